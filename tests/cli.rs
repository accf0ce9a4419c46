//! The command line, as a user meets it.

#[path = "common/command.rs"]
mod command;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use command::{luxel, names, stderr, stdout};
use luxel::output::atomic::Staged;
use tempfile::TempDir;

/// A room of 2 x 2 x 2 with a lamp under its ceiling, seen from inside.
const ROOM_OBJ: &str = "\
mtllib room.mtl
v -1 -1 -1
v 1 -1 -1
v 1 -1 1
v -1 -1 1
v -1 1 -1
v 1 1 -1
v 1 1 1
v -1 1 1
v -0.3 0.9 -0.3
v 0.3 0.9 -0.3
v 0.3 0.9 0.3
v -0.3 0.9 0.3
usemtl wall
f 4 3 2 1
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 3 4 8 7
f 4 1 5 8
usemtl lamp
f 9 10 11 12
";
const ROOM_MTL: &str = "newmtl wall\nKd 0.5 0.4 0.3\nnewmtl lamp\nKd 0 0 0\nKe 5 5 5\n";
/// Settings that bake the room in a moment.
const QUICK: [&str; 6] = ["--grid", "6", "--rays", "16", "--point-samples", "4"];

fn room() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("room.obj");
    fs::write(&scene, ROOM_OBJ).unwrap();
    fs::write(folder.path().join("room.mtl"), ROOM_MTL).unwrap();
    (folder, scene)
}

fn bake(scene: &Path, output: &Path, more: &[&str]) -> Output {
    let paths = ["bake", scene.to_str().unwrap(), "-o", output.to_str().unwrap()];
    luxel(&[&paths, &QUICK[..], more].concat())
}

#[test]
fn help_names_the_commands_and_every_bake_option() {
    let top = luxel(&["--help"]);
    assert!(top.status.success());
    for command in ["bake", "check", "points"] {
        assert!(stdout(&top).contains(&format!("  {command}")), "{}", stdout(&top));
        let help = luxel(&[command, "--help"]);
        assert!(help.status.success());
        for option in [
            "--grid",
            "--voxel",
            "--patches",
            "--proxy",
            "--target-patches",
            "--gather-rays",
            "--rays",
            "--reconstruct",
            "--primary",
            "--backend",
            "--sides",
            "--seed",
            "--threads",
            "--normal-threshold",
            "--point-samples",
            "--patch-samples",
            "--tolerance",
            "--face-colour",
            "--no-skip",
            "--sky",
            "--sun",
            "--point",
            "--emit",
            "--environment",
            "--quiet",
            "--json-progress",
        ] {
            assert!(stdout(&help).contains(option), "luxel {command} --help lacks {option}");
        }
    }
}

#[test]
fn wrong_usage_exits_with_2_and_says_what_would_be_right() {
    let cases: [(&[&str], &str); 14] = [
        (&[], "Usage"),
        (&["roast"], "unrecognized subcommand"),
        (&["bake", "a.obj"], "--output"),
        (&["bake", "a.obj", "-o", "x", "--rays", "100"], "a power of two, such as 64 or 128"),
        (&["bake", "a.obj", "-o", "x", "--rays", "-1"], "a whole number from 16 to 65536"),
        (&["bake", "a.obj", "-o", "x", "--gather-rays", "8"], "a whole number from 16 to 65536"),
        (&["bake", "a.obj", "-o", "x", "--target-patches", "0"], "a whole number from 16 to 50000000"),
        (&["bake", "a.obj", "-o", "x", "--grid", "5000"], "a whole number from 2 to 4096"),
        (&["bake", "a.obj", "-o", "x", "--grid", "8", "--voxel", "1"], "cannot be used with"),
        (&["bake", "a.obj", "-o", "x", "--voxel", "-1"], "must be above 0"),
        (&["bake", "a.obj", "-o", "x", "--backend", "gpu"], "auto, embree, bvh, brute"),
        (&["bake", "a.obj", "-o", "x", "--sun", "0,0,0:1,1,1"], "a direction cannot be 0,0,0"),
        (&["check", "a.obj", "--sky", "1,inf,1"], "inf is not finite"),
        (&["points", "a.obj", "-o", "x"], "--at"),
    ];
    for (args, expected) in cases {
        let output = luxel(args);
        assert_eq!(output.status.code(), Some(2), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{args:?}: {}", stderr(&output));
    }
}

#[test]
fn a_missing_scene_exits_with_1_and_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let output = bake(&folder.path().join("none.obj"), &folder.path().join("out"), &[]);
    assert_eq!(output.status.code(), Some(1));
    let message = stderr(&output);
    assert!(message.starts_with("luxel: ") && message.contains("none.obj"), "{message}");
    assert!(!message.contains("panicked") && message.lines().count() == 1, "{message}");
    assert!(names(folder.path()).is_empty());
}

