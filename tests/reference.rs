//! The path tracer against closed forms, another path tracer and the direct light of the baker, in sigmas.

mod common;

use std::path::PathBuf;

use common::{Stage, World, rotation};
use glam::{DVec3, Vec3};
use luxel::{
    light::{self, LightSet},
    options::Backend,
    progress::Silent,
    reference::{Reference, ReferenceOptions, Until, irradiance},
    scene::{self, SceneOverrides, SurfacePoint, WorldLight, light::Environment},
    trace,
};

fn samples(n: u32) -> ReferenceOptions {
    ReferenceOptions { until: Until::Samples(n), seed: 1 }
}

fn traced_on(backend: Backend, stage: &Stage, points: &[SurfacePoint], options: &ReferenceOptions) -> Reference {
    let tracer = trace::build(backend, &stage.scene.geometry()).unwrap();
    irradiance(&stage.scene, &*tracer, points, options, &Silent).unwrap()
}

fn traced(stage: &Stage, points: &[SurfacePoint], n: u32) -> Reference {
    traced_on(Backend::Auto, stage, points, &samples(n))
}

/// Quantiles of Student's t with 15 degrees of freedom (those of one round) are at most these: one value in 10^5 is
/// beyond 6.5, and no test has more than 100. Few values only, so that a wrong one shows in the sum of squares too.
const FAR: f64 = 6.5;

/// Fails if values are not those expected, within their standard errors and `rounding` (relative). One band.
fn assert_agree(what: &str, values: &[Vec3], errors: &[Vec3], expected: &[f64], rounding: f64) {
    let mut squares = 0.0;
    for (i, expected) in expected.iter().enumerate() {
        let (value, error) = (values[i].x as f64, errors[i].x as f64);
        let beyond = ((value - expected).abs() - rounding * expected.abs()).max(0.0);
        let sigmas = if beyond > 0.0 { beyond / error } else { 0.0 };
        println!("{what}, {i}: {value:.5} +- {error:.5}, expected {expected:.5}: {sigmas:.2} sigmas");
        assert!(sigmas < FAR, "{what}, {i}");
        squares += sigmas * sigmas;
    }
    assert_squares(what, squares, expected.len());
}

/// The squares of n t-values with 15 degrees of freedom: mean 15/13, variance 3.39.
fn assert_squares(what: &str, squares: f64, n: usize) {
    let n = n as f64;
    println!("{what}: mean square {:.3} of {n}", squares / n);
    assert!(squares / n < 15.0 / 13.0 + 5.0 * (3.39 / n).sqrt(), "{what}: {}", squares / n);
}

#[test]
fn cie_5_3_area_source_in_a_black_room() {
    let expected = [32.68, 75.19, 81.32, 69.06, 53.40, 40.00, 61.42, 79.26, 95.67, 105.78];
    // Once as a light that is no surface, in the plane of the ceiling; once as a surface just below it.
    for surface in [false, true] {
        let mut world = World::new();
        let (black, lamp) = (world.grey(0.0, 0.0), world.grey(0.0, 1000.0));
        world.room(DVec3::ZERO, DVec3::new(4.0, 4.0, 3.0), black);
        if surface {
            world.quad("lamp", DVec3::new(1.5, 1.5, 2.9999), DVec3::Y, DVec3::X, lamp);
        } else {
            world.builder.add_light(WorldLight::Rectangle {
                corner: DVec3::new(1.5, 1.5, 3.0),
                edge_u: DVec3::Y,
                edge_v: DVec3::X,
                radiance: Vec3::splat(1000.0),
            });
        }
        let stage = world.build();
        let mut points: Vec<_> =
            (0..6).map(|k| stage.point([2.0, 0.0, 2.75 - 0.5 * k as f64], [0.0, 1.0, 0.0])).collect();
        points.extend((0..4).map(|k| stage.point([2.0, 0.25 + 0.5 * k as f64, 0.0], [0.0, 0.0, 1.0])));
        let r = traced(&stage, &points, 4096);
        assert!(r.indirect.iter().all(|e| *e == Vec3::ZERO));
        // Half a digit of the table; 0.1 mm lower is up to 2e-4 of the light.
        assert_agree("CIE 5.3", &r.direct, &r.direct_error, &expected, 2e-4);
        assert!(r.direct_error.iter().zip(expected).all(|(e, v)| e.x as f64 / v < 0.01), "{:?}", r.direct_error);
    }
}

