//! `luxel bake`.

use std::path::PathBuf;

use luxel::{
    Error, Goal, Result,
    bake::{Bake, Run},
    lxt::Cache,
};

use super::{
    args::{BakeArgs, Goals, Job},
    keeper::{Keeper, Memory, Resume},
    progress::{Style, Terminal},
    results::Results,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    results: Results,
    /// Folder of rows from earlier bakes: those of the same surfaces with the same settings are used again, whatever the
    /// lights and albedos, and new ones are added
    #[arg(long, value_name = "DIR", conflicts_with_all = ["target_error", "budget"])]
    cache: Option<PathBuf>,
    #[command(flatten)]
    goals: Goals,
    #[command(flatten)]
    memory: Memory,
    #[command(flatten)]
    resume: Resume,
    #[command(flatten)]
    bake: BakeArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let job = args.bake.load()?;
    let scene = &job.scene;
    let goal = args.bake.goal(&args.goals);
    let running = &args.bake.running;
    let cache = args.cache.as_deref().map(Cache::open).transpose()?;
    let staged = args.results.open()?;
    let progress = Terminal::new(Style::choose(running.quiet, running.json_progress));
    let bake = job.on_threads(|| {
        let folder = args.results.place();
        let mut keeper = args.memory.keeper(folder, args.results.pixels());
        // A search bakes many times, with settings of its own.
        if goal.target_error.is_none() && goal.budget.is_none() {
            args.resume.arm(&mut keeper, folder, scene, &job.options)?;
        }
        let baked = bake(&job, &goal, cache.as_ref(), &mut keeper, &progress);
        if let Err(Error::Interrupted(_)) = baked {
            // Before `staged` goes, which takes a folder with it that was made for this bake and is empty.
            keeper.save();
        }
        let mut bake = baked?;
        keeper.tell(&mut bake);
        args.results.write(scene, &mut bake, staged, &progress)?;
        keeper.finish()?;
        Ok(bake)
    })?;
    args.results.tell(scene, &bake, running);
    Ok(())
}

fn bake(job: &Job, goal: &Goal, cache: Option<&Cache>, keeper: &mut Keeper, progress: &Terminal) -> Result<Bake> {
    let (scene, options) = (&job.scene, &job.options);
    match cache {
        Some(cache) => cache.bake(scene, options, &mut Run { progress, keeper, deadline: None }),
        None => luxel::goal::bake_to_kept(scene, options, goal, keeper, progress),
    }
}
