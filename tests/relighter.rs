//! Light that is moved in a baked scene is that of a bake with the light there.

mod common;

use std::path::Path;

use common::{World, options};
use glam::{DAffine3, DVec3, Vec3};
use luxel::{
    BakeOptions, Error, Relighter, Scene,
    bake::{self, Bake, Irradiance, Kept, Run},
    progress::Silent,
    relight::RelightOptions,
    scene::{self, Light, SceneOverrides, WorldLight},
};

/// The middle of the Cornell box's lamp.
const HOME: DVec3 = DVec3::new(278.0, 548.8, 279.5);
const GRID: u32 = 16;

fn cornell() -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    scene::load(&path, &SceneOverrides::default()).unwrap().0
}

fn bake(scene: &Scene, options: &BakeOptions) -> Bake {
    luxel::bake(scene, options, &Silent).unwrap()
}

fn relighter(scene: &Scene) -> Relighter {
    Relighter::new(scene.clone(), bake(scene, &options(GRID, 256))).unwrap()
}

/// Turns the lamp over by a few degrees and carries it to `to`.
fn carried(to: DVec3) -> DAffine3 {
    DAffine3::from_translation(to) * DAffine3::from_rotation_x(0.2) * DAffine3::from_translation(-HOME)
}

/// The scene with a light instead of its lamp.
fn lit_by(scene: &Scene, light: &WorldLight) -> Scene {
    let mut scene = scene.clone();
    scene.materials.iter_mut().for_each(|m| m.emission = Vec3::ZERO);
    let (WorldLight::Rectangle { .. } | WorldLight::Point { .. }) = light else { panic!("another light") };
    let local = |p: DVec3| scene.frame.to_local(p);
    let vector = |v: DVec3| (v / scene.frame.scale).as_vec3();
    let local = match *light {
        WorldLight::Rectangle { corner, edge_u, edge_v, radiance } => {
            Light::Rectangle { corner: local(corner), edge_u: vector(edge_u), edge_v: vector(edge_v), radiance }
        }
        WorldLight::Point { position, intensity, range } => Light::Point {
            position: local(position),
            intensity: intensity / (scene.frame.scale * scene.frame.scale) as f32,
            range: (range / scene.frame.scale) as f32,
        },
        _ => return scene,
    };
    scene.lights.push(local);
    scene
}

/// The lamp as a rectangle, carried to `to`.
fn lamp(to: DVec3) -> WorldLight {
    let mut lamp = WorldLight::Rectangle {
        corner: DVec3::new(343.0, 548.8, 227.0),
        edge_u: DVec3::new(0.0, 0.0, 105.0),
        edge_v: DVec3::new(-130.0, 0.0, 0.0),
        radiance: Vec3::new(17.0, 12.0, 4.0),
    };
    lamp.transform(&carried(to));
    lamp
}

