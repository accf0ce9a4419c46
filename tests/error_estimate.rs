//! What a bake says of its own error is what its error is.

mod common;

use common::{World, faces, options};
use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions,
    bake::Bake,
    options::{PatchSource, Primary, Reconstruct, Resolution},
    output::tonemap::luminance,
    progress::Silent,
    reference::{self, ReferenceOptions, Until},
    scene::{SurfacePoint, WorldLight},
    trace::{Brute, Geometry},
    transfer::{self, Casting, RowPoints, Rows},
};

/// A room with a lamp whose shadows are soft, and a block that hides no floor: light that nobody sees has no truth.
fn room() -> World {
    let mut world = World::new();
    let wall = world.grey(0.7, 0.0);
    world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), wall);
    world.block(DVec3::new(0.31, 0.2, 0.08), DVec3::new(0.6, 0.53, 0.35), wall);
    world.builder.add_light(WorldLight::Rectangle {
        corner: DVec3::new(0.4, 0.4, 0.75),
        edge_u: DVec3::Y * 0.3,
        edge_v: DVec3::X * 0.3,
        radiance: Vec3::splat(5.0),
    });
    world
}

fn estimated(options: BakeOptions) -> BakeOptions {
    BakeOptions { estimate: true, ..options }
}

/// Area of the triangles around each vertex.
fn areas(bake: &Bake) -> Vec<f64> {
    let mut areas = vec![0.0; bake.mesh.positions.len()];
    for t in &bake.mesh.triangles {
        let [a, b, c] = t.map(|v| bake.mesh.positions[v as usize].as_dvec3());
        t.iter().for_each(|&v| areas[v as usize] += (b - a).cross(c - a).length());
    }
    areas
}

fn bright(values: &[Vec3]) -> Vec<f64> {
    values.iter().map(|v| luminance(*v) as f64).collect()
}

/// Root of the mean square of `a - b` over the mean of `b`, by area.
fn relative_rmse(a: &[f64], b: &[f64], areas: &[f64]) -> f64 {
    let (mut square, mut mean, mut all) = (0.0, 0.0, 0.0);
    for ((a, b), area) in a.iter().zip(b).zip(areas) {
        square += area * (a - b).powi(2);
        mean += area * b;
        all += area;
    }
    (square / all).sqrt() / (mean / all)
}

#[test]
fn a_furnace_is_known_to_have_no_error() {
    let mut world = World::new();
    let wall = world.grey(0.5, 1.0);
    world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), wall);
    let bake = world.build().bake(&BakeOptions { primary: Primary::Radiosity, ..estimated(options(8, 64)) });
    let error = bake.report.error.expect("an estimate");
    // Equal radiosity everywhere: only the rounding of single precision differs.
    assert!(error.direct.total < 1e-5 && error.indirect.total < 1e-5, "{error:?}");
    assert!(bake.error.expect("an estimate").total.iter().all(|&e| e < 1e-4));
}

#[test]
fn noise_is_what_other_seeds_scatter_by() {
    const SEEDS: usize = 8;
    let scene = room().build().scene;
    let bakes: Vec<Bake> = (0..SEEDS as u64)
        .map(|seed| luxel::bake(&scene, &BakeOptions { seed, ..estimated(options(12, 32)) }, &Silent).unwrap())
        .collect();
    let areas = areas(&bakes[0]);
    let scatter = |light: &dyn Fn(&Bake) -> Vec<f64>| {
        let all: Vec<Vec<f64>> = bakes.iter().map(light).collect();
        let mean: Vec<f64> = (0..areas.len()).map(|i| all.iter().map(|v| v[i]).sum::<f64>() / SEEDS as f64).collect();
        let square: f64 = all.iter().map(|v| relative_rmse(v, &mean, &areas).powi(2)).sum();
        (square / (SEEDS - 1) as f64).sqrt()
    };
    let noise = |of: &dyn Fn(&Bake) -> f64| bakes.iter().map(of).sum::<f64>() / SEEDS as f64;
    let direct = (scatter(&|b| bright(&b.vertices.direct)), noise(&|b| b.report.error.as_ref().unwrap().direct.noise));
    let indirect =
        (scatter(&|b| bright(&b.vertices.indirect)), noise(&|b| b.report.error.as_ref().unwrap().indirect.noise));
    println!("direct {direct:?}, indirect {indirect:?}");
    // Each side is a root of a mean of squares with some 1000 independent values and more in each of 8 bakes, but heavy
    // tails (shadow edges; patches next to the lamp) make that worth some 100: 4 sigma of sqrt(1 / (2 * 8 * 100)).
    for (name, (scatter, noise)) in [("direct", direct), ("indirect", indirect)] {
        assert!((noise / scatter - 1.0).abs() < 0.1, "{name}: {noise} for {scatter}");
    }
}

