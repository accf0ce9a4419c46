//! Where few places carry most of the error.
//!
//! The root of the mean square says little where the rim of a lamp is far off and all else is good.

use glam::DVec3;

use super::Variance;
use crate::{
    report::ErrorPeak,
    scene::{Frame, SurfacePoint},
};

/// Share of the squares that is looked for, at the points where they are largest; and of the area that it is told of on, at
/// most. If the error were the same everywhere and normally distributed, the largest 5 % would have 28 % of the squares.
const SQUARES: f64 = 0.75;
const AREA: f64 = 0.05;

/// Where the largest squares are, by the variance of `points`, each of its area; `None` if these are not few.
pub(super) fn find(variance: &Variance, points: &[SurfacePoint], areas: &[f64], frame: &Frame) -> Option<ErrorPeak> {
    let parts = |k: usize| [variance.shadow[k], variance.rows[k], variance.detail[k]];
    let each: Vec<f64> = (0..points.len()).map(|k| parts(k).iter().sum()).collect();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&i, &j| each[j].total_cmp(&each[i]).then(i.cmp(&j)));
    let all: f64 = order.iter().map(|&k| areas[k] * each[k]).sum();
    let mut found = 0.0;
    let count = 1 + order.iter().position(|&k| {
        found += areas[k] * each[k];
        found >= SQUARES * all
    })?;
    let worst = &order[..count];
    let area = worst.iter().map(|&k| areas[k]).sum::<f64>() / areas.iter().sum::<f64>();
    if !(all > 0.0 && area <= AREA) {
        return None;
    }
    let place = |k: usize| frame.to_world(points[k].position);
    let middle = worst.iter().map(|&k| areas[k] * each[k] * place(k)).sum::<DVec3>() / found;
    let square = worst.iter().map(|&k| areas[k] * each[k] * place(k).distance_squared(middle)).sum::<f64>() / found;
    let own = worst.iter().fold([0.0; 3], |sum, &k| [0, 1, 2].map(|c| sum[c] + areas[k] * parts(k)[c]));
    let names = ["shadow_noise", "row_noise", "discretisation"];
    let (_, mostly) = own.into_iter().zip(names).max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(ErrorPeak {
        position: middle.to_array(),
        radius: square.sqrt(),
        squares: (found / all).min(1.0),
        area,
        vertices: count,
        mostly,
    })
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    /// 200 points in a row, with the variances of their shadow rays and of their detail.
    fn of_row(shadow: impl Fn(usize) -> f64, detail: impl Fn(usize) -> f64) -> Option<ErrorPeak> {
        let n = 200;
        let point = |k: usize| SurfacePoint { position: Vec3::new(0.01 * k as f32, 0.0, 0.0), normal: Vec3::Y };
        let variance =
            Variance { shadow: (0..n).map(shadow).collect(), rows: vec![0.0; n], detail: (0..n).map(detail).collect() };
        let points: Vec<SurfacePoint> = (0..n).map(point).collect();
        let frame = Frame { origin: DVec3::new(5.0, 0.0, 0.0), scale: 2.0 };
        find(&variance, &points, &vec![0.5; n], &frame)
    }

    #[test]
    fn few_points_that_carry_the_error_are_found_with_its_reason() {
        // Five points of 200 have 5 x 200, all others together 195.
        let peak = of_row(|_| 1.0, |k| if (48..=52).contains(&k) { 199.0 } else { 0.0 }).unwrap();
        assert_eq!((peak.vertices, peak.mostly), (5, "discretisation"));
        assert!((peak.area - 5.0 / 200.0).abs() < 1e-12 && (peak.squares - 1000.0 / 1195.0).abs() < 1e-12, "{peak:?}");
        // Points 0.02 apart in world units: the mean square of 0, 1, 1, 2 and 2 of these is 2.
        assert!(
            (peak.position[0] - 6.0).abs() < 1e-6 && (peak.radius - 0.02 * 2.0_f64.sqrt()).abs() < 1e-6,
            "{peak:?}"
        );
        // Two far apart are few places too, with what lies between them around the middle.
        let peak = of_row(|k| if k == 20 || k == 180 { 1.0 } else { 0.0 }, |_| 0.0).unwrap();
        assert_eq!((peak.vertices, peak.mostly), (2, "shadow_noise"));
        assert!((peak.radius - 1.6).abs() < 1e-6 && peak.squares == 1.0, "{peak:?}");
    }

    #[test]
    fn an_error_that_lies_everywhere_has_no_place() {
        assert_eq!(of_row(|_| 1.0, |_| 0.0), None);
        assert_eq!(of_row(|k| if k % 10 == 0 { 1.0 } else { 0.0 }, |_| 0.0), None);
        assert_eq!(of_row(|_| 0.0, |_| 0.0), None);
        assert_eq!(of_row(|k| if k == 7 { 1.0 } else { 0.0 }, |_| -1.0), None);
    }
}
