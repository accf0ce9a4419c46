//! What it costs to share a bake out: CPU time of a plan, its shards and the merge against that of one process, and how
//! even the shards are, and how well foreseen.
//!
//! `cargo bench --bench farm -- [--shards N] [SCENE [OPTION ...]]`

use std::{
    path::Path,
    process::{Command, Stdio},
};

use luxel::farm::Plan;

const DEFAULT: [(&str, &[&str]); 6] = [
    ("scenes/cornell.toml", &["--rays", "1024"]),
    ("scenes/cornell.toml", &["--rays", "4096"]),
    ("scenes/cornell.toml", &["--rays", "16384"]),
    ("../shared/scenes/godot_room/room.glb", &["--rays", "1024"]),
    ("../shared/scenes/lost_empire/lost_empire.obj", &["--rays", "256"]),
    ("../shared/scenes/lost_empire/lost_empire.obj", &["--rays", "1024"]),
];
/// Light for scenes that have none.
const LIGHT: [&str; 2] = ["--sky", "1,1,1"];
/// Asked of the CPU time of the shards, and of the merge, of that of one process.
const ASKED: [f64; 2] = [1.05, 0.05];

fn main() {
    let mut given: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let mut shards = 16;
    if given.first().is_some_and(|a| a == "--shards") && given.len() > 1 {
        shards = given[1].parse().unwrap_or(shards);
        given.drain(..2);
    }
    println!(
        "{shards} shards; CPU seconds, all of one thread each; shards asked for at most {} of prepare, merge at most {} of bake",
        ASKED[0], ASKED[1]
    );
    println!(
        "| scene | bake | prepare | plan | shards | of prepare | with the plan | largest to mean | foreseen to measured | merge to a file | of bake | merge to \
         results | relight |"
    );
    println!("|-|-|-|-|-|-|-|-|-|-|-|-|-|");
    if let Some((scene, options)) = given.split_first() {
        let options: Vec<&str> = options.iter().map(String::as_str).collect();
        return measure(scene, &options, shards);
    }
    DEFAULT.iter().for_each(|(scene, options)| measure(scene, options, shards));
}

fn measure(scene: &str, options: &[&str], shards: usize) {
    let name = format!("{scene} {}", options.join(" "));
    if !Path::new(scene).exists() {
        return println!("| {name} | skipped |");
    }
    let folder = std::env::temp_dir().join(format!("luxel-farm-{}", std::process::id()));
    let place = |name: &str| folder.join(name).to_string_lossy().into_owned();
    let (plan, results, file, merged) = (place("plan"), place("results"), place("alone.lxt"), place("merged.lxt"));
    let mut all = vec![scene, "--threads", "1", "--quiet"];
    all.extend(LIGHT);
    all.extend(options);
    let with = |own: &[&str]| -> Option<f64> { seconds(own.iter().chain(&all).copied()) };
    let row = || -> Option<String> {
        let bake = with(&["bake", "--no-preview", "-o", &results])?;
        let prepare = with(&["prepare", "-o", &file])?;
        let planned = with(&["farm", "plan", "-o", &plan, "--shards", &shards.to_string()])?;
        let foreseen: f64 = Plan::open(Path::new(&plan)).ok()?.shards().iter().map(|part| part.seconds).sum();
        let mut each = Vec::new();
        for k in 0..shards {
            each.push(seconds(["farm", "shard", &plan, &k.to_string(), "--threads", "1", "--quiet"])?);
        }
        let end = ["--threads", "1", "--quiet"];
        let to_file = seconds(["farm", "merge", &plan, "-o", &merged].into_iter().chain(end))?;
        let to_results = seconds(["farm", "merge", &plan, "--no-preview", "-o", &results].into_iter().chain(end))?;
        let relight = seconds(["relight", &file, "--no-preview", "-o", &results].into_iter().chain(end))?;
        let sum: f64 = each.iter().sum();
        let most = each.iter().copied().fold(0.0, f64::max);
        Some(format!(
            "{bake:.2} | {prepare:.2} | {planned:.2} | {sum:.2} | {:.3} | {:.3} | {:.2} | {:.2} | {to_file:.2} | {:.3} | {to_results:.2} | \
             {relight:.2}",
            sum / prepare,
            (planned + sum) / prepare,
            most * each.len() as f64 / sum,
            foreseen / sum,
            to_file / bake
        ))
    };
    println!("| {name} | {} |", row().unwrap_or("failed".into()));
    std::fs::remove_dir_all(&folder).ok();
}

/// CPU seconds of a command of luxel; `None` if it fails.
fn seconds<'a>(arguments: impl IntoIterator<Item = &'a str>) -> Option<f64> {
    let before = children()?;
    let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
    let status = command.args(arguments).stdout(Stdio::null()).status();
    status.ok()?.success().then_some(())?;
    Some(children()? - before)
}

/// CPU seconds of all children that have ended, by Linux's hundredths.
fn children() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    // Behind the name, which may hold anything: state is field 3, cutime and cstime are 16 and 17.
    let fields: Vec<&str> = text.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |field: usize| fields.get(field - 3)?.parse::<f64>().ok();
    Some((ticks(16)? + ticks(17)?) / 100.0)
}
