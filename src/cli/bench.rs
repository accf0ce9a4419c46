//! `luxel bench`.

use std::path::{Path, PathBuf};

use luxel::{
    Error, Result,
    bench::{self, Extent, Machine, SUITE, SceneBench, Settings},
    output::atomic::Staged,
    scene::{self, SceneOverrides},
};

use super::{
    args::{Lights, Running, on_threads},
    parse,
    progress::{Style, Terminal},
    say, signals,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// The scene: an OBJ, glTF or GLB file, or a scene file (.toml)
    #[arg(value_name = "SCENE", required_unless_present = "suite", conflicts_with = "suite")]
    scene: Option<PathBuf>,
    /// The scenes of the suite: those of the repository, and shared ones where they are present
    #[arg(long)]
    suite: bool,
    /// Folder for tables, plots and references; made if it is missing
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Every patch source with every grid, number of rays, reconstruction and ray tracer
    #[arg(long)]
    full: bool,
    /// Random points where errors are measured
    #[arg(long, value_name = "N", value_parser = parse::count, default_value = "1000")]
    places: usize,
    /// Points that times are told for
    #[arg(long, value_name = "N", value_parser = parse::count, default_value = "100000")]
    job: usize,
    /// Runs of each configuration, of which the median counts; what takes over 5 s runs once
    #[arg(long, value_name = "N", value_parser = parse::count, default_value = "3")]
    repeats: usize,
    /// Leave out bakes that are foretold to take longer, seconds
    #[arg(long, value_name = "SECONDS", value_parser = parse::positive, default_value = "20")]
    limit: f64,
    /// Standard error of the reference
    #[arg(long, value_name = "SHARE", value_parser = parse::share, default_value = "0.5%")]
    stderr: f64,
    /// A simplified mesh of the scene, to compare as patches too
    #[arg(long, value_name = "FILE", conflicts_with = "suite")]
    proxy: Option<PathBuf>,
    /// Folder of the repository's scenes
    #[arg(long, value_name = "DIR", default_value = "scenes")]
    scenes: PathBuf,
    /// Folder of the shared scenes
    #[arg(long, value_name = "DIR", default_value = "../shared/scenes")]
    shared: PathBuf,
    #[command(flatten)]
    lights: Lights,
    #[command(flatten)]
    running: Running,
}

pub fn run(args: &Args) -> Result<()> {
    let settings = Settings {
        extent: if args.full { Extent::Full } else { Extent::Quick },
        points: args.places,
        job: args.job,
        repeats: args.repeats,
        limit: args.limit,
        reference_error: args.stderr,
        ..Settings::default()
    };
    let jobs = match &args.scene {
        Some(path) => vec![(path.clone(), SceneOverrides { proxy: args.proxy.clone(), ..args.lights.overrides(None) })],
        None => suite(args)?,
    };
    let running = &args.running;
    let progress = Terminal::new(Style::choose(running.quiet, running.json_progress));
    signals::set_remedy(format!("scenes and references that were done are in {}", args.output.display()));
    on_threads(running.threads, || {
        let machine = Machine::here();
        let mut benches: Vec<SceneBench> = Vec::new();
        for (path, overrides) in &jobs {
            let scene = scene::load(path, overrides)?.0;
            benches.push(bench::run(&scene, &settings, &args.output, &progress)?);
            // After every scene: what comes later may take long.
            write(&args.output, &benches, &machine)?;
        }
        if !running.quiet && !running.json_progress {
            say(&bench::markdown(&benches, &machine));
            say(&format!("\nwritten to {}\n", args.output.display()));
        }
        Ok(())
    })
}

/// Scenes of the suite that are there.
fn suite(args: &Args) -> Result<Vec<(PathBuf, SceneOverrides)>> {
    let mut jobs = Vec::new();
    for scene in &SUITE {
        let path = scene.path(&args.scenes, &args.shared);
        if path.is_file() {
            jobs.push((path, scene.overrides()));
        } else if scene.shared {
            super::complain(&format!("skipped: no file {} (--shared names the folder)", path.display()));
        } else {
            return Err(Error::Option(format!(
                "no file {}: run it from the repository, or name the folder of its scenes by --scenes",
                path.display()
            )));
        }
    }
    Ok(jobs)
}

fn write(folder: &Path, benches: &[SceneBench], machine: &Machine) -> Result<()> {
    let mut staged = Staged::open(folder)?;
    staged.write("bench.csv", |out| out.write_all(bench::csv(benches, machine).as_bytes()))?;
    let mut text = bench::markdown(benches, machine);
    for bench in benches {
        let name = format!("{}.svg", file_name(&bench.name));
        let svg = bench::svg(bench, machine)?;
        staged.write(&name, |out| out.write_all(svg.as_bytes()))?;
        text.push_str(&format!("\n![{}]({name})\n", bench.name));
    }
    staged.write("bench.md", |out| out.write_all(text.as_bytes()))?;
    staged.commit().map(drop)
}

/// Letters and digits of a scene's name.
fn file_name(name: &str) -> String {
    let kept = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let name: String = name.chars().map(kept).collect();
    if name.trim_matches('.').is_empty() { "scene".into() } else { name }
}
