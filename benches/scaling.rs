//! Time and memory of a whole bake from ten thousand patches to a million: they must grow no faster than N log N.
//!
//! `cargo bench --bench scaling -- [--bvh] [--plot FILE] [GRID ...]`; the Cornell box. Each grid is baked in a process of
//! its own, whose memory is measured; FILE is an SVG picture.

use std::{path::Path, process::Command};

use luxel::{
    BakeOptions, Error, Result, Scene, bake,
    bench::{Growth, Machine, growth_svg},
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
/// Bakes of a grid are repeated for so long, at most so often; medians count.
const SECONDS: f64 = 1.5;
const ROUNDS: usize = 5;
/// What a process is told that bakes one grid.
const ONE: &str = "--one";

fn main() {
    let mut args = std::env::args().skip(1).peekable();
    let (mut grids, mut plot, mut bvh, mut one) = (Vec::new(), None, false, false);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--bvh" => bvh = true,
            "--plot" => plot = args.next(),
            ONE => one = true,
            _ => grids.extend(arg.parse::<u32>()),
        }
    }
    if grids.is_empty() {
        grids = GRIDS.to_vec();
    }
    grids.sort_unstable();
    let done = if one {
        grids.iter().try_for_each(|&grid| measure(grid, bvh).map(|growth| println!("{}", written(&growth))))
    } else {
        grids.iter().map(|&grid| apart(grid, bvh)).collect::<Result<Vec<Growth>>>().and_then(|bakes| {
            print(&bakes);
            let title = "Cornell box, 256 rays a patch: time and memory against patches";
            plot.map_or(Ok(()), |file| {
                let svg = growth_svg(title, &bakes, &Machine::here())?;
                std::fs::write(&file, svg).map_err(|e| Error::io(file, e))
            })
        })
    };
    if let Err(error) = done {
        println!("scaling: {error}");
        std::process::exit(1);
    }
}

/// Bakes a grid in a process of its own.
fn apart(grid: u32, bvh: bool) -> Result<Growth> {
    let program = std::env::current_exe().map_err(|e| Error::io("this program", e))?;
    let mut command = Command::new(program);
    command.arg(ONE).arg(grid.to_string()).args(bvh.then_some("--bvh"));
    let output = command.output().map_err(|e| Error::io("this program", e))?;
    let text = String::from_utf8_lossy(&output.stdout);
    read(text.lines().last().unwrap_or_default()).ok_or_else(|| Error::Option(format!("grid {grid}: {text}")))
}

/// Bakes a grid a few times.
fn measure(grid: u32, bvh: bool) -> Result<Growth> {
    let scene: Scene = scene::load(Path::new("scenes/cornell.toml"), &SceneOverrides::default())?.0;
    let backend = if bvh { Backend::Bvh } else { Backend::Auto };
    let options = BakeOptions { resolution: Resolution::Grid(grid), backend, ..BakeOptions::default() };
    let mut reports: Vec<Report> = Vec::new();
    let seconds = |r: &Report| r.stages.iter().map(|s| s.seconds).sum::<f64>();
    // The peak of the first: what it leaves behind is no part of a bake.
    let mut memory = 0;
    while reports.len() < ROUNDS && reports.iter().map(seconds).sum::<f64>() < SECONDS {
        reports.push(bake(&scene, &options, &Silent)?.report);
        memory = if memory == 0 { peak_memory_bytes() } else { memory };
    }
    let median = |name: &str| {
        let of = |r: &Report| r.stages.iter().filter(|s| s.name == name).map(|s| s.seconds).sum();
        let mut x: Vec<f64> = reports.iter().map(of).collect();
        x.sort_by(f64::total_cmp);
        x[x.len() / 2]
    };
    let stages = reports[0].stages.iter().map(|s| (s.name.to_string(), median(s.name))).collect();
    let counts = &reports[0].counts;
    Ok(Growth { patches: counts.patches, stages, memory, rows: counts.form_factor_bytes as u64 })
}

/// What was measured, in a line for the process that asked.
fn written(g: &Growth) -> String {
    let stages: Vec<String> = g.stages.iter().map(|(name, seconds)| format!("{name}={seconds}")).collect();
    format!("{};{};{};{}", g.patches, g.memory, g.rows, stages.join(";"))
}

fn read(line: &str) -> Option<Growth> {
    let mut parts = line.split(';');
    let mut number = || parts.next()?.parse().ok();
    let (patches, memory, rows): (u64, _, _) = (number()?, number()?, number()?);
    let stage = |text: &str| {
        let (name, seconds) = text.split_once('=')?;
        Some((name.to_string(), seconds.parse().ok()?))
    };
    Some(Growth { patches: patches as usize, memory, rows, stages: parts.map(stage).collect::<Option<_>>()? })
}

fn print(bakes: &[Growth]) {
    let Some(last) = bakes.last() else { return };
    let names: Vec<&str> = last.stages.iter().map(|s| &s.0[..]).collect();
    println!("| patches | {} | total, s | rows, bytes a patch ({BYTES}) | peak, MB |", names.join(" | "));
    println!("|{}", "-|".repeat(names.len() + 4));
    for g in bakes {
        let times: Vec<String> = names.iter().map(|n| format!("{:.3}", g.seconds(n))).collect();
        let row_bytes = g.rows as f64 / g.patches as f64;
        let (times, total, peak) = (times.join(" | "), g.total(), g.memory as f64 * 1e-6);
        println!("| {} | {times} | {total:.2} | {row_bytes:.0} | {peak:.0} |", g.patches);
    }
    let [first, .., last] = bakes else { return };
    let (small, large) = (first.patches as f64, last.patches as f64);
    let exponent = |a: f64, b: f64| (b / a).ln() / (large / small).ln();
    println!(
        "Exponents from {small} to {large} patches; N log N: {:.3}",
        exponent(small * small.ln(), large * large.ln())
    );
    for name in names.iter().filter(|n| last.seconds(n) > SHARE * last.total()) {
        println!("  {name}: {:.3}", exponent(first.seconds(name), last.seconds(name)));
    }
    println!("  total: {:.3}", exponent(first.total(), last.total()));
    println!("  memory: {:.3}", exponent(first.memory as f64, last.memory as f64));
    println!("{}, {} rays a patch", Machine::here(), BakeOptions::default().rays);
}
