//! Every file of the collection of bad files gets what its index asks for: an error that says where and why, or a scene
//! without the bad parts and a warning, or the whole scene; never a panic, and never long.

use std::{path::PathBuf, sync::mpsc, time::Duration};

use luxel::scene::{Scene, SceneOverrides, SideKind, load};

/// What must come of a file.
enum Expect {
    /// An error whose message holds all these words.
    Error(&'static [&'static str]),
    /// This many triangles, this area (relative tolerance 1e-6), a warning with each of these words, and no further ones.
    Scene(usize, f64, &'static [&'static str]),
}
use Expect::{Error, Scene as Loads};

const GREY: &str = "materials that no library defines are grey";
const NO_GEOMETRY: &str = "no geometry";

const FILES: [(&str, Expect); 60] = [
    ("invalid-face-definition.obj", Error(&[NO_GEOMETRY, "2 faces with fewer than 3 corners"])),
    ("invalid-relative-vertex-index.obj", Error(&["line 1", "\"-4\""])),
    ("issue-140-zero-face-idx.obj", Error(&["line 16", "\"0\""])),
    ("issue-295-trianguation-failure.obj", Loads(28, 14.0, &[GREY])),
    ("missing_material_file.obj", Loads(36, 1989605.2045, &[GREY])),
    ("test-nan.obj", Error(&["line 14", "1.#"])),
    ("malformed.obj", Error(&["line 23", "\"12\""])),
    ("empty_0_bytes.obj", Error(&[NO_GEOMETRY])),
    ("box_without_lineending.obj", Loads(12, 6.0, &[GREY])),
    ("box_longline.obj", Loads(12, 6.0, &[GREY, "visit a corner more than once", "winding was inconsistent"])),
    ("number_formats.obj", Error(&["line 11", "3.1+e2"])),
    ("negative_indices.obj", Loads(12, 24.0, &[GREY])),
    ("notenoughindices.obj", Loads(1, 250000.0, &[GREY, "surface.mtl", "1 faces with fewer than 3 corners"])),
    // The index asks to drop the triangle and count it; nothing is left then.
    ("zero_area_face.obj", Error(&[NO_GEOMETRY, "1 without area"])),
    ("degenerate_edge.obj", Loads(1, 2.0, &[GREY, "1 triangles without area"])),
    ("moebius.obj", Loads(448, 1335.60621, &[GREY, "no consistent winding"])),
    ("fan3.obj", Loads(3, 25.9533005, &[GREY])),
    ("truncated_chunk_data.glb", Error(&["truncated"])),
    ("invalid_magic.glb", Error(&["not a GLB"])),
    ("buffer_not_found.gltf", Error(&["buffer 0", "not_found.bin"])),
    ("unresolved_positions.gltf", Error(&["mesh 0, primitive 0", "accessor 0"])),
    ("IndexOutOfRange.gltf", Error(&["mesh 0", "index 255"])),
    ("RecursiveNodes.gltf", Error(&["node 0"])),
    ("BoxWithInfinites.glb", Error(&[NO_GEOMETRY, "12 not finite"])),
    ("badNumber.gltf", Error(&["expected f32", "line 132"])),
    ("Mesh_PrimitiveMode_04.gltf", Loads(2, 1.0, &["without a material"])),
    ("gen_nan_vertex.obj", Loads(9, 54.0, &["5 triangles with a corner that is not finite"])),
    ("gen_huge_1e30.obj", Loads(14, 95e60, &[])),
    ("gen_tiny_1e-8.obj", Loads(14, 95e-16, &[])),
    ("gen_far_from_origin.obj", Loads(14, 95.0, &[])),
    ("gen_index_u64_overflow.obj", Error(&["line 35", "99999999999999999999"])),
    ("gen_two_vertex_face.obj", Loads(14, 95.0, &["2 faces with fewer than 3 corners"])),
    ("gen_all_degenerate.obj", Error(&[NO_GEOMETRY, "3 without area"])),
    ("gen_coincident_walls.obj", Loads(14, 95.0, &["4 triangles coincide"])),
    ("gen_inverted_room.obj", Loads(14, 95.0, &["wound inside out", "glowing surfaces faced away"])),
    ("gen_mixed_winding.obj", Loads(14, 95.0, &["winding was inconsistent"])),
    ("gen_open_room.obj", Loads(12, 83.0, &[])),
    ("gen_intersecting_boxes.obj", Loads(38, 122.0, &[])),
    ("gen_concave_L.obj", Loads(18, 97.0, &[])),
    ("gen_ngon_2000.obj", Loads(2012, 98.1415875, &[])),
    ("gen_crlf_bom.obj", Loads(14, 95.0, &[])),
    ("gen_backslash_continuation.obj", Loads(14, 95.0, &[])),
    ("gen_decimal_comma.obj", Error(&["line 10", "1,5"])),
    ("gen_path_traversal.obj", Loads(14, 95.0, &[GREY, "outside the scene's folder", "wound inside out"])),
    ("gen_bad_mtl_values.obj", Loads(14, 95.0, &["defined again", "emission that is negative or not finite"])),
    ("gen_white_furnace_kd1.obj", Loads(14, 95.0, &["albedo above"])),
    ("gen_nan_uv.obj", Loads(14, 95.0, &[])),
    ("gen_no_light.obj", Loads(12, 94.0, &["wound inside out"])),
    ("gen_count_4e9.gltf", Error(&["accessor 0", "4000000000"])),
    ("gen_bufferview_oob.gltf", Error(&["bufferView 1"])),
    ("gen_bad_base64.gltf", Error(&["buffer 0", "base64"])),
    ("gen_uri_traversal.gltf", Error(&["buffer 0", "outside the scene's folder"])),
    ("gen_zero_scale.gltf", Loads(2, 15.0, &["10 triangles without area", "2 triangles coincide"])),
    ("gen_deep_nodes_5000.gltf", Loads(14, 95.0, &[])),
    ("gen_draco_required.gltf", Error(&["KHR_draco_mesh_compression"])),
    ("gen_nan_position.gltf", Loads(9, 54.0, &["5 triangles with a corner that is not finite"])),
    ("gen_no_scene_no_materials.gltf", Loads(14, 95.0, &["without a material", "wound inside out"])),
    ("gen_negative_scale.gltf", Loads(14, 95.0, &[])),
    ("gen_cycle_with_mesh.gltf", Error(&["node 0"])),
    ("gen_missing_texture.gltf", Loads(14, 95.0, &["no_such_texture.png"])),
];

