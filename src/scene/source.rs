//! A scene as it was read, before it is cleaned: what another light or colour is put into.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{
    Builder, FileSettings, Proxy, Scene, SceneOverrides, SidesRule, WorldLight, file,
    load::{extension, read_mesh},
};
use crate::Result;

/// A scene as it was read. It can be kept, in memory or in a file, given other lights and colours, and built again.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Source {
    builder: Builder,
    rule: SidesRule,
    /// In the local frame, which depends on the geometry alone.
    proxy: Option<Proxy>,
}

impl Source {
    /// What was collected.
    pub fn new(builder: Builder, rule: SidesRule) -> Source {
        Source { builder, rule, proxy: None }
    }

    /// Reads what [`load`](super::load) reads.
    ///
    /// # Errors
    /// Those of [`load`](super::load).
    pub fn load(path: &Path, overrides: &SceneOverrides) -> Result<(Source, FileSettings)> {
        let mut builder = Builder::new(path.file_stem().unwrap_or_default().to_string_lossy());
        let settings = if extension(path) == "toml" {
            file::read(path, &mut builder)?
        } else {
            read_mesh(path, &mut builder)?;
            FileSettings::default()
        };
        let rule = overrides.sides.or(settings.sides).unwrap_or_default();
        let mut source = Source::new(builder, rule);
        source.change(overrides)?;
        if let Some(path) = overrides.proxy.as_ref().or(settings.proxy.as_ref()) {
            source.proxy = Some(Proxy::read(path, &source.clone().build()?)?);
        }
        Ok((source, settings))
    }

    /// Adds the lights of `overrides`, and changes materials as it says.
    ///
    /// # Errors
    /// [`Error::Option`](crate::Error::Option) for a light without sense, or a material that is not there; those of
    /// reading an environment.
    pub fn change(&mut self, overrides: &SceneOverrides) -> Result<()> {
        overrides.apply(&mut self.builder)
    }

    /// Removes all lights that are not surfaces.
    pub fn remove_lights(&mut self) {
        self.builder.lights.clear();
    }

    /// Cleans the scene.
    ///
    /// # Errors
    /// Those of [`Builder::build`].
    pub fn build(self) -> Result<Scene> {
        let mut scene = self.builder.build(self.rule)?;
        if let Some(proxy) = self.proxy {
            if proxy.dropped > 0 {
                scene.warnings.push(format!(
                    "proxy {}: {} faces were left out: without area, not finite, transparent, or lying on others",
                    proxy.path.display(),
                    proxy.dropped
                ));
            }
            scene.proxy = Some(proxy);
        }
        Ok(scene)
    }

    /// What loaders and [`Builder::build`] take for granted.
    pub(crate) fn check(&self) -> std::result::Result<(), String> {
        let Builder { textures, opacity_maps, lights, camera, .. } = &self.builder;
        for (i, t) in textures.iter().enumerate() {
            let sound = t.texels.iter().all(|t| t.is_finite() && t.min_element() >= 0.0);
            image(t.width, t.height, t.texels.len(), sound).map_err(|e| format!("texture {i}: {e}"))?;
        }
        for (i, m) in opacity_maps.iter().enumerate() {
            let sound = m.texels.iter().all(|t| (0.0..=1.0).contains(t));
            image(m.width, m.height, m.texels.len(), sound).map_err(|e| format!("opacity map {i}: {e}"))?;
        }
        for (i, light) in lights.iter().enumerate() {
            let problem = match light {
                WorldLight::Environment(e) if !(e.up.is_finite() && e.up.is_normalized()) => {
                    Some("up has no length".into())
                }
                WorldLight::Environment(e) => {
                    let sound = e.texels.iter().all(|t| t.is_finite() && t.min_element() >= 0.0);
                    image(e.width, e.height, e.texels.len(), sound).err()
                }
                other => other.problem(),
            };
            problem.map_or(Ok(()), |e| Err(format!("light {i}: {e}")))?;
        }
        if let Some(c) = camera {
            let finite = c.position.is_finite() && c.target.is_finite() && c.up.is_finite();
            if !(finite && c.vertical_fov > 0.0 && c.vertical_fov < 180.0) {
                return Err("the camera is not finite".into());
            }
        }
        self.proxy.as_ref().map_or(Ok(()), Proxy::check)
    }
}

fn image(width: u32, height: u32, texels: usize, sound: bool) -> std::result::Result<(), String> {
    if texels == 0 || width as u64 * height as u64 != texels as u64 {
        return Err(format!("{width} x {height} texels, but {texels} values"));
    }
    if sound { Ok(()) } else { Err("a value is negative, not finite or too large".into()) }
}
