//! A bake that is shared out: the bytes of one process, whatever happened to the shards on the way.

#[path = "common/command.rs"]
mod command;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

use command::{LUXEL, assert_same_results, scene};
use luxel::{
    Error, Result,
    bake::Run,
    farm::{Cast, Plan},
    lock::Lock,
    lxt::{Container, Name, Writer},
    outlook::Outlook,
    progress::{Progress, Silent},
    transfer::{Block, RowKeeper, Rows, Spill},
};
use tempfile::TempDir;

const QUICK: [&str; 6] = ["--grid", "12", "--rays", "64", "--point-samples", "8"];
const PICTURE: [&str; 2] = ["--preview-size", "32x24"];

fn luxel() -> Command {
    Command::new(LUXEL)
}

fn cornell() -> PathBuf {
    scene("cornell.toml")
}

/// The quick settings, where these options have no others.
fn settings<'a>(options: &[&'a str]) -> Vec<&'a str> {
    let quick = QUICK.chunks(2).filter(|pair| !options.contains(&pair[0])).flatten();
    quick.chain(options).copied().collect()
}

/// Runs a command that must end with this exit code; what it said on either stream.
fn ends(command: &mut Command, code: i32) -> String {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let said = [stdout, stderr].map(|text| String::from_utf8_lossy(&text).into_owned()).concat();
    assert_eq!(status.code(), Some(code), "{command:?}: {said}");
    said
}

fn plan(place: &Path, shards: &str, options: &[&str]) {
    let mut command = luxel();
    command.args(["farm", "plan"]).arg(cornell()).arg("-o").arg(place).args(["--shards", shards]);
    ends(command.args(settings(options)), 0);
}

/// No rows are written down before a shard is done.
const HOUR: Duration = Duration::from_secs(3600);

fn shard(place: &Path, k: &str) -> Command {
    let mut command = luxel();
    command.args(["farm", "shard"]).arg(place).arg(k);
    command
}

/// Casts these shards without a process for each, on so many threads.
fn cast(place: &Path, shards: impl IntoIterator<Item = usize>, threads: usize) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    for k in shards {
        let cast = || {
            let mut run = Run { progress: &Silent, keeper: &mut (), deadline: None };
            Plan::open(place).unwrap().cast(k, HOUR, &mut run).unwrap()
        };
        let cast = pool.install(cast);
        assert!(matches!(cast, Cast::Now { resumed: 0, .. }), "{k}: {cast:?}");
    }
}

fn merge(place: &Path, to: &Path) -> Command {
    let mut command = luxel();
    command.args(["farm", "merge"]).arg(place).arg("-o").arg(to).args(PICTURE).arg("--quiet");
    command
}

/// What one process makes of the scene with these options: the results, and the transfer file.
fn alone(folder: &TempDir, options: &[&str]) -> (PathBuf, PathBuf) {
    let (results, file) = (folder.path().join("alone"), folder.path().join("alone.lxt"));
    let command = |name: &str, to: &Path| {
        let mut command = luxel();
        command.arg(name).arg(cornell()).arg("-o").arg(to).args(settings(options)).arg("--quiet");
        command
    };
    ends(command("bake", &results).args(PICTURE), 0);
    ends(&mut command("prepare", &file), 0);
    (results, file)
}

/// The merged shards are what one process makes.
fn same(folder: &TempDir, place: &Path, (results, file): &(PathBuf, PathBuf), what: &str) {
    let (merged, merged_file) = (folder.path().join("merged"), folder.path().join("merged.lxt"));
    ends(&mut merge(place, &merged), 0);
    ends(&mut merge(place, &merged_file), 0);
    // Shown where they differ.
    println!("{what}");
    assert_same_results(&merged, results);
    assert!(fs::read(merged_file).unwrap() == fs::read(file).unwrap(), "{what}: the transfer files differ");
}

