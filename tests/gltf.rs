//! glTF: attributes, materials, lights, and files that are damaged at random.

use glam::{DVec3, Vec3};
use luxel::{
    Scene,
    scene::{Light, SceneOverrides, load},
};
use proptest::prelude::*;
use serde_json::{Value, json};
use tempfile::TempDir;

/// A square in the plane z = 0 with colours, texture coordinates and indices of several types:
/// bytes 0 .. 48 positions (f32), 48 .. 64 uv (u16 normalised), 64 .. 80 colours (u8 normalised, RGBA),
/// 80 .. 86 indices (u8), 88 .. 92 sparse indices (u16, one), 92 .. 104 sparse value.
fn square_bytes() -> Vec<u8> {
    let mut bytes = Vec::new();
    for p in [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0_f32]] {
        p.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    for uv in [[0, 65535], [65535, 65535], [65535, 0], [0, 0_u16]] {
        uv.iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    }
    bytes.extend([[255, 0, 0, 255], [255, 0, 0, 255], [255, 0, 0, 255], [255, 0, 0, 255_u8]].concat());
    bytes.extend([0, 1, 2, 0, 2, 3, 0, 0, 2, 0, 0, 0]);
    [1.0, 3.0, 0.0_f32].iter().for_each(|x| bytes.extend(x.to_le_bytes()));
    bytes
}

fn square() -> Value {
    let bytes = square_bytes();
    json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "square" }],
        "meshes": [{ "primitives": [{
            "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 3, "material": 0
        }] }],
        "materials": [{ "name": "m", "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.25, 0.125, 1.0], "metallicFactor": 1.0 } }],
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0] },
            { "bufferView": 1, "componentType": 5123, "count": 4, "type": "VEC2", "normalized": true },
            { "bufferView": 2, "componentType": 5121, "count": 4, "type": "VEC4", "normalized": true },
            { "bufferView": 3, "componentType": 5121, "count": 6, "type": "SCALAR" }
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 16 },
            { "buffer": 0, "byteOffset": 64, "byteLength": 16 },
            { "buffer": 0, "byteOffset": 80, "byteLength": 6 },
            { "buffer": 0, "byteOffset": 88, "byteLength": 2 },
            { "buffer": 0, "byteOffset": 92, "byteLength": 12 }
        ],
        "buffers": [{ "uri": "b%20b.bin", "byteLength": bytes.len() }]
    })
}

fn store(text: &[u8], bytes: &[u8]) -> TempDir {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("s.gltf"), text).unwrap();
    std::fs::write(dir.path().join("b b.bin"), bytes).unwrap();
    dir
}

fn open(document: &Value) -> luxel::Result<Scene> {
    let dir = store(document.to_string().as_bytes(), &square_bytes());
    load(&dir.path().join("s.gltf"), &SceneOverrides::default()).map(|s| s.0)
}

fn area(scene: &Scene) -> f64 {
    (0..scene.triangles.len()).map(|t| scene.area(t)).sum::<f64>() * scene.frame.scale.powi(2)
}

#[test]
fn metals_are_diffuse_and_vertex_colours_multiply() {
    let mut document = square();
    let scene = open(&document).unwrap();
    assert_eq!((scene.triangles.len(), area(&scene)), (2, 1.0));
    assert_eq!(scene.albedo(0, 0.3, 0.3), Vec3::new(0.5, 0.25, 0.125));
    document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(2);
    assert_eq!(open(&document).unwrap().albedo(0, 0.3, 0.3), Vec3::new(0.5, 0.0, 0.0));
}

