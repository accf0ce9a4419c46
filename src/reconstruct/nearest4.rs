//! Step 5 of the paper: the four nearest patches, by inverse distance.

use glam::Vec3;

use super::Field;
use crate::scene::SurfacePoint;

/// The four nearest known patches whose normals are within the threshold angle, weighted by inverse distance.
///
/// Weights sum to 1: w_k = (1/d_k) / sum(1/d). The paper's printed formula has a wrong normaliser.
pub fn interpolate(field: &Field, point: &SurfacePoint) -> Vec3 {
    // Shares first: the strongest light stays finite.
    factors(field, point).map(|(j, share)| share * field.values[j as usize]).sum::<Vec3>().min(Vec3::MAX)
}

/// What [`interpolate`] takes from each patch, as (patch, share); the shares sum to 1.
pub fn factors(field: &Field, point: &SurfacePoint) -> impl Iterator<Item = (u32, f32)> {
    let best = if point.is_sound() { around(field, point) } else { NONE };
    // A point in the very centre of a patch takes its value.
    let weight = |d2: f32| 1.0 / d2.sqrt().max(1e-12);
    let found = move || best.into_iter().filter(|b| b.1 != usize::MAX);
    let weights: f32 = found().map(|b| weight(b.0)).sum();
    found().map(move |b| (b.1 as u32, weight(b.0) / weights))
}

/// No patches, as [`nearest`] tells them.
const NONE: [(f32, usize); 4] = [(f32::INFINITY, usize::MAX); 4];

/// The four nearest of all.
fn around(field: &Field, point: &SurfacePoint) -> [(f32, usize); 4] {
    let mut radius = 1.0;
    loop {
        let best = nearest(field, point, radius);
        // Beyond `radius` voxels there may be nearer ones than those found in the corners of the cube.
        let limit = radius * field.simplified.grid.voxel_size as f32;
        let complete = best[3].0 <= limit * limit;
        if complete || radius >= field.index.whole() {
            return best;
        }
        radius *= 2.0;
    }
}

/// The four nearest as (squared distance, patch), nearest first; infinite where there are fewer.
fn nearest(field: &Field, point: &SurfacePoint, radius: f32) -> [(f32, usize); 4] {
    let patches = field.patches();
    let mut best = NONE;
    field.index.near(point.position, radius, |j| {
        if !field.known[j] || patches.normal[j].dot(point.normal) < field.cos_threshold {
            return;
        }
        let entry = (patches.centroid[j].distance_squared(point.position), j);
        if entry < best[3] {
            best[3] = entry;
            best.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        }
    });
    best
}
