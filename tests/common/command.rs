//! Running luxel, and comparing what it leaves.
#![allow(dead_code)] // Each test binary uses a part.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// The luxel under test.
pub const LUXEL: &str = env!("CARGO_BIN_EXE_luxel");

/// Runs luxel to its end, whatever that is.
pub fn luxel(args: &[&str]) -> Output {
    Command::new(LUXEL).args(args).output().unwrap()
}

pub fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// A path as an argument.
pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A scene of the repository.
pub fn scene(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes").join(name)
}

/// Names in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(folder).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
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
    assert!(a.len() >= 3, "too few results: {:?}", a.keys());
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(*bytes == b[name], "{name} differs");
    }
}
