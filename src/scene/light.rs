//! Lights that are not surfaces of the scene.

use glam::Vec3;
use serde::{Deserialize, Serialize};

/// A light in the local frame. Emissive triangles are lights too, but stand in the geometry.
#[derive(Clone, Debug, PartialEq)]
pub enum Light {
    /// A parallelogram `corner + a * edge_u + b * edge_v`, 0 <= a, b <= 1, that radiates from the side that
    /// `edge_u x edge_v` points to. It blocks no rays.
    Rectangle {
        /// One corner, local.
        corner: Vec3,
        /// First edge, local.
        edge_u: Vec3,
        /// Second edge, local.
        edge_v: Vec3,
        /// Radiance, W/m2/sr.
        radiance: Vec3,
    },
    /// A disc that radiates from the side of `normal`. It blocks no rays.
    Disc {
        /// Centre, local.
        centre: Vec3,
        /// Unit normal.
        normal: Vec3,
        /// Radius, local.
        radius: f32,
        /// Radiance, W/m2/sr.
        radiance: Vec3,
    },
    /// An isotropic point.
    Point {
        /// Position, local.
        position: Vec3,
        /// Radiant intensity a local unit squared: world intensity (W/sr) / scale^2.
        intensity: Vec3,
        /// Distance beyond which it gives nothing (glTF range), local; infinite without one.
        range: f32,
    },
    /// A point with a cone; between the angles it falls off as KHR_lights_punctual says.
    Spot {
        /// Position, local.
        position: Vec3,
        /// Unit direction of its axis.
        direction: Vec3,
        /// Radiant intensity on the axis, as of `Point`.
        intensity: Vec3,
        /// Cosine of the angle of full strength.
        cos_inner: f32,
        /// Cosine of the angle where it ends.
        cos_outer: f32,
        /// As of `Point`.
        range: f32,
    },
    /// A light at infinity with parallel rays.
    Sun {
        /// Unit direction in which the light travels.
        direction: Vec3,
        /// Irradiance at normal incidence, W/m2.
        irradiance: Vec3,
    },
    /// The same radiance from every direction that sees no surface.
    Sky {
        /// Radiance, W/m2/sr.
        radiance: Vec3,
    },
    /// Radiance by direction, from a lat-long image.
    Environment(Environment),
}

/// A lat-long image: row 0 is the zenith; column u looks along azimuth `2 pi u - pi` from -z towards +x, when `up`
/// is +y (the convention of OpenEXR's latlong images as Blender and Mitsuba read them).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Environment {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Radiance, W/m2/sr.
    #[serde(with = "crate::lxt::raw")]
    pub texels: Vec<Vec3>,
    /// World axis (unit) that the image's zenith points to.
    pub up: Vec3,
}

impl Light {
    /// Whether it sends out anything at all.
    pub fn gives_light(&self) -> bool {
        match self {
            Light::Rectangle { radiance, .. } | Light::Disc { radiance, .. } | Light::Sky { radiance } => {
                *radiance != Vec3::ZERO
            }
            Light::Point { intensity, .. } | Light::Spot { intensity, .. } => *intensity != Vec3::ZERO,
            Light::Sun { irradiance, .. } => *irradiance != Vec3::ZERO,
            Light::Environment(e) => e.texels.iter().any(|t| *t != Vec3::ZERO),
        }
    }

    /// Whether all its numbers fit in f32.
    pub(crate) fn is_finite(&self) -> bool {
        let all = |v: &[Vec3]| v.iter().all(|v| v.is_finite());
        match self {
            Light::Rectangle { corner, edge_u, edge_v, radiance } => all(&[*corner, *edge_u, *edge_v, *radiance]),
            Light::Disc { centre, radius, radiance, .. } => all(&[*centre, *radiance]) && radius.is_finite(),
            Light::Point { position, intensity, .. } | Light::Spot { position, intensity, .. } => {
                all(&[*position, *intensity])
            }
            Light::Sun { irradiance, .. } => irradiance.is_finite(),
            Light::Sky { radiance } => radiance.is_finite(),
            Light::Environment(e) => all(&e.texels),
        }
    }
}
