//! Loading: units, winding, sides, materials, scene files.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Scene,
    options::{Reconstruct, Resolution},
    scene::{Builder, Light, Material, RawMaterial, RawMesh, SceneCheck, SceneOverrides, SideKind, SidesRule, load},
};
use tempfile::TempDir;

fn folder(files: &[(&str, &str)]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in files {
        std::fs::write(dir.path().join(name), text).unwrap();
    }
    dir
}

fn open(dir: &TempDir, name: &str) -> luxel::Result<Scene> {
    load(&dir.path().join(name), &SceneOverrides::default()).map(|s| s.0)
}

fn message(dir: &TempDir, name: &str) -> String {
    open(dir, name).unwrap_err().to_string()
}

fn world_area(scene: &Scene) -> f64 {
    (0..scene.triangles.len()).map(|t| scene.area(t)).sum::<f64>() * scene.frame.scale.powi(2)
}

/// An axis-aligned box as an OBJ object, normals outwards.
fn cube(name: &str, low: [f64; 3], high: [f64; 3]) -> String {
    let mut text = format!("o {name}\n");
    for i in 0..8 {
        let pick = |axis: usize, bit: u32| if i >> bit & 1 == 1 { high[axis] } else { low[axis] };
        text += &format!("v {} {} {}\n", pick(0, 0), pick(1, 1), pick(2, 2));
    }
    for q in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        let [a, b, c, d] = q.map(|v| v - 8);
        text += &format!("f {a} {b} {c} {d}\n");
    }
    text
}

const LAMP: &str = "newmtl lamp\nKd 0 0 0\nKe 5 5 5\nnewmtl grey\nKd 0.5 0.5 0.5\n";

/// A downward lamp of 1 x 1 at height `y` above the middle of the unit square.
fn lamp(y: f64) -> String {
    format!("o lamp\nusemtl lamp\nv 0 {y} 0\nv 1 {y} 0\nv 1 {y} 1\nv 0 {y} 1\nf -4 -3 -2 -1\n")
}

#[test]
fn a_closed_shell_is_a_room_only_if_it_holds_the_light() {
    let text = format!(
        "mtllib m.mtl\nusemtl grey\n{}{}{}",
        cube("room", [-2.0, -2.0, -2.0], [3.0, 3.0, 3.0]),
        cube("block", [-1.0, -1.0, -1.0], [0.0, 0.0, 0.0]),
        lamp(2.0)
    );
    let dir = folder(&[("s.obj", &text), ("m.mtl", LAMP)]);
    let scene = open(&dir, "s.obj").unwrap();
    let kind = |name: &str| scene.sides.iter().find(|s| s.meshes == [name]).unwrap().kind;
    assert_eq!((kind("room"), kind("block"), kind("lamp")), (SideKind::Room, SideKind::Solid, SideKind::Sheet));
    for t in 0..12 {
        let [a, b, c] = scene.corners_of(t);
        assert!(scene.normal(t).dot((a + b + c) / 3.0) < 0.0, "the room's normals point inwards");
    }
}

#[test]
fn the_walls_of_a_thick_room_are_solid() {
    let text = format!(
        "mtllib m.mtl\nusemtl grey\n{}{}{}",
        cube("outer", [-3.0, -3.0, -3.0], [4.0, 4.0, 4.0]),
        cube("inner", [-2.0, -2.0, -2.0], [3.0, 3.0, 3.0]),
        lamp(2.0)
    );
    let dir = folder(&[("s.obj", &text), ("m.mtl", LAMP)]);
    let scene = open(&dir, "s.obj").unwrap();
    let kind = |name: &str| scene.sides.iter().find(|s| s.meshes == [name]).unwrap().kind;
    assert_eq!((kind("outer"), kind("inner")), (SideKind::Solid, SideKind::Room));
}

