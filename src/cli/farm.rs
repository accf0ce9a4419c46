//! `luxel farm`.

use std::process::ExitCode;

use clap::Subcommand;
use luxel::Result;

use super::{
    args::Running,
    progress::{Style, Terminal},
};

mod merge;
mod plan;
mod shard;
mod status;
mod submit;

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Make the patches, and divide the rest of the work into shards
    Plan(plan::Args),
    /// Cast the rows of one shard; go on where it was interrupted; do nothing if it is done
    Shard(shard::Args),
    /// Tell how far the shards are; seconds are those foreseen, on one thread
    Status(status::Args),
    /// Put the shards together: the results of `luxel bake`, or the transfer file of `luxel prepare`, byte for byte
    Merge(merge::Args),
    /// Have a scheduler run the shards, and the merge behind them
    Submit(submit::Args),
}

/// What to do with shards of a scene that has no light.
const UNLIT: &str = "merge the shards to a FILE.lxt, and add lights with luxel relight";

pub fn run(args: &Args) -> Result<ExitCode> {
    match &args.command {
        Command::Plan(args) => plan::run(args)?,
        Command::Shard(args) => shard::run(args)?,
        Command::Status(args) => status::run(args)?,
        Command::Merge(args) => merge::run(args)?,
        Command::Submit(args) => submit::run(args)?,
    }
    Ok(ExitCode::SUCCESS)
}

fn terminal(running: &Running) -> Terminal {
    Terminal::new(Style::choose(running.quiet, running.json_progress))
}
