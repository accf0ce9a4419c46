//! A plan as jobs of a real Slurm, which is started for each test and stopped behind it.

#[path = "common/farm.rs"]
mod farm;

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

use farm::{
    command::{LUXEL, assert_same_results, scene},
    plan, run, until,
};

/// Exit code of `tests/slurm/cluster` where there is no Slurm to start.
const LACKING: i32 = 77;

/// A Slurm of three nodes; it ends when it is dropped, and also when this process dies.
struct Cluster {
    child: Child,
    conf: String,
}

impl Cluster {
    /// None, and a word on the reason, where there is none to be had.
    fn start() -> Option<Cluster> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/slurm/cluster");
        let mut child =
            Command::new(script).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        if let Some(conf) = line.trim().strip_prefix("SLURM_CONF=") {
            return Some(Cluster { conf: conf.into(), child });
        }
        let mut reason = String::new();
        child.stderr.take().unwrap().read_to_string(&mut reason).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(LACKING), "{reason}");
        println!("skipped: {}", reason.trim());
        None
    }

    /// A command that means this Slurm.
    fn command(&self, program: &str) -> Command {
        let mut command = Command::new(program);
        command.env("SLURM_CONF", &self.conf);
        command
    }

    fn run(&self, program: &str, arguments: &[&str]) -> String {
        run(self.command(program).args(arguments))
    }

    /// The states of a job, or of the tasks of an array: `COMPLETED`, `PENDING` ...
    fn states(&self, job: &str) -> Vec<String> {
        let text = self.run("scontrol", &["show", "job", job]);
        text.split_whitespace().filter_map(|word| word.strip_prefix("JobState=")).map(Into::into).collect()
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        // The end of its input stops it.
        drop(self.child.stdin.take());
        self.child.wait().ok();
    }
}

/// Submits a plan whose jobs run `program`; gives the numbers of the array jobs, and of the merge.
fn submit(cluster: &Cluster, plan: &Path, program: &Path, options: &[&str]) -> (Vec<String>, String) {
    let mut command = cluster.command(LUXEL);
    let said = run(command.env("LUXEL", program).args(["farm", "submit"]).arg(plan).args(options));
    let after = |name: &str| {
        let line = said.lines().find(|line| line.starts_with(name)).unwrap_or_else(|| panic!("no {name} in {said}"));
        line.split_once("job ").unwrap().1.split(", ").map(String::from).collect::<Vec<_>>()
    };
    (after("shards"), after("merge").remove(0))
}

/// Stands for luxel in the jobs: a shard does what the table says for its first run, and succeeds in the second. All
/// runs are listed in the file `calls` of the plan.
fn stand_in(folder: &Path, first_runs: &str) -> PathBuf {
    let text = format!(
        "[ $2 = merge ] && {{ echo merge >>\"$3/calls\"; exit; }}\n\
         echo \"shard $4\" >>\"$3/calls\"\n\
         [ $(grep -cx \"shard $4\" \"$3/calls\") = 2 ] && exit 0\n\
         sleeps() {{ trap 'kill $!; exit 143' TERM; sleep 1000 & wait; }}\n\
         case $4 in\n{first_runs}\nesac"
    );
    script(&folder.join("stand-in"), &text)
}

/// A program of this text.
fn script(path: &Path, text: &str) -> PathBuf {
    fs::write(path, format!("#!/bin/bash\n{text}\n")).unwrap();
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).unwrap();
    path.into()
}

#[test]
fn shards_that_are_interrupted_or_killed_are_requeued_and_the_merge_waits_for_them() {
    let Some(cluster) = Cluster::start() else { return };
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("it's a plan");
    plan(&scene("cornell.toml"), &folder, 11, &["--grid", "24", "--rays", "16"]);
    // More than the 9 that fit into one array: 7 of them are run to the end at once.
    let shard = stand_in(root.path(), "1) kill -KILL $$ ;; 2) exit 143 ;; 3 | 10) sleeps ;;");
    let (arrays, merge) = submit(&cluster, &folder, &shard, &["--slurm", "--partition", "all", "--time=10"]);
    assert_eq!(arrays.len(), 2);

    let calls = || fs::read_to_string(folder.join("calls")).unwrap_or_default();
    let count = |call: &str| calls().lines().filter(|line| *line == call).count();
    until("the call of shards 3 and 10", || count("shard 3") == 1 && count("shard 10") == 1);
    // What Slurm sends before the limit of time; and a job that takes the node.
    cluster.run("scancel", &["--batch", "--signal=USR1", &format!("{}_3", arrays[0])]);
    let node = cluster.run("squeue", &["--noheader", "--format=%N", &format!("--jobs={}_1", arrays[1])]);
    let node = format!("--nodelist={}", node.trim());
    cluster.run("sbatch", &["--partition=urgent", &node, "--output=/dev/null", "--wrap=true"]);
    until("the merge's end", || cluster.states(&merge) == ["COMPLETED"]);

    assert_eq!(cluster.states(&arrays[1]), ["COMPLETED"; 2]);
    for shard in 0..11 {
        let runs = if [1, 2, 3, 10].contains(&shard) { 2 } else { 1 };
        assert_eq!(count(&format!("shard {shard}")), runs, "shard {shard}: {}", calls());
    }
    assert_eq!(calls().lines().last(), Some("merge"));
    assert_eq!(calls().lines().count(), 16);
}

