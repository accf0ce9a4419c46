//! The lights as paths look for them: one lamp a vertex, picked by its power, one point of it by area.
//!
//! A lamp that has an extent is also found by paths that happen to meet it. Both are weighed by the power heuristic
//! (Veach 1997, section 9.2, exponent 2), written with k = density of looking / density of meeting: by looking a
//! vertex gets pi L k / (1 + k^2), by meeting pi L / (1 + k^2); both are bounded, however near the lamp is.

use std::f32::consts::PI;

use glam::{Vec3, Vec3A};

use super::{numbers::fraction, pick::Pick, sky::Map};
use crate::{
    Result, Scene,
    options::Backend,
    sampling,
    scene::{Light, RAY_OFFSET},
    trace::{self, Geometry, Hit, RayBatch, RayTracer},
};

/// No lamp.
pub(super) const NO_LAMP: u32 = u32::MAX;

/// Share of the picks that goes to all lamps alike: no lamp is picked so seldom that its light is missed.
const EVENLY: f64 = 0.25;

/// A lamp, its colour divided by the probability of its pick where it has no extent.
enum Lamp {
    Facet(Facet),
    Disc(Disc),
    Point { position: Vec3, range: f32, intensity: Vec3 },
    Spot { position: Vec3, direction: Vec3, cos_inner: f32, cos_outer: f32, range: f32, intensity: Vec3 },
    Sun { direction: Vec3, irradiance: Vec3 },
    Map { map: u32, pick: f32 },
}

/// A triangle that glows on its front.
#[derive(Clone, Copy)]
struct Facet {
    /// One corner, as far off the surface as rays start: rays end there.
    corner: Vec3A,
    u: Vec3A,
    v: Vec3A,
    normal: Vec3A,
    glow: Glow,
}

/// A disc that glows on its front.
#[derive(Clone, Copy)]
struct Disc {
    /// As far off the disc as rays start.
    centre: Vec3,
    normal: Vec3A,
    radius: f32,
    glow: Glow,
}

/// What a lamp with an extent gives.
#[derive(Clone, Copy)]
struct Glow {
    /// pi times the radiance.
    exitance: Vec3A,
    /// pi times the density of its points among those looked for, by area.
    density: f32,
}

/// A way to light, as a vertex sees it.
pub(super) struct Look {
    /// Of the shadow ray; not a unit vector.
    pub direction: Vec3A,
    /// End of the shadow ray.
    pub t_max: f32,
    /// Irradiance if nothing is in the way, divided by the density of the choice.
    pub irradiance: Vec3A,
}

impl Look {
    const NOTHING: Look = Look { direction: Vec3A::ZERO, t_max: 0.0, irradiance: Vec3A::ZERO };
}

/// All lights of a scene.
pub(super) struct Lamps {
    lamps: Vec<Lamp>,
    pick: Pick,
    /// Of the front and back of every triangle.
    pub of_triangle: Vec<[u32; 2]>,
    /// Lamps that are no surfaces, but have an extent: paths meet them too, without an end.
    floating: Option<Floating>,
    /// Constant radiance of the sky.
    sky: Vec3,
    maps: Vec<Map>,
    map_picks: Vec<f32>,
}

/// The squares and triangles of floating lamps, to be met.
struct Floating {
    tracer: Box<dyn RayTracer>,
    lamp_of: Vec<u32>,
}

/// Working memory of [`Lamps::meet_floating`].
#[derive(Default)]
pub(super) struct Crossing {
    rays: RayBatch,
    hits: Vec<Hit>,
    /// Ray of the batch, for those that go on.
    of: Vec<u32>,
    limit: Vec<f32>,
}

impl Lamps {
    /// The lights of `scene`; those that are black, without extent or not finite are left out.
    ///
    /// # Errors
    /// [`crate::Error::Backend`] if floating lamps cannot be traced.
    pub fn new(scene: &Scene) -> Result<Lamps> {
        let mut lights = Collector::default();
        let mut of_triangle = vec![[NO_LAMP; 2]; scene.triangles.len()];
        for (t, of) in of_triangle.iter_mut().enumerate() {
            let radiance = scene.emission(t);
            if is_light(radiance) {
                let [a, b, c] = scene.corners_of(t);
                of[0] = lights.facet(a, b - a, c - a, radiance);
                if scene.triangles[t].emits_back {
                    of[1] = lights.facet(a, c - a, b - a, radiance);
                }
            }
        }
        let (mut geometry, mut lamp_of) = (Geometry::default(), Vec::new());
        // Power through the disc that holds the scene, for lights at infinity.
        let reach = scene.positions.iter().fold(0.0_f32, |r, p| r.max(p.length_squared())) as f64;
        let section = std::f64::consts::PI * reach;
        for light in scene.lights.iter() {
            lights.light(light, section, &mut geometry, &mut lamp_of);
        }
        let floating = if lamp_of.is_empty() {
            None
        } else {
            Some(Floating { tracer: trace::build(Backend::Auto, &geometry)?, lamp_of })
        };
        Ok(lights.finish(of_triangle, floating))
    }

