//! How much faster a bake is than path tracing to the same error; both sides measured in one run.
//!
//! `cargo bench --bench path_tracing`. Two jobs: the light of 100,000 random points of the Cornell box, and that of the
//! 1834 points of an independent reference, where its folder is present. The path tracer is given as many
//! paths as 1 % of error takes, at a part of the points where it would take minutes: its time is proportional to their
//! number.

use std::{
    fs,
    path::{Path, PathBuf},
    time::Instant,
};

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Result, Scene,
    bench::{Machine, Settings, Truth},
    colour::luminance,
    compare::difference,
    options::{Backend, Resolution},
    progress::Silent,
    reference::{self, ReferenceOptions, Until},
    scene::{self, SceneOverrides, SurfacePoint},
    trace::{self, RayTracer},
};

/// The error that both sides go for.
const TARGET: f64 = 0.01;
/// Grids and rays, from fast to slow; the first one that reaches the target is timed.
const CANDIDATES: [(u32, u32); 7] = [(16, 256), (24, 128), (24, 256), (32, 128), (32, 256), (48, 256), (64, 256)];
const ROUNDS: usize = 3;
/// Stages that lighting given points does not need.
const NOT_NEEDED: [&str; 2] = ["split mesh", "vertices"];
/// Points that the path tracer is timed at, at most.
const TRACED: usize = 1000;

fn main() {
    println!("{}", Machine::here());
    println!(
        "| job | bake: grid/rays | error, % | seconds | path tracing: paths | error, % | seconds to 1 % | times faster |"
    );
    println!("|-|-|-|-|-|-|-|-|");
    for job in [random_points(), reference_points()] {
        match job.and_then(|job| job.map(|job| job.measure()).transpose()) {
            Ok(Some(())) => {}
            Ok(None) => println!("skipped: no ../shared/reference/cornell"),
            Err(error) => println!("{error}"),
        }
    }
    println!("medians of {ROUNDS} rounds, error: relative RMSE of the luminance of all light");
}

/// Points to be lit, and what their light is.
struct Job {
    name: String,
    scene: Scene,
    /// Points with known light.
    points: Vec<SurfacePoint>,
    truth: Vec<f64>,
    /// Standard errors of `truth`.
    noise: Vec<f64>,
    /// Points that are lit in all, those with known light over and over.
    count: usize,
}

/// 100,000 points of the Cornell box, 1000 of them with a reference by luxel's own path tracer.
fn random_points() -> Result<Option<Job>> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    let scene = scene::load(&path, &SceneOverrides::default())?.0;
    let tracer = trace::build(Backend::Auto, &scene.geometry())?;
    let settings = Settings { points: TRACED, reference_error: 0.004, ..Settings::default() };
    let truth = Truth::find(&scene, &*tracer, &settings, Path::new(env!("CARGO_TARGET_TMPDIR")), &Silent)?;
    let points = truth.points();
    let (total, _) = truth.luminance();
    let name = "Cornell box, 100,000 points".into();
    Ok(Some(Job { name, scene, points, truth: total, noise: truth.noise().0, count: 100_000 }))
}

/// The points of the independent reference; `None` where it is not present.
fn reference_points() -> Result<Option<Job>> {
    let folder: PathBuf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/reference/cornell");
    let Ok(text) = fs::read_to_string(folder.join("ref_center.csv")) else { return Ok(None) };
    let scene = scene::load(&folder.join("cornell.obj"), &SceneOverrides::default())?.0;
    let (mut points, mut truth, mut noise) = (Vec::new(), Vec::new(), Vec::new());
    for line in text.lines().skip(1) {
        let v: Vec<f64> = line.split(',').filter_map(|field| field.parse().ok()).collect();
        let three = |i: usize| Vec3::new(v[i] as f32, v[i + 1] as f32, v[i + 2] as f32);
        let position = scene.frame.to_local(DVec3::new(v[0], v[1], v[2]));
        points.push(SurfacePoint { position, normal: three(3).normalize() });
        truth.push(luminance(three(6) + three(9)));
        // Direct and indirect light err independently; the bands of each are taken as erring alike.
        noise.push(luminance(three(12)).hypot(luminance(three(15))));
    }
    let (name, count) = (format!("Cornell box, {} points of a reference", points.len()), points.len());
    Ok(Some(Job { name, scene, points, truth, noise, count }))
}

impl Job {
    fn measure(&self) -> Result<()> {
        let tracer = trace::build(Backend::Auto, &self.scene.geometry())?;
        let mut chosen = None;
        for (grid, rays) in CANDIDATES {
            chosen = Some((grid, rays));
            if self.bake(grid, rays)?.1 <= TARGET {
                break;
            }
        }
        let (grid, rays) = chosen.unwrap_or((64, 256));
        let pilot = self.trace(&*tracer, 256)?;
        let paths = (256.0 * (pilot.1 / TARGET).powi(2)).ceil() as u32;
        let (mut baked, mut traced) = (Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            baked.push(self.bake(grid, rays)?);
            traced.push(self.trace(&*tracer, paths)?);
        }
        let (bake, path) = (median(baked), median(traced));
        // What is left to the target, by the square-root law.
        let to_target = path.0 * (path.1 / TARGET).powi(2);
        println!(
            "| {} | {grid}/{rays} | {:.2} | {:.3} | {paths} | {:.2} | {to_target:.2} | {:.0} |",
            self.name,
            100.0 * bake.1,
            bake.0,
            100.0 * path.1,
            to_target / bake.0
        );
        Ok(())
    }

    /// Seconds and error of a bake with the light of all points.
    fn bake(&self, grid: u32, rays: u32) -> Result<(f64, f64)> {
        let options = BakeOptions { resolution: Resolution::Grid(grid), rays, seed: 1, ..BakeOptions::default() };
        let points: Vec<SurfacePoint> = self.points.iter().copied().cycle().take(self.count).collect();
        let bake = luxel::bake(&self.scene, &options, &Silent)?;
        let needed = bake.report.stages.iter().filter(|stage| !NOT_NEEDED.contains(&stage.name));
        let baked: f64 = needed.map(|stage| stage.seconds).sum();
        let begun = Instant::now();
        let light = bake.irradiance(&points, &Silent);
        Ok((baked + begun.elapsed().as_secs_f64(), self.error(&light.direct, &light.indirect)))
    }

    /// Seconds that all points would take, and error.
    fn trace(&self, tracer: &dyn RayTracer, paths: u32) -> Result<(f64, f64)> {
        let options = ReferenceOptions { until: Until::Samples(paths), seed: 1 };
        let found = reference::irradiance(&self.scene, tracer, &self.points, &options, &Silent)?;
        let share = self.count as f64 / self.points.len() as f64;
        Ok((found.seconds * share, self.error(&found.direct, &found.indirect)))
    }

    fn error(&self, direct: &[Vec3], indirect: &[Vec3]) -> f64 {
        let values = direct.iter().zip(indirect).take(self.truth.len()).map(|(&d, &i)| luminance(d + i));
        difference(&values.collect::<Vec<_>>(), &self.truth, Some(&self.noise)).rmse
    }
}

/// The run of median time.
fn median(mut runs: Vec<(f64, f64)>) -> (f64, f64) {
    runs.sort_by(|a, b| a.0.total_cmp(&b.0));
    runs[runs.len() / 2]
}
