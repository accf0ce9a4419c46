//! The scenes that every change is measured on.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use crate::scene::SceneOverrides;

/// A scene of the suite.
pub struct SuiteScene {
    /// Its file, in the folder of the repository's scenes or of the shared ones.
    pub file: &'static str,
    /// Whether it is one of the shared scenes.
    pub shared: bool,
    /// Light that it does not have itself.
    light: Option<AddedLight>,
}

/// Light for a scene without any.
enum AddedLight {
    /// Position and intensity of a grey lamp.
    Point([f64; 3], f32),
    /// A blue sky and a low sun.
    SkyAndSun,
}

/// The repository's scenes, then those that others made.
pub const SUITE: [SuiteScene; 9] = [
    own("cornell.toml"),
    own("curved_room.toml"),
    own("two_rooms.toml"),
    shared("veach_ajar/veach_ajar.obj", None),
    shared("cornell_mcguire/CornellBox-Sphere.obj", None),
    shared("godot_room/room.glb", Some(AddedLight::Point([0.0, 4.0, 0.0], 20.0))),
    shared("ignis_room/Room.obj", Some(AddedLight::Point([0.0, 0.5, 0.0], 2.0))),
    shared("map_pandora/pandora.obj", Some(AddedLight::SkyAndSun)),
    shared("lost_empire/lost_empire.obj", Some(AddedLight::SkyAndSun)),
];

const fn own(file: &'static str) -> SuiteScene {
    SuiteScene { file, shared: false, light: None }
}

const fn shared(file: &'static str, light: Option<AddedLight>) -> SuiteScene {
    SuiteScene { file, shared: true, light }
}

impl SuiteScene {
    /// Its file in the folder of its kind.
    pub fn path(&self, scenes: &Path, shared: &Path) -> PathBuf {
        if self.shared { shared } else { scenes }.join(self.file)
    }

    /// The light that is added to it.
    pub fn overrides(&self) -> SceneOverrides {
        let mut added = SceneOverrides::default();
        match self.light {
            None => {}
            Some(AddedLight::Point(position, intensity)) => {
                added.points.push((position.into(), Vec3::splat(intensity)));
            }
            Some(AddedLight::SkyAndSun) => {
                added.sky = Some(Vec3::new(0.2, 0.3, 0.5));
                added.suns.push((DVec3::new(0.3, -1.0, 0.5), Vec3::new(3.0, 3.0, 2.5)));
            }
        }
        added
    }
}
