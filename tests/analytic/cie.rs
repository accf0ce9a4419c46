//! Test cases of CIE 171:2006, as whole bakes.

use glam::{DVec3, Vec3};
use luxel::{BakeOptions, options::Reconstruct, progress::Silent, scene::WorldLight};

use crate::common::{Stage, World, faces, options, patch_mean, red, rotation, vertex_mean, worst};

/// Published largest errors of another renderer on cases 5.4, 5.6 and 5.8; ours are smaller.
const CYCLES_5_4: f64 = 0.0028;
const CYCLES_5_6: f64 = 0.0025;
const CYCLES_5_8: f64 = 0.0031;

/// Case 5.3: a diffuse source of 1 m2 and 1000 pi lm in the ceiling of a black room.
#[test]
fn cie_5_3_area_source_in_a_black_room() {
    let wall = [32.68, 75.19, 81.32, 69.06, 53.40, 40.00];
    let floor = [61.42, 79.26, 95.67, 105.78];
    let mut world = World::new();
    let black = world.grey(0.0, 0.0);
    world.room(DVec3::ZERO, DVec3::new(4.0, 4.0, 3.0), black);
    let radiance = Vec3::splat(1000.0);
    world.builder.add_light(WorldLight::Rectangle {
        corner: DVec3::new(1.5, 1.5, 3.0),
        edge_u: DVec3::Y,
        edge_v: DVec3::X,
        radiance,
    });
    let stage = world.build();
    let mut points: Vec<_> = (0..6).map(|k| stage.point([2.0, 0.0, 2.75 - 0.5 * k as f64], [0.0, 1.0, 0.0])).collect();
    points.extend((0..4).map(|k| stage.point([2.0, 0.25 + 0.5 * k as f64, 0.0], [0.0, 0.0, 1.0])));
    let expected: Vec<f64> = wall.into_iter().chain(floor).collect();
    for options in [options(16, 64), faces(options(16, 64))] {
        let light = stage.bake(&options).irradiance(&points, &Silent);
        let error = worst(&red(&light.direct), &expected);
        println!("CIE 5.3: largest error {:.4} %", 100.0 * error);
        // Half a unit of the table's last digit.
        assert!(error < 0.005 / 32.68 + 1e-5, "{error}");
        assert!(light.indirect.iter().all(|e| *e == Vec3::ZERO));
    }
}

/// Case 5.4: the walls of a black room receive all of a point source's flux.
#[test]
fn cie_5_4_conservation_of_flux() {
    let mut world = World::new();
    let black = world.grey(0.0, 0.0);
    world.room(DVec3::ZERO, DVec3::new(4.0, 4.0, 3.0), black);
    world.point_light(DVec3::new(2.0, 2.0, 2.9), FLUX);
    let bake = world.build().bake(&options(32, 64));
    let error = bake.report.energy.direct[0] / FLUX - 1.0;
    println!("CIE 5.4: {:+.4} %", 100.0 * error);
    assert!(error.abs() < CYCLES_5_4, "{error}");
}

/// Case 5.6: a wall and a ceiling, black, over a square of reflectance 0.3 in the sun.
fn one_bounce(edge: f64) -> Stage {
    let mut world = World::new();
    let (black, grey) = (world.grey(0.0, 0.0), world.grey(0.3, 0.0));
    let low = 2.0 - 0.5 * edge;
    world.quad("S2", DVec3::new(low, low, 0.0), DVec3::X * edge, DVec3::Y * edge, grey);
    world.quad("wall", DVec3::ZERO, DVec3::Z * 3.0, DVec3::X * 4.0, black);
    world.quad("ceiling", DVec3::Z * 3.0, DVec3::Y * 4.0, DVec3::X * 4.0, black);
    // Flat enough to come in under the ceiling, along the wall: it lights nothing but S2.
    let direction = DVec3::new(-10.0, 0.0, -1.0);
    let irradiance = Vec3::splat((direction.length() * 100.0 / 0.3) as f32);
    world.builder.add_light(WorldLight::Sun { direction, irradiance });
    world.build()
}

