//! Meshes and materials before they are cleaned.

use std::borrow::Cow;

use glam::{DAffine3, DVec3, Vec2, Vec3};
use serde::{Deserialize, Serialize};

use super::{Material, OpacityMap};

/// One mesh with one material, world coordinates.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct RawMesh {
    /// For messages; consecutive meshes of one name count as one.
    pub name: String,
    /// Vertex positions. They need not be finite.
    #[serde(with = "crate::lxt::raw")]
    pub positions: Vec<DVec3>,
    /// Shading normals a vertex, or empty; they need not have unit length.
    #[serde(with = "crate::lxt::raw")]
    pub normals: Vec<Vec3>,
    /// Texture coordinates a vertex, or empty; v = 0 is the top row.
    #[serde(with = "crate::lxt::raw")]
    pub uvs: Vec<Vec2>,
    /// Linear colours a vertex that multiply the albedo, or empty.
    #[serde(with = "crate::lxt::raw")]
    pub colours: Vec<Vec3>,
    /// Vertex indices.
    #[serde(with = "crate::lxt::raw")]
    pub triangles: Vec<[u32; 3]>,
    /// What messages call a triangle's place, e.g. `line`; empty: `triangle`.
    pub place: Cow<'static, str>,
    /// The number of that place a triangle, or empty: the triangle's own number.
    #[serde(with = "crate::lxt::raw")]
    pub places: Vec<u32>,
    /// Index of the material, as [`Builder::add_material`](super::Builder::add_material) returned it.
    pub material: u32,
}

/// How much of the light a surface stops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opacity {
    /// 0 (clear) ..= 1 (opaque).
    pub factor: f32,
    /// Index of the map that multiplies it, as [`Builder::add_opacity_map`](super::Builder::add_opacity_map) returned it.
    pub texture: Option<u32>,
    /// Opacity from which a place counts as opaque, and below which as clear (glTF alphaMode MASK).
    pub cutoff: Option<f32>,
}

impl Default for Opacity {
    fn default() -> Self {
        Opacity { factor: 1.0, texture: None, cutoff: None }
    }
}

/// A material before it is cleaned: colours may have any value.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct RawMaterial {
    /// Colours and textures.
    pub surface: Material,
    /// Opacity.
    pub opacity: Opacity,
}

impl Opacity {
    /// The opacity at a place of its map.
    pub(super) fn at(&self, map: &OpacityMap, uv: Vec2) -> f32 {
        self.cut(self.factor * map.sample(uv))
    }

    /// The opacity where there is no map.
    pub(super) fn everywhere(&self) -> f32 {
        self.cut(self.factor)
    }

    fn cut(&self, opacity: f32) -> f32 {
        self.cutoff.map_or(opacity, |c| if opacity >= c { 1.0 } else { 0.0 })
    }
}

impl RawMaterial {
    /// Replaces colour and texture of the albedo.
    pub fn set_albedo(&mut self, albedo: Vec3) {
        self.surface.albedo = albedo;
        self.surface.albedo_texture = None;
    }

    /// Replaces colour and texture of the emission, W/m2/sr.
    pub fn set_emission(&mut self, radiance: Vec3) {
        self.surface.emission = radiance;
        self.surface.emission_texture = None;
    }
}

impl RawMesh {
    pub(super) fn corners(&self, t: usize) -> [DVec3; 3] {
        self.triangles[t].map(|v| self.positions[v as usize])
    }

    pub(super) fn at_corners<T: Copy>(&self, values: &[T], t: u32) -> Option<[T; 3]> {
        (!values.is_empty()).then(|| self.triangles[t as usize].map(|v| values[v as usize]))
    }

    /// `mesh "wall", line 12 (0 0 0, 1 0 0, 1 NaN 0)`.
    pub(super) fn describe(&self, t: usize) -> String {
        let place = if self.place.is_empty() { "triangle" } else { &self.place };
        let number = self.places.get(t).copied().unwrap_or(t as u32);
        let [a, b, c] = self.corners(t).map(|p| format!("{} {} {}", p.x, p.y, p.z));
        format!("mesh \"{}\", {place} {number} ({a}, {b}, {c})", self.name)
    }

    pub(super) fn transform(&mut self, transform: &DAffine3) {
        for p in &mut self.positions {
            *p = transform.transform_point3(*p);
        }
        let linear = transform.matrix3;
        // The cofactor matrix transforms normals, and needs no division by a determinant that may be 0.
        let cofactor = glam::DMat3::from_cols(
            linear.y_axis.cross(linear.z_axis),
            linear.z_axis.cross(linear.x_axis),
            linear.x_axis.cross(linear.y_axis),
        );
        let mirror = linear.determinant() < 0.0;
        let sign = if mirror { -1.0 } else { 1.0 };
        for n in &mut self.normals {
            *n = (sign * (cofactor * n.as_dvec3())).normalize_or_zero().as_vec3();
        }
        if mirror {
            for t in &mut self.triangles {
                t.swap(1, 2);
            }
        }
    }
}
