//! Single lights of a scene as light sets of their own, for lights that change one by one.

use glam::Vec3;

use super::{LightSet, Polygon, Shape, Sky, emitters, sky::Map};
use crate::{Scene, light::Lamp, scene::Light};

impl LightSet {
    /// One of [`Scene::lights`] alone. Empty if it is black, without extent or not finite.
    pub(crate) fn of_light(light: &Light) -> LightSet {
        let mut sky = Sky::default();
        match light {
            Light::Sky { radiance } if radiance.is_finite() => sky.constant = radiance.max(Vec3::ZERO),
            Light::Environment(image) => sky.maps.extend(Map::new(image)),
            _ => {}
        }
        LightSet::of(Lamp::new(light).into_iter().collect(), sky)
    }

    /// The emitting triangles of a material alone.
    pub(crate) fn of_material(scene: &Scene, material: u32) -> LightSet {
        LightSet::of(emitters::lamps(scene, |t| scene.triangles[t].material == material), Sky::default())
    }

    /// The same polygons with every corner at its image under `place`, an affine map; `mirrors` tells whether that turns
    /// right hands into left ones. Other lights stay where they are. Polygons that lose their area, and those that leave the
    /// range of f32, are left out.
    pub(crate) fn moved(&self, place: impl Fn(Vec3) -> Vec3, mirrors: bool) -> LightSet {
        let moved = |lamp: &Lamp| {
            let Shape::Polygon(p) = &lamp.shape else { return Some(lamp.clone()) };
            let mut corners = p.corners.map(&place);
            if mirrors {
                corners[..p.count].reverse();
            }
            let shape = Shape::Polygon(Polygon::new(&corners[..p.count], p.both_sides)?);
            Some(Lamp { shape, ..lamp.clone() })
        };
        LightSet::of(self.lamps.iter().filter_map(moved).collect(), self.sky.clone())
    }

    /// All lights of several sets.
    pub(crate) fn union<'a>(sets: impl Iterator<Item = &'a LightSet>) -> LightSet {
        let (mut lamps, mut sky) = (Vec::new(), Sky::default());
        for set in sets {
            lamps.extend_from_slice(&set.lamps);
            sky.constant += set.sky.constant;
            sky.maps.extend_from_slice(&set.sky.maps);
        }
        LightSet::of(lamps, sky)
    }
}
