//! How far values are from reference values: one number each for the typical, the systematic and the worst error.

use std::path::Path;

mod csv;
mod exr;
mod picture;
mod ply;
mod table;

pub use picture::{difference_image, difference_picture};
pub use table::{Layer, Table, read};

use crate::{Error, Result};

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

/// The differences of one kind of light.
#[derive(Clone, Debug, PartialEq)]
pub struct Differences {
    /// As the [`Layer`]'s.
    pub name: String,
    /// Of the luminance.
    pub luminance: Difference,
    /// Of red, green, blue.
    pub bands: [Difference; 3],
    /// Whether the reference tells its standard errors.
    pub noise_is_known: bool,
}

/// Share of the extent of all points by which two positions may differ: single precision and printed digits.
const SAME_PLACE: f64 = 1e-5;

/// Compares every kind of light that both tables hold. The paths are for messages.
///
/// # Errors
/// [`Error::Input`] if the tables are not about the same points or pixels, or have no light in common.
pub fn compare(a: (&Path, &Table), b: (&Path, &Table)) -> Result<Vec<Differences>> {
    same_places(a, b)?;
    let differences: Vec<Differences> = (a.1.layers.iter())
        .filter_map(|layer| {
            let reference = b.1.layers.iter().find(|l| l.name == layer.name)?;
            let errors = |k: usize| reference.errors.as_ref().map(|e| e[k].as_slice());
            let band = |c: usize| difference(&layer.bands[c], &reference.bands[c], errors(c));
            Some(Differences {
                name: layer.name.clone(),
                luminance: difference(&layer.luminance(), &reference.luminance(), errors(3)),
                bands: [0, 1, 2].map(band),
                noise_is_known: reference.errors.is_some(),
            })
        })
        .collect();
    if differences.is_empty() {
        let names = |t: &Table| t.layers.iter().map(|l| l.name.as_str()).collect::<Vec<_>>().join(", ");
        let message = format!("holds {}, but {} holds {}", names(a.1), b.0.display(), names(b.1));
        return Err(Error::input(a.0, "", message));
    }
    Ok(differences)
}

fn same_places((path, a): (&Path, &Table), (other, b): (&Path, &Table)) -> Result<()> {
    let other = other.display();
    if a.size != b.size {
        let told = |size: Option<(u32, u32)>| size.map_or("no image".into(), |(w, h)| format!("{w} x {h} pixels"));
        return Err(Error::input(path, "", format!("{}, but {other} has {}", told(a.size), told(b.size))));
    }
    let count = |t: &Table| t.layers.first().map_or(0, |l| l.bands[0].len());
    if count(a) != count(b) {
        return Err(Error::input(path, "", format!("{} points, but {other} has {}", count(a), count(b))));
    }
    let (Some(p), Some(q)) = (&a.positions, &b.positions) else { return Ok(()) };
    let extent = (0..3).map(|axis| {
        let of_axis = || q.iter().map(|x| x[axis]);
        of_axis().fold(f64::NEG_INFINITY, f64::max) - of_axis().fold(f64::INFINITY, f64::min)
    });
    // A single point has no extent; its own coordinates then say what rounding is.
    let largest = q.iter().flatten().fold(0.0, |m: f64, x| m.max(x.abs()));
    let tolerance = SAME_PLACE * extent.fold(0.0, f64::max).max(0.1 * largest);
    let apart = |(p, q): (&[f64; 3], &[f64; 3])| !p.iter().zip(q).all(|(p, q)| (p - q).abs() <= tolerance);
    match p.iter().zip(q).position(apart) {
        None => Ok(()),
        Some(i) => {
            let message = format!("lies at {:?}, but in {other} at {:?}: both must list the same points", p[i], q[i]);
            Err(Error::input(path, format!("point {}", i + 1), message))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_are_those_of_a_hand_computed_case() {
        // 200 values: reference 2, differences +0.1 at 190 of them, -0.2 at eight, +1 at two.
        let reference = vec![2.0; 200];
        let mut values = vec![2.1; 200];
        values[..8].fill(1.8);
        values[8..10].fill(3.0);
        let square = (190.0 * 0.01 + 8.0 * 0.04 + 2.0) / 200.0_f64;
        let d = difference(&values, &reference, None);
        assert!((d.rmse - square.sqrt() / 2.0).abs() < 1e-12);
        assert!((d.bias - (19.0 - 1.6 + 2.0) / 200.0 / 2.0).abs() < 1e-12);
        assert!((d.p95 - 0.05).abs() < 1e-12);
        assert!((d.worst - 0.5).abs() < 1e-12);
        assert_eq!((d.noise, d.count), (0.0, 200));

        // One value more beyond the rank makes the percentile the next larger difference.
        values[10] = 1.8;
        assert!((difference(&values, &reference, None).p95 - 0.1).abs() < 1e-12);
    }

    #[test]
    fn noise_is_subtracted_in_quadrature_and_never_below_zero() {
        // Differences of 0.5, errors of 0.3: what is left is 0.4; means are 1.
        let d = difference(&[1.5, 0.5], &[1.0, 1.0], Some(&[0.3, 0.3]));
        assert!((d.rmse - 0.4).abs() < 1e-12);
        assert!((d.noise - 0.3).abs() < 1e-12);
        assert_eq!(d.bias, 0.0);
        assert_eq!(difference(&[1.5, 0.5], &[1.0, 1.0], Some(&[0.6, 0.6])).rmse, 0.0);
    }

    #[test]
    fn degenerate_cases_have_plain_answers() {
        assert_eq!(difference(&[], &[], None), Difference::default());
        assert_eq!(difference(&[0.0], &[0.0], None).rmse, 0.0);
        assert_eq!(difference(&[1.0], &[0.0], None).rmse, f64::INFINITY);
        assert!(difference(&[f64::NAN], &[1.0], Some(&[0.1])).rmse.is_nan());
    }

    fn table(light: f64, at: Option<[f64; 3]>) -> Table {
        let layer = Layer { name: "direct".into(), bands: [0, 1, 2].map(|_| vec![light]), errors: None };
        Table { layers: vec![layer], positions: at.map(|x| vec![x]), size: None }
    }

    #[test]
    fn other_points_or_none_in_common_are_refused() {
        let (a, b) = (Path::new("a.csv"), Path::new("b.csv"));
        let message = |x: &Table, y: &Table| compare((a, x), (b, y)).unwrap_err().to_string();
        let here = table(1.0, Some([1.0, 2.0, 3.0]));
        assert!(compare((a, &here), (b, &table(1.1, Some([1.0, 2.000_001, 3.0])))).is_ok());
        assert!(compare((a, &here), (b, &table(1.1, None))).is_ok());
        assert_eq!(
            message(&here, &table(1.0, Some([1.0, 2.001, 3.0]))),
            "a.csv: point 1: lies at [1.0, 2.0, 3.0], but in b.csv at [1.0, 2.001, 3.0]: both must list the same points"
        );
        let mut two = table(1.0, None);
        two.layers[0].bands.iter_mut().for_each(|band| band.push(1.0));
        assert_eq!(message(&here, &two), "a.csv: 1 points, but b.csv has 2");
        let mut other = table(1.0, None);
        other.layers[0].name = "indirect".into();
        assert_eq!(message(&here, &other), "a.csv: holds direct, but b.csv holds indirect");
        other.size = Some((1, 1));
        assert_eq!(message(&here, &other), "a.csv: no image, but b.csv has 1 x 1 pixels");
    }
}
