//! Running luxel and schedulers as processes, and comparing what they leave.
#![allow(dead_code)] // Each test binary uses a part.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::Command,
    thread,
    time::{Duration, Instant},
};

/// Far above what anything here takes on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// The luxel under test.
pub const LUXEL: &str = env!("CARGO_BIN_EXE_luxel");

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

pub fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
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

/// The results in a folder, by name: all but the report, which tells of times.
pub fn results(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    let named = files.map(|path| (path.file_name().unwrap().to_str().unwrap().to_string(), fs::read(&path).unwrap()));
    named.filter(|(name, _)| name != "bake.json").collect()
}

/// Asserts that two folders hold the same results, to the byte.
pub fn assert_same_results(a: &Path, b: &Path) {
    let [a, b] = [results(a), results(b)];
    assert!(a.len() > 3, "too few results: {:?}", a.keys());
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(*bytes == b[name], "{name} differs");
    }
}
