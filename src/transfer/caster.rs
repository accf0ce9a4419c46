//! The rays of a patch, and what they meet.

use std::{
    ops::Range,
    sync::{
        Mutex,
        atomic::{AtomicBool, Ordering},
    },
};

use rayon::prelude::*;

use super::{Block, BlockWriter, Casting, Emitter, PointSets, Row, RowKeeper, Rows, View, tally::Tally};
use crate::{
    Result, sampling,
    simplify::{NO_PATCH, Simplified, hit_map::NOTHING},
    trace::{Hit, RayBatch},
};

/// Rays and patches at most of a unit of parallel work. Threads take one at a time: left to itself, rayon divides work for
/// two threads into some six parts, and one waits for the last of the other.
const CHUNK_RAYS: usize = 1 << 14;
const CHUNK: usize = 64;
/// Rays that are cast before rows are kept: a tenth of a second or so on two threads.
const SLICE_RAYS: usize = 1 << 22;
/// Leading rays that are cast one by one to show that a patch is not hidden.
const GLANCES: usize = 4;
/// Purpose word of the rows' random bits.
const ROW: u64 = 0x0072_6f77;

/// Who asks what rows meet.
pub struct Seen<'a> {
    /// Whether what a row meets is asked for.
    pub by: &'a (dyn Fn(u32) -> bool + Sync),
    pub marks: &'a [AtomicBool],
}

/// What a probe found.
#[derive(Clone, Copy, PartialEq)]
pub enum Probe {
    /// A ray met a patch that light reaches.
    SeesLight,
    /// None did.
    Dark(View),
}

/// Casts rows, on any number of threads.
pub struct Caster<'a> {
    casting: Casting<'a>,
    /// Working memory that is not in use.
    scratch: Mutex<Vec<Scratch>>,
}

#[derive(Default)]
pub struct Scratch {
    emitter: Emitter,
    /// The rays of a probe, and the others of its row.
    parts: [Part; 2],
    /// Patches that the leading rays met, of probes and of rows that get marks.
    leading: Vec<u32>,
    tally: Tally,
    /// What the row met.
    pub entries: Vec<(u32, u32)>,
    /// The same of the leading rays.
    leading_entries: Vec<(u32, u32)>,
    /// Rays that look again from where others met backs, and their hits.
    turned: RayBatch,
    found: Vec<Hit>,
    writer: BlockWriter,
}

/// Some rays of a row.
#[derive(Default)]
struct Part {
    rays: RayBatch,
    hits: Vec<Hit>,
    /// Cell and patch of every hit.
    cells: Vec<u32>,
    patches: Vec<u32>,
    /// Whether there is a patch for each.
    all_patches: bool,
}

impl<'a> Caster<'a> {
    pub fn new(casting: &Casting<'a>) -> Caster<'a> {
        Caster { casting: *casting, scratch: Mutex::default() }
    }

    pub fn is_outer(&self, patch: u32) -> bool {
        self.casting.outer.get(patch as usize).is_some_and(|&outer| outer)
    }

    /// Rays of the row of a patch.
    pub fn rays(&self, patch: u32, few: &[bool]) -> usize {
        self.sets(patch, few).len
    }

    fn sets(&self, patch: u32, few: &[bool]) -> &'a PointSets {
        let points = self.casting.points;
        if few.get(patch as usize).is_some_and(|&few| few) { points.fewer() } else { points.rows() }
    }

    /// Patches of a unit of parallel work.
    pub fn chunk(&self) -> usize {
        (CHUNK_RAYS / self.casting.points.rays() as usize).clamp(1, CHUNK)
    }

