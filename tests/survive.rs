//! What ends a run before its time: signals, other processes on the same folder, full and read-only disks.
#![cfg(unix)]

#[path = "common/command.rs"]
mod command;

use std::{
    fs,
    io::{BufRead, BufReader, Read},
    os::unix::process::ExitStatusExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use command::{LUXEL, names, scene, stderr};

const TERM: i32 = 15;
const INT: i32 = 2;
const KILL: i32 = 9;

/// Rays enough for a minute of one stage, with as many threads as [`bake`] has.
const LONG: &str = "65536";

/// At low priority: whoever waits for what it says, to end it there, comes first on a busy machine too.
fn luxel() -> Command {
    let mut command = Command::new("nice");
    command.args(["-n", "5", LUXEL]);
    command
}

fn cornell() -> PathBuf {
    scene("cornell.obj")
}

/// `luxel bake` of the Cornell box into `out`.
fn bake(out: &Path, options: &[&str]) -> Command {
    let mut command = luxel();
    command.arg("bake").arg(cornell()).arg("-o").arg(out).args(["--no-preview", "--json-progress"]);
    // On any machine, so that none is done before it is interrupted.
    command.args(["--threads", "2"]).args(options);
    command
}

fn send(child: &Child, signal: i32) {
    let sent = Command::new("kill").args([format!("-{signal}"), child.id().to_string()]).status();
    assert!(sent.unwrap().success());
}

/// Starts `command` and waits until it tells of `stage`.
fn run_to(command: Command, stage: &str) -> Child {
    run_until(command, |line| line["stage"] == stage)
}

/// Starts `command` and waits for a line of its progress.
fn run_until(mut command: Command, awaited: impl Fn(&serde_json::Value) -> bool) -> Child {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let came = lines.by_ref().map_while(Result::ok).any(|line| awaited(&serde_json::from_str(&line).unwrap()));
    assert!(came, "what was awaited never came");
    // What else it says is not read: the pipe holds some hundred lines.
    std::thread::spawn(move || lines.for_each(drop));
    child
}

fn said(child: &mut Child) -> String {
    let mut text = String::new();
    child.stderr.take().unwrap().read_to_string(&mut text).unwrap();
    text
}

#[test]
fn signals_end_every_long_stage_with_their_own_code() {
    let folder = tempfile::tempdir().unwrap();
    let points = folder.path().join("points.txt");
    fs::write(&points, "278 1 100  0 1 0\n").unwrap();
    let out = folder.path().join("out");
    let points_of = |command: &str, options: &[&str]| {
        let mut run = luxel();
        run.arg(command).arg(cornell()).arg("--at").arg(&points).arg("-o").arg(folder.path().join("out/light.csv"));
        run.arg("--json-progress").args(options);
        run
    };
    let cases = [
        (bake(&out, &["--patch-samples", LONG]), "direct light", TERM),
        (bake(&out, &["--rays", LONG]), "form factors", INT),
        (bake(&out, &["--grid", "32", "--rays", "16", "--point-samples", LONG]), "points", TERM),
        (points_of("points", &["--rays", LONG]), "form factors", INT),
        (points_of("reference", &["--spp", "1048576"]), "path tracing", TERM),
    ];
    for (command, stage, signal) in cases {
        let mut child = run_to(command, stage);
        send(&child, signal);
        let status = child.wait().unwrap();
        let said = said(&mut child);
        assert_eq!(status.code(), Some(128 + signal), "{stage}: {said}");
        let name = if signal == INT { "SIGINT" } else { "SIGTERM" };
        assert!(said.contains(&format!("luxel: interrupted by {name}: ")), "{stage}: {said}");
        assert!(!said.contains("could not be written"), "{stage}: {said}");
        // The folder was made for the run, and nothing is left in it that could be taken for a result.
        let left = if out.exists() { names(&out) } else { Vec::new() };
        assert!(left.iter().all(|name| name.starts_with('.')), "{stage}: {left:?}");
    }
}

#[test]
fn a_second_interrupt_ends_the_process_where_it_is_and_a_second_sigterm_does_not() {
    let folder = tempfile::tempdir().unwrap();
    // Work asks between slices, and a slice takes ten times the grace: 64 rows, each of some 2,400 triangles against each ray.
    let slow = ["--grid", "8", "--backend", "brute", "--patch-samples", "1", "--rays", LONG];
    let after = |signal: i32| loop {
        let mut command = luxel();
        command.args(["bake", "scenes/curved_room.toml", "--json-progress", "-o"]);
        command.arg(folder.path().join("out")).args(slow);
        let mut child = run_to(command, "form factors");
        // Again and again: signals of a kind that are not yet delivered are one.
        let mut pause = Duration::ZERO;
        while child.try_wait().unwrap().is_none() {
            let sent = Instant::now();
            send(&child, signal);
            std::thread::sleep(Duration::from_millis(20));
            pause = pause.max(sent.elapsed());
        }
        let ended = (child.wait().unwrap().code(), said(&mut child));
        // A machine that slept between two signals has shown nothing.
        if pause < Duration::from_secs(1) {
            break ended;
        }
    };
    // It had no time to say why; but where the first signal came before the first slice, it ended in order.
    let abrupt = (Some(128 + INT), String::new());
    assert!((0..5).any(|_| after(INT) == abrupt));
    // A scheduler that repeats itself takes no time from the work to end in order.
    let (code, said) = after(TERM);
    assert!(code == Some(128 + TERM) && said.contains("luxel: interrupted by SIGTERM: "), "{code:?} {said}");
}

#[test]
fn of_two_bakes_into_one_folder_the_second_is_told_of_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut first = run_to(bake(&out, &["--rays", LONG]), "form factors");
    let quick = ["--grid", "6", "--rays", "16", "--point-samples", "4"];
    let second = bake(&out, &quick).output().unwrap();
    let says = stderr(&second);
    assert_eq!(second.status.code(), Some(75), "{says}");
    assert!(says.contains(&format!("in use by luxel, process {} on ", first.id())), "{says}");
    // A killed process holds nothing, and what it left is swept.
    send(&first, KILL);
    assert_eq!(first.wait().unwrap().signal(), Some(KILL));
    fs::write(out.join(format!(".vertices.ply.{}.tmp", first.id())), "half").unwrap();
    let third = bake(&out, &quick).output().unwrap();
    assert!(third.status.success(), "{}", stderr(&third));
    assert_eq!(names(&out), ["bake.json", "lit.glb", "patches.ply", "vertices.ply"]);
}

