//! Lights in world coordinates, as users give them.

use glam::{DAffine3, DVec3, Vec3};
use serde::{Deserialize, Serialize};

use super::{Frame, Light, light::Environment};

/// A light in world coordinates and world units; see [`Light`] for what each does.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum WorldLight {
    /// Parallelogram that radiates from the side that `edge_u x edge_v` points to.
    Rectangle {
        /// One corner.
        corner: DVec3,
        /// First edge.
        edge_u: DVec3,
        /// Second edge.
        edge_v: DVec3,
        /// Radiance, W/m2/sr.
        radiance: Vec3,
    },
    /// Disc that radiates from the side of `normal`.
    Disc {
        /// Centre.
        centre: DVec3,
        /// Normal, of any length.
        normal: DVec3,
        /// Radius.
        radius: f64,
        /// Radiance, W/m2/sr.
        radiance: Vec3,
    },
    /// Isotropic point.
    Point {
        /// Position.
        position: DVec3,
        /// Radiant intensity, W/sr.
        intensity: Vec3,
        /// Distance beyond which it gives nothing.
        range: f64,
    },
    /// Point with a cone.
    Spot {
        /// Position.
        position: DVec3,
        /// Direction of its axis, of any length.
        direction: DVec3,
        /// Radiant intensity on the axis, W/sr.
        intensity: Vec3,
        /// Angle from the axis up to which it has full strength, degrees.
        inner: f64,
        /// Angle from the axis at which it ends, degrees, at most 90.
        outer: f64,
        /// Distance beyond which it gives nothing.
        range: f64,
    },
    /// Parallel rays from infinity.
    Sun {
        /// Direction in which the light travels, of any length.
        direction: DVec3,
        /// Irradiance at normal incidence, W/m2.
        irradiance: Vec3,
    },
    /// The same radiance from every direction.
    Sky {
        /// Radiance, W/m2/sr.
        radiance: Vec3,
    },
    /// Radiance by direction.
    Environment(Environment),
}

impl WorldLight {
    /// What is wrong with the light's numbers, if anything.
    pub fn problem(&self) -> Option<String> {
        let colour = |what: &str, c: &Vec3| {
            (!c.is_finite() || c.min_element() < 0.0)
                .then(|| format!("{what} {c} must have three numbers that are finite and not negative"))
        };
        let place = |what: &str, p: &DVec3| (!p.is_finite()).then(|| format!("{what} must be finite"));
        let axis = |what: &str, d: &DVec3| {
            d.try_normalize().is_none().then(|| format!("{what} must be finite and have a length"))
        };
        match self {
            WorldLight::Rectangle { corner, edge_u, edge_v, radiance } => place("corner", corner)
                .or_else(|| axis("edge_u", edge_u))
                .or_else(|| axis("edge_v", edge_v))
                .or_else(|| axis("edge_u x edge_v", &edge_u.normalize().cross(edge_v.normalize())))
                .or_else(|| colour("radiance", radiance)),
            WorldLight::Disc { centre, normal, radius, radiance } => place("centre", centre)
                .or_else(|| axis("normal", normal))
                .or_else(|| (!(radius.is_finite() && *radius > 0.0)).then(|| "radius must be above 0".into()))
                .or_else(|| colour("radiance", radiance)),
            WorldLight::Point { position, intensity, range } => {
                place("position", position).or_else(|| colour("intensity", intensity)).or_else(|| far(*range))
            }
            WorldLight::Spot { position, direction, intensity, inner, outer, range } => place("position", position)
                .or_else(|| axis("direction", direction))
                .or_else(|| colour("intensity", intensity))
                .or_else(|| far(*range))
                .or_else(|| {
                    (!(0.0 <= *inner && inner <= outer && *outer > 0.0 && *outer <= 90.0))
                        .then(|| "inner and outer must be degrees with 0 <= inner <= outer <= 90".into())
                }),
            WorldLight::Sun { direction, irradiance } => {
                axis("direction", direction).or_else(|| colour("irradiance", irradiance))
            }
            WorldLight::Sky { radiance } => colour("radiance", radiance),
            WorldLight::Environment(_) => None,
        }
    }

    /// Moves the light. Powers stay: a scaled lamp keeps its radiance, a point its intensity.
    pub fn transform(&mut self, transform: &DAffine3) {
        match self {
            WorldLight::Rectangle { corner, edge_u, edge_v, .. } => {
                *corner = transform.transform_point3(*corner);
                *edge_u = transform.transform_vector3(*edge_u);
                *edge_v = transform.transform_vector3(*edge_v);
                if transform.matrix3.determinant() < 0.0 {
                    std::mem::swap(edge_u, edge_v);
                }
            }
            WorldLight::Disc { centre, normal, radius, .. } => {
                *centre = transform.transform_point3(*centre);
                *normal = transform.transform_vector3(*normal);
                *radius *= transform.matrix3.determinant().abs().cbrt();
            }
            WorldLight::Point { position, range, .. } => {
                *position = transform.transform_point3(*position);
                *range *= transform.matrix3.determinant().abs().cbrt();
            }
            WorldLight::Spot { position, direction, range, .. } => {
                *position = transform.transform_point3(*position);
                *direction = transform.transform_vector3(*direction);
                *range *= transform.matrix3.determinant().abs().cbrt();
            }
            WorldLight::Sun { direction, .. } => *direction = transform.transform_vector3(*direction),
            WorldLight::Sky { .. } | WorldLight::Environment(_) => {}
        }
    }