#[test]
fn the_true_error_is_within_twice_the_estimate_and_half_of_it() {
    let scene = room().build().scene;
    let fine = BakeOptions { point_samples: 16, ..options(64, 1024) };
    let truth = luxel::bake(&scene, &fine, &Silent).unwrap();
    let smooth = Reconstruct::Smooth;
    let cases = [
        (8, 256, smooth),
        (16, 256, smooth),
        (16, 32, smooth),
        (12, 64, Reconstruct::Adaptive),
        (12, 64, Reconstruct::Gather),
    ];
    for (grid, rays, reconstruct) in cases {
        let own = BakeOptions { point_samples: 32, gather_rays: 128, reconstruct, ..estimated(options(grid, rays)) };
        let bake = luxel::bake(&scene, &own, &Silent).unwrap();
        let expected = truth.irradiance_with(&bake.mesh.samples, 4096, &Silent);
        let areas = areas(&bake);
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a + b).collect::<Vec<f64>>();
        let (direct, indirect) = (bright(&bake.vertices.direct), bright(&bake.vertices.indirect));
        let (true_direct, true_indirect) = (bright(&expected.direct), bright(&expected.indirect));
        let error = bake.report.error.as_ref().expect("an estimate");
        let rows = [
            ("direct", relative_rmse(&direct, &true_direct, &areas), error.direct.total),
            ("indirect", relative_rmse(&indirect, &true_indirect, &areas), error.indirect.total),
            (
                "total",
                relative_rmse(&sum(&direct, &indirect), &sum(&true_direct, &true_indirect), &areas),
                error.total.total,
            ),
        ];
        for (name, is, said) in rows {
            println!("grid {grid}, {rays} rays, {reconstruct:?}, {name}: {is:.4}, estimated {said:.4}");
            assert!((0.5..2.0).contains(&(said / is)), "{name}: {said} for {is}");
        }
    }
}

#[test]
fn grooves_that_no_voxel_knows_of_are_in_the_estimate() {
    // Pleats half a voxel wide and as high: light falls towards their bottoms within the reach of a single patch.
    const PLEATS: usize = 16;
    const WIDTH: f64 = 0.05;
    let mut world = World::new();
    let wall = world.grey(0.7, 0.0);
    world.room(DVec3::ZERO, DVec3::new(1.3, 1.0, 0.8), wall);
    let ridge = |k: usize| DVec3::new(0.25 + 0.5 * WIDTH * k as f64, 0.2, 0.3 + WIDTH * (k % 2) as f64);
    for k in 0..2 * PLEATS {
        world.quad("pleats", ridge(k), ridge(k + 1) - ridge(k), DVec3::Y * 0.6, wall);
    }
    world.point_light(DVec3::new(0.9, 0.5, 0.7), 10.0);
    let mut scene = world.build().scene;
    for t in &mut scene.triangles {
        t.two_sided = scene.meshes[t.mesh as usize] == "pleats";
    }

    let bake = luxel::bake(&scene, &estimated(options(12, 256)), &Silent).unwrap();
    let areas = areas(&bake);
    let chosen: Vec<usize> = (0..areas.len()).step_by(3).collect();
    let points: Vec<SurfacePoint> = chosen.iter().map(|&v| bake.mesh.samples[v]).collect();
    let paths = ReferenceOptions { until: Until::Samples(1024), seed: 1 };
    let truth = reference::irradiance(&scene, bake.tracer(), &points, &paths, &Silent).unwrap();
    let (light, areas): (Vec<f64>, Vec<f64>) =
        chosen.iter().map(|&v| (luminance(bake.vertices.indirect[v]) as f64, areas[v])).unzip();
    let noisy = relative_rmse(&light, &bright(&truth.indirect), &areas);
    let noise: Vec<f64> =
        bright(&truth.indirect).iter().zip(&truth.indirect_luminance_error).map(|(e, noise)| e + noise).collect();
    let noise = relative_rmse(&noise, &bright(&truth.indirect), &areas);
    let square = noisy.powi(2) - noise.powi(2);
    // Squares of the noise of so many points scatter by sqrt(2 / n) of their mean.
    let scatter = noise.powi(2) * (2.0 / points.len() as f64).sqrt();
    let (is, said) = (square.sqrt(), bake.report.error.expect("an estimate").indirect);
    println!("{is:.4}, of a reference with noise {noise:.4}; estimated {said:?}");
    assert!(4.0 * scatter < square, "{scatter} of {square}");
    assert!((0.5..2.0).contains(&(said.total / is)), "{said:?} for {is}");
}