/// Errors at the table's points.
fn one_bounce_errors(edge: f64, options: &BakeOptions, wall: &[f64], ceiling: &[f64]) -> Vec<f64> {
    let stage = one_bounce(edge);
    let bake = stage.bake(options);
    let lowest = 3.0 - 0.5 * wall.len() as f64 + 0.25;
    let mut points: Vec<_> =
        (0..wall.len()).map(|k| stage.point([2.0, 0.0, lowest + 0.5 * k as f64], [0.0, 1.0, 0.0])).collect();
    points.extend((0..4).map(|k| stage.point([2.0, 0.25 + 0.5 * k as f64, 3.0], [0.0, 0.0, -1.0])));
    let light = bake.irradiance(&points, &Silent);
    assert!(light.direct.iter().all(|e| *e == Vec3::ZERO));
    red(&light.indirect).iter().zip(wall.iter().chain(ceiling)).map(|(got, expected)| got / expected - 1.0).collect()
}

fn largest(errors: &[f64]) -> f64 {
    errors.iter().fold(0.0, |most, e| e.abs().max(most))
}

#[test]
fn cie_5_6_one_bounce_from_a_lit_floor() {
    let wall = [35.901, 27.992, 21.639, 16.716, 12.967];
    let errors = one_bounce_errors(4.0, &options(48, 8192), &wall, &[26.80, 30.94, 33.98, 35.57]);
    println!("CIE 5.6, S2 of 4 m: largest error {:.3} %", 100.0 * largest(&errors));
    assert!(largest(&errors) < CYCLES_5_6, "{errors:.4?}");
}

/// Rows of 256 rays would meet the square with less than one: it is a bright patch, and sends its light by shadow rays.
#[test]
fn cie_5_6_one_bounce_from_a_small_square() {
    let wall = [0.246, 0.580, 0.644, 0.556, 0.433, 0.325];
    let ceiling = [0.491, 0.639, 0.778, 0.864];
    let errors = one_bounce_errors(0.5, &options(32, 256), &wall, &ceiling);
    println!("CIE 5.6, S2 of 0.5 m: largest error {:.2} %", 100.0 * largest(&errors));
    for (error, expected) in errors.iter().zip(wall.iter().chain(&ceiling)) {
        // The table has three digits; form factors of the pieces are exact to 1e-5.
        assert!(error.abs() < 0.0005 / expected + 5e-4, "{errors:.4?}");
    }
}

const FLUX: f64 = 10_000.0;

/// Case 5.8: a cube of 4 m with a point source in its middle.
fn cube(albedo: f32, turned: bool) -> Stage {
    let mut world = World::new();
    let grey = world.grey(albedo, 0.0);
    world.room(DVec3::splat(-2.0), DVec3::splat(2.0), grey);
    world.point_light(DVec3::ZERO, FLUX);
    if turned {
        world.transform(rotation());
    }
    world.build()
}

fn mean_indirect(rho: f64) -> f64 {
    FLUX / 96.0 * rho / (1.0 - rho)
}

#[test]
fn cie_5_8_mean_of_a_cube_at_every_reflectance() {
    let table = [
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
    for (rho, lux) in table {
        assert!((mean_indirect(rho) - lux).abs() < 0.005 + 1e-9);
        for turned in [false, true] {
            let bake = cube(rho as f32, turned).bake(&options(10, 1024));
            let error = patch_mean(&bake, &bake.light.indirect) / mean_indirect(rho) - 1.0;
            println!("CIE 5.8, mean, albedo {rho}, turned {turned}: {:+.4} %", 100.0 * error);
            assert!(error.abs() < CYCLES_5_8, "{rho}, {turned}: {error}");
        }
    }
}

#[test]
fn cie_5_8_points_of_a_cube_turned_or_not() {
    let places = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.5, 1.5], [1.75, 1.75]];
    let cases = [(0.1, [12.95, 12.73, 12.18, 10.33, 8.73]), (0.5, [112.04, 110.88, 107.78, 96.86, 86.42])];
    let direct = [198.94, 142.35, 108.29, 64.22, 49.40];
    for ((rho, expected), turned) in cases.into_iter().zip([false, true]) {
        let stage = cube(rho, turned);
        let bake = stage.bake(&options(96, 1024));
        // On all six faces.
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let points: Vec<_> = (places.iter())
                    .map(|[a, b]| {
                        let mut p = DVec3::ZERO;
                        p[axis] = 2.0 * side;
                        p[(axis + 1) % 3] = *a;
                        p[(axis + 2) % 3] = *b;
                        stage.point(p.to_array(), (DVec3::AXES[axis] * -side).to_array())
                    })
                    .collect();
                let light = bake.irradiance(&points, &Silent);
                let error = worst(&red(&light.indirect), &expected);
                println!(
                    "CIE 5.8, points, albedo {rho}, turned {turned}, face {axis} {side}: largest error {:.3} %; {:.2?}",
                    100.0 * error,
                    red(&light.indirect)
                );
                assert!(error < CYCLES_5_8, "{rho}, {turned}: {error}");
                // Four or five digits: half a unit of 49.40.
                assert!(worst(&red(&light.direct), &direct) < 2e-4);
            }
        }
    }
}

