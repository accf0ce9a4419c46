//! Points in the edges of the mesh.
//!
//! Where a floor meets a wall, a point lies in the wall too, and half of its rays would slip behind it: in a closed
//! room the sky would light the corners.

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    sampling,
    scene::RAY_OFFSET,
    scene::SurfacePoint,
    trace::{Hit, RayBatch, RayTracer},
};

/// Distance that points are moved off walls; local units.
const CLEAR: f32 = 8.0 * RAY_OFFSET;
/// Directions along the surface in which walls are looked for.
const DIRECTIONS: usize = 8;
/// Walls that can meet in a corner.
const ROUNDS: usize = 4;

/// `points` that lie in the front of another surface, or within rounding behind it, moved along their own surface to
/// before it; the others as they are. `normals` are those of the tracer's triangles.
pub fn clear_of_walls(tracer: &dyn RayTracer, normals: &[Vec3], points: &[SurfacePoint]) -> Vec<SurfacePoint> {
    points
        .par_chunks(256)
        .flat_map_iter(|chunk| {
            let mut points = chunk.to_vec();
            let mut open: Vec<usize> = (0..points.len()).filter(|&i| points[i].is_sound()).collect();
            for _ in 0..ROUNDS {
                let mut rays = RayBatch::with_capacity(open.len() * DIRECTIONS);
                open.iter().for_each(|&i| look_back(&points[i], &mut rays));
                let mut hits = vec![Hit::NONE; rays.len()];
                tracer.closest_hits(&rays, &mut hits);
                let before = points.clone();
                for (k, hit) in hits.iter().enumerate().filter(|(_, h)| h.is_hit() && !h.is_back()) {
                    let on_wall = rays.origin(k) + hit.t * rays.direction(k);
                    step_off(&mut points[open[k / DIRECTIONS]], on_wall, normals[hit.triangle()]);
                }
                open.retain(|&i| points[i].position != before[i].position);
                if open.is_empty() {
                    break;
                }
            }
            points
        })
        .collect()
}

/// Rays from around the point, slightly above its surface, across it.
fn look_back(point: &SurfacePoint, rays: &mut RayBatch) {
    let (t, b) = sampling::frame(point.normal);
    for k in 0..DIRECTIONS {
        let (sin, cos) = ((k as f32 + 0.3) * std::f32::consts::TAU / DIRECTIONS as f32).sin_cos();
        let d = cos * t + sin * b;
        rays.push(point.position + CLEAR * (point.normal + d), -d, 0.0, 2.0 * CLEAR);
    }
}

/// Moves the point along its surface until it is clear of the wall, if it lies in it.
fn step_off(point: &mut SurfacePoint, on_wall: Vec3, wall: Vec3) {
    let n = point.normal;
    let along = wall.dot(n);
    let before = (point.position - on_wall).dot(wall);
    // Surfaces that face alike are no walls to each other.
    if along.abs() < 0.7 && (-RAY_OFFSET..0.5 * CLEAR).contains(&before) {
        point.position += (CLEAR - before) / (1.0 - along * along) * (wall - along * n);
    }
}