    /// Whether rays that leave the scene bring light.
    pub fn has_sky(&self) -> bool {
        self.sky != Vec3::ZERO || !self.maps.is_empty()
    }

    /// Whether [`Lamps::meet_floating`] has anything to do.
    pub fn has_floating(&self) -> bool {
        self.floating.is_some()
    }

    /// Looks for light from `x` (off its surface) with unit normal `n`, by two random words. The irradiance is zero if the
    /// lamp that was picked gives nothing there.
    #[inline]
    pub fn look(&self, x: Vec3A, n: Vec3A, u: u32, v: u32) -> Look {
        let Some((lamp, u)) = self.pick.pick(u) else { return Look::NOTHING };
        let v = fraction(v);
        match &self.lamps[lamp as usize] {
            Lamp::Facet(f) => {
                // Folded at the diagonal, without a branch that would be taken half of the time.
                let fold = (u + v > 1.0) as i32 as f32;
                let (u, v) = (u + fold * (1.0 - 2.0 * u), v + fold * (1.0 - 2.0 * v));
                f.glow.look(f.corner + u * f.u + v * f.v - x, n, f.normal)
            }
            Lamp::Disc(d) => {
                let (e1, e2) = sampling::frame(d.normal.into());
                let at = sampling::concentric_disc(u, v) * d.radius;
                d.glow.look(Vec3A::from(d.centre + at.x * e1 + at.y * e2) - x, n, d.normal)
            }
            Lamp::Point { position, range, intensity } => from_point(Vec3A::from(*position) - x, n, *range, *intensity),
            Lamp::Spot { position, direction, cos_inner, cos_outer, range, intensity } => {
                let to_lamp = Vec3A::from(*position) - x;
                let cos = -to_lamp.normalize_or_zero().dot(Vec3A::from(*direction));
                let t = ((cos - cos_outer) / (cos_inner - cos_outer).max(1e-6)).clamp(0.0, 1.0);
                from_point(to_lamp, n, *range, t * t * *intensity)
            }
            Lamp::Sun { direction, irradiance } => {
                let direction = -Vec3A::from(*direction);
                let irradiance = n.dot(direction).max(0.0) * Vec3A::from(*irradiance);
                Look { direction, t_max: f32::INFINITY, irradiance }
            }
            Lamp::Map { map, pick } => {
                let map = &self.maps[*map as usize];
                let (direction, density) = map.sample(u, v);
                let cos = Vec3::from(n).dot(direction);
                if cos <= 0.0 || density <= 0.0 {
                    return Look::NOTHING;
                }
                let k = pick * density * PI / cos;
                let irradiance = PI * map.radiance(direction) * share(k);
                Look { direction: direction.into(), t_max: f32::INFINITY, irradiance: irradiance.into() }
            }
        }
    }

    /// pi times the radiance that a ray brings which met a glowing surface, weighed against looking for it.
    /// `direction` is the ray's: normal + point of the unit sphere; `facing` its product with the lamp's normal.
    #[inline]
    pub fn met(&self, lamp: u32, t: f32, direction: Vec3A, facing: f32) -> Vec3A {
        let glow = match &self.lamps[lamp as usize] {
            Lamp::Facet(f) => f.glow,
            Lamp::Disc(d) => d.glow,
            _ => return Vec3A::ZERO,
        };
        // The cosine at the start is half the length of the direction.
        let k = 2.0 * glow.density * t * t * direction.length_squared() / facing.max(f32::MIN_POSITIVE);
        glow.exitance / (1.0 + k * k)
    }

    /// pi times the radiance that a ray brings which met nothing; `direction` as in [`Lamps::met`].
    pub fn sky(&self, direction: Vec3A) -> Vec3A {
        let direction = Vec3::from(direction);
        let mut light = PI * self.sky;
        let length = direction.length();
        for (map, pick) in self.maps.iter().zip(&self.map_picks) {
            let unit = direction / length;
            let k = pick * map.density(unit) * PI / (0.5 * length);
            light += PI * map.radiance(unit) / (1.0 + k * k);
        }
        light.into()
    }