#[test]
fn shards_of_any_number_in_any_order_on_any_threads_give_the_bytes_of_one_process() {
    let folder = tempfile::tempdir().unwrap();
    let alone = alone(&folder, &[]);
    for (count, threads) in [(1, 2), (2, 1), (7, 2), (16, 1)] {
        let place = folder.path().join(format!("plan-{count}"));
        plan(&place, &count.to_string(), &[]);
        // 5 has no divisor in common with any of them.
        let order: Vec<usize> = (0..count).map(|k| (5 * k + 3) % count).collect();
        cast(&place, order, threads);
        same(&folder, &place, &alone, &format!("{count} shards"));
    }
}

#[test]
fn every_mode_is_shared_out() {
    for options in [
        &["--only", "tall_block"][..],
        &["--only", "tall_block", "--rays", "512", "--no-estimate"],
        &["--patches", "faces", "--primary", "radiosity"],
        &["--patches", "decimated", "--no-skip"],
        &["--reconstruct", "adaptive", "--gather-rays", "16", "--backend", "bvh"],
    ] {
        let folder = tempfile::tempdir().unwrap();
        let alone = alone(&folder, options);
        let place = folder.path().join("plan");
        plan(&place, "3", options);
        let count = Plan::open(&place).unwrap().shards().len();
        cast(&place, 0..count, 2);
        same(&folder, &place, &alone, &format!("{options:?}"));
    }
}

#[test]
fn vertices_of_patches_that_were_foreseen_wrongly_are_made_again_by_the_merge() {
    let folder = tempfile::tempdir().unwrap();
    let alone = alone(&folder, &[]);
    let place = folder.path().join("plan");
    plan(&place, "2", &[]);
    let path = place.join("plan.lxt");
    let file = Container::open(&path, Name::new("plan")).unwrap();
    let mut writer = Writer::new(Vec::new(), Name::new("plan")).unwrap();
    for (kind, number) in file.names() {
        let mut payload = file.block(kind, number).unwrap().to_vec();
        if kind == Name::new("sight") {
            // Behind a length of several bytes, of which the last alone is below 128, there is a byte for each patch.
            let first = 1 + payload.iter().position(|&byte| byte < 128).unwrap();
            payload[first] ^= 1;
        }
        writer.block(kind, number, &[&payload]).unwrap();
    }
    fs::write(&path, writer.finish().unwrap()).unwrap();
    cast(&place, 0..2, 2);
    same(&folder, &place, &alone, "a patch foreseen wrongly");
}

#[test]
fn a_shard_that_is_done_or_not_there_is_nothing_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("plan");
    plan(&place, "2", &[]);
    assert!(ends(&mut shard(&place, "0"), 0).contains("done in"));
    let first = fs::read(place.join("shard-0.lxt")).unwrap();
    assert!(ends(&mut shard(&place, "0"), 0).contains("was done before"));
    assert!(fs::read(place.join("shard-0.lxt")).unwrap() == first);
    let said = ends(shard(&place, "2").arg("--json-progress"), 0);
    assert!(said.contains("\"state\":\"beyond\""), "{said}");
    assert!(ends(&mut shard(&place, "99999999"), 0).contains("2 shards, 0 to 1"));

    // By a variable of the environment.
    let by = |variable: &str, value: Option<&str>| {
        let mut command = luxel();
        command.args(["farm", "shard"]).arg(&place).args(["--index", variable, "--json-progress"]);
        value.map(|value| command.env(variable, value));
        command
    };
    let said = ends(&mut by("FARM_TEST_TASK", Some("1")), 0);
    let last: serde_json::Value = serde_json::from_str(said.trim().lines().last().unwrap()).unwrap();
    assert_eq!((&last["shard"], &last["state"]), (&1.into(), &"done".into()));
    assert!(last["rays"].as_u64().unwrap() > 10_000);
    let said = ends(&mut shard(&place, "-1"), 2);
    assert!(said.contains("must be a whole number, 0 or more"), "{said}");
    assert!(ends(&mut by("FARM_TEST_TASK", Some("one")), 1).contains("\"one\" is no number of a shard"));
    assert!(ends(&mut by("FARM_TEST_NOTHING", None), 1).contains("there is no such variable"));
    ends(luxel().args(["farm", "shard"]).arg(&place), 2);

    let said = ends(luxel().args(["farm", "status", "--json"]).arg(&place), 0);
    let status: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(status["totals"]["done"], 2);
    assert_eq!(status["rows"], status["rows_done"]);
}

