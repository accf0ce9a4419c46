//! Bakes that are killed at random moments and taken up again: same bytes? And how soon a bake ends when it is asked to.
//!
//! `cargo bench --bench kill [-- MOMENTS]`, 50 by default.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use luxel::sampling::hash;

const FILES: [&str; 4] = ["vertices.ply", "patches.ply", "lit.glb", "4-combined.png"];

fn bake(out: &Path, resume: bool) -> Child {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.obj");
    let mut command = Command::new(env!("CARGO_BIN_EXE_luxel"));
    command.arg("bake").arg(scene).arg("-o").arg(out);
    command.args(["--grid", "32", "--rays", "4096", "-q", "--checkpoint-every", "0.05s"]);
    if resume {
        command.arg("--resume");
    }
    command.stderr(Stdio::null()).spawn().expect("luxel starts")
}

fn contents(out: &Path) -> Vec<Vec<u8>> {
    FILES.map(|name| fs::read(out.join(name)).expect("a result")).to_vec()
}

fn send(child: &Child, signal: &str) {
    Command::new("kill").args([signal, &child.id().to_string()]).status().expect("kill runs");
}

fn main() {
    // Cargo passes `--bench`.
    let moments: u64 = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(50);
    let folder = std::env::temp_dir().join(format!("luxel-kill-{}", std::process::id()));
    let place = |name: &str| -> PathBuf { folder.join(name) };
    let begun = Instant::now();
    assert!(bake(&place("whole"), false).wait().expect("it ends").success());
    let (whole, seconds) = (contents(&place("whole")), begun.elapsed().as_secs_f64());
    println!("a bake of {seconds:.2} s, {} moments", moments);

    let random = |k: u64, purpose: u64| hash(&[k, purpose]) as f64 / u64::MAX as f64 * seconds;
    let (mut same, mut left, mut done) = (0, 0, 0);
    for k in 0..moments {
        let out = place("killed");
        let mut child = bake(&out, false);
        std::thread::sleep(Duration::from_secs_f64(random(k, 0)));
        child.kill().expect("it can be killed");
        done += child.wait().expect("it ends").success() as u64;
        left += out.join(".luxel.checkpoint").exists() as u64;
        assert!(bake(&out, true).wait().expect("it ends").success(), "moment {k}");
        same += (contents(&out) == whole) as u64;
        fs::remove_dir_all(&out).expect("a folder");
    }
    println!("kill -9: {same} of {moments} same bytes; {left} had a checkpoint, {done} were done before");

    let mut slowest = Duration::ZERO;
    let (mut same, mut coded) = (0, 0);
    for k in 0..moments {
        let out = place("asked");
        let (signal, code) = if k % 2 == 0 { ("-TERM", 143) } else { ("-INT", 130) };
        let mut child = bake(&out, false);
        std::thread::sleep(Duration::from_secs_f64(random(k, 1)));
        let asked = Instant::now();
        send(&child, signal);
        let status = child.wait().expect("it ends");
        if !status.success() {
            slowest = slowest.max(asked.elapsed());
        }
        // The earliest come before the signals are caught.
        coded += (status.success() || status.code() == Some(code)) as u64;
        assert!(bake(&out, true).wait().expect("it ends").success(), "moment {k}");
        same += (contents(&out) == whole) as u64;
        fs::remove_dir_all(&out).expect("a folder");
    }
    println!(
        "SIGTERM, SIGINT: {same} of {moments} same bytes, {coded} with their exit code; the slowest ended after {:.2} s",
        slowest.as_secs_f64()
    );
    fs::remove_dir_all(&folder).expect("a folder");
}