/// Sum of the differences over the sum of the second.
fn difference(a: &[Vec3], b: &[Vec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    let sum = |x: Vec3| x.element_sum() as f64;
    a.iter().zip(b).map(|(a, b)| sum((*a - *b).abs())).sum::<f64>() / b.iter().map(|b| sum(*b)).sum::<f64>()
}

/// Indirect light of the patches by area.
fn area_sum(bake: &Bake) -> f64 {
    bake.light.indirect.iter().zip(&bake.patches().area).map(|(e, a)| (e.x * a) as f64).sum()
}

fn square(a: &[Vec3], b: &[Vec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (*a - *b).length_squared() as f64).sum()
}

/// Indirect light at the vertices with the lamp at `to`: of a frame, and of bakes of the same rays and of two others, which tell
/// how noisy it is; and that the frame differs from those by no more than they do.
fn within_noise(relighter: &mut Relighter, scene: &Scene, to: DVec3) -> [Irradiance; 3] {
    relighter.place(0, carried(to)).unwrap();
    relighter.frame();
    let samples = relighter.bake().mesh.samples.clone();
    let fresh = |seed: u64| {
        let options = BakeOptions { seed, ..options(GRID, 256) };
        bake(&lit_by(scene, &lamp(to)), &options).irradiance(&samples, &Silent)
    };
    let [same, b, c] = [0, 1, 2].map(fresh);
    // Three independent estimates of equal noise: the expected squares of all differences are equal. A sum over n
    // independent points of a Gaussian error has the relative standard error sqrt(2 / n), the quotient of two sums at most
    // twice that. Vertices share the noise of the nine patches around, and three channels share their rays.
    let n = samples.len() as f64 / 9.0;
    let bound = 1.0 + 4.0 * 2.0 * (2.0 / n).sqrt();
    let (got, between) = (square(relighter.indirect(), &b.indirect), square(&c.indirect, &b.indirect));
    assert!(got / between < bound, "{to}: {got} {between} {bound}");
    [same, b, c]
}

#[test]
fn a_lamp_that_was_carried_lights_as_in_a_bake_within_noise() {
    let scene = cornell();
    let mut relighter = relighter(&scene);
    // Far from all walls, so that no patch is so bright that the bakes send its light by shadow rays.
    let [same, b, _] = within_noise(&mut relighter, &scene, DVec3::new(250.0, 470.0, 200.0));
    // The bake of the same seed has the same rows; the rays to the lamp differ where the horizon cuts it.
    let off = difference(relighter.indirect(), &same.indirect);
    assert!(off < 0.3 * difference(&b.indirect, &same.indirect), "{off}");
    // Vertices: 64 rays to a penumbra have an error below 0.5 / 8; a tenth of all places lie in one.
    let direct = difference(relighter.direct(), &same.direct);
    assert!(direct < 0.1 * 0.5 / 8.0 * 2.0_f64.sqrt(), "{direct}");
}

#[test]
fn what_a_lamp_beside_a_surface_lights_up_is_sent_as_in_a_bake_within_noise() {
    let scene = cornell();
    // A hundred above the tall block, whose top is then as bright as a lamp.
    within_noise(&mut relighter(&scene), &scene, DVec3::new(408.0, 430.0, 279.5));
}

#[test]
fn a_point_light_gives_the_light_of_a_bake_but_for_rounding() {
    let scene = cornell();
    let mut relighter = relighter(&scene);
    relighter.set_options(RelightOptions { tolerance: 1e-5, ..relighter.options() }).unwrap();
    relighter.set_emission("light", Vec3::ZERO).unwrap();
    let point = |x: f64| WorldLight::Point {
        position: DVec3::new(x, 400.0, 150.0),
        intensity: Vec3::new(3e5, 2e5, 1e5),
        range: f64::INFINITY,
    };
    let number = relighter.add_light(point(100.0)).unwrap();
    relighter.frame();
    for x in [150.0, 278.0] {
        relighter.set_light(number, point(x)).unwrap();
        relighter.frame();
        let expected = bake(&lit_by(&scene, &point(x)), &options(GRID, 256));
        // One ray in some thousands slips past an edge by rounding, and is one of 32 of its patch.
        let samples = &relighter.bake().mesh.samples.clone();
        let light = expected.irradiance(samples, &Silent);
        let off = [difference(relighter.direct(), &light.direct), difference(relighter.indirect(), &light.indirect)];
        assert!(off[0] < 1e-3 && off[1] < 1e-3, "{x}: {off:?}");
    }
}

#[test]
fn the_light_of_a_lamp_comes_back_with_it() {
    let mut relighter = relighter(&cornell());
    let tolerance = relighter.options().tolerance;
    relighter.frame();
    let (direct, indirect) = (relighter.direct().to_vec(), relighter.indirect().to_vec());
    for k in 0..5 {
        relighter.place(0, carried(DVec3::new(150.0 + 60.0 * k as f64, 450.0, 250.0))).unwrap();
        relighter.frame();
        assert_ne!(relighter.direct(), direct);
    }
    relighter.place(0, DAffine3::IDENTITY).unwrap();
    let frame = relighter.frame();
    assert!(frame.residual <= tolerance && frame.rays > 0, "{frame:?}");
    assert_eq!(relighter.direct(), direct);
    // Both solutions are within the tolerance of the radiosity, and irradiance is a mean of that over one albedo or so.
    let off = difference(relighter.indirect(), &indirect);
    assert!(off < 2.0 * tolerance / 0.5, "{off}");
    assert_eq!(relighter.frame().rays, 0, "nothing has changed");
}

#[test]
fn without_light_all_is_black_and_light_comes_back() {
    let mut relighter = relighter(&cornell());
    relighter.frame();
    let before = relighter.indirect().to_vec();
    relighter.set_emission("light", Vec3::ZERO).unwrap();
    relighter.frame();
    assert!(relighter.indirect().iter().all(|e| *e == Vec3::ZERO));
    assert!(relighter.direct().iter().all(|e| *e == Vec3::ZERO));
    relighter.set_emission("light", Vec3::new(17.0, 12.0, 4.0)).unwrap();
    relighter.frame();
    assert!(difference(relighter.indirect(), &before) < 4.0 * relighter.options().tolerance);
}

#[test]
fn a_light_inside_a_block_lights_nothing() {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    world.room(DVec3::ZERO, DVec3::splat(2.0), grey);
    world.block(DVec3::splat(0.8), DVec3::splat(1.2), grey);
    world.point_light(DVec3::splat(0.5), 10.0);
    let scene = world.build().scene;
    let mut relighter = relighter(&scene);
    relighter.frame();
    assert!(relighter.indirect().iter().any(|e| *e != Vec3::ZERO));
    relighter.place(0, DAffine3::from_translation(DVec3::splat(0.5))).unwrap();
    relighter.frame();
    assert!(relighter.direct().iter().all(|e| *e == Vec3::ZERO));
    assert!(relighter.indirect().iter().all(|e| *e == Vec3::ZERO));
}

#[test]
fn albedos_are_those_of_a_bake_with_them() {
    let scene = cornell();
    let mut relighter = relighter(&scene);
    relighter.set_options(RelightOptions { tolerance: 1e-5, ..relighter.options() }).unwrap();
    let blue = Vec3::new(0.1, 0.2, 0.7);
    relighter.set_albedo("white", blue).unwrap();
    relighter.frame();
    let mut painted = scene.clone();
    painted.materials.iter_mut().filter(|m| m.name == "white").for_each(|m| m.albedo = blue);
    let expected = bake(&painted, &options(GRID, 256));
    let off = difference(relighter.indirect(), &expected.vertices.indirect);
    // As for a point light.
    assert!(off < 1e-3, "{off}");
    // Vertices between materials are means of other pieces; all else differs by rounding.
    let differ = |(a, b): (&Vec3, &Vec3)| (*a - *b).abs().max_element() > 1e-6;
    let albedo = &relighter.bake().mesh.albedo;
    let between = albedo.iter().zip(&expected.mesh.albedo).filter(|&pair| differ(pair)).count();
    assert!(between * 50 < albedo.len(), "{between} of {}", albedo.len());
}

#[test]
fn surfaces_so_white_that_light_stays_are_solved_too() {
    let mut relighter = relighter(&cornell());
    relighter.set_options(RelightOptions { tolerance: 1e-6, ..relighter.options() }).unwrap();
    for name in ["white", "red", "green"] {
        relighter.set_albedo(name, Vec3::splat(0.99)).unwrap();
    }
    let frame = relighter.frame();
    assert!(frame.residual <= 1e-6, "{frame:?}");
    let white = bake(relighter.scene(), &options(GRID, 256));
    // Light that is left out is at most 1 / (1 - albedo) of the residual.
    assert!(difference(relighter.indirect(), &white.vertices.indirect) < 1e-3);
}

#[test]
fn what_is_asked_of_a_relit_bake_is_its_light() {
    let mut relighter = relighter(&cornell());
    let bake = relighter.bake();
    let light = bake.irradiance(&bake.mesh.samples.clone(), &Silent);
    // The vertices' places lie clear of walls already, and no patch is bright; f32 sums.
    assert!(difference(&bake.vertices.indirect, &light.indirect) < 1e-5);

    relighter.place(0, carried(DVec3::new(200.0, 400.0, 150.0))).unwrap();
    let bake = relighter.bake();
    let light = bake.irradiance(&bake.mesh.samples.clone(), &Silent);
    // What bright patches send is sampled twice, so that the two differ by chance, at each vertex by its own.
    let off = |(a, b): (&Vec3, &Vec3)| (*a - *b).as_dvec3();
    let offs: Vec<DVec3> = bake.vertices.indirect.iter().zip(&light.indirect).map(off).collect();
    let count = offs.len() as f64;
    let mean = offs.iter().sum::<DVec3>() / count;
    let error = (offs.iter().map(|d| *d * *d).sum::<DVec3>() / count / count).map(f64::sqrt);
    // Four standard errors, and 1 % that many bright patches may be off in full view (light/crowd.rs).
    let scale = light.indirect.iter().map(|e| e.as_dvec3()).sum::<DVec3>() / count;
    assert!(mean.abs().cmple(4.0 * error + 0.01 * scale).all(), "{mean}, standard error {error}");
    // Penumbras where the horizon cuts the lamp are sampled otherwise.
    assert!(difference(&bake.vertices.direct, &light.direct) < 0.01);
    // The lamp's own surface is dark now.
    assert!(bake.patches().emitted.iter().all(|m| *m == Vec3::ZERO));
    assert!(!relighter.scene().has_light());
}

#[test]
fn frames_have_the_same_bits_on_any_number_of_threads() {
    let frames = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut relighter = relighter(&cornell());
            let mut all = Vec::new();
            for k in 0..4 {
                relighter.place(0, carried(DVec3::new(150.0 + 60.0 * k as f64, 450.0, 250.0))).unwrap();
                relighter.frame();
                all.extend_from_slice(relighter.indirect());
                all.extend_from_slice(relighter.direct());
            }
            all
        })
    };
    assert!(frames(1) == frames(3));
}

