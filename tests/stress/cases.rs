//! Scenes that strain the numbers, each with what is known of its light.
//!
//! In a closed room of uniform albedo rho and total surface S the mean indirect irradiance is Phi rho / (S (1 - rho)),
//! whatever stands in it (CIE 171:2006, 5.8). Nearly all cases are such rooms.

use glam::{DAffine3, DQuat, DVec3, Vec3};
use luxel::{
    sampling,
    scene::{SidesRule, WorldLight},
};

use crate::common::{Stage, World};

/// A scene and what holds in it.
pub struct Case {
    pub name: String,
    pub stage: Stage,
    /// Mean indirect irradiance in closed form.
    pub mean: Option<f64>,
    /// The first coordinate, as built, beyond which a sealed room lies that gets no light.
    pub dark_beyond: Option<f64>,
}

/// Power of the lamps, W.
const FLUX: f64 = 100.0;

/// Size of the plain room.
const ROOM: DVec3 = DVec3::new(1.3, 1.0, 0.8);

/// All cases; walls are as thin as their names say on a grid of `grid`.
pub fn all(grid: u32) -> Vec<Case> {
    let mut cases = frames();
    cases.extend(albedos());
    cases.extend(walls(grid));
    cases.extend(shapes());
    cases.extend(lights());
    cases
}

/// A room with a block on its floor, before it is moved; and the surface that light reaches.
fn furnished(albedo: f32) -> (World, f64) {
    let mut world = World::new();
    let grey = world.grey(albedo, 0.0);
    world.room(DVec3::ZERO, ROOM, grey);
    let (low, high) = (DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35));
    world.block(low, high, grey);
    world.point_light(DVec3::new(0.83, 0.61, 0.47), FLUX);
    let d = high - low;
    (world, surface(ROOM) + 2.0 * (d.x + d.y) * d.z)
}

/// Surface of a box.
fn surface(d: DVec3) -> f64 {
    2.0 * (d.x * d.y + d.y * d.z + d.z * d.x)
}

fn mean(albedo: f64, flux: f64, surface: f64) -> Option<f64> {
    Some(flux * albedo / (surface * (1.0 - albedo)))
}

/// Scale, place and rotation.
pub fn frames() -> Vec<Case> {
    let moved = |name: &str, scale: f64, offset: f64, turn: DQuat| {
        let (mut world, surface) = furnished(0.5);
        let translation = offset * scale * DVec3::new(0.6, -0.64, 0.48);
        world.transform(DAffine3::from_scale_rotation_translation(DVec3::splat(scale), turn, translation));
        Case {
            name: name.into(),
            stage: world.build(),
            mean: mean(0.5, FLUX, surface * scale * scale),
            dark_beyond: None,
        }
    };
    let still = DQuat::IDENTITY;
    let turn = |k: u64| {
        let mut number = numbers(k);
        DQuat::from_xyzw(number(), number(), number(), number()).normalize()
    };
    vec![
        moved("scale 1e-6", 1e-6, 0.0, still),
        moved("scale 1e-3", 1e-3, 0.0, still),
        moved("scale 1", 1.0, 0.0, still),
        moved("scale 1e3", 1e3, 0.0, still),
        moved("scale 1e6", 1e6, 0.0, still),
        moved("offset 1e3 sizes", 1.0, 1e3, still),
        moved("offset 1e6 sizes", 1.0, 1e6, still),
        moved("turned, 1", 1.0, 0.0, turn(1)),
        moved("turned, 2", 1.0, 0.0, turn(2)),
        moved("turned, 3, and all", 1e-6, 1e6, turn(3)),
    ]
}

