//! Interpolation whose neighbours are found once, for values that change.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

use super::{CHUNK, Field, nearest4, smooth};
use crate::{options::Reconstruct, scene::SurfacePoint};

/// What points take from the patches near them: the visible neighbours of each, with the factor of each in a fit.
///
/// Visibility and least squares depend on geometry alone, so that carrying new values to the points is one sum each.
#[derive(Clone, Debug, Default)]
pub struct Factors {
    /// Where the neighbours of each point begin; one more entry than points.
    start: Vec<u32>,
    patches: Vec<u32>,
    factors: Vec<f32>,
}

/// Points of a unit of parallel work when values are carried.
const RUN: usize = 1024;

impl Factors {
    /// Of `points`, by the paper's nearest four or else by least squares over the patches that a point sees. Values of
    /// the field are not looked at.
    pub fn new(field: &Field, method: Reconstruct, points: &[SurfacePoint]) -> Factors {
        let chunks: Vec<(Vec<(u32, f32)>, Vec<usize>)> = points
            .par_chunks(CHUNK)
            .map(|chunk| {
                if method != Reconstruct::Nearest4 {
                    return smooth::factors(field, chunk);
                }
                let mut all = Vec::with_capacity(4 * chunk.len());
                let mut take = |p| {
                    all.extend(nearest4::factors(field, p));
                    all.len()
                };
                let ends = chunk.iter().map(&mut take).collect();
                (all, ends)
            })
            .collect();
        let mut factors = Factors { start: vec![0], ..Factors::default() };
        for (all, ends) in chunks {
            let first = factors.patches.len();
            factors.start.extend(ends.iter().map(|end| (first + end) as u32));
            factors.patches.extend(all.iter().map(|e| e.0));
            factors.factors.extend(all.iter().map(|e| e.1));
        }
        factors
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Names patches by their places in another list: entry `j` of `places` takes the place of patch `j`.
    pub fn renamed(mut self, places: &[u32]) -> Factors {
        self.patches.iter_mut().for_each(|j| *j = places[*j as usize]);
        self
    }

    /// Carries `values` (RGB and a fourth number that is not looked at) to the points: what [`super::interpolate`] does, but
    /// for rounding (f32 here). Never negative; zero where a point is not finite or its normal is not a unit vector.
    pub fn carry(&self, values: &[Vec4], out: &mut [Vec3]) {
        let starts = self.start.par_chunks(RUN).enumerate();
        out.par_chunks_mut(RUN).zip(starts).for_each(|(out, (chunk, starts))| {
            let after = self.start.get((chunk + 1) * RUN).copied();
            let ends = starts[1..].iter().copied().chain(after);
            for ((out, &begin), end) in out.iter_mut().zip(starts).zip(ends) {
                let own = begin as usize..end as usize;
                *out = blend(&self.patches[own.clone()], &self.factors[own], values);
            }
        });
    }
}

fn blend(patches: &[u32], factors: &[f32], values: &[Vec4]) -> Vec3 {
    let (mut sum, mut low, mut high) = (Vec4::ZERO, Vec4::INFINITY, Vec4::ZERO);
    for (&j, &factor) in patches.iter().zip(factors) {
        let value = values[j as usize];
        sum += factor * value;
        low = low.min(value);
        high = high.max(value);
    }
    if patches.is_empty() { Vec3::ZERO } else { smooth::within(sum.truncate(), low.truncate(), high.truncate()) }
}
