//! How large a simplification will be, before it is made.

use rayon::prelude::*;

use super::Grid;
use crate::{Error, Result, Scene};

/// Most fragments: their corners on both sides, some nine in all, are numbered by 32 bits.
const MOST_FRAGMENTS: f64 = (1u32 << 28) as f64;

/// The number of fragments to expect when `scene` is cut by `grid`.
///
/// Steiner's formula for boxes: a convex body meets, in the mean over all places of the grid, as many unit cells as
/// the volume of its Minkowski sum with a unit cube says. For a triangle that is 1 + its widths along the axes + the
/// areas of its projections along the axes, in voxels.
pub fn expected_fragments(scene: &Scene, grid: &Grid) -> f64 {
    let of_triangle = |t: usize| {
        let [a, b, c] = scene.corners_of(t).map(|p| p.as_dvec3() / grid.voxel_size);
        let widths = a.max(b).max(c) - a.min(b).min(c);
        let projections = 0.5 * (b - a).cross(c - a).abs();
        1.0 + widths.element_sum() + projections.element_sum()
    };
    let chunks: Vec<f64> = (0..scene.triangles.len())
        .collect::<Vec<_>>()
        .par_chunks(4096)
        .map(|chunk| chunk.iter().map(|&t| of_triangle(t)).sum())
        .collect();
    chunks.iter().sum()
}

/// Refuses to cut `scene` by `grid` into more fragments than can be numbered, or held by the memory that is free if
/// each takes so many bytes.
///
/// # Errors
/// [`Error::Option`] that names the voxel size that would do.
pub fn check_size(scene: &Scene, grid: &Grid, bytes_per_fragment: f64) -> Result<()> {
    let memory = available_memory().unwrap_or(f64::INFINITY);
    let most = MOST_FRAGMENTS.min(memory / bytes_per_fragment);
    let count = expected_fragments(scene, grid);
    if count <= most {
        return Ok(());
    }
    let side = grid.voxel_size * grid.dims.into_iter().max().unwrap_or(1) as f64;
    let coarser = |k: i32| Grid { voxel_size: grid.voxel_size * 1.1_f64.powi(k), ..*grid };
    let fits = (1..).map(coarser).take_while(|g| g.voxel_size < side).find(|g| expected_fragments(scene, g) <= most);
    let remedy = fits.map_or("the scene has too many triangles for it at any voxel size".into(), |g| {
        format!("choose --grid {:.0} or --voxel {:.4}", (side / g.voxel_size).floor(), g.voxel_size * scene.frame.scale)
    });
    let limit = if most < MOST_FRAGMENTS {
        format!(
            "would take {:.1} GB of memory, and {:.1} GB are free",
            count * bytes_per_fragment * 1e-9,
            memory * 1e-9
        )
    } else {
        format!("are more than the {MOST_FRAGMENTS} that are possible")
    };
    Err(Error::Option(format!(
        "voxel size {:.3e}: about {count:.2e} pieces of surface {limit}; {remedy}",
        grid.voxel_size * scene.frame.scale
    )))
}

/// Refuses rows that do not fit the memory.
///
/// # Errors
/// [`Error::Option`] with the numbers and the remedy.
pub fn check_rows(patches: usize, rays: u32, bytes_per_ray: f64) -> Result<()> {
    let memory = available_memory().unwrap_or(f64::INFINITY);
    let bytes = patches as f64 * rays as f64 * bytes_per_ray;
    if bytes <= memory {
        return Ok(());
    }
    Err(Error::Option(format!(
        "the form factors of {patches} patches with {rays} rays each would take {:.1} GB of memory, and {:.1} GB are free; \
         choose fewer --rays or a coarser --grid",
        bytes * 1e-9,
        memory * 1e-9
    )))
}

/// Bytes a patch of a simplified mesh: before it is simplified, it has some five triangles for each.
const TARGET_BYTES: f64 = 1200.0;

/// Refuses to simplify a mesh to more patches than the memory holds.
///
/// # Errors
/// [`Error::Option`] with the numbers and the remedy.
pub(super) fn check_target(patches: Option<u32>) -> Result<()> {
    let bytes = patches.unwrap_or(0) as f64 * TARGET_BYTES;
    let memory = available_memory().unwrap_or(f64::INFINITY);
    if bytes <= memory {
        return Ok(());
    }
    Err(Error::Option(format!(
        "{:.2e} target patches would take {:.1} GB of memory, and {:.1} GB are free; choose fewer --target-patches",
        bytes / TARGET_BYTES,
        bytes * 1e-9,
        memory * 1e-9
    )))
}

/// Memory that can be had without swapping, bytes; `None` where the system does not tell (`/proc/meminfo`).
fn available_memory() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    line.split_whitespace().next()?.parse::<f64>().ok().map(|kib| kib * 1024.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_fit_no_machine_are_refused_with_the_numbers() {
        assert!(check_rows(1000, 256, 3.0).is_ok() && check_target(None).is_ok() && check_target(Some(100)).is_ok());
        if available_memory().is_some() {
            let error = check_rows(1 << 40, 65536, 3.0).expect_err("too much").to_string();
            assert!(error.contains("65536 rays") && error.contains("--grid"), "{error}");
            let error = check_target(Some(u32::MAX)).expect_err("too much").to_string();
            assert!(error.contains("4.29e9 target patches") && error.contains("--target-patches"), "{error}");
        }
    }
}