/// A final gather over a coarse grid: what is left of the voxels is their constant radiosity, seen from afar.
#[test]
fn cie_5_8_points_and_mean_by_final_gather() {
    let (rho, expected) = (0.5, [112.04, 110.88, 107.78, 96.86, 86.42]);
    let stage = cube(rho, true);
    let gather = BakeOptions { reconstruct: Reconstruct::Gather, gather_rays: 4096, ..options(40, 1024) };
    let bake = stage.bake(&gather);
    let on_face = |axis: usize, side: f64, a: f64, b: f64| {
        let mut p = DVec3::ZERO;
        p[axis] = 2.0 * side;
        p[(axis + 1) % 3] = a;
        p[(axis + 2) % 3] = b;
        stage.point(p.to_array(), (DVec3::AXES[axis] * -side).to_array())
    };
    let places = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.5, 1.5], [1.75, 1.75]];
    let mut largest = 0.0_f64;
    for (axis, side) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
        let points: Vec<_> = places.iter().map(|[a, b]| on_face(axis, side, *a, *b)).collect();
        largest = largest.max(worst(&red(&bake.irradiance_with(&points, 1, &Silent).indirect), &expected));
    }
    println!("CIE 5.8, points by gather, grid 40: largest error {:.3} %", 100.0 * largest);
    assert!(largest < CYCLES_5_8, "{largest}");

    // Midpoints of 20 x 20 cells of every face.
    let cell = |k: usize| -2.0 + 4.0 * (k as f64 + 0.5) / 20.0;
    let points: Vec<_> =
        (0..2400).map(|i| on_face(i % 3, (i / 3 % 2) as f64 * 2.0 - 1.0, cell(i / 6 % 20), cell(i / 120))).collect();
    let light = red(&bake.irradiance_with(&points, 1, &Silent).indirect);
    let mean = light.iter().sum::<f64>() / 2400.0 / mean_indirect(rho as f64) - 1.0;
    println!("CIE 5.8, mean by gather, grid 40: {:+.4} %", 100.0 * mean);
    assert!(mean.abs() < CYCLES_5_8, "{mean}");
}

/// Bright patches send their first reflection by shadow rays; gathering rays that meet them must not count it again.
#[test]
fn cie_5_6_of_a_small_square_is_gathered_once() {
    let wall = [0.246, 0.580, 0.644, 0.556, 0.433, 0.325];
    let ceiling = [0.491, 0.639, 0.778, 0.864];
    let gather = BakeOptions { reconstruct: Reconstruct::Gather, ..options(32, 256) };
    let errors = one_bounce_errors(0.5, &gather, &wall, &ceiling);
    for (error, expected) in errors.iter().zip(wall.iter().chain(&ceiling)) {
        assert!(error.abs() < 0.0005 / expected + 5e-4, "{errors:.4?}");
    }
}

/// The voxel trap: voxel faces of a turned cube have a larger area than its walls.
#[test]
fn voxel_faces_of_a_turned_cube_hold_the_wrong_energy_and_surfels_the_right_one() {
    let stage = cube(0.5, true);
    let error = |options: &BakeOptions| {
        let bake = stage.bake(options);
        vertex_mean(&bake, &bake.vertices.indirect) / mean_indirect(0.5) - 1.0
    };
    let (surfels, staircase) = (error(&options(24, 256)), error(&faces(options(24, 256))));
    println!("voxel trap, turned cube: surfels {:+.2} %, faces {:+.2} %", 100.0 * surfels, 100.0 * staircase);
    // Linear interpolation of a light that bends down towards the edges lies below it, by O(h^2).
    assert!(surfels.abs() < 0.01);
    assert!(staircase.abs() > 0.1);
}
