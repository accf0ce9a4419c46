//! What is skipped changes no result by more than the report says.

mod common;

use common::{Stage, World, faces, options};
use glam::{DVec3, Vec2, Vec3};
use luxel::{
    BakeOptions, Error,
    bake::Bake,
    options::{Backend, Primary},
    progress::Silent,
    report::Skipped,
    scene::{Material, RawMaterial, RawMesh, Texture, WorldLight},
};

/// A room with a block and a lamp, and a sealed box in it that holds a light of its own.
fn furnished() -> World {
    let mut world = World::new();
    let (wall, lamp) = (world.grey(0.6, 0.0), world.grey(0.0, 10.0));
    world.room(DVec3::ZERO, DVec3::new(1.0, 1.2, 0.9), wall);
    world.block(DVec3::new(0.2, 0.3, 0.0), DVec3::new(0.5, 0.6, 0.4), wall);
    world.quad("lamp", DVec3::new(0.4, 0.4, 0.85), DVec3::Y * 0.3, DVec3::X * 0.3, lamp);
    world
}

/// Two blocks in the open, one on the other: their sides are outer shells.
fn blocks() -> World {
    let mut world = World::new();
    let wall = world.grey(0.5, 0.0);
    world.block(DVec3::ZERO, DVec3::new(1.0, 0.8, 0.3), wall);
    world.block(DVec3::new(0.3, 0.3, 0.3), DVec3::new(0.6, 0.5, 0.5), wall);
    world
}

fn sun(world: &mut World) {
    let (direction, irradiance) = (DVec3::new(0.3, 0.4, -1.0), Vec3::new(3.0, 2.0, 2.0));
    world.builder.add_light(WorldLight::Sun { direction, irradiance });
}

fn skipped<'a>(bake: &'a Bake, what: &str) -> &'a Skipped {
    let found = bake.report.skipped.iter().find(|s| s.what.contains(what));
    found.unwrap_or_else(|| panic!("\"{what}\" is not in {:#?}", bake.report.skipped))
}

/// With and without skipping.
fn both(stage: &Stage, base: &BakeOptions) -> [Bake; 2] {
    [true, false].map(|skip| stage.bake(&BakeOptions { skip, ..base.clone() }))
}

/// Light of vertices and of patches that light reaches, as bits.
fn bits(bake: &Bake) -> Vec<u32> {
    let reached = |v: &Vec<Vec3>| {
        let all = v.iter().zip(&bake.light.reached);
        all.filter(|r| *r.1).map(|r| *r.0).collect::<Vec<Vec3>>()
    };
    let light = &bake.light;
    let patches = [&light.direct, &light.indirect, &light.radiosity].map(reached);
    let vertices = [&bake.mesh.positions, &bake.vertices.direct, &bake.vertices.indirect];
    vertices.into_iter().chain(&patches).flatten().flat_map(|v| v.to_array()).map(f32::to_bits).collect()
}

#[test]
fn what_has_no_bound_but_zero_changes_no_bit_on_any_backend_and_in_any_mode() {
    let mut room = furnished();
    room.point_light(DVec3::new(0.35, 0.45, 0.2), 5.0);
    let mut open = blocks();
    sun(&mut open);
    open.point_light(DVec3::new(0.5, -0.5, 0.9), 3.0);
    for (stage, what) in [(room.build(), "room"), (open.build(), "open")] {
        let base = options(12, 64);
        let modes = [
            BakeOptions { backend: Backend::Bvh, ..base.clone() },
            BakeOptions { backend: Backend::Brute, ..options(6, 64) },
            BakeOptions { primary: Primary::Radiosity, ..base.clone() },
            faces(options(8, 64)),
            base,
        ];
        for mode in modes {
            let [skip, all] = both(&stage, &mode);
            assert!(all.report.skipped.is_empty());
            assert!(bits(&skip) == bits(&all), "{what}, {mode:?}");
            assert!(skip.report.rays.form_factors <= all.report.rays.form_factors);
        }
    }
}

#[test]
fn the_list_tells_what_was_saved() {
    let mut open = blocks();
    sun(&mut open);
    let [skip, all] = both(&open.build(), &options(12, 64));
    // Four sides and the bottom of the lower block, the top of the upper one.
    let outer = skipped(&skip, "outer shells");
    assert!(outer.patches > 300 && outer.bound == Some(0.0), "{outer:?}");
    let saved = all.report.rays.form_factors - skip.report.rays.form_factors;
    assert!(outer.rays > saved / 2 && outer.seconds.unwrap() > 0.0, "{outer:?}, {saved} rays");
    for what in ["that face away", "sky rays without sky", "along planes", "channels"] {
        assert_eq!(skipped(&skip, what).bound, Some(0.0), "{what}");
    }

    let mut room = furnished();
    // A block in the air, and a light inside of it.
    let wall = room.grey(0.6, 0.0);
    room.block(DVec3::new(0.6, 0.7, 0.4), DVec3::new(0.8, 0.9, 0.6), wall);
    room.point_light(DVec3::new(0.7, 0.8, 0.5), 5.0);
    let [skip, all] = both(&room.build(), &options(16, 64));
    let lamp = skipped(&skip, "reach nothing");
    assert!(lamp.rays > 1000 && lamp.error.contains(" 1 lamps"), "{lamp:?}");
    assert!(bits(&skip) == bits(&all));
}

