//! Direct irradiance of patches, vertices and points by every kind of light.
//!
//! The light of a lamp is its exact irradiance without occluders (Lambert's formula and its kin, `form`) times the
//! share of it that shadow rays find unblocked, so that a receiver in full view has no noise at all. Rays are
//! stratified (Owen-scrambled Sobol), go to a lamp in proportion to what it can give, and towards near lamps are
//! uniform in solid angle (`spherical`). Where there are more lamps than a receiver can look at one by one, a tree
//! groups them (`tree`).

use glam::Vec3;

use crate::{Scene, scene::Light};

mod aim;
mod answers;
mod beside;
mod bright;
mod crowd;
mod emitters;
mod estimate;
mod form;
mod known;
mod lamp;
mod lanes;
mod node;
mod numbers;
mod parts;
mod power;
mod senders;
mod sky;
mod spherical;
mod stream;
mod tree;

pub use beside::beside_lamps;
pub use bright::Bright;
pub(crate) use crowd::AS_GOOD;
pub use estimate::{irradiance, irradiance_where};
pub use known::{Census, Known, Spared, View};
use lamp::{Lamp, Polygon, Shape};
pub use power::LampPower;
pub(crate) use senders::Crowd;
use sky::{Map, Sky};
pub(crate) use stream::irradiance_of_few;
use tree::Tree;

/// The lights of a scene, prepared: emissive triangles and [`Scene::lights`], in the local frame.
#[derive(Clone, Debug, Default)]
pub struct LightSet {
    lamps: Vec<Lamp>,
    /// Over all lamps but the suns.
    tree: Tree,
    suns: Vec<u32>,
    sky: Sky,
    /// Lamps that reach nothing; empty if none are known.
    dark: Vec<bool>,
    /// Whether it is surfaces alone, and nobody looks for a sky.
    polygons: bool,
}

/// What [`irradiance`] found.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DirectResult {
    /// One entry a receiver, W/m2; finite and not negative.
    pub irradiance: Vec<Vec3>,
    /// Shadow rays traced.
    pub rays: u64,
    /// Shadow rays that were left out.
    pub spared: Spared,
}

impl LightSet {
    /// Prepares the lights of `scene`. Lights that are black, without extent or not finite are left out.
    pub fn new(scene: &Scene) -> LightSet {
        let mut lamps = emitters::lamps(scene, |_| true);
        lamps.extend(scene.lights.iter().filter_map(Lamp::new));
        let mut sky = Sky::default();
        for light in &scene.lights {
            match light {
                Light::Sky { radiance } if radiance.is_finite() => sky.constant += radiance.max(Vec3::ZERO),
                Light::Environment(image) => sky.maps.extend(Map::new(image)),
                _ => {}
            }
        }
        LightSet::of(lamps, sky)
    }

    /// Polygons of a scene's surfaces that radiate from their fronts: corners (3, or 4 of a parallelogram,
    /// counter-clockwise as seen from the front; local) and radiance, W/m2/sr. Those without area are left out.
    pub fn of_polygons<'a>(polygons: impl Iterator<Item = (&'a [Vec3], Vec3)>) -> LightSet {
        let lamp = |(corners, colour): (&[Vec3], Vec3)| {
            Some(Lamp { shape: Shape::Polygon(Polygon::new(corners, false)?), colour, surface: true })
        };
        LightSet { polygons: true, ..LightSet::of(polygons.filter_map(lamp).collect(), Sky::default()) }
    }

    fn of(lamps: Vec<Lamp>, sky: Sky) -> LightSet {
        let suns = (0..lamps.len() as u32).filter(|&i| lamps[i as usize].bounds().is_none()).collect();
        LightSet { tree: Tree::new(&lamps), suns, lamps, sky, dark: Vec::new(), polygons: false }
    }

    /// Whether there is no light at all.
    pub fn is_empty(&self) -> bool {
        self.lamps.is_empty() && !self.has_sky()
    }

    /// Emitted power by channel, W / scale^2, without sun and sky (whose power has no bound).
    pub fn power(&self) -> [f64; 3] {
        let mut power = [0.0; 3];
        for lamp in &self.lamps {
            for (sum, colour) in power.iter_mut().zip(lamp.colour.to_array()) {
                *sum += lamp.power() * colour as f64;
            }
        }
        power
    }

    /// Radiance that arrives from unit `direction` when no surface is in the way, W/m2/sr: constant sky and
    /// environment; suns have no extent and are not in it.
    pub fn sky_radiance(&self, direction: Vec3) -> Vec3 {
        self.sky.radiance(direction)
    }

    /// Whether [`LightSet::sky_radiance`] is anything but black.
    pub fn has_sky(&self) -> bool {
        self.sky.is_lit()
    }

    /// The middle of the box around the lamps, local; none if all are suns or skies.
    pub(crate) fn middle(&self) -> Option<Vec3> {
        let bounds = || self.lamps.iter().filter_map(Lamp::bounds);
        let low = bounds().map(|b| b.low).reduce(Vec3::min)?;
        let high = bounds().map(|b| b.high).reduce(Vec3::max)?;
        Some(0.5 * (low + high))
    }

    /// Whether there are suns or a sky, whose power has no bound.
    pub fn has_unbounded(&self) -> bool {
        !self.suns.is_empty() || self.has_sky()
    }

    /// Mean over the channels of the largest irradiance that a sky gives; `None` if there is none, or an image with
    /// bright spots, of which a few rays say nothing.
    pub fn even_sky(&self) -> Option<f64> {
        let sky = &self.sky;
        let even = sky.is_lit() && sky.maps.iter().all(|m| !m.uneven);
        even.then(|| std::f64::consts::PI * sky.largest())
    }

    /// Casts no more rays to the lamps that `dark` names, one entry a lamp.
    pub(crate) fn forget(&mut self, dark: Vec<bool>) {
        self.dark = dark;
    }

    fn is_dark(&self, lamp: u32) -> bool {
        self.dark.get(lamp as usize).is_some_and(|&dark| dark)
    }

    /// Without emissive surfaces: for when emitting triangles are senders of the radiosity system themselves.
    pub fn without_surfaces(self) -> LightSet {
        LightSet::of(self.lamps.into_iter().filter(|lamp| !lamp.surface).collect(), self.sky)
    }
}
