//! `luxel farm plan`.

use std::path::PathBuf;

use luxel::{
    Result,
    bake::Run,
    farm::{Division, Part, Plan, submit::command},
};
use serde_json::json;

use super::{UNLIT, terminal};
use crate::cli::{args::BakeArgs, keeper::Memory, parse, say};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Folder of the plan, which all processes must see; made if it is missing
    #[arg(long, short, value_name = "PLAN")]
    output: PathBuf,
    #[command(flatten)]
    division: Shards,
    #[command(flatten)]
    memory: Memory,
    #[command(flatten)]
    bake: BakeArgs,
}

#[derive(clap::Args, Debug)]
#[group(required = true, multiple = false)]
struct Shards {
    /// Divide the work into N shards, or fewer where it is too little for so many
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    shards: Option<u32>,
    /// Divide it into shards that each take about T seconds on a machine like this one with all its threads (or
    /// --threads)
    #[arg(long, value_name = "T", value_parser = parse::positive, allow_hyphen_values = true)]
    shard_seconds: Option<f64>,
}

pub fn run(args: &Args) -> Result<()> {
    Plan::check_place(&args.output)?;
    let (source, job) = args.bake.load_source()?;
    let running = &args.bake.running;
    let progress = terminal(running);
    let division = match (args.division.shards, args.division.shard_seconds) {
        (Some(shards), _) => Division::Shards(shards as usize),
        (None, seconds) => Division::Seconds(seconds.unwrap_or(f64::INFINITY)),
    };
    let plan = job.on_threads(|| {
        let mut keeper = args.memory.keeper(&args.output, 0);
        let mut run = Run { progress: &progress, keeper: &mut keeper, deadline: None };
        Plan::make(&args.output, &source, &job.scene, &job.options, division, &mut run)
    })?;
    let shards = plan.shards();
    let (count, place) = (shards.len(), args.output.display());
    if running.json_progress {
        let seconds: Vec<f64> = shards.iter().map(|part| part.seconds).collect();
        say(&format!("{}\n", json!({ "plan": place.to_string(), "shards": count, "cpu_seconds": seconds })));
    } else if !running.quiet {
        let all: f64 = shards.iter().map(|part| part.seconds).sum();
        let most = shards.iter().map(|part| part.seconds).fold(0.0, f64::max);
        let line = |name: &str, value: String| say(&format!("{name:<14}{value}\n"));
        line("scene", format!("{}: {} triangles", job.scene.name, job.scene.triangles.len()));
        for warning in &job.scene.warnings {
            line("warning", warning.clone());
        }
        if !job.scene.has_light() {
            line("warning", format!("there is no light: {UNLIT}"));
        }
        line("shards", format!("{count} of {:.2} to {most:.2} s of one thread each, {all:.1} s in all", least(shards)));
        line("plan", place.to_string());
        let [shard, merge] = ["shard", "merge"].map(|name| command(name, &args.output));
        line("next", format!("{shard} K for K = 0 to {}, then {merge} -o DIR", count - 1));
    }
    Ok(())
}

fn least(shards: &[Part]) -> f64 {
    shards.iter().map(|part| part.seconds).fold(f64::INFINITY, f64::min)
}
