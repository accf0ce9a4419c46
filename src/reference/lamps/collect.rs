//! Gathers the lights of a scene, and finds how often each is to be looked for.

use std::f32::consts::PI;

use glam::Vec3;

use super::{Disc, Facet, Floating, Glow, Lamp, Lamps, NO_LAMP};
use crate::{
    reference::{pick::Pick, sky::Map},
    sampling,
    scene::{Light, RAY_OFFSET},
    trace::Geometry,
};

/// Share of the picks that goes to all lamps alike: no lamp is picked so seldom that its light is missed.
const EVENLY: f64 = 0.25;

pub(super) fn is_light(colour: Vec3) -> bool {
    colour.is_finite() && colour.min_element() >= 0.0 && colour != Vec3::ZERO
}

fn mean(colour: Vec3) -> f64 {
    colour.to_array().iter().map(|&c| c as f64).sum::<f64>() / 3.0
}

/// Lamps before their probabilities are known.
#[derive(Default)]
pub(super) struct Collector {
    lamps: Vec<Lamp>,
    /// Power, of a mean channel.
    powers: Vec<f64>,
    /// Of lamps with an extent, else 1.
    areas: Vec<f64>,
    sky: Vec3,
    maps: Vec<Map>,
}

impl Collector {
    fn push(&mut self, lamp: Lamp, power: f64, area: f64) -> u32 {
        self.lamps.push(lamp);
        self.powers.push(power);
        self.areas.push(area);
        self.lamps.len() as u32 - 1
    }

    /// A triangle that glows on the side of u x v; none without an area.
    pub fn facet(&mut self, corner: Vec3, u: Vec3, v: Vec3, radiance: Vec3) -> u32 {
        let cross = u.as_dvec3().cross(v.as_dvec3());
        let area = 0.5 * cross.length();
        if !(area > 0.0 && area.is_finite()) {
            return NO_LAMP;
        }
        let normal = cross.normalize().as_vec3();
        let glow = Glow { exitance: (PI * radiance).into(), density: 0.0 };
        let corner = corner + RAY_OFFSET * normal;
        let facet = Facet { corner: corner.into(), u: u.into(), v: v.into(), normal: normal.into(), glow };
        self.push(Lamp::Facet(facet), std::f64::consts::PI * area * mean(radiance), area)
    }

