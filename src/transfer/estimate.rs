//! Casting the rays: which patches are reached by light, and what each of them sees.

use std::sync::{
    Mutex,
    atomic::{AtomicBool, Ordering},
};

use rayon::prelude::*;

use super::{
    Emitter, FormFactors, PointSets,
    matrix::{Block, Row},
    tally::Tally,
};
use crate::{
    progress::Progress,
    sampling,
    simplify::{NO_PATCH, Simplified, hit_map::NOTHING},
    trace::{Hit, RayBatch, RayTracer},
};

/// Form factors and what was learnt on the way.
pub struct Estimate {
    /// The matrix.
    pub form_factors: FormFactors,
    /// Whether light reaches each patch.
    pub reached: Vec<bool>,
    /// Whether any ray of the patch started outside of objects.
    pub visible: Vec<bool>,
    /// Whether an unreached patch sees out of the scene, as far as its probe tells.
    pub outside: Vec<bool>,
    /// Whether the row of a patch has fewer rays, because it matters less.
    pub few: Vec<bool>,
    /// Rays that were cast, probes among them.
    pub rays: u64,
    /// Rays of patches that nothing lies before: they were not cast.
    pub clear: u64,
}

/// Which rows are cast, and with how many rays.
#[derive(Clone, Copy, Default)]
pub struct Plan<'a> {
    /// Patches that rows start from: those that light starts from; with `backwards`, those whose light is wanted.
    pub start: &'a [bool],
    /// Whether every row is cast, and kept.
    pub all: bool,
    /// Patches that no surface lies before: their rays leave the scene, so none is cast. Empty: none are known.
    pub outer: &'a [bool],
    /// Whether rows follow what matters to `start` instead of what light reaches. Patches that no row of `start` sees
    /// much of get fewer rays.
    pub backwards: bool,
    /// Patches whose rows matter only if they are in `start`. Empty: none.
    pub black: &'a [bool],
}

/// Rays of a probe that looks for light from a patch that nothing else found.
const PROBE: usize = 64;
/// Independent rows that confirm a single ray.
const CONFIRM: u64 = 4;
/// Number of the set of rays that tells how noisy a row is.
const AGAIN: u64 = CONFIRM + 1;
/// A row of little importance has this many times fewer rays, but no fewer than [`LEAST`].
const FEWER: u32 = 8;
const LEAST: u32 = 16;
/// A patch is of little importance if none of the wanted ones sends it more than a 64th of its rays.
const SEEN_LITTLE: u32 = 64;
/// Patches of a unit of parallel work.
const CHUNK: usize = 64;

/// Estimates the rows of all patches that light can reach.
///
/// Light starts at the patches in `lit`. What their rays meet may be lit too, and so on to closure: rows are cast in
/// waves, so finding out what is reached costs hardly a ray. A patch is reached if its own row meets a reached patch,
/// for else its irradiance is zero in any case; a single such ray is confirmed by others, because where surfaces
/// touch, rounding puts about one hit in a million on the wrong side. At last each patch that was not met looks for
/// light itself with 64 probe rays, since a small patch may be missed from afar; until nothing new turns up. With
/// `all`, every row is cast.
///
/// F_ij = hits_j / valid rays; Sobol-Owen points (see [`PointSets`]), `rays` a patch, a power of two. Rays that meet
/// the back of a one-sided surface started hidden and are dropped; unless they started in the open, beside the back of
/// a sheet, which lets no light out.
///
/// # Accuracy
/// The standard error of F_ij is at most sqrt(F (1 - F) / rays). Same seed, same bits, on any number of threads.
pub fn estimate(
    simplified: &Simplified,
    tracer: &dyn RayTracer,
    lit: &[bool],
    all: bool,
    rays: u32,
    seed: u64,
    progress: &dyn Progress,
) -> Estimate {
    estimate_plan(simplified, tracer, &Plan { start: lit, all, ..Plan::default() }, rays, seed, progress)
}

