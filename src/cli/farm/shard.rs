//! `luxel farm shard`.

use std::{
    path::PathBuf,
    time::{Duration, Instant},
};

use luxel::{
    Error, Result,
    bake::Run,
    farm::{Cast, Plan, submit::command},
};
use serde_json::json;

use super::terminal;
use crate::cli::{
    args::{Running, on_threads},
    keeper::{Memory, SHARD},
    parse, say, signals,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Folder of the plan
    #[arg(value_name = "PLAN")]
    plan: PathBuf,
    /// Number of the shard, from 0; more than there are do nothing
    #[arg(value_name = "K", required_unless_present = "index", value_parser = parse::index, allow_negative_numbers = true)]
    number: Option<usize>,
    /// Take the number from this variable of the environment, such as SLURM_ARRAY_TASK_ID
    #[arg(long, value_name = "VARIABLE", conflicts_with = "number")]
    index: Option<String>,
    /// How often rows are written down while they are cast: a shard that is killed loses so much
    #[arg(long, value_name = "TIME", value_parser = parse::time, default_value = "5s", help_heading = "Running")]
    checkpoint_every: Duration,
    #[command(flatten)]
    memory: Memory,
    #[command(flatten)]
    running: Running,
}

pub fn run(args: &Args) -> Result<()> {
    let k = match (args.number, &args.index) {
        (Some(k), _) => k,
        (None, variable) => number_in(variable.as_deref().unwrap_or_default())?,
    };
    let begun = Instant::now();
    let progress = terminal(&args.running);
    let place = args.plan.display();
    let again = command("shard", &args.plan);
    signals::set_remedy(format!("the rows that were cast are kept; go on with: {again} {k}"));
    let (cast, count) = on_threads(args.running.threads, || {
        let plan = Plan::open(&args.plan)?;
        let mut keeper = args.memory.keeper_of(SHARD, &args.plan, 0);
        let mut run = Run { progress: &progress, keeper: &mut keeper, deadline: None };
        Ok((plan.cast(k, args.checkpoint_every, &mut run)?, plan.shards().len()))
    })?;
    let seconds = begun.elapsed().as_secs_f64();
    let (state, text, rays, resumed) = match cast {
        Cast::Now { rays, resumed: 0 } => ("done", format!("done in {seconds:.1} s, {rays} rays"), rays, 0),
        Cast::Now { rays, resumed } => {
            let text = format!("done in {seconds:.1} s, {rays} rays; {resumed} rows were there");
            ("done", text, rays, resumed)
        }
        Cast::Before => ("before", "was done before".into(), 0, 0),
        Cast::Beyond => {
            ("beyond", format!("nothing to do: {place} has {count} shards, 0 to {}", count.saturating_sub(1)), 0, 0)
        }
    };
    if args.running.json_progress {
        let line = json!({ "shard": k, "state": state, "rays": rays, "rows_resumed": resumed, "seconds": seconds });
        say(&format!("{line}\n"));
    } else if !args.running.quiet {
        say(&format!("{:<13} {text}\n", format!("shard {k}")));
    }
    Ok(())
}

/// The number of a shard in a variable of the environment.
fn number_in(variable: &str) -> Result<usize> {
    let value = std::env::var(variable);
    let value = value.map_err(|_| Error::Option(format!("--index {variable}: there is no such variable")))?;
    parse::index(&value)
        .map_err(|e| Error::Option(format!("--index {variable}: \"{value}\" is no number of a shard: {e}")))
}
