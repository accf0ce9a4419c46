//! Irradiance by very many small senders: bright patches, when there is no time to look at each as a lamp.
//!
//! What all give in full view is known ([`senders`](super::senders)). The share of it that arrives is found by few shadow rays to
//! senders that are picked in proportion to what they give, at even steps of their sum: in full view there is no noise, and in
//! half shadow that of stratified samples.

use glam::Vec3;
use rayon::prelude::*;

use super::{
    DirectResult, Spared,
    estimate::{CUT, LEAST},
    lanes::WIDTH,
    numbers::Numbers,
    senders::{Crowd, give},
};
use crate::{
    sampling,
    scene::{RAY_OFFSET, SurfacePoint},
    trace::{RayBatch, RayTracer},
};

/// Points of a receiver that tell what the senders give it: the first of a Sobol sequence lie well apart.
const ASKED: usize = 4;
/// Rays of a receiver that are as good as those of [`irradiance`](super::irradiance()), which has as many at least where it groups
/// lamps.
pub(crate) const AS_GOOD: u32 = (CUT * LEAST) as u32;
/// Rays that are traced together, about.
const BATCH: usize = 2048;

impl Crowd {
    /// Irradiance of receivers, W/m2, with one shadow ray a sample; receivers are consecutive `points` as `light::irradiance`
    /// takes them. Points that are not finite, or have no unit normal, get nothing.
    ///
    /// Equal points, senders and `seed` give equal bits, on any number of threads.
    pub fn irradiance(
        &self,
        tracer: &dyn RayTracer,
        points: &[SurfacePoint],
        points_per_receiver: usize,
        samples: u32,
        seed: u64,
    ) -> DirectResult {
        let per = points_per_receiver.max(1);
        let numbers = Numbers::new(samples, per, seed);
        let chunk = (BATCH / numbers.len()).max(1);
        let mut irradiance = vec![Vec3::ZERO; points.len() / per];
        let rays = irradiance
            .par_chunks_mut(chunk)
            .zip(points.par_chunks(chunk * per))
            .map_init(Scratch::default, |scratch, (out, points)| {
                scratch.begin();
                for receiver in points.chunks_exact(per) {
                    scratch.look(self, receiver, &numbers);
                }
                scratch.arrive(self, tracer, out)
            })
            .sum();
        DirectResult { irradiance, rays, spared: Spared::default() }
    }
}

/// Memory of a thread.
#[derive(Default)]
struct Scratch {
    /// What the senders give to the receiver in full view: the sum of the bands.
    given: Vec<f32>,
    /// The sum of it of every block.
    blocks: Vec<f32>,
    rays: RayBatch,
    /// The sender of every ray.
    senders: Vec<u32>,
    occluded: Vec<bool>,
    /// Of every receiver: what it gets in full view, and where its rays end.
    open: Vec<(Vec3, u32)>,
}

impl Scratch {
    fn begin(&mut self) {
        self.rays.clear();
        self.senders.clear();
        self.open.clear();
    }

    /// Takes a receiver: what it gets in full view, and its rays.
    fn look(&mut self, crowd: &Crowd, points: &[SurfacePoint], numbers: &Numbers) {
        let open = if points.iter().all(SurfacePoint::is_sound) {
            give(crowd, &points[..points.len().min(ASKED)], &mut self.given, &mut self.blocks)
        } else {
            Vec3::ZERO
        };
        let all: f32 = self.blocks.iter().sum();
        if open.is_finite() && all > 0.0 && open != Vec3::ZERO {
            self.aim(crowd, points, numbers, all);
            self.open.push((open, self.rays.len() as u32));
        } else {
            self.open.push((Vec3::ZERO, self.rays.len() as u32));
        }
    }

