//! Rays from the surface of a patch.

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::PointSets;
use crate::{
    sampling,
    scene::RAY_OFFSET,
    scene::SurfacePoint,
    simplify::{Simplified, clip::point_at, normal_of},
    trace::RayBatch,
};

/// A triangle or parallelogram that points are drawn from.
#[derive(Clone, Copy)]
struct Primitive {
    corner: Vec3,
    edge_u: Vec3,
    edge_v: Vec3,
    normal: Vec3,
    parallelogram: bool,
    /// Share of the patch's area up to and with this one.
    end: f32,
}

impl Primitive {
    fn point(&self, a: f32, b: f32) -> Vec3 {
        let (u, v) = if self.parallelogram { (a, b) } else { sampling::triangle(a, b) };
        self.corner + self.edge_u * u + self.edge_v * v
    }
}

/// Draws points and rays from patches, uniformly by area; keeps its memory from patch to patch.
#[derive(Default)]
pub struct Emitter {
    primitives: Vec<Primitive>,
}

impl Emitter {
    /// Turns to patch `i`.
    pub fn load(&mut self, simplified: &Simplified, i: usize) {
        self.primitives.clear();
        let mut total = 0.0_f64;
        for &member in simplified.patches.members(i) {
            let (f, side) = ((member >> 1) as usize, member & 1);
            let triangle = simplified.corners(simplified.fragments.triangle[f] as usize);
            let normal = if side == 1 { -normal_of(&triangle) } else { normal_of(&triangle) };
            let uv = simplified.fragments.uv(f);
            let corner = point_at(&triangle, uv[0]);
            let mut add = |p: Vec2, q: Vec2, parallelogram: bool| {
                let (edge_u, edge_v) = (point_at(&triangle, p) - corner, point_at(&triangle, q) - corner);
                let area = edge_u.as_dvec3().cross(edge_v.as_dvec3()).length();
                total += if parallelogram { area } else { 0.5 * area };
                self.primitives.push(Primitive { corner, edge_u, edge_v, normal, parallelogram, end: total as f32 });
            };
            let scale = (uv[2] - uv[0]).abs().max_element();
            if uv.len() == 4 && (uv[0] + uv[2] - uv[1] - uv[3]).abs().max_element() < 1e-4 * scale {
                add(uv[1], uv[3], true);
            } else {
                uv[1..].windows(2).for_each(|w| add(w[0], w[1], false));
            }
        }
        let total = (total as f32).max(f32::MIN_POSITIVE);
        self.primitives.iter_mut().for_each(|p| p.end /= total);
        if let Some(last) = self.primitives.last_mut() {
            last.end = 1.0;
        }
    }

    /// The primitive that holds share `a` of the area, and the share within it.
    fn select(&self, a: f32) -> (&Primitive, f32) {
        let mut begin = 0.0;
        for p in &self.primitives {
            if a < p.end {
                return (p, ((a - begin) / (p.end - begin)).min(BELOW_ONE));
            }
            begin = p.end;
        }
        (&self.primitives[self.primitives.len() - 1], BELOW_ONE)
    }

    /// A point of the patch for `a`, `b` in [0, 1).
    pub fn point(&self, a: f32, b: f32) -> SurfacePoint {
        let (primitive, a) = self.select(a);
        SurfacePoint { position: primitive.point(a, b), normal: primitive.normal }
    }

    /// Fills `rays` with one ray for each point of a set, chosen by the bits of `random`. Directions are
    /// cosine-distributed about the normal of the surface at the origin.
    pub fn rays(&self, sets: &PointSets, random: [u64; 2], rays: &mut RayBatch) {
        let set = sets.set(random[0]);
        let azimuth = (random[0] >> 40) as f32 * (std::f32::consts::TAU / (1 << 24) as f32);
        let flip = [random[1] as u32, (random[1] >> 32) as u32];
        rays.resize(sets.len);
        rays.coherent = true;
        rays.t_min.fill(0.0);
        rays.t_max.fill(f32::INFINITY);
        self.origins(sets, set.clone(), flip, rays);
        if let [only] = &self.primitives[..] {
            let axes = turned_frame(only.normal, azimuth);
            turn(sets, set, axes, 0, rays);
        } else {
            self.turn_each(sets, set, flip, azimuth, rays);
        }
    }

