//! How large a simplification will be, before it is made.

use rayon::prelude::*;

use super::grid::{self, Grid, MAX_DIM};
use crate::{Error, Result, Scene};

/// Most fragments: their corners on both sides, some nine in all, are numbered by 32 bits.
const MOST_FRAGMENTS: f64 = (1u32 << 28) as f64;

/// How many fragments a scene is cut into by voxels of any size.
///
/// Steiner's formula for boxes: a convex body meets, in the mean over all places of the grid, as many unit cells as
/// the volume of its Minkowski sum with a unit cube says. For a triangle that is 1 + its widths along the axes + the
/// areas of its projections along the axes, in voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pieces {
    triangles: f64,
    widths: f64,
    areas: f64,
    /// The scene's longest side.
    side: f64,
    /// World units of a local one.
    scale: f64,
}

impl Pieces {
    /// Of `scene`.
    pub fn new(scene: &Scene) -> Pieces {
        let of_triangle = |t: usize| {
            let [a, b, c] = scene.corners_of(t).map(|p| p.as_dvec3());
            let widths = a.max(b).max(c) - a.min(b).min(c);
            [widths.element_sum(), 0.5 * (b - a).cross(c - a).abs().element_sum()]
        };
        let add = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        let all: Vec<usize> = (0..scene.triangles.len()).collect();
        let chunks: Vec<[f64; 2]> =
            all.par_chunks(4096).map(|chunk| chunk.iter().map(|&t| of_triangle(t)).fold([0.0; 2], add)).collect();
        let [widths, areas] = chunks.into_iter().fold([0.0; 2], add);
        let triangles = scene.triangles.len() as f64;
        Pieces { triangles, widths, areas, side: grid::side(scene), scale: scene.frame.scale }
    }

    /// How many to expect with voxels of this size, local units.
    pub fn at(&self, voxel_size: f64) -> f64 {
        self.triangles + self.widths / voxel_size + self.areas / (voxel_size * voxel_size)
    }

    /// The remedy: the finest grid that is coarser than voxels of this size and whose number of pieces `fits`; `None` if
    /// no grid does.
    pub fn coarser(&self, voxel_size: f64, fits: impl Fn(f64) -> bool) -> Option<String> {
        let finest = ((self.side / voxel_size).ceil() as u32).saturating_sub(1).min(MAX_DIM);
        let size = |n: u32| self.side / n as f64;
        let n = (LEAST_GRID..=finest).rev().find(|&n| fits(self.at(size(n))))?;
        // Four digits, not rounded down.
        let h = size(n) * self.scale;
        let digits = 10_f64.powi(3 - h.log10().floor() as i32);
        Some(format!("choose --grid {n} or --voxel {}", ((h * digits).ceil() / digits) as f32))
    }
}

/// Voxels on the longest side at least.
const LEAST_GRID: u32 = 2;

/// The number of fragments to expect when `scene` is cut by `grid`: see [`Pieces`].
pub fn expected_fragments(scene: &Scene, grid: &Grid) -> f64 {
    Pieces::new(scene).at(grid.voxel_size)
}

/// Refuses to cut `scene` by `grid` into more fragments than can be numbered, or held by the memory that is free if
/// each takes so many bytes.
///
/// # Errors
/// [`Error::Option`] that names the voxel size that would do.
pub fn check_size(scene: &Scene, grid: &Grid, bytes_per_fragment: f64) -> Result<()> {
    let memory = available_memory().unwrap_or(f64::INFINITY);
    let most = MOST_FRAGMENTS.min(memory / bytes_per_fragment);
    let pieces = Pieces::new(scene);
    let count = pieces.at(grid.voxel_size);
    if count <= most {
        return Ok(());
    }
    let remedy = pieces.coarser(grid.voxel_size, |count| count <= most);
    let remedy = remedy.unwrap_or("the scene has too many triangles for it at any voxel size".into());
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
    use std::path::Path;

    use super::*;
    use crate::{options::Resolution, scene};

    #[test]
    fn the_grid_that_is_suggested_fits_and_the_next_finer_one_does_not() {
        let scene = scene::load(Path::new("scenes/cornell.toml"), &Default::default()).unwrap().0;
        let pieces = Pieces::new(&scene);
        let at = |resolution| expected_fragments(&scene, &Grid::new(&scene, resolution).unwrap());
        let fine = Grid::new(&scene, Resolution::Grid(500)).unwrap();
        for most in [1e3, 1e4, 1e5] {
            let remedy = pieces.coarser(fine.voxel_size, |count| count <= most).expect("some grid fits");
            let words: Vec<&str> = remedy.split(' ').collect();
            let ["choose", "--grid", n, "or", "--voxel", h] = words[..] else { panic!("{remedy}") };
            let (n, h): (u32, f64) = (n.parse().unwrap(), h.parse().unwrap());
            assert!(at(Resolution::Grid(n)) <= most && at(Resolution::Voxel(h)) <= most, "{remedy}, at most {most}");
            assert!(at(Resolution::Grid(n + 1)) > most, "{remedy}, at most {most}");
        }
        assert_eq!(pieces.coarser(fine.voxel_size, |count| count <= pieces.triangles), None);
        // Nothing finer is a remedy.
        assert!(pieces.coarser(fine.voxel_size, |_| true).unwrap().starts_with("choose --grid 499 "));
    }

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
