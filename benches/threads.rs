//! How much faster two threads are than one, stage by stage; and the most that the machine gives: two bakes at once, each
//! on a thread of its own, which share nothing but caches and memory.
//!
//! `cargo bench --bench threads -- [SCENE ...]`

use std::path::Path;

use luxel::{BakeOptions, Scene, bake, bench::SUITE, progress::Silent, report::Report, scene};

const SCENES: [&str; 2] = ["scenes/cornell.toml", "../shared/scenes/godot_room/room.glb"];
const ROUNDS: usize = 3;
/// Stages over this share of the time must be `ASKED` times as fast.
const SHARE: f64 = 0.05;
const ASKED: f64 = 1.9;

fn main() {
    let given: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let scenes = if given.is_empty() { SCENES.map(String::from).to_vec() } else { given };
    for path in scenes {
        if !Path::new(&path).exists() {
            println!("{path}: skipped");
        } else if let Err(error) = measure(Path::new(&path)) {
            println!("{path}: {error}");
        }
    }
}

fn measure(path: &Path) -> luxel::Result<()> {
    let added = SUITE.iter().find(|scene| path.ends_with(scene.file)).map(|scene| scene.overrides());
    let scene: Scene = scene::load(path, &added.unwrap_or_default())?.0;
    let (mut one, mut two, mut both) = (Vec::new(), Vec::new(), Vec::new());
    // In turns, so that what else the machine does falls on all alike.
    for _ in 0..ROUNDS {
        one.push(on(1, &scene)?);
        two.push(on(2, &scene)?);
        let (a, b) = std::thread::scope(|scope| {
            let other = scope.spawn(|| on(1, &scene));
            (on(1, &scene), other.join().expect("a bake does not panic"))
        });
        both.extend([a?, b?]);
    }
    println!("{}: | stage | 1 thread, s | 2 threads, s | times faster ({ASKED}) | two bakes at once |", scene.name);
    println!("|-|-|-|-|-|");
    let names: Vec<&str> = one[0].stages.iter().map(|s| s.name).collect();
    let total: f64 = names.iter().map(|n| median(&one, n)).sum();
    for name in names.iter().filter(|n| median(&one, n) > SHARE * total) {
        let (a, b, c) = (median(&one, name), median(&two, name), median(&both, name));
        println!("| {name} | {a:.3} | {b:.3} | {:.2} | {:.2} |", a / b, 2.0 * a / c);
    }
    Ok(())
}

fn on(threads: usize, scene: &Scene) -> luxel::Result<Report> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|e| luxel::Error::Option(e.to_string()))?;
    Ok(pool.install(|| bake(scene, &BakeOptions::default(), &Silent))?.report)
}

fn median(reports: &[Report], name: &str) -> f64 {
    let of = |r: &Report| r.stages.iter().filter(|s| s.name == name).map(|s| s.seconds).sum();
    let mut x: Vec<f64> = reports.iter().map(of).collect();
    x.sort_by(f64::total_cmp);
    x[x.len() / 2]
}
