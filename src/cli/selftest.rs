//! `luxel selftest`.

use std::{path::PathBuf, process::ExitCode};

use luxel::{
    Error, Result,
    output::atomic::{Staged, place_of},
    selftest::{self, Selftest},
};

use super::{
    WORSE,
    args::{Running, on_threads},
    choices::Tracer,
    progress::{Style, Terminal},
    say,
};

#[derive(clap::Args, Debug)]
pub struct Args {
    /// Ray tracer to test; may be repeated [default: every one that is compiled in; brute force leaves out the cases of
    /// 50 million rays]
    #[arg(long, value_enum)]
    backend: Vec<Tracer>,
    /// JSON file to write the table to
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    running: Running,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let mut json = None;
    if let Some(path) = &args.json {
        let (folder, name) = place_of(path)?;
        json = Some((Staged::open(folder)?, name));
    }
    let given: Vec<_> = args.backend.iter().map(|&backend| backend.into()).collect();
    let backends = if given.is_empty() { selftest::backends() } else { given };
    let running = &args.running;
    let progress = Terminal::new(Style::choose(running.quiet, running.json_progress));
    let test = on_threads(running.threads, || selftest::run(&backends, &progress))?;
    if let Some((mut staged, name)) = json {
        let text = serde_json::to_vec_pretty(&test).map_err(|e| Error::io(name, e.into()))?;
        staged.write(name, |out| out.write_all(&text))?;
        staged.commit()?;
    }
    if !running.quiet && !running.json_progress {
        say(&test.to_string());
    }
    Ok(ExitCode::from(code(&test)))
}

fn code(test: &Selftest) -> u8 {
    if test.passed() { 0 } else { WORSE }
}

#[cfg(test)]
mod tests {
    use super::*;
    use luxel::selftest::Row;

    #[test]
    fn a_failure_has_its_own_exit_code() {
        let rows = vec![Row::error("good", 1.0, 1.0, 0.1)];
        let mut test = Selftest { version: "1", threads: 1, tracers: vec![], seconds: 0.0, rows };
        assert_eq!(code(&test), 0);
        test.rows.push(Row::error("broken", 1.2, 1.0, 0.1));
        assert_eq!(code(&test), 3);
    }
}
