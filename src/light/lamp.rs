//! One light that stands somewhere, and what it gives without occluders.

use std::f64::consts::PI;

use glam::{DVec3, Vec3};

use super::form;
use crate::{
    sampling,
    scene::SurfacePoint,
    scene::{Light, RAY_OFFSET},
};

/// A light with its colour: radiance, radiant intensity or irradiance at normal incidence, by shape.
#[derive(Clone, Debug)]
pub(super) struct Lamp {
    pub shape: Shape,
    pub colour: Vec3,
    /// Whether it is a triangle (or two) of the scene.
    pub surface: bool,
}

#[derive(Clone, Debug)]
pub(super) enum Shape {
    Polygon(Polygon),
    Disc { centre: Vec3, normal: Vec3, radius: f32 },
    Point { position: Vec3, range: f32 },
    Spot { position: Vec3, direction: Vec3, cos_inner: f32, cos_outer: f32, range: f32 },
    Sun { direction: Vec3 },
}

/// A triangle, or a parallelogram whose corners 1 and 3 are next to corner 0.
#[derive(Clone, Debug)]
pub(super) struct Polygon {
    pub corners: [Vec3; 4],
    pub count: usize,
    pub normal: Vec3,
    pub area: f32,
    /// Of the circle about the mean of the corners that holds them.
    pub radius: f32,
    pub both_sides: bool,
}

#[derive(Clone, Debug)]
/// Bounds of a lamp for the light tree.
pub(super) struct Bounds {
    pub low: Vec3,
    pub high: Vec3,
    /// Axis of the cone of surface normals (or of directions, for a spot).
    pub axis: Vec3,
    /// Half-angle of that cone, radians.
    pub spread: f32,
    /// Irradiance x squared distance at normal incidence on the axis, mean of the channels.
    pub strength: f64,
}

impl Polygon {
    /// `corners`: 3, or 4 of a parallelogram, counter-clockwise as seen from the front. None without area.
    pub fn new(corners: &[Vec3], both_sides: bool) -> Option<Polygon> {
        let count = corners.len().min(4);
        let mut four = [*corners.last()?; 4];
        four[..count].copy_from_slice(&corners[..count]);
        let c = four.map(Vec3::as_dvec3);
        let cross = (c[1] - c[0]).cross(c[count - 1] - c[0]);
        let area = cross.length() * if count == 4 { 1.0 } else { 0.5 };
        if !(area > 0.0 && area.is_finite()) {
            return None;
        }
        let centre = c[..count].iter().sum::<DVec3>() / count as f64;
        let radius = c[..count].iter().map(|p| p.distance(centre)).fold(0.0, f64::max);
        Some(Polygon {
            corners: four,
            count,
            normal: cross.normalize().as_vec3(),
            area: area as f32,
            radius: radius as f32,
            both_sides,
        })
    }

    pub fn relative_corners(&self, x: Vec3) -> [DVec3; 4] {
        self.corners.map(|c| c.as_dvec3() - x.as_dvec3())
    }

    /// The point at (u, v) of the unit square, uniform by area.
    pub fn point(&self, u: f32, v: f32) -> Vec3 {
        let [a, b, .., d] = self.corners;
        let (u, v) = if self.count == 4 { (u, v) } else { sampling::triangle(u, v) };
        a + u * (b - a) + v * (d - a)
    }

    /// Distance of `x` from the polygon; for a triangle that of its parallelogram.
    pub fn distance(&self, x: Vec3) -> f32 {
        let (u, v, d) = (self.corners[1] - self.corners[0], self.corners[3] - self.corners[0], x - self.corners[0]);
        // The nearest point of an oblique parallelogram is not exactly at the clamped coordinates: near enough.
        let (uu, uv, vv, du, dv) = (u.dot(u), u.dot(v), v.dot(v), d.dot(u), d.dot(v));
        let det = uu * vv - uv * uv;
        let (s, t) = ((du * vv - dv * uv) / det, (dv * uu - du * uv) / det);
        (d - s.clamp(0.0, 1.0) * u - t.clamp(0.0, 1.0) * v).length()
    }

