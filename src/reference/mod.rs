//! A reference to measure bakes against: unbiased path tracing of the irradiance at surface points.
//!
//! It shares the scene and the ray tracer with the baker, and nothing else: no patches, no form factors, no
//! interpolation, no closed forms of lamps. Paths start at the point, are cosine-distributed, look for a lamp at every vertex
//! (next-event estimation) and end by Russian roulette alone, however long that takes.
//!
//! The model is the baker's: diffuse surfaces, whose albedo is read at the hit; triangles that emit their mean
//! radiance; lights that are no surfaces block no rays; the back of a one-sided surface is black. (The baker leaves out
//! rays that end on such backs instead, because its patches may reach into objects; a point of a visible surface meets
//! them only where surfaces are neither solids nor rooms.)

use std::{
    sync::Mutex,
    time::{Duration, Instant},
};

use glam::{DVec3, Vec3};
use rayon::prelude::*;

mod lamps;
mod numbers;
mod pick;
mod sky;
mod statistics;
mod surfaces;
mod walk;

use lamps::Lamps;
use numbers::{MOST_STRATIFIED, Shift, Table};
use statistics::Sums;
use surfaces::Surfaces;
use walk::{Light, Tally, Walk, World};

use crate::{
    Error, Result, Scene,
    progress::{self, Progress},
    reconstruct,
    scene::SurfacePoint,
    trace::RayTracer,
};

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// After this many paths a point (2 at least), rounded up to replicates of one size.
    Samples(u32),
    /// When the standard error of the total luminance, root mean square over the points, is below `relative` times
    /// its mean; after `most` paths a point in any case.
    StandardError {
        /// Relative standard error, above 0.
        relative: f64,
        /// Paths a point at most; 64 at least.
        most: u32,
    },
}

/// How to trace.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceOptions {
    /// When to stop.
    pub until: Until,
    /// Of all random numbers.
    pub seed: u64,
}

/// Irradiance at points with its standard errors (one sigma, of the means), W/m2; one entry a point, bands apart.
///
/// The errors come from independent randomised replicates, so that they hold for stratified samples too; see
/// [`Reference::degrees_of_freedom`]. Points that are not finite or have no unit normal have zero everywhere.
#[derive(Clone, Debug, Default)]
pub struct Reference {
    /// Straight from lights.
    pub direct: Vec<Vec3>,
    /// After at least one reflection.
    pub indirect: Vec<Vec3>,
    /// Standard error of `direct`.
    pub direct_error: Vec<Vec3>,
    /// Standard error of `indirect`.
    pub indirect_error: Vec<Vec3>,
    /// Standard error of their sum.
    pub total_error: Vec<Vec3>,
    /// Standard error of the luminance of `direct`.
    pub direct_luminance_error: Vec<f64>,
    /// Standard error of the luminance of `indirect`.
    pub indirect_luminance_error: Vec<f64>,
    /// Standard error of the luminance of their sum.
    pub luminance_error: Vec<f64>,
    /// Paths a point.
    pub samples: u32,
    /// Of each of the standard errors: their own relative error is about 1 / sqrt(2 x degrees of freedom).
    pub degrees_of_freedom: f64,
    /// Root mean square of `luminance_error` over the mean luminance; 0 where all is black.
    pub relative_error: f64,
    /// Whether the standard error that was asked for was reached; true where none was.
    pub converged: bool,
    /// Rays traced, shadow rays among them.
    pub rays: u64,
    /// Rays that met nothing.
    pub escaped: u64,
    /// Rays that ended on the black back of a one-sided surface.
    pub hidden: u64,
    /// Wall time.
    pub seconds: f64,
    /// Of it spent in the ray tracer, summed over the threads.
    pub tracing_seconds: f64,
    /// Spent walking (tracing included), summed over the threads.
    pub walking_seconds: f64,
}

/// Replicates a round.
const REPLICATES: u32 = 16;
/// Paths a replicate of the first round when a standard error is asked for.
const PILOT: u32 = 4;
/// Paths that are under way together.
const BATCH: usize = 2048;
/// Replicates, of all their points, that are held in memory together.
const BLOCK: usize = 1 << 15;

