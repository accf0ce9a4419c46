//! Shadow rays of receivers, and what their answers add up to.

use glam::Vec3;

use super::{
    Spared,
    aim::{Aim, origin},
    known::Census,
};
use crate::{
    scene::{RAY_OFFSET, SurfacePoint},
    trace::{RayBatch, RayTracer},
};

/// Rays of one receiver that are summed up together.
struct Group {
    receiver: u32,
    /// One past its last ray.
    end: u32,
    sum: Sum,
}

/// How the rays of a group are summed up.
pub(super) enum Sum {
    /// Irradiance without occluders times the weighted share of the rays that arrive, from one lamp.
    Share(Vec3, u32),
    /// No ray was cast: this arrives, from one lamp or from many.
    Known(Vec3, Option<u32>),
    /// Every ray that arrives adds its own colour.
    Colours,
}

/// Rays of some receivers, in groups.
#[derive(Default)]
pub(super) struct Answers {
    rays: RayBatch,
    weights: Vec<f32>,
    /// Of the rays of `Sum::Colours`; of others unused.
    colours: Vec<Vec3>,
    occluded: Vec<bool>,
    groups: Vec<Group>,
    receivers: u32,
    /// Whether all rays of the receiver arrive, so that none is cast.
    free: bool,
    /// Rays that were left out.
    pub spared: Spared,
}

impl Answers {
    /// Goes on to the next receiver.
    pub fn next(&mut self) {
        self.receivers += 1;
    }

    /// Tells whether all rays of the receiver that are pushed from now on arrive, so that none need be cast.
    pub fn set_free(&mut self, free: bool) {
        self.free = free;
    }

    /// Adds a ray from `x`.
    pub fn push(&mut self, x: &SurfacePoint, aim: &Aim, weight: f32, colour: Vec3) {
        // What lies nearer than the offset is the surface itself, or one that meets it here.
        let t_min = RAY_OFFSET * aim.direction.length_recip();
        self.rays.push(origin(x), aim.direction, t_min, aim.t_max);
        self.weights.push(weight);
        self.colours.push(colour);
    }

    /// Ends a group: the rays since the last one.
    pub fn close(&mut self, sum: Sum) {
        let (begin, end) = (self.groups.last().map_or(0, |g| g.end), self.rays.len() as u32);
        if begin == end {
            return;
        }
        let receiver = self.receivers - 1;
        if !self.free {
            self.groups.push(Group { receiver, end, sum });
            return;
        }
        // The same sums as of rays that all arrive.
        let own = begin as usize..end as usize;
        let known = match sum {
            Sum::Share(unshadowed, lamp) if self.weights[own.clone()].iter().any(|&w| w > 0.0) => {
                Sum::Known(unshadowed, Some(lamp))
            }
            Sum::Share(_, lamp) => Sum::Known(Vec3::ZERO, Some(lamp)),
            Sum::Known(..) => sum,
            Sum::Colours => Sum::Known(self.colours[own].iter().sum(), None),
        };
        self.spared.clear += (end - begin) as u64;
        self.rays.resize(begin as usize);
        self.weights.truncate(begin as usize);
        self.colours.truncate(begin as usize);
        self.groups.push(Group { receiver, end: begin, sum: known });
    }

    /// Traces the rays, adds up in order what arrives, and returns the number of rays; none is left.
    pub fn sum_up(&mut self, tracer: &dyn RayTracer, census: Option<&Census>, out: &mut [Vec3]) -> (u64, Spared) {
        let s = self;
        s.occluded.clear();
        s.occluded.resize(s.rays.len(), false);
        tracer.occluded(&s.rays, &mut s.occluded);
        let mut begin = 0;
        for group in &s.groups {
            let range = begin..group.end as usize;
            begin = range.end;
            let arrived = match group.sum {
                Sum::Share(unshadowed, lamp) => {
                    let (mut arrived, mut all) = (0.0_f64, 0.0_f64);
                    let cast = range.len() as u64;
                    for k in range {
                        let weight = s.weights[k] as f64;
                        all += weight;
                        arrived += if s.occluded[k] { 0.0 } else { weight };
                    }
                    if let Some(census) = census {
                        census.enter(lamp, cast, arrived > 0.0);
                    }
                    if all > 0.0 { unshadowed * (arrived / all) as f32 } else { Vec3::ZERO }
                }
                Sum::Known(arrives, lamp) => {
                    if let (Some(census), Some(lamp)) = (census, lamp) {
                        census.enter(lamp, 0, arrives != Vec3::ZERO);
                    }
                    arrives
                }
                Sum::Colours => range.filter(|&k| !s.occluded[k]).map(|k| s.colours[k]).sum(),
            };
            let sum = &mut out[group.receiver as usize];
            *sum = (*sum + arrived).min(Vec3::MAX);
        }
        let done = (s.rays.len() as u64, s.spared);
        s.clear();
        done
    }

    fn clear(&mut self) {
        self.rays.clear();
        self.weights.clear();
        self.colours.clear();
        self.groups.clear();
        self.receivers = 0;
        self.spared = Spared::default();
    }
}
