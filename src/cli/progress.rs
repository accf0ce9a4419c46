//! How far the work is: bars on a terminal, plain lines in a log, JSON lines for a program.

use std::{
    io::{self, IsTerminal, Write},
    sync::{
        Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use indicatif::{ProgressBar, ProgressStyle};
use luxel::progress::Progress;
use serde_json::json;

use super::signals;

/// Seconds between two plain lines of one stage, and between two JSON lines.
const PLAIN_EVERY: f64 = 5.0;
const JSON_EVERY: f64 = 0.5;

/// How to tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// Bars with the expected end, on stderr.
    Bars,
    /// A line a stage and one every few seconds, on stderr.
    Plain,
    /// One JSON object a line, on stdout.
    Json,
    /// Nothing.
    Quiet,
}

impl Style {
    /// What the flags ask for; bars where stderr is a terminal.
    pub fn choose(quiet: bool, json: bool) -> Style {
        match (json, quiet) {
            (true, _) => Style::Json,
            (_, true) => Style::Quiet,
            _ if io::stderr().is_terminal() => Style::Bars,
            _ => Style::Plain,
        }
    }
}

/// The progress of a command.
pub struct Terminal {
    style: Style,
    done: AtomicU64,
    stage: Mutex<Option<Stage>>,
}

struct Stage {
    name: String,
    total: u64,
    begun: Instant,
    told: Instant,
    bar: Option<ProgressBar>,
}

impl Terminal {
    /// Tells in the given style.
    pub fn new(style: Style) -> Terminal {
        signals::grant_grace();
        Terminal { style, done: AtomicU64::new(0), stage: Mutex::new(None) }
    }

    fn tell(&self, stage: &Stage, done: u64, ended: bool) {
        let seconds = stage.begun.elapsed().as_secs_f64();
        let share =
            if ended { Some(1.0) } else { (stage.total > 0).then(|| (done as f64 / stage.total as f64).min(1.0)) };
        let eta = share.filter(|s| *s > 0.0).map(|s| seconds * (1.0 - s) / s);
        match self.style {
            Style::Json => {
                let line = json!({
                    "stage": stage.name,
                    "done": done,
                    "total": stage.total,
                    "percent": share.map(|s| round(100.0 * s, 10.0)),
                    "seconds": round(seconds, 1000.0),
                    "eta_seconds": eta.map(|s| round(s, 10.0)),
                    "ended": ended,
                });
                // A reader that has gone away does not stop the bake.
                writeln!(io::stdout(), "{line}").ok();
            }
            _ if ended => {
                writeln!(io::stderr(), "{:<24} {seconds:8.2} s", stage.name).ok();
            }
            _ => {
                let percent = share.map_or(String::new(), |s| format!(" {:3.0} %", 100.0 * s));
                let eta = eta.map_or(String::new(), |s| format!(", {s:.0} s left"));
                writeln!(io::stderr(), "{:<24}{percent}{eta}", stage.name).ok();
            }
        }
    }
}

fn round(x: f64, steps: f64) -> f64 {
    (x * steps).round() / steps
}

impl Progress for Terminal {
    fn begin(&self, name: &str, total: u64) {
        if self.style == Style::Quiet {
            return;
        }
        self.end();
        self.done.store(0, Ordering::Relaxed);
        let now = Instant::now();
        let stage = Stage {
            name: name.into(),
            total,
            begun: now,
            told: now,
            bar: (self.style == Style::Bars).then(|| bar(name, total)),
        };
        if self.style == Style::Json {
            self.tell(&stage, 0, false);
        }
        *lock(&self.stage) = Some(stage);
    }

    fn advance(&self, units: u64) {
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        let every = match self.style {
            Style::Bars => 0.0,
            Style::Plain => PLAIN_EVERY,
            Style::Json => JSON_EVERY,
            Style::Quiet => return,
        };
        // Whoever finds the lock taken leaves the telling to its holder.
        let Ok(mut guard) = self.stage.try_lock() else { return };
        let Some(stage) = guard.as_mut() else { return };
        if let Some(bar) = &stage.bar {
            bar.set_position(done);
        } else if stage.told.elapsed() >= Duration::from_secs_f64(every) {
            stage.told = Instant::now();
            self.tell(stage, done, false);
        }
    }

    fn stopped(&self) -> bool {
        signals::caught().is_some()
    }

    fn end(&self) {
        let Some(stage) = lock(&self.stage).take() else { return };
        if let Some(bar) = &stage.bar {
            bar.finish_and_clear();
        }
        self.tell(&stage, self.done.load(Ordering::Relaxed), true);
    }
}

/// The stage, also when a thread died while it told of it: what is told is no data.
fn lock(stage: &Mutex<Option<Stage>>) -> std::sync::MutexGuard<'_, Option<Stage>> {
    stage.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

fn bar(name: &str, total: u64) -> ProgressBar {
    let (bar, template) = if total > 0 {
        (ProgressBar::new(total), "{msg:<24} [{wide_bar}] {percent:>3} %  {elapsed} / ETA {eta}")
    } else {
        (ProgressBar::new_spinner(), "{msg:<24} {spinner} {elapsed}")
    };
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_message(name.to_string());
    bar.enable_steady_tick(Duration::from_millis(250));
    bar
}
