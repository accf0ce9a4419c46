//! `luxel farm submit` against commands that stand in for Slurm's.

#[path = "common/farm.rs"]
mod farm;

use std::{
    fs,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Command, Output},
};

use farm::{
    command::{LUXEL, scene},
    plan,
};
use tempfile::TempDir;

/// A folder with a plan in `my plan`, and stand-ins in `bin` that list their calls in `calls`.
struct Site(TempDir);

impl Site {
    /// `sbatch` answers by the shell text given, after it has listed its call.
    fn new(sbatch: &str) -> Site {
        let site = Site(tempfile::tempdir().unwrap());
        fs::create_dir(site.path("bin")).unwrap();
        // More shards than the 9 that go into an array.
        plan(&scene("cornell.toml"), &site.path("my plan"), 11, &["--grid", "24", "--rays", "16"]);
        let list = format!("echo \"${{0##*/}} $*\" >>'{}'", site.path("calls").display());
        site.program("sbatch", &format!("{list}\n{sbatch}"));
        site.program("scancel", &list);
        site.program("scontrol", "echo 'MaxArraySize            = 9'");
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn program(&self, name: &str, text: &str) {
        let path = self.path("bin").join(name);
        fs::write(&path, format!("#!/bin/sh\n{text}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn submit(&self, arguments: &[&str]) -> Output {
        Command::new(LUXEL)
            .args(["farm", "submit", "my plan"])
            .args(arguments)
            .env("PATH", format!("{}:/usr/bin:/bin", self.path("bin").display()))
            .current_dir(self.0.path())
            .output()
            .unwrap()
    }

    fn calls(&self) -> Vec<String> {
        fs::read_to_string(self.path("calls")).unwrap_or_default().lines().map(Into::into).collect()
    }
}

/// Says that the job is taken, with a number of its own.
const TAKES: &str = "case \"$*\" in *merge.sbatch) echo 12 ;; *' 9') echo 11 ;; *) echo Welcome; echo 10 ;; esac";

fn error(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(1));
    String::from_utf8(output.stderr.clone()).unwrap()
}

fn files(folder: &Path) -> Vec<String> {
    let mut names: Vec<_> =
        fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

#[test]
fn a_plan_becomes_arrays_that_slurm_takes_and_a_merge_behind_them() {
    let site = Site::new(TAKES);
    let output = site.submit(&["--at-once", "4", "--slurm", "-p", "cpu", "--comment=two words"]);
    assert_eq!(String::from_utf8_lossy(&output.stdout), "shards: job 10, 11\nmerge:  job 12\n");
    assert!(output.status.success());
    assert_eq!(
        site.calls(),
        [
            "sbatch --parsable -p cpu --comment=two words --array=0-8%4 array.sbatch 0",
            "sbatch --parsable -p cpu --comment=two words --array=0-1%4 array.sbatch 9",
            "sbatch --parsable -p cpu --comment=two words --dependency=afterok:10:11 --kill-on-invalid-dep=yes \
             merge.sbatch",
        ]
    );
    for script in ["array.sbatch", "merge.sbatch"] {
        let checked = Command::new("bash").arg("-n").arg(site.path("my plan").join(script)).output().unwrap();
        assert!(checked.status.success(), "{}", String::from_utf8_lossy(&checked.stderr));
    }
}

#[test]
fn a_dry_run_shows_scripts_and_commands_and_leaves_nothing() {
    let site = Site::new(TAKES);
    let before = files(&site.path("my plan"));
    let output = site.submit(&["--dry-run", "--slurm", "--comment", "it's"]);
    assert!(output.status.success());
    let behind = site.submit(&["--slurm", "--comment", "it's", "--dry-run"]);
    assert_eq!(behind.stdout, output.stdout);
    let text = String::from_utf8(output.stdout).unwrap();
    for line in [
        "#SBATCH --requeue",
        &format!("plan='{}'", site.path("my plan").display()),
        &format!("output='{}'", site.path("my plan/result").display()),
        &format!("cd '{}'", site.path("my plan").display()),
        r"sbatch --parsable --comment 'it'\''s' --array=0-1 array.sbatch 9",
    ] {
        assert!(text.lines().any(|l| l == line), "no {line} in {text}");
    }
    assert!(site.calls().is_empty());
    assert_eq!(files(&site.path("my plan")), before);
}

#[test]
fn a_refusal_is_told_in_slurms_words_and_takes_back_what_was_submitted() {
    let site = Site::new(
        "case \"$*\" in *merge.sbatch) echo 'sbatch: error: no such QOS' >&2; exit 1 ;; *) echo '7;big' ;; esac",
    );
    let message = error(&site.submit(&["--slurm"]));
    assert_eq!(
        message,
        "luxel: sbatch refused: sbatch: error: no such QOS; array job 7, already taken, is cancelled; array job 7, \
         already taken, is cancelled\n"
    );
    assert_eq!(site.calls()[3..], ["scancel --clusters=big 7", "scancel --clusters=big 7"]);
}

#[test]
fn an_answer_that_names_no_job_is_an_error() {
    let site = Site::new("echo Submitted batch job 7");
    assert!(error(&site.submit(&["--slurm"])).contains("no number of a job, but \"Submitted batch job 7\""));
}

#[test]
fn a_machine_without_slurm_is_told_what_else_to_do() {
    let site = Site::new("");
    fs::remove_dir_all(site.path("bin")).unwrap();
    let output = Command::new(LUXEL)
        .args(["farm", "submit", "my plan", "--slurm"])
        .env("PATH", site.path("bin"))
        .current_dir(site.0.path())
        .output()
        .unwrap();
    let message = error(&output);
    assert!(message.starts_with("luxel: sbatch is not on the PATH: submit on a machine of"), "{message}");
}

#[test]
fn options_that_the_plan_decides_are_refused() {
    let site = Site::new(TAKES);
    assert!(error(&site.submit(&["--slurm", "--array=0-3"])).contains("--array=0-3 is not for sbatch here"));
    assert!(site.calls().is_empty());
}