/// CIE 171:2006, 5.8.
pub fn albedos() -> Vec<Case> {
    let cube = |albedo: f32| {
        let mut world = World::new();
        let grey = world.grey(albedo, 0.0);
        world.room(DVec3::splat(-2.0), DVec3::splat(2.0), grey);
        world.point_light(DVec3::ZERO, FLUX);
        // The albedo as it was rounded: at 0.9999 the mean goes with 1 / (1 - rho).
        let mean = mean(albedo as f64, FLUX, 96.0);
        Case { name: format!("albedo {albedo}"), stage: world.build(), mean, dark_beyond: None }
    };
    [0.0, 0.5, 0.9, 0.99, 0.999, 0.9999].map(cube).into()
}

/// What parts a lit room from a dark one.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Wall {
    /// A slab through floor and ceiling.
    Slab,
    /// Two sheets, seen from both sides.
    Sheets,
}

/// Walls thinner than a voxel of a grid of `grid`, and a gap narrower than one.
pub fn walls(grid: u32) -> Vec<Case> {
    let mut cases = Vec::new();
    for wall in [Wall::Slab, Wall::Sheets] {
        for voxels in [0.5, 1e-2, 1e-4] {
            // The frame's rounding is 1e-4 voxels of a fine grid: a sheet and its neighbour would be one.
            if wall == Wall::Slab || voxels > 1e-3 {
                cases.extend([false, true].map(|turned| parted(grid, wall, voxels, 0.0, turned)));
            }
        }
    }
    cases.push(parted(grid, Wall::Slab, 0.01, 0.3, false));
    cases.push(parted(grid, Wall::Slab, 0.01, 0.3, true));
    cases
}

/// Two rooms with the light in the left one; `gap` voxels of the wall are open.
fn parted(grid: u32, kind: Wall, voxels: f64, gap: f64, turned: bool) -> Case {
    let h = 2.1 / grid as f64;
    let (middle, half) = (1.03, 0.5 * voxels * h);
    let mut world = World::new();
    let grey = world.grey(0.8, 0.0);
    let high = DVec3::new(2.1, 1.0, 1.0);
    world.room(DVec3::ZERO, high, grey);
    let (low, top) = (DVec3::splat(-0.05), high + 0.05);
    let end = if gap > 0.0 { 1.0 - gap * h } else { top.y };
    match kind {
        Wall::Slab => {
            world.block(low.with_x(middle - half), DVec3::new(middle + half, end, top.z), grey);
        }
        Wall::Sheets => {
            for x in [middle - half, middle + half] {
                world.quad("sheet", low.with_x(x), DVec3::Y * (end - low.y), DVec3::Z * (top.z - low.z), grey);
            }
        }
    }
    world.point_light(DVec3::new(0.5, 0.4, 0.6), FLUX);
    if turned {
        world.transform(crate::common::rotation());
    }
    let mut stage = world.build();
    for t in &mut stage.scene.triangles {
        t.two_sided = stage.scene.meshes[t.mesh as usize] == "sheet";
    }
    // The wall covers floor and ceiling by its thickness; what it covers of one side wall it gives back as its end.
    let wall = 1.0 - gap * h;
    let surface = surface(high) + 2.0 * wall * (1.0 - 2.0 * half);
    let name = if gap > 0.0 { format!("door gap of {gap} voxels") } else { format!("{kind:?}, {voxels} voxels") };
    Case {
        name: if turned { format!("{name}, turned") } else { name },
        stage,
        mean: if gap > 0.0 { mean(0.8, FLUX, surface) } else { None },
        dark_beyond: (gap == 0.0).then_some(middle + half),
    }
}

