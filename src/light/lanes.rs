//! What lamps give to many samples at once, compiled for several processors; the widest that this one has is taken.
//!
//! These are the formulas of `form`, `lamp` and `aim` a second time: there they are for any lamp, in f64 and with branches
//! that spare most of the work; here f32 without branches or calls, or the compiler would make no vectors of them. The
//! tests of `stream` hold the two against each other.
//!
//! Rust never contracts to fused multiply-add, so that all give the same bits.
#![allow(clippy::needless_range_loop)] // Loops over lanes step through several arrays at once.

use std::ops::Range;

use glam::Vec3;
use multiversion::multiversion;

use crate::{scene::RAY_OFFSET, trace::RayBatch};

/// Samples as a structure of arrays, all of one length: places of receivers, numbers, and what comes of them.
#[derive(Default)]
pub(super) struct Lanes {
    /// Position of the receiver.
    pub px: Vec<f32>,
    pub py: Vec<f32>,
    pub pz: Vec<f32>,
    /// Its normal.
    pub nx: Vec<f32>,
    pub ny: Vec<f32>,
    pub nz: Vec<f32>,
    /// The place on the lamp, in the unit square.
    pub u: Vec<f32>,
    pub v: Vec<f32>,
    /// Shadow rays; where there is no light they end where they start.
    pub rays: RayBatch,
    /// Irradiance by unit colour, divided by the density of the choice; 0 if there is none.
    pub weight: Vec<f32>,
    /// Irradiance by unit colour if nothing stood between: of all the lamp, or of the place on it.
    pub open: Vec<f32>,
    /// Squared distance from the middle of the lamp.
    pub away: Vec<f32>,
    /// Height of the lamp's lowest and highest corner above the receiver's horizon; the highest is 0 from behind the lamp.
    pub low: Vec<f32>,
    pub high: Vec<f32>,
}

/// A triangle, or a parallelogram whose corners 1 and 3 are next to corner 0. A triangle's last corner stands twice.
pub(super) struct Flat {
    pub corners: [Vec3; 4],
    pub edge_u: Vec3,
    pub edge_v: Vec3,
    /// 0.5 for a triangle, 0 for a parallelogram.
    pub fold: f32,
    pub normal: Vec3,
    pub area: f32,
    pub centre: Vec3,
    pub both_sides: bool,
    /// Places and shares of the area of a quadrature.
    pub nodes: Vec<(Vec3, f32)>,
}

/// A point, perhaps with a cone.
pub(super) struct Small {
    pub position: Vec3,
    pub range: f32,
    pub direction: Vec3,
    pub cos_inner: f32,
    pub cos_outer: f32,
}

impl Small {
    /// A point that shines everywhere.
    pub fn point(position: Vec3, range: f32) -> Small {
        // Every cosine is past such a cone's inner one.
        Small { position, range, direction: Vec3::Y, cos_inner: -2.0, cos_outer: -3.0 }
    }
}

impl Lanes {
    /// Makes room for `n` samples, in whole blocks.
    pub fn resize(&mut self, n: usize) {
        let n = n.next_multiple_of(WIDTH);
        let places = [&mut self.px, &mut self.py, &mut self.pz, &mut self.nx, &mut self.ny, &mut self.nz];
        let numbers = [&mut self.u, &mut self.v];
        let found = [&mut self.weight, &mut self.open, &mut self.away, &mut self.low, &mut self.high];
        for v in places.into_iter().chain(numbers).chain(found) {
            v.resize(n, 0.0);
        }
        self.rays.resize(n);
    }
}

/// Samples that are computed together. Loops over arrays of fixed size become vector instructions; loops over slices would
/// first have to be proved not to overlap.
pub(super) const WIDTH: usize = 16;

/// One number of each sample of a block.
pub(super) type Block = [f32; WIDTH];

pub(super) const NONE: Block = [0.0; WIDTH];

/// The block of samples that begins at `at`.
#[inline(always)]
pub(super) fn load<const N: usize>(columns: [&[f32]; N], at: usize) -> [Block; N] {
    // Not `map`, which would be a call without vector instructions.
    let mut blocks = [NONE; N];
    for (block, column) in blocks.iter_mut().zip(columns) {
        if let Some(from) = column[at..].first_chunk() {
            *block = *from;
        }
    }
    blocks
}