    /// What kind of light it is, for messages.
    pub fn kind(&self) -> &'static str {
        match self {
            WorldLight::Rectangle { .. } => "rectangle",
            WorldLight::Disc { .. } => "disc",
            WorldLight::Point { .. } => "point",
            WorldLight::Spot { .. } => "spot",
            WorldLight::Sun { .. } => "sun",
            WorldLight::Sky { .. } => "sky",
            WorldLight::Environment(_) => "environment",
        }
    }

    /// A light of the local frame in world coordinates.
    pub fn of_local(light: &Light, frame: &Frame) -> WorldLight {
        let vector = |v: &Vec3| v.as_dvec3() * frame.scale;
        let point = |i: &Vec3| (i.as_dvec3() * (frame.scale * frame.scale)).as_vec3();
        let degrees = |cos: f32| (cos as f64).clamp(-1.0, 1.0).acos().to_degrees();
        match light {
            Light::Rectangle { corner, edge_u, edge_v, radiance } => WorldLight::Rectangle {
                corner: frame.to_world(*corner),
                edge_u: vector(edge_u),
                edge_v: vector(edge_v),
                radiance: *radiance,
            },
            Light::Disc { centre, normal, radius, radiance } => WorldLight::Disc {
                centre: frame.to_world(*centre),
                normal: normal.as_dvec3(),
                radius: *radius as f64 * frame.scale,
                radiance: *radiance,
            },
            Light::Point { position, intensity, range } => WorldLight::Point {
                position: frame.to_world(*position),
                intensity: point(intensity),
                range: *range as f64 * frame.scale,
            },
            Light::Spot { position, direction, intensity, cos_inner, cos_outer, range } => WorldLight::Spot {
                position: frame.to_world(*position),
                direction: direction.as_dvec3(),
                intensity: point(intensity),
                inner: degrees(*cos_inner),
                // The cosine of 90 degrees is a little below zero in f32.
                outer: degrees(*cos_outer).min(90.0),
                range: *range as f64 * frame.scale,
            },
            Light::Sun { direction, irradiance } => {
                WorldLight::Sun { direction: direction.as_dvec3(), irradiance: *irradiance }
            }
            Light::Sky { radiance } => WorldLight::Sky { radiance: *radiance },
            Light::Environment(e) => WorldLight::Environment(e.clone()),
        }
    }

    /// The light in the local frame.
    pub(crate) fn to_local(&self, frame: &Frame) -> Light {
        let unit = |d: &DVec3| d.normalize_or(DVec3::NEG_Y).as_vec3();
        let length = |x: f64| (x / frame.scale) as f32;
        let vector = |v: &DVec3| (*v / frame.scale).as_vec3();
        // Irradiance is intensity / distance^2, and local distances are smaller by the scale.
        let point = |i: &Vec3| (i.as_dvec3() / (frame.scale * frame.scale)).as_vec3();
        let cos = |degrees: f64| degrees.to_radians().cos() as f32;
        match self {
            WorldLight::Rectangle { corner, edge_u, edge_v, radiance } => Light::Rectangle {
                corner: frame.to_local(*corner),
                edge_u: vector(edge_u),
                edge_v: vector(edge_v),
                radiance: *radiance,
            },
            WorldLight::Disc { centre, normal, radius, radiance } => Light::Disc {
                centre: frame.to_local(*centre),
                normal: unit(normal),
                radius: length(*radius),
                radiance: *radiance,
            },
            WorldLight::Point { position, intensity, range } => {
                Light::Point { position: frame.to_local(*position), intensity: point(intensity), range: length(*range) }
            }
            WorldLight::Spot { position, direction, intensity, inner, outer, range } => Light::Spot {
                position: frame.to_local(*position),
                direction: unit(direction),
                intensity: point(intensity),
                cos_inner: cos(*inner),
                cos_outer: cos(*outer),
                range: length(*range),
            },
            WorldLight::Sun { direction, irradiance } => {
                Light::Sun { direction: unit(direction), irradiance: *irradiance }
            }
            WorldLight::Sky { radiance } => Light::Sky { radiance: *radiance },
            WorldLight::Environment(e) => Light::Environment(e.clone()),
        }
    }
}

fn far(range: f64) -> Option<String> {
    (range.is_nan() || range <= 0.0).then(|| "range must be above 0".into())
}