#[test]
fn points_that_see_no_sky_or_only_sky_lose_no_more_light_than_the_bound() {
    // A court under the sky, and a chamber beside it with a low slot between: its ceiling sees no sky.
    let mut world = World::new();
    let wall = world.grey(0.7, 0.0);
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    for (corner, u, v) in [
        (DVec3::ZERO, 2.0 * x, y),
        (DVec3::ZERO, y, z),
        (2.0 * x, z, y),
        (DVec3::ZERO, z, 2.0 * x),
        (y, 2.0 * x, z),
        (x + z, y, x),
        (x + 0.2 * z, y, 0.8 * z),
        (0.98 * x + 0.2 * z, 0.8 * z, y),
        (0.98 * x + 0.2 * z, y, 0.02 * x),
    ] {
        world.quad("wall", corner, u, v, wall);
    }
    world.builder.add_light(WorldLight::Sky { radiance: Vec3::new(1.0, 2.0, 3.0) });
    let stage = world.build();
    let [skip, all] = both(&stage, &options(24, 256));
    let known = skipped(&skip, "known answer");
    let bound = known.bound.unwrap();
    assert!(known.rays > 10_000 && bound > 0.0 && bound < 0.01, "{known:?}");
    let sum = |bake: &Bake| bake.vertices.direct.iter().map(|e| e.element_sum() as f64).sum::<f64>();
    let lost = (sum(&skip) / sum(&all) - 1.0).abs();
    println!("lost {lost:.1e} of direct light, bound {bound:.1e}");
    assert!(lost <= bound, "{lost} {bound}");
    // Indirect light: what the patches that no light reaches would have sent, and two runs of the solver to 1e-6.
    let unlit = skip.report.skipped.iter().filter(|s| s.what.contains("no light reaches"));
    let bound = unlit.filter_map(|s| s.bound).sum::<f64>() + 1e-5;
    let power = |i: usize, e: Vec3| {
        skip.patches().area[i] as f64 * (1.0 - skip.form_factors.hidden(i)) * e.abs().element_sum() as f64
    };
    let (mut changed, mut all_of_it) = (0.0, 0.0);
    for i in (0..skip.patches().len()).filter(|&i| skip.light.reached[i]) {
        changed += power(i, skip.light.indirect[i] - all.light.indirect[i]);
        all_of_it += power(i, all.light.indirect[i]);
    }
    println!("changed {:.1e} of indirect light, bound {bound:.1e}", changed / all_of_it);
    assert!(changed <= bound * all_of_it, "{changed} {all_of_it}");
}

#[test]
fn textures_of_one_colour_are_plain_colours() {
    let room = |textured: bool| {
        let mut world = World::new();
        let colour = Vec3::new(0.7, 0.5, 0.3);
        let texture = Texture { width: 2, height: 2, texels: vec![colour; 4] };
        let albedo_texture = textured.then(|| world.builder.add_texture(texture));
        let albedo = if textured { Vec3::splat(0.9) } else { 0.9 * colour };
        let surface = Material { name: "wall".into(), albedo, albedo_texture, ..Material::default() };
        let wall = world.builder.add_material(RawMaterial { surface, ..RawMaterial::default() });
        let size = DVec3::ONE;
        for axis in 0..3 {
            let (u, v) = (DVec3::AXES[(axis + 1) % 3] * size, DVec3::AXES[(axis + 2) % 3] * size);
            for (corner, u, v) in [(DVec3::ZERO, u, v), (DVec3::AXES[axis] * size, v, u)] {
                world.builder.add_mesh(RawMesh {
                    name: "room".into(),
                    positions: vec![corner, corner + u, corner + u + v, corner + v],
                    triangles: vec![[0, 1, 2], [0, 2, 3]],
                    uvs: vec![Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y],
                    material: wall,
                    ..RawMesh::default()
                });
            }
        }
        world.point_light(DVec3::splat(0.4), 10.0);
        world.build()
    };
    let [skip, all] = both(&room(true), &options(8, 64));
    let plain = room(false).bake(&options(8, 64));
    assert_eq!(skipped(&skip, "textures of one colour").patches, skip.patches().len());
    assert!(bits(&skip) == bits(&plain));
    // Sums of equal samples: a few roundings, and 1 / (1 - rho) times that.
    for (a, b) in skip.vertices.indirect.iter().zip(&all.vertices.indirect) {
        assert!((*a - *b).abs().max_element() <= 1e-5 * b.max_element(), "{a} {b}");
    }
}

