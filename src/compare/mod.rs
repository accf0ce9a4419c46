//! How far values are from reference values: one number each for the typical, the systematic and the worst error.

use glam::Vec3;

/// What the difference of values from a reference comes to. All are relative to the mean of the reference, but for
/// `count`; where that is zero, they are 0 if there is no difference and infinite if there is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// Root of the mean squared difference, without the reference's own `noise`: sqrt(rmse^2 - noise^2), and 0 where the
    /// noise is larger.
    pub rmse: f64,
    /// Mean difference, with its sign.
    pub bias: f64,
    /// The size that 95 % of the differences do not exceed (nearest rank).
    pub p95: f64,
    /// Mean of the largest 1 % of the differences (of one at least).
    pub worst: f64,
    /// Root mean square of the reference's standard errors; 0 where they are not known.
    pub noise: f64,
    /// Values compared.
    pub count: usize,
}

/// Luminance of linear RGB with the primaries of sRGB (ITU-R BT.709).
pub fn luminance(v: Vec3) -> f64 {
    luminance_f64(v.to_array().map(f64::from))
}

/// As [`luminance`].
pub(crate) fn luminance_f64([r, g, b]: [f64; 3]) -> f64 {
    0.2126 * r + 0.7152 * g + 0.0722 * b
}

/// The difference of `values` from `reference`, which have one length, as do the reference's `standard_errors` where
/// they are known. Only `rmse` is freed of the reference's noise: percentiles cannot be, and the bias averages it out.
///
/// Empty slices have no difference. A value that is not finite makes the figures not finite.
pub fn difference(values: &[f64], reference: &[f64], standard_errors: Option<&[f64]>) -> Difference {
    let count = values.len().min(reference.len());
    if count == 0 {
        return Difference::default();
    }
    let n = count as f64;
    let mean = reference[..count].iter().sum::<f64>() / n;
    let relative = |x: f64| if x == 0.0 { 0.0 } else { x / mean.abs() };

    let mut sizes: Vec<f64> = values.iter().zip(reference).map(|(a, b)| (a - b).abs()).collect();
    let square = sizes.iter().map(|d| d * d).sum::<f64>() / n;
    let signed = values.iter().zip(reference).map(|(a, b)| a - b).sum::<f64>() / n;
    // Not `max`, which would make a zero of NaN.
    let above_zero = |x: f64| if x < 0.0 { 0.0 } else { x };
    let noise = standard_errors.map_or(0.0, |errors| errors.iter().map(|e| e * e).sum::<f64>() / n);

    sizes.sort_by(f64::total_cmp);
    let rank = (0.95 * n).ceil() as usize;
    let tail = (count / 100).max(1);
    Difference {
        rmse: relative(above_zero(square - noise).sqrt()),
        bias: relative(signed),
        p95: relative(sizes[rank.clamp(1, count) - 1]),
        worst: relative(sizes[count - tail..].iter().sum::<f64>() / tail as f64),
        noise: relative(noise.sqrt()),
        count,
    }
}
