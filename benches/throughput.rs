//! Form-factor rays a second: the whole stage (generate, trace, look up, count) against the ray tracer alone on the
//! same rays, in one run.
//!
//! `cargo bench --bench throughput -- [SCENE ...]`; without scenes the Cornell box.

use std::{path::Path, time::Instant};

use luxel::{
    options::{Backend, Resolution},
    progress::Silent,
    scene::{self, SceneOverrides},
    simplify::{self, Grid},
    trace::{self, Hit, RayBatch},
    transfer::{self, Emitter, PointSets},
};
use rayon::prelude::*;

const RAYS: u32 = 256;
const ROUNDS: usize = 5;
/// Patches whose rays are held in memory at once.
const BLOCK: usize = 4096;

fn main() {
    let given: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let scenes = if given.is_empty() { vec!["scenes/cornell.toml".to_string()] } else { given };
    println!("| scene | triangles | patches | tracer | alone, Mrays/s | stage, Mrays/s | share |");
    println!("|-|-|-|-|-|-|-|");
    for path in &scenes {
        for backend in backends() {
            if let Err(error) = measure(Path::new(path), backend) {
                println!("{path}: {error}");
            }
        }
    }
    println!("{} threads, {RAYS} rays a patch, grid 64, medians of {ROUNDS}", rayon::current_num_threads());
}

fn backends() -> Vec<Backend> {
    if cfg!(feature = "embree") { vec![Backend::Embree, Backend::Bvh] } else { vec![Backend::Bvh] }
}

fn measure(path: &Path, backend: Backend) -> luxel::Result<()> {
    let scene = scene::load(path, &SceneOverrides::default())?.0;
    let tracer = trace::build(backend, &scene.geometry())?;
    let simplified = simplify::surfels(&scene, Grid::new(&scene, Resolution::Grid(64))?, &*tracer);
    let patches = simplified.patches.len();
    let sets = PointSets::new(RAYS as usize, 0);

    let (mut alone, mut stage) = (Vec::new(), Vec::new());
    for _ in 0..ROUNDS {
        let begun = Instant::now();
        let estimate = transfer::estimate(&simplified, &*tracer, &vec![true; patches], true, RAYS, 0, &Silent);
        stage.push(estimate.rays as f64 / begun.elapsed().as_secs_f64() * 1e-6);

        let mut seconds = 0.0;
        for block in (0..patches as u32).collect::<Vec<_>>().chunks(BLOCK) {
            let mut batches: Vec<(RayBatch, Vec<Hit>)> = block
                .par_iter()
                .map_init(Emitter::default, |emitter, &i| {
                    let mut rays = RayBatch::default();
                    transfer::row_rays(&simplified, &sets, i, 0, 0, emitter, &mut rays);
                    let hits = vec![Hit::NONE; rays.len()];
                    (rays, hits)
                })
                .collect();
            let begun = Instant::now();
            batches.par_chunks_mut(64).for_each(|chunk| {
                chunk.iter_mut().for_each(|(rays, hits)| tracer.closest_hits(rays, hits));
            });
            seconds += begun.elapsed().as_secs_f64();
        }
        alone.push((patches as u64 * RAYS as u64) as f64 / seconds * 1e-6);
    }
    let (alone, stage) = (median(alone), median(stage));
    println!(
        "| {} | {} | {patches} | {} | {alone:.1} | {stage:.1} | {:.2} |",
        scene.name,
        scene.triangles.len(),
        tracer.name(),
        stage / alone
    );
    Ok(())
}

fn median(mut x: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    x[x.len() / 2]
}