#[test]
fn a_mesh_alone_gets_the_light_that_it_gets_with_the_others() {
    let stage = furnished().build();
    let base = options(20, 256);
    let whole = stage.bake(&base);
    let alone = stage.bake(&BakeOptions { only: vec!["block".into()], ..base.clone() });

    let names: Vec<&str> = alone
        .mesh
        .source
        .iter()
        .map(|&t| stage.scene.triangles[t as usize].mesh)
        .map(|m| &stage.scene.meshes[m as usize][..])
        .collect();
    assert!(!names.is_empty() && names.iter().all(|&n| n == "block"));

    let little = skipped(&alone, "matter little");
    let noise = little.bound.unwrap();
    assert!(little.patches > 1000 && noise > 0.0 && noise < 0.01, "{little:?}");
    assert!(alone.report.rays.form_factors < whole.report.rays.form_factors / 2);
    // Vertices are the same but in order.
    let key = |p: Vec3, n: Vec3| (p.to_array().map(f32::to_bits), n.to_array().map(f32::to_bits));
    let mut places = std::collections::HashMap::new();
    for v in 0..whole.mesh.positions.len() {
        places.insert(key(whole.mesh.positions[v], whole.mesh.normals[v]), v);
    }
    let (mut sum, mut change, mut square, mut found) = (0.0, 0.0, 0.0, 0);
    for v in 0..alone.mesh.positions.len() {
        let Some(&w) = places.get(&key(alone.mesh.positions[v], alone.mesh.normals[v])) else { continue };
        if alone.mesh.samples[v] != whole.mesh.samples[w] {
            continue;
        }
        assert_eq!(alone.vertices.direct[v], whole.vertices.direct[w]);
        let (a, b) = (alone.vertices.indirect[v].x as f64, whole.vertices.indirect[w].x as f64);
        sum += b + whole.vertices.direct[w].x as f64;
        change += a - b;
        square += (a - b).powi(2);
        found += 1;
    }
    assert!(found > 200, "{found}");
    let rms = (square / found as f64).sqrt() * found as f64 / sum;
    println!("mean {:+.1e}, rms {rms:.1e}; standard error of the mean {noise:.1e}", change / sum);
    // Four standard errors; the mean of vertices stands for that of patches.
    assert!((change / sum).abs() < 4.0 * noise, "{} {noise}", change / sum);
}

#[test]
fn rooms_apart_from_the_wanted_mesh_get_no_rows() {
    let mut world = furnished();
    let (wall, black) = (world.grey(0.6, 0.0), world.grey(0.0, 0.0));
    world.named_room("next door", DVec3::new(1.1, 0.0, 0.0), DVec3::new(2.0, 1.0, 0.9), wall);
    world.quad("stove", DVec3::new(0.8, 0.8, 0.3), DVec3::X * 0.1, DVec3::Y * 0.1, black);
    world.point_light(DVec3::new(1.5, 0.5, 0.5), 3.0);
    let stage = world.build();
    let alone = stage.bake(&BakeOptions { only: vec!["block".into()], ..options(16, 64) });
    let mut apart = 0;
    for i in 0..alone.patches().len() {
        match common::mesh_of(&stage.scene, &alone, i) {
            "next door" => {
                assert!(!alone.form_factors.has_row(i));
                apart += 1;
            }
            "stove" => assert!(!alone.form_factors.has_row(i), "nobody asked for its light"),
            _ => (),
        }
    }
    let listed = skipped(&alone, "apart from");
    assert!(apart > 200 && listed.patches >= apart && listed.bound == Some(0.0), "{apart} {listed:?}");
    assert!(skipped(&alone, "black surfaces").patches > 0);
}

#[test]
fn a_name_that_no_mesh_has_is_told_with_those_that_are_like_it() {
    let stage = furnished().build();
    let error = |name: &str| {
        let options = BakeOptions { only: vec!["block".into(), name.into()], ..options(8, 64) };
        match luxel::bake(&stage.scene, &options, &Silent) {
            Err(Error::Option(message)) => message,
            other => panic!("{:?}", other.err()),
        }
    };
    assert_eq!(error("B_lo"), "--only \"B_lo\": there is no such mesh; like it are \"block\"");
    assert_eq!(error("chair"), "--only \"chair\": there is no such mesh; there are \"block\"; \"lamp\"; \"room\"");
}
