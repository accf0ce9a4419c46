//! Where nothing can stand between a point and the patches near it.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

use glam::Vec3;
use rayon::prelude::*;

use crate::simplify::{Simplified, UNLIKE, normal_of};

/// How much the surfaces of each patch turn; and the visibility rays that this has spared.
///
/// Only surfaces unlike a point hide patches from it. Every surface near is a piece of a patch, but for dust that
/// clipping leaves out; so where all patches near are like the point, all of them are visible.
#[derive(Debug, Default)]
pub struct Level {
    /// Cosine and sine of the largest angle of the surfaces of a patch to its normal; empty if nothing is known.
    spread: Vec<[f32; 2]>,
    cast: AtomicU64,
    spared: AtomicU64,
}

/// Margin for rounding.
const MARGIN: f32 = 1e-4;

impl Level {
    /// Of patches that are the pieces of all real surfaces.
    pub fn new(simplified: &Simplified) -> Level {
        let patches = &simplified.patches;
        let spread = |i: usize| {
            let cosine = |&m: &u32| {
                let corners = simplified.corners(simplified.fragments.triangle[(m >> 1) as usize] as usize);
                normal_of(&corners).dot(patches.normal[i]).abs()
            };
            let cos = patches.members(i).iter().map(cosine).fold(1.0, f32::min);
            [cos, (1.0 - cos * cos).max(0.0).sqrt()]
        };
        Level { spread: (0..patches.len()).into_par_iter().map(spread).collect(), ..Level::default() }
    }

    /// Whether anything is known.
    pub(super) fn is_known(&self) -> bool {
        !self.spread.is_empty()
    }

    /// Whether no surface of patch `j` with mean normal `n` hides anything from a point with this normal.
    pub(super) fn is_like(&self, j: usize, n: Vec3, normal: Vec3) -> bool {
        let ([cos_spread, sin_spread], cos) = (self.spread[j], n.dot(normal).abs().min(1.0));
        cos * cos_spread - (1.0 - cos * cos).max(0.0).sqrt() * sin_spread > UNLIKE + MARGIN
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