/// Points spread over the walls of a room, cosine-free: each wall in proportion to its area.
fn room_points(stage: &Stage, size: DVec3, per_metre: f64) -> Vec<SurfacePoint> {
    let mut points = Vec::new();
    for axis in 0..3 {
        let (a, b) = ((axis + 1) % 3, (axis + 2) % 3);
        let (na, nb) = ((size[a] * per_metre) as usize, (size[b] * per_metre) as usize);
        for i in 0..2 * na * nb {
            let (side, i) = (i % 2, i / 2);
            let (mut p, mut n) = ([0.0; 3], [0.0; 3]);
            p[axis] = side as f64 * size[axis];
            p[a] = ((i % na) as f64 + 0.5) / per_metre;
            p[b] = ((i / na) as f64 + 0.5) / per_metre;
            n[axis] = 1.0 - 2.0 * side as f64;
            points.push(stage.point(p, n));
        }
    }
    points
}

#[test]
fn cie_5_4_walls_receive_all_of_an_isotropic_source() {
    let mut world = World::new();
    let black = world.grey(0.0, 0.0);
    let size = DVec3::new(4.0, 4.0, 3.0);
    world.room(DVec3::ZERO, size, black);
    world.point_light(DVec3::new(2.0, 2.0, 1.5), 10_000.0);
    let stage = world.build();
    let points = room_points(&stage, size, 8.0);
    let r = traced(&stage, &points, 2);
    let flux = r.direct.iter().map(|e| e.x as f64).sum::<f64>() / 64.0;
    println!("CIE 5.4: {flux:.1} lm, {} points", points.len());
    // One lamp: no noise. The midpoint rule errs by h^2 / 24 of the second derivatives, 0.1 % here.
    assert!((flux / 10_000.0 - 1.0).abs() < 1e-3, "{flux}");
    assert!(r.direct_error.iter().all(|e| *e == Vec3::ZERO));
}

/// A cube of 4 m, one albedo, 10 klm in its middle.
fn cube(albedo: f32, turned: bool) -> Stage {
    let mut world = World::new();
    let grey = world.grey(albedo, 0.0);
    world.room(DVec3::splat(-2.0), DVec3::splat(2.0), grey);
    world.point_light(DVec3::ZERO, 10_000.0);
    if turned {
        world.transform(rotation());
    }
    world.build()
}

#[test]
fn cie_5_8_points_of_a_cube_turned_or_not() {
    let places = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.5, 1.5], [1.75, 1.75]];
    let cases = [(0.1, [12.95, 12.73, 12.18, 10.33, 8.73]), (0.5, [112.04, 110.88, 107.78, 96.86, 86.42])];
    for ((rho, expected), turned) in cases.into_iter().zip([true, false]) {
        let stage = cube(rho, turned);
        let points: Vec<_> = places.iter().map(|[a, b]| stage.point([*a, *b, -2.0], [0.0, 0.0, 1.0])).collect();
        let r = traced(&stage, &points, 65_536);
        // The table is good to 0.05 %, and half a digit of 8.73 is more.
        assert_agree("CIE 5.8", &r.indirect, &r.indirect_error, &expected, 6e-4);
        let direct = [198.94, 142.35, 108.29, 64.22, 49.40];
        assert_agree("CIE 5.8, direct", &r.direct, &r.direct_error, &direct, 2e-4);
        assert!(r.indirect_error.iter().zip(expected).all(|(e, v)| (e.x as f64) < 0.005 * v));
    }
}

