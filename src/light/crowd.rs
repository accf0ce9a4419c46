//! Irradiance by very many small senders: bright patches, when there is no time to look at each as a lamp.
//!
//! What all senders give in full view is summed up one by one, several to an instruction: a sender from afar is a disc of
//! its area, E = B cos cos' A / (pi r^2 + A) (exact over the middle of a disc; Baum, Rushmeier & Winget 1989 tell how wrong it
//! is nearby), one nearby is its polygons by Lambert's formula. The share of it that arrives is found by few shadow rays to
//! senders that are picked in proportion to what they give, at even steps of their sum: in full view there is no noise, and in
//! half shadow that of stratified samples.
#![allow(clippy::needless_range_loop)] // Loops over lanes step through several arrays at once.

use std::f32::consts::PI;

use glam::Vec3;
use multiversion::multiversion;
use rayon::prelude::*;

use super::{
    DirectResult, LightSet, Spared, bright,
    estimate::CUT,
    lamp::{Lamp, Polygon, Shape},
    lanes::{Block, NONE, WIDTH, load},
    numbers::Numbers,
};
use crate::{
    sampling,
    scene::{RAY_OFFSET, SurfacePoint},
    simplify::Simplified,
    trace::{RayBatch, RayTracer},
};

/// A sender within so many of its radii is looked at polygon by polygon. Of what lies farther the light of a disc is off by at
/// most 10/3 (radius / distance)^2 of what it gives face to face, either way: 1 % is left over a hundred squares (test).
const NEAR: f32 = 4.0;
/// Points of a receiver that tell what the senders give it: the first of a Sobol sequence lie well apart.
const ASKED: usize = 4;
/// Rays that are traced together, about.
const BATCH: usize = 2048;

/// Patches that send light, in whole blocks: the last ones have no area.
pub(crate) struct Crowd {
    /// Centroid.
    place: [Vec<f32>; 3],
    normal: [Vec<f32>; 3],
    area: Vec<f32>,
    /// Square of the distance within which it is near.
    near: Vec<f32>,
    /// Exitance, W/m2.
    colour: [Vec<f32>; 3],
    /// Their polygons, and where those of each sender begin; one more entry than senders.
    polygons: Vec<Lamp>,
    first: Vec<u32>,
}

impl Crowd {
    /// Of `patches` that send `exitance`, W/m2. Patches without area are left out.
    pub fn new(simplified: &Simplified, patches: &[u32], exitance: impl Fn(u32) -> Vec3) -> Crowd {
        let polygons = |i| bright::outlines(simplified, i).iter().filter_map(|o| Polygon::new(o, false)).collect();
        Crowd::of(patches.iter().map(|&i| (polygons(i), exitance(i))))
    }

    /// Of the polygons of `lights`, each a sender; none where they are so few that [`irradiance`](super::irradiance()) looks at
    /// each, or not polygons alone.
    pub fn of_polygons(lights: &LightSet) -> Option<Crowd> {
        let sender = |lamp: &Lamp| Some((vec![lamp.polygon()?.clone()], PI * lamp.colour));
        (lights.polygons && lights.lamps.len() > CUT).then(|| Crowd::of(lights.lamps.iter().filter_map(sender)))
    }

    /// Of senders made of polygons.
    fn of(senders: impl Iterator<Item = (Vec<Polygon>, Vec3)>) -> Crowd {
        let mut crowd = Crowd {
            place: Default::default(),
            normal: Default::default(),
            area: Vec::new(),
            near: Vec::new(),
            colour: Default::default(),
            polygons: Vec::new(),
            first: vec![0],
        };
        senders.for_each(|(polygons, exitance)| crowd.push(polygons, exitance));
        let whole = crowd.area.len().next_multiple_of(WIDTH);
        let Crowd { place, normal, area, near, colour, .. } = &mut crowd;
        for column in place.iter_mut().chain(normal).chain(colour).chain([area, near]) {
            column.resize(whole, 0.0);
        }
        crowd
    }

    /// Adds a sender made of `polygons`.
    fn push(&mut self, polygons: Vec<Polygon>, exitance: Vec3) {
        let begin = self.polygons.len();
        let lamp = |p| Lamp { shape: Shape::Polygon(p), colour: Vec3::ONE, surface: true };
        self.polygons.extend(polygons.into_iter().map(lamp));
        let own = || self.polygons[begin..].iter().filter_map(Lamp::polygon);
        let area: f32 = own().map(|p| p.area).sum();
        if !(area > 0.0 && exitance.is_finite()) {
            return self.polygons.truncate(begin);
        }
        let middle = |p: &Polygon| p.corners[..p.count].iter().sum::<Vec3>() / p.count as f32;
        let centroid = own().map(|p| p.area * middle(p)).sum::<Vec3>() / area;
        let normal = own().map(|p| p.area * p.normal).sum::<Vec3>().normalize_or_zero();
        let radius = own().flat_map(|p| p.corners).map(|c| c.distance(centroid)).fold(0.0, f32::max);
        for (column, value) in self.place.iter_mut().zip(centroid.to_array()) {
            column.push(value);
        }
        for (column, value) in self.normal.iter_mut().zip(normal.to_array()) {
            column.push(value);
        }
        for (column, value) in self.colour.iter_mut().zip(exitance.to_array()) {
            column.push(value);
        }
        self.area.push(area);
        self.near.push((NEAR * radius).powi(2));
        self.first.push(self.polygons.len() as u32);
    }

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

