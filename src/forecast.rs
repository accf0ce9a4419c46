//! What a bake will take, before a ray is cast.

use serde::Serialize;

use crate::{
    BakeOptions, Result, Scene,
    options::PatchSource,
    outlook::{Outlook, Sizes},
    simplify::{self, Grid},
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
const DIRECT_BYTES: f64 = 20e6;
/// Bytes a ray of a row: 0.7 entries of 2.1 bytes; five scenes have 0.25 to 0.77 entries.
pub(crate) const RAY_BYTES: f64 = 0.7 * 2.1;
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
    let row_bytes = options.rays as f64 * RAY_BYTES;
    let sizes = Sizes {
        used: 0.0,
        patches,
        row_bytes: patches as f64 * row_bytes,
        corners: (fragments as f64 * CORNERS) as usize,
        vertices: (fragments as f64 * VERTICES) as usize,
        estimate: options.estimate,
    };
    let simplified = scene.triangles.len() as f64 * TRIANGLE_BYTES
        + fragments as f64 * SIMPLIFIED_FRAGMENT
        + patches as f64 * SIMPLIFIED_PATCH;
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
        form_factor_bytes: (patches as f64 * row_bytes) as u64,
        memory_bytes: Outlook::new(&sizes).after(simplified + DIRECT_BYTES).most(PIXELS, false),
        seconds: seconds(scene, fragments, rays),
        largest_mesh,
    })
}

/// Rays take longer the deeper the tree; fragments pay for clipping, vertices, shadow and visibility rays.
fn seconds(scene: &Scene, fragments: usize, rays: u64) -> f64 {
    let threads = rayon::current_num_threads() as f64;
    let depth = (scene.triangles.len().max(2) as f64).log2();
    let ray = 40e-9 + 12e-9 * depth;
    (rays as f64 * ray + fragments as f64 * (5e-6 + 64.0 * ray)) / threads
}