    fn origins(&self, sets: &PointSets, set: std::ops::Range<usize>, flip: [u32; 2], rays: &mut RayBatch) {
        let (oa, ob) = (&sets.origin_a[set.clone()], &sets.origin_b[set]);
        match &self.primitives[..] {
            [p] if p.parallelogram => {
                let base = p.corner + RAY_OFFSET * p.normal;
                for axis in 0..3 {
                    let out = match axis {
                        0 => &mut rays.origin_x,
                        1 => &mut rays.origin_y,
                        _ => &mut rays.origin_z,
                    };
                    let (c, u, v) = (base[axis], p.edge_u[axis], p.edge_v[axis]);
                    for ((o, &a), &b) in out.iter_mut().zip(oa).zip(ob) {
                        *o = c + u * fraction(a ^ flip[0]) + v * fraction(b ^ flip[1]);
                    }
                }
            }
            _ => {
                for i in 0..oa.len() {
                    let (p, a) = self.select(fraction(oa[i] ^ flip[0]));
                    let origin = p.point(a, fraction(ob[i] ^ flip[1])) + RAY_OFFSET * p.normal;
                    rays.origin_x[i] = origin.x;
                    rays.origin_y[i] = origin.y;
                    rays.origin_z[i] = origin.z;
                }
            }
        }
    }

    fn turn_each(
        &self,
        sets: &PointSets,
        set: std::ops::Range<usize>,
        flip: [u32; 2],
        azimuth: f32,
        rays: &mut RayBatch,
    ) {
        let flat = self.primitives.iter().all(|p| p.normal == self.primitives[0].normal);
        if flat {
            return turn(sets, set, turned_frame(self.primitives[0].normal, azimuth), 0, rays);
        }
        for (i, k) in set.enumerate() {
            let (p, _) = self.select(fraction(sets.origin_a[k] ^ flip[0]));
            turn(sets, k..k + 1, turned_frame(p.normal, azimuth), i, rays);
        }
    }
}

/// The largest f32 below one.
const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// A fixed-point fraction as a float in [0, 1). Signed integers convert in one vector instruction, unsigned ones do not.
fn fraction(x: u32) -> f32 {
    (x >> 8) as i32 as f32 * (1.0 / (1 << 24) as f32)
}

/// Frame about `normal` whose first axis is turned by `azimuth`.
fn turned_frame(normal: Vec3, azimuth: f32) -> [Vec3; 3] {
    let (t, b) = sampling::frame(normal);
    let (sin, cos) = azimuth.sin_cos();
    [t * cos + b * sin, b * cos - t * sin, normal]
}

/// Writes the directions of `points`, turned into the frame, from ray `at` on.
fn turn(sets: &PointSets, points: std::ops::Range<usize>, [t, b, n]: [Vec3; 3], at: usize, rays: &mut RayBatch) {
    let (dx, dy, dz) =
        (&sets.direction_x[points.clone()], &sets.direction_y[points.clone()], &sets.direction_z[points.clone()]);
    for axis in 0..3 {
        let out = match axis {
            0 => &mut rays.direction_x,
            1 => &mut rays.direction_y,
            _ => &mut rays.direction_z,
        };
        let (t, b, n) = (t[axis], b[axis], n[axis]);
        for (((o, &x), &y), &z) in out[at..at + points.len()].iter_mut().zip(dx).zip(dy).zip(dz) {
            *o = t * x + b * y + n * z;
        }
    }
}

/// `count` stratified points on every patch of `of`, one patch after the other: those that the first two coordinates
/// of `sampling::sobol4(k, seed)` choose, as [`crate::light::irradiance`] asks.
pub fn patch_points(simplified: &Simplified, of: &[u32], count: u32, seed: u64) -> Vec<SurfacePoint> {
    let places: Vec<[f32; 4]> = (0..count).map(|k| sampling::sobol4(k, seed)).collect();
    of.par_chunks(256)
        .flat_map_iter(|chunk| {
            let mut emitter = Emitter::default();
            let mut points = Vec::with_capacity(chunk.len() * count as usize);
            for &i in chunk {
                emitter.load(simplified, i as usize);
                points.extend(places.iter().map(|p| emitter.point(p[0], p[1])));
            }
            points
        })
        .collect()
}