    /// What sender `j` gives to `x` in full view, by unit exitance, from nearby.
    #[cold]
    fn nearby(&self, j: usize, x: &SurfacePoint) -> f32 {
        let own = &self.polygons[self.first[j] as usize..self.first[j + 1] as usize];
        own.iter().map(|lamp| lamp.unshadowed(x)).sum::<f64>() as f32 / PI
    }

    /// A point of sender `j`, with the normal there, by numbers in [0, 1): `which` chooses the polygon.
    fn point(&self, j: usize, which: f32, [u, v]: [f32; 2]) -> Option<(Vec3, Vec3)> {
        let mut left = which * self.area[j];
        let own = &self.polygons[self.first[j] as usize..self.first[j + 1] as usize];
        let mut found = None;
        for p in own.iter().filter_map(Lamp::polygon) {
            found = Some(p);
            left -= p.area;
            if left < 0.0 {
                break;
            }
        }
        found.map(|p| (p.point(u, v), p.normal))
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

/// What all senders give to a receiver in full view: those that are near to the mean over `points`, others to their middle.
/// `given` tells the sum of the bands of each,
/// `blocks` of each block.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
fn give(crowd: &Crowd, points: &[SurfacePoint], given: &mut Vec<f32>, blocks: &mut Vec<f32>) -> Vec3 {
    given.resize(crowd.area.len(), 0.0);
    blocks.clear();
    let share = 1.0 / points.len() as f32;
    let p = share * points.iter().map(|x| x.position).sum::<Vec3>();
    let n = share * points.iter().map(|x| x.normal).sum::<Vec3>();
    let mut sums = [NONE; 3];
    for at in (0..crowd.area.len()).step_by(WIDTH) {
        let [px, py, pz] = load([&crowd.place[0], &crowd.place[1], &crowd.place[2]], at);
        let [nx, ny, nz] = load([&crowd.normal[0], &crowd.normal[1], &crowd.normal[2]], at);
        let [area, near] = load([&crowd.area, &crowd.near], at);
        let [red, green, blue] = load([&crowd.colour[0], &crowd.colour[1], &crowd.colour[2]], at);
        let (mut form, mut d2s) = (NONE, NONE);
        for i in 0..WIDTH {
            let (dx, dy, dz) = (px[i] - p.x, py[i] - p.y, pz[i] - p.z);
            let d2 = dx * dx + dy * dy + dz * dz;
            let up = dx * n.x + dy * n.y + dz * n.z;
            let down = -(dx * nx[i] + dy * ny[i] + dz * nz[i]);
            let (up, down) = (if up > 0.0 { up } else { 0.0 }, if down > 0.0 { down } else { 0.0 });
            let under = d2 * (PI * d2 + area[i]);
            form[i] = up * down * area[i] / if under > f32::MIN_POSITIVE { under } else { f32::MIN_POSITIVE };
            d2s[i] = d2 - near[i];
        }
        let mut nearest = 0.0;
        for i in 0..WIDTH {
            nearest = if d2s[i] < nearest { d2s[i] } else { nearest };
        }
        if nearest < 0.0 {
            for i in (0..WIDTH).filter(|&i| d2s[i] < 0.0) {
                form[i] = share * points.iter().map(|x| crowd.nearby(at + i, x)).sum::<f32>();
            }
        }
        let mut all = NONE;
        for i in 0..WIDTH {
            let (r, g, b) = (form[i] * red[i], form[i] * green[i], form[i] * blue[i]);
            sums[0][i] += r;
            sums[1][i] += g;
            sums[2][i] += b;
            all[i] = r + g + b;
        }
        given[at..at + WIDTH].copy_from_slice(&all);
        blocks.push(total(&all));
    }
    Vec3::new(total(&sums[0]), total(&sums[1]), total(&sums[2]))
}

/// The sum of a block, by halves.
#[inline(always)]
fn total(block: &Block) -> f32 {
    let mut sum = *block;
    let mut half = WIDTH / 2;
    while half > 0 {
        for i in 0..half {
            sum[i] += sum[i + half];
        }
        half /= 2;
    }
    sum[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        light::irradiance,
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
        let lit = |x: &SurfacePoint| lamps.lamps.iter().map(|l| l.unshadowed(x) as f32 * l.colour.y).sum::<f32>();
        let (mut off, mut square, mut all, mut shadowed, mut bias) = (0.0, 0.0, 0.0, 0, 0.0);
        for i in 0..points.len() {
            let error = (got[i] - exact[i]).y as f64;
            (off, square, all) = (off + error, square + error * error, all + exact[i].y as f64);
            bias += (open[i].y - lit(&points[i])).abs() as f64;
            shadowed += (exact[i].y < 0.99 * open[i].y) as u32;
            // What is dark stays dark, and nothing is brighter than in full view.
            assert!(exact[i] != Vec3::ZERO || got[i].max_element() <= 1e-2 * open[i].max_element() + 1e-6, "{i}");
            assert!(got[i].cmple(open[i] * (1.0 + 1e-5)).all(), "{i}");
        }
        assert!(shadowed > 200, "{shadowed}");
        // Receivers err independently; besides, what arrives is a share of a light in full view that is off itself.
        assert!(off.abs() < 4.0 * square.sqrt() + bias, "{off} {square} {bias}");
        // A share of 16 stratified rays has a standard error of at most 1 / 8; one in five receivers is in half shadow.
        let rms = (square / points.len() as f64).sqrt() / (all / points.len() as f64);
        assert!(rms < 0.1, "{rms}");
    }
}