#[inline(always)]
fn store<const N: usize>(columns: [&mut [f32]; N], at: usize, blocks: &[Block; N]) {
    for (column, block) in columns.into_iter().zip(blocks) {
        if let Some(to) = column[at..].first_chunk_mut() {
            *to = *block;
        }
    }
}

impl Lanes {
    #[inline(always)]
    fn places(&self, at: usize) -> [Block; 6] {
        load([&self.px, &self.py, &self.pz, &self.nx, &self.ny, &self.nz], at)
    }

    #[inline(always)]
    fn store_rays(&mut self, at: usize, rays: &[Block; 8]) {
        let RayBatch { origin_x, origin_y, origin_z, direction_x, direction_y, direction_z, t_min, t_max, .. } =
            &mut self.rays;
        let columns: [&mut [f32]; 8] =
            [origin_x, origin_y, origin_z, direction_x, direction_y, direction_z, t_min, t_max];
        store(columns, at, rays);
    }
}

/// Position and normal of sample `i` of a block.
#[inline(always)]
fn receiver(places: &[Block; 6], i: usize) -> (Vec3, Vec3) {
    let [px, py, pz, nx, ny, nz] = places;
    (Vec3::new(px[i], py[i], pz[i]), Vec3::new(nx[i], ny[i], nz[i]))
}

#[inline(always)]
fn get(v: &[Block; 3], i: usize) -> Vec3 {
    Vec3::new(v[0][i], v[1][i], v[2][i])
}

#[inline(always)]
fn set(v: &mut [Block; 3], i: usize, value: Vec3) {
    (v[0][i], v[1][i], v[2][i]) = (value.x, value.y, value.z);
}

/// Enters the ray of sample `i` of a block.
#[inline(always)]
fn set_ray(rays: &mut [Block; 8], i: usize, origin: Vec3, direction: Vec3, t: [f32; 2]) {
    let values = [origin.x, origin.y, origin.z, direction.x, direction.y, direction.z, t[0], t[1]];
    for k in 0..8 {
        rays[k][i] = values[k];
    }
}

/// Shadow rays to a triangle or parallelogram, their weights, and where it stands.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn flat(lanes: &mut Lanes, lamp: &Flat) {
    for at in (0..lanes.px.len()).step_by(WIDTH) {
        let places = lanes.places(at);
        let [u, v] = load([&lanes.u, &lanes.v], at);
        let (mut rays, mut found) = ([NONE; 8], [NONE; 4]);
        for i in 0..WIDTH {
            let (p, normal) = receiver(&places, i);
            let fold = lamp.fold * if u[i] < v[i] { u[i] } else { v[i] };
            let target = add(lamp.corners[0], add(scale(u[i] - fold, lamp.edge_u), scale(v[i] - fold, lamp.edge_v)));
            let to = sub(target, p);
            let r2 = dot(to, to);
            let (height, before) = before(lamp, p, normal);
            let w = dot(normal, to) * height.abs() * lamp.area / (r2 * r2);
            let lit = before & is_unit(normal) & (w > 0.0) & (w < f32::MAX);

            let origin = add(p, scale(RAY_OFFSET, normal));
            let d = sub(add(target, scale(RAY_OFFSET.copysign(height), lamp.normal)), origin);
            let t_min = RAY_OFFSET / dot(d, d).sqrt();
            set_ray(&mut rays, i, origin, d, [t_min, if lit { 1.0 } else { 0.0 }]);

            let [a, b, c, e] = lamp.corners;
            let h = [dot(normal, sub(a, p)), dot(normal, sub(b, p)), dot(normal, sub(c, p)), dot(normal, sub(e, p))];
            let (low, high) =
                (least(least(h[0], h[1]), least(h[2], h[3])), -least(least(-h[0], -h[1]), least(-h[2], -h[3])));
            let middle = sub(lamp.centre, p);
            found[0][i] = if lit { w } else { 0.0 };
            found[1][i] = dot(middle, middle);
            found[2][i] = low;
            found[3][i] = if before { high } else { 0.0 };
        }
        lanes.store_rays(at, &rays);
        let columns: [&mut [f32]; 4] = [&mut lanes.weight, &mut lanes.away, &mut lanes.low, &mut lanes.high];
        store(columns, at, &found);
    }
}

