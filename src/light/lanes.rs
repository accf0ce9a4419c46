//! What lamps give to many samples at once, compiled for several processors; the widest that this one has is taken.
//!
//! Rust never contracts to fused multiply-add, so that all give the same bits.

use glam::Vec3;
use multiversion::multiversion;

use crate::scene::{RAY_OFFSET, SurfacePoint};

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
    u: Vec<f32>,
    v: Vec<f32>,
    /// Shadow ray: from the receiver's displaced origin to its end.
    pub dx: Vec<f32>,
    pub dy: Vec<f32>,
    pub dz: Vec<f32>,
    /// Irradiance by unit colour, divided by the density of the choice; 0 if there is none.
    pub weight: Vec<f32>,
    /// Irradiance by unit colour from all of the lamp, if nothing stood between.
    pub open: Vec<f32>,
    /// Above zero where these numbers are not good enough: the lamp is close, or cut by the horizon.
    pub hard: Vec<f32>,
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
    /// Of the circle about the centre that holds the corners.
    pub radius: f32,
    pub both_sides: bool,
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

/// A polygon whose distance is below so many of its radii is close.
const CLOSE: f32 = 1.3;
/// A polygon is tiny from so many of its radii on: contour integrals lose their digits, while all of it is seen alike.
const TINY: f32 = 100.0;

impl Lanes {
    pub fn clear(&mut self) {
        for v in [&mut self.px, &mut self.py, &mut self.pz, &mut self.nx, &mut self.ny, &mut self.nz] {
            v.clear();
        }
        self.u.clear();
        self.v.clear();
    }

    pub fn push(&mut self, x: &SurfacePoint, u: f32, v: f32) {
        self.px.push(x.position.x);
        self.py.push(x.position.y);
        self.pz.push(x.position.z);
        self.nx.push(x.normal.x);
        self.ny.push(x.normal.y);
        self.nz.push(x.normal.z);
        self.u.push(u);
        self.v.push(v);
    }

    /// Gives what comes of the samples their number of places.
    fn make_room(&mut self) -> usize {
        let n = self.px.len();
        for v in [&mut self.dx, &mut self.dy, &mut self.dz, &mut self.weight, &mut self.open, &mut self.hard] {
            v.resize(n, 0.0);
        }
        n
    }
}

/// The inputs and outputs of a lane function as slices of one length.
macro_rules! lanes {
    ($lanes:ident, $n:ident, $($name:ident),+; $($out:ident),+) => {
        let $n = $lanes.make_room();
        $(let $name = &$lanes.$name[..$n];)+
        $(let $out = &mut $lanes.$out[..$n];)+
    };
}

/// A triangle or parallelogram.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn flat(lanes: &mut Lanes, lamp: &Flat) {
    lanes!(lanes, n, px, py, pz, nx, ny, nz, u, v; dx, dy, dz, weight, open, hard);
    let (close, tiny) = ((CLOSE * lamp.radius).powi(2), (TINY * lamp.radius).powi(2));
    for i in 0..n {
        let (p, normal) = (Vec3::new(px[i], py[i], pz[i]), Vec3::new(nx[i], ny[i], nz[i]));
        let fold = lamp.fold * u[i].min(v[i]);
        let target = add(lamp.corners[0], add(scale(u[i] - fold, lamp.edge_u), scale(v[i] - fold, lamp.edge_v)));
        let to = sub(target, p);
        let r2 = dot(to, to);
        // As `Polygon::front_distance`.
        let height = dot(lamp.normal, sub(p, lamp.corners[0]));
        let of_origin = height + RAY_OFFSET * dot(lamp.normal, normal);
        let both = lamp.both_sides & (height * of_origin > 0.0);
        let before = both | ((height > 0.0) & (of_origin > 0.0));
        let w = dot(normal, to) * height.abs() * lamp.area / (r2 * r2);
        let w = if before & (w > 0.0) & (w < f32::MAX) { w } else { 0.0 };
        let end = add(target, scale(RAY_OFFSET.copysign(height), lamp.normal));
        let direction = sub(end, add(p, scale(RAY_OFFSET, normal)));
        (dx[i], dy[i], dz[i]) = (direction.x, direction.y, direction.z);

        let c = [sub(lamp.corners[0], p), sub(lamp.corners[1], p), sub(lamp.corners[2], p), sub(lamp.corners[3], p)];
        let h = [dot(normal, c[0]), dot(normal, c[1]), dot(normal, c[2]), dot(normal, c[3])];
        let low = h[0].min(h[1]).min(h[2].min(h[3]));
        let high = h[0].max(h[1]).max(h[2].max(h[3]));
        let outline = edge(c[0], c[1], normal) + edge(c[1], c[2], normal) + (edge(c[2], c[3], normal) + edge(c[3], c[0], normal));
        let away = sub(lamp.centre, p);
        let d2 = dot(away, away);
        let exact = if d2 > tiny { w } else { 0.5 * outline.abs() };
        let seen = before & (high > 0.0);
        open[i] = if seen { exact } else { 0.0 };
        hard[i] = if seen & ((low < 0.0) | (d2 < close)) { 1.0 } else { 0.0 };
        weight[i] = w;
    }
}

