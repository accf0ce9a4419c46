//! Which points see no sky, and which nothing but sky: the rows of the patches around them tell.

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    light::View,
    reconstruct::PatchIndex,
    scene::SurfacePoint,
    simplify::{Patches, Simplified},
    transfer::FormFactors,
};

/// What the rays of each patch found.
#[derive(Clone, Debug, Default)]
pub struct Sky {
    /// Rays that met surfaces and rays that left the scene, of each patch.
    seen: Vec<[u32; 2]>,
}

/// Patches within this many voxels are asked.
const RADIUS: f32 = 1.25;
/// Rays that must agree.
const ENOUGH: u32 = 512;
/// Cosine from which on a patch faces like a point.
const LIKE: f32 = 0.5;

impl Sky {
    /// Of the rows of pieces of the real surfaces.
    pub fn new(f: &FormFactors) -> Sky {
        let seen = |i| {
            let (valid, escaped) = f.rays(i);
            [valid - escaped, escaped]
        };
        Sky { seen: (0..f.len()).into_par_iter().map(seen).collect() }
    }

    /// The view of a point, by the patches around it that face like it.
    pub fn view(&self, simplified: &Simplified, index: &PatchIndex, x: &SurfacePoint) -> View {
        if self.seen.is_empty() {
            return View::Unknown;
        }
        let patches: &Patches = &simplified.patches;
        let (mut met, mut left) = (0, 0);
        index.within(x.position, RADIUS, |j| {
            let near = |a: Vec3| a.distance(x.position) < RADIUS * simplified.grid.voxel_size as f32;
            if patches.normal[j].dot(x.normal) >= LIKE && near(patches.centroid[j]) {
                met += self.seen[j][0];
                left += self.seen[j][1];
            }
        });
        match (met, left) {
            (ENOUGH.., 0) => View::NoSky(met),
            (0, ENOUGH..) => View::AllSky(left),
            _ => View::Unknown,
        }
    }
}
