//! What is known before rays are cast, and a count of those that this spares.

use std::sync::{Mutex, PoisonError};

use super::{Outer, Sky};
use crate::{
    light::{DirectResult, Spared, View},
    reconstruct::{Level, PatchIndex},
    scene::SurfacePoint,
    simplify::Simplified,
    trace::Geometry,
};

/// What is known of a scene and its patches; knows nothing by default.
#[derive(Debug, Default)]
pub struct Foresight {
    /// Whether anything may be left out.
    pub on: bool,
    /// Surfaces with nothing before them.
    pub outer: Outer,
    /// Patches that see no sky, or nothing else.
    pub sky: Sky,
    /// Where patches are visible without asking.
    pub level: Level,
    /// Shadow rays that were cast and spared.
    shadows: Mutex<(u64, Spared)>,
}

impl Foresight {
    /// What the geometry alone tells.
    pub fn new(on: bool, geometry: &Geometry) -> Foresight {
        let outer = if on { Outer::new(geometry) } else { Outer::default() };
        Foresight { on, outer, ..Foresight::default() }
    }

    /// The view of a patch by points of it.
    pub fn of_patch(&self, points: &[SurfacePoint]) -> View {
        if points.iter().all(|x| self.outer.is_clear(x)) { View::Clear } else { View::Unknown }
    }

    /// The view of one point.
    pub fn of_point(&self, simplified: &Simplified, index: &PatchIndex, points: &[SurfacePoint]) -> View {
        match self.of_patch(points) {
            View::Unknown => self.sky.view(simplified, index, &points[0]),
            view => view,
        }
    }

    /// Counts shadow rays.
    pub fn count(&self, result: &DirectResult) {
        let mut shadows = self.shadows.lock().unwrap_or_else(PoisonError::into_inner);
        shadows.0 += result.rays;
        shadows.1 += result.spared;
    }

    /// Shadow rays that were cast and spared since this was last asked.
    pub fn take(&self) -> (u64, Spared) {
        std::mem::take(&mut *self.shadows.lock().unwrap_or_else(PoisonError::into_inner))
    }
}