    /// Rays to senders at even steps of the sum of what they give, `all`.
    fn aim(&mut self, crowd: &Crowd, points: &[SurfacePoint], numbers: &Numbers, all: f32) {
        let n = numbers.len();
        let shift = sampling::hash(&[numbers.identity(&points[0])]);
        let begin = (sampling::hash(&[shift]) >> 40) as f32 / 16_777_216.0;
        let (mut block, mut before) = (0, 0.0);
        for k in 0..n {
            let mut left = (k as f32 + begin) / n as f32 * all - before;
            while block + 1 < self.blocks.len() && left >= self.blocks[block] {
                left -= self.blocks[block];
                before += self.blocks[block];
                block += 1;
            }
            let own = &self.given[block * WIDTH..(block + 1) * WIDTH];
            // Rounding may leave more than there is: then it is the last that gives anything.
            let (mut sender, mut which) = (None, 0.0);
            for (i, &given) in own.iter().enumerate().filter(|g| *g.1 > 0.0) {
                (sender, which) = (Some(block * WIDTH + i), (left / given).clamp(0.0, 1.0));
                left -= given;
                if left < 0.0 {
                    break;
                }
            }
            let x = &points[k % points.len()];
            let [u, v, _] = numbers.shifted(k, shift);
            let Some((j, (target, normal))) = sender.and_then(|j| Some((j, crowd.point(j, which, [u, v])?))) else {
                continue;
            };
            let to = target - x.position;
            if x.normal.dot(to) <= 0.0 || normal.dot(to) >= 0.0 {
                continue;
            }
            // Rays start and end off their surfaces, as all that look for lamps.
            let origin = x.position + RAY_OFFSET * x.normal;
            let direction = target + RAY_OFFSET * normal - origin;
            self.rays.push(origin, direction, RAY_OFFSET * direction.length_recip(), 1.0);
            self.senders.push(j as u32);
        }
    }

    /// Traces the rays and enters what arrives; how many there were.
    fn arrive(&mut self, crowd: &Crowd, tracer: &dyn RayTracer, out: &mut [Vec3]) -> u64 {
        self.rays.coherent = true;
        self.occluded.clear();
        self.occluded.resize(self.rays.len(), false);
        tracer.occluded(&self.rays, &mut self.occluded);
        let mut begin = 0;
        for (out, &(open, end)) in out.iter_mut().zip(&self.open) {
            // Picks go by the sum of the bands: each counts with its colour by unit sum.
            let (mut arrived, mut all) = (Vec3::ZERO, Vec3::ZERO);
            for k in begin..end as usize {
                let j = self.senders[k] as usize;
                let colour = Vec3::from_array([0, 1, 2].map(|c| crowd.colour[c][j]));
                let colour = colour / colour.element_sum();
                all += colour;
                arrived += if self.occluded[k] { Vec3::ZERO } else { colour };
            }
            begin = end as usize;
            // The share first: the largest light times a number of rays is beyond f32.
            *out = open * (arrived / all.max(Vec3::splat(f32::MIN_POSITIVE)));
        }
        self.rays.len() as u64
    }
}

#[cfg(test)]
mod tests {
    use std::f32::consts::PI;

    use super::*;
    use crate::{
        light::{
            LightSet, irradiance,
            lamp::{Lamp, Polygon},
            senders::NEAR,
        },
        sampling::hash,
        trace::{Brute, Geometry},
    };

    const SEED: u64 = 3;

    fn unit(i: u64, k: u64) -> f32 {
        (hash(&[i, k]) >> 40) as f32 / (1 << 24) as f32
    }

    fn place(i: u64, k: u64) -> Vec3 {
        Vec3::new(unit(i, k), unit(i, k + 1), unit(i, k + 2)) - 0.5
    }

    /// Squares of the plane z = 0 that face upwards, 0.05 wide, in rows of ten, with colours of their own.
    fn squares() -> Vec<(Vec<Vec3>, Vec3)> {
        let square = |i: u64| {
            let corner = Vec3::new(0.05 * (i % 10) as f32 - 0.25, 0.05 * (i / 10) as f32 - 0.25, 0.0);
            let (u, v) = (0.05 * Vec3::X, 0.05 * Vec3::Y);
            (vec![corner, corner + u, corner + u + v, corner + v], Vec3::new(unit(i, 8), unit(i, 9), 1.0))
        };
        (0..100).map(square).collect()
    }

    fn crowd() -> Crowd {
        let polygon = |(corners, exitance): (Vec<Vec3>, Vec3)| (vec![Polygon::new(&corners, false).unwrap()], exitance);
        Crowd::of(squares().into_iter().map(polygon))
    }

    /// The same as lamps.
    fn lamps() -> LightSet {
        let squares = squares();
        LightSet::of_polygons(squares.iter().map(|(corners, exitance)| (&corners[..], *exitance / PI)))
    }

    /// Receivers above the squares, turned anyhow.
    fn receivers(count: u64) -> Vec<SurfacePoint> {
        let point =
            |i| SurfacePoint { position: place(i, 0) + Vec3::new(0.0, 0.0, 0.52), normal: place(i, 3).normalize() };
        (0..count).map(point).collect()
    }

