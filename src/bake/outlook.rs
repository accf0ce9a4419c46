//! How large the rest of a bake will be.

use crate::{
    BakeOptions, Result, Scene,
    forecast::RAY_BYTES,
    options::PatchSource,
    outlook::{Outlook, Sizes},
    progress::{Hushed, Progress},
    simplify::{self, NO_PATCH},
    transfer::{self, Casting, RowKeeper, Rows, View},
};

/// Rays of the sample of rows, and rows in it at most.
const SAMPLE_RAYS: usize = 1 << 21;
const MOST_ROWS: usize = 512;
/// Corners of a piece of surface, about; and vertices a corner: where pieces are not those of the split mesh.
const CORNERS: f64 = 4.0;
const VERTICES: f64 = 0.3;

/// Tells `keeper` of the rows that are to come to `rows`, for light that starts at the patches `lit`.
///
/// # Errors
/// Those of the keeper; [`Error::Option`](crate::Error::Option) for rows that fit no memory, if they stay there.
pub(super) fn begin(
    scene: &Scene,
    casting: &Casting,
    lit: &[bool],
    rows: &mut Rows,
    options: &BakeOptions,
    keeper: &mut dyn RowKeeper,
    progress: &dyn Progress,
) -> Result<()> {
    keeper.begin(rows, &|| outlook(scene, casting, lit, options, progress))?;
    if keeper.spills() { Ok(()) } else { simplify::check_rows(lit.len(), options.rays, RAY_BYTES) }
}

/// What the bake will take from the rows on, if light starts at the patches `lit`: a sample of rows, evenly spaced, tells
/// of all of them.
fn outlook(
    scene: &Scene,
    casting: &Casting,
    lit: &[bool],
    options: &BakeOptions,
    progress: &dyn Progress,
) -> Result<Outlook> {
    let simplified = casting.simplified;
    let outer = |i: usize| casting.outer.get(i).is_some_and(|&outer| outer);
    // Taken as reached, whatever is not seen to be dark.
    let wanted: Vec<u32> = (0..lit.len()).filter(|&i| lit[i] || !outer(i)).map(|i| i as u32).collect();
    let Sample { row_bytes, hidden } = sample(casting, &wanted, progress)?;

    let (corners, vertices) = if options.patches == PatchSource::Surfels {
        let fragments = &simplified.fragments;
        let seen = |f: usize, side: usize| {
            let patch = fragments.patch[f][side] as usize;
            patch != NO_PATCH as usize && (lit[patch] || !outer(patch))
        };
        let wanted = |f: usize, side: usize| seen(f, side) || (side == 0 && !seen(f, 1));
        let (corners, vertices) = simplify::foresee(scene, fragments, wanted);
        // Sides that are hidden inside objects get none, but every piece has one side.
        let one_side: usize = (0..fragments.len()).map(|f| fragments.uv(f).len()).sum();
        let left = (corners as f64 * (1.0 - hidden)).max(one_side as f64).min(corners as f64);
        (left, vertices as f64 * left / corners.max(1) as f64)
    } else {
        let corners = CORNERS * simplify::expected_fragments(scene, &simplified.grid);
        (corners, VERTICES * corners)
    };
    Ok(Outlook::new(&Sizes {
        patches: lit.len(),
        row_bytes,
        corners: corners as usize,
        vertices: vertices as usize,
        estimate: options.estimate,
    }))
}

/// What the process will take if the rows of `patches` are cast and kept, and nothing is done with them.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted).
pub(crate) fn of_rows(casting: &Casting, patches: &[u32], progress: &dyn Progress) -> Result<Outlook> {
    Ok(Outlook::of_rows(sample(casting, patches, progress)?.row_bytes))
}

/// What some rows tell of all.
struct Sample {
    /// Bytes of all rows together.
    row_bytes: f64,
    /// Share of the patches that lie hidden.
    hidden: f64,
}

fn sample(casting: &Casting, patches: &[u32], progress: &dyn Progress) -> Result<Sample> {
    let count = (SAMPLE_RAYS / casting.rays as usize).min(MOST_ROWS).min(patches.len());
    let sample: Vec<u32> = (0..count).map(|k| patches[k * patches.len() / count]).collect();
    let mut rows = Rows::new(casting.simplified.patches.len());
    transfer::cast(casting, &sample, &[], &mut rows, &mut (), &Hushed(progress))?;
    let bytes: usize = rows.blocks().iter().map(|block| block.bytes.len() + block.marks.len()).sum();
    let hidden = sample.iter().filter(|&&i| rows.get(i).is_some_and(|r| r.row.view == View::Hidden)).count();
    let share = |n: usize| n as f64 / count.max(1) as f64;
    Ok(Sample { row_bytes: share(bytes) * patches.len() as f64, hidden: share(hidden) })
}