    /// A light that is no surface; what paths can meet of it goes into `geometry`, and its lamp into `lamp_of`.
    pub fn light(&mut self, light: &Light, section: f64, geometry: &mut Geometry, lamp_of: &mut Vec<u32>) {
        let mut add_triangle = |corners: [Vec3; 3], lamp: u32| {
            let first = geometry.positions.len() as u32;
            geometry.positions.extend(corners);
            geometry.triangles.push([first, first + 1, first + 2]);
            lamp_of.push(lamp);
        };
        let four_pi = 4.0 * std::f64::consts::PI;
        match light {
            Light::Rectangle { corner, edge_u, edge_v, radiance } if is_light(*radiance) => {
                let far = *corner + *edge_u + *edge_v;
                for [a, b, c] in
                    [[*corner, *corner + *edge_u, *corner + *edge_v], [far, *corner + *edge_v, *corner + *edge_u]]
                {
                    let finite = [a, b, c].iter().all(|p| p.is_finite());
                    let lamp = if finite { self.facet(a, b - a, c - a, *radiance) } else { NO_LAMP };
                    if lamp != NO_LAMP {
                        add_triangle([a, b, c], lamp);
                    }
                }
            }
            Light::Disc { centre, normal, radius, radiance } if is_light(*radiance) => {
                let Some(normal) = normal.try_normalize() else { return };
                let area = std::f64::consts::PI * (*radius as f64).powi(2);
                if !(centre.is_finite() && area > 0.0 && area.is_finite()) {
                    return;
                }
                let glow = Glow { exitance: (PI * *radiance).into(), density: 0.0 };
                let disc = Disc { centre: *centre + RAY_OFFSET * normal, normal: normal.into(), radius: *radius, glow };
                let lamp = self.push(Lamp::Disc(disc), std::f64::consts::PI * area * mean(*radiance), area);
                let (u, v) = sampling::frame(normal);
                // Slightly more than the disc, which decides by itself.
                let (u, v) = (1.001 * *radius * u, 1.001 * *radius * v);
                let [a, b, c, d] = [*centre - u - v, *centre + u - v, *centre + u + v, *centre - u + v];
                add_triangle([a, b, c], lamp);
                add_triangle([a, c, d], lamp);
            }
            Light::Point { position, intensity, range }
                if is_light(*intensity) && position.is_finite() && *range > 0.0 =>
            {
                let lamp = Lamp::Point { position: *position, range: *range, intensity: *intensity };
                self.push(lamp, four_pi * mean(*intensity), 1.0);
            }
            Light::Spot { position, direction, intensity, cos_inner, cos_outer, range }
                if is_light(*intensity) && position.is_finite() && *range > 0.0 =>
            {
                let usable = cos_inner.is_finite() && cos_outer.is_finite();
                let Some(direction) = direction.try_normalize().filter(|_| usable) else { return };
                let lamp = Lamp::Spot {
                    position: *position,
                    direction,
                    cos_inner: *cos_inner,
                    cos_outer: *cos_outer,
                    range: *range,
                    intensity: *intensity,
                };
                let share = 0.5 * (1.0 - cos_inner.min(*cos_outer).clamp(-1.0, 1.0)) as f64;
                self.push(lamp, four_pi * share.max(1e-6) * mean(*intensity), 1.0);
            }
            Light::Sun { direction, irradiance } if is_light(*irradiance) => {
                let Some(direction) = direction.try_normalize() else { return };
                self.push(Lamp::Sun { direction, irradiance: *irradiance }, section * mean(*irradiance), 1.0);
            }
            Light::Sky { radiance } if is_light(*radiance) => self.sky += *radiance,
            Light::Environment(image) => {
                if let Some(map) = Map::new(image) {
                    let power = section * map.total();
                    self.maps.push(map);
                    self.push(Lamp::Map { map: self.maps.len() as u32 - 1, pick: 0.0 }, power, 1.0);
                }
            }
            _ => (),
        }
    }

    /// The lamps, each picked by its power.
    pub fn finish(mut self, of_triangle: Vec<[u32; 2]>, floating: Option<Floating>) -> Lamps {
        let (n, total) = (self.lamps.len() as f64, self.powers.iter().sum::<f64>());
        let by_power = if total.is_finite() { 1.0 - EVENLY } else { 0.0 };
        let probability = |power: f64| {
            let own = if by_power > 0.0 { by_power * power / total } else { 0.0 };
            own + (1.0 - by_power) / n
        };
        let probabilities: Vec<f64> = self.powers.iter().map(|&p| probability(p)).collect();
        let pick = Pick::new(&probabilities);
        let mut map_picks = vec![0.0; self.maps.len()];
        for (k, lamp) in self.lamps.iter_mut().enumerate() {
            let p = pick.probability(k);
            let density = (std::f64::consts::PI * p / self.areas[k]).min(f32::MAX as f64) as f32;
            match lamp {
                Lamp::Facet(Facet { glow, .. }) | Lamp::Disc(Disc { glow, .. }) => glow.density = density,
                Lamp::Point { intensity, .. } | Lamp::Spot { intensity, .. } => *intensity /= p as f32,
                Lamp::Sun { irradiance, .. } => *irradiance /= p as f32,
                Lamp::Map { map, pick } => {
                    *pick = p as f32;
                    map_picks[*map as usize] = p as f32;
                }
            }
        }
        let Collector { lamps, sky, maps, .. } = self;
        Lamps { lamps, pick, of_triangle, floating, sky, maps, map_picks }
    }
}
