//! How large the rest of a bake will be.

use super::{exchange::PATCH_POINTS, scout};
use crate::{
    BakeOptions, Result, Scene,
    forecast::{DIRECT_BYTES, RAY_BYTES},
    options::PatchSource,
    outlook::{Outlook, Sizes, Voxels},
    progress::{Hushed, Progress},
    simplify::{self, NO_PATCH, Pieces, Simplified},
    transfer::{self, Casting, Plan, RowKeeper, Rows},
};

/// Rays of the sample of rows, and rows in it at most.
const SAMPLE_RAYS: usize = 1 << 21;
const MOST_ROWS: usize = 512;
/// Bytes of a triangle and of its place in the tree of a ray tracer, about.
const TRACED_TRIANGLE: usize = 12 + 150;
/// Bytes of a piece of surface without its corners: triangle, voxel, start, patches of both sides; two cells of the hit map.
const FRAGMENT: usize = 4 + 8 + 4 + 8 + 8;
/// Bytes of a patch without its members: area, five vectors, voxel, start; place in the index; direct light and what is known
/// of it.
const PATCH: usize = 4 + 5 * 12 + 8 + 4 + 8 + 16;
/// Corners of a piece of surface, about; and vertices a corner: where pieces are not those of the split mesh.
const CORNERS: f64 = 4.0;
const VERTICES: f64 = 0.3;

/// Rows that are to be cast.
pub(super) struct Coming<'a> {
    pub scene: &'a Scene,
    pub casting: &'a Casting<'a>,
    pub plan: Plan<'a>,
    pub purpose: Purpose,
    /// Bytes that the process held before it made the patches.
    pub before: u64,
}

/// What a process casts rows for.
#[derive(Clone, Copy)]
pub(super) enum Purpose {
    /// To make light of them.
    Light,
    /// To write them down, with the replicates of so many rows. It makes no light.
    Transfer { replicates: usize },
}

impl Coming<'_> {
    /// Tells `keeper` of them; they come to `rows`.
    ///
    /// # Errors
    /// Those of the keeper; [`Error::Option`](crate::Error::Option) for rows that fit no memory, if they stay there.
    pub fn begin(
        &self,
        rows: &mut Rows,
        options: &BakeOptions,
        keeper: &mut dyn RowKeeper,
        progress: &dyn Progress,
    ) -> Result<()> {
        // Those are in a file that is mapped already.
        let known = rows.blocks().iter().map(|block| block.rows.len()).sum();
        keeper.begin(rows, &|| self.outlook(known, options, progress))?;
        if keeper.spills() { Ok(()) } else { simplify::check_rows(self.plan.start.len(), options.rays, RAY_BYTES) }
    }

    /// What the bake will take from the rows on; so many are `known`.
    fn outlook(&self, known: usize, options: &BakeOptions, progress: &dyn Progress) -> Result<Outlook> {
        let &Coming { scene, casting, plan, purpose, before } = self;
        let simplified = casting.simplified;
        let reached = scout::reached(casting, plan.start, progress)?;
        // What no light reaches has no row, or one without entries.
        let cast: Vec<u32> = (0..reached.len()).filter(|&i| plan.all || reached[i]).map(|i| i as u32).collect();
        let row_bytes = row_bytes(casting, &cast, progress)?;
        let missing = (1.0 - known as f64 / cast.len().max(1) as f64).max(0.0);
        let more = match purpose {
            Purpose::Light => 0.0,
            Purpose::Transfer { replicates } => replicates as f64 / plan.start.len() as f64,
        };
        let (corners, vertices) = if options.patches == PatchSource::Surfels {
            mesh(scene, simplified, |patch| reached[patch])
        } else {
            let corners = CORNERS * simplify::expected_fragments(scene, &simplified.grid);
            (corners as usize, (VERTICES * corners) as usize)
        };
        let sizes = Sizes {
            used: used(scene, simplified),
            patches: plan.start.len(),
            row_bytes,
            cast_bytes: row_bytes * (missing + more),
            corners,
            vertices,
            estimate: options.estimate,
        };
        let outlook = match purpose {
            Purpose::Light => Outlook::new(&sizes),
            Purpose::Transfer { .. } => Outlook::of_transfer(&sizes),
        };
        // That of the shadow rays of the patches, of which there are but so many at a time.
        let rays = plan.start.len() as f64 * options.patch_samples as f64;
        let down_to = (PATCH_POINTS as f64 / rays.max(1.0)).min(1.0);
        let alike = outlook.held.saturating_sub(before + of_patches(simplified) as u64).min(DIRECT_BYTES as u64);
        let voxels = Voxels { alike, down_to, ..voxels(scene, simplified, before) };
        Ok(Outlook { voxels: Some(voxels), ..outlook })
    }
}

