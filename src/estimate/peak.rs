//! Where few places carry most of the error.
//!
//! The root of the mean square says little where a corner beside a lamp is far off and all else is good.

use glam::{DVec4, Vec3};

use super::Variance;
use crate::{
    report::ErrorPeak,
    scene::{Frame, SurfacePoint},
};

/// Radius of the neighbourhood that is looked at, in voxels.
const RADIUS: f64 = 4.0;
/// It is told of if it holds at least this share of the squares, on at most this share of the area.
const LEAST_SQUARES: f64 = 0.5;
const MOST_AREA: f64 = 0.05;
/// How often the middle moves to the mean place of the squares around it.
const STEPS: usize = 4;

/// The neighbourhood of the largest squares, if it holds most of all: by the variance of `points`, each of its area.
pub(super) fn find(
    variance: &Variance,
    points: &[SurfacePoint],
    areas: &[f64],
    voxel: f64,
    frame: &Frame,
) -> Option<ErrorPeak> {
    let parts = |k: usize| [variance.shadow[k], variance.rows[k], variance.detail[k]].map(|v| areas[k] * v);
    let squares: Vec<f64> = (0..points.len()).map(|k| parts(k).iter().sum()).collect();
    let all: f64 = squares.iter().sum();
    let radius = RADIUS * voxel;
    let worst = (0..points.len()).max_by(|&i, &j| squares[i].total_cmp(&squares[j]).then(j.cmp(&i)))?;
    let mut middle = points[worst].position;
    let near = |middle: Vec3| {
        let is_near = move |k: &usize| (points[*k].position.distance(middle) as f64) < radius;
        (0..points.len()).filter(is_near)
    };
    for _ in 0..STEPS {
        // Differences of products may be below zero, and are no weights then.
        let weighted = near(middle).map(|k| squares[k].max(0.0) * points[k].position.as_dvec3().extend(1.0));
        let sum = weighted.sum::<DVec4>();
        if sum.w > 0.0 {
            middle = (sum.truncate() / sum.w).as_vec3();
        }
    }
    let total: f64 = areas.iter().sum();
    let area = near(middle).map(|k| areas[k]).sum::<f64>() / total;
    let own = near(middle).map(parts).fold([0.0; 3], |sum, p| [0, 1, 2].map(|c| sum[c] + p[c]));
    let share = own.iter().sum::<f64>() / all;
    if !(all > 0.0 && share >= LEAST_SQUARES && area <= MOST_AREA) {
        return None;
    }
    let names = ["shadow_noise", "row_noise", "discretisation"];
    let (_, mostly) = own.into_iter().zip(names).max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(ErrorPeak {
        position: frame.to_world(middle).to_array(),
        radius: radius * frame.scale,
        squares: share.min(1.0),
        area,
        vertices: near(middle).count(),
        mostly,
    })
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;

    /// A row of points a voxel of 0.01 apart, with the variances of its shadow rays and of its detail.
    fn of_row(shadow: impl Fn(usize) -> f64, detail: impl Fn(usize) -> f64) -> Option<ErrorPeak> {
        let n = 200;
        let point = |k: usize| SurfacePoint { position: Vec3::new(0.01 * k as f32, 0.0, 0.0), normal: Vec3::Y };
        let variance =
            Variance { shadow: (0..n).map(shadow).collect(), rows: vec![0.0; n], detail: (0..n).map(detail).collect() };
        let points: Vec<SurfacePoint> = (0..n).map(point).collect();
        let frame = Frame { origin: DVec3::new(5.0, 0.0, 0.0), scale: 2.0 };
        find(&variance, &points, &vec![0.5; n], 0.01, &frame)
    }

    #[test]
    fn few_points_that_carry_the_error_are_found_with_its_reason() {
        // Five points of 200 have 5 x 100, all others together 195.
        let peak = of_row(|_| 1.0, |k| if (48..=52).contains(&k) { 99.0 } else { 0.0 }).unwrap();
        // Seven points lie within four voxels of the middle, or 9 if rounding is kind to those at the rim.
        assert!((7..=9).contains(&peak.vertices), "{peak:?}");
        assert!((peak.area - peak.vertices as f64 / 200.0).abs() < 1e-12);
        assert!((peak.squares - (495.0 + peak.vertices as f64) / 695.0).abs() < 1e-9);
        assert!((peak.position[0] - 6.0).abs() < 1e-3 && (peak.radius - 0.08).abs() < 1e-9, "{peak:?}");
        assert_eq!(peak.mostly, "discretisation");
    }

    #[test]
    fn an_error_that_lies_everywhere_has_no_place() {
        assert_eq!(of_row(|_| 1.0, |_| 0.0), None);
        // Two places with half of it each, less what lies elsewhere.
        assert_eq!(of_row(|_| 0.1, |k| if k == 20 || k == 180 { 100.0 } else { 0.0 }), None);
        assert_eq!(of_row(|_| 0.0, |_| 0.0), None);
        assert_eq!(of_row(|k| if k == 7 { 1.0 } else { 0.0 }, |_| -1.0), None);
    }
}
