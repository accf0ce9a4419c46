//! Rays from the surface of a patch.

use std::ops::Range;

use glam::{Vec2, Vec3};
use rayon::prelude::*;

use super::{
    PointSets,
    lanes::{self, Part},
};
use crate::{
    sampling,
    scene::RAY_OFFSET,
    scene::SurfacePoint,
    simplify::{Simplified, clip::point_at, normal_of},
    trace::RayBatch,
};

/// Up to so many parts, each goes through all rays and takes its own; beyond, each ray looks for its part.
const FEW: usize = 12;

/// Draws points and rays from patches, uniformly by area; keeps its memory from patch to patch.
#[derive(Default)]
pub struct Emitter {
    /// Triangles and parallelograms that make up the patch, and their normals.
    parts: Vec<Part>,
    normals: Vec<Vec3>,
    /// The part in which each of equal shares of the area begins; a power of two.
    guide: Vec<u32>,
    /// Frames of the parts' directions.
    frames: Vec<[Vec3; 3]>,
}

impl Emitter {
    /// Turns to patch `i`.
    pub fn load(&mut self, simplified: &Simplified, i: usize) {
        self.parts.clear();
        self.normals.clear();
        let mut total = 0.0_f64;
        for &member in simplified.patches.members(i) {
            let (f, side) = ((member >> 1) as usize, member & 1);
            let triangle = simplified.corners(simplified.fragments.triangle[f] as usize);
            let normal = normal_of(&triangle);
            let normal = if side == 1 { -normal } else { normal };
            let uv = simplified.fragments.uv(f);
            let corner = point_at(&triangle, uv[0]);
            let mut add = |p: Vec2, q: Vec2, parallelogram: bool| {
                let (edge_u, edge_v) = (point_at(&triangle, p) - corner, point_at(&triangle, q) - corner);
                let area = edge_u.as_dvec3().cross(edge_v.as_dvec3()).length();
                total += if parallelogram { area } else { 0.5 * area };
                let fold = if parallelogram { 0.0 } else { 0.5 };
                self.parts.push(Part { begin: 0.0, end: total as f32, corner, edge_u, edge_v, fold });
                self.normals.push(normal);
            };
            let scale = (uv[2] - uv[0]).abs().max_element();
            if uv.len() == 4 && (uv[0] + uv[2] - uv[1] - uv[3]).abs().max_element() < 1e-4 * scale {
                add(uv[1], uv[3], true);
            } else {
                uv[1..].windows(2).for_each(|w| add(w[0], w[1], false));
            }
        }
        let total = (total as f32).max(f32::MIN_POSITIVE);
        let mut begin = 0.0;
        for part in &mut self.parts {
            (part.begin, part.end) = (begin, part.end / total);
            begin = part.end;
        }
        if let Some(last) = self.parts.last_mut() {
            last.end = 1.0;
        }
        self.guide.clear();
        if self.parts.len() > FEW {
            let shares = self.parts.len().next_power_of_two();
            let mut first = 0;
            self.guide.extend((0..shares).map(|k| {
                while self.parts[first].end <= k as f32 / shares as f32 {
                    first += 1;
                }
                first as u32
            }));
        }
    }

    /// The part that holds share `a` of the area, 0 <= a < 1.
    #[inline]
    fn select(&self, a: f32) -> usize {
        let shares = self.guide.len() as f32;
        let mut k = if self.guide.is_empty() { 0 } else { self.guide[(a * shares) as usize] as usize };
        while self.parts[k].end <= a {
            k += 1;
        }
        k
    }

    /// A point of the patch for `a`, `b` in [0, 1).
    pub fn point(&self, a: f32, b: f32) -> SurfacePoint {
        let k = self.select(a);
        SurfacePoint { position: self.parts[k].point(a, b), normal: self.normals[k] }
    }

    /// Fills `rays` with one ray for each of the points `part` of a set, which is chosen by the bits of `random`.
    /// Directions are cosine-distributed about the normal of the surface at the origin.
    pub fn rays(&mut self, sets: &PointSets, part: Range<usize>, random: [u64; 2], rays: &mut RayBatch) {
        let first = sets.set(random[0]).start;
        let set = first + part.start..first + part.end;
        let azimuth = (random[0] >> 40) as f32 * (std::f32::consts::TAU / (1 << 24) as f32);
        let flip = random[1] as u32;
        if rays.len() != part.len() {
            rays.resize(part.len());
            rays.t_min.fill(0.0);
            rays.t_max.fill(f32::INFINITY);
        }
        rays.coherent = true;
        let origins = &sets.origin[set.clone()];
        let directions = sets.directions.each_ref().map(|of_axis| &of_axis[set.clone()]);
        let turn = azimuth.sin_cos();
        let flat = self.normals.iter().all(|n| *n == self.normals[0]);
        if flat {
            lanes::turn(rays.directions_mut(), directions, turned_frame(self.normals[0], turn));
        } else {
            self.frames.clear();
            self.frames.extend(self.normals.iter().map(|&n| turned_frame(n, turn)));
        }
        if self.parts.len() <= FEW {
            for (k, part) in self.parts.iter().enumerate() {
                let lifted = Part { corner: part.corner + RAY_OFFSET * self.normals[k], ..*part };
                lanes::place(rays.origins_mut(), origins, flip, &lifted);
                if !flat {
                    lanes::turn_some(rays.directions_mut(), directions, self.frames[k], origins, flip, part);
                }
            }
        } else {
            self.scatter(origins, directions, flip, flat, rays);
        }
    }

    /// Rays of a patch of many parts.
    fn scatter(&self, origins: &[u32], [dx, dy, dz]: [&[f32]; 3], flip: u32, flat: bool, rays: &mut RayBatch) {
        for (i, &origin) in origins.iter().enumerate() {
            let (a, b) = lanes::fractions(origin ^ flip);
            let k = self.select(a);
            let origin = self.parts[k].point(a, b) + RAY_OFFSET * self.normals[k];
            (rays.origin_x[i], rays.origin_y[i], rays.origin_z[i]) = origin.into();
            if !flat {
                let direction = lanes::turned([dx[i], dy[i], dz[i]], &self.frames[k]);
                (rays.direction_x[i], rays.direction_y[i], rays.direction_z[i]) = direction.into();
            }
        }
    }
}

/// Frame about `normal` whose first axis is turned by the azimuth with this sine and cosine.
fn turned_frame(normal: Vec3, (sin, cos): (f32, f32)) -> [Vec3; 3] {
    let (t, b) = sampling::frame(normal);
    [t * cos + b * sin, b * cos - t * sin, normal]
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
