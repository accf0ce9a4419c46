//! Frame times of the relighter: the Cornell box, its lamp taken off the ceiling and carried about, with shadows. A frame is
//! direct light of the patches, solution, and indirect light of all vertices; direct light of the vertices is timed beside
//! it. Then how far frames are from bakes with the lamp at the same place, and how far two such bakes are from each other.
//!
//! `cargo bench --bench relight -- [GRID ...]`; as many threads as `RAYON_NUM_THREADS` says.

use std::{f64::consts::TAU, path::Path, time::Instant};

use glam::{DAffine3, DVec3, Vec3};
use luxel::{
    BakeOptions, Relighter, Scene, bake,
    bench::Machine,
    options::Resolution,
    output::tonemap::luminance,
    progress::Silent,
    scene::{self, Light, SceneOverrides},
};

/// Grids and the milliseconds that a frame may take, of two threads.
const GRIDS: [(u32, f64); 2] = [(32, 16.0), (64, 60.0)];
const FRAMES: usize = 240;
/// Frames whose light is compared with bakes.
const CHECKED: [usize; 3] = [0, 90, 170];
/// Every so many frames the vertices get direct light too.
const EVERY: usize = 8;

fn main() {
    let given: Vec<u32> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let grids: Vec<u32> = if given.is_empty() { GRIDS.map(|g| g.0).to_vec() } else { given };
    for grid in grids {
        if let Err(error) = measure(grid) {
            println!("relight: {error}");
        }
    }
}

/// Where the lamp is in a frame: a tour about the room at changing height, turning over.
fn place(frame: usize) -> DAffine3 {
    let turn = frame as f64 / FRAMES as f64 * TAU;
    let home = DVec3::new(278.0, 548.8, 279.5);
    let to = DVec3::new(278.0 + 130.0 * turn.cos(), 430.0 + 80.0 * (2.0 * turn).sin(), 279.5 + 130.0 * turn.sin());
    DAffine3::from_translation(to) * DAffine3::from_rotation_x(0.4 * turn.sin()) * DAffine3::from_translation(-home)
}

fn measure(grid: u32) -> luxel::Result<()> {
    let scene: Scene = scene::load(Path::new("scenes/cornell.toml"), &SceneOverrides::default())?.0;
    let options = BakeOptions { resolution: Resolution::Grid(grid), estimate: false, ..BakeOptions::default() };
    let baked = bake(&scene, &options, &Silent)?;
    let begun = Instant::now();
    let mut relighter = Relighter::new(scene.clone(), baked)?;
    let prepared = begun.elapsed().as_secs_f64();

    let (mut times, mut vertices, mut sweeps, mut rays) = (Vec::new(), Vec::new(), Vec::new(), 0);
    let mut checked = Vec::new();
    for k in 0..FRAMES {
        relighter.place(0, place(k))?;
        let begun = Instant::now();
        let frame = relighter.frame();
        let whole = begun.elapsed().as_secs_f64();
        if k > 0 {
            times.push([frame.seconds[0], frame.seconds[1], frame.seconds[2], whole].map(|s| 1e3 * s));
            sweeps.push(frame.sweeps as f64);
            rays += frame.rays;
        }
        if k % EVERY == 0 {
            let begun = Instant::now();
            relighter.direct();
            vertices.push(1e3 * begun.elapsed().as_secs_f64());
        }
        if CHECKED.contains(&k) {
            checked.push((k, relighter.indirect().to_vec()));
        }
    }
    let tolerance = relighter.options().tolerance;
    let lit = relighter.bake();
    let counts = &lit.report.counts;
    println!(
        "## grid {grid}: {} patches, {} reached, {} vertices",
        counts.patches, counts.patches_reached, counts.vertices
    );
    println!("| stage | median, ms | 95th percentile |\n|-|-|-|");
    for (i, name) in ["direct light of patches", "solve", "indirect light of vertices"].iter().enumerate() {
        row(name, times.iter().map(|t| t[i]).collect());
    }
    row("frame", times.iter().map(|t| t[3]).collect());
    row("direct light of vertices", vertices);
    let median = quantile(sweeps, 0.5);
    println!("{} shadow rays a frame, {median} sweeps, tolerance {tolerance}", rays / (FRAMES as u64 - 1));
    println!("ready after {prepared:.2} s; {}", Machine::here());

    // Bakes of the same seed have the same rows; those of others tell how noisy they are.
    println!("| frame | of a bake, same rays | of a bake, other rays | two bakes of other rays |\n|-|-|-|-|");
    for (k, frame) in checked {
        let scene = with_lamp(&scene, place(k));
        let indirect = |seed: u64| {
            let fresh = bake(&scene, &BakeOptions { seed, ..options.clone() }, &Silent)?;
            luxel::Result::Ok(fresh.irradiance(&lit.mesh.samples, &Silent).indirect)
        };
        let (same, other, third) = (indirect(options.seed)?, indirect(1)?, indirect(2)?);
        let differences = [(&frame, &same), (&frame, &other), (&other, &third)].map(|(a, b)| difference(a, b));
        let [a, b, c] = differences.map(|d| format!("{:.3} %", 100.0 * d));
        println!("| {k} | {a} | {b} | {c} |");
    }
    Ok(())
}

/// The scene with its lamp taken off the ceiling.
fn with_lamp(scene: &Scene, place: DAffine3) -> Scene {
    let mut scene = scene.clone();
    let (mut corners, mut radiance) = (Vec::new(), Vec3::ZERO);
    for t in 0..scene.triangles.len() {
        if scene.emission(t) != Vec3::ZERO {
            corners.push(scene.corners_of(t).map(|c| place.transform_point3(scene.frame.to_world(c))));
            radiance = scene.emission(t);
        }
    }
    // Two triangles of a parallelogram: 0 1 2 and 0 2 3.
    let [[a, b, _], [_, _, d]] = corners[..] else { return scene };
    scene.materials.iter_mut().for_each(|m| m.emission = Vec3::ZERO);
    let vector = |v: DVec3| (v / scene.frame.scale).as_vec3();
    scene.lights.push(Light::Rectangle {
        corner: scene.frame.to_local(a),
        edge_u: vector(b - a),
        edge_v: vector(d - a),
        radiance,
    });
    scene
}

/// Root mean square of the difference of two lists of luminances, relative to the mean of the second.
fn difference(a: &[Vec3], b: &[Vec3]) -> f64 {
    let square = |(a, b): (&Vec3, &Vec3)| (luminance(*a - *b) as f64).powi(2);
    let rms = (a.iter().zip(b).map(square).sum::<f64>() / a.len() as f64).sqrt();
    rms / (b.iter().map(|b| luminance(*b) as f64).sum::<f64>() / b.len() as f64)
}

fn row(name: &str, times: Vec<f64>) {
    println!("| {name} | {:.2} | {:.2} |", quantile(times.clone(), 0.5), quantile(times, 0.95));
}

fn quantile(mut x: Vec<f64>, share: f64) -> f64 {
    x.sort_by(f64::total_cmp);
    x[((x.len() - 1) as f64 * share) as usize]
}
