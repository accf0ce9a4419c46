//! How stable bakes are: the cases of `tests/stress` at default quality on every backend, the balance of power of whole
//! scenes, and the curves behind them, as Markdown.
//!
//! `cargo bench --bench stability -- [SCENE ...]`; scenes are files with their lights in them, by default those of
//! `scenes/`.

use std::path::{Path, PathBuf};

use luxel::{
    BakeOptions,
    bake::Bake,
    options::{Backend, Resolution},
    progress::Silent,
    scene::{self, SceneOverrides},
};

#[path = "../tests/stress/cases.rs"]
mod cases;
#[path = "../tests/common/mod.rs"]
mod common;
#[path = "../tests/stress/found.rs"]
mod found;
#[allow(dead_code)] // Its test is not run here.
#[path = "../tests/stress/precision.rs"]
mod precision;

use cases::Case;
use found::{Found, difference};

/// Seeds that the worst is taken of, and that tell the noise.
const SEEDS: u64 = 3;

fn main() {
    let given: Vec<PathBuf> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).map(PathBuf::from).collect();
    let defaults = BakeOptions::default();
    println!("luxel {}, grid 64, {} rays, worst of {SEEDS} seeds\n", env!("CARGO_PKG_VERSION"), defaults.rays);
    cases(&defaults);
    rays();
    precision();
    scenes(&given);
}

fn backends() -> Vec<Backend> {
    if cfg!(feature = "embree") { vec![Backend::Embree, Backend::Bvh] } else { vec![Backend::Bvh] }
}

fn percent(x: Option<f64>) -> String {
    x.map_or("".into(), |x| format!("{:.3}", 100.0 * x))
}

/// Of every case: the worst balance, mean and leak, noise and difference of backends.
fn cases(defaults: &BakeOptions) {
    println!(
        "| case | balance % | of independent rays % | error of mean % | leak % | noise between seeds % | between backends % | steps | sound |"
    );
    println!("|-|-|-|-|-|-|-|-|-|");
    for case in cases::all(64) {
        let bake = |backend, seed| case.stage.bake(&BakeOptions { backend, seed, ..defaults.clone() });
        let bakes: Vec<Bake> = (0..SEEDS).map(|seed| bake(Backend::Auto, seed)).collect();
        let others: Vec<Bake> = backends().into_iter().skip(1).map(|b| bake(b, 0)).collect();
        let found: Vec<Found> = bakes.iter().chain(&others).map(|b| Found::of(&case, b)).collect();
        let worst = |of: &dyn Fn(&Found) -> Option<f64>| found.iter().filter_map(of).map(f64::abs).reduce(f64::max);
        println!(
            "| {} | {} | {} | {} | {} | {} | {} | {} | {} |",
            case.name,
            percent(worst(&|f| Some(f.lost))),
            percent(worst(&|f| Some(f.sigma))),
            percent(worst(&|f| f.mean)),
            percent(worst(&|f| f.leak.map(|l| l[0].max(l[1])))),
            percent(bakes[1..].iter().map(|b| difference(&bakes[0], b)).reduce(f64::max)),
            percent(others.iter().map(|b| difference(&bakes[0], b)).reduce(f64::max)),
            found.iter().map(|f| f.iterations).max().unwrap_or_default(),
            if found.iter().all(|f| f.sound) { "yes" } else { "NO" }
        );
    }
}

/// Balance and mean against rays, root mean square over seeds.
fn rays() {
    println!("\n| rays | balance %: room | soup | error of mean %: room | soup |");
    println!("|-|-|-|-|-|");
    let all: [Case; 2] = [cases::frames().swap_remove(2), cases::shapes().swap_remove(4)];
    for rays in [16, 64, 256, 1024, 4096] {
        let (mut lost, mut mean) = (Vec::new(), Vec::new());
        for case in &all {
            let options = |seed| BakeOptions { rays, seed, resolution: Resolution::Grid(32), ..BakeOptions::default() };
            let found: Vec<Found> = (0..4).map(|seed| Found::of(case, &case.stage.bake(&options(seed)))).collect();
            let rms = |of: &dyn Fn(&Found) -> f64| (found.iter().map(|f| of(f).powi(2)).sum::<f64>() / 4.0).sqrt();
            lost.push(percent(Some(rms(&|f| f.lost))));
            mean.push(percent(Some(rms(&|f| f.mean.unwrap_or_default()))));
        }
        println!("| {rays} | {} | {} |", lost.join(" | "), mean.join(" | "));
    }
}

/// What a furnace's bounces come to in single and in double precision.
fn precision() {
    println!("\n| albedo | error of a furnace, f64 | f32 |");
    println!("|-|-|-|");
    let f = precision::furnace();
    for albedo in [0.5, 0.9, 0.99, 0.999, 0.9999] {
        let double = precision::furnace_error(&f, albedo, |x| x);
        let single = precision::furnace_error(&f, albedo, precision::single);
        println!("| {albedo} | {double:.1e} | {single:.1e} |");
    }
}

/// The balance of whole scenes.
fn scenes(given: &[PathBuf]) {
    println!("\n| scene | emitted W | emitted - missed - absorbed - escaped % | direct - absorbed - escaped % |");
    println!("|-|-|-|-|");
    let mut files = given.to_vec();
    if files.is_empty() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes");
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path());
        files.extend(entries.filter(|p| p.extension().is_some_and(|e| e == "toml")));
        files.sort();
    }
    for path in files {
        let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let baked = scene::load(&path, &SceneOverrides::default())
            .and_then(|(scene, _)| luxel::bake(&scene, &BakeOptions::default(), &Silent));
        match baked {
            Ok(bake) => {
                let energy = &bake.report.energy;
                let worst = |e: [f64; 3]| e.into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs()));
                let emitted = energy.emitted[0];
                let balance = percent(energy.unaccounted.and_then(worst));
                println!("| {name} | {emitted:.4e} | {balance} | {} |", percent(worst(energy.imbalance)));
            }
            Err(error) => println!("| {name} | {error} |"),
        }
    }
}
