//! Where nothing can stand between a point and the patches near it.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use glam::Vec3;
use rayon::prelude::*;

use crate::simplify::{Simplified, clip::point_at, normal_of};

/// Which patches are flat; and the visibility rays that this has spared.
///
/// Points and patches look for each other from slightly above their surface. Every surface near is a piece of a patch,
/// but for dust that clipping leaves out; so where all patches near are parallel to a point's surface and none rises
/// above it, nothing hides those that lie level with it.
#[derive(Debug, Default)]
pub struct Level {
    /// How far, in voxels, a patch reaches to either side of its centroid, along its normal; infinite if it is not flat.
    /// Empty if nothing is known.
    depth: Vec<f32>,
    voxel_size: f32,
    cast: AtomicU64,
    spared: AtomicU64,
}

/// Parallel normals have at least this cosine: within the radius of a point's neighbours they rise by 0.3 % of a voxel.
const PARALLEL: f32 = 1.0 - 1e-6;
/// What does not rise above a point's surface by more than so many voxels lies below its rays.
const RISE: f32 = 0.005;

impl Level {
    /// Of patches that are the pieces of all real surfaces.
    pub fn new(simplified: &Simplified) -> Level {
        let patches = &simplified.patches;
        let voxel_size = simplified.grid.voxel_size as f32;
        let depth = |i: usize| {
            let mut depth = 0.0_f32;
            for &m in patches.members(i) {
                let f = (m >> 1) as usize;
                let corners = simplified.corners(simplified.fragments.triangle[f] as usize);
                if normal_of(&corners).dot(patches.normal[i]).abs() < PARALLEL {
                    return f32::INFINITY;
                }
                let height = |&uv| (point_at(&corners, uv) - patches.centroid[i]).dot(patches.normal[i]).abs();
                depth = simplified.fragments.uv(f).iter().map(height).fold(depth, f32::max);
            }
            depth / voxel_size
        };
        let depth = (0..patches.len()).into_par_iter().map(depth).collect();
        Level::of(depth, simplified.grid.voxel_size)
    }

    /// As [`Level::new`] found it: the [depth](Level::depth) of each patch, in voxels of this size.
    pub fn of(depth: Vec<f32>, voxel_size: f64) -> Level {
        Level { depth, voxel_size: voxel_size as f32, ..Level::default() }
    }

    /// How far, in voxels, each patch reaches to either side of its centroid, along its normal; infinite if it is not flat.
    pub fn depth(&self) -> &[f32] {
        &self.depth
    }

    /// Whether anything is known.
    pub(super) fn is_known(&self) -> bool {
        !self.depth.is_empty()
    }

    /// Whether patch `j`, of this normal and with its centroid at `to` from a point, lies below the rays of that point.
    pub(super) fn is_below(&self, j: usize, n: Vec3, to: Vec3, normal: Vec3) -> bool {
        n.dot(normal).abs() >= PARALLEL && to.dot(normal) / self.voxel_size + self.depth[j] <= RISE
    }

    /// Whether a patch with its centroid at `to` from a point lies no deeper than the point, if it is below its rays.
    pub(super) fn is_level(&self, to: Vec3, normal: Vec3) -> bool {
        to.dot(normal) / self.voxel_size >= -RISE
    }

    pub(super) fn count(&self, cast: usize, spared: usize) {
        self.cast.fetch_add(cast as u64, Relaxed);
        self.spared.fetch_add(spared as u64, Relaxed);
    }

    /// Visibility rays that were cast, and that were not.
    pub fn rays(&self) -> (u64, u64) {
        (self.cast.load(Relaxed), self.spared.load(Relaxed))
    }
}
