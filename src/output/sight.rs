//! What an eye sees: the nearest surface that is not the hidden back of a one-sided one.

use glam::Vec3;

use crate::{
    Scene,
    simplify::SplitMesh,
    trace::{Hit, RayBatch, RayTracer},
};

/// Backs that a ray passes before it is given up.
const BACKS: usize = 64;

/// Tells hidden backs from visible surfaces.
pub struct Sight<'a> {
    tracer: &'a dyn RayTracer,
    hidden: &'a (dyn Fn(&Hit) -> bool + Sync),
}

impl<'a> Sight<'a> {
    /// Rays of `tracer`, that pass through what is `hidden`.
    pub fn new(tracer: &'a dyn RayTracer, hidden: &'a (dyn Fn(&Hit) -> bool + Sync)) -> Sight<'a> {
        Sight { tracer, hidden }
    }

    /// Whether the hit is on a hidden back.
    pub fn is_hidden(&self, hit: &Hit) -> bool {
        hit.is_hit() && (self.hidden)(hit)
    }

    /// The nearest hits, hidden or not.
    pub fn nearest(&self, rays: &RayBatch) -> Vec<Hit> {
        let mut hits = vec![Hit::NONE; rays.len()];
        self.tracer.closest_hits(rays, &mut hits);
        hits
    }

    /// The nearest hits that are not hidden: near walls of a room are seen through from outside, as viewers with
    /// back-face culling do. Moves the rays' `t_min`.
    pub fn visible(&self, rays: &mut RayBatch) -> Vec<Hit> {
        let mut hits = self.nearest(rays);
        let mut again: Vec<usize> = (0..hits.len()).filter(|&i| self.is_hidden(&hits[i])).collect();
        for _ in 0..BACKS {
            if again.is_empty() {
                break;
            }
            let mut behind = RayBatch::with_capacity(again.len());
            for &i in &again {
                rays.t_min[i] = hits[i].t.next_up();
                behind.push(rays.origin(i), rays.direction(i), rays.t_min[i], rays.t_max[i]);
            }
            for (&i, hit) in again.iter().zip(self.nearest(&behind)) {
                hits[i] = hit;
            }
            again.retain(|&i| self.is_hidden(&hits[i]));
        }
        for i in again {
            hits[i] = Hit::NONE;
        }
        hits
    }
}

/// The rule of the scene's own surfaces: backs of one-sided triangles are hidden.
pub fn hidden_backs(scene: &Scene) -> impl Fn(&Hit) -> bool + Sync {
    |hit| hit.is_back() && !scene.triangles[hit.triangle()].two_sided
}

/// Radiance that one side of triangle `t` sends out.
pub(super) fn emission(scene: &Scene, t: usize, back: bool) -> Vec3 {
    if back && !scene.triangles[t].emits_back { Vec3::ZERO } else { scene.emission(t) }
}

/// Whether triangle `i` of the split mesh is a piece of the back of its scene triangle.
pub(super) fn is_back(scene: &Scene, mesh: &SplitMesh, i: usize) -> bool {
    let [a, b, c] = mesh.triangles[i].map(|v| mesh.positions[v as usize]);
    (b - a).cross(c - a).dot(scene.normal(mesh.source[i] as usize)) < 0.0
}
