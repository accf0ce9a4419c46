//! Direct irradiance of receivers: who gets how many shadow rays.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    DirectResult, Known, LightSet, Spared, View,
    aim::{Aim, Sampler},
    answers::{Answers, Sum},
    node::Ball,
    numbers::Numbers,
    sky,
    tree::Branch,
};
use crate::{sampling, scene::SurfacePoint, trace::RayTracer};

/// Lamps and groups of lamps that a receiver looks at one by one; groups are sampled.
pub(super) const CUT: usize = 32;

/// Rays that a lamp or group gets at least.
pub(super) const LEAST: usize = 4;

/// Lamps within so many radii of a patch get all samples: a part of the patch says nothing of the rest.
const NEAR: f32 = 2.0;

/// Points of a receiver that tell what a lamp may give it: the first of a Sobol sequence lie well apart.
const ASKED: usize = 4;

/// Rays traced in one call, about.
const BATCH: usize = 4096;

/// Batches of a piece of work at most: their cost differs, and the larger the last piece, the longer the others wait for it.
const PIECE: usize = 8;

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
    irradiance_where(lights, tracer, points, points_per_receiver, samples, seed, &Known::NOTHING)
}

/// As [`irradiance`], without the rays whose answer is known.
pub fn irradiance_where(
    lights: &LightSet,
    tracer: &dyn RayTracer,
    points: &[SurfacePoint],
    points_per_receiver: usize,
    samples: u32,
    seed: u64,
    known: &Known,
) -> DirectResult {
    let per_receiver = points_per_receiver.max(1);
    let numbers = Numbers::new(samples.clamp(1, MOST_SAMPLES), per_receiver, seed);
    let mut irradiance = vec![Vec3::ZERO; points.len() / per_receiver];
    let chunk = (BATCH / numbers.len()).clamp(1, 256);
    let (rays, spared) = irradiance
        .par_chunks_mut(chunk)
        .zip(points.par_chunks(chunk * per_receiver))
        .with_max_len(PIECE)
        .map_init(Scratch::default, |scratch, (out, points)| {
            let mut work = Work { lights, numbers: &numbers, known, scratch };
            for receiver in points.chunks_exact(per_receiver) {
                work.emit(receiver);
            }
            scratch.answers.sum_up(tracer, known.census, out)
        })
        .reduce(Default::default, |mut a: (u64, Spared), b| {
            a.0 += b.0;
            a.1 += b.1;
            a
        });
    DirectResult { irradiance, rays, spared }
}

#[derive(Default)]
struct Scratch {
    answers: Answers,
    cut: Vec<Branch>,
    /// Of every lamp of the cut, then of the suns, the unshadowed irradiance by unit colour at the first points; of every
    /// branch its importance.
    expected: Vec<f64>,
}

struct Work<'a> {
    lights: &'a LightSet,
    numbers: &'a Numbers,
    known: &'a Known<'a>,
    scratch: &'a mut Scratch,
}

