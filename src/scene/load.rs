//! Opens a scene by its file's kind and applies what the command line adds.

use std::path::{Path, PathBuf};

use glam::{DVec3, Vec3};

use super::{Builder, FileSettings, Scene, SidesRule, Source, WorldLight, environment, gltf, obj};
use crate::{Error, Result};

/// What is added to, or changed in, a scene after its file is read.
#[derive(Clone, Debug, Default)]
pub struct SceneOverrides {
    /// Radiance of a constant sky, W/m2/sr.
    pub sky: Option<Vec3>,
    /// Directions of travel and irradiances at normal incidence, W/m2.
    pub suns: Vec<(DVec3, Vec3)>,
    /// World positions and radiant intensities, W/sr.
    pub points: Vec<(DVec3, Vec3)>,
    /// Lat-long EXR image of the surroundings; up is +y.
    pub environment: Option<PathBuf>,
    /// Names of materials and the radiance they emit, W/m2/sr.
    pub emit: Vec<(String, Vec3)>,
    /// Names of materials and their albedo.
    pub albedo: Vec<(String, Vec3)>,
    /// Which sides of surfaces count; `None`: as the scene file says, else [`SidesRule::Auto`].
    pub sides: Option<SidesRule>,
    /// A hand-made simplified mesh; before that of the scene file.
    pub proxy: Option<PathBuf>,
}

/// Loads a scene: an OBJ, glTF or GLB file, or a scene file `NAME.toml`; and the bake settings that a scene file gives.
///
/// # Errors
/// The file cannot be read or is wrong, no geometry is left, or an override names a material that is not there. A
/// scene without light loads: see [`Scene::has_light`].
pub fn load(path: &Path, overrides: &SceneOverrides) -> Result<(Scene, FileSettings)> {
    let (source, settings) = Source::load(path, overrides)?;
    Ok((source.build()?, settings))
}

/// Reads an OBJ, glTF or GLB file into `builder`.
pub(crate) fn read_mesh(path: &Path, builder: &mut Builder) -> Result<()> {
    match extension(path).as_str() {
        "obj" => obj::read(path, builder),
        "gltf" | "glb" => gltf::read(path, builder),
        other => {
            let what = match other {
                _ if path.is_dir() => "is a folder".to_string(),
                "" => "has no extension that tells its kind".to_string(),
                other => format!("\".{other}\" is no kind of scene"),
            };
            Err(Error::input(path, "", format!("{what}; scenes are .obj, .gltf, .glb and scene files .toml")))
        }
    }
}

pub(super) fn extension(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

impl SceneOverrides {
    pub(super) fn apply(&self, builder: &mut Builder) -> Result<()> {
        let mut lights: Vec<WorldLight> = self.sky.iter().map(|&radiance| WorldLight::Sky { radiance }).collect();
        lights.extend(self.suns.iter().map(|&(direction, irradiance)| WorldLight::Sun { direction, irradiance }));
        lights.extend(self.points.iter().map(|&(position, intensity)| WorldLight::Point {
            position,
            intensity,
            range: f64::INFINITY,
        }));
        for light in lights {
            if let Some(problem) = light.problem() {
                return Err(Error::Option(format!("light: {problem}")));
            }
            builder.add_light(light);
        }
        if let Some(path) = &self.environment {
            builder.add_light(WorldLight::Environment(environment::read(path, Vec3::Y)?));
        }
        for (name, albedo) in &self.albedo {
            change(builder, name, |m| m.set_albedo(*albedo))?;
        }
        for (name, radiance) in &self.emit {
            change(builder, name, |m| m.set_emission(*radiance))?;
        }
        Ok(())
    }
}

/// Changes all materials called `name`.
fn change(builder: &mut Builder, name: &str, f: impl Fn(&mut super::RawMaterial)) -> Result<()> {
    let mut found = false;
    for material in builder.materials_mut().iter_mut().filter(|m| m.surface.name == name) {
        f(material);
        found = true;
    }
    if found {
        return Ok(());
    }
    let names: Vec<String> = builder.materials_mut().iter().map(|m| format!("\"{}\"", m.surface.name)).collect();
    Err(Error::Option(format!("there is no material \"{name}\"; there are {}", super::builder::list(&names, 30))))
}