    /// What rays bring from the floating lamps that they cross before they end; `add` gets the ray and pi times the
    /// radiance, weighed against looking for it.
    pub fn meet_floating(&self, rays: &RayBatch, hits: &[Hit], c: &mut Crossing, mut add: impl FnMut(usize, Vec3A)) {
        let Some(floating) = &self.floating else { return };
        c.rays.clear();
        c.of.clear();
        c.limit.clear();
        for (i, hit) in hits.iter().enumerate() {
            let d = rays.direction(i);
            // A lamp that lies in a wall counts as before it, as it does to shadow rays.
            let margin = 64.0 * RAY_OFFSET / d.length();
            c.rays.push(rays.origin(i), d, 0.0, hit.t + margin);
            c.of.push(i as u32);
            c.limit.push(hit.t);
        }
        while !c.rays.is_empty() {
            c.hits.resize(c.rays.len(), Hit::NONE);
            floating.tracer.closest_hits(&c.rays, &mut c.hits);
            let mut kept = 0;
            for k in 0..c.hits.len() {
                let hit = c.hits[k];
                if !hit.is_hit() {
                    continue;
                }
                let (origin, direction) = (c.rays.origin(k), c.rays.direction(k));
                let lamp = floating.lamp_of[hit.triangle()];
                if !hit.is_back() && self.is_on(lamp, origin + hit.t * direction) {
                    let facing = self.normal(lamp).dot(direction.into()).abs();
                    if hit.t - RAY_OFFSET / facing <= c.limit[k] {
                        add(c.of[k] as usize, self.met(lamp, hit.t, direction.into(), facing));
                    }
                }
                let t_max = c.rays.t_max[k];
                set_ray(&mut c.rays, kept, origin, direction, hit.t, t_max);
                c.of[kept] = c.of[k];
                c.limit[kept] = c.limit[k];
                kept += 1;
            }
            c.rays.resize(kept);
            c.of.truncate(kept);
            c.limit.truncate(kept);
        }
    }

    /// Whether `x`, in the square around a lamp, is on it.
    fn is_on(&self, lamp: u32, x: Vec3) -> bool {
        match &self.lamps[lamp as usize] {
            Lamp::Disc(d) => {
                (x - d.centre).reject_from_normalized(d.normal.into()).length_squared() <= d.radius * d.radius
            }
            _ => true,
        }
    }

    fn normal(&self, lamp: u32) -> Vec3A {
        match &self.lamps[lamp as usize] {
            Lamp::Facet(f) => f.normal,
            Lamp::Disc(d) => d.normal,
            _ => Vec3A::ZERO,
        }
    }
}

/// Overwrites ray `i`.
#[inline]
fn set_ray(rays: &mut RayBatch, i: usize, origin: Vec3, direction: Vec3, t_min: f32, t_max: f32) {
    (rays.origin_x[i], rays.origin_y[i], rays.origin_z[i]) = origin.into();
    (rays.direction_x[i], rays.direction_y[i], rays.direction_z[i]) = direction.into();
    (rays.t_min[i], rays.t_max[i]) = (t_min, t_max);
}

/// k / (1 + k^2), also where k^2 leaves the range of f32.
fn share(k: f32) -> f32 {
    if k > 1.0 { 1.0 / (k + 1.0 / k) } else { k / (1.0 + k * k) }
}

impl Glow {
    /// A shadow ray along `d` to a point of a lamp with unit normal `m`.
    #[inline]
    fn look(&self, d: Vec3A, n: Vec3A, m: Vec3A) -> Look {
        let (here, there) = (n.dot(d), -m.dot(d));
        let r2 = d.length_squared();
        // k = far / near. Beyond 1e15 the heuristic's denominator is 1 to all digits, and its squares might overflow.
        let (near, far) = (here.max(0.0) * there.max(0.0), self.density * r2 * r2);
        let share = if far > 1e15 { near / far } else { near * far / (near * near + far * far).max(f32::MIN_POSITIVE) };
        Look { direction: d, t_max: 1.0, irradiance: self.exitance * share }
    }
}

/// cos / d^2 with the range window of KHR_lights_punctual. A light nearer than a ray's offset counts as that far.
fn from_point(to_lamp: Vec3A, n: Vec3A, range: f32, intensity: Vec3) -> Look {
    let cos = n.dot(to_lamp).max(0.0);
    let d2 = to_lamp.length_squared();
    if d2 == 0.0 {
        return Look::NOTHING;
    }
    let window = (1.0 - (d2 / (range * range)).powi(2)).clamp(0.0, 1.0);
    let irradiance = window * cos / (d2.sqrt() * d2.max(RAY_OFFSET * RAY_OFFSET)) * intensity;
    Look { direction: to_lamp, t_max: 1.0, irradiance: irradiance.into() }
}

fn is_light(colour: Vec3) -> bool {
    colour.is_finite() && colour.min_element() >= 0.0 && colour != Vec3::ZERO
}

fn mean(colour: Vec3) -> f64 {
    colour.to_array().iter().map(|&c| c as f64).sum::<f64>() / 3.0
}

/// Lamps before their probabilities are known.
#[derive(Default)]
struct Collector {
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
    fn facet(&mut self, corner: Vec3, u: Vec3, v: Vec3, radiance: Vec3) -> u32 {
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

    fn light(&mut self, light: &Light, section: f64, geometry: &mut Geometry, lamp_of: &mut Vec<u32>) {
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

    fn finish(mut self, of_triangle: Vec<[u32; 2]>, floating: Option<Floating>) -> Lamps {
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
