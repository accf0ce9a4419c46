//! `luxel relight`.

use std::path::PathBuf;

use luxel::{
    Result,
    bake::{self, Run},
    lxt::Transfer,
};

use super::{
    args::{Lights, Running, on_threads},
    orbit::Orbit,
    progress::{Style, Terminal},
    results::Results,
    say,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// The transfer file, made by `luxel prepare`
    #[arg(value_name = "FILE.lxt")]
    file: PathBuf,
    #[command(flatten)]
    results: Results,
    #[command(flatten)]
    lights: Lights,
    #[command(flatten)]
    orbit: Orbit,
    /// Leave out the lights in the file that are no surfaces
    #[arg(long, help_heading = "Lights and materials")]
    replace_lights: bool,
    #[command(flatten)]
    running: Running,
}

pub fn run(args: &Args) -> Result<()> {
    let staged = args.results.open()?;
    let progress = Terminal::new(Style::choose(args.running.quiet, args.running.json_progress));
    let done = on_threads(args.running.threads, || {
        let transfer = Transfer::open(&args.file)?;
        let scene = transfer.scene(&args.lights.overrides(None), args.replace_lights)?;
        let round = args.orbit.round(&scene, transfer.options())?;
        let mut kept = transfer.kept(&scene)?;
        let mut run = Run { progress: &progress, keeper: &mut (), deadline: None };
        let mut bake = bake::bake_with(&scene, transfer.options(), &mut kept, &mut run)?;
        bake.report.rows.from = Some(args.file.display().to_string());
        if let Some(round) = round {
            args.orbit.write(round, (&scene, bake, &kept.rows), &args.results, staged, &progress)?;
            return Ok(None);
        }
        args.results.write(&scene, &mut bake, staged, &progress)?;
        Ok(Some((scene, bake)))
    })?;
    match done {
        Some((scene, bake)) => args.results.tell(&scene, &bake, &args.running),
        None if args.running.quiet || args.running.json_progress => {}
        None => say(&format!("{:<14}{}\n", "written to", args.results.place().display())),
    }
    Ok(())
}