/// What all of the polygon gives to the samples in `own`, by Lambert's formula: half the sum over the outline, clipped by
/// the horizon, of angle x (normal of the receiver . normal of the edge's plane). What comes after them is overwritten.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn outline(lanes: &mut Lanes, lamp: &Flat, own: Range<usize>) {
    for at in own.step_by(WIDTH) {
        let places = lanes.places(at);
        let (mut sum, mut highest) = (NONE, NONE);
        // Where the outline goes below the horizon, and where it comes up again.
        let (mut down, mut up) = ([NONE; 3], [NONE; 3]);
        for k in 0..4 {
            let (from, to) = (lamp.corners[k], lamp.corners[(k + 1) % 4]);
            for i in 0..WIDTH {
                let (p, normal) = receiver(&places, i);
                let (a, b) = (sub(from, p), sub(to, p));
                let (ha, hb) = (dot(normal, a), dot(normal, b));
                highest[i] = if ha > highest[i] { ha } else { highest[i] };
                let (goes_down, comes_up) = ((ha > 0.0) & (hb <= 0.0), (ha <= 0.0) & (hb > 0.0));
                let at = add(a, scale(ha / (ha - hb), sub(b, a)));
                let (lower, upper) = (select(goes_down, at, get(&down, i)), select(comes_up, at, get(&up, i)));
                set(&mut down, i, lower);
                set(&mut up, i, upper);
                let term = edge(select(comes_up, at, a), select(goes_down, at, b), normal);
                sum[i] += if (ha > 0.0) | (hb > 0.0) { term } else { 0.0 };
            }
        }
        let mut open = NONE;
        for i in 0..WIDTH {
            let (p, normal) = receiver(&places, i);
            let sum = sum[i] + edge(get(&down, i), get(&up, i), normal);
            let (_, before) = before(lamp, p, normal);
            // As `Lamp::unshadowed`: the receiver's own plane is no sky.
            open[i] = if before & (highest[i] > RAY_OFFSET) { 0.5 * sum.abs() } else { 0.0 };
        }
        store([&mut lanes.open[..]], at, &[open]);
    }
}

/// The same by quadrature: for polygons that lie above the horizon and far away (see `form::far_polygon`).
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn quadrature(lanes: &mut Lanes, lamp: &Flat, own: Range<usize>) {
    for at in own.step_by(WIDTH) {
        let places = lanes.places(at);
        let mut open = NONE;
        for &(node, area) in &lamp.nodes {
            for i in 0..WIDTH {
                let (p, normal) = receiver(&places, i);
                let to = sub(node, p);
                let r2 = dot(to, to);
                open[i] += area * dot(normal, to) / (r2 * r2);
            }
        }
        for i in 0..WIDTH {
            let (p, normal) = receiver(&places, i);
            let (height, before) = before(lamp, p, normal);
            open[i] = if before { open[i] * height.abs() } else { 0.0 };
        }
        store([&mut lanes.open[..]], at, &[open]);
    }
}

/// Height of a receiver above the polygon's plane, and whether light leaves towards it: as `Polygon::front_distance`.
#[inline(always)]
fn before(lamp: &Flat, p: Vec3, normal: Vec3) -> (f32, bool) {
    let height = dot(lamp.normal, sub(p, lamp.corners[0]));
    let of_origin = height + RAY_OFFSET * dot(lamp.normal, normal);
    let both = lamp.both_sides & (height * of_origin > 0.0);
    (height, both | ((height > 0.0) & (of_origin > 0.0)))
}

/// Shadow rays to a point or spot, and what it gives.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn small(lanes: &mut Lanes, lamp: &Small) {
    let per_range = 1.0 / (lamp.range * lamp.range);
    let per_cone = 1.0 / (lamp.cos_inner - lamp.cos_outer).max(1e-6);
    let nearest = RAY_OFFSET * RAY_OFFSET;
    for at in (0..lanes.px.len()).step_by(WIDTH) {
        let places = lanes.places(at);
        let (mut rays, mut weight) = ([NONE; 8], NONE);
        for i in 0..WIDTH {
            let (p, normal) = receiver(&places, i);
            let to = sub(lamp.position, p);
            let d2 = dot(to, to);
            let d = d2.sqrt();
            let far = d2 * per_range;
            let window = -least(far * far - 1.0, 0.0);
            let cone = (-dot(to, lamp.direction) / d - lamp.cos_outer) * per_cone;
            let cone = least(if cone > 0.0 { cone } else { 0.0 }, 1.0);
            // As `lamp::from_point`.
            let w = window * cone * cone * dot(normal, to) / (d * if d2 > nearest { d2 } else { nearest });
            let lit = (d2 >= 1e-6 * nearest) & is_unit(normal) & (w > 0.0) & (w < f32::MAX);
            weight[i] = if lit { w } else { 0.0 };
            let origin = add(p, scale(RAY_OFFSET, normal));
            let d = sub(lamp.position, origin);
            let t_min = RAY_OFFSET / dot(d, d).sqrt();
            set_ray(&mut rays, i, origin, d, [t_min, if lit { 1.0 } else { 0.0 }]);
        }
        lanes.store_rays(at, &rays);
        store([&mut lanes.weight[..], &mut lanes.open[..]], at, &[weight, weight]);
    }
}