fn voxels(scene: &Scene, simplified: &Simplified, without: u64) -> Voxels {
    Voxels { size: simplified.grid.voxel_size, pieces: Pieces::new(scene), without, alike: 0, down_to: 1.0 }
}

/// Corners and vertices of the split mesh of the sides whose patches are `seen`, and of the fronts of the rest.
fn mesh(scene: &Scene, simplified: &Simplified, seen: impl Fn(usize) -> bool + Sync) -> (usize, usize) {
    let fragments = &simplified.fragments;
    let seen = |f: usize, side: usize| {
        let patch = fragments.patch[f][side];
        patch != NO_PATCH && seen(patch as usize)
    };
    simplify::foresee(scene, fragments, |f, side| seen(f, side) || (side == 0 && !seen(f, 1)))
}

/// What the process will take if it makes the vertices of all patches, and nothing more; it held so much `before` it made
/// the patches.
pub(super) fn of_mesh(scene: &Scene, simplified: &Simplified, before: u64) -> Outlook {
    let (corners, vertices) = mesh(scene, simplified, |_| true);
    Outlook { voxels: Some(voxels(scene, simplified, before)), ..Outlook::of_mesh(corners, vertices) }
}

/// Bytes of scene, ray tracer, patches and their direct light.
fn used(scene: &Scene, simplified: &Simplified) -> f64 {
    let geometry = &simplified.geometry;
    let corners = &scene.corners;
    let of_scene = size_of_val(&scene.positions[..])
        + size_of_val(&scene.triangles[..])
        + size_of_val(&corners.normals[..])
        + size_of_val(&corners.uvs[..])
        + size_of_val(&corners.colours[..])
        + scene.textures.iter().map(|t| size_of_val(&t.texels[..])).sum::<usize>();
    let of_geometry = size_of_val(&geometry.positions[..]) + geometry.triangles.len() * TRACED_TRIANGLE;
    (of_scene + of_geometry) as f64 + of_patches(simplified)
}

/// Bytes of patches and their direct light.
fn of_patches(simplified: &Simplified) -> f64 {
    let Simplified { fragments, patches, .. } = simplified;
    let of_fragments = size_of_val(&fragments.uv[..]) + fragments.len() * FRAGMENT;
    let of_patches = size_of_val(&patches.members[..]) + patches.len() * PATCH;
    (of_fragments + of_patches) as f64
}

/// What the process will take if the rows of `patches` are cast and kept, and nothing is done with them.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted).
pub(crate) fn of_rows(casting: &Casting, patches: &[u32], progress: &dyn Progress) -> Result<Outlook> {
    Ok(Outlook::of_rows(row_bytes(casting, patches, progress)?))
}

/// Bytes of the rows of `patches` together, told by some of them, evenly spaced.
fn row_bytes(casting: &Casting, patches: &[u32], progress: &dyn Progress) -> Result<f64> {
    let count = (SAMPLE_RAYS / casting.points.rays() as usize).min(MOST_ROWS).min(patches.len());
    let sample: Vec<u32> = (0..count).map(|k| patches[k * patches.len() / count]).collect();
    let mut rows = Rows::new(casting.simplified.patches.len());
    transfer::cast(casting, &sample, &[], &mut rows, &mut (), &Hushed(progress))?;
    let bytes: usize = rows.blocks().iter().map(|block| block.bytes.len() + block.marks.len()).sum();
    Ok(bytes as f64 / count.max(1) as f64 * patches.len() as f64)
}