#[test]
fn a_point_light_makes_a_room_and_a_lamp_beside_a_block_does_not() {
    let dir = folder(&[("s.obj", &cube("box", [0.0; 3], [1.0; 3]))]);
    let with = |x: f64| {
        let overrides = SceneOverrides { points: vec![(DVec3::new(x, 0.5, 0.5), Vec3::ONE)], ..Default::default() };
        load(&dir.path().join("s.obj"), &overrides).unwrap().0.sides[0].kind
    };
    assert_eq!(with(0.5), SideKind::Room);
    assert_eq!(with(1.5), SideKind::Solid);
}

#[test]
fn a_glowing_shell_is_a_furnace_if_alone_and_a_lamp_above_a_floor() {
    let glowing = format!("mtllib m.mtl\nusemtl lamp\n{}", cube("box", [0.0; 3], [1.0; 3]));
    let floor = "usemtl grey\no floor\nv -9 -1 -9\nv -9 -1 9\nv 9 -1 9\nv 9 -1 -9\nf -4 -3 -2 -1\n";
    let dir = folder(&[("a.obj", &glowing), ("b.obj", &format!("{glowing}{floor}")), ("m.mtl", LAMP)]);
    assert_eq!(open(&dir, "a.obj").unwrap().sides[0].kind, SideKind::Room);
    assert_eq!(open(&dir, "b.obj").unwrap().sides[0].kind, SideKind::Solid);
}

#[test]
fn sides_can_be_forced() {
    let dir = folder(&[("s.obj", &cube("box", [0.0; 3], [1.0; 3]))]);
    for (rule, two_sided) in [(SidesRule::One, false), (SidesRule::Two, true)] {
        let overrides = SceneOverrides { sides: Some(rule), ..Default::default() };
        let scene = load(&dir.path().join("s.obj"), &overrides).unwrap().0;
        assert!(scene.triangles.iter().all(|t| t.two_sided == two_sided));
        assert_eq!(scene.sides[0].kind, SideKind::Forced);
    }
}

#[test]
fn a_lamp_keeps_its_front_unless_that_is_shut() {
    let below = |y| format!("mtllib m.mtl\nusemtl grey\n{}{}", cube("room", [-2.0; 3], [3.0; 3]), lamp(y));
    let dir = folder(&[("mid.obj", &below(0.5)), ("low.obj", &below(-1.99)), ("m.mtl", LAMP)]);
    let up = |name| {
        let scene = open(&dir, name).unwrap();
        let t = (0..scene.triangles.len()).find(|&t| scene.emission(t) != Vec3::ZERO).unwrap();
        scene.normal(t).y
    };
    assert!(up("mid.obj") < -0.99, "in the middle of the room it shines down, as drawn");
    assert!(up("low.obj") > 0.99, "a centimetre above the floor it is turned up");
}

#[test]
fn point_lights_keep_their_irradiance_in_the_local_frame() {
    let dir = folder(&[("s.obj", &cube("box", [100.0, 200.0, 300.0], [107.0, 203.0, 304.0]))]);
    let at = DVec3::new(103.0, 209.0, 301.0);
    let overrides = SceneOverrides { points: vec![(at, Vec3::new(8.0, 4.0, 2.0))], ..Default::default() };
    let scene = load(&dir.path().join("s.obj"), &overrides).unwrap().0;
    assert_eq!(scene.frame.scale, 8.0, "the next power of two above the longest side");
    let Light::Point { position, intensity, range } = scene.lights[0] else { panic!() };
    assert_eq!(*intensity.to_array().map(|i| i * 64.0).first().unwrap(), 8.0);
    assert_eq!(range, f32::INFINITY);
    // f32 holds local coordinates of size 1 to 6e-8.
    assert!((scene.frame.to_world(position) - at).length() < 1e-6);
}

#[test]
fn a_light_beyond_f32_is_an_error() {
    let dir = folder(&[("s.obj", &cube("box", [0.0; 3], [1e-30; 3]))]);
    let overrides = SceneOverrides { points: vec![(DVec3::ZERO, Vec3::ONE)], ..Default::default() };
    let error = load(&dir.path().join("s.obj"), &overrides).unwrap_err().to_string();
    assert!(error.contains("light 1"), "{error}");
}