/// Moves rows to a file, and asks what they will take.
struct Elsewhere {
    spill: Spill,
    foretold: u64,
}

impl RowKeeper for Elsewhere {
    fn begin(&mut self, _: &mut Rows, outlook: &dyn Fn() -> Result<Outlook>) -> Result<()> {
        outlook().map(|outlook| self.foretold = outlook.rows)
    }

    fn spills(&self) -> bool {
        true
    }

    fn keep(&mut self, block: Block) -> Result<Block> {
        self.spill.put(block)
    }
}

#[test]
fn rows_of_a_shard_may_leave_the_memory_and_what_no_memory_holds_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("plan");
    plan(&place, "4", &["--no-estimate"]);
    let limited = |command: &mut Command| ends(command.args(["--memory-limit", "2M"]), 1);
    let said = limited(&mut shard(&place, "0"));
    assert!(said.contains("the shard would take ") && said.contains("make a plan of more shards"), "{said}");
    assert!(!place.join("shard-0.lxt").exists());

    cast(&place, [1], 2);
    let whole = fs::read(place.join("shard-1.lxt")).unwrap();
    fs::remove_file(place.join("shard-1.lxt")).unwrap();
    let mut keeper = Elsewhere { spill: Spill::new(folder.path()).unwrap(), foretold: 0 };
    Plan::open(&place)
        .unwrap()
        .cast(1, HOUR, &mut Run { progress: &Silent, keeper: &mut keeper, deadline: None })
        .unwrap();
    assert!(fs::read(place.join("shard-1.lxt")).unwrap() == whole);
    // There are fewer rows than a sample has: all of them are in it.
    assert_eq!(keeper.foretold, keeper.spill.size_in_bytes());

    cast(&place, [0, 2, 3], 2);
    for output in ["merged.lxt", "merged"] {
        let said = limited(&mut merge(&place, &folder.path().join(output)));
        assert!(
            said.contains("the merge would take ") && said.contains("; make a plan with a larger --voxel"),
            "{said}"
        );
    }
    let mut other = luxel();
    other
        .args(["farm", "plan"])
        .arg(cornell())
        .args(QUICK)
        .args(["--shards", "2", "-o"])
        .arg(folder.path().join("other"));
    assert!(limited(&mut other).contains("the bake would take "));
}

/// Wants no more once anything is done.
#[derive(Default)]
struct Once(AtomicBool);

impl Progress for Once {
    fn begin(&self, _: &str, _: u64) {}

    fn end(&self) {}

    fn advance(&self, _: u64) {
        self.0.store(true, Ordering::Relaxed);
    }

    fn stopped(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

#[test]
fn a_shard_that_is_interrupted_at_once_keeps_what_it_has_cast() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("plan");
    plan(&place, "2", &[]);
    let plan = Plan::open(&place).unwrap();
    let cast = |progress: &dyn Progress| plan.cast(0, HOUR, &mut Run { progress, keeper: &mut (), deadline: None });
    assert!(matches!(cast(&Once::default()), Err(Error::Interrupted(_))));
    let resumed = cast(&Silent).unwrap();
    assert!(matches!(resumed, Cast::Now { resumed: 1.., .. }), "{resumed:?}");
}

#[test]
fn shards_that_cannot_be_used_are_named_with_what_mends_them() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("plan");
    plan(&place, "3", &[]);
    cast(&place, 0..3, 2);
    let path = |k: usize| place.join(format!("shard-{k}.lxt"));
    let sound: Vec<Vec<u8>> = (0..3).map(|k| fs::read(path(k)).unwrap()).collect();

