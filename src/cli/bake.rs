//! `luxel bake`.

use luxel::Result;

use super::{
    args::{BakeArgs, Goals},
    progress::{Style, Terminal},
    results::Results,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    #[command(flatten)]
    results: Results,
    #[command(flatten)]
    goals: Goals,
    #[command(flatten)]
    bake: BakeArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let job = args.bake.load()?;
    let scene = &job.scene;
    let goal = args.bake.goal(&args.goals);
    let running = &args.bake.running;
    let staged = args.results.open()?;
    let progress = Terminal::new(Style::choose(running.quiet, running.json_progress));
    let bake = job.on_threads(|| {
        let mut bake = luxel::bake_to(scene, &job.options, &goal, &progress)?;
        args.results.write(scene, &mut bake, staged, &progress)?;
        Ok(bake)
    })?;
    args.results.tell(scene, &bake, running);
    Ok(())
}
