//! From patches back to vertices and points (step 5 of the paper, and a better one).

mod edges;
mod index;
mod level;
mod nearest4;
mod smooth;

pub use edges::clear_of_walls;
pub use index::PatchIndex;
pub use level::Level;

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    options::Reconstruct,
    scene::SurfacePoint,
    simplify::{Patches, Simplified},
    trace::RayTracer,
};

/// What interpolation works on.
pub struct Field<'a> {
    /// The patches, their grid and surfaces.
    pub simplified: &'a Simplified,
    /// Finds patches near a point.
    pub index: &'a PatchIndex,
    /// The value of each patch: irradiance, W/m2.
    pub values: &'a [Vec3],
    /// Patches whose value is known; the others are left out.
    pub known: &'a [bool],
    /// Tracer of the real surfaces.
    pub tracer: &'a dyn RayTracer,
    /// Unit normals of the triangles that `tracer` holds.
    pub normals: &'a [Vec3],
    /// Cosine of the largest angle between the normals of a point and a patch.
    pub cos_threshold: f32,
    /// Where patches are visible without asking.
    pub level: &'a Level,
}

impl Field<'_> {
    fn patches(&self) -> &Patches {
        &self.simplified.patches
    }
}

/// Interpolates the field at `points`. Values are never negative. The result of a point depends on nothing but its
/// position and normal; it is zero if these are not finite or the normal is not a unit vector.
pub fn interpolate(field: &Field, method: Reconstruct, points: &[SurfacePoint]) -> Vec<Vec3> {
    points
        .par_chunks(64)
        .flat_map_iter(|chunk| match method {
            Reconstruct::Smooth => smooth::interpolate(field, chunk),
            Reconstruct::Nearest4 => chunk.iter().map(|p| nearest4::interpolate(field, p)).collect(),
        })
        .collect()
}
