//! Test cases of CIE 171:2006, as whole bakes.

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions,
    options::Reconstruct,
    progress::Silent,
    selftest::{
        cie::{self, FLUX},
        closed_forms::{CIE_5_8_POINTS, closed_mean, cycles::CIE_5_8 as CYCLES_5_8},
    },
};

use crate::{
    common::{Stage, World, faces, options, red, vertex_mean, worst},
    passes,
};

#[test]
fn cie_5_3_area_source_in_a_black_room() {
    passes("CIE 5.3");
}

#[test]
fn cie_5_3_does_not_depend_on_the_patches() {
    let stage = World::from(cie::area_source()).build();
    let points: Vec<_> = cie::area_source_places().into_iter().map(|(p, n)| stage.point(p, n)).collect();
    let light = stage.bake(&faces(options(16, 64))).irradiance(&points, &Silent);
    // Half a unit of the published table's last digit.
    assert!(worst(&red(&light.direct), &cie::area_source_answers()) < 0.005 / 32.68);
    assert!(light.indirect.iter().all(|e| *e == Vec3::ZERO));
}

#[test]
fn cie_5_4_conservation_of_flux() {
    passes("CIE 5.4");
}

/// The lit floor of 4 m, and a square of 0.5 m: rows of 256 rays would meet that with less than one, so it is a bright patch
/// and sends its light by shadow rays.
#[test]
fn cie_5_6_one_bounce() {
    passes("CIE 5.6");
}

#[test]
fn cie_5_8_cube_as_built_and_turned() {
    passes("CIE 5.8");
}

/// A final gather over a coarse grid: what is left of the voxels is their constant radiosity, seen from afar.
#[test]
fn cie_5_8_points_and_mean_by_final_gather() {
    let (rho, expected) = CIE_5_8_POINTS[1];
    let stage: Stage = World::from(cie::cube(Vec3::splat(rho as f32), true)).build();
    let gather = BakeOptions { reconstruct: Reconstruct::Gather, gather_rays: 4096, ..options(40, 1024) };
    let bake = stage.bake(&gather);
    let points: Vec<_> = cie::cube_places().into_iter().map(|(p, n)| stage.point(p, n)).collect();
    let indirect = bake.irradiance_with(&points, 1, &Silent).indirect;
    let largest = worst(&red(&indirect), &expected.repeat(6));
    println!("CIE 5.8, points by gather, grid 40: largest error {:.3} %", 100.0 * largest);
    assert!(largest < CYCLES_5_8, "{largest}");

    // Midpoints of 20 x 20 cells of every face.
    let on_face = |axis: usize, side: f64, a: f64, b: f64| {
        let mut p = DVec3::ZERO;
        (p[axis], p[(axis + 1) % 3], p[(axis + 2) % 3]) = (2.0 * side, a, b);
        stage.point(p.to_array(), (DVec3::AXES[axis] * -side).to_array())
    };
    let cell = |k: usize| -2.0 + 4.0 * (k as f64 + 0.5) / 20.0;
    let points: Vec<_> =
        (0..2400).map(|i| on_face(i % 3, (i / 3 % 2) as f64 * 2.0 - 1.0, cell(i / 6 % 20), cell(i / 120))).collect();
    let light = red(&bake.irradiance_with(&points, 1, &Silent).indirect);
    let mean = light.iter().sum::<f64>() / 2400.0 / closed_mean(FLUX, 96.0, rho) - 1.0;
    println!("CIE 5.8, mean by gather, grid 40: {:+.4} %", 100.0 * mean);
    assert!(mean.abs() < CYCLES_5_8, "{mean}");
}

/// Bright patches send their first reflection by shadow rays; gathering rays that meet them must not count it again.
#[test]
fn cie_5_6_of_a_small_square_is_gathered_once() {
    let gather = BakeOptions { reconstruct: Reconstruct::Gather, ..options(32, 256) };
    let stage: Stage = World::from(cie::one_bounce(0.5)).build();
    let points: Vec<_> = cie::one_bounce_places(0.5).into_iter().map(|(p, n)| stage.point(p, n)).collect();
    let light = red(&stage.bake(&gather).irradiance(&points, &Silent).indirect);
    for (got, expected) in light.iter().zip(cie::one_bounce_answers(0.5)) {
        let error = got / expected - 1.0;
        assert!(error.abs() < 0.0005 / expected + 5e-4, "{got}, expected {expected}");
    }
}

/// The voxel trap: voxel faces of a turned cube have a larger area than its walls.
#[test]
fn voxel_faces_of_a_turned_cube_hold_the_wrong_energy_and_surfels_the_right_one() {
    let stage: Stage = World::from(cie::cube(Vec3::splat(0.5), true)).build();
    let error = |options: &BakeOptions| {
        let bake = stage.bake(options);
        vertex_mean(&bake, &bake.vertices.indirect) / closed_mean(FLUX, 96.0, 0.5) - 1.0
    };
    let (surfels, staircase) = (error(&options(24, 256)), error(&faces(options(24, 256))));
    println!("voxel trap, turned cube: surfels {:+.2} %, faces {:+.2} %", 100.0 * surfels, 100.0 * staircase);
    // Linear interpolation of a light that bends down towards the edges lies below it, by O(h^2).
    assert!(surfels.abs() < 0.01);
    assert!(staircase.abs() > 0.1);
}
