//! What bakes say of their own error against what it is: the estimate of every bake beside its difference from paths
//! traced at the same vertices.
//!
//! `cargo bench --bench calibration -- [SCENE ...] [--paths N] [--points N] [--only preview|default|high] [--adaptive]`;
//! `--adaptive` lets points gather where they are in doubt; without scenes
//! the Cornell box, a room with curved surfaces, two rooms, and those of `../shared/scenes` that are there.

use std::path::{Path, PathBuf};

use glam::Vec3;
use luxel::{
    BakeOptions, Quality, Scene,
    bake::Bake,
    bench::SUITE,
    colour::luminance,
    compare::{self, Difference},
    options::Reconstruct,
    progress::Silent,
    reference::{self, Reference, ReferenceOptions, Until},
    report::ErrorParts,
    sampling,
    scene::{self, RAY_OFFSET, SceneOverrides, SurfacePoint},
    trace::{Hit, RayBatch},
};

/// The noise of the reference for indirect light is to be at most this share of the estimated error,
const CONVERGED: f64 = 0.5;
/// if so many paths bring it there.
const MOST_PATHS: u32 = 1 << 16;

struct Job {
    path: PathBuf,
    overrides: SceneOverrides,
}

fn main() {
    let mut arguments = std::env::args().skip(1);
    let (mut jobs, mut paths, mut points, mut only) = (Vec::new(), 4096, 1000, None);
    let mut reconstruct = Reconstruct::Smooth;
    while let Some(argument) = arguments.next() {
        let mut number = || arguments.next().and_then(|n| n.parse().ok()).expect("a number");
        match argument.as_str() {
            "--bench" => {}
            "--paths" => paths = number(),
            "--points" => points = number(),
            "--only" => only = arguments.next(),
            "--adaptive" => reconstruct = Reconstruct::Adaptive,
            scene => jobs.push(Job::new(scene)),
        }
    }
    if jobs.is_empty() {
        jobs = suite();
    }
    println!(
        "| scene | quality | light | true error | noise of the reference | estimated | true / estimated | noise | grid | seconds |"
    );
    println!("|-|-|-|-|-|-|-|-|-|-|");
    for job in jobs {
        if let Err(error) = job.run(paths, points as usize, only.as_deref(), reconstruct) {
            println!("{}: {error}", job.path.display());
        }
    }
    println!(
        "{} threads; {points} vertices chosen by area, {paths} to {MOST_PATHS} paths each, their noise subtracted",
        threads()
    );
}

fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn suite() -> Vec<Job> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (own, shared) = (root.join("scenes"), root.join("../shared/scenes"));
    // Paths to a converged reference of the others would take hours.
    let paths = SUITE[..6].iter().map(|scene| scene.path(&own, &shared));
    paths.filter(|path| path.exists()).map(|path| Job::new(&path.to_string_lossy())).collect()
}

impl Job {
    fn new(path: &str) -> Job {
        let known = SUITE.iter().find(|scene| path.ends_with(scene.file));
        Job { path: path.into(), overrides: known.map_or_else(SceneOverrides::default, |scene| scene.overrides()) }
    }

    fn run(&self, paths: u32, points: usize, only: Option<&str>, reconstruct: Reconstruct) -> luxel::Result<()> {
        let scene = scene::load(&self.path, &self.overrides)?.0;
        for (name, quality) in [("preview", Quality::Preview), ("default", Quality::Default), ("high", Quality::High)] {
            if only.is_some_and(|only| only != name) {
                continue;
            }
            let mut options = BakeOptions { reconstruct, ..BakeOptions::default() };
            quality.apply(&mut options);
            let bake = luxel::bake(&scene, &options, &Silent)?;
            row(&scene, &bake, name, paths, points)?;
        }
        Ok(())
    }
}

