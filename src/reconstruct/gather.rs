//! Final gather: a point's own rays ask the patches what they send.

use std::ops::Range;

use glam::Vec3;

use super::Field;
use crate::{
    sampling,
    scene::{RAY_OFFSET, SurfacePoint},
    simplify::NO_PATCH,
    trace::{Hit, RayBatch, RayTracer},
};

/// What rays of points meet, and what it sends.
pub struct Senders<'a> {
    /// Tracer of the surfaces that the patches are pieces of.
    pub tracer: &'a dyn RayTracer,
    /// Exitance of every patch whose light the field's values are, W/m2.
    pub exitance: &'a [Vec3],
    /// Whether the scene is closed: rays that escape slipped through cracks and do not count, as in the rows.
    pub closed: bool,
    /// Whether the patches stand off the real surfaces: points may lie behind them.
    pub displaced: bool,
    /// Rays a point.
    pub rays: u32,
    /// Seed of the directions.
    pub seed: u64,
}

/// Directions of gather rays: rank-1 lattices of cosine-distributed points.
///
/// Point i of n lies at (i / n, i g) of the unit square, g the golden ratio, which the polar map turns into the
/// sunflower's even cover of the disc (Vogel 1979). Sets differ by a shift below 1 / n, and a point turns its set by a
/// random azimuth: every single ray is then distributed as it should be. Directions are in order of their place, so
/// that packets of rays stay together.
struct Lattice {
    rays: usize,
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
}

/// Sets of directions.
const SETS: usize = 16;
/// Purpose words of random bits.
const POINT: u64 = 0x6761_7468_6572;
const SHIFT: u64 = 0x7368_6966_7473;
/// Voxels before a point within which the patches of its surface may stand.
const SHELL: f32 = 2.0;
/// Surfaces that rays start before, at most.
const ROUNDS: usize = 3;

impl Lattice {
    /// Directions for gathers of `rays` rays, at least one.
    fn new(rays: u32, seed: u64) -> Lattice {
        let rays = rays.max(1) as usize;
        let all = || Vec::with_capacity(SETS * rays);
        let mut lattice = Lattice { rays, x: all(), y: all(), z: all() };
        for set in 0..SETS {
            let random = sampling::hash(&[seed, SHIFT, set as u64]) >> 11;
            // Strata of the sets among each other, too.
            let shift = (set as f64 + random as f64 / (1u64 << 53) as f64) / SETS as f64;
            let mut directions: Vec<Vec3> = (0..rays).map(|i| sunflower(i, rays, shift)).collect();
            directions.sort_by_key(|d| place(*d));
            lattice.x.extend(directions.iter().map(|d| d.x));
            lattice.y.extend(directions.iter().map(|d| d.y));
            lattice.z.extend(directions.iter().map(|d| d.z));
        }
        lattice
    }

    fn set(&self, random: u64) -> Range<usize> {
        let first = (random % SETS as u64) as usize * self.rays;
        first..first + self.rays
    }
}

fn sunflower(i: usize, n: usize, shift: f64) -> Vec3 {
    const GOLDEN: f64 = 0.618_033_988_749_894_9;
    let u = (i as f64 + shift) / n as f64;
    let (sin, cos) = ((i as f64 * GOLDEN).fract() * std::f64::consts::TAU).sin_cos();
    let r = u.sqrt();
    Vec3::new((r * cos) as f32, (r * sin) as f32, (1.0 - u).sqrt() as f32)
}

/// Sector and ring: neighbours in this order look alike.
fn place(d: Vec3) -> (u32, u32) {
    const SECTORS: f32 = 16.0;
    let turn = (d.y.atan2(d.x) / std::f32::consts::TAU + 0.5) * SECTORS;
    let sector = (turn as u32).min(SECTORS as u32 - 1);
    let ring = ((1.0 - d.z * d.z) * 65536.0) as u32;
    (sector, if sector.is_multiple_of(2) { ring } else { 65536 - ring.min(65536) })
}

/// Memory that is kept from point to point.
#[derive(Default)]
struct Scratch {
    rays: RayBatch,
    hits: Vec<Hit>,
}

/// A final gather, ready for points.
pub struct Gather<'a> {
    field: &'a Field<'a>,
    senders: &'a Senders<'a>,
    lattice: Lattice,
}