fn folder() -> Option<PathBuf> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/bad");
    if !folder.is_dir() {
        println!("skipped: {} is not there", folder.display());
        return None;
    }
    Some(folder)
}

/// Loads on a thread of its own, so that a hang or a panic is a message.
fn load_in_time(path: PathBuf) -> Result<luxel::Result<Scene>, &'static str> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        // Nobody listens any more once the time is over.
        let _ = sender.send(load(&path, &SceneOverrides::default()).map(|s| s.0));
    });
    receiver.recv_timeout(Duration::from_secs(5)).map_err(|e| match e {
        mpsc::RecvTimeoutError::Timeout => "it takes longer than 5 s",
        mpsc::RecvTimeoutError::Disconnected => "it panics",
    })
}

fn judge(result: luxel::Result<Scene>, expect: &Expect) -> Result<(), String> {
    match (result, expect) {
        (Err(error), Error(words)) => {
            let message = error.to_string();
            match words.iter().find(|w| !message.contains(**w)) {
                Some(word) => Err(format!("\"{message}\" lacks \"{word}\"")),
                None => Ok(()),
            }
        }
        (Ok(scene), Loads(triangles, area, words)) => {
            let found = (0..scene.triangles.len()).map(|t| scene.area(t)).sum::<f64>() * scene.frame.scale.powi(2);
            if scene.triangles.len() != *triangles || ((found - area) / area).abs() > 1e-6 {
                return Err(format!("{} triangles of area {found}", scene.triangles.len()));
            }
            if let Some(word) = words.iter().find(|w| !scene.warnings.iter().any(|m| m.contains(**w))) {
                return Err(format!("{:?} lacks \"{word}\"", scene.warnings));
            }
            match scene.warnings.iter().find(|m| !words.iter().any(|w| m.contains(w))) {
                Some(warning) => Err(format!("unexpected: {warning}")),
                None => Ok(()),
            }
        }
        (Err(error), Loads(..)) => Err(format!("refused: {error}")),
        (Ok(_), Error(_)) => Err("loaded".into()),
    }
}