fn row(scene: &Scene, bake: &Bake, quality: &str, paths: u32, count: usize) -> luxel::Result<()> {
    let chosen = visible(scene, bake, by_area(bake, count));
    let points: Vec<SurfacePoint> = chosen.iter().map(|&v| bake.mesh.samples[v]).collect();
    let error = bake.report.error.as_ref().expect("the bake made an estimate");
    let mut paths = paths;
    let truth = loop {
        let options = ReferenceOptions { until: Until::Samples(paths), seed: 1 };
        let truth = reference::irradiance(scene, bake.tracer(), &points, &options, &Silent)?;
        // Standard errors of few paths do not know of those that are rare and bright.
        if paths >= MOST_PATHS || noise(&truth) <= CONVERGED * error.indirect.total {
            break truth;
        }
        paths *= 4;
    };
    let at = |values: &[Vec3]| chosen.iter().map(|&v| values[v]).collect::<Vec<Vec3>>();
    let sum = |a: &[Vec3], b: &[Vec3]| a.iter().zip(b).map(|(a, b)| *a + *b).collect::<Vec<Vec3>>();
    let (direct, indirect) = (at(&bake.vertices.direct), at(&bake.vertices.indirect));
    let Reference { direct: d, indirect: i, luminance_error, .. } = &truth;
    let Reference { direct_luminance_error, indirect_luminance_error, .. } = &truth;
    let seconds: f64 = bake.report.stages.iter().map(|s| s.seconds).sum();
    let rows = [
        ("direct", difference(&direct, d, direct_luminance_error), &error.direct),
        ("indirect", difference(&indirect, i, indirect_luminance_error), &error.indirect),
        ("total", difference(&sum(&direct, &indirect), &sum(d, i), luminance_error), &error.total),
    ];
    for (light, is, said) in rows {
        print_row(&scene.name, quality, light, &is, said, seconds);
    }
    Ok(())
}

/// Noise of indirect light, root mean square over the points, as a share of its mean.
fn noise(truth: &Reference) -> f64 {
    let squares: f64 = truth.indirect_luminance_error.iter().map(|e| e * e).sum();
    let light: f64 = truth.indirect.iter().map(|e| luminance(*e)).sum();
    let n = truth.indirect.len().max(1) as f64;
    (squares / n).sqrt() / (light / n).max(f64::MIN_POSITIVE)
}

fn print_row(scene: &str, quality: &str, light: &str, is: &Difference, said: &ErrorParts, seconds: f64) {
    let percent = |x: f64| format!("{:.2}", 100.0 * x);
    let [rmse, reference, total, noise, grid] =
        [is.rmse, is.noise, said.total, said.noise, said.discretisation].map(percent);
    // Where no rays are random there is nothing to compare.
    let ratio = if said.total > 1e-4 { format!("{:.2}", is.rmse / said.total) } else { "-".into() };
    println!(
        "| {scene} | {quality} | {light} | {rmse} | {reference} | {total} | {ratio} | {noise} | {grid} | {seconds:.2} |"
    );
}

fn difference(values: &[Vec3], truth: &[Vec3], errors: &[f64]) -> Difference {
    let bright = |v: &[Vec3]| v.iter().map(|e| luminance(*e)).collect::<Vec<f64>>();
    compare::difference(&bright(values), &bright(truth), Some(errors))
}

/// Without those inside of objects, such as the floor under a block: nobody sees what light they have.
fn visible(scene: &Scene, bake: &Bake, mut vertices: Vec<usize>) -> Vec<usize> {
    let mut rays = RayBatch::default();
    for &v in &vertices {
        let SurfacePoint { position, normal } = bake.mesh.samples[v];
        rays.push(position + RAY_OFFSET * normal, normal, 0.0, f32::INFINITY);
    }
    let mut hits = vec![Hit::NONE; rays.len()];
    bake.tracer().closest_hits(&rays, &mut hits);
    let inside = |h: &Hit| h.is_hit() && h.is_back() && !scene.triangles[h.triangle()].two_sided;
    let mut hits = hits.iter();
    vertices.retain(|_| !hits.next().is_some_and(inside));
    vertices
}

/// Vertices in proportion to the area around them, so that plain means over them are means over the surfaces.
fn by_area(bake: &Bake, count: usize) -> Vec<usize> {
    let mut sums = vec![0.0; bake.mesh.positions.len()];
    for t in &bake.mesh.triangles {
        let [a, b, c] = t.map(|v| bake.mesh.positions[v as usize].as_dvec3());
        t.iter().for_each(|&v| sums[v as usize] += (b - a).cross(c - a).length());
    }
    let mut all = 0.0;
    sums.iter_mut().for_each(|s| {
        all += *s;
        *s = all;
    });
    let strata = (0..count).map(|k| {
        let random = (sampling::hash(&[0x6361_6c69, k as u64]) >> 11) as f64 / (1u64 << 53) as f64;
        all * (k as f64 + random) / count as f64
    });
    strata.map(|x| sums.partition_point(|&s| s <= x).min(sums.len() - 1)).collect()
}