    /// Patches in the portions in which they are best added.
    pub fn slices<'b>(&self, patches: &'b [u32]) -> std::slice::Chunks<'b, u32> {
        patches.chunks((SLICE_RAYS / self.casting.points.rays() as usize).max(CHUNK))
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
        known.par_iter().with_max_len(CHUNK).for_each(|&i| {
            if let (Some(Seen { marks, .. }), Some(row)) = (asked(i), rows.get(i)) {
                row.entries().for_each(|(j, _)| marks[j as usize].store(true, Ordering::Relaxed));
            }
        });
        let blocks: Vec<(Block, u64)> = missing
            .par_chunks(self.chunk())
            .with_max_len(1)
            .map(|chunk| {
                let mut s = self.take();
                let mut writer = std::mem::take(&mut s.writer);
                let mut rays = 0;
                for &i in chunk {
                    rays += self.row(i, few, &mut s, &mut writer);
                    if let Some(Seen { marks, .. }) = asked(i) {
                        s.entries.iter().for_each(|e| marks[e.0 as usize].store(true, Ordering::Relaxed));
                    }
                }
                let block = writer.take();
                self.give_back(Scratch { writer, ..s });
                (block, rays)
            })
            .collect();
        let mut cast = 0;
        for (block, rays) in blocks {
            rows.add(keeper.keep(block)?);
            cast += rays;
        }
        Ok(cast)
    }

    /// Appends the row of patch `i`, and leaves its entries in `s.entries`; how many rays were cast for it.
    pub fn row(&self, i: u32, few: &[bool], s: &mut Scratch, writer: &mut BlockWriter) -> u64 {
        let sets = self.sets(i, few);
        if self.is_outer(i) {
            let all = sets.len as u32;
            s.entries.clear();
            writer.push(&[], Row { patch: i, valid: all, escaped: all, view: View::Outside, ..Row::default() });
            return 0;
        }
        let row = self.count(i, sets, s);
        writer.push(&s.entries, row);
        if self.casting.marked {
            s.leading_entries.clear();
            if row.view != View::Hidden {
                s.leading.retain(|&j| j < NOTHING);
                s.tally.count([&s.leading, &[]], &mut s.leading_entries);
            }
            writer.mark(&s.entries, &s.leading_entries);
        }
        if row.view == View::Hidden { sets.probe as u64 } else { sets.len as u64 }
    }

    /// Asks the leading rays of every patch of `patches` for light; and how many were cast for that.
    pub fn probe(&self, patches: &[u32], reached: &[bool], rows: &Rows) -> Vec<(Probe, u64)> {
        let sets = self.casting.points.rows();
        let found = |view: View, sees: bool| if sees { Probe::SeesLight } else { Probe::Dark(view) };
        patches
            .par_chunks(self.chunk())
            .with_max_len(1)
            .flat_map_iter(|chunk| {
                let mut s = self.take();
                let probe = |&i: &u32| {
                    if self.is_outer(i) {
                        return (Probe::Dark(View::Outside), 0);
                    }
                    if let Some(row) = rows.with_rays(i, sets.len)
                        && let Some(mut met) = row.leading()
                    {
                        return (found(row.row.view, met.any(|j| reached[j as usize])), 0);
                    }
                    let view = self.cast(i, sets, false, &mut s);
                    let sees = s.leading.iter().any(|&j| reached.get(j as usize).is_some_and(|&r| r));
                    (found(view, sees), sets.probe as u64)
                };
                let found: Vec<(Probe, u64)> = chunk.iter().map(probe).collect();
                self.give_back(s);
                found
            })
            .collect()
    }

    /// Whether patch `i` will not be hidden in its row: nearly every patch shows it by one of a few leading rays, the others
    /// are asked for all of them.
    pub fn is_visible(&self, i: u32, s: &mut Scratch) -> bool {
        if self.is_outer(i) {
            return true;
        }
        let Casting { simplified, points, again, .. } = self.casting;
        let sets = points.rows();
        let random = random(points.seed(), i, again);
        s.emitter.load(simplified, i as usize);
        let leading = sets.leading(random[0]);
        let glance = |&k: &u16| {
            let Scratch { emitter, parts: [part, _], .. } = &mut *s;
            self.cast_part(sets, k as usize..k as usize + 1, random, emitter, part);
            part.patches[0] != NO_PATCH
        };
        leading.iter().step_by(leading.len().div_ceil(GLANCES)).any(glance)
            || self.cast(i, sets, false, s) != View::Hidden
    }

    /// Casts the leading rays of patch `i`, and the others if the `whole` row is wanted and the patch is not hidden.
    fn cast(&self, i: u32, sets: &PointSets, whole: bool, s: &mut Scratch) -> View {
        let Casting { simplified, points, again, .. } = self.casting;
        let Scratch { emitter, parts: [probe, rest], leading, .. } = s;
        emitter.load(simplified, i as usize);
        let random = random(points.seed(), i, again);
        self.cast_part(sets, 0..sets.probe, random, emitter, probe);
        let view = if probe.all_patches && whole && !self.casting.marked {
            View::Within
        } else {
            leading.clear();
            leading.extend(sets.leading(random[0]).iter().map(|&k| probe.patches[k as usize]));
            view(leading)
        };
        if whole && view != View::Hidden && sets.probe < sets.len {
            self.cast_part(sets, sets.probe..sets.len, random, emitter, rest);
        } else {
            rest.patches.clear();
        }
        view
    }

    fn cast_part(
        &self,
        sets: &PointSets,
        part: Range<usize>,
        random: [u64; 2],
        emitter: &mut Emitter,
        Part { rays, hits, cells, patches, all_patches }: &mut Part,
    ) {
        let Casting { simplified, tracer, .. } = self.casting;
        emitter.rays(sets, part, random, rays);
        hits.resize(rays.len(), Hit::NONE);
        tracer.closest_hits(rays, hits);
        *all_patches = simplified.hit_map.patches(&simplified.fragments, hits, cells, patches);
    }

    /// Casts the row of patch `i`, and leaves its entries in `s.entries`.
    ///
    /// A patch whose leading rays are all hidden is hidden altogether: what the others say of a hundredth of its
    /// surface is mostly rounding.
    pub fn count(&self, i: u32, sets: &PointSets, s: &mut Scratch) -> Row {
        let view = self.cast(i, sets, true, s);
        let all = sets.len as u32;
        s.entries.clear();
        if view == View::Hidden {
            return Row { patch: i, hidden: all, view, ..Row::default() };
        }
        let Scratch { parts, tally, entries, turned, found, .. } = s;
        for part in parts.iter_mut().filter(|part| !part.all_patches) {
            if part.patches.contains(&NO_PATCH) {
                self.acquit(i, part, turned, found);
            }
        }
        let [probe, rest] = parts;
        tally.count([&probe.patches, &rest.patches], entries);
        // What is no patch stands behind the patches.
        let hidden = entries.pop_if(|e| e.0 == NO_PATCH).map_or(0, |e| e.1);
        let escaped = entries.pop_if(|e| e.0 == NOTHING).map_or(0, |e| e.1);
        Row { patch: i, valid: all - hidden, escaped, hidden, view, ..Row::default() }
    }

    /// Lets those rays of patch `i` escape that met backs, but started in the open, beside a sheet: two of their three
    /// quarter turns about the patch's normal meet no back. Inside and behind solids nearly all do.
    fn acquit(&self, i: u32, part: &mut Part, turned: &mut RayBatch, found: &mut Vec<Hit>) {
        let Part { rays, patches, .. } = part;
        let Casting { simplified, tracer, .. } = self.casting;
        let normal = simplified.patches.normal[i as usize];
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
        tracer.closest_hits(turned, found);
        let patch = |h: &Hit| simplified.hit_map.patch(&simplified.fragments, h);
        let free = |h: &&Hit| !h.is_hit() || ![NO_PATCH, i].contains(&patch(h));
        for (patch, turns) in patches.iter_mut().filter(|j| **j == NO_PATCH).zip(found.chunks_exact(3)) {
            if turns.iter().filter(free).count() >= 2 {
                *patch = NOTHING;
            }
        }
    }

    pub fn take(&self) -> Scratch {
        let kept = self.scratch.lock().expect("no thread panics with the lock").pop();
        let tally = || Tally::new(self.casting.simplified.patches.len());
        kept.unwrap_or_else(|| Scratch { tally: tally(), ..Scratch::default() })
    }

    pub fn give_back(&self, s: Scratch) {
        self.scratch.lock().expect("no thread panics with the lock").push(s);
    }
}

