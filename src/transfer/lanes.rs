//! The loops over the rays of a patch, compiled for several processors; the widest that this one has is taken.
//!
//! Rust never contracts to fused multiply-add, so that all give the same bits.

use glam::Vec3;
use multiversion::multiversion;

/// The two fractions in [0, 1) of an origin of [`super::PointSets`]. Signed integers convert in one vector instruction,
/// unsigned ones do not.
#[inline(always)]
pub fn fractions(origin: u32) -> (f32, f32) {
    let fraction = |x: u32| x as i32 as f32 * (1.0 / (1 << 16) as f32);
    (fraction(origin >> 16), fraction(origin & 0xffff))
}

/// The largest f32 below one.
pub const BELOW_ONE: f32 = 1.0 - f32::EPSILON / 2.0;

/// A part of a patch, with all that a ray from it needs.
#[derive(Clone, Copy)]
pub struct Part {
    /// Shares of the patch's area before it, and up to and with it.
    pub begin: f32,
    pub end: f32,
    pub corner: Vec3,
    pub edge_u: Vec3,
    pub edge_v: Vec3,
    /// 0.5 for a triangle, 0 for a parallelogram.
    pub fold: f32,
}

impl Part {
    /// The place on the part of share `a` of the patch's area, begin <= a < end, and the fraction `b` across.
    #[inline(always)]
    pub fn point(&self, a: f32, b: f32) -> Vec3 {
        let a = ((a - self.begin) * (1.0 / (self.end - self.begin))).clamp(0.0, BELOW_ONE);
        // As `sampling::triangle`.
        let fold = self.fold * a.min(b);
        self.corner + (a - fold) * self.edge_u + (b - fold) * self.edge_v
    }
}

/// For those rays whose first fraction, after flipping bits, falls on the part: the origin. All of one length.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub fn place(out: [&mut [f32]; 3], origins: &[u32], flip: u32, part: &Part) {
    let [x, y, z] = out;
    for (((x, y), z), &origin) in x.iter_mut().zip(y).zip(z).zip(origins) {
        let (a, b) = fractions(origin ^ flip);
        let here = a >= part.begin && a < part.end;
        let p = part.point(a, b);
        *x = if here { p.x } else { *x };
        *y = if here { p.y } else { *y };
        *z = if here { p.z } else { *z };
    }
}

/// The directions in the frame `axes`. All of one length.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub fn turn(out: [&mut [f32]; 3], [dx, dy, dz]: [&[f32]; 3], axes: [Vec3; 3]) {
    let [x, y, z] = out;
    for (((((x, y), z), &dx), &dy), &dz) in x.iter_mut().zip(y).zip(z).zip(dx).zip(dy).zip(dz) {
        let d = turned([dx, dy, dz], &axes);
        (*x, *y, *z) = (d.x, d.y, d.z);
    }
}

/// The same for those rays that [`place`] puts on the part.
#[multiversion(targets("x86_64+avx512f", "x86_64+avx2"))]
pub fn turn_some(
    out: [&mut [f32]; 3],
    [dx, dy, dz]: [&[f32]; 3],
    axes: [Vec3; 3],
    origins: &[u32],
    flip: u32,
    part: &Part,
) {
    let [x, y, z] = out;
    for ((((((x, y), z), &dx), &dy), &dz), &origin) in x.iter_mut().zip(y).zip(z).zip(dx).zip(dy).zip(dz).zip(origins) {
        let (a, _) = fractions(origin ^ flip);
        let here = a >= part.begin && a < part.end;
        let d = turned([dx, dy, dz], &axes);
        *x = if here { d.x } else { *x };
        *y = if here { d.y } else { *y };
        *z = if here { d.z } else { *z };
    }
}

/// A direction in the frame `axes`.
#[inline(always)]
pub fn turned([x, y, z]: [f32; 3], [t, b, n]: &[Vec3; 3]) -> Vec3 {
    Vec3::new(t.x * x + b.x * y + n.x * z, t.y * x + b.y * y + n.y * z, t.z * x + b.z * y + n.z * z)
}
