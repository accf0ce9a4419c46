//! Direct irradiance of receivers: who gets how many shadow rays, and what their answers add up to.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    DirectResult, LightSet,
    aim::{Aim, Sampler, origin},
    numbers::Numbers,
    sky,
    tree::{Ball, Branch},
};
use crate::{
    sampling,
    scene::RAY_OFFSET,
    scene::SurfacePoint,
    trace::{RayBatch, RayTracer},
};

/// Lamps and groups of lamps that a receiver looks at one by one; groups are sampled.
const CUT: usize = 32;

/// Rays that a lamp or group gets at least.
const LEAST: usize = 4;

/// Rays traced in one call, about.
const BATCH: usize = 4096;

/// Owen-scrambled Sobol numbers end here.
const MOST_SAMPLES: u32 = 1 << 16;

/// Direct irradiance of receivers, W/m2.
///
/// A receiver is `points_per_receiver` consecutive `points`; its irradiance is the mean over them. Sample k of
/// `samples` (at most 65536; a power of two is best) is taken at point k modulo `points_per_receiver`. For a patch give as
/// many points as samples, at the places that the first two coordinates of `sampling::sobol4(k, seed)` choose with
/// the same `seed`: the lights then use the other two, and all four are stratified together. Points are taken as
/// they are; rays start [`RAY_OFFSET`](crate::scene::RAY_OFFSET) off along the unit normal. Receivers
/// with a point that is not finite or a normal that is not a unit vector get no light.
///
/// # Accuracy
/// Exact in full view of the lights (skies: of all of a constant sky). Equal points and `seed` give equal bits, whatever
/// else is in the list and however many threads there are.
pub fn irradiance(
    lights: &LightSet,
    tracer: &dyn RayTracer,
    points: &[SurfacePoint],
    points_per_receiver: usize,
    samples: u32,
    seed: u64,
) -> DirectResult {
    let per_receiver = points_per_receiver.max(1);
    let numbers = Numbers::new(samples.clamp(1, MOST_SAMPLES), per_receiver, seed);
    let mut irradiance = vec![Vec3::ZERO; points.len() / per_receiver];
    let chunk = (BATCH / numbers.len()).clamp(1, 256);
    let rays = irradiance
        .par_chunks_mut(chunk)
        .zip(points.par_chunks(chunk * per_receiver))
        .map_init(Scratch::default, |scratch, (out, points)| {
            let mut work = Work { lights, numbers: &numbers, scratch };
            for receiver in points.chunks_exact(per_receiver) {
                work.emit(receiver);
            }
            work.finish(tracer, out)
        })
        .sum();
    DirectResult { irradiance, rays }
}

/// Rays of one receiver that are summed up together.
struct Group {
    receiver: u32,
    /// One past its last ray.
    end: u32,
    sum: Sum,
}

enum Sum {
    /// Irradiance without occluders times the weighted share of the rays that arrive.
    Share(Vec3),
    /// Every ray that arrives adds its own colour.
    Colours,
}

#[derive(Default)]
struct Scratch {
    rays: RayBatch,
    weights: Vec<f32>,
    /// Of the rays of `Sum::Colours`; of others unused.
    colours: Vec<Vec3>,
    occluded: Vec<bool>,
    groups: Vec<Group>,
    cut: Vec<Branch>,
    /// Of every lamp of the cut, then of the suns, the unshadowed irradiance by unit colour at the middle point; of every
    /// branch its importance.
    expected: Vec<f64>,
    receivers: u32,
}

struct Work<'a> {
    lights: &'a LightSet,
    numbers: &'a Numbers,
    scratch: &'a mut Scratch,
}

