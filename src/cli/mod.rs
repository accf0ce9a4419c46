//! The command line: one file a subcommand.

use std::{
    io::{self, Write},
    panic::{self, AssertUnwindSafe, PanicHookInfo},
    process::ExitCode,
    sync::Mutex,
};

use clap::{Parser, Subcommand};
use luxel::Error;

mod args;
mod bake;
mod bench;
mod check;
mod choices;
mod compare;
mod farm;
mod keeper;
mod orbit;
mod parse;
mod points;
mod prepare;
mod progress;
mod reference;
mod relight;
mod results;
mod selftest;
mod signals;

/// Bakes diffuse global illumination on the CPU: radiosity on automatically simplified geometry.
///
/// Exit codes: 0 done, 1 wrong input or a bake that failed, 2 wrong usage, 3 a figure is worse than asked or shards
/// are not there to be merged, 75 another process works there, 101 a bug of luxel, 130 and 143 ended by SIGINT and SIGTERM.
#[derive(Parser, Debug)]
#[command(name = "luxel", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand, Debug)]
enum Command {
    /// Bake a scene: light of vertices and patches, pictures, a report
    Bake(bake::Args),
    /// Compute once what no light or albedo changes, and keep it in a transfer file
    Prepare(prepare::Args),
    /// Bake the scene of a transfer file with other lights and albedos, without casting a form-factor ray
    Relight(relight::Args),
    /// Share a bake out among processes and machines: plan, shard, status, merge
    Farm(farm::Args),
    /// Tell what a scene holds and what a bake would take, without tracing a ray
    Check(check::Args),
    /// Irradiance at given points
    Points(points::Args),
    /// Irradiance at given points by path tracing, with its standard errors: slow and unbiased, to measure bakes against
    Reference(reference::Args),
    /// How far light is from that of a reference
    Compare(compare::Args),
    /// Measure error against time: many settings, and path tracing, against a reference
    Bench(bench::Args),
    /// Compute known answers on this machine: form factors, CIE 171:2006, enclosures, invariants
    Selftest(selftest::Args),
}

/// Exit code where all was done, and a figure is worse than asked; and where shards are not there to be merged.
const WORSE: u8 = 3;

/// Exit code where another process works on the same folder or shard: EX_TEMPFAIL of sysexits.h, "try again later".
const BUSY: u8 = 75;

/// Exit code of a bug, as of any panic of a Rust program.
const BUG: u8 = 101;

/// Runs the command line of this process.
pub fn main() -> ExitCode {
    // Usage errors end here, with code 2.
    let cli = Cli::parse();
    let last_words = remember_panics();
    if let Err(error) = signals::install() {
        // The work can be done; it ends less gently.
        complain(&format!("signals cannot be caught: {error}"));
    }
    // Nothing of the unwound state is used again.
    let result = panic::catch_unwind(AssertUnwindSafe(|| match &cli.command {
        Command::Bake(args) => bake::run(args).map(|()| ExitCode::SUCCESS),
        Command::Prepare(args) => prepare::run(args).map(|()| ExitCode::SUCCESS),
        Command::Relight(args) => relight::run(args).map(|()| ExitCode::SUCCESS),
        Command::Farm(args) => farm::run(args),
        Command::Check(args) => check::run(args).map(|()| ExitCode::SUCCESS),
        Command::Points(args) => points::run(args).map(|()| ExitCode::SUCCESS),
        Command::Reference(args) => reference::run(args).map(|()| ExitCode::SUCCESS),
        Command::Compare(args) => compare::run(args),
        Command::Bench(args) => bench::run(args).map(|()| ExitCode::SUCCESS),
        Command::Selftest(args) => selftest::run(args),
    }));
    match result {
        Ok(Ok(code)) => code,
        Ok(Err(error)) => {
            if let (Error::Interrupted(_), Some(signal)) = (&error, signals::caught()) {
                complain(&signals::message(signal));
                return ExitCode::from(signals::code(signal));
            }
            complain(&error.to_string());
            match error {
                Error::Shards { .. } => ExitCode::from(WORSE),
                Error::Busy { .. } => ExitCode::from(BUSY),
                _ => ExitCode::FAILURE,
            }
        }
        Err(_) => {
            let words = last_words.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).clone();
            complain(&format!(
                "this is a bug of luxel {}, please report it with the command and the scene: {words}",
                env!("CARGO_PKG_VERSION")
            ));
            ExitCode::from(BUG)
        }
    }
}

/// Has panics keep their message instead of printing it: the ones that end the program are told by [`main`], those
/// that a caller deals with (readers of broken files) concern nobody.
fn remember_panics() -> &'static Mutex<String> {
    static LAST: Mutex<String> = Mutex::new(String::new());
    panic::set_hook(Box::new(|info: &PanicHookInfo| {
        if let Ok(mut last) = LAST.lock() {
            *last = info.to_string().replace('\n', " ");
        }
    }));
    &LAST
}

fn complain(message: &str) {
    // Where stderr is gone there is nobody to tell.
    writeln!(io::stderr(), "luxel: {message}").ok();
}

/// Prints to stdout; a reader that has gone away (`| head`) is no error.
fn say(text: &str) {
    io::stdout().write_all(text.as_bytes()).ok();
}