/// As [`estimate`], of the rows that `plan` asks for.
pub fn estimate_plan(
    simplified: &Simplified,
    tracer: &dyn RayTracer,
    plan: &Plan,
    rays: u32,
    seed: u64,
    progress: &dyn Progress,
) -> Estimate {
    let n = simplified.patches.len();
    let of = |marks: &[bool], i: u32| marks.get(i as usize).is_some_and(|&m| m);
    let caster = Caster::new(simplified, tracer, plan.outer, rays, seed);
    let mut reached = plan.start.to_vec();
    let mut has_row = reached.clone();
    // Several threads set marks, which is the same in any order.
    let seen: Vec<AtomicBool> = (0..n).map(|_| AtomicBool::new(false)).collect();
    let (mut visible, mut outside) = (vec![true; n], vec![false; n]);
    let mut few = vec![false; n];
    let mut first = true;
    let mut clear = 0;
    let mut blocks: Vec<Block> = Vec::new();
    let mut wave: Vec<u32> = (0..n as u32).filter(|&i| reached[i as usize]).collect();
    let mut pending: Vec<Pending> = Vec::new();
    let mut cast = 0;
    progress.begin("form factors", n as u64);
    loop {
        while !wave.is_empty() {
            // What reached patches see gets a row next; where all have one, nobody asks.
            let asked = has_row.contains(&false).then_some(&seen[..]);
            let sees = |i: u32| plan.backwards || reached[i as usize];
            let new = caster.rows(&wave, &few, asked.map(|marks| Seen { by: &sees, marks }), progress);
            let (outer, open): (Vec<u32>, Vec<u32>) = wave.iter().partition(|&&i| caster.is_outer(i));
            clear += outer.len() as u64 * rays as u64;
            cast += open.iter().map(|&i| caster.sets(i, &few).len as u64).sum::<u64>();
            if plan.backwards && std::mem::take(&mut first) {
                few = little_seen(n, &new, &has_row, rays);
            }
            for block in new {
                for (k, row) in block.rows.iter().enumerate() {
                    reached[row.patch as usize] |= plan.backwards;
                    if !reached[row.patch as usize] {
                        pending.push(Pending { patch: row.patch, block: blocks.len(), row: k, refused: 0 });
                    }
                }
                blocks.push(block);
            }
            loop {
                let (accepted, confirming) = caster.accept(&mut pending, &blocks, &reached);
                cast += confirming;
                for p in &accepted {
                    reached[p.patch as usize] = true;
                    blocks[p.block].entries(p.row).for_each(|(j, _)| seen[j as usize].store(true, Ordering::Relaxed));
                }
                if accepted.is_empty() {
                    break;
                }
            }
            wave.clear();
            for (i, seen) in (0..).zip(&seen) {
                let new = seen.load(Ordering::Relaxed) && !std::mem::replace(&mut has_row[i as usize], true);
                if new && !of(plan.black, i) {
                    wave.push(i);
                }
            }
        }
        if plan.backwards {
            // What no row met adds nothing to any of them.
            (0..n).filter(|&i| !reached[i]).for_each(|i| visible[i] = false);
            break;
        }
        let unknown: Vec<u32> = (0..n as u32).filter(|&i| !has_row[i as usize]).collect();
        if plan.all {
            // Whole rows look for light.
            has_row.fill(true);
            wave = unknown;
            if wave.is_empty() {
                break;
            }
            continue;
        }
        let outer = unknown.iter().filter(|&&i| caster.is_outer(i)).count() as u64;
        clear += outer * caster.probes.len as u64;
        cast += (unknown.len() as u64 - outer) * caster.probes.len as u64;
        let probes = caster.probe(&unknown, &reached);
        for (p, &i) in probes.iter().zip(&unknown) {
            (visible[i as usize], outside[i as usize]) = (*p != Probe::Hidden, *p == Probe::Outside);
        }
        wave = unknown.iter().zip(&probes).filter(|(_, p)| **p == Probe::SeesLight).map(|(i, _)| *i).collect();
        if wave.is_empty() {
            break;
        }
        wave.iter().for_each(|&i| has_row[i as usize] = true);
    }
    progress.end();
    for row in blocks.iter().flat_map(|b| &b.rows) {
        visible[row.patch as usize] = row.valid > 0;
    }
    let wanted = if plan.all { &has_row } else { &reached };
    let form_factors = FormFactors::of_blocks(n, blocks, wanted, &reached);
    Estimate { form_factors, reached, visible, outside, few, rays: cast, clear }
}

/// Which patches none of `rows` sees much of; those with a row already are not among them.
fn little_seen(patches: usize, rows: &[Block], has_row: &[bool], rays: u32) -> Vec<bool> {
    let mut most = vec![0; patches];
    for block in rows {
        for (j, count) in (0..block.rows.len()).flat_map(|row| block.entries(row)) {
            most[j as usize] = count.max(most[j as usize]);
        }
    }
    most.iter().zip(has_row).map(|(&count, has_row)| !has_row && count * SEEN_LITTLE <= rays).collect()
}