/// What these hits of leading rays say.
fn view(leading: &[u32]) -> View {
    if leading.iter().all(|&j| j == NO_PATCH) {
        View::Hidden
    } else if leading.contains(&NOTHING) {
        View::Outside
    } else {
        View::Within
    }
}

/// Random bits of row `i`.
fn random(seed: u64, i: u32, again: u64) -> [u64; 2] {
    [0, 1].map(|k| sampling::hash(&[seed, ROW, i as u64, k + 2 * again]))
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
    emitter.rays(sets, 0..sets.len, random(seed, i, again), rays);
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::{
        options::{Backend, Resolution},
        progress::Silent,
        scene,
        simplify::{self, Grid},
        trace,
        transfer::{RowPoints, cast, foresee_visible},
    };

    #[test]
    fn a_probe_finds_what_the_marks_of_its_row_tell() {
        let scene = scene::load(Path::new("scenes/cornell.toml"), &Default::default()).unwrap().0;
        let grid = Grid::new(&scene, Resolution::Grid(16)).unwrap();
        let tracer = trace::build(Backend::Auto, &scene.geometry()).unwrap();
        let simplified = simplify::surfels(&scene, grid, &*tracer);
        let n = simplified.patches.len();
        let all: Vec<u32> = (0..n as u32).collect();
        // Rows shorter than a probe; those whose leading rays stand among the others, if packets are traced; and before them.
        for rays in [16, 256, 1024] {
            let points = RowPoints::new(rays, 5, &*tracer);
            let casting = Casting { marked: true, ..Casting::new(&simplified, &*tracer, &[], &points) };
            let mut rows = Rows::new(n);
            let sum = cast(&casting, &all, &[], &mut rows, &mut (), &Silent).unwrap();
            let caster = Caster::new(&casting);
            let reached: Vec<bool> = (0..n).map(|i| i % 97 == 0).collect();
            let alone = caster.probe(&all, &reached, &Rows::new(n));
            let marked = caster.probe(&all, &reached, &rows);
            assert!(alone.iter().zip(&marked).all(|(a, b)| a.0 == b.0 && b.1 == 0), "{rays} rays");
            let hidden = marked.iter().filter(|p| p.0 == Probe::Dark(View::Hidden)).count();
            let sees = marked.iter().filter(|p| p.0 == Probe::SeesLight).count();
            assert!(hidden > 0 && sees > 0 && hidden + sees < n, "{hidden} hidden, {sees} see light, of {n}");
            assert!(foresee_visible(&casting) == rows.visible(), "{rays} rays");
            // Hidden ones cast a probe.
            assert_eq!(sum, ((n - hidden) * rays as usize + hidden * points.probe_rays()) as u64);
        }
    }
}