    // Shards of other plans.
    let of_other = |options: &[&str]| {
        let other = tempfile::tempdir().unwrap();
        plan(&other.path().join("plan"), "3", options);
        cast(&other.path().join("plan"), [1], 2);
        fs::read(other.path().join("plan/shard-1.lxt")).unwrap()
    };
    let settings = of_other(&["--rays", "32", "--seed", "3"]);
    let light = of_other(&["--sky", "1,1,1"]);
    let sides = of_other(&["--sides", "two"]);
    // The same with changes, and checksums that fit.
    let written = |kinds: &[&str], change: &dyn Fn(&mut serde_json::Value)| {
        let file = Container::of_bytes(&path(1), sound[1].clone().into(), Name::new("shard")).unwrap();
        let mut writer = Writer::new(Vec::new(), Name::new("shard")).unwrap();
        let mut identity: serde_json::Value = file.json(Name::new("identity"), 0).unwrap();
        change(&mut identity);
        writer.json(Name::new("identity"), 0, &identity).unwrap();
        for kind in kinds.iter().map(|kind| Name::new(kind)) {
            for number in file.numbers(kind) {
                writer.block(kind, number, &[&file.block(kind, number).unwrap()]).unwrap();
            }
        }
        writer.finish().unwrap()
    };
    let elsewhere = written(&["settings", "rows", "again", "stencils"], &|identity| {
        identity["build"]["instruction_set"] = "abacus".into();
    });
    let short = written(&["settings", "rows", "stencils"], &|_| ());
    let blind = written(&["settings", "rows", "again"], &|_| ());
    let changed = |at: usize| {
        let mut bytes = sound[1].clone();
        bytes[at] ^= 4;
        bytes
    };
    let cut = sound[1][..sound[1].len() / 2].to_vec();
    let cases: [(&str, Option<Vec<u8>>); 11] = [
        ("shard 1 is missing", None),
        ("cut off", Some(cut)),
        ("its first bytes are lost (0 bytes)", Some(Vec::new())),
        ("its first bytes are lost", Some(b"no shard at all".repeat(9))),
        ("are not what was written", Some(changed(sound[1].len() / 2))),
        ("rays 32 there, 64 here; seed 3 there, 0 here", Some(settings)),
        ("is of another plan of this scene", Some(light)),
        ("is of another scene", Some(sides)),
        ("made by another build: instruction set abacus there", Some(elsewhere)),
        ("lacks rows", Some(short)),
        ("block stencils 0: is missing", Some(blind)),
    ];
    let to = folder.path().join("out");
    for (what, bytes) in cases {
        fs::remove_file(path(1)).unwrap();
        if let Some(bytes) = &bytes {
            fs::write(path(1), bytes).unwrap();
        }
        let said = ends(&mut merge(&place, &to), 3);
        assert!(said.contains("1 of 3 shards") && said.contains(what), "{said}\n(expected: {what})");
        let remedy = format!("luxel farm shard {} 1", place.display());
        assert!(said.contains(&remedy), "{said}");
        assert!(!to.exists());
        let said = ends(luxel().args(["farm", "status"]).arg(&place), 0);
        assert!(said.contains(if bytes.is_some() { "1 broken" } else { "1 open" }), "{said}");
        ends(&mut shard(&place, "1"), 0);
        assert!(fs::read(path(1)).unwrap() == sound[1], "{what}");
    }
    fs::write(path(2), &sound[1]).unwrap();
    let said = ends(&mut merge(&place, &to.with_extension("lxt")), 3);
    assert!(said.contains("is shard 1"), "{said}");
    // All that are wrong are named at once.
    fs::remove_file(path(0)).unwrap();
    fs::write(path(1), changed(sound[1].len() / 2)).unwrap();
    let said = ends(&mut merge(&place, &to), 3);
    for what in ["3 of 3 shards", "shard 0 is missing", "shard 1 cannot be used", "shard 2 cannot be used"] {
        assert!(said.contains(what), "{said}");
    }
    for (k, sound) in sound.iter().enumerate() {
        fs::write(path(k), sound).unwrap();
    }
    ends(&mut merge(&place, &to), 0);
}

