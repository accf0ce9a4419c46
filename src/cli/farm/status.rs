//! `luxel farm status`.

use std::path::PathBuf;

use luxel::{
    Result,
    farm::{Plan, ShardState, ShardStatus},
};
use serde_json::json;

use crate::cli::say;

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Folder of the plan
    #[arg(value_name = "PLAN")]
    plan: PathBuf,
    /// Tell it as JSON
    #[arg(long)]
    json: bool,
}

pub fn run(args: &Args) -> Result<()> {
    let plan = Plan::open(&args.plan)?;
    let shards = plan.status()?;
    let count = |state: ShardState| shards.iter().filter(|shard| shard.state == state).count();
    let states = [ShardState::Open, ShardState::Running, ShardState::Done, ShardState::Broken];
    let (rows, done): (usize, usize) = (sum(&shards, |s| s.rows), sum(&shards, |s| s.rows_done));
    if args.json {
        let totals: serde_json::Map<_, _> =
            states.iter().map(|state| (state.to_string(), json!(count(*state)))).collect();
        let all = json!({ "plan": args.plan.display().to_string(), "totals": totals, "rows": rows, "rows_done": done, "shards": shards });
        say(&format!("{all:#}\n"));
        return Ok(());
    }
    say(&format!("{:>7}  {:<8} {:>7} {:>9}\n", "shard", "state", "rows", "seconds"));
    for ShardStatus { shard, state, rows, rows_done, seconds, holder, problem } in &shards {
        let share = percent(*rows_done, *rows);
        let more = holder.as_ref().or(problem.as_ref()).map_or(String::new(), |text| format!("  {text}"));
        say(&format!("{shard:>7}  {state:<8} {share:>5.0} % {seconds:>9.1}{more}\n"));
    }
    let totals: Vec<String> = states.iter().map(|state| format!("{} {state}", count(*state))).collect();
    say(&format!("{} shards: {}; {:.0} % of the rows\n", shards.len(), totals.join(", "), percent(done, rows)));
    Ok(())
}

fn sum(shards: &[ShardStatus], of: impl Fn(&ShardStatus) -> usize) -> usize {
    shards.iter().map(of).sum()
}

fn percent(part: usize, whole: usize) -> f64 {
    100.0 * part as f64 / whole.max(1) as f64
}