#[test]
fn a_bake_makes_its_folder_and_all_files() {
    let (folder, scene) = room();
    let out = folder.path().join("a/b");
    let output = bake(&scene, &out, &["--preview-size", "16x12", "--sun", "-1,-2,-0.5:1,1,1"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let expected = [
        "1-direct.png",
        "2-patches.png",
        "3-secondary.png",
        "4-combined.png",
        "bake.json",
        "lit.glb",
        "patches.ply",
        "preview.exr",
        "vertices.ply",
    ];
    assert_eq!(names(&out), expected);
    let json: serde_json::Value = serde_json::from_slice(&fs::read(out.join("bake.json")).unwrap()).unwrap();
    assert_eq!(json["settings"]["resolution"]["grid"], 6);
    assert_eq!(json["preview"]["width"], 16);
    assert!(json["peak_memory_bytes"].as_u64().unwrap() > 0);
    let picture = image::open(out.join("4-combined.png")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (16, 12));
    assert!(picture.pixels().any(|p| p.0 != [0; 3]), "the room is black");
    let document = gltf::Gltf::open(out.join("lit.glb")).unwrap();
    assert_eq!(document.meshes().count(), 1);
    assert!(stdout(&output).contains("patches"), "{}", stdout(&output));
}

#[test]
fn both_kinds_of_patches_and_no_pictures_work_together() {
    let (folder, scene) = room();
    let out = folder.path().join("out");
    let output = bake(&scene, &out, &["--patches", "faces", "--no-preview", "--quiet"]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert_eq!(names(&out), ["bake.json", "lit.glb", "patches.ply", "vertices.ply"]);
    assert!(output.stdout.is_empty() && output.stderr.is_empty(), "--quiet was not");
}

#[test]
fn a_proxy_gives_the_patches_and_a_wrong_one_is_named() {
    let (folder, scene) = room();
    let proxy = |name: &str, text: &str| {
        fs::write(folder.path().join(name), text).unwrap();
        folder.path().join(name).to_str().unwrap().to_string()
    };
    let walls: String = ROOM_OBJ.lines().filter(|l| l.starts_with('v') || l.starts_with("f ")).take(18).fold(
        String::new(),
        |mut text, line| {
            text.push_str(line);
            text.push('\n');
            text
        },
    );
    let good = proxy("good.obj", &walls);
    let out = folder.path().join("out");
    let output = bake(&scene, &out, &["--proxy", &good, "--preview-size", "16x12", "--reconstruct", "gather"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let report: serde_json::Value = serde_json::from_str(&fs::read_to_string(out.join("bake.json")).unwrap()).unwrap();
    assert_eq!((&report["settings"]["patches"], &report["settings"]["gather_rays"]), (&"proxy".into(), &1024.into()));

    let far = proxy("far.obj", "o wall\nv 0 0 0\nv 900 0 0\nv 0 900 0\nf 1 2 3\n");
    let stray = proxy("stray.obj", "o stray\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n");
    let cases: [(&[&str], &str); 6] = [
        (&["--patches", "proxy"], "give --proxy FILE"),
        (&["--proxy", "nowhere.obj"], "nowhere.obj: "),
        (&["--proxy", &good, "--patches", "faces"], "leave --patches out"),
        (&["--proxy", &far], "far.obj: the proxy spans [0, 0, 0] to [900, 900, 0]"),
        (&["--proxy", &stray], "stray.obj: mesh \"stray\", triangle ("),
        (&["--proxy", &stray], "(0.100000 0.000000 0.000000), (0.000000 0.100000 0.000000): is near no surface"),
    ];
    for (more, expected) in cases {
        let output = bake(&scene, &folder.path().join("none"), more);
        assert_eq!(output.status.code(), Some(1), "{more:?}");
        assert!(stderr(&output).contains(expected), "{more:?}: {}", stderr(&output));
    }
}

#[test]
fn the_same_bake_on_one_and_two_threads_writes_the_same_bytes() {
    let (folder, scene) = room();
    let outs = ["1", "2"].map(|threads| {
        let out = folder.path().join(threads);
        let output = bake(&scene, &out, &["--threads", threads, "--preview-size", "70x40"]);
        assert!(output.status.success(), "{}", stderr(&output));
        out
    });
    for name in ["vertices.ply", "patches.ply", "lit.glb", "1-direct.png", "2-patches.png", "4-combined.png"] {
        let [one, two] = outs.each_ref().map(|out| fs::read(out.join(name)).unwrap());
        assert!(one == two, "{name} depends on the number of threads");
    }
}

#[test]
fn json_progress_is_one_object_a_line() {
    let (folder, scene) = room();
    let output = bake(&scene, &folder.path().join("out"), &["--json-progress", "--no-preview"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let lines: Vec<serde_json::Value> =
        stdout(&output).lines().map(|l| serde_json::from_str(l).expect("a line is no JSON")).collect();
    let ended: Vec<_> = lines.iter().filter(|l| l["ended"] == true).collect();
    assert!(ended.len() >= 2);
    for line in &ended {
        assert_eq!(line["percent"], 100.0, "{line}");
        assert!(line["stage"].is_string() && line["done"].is_u64() && line["eta_seconds"] == 0.0, "{line}");
    }
    assert!(output.stderr.is_empty(), "{}", stderr(&output));
}

#[test]
fn a_folder_that_cannot_be_made_is_an_error_before_the_bake() {
    let (folder, scene) = room();
    let file = folder.path().join("file");
    fs::write(&file, "mine").unwrap();
    let output = bake(&scene, &file, &[]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("is a file"), "{}", stderr(&output));
    assert!(!stderr(&output).contains("form factors"), "it baked first");
    assert_eq!(fs::read(&file).unwrap(), b"mine");
}

#[test]
fn a_bake_that_fails_leaves_no_folder() {
    let (folder, scene) = room();
    fs::write(folder.path().join("room.mtl"), "newmtl wall\nKd 0.5 0.5 0.5\nnewmtl lamp\nKd 0 0 0\n").unwrap();
    let output = bake(&scene, &folder.path().join("out"), &[]);
    assert_eq!(output.status.code(), Some(1), "a scene without light was baked");
    let message = stderr(&output);
    for flag in ["--sky", "--sun", "--point", "--emit"] {
        assert!(message.contains(flag), "{message}");
    }
    assert_eq!(names(folder.path()), ["room.mtl", "room.obj"]);
}

#[test]
fn of_two_processes_that_write_one_file_the_second_is_told_of_the_first() {
    let (folder, scene) = room();
    let file = folder.path().join("new/some.lxt");
    let left = folder.path().join("new/.some.lxt.17.tmp");
    let prepare = || {
        let paths = ["prepare", scene.to_str().unwrap(), "-o", file.to_str().unwrap(), "--quiet"];
        luxel(&[&paths, &QUICK[..]].concat())
    };
    let first = Staged::open_file(&file, "the first").unwrap();
    let output = prepare();
    assert_eq!(output.status.code(), Some(75));
    assert!(stderr(&output).contains("some.lxt: in use by the first, process "), "{}", stderr(&output));
    drop(first);
    assert!(!folder.path().join("new").exists(), "the first has written nothing");

    fs::create_dir(folder.path().join("new")).unwrap();
    fs::write(&left, "by a process that was killed").unwrap();
    assert_eq!(prepare().status.code(), Some(0));
    assert_eq!(names(&folder.path().join("new")), ["some.lxt"]);
    assert_eq!(prepare().status.code(), Some(0), "a transfer file may be made anew");
}

#[test]
fn a_transfer_file_does_not_take_the_place_of_anything_else() {
    let (folder, scene) = room();
    let plan = folder.path().join("plan");
    let [scene, folder_of_plan] = [&scene, &plan].map(|path| path.to_str().unwrap());
    luxel(&[&["farm", "plan", scene, "--shards", "1", "-q", "-o", folder_of_plan], &QUICK[..]].concat());
    for place in [Path::new(scene), &plan.join("plan.lxt")] {
        let before = fs::read(place).unwrap();
        let output = luxel(&["prepare", scene, "-o", place.to_str().unwrap()]);
        assert_eq!(output.status.code(), Some(1));
        assert!(stderr(&output).contains("is no transfer file; choose another name"), "{}", stderr(&output));
        assert!(fs::read(place).unwrap() == before);
    }
}

#[test]
fn no_command_writes_over_what_it_reads() {
    let (folder, scene) = room();
    let points = folder.path().join("points");
    fs::write(&points, "0 0 0 0 1 0\n").unwrap();
    let before = [&points, &scene].map(|path| fs::read(path).unwrap());
    for input in [&points, &scene] {
        let [input, points, scene] = [input, &points, &scene].map(|path| path.to_str().unwrap());
        for command in ["points", "reference"] {
            let output = luxel(&[command, scene, "--at", points, "-o", input]);
            assert_eq!(output.status.code(), Some(1), "{command}");
            assert!(stderr(&output).contains(&format!("{input}: is read by this command; choose another name")));
        }
    }
    assert!([&points, &scene].map(|path| fs::read(path).unwrap()) == before);
}

#[cfg(unix)]
#[test]
fn no_file_takes_the_place_of_a_device_or_pipe() {
    let (folder, scene) = room();
    let [socket, points] = ["socket", "points"].map(|name| folder.path().join(name));
    let _listener = std::os::unix::net::UnixListener::bind(&socket).unwrap();
    fs::write(&points, "0 0 0 0 1 0\n").unwrap();
    let [socket, points, scene] = [&socket, &points, &scene].map(|path| path.to_str().unwrap());
    for words in [&["prepare", scene, "-o", socket][..], &["points", scene, "--at", points, "-o", socket]] {
        let output = luxel(&[words, &QUICK[..]].concat());
        assert_eq!(output.status.code(), Some(1), "{words:?}");
        assert!(stderr(&output).contains("socket: is no regular file; choose another name"), "{}", stderr(&output));
        assert!(!stderr(&output).contains("form factors"), "it baked first");
    }
}

/// Names of files are bytes there, and need be no text.
#[cfg(target_os = "linux")]
#[test]
fn names_of_files_may_be_any_bytes_and_where_they_may_not_that_is_told_before_the_work() {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt, process::Command};

    let (folder, scene) = room();
    let name = |bytes: &[u8]| folder.path().join(OsStr::from_bytes(bytes));
    let (odd, plan) = (name(b"new\nline \xff"), name(b"it's a \xfe plan"));
    fs::create_dir(&odd).unwrap();
    let [room, cache, out, merged, file] =
        ["room.obj", "cache", "out", "merged", "some.lxt"].map(|name| odd.join(name));
    fs::copy(&scene, &room).unwrap();
    fs::copy(scene.with_extension("mtl"), room.with_extension("mtl")).unwrap();
    let run = |words: &[&OsStr], more: &[&str]| {
        let more = more.iter().map(OsStr::new).collect::<Vec<_>>();
        Command::new(command::LUXEL).args([words, &more].concat()).output().unwrap()
    };
    let word = OsStr::new;
    let all: [(&[&OsStr], &[&str]); 8] = [
        (
            &[
                word("bake"),
                word("--no-preview"),
                room.as_ref(),
                word("--cache"),
                cache.as_ref(),
                word("-o"),
                out.as_ref(),
            ],
            &QUICK,
        ),
        (&[word("prepare"), room.as_ref(), word("-o"), file.as_ref()], &QUICK),
        (&[word("relight"), file.as_ref(), word("-o"), out.as_ref()], &["--no-preview"]),
        (
            &[word("farm"), word("plan"), room.as_ref(), word("-o"), plan.as_ref()],
            &["--shards=1", "--grid=6", "--rays=16", "--json-progress"],
        ),
        (&[word("farm"), word("shard"), plan.as_ref()], &["0", "--json-progress"]),
        (&[word("farm"), word("status"), plan.as_ref()], &[]),
        (&[word("farm"), word("status"), plan.as_ref()], &["--json"]),
        (&[word("farm"), word("merge"), plan.as_ref(), word("-o"), merged.as_ref()], &["--no-preview"]),
    ];
    for (words, more) in all {
        let output = run(words, more);
        assert_eq!(output.status.code(), Some(0), "{words:?}: {}", stderr(&output));
    }
    let record: serde_json::Value = serde_json::from_slice(&fs::read(out.join("bake.json")).unwrap()).unwrap();
    assert!(record["command"].to_string().contains("some.lxt"), "{record:#}");

    let output = run(&[word("prepare"), room.as_ref(), word("-o"), name(b"\xfd.lxt").as_ref()], &QUICK);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("must be UTF-8; choose another one"), "{}", stderr(&output));
    assert!(!stderr(&output).contains("form factors"), "it was prepared first");
}

fn points(folder: &Path, scene: &Path, text: &str) -> (Output, PathBuf) {
    let (at, out) = (folder.join("at.txt"), folder.join("new/light.csv"));
    fs::write(&at, text).unwrap();
    let args = ["points", scene.to_str().unwrap(), "--at", at.to_str().unwrap(), "-o", out.to_str().unwrap()];
    (luxel(&[&args[..], &QUICK].concat()), out)
}

#[test]
fn points_get_their_light_in_order() {
    let (folder, scene) = room();
    let (output, csv) = points(folder.path(), &scene, "# floor\n0 -1 0 0 2 0\n-1,0,0,1,0,0\n0 0.9 0 0 1 0\n");
    assert!(output.status.success(), "{}", stderr(&output));
    let text = fs::read_to_string(csv).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("x,y,z,nx,ny,nz,direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b"));
    let rows: Vec<Vec<f64>> = lines.map(|l| l.split(',').map(|x| x.parse().unwrap()).collect()).collect();
    assert_eq!(rows.len(), 3);
    assert_eq!(rows[0][..6], [0.0, -1.0, 0.0, 0.0, 1.0, 0.0]);
    assert!(rows[0][6] > rows[1][6], "the floor under the lamp is not the brightest");
    // Walls are red most, so indirect light is.
    assert!(rows[1][9] > rows[1][10] && rows[1][10] > rows[1][11] && rows[1][11] > 0.0, "{:?}", rows[1]);
    // Above the lamp, facing up: no direct light.
    assert_eq!(rows[2][6..9], [0.0; 3]);
}

#[test]
fn a_wrong_line_of_points_is_named_and_nothing_is_left() {
    let (folder, scene) = room();
    let (output, _) = points(folder.path(), &scene, "0 0 0 0 1 0\n0 0 0 0 1\n");
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("at.txt: line 2: 6 numbers"), "{}", stderr(&output));
    assert_eq!(names(folder.path()), ["at.txt", "room.mtl", "room.obj"]);
}

#[test]
fn check_tells_what_the_scene_holds() {
    let (_folder, scene) = room();
    let output = luxel(&["check", scene.to_str().unwrap()]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("14 triangles"), "{}", stdout(&output));
}

#[test]
fn a_target_is_baked_to_and_the_search_is_told() {
    let (folder, scene) = room();
    let out = folder.path().join("out");
    let run = |more: &[&str]| {
        let paths = ["bake", scene.to_str().unwrap(), "-o", out.to_str().unwrap(), "--no-preview"];
        let output = luxel(&[&paths, more].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let json: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(out.join("bake.json")).unwrap()).unwrap();
        (stdout(&output), json)
    };
    let (text, json) = run(&["--target-error", "2 %"]);
    assert!(text.contains("target reached: estimated"), "{text}");
    let steps = json["goal"]["steps"].as_array().unwrap();
    assert!(json["error"]["total"]["total"].as_f64().unwrap() <= 0.02);
    assert_eq!((&json["goal"]["target_error"], &json["goal"]["reached"]), (&0.02.into(), &true.into()));
    // The result is that of the last step.
    assert_eq!(steps.last().unwrap()["error"], json["error"]["total"]["total"]);
    assert_eq!(steps.last().unwrap()["rays"], json["settings"]["rays"]);
    // What is said explicitly is kept, also where it forbids the target.
    let (text, json) = run(&["--target-error", "0.01", "--grid", "4", "--rays", "16", "--point-samples", "4"]);
    assert!(text.contains("target not reached: estimated") && text.contains("no settings promise less"), "{text}");
    assert_eq!((&json["settings"]["resolution"]["grid"], &json["settings"]["rays"]), (&4.into(), &16.into()));
    assert_eq!(json["goal"]["reached"], false);
}

#[test]
fn quality_gives_way_to_explicit_settings_and_excludes_goals() {
    let (folder, scene) = room();
    let scene = scene.to_str().unwrap();
    let forecast = |more: &[&str]| {
        let output = luxel(&[&["check", scene], more].concat());
        assert!(output.status.success());
        let text = stdout(&output);
        text.lines().find(|l| l.contains("voxels of")).unwrap().to_string()
    };
    assert_eq!(forecast(&["--quality", "default"]), forecast(&[]));
    assert_ne!(forecast(&["--quality", "preview"]), forecast(&[]));
    assert_eq!(forecast(&["--quality", "high", "--grid", "64"]), forecast(&[]));
    let out = folder.path().join("out");
    for wrong in [
        &["--quality", "high", "--budget", "5s"][..],
        &["--target-error", "1%", "--no-estimate"],
        &["--target-error", "0"],
        &["--budget", "5"],
        &["--quality", "best"],
    ] {
        let output = luxel(&[&["bake", scene, "-o", out.to_str().unwrap()], wrong].concat());
        assert_eq!(output.status.code(), Some(2), "{wrong:?}");
    }
}

#[test]
fn an_option_that_nothing_would_use_is_refused() {
    let (folder, scene) = room();
    let out = folder.path().join("out");
    for (options, said) in [
        (&["--target-patches", "99"][..], "--target-patches is for --patches decimated or clustered"),
        (&["--face-colour", "literal", "--patches", "decimated"], "--face-colour is for --patches faces"),
        (&["--gather-rays", "64"], "--gather-rays is for --reconstruct gather or adaptive"),
    ] {
        let refused = bake(&scene, &out, options);
        assert_eq!(refused.status.code(), Some(1));
        assert!(stderr(&refused).contains(said), "{}", stderr(&refused));
    }
    let used = bake(&scene, &out, &["--reconstruct", "gather", "--gather-rays", "16", "--no-preview"]);
    assert!(used.status.success(), "{}", stderr(&used));
}

#[test]
fn the_selftest_passes_and_writes_its_table() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("selftest.json");
    let output = luxel(&["selftest", "--backend", "auto", "--json", file.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", stdout(&output));
    let table: serde_json::Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    let rows = table["rows"].as_array().unwrap();
    assert!(rows.len() > 40);
    for row in rows {
        assert_eq!(row["backend"], "auto");
        assert_ne!(row["verdict"], "fail", "{row}");
        assert!(stdout(&output).contains(row["case"].as_str().unwrap()));
    }
    for case in ["parallel", "upright", "5.3", "5.4", "5.6", "5.8", "furnace", "sphere", "trap", "reciprocity"] {
        assert!(rows.iter().any(|row| row["case"].as_str().unwrap().contains(case)), "no case {case}");
    }
}

#[test]
fn a_bench_writes_tables_and_a_plot_and_keeps_its_reference() {
    let (folder, scene) = room();
    let out = folder.path().join("bench");
    let paths = ["bench", scene.to_str().unwrap(), "-o", out.to_str().unwrap()];
    let few = ["--places", "40", "--job", "40", "--repeats", "1", "--stderr", "5%"];
    let run = |more: &[&str]| luxel(&[&paths[..], &few[..], more].concat());
    let output = run(&[]);
    assert!(output.status.success(), "{}", stderr(&output));
    let table = fs::read_to_string(out.join("bench.md")).unwrap();
    assert!(stdout(&output).contains("## room") && table.contains("| * |"), "{table}");
    assert!(table.contains("threads, luxel ") && table.contains("(room.svg)"), "{table}");
    let csv = fs::read_to_string(out.join("bench.csv")).unwrap();
    let rows: Vec<Vec<&str>> = csv.lines().map(|line| line.split(',').collect()).collect();
    assert!(rows.iter().all(|row| row.len() == rows[0].len()), "{csv}");
    let column = |name: &str| rows[0].iter().position(|c| *c == name).unwrap();
    for method in ["bake", "paths"] {
        assert!(rows.iter().any(|row| row[column("method")] == method), "{csv}");
    }
    for row in &rows[1..] {
        assert!(row[column("seconds")].parse::<f64>().unwrap() > 0.0, "{row:?}");
        assert!(row[column("total_rmse")].parse::<f64>().unwrap().is_finite(), "{row:?}");
    }
    let svg = fs::read_to_string(out.join("room.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("Pareto front") && svg.contains("path tracing"));
    let reference = names(&out).into_iter().find(|name| name.starts_with("reference-")).unwrap();
    let written = fs::metadata(out.join(&reference)).unwrap().modified().unwrap();

    // Nothing is baked in no time.
    let output = run(&["--limit", "1e-9"]);
    assert!(output.status.success() && stdout(&output).contains("Left out"), "{}", stdout(&output));
    assert_eq!(fs::metadata(out.join(&reference)).unwrap().modified().unwrap(), written);
    assert_eq!(names(&out).len(), 4);
}

#[test]
fn a_suite_that_is_not_there_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = folder.path().to_str().unwrap();
    let output = luxel(&["bench", "--suite", "-o", nowhere, "--scenes", nowhere, "--shared", nowhere]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("cornell.toml") && stderr(&output).contains("--scenes"), "{}", stderr(&output));
}