#[test]
fn cie_5_8_means_at_albedos_up_to_the_largest() {
    for (rho, paths) in [(0.05, 64), (0.5, 64), (0.95, 64), (0.9999, 2)] {
        let stage = cube(rho, false);
        // The corner of the cube is the corner of its world.
        let size = DVec3::splat(4.0);
        let shifted: Vec<_> = room_points(&stage, size, 2.0)
            .into_iter()
            .map(|p| {
                let world = stage.scene.frame.to_world(p.position) - DVec3::splat(2.0);
                SurfacePoint { position: stage.scene.frame.to_local(world), ..p }
            })
            .collect();
        let r = traced(&stage, &shifted, paths);
        let n = shifted.len() as f64;
        let mean = r.indirect.iter().map(|e| e.x as f64).sum::<f64>() / n;
        // Points are independent of each other.
        let error = r.indirect_error.iter().map(|e| (e.x as f64).powi(2)).sum::<f64>().sqrt() / n;
        let rho = rho as f64;
        let expected = 10_000.0 / 96.0 * rho / (1.0 - rho);
        println!("CIE 5.8, albedo {rho}: {mean:.2} +- {error:.2}, expected {expected:.2}; {} rays", r.rays);
        // The midpoint rule lies above the mean of a light that falls towards the edges: 0.3 % with cells of 0.5 m for the
        // share that the first reflection has, and no more.
        let curved = 0.004 * 10_000.0 / 96.0 * rho;
        assert!((mean - expected).abs() < 4.5 * error + curved, "{rho}: {mean} {error} {expected}");
        assert!(error < 0.05 * expected, "{rho}");
        assert_eq!((r.escaped, r.hidden), (0, 0));
    }
}

#[test]
fn in_a_white_furnace_all_points_are_lit_alike() {
    for (albedo, paths) in [(0.5_f32, 256), (0.9, 256)] {
        let mut world = World::new();
        let glowing = world.grey(albedo, 1.0 / std::f32::consts::PI);
        world.room(DVec3::ZERO, DVec3::ONE, glowing);
        world.block(DVec3::new(0.2, 0.3, 0.0), DVec3::new(0.5, 0.6, 0.4), glowing);
        let stage = world.build();
        // On the floor, in a corner of the block with it, on the block.
        let points = [
            stage.point([0.8, 0.7, 0.0], [0.0, 0.0, 1.0]),
            stage.point([0.51, 0.45, 0.0], [0.0, 0.0, 1.0]),
            stage.point([0.3, 0.4, 0.4], [0.0, 0.0, 1.0]),
            stage.point([0.999, 0.001, 0.5], [-1.0, 0.0, 0.0]),
        ];
        let r = traced(&stage, &points, paths * 16);
        // Exitance 1 from all sides; indirect: what is reflected, rho / (1 - rho).
        assert_agree("furnace, direct", &r.direct, &r.direct_error, &[1.0; 4], 1e-5);
        let indirect = (albedo / (1.0 - albedo)) as f64;
        assert_agree("furnace, indirect", &r.indirect, &r.indirect_error, &[indirect; 4], 1e-4);
        let total: Vec<Vec3> = r.direct.iter().zip(&r.indirect).map(|(a, b)| a + b).collect();
        assert_agree("furnace, total", &total, &r.total_error, &[1.0 + indirect; 4], 1e-4);
        // Looking for lamps next to the point finds them far too bright; weighed, nothing stays of that.
        assert!(r.total_error.iter().all(|e| (e.x as f64) < 0.03 * (1.0 + indirect)), "{:?}", r.total_error);
    }
}

#[test]
fn a_sphere_is_lit_evenly_by_a_lamp_anywhere() {
    let mut world = World::new();
    let grey = world.grey(0.7, 0.0);
    world.sphere(DVec3::ZERO, 1.0, 4, grey);
    world.point_light(DVec3::new(-0.4, 0.5, 0.3), 100.0);
    let stage = world.build();
    let expected = 100.0 * 0.7 / (stage.area() * 0.3);
    let points: Vec<_> = (0..24)
        .map(|t| {
            let [a, b, c] = stage.scene.corners_of(t * 211);
            SurfacePoint { position: (a + b + c) / 3.0, normal: stage.scene.normal(t * 211) }
        })
        .collect();
    let r = traced(&stage, &points, 4096);
    // Facets stand off the sphere's normals by half an edge, 1.1 / 16.
    let facets = 2.0 * (0.5 * 1.1 / 16.0_f64).powi(2);
    assert_agree("sphere", &r.indirect, &r.indirect_error, &[expected; 24], facets);
}