#[test]
fn overrides_name_the_materials_that_exist() {
    let dir =
        folder(&[("s.obj", &format!("mtllib m.mtl\nusemtl grey\n{}", cube("b", [0.0; 3], [1.0; 3]))), ("m.mtl", LAMP)]);
    let path = dir.path().join("s.obj");
    let emit = |name: &str| SceneOverrides { emit: vec![(name.into(), Vec3::splat(3.0))], ..Default::default() };
    let error = load(&path, &emit("gray")).unwrap_err().to_string();
    assert!(error.contains("\"gray\"") && error.contains("\"grey\"") && error.contains("\"lamp\""), "{error}");
    let scene = load(&path, &emit("grey")).unwrap().0;
    assert_eq!(scene.emission(0), Vec3::splat(3.0));
    assert!(scene.has_light());
}

#[test]
fn a_scene_without_light_says_how_to_add_some() {
    let dir = folder(&[("s.obj", &cube("b", [0.0; 3], [1.0; 3]))]);
    let scene = open(&dir, "s.obj").unwrap();
    assert!(!scene.has_light());
    for flag in ["--sky", "--sun", "--point", "--emit"] {
        assert!(scene.no_light_message().contains(flag));
    }
}

#[test]
fn surfaces_of_low_opacity_leave_the_scene_and_are_listed() {
    let mtl = "newmtl a\nd 0.4\nnewmtl b\nTr 0.6\nnewmtl c\nd 0.6\nnewmtl lit\nd 0.1\nKe 1 1 1\n";
    let mut text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n".to_string();
    for (material, face) in [("a", "1 2 3"), ("b", "1 2 4"), ("c", "1 3 4"), ("lit", "2 3 4")] {
        text += &format!("usemtl {material}\nf {face}\n");
    }
    let dir = folder(&[("s.obj", &text), ("m.mtl", mtl)]);
    let scene = open(&dir, "s.obj").unwrap();
    assert_eq!(scene.triangles.len(), 2);
    assert_eq!(scene.dropped.transparent, [("a".to_string(), 1), ("b".to_string(), 1)]);
    assert!(scene.warnings.iter().any(|w| w.contains("\"a\" (1 triangles)") && w.contains("\"b\"")));
}

#[test]
fn mtl_rules_for_albedo() {
    let mtl = "newmtl none\nnewmtl mirror\nKd 0.1 0.1 0.1\nKs 0.6 0.6 0.6\nillum 3\nnewmtl gloss\nKd 0.1 0.1 0.1\nKs 0.6 0.6 0.6\nillum 2\nnewmtl tex\nKd 0.25 0.25 0.25\nmap_Kd no such.png\n";
    let mut text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n".to_string();
    for (material, face) in [("none", "1 2 3"), ("mirror", "1 2 4"), ("gloss", "1 3 4"), ("tex", "2 3 4")] {
        text += &format!("usemtl {material}\nf {face}\n");
    }
    let dir = folder(&[("s.obj", &text), ("m.mtl", mtl)]);
    let scene = open(&dir, "s.obj").unwrap();
    let albedo: Vec<f32> = (0..4).map(|t| scene.albedo(t, 0.3, 0.3).x).collect();
    assert!(albedo.iter().zip([0.5, 0.7, 0.1, 0.25]).all(|(a, b)| (a - b).abs() < 1e-6), "{albedo:?}");
    assert!(scene.warnings.iter().any(|w| w.contains("no such.png")));
}

