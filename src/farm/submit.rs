//! A plan as jobs of Slurm: an array job of its shards, and a merge that waits for it.

use std::{
    fs,
    path::{Path, PathBuf, absolute},
    process::Command,
};

use super::{
    Plan,
    slurm::{Job, array_size, cancel, run},
};
use crate::{Error, Result};

pub(super) const ARRAY: &str = "array.sbatch";
pub(super) const MERGE: &str = "merge.sbatch";
pub(super) const LOGS: &str = "logs";

/// What to submit.
#[derive(Clone, Copy)]
pub struct Submission<'a> {
    /// The plan, whose folder all nodes see under the same path.
    pub plan: &'a Plan,
    /// What the merge writes: a folder, or a transfer file.
    pub output: &'a Path,
    /// The luxel that the jobs run, unless their environment has another one in `LUXEL`.
    pub program: &'a Path,
    /// Largest number of tasks of an array that run at one time.
    pub at_once: Option<u64>,
    /// Options of `sbatch`, for all jobs (partition, limit of time ...).
    pub options: &'a [String],
}

/// The jobs that Slurm has taken.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Jobs {
    /// Numbers of the array jobs, of their shards in order.
    pub arrays: Vec<String>,
    /// Number of the merge.
    pub merge: String,
    /// What `sbatch` said on standard error.
    pub notes: String,
}

/// Scripts and command lines, ready to be submitted.
#[derive(Clone, Debug)]
pub struct Batch {
    plan: PathBuf,
    array_script: String,
    merge_script: String,
    options: Vec<String>,
    at_once: Option<u64>,
    /// First shard and number of shards of each array job.
    arrays: Vec<(u64, u64)>,
}

/// Makes the jobs of a plan. Nothing is written or submitted.
///
/// # Errors
/// [`Error::Option`]: an option of `sbatch` that the plan decides; a path that is no UTF-8; those of
/// [`Plan::check_output`]. [`Error::Scheduler`]: this Slurm takes no arrays.
pub fn batch(submission: &Submission) -> Result<Batch> {
    if let Some(option) = submission.options.iter().find(|option| decided(option)) {
        return Err(Error::Option(format!(
            "{option} is not for sbatch here: the plan decides the array (see --at-once) and the scripts"
        )));
    }
    let folder = submission.plan.folder();
    submission.plan.check_output(submission.output)?;
    let paths = ["plan", "output"].into_iter().zip([folder, submission.output]);
    let assignments: Vec<String> =
        paths.map(|(name, path)| Ok(format!("{name}={}", quoted(&text(path)?)))).collect::<Result<_>>()?;
    let program = format!("luxel=${{LUXEL:-{}}}", quoted(&text(submission.program)?));
    let script = |template: &str, paths: &[String]| {
        template.replacen("@PATHS@", &[std::slice::from_ref(&program), paths].concat().join("\n"), 1)
    };
    let size = array_size()?;
    if size < 2 {
        return Err(Error::Scheduler(format!("this Slurm takes no array jobs: its MaxArraySize is {size}")));
    }
    Ok(Batch {
        plan: absolute(folder).map_err(|e| Error::io(folder, e))?,
        array_script: script(include_str!("array.sbatch"), &assignments[..1]),
        merge_script: script(include_str!("merge.sbatch"), &assignments),
        options: submission.options.to_vec(),
        at_once: submission.at_once,
        arrays: arrays(submission.plan.shards().len() as u64, size),
    })
}

impl Batch {
    /// What [`Batch::submit`] would write and run.
    pub fn describe(&self) -> String {
        let mut lines = Vec::new();
        for (name, script) in [(ARRAY, &self.array_script), (MERGE, &self.merge_script)] {
            lines.push(format!("--- {}\n{script}", self.plan.join(name).display()));
        }
        let plan = self.plan.display().to_string();
        lines.push(format!("--- commands (ID0 ...: the numbers that they print)\ncd {}", line(&[plan])));
        lines.extend(self.arrays.iter().map(|&(first, count)| line(&self.array_arguments(first, count))));
        let names: Vec<String> = (0..self.arrays.len()).map(|index| format!("ID{index}")).collect();
        lines.push(line(&self.merge_arguments(&names)));
        lines.join("\n") + "\n"
    }

