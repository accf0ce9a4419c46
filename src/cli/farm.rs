//! `luxel farm`.

use std::{
    path::PathBuf,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Subcommand;
use luxel::{
    Error, Result,
    bake::{self, Run},
    farm::{Cast, Division, Plan, ShardState, ShardStatus, submit::command},
    lxt::Transfer,
    output::atomic::folder_of,
};
use serde_json::json;

use super::{
    args::{BakeArgs, Running, on_threads},
    keeper::{Memory, SHARD},
    parse,
    progress::{Style, Terminal},
    results::Results,
    say, signals,
};

mod submit;

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Make the patches, and divide the rest of the work into shards
    Plan(PlanArgs),
    /// Cast the rows of one shard; go on where it was interrupted; do nothing if it is done
    Shard(ShardArgs),
    /// Tell how far the shards are; seconds are those foreseen, on one thread
    Status(StatusArgs),
    /// Put the shards together: the results of `luxel bake`, or the transfer file of `luxel prepare`, byte for byte
    Merge(MergeArgs),
    /// Have a scheduler run the shards, and the merge behind them
    Submit(submit::Args),
}

#[derive(clap::Args, Debug)]
struct PlanArgs {
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

#[derive(clap::Args, Debug)]
struct ShardArgs {
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

#[derive(clap::Args, Debug)]
struct StatusArgs {
    /// Folder of the plan
    #[arg(value_name = "PLAN")]
    plan: PathBuf,
    /// Tell it as JSON
    #[arg(long)]
    json: bool,
}

#[derive(clap::Args, Debug)]
#[command(mut_arg("output", |output| output.value_name("DIR|FILE.lxt").help(MERGED)))]
struct MergeArgs {
    /// Folder of the plan
    #[arg(value_name = "PLAN")]
    plan: PathBuf,
    #[command(flatten)]
    results: Results,
    #[command(flatten)]
    memory: Memory,
    #[command(flatten)]
    running: Running,
}

const MERGED: &str = "Folder for the results of `luxel bake`, made if it is missing; or, by its ending, the transfer file of \
                      `luxel prepare`";

/// What to do with shards of a scene that has no light.
const UNLIT: &str = "merge the shards to a FILE.lxt, and add lights with luxel relight";

/// The ending of names of transfer files.
const TRANSFER: &str = "lxt";

pub fn run(args: &Args) -> Result<ExitCode> {
    match &args.command {
        Command::Plan(args) => plan(args)?,
        Command::Shard(args) => shard(args)?,
        Command::Status(args) => status(args)?,
        Command::Merge(args) => merge(args)?,
        Command::Submit(args) => submit::run(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn plan(args: &PlanArgs) -> Result<()> {
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

fn least(shards: &[luxel::farm::Part]) -> f64 {
    shards.iter().map(|part| part.seconds).fold(f64::INFINITY, f64::min)
}

fn shard(args: &ShardArgs) -> Result<()> {
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

fn status(args: &StatusArgs) -> Result<()> {
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

fn merge(args: &MergeArgs) -> Result<()> {
    on_threads(args.running.threads, || {
        let (place, plan) = (args.results.place(), Plan::open(&args.plan)?);
        plan.check_output(place)?;
        let is_file = place.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(TRANSFER));
        if is_file { merge_to_file(args, &plan) } else { merge_to_folder(args, &plan) }
    })
}

fn merge_to_file(args: &MergeArgs, plan: &Plan) -> Result<()> {
    let (place, running) = (args.results.place(), &args.running);
    let progress = terminal(running);
    let _alone = Transfer::claim(place, "luxel farm merge")?;
    let mut keeper = args.memory.keeper(folder_of(place), 0);
    plan.merge_to_file(place, &mut Run { progress: &progress, keeper: &mut keeper, deadline: None })?;
    if !running.quiet && !running.json_progress {
        say(&format!("{:<14}{}\n", "written to", place.display()));
    }
    Ok(())
}

fn merge_to_folder(args: &MergeArgs, plan: &Plan) -> Result<()> {
    let progress = terminal(&args.running);
    let staged = args.results.open()?;
    let mut keeper = args.memory.keeper(args.results.folder(), args.results.pixels());
    let mut run = Run { progress: &progress, keeper: &mut keeper, deadline: None };
    let mut kept = plan.merge()?;
    let scene = plan.scene()?;
    if !scene.has_light() {
        return Err(Error::Scene(format!("scene \"{}\" has no light: {UNLIT}", scene.name)));
    }
    let mut bake = bake::bake_with(&scene, plan.options(), &mut kept, &mut run)?;
    keeper.tell(&mut bake);
    bake.report.rows.from = Some(args.plan.display().to_string());
    args.results.write(&scene, &mut bake, staged, &progress)?;
    args.results.tell(&scene, &bake, &args.running);
    Ok(())
}

fn terminal(running: &Running) -> Terminal {
    Terminal::new(Style::choose(running.quiet, running.json_progress))
}