#[test]
fn textures_start_at_the_top_and_can_be_moved() {
    let mut document = square();
    document["images"] = json!([{ "uri": "t.png" }]);
    document["textures"] = json!([{ "source": 0 }]);
    document["materials"][0]["pbrMetallicRoughness"] = json!({ "baseColorTexture": { "index": 0 } });
    let sample = |document: &Value| {
        let dir = store(document.to_string().as_bytes(), &square_bytes());
        image::GrayImage::from_raw(1, 2, vec![0, 255]).unwrap().save(dir.path().join("t.png")).unwrap();
        let scene = load(&dir.path().join("s.gltf"), &SceneOverrides::default()).unwrap().0;
        // The first triangle's second corner is (1, 0) with v = 1, its third (1, 1) with v = 0.
        [scene.albedo(0, 0.9, 0.05).x, scene.albedo(0, 0.05, 0.9).x]
    };
    assert_eq!(sample(&document), [0.9999, 0.0]);
    let half = json!({ "KHR_texture_transform": { "offset": [0.0, 0.5] } });
    document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = half;
    assert_eq!(sample(&document), [0.0, 0.9999]);
}

#[test]
fn emission_is_multiplied_by_its_strength_and_both_sides_emit_if_asked() {
    let mut document = square();
    document["materials"][0]["emissiveFactor"] = json!([1.0, 0.5, 0.0]);
    document["materials"][0]["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": 8.0 } });
    let scene = open(&document).unwrap();
    assert_eq!(scene.emission(0), Vec3::new(8.0, 4.0, 0.0));
    assert!(scene.triangles.iter().all(|t| t.two_sided && !t.emits_back));
    document["materials"][0]["doubleSided"] = json!(true);
    assert!(open(&document).unwrap().triangles.iter().all(|t| t.two_sided && t.emits_back));
    document["materials"][0]["extensions"] = json!({ "KHR_materials_unlit": {} });
    let scene = open(&document).unwrap();
    assert!(!scene.has_light() && scene.warnings[0].contains("KHR_materials_unlit"));
}