    /// Writes the scripts into the plan's folder and submits the jobs. Where Slurm refuses one of them, those that it has
    /// taken are cancelled.
    ///
    /// # Errors
    /// [`Error::Io`]: the folder cannot be written. [`Error::Scheduler`]: there is no `sbatch`, or it refuses, with its
    /// reason.
    pub fn submit(&self) -> Result<Jobs> {
        for (name, script) in [(ARRAY, &self.array_script), (MERGE, &self.merge_script)] {
            let path = self.plan.join(name);
            fs::write(&path, script).map_err(|e| Error::io(path, e))?;
        }
        // Slurm makes no folders for its logs.
        let logs = self.plan.join(LOGS);
        fs::create_dir_all(&logs).map_err(|e| Error::io(logs, e))?;

        let mut taken: Vec<Job> = Vec::new();
        let mut notes = String::new();
        let mut send = |arguments: Vec<String>, taken: &mut Vec<Job>| match self.sbatch(&arguments) {
            Ok((job, said)) => {
                notes.push_str(&said);
                taken.push(job);
                Ok(())
            }
            Err(refusal) => Err(cancel(taken, refusal)),
        };
        for &(first, count) in &self.arrays {
            send(self.array_arguments(first, count), &mut taken)?;
        }
        let arrays: Vec<String> = taken.iter().map(|job| job.number.clone()).collect();
        send(self.merge_arguments(&arrays), &mut taken)?;
        let merge = taken.pop().map(|job| job.number).unwrap_or_default();
        Ok(Jobs { arrays, merge, notes })
    }

    /// The plan's own options come last, where they win.
    fn array_arguments(&self, first: u64, count: u64) -> Vec<String> {
        let limit = self.at_once.map_or(String::new(), |tasks| format!("%{tasks}"));
        self.arguments([format!("--array=0-{}{limit}", count - 1), ARRAY.into(), first.to_string()])
    }

    fn merge_arguments(&self, arrays: &[String]) -> Vec<String> {
        let dependency = format!("--dependency=afterok:{}", arrays.join(":"));
        self.arguments([dependency, "--kill-on-invalid-dep=yes".into(), MERGE.into()])
    }

    fn arguments(&self, own: [String; 3]) -> Vec<String> {
        ["sbatch".into(), "--parsable".into()].into_iter().chain(self.options.iter().cloned()).chain(own).collect()
    }

    /// The job, and what was said about it.
    fn sbatch(&self, arguments: &[String]) -> Result<(Job, String)> {
        let output = run(Command::new(&arguments[0]).args(&arguments[1..]).current_dir(&self.plan))?;
        let job = Job::parse(&output.0)
            .ok_or_else(|| Error::Scheduler(format!("sbatch gave no number of a job, but \"{}\"", output.0.trim())))?;
        Ok((job, output.1))
    }
}

/// First shard and number of shards of each array.
fn arrays(shards: u64, size: u64) -> Vec<(u64, u64)> {
    (0..shards.div_ceil(size)).map(|i| (i * size, size.min(shards - i * size))).collect()
}

/// Whether an option of `sbatch` is decided by the plan.
fn decided(option: &str) -> bool {
    let short = option.starts_with('-') && !option.starts_with("--") && option[1..].starts_with('a');
    short || ["--array", "--wrap"].contains(&option.split('=').next().unwrap_or_default())
}

/// The absolute path, as text.
fn text(path: &Path) -> Result<String> {
    let path = absolute(path).map_err(|e| Error::io(path, e))?;
    path.to_str().map(Into::into).ok_or_else(|| {
        Error::Option(format!("{}: a path that goes into a script must be UTF-8; rename it", path.display()))
    })
}

/// One word for a shell, whatever is in it.
fn quoted(word: &str) -> String {
    format!("'{}'", word.replace('\'', r"'\''"))
}

/// The command `luxel farm NAME PLAN`, for a shell.
pub fn command(name: &str, plan: &Path) -> String {
    line(&["luxel", "farm", name, &plan.display().to_string()])
}

/// A command line for a shell; words are quoted where they have to be.
fn line(words: &[impl AsRef<str>]) -> String {
    let plain =
        |word: &str| !word.is_empty() && word.bytes().all(|b| b.is_ascii_alphanumeric() || b"-_=/.,:%+@".contains(&b));
    let words = words.iter().map(AsRef::as_ref);
    words.map(|word| if plain(word) { word.to_string() } else { quoted(word) }).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrays_hold_every_shard_once_and_are_no_larger_than_slurm_takes() {
        assert_eq!(arrays(1, 1001), [(0, 1)]);
        assert_eq!(arrays(1001, 1001), [(0, 1001)]);
        assert_eq!(arrays(1002, 1001), [(0, 1001), (1001, 1)]);
        assert_eq!(arrays(20, 9), [(0, 9), (9, 9), (18, 2)]);
    }

    #[test]
    fn a_quoted_word_is_that_word_to_a_shell() {
        for word in ["plain", "", "it's here", "$HOME `x` \"y\" \\ * ~", "two\nlines", "-n"] {
            let echo = Command::new("sh").args(["-c", &format!("printf %s {}", line(&[word]))]).output().unwrap();
            assert_eq!(String::from_utf8(echo.stdout).unwrap(), word);
        }
    }

    #[test]
    fn options_that_the_plan_decides_are_told_from_the_others() {
        assert!(["-a", "-a0-3", "--array", "--array=0-3", "--wrap=x"].iter().all(|option| decided(option)));
        assert!(!["-A", "--account=a", "-p", "all", "--array-of", "a"].iter().any(|option| decided(option)));
    }
}
