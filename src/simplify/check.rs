//! What the rest of luxel takes for granted of patches and fragments that come out of a file.

use super::{Fragments, Grid, NO_PATCH, Patches, grid::MAX_DIM};
use crate::trace::Geometry;

/// Barycentric weights may leave [0, 1] by this much, by rounding.
const SLACK: f32 = 1e-3;

/// Coordinates stay below this: a scene lies in [-0.5, 0.5]^3, a proxy at most a side of it away. The table from hits to
/// patches grows with what triangles cover.
const FARTHEST: f32 = 4.0;

/// Voxels are larger: the longest side of a scene is at least 0.5.
const SMALLEST: f64 = 0.4 / MAX_DIM as f64;

/// Numbers of fragments and patches have 31 bits.
const MOST: usize = 1 << 31;

/// What does not fit together, if anything.
pub(crate) fn check(grid: &Grid, geometry: &Geometry, fragments: &Fragments, patches: &Patches) -> Result<(), String> {
    check_grid(grid)?;
    geometry.check().map_err(|e| e.to_string())?;
    ensure(geometry.positions.iter().all(|p| p.abs().max_element() < FARTHEST), "geometry: a vertex far away")?;
    let voxels = grid.dims.iter().map(|&n| n as u64).product::<u64>();
    check_fragments(geometry, fragments, voxels, patches.len())?;
    check_patches(fragments, patches, voxels)
}

fn check_grid(grid: &Grid) -> Result<(), String> {
    let dims = grid.dims.iter().all(|n| (1..=MAX_DIM + 2).contains(n));
    let sound = dims && grid.origin.is_finite() && grid.voxel_size.is_finite() && grid.voxel_size > SMALLEST;
    if sound { Ok(()) } else { Err(format!("a grid of {:?} voxels of size {}", grid.dims, grid.voxel_size)) }
}

fn check_fragments(geometry: &Geometry, fragments: &Fragments, voxels: u64, patches: usize) -> Result<(), String> {
    let n = fragments.len();
    let Fragments { triangle, voxel, start, uv, patch } = fragments;
    ensure(n < MOST && voxel.len() == n && patch.len() == n, "fragments: arrays differ in length")?;
    check_start(start, n, uv.len(), 3).map_err(|e| format!("fragments: {e}"))?;
    // Every triangle has fragments, and they are in its order.
    let mut last = None;
    for &t in triangle {
        ensure(
            last == Some(t) || last.map_or(0, |l: u32| l.wrapping_add(1)) == t,
            "fragments: not sorted by triangle",
        )?;
        last = Some(t);
    }
    ensure(last.map_or(0, |l| l as usize + 1) == geometry.triangles.len(), "fragments: triangles without any")?;
    ensure(all(voxel, |&v| v < voxels), "fragments: a voxel outside the grid")?;
    // What is no number is in no range.
    let near = |x: f32| (-SLACK..=1.0 + SLACK).contains(&x);
    ensure(all(uv, |p| near(p.x) & near(p.y)), "fragments: a corner outside its triangle")?;
    let known = |p: u32| (p == NO_PATCH) | ((p as usize) < patches);
    ensure(all(patch, |sides| known(sides[0]) & known(sides[1])), "fragments: a patch that is not there")
}

fn check_patches(fragments: &Fragments, patches: &Patches, voxels: u64) -> Result<(), String> {
    let n = patches.len();
    let Patches { area, centroid, eye, normal, albedo: _, emitted: _, voxel, start, members } = patches;
    let lengths = [centroid.len(), eye.len(), normal.len(), voxel.len()];
    ensure(n < MOST && lengths == [n; 4], "patches: arrays differ in length")?;
    check_start(start, n, members.len(), 1).map_err(|e| format!("patches: {e}"))?;
    ensure(all(voxel, |&v| v < voxels) && voxel.is_sorted(), "patches: not sorted by voxel")?;
    ensure(all(area, |a| a.is_finite() & (*a >= 0.0)), "patches: an area that is negative or not finite")?;
    let finite = [centroid, eye, normal].into_iter().all(|list| all(list, |v| v.is_finite()));
    ensure(finite && all(normal, |n| n.length_squared() < 1.1), "patches: a place that is not finite")?;
    // Fragments and patches say the same of each other.
    let sides = fragments.patch.iter().flatten().filter(|p| **p != NO_PATCH).count();
    ensure(sides == members.len(), "patches: members are not the fragments' sides")?;
    for i in 0..n {
        for &m in patches.members(i) {
            let side = fragments.patch.get((m >> 1) as usize).map(|sides| sides[(m & 1) as usize]);
            ensure(side == Some(i as u32), "patches: members are not the fragments' sides")?;
        }
    }
    Ok(())
}

/// `start` parts `items` things into `n` runs of at least `least`.
fn check_start(start: &[u32], n: usize, items: usize, least: u32) -> Result<(), &'static str> {
    let runs = start.len() == n + 1 && start[0] == 0 && start[n] as usize == items;
    let long = start.windows(2).all(|w| w[1].checked_sub(w[0]).is_some_and(|length| length >= least));
    if runs && long { Ok(()) } else { Err("runs that do not fit") }
}

/// Whether that `holds` of all: it is asked of each, so that vectors of them can be asked at once.
fn all<T>(list: &[T], holds: impl Fn(&T) -> bool) -> bool {
    list.iter().fold(true, |all, item| all & holds(item))
}

fn ensure(holds: bool, message: &str) -> Result<(), String> {
    if holds { Ok(()) } else { Err(message.into()) }
}
