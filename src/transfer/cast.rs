//! Casting rows: the rays of a patch, and what they meet.

use std::{
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::Instant,
};

use rayon::prelude::*;

use super::{
    Emitter, PointSets,
    points::LEADING,
    rows::{Block, BlockWriter, Row, RowKeeper, Rows, View},
    tally::Tally,
};
use crate::{
    BakeOptions, Result,
    progress::{self, Progress},
    sampling,
    simplify::{NO_PATCH, Simplified, hit_map::NOTHING},
    trace::{Hit, RayBatch, RayTracer},
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
    /// Rays a row; a power of two.
    pub rays: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// 0 for the rows that count; else the number of another, independent set of them.
    pub again: u64,
    /// Whether rows get marks of what their leading rays met, so that they serve for other lights.
    pub marked: bool,
}

impl<'a> Casting<'a> {
    /// The rows that count of a bake with `options`, without marks.
    pub fn new(
        simplified: &'a Simplified,
        tracer: &'a dyn RayTracer,
        outer: &'a [bool],
        options: &BakeOptions,
    ) -> Casting<'a> {
        Casting { simplified, tracer, outer, rays: options.rays, seed: options.seed, again: 0, marked: false }
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
    if patches.iter().all(|&i| rows.with_rays(i, row_length(casting.rays, is_few(few, i)) as usize).is_some()) {
        // Merging and relighting need no points.
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

/// How often [`seconds_a_ray`] casts each row.
pub const TIMED: u32 = 2;

/// Seconds a ray of the rows of `patches`, cast one after the other on this thread: to foresee how long others will take.
pub fn seconds_a_ray(casting: &Casting, patches: &[u32]) -> Vec<f64> {
    let caster = Caster::new(casting);
    let mut s = caster.take();
    let mut writer = BlockWriter::default();
    let mut seconds = |i: u32| {
        let begun = Instant::now();
        caster.row(i, &[], &mut s, &mut writer);
        begun.elapsed().as_secs_f64() / casting.rays as f64
    };
    // More than once, because the machine may do something else meanwhile.
    patches.iter().map(|&i| (0..TIMED).map(|_| seconds(i)).fold(f64::INFINITY, f64::min)).collect()
}

/// What `patches` receive by the rows of `casting`: the sum of what is `sent` over the hits (`closed`: see
/// [`FormFactors::is_closed`](super::FormFactors::is_closed)). Rows that `rows` does not have are cast.
pub fn receive(casting: &Casting, patches: &[u32], sent: &[f32], closed: bool, rows: &Rows) -> Vec<f64> {
    let caster = Caster::new(casting);
    let received = |row: &Row, entries: &mut dyn Iterator<Item = (u32, u32)>| {
        let sum: f64 = entries.map(|(j, count)| count as f64 * sent[j as usize] as f64).sum();
        sum / (row.valid - if closed { row.escaped } else { 0 }).max(1) as f64
    };
    let chunks = patches.par_chunks(CHUNK).map(|chunk| {
        let mut s = caster.take();
        let mut writer = BlockWriter::default();
        let of = |&i: &u32| match rows.with_rays(i, caster.rows.len) {
            Some(known) => received(known.row, &mut known.entries()),
            None => {
                caster.cast(i, &caster.rows, &mut s);
                let row = caster.count(i, &mut s, &mut writer);
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

/// Whether the row of a patch is one of those that are `few`.
fn is_few(few: &[bool], patch: u32) -> bool {
    few.get(patch as usize).is_some_and(|&few| few)
}

/// Patches of a unit of parallel work.
const CHUNK: usize = 64;
/// Rays that are cast before rows are kept: a tenth of a second or so on two threads.
const SLICE_RAYS: usize = 1 << 22;
/// Purpose word of the rows' random bits.
const ROW: u64 = 0x0072_6f77;

/// Who asks what rows meet.
pub(super) struct Seen<'a> {
    /// Whether what a row meets is asked for.
    pub by: &'a (dyn Fn(u32) -> bool + Sync),
    pub marks: &'a [AtomicBool],
}

/// What a probe found.
#[derive(Clone, Copy, PartialEq)]
pub(super) enum Probe {
    /// A ray met a patch that light reaches.
    SeesLight,
    /// None did.
    Dark(View),
}

pub(super) struct Caster<'a> {
    casting: Casting<'a>,
    rows: PointSets,
    fewer: PointSets,
    leading: PointSets,
    /// Working memory that is not in use.
    scratch: Mutex<Vec<Scratch>>,
}

#[derive(Default)]
struct Scratch {
    emitter: Emitter,
    rays: RayBatch,
    hits: Vec<Hit>,
    /// Cell and patch of every hit.
    cells: Vec<u32>,
    patches: Vec<u32>,
    /// Hits of every patch, of the sky and of the insides of objects.
    tally: Tally,
    entries: Vec<(u32, u32)>,
    /// The same of the leading rays.
    leading: Tally,
    leading_entries: Vec<(u32, u32)>,
    /// Rays that look again from where others met backs, and their hits.
    turned: RayBatch,
    found: Vec<Hit>,
}

impl<'a> Caster<'a> {
    pub fn new(casting: &Casting<'a>) -> Caster<'a> {
        let rows = PointSets::new(casting.rays as usize, casting.seed);
        Caster {
            casting: *casting,
            leading: rows.leading(),
            rows,
            fewer: PointSets::new(row_length(casting.rays, true) as usize, casting.seed),
            scratch: Mutex::default(),
        }
    }

    pub fn is_outer(&self, patch: u32) -> bool {
        self.casting.outer.get(patch as usize).is_some_and(|&outer| outer)
    }

    /// Rays of the row of a patch.
    pub fn rays(&self, patch: u32, few: &[bool]) -> usize {
        self.sets(patch, few).len
    }

    /// Rays of a probe.
    pub fn probe_rays(&self) -> usize {
        self.leading.len
    }

    fn sets(&self, patch: u32, few: &[bool]) -> &PointSets {
        if is_few(few, patch) { &self.fewer } else { &self.rows }
    }

    /// Patches in the portions in which they are best added.
    pub fn slices<'b>(&self, patches: &'b [u32]) -> std::slice::Chunks<'b, u32> {
        patches.chunks((SLICE_RAYS / self.rows.len).max(CHUNK))
    }

    /// Sees to it that `rows` has those of `patches`, and `seen` is told what they met; how many rays that took.
    pub fn add(
        &self,
        patches: &[u32],
        few: &[bool],
        seen: Option<Seen>,
        rows: &mut Rows,
        keeper: &mut dyn RowKeeper,
    ) -> Result<u64> {
        let is_known = |i: &u32| rows.with_rays(*i, self.rays(*i, few)).is_some();
        let (known, missing): (Vec<u32>, Vec<u32>) = patches.iter().partition(|i| is_known(i));
        let asked = |i: u32| seen.as_ref().filter(|seen| (seen.by)(i));
        known.par_iter().for_each(|&i| {
            if let (Some(Seen { marks, .. }), Some(row)) = (asked(i), rows.get(i)) {
                row.entries().for_each(|(j, _)| marks[j as usize].store(true, Ordering::Relaxed));
            }
        });
        let blocks: Vec<Block> = missing
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut s = self.take();
                let mut writer = BlockWriter::default();
                for &i in chunk {
                    self.row(i, few, &mut s, &mut writer);
                    if let Some(Seen { marks, .. }) = asked(i) {
                        s.entries.iter().for_each(|e| marks[e.0 as usize].store(true, Ordering::Relaxed));
                    }
                }
                self.give_back(s);
                writer.finish()
            })
            .collect();
        for block in blocks {
            rows.add(keeper.keep(block)?);
        }
        Ok(missing.iter().filter(|i| !self.is_outer(**i)).map(|&i| self.rays(i, few) as u64).sum())
    }

    /// Appends the row of patch `i`, and leaves its entries in `s.entries`.
    fn row(&self, i: u32, few: &[bool], s: &mut Scratch, writer: &mut BlockWriter) {
        if self.is_outer(i) {
            let all = self.rays(i, few) as u32;
            s.entries.clear();
            writer.push(&[], Row { patch: i, valid: all, escaped: all, view: View::Outside, ..Row::default() });
            return;
        }
        self.cast(i, self.sets(i, few), s);
        let row = self.count(i, s, writer);
        if self.casting.marked {
            s.leading_entries.clear();
            if row.view != View::Hidden {
                s.leading.add(&s.patches[..LEADING.min(s.patches.len())]);
                s.leading.drain(&mut s.leading_entries);
            }
            writer.mark(&s.entries, &s.leading_entries);
        }
    }

    /// Asks the leading rays of every patch of `patches` for light; and how many were cast for that.
    pub fn probe(&self, patches: &[u32], reached: &[bool], rows: &Rows) -> Vec<(Probe, u64)> {
        let found = |view: View, sees: bool| if sees { Probe::SeesLight } else { Probe::Dark(view) };
        patches
            .par_chunks(CHUNK)
            .flat_map_iter(|chunk| {
                let mut s = self.take();
                let probe = |&i: &u32| {
                    if self.is_outer(i) {
                        return (Probe::Dark(View::Outside), 0);
                    }
                    if let Some(row) = rows.with_rays(i, self.rows.len)
                        && let Some(mut met) = row.leading()
                    {
                        return (found(row.row.view, met.any(|j| reached[j as usize])), 0);
                    }
                    self.cast(i, &self.leading, &mut s);
                    self.look_up(&mut s);
                    let sees = s.patches.iter().any(|&j| reached.get(j as usize).is_some_and(|&r| r));
                    (found(view(&s.patches), sees), self.leading.len as u64)
                };
                let found: Vec<(Probe, u64)> = chunk.iter().map(probe).collect();
                self.give_back(s);
                found
            })
            .collect()
    }

    /// Casts the rays of patch `i`.
    fn cast(&self, i: u32, sets: &PointSets, s: &mut Scratch) {
        let Casting { simplified, tracer, seed, again, .. } = self.casting;
        row_rays(simplified, sets, i, seed, again, &mut s.emitter, &mut s.rays);
        s.hits.resize(s.rays.len(), Hit::NONE);
        tracer.closest_hits(&s.rays, &mut s.hits);
    }

    /// The patch of a hit; `None` on the back of a one-sided surface.
    #[inline]
    fn patch(&self, hit: &Hit) -> Option<u32> {
        let simplified = self.casting.simplified;
        let patch = simplified.hit_map.patch(&simplified.fragments, hit);
        (patch != NO_PATCH).then_some(patch)
    }

    /// The patches of all hits.
    fn look_up(&self, s: &mut Scratch) {
        let simplified = self.casting.simplified;
        simplified.hit_map.patches(&simplified.fragments, &s.hits, &mut s.cells, &mut s.patches);
    }

    /// Counts the hits of patch `i` into a new row, and leaves them in `s.entries`.
    ///
    /// A patch whose leading rays are all hidden is hidden altogether: what the others say of a hundredth of its
    /// surface is mostly rounding.
    fn count(&self, i: u32, s: &mut Scratch, writer: &mut BlockWriter) -> Row {
        self.look_up(s);
        let all = s.hits.len() as u32;
        let backs = s.patches.iter().filter(|&&j| j == NO_PATCH).count();
        // What the leading rays say, where it matters how many were hidden.
        let view = view(&s.patches);
        if view == View::Hidden {
            s.entries.clear();
            let row = Row { patch: i, hidden: all, view, ..Row::default() };
            writer.push(&[], row);
            return row;
        }
        if backs > 0 {
            self.acquit(i, s);
        }
        let n = self.casting.simplified.patches.len() as u32;
        let Scratch { patches, tally, entries, .. } = s;
        // What is no patch comes behind the patches: n + (j - NOTHING).
        patches.iter_mut().for_each(|j| *j = (*j).min(n.wrapping_add(j.wrapping_sub(NOTHING))));
        tally.add(patches);
        tally.drain(entries);
        let (mut escaped, mut hidden) = (0, 0);
        while let Some((_, count)) = entries.pop_if(|e| e.0 >= n + (NO_PATCH - NOTHING)) {
            hidden = count;
        }
        while let Some((_, count)) = entries.pop_if(|e| e.0 >= n) {
            escaped = count;
        }
        let row = Row { patch: i, valid: all - hidden, escaped, hidden, view, ..Row::default() };
        writer.push(entries, row);
        row
    }

    /// Lets those rays of patch `i` escape that met backs, but started in the open, beside a sheet: two of their three
    /// quarter turns about the patch's normal meet no back. Inside and behind solids nearly all do.
    fn acquit(&self, i: u32, s: &mut Scratch) {
        let Scratch { rays, patches, turned, found, .. } = s;
        let normal = self.casting.simplified.patches.normal[i as usize];
        turned.clear();
        for k in (0..rays.len()).filter(|&k| patches[k] == NO_PATCH) {
            let d = rays.direction(k);
            let up = d.dot(normal) * normal;
            let (along, across) = (d - up, normal.cross(d));
            for turn in [across, -along, -across] {
                turned.push(rays.origin(k), up + turn, 0.0, f32::INFINITY);
            }
        }
        found.resize(turned.len(), Hit::NONE);
        self.casting.tracer.closest_hits(turned, found);
        let free = |h: &&Hit| !h.is_hit() || self.patch(h).is_some_and(|j| j != i);
        for (patch, turns) in patches.iter_mut().filter(|j| **j == NO_PATCH).zip(found.chunks_exact(3)) {
            if turns.iter().filter(free).count() >= 2 {
                *patch = NOTHING;
            }
        }
    }

    fn take(&self) -> Scratch {
        let kept = self.scratch.lock().expect("no thread panics with the lock").pop();
        let tally = || Tally::new(self.casting.simplified.patches.len() + 3);
        let leading = || if self.casting.marked { tally() } else { Tally::default() };
        kept.unwrap_or_else(|| Scratch { tally: tally(), leading: leading(), ..Scratch::default() })
    }

    fn give_back(&self, s: Scratch) {
        self.scratch.lock().expect("no thread panics with the lock").push(s);
    }
}

/// What the leading ones of these hits say.
fn view(patches: &[u32]) -> View {
    let leading = &patches[..LEADING.min(patches.len())];
    if leading.iter().all(|&j| j == NO_PATCH) {
        View::Hidden
    } else if leading.contains(&NOTHING) {
        View::Outside
    } else {
        View::Within
    }
}

/// The rays of row `i`; `again` is 0 for those that are counted.
pub fn row_rays(
    simplified: &Simplified,
    sets: &PointSets,
    i: u32,
    seed: u64,
    again: u64,
    emitter: &mut Emitter,
    rays: &mut RayBatch,
) {
    emitter.load(simplified, i as usize);
    let random = [0, 1].map(|k| sampling::hash(&[seed, ROW, i as u64, k + 2 * again]));
    emitter.rays(sets, random, rays);
}
