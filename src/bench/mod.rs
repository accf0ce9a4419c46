//! Error against time: bakes with many settings, and path tracing, measured against a converged reference.

use std::{path::Path, time::Instant};

use crate::{
    Result, Scene,
    bake::Irradiance,
    colour::luminance,
    compare::{Difference, difference},
    options::{Backend, PatchSource},
    progress::{self, Hushed, Progress},
    reference::{self, ReferenceOptions, Until},
    scene::SurfacePoint,
    trace::{self, RayTracer},
};

mod cache;
mod growth;
mod machine;
mod pareto;
mod plot;
mod points;
mod suite;
mod sweep;
mod table;

pub use cache::Truth;
pub use growth::{Growth, growth_svg};
pub use machine::Machine;
pub use plot::svg;
pub use suite::{SUITE, SuiteScene};
pub use sweep::{Configuration, Extent, PATHS, configurations};
pub use table::{csv, markdown};

/// How much is measured, and how well.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Which configurations.
    pub extent: Extent,
    /// Points where errors are measured.
    pub points: usize,
    /// Points that times are told for: a bake plus the light of so many points, or so many points path-traced.
    pub job: usize,
    /// Runs of each configuration; their median counts. What takes long runs once.
    pub repeats: usize,
    /// Bakes that are foretold to take longer are left out, seconds.
    pub limit: f64,
    /// Standard error that the reference aims at, relative.
    pub reference_error: f64,
    /// Paths a point of the reference at most.
    pub most_paths: u32,
    /// Of all random numbers; the curves take others than the reference.
    pub seed: u64,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            extent: Extent::Quick,
            points: 1000,
            job: 100_000,
            repeats: 3,
            limit: 20.0,
            reference_error: 0.005,
            most_paths: 65536,
            seed: 0,
        }
    }
}

/// How the light of an entry came about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Method {
    /// A bake.
    Bake(Configuration),
    /// So many paths a point.
    Paths(u32),
}

impl Method {
    /// The curve that it belongs to.
    pub fn series(&self) -> String {
        match self {
            Method::Bake(c) => c.series(),
            Method::Paths(_) => "path tracing".into(),
        }
    }

    /// Its place on the curve.
    pub fn label(&self) -> String {
        match self {
            Method::Bake(c) => format!("{}/{}", c.grid, c.rays),
            Method::Paths(n) => format!("{n} paths"),
        }
    }
}

/// One point of the plot.
#[derive(Clone, Debug)]
pub struct Entry {
    /// What was run.
    pub method: Method,
    /// Median seconds for the job.
    pub seconds: f64,
    /// Of these, before the first point is lit: structure, patches, direct light, form factors, solution.
    pub bake_seconds: f64,
    /// Runs that the median is of.
    pub runs: usize,
    /// Patches of a bake.
    pub patches: usize,
    /// Error of the luminance of all light, and of indirect light.
    pub total: Difference,
    /// See `total`.
    pub indirect: Difference,
    /// Whether no other entry beats it in time and total error.
    pub on_front: bool,
}

/// A configuration that was not run.
#[derive(Clone, Debug)]
pub struct LeftOut {
    /// Which.
    pub configuration: Configuration,
    /// Why.
    pub why: String,
}

/// All that was measured on one scene.
#[derive(Clone, Debug)]
pub struct SceneBench {
    /// Name of the scene.
    pub name: String,
    /// Its triangles.
    pub triangles: usize,
    /// Ray tracers that ran.
    pub tracers: Vec<String>,
    /// How it was measured.
    pub settings: Settings,
    /// Paths a point of the reference, and its standard error.
    pub reference: (u32, f64),
    /// The points of the plot.
    pub entries: Vec<Entry>,
    /// What is not in it.
    pub left_out: Vec<LeftOut>,
}

/// Configurations that take longer run once, seconds.
const ONCE: f64 = 5.0;
/// Points that the time of lighting one is the mean of, at least.
const TIMED: usize = 20_000;
/// Paths a point at and above which the points that errors are measured at are enough to tell the time.
const ENOUGH_PATHS: u32 = 256;
/// Stages of a bake that lighting given points does not need.
const NOT_NEEDED: [&str; 2] = ["split mesh", "vertices"];

/// Measures `scene`; the reference is looked for, and stored, in `folder`.
///
/// A configuration that cannot be baked is left out with its reason.
///
/// # Errors
/// Those of the reference; the scene has no light; the folder cannot be written.
pub fn run(scene: &Scene, settings: &Settings, folder: &Path, progress: &dyn Progress) -> Result<SceneBench> {
    let begun = Instant::now();
    let tracer = trace::build(Backend::Auto, &scene.geometry())?;
    let build_seconds = begun.elapsed().as_secs_f64();
    let truth = Truth::find(scene, &*tracer, settings, folder, progress)?;
    let judge = Judge::new(&truth);

    let mut left_out = Vec::new();
    let mut chosen: Vec<(Method, Vec<Run>)> = Vec::new();
    let has_proxy = scene.proxy.is_some();
    for configuration in configurations(settings.extent) {
        if configuration.patches == PatchSource::Proxy && !has_proxy {
            continue;
        }
        match too_long(scene, &configuration, settings) {
            Some(why) => left_out.push(LeftOut { configuration, why }),
            None => chosen.push((Method::Bake(configuration), Vec::new())),
        }
    }
    chosen.extend(PATHS.map(|n| (Method::Paths(n), Vec::new())));

    let mut tracers = vec![tracer.name()];
    progress.begin(&scene.name, (chosen.len() * settings.repeats) as u64);
    // Rounds over all, so that a machine that slows down does so for everyone.
    for round in 0..settings.repeats {
        for (method, runs) in &mut chosen {
            let due = round == 0 || runs.first().is_some_and(|first| first.seconds < ONCE);
            if due {
                let quiet = Hushed(progress);
                let result = match method {
                    Method::Bake(configuration) => bake(scene, configuration, settings, &judge, &quiet),
                    Method::Paths(n) => paths(scene, &*tracer, *n, build_seconds, settings, &judge, &quiet),
                };
                progress::go_on(progress, &scene.name)?;
                match (result, &method) {
                    (Ok(run), _) => {
                        if !tracers.contains(&run.tracer) {
                            tracers.push(run.tracer.clone());
                        }
                        runs.push(run);
                    }
                    (Err(error), Method::Bake(configuration)) => {
                        left_out.push(LeftOut { configuration: *configuration, why: error.to_string() });
                    }
                    (Err(error), _) => return Err(error),
                }
            }
            progress.advance(1);
        }
    }
    progress.end();
    let mut entries: Vec<Entry> = chosen.into_iter().filter_map(|(method, runs)| entry(method, runs)).collect();
    let front = pareto::front(&entries.iter().map(|e| (e.seconds, e.total.rmse)).collect::<Vec<_>>());
    entries.iter_mut().zip(front).for_each(|(e, on)| e.on_front = on);
    Ok(SceneBench {
        name: scene.name.clone(),
        triangles: scene.triangles.len(),
        tracers,
        settings: settings.clone(),
        reference: (truth.samples, truth.relative_error as f64),
        entries,
        left_out,
    })
}

