//! Changes of lights and materials.

use glam::{DAffine3, Vec3};

use super::{Relighter, Source};
use crate::{
    Error, Result,
    scene::{WorldLight, list, material::ALBEDO_MAX},
    simplify,
};

impl Relighter {
    /// Puts a light somewhere else: `place` maps where it was when it was given (world coordinates) to where it shall be.
    /// Suns and spots turn with it; points and skies do not.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such light, or `place` is not finite or leaves nothing of it.
    pub fn place(&mut self, source: usize, place: DAffine3) -> Result<()> {
        let placed = self.source(source)?.placed(place, &self.scene)?;
        self.replace(source, placed);
        Ok(())
    }

    /// Exchanges one of the scene's lights, or an added one, for another.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such light, if it is a material, or if the new one has numbers without sense.
    pub fn set_light(&mut self, source: usize, light: WorldLight) -> Result<()> {
        let old = self.source(source)?;
        if old.light().is_none() {
            return Err(Error::Option(format!("{} is no free light: set its emission instead", old.name())));
        }
        let new = Source::of_light(source, light, &self.scene)?;
        self.replace(source, new);
        Ok(())
    }

    /// Adds a light and returns its number.
    ///
    /// # Errors
    /// [`Error::Option`] for numbers without sense.
    pub fn add_light(&mut self, light: WorldLight) -> Result<usize> {
        let number = self.sources.len();
        self.sources.push(Source::of_light(number, light, &self.scene)?);
        self.patch_direct.push(Vec::new());
        self.vertex_direct.push(Vec::new());
        self.lit = false;
        Ok(number)
    }

    /// Sets the radiance (W/m2/sr) of all materials called `name`, where they stand or were moved to; a texture of the
    /// emission is dropped.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such material, or `radiance` is negative or not finite.
    pub fn set_emission(&mut self, name: &str, radiance: Vec3) -> Result<()> {
        if !(radiance.is_finite() && radiance.min_element() >= 0.0) {
            return Err(Error::Option(format!(
                "radiance {radiance} must have three numbers that are finite and not negative"
            )));
        }
        for material in self.materials(name)? {
            let surface = &mut self.scene.materials[material as usize];
            (surface.emission, surface.emission_texture) = (radiance, None);
            let new = Source::of_material(material, &self.scene);
            match self.sources.iter().position(|s| s.surface().is_some_and(|s| s.0 == material)) {
                Some(i) => {
                    let placed = new.placed(self.sources[i].place(), &self.scene)?;
                    self.replace(i, placed);
                }
                None => {
                    self.sources.push(new);
                    self.patch_direct.push(Vec::new());
                    self.vertex_direct.push(Vec::new());
                    self.lit = false;
                }
            }
        }
        self.coloured = false;
        Ok(())
    }

    /// Sets the albedo of all materials called `name`; a texture of it is dropped. Vertex colours still multiply it.
    ///
    /// # Errors
    /// [`Error::Option`] if there is no such material, or `albedo` is not from 0 to 0.9999.
    pub fn set_albedo(&mut self, name: &str, albedo: Vec3) -> Result<()> {
        // What is no number hides from the least and the largest of three.
        if !albedo.to_array().iter().all(|a| (0.0..=ALBEDO_MAX).contains(a)) {
            return Err(Error::Option(format!("albedo {albedo} must have three numbers from 0 to {ALBEDO_MAX}")));
        }
        for material in self.materials(name)? {
            let surface = &mut self.scene.materials[material as usize];
            (surface.albedo, surface.albedo_texture) = (albedo, None);
        }
        self.colour();
        self.take_albedo();
        self.lit = false;
        Ok(())
    }

    fn source(&self, source: usize) -> Result<&Source> {
        let count = self.sources.len();
        self.sources
            .get(source)
            .ok_or_else(|| Error::Option(format!("there is no light {source}: there are {count}, counted from 0")))
    }

    /// The materials called `name`.
    fn materials(&self, name: &str) -> Result<Vec<u32>> {
        let materials = &self.scene.materials;
        let found: Vec<u32> = (0..).zip(materials).filter(|m| m.1.name == name).map(|m| m.0).collect();
        if found.is_empty() {
            let names: Vec<String> = materials.iter().map(|m| format!("\"{}\"", m.name)).collect();
            return Err(Error::Option(format!("there is no material \"{name}\"; there are {}", list(&names, 30))));
        }
        Ok(found)
    }

    fn replace(&mut self, source: usize, new: Source) {
        if let Some((material, radiance)) = new.surface() {
            // Triangles whose light has gone elsewhere are dark.
            let shines = new.place() == DAffine3::IDENTITY;
            let emission = if shines { radiance } else { Vec3::ZERO };
            let old = std::mem::replace(&mut self.scene.materials[material as usize].emission, emission);
            self.coloured &= old == emission;
        }
        self.sources[source] = new;
        self.patch_direct[source].clear();
        self.vertex_direct[source].clear();
        self.lit = false;
    }

    /// Colours of patches and vertices, by the materials as they are now.
    pub(super) fn colour(&mut self) {
        simplify::colour(&mut self.bake.simplified, &self.scene);
        self.bake.mesh.recolour(&self.scene);
        self.coloured = true;
    }

    /// Albedo of the patches, for the solution.
    pub(super) fn take_albedo(&mut self) {
        let albedo = &self.bake.simplified.patches.albedo;
        self.solution.albedo = self.transport.patches.iter().map(|&i| albedo[i as usize].extend(0.0)).collect();
    }
}