/// A room with things in it and one lamp of each kind that is asked for.
fn furnished(lights: &[WorldLight], glow: f32, open: bool) -> Stage {
    let mut world = World::new();
    let (wall, lamp) = (world.grey(0.6, 0.0), world.grey(0.2, glow));
    if open {
        world.quad("floor", DVec3::ZERO, DVec3::X, DVec3::Y, wall);
        world.quad("wall", DVec3::ZERO, DVec3::Y, DVec3::Z, wall);
    } else {
        world.room(DVec3::ZERO, DVec3::ONE, wall);
    }
    world.block(DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35), wall);
    if glow > 0.0 {
        world.block(DVec3::new(0.7, 0.7, 0.5), DVec3::new(0.8, 0.85, 0.55), lamp);
    }
    lights.iter().for_each(|light| world.builder.add_light(light.clone()));
    world.build()
}

fn furnished_points(stage: &Stage) -> Vec<SurfacePoint> {
    let mut points = Vec::new();
    for i in 0..5 {
        let t = 0.1 + 0.2 * i as f64;
        points.push(stage.point([t, 0.61, 0.0], [0.0, 0.0, 1.0]));
        points.push(stage.point([0.0, t, 0.37], [1.0, 0.0, 0.0]));
    }
    points.push(stage.point([0.4, 0.4, 0.35], [0.0, 0.0, 1.0]));
    points
}

/// Every kind of light, with a name, how much the closed form may err, and whether the room is open.
fn every_light() -> Vec<(&'static str, Stage)> {
    let white = Vec3::splat(3.0);
    let above = DVec3::new(0.2, 0.8, 0.9);
    let down = DVec3::new(0.3, -0.4, -1.0).normalize();
    let edge = DVec3::new(0.3, 0.0, 0.05);
    let image = |x: u32, y: u32| Vec3::splat(if (x, y) == (11, 3) { 400.0 } else { ((x * 7 + y * 5) % 4) as f32 });
    let texels = (0..16 * 8).map(|i| image(i % 16, i / 16)).collect();
    let environment = Environment { width: 16, height: 8, texels, up: Vec3::Z };
    let one = |light: WorldLight, open: bool| furnished(&[light], 0.0, open);
    let rectangle =
        |corner: DVec3| WorldLight::Rectangle { corner, edge_u: edge, edge_v: DVec3::Y * -0.2, radiance: white };
    vec![
        ("surface", furnished(&[], 5.0, false)),
        ("rectangle", one(rectangle(above), false)),
        ("rectangle close to a wall", one(rectangle(DVec3::new(0.01, 0.7, 0.4)), false)),
        ("disc", one(WorldLight::Disc { centre: above, normal: down, radius: 0.15, radiance: white }, false)),
        ("point", one(WorldLight::Point { position: above, intensity: white, range: f64::INFINITY }, false)),
        ("point with a range", one(WorldLight::Point { position: above, intensity: white, range: 1.1 }, false)),
        (
            "spot",
            one(
                WorldLight::Spot {
                    position: above,
                    direction: down,
                    intensity: white,
                    inner: 15.0,
                    outer: 50.0,
                    range: f64::INFINITY,
                },
                false,
            ),
        ),
        ("sun", one(WorldLight::Sun { direction: down, irradiance: white }, true)),
        ("sky", one(WorldLight::Sky { radiance: white }, true)),
        ("environment", one(WorldLight::Environment(environment), true)),
        (
            "several",
            furnished(
                &[
                    rectangle(above),
                    WorldLight::Point { position: DVec3::new(0.9, 0.1, 0.5), intensity: white, range: f64::INFINITY },
                    WorldLight::Disc { centre: DVec3::splat(0.7), normal: down, radius: 0.1, radiance: white },
                ],
                5.0,
                false,
            ),
        ),
    ]
}

