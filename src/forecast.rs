//! What a bake will take, before a ray is cast.

use serde::Serialize;

use crate::{
    BakeOptions, Error, Result, Scene,
    options::PatchSource,
    outlook::{Limit, Outlook, SUGGESTED, Sizes},
    output::report::memory_bytes,
    simplify::{self, Grid, Pieces},
    trace,
};

/// Sizes and costs of a bake that has not begun.
///
/// The scene is cut into voxels as the bake will cut it, so fragments are nearly exact. How many patches are split where
/// they straddle something takes rays to know: patches, rays, bytes and seconds are estimates within a factor of two or
/// so. All patches are taken as reached by light. A bake with a limit foretells its memory better, from its patches and
/// a sample of its rows: see [`Outlook`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Forecast {
    /// Voxel size, world units.
    pub voxel_size: f64,
    /// Voxels along each axis.
    pub voxels: [u32; 3],
    /// Pieces of triangles.
    pub fragments: usize,
    /// Patches.
    pub patches: usize,
    /// Form-factor rays.
    pub rays: u64,
    /// Bytes of the form factors.
    pub form_factor_bytes: u64,
    /// Largest memory, bytes, with pictures of the default size.
    pub memory_bytes: u64,
    /// Seconds on this machine's threads, within a factor of three.
    pub seconds: f64,
    /// The mesh with most fragments, and its share of them.
    pub largest_mesh: Option<(String, f64)>,
}

impl std::fmt::Display for Forecast {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let [x, y, z] = self.voxels;
        writeln!(
            f,
            "forecast      {x} x {y} x {z} voxels of {:.4}; {} fragments, {} patches",
            self.voxel_size, self.fragments, self.patches
        )?;
        writeln!(
            f,
            "              {:.1} million form-factor rays, {:.1} MB of form factors, {:.1} MB of memory, about {:.1} s",
            self.rays as f64 * 1e-6,
            self.form_factor_bytes as f64 * 1e-6,
            self.memory_bytes as f64 * 1e-6,
            self.seconds
        )?;
        match &self.largest_mesh {
            Some((mesh, share)) => {
                writeln!(f, "              most of it from mesh \"{mesh}\": {:.0} % of the fragments", 100.0 * share)
            }
            None => Ok(()),
        }
    }
}

/// Bytes a triangle: ray-tracing structure, copies for it. The scene is there.
const TRIANGLE_BYTES: f64 = 180.0;
/// Bytes a fragment: its corners, and its vertices with their light.
pub(crate) const FRAGMENT_BYTES: f64 = 1000.0;
/// Bytes a fragment and a patch of the simplified scene.
const SIMPLIFIED_FRAGMENT: f64 = 240.0;
const SIMPLIFIED_PATCH: f64 = 250.0;
/// Corners and vertices a fragment: five scenes have 4 to 7, and 0.8 to 2.6.
const CORNERS: f64 = 5.0;
const VERTICES: f64 = 1.8;
/// What the direct light of the patches takes on its way.
pub(crate) const DIRECT_BYTES: f64 = 20e6;
/// Bytes a ray of a row: 0.7 entries of 2.1 bytes; five scenes have 0.25 to 0.77 entries.
pub(crate) const RAY_BYTES: f64 = 0.7 * 2.1;
/// Patches a fragment at most, about: one a side.
const SIDES: f64 = 2.0;
/// Pixels of the pictures by default.
const PIXELS: u64 = 640 * 480;

/// Foretells the bake of `scene` with `options`.
///
/// # Errors
/// [`crate::Error::Option`] for voxels that do not fit the scene, or are so small that the bake would be refused.
pub fn forecast(scene: &Scene, options: &BakeOptions) -> Result<Forecast> {
    let grid = Grid::new(scene, options.resolution)?;
    simplify::check_size(scene, &grid, FRAGMENT_BYTES)?;
    let (fragments, mut patches, by_mesh) = simplify::count(scene, &grid);
    if options.patches != PatchSource::Surfels {
        let tracer = trace::build(options.backend, &scene.geometry())?;
        patches = simplify::simplify(scene, grid, options, &*tracer)?.patches.len();
    }
    let rays = patches as u64 * options.rays as u64;
    let outlook = outlook(scene, options, fragments as f64, patches as f64);
    let largest_mesh = by_mesh
        .iter()
        .enumerate()
        .max_by_key(|(i, n)| (**n, std::cmp::Reverse(*i)))
        .map(|(i, n)| (scene.meshes[i].clone(), *n as f64 / fragments.max(1) as f64));
    Ok(Forecast {
        voxel_size: grid.voxel_size * scene.frame.scale,
        voxels: grid.dims,
        fragments,
        patches,
        rays,
        form_factor_bytes: outlook.rows,
        memory_bytes: outlook.most(PIXELS, false),
        seconds: seconds(scene, fragments, rays),
        largest_mesh,
    })
}

/// What a bake of so many fragments and patches will take.
fn outlook(scene: &Scene, options: &BakeOptions, fragments: f64, patches: f64) -> Outlook {
    let row_bytes = patches * options.rays as f64 * RAY_BYTES;
    let sizes = Sizes {
        used: 0.0,
        patches: patches as usize,
        row_bytes,
        cast_bytes: row_bytes,
        corners: (fragments * CORNERS) as usize,
        vertices: (fragments * VERTICES) as usize,
        estimate: options.estimate,
    };
    let simplified =
        scene.triangles.len() as f64 * TRIANGLE_BYTES + fragments * SIMPLIFIED_FRAGMENT + patches * SIMPLIFIED_PATCH;
    Outlook::new(&sizes).after(simplified + DIRECT_BYTES)
}

/// Refuses to cut `scene` by `grid` into so many fragments that they alone exceed `limit`: a bake that comes closer
/// is weighed when its patches are known.
///
/// # Errors
/// [`Error::Option`] with the numbers and the remedy.
pub(crate) fn check_limit(scene: &Scene, options: &BakeOptions, grid: &Grid, limit: Limit) -> Result<()> {
    let pieces = Pieces::new(scene);
    let count = pieces.at(grid.voxel_size);
    let least = memory_bytes() as f64 + count * SIMPLIFIED_FRAGMENT;
    if least <= limit.bytes as f64 {
        return Ok(());
    }
    let most = |count: f64| outlook(scene, options, count, SIDES * count).most(limit.pixels, true) as f64;
    let remedy = pieces.coarser(grid.voxel_size, |count| most(count) <= SUGGESTED * limit.bytes as f64);
    let remedy = remedy.map_or(String::new(), |remedy| format!("{remedy}, or "));
    Err(Error::Option(format!(
        "the bake would take {:.0} MB of memory at least, for about {count:.2e} pieces of surface with voxel size {:.3e}, and \
         --memory-limit allows {:.0} MB; {remedy}allow more",
        least * 1e-6,
        grid.voxel_size * scene.frame.scale,
        limit.bytes as f64 * 1e-6
    )))
}

/// Rays take longer the deeper the tree; fragments pay for clipping, vertices, shadow and visibility rays.
fn seconds(scene: &Scene, fragments: usize, rays: u64) -> f64 {
    let threads = rayon::current_num_threads() as f64;
    let depth = (scene.triangles.len().max(2) as f64).log2();
    let ray = 40e-9 + 12e-9 * depth;
    (rays as f64 * ray + fragments as f64 * (5e-6 + 64.0 * ray)) / threads
}
