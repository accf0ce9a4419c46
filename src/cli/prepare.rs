//! `luxel prepare`.

use std::{path::PathBuf, time::Instant};

use luxel::{
    Error, Result,
    bake::{self, Kept, Run},
    lxt::Transfer,
    output::{atomic::folder_of, report::bytes},
};

use super::{
    args::BakeArgs,
    keeper::Memory,
    progress::{Style, Terminal},
    say,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Transfer file to write
    #[arg(long, short, value_name = "FILE.lxt")]
    output: PathBuf,
    #[command(flatten)]
    memory: Memory,
    #[command(flatten)]
    bake: BakeArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let begun = Instant::now();
    let (source, job) = args.bake.load_source()?;
    let running = &args.bake.running;
    let progress = Terminal::new(Style::choose(running.quiet, running.json_progress));
    // A long computation should not find at its end that there is no place for its result.
    let _alone = Transfer::claim(&args.output, "luxel prepare")?;
    let (rays, rows, patches) = job.on_threads(|| {
        let mut kept = Kept::default();
        let mut keeper = args.memory.keeper(folder_of(&args.output), 0);
        let mut run = Run { progress: &progress, keeper: &mut keeper, deadline: None };
        let rays = bake::prepare(&job.scene, &job.options, &mut kept, &mut run)?;
        Transfer::write(&args.output, &source, &job.scene, &job.options, &kept)?;
        Ok((rays, kept.rows.size_in_bytes(), kept.rows.patches()))
    })?;
    if !running.quiet && !running.json_progress {
        let line = |name: &str, value: String| say(&format!("{name:<14}{value}\n"));
        line("scene", format!("{}: {} triangles", job.scene.name, job.scene.triangles.len()));
        line("patches", patches.to_string());
        line("rays", format!("{rays} for rows of {}", bytes(rows as u64)));
        line("seconds", format!("{:.2}", begun.elapsed().as_secs_f64()));
        for warning in &job.scene.warnings {
            line("warning", warning.clone());
        }
        let size = std::fs::metadata(&args.output).map_err(|e| Error::io(&args.output, e))?.len();
        line("written to", format!("{}, {}", args.output.display(), bytes(size)));
    }
    Ok(())
}