/// Bad triangles.
pub fn shapes() -> Vec<Case> {
    let case = |name: &str, stage: Stage, mean: Option<f64>| Case { name: name.into(), stage, mean, dark_beyond: None };
    let plain = surface(ROOM);
    let mut cases = vec![
        case("slivers of aspect 1e6", slivers(), mean(0.5, FLUX, plain)),
        case("every face three times", thrice(), mean(0.5, FLUX, plain)),
        case("winding inverted", wound(|_| true), mean(0.5, FLUX, plain)),
        case("winding mixed", wound(|k| sampling::hash(&[k]) & 1 == 1), mean(0.5, FLUX, plain)),
    ];
    for seed in 0..3 {
        let (stage, surface) = soup(seed);
        cases.push(case(&format!("triangle soup in a room, {seed}"), stage, mean(0.5, FLUX, surface)));
        cases.push(case(&format!("triangle soup under a sky, {seed}"), open_soup(seed), None));
    }
    let mut one = World::new();
    let grey = one.grey(0.6, 0.0);
    one.mesh("one", vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]], grey);
    one.builder.add_light(WorldLight::Sky { radiance: Vec3::ONE });
    cases.push(case("one triangle", one.build(), Some(0.0)));
    let mut black = World::new();
    let soot = black.grey(0.0, 0.0);
    black.room(DVec3::ZERO, ROOM, soot);
    black.point_light(0.4 * ROOM, FLUX);
    cases.push(case("black room", black.build(), Some(0.0)));
    cases
}

/// A room whose walls have strips a millionth as wide as long.
fn slivers() -> Stage {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    for [corner, u, v] in quads() {
        let mut at = 0.0;
        for k in 0..20 {
            let width = if k % 2 == 1 { 1e-6 } else { (1.0 - 1e-5) / 10.0 };
            world.quad("room", corner + at * u, width * u, v, grey);
            at += width;
        }
    }
    world.point_light(DVec3::new(0.83, 0.61, 0.47), FLUX);
    world.build()
}

/// The walls of the plain room as single quads: (corner, u, v), the front on the side of u x v, inside.
fn quads() -> Vec<[DVec3; 3]> {
    (0..3)
        .flat_map(|axis| {
            let (u, v) = (DVec3::AXES[(axis + 1) % 3] * ROOM, DVec3::AXES[(axis + 2) % 3] * ROOM);
            [[DVec3::ZERO, u, v], [DVec3::AXES[axis] * ROOM, v, u]]
        })
        .collect()
}

/// Every wall twice, and once more cut along its other diagonal.
fn thrice() -> Stage {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    for [corner, u, v] in quads() {
        world.quad("once", corner, u, v, grey);
        world.quad("twice", corner, u, v, grey);
        world.mesh("thrice", vec![corner + u, corner + u + v, corner + v, corner], vec![[0, 1, 2], [0, 2, 3]], grey);
    }
    world.point_light(DVec3::new(0.83, 0.61, 0.47), FLUX);
    world.build()
}

/// The plain room with some of its triangles turned over.
fn wound(turned: impl Fn(u64) -> bool) -> Stage {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    for (k, [corner, u, v]) in (0..).zip(quads()) {
        let triangles = [[0, 1, 2], [0, 2, 3]].into_iter().zip(0..);
        let triangles = triangles.map(|([a, b, c], half)| if turned(2 * k + half) { [a, c, b] } else { [a, b, c] });
        world.mesh("room", vec![corner, corner + u, corner + u + v, corner + v], triangles.collect(), grey);
    }
    world.point_light(DVec3::new(0.83, 0.61, 0.47), FLUX);
    world.build_by(SidesRule::Auto)
}

/// Uniform numbers in [-1, 1).
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut k = 0;
    move || {
        k += 1;
        sampling::hash(&[0x50_7570, seed, k]) as f64 / u64::MAX as f64 * 2.0 - 1.0
    }
}

/// Triangles of many sizes, slivers among them, that pass through each other.
fn triangles(seed: u64, count: usize, add: &mut impl FnMut([DVec3; 3])) {
    let mut number = numbers(seed);
    let mut vector = || DVec3::new(number(), number(), number());
    for k in 0..count {
        let size = 10.0_f64.powf(-0.5 - 1.5 * (k % 4) as f64 / 3.0);
        let p = 0.55 * vector();
        let (a, b) = (size * vector(), size * vector());
        add([p, p + a, p + if k % 5 == 4 { a * 0.5 + b * 1e-3 } else { b }]);
    }
}