#[test]
fn every_mode_has_an_estimate_and_errors_of_vertices_agree_with_it() {
    let stage = room().build();
    let modes = [
        options(10, 64),
        faces(options(10, 64)),
        BakeOptions { primary: Primary::Radiosity, ..options(10, 64) },
        BakeOptions { resolution: Resolution::Grid(2), ..options(2, 16) },
        BakeOptions { patches: PatchSource::Decimated, ..options(10, 64) },
        BakeOptions { reconstruct: Reconstruct::Adaptive, gather_rays: 64, ..options(10, 64) },
        BakeOptions { reconstruct: Reconstruct::Nearest4, ..options(10, 64) },
    ];
    for mode in modes {
        let bake = stage.bake(&estimated(mode));
        let (report, vertices) = (bake.report.error.as_ref().expect("an estimate"), bake.error.as_ref().unwrap());
        let areas = areas(&bake);
        let total: Vec<f64> = vertices.total.iter().map(|&e| e as f64).collect();
        assert!(total.iter().all(|e| e.is_finite() && *e >= 0.0) && total.len() == areas.len());
        let light: Vec<f64> =
            bright(&bake.vertices.direct).iter().zip(bright(&bake.vertices.indirect)).map(|(a, b)| a + b).collect();
        let shifted: Vec<f64> = light.iter().zip(&total).map(|(l, e)| l + e).collect();
        let spread = relative_rmse(&shifted, &light, &areas);
        // Local means keep the mean up to what the prior of small neighbourhoods moves.
        assert!((spread / report.total.total - 1.0).abs() < 0.25, "{spread} for {report:?}");
        assert!(report.total.p95 > report.total.total, "{report:?}");
        // The sum has the errors of its parts.
        let mean = |v: &[f64]| v.iter().zip(&areas).map(|(v, a)| v * a).sum::<f64>();
        let (direct, indirect) = (mean(&bright(&bake.vertices.direct)), mean(&bright(&bake.vertices.indirect)));
        let parts = (report.direct.total * direct).hypot(report.indirect.total * indirect) / (direct + indirect);
        assert!((parts / report.total.total - 1.0).abs() < 0.05, "{parts} for {report:?}");
    }
}

#[test]
fn a_sealed_dark_room_is_known_to_be_dark() {
    let mut world = room();
    let wall = world.grey(0.7, 0.0);
    world.named_room("dark", DVec3::new(2.0, 0.0, 0.0), DVec3::new(3.0, 1.0, 0.8), wall);
    let bake = world.build().bake(&estimated(options(24, 64)));
    let error = bake.error.as_ref().expect("an estimate");
    let of = |dark: bool| {
        let inside = (0..error.total.len()).filter(|&v| (bake.mesh.positions[v].x > dark_from(&bake)) == dark);
        inside.map(|v| error.total[v]).fold(0.0, f32::max)
    };
    // The floor of light is 2 % of the mean.
    assert!(of(true) < 0.05 * of(false), "{} and {}", of(true), of(false));
}

/// Half-way between the rooms, local.
fn dark_from(bake: &Bake) -> f32 {
    let x = || bake.mesh.positions.iter().map(|p| p.x);
    let (low, high) = (x().fold(f32::INFINITY, f32::min), x().fold(f32::NEG_INFINITY, f32::max));
    low + (high - low) * 1.65 / 3.0
}

#[test]
fn rows_of_other_rays_that_are_kept_are_not_cast_again() {
    let bake = room().build().bake(&options(8, 64));
    let points = RowPoints::new(64, 7, bake.tracer());
    let casting = |tracer| Casting { again: 1, ..Casting::new(&bake.simplified, tracer, &[], &points) };
    let all: Vec<u32> = (0..bake.patches().len() as u32).collect();
    let (half, none) = (&all[..all.len() / 2], Rows::new(all.len()));
    let mut kept = Rows::new(all.len());
    transfer::cast(&casting(bake.tracer()), half, &[], &mut kept, &mut (), &Silent).unwrap();
    let sent = vec![1.0; all.len()];
    let with = |tracer, rows| transfer::receive(&casting(tracer), &all, &sent, false, rows);
    let expected = with(bake.tracer(), &none);
    assert!(expected.iter().filter(|e| **e > 0.9).count() > all.len() / 2);
    assert_eq!(with(bake.tracer(), &kept), expected);
    // Rays that find nothing change those alone that are not kept.
    let blind = with(&Brute::new(&Geometry::default()), &kept);
    assert_eq!(blind[..half.len()], expected[..half.len()]);
    assert!(blind[half.len()..].iter().all(|e| *e == 0.0));
}
