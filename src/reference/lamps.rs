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
    scene::RAY_OFFSET,
    trace::{self, Geometry, Hit, RayBatch, RayTracer},
};

mod collect;

use collect::{Collector, is_light};

/// No lamp.
pub(super) const NO_LAMP: u32 = u32::MAX;

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
