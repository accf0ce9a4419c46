//! What the scenes with known answers are held against: formulas with their sources, and published tables.

use std::f64::consts::PI;

use glam::DVec3;

/// Form factor between two parallel a x b rectangles at distance c, given as `[a, b, c]`.
///
/// J. R. Howell, A Catalogue of Radiation Configuration Factors, C-11.
pub fn parallel([a, b, c]: [f64; 3]) -> f64 {
    let (x, y) = (a / c, b / c);
    let (x1, y1) = (1.0 + x * x, 1.0 + y * y);
    let logarithm = 0.5 * (x1 * y1 / (x1 + y * y)).ln();
    2.0 / (PI * x * y)
        * (logarithm + x * y1.sqrt() * (x / y1.sqrt()).atan() + y * x1.sqrt() * (y / x1.sqrt()).atan()
            - x * x.atan()
            - y * y.atan())
}

/// Form factor from a w x l rectangle to an h x l one that stands on its edge l, given as `[h, w, l]`.
///
/// J. R. Howell, A Catalogue of Radiation Configuration Factors, C-14.
pub fn perpendicular([h, w, l]: [f64; 3]) -> f64 {
    let (h, w) = (h / l, w / l);
    let (hh, ww) = (h * h, w * w);
    let ss = hh + ww;
    let s = ss.sqrt();
    let logarithm = ((1.0 + ww) * (1.0 + hh) / (1.0 + ss)).ln()
        + ww * (ww * (1.0 + ss) / ((1.0 + ww) * ss)).ln()
        + hh * (hh * (1.0 + ss) / ((1.0 + hh) * ss)).ln();
    (w * (1.0 / w).atan() + h * (1.0 / h).atan() - s * (1.0 / s).atan() + 0.25 * logarithm) / (PI * w)
}

/// Form factor from a point with unit `normal` to a polygon all of which lies above its horizon.
///
/// Lambert: 1 / (2 pi) sum of Theta_i (n . Gamma_i), Theta_i the angle of edge i seen from the point, Gamma_i the unit
/// normal of the plane through the edge and the point. Either winding.
pub fn point_to_polygon(point: DVec3, normal: DVec3, corners: &[DVec3]) -> f64 {
    let mut sum = 0.0;
    for (i, &a) in corners.iter().enumerate() {
        let (a, b) = (a - point, corners[(i + 1) % corners.len()] - point);
        let cross = a.cross(b);
        // An edge that points at the point covers no angle.
        if cross.length() > 0.0 {
            sum += cross.length().atan2(a.dot(b)) * normal.dot(cross.normalize());
        }
    }
    sum.abs() / (2.0 * PI)
}

/// Emitted plus reflected radiosity of a closed scene with the same emitted exitance and albedo everywhere.
pub fn furnace(emitted: f64, albedo: f64) -> f64 {
    emitted / (1.0 - albedo)
}

/// Area mean of the indirect irradiance of a closed scene of uniform albedo into which `flux` is sent; inside a sphere
/// also its value everywhere.
pub fn closed_mean(flux: f64, area: f64, albedo: f64) -> f64 {
    flux / area * albedo / (1.0 - albedo)
}

/// Form factors of the catalogue between parallel rectangles `[a, b, c]`, to nine digits.
pub const PARALLEL: [([f64; 3], f64); 6] = [
    ([1.0, 1.0, 1.0], 0.199824896),
    ([1.0, 1.0, 0.1], 0.826994522),
    ([1.0, 1.0, 0.5], 0.415253284),
    ([1.0, 1.0, 2.0], 0.068589589),
    ([1.0, 2.0, 1.0], 0.285875385),
    ([1.0, 1.0, 10.0], 0.003162057),
];

/// Form factors of the catalogue between perpendicular rectangles `[h, w, l]`, to nine digits.
pub const PERPENDICULAR: [([f64; 3], f64); 6] = [
    ([1.0, 1.0, 1.0], 0.200043776),
    ([1.0, 2.0, 1.0], 0.116426301),
    ([2.0, 1.0, 1.0], 0.232852603),
    ([0.5, 1.0, 1.0], 0.146186679),
    ([0.1, 1.0, 1.0], 0.043251369),
    ([10.0, 1.0, 1.0], 0.249209486),
];

/// CIE 171:2006, test 5.3: illuminance of the wall y = 0 at x = 2, z = 2.75, 2.25 ... 0.25 and of the floor at
/// x = 2, y = 0.25, 0.75, 1.25, 1.75; lx.
pub const CIE_5_3: [f64; 10] = [32.68, 75.19, 81.32, 69.06, 53.40, 40.00, 61.42, 79.26, 95.67, 105.78];

