//! 8-bit sRGB pictures.

use std::io::{self, Write};

use glam::Vec3;
use image::{ExtendedColorType, ImageEncoder, codecs::png::PngEncoder};

use super::tonemap::ToneMap;

/// Writes `radiance` (`width` x `height` pixels, top row first) as a PNG.
///
/// # Errors
/// Those of `out`.
pub fn write(out: &mut dyn Write, width: u32, height: u32, radiance: &[Vec3], tone: ToneMap) -> io::Result<()> {
    let bytes: Vec<u8> = radiance.iter().flat_map(|&r| tone.srgb8(r)).collect();
    PngEncoder::new(out).write_image(&bytes, width, height, ExtendedColorType::Rgb8).map_err(io::Error::other)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_reads_back_pixel_for_pixel_with_the_top_row_first() {
        let pixels = [Vec3::ZERO, Vec3::X, Vec3::Y, Vec3::Z, Vec3::splat(0.2141), Vec3::splat(100.0)];
        let mut file = Vec::new();
        write(&mut file, 2, 3, &pixels, ToneMap { exposure: 1.0 }).unwrap();
        let back = image::load_from_memory(&file).unwrap().into_rgb8();
        assert_eq!(back.dimensions(), (2, 3));
        let expected = pixels.map(|p| ToneMap { exposure: 1.0 }.srgb8(p));
        assert_eq!(back.as_raw().as_slice(), expected.as_flattened());
        assert_eq!(back.get_pixel(0, 2).0, [128; 3]);
    }
}
