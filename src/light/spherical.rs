//! Uniform directions towards a polygon.

use std::f64::consts::PI;

use glam::DVec3;

use super::form::MAX_CORNERS;

const MAX_TRIANGLES: usize = MAX_CORNERS - 2;

/// A convex polygon projected on the unit sphere about the receiver, as a fan of spherical triangles.
#[derive(Clone, Copy, Debug)]
pub(super) struct SphericalPolygon {
    triangles: [SphericalTriangle; MAX_TRIANGLES],
    count: usize,
    solid_angle: f64,
}

#[derive(Clone, Copy, Debug, Default)]
struct SphericalTriangle {
    a: DVec3,
    b: DVec3,
    /// Unit tangent at `a` towards `c`.
    tangent: DVec3,
    cos_c: f64,
    alpha_cos: f64,
    alpha_sin: f64,
    solid_angle: f64,
}

impl SphericalPolygon {
    /// `corners` relative to the receiver; none if the polygon's solid angle is too small to be told from rounding.
    pub fn new(corners: &[DVec3]) -> Option<SphericalPolygon> {
        let mut polygon =
            SphericalPolygon { triangles: [SphericalTriangle::default(); MAX_TRIANGLES], count: 0, solid_angle: 0.0 };
        let apex = corners.first()?.normalize_or_zero();
        for pair in corners[1..].windows(2) {
            if let Some(t) = SphericalTriangle::new(apex, pair[0].normalize_or_zero(), pair[1].normalize_or_zero()) {
                polygon.triangles[polygon.count] = t;
                polygon.count += 1;
                polygon.solid_angle += t.solid_angle;
            }
        }
        (polygon.solid_angle > 1e-9).then_some(polygon)
    }

    /// Steradians.
    pub fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// A unit direction, uniform in the polygon's solid angle.
    pub fn sample(&self, u: f64, v: f64) -> DVec3 {
        // The choice of the triangle uses up part of u and gives the rest on.
        let mut u = u * self.solid_angle;
        for t in &self.triangles[..self.count - 1] {
            if u < t.solid_angle {
                return t.sample(u / t.solid_angle, v);
            }
            u -= t.solid_angle;
        }
        let last = &self.triangles[self.count - 1];
        last.sample((u / last.solid_angle).min(1.0), v)
    }
}

impl SphericalTriangle {
    fn new(a: DVec3, b: DVec3, c: DVec3) -> Option<SphericalTriangle> {
        // Girard: the solid angle by Van Oosterom & Strackee 1983, which keeps its digits for small triangles.
        let volume = a.dot(b.cross(c)).abs();
        let solid_angle = 2.0 * volume.atan2(1.0 + a.dot(b) + b.dot(c) + c.dot(a));
        let ab = (b - a * a.dot(b)).try_normalize()?;
        let tangent = (c - a * a.dot(c)).try_normalize()?;
        let alpha_cos = ab.dot(tangent).clamp(-1.0, 1.0);
        let alpha_sin = ab.cross(tangent).length();
        (solid_angle > 0.0 && solid_angle < 2.0 * PI && alpha_sin > 0.0).then_some(SphericalTriangle {
            a,
            b,
            tangent,
            cos_c: a.dot(b),
            alpha_cos,
            alpha_sin,
            solid_angle,
        })
    }

    /// Arvo 1995: the triangle (a, b, c') that has fraction u of the area, then a point on the arc from b to c'.
    fn sample(&self, u: f64, v: f64) -> DVec3 {
        let (sin_area, cos_area) = (u * self.solid_angle).sin_cos();
        let s = sin_area * self.alpha_cos - cos_area * self.alpha_sin;
        let t = cos_area * self.alpha_cos + sin_area * self.alpha_sin;
        let p = t - self.alpha_cos;
        let q = s + self.alpha_sin * self.cos_c;
        let numerator = (q * t - p * s) * self.alpha_cos - q;
        let denominator = (q * s + p * t) * self.alpha_sin;
        let cos = if denominator != 0.0 { (numerator / denominator).clamp(-1.0, 1.0) } else { 1.0 };
        let c = self.a * cos + self.tangent * (1.0 - cos * cos).max(0.0).sqrt();
        let z = 1.0 - v * (1.0 - c.dot(self.b));
        let across = (c - self.b * c.dot(self.b)).normalize_or_zero();
        self.b * z + across * (1.0 - z * z).max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_octant_is_an_eighth_of_the_sphere_and_its_samples_have_the_mean_of_the_octant() {
        let polygon = SphericalPolygon::new(&[DVec3::X, DVec3::Y * 3.0, DVec3::Z * 0.1]).unwrap();
        assert!((polygon.solid_angle() - PI / 2.0).abs() < 1e-12);
        let n = 256;
        let mut mean = DVec3::ZERO;
        for i in 0..n * n {
            let d = polygon.sample(((i % n) as f64 + 0.5) / n as f64, ((i / n) as f64 + 0.5) / n as f64);
            assert!((d.length() - 1.0).abs() < 1e-9 && d.min_element() >= -1e-9, "{d}");
            mean += d / (n * n) as f64;
        }
        // The mean height over an octant is 1/2; the midpoint rule on 256 x 256 cells is good to 1e-4.
        assert!((mean - DVec3::splat(0.5)).abs().max_element() < 1e-4, "{mean}");
    }

    #[test]
    fn degenerate_polygons_are_refused() {
        assert!(SphericalPolygon::new(&[]).is_none());
        assert!(SphericalPolygon::new(&[DVec3::X, DVec3::X, DVec3::X]).is_none());
        assert!(SphericalPolygon::new(&[DVec3::ZERO, DVec3::X, DVec3::Y]).is_none());
    }
}