/// CIE 171:2006, test 5.6, reflector of 0.5 m: 100 E / (E_hz rho) of the wall y = 0 at x = 2, z = 0.25, 0.75 ... 2.75 and
/// of the ceiling at x = 2, y = 0.25, 0.75, 1.25, 1.75.
pub const CIE_5_6_SMALL: [f64; 10] = [0.246, 0.580, 0.644, 0.556, 0.433, 0.325, 0.491, 0.639, 0.778, 0.864];

/// The same with a reflector of 4 m; the wall from z = 0.75.
pub const CIE_5_6_LARGE: [f64; 9] = [35.901, 27.992, 21.639, 16.716, 12.967, 26.80, 30.94, 33.98, 35.57];

/// CIE 171:2006, test 5.8: albedos and area means of the indirect illuminance, lx.
pub const CIE_5_8_MEANS: [(f64, f64); 11] = [
    (0.05, 5.48),
    (0.1, 11.57),
    (0.2, 26.04),
    (0.3, 44.64),
    (0.4, 69.44),
    (0.5, 104.17),
    (0.6, 156.25),
    (0.7, 243.06),
    (0.8, 416.67),
    (0.9, 937.5),
    (0.95, 1979.17),
];

/// Places on a face of the cube of test 5.8, metres from its centre along the two edges.
pub const CIE_5_8_PLACES: [[f64; 2]; 5] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.5, 1.5], [1.75, 1.75]];

/// Indirect illuminance there at albedos 0.1 and 0.5, lx; 64 x 64 collocation with exact form factors, +-0.05 %.
pub const CIE_5_8_POINTS: [(f64, [f64; 5]); 2] =
    [(0.1, [12.95, 12.73, 12.18, 10.33, 8.73]), (0.5, [112.04, 110.88, 107.78, 96.86, 86.42])];

/// Direct illuminance there, lx.
pub const CIE_5_8_DIRECT: [f64; 5] = [198.94, 142.35, 108.29, 64.22, 49.40];

/// Largest relative errors of Blender Cycles on CIE 171:2006 tests, as published.
pub mod cycles {
    /// Test 5.3.
    pub const CIE_5_3: f64 = 0.0494;
    /// Test 5.4.
    pub const CIE_5_4: f64 = 0.0028;
    /// Test 5.6.
    pub const CIE_5_6: f64 = 0.0025;
    /// Test 5.8.
    pub const CIE_5_8: f64 = 0.0031;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::selftest::cie;

    #[test]
    fn closed_forms_give_the_values_of_the_catalogue() {
        for (abc, expected) in PARALLEL {
            assert!((parallel(abc) - expected).abs() < 1e-9, "{abc:?}: {}", parallel(abc));
        }
        for (hwl, expected) in PERPENDICULAR {
            assert!((perpendicular(hwl) - expected).abs() < 1e-9, "{hwl:?}: {}", perpendicular(hwl));
        }
    }

    #[test]
    fn a_point_sees_the_catalogue_share_of_a_unit_square() {
        let square = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[x, y]| DVec3::new(x, y, 1.0));
        let centre = point_to_polygon(DVec3::ZERO, DVec3::Z, &square);
        assert!((centre - 0.239456470).abs() < 1e-9, "{centre}");
        let corner = point_to_polygon(DVec3::new(0.5, 0.5, 0.0), DVec3::Z, &square);
        assert!((corner - 0.138531606).abs() < 1e-9, "{corner}");
    }

    /// The tables of the cases that Lambert's formula answers, to their last digits.
    #[test]
    fn lambert_gives_the_published_tables() {
        let check = |values: Vec<f64>, table: &[f64], digit: f64| {
            assert_eq!(values.len(), table.len());
            for (value, printed) in values.iter().zip(table) {
                assert!((value - printed).abs() < 0.5001 * digit, "{value}, printed {printed}");
            }
        };
        check(cie::area_source_answers(), &CIE_5_3, 0.01);
        check(cie::one_bounce_answers(0.5), &CIE_5_6_SMALL, 0.001);
        let large = cie::one_bounce_answers(4.0);
        check(large[..5].to_vec(), &CIE_5_6_LARGE[..5], 0.001);
        check(large[5..].to_vec(), &CIE_5_6_LARGE[5..], 0.01);
        for (rho, lux) in CIE_5_8_MEANS {
            assert!((closed_mean(10_000.0, 96.0, rho) - lux).abs() < 0.005 + 1e-9);
        }
    }
}
