//! Bugs that were, as cases that must not come back.

mod common;

use common::{World, options};
use glam::{DAffine3, DVec3, Vec3};
use luxel::{
    BakeOptions,
    options::{Reconstruct, Resolution},
    progress::Silent,
    scene::SurfacePoint,
    scene::WorldLight,
    selftest::{cie, closed_forms::point_to_polygon},
    simplify::{self, Grid},
};

/// A furnished room with a lamp.
fn room() -> World {
    let mut world = World::new();
    let (wall, lamp) = (world.grey(0.7, 0.0), world.grey(0.2, 5.0));
    world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), wall);
    world.block(DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35), wall);
    world.quad("lamp", DVec3::new(0.4, 0.4, 0.75), DVec3::Y * 0.3, DVec3::X * 0.3, lamp);
    world
}

#[test]
fn the_number_of_fragments_is_foretold() {
    let mut world = room();
    let wall = world.grey(0.5, 0.0);
    world.sphere(DVec3::new(0.9, 0.5, 0.4), 0.25, 2, wall);
    world.transform(common::rotation());
    let scene = world.build().scene;
    for n in [4, 16, 64] {
        let grid = Grid::new(&scene, Resolution::Grid(n)).unwrap();
        let (expected, got) = (simplify::expected_fragments(&scene, &grid), simplify::clip(&scene, &grid).len() as f64);
        // A triangle meets one cell more or less with its place, independently: some 350 triangles, 3 sigma.
        assert!((got - expected).abs() < 3.0 * 350_f64.sqrt() + 0.02 * expected, "{n}: {got} for {expected}");
    }
}

#[test]
fn more_fragments_than_memory_can_hold_are_refused_with_a_remedy() {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    for k in 0..200 {
        let z = k as f64 * 0.005;
        world.quad("sheet", DVec3::new(0.0, 0.0, z), DVec3::X, DVec3::Y + DVec3::Z, grey);
    }
    world.point_light(DVec3::splat(0.5), 1.0);
    let scene = world.build().scene;
    let fine = options(4096, 16);
    for error in [
        luxel::bake(&scene, &fine, &Silent).err().expect("far too many pieces").to_string(),
        luxel::forecast(&scene, &fine).expect_err("far too many pieces").to_string(),
    ] {
        assert!(error.contains("pieces of surface") && error.contains("choose --grid"), "{error}");
    }
}

#[test]
fn voxels_that_do_not_fit_are_refused_instead_of_clamped() {
    let scene = room().build().scene;
    let of = |resolution| BakeOptions { resolution, ..options(8, 16) };
    for resolution in [
        Resolution::Grid(0),
        Resolution::Grid(4097),
        Resolution::Voxel(1e9),
        Resolution::Voxel(1e-9),
        Resolution::Voxel(-1.0),
        Resolution::Voxel(f64::NAN),
    ] {
        let error = luxel::bake(&scene, &of(resolution), &Silent).err().expect("voxels that do not fit").to_string();
        assert!(error.contains("choose --voxel from"), "{resolution:?}: {error}");
    }
}

#[test]
fn points_that_are_none_are_dark_and_change_no_others() {
    let scene = room().build().scene;
    for reconstruct in [Reconstruct::Smooth, Reconstruct::Nearest4] {
        let bake = luxel::bake(&scene, &BakeOptions { reconstruct, ..options(8, 64) }, &Silent).unwrap();
        let good = bake.mesh.samples[10];
        let bad = [
            SurfacePoint { position: Vec3::NAN, ..good },
            SurfacePoint { position: Vec3::INFINITY, ..good },
            SurfacePoint { normal: Vec3::NAN, ..good },
            SurfacePoint { normal: Vec3::ZERO, ..good },
            SurfacePoint { normal: 3.0 * good.normal, ..good },
        ];
        let far = SurfacePoint { position: Vec3::splat(1e30), ..good };
        let all: Vec<SurfacePoint> = bad.into_iter().chain([good, far, bake.mesh.samples[40]]).collect();
        let light = bake.irradiance(&all, &Silent);
        for (i, point) in bad.iter().enumerate() {
            assert_eq!((light.direct[i], light.indirect[i]), (Vec3::ZERO, Vec3::ZERO), "{point:?}");
        }
        assert!(light.direct.iter().chain(&light.indirect).all(|e| e.is_finite()));
        let reversed = bake.irradiance(&all.iter().rev().copied().collect::<Vec<_>>(), &Silent);
        assert!(light.indirect.iter().eq(reversed.indirect.iter().rev()));
        assert!(light.direct.iter().eq(reversed.direct.iter().rev()));
        assert_eq!(light.indirect[bad.len()], bake.vertices.indirect[10]);
    }
}

