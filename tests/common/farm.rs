//! Running shards and schedulers as processes.
#![allow(dead_code)] // Each test binary uses a part.

#[path = "command.rs"]
pub mod command;

use std::{
    path::Path,
    process::Command,
    thread,
    time::{Duration, Instant},
};

use command::LUXEL;

/// Far above what anything here takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(600);

/// Runs a command that must succeed; gives its standard output.
pub fn run(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let [stdout, stderr] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    assert!(output.status.success(), "{command:?}: {}\n{stdout}\n{stderr}", output.status);
    stdout
}

/// Waits until something is so.
pub fn until(what: &str, mut done: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !done() {
        assert!(begun.elapsed() < PATIENCE, "{what} did not come");
        thread::sleep(Duration::from_millis(20));
    }
}

/// Makes a plan of a scene; `settings` are those of a bake.
pub fn plan(scene: &Path, plan: &Path, shards: u32, settings: &[&str]) {
    let shards = shards.to_string();
    run(Command::new(LUXEL)
        .args(["farm", "plan"])
        .arg(scene)
        .arg("-o")
        .arg(plan)
        .args(["--shards", &shards])
        .args(settings));
}
