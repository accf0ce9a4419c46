//! The real surfaces that points of a simplified mesh stand for.

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    Scene, sampling,
    scene::{RAY_OFFSET, SurfacePoint},
    trace::{Hit, RayBatch, RayTracer},
};

/// The point of a real surface that a point of a simplified one stands for.
#[derive(Clone, Copy, Debug)]
pub struct Foot {
    /// Triangle of the scene, with its barycentric weights.
    pub hit: Hit,
    /// Whether the back of the triangle is meant.
    pub back: bool,
    /// Distance of the two points.
    pub distance: f32,
}

/// How far surfaces along the normal may be, local units; the scene is between 0.5 and 1 long.
pub const REACH: f32 = 0.1;
/// Directions in which surfaces are looked for that do not lie along the normal.
const FAN: usize = 48;
/// Rays along the normal start this far on the other side, to meet surfaces that touch.
const OVERLAP: f32 = 4.0 * RAY_OFFSET;

/// The foot of each point: the nearest real surface before and behind it that faces its way; where there is none,
/// the nearest in any of some directions; `None` where that is farther than [`REACH`] too. With `any_side`, surfaces
/// that turn their backs to the point count as well. `tracer` holds the scene's own triangles.
pub fn feet(scene: &Scene, tracer: &dyn RayTracer, points: &[SurfacePoint], any_side: bool) -> Vec<Option<Foot>> {
    points
        .par_chunks(2048)
        .flat_map_iter(|chunk| {
            let mut rays = RayBatch::with_capacity(2 * chunk.len());
            for p in chunk {
                for n in [p.normal, -p.normal] {
                    rays.push(p.position - OVERLAP * n, n, 0.0, REACH + OVERLAP);
                }
            }
            let mut hits = vec![Hit::NONE; rays.len()];
            tracer.closest_hits(&rays, &mut hits);
            let mut feet: Vec<Option<Foot>> = (hits.chunks_exact(2))
                .map(|pair| {
                    let ahead = foot(scene, &pair[0], true, OVERLAP, any_side);
                    let behind = foot(scene, &pair[1], false, OVERLAP, any_side);
                    nearer(ahead, behind)
                })
                .collect();
            let lost: Vec<usize> = (0..chunk.len()).filter(|&i| feet[i].is_none()).collect();
            for (i, found) in lost.iter().zip(around(scene, tracer, &lost, chunk)) {
                feet[*i] = found;
            }
            feet
        })
        .collect()
}

/// The foot that a ray found. A ray along the normal (`ahead`) meets the backs of surfaces that face its way.
fn foot(scene: &Scene, hit: &Hit, ahead: bool, start: f32, any_side: bool) -> Option<Foot> {
    if !hit.is_hit() {
        return None;
    }
    let back = hit.is_back() != ahead;
    let visible = !back || scene.triangles[hit.triangle()].two_sided;
    (visible || any_side).then_some(Foot { hit: *hit, back: back && visible, distance: (hit.t - start).abs() })
}

fn nearer(a: Option<Foot>, b: Option<Foot>) -> Option<Foot> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if b.distance < a.distance { b } else { a }),
        _ => a.or(b),
    }
}

/// The nearest surfaces in all directions.
fn around(scene: &Scene, tracer: &dyn RayTracer, lost: &[usize], points: &[SurfacePoint]) -> Vec<Option<Foot>> {
    let mut rays = RayBatch::with_capacity(lost.len() * FAN);
    for &i in lost {
        for k in 0..FAN {
            // A spiral over the sphere.
            let z = 1.0 - (2 * k + 1) as f32 / FAN as f32;
            let (sin, cos) = (k as f32 * 2.399_963_1).sin_cos();
            let r = (1.0 - z * z).sqrt();
            let (t, b) = sampling::frame(points[i].normal);
            rays.push(points[i].position, r * (cos * t + sin * b) + z * points[i].normal, 0.0, REACH);
        }
    }
    let mut hits = vec![Hit::NONE; rays.len()];
    tracer.closest_hits(&rays, &mut hits);
    hits.chunks_exact(FAN)
        .zip(lost)
        .map(|(hits, &i)| {
            let nearest = hits.iter().filter(|h| h.is_hit()).min_by(|a, b| a.t.total_cmp(&b.t))?;
            let faces = scene.normal(nearest.triangle()).dot(points[i].normal) >= 0.0;
            let back = !faces && scene.triangles[nearest.triangle()].two_sided;
            Some(Foot { hit: *nearest, back, distance: nearest.t })
        })
        .collect()
}

/// Points of a simplified mesh moved to the real surfaces; those without a foot stay.
pub fn onto_surfaces(scene: &Scene, tracer: &dyn RayTracer, points: &[SurfacePoint]) -> Vec<SurfacePoint> {
    let moved = |(point, foot): (&SurfacePoint, Option<Foot>)| {
        let Some(foot) = foot else { return *point };
        let t = foot.hit.triangle();
        let normal = scene.normal(t);
        SurfacePoint { position: foot.position(scene), normal: if foot.back { -normal } else { normal } }
    };
    points.iter().zip(feet(scene, tracer, points, false)).map(moved).collect()
}

impl Foot {
    fn position(&self, scene: &Scene) -> Vec3 {
        let [a, b, c] = scene.corners_of(self.hit.triangle());
        a * (1.0 - self.hit.u - self.hit.v) + b * self.hit.u + c * self.hit.v
    }
}