/// A point or spot.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn small(lanes: &mut Lanes, lamp: &Small) {
    lanes!(lanes, n, px, py, pz, nx, ny, nz; dx, dy, dz, weight, open, hard);
    let per_range = 1.0 / (lamp.range * lamp.range);
    let per_cone = 1.0 / (lamp.cos_inner - lamp.cos_outer).max(1e-6);
    for i in 0..n {
        let (p, normal) = (Vec3::new(px[i], py[i], pz[i]), Vec3::new(nx[i], ny[i], nz[i]));
        let to = sub(lamp.position, p);
        let d2 = dot(to, to);
        let d = d2.sqrt();
        let far = d2 * per_range;
        let window = (1.0 - far * far).max(0.0);
        let cone = ((-dot(to, lamp.direction) / d - lamp.cos_outer) * per_cone).clamp(0.0, 1.0);
        // As `lamp::from_point`.
        let nearest = RAY_OFFSET * RAY_OFFSET;
        let w = window * cone * cone * dot(normal, to).max(0.0) / (d * d2.max(nearest));
        let w = if (d2 >= 1e-6 * nearest) & (w > 0.0) & (w < f32::MAX) { w } else { 0.0 };
        let direction = sub(lamp.position, add(p, scale(RAY_OFFSET, normal)));
        (dx[i], dy[i], dz[i]) = (direction.x, direction.y, direction.z);
        (weight[i], open[i], hard[i]) = (w, w, 0.0);
    }
}

/// A light at infinity that travels in `direction`.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub(super) fn sun(lanes: &mut Lanes, direction: Vec3) {
    lanes!(lanes, n, nx, ny, nz; dx, dy, dz, weight, open, hard);
    for i in 0..n {
        let w = (-dot(direction, Vec3::new(nx[i], ny[i], nz[i]))).max(0.0);
        (dx[i], dy[i], dz[i]) = (-direction.x, -direction.y, -direction.z);
        (weight[i], open[i], hard[i]) = (w, w, 0.0);
    }
}

/// The angle under which edge `a` - `b` is seen from the origin times the component along `normal` of its plane's unit
/// normal; 0 for an edge without length.
#[inline(always)]
fn edge(a: Vec3, b: Vec3, normal: Vec3) -> f32 {
    let cross = Vec3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x);
    let length = dot(cross, cross).sqrt();
    angle(length, dot(a, b)) * (dot(normal, cross) / length.max(f32::MIN_POSITIVE))
}

/// The angle of sine and cosine in proportion to `sin` (not negative) and `cos`, 0 to pi: arc tangents by the polynomial of
/// the Cephes library (Moshier 1992), relative error 2e-7.
#[inline(always)]
fn angle(sin: f32, cos: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    let (low, high) = (sin.min(cos.abs()), sin.max(cos.abs()));
    // atan(low / high), 0 to pi / 4; past tan(pi / 8) from pi / 4 down.
    let late = low > 0.414_213_56 * high;
    let (over, under) = if late { (low - high, low + high) } else { (low, high) };
    let t = over / under.max(f32::MIN_POSITIVE);
    let z = t * t;
    let p = ((8.053_744_5e-2 * z - 1.387_768_6e-1) * z + 1.997_771_1e-1) * z - 3.333_294_9e-1;
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
