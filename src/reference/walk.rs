//! Paths, bounce by bounce in batches: the ray tracer gets thousands of rays a call, and nothing is allocated between.

use std::time::{Duration, Instant};

use glam::Vec3;

use super::{
    lamps::{Crossing, Lamps, set_ray},
    numbers::{Draws, Identities, Shift, Table, on_sphere},
    surfaces::Surfaces,
};
use crate::{
    scene::{RAY_OFFSET, SurfacePoint},
    trace::{Hit, RayBatch, RayTracer},
};

/// Light that paths brought to one receiver: the sum over its samples. Direct, then indirect; three bands each.
pub(super) type Light = [f64; 6];

/// What happened on the way.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    /// Rays traced, of both kinds.
    pub rays: u64,
    /// Rays that met nothing.
    pub escaped: u64,
    /// Rays that ended on the back of a one-sided surface.
    pub hidden: u64,
    /// Spent in the ray tracer.
    pub tracing: Duration,
}

impl std::ops::Add for Tally {
    type Output = Tally;

    fn add(self, other: Tally) -> Tally {
        Tally {
            rays: self.rays + other.rays,
            escaped: self.escaped + other.escaped,
            hidden: self.hidden + other.hidden,
            tracing: self.tracing + other.tracing,
        }
    }
}

/// What all walks share.
#[derive(Clone, Copy)]
pub(super) struct World<'a> {
    pub tracer: &'a dyn RayTracer,
    pub surfaces: &'a Surfaces<'a>,
    pub lamps: &'a Lamps,
    pub table: &'a Table,
}

/// Vertices of paths that are under way.
#[derive(Default)]
struct Vertices {
    /// Where rays start.
    origin: Vec<Vec3>,
    normal: Vec<Vec3>,
    /// What light that arrives here is worth at the receiver, at most 1.
    weight: Vec<Vec3>,
    slot: Vec<u32>,
    sample: Vec<u32>,
    key: Vec<u32>,
}

impl Vertices {
    fn clear(&mut self) {
        self.origin.clear();
        self.normal.clear();
        self.weight.clear();
        self.slot.clear();
        self.sample.clear();
        self.key.clear();
    }

    fn len(&self) -> usize {
        self.slot.len()
    }

    #[inline]
    fn push(&mut self, origin: Vec3, normal: Vec3, weight: Vec3, [slot, sample, key]: [u32; 3]) {
        self.origin.push(origin);
        self.normal.push(normal);
        self.weight.push(weight);
        self.slot.push(slot);
        self.sample.push(sample);
        self.key.push(key);
    }

    fn identities(&self) -> Identities<'_> {
        Identities { slot: &self.slot, sample: &self.sample, key: &self.key }
    }
}

/// Working memory of one thread.
#[derive(Default)]
pub(super) struct Walk {
    /// Paths that go on, and the vertices that they come to.
    paths: Vertices,
    next: Vertices,
    /// Paths that end here, and those that will at the next vertex; both still look for light once.
    ending: Vertices,
    next_ending: Vertices,
    draws: Draws,
    rays: RayBatch,
    hits: Vec<Hit>,
    shadow: RayBatch,
    occluded: Vec<bool>,
    /// What an unblocked shadow ray brings.
    brought: Vec<Vec3>,
    brought_to: Vec<u32>,
    crossing: Crossing,
    tally: Tally,
}

impl Walk {
    /// Walks all samples of the table from every one of `receivers` (each with its own shift), and adds what they bring
    /// to `light`.
    pub fn run(&mut self, world: &World, receivers: &[SurfacePoint], shifts: &[Shift], light: &mut [Light]) -> Tally {
        self.tally = Tally::default();
        self.paths.clear();
        self.ending.clear();
        for (slot, (point, shift)) in receivers.iter().zip(shifts).enumerate() {
            let origin = point.position + RAY_OFFSET * point.normal;
            for k in 0..world.table.len() as u32 {
                self.paths.push(origin, point.normal, Vec3::ONE, [slot as u32, k, shift.key(k)]);
            }
        }
        let mut bounce = 0;
        loop {
            self.look(world, shifts, bounce, light);
            if self.paths.len() == 0 {
                return self.tally;
            }
            self.go(world, shifts, bounce);
            self.arrive(world, bounce, light);
            std::mem::swap(&mut self.paths, &mut self.next);
            std::mem::swap(&mut self.ending, &mut self.next_ending);
            bounce += 1;
        }
    }