#[test]
fn prepared_rows_light_rooms_that_no_light_of_the_bake_reaches() {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    world.named_room("lit", DVec3::ZERO, DVec3::splat(2.0), grey);
    world.named_room("dark", DVec3::new(2.1, 0.0, 0.0), DVec3::new(4.1, 2.0, 2.0), grey);
    world.point_light(DVec3::ONE, 10.0);
    let stage = world.build();
    let scene = &stage.scene;
    let options = options(12, 64);
    let mut kept = Kept::default();
    let mut run = Run { progress: &Silent, keeper: &mut (), deadline: None };
    bake::prepare(scene, &options, &mut kept, &mut run).unwrap();
    let lit = bake::bake_with(scene, &options, &mut kept, &mut run).unwrap();
    let to_the_other_room = DAffine3::from_translation(DVec3::new(2.1, 0.0, 0.0));
    let light = |relighter: luxel::Result<Relighter>| {
        let mut relighter = relighter.unwrap();
        relighter.place(0, to_the_other_room).unwrap();
        let frame = relighter.frame();
        assert!(frame.residual <= relighter.options().tolerance);
        area_sum(relighter.bake())
    };
    let again = || bake::bake(scene, &options, &Silent).unwrap();
    let before = area_sum(&again());
    assert_eq!(light(Relighter::new(scene.clone(), again())), 0.0);
    // Mean indirect light of a closed room is power x albedo / (1 - albedo) / area: 2 % is ten standard errors of 64 rays and
    // 500 patches.
    let after = light(Relighter::with_rows(scene.clone(), lit, &kept.rows));
    assert!((after / before - 1.0).abs() < 0.02, "{after} {before}");
}