impl<'a> Gather<'a> {
    /// Chooses the directions.
    pub fn new(field: &'a Field, senders: &'a Senders) -> Gather<'a> {
        Gather { field, senders, lattice: Lattice::new(senders.rays, senders.seed) }
    }

    /// The light that arrives at each point from the patches that its rays meet; `None` where no ray starts in the
    /// open, or most meet backs.
    ///
    /// E = mean of the exitance met, over cosine-distributed rays. Backs are black. The result depends on nothing but
    /// position and normal of the point.
    pub fn light(&self, points: &[SurfacePoint]) -> Vec<Option<Vec3>> {
        let mut scratch = Scratch::default();
        let light = |(p, origin): (&SurfacePoint, Vec3)| {
            // Adding zero makes -0 and 0 one place.
            let p = SurfacePoint { position: p.position + Vec3::ZERO, normal: p.normal + Vec3::ZERO };
            if p.is_sound() { self.one(&p, origin, &mut scratch) } else { None }
        };
        points.iter().zip(self.origins(points)).map(light).collect()
    }

    fn one(&self, point: &SurfacePoint, origin: Vec3, s: &mut Scratch) -> Option<Vec3> {
        aim(&self.lattice, point, origin, self.senders.seed, &mut s.rays);
        s.hits.clear();
        s.hits.resize(s.rays.len(), Hit::NONE);
        self.senders.tracer.closest_hits(&s.rays, &mut s.hits);
        let (mut sum, mut valid, mut backs) = (glam::DVec3::ZERO, 0u32, 0u32);
        for hit in &s.hits {
            if !hit.is_hit() {
                valid += !self.senders.closed as u32;
                continue;
            }
            let patch = self.patch(hit);
            if patch == NO_PATCH {
                backs += 1;
            } else {
                sum += self.senders.exitance[patch as usize].as_dvec3();
                valid += 1;
            }
        }
        // A point in the open meets the backs of sheets, which are black; one that stands off its surface meets what its own
        // surface hides. Where most rays meet backs nobody knows whether it lies close behind a sheet or inside of an object.
        if self.senders.displaced {
            return (valid > 0).then(|| (sum / valid as f64).as_vec3().min(Vec3::MAX));
        }
        (backs < valid).then(|| (sum / (valid + backs) as f64).as_vec3().min(Vec3::MAX))
    }

    fn patch(&self, hit: &Hit) -> u32 {
        let simplified = self.field.simplified;
        simplified.hit_map.patch(&simplified.fragments, hit)
    }

    /// Where the rays of points start: on their surface, or before the patches that stand off it.
    fn origins(&self, points: &[SurfacePoint]) -> Vec<Vec3> {
        let surface = |p: &SurfacePoint| p.position + RAY_OFFSET * p.normal;
        if !self.senders.displaced {
            return points.iter().map(surface).collect();
        }
        let reach = SHELL * self.field.simplified.grid.voxel_size as f32;
        let ahead = |tracer: &dyn RayTracer, from: &[f32], length: f32| {
            let mut rays = RayBatch::with_capacity(points.len());
            points.iter().zip(from).for_each(|(p, t)| rays.push(surface(p), p.normal, *t, length));
            let mut hits = vec![Hit::NONE; points.len()];
            tracer.closest_hits(&rays, &mut hits);
            hits
        };
        let mut from = vec![0.0; points.len()];
        let real = ahead(self.field.tracer, &from, 2.0 * reach);
        for _ in 0..ROUNDS {
            let hits = ahead(self.senders.tracer, &from, reach);
            for (i, hit) in hits.iter().enumerate().filter(|(_, hit)| hit.is_hit()) {
                let inside = self.patch(hit) == NO_PATCH;
                // A patch of two sides stands for the nearer real surface: that of the point, or that which its ray meets.
                if inside || 2.0 * hit.t < real[i].t {
                    from[i] = hit.t.next_up();
                }
            }
        }
        let before =
            |(p, t): (&SurfacePoint, f32)| surface(p) + if t > 0.0 { (t + RAY_OFFSET) * p.normal } else { Vec3::ZERO };
        points.iter().zip(from).map(before).collect()
    }
}

/// The rays of a point, in directions that its place chooses.
fn aim(lattice: &Lattice, point: &SurfacePoint, origin: Vec3, seed: u64, rays: &mut RayBatch) {
    let bits = point.position.to_array().into_iter().chain(point.normal.to_array());
    let mut words = [seed, POINT, 0, 0, 0, 0, 0, 0];
    words[2..].iter_mut().zip(bits).for_each(|(word, x)| *word = x.to_bits() as u64);
    let random = sampling::hash(&words);
    let azimuth = (random >> 40) as f32 * (std::f32::consts::TAU / (1 << 24) as f32);
    let (t, b) = sampling::frame(point.normal);
    let (sin, cos) = azimuth.sin_cos();
    let (t, b, n) = (t * cos + b * sin, b * cos - t * sin, point.normal);

    let set = lattice.set(random);
    let (dx, dy, dz) = (&lattice.x[set.clone()], &lattice.y[set.clone()], &lattice.z[set]);
    rays.resize(lattice.rays);
    rays.coherent = true;
    rays.t_min.fill(0.0);
    rays.t_max.fill(f32::INFINITY);
    rays.origin_x.fill(origin.x);
    rays.origin_y.fill(origin.y);
    rays.origin_z.fill(origin.z);
    let out = [&mut rays.direction_x, &mut rays.direction_y, &mut rays.direction_z];
    for (axis, out) in out.into_iter().enumerate() {
        let (t, b, n) = (t[axis], b[axis], n[axis]);
        for (((o, &x), &y), &z) in out.iter_mut().zip(dx).zip(dy).zip(dz) {
            *o = t * x + b * y + n * z;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_cover_the_hemisphere_evenly() {
        let lattice = Lattice::new(512, 3);
        for set in [0, 5, 15] {
            let range = lattice.set(set);
            let mut cells = [0; 16];
            let mut sum = glam::DVec3::ZERO;
            for i in range {
                let d = Vec3::new(lattice.x[i], lattice.y[i], lattice.z[i]);
                assert!((d.length() - 1.0).abs() < 1e-6);
                sum += d.as_dvec3();
                // Ring of equal measure x quadrant: 32 points each.
                let ring = ((1.0 - d.z * d.z) * 4.0).min(3.0) as usize;
                cells[ring * 4 + (d.x > 0.0) as usize * 2 + (d.y > 0.0) as usize] += 1;
            }
            // Discrepancy of a lattice of the golden ratio: below log2(n) / 2 points a box.
            assert!(cells.iter().all(|&c| (c - 32_i32).abs() <= 4), "{cells:?}");
            assert!((sum.z / 512.0 - 2.0 / 3.0).abs() < 1e-3 && sum.truncate().length() / 512.0 < 2e-3, "{sum}");
        }
    }
}
