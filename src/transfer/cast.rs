//! Casting rows: whose, how, and what for.

use std::time::Instant;

use rayon::prelude::*;

use super::{BlockWriter, Row, RowKeeper, RowPoints, Rows, caster::Caster};
use crate::{
    Result,
    progress::{self, Progress},
    simplify::Simplified,
    trace::RayTracer,
};

/// What rows are cast from, against and with.
#[derive(Clone, Copy)]
pub struct Casting<'a> {
    /// The patches.
    pub simplified: &'a Simplified,
    /// Tracer of the geometry that they are patches of.
    pub tracer: &'a dyn RayTracer,
    /// Patches that no surface lies before: their rays leave the scene, so none is cast. Empty: none are known.
    pub outer: &'a [bool],
    /// Where rays start and go, and how many there are.
    pub points: &'a RowPoints,
    /// 0 for the rows that count; else the number of another, independent set of them.
    pub again: u64,
    /// Whether rows get marks of what their leading rays met, so that they serve for other lights.
    pub marked: bool,
}

impl<'a> Casting<'a> {
    /// The rows that count, without marks.
    pub fn new(
        simplified: &'a Simplified,
        tracer: &'a dyn RayTracer,
        outer: &'a [bool],
        points: &'a RowPoints,
    ) -> Casting<'a> {
        Casting { simplified, tracer, outer, points, again: 0, marked: false }
    }
}

/// Casts those rows of `patches` that `rows` does not have; those that are `few` have fewer rays (empty: none are). How
/// many rays that took.
///
/// # Errors
/// Those of `keeper`, and [`Error::Interrupted`](crate::Error::Interrupted); what was cast until then is in `rows`.
pub fn cast(
    casting: &Casting,
    patches: &[u32],
    few: &[bool],
    rows: &mut Rows,
    keeper: &mut dyn RowKeeper,
    progress: &dyn Progress,
) -> Result<u64> {
    if patches.is_empty() {
        return Ok(0);
    }
    let caster = Caster::new(casting);
    let mut cast = 0;
    progress.begin("form factors", patches.len() as u64);
    for slice in caster.slices(patches) {
        progress::go_on(progress, "form factors")?;
        cast += caster.add(slice, few, None, rows, keeper)?;
        progress.advance(slice.len() as u64);
    }
    progress.end();
    Ok(cast)
}

/// Which patches the rows of `casting` will show to be [visible](Rows::visible), before they are cast. It takes one ray of most
/// patches. Where surfaces coincide, which of them a ray meets depends on the rays beside it, so that this may, very seldom,
/// differ from what the rows tell.
pub fn foresee_visible(casting: &Casting) -> Vec<bool> {
    let caster = Caster::new(casting);
    let all: Vec<u32> = (0..casting.simplified.patches.len() as u32).collect();
    let chunks = all.par_chunks(GLANCED).map(|chunk| {
        let mut s = caster.take();
        let visible: Vec<bool> = chunk.iter().map(|&i| caster.is_visible(i, &mut s)).collect();
        caster.give_back(s);
        visible
    });
    chunks.flatten_iter().collect()
}

/// Patches of a unit of parallel work where few rays are cast of each.
const GLANCED: usize = 4096;

/// Seconds that the rows of `patches` take, cast one after the other on this thread: to foresee how long others will.
pub fn seconds_of_rows(casting: &Casting, patches: &[u32]) -> Vec<f64> {
    let caster = Caster::new(casting);
    let mut s = caster.take();
    let mut writer = BlockWriter::default();
    let seconds = |&i: &u32| {
        let begun = Instant::now();
        caster.row(i, &[], &mut s, &mut writer);
        begun.elapsed().as_secs_f64()
    };
    patches.iter().map(seconds).collect()
}

/// What `patches` receive by the rows of `casting`: the sum of what is `sent` over the hits (`closed`: see
/// [`FormFactors::is_closed`](super::FormFactors::is_closed)). Rows that `rows` does not have are cast.
pub fn receive(casting: &Casting, patches: &[u32], sent: &[f32], closed: bool, rows: &Rows) -> Vec<f64> {
    let caster = Caster::new(casting);
    let received = |row: &Row, entries: &mut dyn Iterator<Item = (u32, u32)>| {
        let sum: f64 = entries.map(|(j, count)| count as f64 * sent[j as usize] as f64).sum();
        sum / (row.valid - if closed { row.escaped } else { 0 }).max(1) as f64
    };
    let chunks = patches.par_chunks(caster.chunk()).with_max_len(1).map(|chunk| {
        let mut s = caster.take();
        let of = |&i: &u32| match rows.with_rays(i, casting.points.rays() as usize) {
            Some(known) => received(known.row, &mut known.entries()),
            None => {
                let row = caster.count(i, casting.points.rows(), &mut s);
                received(&row, &mut s.entries.iter().copied())
            }
        };
        let all: Vec<f64> = chunk.iter().map(of).collect();
        caster.give_back(s);
        all
    });
    chunks.flatten_iter().collect()
}

/// A row of little importance has this many times fewer rays, but no fewer than [`LEAST`].
const FEWER: u32 = 8;
const LEAST: u32 = 16;
/// Rays of a row, of so many usually, and of few if it is of little importance.
pub fn row_length(rays: u32, few: bool) -> u32 {
    if few { rays.div_ceil(FEWER).max(LEAST) } else { rays }
}
