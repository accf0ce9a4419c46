//! Scene files: `NAME.toml`. The schema is explained in docs/SCENE.md.
//!
//! Unknown keys are errors. Paths are relative to the scene file; they may lead anywhere, because whoever wrote the
//! scene file chose them, unlike the references inside meshes.

use std::{
    collections::BTreeMap,
    f64::consts::PI,
    path::{Path, PathBuf},
};

use glam::{DAffine3, DQuat, DVec3, Vec3};
use serde::Deserialize;

use super::{
    Camera, Material, WorldLight,
    builder::{Builder, list},
    environment,
    load::read_mesh,
    path,
    raw::RawMaterial,
    sides::SidesRule,
};
use crate::{
    BakeOptions, Error, Result,
    options::{Backend, FaceColour, PatchSource, Primary, Reconstruct, Resolution},
};

/// The `[bake]` table of a scene file. The keys are the command line's flags with `_` for `-`; flags go before them.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileSettings {
    /// Voxels along the longest side; not together with `voxel`.
    pub grid: Option<u32>,
    /// Voxel size, world units.
    pub voxel: Option<f64>,
    /// See [`BakeOptions::patches`].
    pub patches: Option<PatchSource>,
    /// See [`BakeOptions::target_patches`].
    pub target_patches: Option<u32>,
    /// A hand-made simplified mesh; `patches` is then [`PatchSource::Proxy`] unless given.
    pub proxy: Option<PathBuf>,
    /// See [`BakeOptions::rays`].
    pub rays: Option<u32>,
    /// See [`BakeOptions::reconstruct`].
    pub reconstruct: Option<Reconstruct>,
    /// See [`BakeOptions::gather_rays`].
    pub gather_rays: Option<u32>,
    /// See [`BakeOptions::primary`].
    pub primary: Option<Primary>,
    /// See [`BakeOptions::backend`].
    pub backend: Option<Backend>,
    /// See [`BakeOptions::face_colour`].
    pub face_colour: Option<FaceColour>,
    /// See [`BakeOptions::normal_threshold`].
    pub normal_threshold: Option<f32>,
    /// See [`BakeOptions::point_samples`].
    pub point_samples: Option<u32>,
    /// See [`BakeOptions::patch_samples`].
    pub patch_samples: Option<u32>,
    /// See [`BakeOptions::tolerance`].
    pub tolerance: Option<f64>,
    /// See [`BakeOptions::seed`].
    pub seed: Option<u64>,
    /// See [`BakeOptions::skip`]; once called `skip_unreached`.
    #[serde(alias = "skip_unreached")]
    pub skip: Option<bool>,
    /// See [`BakeOptions::only`].
    pub only: Option<Vec<String>>,
    /// See [`BakeOptions::estimate`].
    pub estimate: Option<bool>,
    /// Threads to use.
    pub threads: Option<usize>,
    /// Which sides of surfaces count; [`super::load`] has applied it.
    pub sides: Option<SidesRule>,
}