#[test]
fn textures_are_srgb_and_start_at_the_bottom_in_obj() {
    let dir = folder(&[
        (
            "s.obj",
            "mtllib m.mtl\nusemtl t\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n",
        ),
        ("m.mtl", "newmtl t\nKd 0.5 0.5 0.5\nmap_Kd t.png\n"),
    ]);
    // Top row 255, bottom row 128: linear 1 and 0.2158605 (IEC 61966-2-1).
    image::GrayImage::from_raw(1, 2, vec![255, 128]).unwrap().save(dir.path().join("t.png")).unwrap();
    let scene = open(&dir, "s.obj").unwrap();
    // The first triangle's second corner is (1, 0), its third (1, 1).
    assert!((scene.albedo(0, 0.9, 0.05).x - 0.5 * 0.2158605).abs() < 1e-5);
    assert!((scene.albedo(0, 0.05, 0.9).x - 0.5).abs() < 1e-5);
}

#[test]
fn vertex_colours_multiply_the_albedo() {
    let dir = folder(&[("s.obj", "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n")]);
    let scene = open(&dir, "s.obj").unwrap();
    let albedo = scene.albedo(0, 0.5, 0.25);
    assert!((albedo - 0.5 * Vec3::new(0.25, 0.5, 0.25)).length() < 1e-6, "{albedo}");
}

#[test]
fn normals_stand_on_the_side_of_the_winding() {
    let text =
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 5\nvn 0 0 -1\nvn 0.1 0 2\nvn 0 0 0\nf 1//1 2//1 3//1\nf 1//2 2//3 3//2\n";
    let dir = folder(&[("s.obj", &text.replace("f 1//2 2//3 3//2", "f 1//2 3//3 4//2"))]);
    let scene = open(&dir, "s.obj").unwrap();
    for (t, normals) in scene.corners.normals.iter().enumerate() {
        for n in normals {
            assert!((n.length() - 1.0).abs() < 1e-6 && n.dot(scene.normal(t)) > 0.0, "{t}: {n}");
        }
    }
}

#[test]
fn scene_files_place_meshes_and_lights() {
    let toml = r#"
        [[mesh]]
        path = "cube.obj"
        scale = [2, 1, -1]
        rotate = { axis = [0, 0, 1], angle = 90 }
        translate = [10, 0, 0]
        material = "wall"
        [material.wall]
        albedo = [0.2, 0.3, 0.4]
        [[light]]
        type = "point"
        position = [9.5, 1, -0.5]
        power = [12.566370614359172, 0, 0]
        [[light]]
        type = "sun"
        direction = [0, -2, 0]
        irradiance = [1, 1, 1]
        [camera]
        position = [0, 0, 5]
        target = [0, 0, 0]
        fov = 40
        [bake]
        grid = 24
        reconstruct = "nearest4"
        seed = 7
    "#;
    let dir = folder(&[("s.toml", toml), ("cube.obj", &cube("cube", [0.0; 3], [1.0; 3]))]);
    let (scene, settings) = load(&dir.path().join("s.toml"), &SceneOverrides::default()).unwrap();
    let check = SceneCheck::new(&scene);
    // Scaled to 2 x 1 x -1, turned so that +x becomes +y, then moved.
    for (found, expected) in check.low.iter().chain(&check.high).zip([9.0, 0.0, -1.0, 10.0, 2.0, 0.0]) {
        assert!((found - expected).abs() < 1e-6, "{:?} {:?}", check.low, check.high);
    }
    assert_eq!(scene.albedo(0, 0.0, 0.0), Vec3::new(0.2, 0.3, 0.4));
    assert_eq!(scene.sides[0].kind, SideKind::Room, "the point is inside");
    assert_eq!(scene.sides[0].turned, 12, "the mirrored cube's normals point outwards as before");
    let Light::Point { intensity, .. } = scene.lights[0] else { panic!() };
    assert!((intensity.x * scene.frame.scale.powi(2) as f32 - 1.0).abs() < 1e-6, "4 pi W are 1 W/sr");
    assert!(matches!(scene.lights[1], Light::Sun { direction, .. } if direction == Vec3::NEG_Y));
    assert_eq!(scene.camera.unwrap().up, DVec3::Y);
    let mut options = BakeOptions::default();
    settings.apply(&mut options);
    assert_eq!(options.resolution, Resolution::Grid(24));
    assert_eq!((options.reconstruct, options.seed), (Reconstruct::Nearest4, 7));
    assert_eq!(options.rays, BakeOptions::default().rays);
}

