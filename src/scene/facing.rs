//! Lamps that face the wrong way.

use glam::Vec3;

use super::{RAY_OFFSET, Scene};
use crate::{
    options::Backend,
    sampling,
    trace::{self, Brute, Hit, RayBatch, RayTracer},
};

/// Rays a side.
const RAYS: usize = 64;

/// For every list of glowing triangles, whether its front is shut off while its back is free.
///
/// Shut means that half of the rays end within 1 % of the scene's diagonal and ten times sooner than those of the back
/// (a lamp that faces the ceiling it hangs from); or that no ray of the front and most of the back's meet anything.
pub(crate) fn shut(scene: &Scene, lamps: &[Vec<u32>]) -> Vec<bool> {
    if lamps.is_empty() {
        return Vec::new();
    }
    let geometry = scene.geometry();
    let tracer: Box<dyn RayTracer> =
        trace::build(Backend::Auto, &geometry).unwrap_or_else(|_| Box::new(Brute::new(&geometry)));
    let (low, high) = (scene.positions.iter())
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(*p), high.max(*p)));
    let near = 0.01 * (high - low).length();

    let mut rays = RayBatch::with_capacity(lamps.len() * 2 * RAYS);
    for triangles in lamps {
        for side in [1.0, -1.0] {
            push_rays(scene, triangles, side, &mut rays);
        }
    }
    let mut hits = vec![Hit::NONE; rays.len()];
    tracer.closest_hits(&rays, &mut hits);
    hits.chunks_exact_mut(2 * RAYS)
        .map(|hits| {
            let (front, back) = hits.split_at_mut(RAYS);
            let (front_path, back_path) = (median(front), median(back));
            let met = |hits: &[Hit]| hits.iter().filter(|h| h.is_hit()).count();
            (front_path < near && 10.0 * front_path < back_path)
                || (met(front) == 0 && 2 * met(back) > RAYS && back_path > near)
        })
        .collect()
}

/// Cosine-distributed rays from points spread over `triangles` by area.
fn push_rays(scene: &Scene, triangles: &[u32], side: f32, rays: &mut RayBatch) {
    let areas: Vec<f64> = triangles.iter().map(|&t| scene.area(t as usize)).collect();
    let total: f64 = areas.iter().sum();
    let (mut k, mut passed) = (0, 0.0);
    for i in 0..RAYS {
        let place = (i as f64 + 0.5) / RAYS as f64 * total;
        while k + 1 < triangles.len() && passed + areas[k] < place {
            passed += areas[k];
            k += 1;
        }
        let t = triangles[k] as usize;
        let [s0, s1, s2, s3] = sampling::sobol4(i as u32, 0);
        let (u, v) = sampling::triangle(s0, s1);
        let [a, b, c] = scene.corners_of(t);
        let normal = side * scene.normal(t);
        let (x, y) = sampling::frame(normal);
        let d = sampling::cosine_hemisphere(s2, s3);
        let origin = a * (1.0 - u - v) + b * u + c * v + normal * RAY_OFFSET;
        rays.push(origin, x * d.x + y * d.y + normal * d.z, 0.0, f32::INFINITY);
    }
}

fn median(hits: &mut [Hit]) -> f32 {
    hits.sort_by(|a, b| a.t.total_cmp(&b.t));
    hits[hits.len() / 2].t
}