impl FileSettings {
    /// Writes the settings that the file gives into `options`.
    pub fn apply(&self, options: &mut BakeOptions) {
        fn set<T: Copy>(slot: &mut T, value: Option<T>) {
            if let Some(value) = value {
                *slot = value;
            }
        }
        set(&mut options.resolution, self.voxel.map(Resolution::Voxel).or(self.grid.map(Resolution::Grid)));
        set(&mut options.patches, self.patches.or(self.proxy.as_ref().map(|_| PatchSource::Proxy)));
        set(&mut options.target_patches, self.target_patches.map(Some));
        set(&mut options.rays, self.rays);
        set(&mut options.reconstruct, self.reconstruct);
        set(&mut options.gather_rays, self.gather_rays);
        set(&mut options.primary, self.primary);
        set(&mut options.backend, self.backend);
        set(&mut options.face_colour, self.face_colour);
        set(&mut options.normal_threshold, self.normal_threshold);
        set(&mut options.point_samples, self.point_samples);
        set(&mut options.patch_samples, self.patch_samples);
        set(&mut options.tolerance, self.tolerance);
        set(&mut options.seed, self.seed);
        set(&mut options.estimate, self.estimate);
        set(&mut options.skip, self.skip);
        if let Some(only) = &self.only {
            options.only.clone_from(only);
        }
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    #[serde(default)]
    mesh: Vec<MeshEntry>,
    #[serde(default)]
    light: Vec<LightEntry>,
    #[serde(default)]
    material: BTreeMap<String, MaterialEntry>,
    camera: Option<CameraEntry>,
    #[serde(default)]
    bake: FileSettings,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MeshEntry {
    path: String,
    scale: Option<Scale>,
    rotate: Option<Rotation>,
    translate: Option<[f64; 3]>,
    material: Option<String>,
}

#[derive(Deserialize)]
#[serde(untagged, expecting = "scale must be one number or three")]
enum Scale {
    Uniform(f64),
    PerAxis([f64; 3]),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rotation {
    axis: [f64; 3],
    /// Degrees, counter-clockwise seen from the axis's tip.
    angle: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MaterialEntry {
    albedo: Option<[f32; 3]>,
    emission: Option<[f32; 3]>,
    opacity: Option<f32>,
    double_sided: Option<bool>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CameraEntry {
    position: [f64; 3],
    target: [f64; 3],
    #[serde(default = "y_axis")]
    up: [f64; 3],
    /// Vertical, degrees.
    fov: f64,
}

#[derive(Deserialize)]
#[serde(tag = "type", rename_all = "snake_case", deny_unknown_fields)]
enum LightEntry {
    Rectangle {
        corner: [f64; 3],
        edge_u: [f64; 3],
        edge_v: [f64; 3],
        radiance: [f32; 3],
    },
    Disc {
        centre: [f64; 3],
        normal: [f64; 3],
        radius: f64,
        radiance: [f32; 3],
    },
    Point {
        position: [f64; 3],
        intensity: Option<[f32; 3]>,
        /// W; intensity = power / 4 pi.
        power: Option<[f32; 3]>,
        #[serde(default = "endless")]
        range: f64,
    },
    Spot {
        position: [f64; 3],
        direction: [f64; 3],
        intensity: [f32; 3],
        inner: f64,
        outer: f64,
        #[serde(default = "endless")]
        range: f64,
    },
    Sun {
        direction: [f64; 3],
        irradiance: [f32; 3],
    },
    Sky {
        radiance: [f32; 3],
    },
    Environment {
        file: String,
        #[serde(default = "y_axis")]
        up: [f64; 3],
        /// Multiplies the image.
        #[serde(default = "one")]
        strength: f32,
    },
}

fn y_axis() -> [f64; 3] {
    [0.0, 1.0, 0.0]
}

fn endless() -> f64 {
    f64::INFINITY
}

fn one() -> f32 {
    1.0
}

/// Reads a scene file and everything it names into `builder`.
///
/// # Errors
/// [`Error::Io`], or [`Error::Input`] with the line of an unknown key or a wrong value.
pub(crate) fn read(file: &Path, builder: &mut Builder) -> Result<FileSettings> {
    let text = std::fs::read_to_string(file).map_err(|e| Error::io(file, e))?;
    let scene: SceneFile = toml::from_str(&text).map_err(|e| {
        let line = e.span().map(|s| format!("line {}", 1 + text[..s.start].matches('\n').count()));
        Error::input(file, line.unwrap_or_default(), e.message())
    })?;
    let wrong = |place: String, message: String| Error::input(file, place, message);
    if scene.bake.grid.is_some() && scene.bake.voxel.is_some() {
        return Err(wrong("[bake]".into(), "grid and voxel exclude each other".into()));
    }
    for (i, entry) in scene.mesh.iter().enumerate() {
        let place = || format!("[[mesh]] {}", i + 1);
        let transform = entry.transform().map_err(|m| wrong(place(), m))?;
        let mark = builder.mark();
        read_mesh(&path::folder(file).join(&entry.path), builder)?;
        builder.transform_since(mark, &transform);
        if let Some(name) = &entry.material {
            let index = material_index(name, &scene.material, builder).map_err(|m| wrong(place(), m))?;
            builder.set_material_since(mark, index);
        }
    }
    for (name, entry) in &scene.material {
        entry.apply(name, builder).map_err(|m| wrong(format!("[material.{name}]"), m))?;
    }
    for (i, entry) in scene.light.into_iter().enumerate() {
        let place = || format!("[[light]] {}", i + 1);
        let light = entry.into_light(path::folder(file)).map_err(|m| wrong(place(), m))?;
        if let Some(problem) = light.problem() {
            return Err(wrong(place(), problem));
        }
        builder.add_light(light);
    }
    if let Some(camera) = scene.camera {
        builder.set_camera(camera.to_camera().map_err(|m| wrong("[camera]".into(), m))?);
    }
    let mut settings = scene.bake;
    settings.proxy = settings.proxy.map(|proxy| path::folder(file).join(proxy));
    Ok(settings)
}

impl MeshEntry {
    /// Scaled first, then turned, then moved.
    fn transform(&self) -> std::result::Result<DAffine3, String> {
        let scale = match self.scale {
            None => DVec3::ONE,
            Some(Scale::Uniform(s)) => DVec3::splat(s),
            Some(Scale::PerAxis(s)) => s.into(),
        };
        let rotation = match &self.rotate {
            None => DQuat::IDENTITY,
            Some(r) => {
                let axis = DVec3::from(r.axis).try_normalize().ok_or("rotate.axis must have a length")?;
                DQuat::from_axis_angle(axis, r.angle.to_radians())
            }
        };
        let transform =
            DAffine3::from_scale_rotation_translation(scale, rotation, self.translate.unwrap_or([0.0; 3]).into());
        if transform.is_finite() { Ok(transform) } else { Err("scale, rotate and translate must be finite".into()) }
    }
}

/// The material `name` of the meshes read so far; one that only the scene file defines is added.
fn material_index(
    name: &str,
    defined: &BTreeMap<String, MaterialEntry>,
    builder: &mut Builder,
) -> std::result::Result<u32, String> {
    if let Some(index) = builder.materials_mut().iter().position(|m| m.surface.name == name) {
        return Ok(index as u32);
    }
    if !defined.contains_key(name) {
        return Err(format!("there is no material \"{name}\"; add [material.{name}]"));
    }
    let surface = Material { name: name.into(), albedo: super::mtl::DEFAULT_ALBEDO, ..Material::default() };
    Ok(builder.add_material(RawMaterial { surface, ..RawMaterial::default() }))
}

impl MaterialEntry {
    /// Changes all materials called `name`. A colour given here replaces colour and texture.
    fn apply(&self, name: &str, builder: &mut Builder) -> std::result::Result<(), String> {
        let mut found = false;
        for material in builder.materials_mut().iter_mut().filter(|m| m.surface.name == name) {
            found = true;
            if let Some(albedo) = self.albedo {
                material.set_albedo(albedo.into());
            }
            if let Some(emission) = self.emission {
                material.set_emission(emission.into());
            }
            if let Some(opacity) = self.opacity {
                material.opacity.factor = opacity;
                material.opacity.texture = None;
            }
            if let Some(double_sided) = self.double_sided {
                material.surface.double_sided = double_sided;
            }
        }
        if found {
            return Ok(());
        }
        let names: Vec<String> = builder.materials_mut().iter().map(|m| format!("\"{}\"", m.surface.name)).collect();
        Err(format!("no mesh has a material of this name; there are {}", list(&names, 30)))
    }
}

impl LightEntry {
    fn into_light(self, folder: &Path) -> std::result::Result<WorldLight, String> {
        Ok(match self {
            LightEntry::Rectangle { corner, edge_u, edge_v, radiance } => WorldLight::Rectangle {
                corner: corner.into(),
                edge_u: edge_u.into(),
                edge_v: edge_v.into(),
                radiance: radiance.into(),
            },
            LightEntry::Disc { centre, normal, radius, radiance } => {
                WorldLight::Disc { centre: centre.into(), normal: normal.into(), radius, radiance: radiance.into() }
            }
            LightEntry::Point { position, intensity, power, range } => {
                let intensity = match (intensity, power) {
                    (Some(i), None) => Vec3::from(i),
                    (None, Some(p)) => Vec3::from(p) / (4.0 * PI) as f32,
                    _ => return Err("a point needs intensity (W/sr) or power (W), and not both".into()),
                };
                WorldLight::Point { position: position.into(), intensity, range }
            }
            LightEntry::Spot { position, direction, intensity, inner, outer, range } => WorldLight::Spot {
                position: position.into(),
                direction: direction.into(),
                intensity: intensity.into(),
                inner,
                outer,
                range,
            },
            LightEntry::Sun { direction, irradiance } => {
                WorldLight::Sun { direction: direction.into(), irradiance: irradiance.into() }
            }
            LightEntry::Sky { radiance } => WorldLight::Sky { radiance: radiance.into() },
            LightEntry::Environment { file, up, strength } => {
                if !(strength.is_finite() && strength >= 0.0) {
                    return Err("strength must be finite and not negative".into());
                }
                let up = DVec3::from(up).try_normalize().ok_or("up must have a length")?;
                let mut environment = environment::read(&folder.join(file), up.as_vec3()).map_err(|e| e.to_string())?;
                environment.texels.iter_mut().for_each(|t| *t *= strength);
                WorldLight::Environment(environment)
            }
        })
    }
}

impl CameraEntry {
    fn to_camera(&self) -> std::result::Result<Camera, String> {
        let camera = Camera {
            position: self.position.into(),
            target: self.target.into(),
            up: self.up.into(),
            vertical_fov: self.fov,
        };
        let view = (camera.target - camera.position).try_normalize();
        let aside = view.zip(camera.up.try_normalize()).map(|(v, u)| v.cross(u).length());
        if !camera.position.is_finite() || aside.is_none_or(|a| a < 1e-6) {
            return Err("position, target and up must be finite, and up must not point along the view".into());
        }
        if !(self.fov > 0.0 && self.fov < 180.0) {
            return Err(format!("fov {} must be degrees between 0 and 180", self.fov));
        }
        Ok(camera)
    }
}