    #[test]
    fn in_full_view_a_crowd_gives_the_light_of_its_polygons() {
        let (points, tracer) = (receivers(1000), Brute::new(&Geometry::default()));
        let found = crowd().irradiance(&tracer, &points, 1, 16, SEED);
        let lamps = lamps();
        let mut squares = (0.0, 0.0);
        for (x, got) in points.iter().zip(found.irradiance) {
            let exact: Vec3 = lamps.lamps.iter().map(|l| l.unshadowed(x) as f32 * l.colour).sum();
            // The second term of the series for a square of radius R at distance d: at most 10/3 (R / d)^2 of what it would
            // give face to face, if it faces the receiver.
            let most = |l: &Lamp| {
                let p = l.polygon().unwrap();
                let to = p.corners[..4].iter().sum::<Vec3>() / 4.0 - x.position;
                let cos = (-p.normal.dot(to.normalize())).max(p.radius / to.length());
                let share = 10.0 / 3.0 * (p.radius / to.length()).powi(2);
                let near = to.length() < NEAR * p.radius;
                if near { 1e-5 } else { share * cos * p.area / to.length_squared() }
            };
            let bound: Vec3 = lamps.lamps.iter().map(|l| most(l) * l.colour).sum();
            assert!((got - exact).abs().cmple(bound + 1e-5 * exact).all(), "{x:?}: {got} {exact} {bound}");
            squares.0 += (got - exact).length_squared() as f64;
            squares.1 += exact.length_squared() as f64;
        }
        // The terms have either sign: much less is left of their sum.
        println!("root mean square: {:.2e}", (squares.0 / squares.1).sqrt());
    }

    #[test]
    fn shadows_of_a_crowd_are_those_of_its_polygons() {
        let positions: Vec<Vec3> =
            (0..24).map(|i| 0.8 * place(500 + i / 3, 0) + 0.3 * place(i, 7) + 0.4 * Vec3::Z).collect();
        let tracer =
            Brute::new(&Geometry { positions, triangles: (0..8).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect() });
        let points = receivers(2000);
        let open = crowd().irradiance(&Brute::new(&Geometry::default()), &points, 1, 16, SEED).irradiance;
        let got = crowd().irradiance(&tracer, &points, 1, 16, SEED).irradiance;
        let exact = irradiance(&lamps(), &tracer, &points, 1, 1024, SEED).irradiance;
        let lamps = lamps();
        let lit = |x: &SurfacePoint| lamps.lamps.iter().map(|l| l.unshadowed(x) as f32 * l.colour.z).sum::<f32>();
        let [red, green, blue] = crowd().colour;
        let weight = (0..100).map(|j| blue[j] / (red[j] + green[j] + blue[j])).fold(0.0, f32::max);
        let (mut off, mut square, mut shadowed, mut bias) = (0.0, 0.0, 0, (0.0, 0.0));
        let (mut noise, mut noise_square) = (0.0, 0.0);
        for i in 0..points.len() {
            let error = (got[i] - exact[i]).z as f64;
            (off, square) = (off + error, square + error * error);
            let full = (open[i].z - lit(&points[i])).abs() as f64;
            bias = (bias.0 + full, bias.1 + full * full);
            shadowed += (exact[i].z < 0.99 * open[i].z) as u32;
            // What is dark stays dark, and nothing is brighter than in full view.
            assert!(exact[i] != Vec3::ZERO || got[i].max_element() <= 1e-2 * open[i].max_element() + 1e-6, "{i}");
            assert!(got[i].cmple(open[i] * (1.0 + 1e-5)).all(), "{i}");
            // Rays are picked by the sum of the bands and count with weights w, their band by that sum. Of n independent rays, a
            // share p of w arrives with the variance E[w^2 (v - p)^2] / (n E[w]^2) <= max w p (1 - p) / (n E[w]), where
            // E[w] is the band's share of the light in full view. Stratified ones do no worse.
            let p = (exact[i].z / open[i].z.max(f32::MIN_POSITIVE)).min(1.0);
            let variance = (open[i].z * open[i].element_sum() * weight * p * (1.0 - p)) as f64 / 16.0;
            (noise, noise_square) = (noise + variance, noise_square + variance * variance);
        }
        assert!(shadowed > 200, "{shadowed}");
        // Receivers err independently; besides, what arrives is a share of a light in full view that is off itself.
        assert!(off.abs() < 4.0 * square.sqrt() + bias.0, "{off} {square} {bias:?}");
        // The exact light has 1024 rays of its own. A square of a Gaussian error has the relative standard error sqrt(2).
        let bound = (1.0 + 16.0 / 1024.0) * noise + 4.0 * (2.0 * noise_square).sqrt();
        println!("squares: {square:.2e}, at most {:.2e}", bound + bias.1);
        assert!(square < bound + bias.1, "{square} {bound} {bias:?}");
    }
}
