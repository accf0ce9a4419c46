//! The example of GNU parallel in docs/FARM.md, with two machines that are folders of this one.

#[path = "common/farm.rs"]
mod farm;

use std::{collections::BTreeSet, fs, os::unix::fs::PermissionsExt, process::Command};

use farm::{
    command::{LUXEL, assert_same_results, scene},
    plan, run,
};

/// Stands for ssh: runs the command on this machine, and lists the machine that it was meant for.
const SSH: &str = r#"#!/bin/bash
while [[ $1 == -* ]]; do shift; done
echo "$1" >>"${0%/*}/machines"
shift
[ "$1" = -- ] && shift
# As sshd does; without it nothing is run.
SHELL=/bin/sh exec sh -c "$*"
"#;

#[test]
fn shards_on_two_machines_by_gnu_parallel_give_the_bytes_of_one_bake() {
    if Command::new("parallel").arg("--version").output().is_err() {
        println!("skipped: parallel is not installed (Debian: parallel)");
        return;
    }
    let root = tempfile::tempdir().unwrap();
    let path = |name: &str| root.path().join(name);
    let scene = scene("cornell.toml");
    let settings = ["--grid", "12", "--rays", "64", "--point-samples", "8"];
    run(Command::new(LUXEL).arg("bake").arg(&scene).arg("-o").arg(path("bake")).args(settings));

    plan(&scene, &path("PLAN"), 5, &settings);
    fs::write(path("ssh"), SSH).unwrap();
    fs::set_permissions(path("ssh"), fs::Permissions::from_mode(0o755)).unwrap();
    // More tasks than there are shards, as array schedulers do.
    run(Command::new("parallel")
        .env("HOME", root.path())
        .arg("--ssh")
        .arg(path("ssh"))
        .args(["--sshlogin", "1/node1,1/node2", "--retries", "3", "--termseq", "TERM,5000,KILL,25"])
        .args([LUXEL, "farm", "shard"])
        .arg(path("PLAN"))
        .args(["{}", ":::"])
        .args((0..7).map(|shard| shard.to_string())));
    let machines = fs::read_to_string(path("machines")).unwrap();
    assert_eq!(machines.lines().collect::<BTreeSet<_>>(), BTreeSet::from(["node1", "node2"]));

    run(Command::new(LUXEL).args(["farm", "merge"]).arg(path("PLAN")).arg("-o").arg(path("merged")));
    assert_same_results(&path("bake"), &path("merged"));
}
