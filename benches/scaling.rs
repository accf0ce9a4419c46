//! Time and memory of a whole bake from ten thousand patches to a million: they must grow no faster than N log N.
//!
//! `cargo bench --bench scaling -- [--bvh] [GRID ...]`; the Cornell box.

use std::path::Path;

use luxel::{
    BakeOptions, Scene, bake,
    options::{Backend, Resolution},
    output::report::peak_memory_bytes,
    progress::Silent,
    report::Report,
    scene::{self, SceneOverrides},
};

/// 12,000 to 1.1 million patches.
const GRIDS: [u32; 6] = [32, 64, 96, 144, 208, 304];
/// Bytes a patch that rows may take.
const BYTES: f64 = 512.0;
/// Stages over this share of the time at the largest grid have an exponent printed.
const SHARE: f64 = 0.02;

fn main() {
    let (flags, grids): (Vec<String>, Vec<String>) = std::env::args().skip(1).partition(|a| a.starts_with("--"));
    let backend = if flags.iter().any(|f| f == "--bvh") { Backend::Bvh } else { Backend::Auto };
    let mut grids: Vec<u32> = grids.iter().filter_map(|g| g.parse().ok()).collect();
    if grids.is_empty() {
        grids = GRIDS.to_vec();
    }
    // The peak of memory is that of the largest bake so far.
    grids.sort_unstable();
    match run(&grids, backend) {
        Ok(reports) => print(&reports),
        Err(error) => println!("scaling: {error}"),
    }
}

fn run(grids: &[u32], backend: Backend) -> luxel::Result<Vec<Report>> {
    let scene: Scene = scene::load(Path::new("scenes/cornell.toml"), &SceneOverrides::default())?.0;
    let options = |grid| BakeOptions { resolution: Resolution::Grid(grid), backend, ..BakeOptions::default() };
    let measured = |&grid| {
        let mut report = bake(&scene, &options(grid), &Silent)?.report;
        report.peak_memory_bytes = peak_memory_bytes();
        Ok(report)
    };
    grids.iter().map(measured).collect()
}

fn print(reports: &[Report]) {
    let Some(last) = reports.last() else { return };
    let names: Vec<&str> = last.stages.iter().map(|s| s.name).collect();
    println!("| patches | {} | total, s | rows, bytes a patch ({BYTES}) | peak, MB |", names.join(" | "));
    println!("|{}", "-|".repeat(names.len() + 4));
    for r in reports {
        let times: Vec<String> = names.iter().map(|n| format!("{:.3}", seconds(r, n))).collect();
        println!(
            "| {} | {} | {:.2} | {:.0} | {:.0} |",
            r.counts.patches,
            times.join(" | "),
            total(r),
            r.counts.form_factor_bytes as f64 / r.counts.patches as f64,
            r.peak_memory_bytes as f64 * 1e-6
        );
    }
    let [first, .., last] = reports else { return };
    let (small, large) = (first.counts.patches as f64, last.counts.patches as f64);
    let exponent = |a: f64, b: f64| (b / a).ln() / (large / small).ln();
    println!(
        "Exponents from {small} to {large} patches; N log N: {:.3}",
        exponent(small * small.ln(), large * large.ln())
    );
    for name in names.iter().filter(|n| seconds(last, n) > SHARE * total(last)) {
        println!("  {name}: {:.3}", exponent(seconds(first, name), seconds(last, name)));
    }
    println!("  total: {:.3}", exponent(total(first), total(last)));
    println!("  memory: {:.3}", exponent(first.peak_memory_bytes as f64, last.peak_memory_bytes as f64));
    println!("{}, {} threads, {} rays a patch", last.backend, last.threads, BakeOptions::default().rays);
}

fn seconds(report: &Report, name: &str) -> f64 {
    report.stages.iter().filter(|s| s.name == name).map(|s| s.seconds).sum()
}

fn total(report: &Report) -> f64 {
    report.stages.iter().map(|s| s.seconds).sum()
}
