//! Where to aim shadow rays: points of a lamp, chosen by area or by solid angle.

use glam::Vec3;

use super::{
    form,
    lamp::{Lamp, Polygon, Shape},
    spherical::SphericalPolygon,
};
use crate::{sampling, scene::RAY_OFFSET, scene::SurfacePoint};

/// Where a shadow ray ends and what its arrival is worth.
pub(super) struct Aim {
    /// From the receiver's displaced origin; need not be a unit vector.
    pub direction: Vec3,
    /// End of the ray in units of `direction`.
    pub t_max: f32,
    /// Irradiance by unit colour, divided by the density of the choice.
    pub weight: f64,
}

impl Aim {
    /// Towards the middle of a lamp, without weight.
    pub fn idle(lamp: &Lamp, x: &SurfacePoint) -> Aim {
        let (direction, t_max) = match (&lamp.shape, lamp.bounds()) {
            (_, Some(b)) => (0.5 * (b.low + b.high) - origin(x), 1.0),
            (Shape::Sun { direction }, None) => (-*direction, f32::INFINITY),
            (_, None) => (Vec3::ZERO, 0.0),
        };
        Aim { direction, t_max, weight: 0.0 }
    }
}

/// A lamp as one receiver sees it, ready to be aimed at.
#[allow(clippy::large_enum_variant, reason = "lives on the stack, one at a time")]
pub(super) enum Sampler<'a> {
    /// By area.
    Flat(&'a Lamp),
    /// By solid angle.
    Near(&'a Polygon, SphericalPolygon),
}

/// Within how many radii of itself a polygon is sampled by solid angle.
const NEAR: f32 = 0.3;

impl<'a> Sampler<'a> {
    /// Prepares aiming at `lamp` from `x`.
    pub fn new(lamp: &'a Lamp, x: &SurfacePoint) -> Sampler<'a> {
        if let Shape::Polygon(p) = &lamp.shape {
            let corners = p.relative_corners(x.position);
            // Near, area sampling would waste most samples on places that count little; cut by the horizon, on
            // places that count nothing.
            let normal = x.normal.as_dvec3();
            let cut = corners.iter().any(|c| normal.dot(*c) < 0.0);
            if cut || p.distance(x.position) < NEAR * p.radius {
                let above = form::Clipped::new(&corners[..p.count], normal);
                if let Some(sphere) = SphericalPolygon::new(above.corners()) {
                    return Sampler::Near(p, sphere);
                }
            }
        }
        Sampler::Flat(lamp)
    }

    /// A point of the lamp for the square's point (u, v), as seen by `x`; none where it gives no light.
    ///
    /// The mean weight over the square is [`Lamp::unshadowed`].
    pub fn aim(&self, x: &SurfacePoint, u: f32, v: f32) -> Option<Aim> {
        match self {
            Sampler::Near(polygon, sphere) => {
                let direction = sphere.sample(u as f64, v as f64);
                let n = polygon.normal.as_dvec3();
                let height = polygon.front_distance(x);
                let t = -height / n.dot(direction);
                let weight = x.normal.as_dvec3().dot(direction) * sphere.solid_angle();
                let target = x.position.as_dvec3() + t * direction;
                (t > 0.0 && t.is_finite()).then(|| aim_at(x, target.as_vec3(), offset(n.as_vec3(), height), weight))?
            }
            Sampler::Flat(lamp) => match &lamp.shape {
                Shape::Polygon(p) => {
                    let height = p.front_distance(x);
                    patch_of_light(x, p.point(u, v), p.normal, height, p.area)
                }
                Shape::Disc { centre, normal, radius } => {
                    let (e1, e2) = sampling::frame(*normal);
                    let at = sampling::concentric_disc(u, v) * *radius;
                    let height = normal.as_dvec3().dot(x.position.as_dvec3() - centre.as_dvec3()).max(0.0);
                    let area = std::f32::consts::PI * radius * radius;
                    patch_of_light(x, *centre + at.x * e1 + at.y * e2, *normal, height, area)
                }
                Shape::Point { position, .. } | Shape::Spot { position, .. } => {
                    aim_at(x, *position, Vec3::ZERO, lamp.unshadowed(x))
                }
                Shape::Sun { direction } => {
                    let weight = lamp.unshadowed(x);
                    (weight > 0.0).then_some(Aim { direction: -*direction, t_max: f32::INFINITY, weight })
                }
            },
        }
    }
}

/// The weight of a point chosen uniformly on a surface light: cos cos' area / r^2.
fn patch_of_light(x: &SurfacePoint, target: Vec3, normal: Vec3, height: f64, area: f32) -> Option<Aim> {
    let d = target - x.position;
    let r2 = d.length_squared() as f64;
    let cosines = x.normal.dot(d) as f64 * height.abs();
    let weight = cosines * area as f64 / (r2 * r2);
    aim_at(x, target, offset(normal, height), weight)
}

/// Rays end short of a surface as they start off one, by a fixed height: grazing rays need no extra care.
fn offset(normal: Vec3, height: f64) -> Vec3 {
    normal * RAY_OFFSET.copysign(height as f32)
}

fn aim_at(x: &SurfacePoint, target: Vec3, offset: Vec3, weight: f64) -> Option<Aim> {
    let direction = target + offset - origin(x);
    (weight > 0.0 && weight.is_finite() && direction != Vec3::ZERO).then_some(Aim { direction, t_max: 1.0, weight })
}

/// Where the rays of `x` start.
pub(super) fn origin(x: &SurfacePoint) -> Vec3 {
    x.position + RAY_OFFSET * x.normal
}