/// What `patches` receive if their rows are cast again with other, independent rays: the sum of what is `sent` over the
/// hits, counted as [`estimate`] counts them (`closed`: see [`FormFactors::is_closed`]).
pub fn receive_again(
    simplified: &Simplified,
    tracer: &dyn RayTracer,
    patches: &[u32],
    sent: &[f32],
    closed: bool,
    rays: u32,
    seed: u64,
) -> Vec<f64> {
    let caster = Caster::new(simplified, tracer, &[], rays, seed);
    patches
        .par_chunks(CHUNK)
        .flat_map_iter(|chunk| {
            let mut s = caster.take();
            let mut block = Block::default();
            for &i in chunk {
                caster.cast(i, &caster.rows, AGAIN, &mut s);
                caster.count(i, &mut s, &mut block);
            }
            caster.give_back(s);
            let received = |k: usize| {
                let sum: f64 = block.entries(k).map(|(j, count)| count as f64 * sent[j as usize] as f64).sum();
                let row = &block.rows[k];
                sum / (row.valid - if closed { row.escaped } else { 0 }).max(1) as f64
            };
            (0..chunk.len()).map(received).collect::<Vec<f64>>()
        })
        .collect()
}

/// What rows met.
struct Seen<'a> {
    /// Whether what a row meets is asked for.
    by: &'a (dyn Fn(u32) -> bool + Sync),
    marks: &'a [AtomicBool],
}

/// A patch whose row is cast, but that is not known to be reached.
struct Pending {
    patch: u32,
    block: usize,
    row: usize,
    /// Rays onto reached patches at which it was last refused.
    refused: u32,
}

/// What a probe found.
#[derive(Clone, Copy, PartialEq)]
enum Probe {
    /// All rays started inside or behind objects.
    Hidden,
    /// No ray met a patch that light reaches, and none left the scene.
    Dark,
    /// No ray met a patch that light reaches, and some left the scene.
    Outside,
    /// A ray met a patch that light reaches.
    SeesLight,
}

struct Caster<'a> {
    simplified: &'a Simplified,
    tracer: &'a dyn RayTracer,
    rows: PointSets,
    fewer: PointSets,
    probes: PointSets,
    /// Patches that nothing lies before.
    outer: &'a [bool],
    seed: u64,
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
    /// Rays that look again from where others met backs, and their hits.
    turned: RayBatch,
    found: Vec<Hit>,
}