#[test]
fn shards_that_fail_or_are_cancelled_are_not_requeued_and_there_is_no_merge() {
    let Some(cluster) = Cluster::start() else { return };
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("plan");
    plan(&scene("cornell.toml"), &folder, 3, &["--grid", "12", "--rays", "16"]);
    // The last is cancelled too, and has ended before the signal of that reaches the script around it.
    let shard = stand_in(
        root.path(),
        "0) echo no such scene; exit 1 ;; 1) sleeps ;; 2) trap '' TERM; scancel ${SLURM_ARRAY_JOB_ID}_2; exit 143 ;;",
    );
    let (arrays, merge) = submit(&cluster, &folder, &shard, &["--slurm"]);
    let calls = || fs::read_to_string(folder.join("calls")).unwrap_or_default();
    until("the call of the shards", || calls().lines().count() == 3);
    cluster.run("scancel", &[&format!("{}_1", arrays[0])]);
    until("the merge's cancellation", || cluster.states(&merge) == ["CANCELLED"]);

    // The merge may be cancelled before the last shard has left its node.
    let mut states = Vec::new();
    until("the end of the shards", || {
        states = cluster.states(&arrays[0]);
        !states.iter().any(|state| ["RUNNING", "COMPLETING"].contains(&state.as_str()))
    });
    states.sort();
    assert_eq!(states, ["CANCELLED", "CANCELLED", "FAILED"]);
    assert_eq!(calls().lines().count(), 3, "{}", calls());
    let log = fs::read_to_string(folder.join(format!("logs/shard-{}_0.log", arrays[0]))).unwrap();
    assert_eq!(log, "no such scene\n");
}

/// The process of a shard.
fn process(folder: &Path, shard: u32) -> Option<String> {
    let words = ["farm", "shard", folder.to_str().unwrap(), &shard.to_string()].join("\0");
    let mut processes = fs::read_dir("/proc").unwrap().map(|entry| entry.unwrap());
    let found = processes.find(|entry| {
        let command = fs::read(entry.path().join("cmdline")).unwrap_or_default();
        String::from_utf8_lossy(&command).contains(&format!("{LUXEL}\0{words}\0"))
    });
    found.map(|entry| entry.file_name().into_string().unwrap())
}

#[test]
fn a_bake_by_slurm_whose_tasks_are_killed_and_requeued_in_mid_run_has_the_bytes_of_one_bake() {
    let Some(cluster) = Cluster::start() else { return };
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name);
    let scene = scene("cornell.toml");
    let settings = ["--grid", "24", "--rays", "16384", "--point-samples", "8"];
    run(Command::new(LUXEL).arg("bake").arg(&scene).arg("-o").arg(path("bake")).args(settings));
    let folder = path("PLAN");
    // A second each: four times what it takes until the first rows are written down. Whoever waits for those comes first, so
    // that they are seen in time on a busy machine too.
    plan(&scene, &folder, 2, &settings);
    let often = r#"[ "$2" = shard ] && set -- "$@" --checkpoint-every 0.25s"#;
    let polite = script(&path("polite"), &format!("{often}\nexec nice -n 5 '{LUXEL}' \"$@\""));

    let merged = path("merged");
    let options = ["-o", merged.to_str().unwrap(), "--slurm", "--cpus-per-task=1"];
    let (arrays, merge) = submit(&cluster, &folder, &polite, &options);
    let is_there = |name: String| fs::metadata(folder.join(name)).is_ok_and(|file| file.len() > 0);
    let works = |shard: u32| is_there(format!("shard-{shard}.checkpoint")) || is_there(format!("shard-{shard}.lxt"));
    let signal = |name: &str, process: &str| drop(run(Command::new("kill").args([name, process])));
    // Both are held where they are, as Slurm may take longer to hear of it than they have to go.
    let mut held = [None, None];
    until("the work on both shards", || {
        for (shard, held) in (0..).zip(&mut held) {
            if held.is_none() && works(shard) {
                let process = process(&folder, shard).expect("the shard ended too early to be held");
                signal("-STOP", &process);
                *held = Some(process);
            }
        }
        held.iter().all(Option::is_some)
    });
    // One is killed, one is interrupted by Slurm, which lets it go on first.
    signal("-KILL", held[0].as_ref().unwrap());
    cluster.run("scontrol", &["requeue", &format!("{}_1", arrays[0])]);
    until("the merge's end", || cluster.states(&merge) == ["COMPLETED"]);

    let log = |shard: u32| fs::read_to_string(folder.join(format!("logs/shard-{}_{shard}.log", arrays[0]))).unwrap();
    assert!(log(0).contains("shard ended with code 137, requeued"), "{}", log(0));
    assert!(log(1).contains("DUE TO JOB REQUEUE"), "{}", log(1));
    // Both went on where they were.
    assert!((0..2).all(|shard| log(shard).contains("rows were there")), "{}{}", log(0), log(1));
    assert_same_results(&path("bake"), &merged);
}
