//! Casting the rays: which patches are reached by light, and what each of them sees.

use std::sync::Mutex;

use rayon::prelude::*;

use super::{
    Emitter, FormFactors, PointSets,
    matrix::{Block, Row},
};
use crate::{
    progress::Progress,
    sampling,
    simplify::{NO_PATCH, Simplified},
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
/// Patches of a unit of parallel work.
const CHUNK: usize = 64;

/// Estimates the rows of all patches that light can reach.
///
/// Light starts at the patches in `lit`. A lit patch lights what its rays meet, and so on to closure: rows are cast
/// in waves, so finding out what is reached costs no ray. Then each patch that was not met looks for light itself
/// with 64 probe rays, since a small patch may be missed from afar; until nothing new turns up. With `all`, every
/// row is cast.
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
    let mut visible = vec![true; n];
    let mut wave: Vec<u32> = (0..n as u32).filter(|&i| reached[i as usize]).collect();
    let mut blocks: Vec<Block> = Vec::new();
    let mut cast = 0;
    progress.begin("form factors", n as u64);
    loop {
        while !wave.is_empty() {
            let new = caster.rows(&wave, progress);
            cast += wave.len() as u64 * rays as u64;
            wave = mark(new.iter().flat_map(Block::columns), &mut reached);
            blocks.extend(new);
        }
        let unknown: Vec<u32> = (0..n as u32).filter(|&i| !reached[i as usize]).collect();
        cast += unknown.len() as u64 * caster.probes.len as u64;
        let probes = caster.probe(&unknown, &reached);
        probes.iter().zip(&unknown).for_each(|(p, &i)| visible[i as usize] = *p != Probe::Hidden);
        let seeing = unknown.iter().zip(&probes).filter(|(_, p)| **p == Probe::SeesLight).map(|(i, _)| *i);
        wave = mark(seeing, &mut reached);
        if wave.is_empty() {
            break;
        }
    }
    progress.end();
    let form_factors = FormFactors::of_blocks(n, blocks);
    for i in (0..n).filter(|&i| reached[i]) {
        visible[i] = form_factors.has_row(i);
    }
    Estimate { form_factors, reached, visible, rays: cast }
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

/// Marks patches as reached; the new ones, in order.
fn mark(patches: impl Iterator<Item = u32>, reached: &mut [bool]) -> Vec<u32> {
    let mut new: Vec<u32> = patches.filter(|&j| !std::mem::replace(&mut reached[j as usize], true)).collect();
    new.sort_unstable();
    new
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
    /// Hits of every patch; zero between rows.
    counts: Vec<u32>,
    touched: Vec<u32>,
}

impl Caster<'_> {
    fn rows(&self, patches: &[u32], progress: &dyn Progress) -> Vec<Block> {
        patches
            .par_chunks(CHUNK)
            .map(|chunk| {
                let mut s = self.take();
                let mut block = Block::default();
                for &i in chunk {
                    self.cast(i, &self.rows, &mut s);
                    self.count(i, &mut s, &mut block);
                }
                self.give_back(s);
                progress.advance(chunk.len() as u64);
                block
            })
            .collect()
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
                        self.cast(i, &self.probes, &mut s);
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

    fn cast(&self, i: u32, sets: &PointSets, s: &mut Scratch) {
        s.emitter.load(self.simplified, i as usize);
        let random = [0, 1].map(|k| sampling::hash(&[self.seed, ROW, i as u64, k]));
        s.emitter.rays(sets, random, &mut s.rays);
        s.hits.resize(s.rays.len(), Hit::NONE);
        self.tracer.closest_hits(&s.rays, &mut s.hits);
    }

    /// The patch of a hit; `None` on the back of a one-sided surface.
    #[inline]
    fn patch(&self, hit: &Hit) -> Option<u32> {
        let fragment = self.simplified.hit_map.fragment(&self.simplified.fragments, hit);
        let patch = self.simplified.fragments.patch[fragment][hit.is_back() as usize];
        (patch != NO_PATCH).then_some(patch)
    }

    fn count(&self, i: u32, s: &mut Scratch, block: &mut Block) {
        let Scratch { hits, counts, touched, .. } = s;
        let (mut escaped, mut hidden) = (0, 0);
        touched.clear();
        for hit in hits.iter() {
            if !hit.is_hit() {
                escaped += 1;
            } else if let Some(j) = self.patch(hit) {
                if counts[j as usize] == 0 {
                    touched.push(j);
                }
                counts[j as usize] += 1;
            } else {
                hidden += 1;
            }
        }
        touched.sort_unstable();
        let row = Row { patch: i, valid: hits.len() as u32 - hidden, escaped, hidden, end: 0 };
        block.push(row, touched.iter().map(|&j| (j, std::mem::take(&mut counts[j as usize]))));
    }

    fn take(&self) -> Scratch {
        let kept = self.scratch.lock().expect("no thread panics with the lock").pop();
        kept.unwrap_or_else(|| Scratch { counts: vec![0; self.simplified.patches.len()], ..Scratch::default() })
    }

    fn give_back(&self, s: Scratch) {
        self.scratch.lock().expect("no thread panics with the lock").push(s);
    }
}

/// Purpose word of the rows' random bits.
const ROW: u64 = 0x726f_77;