#[test]
fn direct_light_of_every_kind_is_that_of_the_baker() {
    for (what, stage) in every_light() {
        let points = furnished_points(&stage);
        let r = traced(&stage, &points, 8192);
        let tracer = trace::build(Backend::Auto, &stage.scene.geometry()).unwrap();
        let lights = LightSet::new(&stage.scene);
        // Independent sets of rays: their scatter is the noise of the closed forms' shadows.
        let sets: Vec<Vec<Vec3>> =
            (0..8).map(|seed| light::irradiance(&lights, &*tracer, &points, 1, 4096, seed).irradiance).collect();
        let mut squares = 0.0;
        for i in 0..points.len() {
            let mean = sets.iter().map(|s| s[i].x as f64).sum::<f64>() / 8.0;
            let variance = sets.iter().map(|s| (s[i].x as f64 - mean).powi(2)).sum::<f64>() / 56.0;
            let (got, error) = (r.direct[i].x as f64, (r.direct_error[i].x as f64).powi(2) + variance);
            // Rounding of positions near the lamp, of single precision sums.
            let beyond = ((got - mean).abs() - 1e-4 * mean).max(0.0);
            let sigmas = if beyond > 0.0 { beyond / error.sqrt() } else { 0.0 };
            assert!(sigmas < FAR, "{what}, point {i}: {got} +- {}, baker {mean}: {sigmas} sigmas", error.sqrt());
            squares += sigmas * sigmas;
        }
        assert_squares(what, squares, points.len());
        let lit = r.direct.iter().filter(|e| e.x > 0.0).count();
        println!("{what}: {lit} points lit, {:.3?}", r.direct.iter().map(|e| e.x).collect::<Vec<_>>());
        assert!(lit >= 3, "{what}: {lit} points lit");
        assert!(r.relative_error < 0.02, "{what}: {}", r.relative_error);
    }
}

#[test]
fn all_backends_trace_the_same_paths() {
    let (_, stage) = every_light().pop().unwrap();
    let points = furnished_points(&stage);
    let oracle = traced_on(Backend::Brute, &stage, &points, &samples(256));
    let embree = cfg!(feature = "embree").then_some(Backend::Embree);
    for backend in [Some(Backend::Bvh), embree].into_iter().flatten() {
        let r = traced_on(backend, &stage, &points, &samples(256));
        // The same random numbers: paths part only where rounding at an edge parts them, a few of 2816.
        let differ = r.indirect.iter().zip(&oracle.indirect).filter(|(a, b)| (*a - *b).length() > 1e-3 * b.length());
        assert!(differ.count() <= 2, "{backend:?}");
        assert!((r.rays as f64 / oracle.rays as f64 - 1.0).abs() < 1e-3);
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_number_of_threads() {
    let (_, stage) = every_light().pop().unwrap();
    let points: Vec<_> = (0..40).flat_map(|_| furnished_points(&stage)).collect();
    let until = Until::StandardError { relative: 0.08, most: 4000 };
    let on = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| traced_on(Backend::Auto, &stage, &points, &ReferenceOptions { until, seed }))
    };
    let (one, five, other) = (on(1, 3), on(5, 3), on(2, 4));
    assert_eq!((&one.direct, &one.indirect, &one.total_error), (&five.direct, &five.indirect, &five.total_error));
    assert_eq!((one.samples, one.rays), (five.samples, five.rays));
    assert_ne!(one.indirect, other.indirect);
    assert!(one.converged && one.relative_error <= 0.08, "{}", one.relative_error);
}

#[test]
fn standard_errors_are_those_that_seeds_show() {
    let (_, stage) = every_light().pop().unwrap();
    let points = furnished_points(&stage);
    let runs: Vec<Reference> = (0..32)
        .map(|seed| traced_on(Backend::Auto, &stage, &points, &ReferenceOptions { until: Until::Samples(128), seed }))
        .collect();
    let n = runs.len() as f64;
    for (what, of) in [
        ("direct", (|r, i| (r.direct[i].x, r.direct_error[i].x)) as fn(&Reference, usize) -> (f32, f32)),
        ("indirect", |r, i| (r.indirect[i].x, r.indirect_error[i].x)),
        ("total", |r, i| ((r.direct[i] + r.indirect[i]).x, r.total_error[i].x)),
    ] {
        let (mut seen, mut told) = (0.0, 0.0);
        for i in 0..points.len() {
            let mean = runs.iter().map(|r| of(r, i).0 as f64).sum::<f64>() / n;
            seen += runs.iter().map(|r| (of(r, i).0 as f64 - mean).powi(2)).sum::<f64>() / (n - 1.0);
            told += runs.iter().map(|r| (of(r, i).1 as f64).powi(2)).sum::<f64>() / n;
        }
        // Both are variances from (32 - 1) x 11 and 32 x 11 x 15 degrees of freedom, if all points count alike; a few
        // noisy points count for most: as if there were three. Relative deviation sqrt(2 / 93) = 0.15.
        println!("{what}: variance told / seen {:.3}", told / seen);
        assert!((told / seen - 1.0).abs() < 4.0 * 0.15, "{what}: told {told}, seen {seen}");
    }
}