#[test]
fn however_many_shards_are_missing_all_are_named_with_commands_that_a_shell_takes() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("our plan");
    plan(&place, "99", &[]);
    let shards = Plan::open(&place).unwrap().shards().len();
    assert!(shards > 25, "{shards}");
    cast(&place, [21, 23], 2);
    let said = ends(&mut merge(&place, &folder.path().join("out")), 3);
    assert!(said.contains(&format!("{} of {shards} shards", shards - 2)), "{said}");
    for k in 0..20 {
        assert!(
            said.contains(&format!("shard {k} is missing: luxel farm shard '{}' {k}\n", place.display())),
            "{said}"
        );
    }
    assert!(said.contains(&format!("and {} more, 20,22,24-{}: see", shards - 22, shards - 1)), "{said}");
}

#[test]
fn shards_without_light_are_merged_to_a_file_that_is_lit() {
    let folder = tempfile::tempdir().unwrap();
    let [place, file, out] = ["plan", "some.lxt", "out"].map(|name| folder.path().join(name));
    let mut command = luxel();
    command.args(["farm", "plan"]).arg(cornell()).arg("-o").arg(&place).args([
        "--shards",
        "2",
        "--emit",
        "light=0,0,0",
    ]);
    let said = ends(command.args(QUICK), 0);
    assert!(said.contains("there is no light: merge the shards to a FILE.lxt"), "{said}");
    cast(&place, 0..2, 2);
    let said = ends(&mut merge(&place, &out), 1);
    assert!(said.contains("add lights with luxel relight"), "{said}");
    ends(&mut merge(&place, &file), 0);
    ends(luxel().arg("relight").arg(&file).args(["--emit", "light=1,1,1", "--quiet", "-o"]).arg(&out).args(PICTURE), 0);
}

#[test]
fn results_come_neither_among_the_shards_nor_in_their_places() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("plan");
    plan(&place, "1", &[]);
    cast(&place, 0..1, 2);
    let files = || {
        let entries = fs::read_dir(&place).unwrap().map(|entry| entry.unwrap().path());
        entries.map(|path| (fs::read(&path).ok(), path)).collect::<BTreeSet<_>>()
    };
    let before = files();
    let own =
        ["plan.lxt", "shard-0.lxt", "SHARD-0.LXT", "shard-7.lxt", "shard-0.checkpoint/a", "logs", "a/../merge.sbatch"];
    let around = folder.path().join("elsewhere/../plan/.");
    for to in own.map(|name| place.join(name)).into_iter().chain([place.clone(), around]) {
        let said = ends(&mut merge(&place, &to), 1);
        assert!(said.contains(&format!("such as {}", place.join("result").display())), "{to:?}: {said}");
    }
    assert!(files() == before);
    #[cfg(unix)]
    {
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(&place, &link).unwrap();
        assert!(ends(&mut merge(&place, &link), 1).contains("among its shards"));
        assert!(ends(&mut merge(&link, &place), 1).contains("among its shards"));
    }
    for to in ["result", "shards.lxt", "shard-0/shard-0.lxt"] {
        ends(&mut merge(&place, &place.join(to)), 0);
    }
}

/// Removes the plan when the first rows are there.
struct Vandal<'a>(&'a Path);

impl RowKeeper for Vandal<'_> {
    fn keep(&mut self, block: Block) -> Result<Block> {
        fs::remove_dir_all(self.0).ok();
        Ok(block)
    }
}