impl Work<'_> {
    /// Writes the shadow rays of one receiver.
    fn emit(&mut self, points: &[SurfacePoint]) {
        self.scratch.answers.next();
        if !points.iter().all(SurfacePoint::is_sound) {
            return;
        }
        let identity = self.numbers.identity(&points[0]);
        let view = if self.known.skip { (self.known.view)(points) } else { View::Unknown };
        let answers = &mut self.scratch.answers;
        answers.set_free(view == View::Clear);
        answers.spared.clear_receivers += (view == View::Clear) as u64;
        let before = answers.spared.clear;
        self.emit_lamps(points, identity);
        let all = self.numbers.len() as u64;
        let spared = &mut self.scratch.answers.spared;
        match view {
            _ if self.lights.polygons => {}
            _ if self.known.skip && !self.lights.sky.is_lit() => spared.black_sky += all,
            View::NoSky(rays) => {
                spared.no_sky += all;
                spared.lose_sky(rays);
            }
            View::AllSky(rays) => {
                spared.lose_sky(rays);
                self.scratch.answers.set_free(true);
                self.emit_sky(points, sampling::hash(&[identity, u64::MAX]));
                let spared = &mut self.scratch.answers.spared;
                spared.all_sky += std::mem::replace(&mut spared.clear, before) - before;
            }
            _ => self.emit_sky(points, sampling::hash(&[identity, u64::MAX])),
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

        let some = &points[..points.len().min(ASKED)];
        let of_lamp = |lamp: u32| {
            let lamp = &lights.lamps[lamp as usize];
            some.iter().map(|x| lamp.unshadowed(x)).sum::<f64>() / some.len() as f64
        };
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
            let near = points.len() > 1 && cut.get(i).is_some_and(|&b| lights.tree.is_near(b, &ball, NEAR));
            let n = ((share * all as f64).round() as usize).next_power_of_two().max(LEAST).min(all);
            let n = if near { all } else { n };
            let shift = sampling::hash(&[identity, i as u64]);
            let lamp = cut.get(i).map_or_else(|| Some(lights.suns[i - cut.len()]), |&b| lights.tree.lamp(b));
            match lamp {
                Some(lamp) => self.emit_lamp(lamp, value, points, n, shift),
                None => self.emit_branch(cut[i], points, n, shift),
            }
        }
        if lights.lamps.len() <= CUT {
            // The tree gave up lamps that face away.
            let missing = |lamp: &u32| !cut.iter().any(|&b| lights.tree.lamp(b) == Some(*lamp));
            for lamp in (0..lights.lamps.len() as u32).filter(|l| !lights.suns.contains(l)).filter(missing) {
                self.emit_away(lamp, &points[0]);
                self.scratch.answers.close(Sum::Share(Vec3::ZERO, lamp));
            }
        }
        self.scratch.cut = cut;
        self.scratch.expected = expected;
    }

    /// `n` rays to one lamp: its exact irradiance (of a single point `expected`, by unit colour) times the share of it that arrives.
    fn emit_lamp(&mut self, id: u32, expected: f64, points: &[SurfacePoint], n: usize, shift: u64) {
        let lamp = &self.lights.lamps[id as usize];
        let mut unshadowed = 0.0;
        if self.lights.is_dark(id) {
            self.scratch.answers.spared.dark_lamps +=
                if lamp.is_point_like() && points.len() == 1 { 1 } else { n as u64 };
            return;
        }
        if let [x] = points {
            unshadowed = expected;
            if unshadowed == 0.0 {
                self.emit_away(id, x);
                return self.scratch.answers.close(Sum::Share(Vec3::ZERO, id));
            }
            let n = if lamp.is_point_like() { 1 } else { n };
            let sampler = Sampler::new(lamp, x);
            for k in 0..n {
                let [u, v, _] = self.numbers.shifted(k, shift);
                if let Some(aim) = sampler.aim(x, u, v) {
                    self.scratch.answers.push(x, &aim, aim.weight as f32, Vec3::ZERO);
                }
            }
        } else {
            let first = self.first_sample(n, shift);
            for k in first..first + n {
                let x = &points[k % points.len()];
                let here = lamp.unshadowed(x);
                if here == 0.0 {
                    self.emit_away(id, x);
                    continue;
                }
                unshadowed += here / n as f64;
                let [u, v, _] = self.numbers.shifted(k, shift);
                if let Some(aim) = Sampler::new(lamp, x).aim(x, u, v) {
                    self.scratch.answers.push(x, &aim, aim.weight as f32, Vec3::ZERO);
                }
            }
        }
        // A finite light times a share of nothing must be nothing.
        self.scratch.answers.close(Sum::Share((lamp.colour * unshadowed as f32).min(Vec3::MAX), id));
    }

    /// A ray to a lamp that gives nothing to `x`: it is left out, or cast without a weight.
    fn emit_away(&mut self, lamp: u32, x: &SurfacePoint) {
        if self.known.skip {
            self.scratch.answers.spared.away += 1;
            return;
        }
        let aim = Aim::idle(&self.lights.lamps[lamp as usize], x);
        if aim.direction != Vec3::ZERO {
            self.scratch.answers.push(x, &aim, 0.0, Vec3::ZERO);
        }
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
                self.scratch.answers.push(x, &aim, 1.0, colour);
            }
        }
        self.scratch.answers.close(Sum::Colours);
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
            if colour != Vec3::ZERO || !self.known.skip {
                self.scratch.answers.push(x, &Aim { direction, t_max: f32::INFINITY, weight: 1.0 }, 1.0, colour);
            } else {
                self.scratch.answers.spared.black_sky += 1;
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
                    self.scratch.answers.push(x, &Aim { direction, t_max: f32::INFINITY, weight: 1.0 }, 1.0, colour);
                }
            }
        }
        self.scratch.answers.close(Sum::Colours);
    }

    /// Where a run of `n` samples starts: an aligned run of a Sobol sequence is stratified in itself, and different
    /// lamps then use different points of the patch.
    fn first_sample(&self, n: usize, shift: u64) -> usize {
        let runs = self.numbers.len() / n;
        n * ((shift >> 8) as usize % runs)
    }
}
