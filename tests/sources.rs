//! Patches of simplified meshes, and final gathers over any patches.

mod common;

use common::{World, faces, options};
use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions,
    bake::Bake,
    options::{PatchSource, Reconstruct},
    progress::Silent,
    scene::{Proxy, SurfacePoint, WorldLight},
};

const SIMPLIFIED: [PatchSource; 2] = [PatchSource::Decimated, PatchSource::Clustered];

/// A closed room with a ball in it.
fn world() -> World {
    let mut world = World::new();
    let (wall, red) = (world.grey(0.6, 0.0), world.grey(0.3, 0.0));
    world.room(DVec3::ZERO, DVec3::new(1.0, 1.1, 0.9), wall);
    world.block(DVec3::new(0.31, 0.2, 0.0), DVec3::new(0.6, 0.53, 0.35), red);
    world.point_light(DVec3::new(0.8, 0.9, 0.7), 100.0);
    world
}

#[test]
fn simplified_meshes_keep_area_and_meet_the_count_asked_for() {
    let stage = world().build();
    let area = stage.area() / stage.scene.frame.scale.powi(2);
    for patches in SIMPLIFIED {
        for target in [400, 1600] {
            let options = BakeOptions { patches, target_patches: Some(target), ..options(12, 64) };
            let bake = stage.bake(&options);
            let found = bake.patches().area.iter().map(|&a| a as f64).sum::<f64>();
            println!("{patches:?}, {target} asked: {} patches, area {:.4}", bake.patches().len(), found / area);
            // Triangles that are too long are cut; clusters that fold on themselves vanish.
            assert!((target / 2..target * 2).contains(&(bake.patches().len() as u32)), "{}", bake.patches().len());
            // Clustering rounds the corners of the block by up to a cell: a few per cent of its area.
            assert!((found / area - 1.0).abs() < 0.03, "{patches:?}: {}", found / area);
            // No triangle is longer than its limit.
            let size = (area / target as f64).sqrt() as f32;
            for t in 0..bake.simplified.geometry.triangles.len() {
                let [a, b, c] = bake.simplified.corners(t);
                assert!(a.distance(b).max(b.distance(c)).max(c.distance(a)) <= 2.35001 * size);
            }
        }
    }
}

#[test]
fn patches_of_simplified_meshes_have_the_colours_of_the_surfaces_they_stand_for() {
    let stage = world().build();
    for patches in SIMPLIFIED {
        let bake = stage.bake(&BakeOptions { patches, ..options(16, 64) });
        let (mut wrong, mut all) = (0.0, 0.0);
        for i in 0..bake.patches().len() {
            let p = stage.scene.frame.to_world(bake.patches().centroid[i]);
            let size = 1.5 * bake.simplified.grid.voxel_size * stage.scene.frame.scale;
            let near = |lo: f64, hi: f64, x: f64, d: f64| x > lo - d && x < hi + d;
            let about = |d: f64| near(0.31, 0.6, p.x, d) && near(0.2, 0.53, p.y, d) && near(0.0, 0.35, p.z, d);
            // Between the two, triangles may stand for either.
            if about(size) && !about(0.01 * size) {
                continue;
            }
            let on_block = about(0.01 * size) && p.z > 0.01;
            let expected = if on_block { 0.3 } else { 0.6 };
            all += bake.patches().area[i];
            if (bake.patches().albedo[i].x - expected).abs() > 1e-5 && p.z > 0.01 {
                wrong += bake.patches().area[i];
            }
        }
        // Triangles across the edges of the block mix: none of them is all inside or outside.
        assert!(wrong < 0.01 * all, "{patches:?}: {wrong} of {all}");
    }
}

/// A proxy of `world`, wound as asked.
fn proxy(stage: &common::Stage, turned: bool) -> Proxy {
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    for (low, high) in [([0.0; 3], [1.0, 1.1, 0.9]), ([0.32, 0.21, 0.0], [0.59, 0.52, 0.34])] {
        let first = positions.len() as u32;
        let corner = |k: usize| DVec3::from(std::array::from_fn(|a| if k >> a & 1 == 1 { high[a] } else { low[a] }));
        positions.extend((0..8).map(|k| stage.scene.frame.to_local(corner(k))));
        for [a, b, c, d] in [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]] {
            triangles.extend([[a, b, c], [a, c, d]].map(|t: [u32; 3]| t.map(|v| first + v)));
        }
    }
    if turned {
        triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let mesh = vec![0; triangles.len()];
    Proxy { path: "box.obj".into(), positions, triangles, mesh, meshes: vec!["box".into()], dropped: 0 }
}