#[test]
fn a_shard_of_a_plan_that_vanished_meanwhile_is_not_done() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("plan");
    plan(&place, "2", &[]);
    let mut run = Run { progress: &Silent, keeper: &mut Vandal(&place), deadline: None };
    let error = Plan::open(&place).unwrap().cast(0, HOUR, &mut run).unwrap_err();
    assert!(error.to_string().contains("there is no plan"), "{error}");
    assert!(!place.exists());
}

#[test]
fn a_plan_of_another_build_or_in_another_plans_place_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path().join("plan");
    plan(&place, "2", &[]);
    let mut again = luxel();
    again.args(["farm", "plan"]).arg(cornell()).arg("-o").arg(&place).args(["--shard-seconds", "60"]);
    assert!(ends(&mut again, 1).contains("there is a plan already"));
    let third = folder.path().join("third");
    fs::create_dir(&third).unwrap();
    let lock = Lock::folder(&third, "somebody else").unwrap();
    let mut late = luxel();
    late.args(["farm", "plan"]).arg(cornell()).arg("-o").arg(&third).args(["--shards", "2"]).args(QUICK);
    assert!(ends(&mut late, 75).contains("in use by somebody else"));
    drop(lock);
    ends(&mut late, 0);
    let other = folder.path().join("other");
    let mut neither = luxel();
    neither.args(["farm", "plan"]).arg(cornell()).arg("-o").arg(&other).args(QUICK);
    ends(&mut neither, 2);
    let said = ends(neither.args(["--shard-seconds", "1000", "--json-progress"]), 0);
    assert!(said.contains("\"shards\":1"), "{said}");
    assert_eq!(Plan::open(&other).unwrap().shards().len(), 1);

    let path = place.join("plan.lxt");
    let bytes = fs::read(&path).unwrap();
    let file = Container::of_bytes(&path, bytes.clone().into(), Name::new("plan")).unwrap();
    // One JSON block with another value, and checksums that fit.
    let change = |name: &str, change: &dyn Fn(&mut serde_json::Value)| {
        let mut writer = Writer::new(Vec::new(), Name::new("plan")).unwrap();
        for (kind, number) in file.names() {
            if kind == Name::new(name) {
                let mut value: serde_json::Value = file.json(kind, number).unwrap();
                change(&mut value);
                writer.json(kind, number, &value).unwrap();
            } else {
                writer.block(kind, number, &[&file.block(kind, number).unwrap()]).unwrap();
            }
        }
        fs::write(&path, writer.finish().unwrap()).unwrap();
    };
    change("identity", &|identity| identity["build"]["version"] = "0.0.1".into());
    let said = ends(&mut shard(&place, "0"), 1);
    assert!(said.contains("plan.lxt: ") && said.contains("luxel 0.0.1 there"), "{said}");
    // Nobody makes a list of so many patches.
    change("shards", &|shards| shards[1]["patches"]["end"] = u32::MAX.into());
    for command in [&mut shard(&place, "0"), luxel().args(["farm", "status"]).arg(&place)] {
        let said = ends(command, 1);
        assert!(said.contains("block shards 0: is not of these patches"), "{said}");
    }

    fs::write(&path, &bytes[..bytes.len() - 9]).unwrap();
    assert!(ends(&mut shard(&place, "0"), 1).contains("plan.lxt: is cut off"));
    for wrong in [folder.path().join("nowhere"), path] {
        let said = ends(&mut shard(&wrong, "0"), 1);
        assert!(said.contains(&format!("{}/plan.lxt: there is no plan", wrong.display())), "{said}");
    }
}

#[cfg(unix)]
mod interrupted {
    use std::{
        os::unix::process::ExitStatusExt,
        process::{Child, Stdio},
        thread,
    };

    use super::*;

    const TERM: i32 = 15;
    const KILL: i32 = 9;
    const STOP: i32 = 19;

