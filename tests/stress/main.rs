//! Stress: scenes that strain the numbers, against closed forms and invariants, on every backend. Coarse grids;
//! `cargo bench --bench stability` runs the same cases at default quality and prints what it finds.

#[path = "../common/mod.rs"]
mod common;

mod cases;
mod found;
mod precision;

use cases::Case;
use common::{options, rotation};
use found::{Found, difference, is_sound};
use glam::DVec3;
use luxel::{
    BakeOptions,
    bake::Bake,
    options::{Backend, Primary},
};

/// Of the closed forms and the balance, at default quality.
const TOLERANCE: f64 = 0.002;
/// Into a sealed room, of the lit one's mean.
const LEAK: f64 = 0.005;
/// Products with the matrix grow with the logarithm of the tolerance over the spectral gap, not with 1 / (1 - rho).
const MOST_ITERATIONS: usize = 40;

fn backends() -> Vec<Backend> {
    let embree = cfg!(feature = "embree").then_some(Backend::Embree);
    [embree, Some(Backend::Bvh)].into_iter().flatten().collect()
}

fn on(case: &Case, options: &BakeOptions) -> Bake {
    case.stage.bake(options)
}

/// Bakes a case on all backends and with another seed, and asks of it what holds in every scene.
fn check(case: &Case, grid: u32) {
    let options = options(grid, 64);
    let bakes: Vec<Bake> =
        backends().into_iter().map(|backend| on(case, &BakeOptions { backend, ..options.clone() })).collect();
    let other = on(case, &BakeOptions { seed: 1, ..options.clone() });
    for bake in bakes.iter().chain([&other]) {
        let found = Found::of(case, bake);
        println!("{}, {}: {found:?}", case.name, bake.report.backend);
        assert!(found.sound, "{}: light that is negative or not finite", case.name);
        // Few rays: four of their standard errors more.
        let allowed = TOLERANCE + 4.0 * found.sigma;
        assert!(found.lost < allowed, "{}: balance {} > {allowed}", case.name, found.lost);
        if let Some(mean) = found.mean {
            // The mean follows from the balance: its relative error is that over the albedo, half at least here.
            assert!(mean.abs() < 2.0 * allowed, "{}: mean {mean} > {}", case.name, 2.0 * allowed);
        }
        if let Some(leak) = found.leak {
            assert!(leak.iter().all(|&l| l < LEAK), "{}: leak {leak:?}", case.name);
        }
        assert!(found.iterations <= MOST_ITERATIONS, "{}: {} iterations", case.name, found.iterations);
    }
    // Backends trace the same rays: what ties decide is less than what chance does.
    let noise = difference(&bakes[0], &other);
    for bake in &bakes[1..] {
        let between = difference(&bakes[0], bake);
        assert!(between <= noise + 1e-6, "{}: backends differ by {between}, seeds by {noise}", case.name);
    }
}

#[test]
fn light_is_the_same_at_every_scale_place_and_angle() {
    cases::frames().iter().for_each(|case| check(case, 16));
}

#[test]
fn high_albedo_keeps_its_closed_form_in_few_iterations() {
    for case in cases::albedos() {
        check(&case, 16);
        let bake = on(&case, &options(16, 256));
        let found = Found::of(&case, &bake);
        println!("{} at 256 rays: {found:?}", case.name);
        let limit = if case.name.ends_with("0.9999") {
            0.1
        } else if case.name.ends_with("0.999") {
            0.01
        } else {
            0.001
        };
        assert!(found.mean.is_some_and(|mean| mean.abs() <= limit), "{}: {found:?}", case.name);
    }
}

#[test]
fn thin_walls_keep_the_dark_and_narrow_gaps_let_light_through() {
    cases::walls(32).iter().for_each(|case| check(case, 32));
}

#[test]
fn bad_triangles_neither_make_nor_lose_light() {
    cases::shapes().iter().for_each(|case| check(case, 16));
}

#[test]
fn unequal_and_very_many_lights_add_up() {
    cases::lights().iter().for_each(|case| check(case, 16));
}

