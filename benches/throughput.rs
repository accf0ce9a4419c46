//! Form-factor rays a second: the whole stage (generate, trace, look up, count) against the ray tracer alone on the
//! same rays, in one run. The tracer is timed twice: through [`RayTracer::closest_hits`], and for Embree also as a
//! bare loop over `rtcIntersect`, which is what the stage is judged by. Both backends are compared as well.
//!
//! `cargo bench --bench throughput -- [--embree | --bvh] [SCENE ...]`; without scenes those of the table below.

use std::{path::Path, time::Instant};

use luxel::{
    BakeOptions,
    bench::SUITE,
    options::Backend,
    progress::Silent,
    scene,
    simplify::Simplified,
    trace::{self, Geometry, Hit, RayBatch, RayTracer},
    transfer::{self, Casting, Emitter, Plan, RowPoints, Rows},
};
use rayon::prelude::*;

const RAYS: u32 = 256;
const ROUNDS: usize = 5;
/// Patches whose rays are held in memory at once, on each thread.
const CHUNK: usize = 32;

/// Scenes, the least share of the bare loop that the stage must reach, and the least share of Embree's speed that the
/// pure-Rust backend must reach.
const SCENES: [(&str, f64, Option<f64>); 3] = [
    ("scenes/cornell.toml", 0.70, None),
    ("../shared/scenes/godot_room/room.glb", 0.80, None),
    ("../shared/scenes/lost_empire/lost_empire.obj", 0.80, Some(0.45)),
];

fn main() {
    let (flags, given): (Vec<String>, Vec<String>) = std::env::args().skip(1).partition(|a| a.starts_with("--"));
    let backends: Vec<Backend> = [Backend::Embree, Backend::Bvh]
        .into_iter()
        .filter(|b| cfg!(feature = "embree") || *b == Backend::Bvh)
        .filter(|b| match (flags.iter().any(|f| f == "--embree"), flags.iter().any(|f| f == "--bvh")) {
            (true, false) => *b == Backend::Embree,
            (false, true) => *b == Backend::Bvh,
            _ => true,
        })
        .collect();
    println!("| scene | triangles | rows | tracer | bare | batch | stage | stage / bare (asked) |");
    println!("|-|-|-|-|-|-|-|-|");
    let scenes: Vec<(&str, f64, Option<f64>)> = if given.is_empty() {
        SCENES.to_vec()
    } else {
        given.iter().map(|g| *SCENES.iter().find(|s| s.0 == g).unwrap_or(&(g.as_str(), 0.0, None))).collect()
    };
    let mut against = Vec::new();
    for (path, asked, asked_of_bvh) in scenes {
        if !Path::new(path).exists() {
            println!("| {path} | skipped |");
            continue;
        }
        match measure(Path::new(path), &backends, asked) {
            Ok(rates) if rates.len() == 2 => {
                let asked = asked_of_bvh.map(|a| format!(" (asked {a})")).unwrap_or_default();
                against.push(format!("{path}: bvh / embree, batches: {:.2}{asked}", rates[1] / rates[0]));
            }
            Ok(_) => (),
            Err(error) => println!("{path}: {error}"),
        }
    }
    println!("Mrays/s, medians of {ROUNDS}, {} threads, {RAYS} rays a patch, grid 64", rayon::current_num_threads());
    against.iter().for_each(|line| println!("{line}"));
}

/// A tracer of which the type is known, because only Embree has a bare loop.
enum Tracer {
    #[cfg(feature = "embree")]
    Embree(trace::Embree),
    Other(Box<dyn RayTracer>),
}

impl Tracer {
    fn new(backend: Backend, geometry: &Geometry) -> luxel::Result<Tracer> {
        #[cfg(feature = "embree")]
        if backend == Backend::Embree {
            return Ok(Tracer::Embree(trace::Embree::new(geometry)?));
        }
        Ok(Tracer::Other(trace::build(backend, geometry)?))
    }

    fn get(&self) -> &dyn RayTracer {
        match self {
            #[cfg(feature = "embree")]
            Tracer::Embree(tracer) => tracer,
            Tracer::Other(tracer) => &**tracer,
        }
    }

    /// Traces and drops the results; false where there is no such loop.
    fn bare(&self, rays: &RayBatch) -> bool {
        match self {
            #[cfg(feature = "embree")]
            Tracer::Embree(tracer) => {
                std::hint::black_box(tracer.bare(rays));
                true
            }
            Tracer::Other(_) => {
                std::hint::black_box(rays);
                false
            }
        }
    }
}

