//! How large the rest of a bake will be.

use crate::{
    BakeOptions, Result, Scene,
    forecast::RAY_BYTES,
    options::PatchSource,
    outlook::{Outlook, Sizes},
    progress::{Hushed, Progress},
    sampling::hash,
    simplify::{self, NO_PATCH, Simplified},
    transfer::{self, Casting, RowKeeper, Rows, View},
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
/// Rows that light is looked for with, one after the other. Where it is reflected once at least, most are at it after one.
const CHAIN: u64 = 8;
/// Purpose word of random bits.
const CHAINS: u64 = 0x6368_6169;
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
    // Those are in a file that is mapped already.
    let known = rows.blocks().iter().map(|block| block.rows.len()).sum();
    keeper.begin(rows, &|| outlook(scene, casting, lit, known, options, progress))?;
    if keeper.spills() { Ok(()) } else { simplify::check_rows(lit.len(), options.rays, RAY_BYTES) }
}

/// What the bake will take from the rows on, if light starts at the patches `lit`: a sample of rows, evenly spaced, tells
/// of all of them; so many are `known`.
fn outlook(
    scene: &Scene,
    casting: &Casting,
    lit: &[bool],
    known: usize,
    options: &BakeOptions,
    progress: &dyn Progress,
) -> Result<Outlook> {
    let simplified = casting.simplified;
    let outer = |i: usize| casting.outer.get(i).is_some_and(|&outer| outer);
    // Taken as reached, whatever is not seen to be dark, if rows follow light.
    let wanted: Vec<u32> = (0..lit.len()).filter(|&i| lit[i] || !outer(i)).map(|i| i as u32).collect();
    let follow = (options.skip && options.only.is_empty()).then_some(lit);
    let Sample { row_bytes, dark } = sample(casting, &wanted, follow, progress)?;

    let (corners, vertices) = if options.patches == PatchSource::Surfels {
        let fragments = &simplified.fragments;
        let (corners, vertices) = mesh(scene, simplified, |patch| lit[patch] || !outer(patch));
        // Sides that are dark or hidden inside objects get none, but every piece has one side.
        let one_side: usize = (0..fragments.len()).map(|f| fragments.uv(f).len()).sum();
        let left = (corners as f64 * (1.0 - dark)).max(one_side as f64).min(corners as f64);
        (left, vertices as f64 * left / corners.max(1) as f64)
    } else {
        let corners = CORNERS * simplify::expected_fragments(scene, &simplified.grid);
        (corners, VERTICES * corners)
    };
    Ok(Outlook::new(&Sizes {
        used: used(scene, simplified),
        patches: lit.len(),
        row_bytes: row_bytes * (1.0 - known as f64 / wanted.len().max(1) as f64).max(0.0),
        corners: corners as usize,
        vertices: vertices as usize,
        estimate: options.estimate,
    }))
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

/// What the process will take if it makes the vertices of all patches, and nothing more.
pub(super) fn of_mesh(scene: &Scene, simplified: &Simplified) -> Outlook {
    let (corners, vertices) = mesh(scene, simplified, |_| true);
    Outlook::of_mesh(corners, vertices)
}

/// Bytes of scene, ray tracer, patches and their direct light.
fn used(scene: &Scene, simplified: &Simplified) -> f64 {
    let Simplified { geometry, fragments, patches, .. } = simplified;
    let corners = &scene.corners;
    let of_scene = size_of_val(&scene.positions[..])
        + size_of_val(&scene.triangles[..])
        + size_of_val(&corners.normals[..])
        + size_of_val(&corners.uvs[..])
        + size_of_val(&corners.colours[..])
        + scene.textures.iter().map(|t| size_of_val(&t.texels[..])).sum::<usize>();
    let of_geometry = size_of_val(&geometry.positions[..]) + geometry.triangles.len() * TRACED_TRIANGLE;
    let of_fragments = size_of_val(&fragments.uv[..]) + fragments.len() * FRAGMENT;
    let of_patches = size_of_val(&patches.members[..]) + patches.len() * PATCH;
    (of_scene + of_geometry + of_fragments + of_patches) as f64
}

/// What the process will take if the rows of `patches` are cast and kept, and nothing is done with them.
///
/// # Errors
/// [`Error::Interrupted`](crate::Error::Interrupted).
pub(crate) fn of_rows(casting: &Casting, patches: &[u32], progress: &dyn Progress) -> Result<Outlook> {
    Ok(Outlook::of_rows(sample(casting, patches, None, progress)?.row_bytes))
}

/// What some rows tell of all.
struct Sample {
    /// Bytes of all rows together.
    row_bytes: f64,
    /// Share of the patches that get no light: they lie hidden, or light does not reach them.
    dark: f64,
}

/// Casts some rows of `patches`. With `lit`, the patches that light starts at, a patch counts as reached if a chain of rows,
/// each of a patch that the last one met, leads from it to light.
fn sample(casting: &Casting, patches: &[u32], lit: Option<&[bool]>, progress: &dyn Progress) -> Result<Sample> {
    let count = (SAMPLE_RAYS / casting.points.rays() as usize).min(MOST_ROWS).min(patches.len());
    let sample: Vec<u32> = (0..count).map(|k| patches[k * patches.len() / count]).collect();
    let mut rows = Rows::new(casting.simplified.patches.len());
    transfer::cast(casting, &sample, &[], &mut rows, &mut (), &Hushed(progress))?;

    let mut dark = vec![false; rows.patches()];
    if let Some(lit) = lit {
        let mut met = rows.clone();
        let sees_light =
            |met: &Rows, at: u32| met.get(at).into_iter().flat_map(|row| row.entries()).any(|(j, _)| lit[j as usize]);
        // Where each chain began, and where it is.
        let mut chains: Vec<(u32, u32)> = sample.iter().map(|&i| (i, i)).filter(|&(i, _)| !lit[i as usize]).collect();
        chains.retain(|&(_, at)| !sees_light(&met, at));
        for step in 1..CHAIN {
            for (begin, at) in &mut chains {
                let entries = || met.get(*at).into_iter().flat_map(|row| row.entries());
                let pick = hash(&[CHAINS, *begin as u64, step]) % entries().count().max(1) as u64;
                *at = entries().nth(pick as usize).map_or(*at, |(j, _)| j);
            }
            let next: Vec<u32> = chains.iter().map(|&(_, at)| at).filter(|&at| met.get(at).is_none()).collect();
            transfer::cast(casting, &next, &[], &mut met, &mut (), &Hushed(progress))?;
            chains.retain(|&(_, at)| !sees_light(&met, at));
        }
        chains.iter().for_each(|&(begin, _)| dark[begin as usize] = true);
    }
    let mut bytes = 0;
    for block in rows.blocks() {
        let (mut end, mut marks_end) = (0, 0);
        for row in &block.rows {
            let own = (row.end - end) + (row.marks_end - marks_end);
            (end, marks_end) = (row.end, row.marks_end);
            let is_dark = &mut dark[row.patch as usize];
            bytes += if *is_dark { 0 } else { own as usize };
            *is_dark |= row.view == View::Hidden;
        }
    }
    let unlit = sample.iter().filter(|&&i| dark[i as usize]).count();
    let share = |n: usize| n as f64 / count.max(1) as f64;
    Ok(Sample { row_bytes: share(bytes) * patches.len() as f64, dark: share(unlit) })
}
