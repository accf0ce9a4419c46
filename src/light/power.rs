//! Where the power of lamps goes: what they emit, and how much of it no surface receives.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    LightSet,
    lamp::{Lamp, Shape},
    sky,
};
use crate::{
    sampling,
    scene::RAY_OFFSET,
    trace::{Hit, RayBatch, RayTracer},
};

/// Power of the lamps by channel, W / scale^2; without suns and skies, whose power has no bound.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LampPower {
    /// What they emit, in closed form: pi A L of surfaces and discs, 4 pi I of points, 2 pi I (1 - c + (c - c') / 3) of
    /// spots with cosines c inside and c' outside.
    pub emitted: [f64; 3],
    /// What no surface receives of it: it leaves the scene, goes into objects, or ends with the range of its lamp.
    pub missed: [f64; 3],
}

/// Rays look where the power goes, set by set of so many Sobol points,
const SET: u32 = 1 << 15;
/// until as many random ones would tell the missed share to this standard error,
const ENOUGH: f64 = 5e-4;
/// or so many sets are done.
const SETS: u32 = 8;
/// Rays traced in one call.
const BATCH: usize = 1024;

impl LampPower {
    /// Follows rays from the lamps, as many of each as its power asks for. `inside` tells whether a hit lies within
    /// an object.
    ///
    /// # Accuracy
    /// The standard error of the missed share m is at most 0.05 % of the emitted power, or sqrt(m (1 - m) / 262144), which is
    /// at most 0.1 %.
    pub fn new(
        lights: &LightSet,
        tracer: &dyn RayTracer,
        inside: impl Fn(&Hit) -> bool + Sync,
        seed: u64,
    ) -> LampPower {
        let mut sum = 0.0;
        let ends: Vec<f64> = (lights.lamps.iter())
            .map(|lamp| {
                sum += lamp.power() * sky::mean(lamp.colour);
                sum
            })
            .collect();
        if !(sum > 0.0 && sum.is_finite()) {
            return LampPower { emitted: lights.power(), missed: [0.0; 3] };
        }
        let (mut missed, mut lost, mut rays) = ([0.0; 3], 0.0, 0.0);
        for set in 0..SETS {
            let points: Vec<u32> = (0..SET).collect();
            let batches: Vec<([f64; 3], f64)> = points
                .par_chunks(BATCH)
                .map(|points| lights.missed(tracer, &inside, &ends, points, [seed, set as u64]))
                .collect();
            for (of_channel, of_all) in batches {
                missed = std::array::from_fn(|c| missed[c] + of_channel[c]);
                lost += of_all;
            }
            rays += SET as f64;
            let share = lost / rays;
            if share * (1.0 - share) <= ENOUGH * ENOUGH * rays {
                break;
            }
        }
        LampPower { emitted: lights.power(), missed: missed.map(|m| m * sum / rays) }
    }
}

impl LightSet {
    /// What these `points` of a set miss, in rays: of each channel, as a multiple of the lamps' mean channel; and of all.
    fn missed(
        &self,
        tracer: &dyn RayTracer,
        inside: impl Fn(&Hit) -> bool,
        ends: &[f64],
        points: &[u32],
        [seed, set]: [u64; 2],
    ) -> ([f64; 3], f64) {
        let sum = ends[ends.len() - 1];
        let mut rays = RayBatch::with_capacity(points.len());
        let mut lamps: Vec<&Lamp> = Vec::with_capacity(points.len());
        for &k in points {
            let numbers = |purpose: u64| sampling::sobol4(k, sampling::hash(&[seed, purpose, set]));
            let ([pick, a, b, side], [u, v, ..]) = (numbers(FROM), numbers(TOWARDS));
            let chosen = ends.partition_point(|&end| end <= pick as f64 * sum).min(ends.len() - 1);
            let lamp = &self.lamps[chosen];
            let (origin, direction) = leave(lamp, [a, b, side], [u, v]);
            rays.push(origin, direction, 0.0, f32::INFINITY);
            lamps.push(lamp);
        }
        let mut hits = vec![Hit::NONE; rays.len()];
        tracer.closest_hits(&rays, &mut hits);
        let (mut missed, mut lost) = ([0.0; 3], 0.0);
        for (lamp, hit) in lamps.iter().zip(&hits) {
            let received = if hit.is_hit() && !inside(hit) { lamp.window(hit.t as f64) } else { 0.0 };
            lost += 1.0 - received;
            let share = (1.0 - received) / sky::mean(lamp.colour);
            for (m, colour) in missed.iter_mut().zip(lamp.colour.to_array()) {
                *m += share * colour as f64;
            }
        }
        (missed, lost)
    }
}

/// Purpose words of the random numbers.
const FROM: u64 = 0x66_726f_6d00;
const TOWARDS: u64 = 0x74_6f77_6172;

/// A ray that leaves the lamp, by the density of its power.
fn leave(lamp: &Lamp, [a, b, side]: [f32; 3], [u, v]: [f32; 2]) -> (Vec3, Vec3) {
    let from_surface = |at: Vec3, normal: Vec3| {
        let (e1, e2) = sampling::frame(normal);
        let d = sampling::cosine_hemisphere(u, v);
        (at + RAY_OFFSET * normal, d.x * e1 + d.y * e2 + d.z * normal)
    };
    let about = |axis: Vec3, cos: f64| {
        let (e1, e2) = sampling::frame(axis);
        let sine = (1.0 - cos * cos).max(0.0).sqrt() as f32;
        let (sin_phi, cos_phi) = (std::f32::consts::TAU * v).sin_cos();
        cos as f32 * axis + sine * (cos_phi * e1 + sin_phi * e2)
    };
    match &lamp.shape {
        Shape::Polygon(p) => {
            let [corner, next, .., last] = p.corners;
            let (a, b) = if p.count == 4 { (a, b) } else { sampling::triangle(a, b) };
            let normal = if p.both_sides && side < 0.5 { -p.normal } else { p.normal };
            from_surface(corner + a * (next - corner) + b * (last - corner), normal)
        }
        Shape::Disc { centre, normal, radius } => {
            let (e1, e2) = sampling::frame(*normal);
            let at = sampling::concentric_disc(a, b) * *radius;
            from_surface(*centre + at.x * e1 + at.y * e2, *normal)
        }
        Shape::Point { position, .. } => (*position, about(Vec3::Z, 1.0 - 2.0 * u as f64)),
        Shape::Spot { position, direction, cos_inner, cos_outer, .. } => {
            // The power within an angle is that of the full cone, then grows as 1 - t^3, t^2 being the fall-off.
            let (inner, outer) = (*cos_inner as f64, *cos_outer as f64);
            let edge = (inner - outer).max(0.0);
            let share = u as f64 * (1.0 - inner + edge / 3.0);
            let t = (1.0 - 3.0 * (share - (1.0 - inner)) / edge.max(f64::MIN_POSITIVE)).max(0.0).cbrt();
            let cos = if share <= 1.0 - inner { 1.0 - share } else { outer + t * edge };
            (*position, about(*direction, cos))
        }
        // Has no power, so is never picked.
        Shape::Sun { direction } => (Vec3::ZERO, *direction),
    }
}
