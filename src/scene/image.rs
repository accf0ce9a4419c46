//! Image files to textures of linear RGB and maps of opacity.

use std::{io::Cursor, path::Path};

use glam::Vec3;
use image::{DynamicImage, ImageReader};
use serde::{Deserialize, Serialize};

use super::Texture;

/// Textures are averaged down to at most this many texels a side: patches are far coarser than texels.
const MAX_SIDE: u32 = 2048;

/// Opacity by place, as of [`Texture`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OpacityMap {
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// width x height values, 0 (clear) ..= 1 (opaque).
    #[serde(with = "crate::lxt::raw")]
    pub texels: Vec<f32>,
}

/// What an image file holds.
pub(crate) struct Image {
    pub texture: Texture,
    /// The alpha channel; `None` where the image has none.
    pub alpha: Option<OpacityMap>,
}

/// Decodes a PNG or JPEG file.
pub(crate) fn read(path: &Path) -> Result<Image, String> {
    decode(&std::fs::read(path).map_err(|e| e.to_string())?)
}

/// Decodes the bytes of a PNG or JPEG file; colours are taken as sRGB.
pub(crate) fn decode(bytes: &[u8]) -> Result<Image, String> {
    // The reader's default limits refuse images that would need more than 512 MB.
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format().map_err(|e| e.to_string())?;
    let image = reader.decode().map_err(|e| e.to_string())?;
    if image.width() == 0 || image.height() == 0 {
        return Err("the image is empty".into());
    }
    Ok(convert(&image))
}

fn convert(image: &DynamicImage) -> Image {
    let step = image.width().max(image.height()).div_ceil(MAX_SIDE);
    let (width, height) = (image.width().div_ceil(step), image.height().div_ceil(step));
    let linear: Vec<f32> = (0..=255).map(|v| srgb_to_linear(v as f32 / 255.0)).collect();
    let pixels = image.to_rgba8();
    let mut texels = Vec::with_capacity((width * height) as usize);
    let mut alphas = Vec::with_capacity((width * height) as usize);
    for y in 0..height {
        for x in 0..width {
            let (mut sum, mut alpha, mut n) = (Vec3::ZERO, 0.0, 0.0);
            for py in (y * step)..((y + 1) * step).min(image.height()) {
                for px in (x * step)..((x + 1) * step).min(image.width()) {
                    let [r, g, b, a] = pixels.get_pixel(px, py).0;
                    sum += Vec3::new(linear[r as usize], linear[g as usize], linear[b as usize]);
                    alpha += a as f32 / 255.0;
                    n += 1.0;
                }
            }
            texels.push(sum / n);
            alphas.push(alpha / n);
        }
    }
    let alpha = image.color().has_alpha().then_some(OpacityMap { width, height, texels: alphas });
    Image { texture: Texture { width, height, texels }, alpha }
}

impl OpacityMap {
    /// The luminance of a texture, undoing the conversion from sRGB: MTL's `map_d` holds plain numbers.
    pub(crate) fn from_grey(texture: &Texture) -> OpacityMap {
        let texels = texture.texels.iter().map(|t| linear_to_srgb(t.element_sum() / 3.0)).collect();
        OpacityMap { width: texture.width, height: texture.height, texels }
    }

    /// The texel that holds `uv`, repeated in both directions.
    pub fn sample(&self, uv: glam::Vec2) -> f32 {
        let index = |x: f32, n: u32| ((x.rem_euclid(1.0) * n as f32) as u32).min(n - 1) as usize;
        if !uv.is_finite() {
            return self.texels[0];
        }
        self.texels[index(uv.y, self.height) * self.width as usize + index(uv.x, self.width)]
    }
}

/// IEC 61966-2-1.
pub(crate) fn srgb_to_linear(v: f32) -> f32 {
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn linear_to_srgb(v: f32) -> f32 {
    if v <= 0.0031308 { v * 12.92 } else { 1.055 * v.powf(1.0 / 2.4) - 0.055 }
}