/// Why a configuration would take too long.
fn too_long(scene: &Scene, configuration: &Configuration, settings: &Settings) -> Option<String> {
    let forecast = match crate::forecast(scene, &configuration.options(settings.seed)) {
        Ok(forecast) => forecast,
        Err(error) => return Some(error.to_string()),
    };
    let over = forecast.seconds > settings.limit;
    over.then(|| format!("foretold to take {:.0} s, the limit is {:.0} s", forecast.seconds, settings.limit))
}

/// What one run gave.
struct Run {
    seconds: f64,
    bake_seconds: f64,
    patches: usize,
    total: Difference,
    indirect: Difference,
    tracer: String,
}

/// Compares light with the reference.
struct Judge {
    points: Vec<SurfacePoint>,
    /// Luminance of all light, and of indirect light.
    light: (Vec<f64>, Vec<f64>),
    /// Their standard errors.
    noise: (Vec<f64>, Vec<f64>),
}

impl Judge {
    fn new(truth: &Truth) -> Judge {
        Judge { points: truth.points(), light: truth.luminance(), noise: truth.noise() }
    }

    /// All points, so many times over.
    fn points(&self, times: usize) -> Vec<SurfacePoint> {
        self.points.repeat(times.max(1))
    }

    /// Differences of total and of indirect luminance at the points, which come first among those that have light.
    fn differences(&self, direct: &[glam::Vec3], indirect: &[glam::Vec3]) -> (Difference, Difference) {
        let bounced: Vec<f64> = indirect[..self.points.len()].iter().map(|&e| luminance(e)).collect();
        let total: Vec<f64> = direct.iter().zip(&bounced).map(|(&d, i)| luminance(d) + i).collect();
        (
            difference(&total, &self.light.0, Some(&self.noise.0)),
            difference(&bounced, &self.light.1, Some(&self.noise.1)),
        )
    }
}

fn bake(
    scene: &Scene,
    configuration: &Configuration,
    settings: &Settings,
    judge: &Judge,
    progress: &dyn Progress,
) -> Result<Run> {
    // The reference has seed, the curves have others.
    let bake = crate::bake(scene, &configuration.options(settings.seed + 1), progress)?;
    let needed = bake.report.stages.iter().filter(|stage| !NOT_NEEDED.contains(&stage.name));
    let bake_seconds: f64 = needed.map(|stage| stage.seconds).sum();
    let points = judge.points(TIMED.min(settings.job).div_ceil(judge.points.len()));
    let begun = Instant::now();
    let Irradiance { direct, indirect, .. } = bake.irradiance(&points, progress);
    let a_point = begun.elapsed().as_secs_f64() / points.len() as f64;
    let (total, indirect) = judge.differences(&direct, &indirect);
    Ok(Run {
        seconds: bake_seconds + a_point * settings.job as f64,
        bake_seconds,
        patches: bake.patches().len(),
        total,
        indirect,
        tracer: bake.report.backend.clone(),
    })
}

fn paths(
    scene: &Scene,
    tracer: &dyn RayTracer,
    paths: u32,
    build_seconds: f64,
    settings: &Settings,
    judge: &Judge,
    progress: &dyn Progress,
) -> Result<Run> {
    let options = ReferenceOptions { until: Until::Samples(paths), seed: settings.seed + 1 };
    let points = judge.points((ENOUGH_PATHS / paths) as usize);
    let found = reference::irradiance(scene, tracer, &points, &options, progress)?;
    let (total, indirect) = judge.differences(&found.direct, &found.indirect);
    Ok(Run {
        seconds: build_seconds + found.seconds / points.len() as f64 * settings.job as f64,
        bake_seconds: build_seconds,
        patches: 0,
        total,
        indirect,
        tracer: tracer.name(),
    })
}

/// The run of median time: every run has the same light.
fn entry(method: Method, mut runs: Vec<Run>) -> Option<Entry> {
    runs.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    let count = runs.len();
    let run = runs.into_iter().nth(count / 2)?;
    Some(Entry {
        method,
        seconds: run.seconds,
        bake_seconds: run.bake_seconds,
        runs: count,
        patches: run.patches,
        total: run.total,
        indirect: run.indirect,
        on_front: false,
    })
}
