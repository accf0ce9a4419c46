//! `luxel compare`.

use std::{
    fmt::Write,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::ValueEnum;
use luxel::{
    Error, Result,
    compare::{self, Difference, Differences, Table},
    output::{
        atomic::{Staged, check_is_no_input, place_of},
        exr::{self, Compression},
        png,
        tonemap::ToneMap,
    },
};

use super::{WORSE, parse, say};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// The light to judge: CSV of `luxel points`, vertices.ply, or an EXR image
    #[arg(value_name = "A")]
    values: PathBuf,
    /// The light to compare it with, about the same points or pixels
    #[arg(value_name = "B")]
    reference: PathBuf,
    /// Largest error to allow, `2%`: the root mean square of the difference of luminance, relative to the reference's mean
    #[arg(long, value_name = "SHARE", value_parser = parse::share, allow_hyphen_values = true)]
    max_error: Option<f64>,
    /// The light that --max-error and a PNG --difference are about
    #[arg(long, value_enum, default_value = "total")]
    of: Kind,
    /// Picture of the difference of two EXR images: an EXR file of A - B, or a PNG file (red: A is brighter, blue: darker)
    #[arg(long, value_name = "OUT.exr|OUT.png")]
    difference: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Kind {
    /// Straight from lights
    Direct,
    /// After at least one reflection
    Indirect,
    /// Both
    Total,
}

impl Kind {
    fn name(self) -> &'static str {
        match self {
            Kind::Direct => "direct",
            Kind::Indirect => "indirect",
            Kind::Total => "total",
        }
    }
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let (a, b) = (compare::read(&args.values)?, compare::read(&args.reference)?);
    let differences = compare::compare((&args.values, &a), (&args.reference, &b))?;
    let judged = differences.iter().find(|d| d.name == args.of.name());
    if let Some(path) = &args.difference {
        check_is_no_input(path, &[&args.values, &args.reference])?;
        write_picture(path, &a, &b, args.of, judged)?;
    }
    say(&table(args, &differences));
    let Some(allowed) = args.max_error else { return Ok(ExitCode::SUCCESS) };
    let judged = judged.ok_or_else(|| missing(args.of))?;
    let found = judged.luminance.rmse;
    // Not `found > allowed`: NaN is no pass.
    let passed = found <= allowed;
    say(&format!(
        "{} luminance: error {:.3} %, allowed {:.3} %: {}\n",
        args.of.name(),
        100.0 * found,
        100.0 * allowed,
        if passed { "passed" } else { "FAILED" }
    ));
    Ok(if passed { ExitCode::SUCCESS } else { ExitCode::from(WORSE) })
}

fn missing(of: Kind) -> Error {
    Error::Option(format!("--of {}: the files have no {} light in common", of.name(), of.name()))
}

fn table(args: &Args, differences: &[Differences]) -> String {
    let count = differences.first().map_or(0, |d| d.luminance.count);
    let mut text = format!(
        "{} against {}, {count} values; per cent of the reference's mean\n{:<22}{:>10}{:>10}{:>10}{:>10}{:>10}\n",
        args.values.display(),
        args.reference.display(),
        "",
        "RMSE",
        "bias",
        "95 %",
        "worst 1 %",
        "noise"
    );
    let mut row = |name: &str, what: &str, d: &Difference, known: bool| {
        let percent = |x: f64| format!("{:.3}", 100.0 * x);
        let noise = if known { percent(d.noise) } else { "unknown".into() };
        let rmse = if known && d.rmse == 0.0 && d.noise > 0.0 { "< noise".into() } else { percent(d.rmse) };
        let bias = format!("{:+.3}", 100.0 * d.bias);
        let (p95, worst) = (percent(d.p95), percent(d.worst));
        // Writing to a string cannot fail.
        writeln!(text, "{name:<12}{what:<10}{rmse:>10}{bias:>10}{p95:>10}{worst:>10}{noise:>10}").ok();
    };
    for d in differences {
        row(&d.name, "luminance", &d.luminance, d.noise_is_known);
        for (band, difference) in ["red", "green", "blue"].iter().zip(&d.bands) {
            row("", band, difference, d.noise_is_known);
        }
    }
    if differences.iter().any(|d| d.noise_is_known) {
        text += "noise: of the reference, from its standard errors; RMSE is without it (root of the difference of squares), \
                 the other figures contain it\n";
    }
    text
}

fn write_picture(path: &Path, a: &Table, b: &Table, of: Kind, judged: Option<&Differences>) -> Result<()> {
    let wrong = |message: &str| Error::Option(format!("--difference {}: {message}", path.display()));
    let image = compare::difference_image(a, b).ok_or_else(|| wrong("needs two EXR images"))?;
    let (folder, name) = place_of(path)?;
    let mut staged = Staged::open(folder)?;
    match path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase().as_str() {
        "exr" => staged.write_path(name, |path| exr::write(path, &image, Compression::Zip))?,
        "png" => {
            let layer = |t: &Table| t.layers.iter().find(|l| l.name == of.name()).cloned();
            let (Some(a), Some(b), Some(judged)) = (layer(a), layer(b), judged) else { return Err(missing(of)) };
            let mean = b.luminance().iter().sum::<f64>() / b.luminance().len().max(1) as f64;
            let full = judged.luminance.p95 * mean.abs();
            // Below the shoulder of the tone curve, where it is straight.
            let tone = ToneMap { exposure: 0.8 };
            let colours = compare::difference_picture(&a, &b, full);
            staged.write(name, |out| png::write(out, image.width, image.height, &colours, tone))?;
            say(&format!("{}: full colour from {:.3} % of the mean\n", path.display(), 100.0 * judged.luminance.p95));
        }
        _ => return Err(wrong("a .exr or .png file was expected")),
    }
    staged.commit().map(|_| ())
}
