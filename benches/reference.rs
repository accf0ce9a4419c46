//! Rays a second of the reference path tracer, against the ray tracer alone on the same rays, in one run.
//!
//! `cargo bench --bench reference -- [SCENE ...]`; without scenes the Cornell box.

use std::{
    path::Path,
    sync::Mutex,
    time::{Duration, Instant},
};

use luxel::{
    options::{Backend, Resolution},
    progress::Silent,
    reference::{ReferenceOptions, Until, irradiance},
    scene::{self, SceneOverrides, SurfacePoint},
    simplify::{self, Grid},
    trace::{self, Hit, RayBatch, RayTracer},
};
use rayon::prelude::*;

const PATHS: u32 = 256;
const POINTS: usize = 1000;
const ROUNDS: usize = 7;

/// Keeps what is traced.
struct Recorder<'a> {
    tracer: &'a dyn RayTracer,
    batches: Mutex<Vec<(RayBatch, bool)>>,
}

impl RayTracer for Recorder<'_> {
    fn name(&self) -> String {
        self.tracer.name()
    }

    fn closest_hits(&self, rays: &RayBatch, hits: &mut [Hit]) {
        self.tracer.closest_hits(rays, hits);
        self.batches.lock().expect("no panics").push((rays.clone(), false));
    }

    fn occluded(&self, rays: &RayBatch, occluded: &mut [bool]) {
        self.tracer.occluded(rays, occluded);
        self.batches.lock().expect("no panics").push((rays.clone(), true));
    }
}

fn main() {
    let given: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let scenes = if given.is_empty() { vec!["scenes/cornell.toml".to_string()] } else { given };
    println!("| scene | tracer | rays a path | alone, Mrays/s | path tracer, Mrays/s | share | within: tracing |");
    println!("|-|-|-|-|-|-|-|");
    for path in &scenes {
        for backend in backends() {
            if let Err(error) = measure(Path::new(path), backend) {
                println!("{path}: {error}");
            }
        }
    }
    println!("{} threads, {PATHS} paths at {POINTS} points, medians of {ROUNDS}", rayon::current_num_threads());
}

fn backends() -> Vec<Backend> {
    if cfg!(feature = "embree") { vec![Backend::Embree, Backend::Bvh] } else { vec![Backend::Bvh] }
}

fn measure(path: &Path, backend: Backend) -> luxel::Result<()> {
    let scene = scene::load(path, &SceneOverrides::default())?.0;
    let tracer = trace::build(backend, &scene.geometry())?;
    let points = points(&scene, &*tracer)?;
    let options = ReferenceOptions { until: Until::Samples(PATHS), seed: 0 };

    let recorder = Recorder { tracer: &*tracer, batches: Mutex::default() };
    irradiance(&scene, &recorder, &points, &options, &Silent)?;
    let batches = recorder.batches.into_inner().expect("no panics");
    let rays: usize = batches.iter().map(|(rays, _)| rays.len()).sum();

    let (mut alone, mut ours, mut within) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let reference = irradiance(&scene, &*tracer, &points, &options, &Silent)?;
        // Without the preparation, which no number of paths repeats: what the threads worked.
        let threads = rayon::current_num_threads() as f64;
        ours.push(reference.rays as f64 / reference.walking_seconds * threads * 1e-6);
        within.push(reference.tracing_seconds / reference.walking_seconds);
        let busy: Duration = batches
            .par_iter()
            .map_init(
                || (Vec::new(), Vec::new()),
                |(hits, occluded), (rays, any)| {
                    hits.resize(rays.len(), Hit::NONE);
                    occluded.resize(rays.len(), false);
                    let begun = Instant::now();
                    match any {
                        true => tracer.occluded(rays, occluded),
                        false => tracer.closest_hits(rays, hits),
                    }
                    begun.elapsed()
                },
            )
            .sum();
        alone.push(rays as f64 / busy.as_secs_f64() * threads * 1e-6);
    }
    let (alone, ours, within) = (median(alone), median(ours), median(within));
    println!(
        "| {} | {} | {:.2} | {alone:.1} | {ours:.1} | {:.2} | {within:.2} |",
        scene.name,
        tracer.name(),
        rays as f64 / (points.len() as u32 * PATHS) as f64,
        ours / alone
    );
    Ok(())
}

/// The middles of patches, evenly chosen.
fn points(scene: &luxel::Scene, tracer: &dyn RayTracer) -> luxel::Result<Vec<SurfacePoint>> {
    let patches = simplify::surfels(scene, Grid::new(scene, Resolution::Grid(32))?, tracer).patches;
    let step = (patches.len() / POINTS).max(1);
    let point = |i: usize| SurfacePoint { position: patches.centroid[i], normal: patches.normal[i] };
    Ok((0..patches.len()).step_by(step).take(POINTS).map(point).collect())
}

fn median(mut x: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    x[x.len() / 2]
}