/// Mean indirect light of all surfaces but the floor, of which a part lies under the block, where nobody sees it.
fn mean_above_floor(stage: &common::Stage, bake: &Bake) -> f64 {
    let (mut sum, mut area) = (0.0, 0.0);
    for t in &bake.mesh.triangles {
        let corners = t.map(|v| stage.scene.frame.to_world(bake.mesh.positions[v as usize]));
        if corners.iter().any(|p| p.z > 1e-4) {
            let own = (corners[1] - corners[0]).cross(corners[2] - corners[0]).length();
            sum += own * t.iter().map(|&v| bake.vertices.indirect[v as usize].x as f64).sum::<f64>() / 3.0;
            area += own;
        }
    }
    sum / area
}

#[test]
fn a_proxy_lights_the_scene_however_it_is_wound() {
    let mut stage = world().build();
    let options = BakeOptions { patches: PatchSource::Proxy, ..options(16, 256) };
    let expected = {
        let bake = stage.bake(&common::options(16, 256));
        mean_above_floor(&stage, &bake)
    };
    for turned in [false, true] {
        stage.scene.proxy = Some(proxy(&stage, turned));
        let bake = stage.bake(&options);
        let mean = mean_above_floor(&stage, &bake);
        println!("proxy, turned {turned}: mean {:+.2} % of that of the surfels", 100.0 * (mean / expected - 1.0));
        // Means of some 1000 patches of 256 rays, whose rows err by some per cent each; the block of the proxy is a
        // hundredth of the room smaller.
        assert!((mean / expected - 1.0).abs() < 0.02, "{mean} {expected}");
    }
}

#[test]
fn a_scene_file_may_name_its_proxy() {
    let folder = tempfile::tempdir().unwrap();
    let scenes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
    let file = folder.path().join("cornell.toml");
    let [mesh, proxy] = ["cornell.obj", "cornell_proxy.obj"].map(|name| scenes.join(name).display().to_string());
    let text = |bake: &str| format!("[[mesh]]\npath = {mesh:?}\n[bake]\nproxy = {proxy:?}\n{bake}");
    for (bake, expected) in [("", PatchSource::Proxy), ("patches = \"surfels\"\n", PatchSource::Surfels)] {
        std::fs::write(&file, text(bake)).unwrap();
        let (scene, settings) = luxel::scene::load(&file, &Default::default()).unwrap();
        let mut options = BakeOptions::default();
        settings.apply(&mut options);
        assert_eq!(options.patches, expected);
        let proxy = scene.proxy.expect("a proxy");
        assert_eq!((proxy.triangles.len(), proxy.dropped), (30, 0));
        assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    }
}

fn points(stage: &common::Stage) -> Vec<SurfacePoint> {
    (0..300)
        .map(|i| {
            let at = |k: u64| (luxel::sampling::hash(&[9, i, k]) >> 11) as f64 / (1u64 << 53) as f64;
            match i % 3 {
                0 => stage.point([at(0), at(1) * 1.1, 0.9], [0.0, 0.0, -1.0]),
                1 => stage.point([at(0), 1.1, at(1) * 0.9], [0.0, -1.0, 0.0]),
                _ => stage.point([0.0, at(0) * 1.1, at(1) * 0.9], [1.0, 0.0, 0.0]),
            }
        })
        .collect()
}

#[test]
fn a_point_gathers_the_same_bits_whatever_is_asked_with_it() {
    let stage = world().build();
    for (patches, reconstruct) in [
        (PatchSource::Surfels, Reconstruct::Gather),
        (PatchSource::Surfels, Reconstruct::Adaptive),
        (PatchSource::Decimated, Reconstruct::Gather),
    ] {
        let bake = stage.bake(&BakeOptions { patches, reconstruct, gather_rays: 128, ..options(10, 64) });
        let points = points(&stage);
        let all = bake.irradiance_with(&points, 1, &Silent).indirect;
        let some: Vec<SurfacePoint> = points.iter().rev().step_by(7).copied().collect();
        let again = bake.irradiance_with(&some, 1, &Silent).indirect;
        assert!(all.iter().rev().step_by(7).eq(again.iter()), "{patches:?} {reconstruct:?}");
        // A zero of the other sign is the same place.
        let minus = |v: Vec3| Vec3::select(v.cmpeq(Vec3::ZERO), -Vec3::ZERO, v);
        let same: Vec<SurfacePoint> = points.iter().map(|p| SurfacePoint { normal: minus(p.normal), ..*p }).collect();
        assert!(all == bake.irradiance_with(&same, 1, &Silent).indirect, "{patches:?} {reconstruct:?}");
    }
}