#[test]
fn numbers_without_sense_are_refused_and_change_nothing() {
    let scene = cornell();
    let mut relighter = relighter(&scene);
    relighter.frame();
    let before = relighter.indirect().to_vec();
    let wrong = |result: luxel::Result<()>, part: &str| match result {
        Err(Error::Option(message)) => assert!(message.contains(part), "{message}"),
        other => panic!("{part}: {other:?}"),
    };
    wrong(relighter.place(0, DAffine3::from_translation(DVec3::new(f64::NAN, 0.0, 0.0))), "finite");
    wrong(relighter.place(7, DAffine3::IDENTITY), "no light 7");
    let position = DVec3::splat(f64::NAN);
    let point = WorldLight::Point { position, intensity: Vec3::ONE, range: f64::INFINITY };
    wrong(relighter.add_light(point.clone()).map(drop), "position must be finite");
    wrong(relighter.set_light(0, point), "material \"light\"");
    let far = WorldLight::Point { position: DVec3::splat(1e300), intensity: Vec3::ONE, range: f64::INFINITY };
    wrong(relighter.add_light(far).map(drop), "too large");
    wrong(relighter.set_emission("light", Vec3::NAN), "not negative");
    wrong(relighter.set_emission("moon", Vec3::ONE), "no material \"moon\"");
    wrong(relighter.set_albedo("white", Vec3::ONE), "0.9999");
    for k in 0..3 {
        let mut albedo = Vec3::splat(0.5);
        albedo[k] = f32::NAN;
        wrong(relighter.set_albedo("white", albedo), "0.9999");
    }
    wrong(relighter.set_options(RelightOptions { tolerance: 0.0, ..relighter.options() }), "tolerance");
    wrong(relighter.set_options(RelightOptions { patch_samples: 0, ..relighter.options() }), "samples");
    let frame = relighter.frame();
    assert_eq!(frame.rays, 0, "nothing has changed");
    assert_eq!(relighter.indirect(), before);
    let other = bake(&scene, &common::faces(options(8, 64)));
    wrong(Relighter::new(scene, other).map(drop), "surfels");
}

