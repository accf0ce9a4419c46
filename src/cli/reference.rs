//! `luxel reference`.

use std::{
    io::{self, Write},
    path::PathBuf,
};

use glam::Vec3;
use luxel::{
    Result,
    output::atomic::{Staged, check_is_no_input, place_of},
    reference::{Reference, ReferenceOptions, Until},
    trace,
};

use super::{
    args::SceneArgs,
    parse,
    points::{Point, read},
    progress::{Style, Terminal},
    say,
};

/// Paths a point if nothing else ends the work.
const MOST: u32 = 1 << 20;

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Points: `x y z nx ny nz` a line, separated by blanks or commas; `#` begins a comment
    #[arg(long, value_name = "FILE")]
    at: PathBuf,
    /// CSV file to write: irradiance and its standard errors, W/m2
    #[arg(long, short, value_name = "REF.csv")]
    output: PathBuf,
    /// Stop at this standard error of the total luminance, root mean square over the points relative to its mean: `0.3%`
    /// [default: 0.5%, if there is no --spp]
    #[arg(long, value_name = "SHARE", value_parser = parse::share, allow_hyphen_values = true)]
    stderr: Option<f64>,
    /// Paths a point; with --stderr: at most so many [default there: 1048576]
    #[arg(long, value_name = "N", value_parser = parse::paths, allow_hyphen_values = true)]
    spp: Option<u32>,
    #[command(flatten)]
    scene: SceneArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let points = read(&args.at)?;
    let job = args.scene.load()?;
    let (folder, name) = place_of(&args.output)?;
    check_is_no_input(&args.output, &[&args.at, &args.scene.scene])?;
    let mut staged = Staged::open(folder)?;
    let running = &args.scene.running;
    let progress = Terminal::new(Style::choose(running.quiet, running.json_progress));
    let until = match (args.stderr, args.spp) {
        (None, Some(paths)) => Until::Samples(paths),
        (relative, most) => Until::StandardError { relative: relative.unwrap_or(0.005), most: most.unwrap_or(MOST) },
    };
    let (backend, reference) = job.on_threads(|| {
        let scene = luxel::reference::check_scene(&job.scene)?;
        let tracer = trace::build(job.options.backend, &scene.geometry())?;
        let local: Vec<_> = points.iter().map(|p| p.local(&scene.frame)).collect();
        let options = ReferenceOptions { until, seed: job.options.seed };
        Ok((tracer.name(), luxel::reference::irradiance(scene, &*tracer, &local, &options, &progress)?))
    })?;
    staged.write(name, |out| write(out, &points, &reference))?;
    staged.commit()?;
    if !running.quiet && !running.json_progress {
        say(&summary(&backend, &reference));
        say(&format!("{:<14}{} points to {}\n", "written", points.len(), args.output.display()));
    }
    Ok(())
}

fn summary(backend: &str, r: &Reference) -> String {
    let reached = if r.converged { "" } else { ", which is more than was asked for: the paths are used up" };
    format!(
        "{:<14}{} a point\n{:<14}{:.3} % of the mean luminance{reached}\n{:<14}{:.1} million, {:.2} million a second, \
         {:.0} % of the time in {backend}\n{:<14}{:.2} s\n",
        "paths",
        r.samples,
        "std error",
        100.0 * r.relative_error,
        "rays",
        r.rays as f64 * 1e-6,
        r.rays as f64 * 1e-6 / r.seconds.max(1e-9),
        100.0 * r.tracing_seconds / r.walking_seconds.max(1e-9),
        "time",
        r.seconds
    )
}

fn write(out: &mut dyn Write, points: &[Point], r: &Reference) -> io::Result<()> {
    write!(out, "x,y,z,nx,ny,nz,direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b")?;
    for kind in ["direct", "indirect", "total"] {
        for band in ["r", "g", "b", "luminance"] {
            write!(out, ",{kind}_{band}_se")?;
        }
    }
    writeln!(out)?;
    for (i, p) in points.iter().enumerate() {
        let join = |v: Vec3| format!("{},{},{}", v.x, v.y, v.z);
        let (p, n) = (p.position, p.normal);
        write!(out, "{},{},{},{},{},{}", p.x, p.y, p.z, n.x, n.y, n.z)?;
        write!(out, ",{},{}", join(r.direct[i]), join(r.indirect[i]))?;
        let errors = [
            (r.direct_error[i], r.direct_luminance_error[i]),
            (r.indirect_error[i], r.indirect_luminance_error[i]),
            (r.total_error[i], r.luminance_error[i]),
        ];
        for (bands, luminance) in errors {
            write!(out, ",{},{}", join(bands), luminance as f32)?;
        }
        writeln!(out)?;
    }
    Ok(())
}
