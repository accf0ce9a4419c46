//! Environment images.

use std::path::Path;

use exr::prelude::*;
use glam::Vec3;

use super::light::Environment;
use crate::{Error, Result};

/// Texels that an environment may have: 16384 x 8192.
const MOST_TEXELS: usize = 1 << 27;

/// Reads a lat-long image from an EXR file; see [`Environment`] for its layout. Values that are negative or not finite
/// become 0.
///
/// # Errors
/// [`Error::Io`]; [`Error::Input`] if the file is no EXR image with the channels R, G, B, or is too large.
pub(crate) fn read(path: &Path, up: Vec3) -> Result<Environment> {
    let wrong = |message: String| Error::input(path, "", message);
    let bytes = std::fs::read(path).map_err(|e| Error::io(path, e))?;
    // The header may promise any size: it is looked at before pixels are allocated.
    let meta = exr::meta::MetaData::read_from_buffered(std::io::Cursor::new(&bytes), false)
        .map_err(|e| wrong(format!("not an EXR image: {e}")))?;
    let largest = meta.headers.iter().map(|h| h.layer_size.area()).max().unwrap_or(0);
    if largest > MOST_TEXELS {
        return Err(wrong(format!("{largest} texels; at most {MOST_TEXELS} are possible")));
    }
    let image = exr::prelude::read()
        .no_deep_data()
        .largest_resolution_level()
        .rgb_channels(
            |size, _| (size.width(), vec![Vec3::ZERO; size.area()]),
            |(width, texels), at, (r, g, b): (f32, f32, f32)| texels[at.y() * *width + at.x()] = usable([r, g, b]),
        )
        .first_valid_layer()
        .all_attributes()
        .from_buffered(std::io::Cursor::new(&bytes))
        .map_err(|e| wrong(format!("not an EXR image with channels R, G, B: {e}")))?;
    let size = image.layer_data.size;
    let texels = image.layer_data.channel_data.pixels.1;
    if texels.is_empty() {
        return Err(wrong("the image is empty".into()));
    }
    Ok(Environment { width: size.width() as u32, height: size.height() as u32, texels, up })
}

fn usable(rgb: [f32; 3]) -> Vec3 {
    rgb.map(|x| if x.is_finite() && x > 0.0 { x } else { 0.0 }).into()
}