    /// Signed distance of `x` from the polygon's plane if light leaves towards it, else 0.
    ///
    /// Rays start [`RAY_OFFSET`] off their surfaces. What faces the lamp from nearer than that is no receiver: its
    /// rays would start behind the lamp, and those of the lamp pass it and are counted at what lies beyond.
    pub fn front_distance(&self, x: &SurfacePoint) -> f64 {
        let normal = self.normal.as_dvec3();
        let height = normal.dot(x.position.as_dvec3() - self.corners[0].as_dvec3());
        let of_origin = height + RAY_OFFSET as f64 * normal.dot(x.normal.as_dvec3());
        let is_before = if self.both_sides { height * of_origin > 0.0 } else { height > 0.0 && of_origin > 0.0 };
        if is_before { height } else { 0.0 }
    }
}

impl Lamp {
    /// The lamp of a light of the scene; none if it is the sky, gives no light or is not finite.
    pub fn new(light: &Light) -> Option<Lamp> {
        let (shape, colour) = match *light {
            Light::Rectangle { corner, edge_u, edge_v, radiance } => {
                let corners = [corner, corner + edge_u, corner + edge_u + edge_v, corner + edge_v];
                (Shape::Polygon(Polygon::new(&corners, false)?), radiance)
            }
            Light::Disc { centre, normal, radius, radiance } => {
                (Shape::Disc { centre, normal: normal.try_normalize()?, radius }, radiance)
            }
            Light::Point { position, intensity, range } => (Shape::Point { position, range }, intensity),
            Light::Spot { position, direction, intensity, cos_inner, cos_outer, range } => {
                let direction = direction.try_normalize()?;
                (Shape::Spot { position, direction, cos_inner, cos_outer, range }, intensity)
            }
            Light::Sun { direction, irradiance } => (Shape::Sun { direction: direction.try_normalize()? }, irradiance),
            Light::Sky { .. } | Light::Environment(_) => return None,
        };
        let lamp = Lamp { shape, colour, surface: false };
        (lamp.is_finite() && lamp.colour != Vec3::ZERO).then_some(lamp)
    }

    /// The polygon, if it is one.
    pub fn polygon(&self) -> Option<&Polygon> {
        match &self.shape {
            Shape::Polygon(p) => Some(p),
            _ => None,
        }
    }

    /// Whether every number of it is usable.
    fn is_finite(&self) -> bool {
        self.colour.is_finite()
            && self.colour.min_element() >= 0.0
            && match &self.shape {
                Shape::Polygon(p) => p.corners.iter().all(|c| c.is_finite()),
                Shape::Disc { centre, radius, .. } => centre.is_finite() && radius.is_finite() && *radius > 0.0,
                Shape::Point { position, range } => position.is_finite() && *range > 0.0,
                Shape::Spot { position, range, cos_inner, cos_outer, .. } => {
                    position.is_finite() && *range > 0.0 && cos_inner.is_finite() && cos_outer.is_finite()
                }
                Shape::Sun { direction } => direction.is_finite(),
            }
    }

    /// Emitted power, W / scale^2, by unit colour; 0 for a sun, whose power has no bound.
    pub fn power(&self) -> f64 {
        match &self.shape {
            Shape::Polygon(p) => PI * p.area as f64 * if p.both_sides { 2.0 } else { 1.0 },
            Shape::Disc { radius, .. } => PI * PI * (*radius as f64).powi(2),
            Shape::Point { .. } => 4.0 * PI,
            Shape::Spot { cos_inner, cos_outer, .. } => {
                let (inner, outer) = (*cos_inner as f64, *cos_outer as f64);
                2.0 * PI * (1.0 - inner + (inner - outer).max(0.0) / 3.0)
            }
            Shape::Sun { .. } => 0.0,
        }
    }

    /// The share of its light that is left at this distance: less than all within the range of a point or spot.
    pub fn window(&self, distance: f64) -> f64 {
        match self.shape {
            Shape::Point { range, .. } | Shape::Spot { range, .. } => window(distance * distance, range),
            _ => 1.0,
        }
    }

