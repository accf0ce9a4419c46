//! Paths, bounce by bounce in batches: the ray tracer gets thousands of rays a call, and nothing is allocated between.

use std::time::{Duration, Instant};

use glam::{BVec3A, DVec3, Vec3A};

use super::{
    lamps::{Crossing, Lamps},
    numbers::{Decision, Identity, Numbers, Shift, Table, fraction, on_sphere},
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

/// Where a path is.
#[derive(Clone, Copy, Default)]
struct Vertex {
    /// Where rays start.
    origin: Vec3A,
    /// Unit normal of the side that they leave.
    normal: Vec3A,
    /// What light that arrives here is worth at the receiver, at most 1.
    weight: Vec3A,
    path: Identity,
}

/// Vertices of a batch: those of paths that go on stand in front, those of paths that end there at the back.
#[derive(Default)]
struct Vertices {
    all: Vec<Vertex>,
    going: usize,
    ending: usize,
}

impl Vertices {
    fn begin(&mut self, most: usize) {
        self.all.resize(most, Vertex::default());
        (self.going, self.ending) = (0, 0);
    }

    /// Adds a vertex, to one end or the other without a branch, which nobody could foresee.
    #[inline]
    fn push(&mut self, vertex: Vertex, goes_on: bool) {
        let at = if goes_on { self.going } else { self.all.len() - 1 - self.ending };
        self.all[at] = vertex;
        self.going += goes_on as usize;
        self.ending += !goes_on as usize;
    }

    fn going(&self) -> &[Vertex] {
        &self.all[..self.going]
    }

    fn ending(&self) -> &[Vertex] {
        &self.all[self.all.len() - self.ending..]
    }
}

/// Smallest weight (of the largest band) with which paths always go on. At 1 the walk is that of photons, at 0 it has no
/// end. Cornell box, variance x time: 1.69 at 1, 1.58 at 0.7, 1.62 at 0.5, 1.73 at 0.25, 1.83 at 0.1.
const ALWAYS: f32 = 0.5;

/// Working memory of one thread.
#[derive(Default)]
pub(super) struct Walk {
    /// Where paths are, and where they come to.
    here: Vertices,
    next: Vertices,
    rays: RayBatch,
    hits: Vec<Hit>,
    /// Random words of the directions.
    words: [Vec<u32>; 2],
    shadow: RayBatch,
    occluded: Vec<bool>,
    /// What an unblocked shadow ray brings, and to whom.
    brought: Vec<(Vec3A, u32)>,
    crossing: Crossing,
    tally: Tally,
}

impl Walk {
    /// Walks all samples of the table from every one of `receivers`, each with its own shift, and adds what they bring
    /// to `light`.
    pub fn run(&mut self, world: &World, receivers: &[SurfacePoint], shifts: &[Shift], light: &mut [Light]) -> Tally {
        self.tally = Tally::default();
        self.here.begin(receivers.len() * world.table.len());
        for (slot, (point, shift)) in receivers.iter().zip(shifts).enumerate() {
            let origin = (point.position + RAY_OFFSET * point.normal).into();
            let normal = point.normal.into();
            for k in 0..world.table.len() as u32 {
                let path = Identity { slot: slot as u32, sample: k, key: shift.key(k) };
                self.here.push(Vertex { origin, normal, weight: Vec3A::ONE, path }, true);
            }
        }
        let mut numbers = Numbers { table: world.table, shifts, bounce: 0 };
        loop {
            self.look(world, &numbers);
            self.collect(world, numbers.bounce, light);
            if self.here.going == 0 {
                return self.tally;
            }
            self.go(world, &numbers);
            self.arrive(world, &numbers, light);
            std::mem::swap(&mut self.here, &mut self.next);
            numbers.bounce += 1;
        }
    }

    /// Shadow rays from all vertices.
    fn look(&mut self, world: &World, numbers: &Numbers) {
        let n = self.here.going + self.here.ending;
        self.shadow.resize(n);
        self.brought.resize(n, Default::default());
        // Slices of one known length: no bounds are checked inside the loop but that of `m`.
        let [ox, oy, oz] =
            [&mut self.shadow.origin_x, &mut self.shadow.origin_y, &mut self.shadow.origin_z].map(|v| &mut v[..n]);
        let [dx, dy, dz] = [&mut self.shadow.direction_x, &mut self.shadow.direction_y, &mut self.shadow.direction_z]
            .map(|v| &mut v[..n]);
        let (t_max, brought) = (&mut self.shadow.t_max[..n], &mut self.brought[..n]);
        let mut m = 0;
        for vertices in [self.here.going(), self.here.ending()] {
            for vertex in vertices {
                if m >= n {
                    break;
                }
                let u = numbers.word(&vertex.path, Decision::Lamp);
                let v = numbers.word(&vertex.path, Decision::LampToo);
                let look = world.lamps.look(vertex.origin, vertex.normal, u, v);
                let light = vertex.weight * look.irradiance;
                (ox[m], oy[m], oz[m]) = vertex.origin.into();
                (dx[m], dy[m], dz[m]) = look.direction.into();
                t_max[m] = look.t_max;
                brought[m] = (light, vertex.path.slot);
                // The next one takes the place of a ray that brings nothing.
                m += (light.max_element() > 0.0) as usize;
            }
        }
        self.shadow.resize(m);
        self.brought.truncate(m);
    }

    /// Traces the shadow rays and adds up what arrives.
    fn collect(&mut self, world: &World, bounce: u32, light: &mut [Light]) {
        let n = self.shadow.len();
        self.occluded.resize(n, false);
        // The first rays of a receiver start at one point.
        self.shadow.coherent = bounce == 0;
        let begun = Instant::now();
        world.tracer.occluded(&self.shadow, &mut self.occluded);
        self.tally.tracing += begun.elapsed();
        self.tally.rays += n as u64;
        let first = first_of(bounce);
        // Paths of a receiver stand together.
        let (mut slot, mut sum) = (0, DVec3::ZERO);
        for (&(brought, to), &occluded) in self.brought.iter().zip(&self.occluded) {
            if to != slot {
                add(&mut light[slot as usize], first, sum);
                (slot, sum) = (to, DVec3::ZERO);
            }
            // No branch, which nobody could foresee.
            sum += Vec3A::select(BVec3A::splat(occluded), Vec3A::ZERO, brought).as_dvec3();
        }
        add(&mut light[slot as usize], first, sum);
    }

    /// Sends the paths that go on, cosine-distributed: along the normal plus a point of the unit sphere.
    fn go(&mut self, world: &World, numbers: &Numbers) {
        let n = self.here.going;
        self.rays.resize(n);
        let [u, v] = &mut self.words;
        u.resize(n, 0);
        v.resize(n, 0);
        let (u, v) = (&mut u[..n], &mut v[..n]);
        let [ox, oy, oz] =
            [&mut self.rays.origin_x, &mut self.rays.origin_y, &mut self.rays.origin_z].map(|v| &mut v[..n]);
        let [dx, dy, dz] =
            [&mut self.rays.direction_x, &mut self.rays.direction_y, &mut self.rays.direction_z].map(|v| &mut v[..n]);
        for (i, vertex) in self.here.all[..n].iter_mut().enumerate() {
            // What went on with less than certainty stands for what did not.
            vertex.weight *= (ALWAYS / vertex.weight.max_element()).max(1.0);
            (ox[i], oy[i], oz[i]) = vertex.origin.into();
            (dx[i], dy[i], dz[i]) = vertex.normal.into();
            u[i] = numbers.word(&vertex.path, Decision::Direction);
            v[i] = numbers.word(&vertex.path, Decision::DirectionToo);
        }
        for i in 0..n {
            let [x, y, z] = on_sphere(u[i], v[i]);
            dx[i] += x;
            dy[i] += y;
            dz[i] += z;
        }
        self.rays.t_max[..n].fill(f32::INFINITY);
        self.rays.coherent = numbers.bounce == 0;
        self.hits.resize(n, Hit::NONE);
        let begun = Instant::now();
        world.tracer.closest_hits(&self.rays, &mut self.hits);
        self.tally.tracing += begun.elapsed();
        self.tally.rays += n as u64;
    }

    /// What paths meet, and which of them go on from there.
    fn arrive(&mut self, world: &World, numbers: &Numbers, light: &mut [Light]) {
        let n = self.here.going;
        let (paths, rays) = (self.here.going(), &self.rays);
        let first = first_of(numbers.bounce);
        if world.lamps.has_floating() {
            world.lamps.meet_floating(rays, &self.hits, &mut self.crossing, |i, brought| {
                add(&mut light[paths[i].path.slot as usize], first, (paths[i].weight * brought).as_dvec3());
            });
        }
        self.next.begin(n);
        let sky = world.lamps.has_sky();
        let [ox, oy, oz] = [&rays.origin_x, &rays.origin_y, &rays.origin_z].map(|v| &v[..n]);
        let [dx, dy, dz] = [&rays.direction_x, &rays.direction_y, &rays.direction_z].map(|v| &v[..n]);
        let hits = &self.hits[..n];
        for (i, vertex) in paths.iter().enumerate() {
            let (hit, direction) = (&hits[i], Vec3A::new(dx[i], dy[i], dz[i]));
            if !hit.is_hit() {
                self.tally.escaped += 1;
                if sky {
                    let brought = vertex.weight * world.lamps.sky(direction);
                    add(&mut light[vertex.path.slot as usize], first, brought.as_dvec3());
                }
                continue;
            }
            if let Some((lamp, facing)) = world.surfaces.lamp(hit, direction) {
                let brought = vertex.weight * world.lamps.met(lamp, hit.t, direction, facing);
                add(&mut light[vertex.path.slot as usize], first, brought.as_dvec3());
            }
            let Some(met) = world.surfaces.met(hit, Vec3A::new(ox[i], oy[i], oz[i]), direction) else {
                self.tally.hidden += 1;
                continue;
            };
            let weight = vertex.weight * met.albedo;
            let largest = weight.max_element();
            if largest > 0.0 {
                let roulette = fraction(numbers.word(&vertex.path, Decision::Roulette));
                let next = Vertex { origin: met.origin, normal: met.normal, weight, path: vertex.path };
                self.next.push(next, roulette * ALWAYS < largest);
            }
        }
    }
}

/// Where in [`Light`] belongs what comes in at a vertex.
fn first_of(bounce: u32) -> usize {
    if bounce == 0 { 0 } else { 3 }
}

#[inline]
fn add(light: &mut Light, first: usize, brought: DVec3) {
    light[first] += brought.x;
    light[first + 1] += brought.y;
    light[first + 2] += brought.z;
}
