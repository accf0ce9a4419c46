//! Test cases of CIE 171:2006, as whole bakes.

use glam::Vec3;
use luxel::{
    BakeOptions,
    progress::Silent,
    selftest::{
        cie::{self, FLUX},
        closed_forms::closed_mean,
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