/// Two-sided triangles in a closed room, clear of its walls.
fn soup(seed: u64) -> (Stage, f64) {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    world.room(DVec3::splat(-1.3), DVec3::splat(1.3), grey);
    let mut total = surface(DVec3::splat(2.6));
    triangles(seed, 60, &mut |[a, b, c]| {
        total += (b - a).cross(c - a).length();
        world.mesh("sheet", vec![a, b, c], vec![[0, 1, 2]], grey);
    });
    world.point_light(DVec3::new(1.05, 1.1, 0.9), FLUX);
    let mut stage = world.build();
    for t in &mut stage.scene.triangles {
        t.two_sided = stage.scene.meshes[t.mesh as usize] == "sheet";
    }
    (stage, total)
}

fn open_soup(seed: u64) -> Stage {
    let mut world = World::new();
    let grey = world.grey(0.6, 0.0);
    triangles(seed + 10, 60, &mut |corners| world.mesh("sheet", corners.into(), vec![[0, 1, 2]], grey));
    world.builder.add_light(WorldLight::Sky { radiance: Vec3::ONE });
    world.build_by(SidesRule::Two)
}

/// Very unequal and very many lights.
pub fn lights() -> Vec<Case> {
    let mut unequal = World::new();
    let grey = unequal.grey(0.5, 0.0);
    unequal.room(DVec3::ZERO, ROOM, grey);
    let strong = 1e6 * (1.0 + 1e-12);
    unequal.point_light(DVec3::new(0.3, 0.7, 0.5), 1e6);
    unequal.point_light(DVec3::new(1.0, 0.2, 0.3), 1e-6);
    let mut bands = World::new();
    let grey = bands.grey(0.5, 0.0);
    bands.room(DVec3::ZERO, ROOM, grey);
    let intensity = (FLUX / (4.0 * std::f64::consts::PI)) as f32 * Vec3::new(1.0, 1e12, 1e-12);
    bands.builder.add_light(WorldLight::Point { position: 0.4 * ROOM, intensity, range: f64::INFINITY });
    let mut many = World::new();
    let grey = many.grey(0.5, 0.0);
    many.room(DVec3::ZERO, ROOM, grey);
    const MANY: usize = 100_000;
    let mut number = numbers(77);
    for _ in 0..MANY {
        let at = 0.5 + 0.45 * DVec3::new(number(), number(), number());
        many.point_light(at * ROOM, FLUX / MANY as f64);
    }
    // Squares of 4 mm, 1 cm below the ceiling; what they cover of it and of each other's light is room like all else.
    let mut squares = World::new();
    let (grey, glow) = (squares.grey(0.5, 0.0), squares.grey(0.5, 1000.0));
    squares.room(DVec3::ZERO, ROOM, grey);
    const SIDE: f64 = 4e-3;
    for k in 0..400 {
        let at = DVec3::new(0.05 + 0.06 * (k % 20) as f64, 0.05 + 0.045 * (k / 20) as f64, ROOM.z - 0.01);
        squares.quad("lamp", at, DVec3::Y * SIDE, DVec3::X * SIDE, glow);
    }
    let glowing = 400.0 * SIDE * SIDE;
    let glow = mean(0.5, std::f64::consts::PI * 1000.0 * glowing, surface(ROOM) + 2.0 * glowing);
    let mut squares = squares.build();
    for t in &mut squares.scene.triangles {
        t.two_sided = squares.scene.meshes[t.mesh as usize] == "lamp";
    }
    let case = |name: &str, world: World, flux: f64| Case {
        name: name.into(),
        stage: world.build(),
        mean: mean(0.5, flux, surface(ROOM)),
        dark_beyond: None,
    };
    vec![
        Case { name: "400 glowing squares".into(), stage: squares, mean: glow, dark_beyond: None },
        case("emission ratio 1e12", unequal, strong),
        case("bands of 1 : 1e12 : 1e-12", bands, FLUX),
        case("100,000 lights", many, FLUX),
    ]
}