/// The oracle on what is small enough for it.
#[test]
fn brute_force_agrees_on_small_scenes() {
    const SMALL: [&str; 4] = ["scale 1", "slivers of aspect 1e6", "every face three times", "winding mixed"];
    for case in cases::all(6).iter().filter(|case| SMALL.contains(&case.name.as_str())) {
        let options = options(6, 64);
        let oracle = on(case, &BakeOptions { backend: Backend::Brute, ..options.clone() });
        let noise =
            difference(&oracle, &on(case, &BakeOptions { seed: 1, backend: Backend::Brute, ..options.clone() }));
        for backend in backends() {
            let between = difference(&oracle, &on(case, &BakeOptions { backend, ..options.clone() }));
            assert!(between <= noise, "{}, {backend:?}: {between}, noise {noise}", case.name);
        }
    }
}

/// Packets and single rays of Embree meet the same patches.
#[cfg(feature = "embree")]
#[test]
fn rows_of_single_rays_are_those_of_packets() {
    use luxel::{progress::Silent, trace::Embree, transfer};
    for case in cases::all(8) {
        if case.name.starts_with("100,000") {
            continue;
        }
        let options = options(8, 64);
        let bake = on(&case, &BakeOptions { backend: Backend::Embree, ..options.clone() });
        let rows = |width: Option<u32>| {
            let tracer = Embree::new(&case.stage.scene.geometry()).unwrap();
            let tracer = match width {
                Some(width) => tracer.with_width(width).unwrap(),
                None => tracer,
            };
            let lit = vec![true; bake.patches().len()];
            transfer::estimate(&bake.simplified, &tracer, &lit, true, options.rays, 0, &Silent)
                .expect("nobody interrupts")
                .form_factors
        };
        let (single, packets) = (rows(Some(1)), rows(None));
        let mut moved = 0.0;
        for i in 0..single.len() {
            let mut row = std::collections::BTreeMap::new();
            single.row(i).for_each(|(j, f)| *row.entry(j).or_insert(0.0) += f);
            packets.row(i).for_each(|(j, f)| *row.entry(j).or_insert(0.0) -= f);
            moved += 0.5 * row.values().map(|d: &f64| d.abs()).sum::<f64>() / single.len() as f64;
        }
        // Only where two triangles are met at the same distance may packets tell the other: rays onto edges, and
        // onto the crossings of a soup, within rounding.
        assert!(moved <= 1e-3, "{}: {moved} of the form factors differ", case.name);
    }
}

#[test]
fn the_balance_gets_better_with_more_rays() {
    let case = &cases::frames()[2];
    let lost = |rays: u32| {
        let of = |seed| Found::of(case, &on(case, &BakeOptions { seed, ..options(12, rays) })).lost.powi(2);
        ((0..4).map(of).sum::<f64>() / 4.0).sqrt()
    };
    let (few, many) = (lost(16), lost(1024));
    println!("balance at 16 rays {few:.2e}, at 1024 {many:.2e}");
    // 64 times the rays make an eighth of the error of independent ones, and the direct light keeps its own.
    assert!(many < 0.5 * few, "{many} {few}");
}

/// Backs of free-standing sheets are no insides of objects: a floor beside one is not brightened.
#[test]
fn a_floor_beside_the_back_of_a_sheet_is_lit_by_the_closed_form() {
    let mut world = common::World::new();
    let (grey, soot) = (world.grey(0.5, 0.0), world.grey(0.0, 0.0));
    world.quad("floor", DVec3::ZERO, DVec3::X, DVec3::Y, soot);
    // Its back faces the room's middle.
    world.quad("sheet", DVec3::new(0.5, 0.0, 0.0), DVec3::Z, DVec3::Y, grey);
    world.point_light(DVec3::new(0.75, 0.5, 0.5), 100.0);
    world.transform(rotation());
    let stage = world.build();
    let bake = stage.bake(&options(16, 256));
    let intensity = 100.0 / (4.0 * std::f64::consts::PI);
    let mut checked = 0;
    for i in 0..bake.patches().len() {
        let p = stage.as_built(bake.patches().centroid[i]);
        let on_floor = p.z.abs() < 1e-4 && (p.x - 0.5) > 0.03 && bake.patches().normal[i].is_finite();
        if on_floor && common::mesh_of(&stage.scene, &bake, i) == "floor" && p.x < 0.7 {
            let to = DVec3::new(0.75, 0.5, 0.5) - p;
            let expected = intensity * to.z / to.length().powi(3);
            let got = bake.light.direct[i].x as f64;
            // The mean over a patch of 1/16 is not the value at its centre: up to h^2 / 24 of E''/E, 20 or so.
            assert!((got / expected - 1.0).abs() < 0.02, "at {p}: {got}, expected {expected}");
            checked += 1;
        }
    }
    assert!(checked > 30, "{checked}");
    assert!(is_sound(&bake));
}

