//! `luxel farm merge`.

use std::path::PathBuf;

use luxel::{
    Error, Result,
    bake::{self, Run},
    farm::Plan,
    lxt::Transfer,
    output::atomic::folder_of,
};

use super::{UNLIT, terminal};
use crate::cli::{
    args::{Running, on_threads},
    keeper::{MERGE, Memory},
    results::Results,
    say,
};

#[derive(clap::Args, Debug)]
#[command(mut_arg("output", |output| output.value_name("DIR|FILE.lxt").help(MERGED)))]
pub struct Args {
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

/// The ending of names of transfer files.
const TRANSFER: &str = "lxt";

pub fn run(args: &Args) -> Result<()> {
    on_threads(args.running.threads, || {
        let (place, plan) = (args.results.place(), Plan::open(&args.plan)?);
        plan.check_output(place)?;
        let is_file = place.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(TRANSFER));
        if is_file { merge_to_file(args, &plan) } else { merge_to_folder(args, &plan) }
    })
}

fn merge_to_file(args: &Args, plan: &Plan) -> Result<()> {
    let (place, running) = (args.results.place(), &args.running);
    let progress = terminal(running);
    let _alone = Transfer::claim(place, "luxel farm merge")?;
    let mut keeper = args.memory.keeper_of(MERGE, folder_of(place), 0);
    plan.merge_to_file(place, &mut Run { progress: &progress, keeper: &mut keeper, deadline: None })?;
    if !running.quiet && !running.json_progress {
        say(&format!("{:<14}{}\n", "written to", place.display()));
    }
    Ok(())
}

fn merge_to_folder(args: &Args, plan: &Plan) -> Result<()> {
    let progress = terminal(&args.running);
    let staged = args.results.open()?;
    let mut keeper = args.memory.keeper_of(MERGE, args.results.place(), args.results.pixels());
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
