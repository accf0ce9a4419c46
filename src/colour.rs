//! What the three bands are to the eye.

use glam::Vec3;

/// Luminance of linear RGB with the primaries of sRGB (ITU-R BT.709), in the unit of its argument.
pub fn luminance(rgb: Vec3) -> f64 {
    luminance_f64(rgb.to_array().map(f64::from))
}

/// As [`luminance`].
pub fn luminance_f64([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_has_the_luminance_of_its_bands() {
        assert_eq!(luminance(Vec3::X), 0.2126);
        assert!((luminance(Vec3::splat(2.0)) - 2.0).abs() < 1e-15);
    }
}