    /// A plan of one shard, of some seconds of work, and where its rows are written down.
    fn long(folder: &TempDir) -> (PathBuf, PathBuf) {
        let place = folder.path().join("plan");
        plan(&place, "1", &["--rays", "16384", "--backend", "bvh", "--no-estimate"]);
        let checkpoint = place.join("shard-0.checkpoint");
        (place, checkpoint)
    }

    /// Starts the shard, and waits until some of its rows are written down.
    fn begun(place: &Path, checkpoint: &Path) -> Child {
        let length = || fs::metadata(checkpoint).map_or(0, |meta| meta.len());
        let before = length();
        let mut command = shard(place, "0");
        let often = ["--threads", "1", "--checkpoint-every", "0.3s"];
        let mut child = command.args(often).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        while length() <= before {
            assert!(child.try_wait().unwrap().is_none(), "it was done before anything was written down");
            thread::sleep(Duration::from_millis(5));
        }
        child
    }

    fn send(child: &Child, signal: i32) {
        let sent = Command::new("kill").args([format!("-{signal}"), child.id().to_string()]).status();
        assert!(sent.unwrap().success());
    }

    #[test]
    fn a_shard_that_was_killed_goes_on_where_it_was_and_gives_the_same_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let (place, checkpoint) = long(&folder);
        let mut child = begun(&place, &checkpoint);
        // Held for as long as the others need to find it there.
        send(&child, STOP);

        // Whoever comes second is told who was first.
        let said = ends(&mut shard(&place, "0"), 75);
        assert!(said.contains(&format!("in use by luxel farm shard 0, process {} on ", child.id())), "{said}");
        let said = ends(luxel().args(["farm", "status"]).arg(&place), 0);
        assert!(said.contains("1 running") && said.contains(&format!("process {}", child.id())), "{said}");
        let said = ends(&mut merge(&place, &folder.path().join("out")), 3);
        let holder = format!("shard 0 is not done: wait for luxel farm shard 0, process {} on ", child.id());
        assert!(said.contains(&holder), "{said}");

        send(&child, KILL);
        assert_eq!(child.wait().unwrap().signal(), Some(KILL));
        assert!(!place.join("shard-0.lxt").exists());
        let said = ends(luxel().args(["farm", "status", "--json"]).arg(&place), 0);
        let status: serde_json::Value = serde_json::from_str(&said).unwrap();
        let rows = status["shards"][0]["rows_done"].as_u64().unwrap();
        assert_eq!(status["shards"][0]["state"], "open");
        assert!(0 < rows && rows < status["rows"].as_u64().unwrap(), "{said}");

        let mut child = begun(&place, &checkpoint);
        send(&child, TERM);
        assert_eq!(child.wait().unwrap().code(), Some(128 + TERM));
        fs::write(place.join(".shard-0.lxt.1.tmp"), "half of a shard").unwrap();
        // A torn end, as of a machine that lost its power.
        let mut bytes = fs::read(&checkpoint).unwrap();
        bytes.extend([7; 100]);
        fs::write(&checkpoint, bytes).unwrap();

        let said = ends(shard(&place, "0").arg("--json-progress"), 0);
        let last: serde_json::Value = serde_json::from_str(said.trim().lines().last().unwrap()).unwrap();
        assert!(last["rows_resumed"].as_u64().unwrap() > rows, "{said}");
        let mut left: Vec<_> = fs::read_dir(&place).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        left.sort();
        assert_eq!(left, ["plan.lxt", "shard-0.lxt"]);

        let whole = folder.path().join("whole");
        fs::create_dir(&whole).unwrap();
        fs::copy(place.join("plan.lxt"), whole.join("plan.lxt")).unwrap();
        cast(&whole, [0], 2);
        let [resumed, whole] = [place, whole].map(|place| fs::read(place.join("shard-0.lxt")).unwrap());
        assert!(resumed == whole);
    }
}
