//! Why light is summed in double precision.

use glam::DVec3;
use luxel::{BakeOptions, options::Primary, transfer::FormFactors};

use crate::common::{World, options};

/// Sums up the bounces of a white furnace, B <- M + rho F B, until they are through; the largest relative error of B.
/// `round` rounds every intermediate result.
pub fn furnace_error(f: &FormFactors, albedo: f64, round: impl Fn(f64) -> f64) -> f64 {
    let rows: Vec<Vec<(usize, f64)>> = (0..f.len()).map(|i| f.row(i).map(|(j, x)| (j, round(x))).collect()).collect();
    let mut b = vec![0.0; f.len()];
    // What is left out is exp(-20), 2e-9.
    for _ in 0..(20.0 / (1.0 - albedo)) as usize {
        let bounce = |row: &Vec<(usize, f64)>| {
            let sum = row.iter().fold(0.0, |sum, &(j, x)| round(sum + round(x * b[j])));
            round(1.0 + round(albedo * sum))
        };
        b = rows.iter().map(bounce).collect();
    }
    b.iter().map(|b| (b * (1.0 - albedo) - 1.0).abs()).fold(0.0, f64::max)
}

/// The matrix of a small closed room.
pub fn furnace() -> FormFactors {
    let mut world = World::new();
    let grey = world.grey(0.5, 1.0);
    world.room(DVec3::ZERO, DVec3::new(1.0, 1.2, 0.9), grey);
    world.build().bake(&BakeOptions { primary: Primary::Radiosity, ..options(2, 64) }).form_factors
}

/// Single precision, as a fold would round it.
pub fn single(x: f64) -> f64 {
    x as f32 as f64
}

#[test]
fn single_precision_would_err_at_high_albedo_where_double_does_not() {
    let albedo = 0.9999_f32 as f64;
    let f = furnace();
    let (double, single) = (furnace_error(&f, albedo, |x| x), furnace_error(&f, albedo, single));
    println!("furnace at albedo {albedo}: f64 errs by {double:.1e}, f32 by {single:.1e}");
    // Half an ulp of rounding in each of the sums, 1 / (1 - rho) of them: 3e-4 in single precision, and rows of 64
    // roundings have a multiple of it.
    assert!(double < 4e-9);
    assert!(single > 3e-5 && single < 64.0 * 3e-4, "{single}");
}