/// A white furnace is even to rounding, whatever its scale and place.
#[test]
fn a_furnace_glows_evenly_at_every_scale() {
    for (scale, offset) in [(1e-6, 0.0), (1e6, 0.0), (1.0, 1e6)] {
        for albedo in [0.9_f32, 0.9999] {
            let mut world = common::World::new();
            let grey = world.grey(albedo, 1.0);
            world.room(DVec3::ZERO, DVec3::new(1.0, 1.2, 0.9), grey);
            let turn = rotation();
            world.transform(glam::DAffine3::from_translation(DVec3::splat(offset * scale)));
            world.transform(turn * glam::DAffine3::from_scale(DVec3::splat(scale)));
            let bake = world.build().bake(&BakeOptions { primary: Primary::Radiosity, ..options(8, 64) });
            let expected = std::f64::consts::PI / (1.0 - albedo as f64);
            for i in 0..bake.patches().len() {
                let b = bake.patches().emitted[i].x as f64 + bake.light.radiosity[i].x as f64;
                // The residual over the spectral gap, and the rounding of the albedo over the same.
                let limit = 1e-6 + 2.0 * f32::EPSILON as f64 / (1.0 - albedo as f64);
                assert!((b / expected - 1.0).abs() < limit, "{scale} {offset} {albedo}: {b}, expected {expected}");
            }
        }
    }
}

/// The two sheets of a thin wall lie in one voxel and face alike, but one sees the room and the other their gap.
#[test]
fn a_wall_of_two_sheets_is_lit_like_a_slab() {
    let light = |sheets: bool| {
        let mut world = common::World::new();
        let grey = world.grey(0.7, 0.0);
        let (x, thick) = (1.03, 0.1 * 2.1 / 16.0);
        world.room(DVec3::ZERO, DVec3::new(2.1, 1.0, 1.0), grey);
        if sheets {
            for x in [x, x + thick] {
                world.quad("sheet", DVec3::new(x, -0.05, -0.05), DVec3::Y * 1.1, DVec3::Z * 1.1, grey);
            }
        } else {
            world.block(DVec3::new(x, -0.05, -0.05), DVec3::new(x + thick, 1.05, 1.05), grey);
        }
        world.point_light(DVec3::new(0.5, 0.4, 0.6), 100.0);
        world.point_light(DVec3::new(1.6, 0.4, 0.6), 100.0);
        let mut stage = world.build();
        for t in &mut stage.scene.triangles {
            t.two_sided = stage.scene.meshes[t.mesh as usize] == "sheet";
        }
        let bake = stage.bake(&options(16, 256));
        let points: Vec<_> = [(x, -1.0), (x + thick, 1.0)]
            .into_iter()
            .flat_map(|(x, n)| [0.2, 0.5, 0.7].map(|y| ([x, y, 0.45], [n, 0.0, 0.0])))
            .map(|(position, normal)| stage.point(position, normal))
            .collect();
        common::red(&bake.irradiance(&points, &luxel::progress::Silent).indirect)
    };
    let (sheets, slab) = (light(true), light(false));
    // Noise of 256 rays in a patch is 2 %, of the several that a point takes less; half the light would be gone.
    assert!(common::worst(&sheets, &slab) < 0.08, "{sheets:?}, {slab:?}");
}