/// A bake of some seconds.
const SECONDS: [&str; 4] = ["--grid", "24", "--rays", "8192"];
/// Its results, but for the times of the report.
const FILES: [&str; 3] = ["vertices.ply", "patches.ply", "lit.glb"];

fn contents(out: &Path) -> Vec<Vec<u8>> {
    FILES.map(|name| fs::read(out.join(name)).unwrap()).to_vec()
}

fn record(out: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(out.join("bake.json")).unwrap()).unwrap()
}

#[test]
fn an_interrupted_bake_that_is_resumed_writes_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole");
    assert!(bake(&whole, &SECONDS).output().unwrap().status.success());
    let out = folder.path().join("out");
    let often = [&SECONDS[..], &["--checkpoint-every", "0.01s"]].concat();
    let resumed = [&often[..], &["--resume"]].concat();
    // It is asked to end, then killed, each time where it has cast some rows.
    for (options, signal) in [(&often, TERM), (&resumed, KILL), (&resumed, INT)] {
        let mut child =
            run_until(bake(&out, options), |line| line["stage"] == "form factors" && line["done"].as_u64() > Some(0));
        send(&child, signal);
        let status = child.wait().unwrap();
        assert!(!status.success());
        if signal != KILL {
            assert!(said(&mut child).contains("the same command with --resume goes on"));
        }
        assert_eq!(names(&out).iter().filter(|name| *name == ".luxel.checkpoint").count(), 1);
    }
    // Other rays, and another scene, are other rows.
    let other = bake(&out, &["--grid", "24", "--rays", "4096", "--resume"]).output().unwrap();
    assert_eq!(other.status.code(), Some(1));
    assert!(stderr(&other).contains("rays 8192 there, 4096 here"), "{}", stderr(&other));

    assert!(bake(&out, &resumed).output().unwrap().status.success());
    assert!(contents(&out) == contents(&whole));
    let [cast, used] = ["cast", "used"].map(|name| record(&out)["rows"][name].as_u64().unwrap());
    assert!(cast < used, "{cast} of {used}");
    assert!(record(&out)["rows"]["from"].as_str().unwrap().ends_with(".luxel.checkpoint"));
    // It is gone with the end of the bake, and nothing to resume is no error.
    assert_eq!(names(&out), ["bake.json", "lit.glb", "patches.ply", "vertices.ply"]);
    assert!(bake(&out, &["--grid", "6", "--rays", "16", "--resume"]).output().unwrap().status.success());
    // Nor is one left behind by a bake that writes none.
    fs::write(out.join(".luxel.checkpoint"), "of an earlier bake").unwrap();
    assert!(bake(&out, &["--grid", "6", "--rays", "16", "--no-checkpoint"]).output().unwrap().status.success());
    assert_eq!(names(&out), ["bake.json", "lit.glb", "patches.ply", "vertices.ply"]);
}