    /// Irradiance at `x` by unit colour if nothing stood between. Finite, not negative.
    pub fn unshadowed(&self, x: &SurfacePoint) -> f64 {
        let normal = x.normal.as_dvec3();
        match &self.shape {
            Shape::Polygon(p) => {
                if p.front_distance(x) == 0.0 {
                    return 0.0;
                }
                let corners = p.relative_corners(x.position);
                let corners = &corners[..p.count];
                // What lies in the receiver's own plane, but for rounding, would fill its sky by Lambert's formula.
                if corners.iter().all(|&c| normal.dot(c) <= RAY_OFFSET as f64) {
                    return 0.0;
                }
                let centre = corners.iter().sum::<DVec3>() / p.count as f64;
                let reach = form::FAR * p.radius as f64;
                if centre.length_squared() > reach * reach && corners.iter().all(|&c| normal.dot(c) > 0.0) {
                    form::far_polygon(corners, normal)
                } else {
                    form::polygon(corners, normal)
                }
            }
            Shape::Disc { centre, normal: axis, radius } => {
                let centre = centre.as_dvec3() - x.position.as_dvec3();
                // As of `Polygon::front_distance`.
                let height = -centre.dot(axis.as_dvec3());
                if height <= 0.0 || height + RAY_OFFSET as f64 * normal.dot(axis.as_dvec3()) <= 0.0 {
                    return 0.0;
                }
                form::disc(centre, axis.as_dvec3(), *radius as f64, normal)
            }
            Shape::Point { position, range } => from_point(position.as_dvec3() - x.position.as_dvec3(), normal, *range),
            Shape::Spot { position, direction, cos_inner, cos_outer, range } => {
                let to_light = position.as_dvec3() - x.position.as_dvec3();
                let cos = -to_light.normalize_or_zero().dot(direction.as_dvec3());
                cone(cos, *cos_inner as f64, *cos_outer as f64) * from_point(to_light, normal, *range)
            }
            Shape::Sun { direction } => (-normal.dot(direction.as_dvec3())).max(0.0),
        }
    }

    /// Whether one shadow ray a point says everything.
    pub fn is_point_like(&self) -> bool {
        !matches!(self.shape, Shape::Polygon(_) | Shape::Disc { .. })
    }

    /// Bounds for the light tree; none for a sun.
    pub fn bounds(&self) -> Option<Bounds> {
        use std::f32::consts::PI;
        let weight = super::sky::mean(self.colour);
        Some(match &self.shape {
            Shape::Polygon(p) => {
                let corners = &p.corners[..p.count];
                Bounds {
                    low: corners.iter().copied().fold(Vec3::INFINITY, Vec3::min),
                    high: corners.iter().copied().fold(Vec3::NEG_INFINITY, Vec3::max),
                    axis: p.normal,
                    spread: if p.both_sides { PI } else { 0.0 },
                    strength: weight * p.area as f64,
                }
            }
            Shape::Disc { centre, normal, radius } => Bounds {
                low: *centre - Vec3::splat(*radius),
                high: *centre + Vec3::splat(*radius),
                axis: *normal,
                spread: 0.0,
                strength: weight * std::f64::consts::PI * (*radius as f64).powi(2),
            },
            Shape::Point { position, .. } => {
                Bounds { low: *position, high: *position, axis: Vec3::Y, spread: PI, strength: weight }
            }
            Shape::Spot { position, direction, cos_outer, .. } => Bounds {
                low: *position,
                high: *position,
                axis: *direction,
                spread: cos_outer.clamp(-1.0, 1.0).acos(),
                strength: weight,
            },
            Shape::Sun { .. } => return None,
        })
    }
}

/// The range window of KHR_lights_punctual at a squared distance.
fn window(d2: f64, range: f32) -> f64 {
    (1.0 - (d2 / (range as f64).powi(2)).powi(2)).clamp(0.0, 1.0)
}

/// cos / d^2 with the range window. A light nearer than a ray's offset counts as that far.
fn from_point(to_light: DVec3, normal: DVec3, range: f32) -> f64 {
    let d2 = to_light.length_squared();
    let nearest = (RAY_OFFSET as f64).powi(2);
    if d2 < nearest * 1e-6 {
        return 0.0;
    }
    window(d2, range) * normal.dot(to_light).max(0.0) / (d2.sqrt() * d2.max(nearest))
}

/// Angular fall-off of KHR_lights_punctual.
fn cone(cos: f64, cos_inner: f64, cos_outer: f64) -> f64 {
    let t = ((cos - cos_outer) / (cos_inner - cos_outer).max(1e-6)).clamp(0.0, 1.0);
    t * t
}