#[test]
fn every_bad_file_gets_what_its_index_asks_for() {
    let Some(folder) = folder() else { return };
    let mut failures = Vec::new();
    for (file, expect) in &FILES {
        let verdict = load_in_time(folder.join(file)).map_err(str::to_string).and_then(|r| judge(r, expect));
        if let Err(why) = verdict {
            failures.push(format!("{file}: {why}"));
        }
    }
    assert!(failures.is_empty(), "{} of {}:\n{}", failures.len(), FILES.len(), failures.join("\n"));
}

#[test]
fn the_table_covers_the_index() {
    let Some(folder) = folder() else { return };
    let text = std::fs::read_to_string(folder.join("index.json")).unwrap();
    let index: Vec<serde_json::Value> = serde_json::from_str(&text).unwrap();
    assert_eq!(index.len(), FILES.len());
    for entry in index {
        let name = entry["file"].as_str().unwrap();
        let (_, expect) = FILES.iter().find(|f| f.0 == name).unwrap_or_else(|| panic!("{name} is not tested"));
        let allowed = entry["expect"].as_str().unwrap();
        let fits = match expect {
            // The one file where nothing is left after cleaning.
            Error(_) => allowed.contains("ERROR") || name == "zero_area_face.obj",
            Loads(..) => allowed.contains("OK") || allowed.contains("CLEAN"),
        };
        assert!(fits, "{name}: the index allows {allowed}");
        if let (Loads(_, _, words), "CLEAN") = (expect, allowed)
            && words.is_empty()
        {
            // Bad texture coordinates and far positions leave nothing to drop.
            assert!(["gen_nan_uv.obj", "gen_far_from_origin.obj"].contains(&name), "{name} must warn");
        }
    }
}

/// The normals of the generated rooms point inwards, whatever the file's winding and transforms are.
#[test]
fn rooms_are_seen_from_inside_however_they_are_wound() {
    let Some(folder) = folder() else { return };
    for name in [
        "gen_inverted_room.obj",
        "gen_mixed_winding.obj",
        "gen_negative_scale.gltf",
        "gen_crlf_bom.obj",
        "gen_tiny_1e-8.obj",
        "gen_huge_1e30.obj",
        "gen_far_from_origin.obj",
    ] {
        let scene = load(&folder.join(name), &SceneOverrides::default()).unwrap().0;
        assert_eq!(scene.sides[0].kind, SideKind::Room, "{name}");
        for t in 0..12 {
            let [a, b, c] = scene.corners_of(t);
            // The room is centred on the origin of the local frame.
            assert!(scene.normal(t).dot((a + b + c) / 3.0) < 0.0, "{name}, triangle {t}");
            assert!(!scene.triangles[t].two_sided, "{name}, triangle {t}");
        }
        // The lamp hangs below the ceiling and shines down.
        for t in 12..14 {
            assert!(scene.normal(t).y < -0.99 && !scene.triangles[t].emits_back, "{name}, triangle {t}");
        }
        assert!(scene.positions.iter().all(|p| p.is_finite() && p.abs().max_element() <= 0.5), "{name}");
    }
}
