//! From radiance to display values: one exposure, a linear curve with a soft shoulder, the sRGB transfer function.

use glam::Vec3;

use crate::colour;

/// Share of the lit values that stays below display white under automatic exposure.
const WHITE_PERCENTILE: f64 = 0.98;

/// Display value where the curve leaves the straight line.
const SHOULDER: f32 = 0.8;

/// Name of the curve, as written into files.
pub const CURVE: &str = "x = exposure * radiance; x <= 0.8: x, else 0.8 + 0.2 (1 - exp(-(x - 0.8) / 0.2)); per channel";

/// Maps radiance to linear display values in [0, 1].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToneMap {
    /// Factor on radiance, sr m2/W.
    pub exposure: f32,
}

impl ToneMap {
    /// Puts the 98th percentile of the luminances above zero at 1 before the shoulder (display 0.93); 1 if all is black.
    ///
    /// Leave lamps and sky out of `radiance`: they are meant to be white.
    pub fn automatic(radiance: impl Iterator<Item = Vec3>) -> ToneMap {
        let mut lit: Vec<f32> = radiance.map(luminance).filter(|l| *l > 0.0 && l.is_finite()).collect();
        if lit.is_empty() {
            return ToneMap { exposure: 1.0 };
        }
        let at = ((lit.len() - 1) as f64 * WHITE_PERCENTILE) as usize;
        let white = *lit.select_nth_unstable_by(at, f32::total_cmp).1;
        // A white so dim that its inverse overflows is black to any display.
        ToneMap { exposure: (1.0 / white).min(f32::MAX) }
    }

    /// Linear display value of `radiance`, each channel in [0, 1]; NaN is black.
    pub fn display(&self, radiance: Vec3) -> Vec3 {
        Vec3::from(radiance.to_array().map(|r| curve(self.exposure * r)))
    }

    /// 8-bit sRGB of `radiance`.
    pub fn srgb8(&self, radiance: Vec3) -> [u8; 3] {
        self.display(radiance).to_array().map(|x| (255.0 * srgb(x) + 0.5) as u8)
    }
}

/// [`colour::luminance`] in single precision.
pub fn luminance(rgb: Vec3) -> f32 {
    colour::luminance(rgb) as f32
}

fn curve(x: f32) -> f32 {
    if x > SHOULDER {
        let room = 1.0 - SHOULDER;
        (SHOULDER + room * (1.0 - (-(x - SHOULDER) / room).exp())).min(1.0)
    } else {
        x.max(0.0)
    }
}

/// The sRGB transfer function (IEC 61966-2-1) of a linear value in [0, 1].
pub fn srgb(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_98th_percentile_of_lit_values_becomes_one() {
        let values = (0..=100).map(|i| Vec3::splat(i as f32));
        // 1 ..= 100 are lit; 98 % of the way along them stands the value 98.
        assert_eq!(ToneMap::automatic(values).exposure, 1.0 / 98.0);
    }

    #[test]
    fn a_black_or_broken_picture_has_exposure_one() {
        let none = [Vec3::ZERO, Vec3::NAN, Vec3::splat(f32::INFINITY)];
        assert_eq!(ToneMap::automatic(none.into_iter()).exposure, 1.0);
    }

    #[test]
    fn the_curve_is_straight_then_rises_to_one_without_a_kink() {
        let tone = ToneMap { exposure: 2.0 };
        assert_eq!(tone.display(Vec3::new(0.1, 0.2, 0.4)), Vec3::new(0.2, 0.4, 0.8));
        assert_eq!(tone.display(Vec3::new(-1.0, f32::NAN, f32::INFINITY)), Vec3::new(0.0, 0.0, 1.0));
        let slope = (curve(0.81) - curve(0.8)) / 0.01;
        // The exponential's second derivative, 1/0.2, bends the chord's slope by 0.01/2 of it: 2.5 %.
        assert!((slope - 1.0).abs() < 0.026, "{slope}");
        let rising = (0..1000).map(|i| curve(i as f32 * 0.01)).collect::<Vec<_>>();
        assert!(rising.is_sorted());
    }

    #[test]
    fn srgb_has_the_values_of_its_standard() {
        let tone = ToneMap { exposure: 1.0 };
        // 0.2140 linear is sRGB 0.5 = 127.5; 0.0031308 is the seam at 10.31/255.
        assert_eq!(tone.srgb8(Vec3::new(0.0, 0.003_130_8, 0.214_1)), [0, 10, 128]);
        assert!((srgb(1.0) - 1.0).abs() <= f32::EPSILON);
    }
}
