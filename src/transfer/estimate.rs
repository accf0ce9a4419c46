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
    /// Rays that were cast, probes among them.
    pub rays: u64,
}

/// Rays of a probe that looks for light from a patch that nothing else found.
const PROBE: usize = 64;
/// Independent rows that confirm a single ray.
const CONFIRM: u64 = 4;
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
/// the back of a one-sided surface started hidden and are dropped.
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
    let n = simplified.patches.len();
    let caster = Caster {
        simplified,
        tracer,
        rows: PointSets::new(rays as usize, seed),
        probes: PointSets::new(PROBE.min(rays as usize), seed ^ 0x70),
        seed,
        scratch: Mutex::default(),
    };
    let mut reached: Vec<bool> = lit.iter().map(|&l| l || all).collect();
    let mut has_row = reached.clone();
    // Several threads set marks, which is the same in any order.
    let seen: Vec<AtomicBool> = (0..n).map(|_| AtomicBool::new(false)).collect();
    let mut visible = vec![true; n];
    let mut blocks: Vec<Block> = Vec::new();
    let mut wave: Vec<u32> = (0..n as u32).filter(|&i| reached[i as usize]).collect();
    let mut pending: Vec<Pending> = Vec::new();
    let mut cast = 0;
    progress.begin("form factors", n as u64);
    loop {
        while !wave.is_empty() {
            // What reached patches see gets a row next; where all have one, nobody asks.
            let new = caster.rows(&wave, &reached, has_row.contains(&false).then_some(&seen[..]), progress);
            cast += wave.len() as u64 * rays as u64;
            for block in new {
                for (k, row) in block.rows.iter().enumerate() {
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
                if seen.load(Ordering::Relaxed) && !std::mem::replace(&mut has_row[i as usize], true) {
                    wave.push(i);
                }
            }
        }
        let unknown: Vec<u32> = (0..n as u32).filter(|&i| !has_row[i as usize]).collect();
        cast += unknown.len() as u64 * caster.probes.len as u64;
        let probes = caster.probe(&unknown, &reached);
        probes.iter().zip(&unknown).for_each(|(p, &i)| visible[i as usize] = *p != Probe::Hidden);
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
    let form_factors = FormFactors::of_blocks(n, blocks, &reached);
    Estimate { form_factors, reached, visible, rays: cast }
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
    /// No ray met a patch that light reaches.
    Dark,
    /// A ray met a patch that light reaches.
    SeesLight,
}

struct Caster<'a> {
    simplified: &'a Simplified,
    tracer: &'a dyn RayTracer,
    rows: PointSets,
    probes: PointSets,
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
}

impl Caster<'_> {
    /// The rows of `patches`. Those that are reached mark in `seen` what they meet.
    fn rows(
        &self,
        patches: &[u32],
        reached: &[bool],
        seen: Option<&[AtomicBool]>,
        progress: &dyn Progress,
    ) -> Vec<Block> {
        patches
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut s = self.take();
                let mut block = Block::default();
                for &i in chunk {
                    self.cast(i, &self.rows, 0, &mut s);
                    self.count(i, &mut s, seen.filter(|_| reached[i as usize]), &mut block);
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
                        self.cast(i, &self.probes, 0, &mut s);
                        let mut found = Probe::Hidden;
                        for hit in &s.hits {
                            match hit.is_hit().then(|| self.patch(hit)) {
                                Some(Some(j)) if reached[j as usize] => return Probe::SeesLight,
                                Some(None) => (),
                                _ => found = Probe::Dark,
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

    /// Counts the hits of patch `i` into a new row of `block`, and marks in `seen` which patches its rays met.
    fn count(&self, i: u32, s: &mut Scratch, seen: Option<&[AtomicBool]>, block: &mut Block) {
        let Scratch { hits, cells, patches, tally, entries, .. } = s;
        let n = self.simplified.patches.len() as u32;
        self.simplified.hit_map.patches(&self.simplified.fragments, hits, cells, patches);
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
        if let Some(seen) = seen {
            entries.iter().for_each(|e| seen[e.0 as usize].store(true, Ordering::Relaxed));
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
