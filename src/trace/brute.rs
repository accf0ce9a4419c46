//! The test oracle: every ray against every triangle, in double precision.

use glam::DVec3;

use super::{Geometry, Hit, RayBatch, RayTracer};

/// Tests every triangle; exact up to rounding in f64, and slow.
pub struct Brute {
    triangles: Vec<[DVec3; 3]>,
}

impl Brute {
    /// Takes the triangles.
    pub fn new(geometry: &Geometry) -> Brute {
        let corner = |i: u32| geometry.positions[i as usize].as_dvec3();
        Brute { triangles: geometry.triangles.iter().map(|t| t.map(corner)).collect() }
    }

    fn closest(&self, rays: &RayBatch, i: usize) -> Hit {
        let (o, d) = (rays.origin(i).as_dvec3(), rays.direction(i).as_dvec3());
        let (t_min, mut t_max) = (rays.t_min[i], rays.t_max[i]);
        let mut hit = Hit::NONE;
        for (k, tri) in self.triangles.iter().enumerate() {
            if let Some((t, u, v, back)) = intersect(o, d, tri)
                // Compared as it is reported, so that both ends are exclusive for the caller.
                && t as f32 > t_min
                && (t as f32) < t_max
            {
                t_max = t as f32;
                hit = Hit { t: t_max, u: u as f32, v: v as f32, face: (k as u32) << 1 | back as u32 };
            }
        }
        hit
    }
}

/// Moeller & Trumbore 1997: (t, u, v, back side) of the ray's meeting with the triangle's plane, if inside.
fn intersect(o: DVec3, d: DVec3, tri: &[DVec3; 3]) -> Option<(f64, f64, f64, bool)> {
    let (e1, e2) = (tri[1] - tri[0], tri[2] - tri[0]);
    let p = d.cross(e2);
    let det = e1.dot(p);
    if det == 0.0 {
        return None;
    }
    let s = o - tri[0];
    let u = s.dot(p) / det;
    let q = s.cross(e1);
    let v = d.dot(q) / det;
    if !(u >= 0.0 && v >= 0.0 && u + v <= 1.0) {
        return None;
    }
    let t = e2.dot(q) / det;
    // det = -d . n: a positive determinant means that the ray meets the front.
    Some((t, u, v, det < 0.0))
}

impl RayTracer for Brute {
    fn name(&self) -> String {
        "brute force".into()
    }

    fn closest_hits(&self, rays: &RayBatch, hits: &mut [Hit]) {
        for (i, hit) in hits.iter_mut().enumerate() {
            *hit = self.closest(rays, i);
        }
    }

    fn occluded(&self, rays: &RayBatch, occluded: &mut [bool]) {
        for (i, o) in occluded.iter_mut().enumerate() {
            *o = self.closest(rays, i).is_hit();
        }
    }
}
