//! Where nothing can stand between a point and the patches near it.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use rayon::prelude::*;

use crate::{
    scene::SurfacePoint,
    simplify::{Patches, Simplified, normal_of},
};

/// Which patches are flat; and the visibility rays that this has spared.
///
/// Every surface near a point is a piece of a patch, but for dust that clipping leaves out. Where all patches near lie
/// in the plane of the point, the rays between, which run above it, meet nothing.
#[derive(Debug, Default)]
pub struct Level {
    /// Empty if nothing is known.
    flat: Vec<bool>,
    cast: AtomicU64,
    spared: AtomicU64,
}

/// Cosine from which on surfaces are parallel: across a voxel they then part by less than a fifth of the rays' height.
const PARALLEL: f32 = 1.0 - 1e-6;

impl Level {
    /// Of patches that are the pieces of all real surfaces.
    pub fn new(simplified: &Simplified) -> Level {
        let patches = &simplified.patches;
        let flat = |i: usize| {
            patches.members(i).iter().all(|&m| {
                let corners = simplified.corners(simplified.fragments.triangle[(m >> 1) as usize] as usize);
                normal_of(&corners).dot(patches.normal[i]).abs() >= PARALLEL
            })
        };
        Level { flat: (0..patches.len()).into_par_iter().map(flat).collect(), ..Level::default() }
    }

    /// Whether anything is known.
    pub(super) fn is_known(&self) -> bool {
        !self.flat.is_empty()
    }

    /// Whether all of patch `j` lies in the plane of the point, up to `height`.
    pub(super) fn in_plane(&self, patches: &Patches, j: usize, point: &SurfacePoint, height: f32) -> bool {
        let parallel = || patches.normal[j].dot(point.normal).abs() >= PARALLEL;
        let level = || (patches.centroid[j] - point.position).dot(point.normal).abs() <= height;
        self.flat[j] && parallel() && level()
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
