//! How surfaces reflect and emit.

use glam::{Vec2, Vec3};
use serde::{Deserialize, Serialize};

/// Largest albedo of any channel: real surfaces absorb, and the solution of a white scene would be infinite.
pub const ALBEDO_MAX: f32 = 0.9999;

/// A diffuse material.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Material {
    /// As the file calls it.
    pub name: String,
    /// Diffuse reflectance, 0 ..= [`ALBEDO_MAX`], linear.
    pub albedo: Vec3,
    /// Emitted radiance, W/m2/sr.
    pub emission: Vec3,
    /// Texture that multiplies `albedo`.
    pub albedo_texture: Option<u32>,
    /// Texture that multiplies `emission`.
    pub emission_texture: Option<u32>,
    /// Whether the file asks for both sides (glTF doubleSided).
    pub double_sided: bool,
}

/// An image of linear RGB, top row first, repeated in both directions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Texture {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// width x height texels.
    #[serde(with = "crate::lxt::raw")]
    pub texels: Vec<Vec3>,
}

impl Texture {
    /// The texel that holds `uv`; not finite coordinates read texel 0.
    pub fn sample(&self, uv: Vec2) -> Vec3 {
        let index = |x: f32, n: u32| ((x.rem_euclid(1.0) * n as f32) as u32).min(n - 1) as usize;
        if !uv.is_finite() {
            return self.texels[0];
        }
        self.texels[index(uv.y, self.height) * self.width as usize + index(uv.x, self.width)]
    }
}