impl<'a> Caster<'a> {
    fn new(
        simplified: &'a Simplified,
        tracer: &'a dyn RayTracer,
        outer: &'a [bool],
        rays: u32,
        seed: u64,
    ) -> Caster<'a> {
        Caster {
            simplified,
            tracer,
            rows: PointSets::new(rays as usize, seed),
            fewer: PointSets::new(rays.div_ceil(FEWER).max(LEAST) as usize, seed),
            probes: PointSets::new(PROBE.min(rays as usize), seed ^ 0x70),
            outer,
            seed,
            scratch: Mutex::default(),
        }
    }

    fn is_outer(&self, patch: u32) -> bool {
        self.outer.get(patch as usize).is_some_and(|&outer| outer)
    }

    /// The points of the row of a patch.
    fn sets(&self, patch: u32, few: &[bool]) -> &PointSets {
        if few[patch as usize] { &self.fewer } else { &self.rows }
    }

    /// The rows of `patches`.
    fn rows(&self, patches: &[u32], few: &[bool], seen: Option<Seen>, progress: &dyn Progress) -> Vec<Block> {
        patches
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut s = self.take();
                let mut block = Block::default();
                for &i in chunk {
                    if self.is_outer(i) {
                        let all = self.rows.len as u32;
                        block.push(&[], Row { patch: i, valid: all, escaped: all, hidden: 0, end: 0 });
                        continue;
                    }
                    self.cast(i, self.sets(i, few), 0, &mut s);
                    self.count(i, &mut s, &mut block);
                    if let Some(Seen { marks, .. }) = seen.as_ref().filter(|seen| (seen.by)(i)) {
                        s.entries.iter().for_each(|e| marks[e.0 as usize].store(true, Ordering::Relaxed));
                    }
                }
                self.give_back(s);
                progress.advance(chunk.len() as u64);
                block.bytes.shrink_to_fit();
                block
            })
            .collect()
    }

    /// Takes from `pending` the patches that see a reached one; and the rays that it took to be sure.
    fn accept(&self, pending: &mut Vec<Pending>, blocks: &[Block], reached: &[bool]) -> (Vec<Pending>, u64) {
        let judged: Vec<(u32, bool, u64)> = pending
            .par_chunks(CHUNK)
            .flat_map_iter(|chunk| {
                let mut s = self.take();
                let judge = |p: &Pending| {
                    let entries = blocks[p.block].entries(p.row);
                    let rays = entries.filter(|e| reached[e.0 as usize]).map(|e| e.1).sum::<u32>();
                    if rays != 1 || p.refused == 1 {
                        return (rays, rays > 1, 0);
                    }
                    let confirmed = (1..=CONFIRM).any(|k| {
                        self.cast(p.patch, &self.rows, k, &mut s);
                        s.hits.iter().any(|h| h.is_hit() && self.patch(h).is_some_and(|j| reached[j as usize]))
                    });
                    (rays, confirmed, CONFIRM * self.rows.len as u64)
                };
                let judged: Vec<_> = chunk.iter().map(judge).collect();
                self.give_back(s);
                judged
            })
            .collect();
        let mut accepted = Vec::new();
        let mut rest = Vec::new();
        for (mut p, (rays, yes, _)) in std::mem::take(pending).into_iter().zip(&judged) {
            p.refused = *rays;
            if *yes { accepted.push(p) } else { rest.push(p) }
        }
        *pending = rest;
        (accepted, judged.iter().map(|j| j.2).sum())
    }

    /// Looks for light from every patch of `patches`.
    fn probe(&self, patches: &[u32], reached: &[bool]) -> Vec<Probe> {
        patches
            .par_chunks(CHUNK)
            .flat_map_iter(|chunk| {
                let mut s = self.take();
                let found: Vec<Probe> = chunk
                    .iter()
                    .map(|&i| {
                        if self.is_outer(i) {
                            return Probe::Outside;
                        }
                        self.cast(i, &self.probes, 0, &mut s);
                        let mut found = Probe::Hidden;
                        for hit in &s.hits {
                            match hit.is_hit().then(|| self.patch(hit)) {
                                Some(Some(j)) if reached[j as usize] => return Probe::SeesLight,
                                Some(None) => (),
                                None => found = Probe::Outside,
                                _ if found == Probe::Hidden => found = Probe::Dark,
                                _ => (),
                            }
                        }
                        found
                    })
                    .collect();
                self.give_back(s);
                found
            })
            .collect()
    }

    /// Casts the rays of patch `i`; `again` is 0 for its row, else the number of another, independent set.
    fn cast(&self, i: u32, sets: &PointSets, again: u64, s: &mut Scratch) {
        row_rays(self.simplified, sets, i, self.seed, again, &mut s.emitter, &mut s.rays);
        s.hits.resize(s.rays.len(), Hit::NONE);
        self.tracer.closest_hits(&s.rays, &mut s.hits);
    }

    /// The patch of a hit; `None` on the back of a one-sided surface.
    #[inline]
    fn patch(&self, hit: &Hit) -> Option<u32> {
        let patch = self.simplified.hit_map.patch(&self.simplified.fragments, hit);
        (patch != NO_PATCH).then_some(patch)
    }

    /// Counts the hits of patch `i` into a new row of `block`, and leaves them in `s.entries`.
    fn count(&self, i: u32, s: &mut Scratch, block: &mut Block) {
        let n = self.simplified.patches.len() as u32;
        let Scratch { hits, cells, patches, .. } = s;
        self.simplified.hit_map.patches(&self.simplified.fragments, hits, cells, patches);
        let backs = patches.iter().filter(|&&j| j == NO_PATCH).count();
        if backs > 0 && backs < patches.len() {
            self.acquit(i, s);
        }
        let Scratch { hits, patches, tally, entries, .. } = s;
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
        block.push(entries, Row { patch: i, valid: hits.len() as u32 - hidden, escaped, hidden, end: 0 });
    }

    /// Lets those rays of patch `i` escape that met backs, but started in the open, beside a sheet: two of their three
    /// quarter turns about the patch's normal meet no back. Inside and behind solids nearly all do.
    fn acquit(&self, i: u32, s: &mut Scratch) {
        let Scratch { rays, patches, turned, found, .. } = s;
        let normal = self.simplified.patches.normal[i as usize];
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
        self.tracer.closest_hits(turned, found);
        let free = |h: &&Hit| !h.is_hit() || self.patch(h).is_some_and(|j| j != i);
        for (patch, turns) in patches.iter_mut().filter(|j| **j == NO_PATCH).zip(found.chunks_exact(3)) {
            if turns.iter().filter(free).count() >= 2 {
                *patch = NOTHING;
            }
        }
    }

    fn take(&self) -> Scratch {
        let kept = self.scratch.lock().expect("no thread panics with the lock").pop();
        kept.unwrap_or_else(|| Scratch { tally: Tally::new(self.simplified.patches.len() + 3), ..Scratch::default() })
    }

    fn give_back(&self, s: Scratch) {
        self.scratch.lock().expect("no thread panics with the lock").push(s);
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

/// Purpose word of the rows' random bits.
const ROW: u64 = 0x0072_6f77;