#[test]
fn scene_files_name_what_is_wrong() {
    let cube = cube("cube", [0.0; 3], [1.0; 3]);
    for (text, words) in [
        ("[[mesh]]\npath = \"cube.obj\"\nscael = 2\n", vec!["line 3", "scael"]),
        ("[[mesh]]\npath = \"cube.obj\"\n[bake]\ngridd = 2\n", vec!["line 4", "gridd"]),
        ("[[mesh]]\npath = \"cube.obj\"\n[bake]\ngrid = 2\nvoxel = 0.1\n", vec!["grid and voxel"]),
        ("[[light]]\ntype = \"lava\"\n", vec!["lava"]),
        ("[[light]]\ntype = \"sky\"\nradiance = [1, 1, 1]\ncolour = 2\n", vec!["colour"]),
        ("[[light]]\ntype = \"sky\"\nradiance = [-1, 1, 1]\n", vec!["[[light]] 1", "radiance"]),
        ("[[mesh]]\npath = \"no.obj\"\n", vec!["no.obj"]),
        ("[[mesh]]\npath = \"cube.obj\"\nmaterial = \"x\"\n", vec!["[[mesh]] 1", "material.x"]),
        ("[[mesh]]\npath = \"cube.obj\"\n[material.y]\nalbedo = [0, 0, 0]\n", vec!["material.y", "\"default\""]),
        ("[[mesh]]\npath = \"cube.obj\"\nrotate = { axis = [0, 0, 0], angle = 3 }\n", vec!["rotate.axis"]),
        ("[camera]\nposition = [0, 0, 0]\ntarget = [0, 1, 0]\nfov = 40\n", vec!["[camera]", "up"]),
        ("[[mesh]]\npath = \"s.toml\"\n", vec![".toml"]),
    ] {
        let dir = folder(&[("s.toml", text), ("cube.obj", &cube)]);
        let message = message(&dir, "s.toml");
        assert!(words.iter().all(|w| message.contains(w)), "{text}: {message}");
    }
}

#[test]
fn environments_are_read_from_exr() {
    let dir = folder(&[
        (
            "s.toml",
            "[[mesh]]\npath = \"cube.obj\"\n[[light]]\ntype = \"environment\"\nfile = \"sky.exr\"\nstrength = 2\n",
        ),
        ("cube.obj", &cube("cube", [0.0; 3], [1.0; 3])),
    ]);
    exr::prelude::write_rgb_file(dir.path().join("sky.exr"), 4, 2, |x, y| (x as f32, y as f32, f32::NAN)).unwrap();
    let scene = open(&dir, "s.toml").unwrap();
    let Light::Environment(e) = &scene.lights[0] else { panic!() };
    assert_eq!((e.width, e.height, e.up), (4, 2, Vec3::Y));
    assert_eq!(e.texels[4 + 3], Vec3::new(6.0, 2.0, 0.0));
}

#[test]
fn builders_refuse_meshes_that_do_not_fit_together() {
    let good = RawMesh { positions: vec![DVec3::ZERO; 3], triangles: vec![[0, 1, 2]], ..RawMesh::default() };
    let build = |mesh: RawMesh, materials: Vec<Material>| {
        let mut builder = Builder::new("x");
        builder.add_mesh(mesh);
        for surface in materials {
            builder.add_material(RawMaterial { surface, ..RawMaterial::default() });
        }
        builder.build(SidesRule::Auto).unwrap_err().to_string()
    };
    let plain = vec![Material::default()];
    assert!(build(good.clone(), vec![]).contains("add_material"));
    assert!(build(RawMesh { triangles: vec![[0, 1, 3]], ..good.clone() }, plain.clone()).contains("vertex"));
    assert!(build(RawMesh { uvs: vec![glam::Vec2::ZERO], ..good.clone() }, plain.clone()).contains("uvs"));
    assert!(build(RawMesh { places: vec![1, 2], ..good.clone() }, plain.clone()).contains("places"));
    let textured = Material { albedo_texture: Some(3), ..Material::default() };
    assert!(build(good.clone(), vec![textured]).contains("add_texture"));
    assert!(build(good, plain).contains("1 without area"));
}

