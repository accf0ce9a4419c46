//! What skipping saves and costs: bakes with and without it, in turn, in one run.
//!
//! `cargo bench --bench skip -- [SCENE ...]`; without scenes those of the repository and, where they are, some of
//! `../shared/scenes`, with a sky and a sun where a scene has no light.

use std::{path::Path, time::Instant};

use glam::{DVec3, Vec3};
use luxel::{
    BakeOptions, Scene,
    bake::Bake,
    progress::Silent,
    scene::{self, SceneOverrides},
};

const ROUNDS: usize = 3;
const SCENES: [&str; 9] = [
    "scenes/cornell.toml",
    "scenes/curved_room.toml",
    "scenes/two_rooms.toml",
    "../shared/scenes/cornell_mcguire/CornellBox-Sphere.obj",
    "../shared/scenes/veach_ajar/veach_ajar.obj",
    "../shared/scenes/ignis_room/Room.obj",
    "../shared/scenes/godot_room/room.glb",
    "../shared/scenes/map_pandora/pandora.obj",
    "../shared/scenes/lost_empire/lost_empire.obj",
];

fn main() {
    let given: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with("--")).collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let scenes = if given.is_empty() {
        SCENES.iter().map(|s| root.join(s)).filter(|p| p.exists()).collect()
    } else {
        given.iter().map(Into::into).collect::<Vec<_>>()
    };
    let mut items = String::new();
    println!("| scene | all, s | skipping, s | share | direct: mean, rms | indirect: mean, rms |");
    println!("|-|-|-|-|-|-|");
    for path in &scenes {
        match measure(path) {
            Ok(text) => items.push_str(&text),
            Err(error) => println!("{}: {error}", path.display()),
        }
    }
    println!("{} threads, medians of {ROUNDS}; differences are relative to the mean\n", rayon::current_num_threads());
    println!("| scene | skipped | patches | rays | seconds, estimated | bound |");
    println!("|-|-|-|-|-|-|");
    println!("{items}");
}

fn load(path: &Path) -> luxel::Result<Scene> {
    let scene = scene::load(path, &SceneOverrides::default())?.0;
    if scene.has_light() {
        return Ok(scene);
    }
    let lights = SceneOverrides {
        sky: Some(Vec3::new(0.3, 0.4, 0.6)),
        suns: vec![(DVec3::new(0.3, -1.0, 0.5), Vec3::new(3.0, 3.0, 2.5))],
        ..SceneOverrides::default()
    };
    Ok(scene::load(path, &lights)?.0)
}

/// Prints the line of one scene; returns those of its items.
fn measure(path: &Path) -> luxel::Result<String> {
    let scene = load(path)?;
    let (mut seconds, mut bakes) = ([Vec::new(), Vec::new()], [None, None]);
    for _ in 0..ROUNDS {
        for (k, skip) in [false, true].into_iter().enumerate() {
            let begun = Instant::now();
            let bake = luxel::bake(&scene, &BakeOptions { skip, ..BakeOptions::default() }, &Silent)?;
            seconds[k].push(begun.elapsed().as_secs_f64());
            bakes[k] = Some(bake);
        }
    }
    let [Some(all), Some(skipping)] = bakes else { return Ok(String::new()) };
    let [whole, less] = seconds.map(median);
    println!(
        "| {} | {whole:.2} | {less:.2} | {:.2} | {} | {} |",
        scene.name,
        less / whole,
        difference(&all, &skipping, |b| &b.vertices.direct),
        difference(&all, &skipping, |b| &b.vertices.indirect),
    );
    let number = |x: Option<f64>| x.map_or("-".to_string(), |x| format!("{x:.2e}"));
    let item = |s: &luxel::report::Skipped| {
        let (seconds, bound) = (number(s.seconds), number(s.bound));
        format!("| {} | {} | {} | {} | {seconds} | {bound} |\n", scene.name, s.what, s.patches, s.rays)
    };
    Ok(skipping.report.skipped.iter().map(item).collect())
}

/// Mean and root mean square of what skipping changes, relative to the mean.
fn difference(all: &Bake, skipping: &Bake, of: impl Fn(&Bake) -> &Vec<Vec3>) -> String {
    let (a, b) = (of(all), of(skipping));
    if a.len() != b.len() {
        return format!("{} and {} vertices", a.len(), b.len());
    }
    let grey = |v: &Vec3| v.element_sum() as f64 / 3.0;
    let changes = || a.iter().zip(b).map(|(a, b)| grey(b) - grey(a));
    let mean = a.iter().map(grey).sum::<f64>().max(f64::MIN_POSITIVE);
    let n = a.len() as f64;
    let rms = (changes().map(|d| d * d).sum::<f64>() / n).sqrt();
    format!("{:+.1e}, {:.1e}", changes().sum::<f64>() / mean, rms * n / mean)
}

fn median(mut x: Vec<f64>) -> f64 {
    x.sort_by(f64::total_cmp);
    x[x.len() / 2]
}
