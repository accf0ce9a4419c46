//! `luxel farm submit`.

use std::{
    env,
    io::{self, Write},
    path::PathBuf,
};

use luxel::{
    Error, Result,
    farm::{
        Plan,
        submit::{self, Submission},
    },
};

use crate::cli::say;

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Folder of the plan; all nodes must see it under this path, and luxel under its own
    #[arg(value_name = "PLAN")]
    plan: PathBuf,
    /// What the merge writes: a folder, or a transfer file [default: PLAN/result]
    #[arg(long, short, value_name = "DIR|FILE.lxt")]
    output: Option<PathBuf>,
    /// Shards that run at one time, at most
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    at_once: Option<u64>,
    /// Say what would be written and submitted, and do neither
    #[arg(long)]
    dry_run: bool,
    /// Submit to Slurm. All words after it are options of sbatch, for the shards and the merge:
    /// --partition, --time, --cpus-per-task ... (sbatch has no --dry-run: that is luxel's wherever it stands)
    #[arg(long, required = true, num_args = 0.., allow_hyphen_values = true, value_name = "SBATCH OPTION")]
    slurm: Option<Vec<String>>,
}

pub fn run(args: &Args) -> Result<()> {
    let program = env::current_exe().map_err(|e| Error::io("luxel", e))?;
    let output = args.output.clone().unwrap_or_else(|| args.plan.join("result"));
    let (dry, options): (Vec<String>, Vec<String>) =
        args.slurm.iter().flatten().cloned().partition(|option| option == "--dry-run");
    let batch = submit::batch(&Submission {
        plan: &Plan::open(&args.plan)?,
        output: &output,
        program: &program,
        at_once: args.at_once,
        options: &options,
    })?;
    if args.dry_run || !dry.is_empty() {
        say(&batch.describe());
        return Ok(());
    }
    let jobs = batch.submit()?;
    // Where stderr is gone there is nobody to tell.
    io::stderr().write_all(jobs.notes.as_bytes()).ok();
    say(&format!("shards: job {}\nmerge:  job {}\n", jobs.arrays.join(", "), jobs.merge));
    Ok(())
}