#[test]
fn loading_is_deterministic() {
    let dir = folder(&[(
        "s.obj",
        &format!("{}{}", cube("a", [0.0; 3], [1.0; 3]), cube("b", [1.0, 0.0, 0.0], [2.0, 1.0, 1.0])),
    )]);
    let (one, two) = (open(&dir, "s.obj").unwrap(), open(&dir, "s.obj").unwrap());
    assert_eq!((one.positions, one.triangles, one.sides), (two.positions, two.triangles, two.sides));
}

/// Opaque triangles with an area, by PROVENANCE.md of each scene less what it calls degenerate or duplicate.
#[test]
fn real_scenes_load_with_the_triangles_that_their_provenance_counts() {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes");
    if !root.is_dir() {
        println!("skipped: {} is not there", root.display());
        return;
    }
    for (file, triangles) in [
        ("cornell_mcguire/CornellBox-Original.obj", 36 - 4),
        ("cornell_mcguire/CornellBox-Sphere.obj", 2188),
        ("cornell_mcguire/CornellBox-Glossy.obj", 1112),
        ("cornell_mcguire/CornellBox-Empty-RG.obj", 12),
        ("cornell_tobj/cornell_box.obj", 36),
        ("cornell_bevy/CornellBox.glb", 36),
        ("cornell_bevy/IrradianceVolumeExample.glb", 32),
        ("gazebo/gazebo_ands.obj", 730),
        ("gazebo/gazebo_xatlas.obj", 730),
        ("godot_room/room.glb", 63720),
        ("godot_room/level_mesh.obj", 138),
        ("playcanvas_vr_gallery/vr-gallery.glb", 1930),
        ("mori_knob/testObj.obj", 11970),
        ("ignis_room/Room.obj", 28),
        ("ignis_room/CubeInCube.obj", 88),
        ("utah_teapot/teapot.obj", 15704),
        // 224998 less the leaves that coincide, as quadrilaterals cut along either diagonal.
        ("lost_empire/lost_empire.obj", 224998 - 15240),
    ] {
        let scene = load(&root.join(file), &SceneOverrides::default()).unwrap().0;
        assert_eq!(scene.triangles.len(), triangles, "{file}");
        assert!(world_area(&scene) > 0.0);
    }
    // Here definitions of "degenerate" differ: what is read is what is kept or dropped.
    for (file, read) in [
        ("castle/castle.obj", 1239),
        ("map_pandora/pandora.obj", 60810),
        ("godot_living_room/living_room.glb", 5088),
        ("playcanvas_house/house.glb", 10497),
        ("veach_ajar/veach_ajar.obj", 4546),
    ] {
        let scene = load(&root.join(file), &SceneOverrides::default()).unwrap().0;
        let d = &scene.dropped;
        let transparent: usize = d.transparent.iter().map(|t| t.1).sum();
        assert_eq!(scene.triangles.len() + d.zero_area + d.duplicate + transparent + d.not_finite, read, "{file}");
    }
}

#[test]
fn an_unlit_gallery_is_no_lamp() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/scenes/playcanvas_vr_gallery/vr-gallery.glb");
    if !file.is_file() {
        println!("skipped: {} is not there", file.display());
        return;
    }
    let scene = load(&file, &SceneOverrides::default()).unwrap().0;
    assert!(!scene.has_light());
    assert!(scene.warnings.iter().any(|w| w.contains("KHR_materials_unlit")));
}