/// Irradiance at `points`, by path tracing; a point in the very edge of the mesh is lit from slightly inside, as by
/// [`crate::bake::Bake::irradiance`]. `tracer` holds the geometry of `scene`.
///
/// Same seed, same bits, on any number of threads (but for the times). Stopping at a standard error makes the estimate very
/// slightly biased (by the noise of the error's own estimate); a given number of samples does not.
///
/// # Errors
/// [`Error::Option`] for options without sense; [`Error::Backend`] if lamps that are no surfaces cannot be traced;
/// [`Error::Interrupted`] if `progress` asks to stop.
pub fn irradiance(
    scene: &Scene,
    tracer: &dyn RayTracer,
    points: &[SurfacePoint],
    options: &ReferenceOptions,
    progress: &dyn Progress,
) -> Result<Reference> {
    check(options)?;
    let begun = Instant::now();
    let lamps = Lamps::new(scene)?;
    let surfaces = Surfaces::new(scene, &lamps.of_triangle);
    let points = reconstruct::clear_of_walls(tracer, &scene.normals(), points);
    let mut tracing = Tracing {
        tracer,
        surfaces,
        lamps,
        sound: (0..points.len() as u32).filter(|&i| points[i as usize].is_sound()).collect(),
        points,
        seed: options.seed,
        rounds: 0,
        walks: Mutex::default(),
        sums: Vec::new(),
        tally: Tally::default(),
        walking: Duration::ZERO,
        progress,
    };
    tracing.sums = vec![Sums::default(); tracing.sound.len()];
    let converged = match options.until {
        Until::Samples(n) => {
            let (replicates, each) = rounds_of(n);
            progress.begin("path tracing", tracing.paths(replicates * each));
            tracing.round(replicates, each);
            progress.end();
            true
        }
        Until::StandardError { relative, most } => tracing.until(relative, most),
    };
    progress::go_on(progress, "path tracing")?;
    Ok(tracing.finish(converged, begun))
}

/// `scene`, if it has surfaces and light.
///
/// # Errors
/// [`Error::Scene`] with what is missing.
pub fn check_scene(scene: &Scene) -> Result<&Scene> {
    if scene.triangles.is_empty() {
        return Err(Error::Scene(format!("scene \"{}\" has no geometry", scene.name)));
    }
    if scene.has_light() { Ok(scene) } else { Err(Error::Scene(scene.no_light_message())) }
}

fn check(options: &ReferenceOptions) -> Result<()> {
    match options.until {
        Until::Samples(n) if n < 2 => {
            Err(Error::Option(format!("{n} paths a point: at least 2 are needed to tell their error")))
        }
        Until::StandardError { relative, .. } if !(relative > 0.0 && relative.is_finite()) => {
            Err(Error::Option(format!("a standard error of {relative} cannot be reached: it must be above 0")))
        }
        Until::StandardError { most, .. } if most < REPLICATES * PILOT => {
            Err(Error::Option(format!("{most} paths a point at most: at least {} are needed", REPLICATES * PILOT)))
        }
        _ => Ok(()),
    }
}

/// Replicates and paths a replicate for `samples` paths in one round.
fn rounds_of(samples: u32) -> (u32, u32) {
    let replicates = samples.min(REPLICATES).max(samples.div_ceil(MOST_STRATIFIED));
    (replicates, samples.div_ceil(replicates))
}

/// A reference under way.
struct Tracing<'a> {
    tracer: &'a dyn RayTracer,
    surfaces: Surfaces<'a>,
    lamps: Lamps,
    points: Vec<SurfacePoint>,
    /// Points that can be lit.
    sound: Vec<u32>,
    seed: u64,
    rounds: u64,
    /// Working memory that is not in use.
    walks: Mutex<Vec<Walk>>,
    /// Of the sound points.
    sums: Vec<Sums>,
    tally: Tally,
    walking: Duration,
    progress: &'a dyn Progress,
}