#[test]
fn blinding_light_stays_finite() {
    let mut world = World::new();
    let white = world.grey(0.99, 0.0);
    world.room(DVec3::ZERO, DVec3::ONE, white);
    world.block(DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35), white);
    world.point_light(DVec3::new(0.8, 0.8, 0.5), 3e38);
    let bake = world.build().bake(&options(8, 64));
    let all = [&bake.vertices.direct, &bake.vertices.indirect, &bake.light.direct, &bake.light.indirect];
    for (k, values) in all.into_iter().enumerate() {
        assert!(values.iter().all(|e| e.is_finite()), "{k}: {:?}", values.iter().find(|e| !e.is_finite()));
    }
}

#[test]
fn no_sky_leaks_into_a_closed_room_at_its_edges_and_corners() {
    for turn in [DAffine3::IDENTITY, common::rotation()] {
        let mut world = World::new();
        let grey = world.grey(0.5, 0.0);
        world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), grey);
        world.block(DVec3::new(0.5, 0.2, 0.0), DVec3::new(0.7, 0.5, 0.3), grey);
        world.builder.add_light(WorldLight::Sky { radiance: Vec3::splat(100.0) });
        world.point_light(DVec3::new(0.6, 0.7, 0.5), 10.0);
        world.transform(turn);
        let stage = world.build();
        let bake = stage.bake(&options(12, 64));
        let near = 1e-3;
        // In the edges and corners of floor, walls and block; and the same a little before.
        let pairs = [
            ([0.0, 0.5, 0.0], [near, 0.5, 0.0]),
            ([0.3, 1.0, 0.0], [0.3, 1.0 - near, 0.0]),
            ([0.0, 0.0, 0.0], [near, near, 0.0]),
            ([1.3, 1.0, 0.0], [1.3 - near, 1.0 - near, 0.0]),
            ([0.6, 0.5, 0.0], [0.6, 0.5 + near, 0.0]),
        ];
        for (edge, inside) in pairs {
            let points = [edge, inside].map(|p| stage.point(p, [0.0, 0.0, 1.0]));
            let light = bake.irradiance(&points, &Silent);
            let (got, expected) = (light.direct[0].x, light.direct[1].x);
            // Light of the point lamp alone changes by less over the distance; the sky would give 100 times it.
            assert!((got / expected - 1.0).abs() < 0.01, "{edge:?}: {got} for {expected}");
        }
    }
}

/// Backs are black. Gathering points once left out the rays that met them, as if the rest of the view were there too.
#[test]
fn the_back_of_a_sheet_hides_what_is_behind_it_from_a_gathering_point() {
    // Test 5.6 of CIE 171 with a black sheet half way up, its back to the ceiling; the sun comes in below it.
    let mut world = World::from(cie::one_bounce(4.0));
    let black = world.grey(0.0, 0.0);
    world.quad("sheet", DVec3::new(1.5, 1.25, 1.5), DVec3::Y, DVec3::X, black);
    let stage = world.build();
    let mut bake = stage.bake(&options(24, 64));
    let rays = 65536;
    bake.set_reconstruct(Reconstruct::Gather, rays);

    let (place, normal) = ([2.0, 1.75, 3.0], [0.0, 0.0, -1.0]);
    let got = bake.irradiance(&[stage.point(place, normal)], &Silent).indirect[0].x as f64;
    let square = |low: [f64; 2], edge: f64| {
        let corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        corners.map(|[x, y]| DVec3::new(low[0] + edge * x, low[1] + edge * y, 0.0))
    };
    let share = |polygon: &[DVec3]| point_to_polygon(place.into(), normal.into(), polygon);
    // The sheet's shadow from the point is twice as large as the sheet.
    let seen = share(&square([0.0, 0.0], 4.0)) - share(&square([1.0, 0.75], 2.0));
    // Of independent rays; those of a gather are spread evenly, and err by less.
    let sigma = (seen * (1.0 - seen) / rays as f64).sqrt();
    println!("{got} for {}, sigma {}", 100.0 * seen, 100.0 * sigma);
    assert!((got - 100.0 * seen).abs() < 4.0 * 100.0 * sigma, "{got} for {}", 100.0 * seen);
}
