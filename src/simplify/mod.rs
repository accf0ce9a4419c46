//! The geometry simplification: surfaces are cut by voxels and the pieces grouped into patches (steps 1-4 of the
//! paper).

mod check;
pub mod clip;
mod decimated;
mod faces;
mod feet;
pub mod grid;
pub mod hit_map;
mod layers;
mod mesh;
mod patches;
mod proxy;
mod size;
mod straddle;
mod surfels;
mod triangles;
mod weld;

pub(crate) use check::check;
pub use clip::{Fragments, NO_PATCH, clip};
pub use decimated::{Method, decimated};
pub use faces::faces;
pub use feet::onto_surfaces;
pub use grid::Grid;
pub use hit_map::HitMap;
pub(crate) use layers::{LIFT, clear_heights};
pub(crate) use mesh::foresee;
pub use mesh::{SplitMesh, split_mesh};
pub use patches::Patches;
pub use proxy::proxy;
pub use size::{Pieces, check_rows, check_size, expected_fragments};
pub(crate) use surfels::{UNLIKE, colour};
pub use surfels::{count, surfels};
pub use triangles::patch_mesh;

use glam::Vec3;
use rayon::prelude::*;

use crate::{
    BakeOptions, Result, Scene,
    options::PatchSource,
    trace::{Geometry, RayTracer},
};

/// The simplified scene: patches, the surface that they stand for, and the way back from a ray's hit to a patch.
pub struct Simplified {
    /// The voxel grid.
    pub grid: Grid,
    /// What form-factor rays are traced against: the scene's surfaces, voxel faces, or a simplified mesh.
    pub geometry: Geometry,
    /// Pieces of `geometry`'s triangles, each of one patch a side.
    pub fragments: Fragments,
    /// The patches.
    pub patches: Patches,
    /// Finds the fragment of a hit.
    pub hit_map: HitMap,
}

/// Makes the patches that `options` ask for; `tracer` holds the scene's own triangles.
///
/// # Errors
/// Those of [`decimated()`] and [`proxy()`]; [`crate::Error::Option`] for more patches than the memory holds.
pub fn simplify(scene: &Scene, grid: Grid, options: &BakeOptions, tracer: &dyn RayTracer) -> Result<Simplified> {
    let target = options.target_patches;
    size::check_target(target)?;
    match options.patches {
        PatchSource::Surfels => Ok(surfels(scene, grid, tracer)),
        PatchSource::Faces => Ok(faces(scene, grid, options.face_colour)),
        PatchSource::Decimated => decimated(scene, grid, Method::Decimate, target, tracer),
        PatchSource::Clustered => decimated(scene, grid, Method::Cluster, target, tracer),
        PatchSource::Proxy => proxy(scene, grid, target, tracer),
    }
}

/// Patches that were made of `scene`'s surfaces before, in the colours that these have now.
///
/// # Errors
/// Those of [`simplify`].
pub(crate) fn coloured(
    mut simplified: Simplified,
    scene: &Scene,
    options: &BakeOptions,
    tracer: &dyn RayTracer,
) -> Result<Simplified> {
    match options.patches {
        PatchSource::Surfels => surfels::colour(&mut simplified, scene),
        // The shape of these patches costs no more than their colours.
        PatchSource::Faces => return simplify(scene, simplified.grid, options, tracer),
        PatchSource::Decimated | PatchSource::Clustered | PatchSource::Proxy => {
            triangles::colour(&mut simplified, scene, tracer);
        }
    }
    Ok(simplified)
}

impl Simplified {
    /// Unit normals of the triangles that the patches are pieces of.
    pub fn normals(&self) -> Vec<Vec3> {
        (0..self.geometry.triangles.len()).into_par_iter().map(|t| normal_of(&self.corners(t))).collect()
    }

    /// Corners of triangle `t`.
    pub fn corners(&self, t: usize) -> [Vec3; 3] {
        corners(&self.geometry, t)
    }
}

/// Corners of triangle `t`.
pub(crate) fn corners(geometry: &Geometry, t: usize) -> [Vec3; 3] {
    let [a, b, c] = geometry.triangles[t];
    [geometry.positions[a as usize], geometry.positions[b as usize], geometry.positions[c as usize]]
}

/// Unit normal of a triangle.
pub(crate) fn normal_of(corners: &[Vec3; 3]) -> Vec3 {
    let [a, b, c] = corners.map(Vec3::as_dvec3);
    (b - a).cross(c - a).normalize_or_zero().as_vec3()
}