#[test]
fn transparent_materials_leave_the_scene() {
    for (material, stays) in [
        (json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, 0.4] } }), false),
        (json!({ "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, 0.6] } }), true),
        (json!({ "alphaMode": "OPAQUE", "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, 0.4] } }), true),
        (json!({ "alphaMode": "MASK", "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, 0.4] } }), false),
        (
            json!({ "alphaMode": "MASK", "alphaCutoff": 0.3, "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 1, 0.4] } }),
            true,
        ),
        (json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.6 } } }), false),
        (json!({ "extensions": { "KHR_materials_transmission": { "transmissionFactor": 0.4 } } }), true),
    ] {
        let mut document = square();
        document["materials"][0] = material.clone();
        match open(&document) {
            Ok(scene) => assert!(stays && scene.triangles.len() == 2, "{material}"),
            Err(e) => assert!(!stays && e.to_string().contains("2 transparent"), "{material}: {e}"),
        }
    }
}

#[test]
fn lights_and_cameras_stand_where_their_nodes_do() {
    let mut document = square();
    document["extensionsUsed"] = json!(["KHR_lights_punctual"]);
    document["extensions"] = json!({ "KHR_lights_punctual": { "lights": [
        { "type": "spot", "color": [1, 0.5, 0], "intensity": 4, "range": 10, "spot": { "innerConeAngle": 0.0, "outerConeAngle": 0.5 } },
        { "type": "directional", "intensity": 2 }
    ] } });
    document["cameras"] = json!([{ "type": "perspective", "perspective": { "yfov": 0.5, "znear": 0.1 } }]);
    let half = std::f64::consts::FRAC_1_SQRT_2;
    document["nodes"] = json!([
        { "mesh": 0, "children": [1, 2, 3] },
        { "translation": [1, 2, 3], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
        { "rotation": [-half, 0, 0, half], "extensions": { "KHR_lights_punctual": { "light": 1 } } },
        { "translation": [0, 0, 9], "camera": 0 }
    ]);
    let scene = open(&document).unwrap();
    let Light::Spot { position, direction, intensity, cos_inner, cos_outer, .. } = &scene.lights[0] else { panic!() };
    assert!((scene.frame.to_world(*position) - DVec3::new(1.0, 2.0, 3.0)).length() < 1e-6);
    assert_eq!((*direction, *intensity), (Vec3::NEG_Z, Vec3::new(4.0, 2.0, 0.0)));
    assert_eq!((*cos_inner, *cos_outer), (1.0, 0.5_f32.cos()));
    let Light::Sun { direction, irradiance } = &scene.lights[1] else { panic!() };
    // Turned by -90 degrees about x, -z becomes -y.
    assert!((*direction - Vec3::NEG_Y).length() < 1e-6 && *irradiance == Vec3::splat(2.0));
    let camera = scene.camera.unwrap();
    assert_eq!((camera.position, camera.target), (DVec3::new(0.0, 0.0, 9.0), DVec3::new(0.0, 0.0, 8.0)));
    assert!((camera.vertical_fov - 0.5_f64.to_degrees()).abs() < 1e-6);
}

#[test]
fn sparse_accessors_replace_their_elements() {
    let mut document = square();
    document["accessors"][0]["sparse"] = json!({
        "count": 1,
        "indices": { "bufferView": 4, "componentType": 5123 },
        "values": { "bufferView": 5 }
    });
    // Corner 2 moves from (1, 1) to (1, 3): 2 triangles of area 1.5 and 0.5.
    let scene = open(&document).unwrap();
    assert!((area(&scene) - 2.0).abs() < 1e-6);
    document["accessors"][0]["sparse"]["count"] = json!(2);
    assert!(open(&document).unwrap_err().to_string().contains("accessor 0"));
}

#[test]
fn broken_references_are_errors() {
    for (pointer, value, word) in [
        ("/accessors/0/count", json!(5), "accessor 0"),
        ("/accessors/0/byteOffset", json!(u32::MAX), "accessor 0"),
        ("/accessors/1/count", json!(3), "TEXCOORD"),
        ("/bufferViews/0/byteStride", json!(100), "accessor 0"),
        ("/buffers/0/byteLength", json!(4_000_000_000_u64), "buffer 0"),
        ("/buffers/0/uri", json!("%2e%2e/b.bin"), "outside"),
        ("/buffers/0/uri", json!("http://x/b.bin"), "not a file"),
        ("/nodes/0/mesh", json!(7), "mesh"),
        ("/scenes/0/nodes/0", json!(7), "nodes"),
        ("/meshes/0/primitives/0/indices", json!(9), "indices"),
        ("/meshes/0/primitives/0/indices", json!(0), "indices of type F32"),
        ("/meshes/0/primitives/0/attributes/TEXCOORD_0", json!(99), "accessor 99"),
        ("/meshes/0/primitives/0/material", json!(3), "material"),
        ("/extensionsRequired", json!(["EXT_meshopt_compression"]), "EXT_meshopt_compression"),
    ] {
        let mut document = square();
        match document.pointer_mut(pointer) {
            Some(slot) => *slot = value,
            None => {
                let (parent, key) = pointer.rsplit_once('/').unwrap();
                let parent = if parent.is_empty() { &mut document } else { document.pointer_mut(parent).unwrap() };
                parent[key] = value;
            }
        }
        // Texture coordinates are only read where a texture is.
        document["images"] = json!([{ "uri": "b b.bin" }]);
        document["textures"] = json!([{ "source": 0 }]);
        if word == "TEXCOORD" {
            document["materials"][0]["emissiveFactor"] = json!([1, 1, 1]);
            document["images"][0]["uri"] = json!(PIXEL);
            document["materials"][0]["emissiveTexture"] = json!({ "index": 0 });
        }
        let error = open(&document).expect_err(pointer).to_string();
        assert!(error.contains(word), "{pointer}: {error}");
    }
}

/// A PNG of one white pixel.
const PIXEL: &str = "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAQAAAC1HAwCAAAAC0lEQVR42mP8/x8AAwMCAO+ip1sAAAAASUVORK5CYII=";

#[test]
fn nodes_with_two_parents_are_refused() {
    let mut document = square();
    document["nodes"] = json!([{ "children": [1, 2] }, { "children": [2] }, { "mesh": 0 }]);
    assert!(open(&document).unwrap_err().to_string().contains("node 2"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Whatever is done to a file, loading ends with a scene or an error.
    #[test]
    fn damaged_gltf_never_panics(edits in prop::collection::vec((any::<prop::sample::Index>(), prop::sample::select(b"0123456789-e.[]{}\",:x".to_vec())), 1..4), cut in any::<prop::sample::Index>(), whole in any::<bool>()) {
        let mut document = square();
        document["materials"][0]["alphaMode"] = json!("MASK");
        let mut text = document.to_string().into_bytes();
        for (at, byte) in edits {
            let at = at.index(text.len());
            text[at] = byte;
        }
        let mut bytes = square_bytes();
        if !whole {
            bytes.truncate(cut.index(bytes.len()));
        }
        let dir = store(&text, &bytes);
        let _ = load(&dir.path().join("s.gltf"), &SceneOverrides::default());
    }

    #[test]
    fn damaged_glb_never_panics(edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..4), cut in any::<prop::sample::Index>()) {
        let mut document = square();
        document["buffers"] = json!([{ "byteLength": 104 }]);
        let mut json = document.to_string().into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let bin = square_bytes();
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        glb.extend(((12 + 8 + json.len() + 8 + bin.len()) as u32).to_le_bytes());
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(&json);
        glb.extend((bin.len() as u32).to_le_bytes());
        glb.extend(b"BIN\0");
        glb.extend(&bin);
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.glb");
        std::fs::write(&path, &glb).unwrap();
        prop_assert!(load(&path, &SceneOverrides::default()).is_ok());
        for (at, byte) in edits {
            // The header and chunk heads are where lengths stand.
            let at = at.index(24);
            glb[at] = byte;
        }
        glb.truncate(1 + cut.index(glb.len()));
        std::fs::write(&path, &glb).unwrap();
        let _ = load(&path, &SceneOverrides::default());
    }

    #[test]
    fn damaged_obj_never_panics(lines in prop::collection::vec("(v|vt|vn|f|usemtl|mtllib|o|g|#|)( (-?[0-9]{1,3}(\\.[0-9])?|nan|inf|1e3[0-9]{1,2}|[0-9]/[0-9]|[0-9]//[0-9]|-[0-9]/-[0-9]/-[0-9]|\\\\))*", 0..30)) {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.obj");
        std::fs::write(&path, lines.join("\n")).unwrap();
        let _ = load(&path, &SceneOverrides::default());
    }

    #[test]
    fn any_triangles_of_valid_vertices_become_a_sound_scene(
        vertices in prop::collection::vec((-3..3, -3..3, -3..3, any::<bool>()), 3..12),
        faces in prop::collection::vec(prop::collection::vec(any::<prop::sample::Index>(), 3..7), 1..30),
        power in -30..30,
    ) {
        let mut text = String::new();
        let scale = 10.0_f64.powi(power);
        for (x, y, z, bad) in &vertices {
            let x = if *bad && vertices.len() > 8 { "nan".to_string() } else { format!("{}", f64::from(*x) * scale) };
            text += &format!("v {x} {} {}\n", f64::from(*y) * scale, f64::from(*z) * scale);
        }
        for face in &faces {
            let corners: Vec<String> = face.iter().map(|i| (1 + i.index(vertices.len())).to_string()).collect();
            text += &format!("f {}\n", corners.join(" "));
        }
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("s.obj");
        std::fs::write(&path, text).unwrap();
        if let Ok((scene, _)) = load(&path, &SceneOverrides::default()) {
            prop_assert!(!scene.triangles.is_empty());
            prop_assert!(scene.positions.iter().all(|p| p.is_finite() && p.abs().max_element() <= 0.5));
            for t in 0..scene.triangles.len() {
                prop_assert!(scene.area(t) > 0.0 && scene.normal(t).is_normalized());
            }
            prop_assert_eq!(scene.sides.iter().map(|s| s.triangles).sum::<usize>(), scene.triangles.len());
        }
    }
}