#[test]
fn gather_and_least_squares_agree_on_smooth_light() {
    let stage = world().build();
    let mut bake = stage.bake(&options(24, 1024));
    // Away from the edges, which least squares blur.
    let points: Vec<SurfacePoint> = (0..200)
        .map(|i| {
            let at = |k: u64| 0.15 + 0.7 * ((luxel::sampling::hash(&[4, i, k]) >> 11) as f64 / (1u64 << 53) as f64);
            stage.point([at(0), at(1) * 1.1, 0.9], [0.0, 0.0, -1.0])
        })
        .collect();
    let smooth = bake.irradiance_with(&points, 1, &Silent).indirect;
    const RAYS: u32 = 4096;
    bake.set_reconstruct(Reconstruct::Gather, RAYS);
    let gather = bake.irradiance_with(&points, 1, &Silent).indirect;
    // Rays of both are stratified; independent ones would err by the deviation of the radiosity over the root of
    // their number: those of the gather, and those of some four rows that a fit amounts to.
    let b = &bake.light.radiosity;
    let mean = common::patch_mean(&bake, b) as f32;
    let deviation = common::patch_mean(&bake, &b.iter().map(|b| (*b - mean) * (*b - mean)).collect::<Vec<_>>()).sqrt();
    let sigma = deviation * (1.0 / RAYS as f64 + 1.0 / (4.0 * 1024.0)).sqrt();
    let difference: Vec<f64> = smooth.iter().zip(&gather).map(|(s, g)| (s.x - g.x) as f64).collect();
    let worst = difference.iter().fold(0.0, |most: f64, d| most.max(d.abs()));
    println!("gather against least squares: largest difference {:.2} sigma", worst / sigma);
    assert!(worst < 4.5 * sigma, "{worst} {sigma}");
}

/// The sky is direct light; no ray of a gather may bring it again.
#[test]
fn a_gather_leaves_the_sky_to_direct_light() {
    let mut world = World::new();
    let grey = world.grey(0.5, 0.0);
    world.quad("floor", DVec3::ZERO, DVec3::X, DVec3::Y, grey);
    world.builder.add_light(WorldLight::Sky { radiance: Vec3::ONE });
    let stage = world.build();
    for options in [options(8, 64), faces(options(8, 64))] {
        let bake = stage.bake(&BakeOptions { reconstruct: Reconstruct::Gather, ..options });
        let light = bake.irradiance(&[stage.point([0.4, 0.6, 0.0], [0.0, 0.0, 1.0])], &Silent);
        assert_eq!(light.indirect, [Vec3::ZERO]);
        assert!((light.direct[0].x / std::f32::consts::PI - 1.0).abs() < 1e-3, "{}", light.direct[0]);
    }
}

/// Adaptive gathers where light changes fast, and interpolates elsewhere.
#[test]
fn adaptive_takes_from_either_and_gathers_in_corners() {
    let stage = world().build();
    let mut bake = stage.bake(&options(24, 256));
    let points = points(&stage);
    let mut by = |method| {
        bake.set_reconstruct(method, 256);
        bake.irradiance_with(&points, 1, &Silent).indirect
    };
    let (smooth, gather, adaptive) = (by(Reconstruct::Smooth), by(Reconstruct::Gather), by(Reconstruct::Adaptive));
    let mut gathered = 0;
    for i in 0..points.len() {
        assert!(adaptive[i] == smooth[i] || adaptive[i] == gather[i], "point {i}");
        gathered += (adaptive[i] == gather[i] && gather[i] != smooth[i]) as usize;
    }
    println!("adaptive: {gathered} of {} gathered", points.len());
    assert!((1..points.len() / 2).contains(&gathered), "{gathered}");
    // In the very corner of the room the neighbours lie to one side.
    let corner = stage.point([0.01, 0.01, 0.9], [0.0, 0.0, -1.0]);
    let mut at_corner = |method| {
        bake.set_reconstruct(method, 256);
        bake.irradiance_with(&[corner], 1, &Silent).indirect[0]
    };
    assert_eq!(at_corner(Reconstruct::Adaptive), at_corner(Reconstruct::Gather));
}