#[test]
fn odd_but_sound_lights_leave_numbers_that_are_sound() {
    let scene = cornell();
    let mut relighter = relighter(&scene);
    let vertex = scene.frame.to_world(relighter.bake().mesh.samples[0].position);
    let patch = scene.frame.to_world(relighter.bake().patches().centroid[0]);
    let number = relighter.add_light(lamp(HOME)).unwrap();
    let sound = |relighter: &mut Relighter, what: &str| {
        relighter.frame();
        let is_sound = |e: &Vec3| e.is_finite() && e.min_element() >= 0.0;
        assert!(relighter.indirect().iter().all(is_sound), "{what}: indirect");
        assert!(relighter.direct().iter().all(is_sound), "{what}: direct");
        let bake = relighter.bake();
        assert!(bake.light.radiosity.iter().all(is_sound), "{what}: radiosity");
    };
    let point = |position: DVec3, power: f32| WorldLight::Point {
        position,
        intensity: Vec3::splat(power),
        range: f64::INFINITY,
    };
    let rectangle = |corner: DVec3, size: f64, radiance: f32| WorldLight::Rectangle {
        corner,
        edge_u: size * DVec3::Z,
        edge_v: -size * DVec3::X,
        radiance: Vec3::splat(radiance),
    };
    for (light, what) in [
        (point(vertex, 1e5), "a point on a vertex"),
        (point(patch, 1e5), "a point on a patch"),
        (point(patch + 1e-3 * DVec3::Y, 1e38), "as bright as numbers allow"),
        (point(DVec3::splat(250.0), 1e-44), "as dark as numbers allow"),
        (point(DVec3::splat(1e20), 1e30), "far away"),
        (rectangle(vertex, 1e-4, 1e5), "a small lamp on a vertex"),
        (rectangle(DVec3::new(250.0, 548.8, 250.0), 100.0, f32::MAX), "the brightest lamp"),
        (rectangle(DVec3::new(5e5, 548.0, -5e5), 1e6, 1.0), "a lamp larger than the scene"),
        (rectangle(DVec3::new(278.0, 0.001, 279.5), 100.0, 1.0), "a lamp in the floor"),
    ] {
        relighter.set_light(number, light).unwrap();
        sound(&mut relighter, what);
    }
    // After all that, light is what it was.
    relighter.set_light(number, lamp(DVec3::new(250.0, 470.0, 200.0))).unwrap();
    sound(&mut relighter, "again");
    let mut fresh = self::relighter(&scene);
    fresh.add_light(lamp(DVec3::new(250.0, 470.0, 200.0))).unwrap();
    fresh.frame();
    // As where a lamp comes back.
    let off = difference(relighter.indirect(), fresh.indirect());
    assert!(off < 2.0 * fresh.options().tolerance / 0.5, "{off}");
}