/// Shadow rays to a light at infinity that travels in `direction`, and what it gives.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn sun(lanes: &mut Lanes, direction: Vec3) {
    for at in (0..lanes.px.len()).step_by(WIDTH) {
        let places = lanes.places(at);
        let (mut rays, mut weight) = ([NONE; 8], NONE);
        for i in 0..WIDTH {
            let (p, normal) = receiver(&places, i);
            let origin = add(p, scale(RAY_OFFSET, normal));
            let cos = -dot(direction, normal);
            let lit = is_unit(normal) & (cos > 0.0) & (dot(origin, origin) < f32::MAX);
            weight[i] = if lit { cos } else { 0.0 };
            set_ray(&mut rays, i, origin, scale(-1.0, direction), [RAY_OFFSET, if lit { f32::INFINITY } else { 0.0 }]);
        }
        lanes.store_rays(at, &rays);
        store([&mut lanes.weight[..], &mut lanes.open[..]], at, &[weight, weight]);
    }
}

/// As `SurfacePoint::is_sound`; places that are not finite give no weight that is a number.
#[inline(always)]
fn is_unit(normal: Vec3) -> bool {
    (dot(normal, normal) - 1.0).abs() < 0.01
}

/// The smaller of two; `f32::min` would take care of what is no number.
#[inline(always)]
fn least(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[inline(always)]
fn select(yes: bool, a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(if yes { a.x } else { b.x }, if yes { a.y } else { b.y }, if yes { a.z } else { b.z })
}

/// The angle under which edge `a` - `b` is seen from the origin times the component along `normal` of its plane's unit
/// normal; 0 for an edge without length.
#[inline(always)]
fn edge(a: Vec3, b: Vec3, normal: Vec3) -> f32 {
    let cross = Vec3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    let length = dot(cross, cross).sqrt();
    let length = if length > f32::MIN_POSITIVE { length } else { f32::MIN_POSITIVE };
    angle(length, dot(a, b)) * (dot(normal, cross) / length)
}

/// The angle of sine and cosine in proportion to `sin` (not negative) and `cos`, 0 to pi: arc tangents by the polynomial of
/// the Cephes library (Moshier 1992), relative error 2e-7.
#[inline(always)]
fn angle(sin: f32, cos: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    let (low, high) = if sin < cos.abs() { (sin, cos.abs()) } else { (cos.abs(), sin) };
    // atan(low / high), 0 to pi / 4; past tan(pi / 8) from pi / 4 down.
    let late = low > 0.414_213_56 * high;
    let (over, under) = if late { (low - high, low + high) } else { (low, high) };
    let t = over / if under > f32::MIN_POSITIVE { under } else { f32::MIN_POSITIVE };
    let z = t * t;
    let p = ((8.053_744_5e-2 * z - 1.387_768_6e-1) * z + 1.997_771_1e-1) * z - 3.333_295e-1;
    let small = p * z * t + t + if late { FRAC_PI_4 } else { 0.0 };
    let acute = if sin > cos.abs() { FRAC_PI_2 - small } else { small };
    if cos < 0.0 { PI - acute } else { acute }
}

// glam's own operators are too many calls for the vectoriser to see through.
#[inline(always)]
fn dot(a: Vec3, b: Vec3) -> f32 {
    a.x * b.x + a.y * b.y + a.z * b.z
}

#[inline(always)]
fn add(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(a.x + b.x, a.y + b.y, a.z + b.z)
}

#[inline(always)]
fn sub(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(a.x - b.x, a.y - b.y, a.z - b.z)
}

#[inline(always)]
fn scale(s: f32, a: Vec3) -> Vec3 {
    Vec3::new(s * a.x, s * a.y, s * a.z)
}