#[test]
fn points_without_sense_get_no_light_and_options_without_sense_an_error() {
    let (_, stage) = every_light().remove(0);
    let mut points = furnished_points(&stage);
    points[1].position.x = f32::NAN;
    points[2].normal = Vec3::ZERO;
    let r = traced(&stage, &points, 64);
    assert!([1, 2].iter().all(|&i| r.direct[i] == Vec3::ZERO && r.total_error[i] == Vec3::ZERO));
    assert!(r.direct[0].x > 0.0 && r.direct.iter().all(|e| e.is_finite()));
    assert!(traced(&stage, &[], 64).direct.is_empty());

    let tracer = trace::build(Backend::Brute, &stage.scene.geometry()).unwrap();
    for until in [
        Until::Samples(1),
        Until::StandardError { relative: 0.0, most: 1000 },
        Until::StandardError { relative: f64::NAN, most: 1000 },
        Until::StandardError { relative: 0.1, most: 10 },
    ] {
        let options = ReferenceOptions { until, seed: 0 };
        assert!(irradiance(&stage.scene, &*tracer, &points, &options, &Silent).is_err(), "{until:?}");
    }
}

#[test]
fn the_cornell_box_is_that_of_another_path_tracer() {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/cornell");
    let Ok(text) = std::fs::read_to_string(folder.join("ref_center.csv")) else {
        println!("skipped: no reference for the Cornell box");
        return;
    };
    let rows: Vec<Vec<f64>> =
        text.lines().skip(1).map(|l| l.split(',').map(|f| f.parse().unwrap()).collect()).collect();
    let scene = scene::load(&folder.join("cornell.obj"), &SceneOverrides::default()).unwrap().0;
    let points: Vec<SurfacePoint> = rows
        .iter()
        .map(|r| SurfacePoint {
            position: scene.frame.to_local(DVec3::new(r[0], r[1], r[2])),
            normal: DVec3::new(r[3], r[4], r[5]).as_vec3(),
        })
        .collect();
    let tracer = trace::build(Backend::Auto, &scene.geometry()).unwrap();
    let ours = irradiance(&scene, &*tracer, &points, &samples(1024), &Silent).unwrap();
    for c in 0..6 {
        let (values, errors) =
            if c < 3 { (&ours.direct, &ours.direct_error) } else { (&ours.indirect, &ours.indirect_error) };
        let (mut squares, mut bias, mut variance, mut count) = (0.0, 0.0, 0.0, 0);
        for (i, row) in rows.iter().enumerate() {
            let (value, error) = (values[i][c % 3] as f64, errors[i][c % 3] as f64);
            let own = error.powi(2) + row[12 + c].powi(2);
            // Points of the ceiling see no lamp; positions are printed with seven digits.
            if own > 0.0 {
                squares += ((value - row[6 + c]).abs() - 1e-6 * row[6 + c]).max(0.0).powi(2) / own;
                count += 1;
            }
            bias += value - row[6 + c];
            variance += own;
        }
        let bias = bias / variance.sqrt();
        println!("band {c}: mean square {:.3} of {count}, mean {bias:+.2} sigmas", squares / count as f64);
        // The replicates' tails are longer than a normal's: 1.3 instead of 15/13.
        assert!(squares / (count as f64) < 1.3, "band {c}: {}", squares / count as f64);
        assert!(bias.abs() < 4.5, "band {c}: {bias}");
    }
}
