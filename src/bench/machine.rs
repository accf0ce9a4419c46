//! What a table was measured on.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use serde::Serialize;

/// The machine and the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Machine {
    /// Name of the processor.
    pub cpu: String,
    /// Threads used.
    pub threads: usize,
    /// Version of luxel.
    pub version: &'static str,
    /// Commit that it was built from, where that is known.
    pub commit: Option<String>,
}

impl Machine {
    /// This one.
    pub fn here() -> Machine {
        Machine {
            cpu: cpu().unwrap_or_else(|| format!("unknown {} processor", std::env::consts::ARCH)),
            threads: rayon::current_num_threads(),
            version: env!("CARGO_PKG_VERSION"),
            commit: option_env!("LUXEL_COMMIT").map(Into::into).or_else(commit),
        }
    }
}

impl std::fmt::Display for Machine {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{}, {} threads, luxel {}", self.cpu, self.threads, self.version)?;
        self.commit.iter().try_for_each(|commit| write!(f, " ({commit})"))
    }
}

/// Linux tells in a file; elsewhere nobody is asked.
fn cpu() -> Option<String> {
    let text = fs::read_to_string("/proc/cpuinfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("model name"))?;
    Some(line.split_once(':')?.1.trim().to_string())
}

/// The commit of the checkout that the running program lies in. A program that was installed lies in none; who builds
/// such ones can set LUXEL_COMMIT.
fn commit() -> Option<String> {
    let program = std::env::current_exe().ok()?;
    let checkout = program.ancestors().find(|folder| is_checkout(folder))?;
    let args = ["describe", "--always", "--dirty", "--abbrev=10"];
    let output = Command::new("git").arg("-C").arg(checkout).args(args).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    (output.status.success() && !text.trim().is_empty()).then(|| text.trim().to_string())
}

fn is_checkout(folder: &Path) -> bool {
    let has = |name: &str| PathBuf::from(folder).join(name).exists();
    has(".git") && has("Cargo.toml") && has("src/bench/machine.rs")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_machine_is_told_in_one_line() {
        let machine = Machine { cpu: "A CPU".into(), threads: 2, version: "0.1.0", commit: Some("abc".into()) };
        assert_eq!(machine.to_string(), "A CPU, 2 threads, luxel 0.1.0 (abc)");
        assert_eq!(Machine { commit: None, ..machine }.to_string(), "A CPU, 2 threads, luxel 0.1.0");
        assert!(!Machine::here().cpu.is_empty());
    }
}