    /// Shadow rays from all vertices.
    fn look(&mut self, world: &World, shifts: &[Shift], bounce: u32, light: &mut [Light]) {
        self.shadow.clear();
        self.brought.clear();
        self.brought_to.clear();
        for vertices in [&self.paths, &self.ending] {
            self.draws.lamps(&vertices.identities(), bounce, world.table, shifts);
            let [u, v] = &self.draws.lamp;
            for i in 0..vertices.len() {
                let Some(look) = world.lamps.look(vertices.origin[i], vertices.normal[i], u[i], v[i]) else { continue };
                let brought = vertices.weight[i] * look.irradiance;
                if brought != Vec3::ZERO {
                    self.shadow.push(vertices.origin[i], look.direction, 0.0, look.t_max);
                    self.brought.push(brought);
                    self.brought_to.push(vertices.slot[i]);
                }
            }
        }
        let n = self.shadow.len();
        self.occluded.resize(n, false);
        // The first rays of a receiver start at one point.
        self.shadow.coherent = bounce == 0;
        let begun = Instant::now();
        world.tracer.occluded(&self.shadow, &mut self.occluded);
        self.tally.tracing += begun.elapsed();
        self.tally.rays += n as u64;
        let first = if bounce == 0 { 0 } else { 3 };
        for ((&slot, brought), &occluded) in self.brought_to.iter().zip(&self.brought).zip(&self.occluded) {
            if !occluded {
                add(&mut light[slot as usize], first, *brought);
            }
        }
    }

    /// Sends every path on, cosine-distributed: along its normal plus a point of the unit sphere.
    fn go(&mut self, world: &World, shifts: &[Shift], bounce: u32) {
        let n = self.paths.len();
        // A path goes on with the probability of its largest weight, which thereby becomes 1.
        self.paths.weight.iter_mut().for_each(|w| *w /= w.max_element());
        let paths = &self.paths;
        self.draws.directions(&paths.identities(), bounce, world.table, shifts);
        let [u, v] = &self.draws.direction;
        self.rays.resize(n);
        for i in 0..n {
            let direction = paths.normal[i] + Vec3::from_array(on_sphere(u[i], v[i]));
            set_ray(&mut self.rays, i, paths.origin[i], direction, 0.0, f32::INFINITY);
        }
        self.rays.coherent = bounce == 0;
        self.hits.resize(n, Hit::NONE);
        let begun = Instant::now();
        world.tracer.closest_hits(&self.rays, &mut self.hits);
        self.tally.tracing += begun.elapsed();
        self.tally.rays += n as u64;
    }

    /// What paths meet, and which of them go on.
    fn arrive(&mut self, world: &World, bounce: u32, light: &mut [Light]) {
        let (paths, rays) = (&self.paths, &self.rays);
        let first = if bounce == 0 { 0 } else { 3 };
        if world.lamps.has_floating() {
            world.lamps.meet_floating(rays, &self.hits, &mut self.crossing, |i, brought| {
                add(&mut light[paths.slot[i] as usize], first, paths.weight[i] * brought);
            });
        }
        self.next.clear();
        self.next_ending.clear();
        let sky = world.lamps.has_sky();
        for (i, hit) in self.hits.iter().enumerate() {
            let (weight, slot) = (paths.weight[i], paths.slot[i]);
            if !hit.is_hit() {
                self.tally.escaped += 1;
                if sky {
                    add(&mut light[slot as usize], first, weight * world.lamps.sky(rays.direction(i)));
                }
                continue;
            }
            if let Some((lamp, facing)) = world.surfaces.lamp(hit, rays.direction(i)) {
                let brought = world.lamps.met(lamp, hit.t, rays.direction(i), facing);
                add(&mut light[slot as usize], first, weight * brought);
            }
            let Some(met) = world.surfaces.met(hit, rays, i) else {
                self.tally.hidden += 1;
                continue;
            };
            let weight = weight * met.albedo;
            let go_on = weight.max_element();
            let identity = [slot, paths.sample[i], paths.key[i]];
            if super::numbers::fraction(self.draws.roulette[i]) < go_on {
                self.next.push(met.origin, met.normal, weight, identity);
            } else if go_on > 0.0 {
                self.next_ending.push(met.origin, met.normal, weight, identity);
            }
        }
    }
}

#[inline]
fn add(light: &mut Light, first: usize, brought: Vec3) {
    light[first] += brought.x as f64;
    light[first + 1] += brought.y as f64;
    light[first + 2] += brought.z as f64;
}