/// Prints a line for each backend; returns the rates of their batches.
fn measure(path: &Path, backends: &[Backend], asked: f64) -> luxel::Result<Vec<f64>> {
    let added = SUITE.iter().find(|scene| path.ends_with(scene.file)).map(|scene| scene.overrides());
    let scene = scene::load(path, &added.unwrap_or_default())?.0;
    let tracers: Vec<Tracer> =
        backends.iter().map(|&b| Tracer::new(b, &scene.geometry())).collect::<luxel::Result<_>>()?;
    // The rows that a bake casts.
    let options = BakeOptions { backend: backends[0], rays: 16, estimate: false, ..BakeOptions::default() };
    let bake = luxel::bake(&scene, &options, &Silent)?;
    let (simplified, reached) = (&bake.simplified, &bake.light.reached);
    let unreached: Vec<bool> = reached.iter().map(|r| !r).collect();
    let rows: Vec<u32> = (0..reached.len() as u32).filter(|&i| reached[i as usize]).collect();
    let plan = Plan { start: reached, ..Plan::default() };
    let mut rates = Vec::new();
    for tracer in &tracers {
        let (mut bare, mut batch, mut stage) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..ROUNDS {
            let begun = Instant::now();
            let points = RowPoints::new(RAYS, 0, tracer.get());
            let casting = Casting::new(simplified, tracer.get(), &unreached, &points);
            let mut store = Rows::new(simplified.patches.len());
            let estimate = transfer::estimate_plan(&casting, &plan, &mut store, &mut (), &Silent)?;
            stage.push(estimate.rays as f64 / begun.elapsed().as_secs_f64() * 1e-6);
            let (without, with) = alone(simplified, &rows, tracer);
            bare.extend(without);
            batch.push(with);
        }
        let (batch, stage) = (median(batch), median(stage));
        let (bare, share) = if bare.is_empty() {
            ("-".into(), format!("{:.2} of batch", stage / batch))
        } else {
            let bare = median(bare);
            (format!("{bare:.1}"), format!("{:.2} ({asked:.2})", stage / bare))
        };
        println!(
            "| {} | {} | {} | {} | {bare} | {batch:.1} | {stage:.1} | {share} |",
            scene.name,
            scene.triangles.len(),
            rows.len(),
            tracer.get().name(),
        );
        rates.push(batch);
    }
    Ok(rates)
}

/// Mrays/s of the bare loop, where there is one, and of the backend's batches, over the rays of `rows`. Rays are
/// made for a few patches at a time and only tracing is timed: they are as near in the caches as in the stage.
fn alone(simplified: &Simplified, rows: &[u32], tracer: &Tracer) -> (Option<f64>, f64) {
    let points = RowPoints::new(RAYS, 0, tracer.get());
    let sets = points.rows();
    let working = || (Emitter::default(), vec![RayBatch::default(); CHUNK], vec![Hit::NONE; RAYS as usize]);
    let timed = |(emitter, batches, hits): &mut (Emitter, Vec<RayBatch>, Vec<Hit>), chunk: &[u32]| {
        for (&i, rays) in chunk.iter().zip(&mut *batches) {
            transfer::row_rays(simplified, sets, i, 0, 0, emitter, rays);
        }
        let batches = &batches[..chunk.len()];
        let begun = Instant::now();
        let has_bare = batches.iter().all(|rays| tracer.bare(rays));
        let bare = begun.elapsed().as_secs_f64();
        let begun = Instant::now();
        batches.iter().for_each(|rays| tracer.get().closest_hits(rays, hits));
        std::hint::black_box(hits);
        (has_bare, bare, begun.elapsed().as_secs_f64())
    };
    let (has_bare, bare, batch) = rows
        .par_chunks(CHUNK)
        .map_init(working, timed)
        .reduce(|| (true, 0.0, 0.0), |a, b| (a.0 && b.0, a.1 + b.1, a.2 + b.2));
    let mrays = (rows.len() as u64 * RAYS as u64) as f64 * 1e-6 * rayon::current_num_threads() as f64;
    (has_bare.then_some(mrays / bare), mrays / batch)
}

fn median(mut x: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    x[x.len() / 2]
}
