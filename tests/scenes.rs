//! The scenes of the repository are what their comments say.

use std::path::{Path, PathBuf};

use luxel::scene::{SceneCheck, SceneOverrides, SideKind, load};

#[allow(dead_code)]
#[path = "../examples/make_scenes.rs"]
mod make_scenes;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes")
}

fn check(name: &str) -> SceneCheck {
    SceneCheck::new(&load(&folder().join(name), &SceneOverrides::default()).unwrap().0)
}

fn power(check: &SceneCheck) -> f64 {
    check.materials.iter().map(|m| m.power[0]).sum()
}

#[test]
fn computed_meshes_are_those_that_the_example_writes() {
    for (name, text) in make_scenes::meshes() {
        let stored = std::fs::read_to_string(folder().join(name)).unwrap();
        assert!(stored == text, "{name} differs: run `cargo run --example make_scenes`");
    }
}

#[test]
fn all_scene_files_load_without_a_warning_and_have_light() {
    let mut found = 0;
    for entry in std::fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|e| e == "toml") {
            found += 1;
            let scene = load(&path, &SceneOverrides::default()).unwrap().0;
            assert!(scene.warnings.is_empty(), "{}: {:?}", path.display(), scene.warnings);
            assert!(scene.has_light(), "{}", path.display());
        }
    }
    assert_eq!(found, 11);
}

#[test]
fn closed_scenes_are_closed_and_seen_from_inside() {
    for name in [
        "cie_5_3.toml",
        "cie_5_8.toml",
        "cie_5_8_rotated.toml",
        "furnace_box.toml",
        "furnace_rotated.toml",
        "furnace_sphere.toml",
        "curved_room.toml",
        "two_rooms.toml",
    ] {
        let check = check(name);
        assert_eq!(check.open_components, 0, "{name}");
        assert_eq!(check.sides.iter().filter(|s| s.kind == SideKind::Room).count(), 1, "{name}");
    }
}

#[test]
fn areas_and_powers_are_those_of_the_comments() {
    // f32 positions: areas are good to 1e-6.
    let close = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-6, "{found} {expected}");
    use std::f64::consts::PI;
    close(check("cie_5_3.toml").area, 80.0);
    close(power(&check("cie_5_3.toml")), PI * 1000.0);
    close(check("cie_5_8_rotated.toml").area, 96.0);
    close(power(&check("curved_room.toml")), 10.0 * PI);
    close(power(&check("two_rooms.toml")), 8.0 * PI);
    close(check("cie_5_6_small.toml").area, 0.25 + 12.0);
    // Exitance 0.5 on all of the surface.
    close(power(&check("furnace_box.toml")), 0.5 * 96.0);
    let sphere = check("furnace_sphere.toml");
    close(power(&sphere), 0.5 * sphere.area);
    // The light of the Cornell box is 130 x 105 mm with a radiance of 17 in red.
    close(power(&check("cornell.toml")), 17.0 * PI * 130.0 * 105.0);
}
