//! A light that can be moved and changed.

use glam::{DAffine3, DVec3, Vec3};

use crate::{
    Error, Result, Scene,
    light::LightSet,
    scene::{Light, WorldLight},
};

/// One of the lights of a [`super::Relighter`].
#[derive(Clone, Debug)]
pub struct Source {
    name: String,
    given: Given,
    place: DAffine3,
    /// What is sampled, local.
    pub(super) lights: LightSet,
}

/// What a source was given as, before it was moved.
#[derive(Clone, Debug)]
enum Given {
    /// One of the scene's lights, or one that was added.
    Light(Box<WorldLight>),
    /// The emitting triangles of a material, with their radiance and their polygons.
    Surface { material: u32, radiance: Vec3, polygons: LightSet },
}

impl Source {
    /// A light of the scene, as it stands in its local frame.
    pub(super) fn of_scene(number: usize, light: &Light, scene: &Scene) -> Source {
        let given = WorldLight::of_local(light, &scene.frame);
        let name = format!("light {number} ({})", given.kind());
        let lights = LightSet::of_light(light);
        Source { name, given: Given::Light(Box::new(given)), place: DAffine3::IDENTITY, lights }
    }

    /// A light in world coordinates.
    ///
    /// # Errors
    /// [`Error::Option`] naming the number that has no sense.
    pub(super) fn of_light(number: usize, light: WorldLight, scene: &Scene) -> Result<Source> {
        let name = format!("light {number} ({})", light.kind());
        let lights = lights_of(&name, &light, scene)?;
        Ok(Source { name, given: Given::Light(Box::new(light)), place: DAffine3::IDENTITY, lights })
    }

    /// The emitting triangles of a material of the scene.
    pub(super) fn of_material(material: u32, scene: &Scene) -> Source {
        let surface = &scene.materials[material as usize];
        let polygons = LightSet::of_material(scene, material);
        Source {
            name: format!("material \"{}\"", surface.name),
            lights: polygons.clone(),
            given: Given::Surface { material, radiance: surface.emission, polygons },
            place: DAffine3::IDENTITY,
        }
    }

    /// What messages call it: `light 0 (sun)`, `material "lamp"`.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The light as it was given, in world coordinates; `None` for emitting triangles.
    pub fn light(&self) -> Option<&WorldLight> {
        match &self.given {
            Given::Light(light) => Some(light),
            Given::Surface { .. } => None,
        }
    }

    /// The material whose triangles emit, as an index of the scene, and its radiance, W/m2/sr; `None` for other lights.
    pub fn surface(&self) -> Option<(u32, Vec3)> {
        match &self.given {
            Given::Light(_) => None,
            Given::Surface { material, radiance, .. } => Some((*material, *radiance)),
        }
    }

    /// Where it stands: the map from where it was given, world coordinates.
    pub fn place(&self) -> DAffine3 {
        self.place
    }

    /// Where it is now, world coordinates: the middle of the box around it; `None` for suns and skies.
    pub fn middle(&self, scene: &Scene) -> Option<DVec3> {
        self.lights.middle().map(|local| scene.frame.to_world(local))
    }

    /// The same light somewhere else.
    ///
    /// # Errors
    /// [`Error::Option`] if `place` is not finite or leaves nothing of the light that makes sense.
    pub(super) fn placed(&self, place: DAffine3, scene: &Scene) -> Result<Source> {
        if !place.is_finite() {
            return Err(Error::Option(format!("{}: the place to move it to must be finite", self.name)));
        }
        let lights = match &self.given {
            Given::Light(light) => {
                let mut moved = light.clone();
                moved.transform(&place);
                lights_of(&self.name, &moved, scene)?
            }
            Given::Surface { polygons, .. } if place == DAffine3::IDENTITY => polygons.clone(),
            Given::Surface { polygons, .. } => {
                let frame = scene.frame;
                let moved = |local| frame.to_local(place.transform_point3(frame.to_world(local)));
                polygons.moved(moved, place.matrix3.determinant() < 0.0)
            }
        };
        Ok(Source { place, lights, name: self.name.clone(), given: self.given.clone() })
    }
}

/// A light as it is sampled.
fn lights_of(name: &str, light: &WorldLight, scene: &Scene) -> Result<LightSet> {
    if let Some(problem) = light.problem() {
        return Err(Error::Option(format!("{name}: {problem}")));
    }
    let local = light.to_local(&scene.frame);
    if !local.is_finite() {
        return Err(Error::Option(format!("{name}: its numbers are too large for this scene")));
    }
    Ok(LightSet::of_light(&local))
}