#[test]
fn form_factors_that_do_not_fit_the_memory_go_to_a_file_and_change_no_bit() {
    let folder = tempfile::tempdir().unwrap();
    // Half of its memory are form factors.
    let many = ["--grid", "32", "--rays", "16384"];
    let bake_with = |name: &str, options: &[&str]| {
        let out = folder.path().join(name);
        let output = bake(&out, &[&many[..], options].concat()).output().unwrap();
        (out, output)
    };
    let (free, output) = bake_with("free", &["--memory-limit", "100G"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let [foretold, measured] =
        ["foretold_memory_bytes", "peak_memory_bytes"].map(|name| record(&free)[name].as_f64().unwrap());
    // Nineteen bakes that no constant of the model was taken from have 0.96 to 1.15, with the mean 1.033 and a standard deviation
    // of 0.053 (ARCHITECTURE.md). One more lies, but once in 10,000 times, within 4.97 (Student's t, 18 degrees of freedom) times
    // 0.053 sqrt(1 + 1/19) of the mean. The form factors are half of the memory: forgotten or counted twice they leave that.
    assert!((0.76..1.31).contains(&(foretold / measured)), "{foretold} foretold, {measured} measured");

    // All of it but a quarter of the form factors: what was freed before holds some of them too.
    let rows = record(&free)["counts"]["form_factor_bytes"].as_f64().unwrap();
    let limit = ((foretold - 0.25 * rows) * 1e-6).round();
    let (spilled, output) = bake_with("spilled", &["--memory-limit", &format!("{limit}M")]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(record(&spilled)["foretold_memory_bytes"].as_f64().unwrap() < foretold - 0.25 * rows);
    assert!(contents(&spilled) == contents(&free));
    // All that is resident, pages of the file too: with all of these it would be what the first one took, within the limit
    // only if that had been foretold a quarter of the form factors too high.
    let resident = record(&spilled)["peak_memory_bytes"].as_f64().unwrap();
    assert!(resident < limit * 1e6, "{resident} resident, {limit} MB allowed");
    assert_eq!(names(&spilled), ["bake.json", "lit.glb", "patches.ply", "vertices.ply"]);
}

#[test]
fn a_bake_that_fits_no_limit_is_refused_and_what_is_suggested_is_accepted() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let ends = |options: &[&str], code: i32| {
        let output = bake(&out, options).output().unwrap();
        let says = stderr(&output);
        assert_eq!(output.status.code(), Some(code), "{options:?}: {says}");
        assert_eq!(out.exists(), code == 0);
        fs::remove_dir_all(&out).ok();
        says
    };
    let word_after = |says: &str, what: &str| {
        let rest = says.split(what).nth(1).unwrap_or_else(|| panic!("no {what:?} in {says}"));
        rest.split([' ', ',']).next().unwrap().to_string()
    };
    // Before there are patches, and when their rows are weighed.
    for fine in ["4096", "96"] {
        let setting = |grid, limit| ["--grid", grid, "--rays", "16", "--no-estimate", "--memory-limit", limit];
        let says = ends(&setting(fine, "60M"), 1);
        assert!(says.contains("--memory-limit allows 60 MB; choose --grid "), "{says}");
        let coarse = word_after(&says, "choose --grid ");
        ends(&setting(&coarse, "60M"), 0);
        if fine == "96" {
            ends(&setting(fine, &format!("{}M", word_after(&says, "or allow "))), 0);
        }
    }
    // No voxels are large enough.
    let says = ends(&["--grid", "8", "--memory-limit", "1M"], 1);
    assert!(says.contains("allows 1 MB; allow ") && !says.contains("--grid"), "{says}");
    let says = ends(&["--memory-limit", "1G", "--spill-dir", "nowhere"], 2);
    assert!(says.contains("there is no such folder"), "{says}");
}

/// A bake of some hundred kB onto what has no room for it.
fn refused_for_room(out: &Path, mut command: Command, why: &str) {
    let before = if out.exists() { names(out) } else { Vec::new() };
    let output = command.output().unwrap();
    let says = stderr(&output);
    assert_eq!(output.status.code(), Some(1), "{says}");
    assert!(says.contains(out.to_str().unwrap()) && says.contains(why), "{says}");
    let after = if out.exists() { names(out) } else { Vec::new() };
    assert_eq!(after, before);
}

#[test]
fn a_file_over_the_limit_is_told_with_the_remedy_and_leaves_what_was_there() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    fs::create_dir(&out).unwrap();
    fs::write(out.join("bake.json"), "of an older bake").unwrap();
    let mut limited = Command::new("sh");
    limited.args(["-c", "ulimit -f 64; exec \"$@\"", "sh", LUXEL, "bake"]);
    limited.arg(cornell()).arg("-o").arg(&out).args(["--grid", "16", "--rays", "16", "--no-preview", "-q"]);
    refused_for_room(&out, limited, "raise the limit");
    assert_eq!(fs::read_to_string(out.join("bake.json")).unwrap(), "of an older bake");
}

/// A small disk of its own, for as long as it lives; `None` where that is not allowed.
struct Disk(tempfile::TempDir);

impl Disk {
    fn new(options: &str) -> Option<Disk> {
        let place = tempfile::tempdir().unwrap();
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", options, "tmpfs"]).arg(place.path()).output();
        mount.is_ok_and(|m| m.status.success()).then_some(Disk(place))
    }

    fn remount_read_only(&self) {
        let remounted = Command::new("mount").args(["-o", "remount,ro"]).arg(self.0.path()).status();
        assert!(remounted.unwrap().success());
    }
}

impl Drop for Disk {
    fn drop(&mut self) {
        Command::new("umount").arg(self.0.path()).status().ok();
    }
}

#[test]
fn full_and_read_only_disks_are_told_with_the_remedy() {
    let Some(disk) = Disk::new("size=256k") else {
        println!("skipped: a small disk takes the right to mount one");
        return;
    };
    let out = disk.0.path().join("out");
    refused_for_room(&out, bake(&out, &["--grid", "16", "--rays", "16"]), "the disk is full: make room");
    disk.remount_read_only();
    refused_for_room(&out, bake(&out, &[]), "the disk is mounted read-only");
}

#[test]
fn a_scene_that_vanished_and_a_folder_without_rights_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let gone = luxel().args(["bake", "gone.obj", "-o"]).arg(&out).output().unwrap();
    assert_eq!(gone.status.code(), Some(1));
    assert!(stderr(&gone).contains("gone.obj: "), "{}", stderr(&gone));
    assert!(!out.exists());
    // A file where a folder should be stands in for rights, which the superuser has everywhere.
    fs::write(&out, "x").unwrap();
    refused_for_file(&out);
}

fn refused_for_file(out: &Path) {
    let output = bake(&out.join("deeper"), &[]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains(out.to_str().unwrap()), "{}", stderr(&output));
}

/// Clocks are set back, and jump: durations come from a clock that does not, and order from nothing of the kind.
#[test]
fn the_time_of_day_is_asked_for_the_name_of_a_holder_alone() {
    fn asks(folder: &Path, found: &mut Vec<PathBuf>) {
        for entry in fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
            if entry.is_dir() {
                asks(&entry, found);
            } else if fs::read_to_string(&entry).is_ok_and(|text| text.contains("SystemTime")) {
                found.push(entry);
            }
        }
    }
    let mut found = Vec::new();
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    asks(&source, &mut found);
    assert_eq!(found, [source.join("lock.rs")]);
}