impl Work<'_> {
    /// Writes the shadow rays of one receiver.
    fn emit(&mut self, points: &[SurfacePoint]) {
        self.scratch.receivers += 1;
        if !points.iter().all(SurfacePoint::is_sound) {
            return;
        }
        let identity = self.numbers.identity(&points[0]);
        self.emit_lamps(points, identity);
        if self.lights.sky.is_lit() {
            self.emit_sky(points, sampling::hash(&[identity, u64::MAX]));
        }
    }

    fn emit_lamps(&mut self, points: &[SurfacePoint], identity: u64) {
        let lights = self.lights;
        let ball = if points.len() == 1 { Ball::point(&points[0]) } else { Ball::around(points) };
        let mut cut = std::mem::take(&mut self.scratch.cut);
        let mut expected = std::mem::take(&mut self.scratch.expected);
        cut.clear();
        expected.clear();
        cut.extend(lights.tree.root(&ball));
        lights.tree.refine(&mut cut, CUT, &ball);

        let middle = &points[points.len() / 2];
        let of_lamp = |lamp: u32| lights.lamps[lamp as usize].unshadowed(middle);
        expected.extend(cut.iter().map(|&b| lights.tree.lamp(b).map_or(b.importance as f64, of_lamp)));
        expected.extend(lights.suns.iter().map(|&s| of_lamp(s)));
        // What a branch expects has its lamps' colours in it already.
        let weight = |i: usize, value: f64| {
            let lamp = cut.get(i).map_or_else(|| Some(lights.suns[i - cut.len()]), |&b| lights.tree.lamp(b));
            lamp.map_or(value, |lamp| value * sky::mean(lights.lamps[lamp as usize].colour))
        };
        let total: f64 = expected.iter().enumerate().map(|(i, &value)| weight(i, value)).sum();

        for (i, &value) in expected.iter().enumerate() {
            let share = if total > 0.0 { weight(i, value) / total } else { 0.0 };
            let all = self.numbers.len();
            let n = ((share * all as f64).round() as usize).next_power_of_two().max(LEAST).min(all);
            let shift = sampling::hash(&[identity, i as u64]);
            match cut.get(i) {
                Some(&branch) => match lights.tree.lamp(branch) {
                    Some(lamp) => self.emit_lamp(lamp, value, points, n, shift),
                    None => self.emit_branch(branch, points, n, shift),
                },
                None => self.emit_lamp(lights.suns[i - cut.len()], value, points, n, shift),
            }
        }
        self.scratch.cut = cut;
        self.scratch.expected = expected;
    }

    /// `n` rays to one lamp: its exact irradiance (`at_middle` by unit colour) times the share of it that arrives.
    fn emit_lamp(&mut self, lamp: u32, at_middle: f64, points: &[SurfacePoint], n: usize, shift: u64) {
        let lamp = &self.lights.lamps[lamp as usize];
        let mut unshadowed = 0.0;
        if let [x] = points {
            unshadowed = at_middle;
            if unshadowed == 0.0 {
                return;
            }
            let n = if lamp.is_point_like() { 1 } else { n };
            let sampler = Sampler::new(lamp, x);
            for k in 0..n {
                let [u, v, _] = self.numbers.shifted(k, shift);
                if let Some(aim) = sampler.aim(x, u, v) {
                    self.scratch.push(x, &aim, aim.weight as f32, Vec3::ZERO);
                }
            }
        } else {
            let first = self.first_sample(n, shift);
            for k in first..first + n {
                let x = &points[k % points.len()];
                let here = lamp.unshadowed(x);
                if here == 0.0 {
                    continue;
                }
                unshadowed += here / n as f64;
                let [u, v, _] = self.numbers.shifted(k, shift);
                if let Some(aim) = Sampler::new(lamp, x).aim(x, u, v) {
                    self.scratch.push(x, &aim, aim.weight as f32, Vec3::ZERO);
                }
            }
        }
        // A finite light times a share of nothing must be nothing.
        self.scratch.close(Sum::Share((lamp.colour * unshadowed as f32).min(Vec3::MAX)));
    }

    /// `n` rays to lamps picked from a part of the tree.
    fn emit_branch(&mut self, branch: Branch, points: &[SurfacePoint], n: usize, shift: u64) {
        let first = if points.len() == 1 { 0 } else { self.first_sample(n, shift) };
        for k in first..first + n {
            let x = &points[k % points.len()];
            let [u, v, pick] = self.numbers.shifted(k, shift);
            let Some((lamp, probability)) = self.lights.tree.pick(branch, &Ball::point(x), pick) else { continue };
            let lamp = &self.lights.lamps[lamp as usize];
            if let Some(aim) = Sampler::new(lamp, x).aim(x, u, v) {
                let colour = lamp.colour * (aim.weight / (probability * n as f64)).min(f32::MAX as f64) as f32;
                self.scratch.push(x, &aim, 1.0, colour);
            }
        }
        self.scratch.close(Sum::Colours);
    }

    /// Cosine-distributed rays for all of the sky, and rays towards the bright texels of uneven images; both estimate
    /// those images, joined by the balance heuristic (Veach & Guibas 1995).
    fn emit_sky(&mut self, points: &[SurfacePoint], shift: u64) {
        use std::f32::consts::{FRAC_1_PI, PI};
        let sky = &self.lights.sky;
        let n = self.numbers.len();
        let per_ray = 1.0 / n as f32;
        for k in 0..n {
            let x = &points[k % points.len()];
            let [u, v, _] = self.numbers.shifted(k, shift);
            let local = sampling::cosine_hemisphere(u, v);
            // Zeros of either sign must have the same frame.
            let (t, b) = sampling::frame(x.normal + Vec3::ZERO);
            let direction = local.x * t + local.y * b + local.z * x.normal;
            let mut colour = sky.constant * PI * per_ray;
            for map in &sky.maps {
                let texel = map.texel(direction);
                let other = if map.uneven { map.pdf(texel) as f32 } else { 0.0 };
                let cos = local.z.max(1e-12);
                colour += map.radiance(texel) * (cos * per_ray / (cos * FRAC_1_PI + other));
            }
            if colour != Vec3::ZERO {
                self.scratch.push(x, &Aim { direction, t_max: f32::INFINITY, weight: 1.0 }, 1.0, colour);
            }
        }
        for (i, map) in sky.maps.iter().enumerate().filter(|(_, m)| m.uneven) {
            let shift = sampling::hash(&[shift, i as u64]);
            for k in 0..n {
                let x = &points[k % points.len()];
                let [u, v, _] = self.numbers.shifted(k, shift);
                let (direction, texel) = map.sample(u, v);
                let cos = x.normal.dot(direction);
                if cos > 0.0 {
                    let colour = map.radiance(texel) * (cos * per_ray / (cos * FRAC_1_PI + map.pdf(texel) as f32));
                    self.scratch.push(x, &Aim { direction, t_max: f32::INFINITY, weight: 1.0 }, 1.0, colour);
                }
            }
        }
        self.scratch.close(Sum::Colours);
    }

    /// Where a run of `n` samples starts: an aligned run of a Sobol sequence is stratified in itself, and different
    /// lamps then use different points of the patch.
    fn first_sample(&self, n: usize, shift: u64) -> usize {
        let runs = self.numbers.len() / n;
        n * ((shift >> 8) as usize % runs)
    }

    /// Traces what was emitted, adds it up in order, and returns the number of rays.
    fn finish(self, tracer: &dyn RayTracer, out: &mut [Vec3]) -> u64 {
        let s = self.scratch;
        s.occluded.clear();
        s.occluded.resize(s.rays.len(), false);
        tracer.occluded(&s.rays, &mut s.occluded);
        let mut begin = 0;
        for group in &s.groups {
            let range = begin..group.end as usize;
            begin = range.end;
            let arrived = match group.sum {
                Sum::Share(unshadowed) => {
                    let (mut arrived, mut all) = (0.0_f64, 0.0_f64);
                    for k in range {
                        let weight = s.weights[k] as f64;
                        all += weight;
                        arrived += if s.occluded[k] { 0.0 } else { weight };
                    }
                    if all > 0.0 { unshadowed * (arrived / all) as f32 } else { Vec3::ZERO }
                }
                Sum::Colours => range.filter(|&k| !s.occluded[k]).map(|k| s.colours[k]).sum(),
            };
            let sum = &mut out[group.receiver as usize];
            *sum = (*sum + arrived).min(Vec3::MAX);
        }
        let rays = s.rays.len() as u64;
        s.clear();
        rays
    }
}

impl Scratch {
    fn push(&mut self, x: &SurfacePoint, aim: &Aim, weight: f32, colour: Vec3) {
        // What lies nearer than the offset is the surface itself, or one that meets it here.
        let t_min = RAY_OFFSET * aim.direction.length_recip();
        self.rays.push(origin(x), aim.direction, t_min, aim.t_max);
        self.weights.push(weight);
        self.colours.push(colour);
    }

    fn close(&mut self, sum: Sum) {
        let end = self.rays.len() as u32;
        if self.groups.last().map_or(0, |g| g.end) < end {
            self.groups.push(Group { receiver: self.receivers - 1, end, sum });
        }
    }

    fn clear(&mut self) {
        self.rays.clear();
        self.weights.clear();
        self.colours.clear();
        self.groups.clear();
        self.receivers = 0;
    }
}