impl Tracing<'_> {
    /// Paths of all points at `samples` each.
    fn paths(&self, samples: u32) -> u64 {
        samples as u64 * self.sound.len() as u64
    }

    /// Rounds until the standard error is reached; whether it is.
    fn until(&mut self, relative: f64, most: u32) -> bool {
        let mut samples = REPLICATES * PILOT;
        self.progress.begin("first paths", self.paths(samples));
        self.round(REPLICATES, PILOT);
        self.progress.end();
        loop {
            let now = self.relative_error();
            if now <= relative || samples >= most || self.progress.stopped() {
                return now <= relative;
            }
            // A tenth more than needed, if errors fall by the root; they fall faster where strata help. From few
            // samples the error itself is not well known: no round is larger than 16 times all before.
            let needed = 1.1 * samples as f64 * (now / relative).powi(2) - samples as f64;
            let next = needed.clamp(0.25 * samples as f64, 16.0 * samples as f64) as u32;
            let (replicates, each) = rounds_of(next.min(most - samples).max(REPLICATES));
            self.progress.begin(&format!("paths, round {}", self.rounds + 1), self.paths(replicates * each));
            self.round(replicates, each);
            self.progress.end();
            samples += replicates * each;
        }
    }

    /// `replicates` independent sets of `each` paths for every point.
    fn round(&mut self, replicates: u32, each: u32) {
        let table = Table::new(each, crate::sampling::hash(&[self.seed, self.rounds]));
        let world = World { tracer: self.tracer, surfaces: &self.surfaces, lamps: &self.lamps, table: &table };
        let per_batch = (BATCH / each as usize).max(1);
        let (walks, seed, round) = (&self.walks, self.seed, self.rounds);
        let block = (BLOCK / replicates as usize).max(1);
        let mut lights = vec![Light::default(); self.sound.len().min(block) * replicates as usize];
        for (sound, sums) in self.sound.chunks(block).zip(self.sums.chunks_mut(block)) {
            let lights = &mut lights[..sound.len() * replicates as usize];
            lights.fill(Light::default());
            let (tally, walking) = lights
                .par_chunks_mut(per_batch)
                .enumerate()
                .map(|(batch, light)| {
                    if self.progress.stopped() {
                        return Default::default();
                    }
                    let begun = Instant::now();
                    let mut walk = lock(walks).pop().unwrap_or_default();
                    let slots = batch * per_batch..batch * per_batch + light.len();
                    let of = |slot: usize| (sound[slot / replicates as usize], (slot % replicates as usize) as u64);
                    let receivers: Vec<SurfacePoint> =
                        slots.clone().map(|slot| self.points[of(slot).0 as usize]).collect();
                    let shift = |slot| Shift::new(&[seed, round, of(slot).0 as u64, of(slot).1]);
                    let shifts: Vec<Shift> = slots.map(shift).collect();
                    let tally = walk.run(&world, &receivers, &shifts, light);
                    lock(walks).push(walk);
                    self.progress.advance(receivers.len() as u64 * each as u64);
                    (tally, begun.elapsed())
                })
                .reduce(Default::default, |a, b| (a.0 + b.0, a.1 + b.1));
            self.tally = self.tally + tally;
            self.walking += walking;
            sums.par_iter_mut()
                .zip(lights.par_chunks(replicates as usize))
                .for_each(|(sums, lights)| sums.add_round(lights, each));
        }
        self.rounds += 1;
    }

    fn relative_error(&self) -> f64 {
        let (mut mean, mut square) = (0.0, 0.0);
        for sums in &self.sums {
            mean += sums.luminance();
            square += sums.luminance_errors()[2].powi(2);
        }
        let n = self.sums.len().max(1) as f64;
        if mean > 0.0 { (square / n).sqrt() / (mean / n) } else { 0.0 }
    }

    fn finish(self, converged: bool, begun: Instant) -> Reference {
        let none = vec![Vec3::ZERO; self.points.len()];
        let mut r = Reference {
            direct: none.clone(),
            indirect: none.clone(),
            direct_error: none.clone(),
            indirect_error: none.clone(),
            total_error: none,
            direct_luminance_error: vec![0.0; self.points.len()],
            indirect_luminance_error: vec![0.0; self.points.len()],
            luminance_error: vec![0.0; self.points.len()],
            samples: self.sums.first().map_or(0, |s| s.samples() as u32),
            degrees_of_freedom: self.sums.first().map_or(0.0, Sums::degrees_of_freedom),
            relative_error: self.relative_error(),
            converged,
            rays: self.tally.rays,
            escaped: self.tally.escaped,
            hidden: self.tally.hidden,
            seconds: 0.0,
            tracing_seconds: self.tally.tracing.as_secs_f64(),
            walking_seconds: self.walking.as_secs_f64(),
        };
        let single = |v: [f64; 3]| DVec3::from(v).as_vec3();
        for (&i, sums) in self.sound.iter().zip(&self.sums) {
            let i = i as usize;
            r.direct[i] = single(sums.direct());
            r.indirect[i] = single(sums.indirect());
            r.direct_error[i] = single(sums.direct_error());
            r.indirect_error[i] = single(sums.indirect_error());
            r.total_error[i] = single(sums.total_error());
            [r.direct_luminance_error[i], r.indirect_luminance_error[i], r.luminance_error[i]] =
                sums.luminance_errors();
        }
        r.seconds = begun.elapsed().as_secs_f64();
        r
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    // Working memory is no data: what a thread that died left of it is as good as new.
    mutex.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}
