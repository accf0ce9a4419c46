//! Relighting and the cache, as a user meets them: the same files as a bake with those lights, and no form-factor ray.

#[path = "common/command.rs"]
mod command;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use command::{LUXEL, assert_same_results, luxel, results, text};
use tempfile::TempDir;

/// A room of 2 x 2 x 2 that is open on one side, with a lamp, a column, and a floor of a chequered texture.
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
v 0.2 -1 0.1
v 0.5 -1 0.1
v 0.5 0.2 0.1
v 0.2 0.2 0.1
vt 0 0
vt 1 0
vt 1 1
vt 0 1
o walls
usemtl wall
f 5 6 7 8
f 1 2 6 5
f 2 3 7 6
f 4 1 5 8
o floor
usemtl floor
f 4/1 3/2 2/3 1/4
o lamp
usemtl lamp
f 9 10 11 12
o screen
usemtl wall
f 13 14 15 16
";
const ROOM_MTL: &str = "\
newmtl wall
Kd 0.5 0.4 0.3
newmtl floor
Kd 1 1 1
map_Kd chequers.png
newmtl lamp
Kd 0.1 0.1 0.1
Ke 5 5 5
";
/// Settings that bake the room in a moment.
const QUICK: [&str; 10] =
    ["--grid", "7", "--rays", "64", "--point-samples", "4", "--patch-samples", "4", "--sides", "two"];
const PICTURE: [&str; 2] = ["--preview-size", "16x12"];

fn room() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("room.obj"), ROOM_OBJ).unwrap();
    fs::write(folder.path().join("room.mtl"), ROOM_MTL).unwrap();
    let chequers = image::RgbImage::from_fn(4, 4, |x, y| image::Rgb([if (x + y) % 2 == 0 { 220 } else { 40 }; 3]));
    chequers.save(folder.path().join("chequers.png")).unwrap();
    let scene = folder.path().join("room.obj");
    (folder, scene)
}

fn done(args: &[&str]) -> String {
    let output = luxel(args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn failed(args: &[&str]) -> String {
    let output = luxel(args);
    assert_eq!(output.status.code(), Some(1), "{args:?}: {}", String::from_utf8_lossy(&output.stdout));
    let message = String::from_utf8(output.stderr).unwrap();
    let told: Vec<&str> = message.lines().filter(|line| line.starts_with("luxel: ")).collect();
    assert!(told.len() == 1 && !message.contains("panicked"), "{message}");
    told[0].into()
}

fn report(folder: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(folder.join("bake.json")).unwrap()).unwrap()
}

/// Bakes `scene` with all options, and relights what was prepared without the lights: the same files without a ray.
fn relit_as_baked(scene: &Path, settings: &[&str], lights: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let [baked, relit, file] = ["baked", "relit", "some.lxt"].map(|name| folder.path().join(name));
    done(&[&["bake", text(scene), "-o", text(&baked)], settings, lights, &PICTURE].concat());
    done(&[&["prepare", text(scene), "-o", text(&file)], settings].concat());
    done(&[&["relight", text(&file), "-o", text(&relit)], lights, &PICTURE].concat());
    assert_same_results(&baked, &relit);
    let (before, after) = (report(&baked), report(&relit));
    assert!(before["rays"]["form_factors"].as_u64().unwrap() > 0);
    assert!(before["rows"]["cast"].as_u64().unwrap() >= before["rows"]["used"].as_u64().unwrap());
    assert_eq!(after["rays"]["form_factors"], 0);
    assert_eq!(after["rows"]["cast"], 0);
    assert_eq!(after["rows"]["from"], text(&file));
    assert_eq!(after["settings"], before["settings"]);
}

#[test]
fn a_relit_room_is_the_baked_one_byte_for_byte() {
    let (_folder, scene) = room();
    let other = ["--emit", "lamp=1,2,3", "--albedo", "wall=0.1,0.8,0.2", "--point", "-0.5,0.5,-0.5:1,1,1"];
    relit_as_baked(&scene, &QUICK, &other);
    relit_as_baked(&scene, &QUICK, &["--sky", "0.2,0.3,0.5", "--sun", "-0.3,-1,-0.5:3,3,2.5"]);
    // Nothing but a lamp behind the screen: most patches see no light of it at first.
    relit_as_baked(&scene, &QUICK, &["--emit", "lamp=0,0,0", "--point", "0.35,-0.9,0.05:1,1,1"]);
}

#[test]
fn so_it_is_with_every_way_to_bake() {
    let (_folder, scene) = room();
    let lights = ["--sky", "0.1,0.1,0.2", "--emit", "lamp=3,1,1"];
    for more in [
        &["--primary", "radiosity"] as &[&str],
        &["--only", "floor"],
        &["--no-skip"],
        &["--patches", "faces"],
        &["--patches", "decimated"],
        &["--reconstruct", "adaptive", "--gather-rays", "16"],
        &["--reconstruct", "nearest4", "--no-estimate"],
        &["--backend", "bvh", "--seed", "7", "--sides", "auto"],
    ] {
        let mut settings = QUICK.to_vec();
        if more.contains(&"--sides") {
            settings.truncate(8);
        }
        relit_as_baked(&scene, &[&settings, more].concat(), &lights);
    }
}

#[test]
fn a_relit_cornell_box_is_the_baked_one() {
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cornell.toml");
    relit_as_baked(
        &scene,
        &["--grid", "12", "--rays", "64", "--point-samples", "4"],
        &["--albedo", "white=0.3,0.5,0.7"],
    );
}

#[test]
fn lights_of_the_file_stay_or_give_way() {
    let (folder, scene) = room();
    let [file, baked, relit] = ["some.lxt", "baked", "relit"].map(|name| folder.path().join(name));
    done(&[&["prepare", text(&scene), "-o", text(&file), "--sky", "1,0,0"], &QUICK[..]].concat());
    done(&[&["bake", text(&scene), "-o", text(&baked), "--sky", "0,1,0", "--no-preview"], &QUICK[..]].concat());
    done(&["relight", text(&file), "-o", text(&relit), "--sky", "0,1,0", "--replace-lights", "--no-preview"]);
    assert_same_results(&baked, &relit);
    done(&["relight", text(&file), "-o", text(&relit), "--sky", "0,1,0", "--no-preview"]);
    assert!(results(&baked) != results(&relit));
}

#[test]
fn what_cannot_be_relit_says_why() {
    let (folder, scene) = room();
    let [file, out] = ["some.lxt", "out"].map(|name| folder.path().join(name));
    let prepare = [&["prepare", text(&scene), "-o", text(&file)], &QUICK[..]].concat();
    done(&prepare);
    let relight = ["relight", text(&file), "-o", text(&out), "--no-preview"];
    let with = |more: &[&str]| failed(&[&relight, more].concat());

    assert!(with(&["--albedo", "wool=1,1,1"]).contains("there is no material \"wool\""));
    assert!(with(&["--emit", "lamp=0,0,0"]).contains("has no light"));
    let whole = fs::read(&file).unwrap();
    let cases: [(&str, Vec<u8>); 4] = [
        ("some.lxt: is cut off or damaged at its end", whole[..whole.len() / 2].to_vec()),
        ("some.lxt: block ", {
            let mut bytes = whole.clone();
            bytes[whole.len() / 2] ^= 1;
            bytes
        }),
        ("some.lxt: is no file of luxel's own", fs::read(&scene).unwrap()),
        ("some.lxt: has format 9, but this luxel reads format 1", {
            let mut bytes = whole.clone();
            bytes[8] = 9;
            bytes
        }),
    ];
    for (expected, bytes) in cases {
        fs::write(&file, bytes).unwrap();
        let message = with(&[]);
        assert!(message.contains(expected), "{message}");
        assert!(!out.exists(), "{message}");
    }
    assert!(failed(&["relight", "/nowhere.lxt", "-o", text(&out)]).contains("/nowhere.lxt: "));
    assert!(failed(&["prepare", text(&scene), "-o", text(folder.path())]).contains("is a folder"));
}

#[test]
fn lights_that_turn_a_solid_into_a_room_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/cube.obj");
    let [file, out] = ["cube.lxt", "out"].map(|name| folder.path().join(name));
    done(&["prepare", text(&scene), "-o", text(&file), "--grid", "4", "--rays", "16"]);
    let inside = failed(&["relight", text(&file), "-o", text(&out), "--point", "0.5,0.5,0.5:1,1,1"]);
    assert!(inside.contains("have other sides than those that were prepared"), "{inside}");
}

#[test]
fn the_cache_serves_other_lights_and_no_other_geometry() {
    let (folder, scene) = room();
    let [plain, cached, cache] = ["plain", "cached", "cache"].map(|name| folder.path().join(name));
    let cast = |lights: &[&str]| {
        let common = [&["--no-preview"], &QUICK[..], lights].concat();
        done(&[&["bake", text(&scene), "-o", text(&plain)], &common[..]].concat());
        let told = done(&[&["bake", text(&scene), "-o", text(&cached), "--cache", text(&cache)], &common[..]].concat());
        assert_same_results(&plain, &cached);
        let report = report(&cached);
        assert_eq!(report["rows"]["kept_in"].is_string(), told.contains(" cast now and kept in "));
        assert_eq!(report["warnings"], self::report(&plain)["warnings"]);
        (report["rows"]["cast"].as_u64().unwrap(), report["rows"]["from"].is_string(), told.contains("used, all from "))
    };
    let first = cast(&["--sky", "1,1,1"]);
    assert!(first.0 > 100 && !first.1 && !first.2, "{first:?}");
    assert_eq!(cast(&["--albedo", "wall=0.9,0.9,0.9"]), (0, true, true));
    assert_eq!(cast(&["--emit", "lamp=9,0,0"]), (0, true, true));
    // Another seed, other rows; the old ones stay.
    assert!(!cast(&["--seed", "3"]).1);
    assert_eq!(cast(&["--seed", "3"]), (0, true, true));
    assert_eq!(fs::read_dir(&cache).unwrap().count(), 2);
    // Another shape, other rows.
    fs::write(&scene, ROOM_OBJ.replace("v 0.2 0.2 0.1", "v 0.2 0.3 0.1")).unwrap();
    assert!(!cast(&[]).1);
    assert_eq!(fs::read_dir(&cache).unwrap().count(), 3);
}

#[test]
fn a_cached_bake_tells_the_same_error_and_casts_no_row_to_know_it() {
    let (folder, scene) = room();
    let [plain, cached, cache] = ["plain", "cached", "cache"].map(|name| folder.path().join(name));
    let bake = |out: &Path, more: &[&str]| {
        done(&[&["bake", text(&scene), "-o", text(out), "--no-preview"], &QUICK[..], more].concat());
        let report = report(out);
        assert!(report["error"]["indirect"]["row_noise"].as_f64().unwrap() > 0.0);
        (report["error"].clone(), report["rays"]["form_factors"].as_u64().unwrap())
    };
    // A file that is replaced is another one.
    let entry = || {
        let files: Vec<_> = fs::read_dir(&cache).unwrap().map(|entry| entry.unwrap().metadata().unwrap()).collect();
        assert_eq!(files.len(), 1);
        std::os::unix::fs::MetadataExt::ino(&files[0])
    };
    let with = ["--cache", text(&cache)];
    let (error, rays) = bake(&plain, &[]);
    assert_eq!(bake(&cached, &with), (error.clone(), rays));
    let before = entry();
    assert_eq!(bake(&cached, &with), (error, 0));
    // Rows of any kind that are cast are kept, which writes the file anew.
    assert_eq!(entry(), before);
    // A bake without an estimate keeps none of other rays: the next one adds them.
    fs::remove_dir_all(&cache).unwrap();
    done(&[&["bake", text(&scene), "-o", text(&cached), "--no-preview", "--no-estimate"], &QUICK[..], &with].concat());
    let before = entry();
    assert_eq!(bake(&cached, &with).1, 0);
    assert_ne!(entry(), before);
}

#[test]
fn rows_that_new_light_needs_are_added_to_the_cache() {
    // A wall parts two halves; a light in one leaves the other dark.
    let folder = tempfile::tempdir().unwrap();
    let scene = Path::new(env!("CARGO_MANIFEST_DIR")).join("scenes/furnace_box.toml");
    let two = folder.path().join("two.toml");
    let mesh =
        |x: f64| format!("[[mesh]]\npath = \"{}\"\ntranslate = [{x}, 0, 0]\n", text(&scene.with_file_name("cube.obj")));
    fs::write(&two, mesh(0.0) + &mesh(5.0)).unwrap();
    let [out, cache] = ["out", "cache"].map(|name| folder.path().join(name));
    let cast = |lights: &[&str]| {
        let settings = ["--grid", "12", "--rays", "16", "--sides", "two", "--no-preview", "--cache", text(&cache)];
        done(&[&["bake", text(&two), "-o", text(&out)], &settings[..], lights].concat());
        report(&out)["rows"]["cast"].as_u64().unwrap()
    };
    let [left, right] = ["0.5,0.5,0.5:1,1,1", "5.5,0.5,0.5:1,1,1"];
    let first = cast(&["--point", left]);
    let second = cast(&["--point", right]);
    assert!(first > 0 && second > 0, "{first} {second}");
    assert_eq!(cast(&["--point", left, "--point", right]), 0);
}

#[test]
fn a_damaged_cache_is_a_warning_and_mends_itself() {
    let (folder, scene) = room();
    let [out, cache] = ["out", "cache"].map(|name| folder.path().join(name));
    let bake =
        [&["bake", text(&scene), "-o", text(&out), "--no-preview", "--cache", text(&cache)], &QUICK[..]].concat();
    done(&bake);
    let good = results(&out);
    let entry = fs::read_dir(&cache).unwrap().next().unwrap().unwrap().path();
    let whole = fs::read(&entry).unwrap();
    for damage in [&whole[..whole.len() / 3], b"", &[&whole[..999], b"?", &whole[1000..]].concat()] {
        fs::write(&entry, damage).unwrap();
        let told = done(&bake);
        assert!(told.contains("cannot be used, and are cast anew"), "{told}");
        let report = report(&out);
        assert!(report["rows"]["cast"].as_u64().unwrap() > 100 && report["rows"]["from"].is_null());
        assert_eq!(results(&out), good);
        assert!(fs::read(&entry).unwrap() == whole);
    }
    assert_eq!(fs::read_dir(&cache).unwrap().count(), 1);
}

#[test]
fn two_bakes_may_fill_one_cache_at_once() {
    let (folder, scene) = room();
    let cache = folder.path().join("cache");
    let bake = |name: &str| {
        let out = folder.path().join(name);
        let args = [&["bake", text(&scene), "-o", text(&out), "--no-preview", "--cache", text(&cache)], &QUICK[..]];
        Command::new(LUXEL).args(args.concat()).arg("-q").spawn().unwrap()
    };
    let names = ["a", "b", "c"];
    for mut child in names.map(bake) {
        assert!(child.wait().unwrap().success());
    }
    assert_same_results(&folder.path().join("a"), &folder.path().join("b"));
    assert_same_results(&folder.path().join("a"), &folder.path().join("c"));
    assert_eq!(fs::read_dir(&cache).unwrap().count(), 1);
    assert!(bake("d").wait().unwrap().success());
    assert_eq!(report(&folder.path().join("d"))["rows"]["cast"], 0);
}

#[test]
fn an_orbit_gives_pictures_of_a_light_that_goes_round() {
    let (folder, scene) = room();
    let [file, relit, out] = ["some.lxt", "relit", "out"].map(|name| folder.path().join(name));
    // The sky comes first, and does not go round.
    done(&[&["prepare", text(&scene), "-o", text(&file), "--sky", "0.1,0.1,0.2"], &QUICK[..]].concat());
    let camera = ["--exposure", "0.1", "--camera", "0,0,4:0,0,0"];
    done(&[&["relight", text(&file), "-o", text(&relit)], &PICTURE[..], &camera].concat());
    let orbit = ["relight", text(&file), "-o", text(&out), "--orbit", "2"];
    // From 0.4 right of the middle to 0.6 left of it.
    done(&[&orbit, &PICTURE[..], &camera, &["--orbit-centre", "-0.1,0,0", "--orbit-radius", "0.5"]].concat());
    assert_eq!(command::names(&out), ["orbit-0000.exr", "orbit-0000.png", "orbit-0001.exr", "orbit-0001.png"]);
    let left = |name: &str| {
        let picture = image::open(out.join(name)).unwrap().to_luma8();
        let sum = |of: &dyn Fn(u32) -> bool| -> u64 {
            picture.enumerate_pixels().filter(|(x, ..)| of(*x)).map(|(.., value)| value[0] as u64).sum()
        };
        sum(&|x| x < 8) as f64 / sum(&|_| true) as f64
    };
    let [first, second] = ["orbit-0000.png", "orbit-0001.png"].map(left);
    assert!(first < 0.5 && second > 0.5, "{first} {second}");
}

#[test]
fn an_orbit_that_cannot_be_made_is_refused_before_the_bake() {
    let (folder, scene) = room();
    let [file, faces, out] = ["some.lxt", "faces.lxt", "out"].map(|name| folder.path().join(name));
    done(&[&["prepare", text(&scene), "-o", text(&file)], &QUICK[..]].concat());
    done(&[&["prepare", text(&scene), "-o", text(&faces), "--patches", "faces"], &QUICK[..]].concat());
    let dark = ["--emit", "lamp=0,0,0"];
    for (file, more, told) in [
        (
            &file,
            &["--orbit-light", "moon"] as &[&str],
            "there is no light \"moon\" to go round; there are: material \"lamp\"",
        ),
        (&file, &["--orbit-light", "1"], "there is no light \"1\" to go round"),
        (&file, &["--sky", "1,1,1", "--orbit-light", "0"], "skies do not go round; there are: light 0 (sky), "),
        (&file, &[dark[0], dark[1], "--sky", "1,1,1"], "skies do not go round"),
        (&file, &dark, "has no light"),
        (&faces, &[], "--patches surfels"),
    ] {
        let asked = [&["relight", text(file), "-o", text(&out), "--orbit", "2", "--json-progress"], more].concat();
        let output = luxel(&asked);
        let [said, told_wrong] = [command::stdout(&output), command::stderr(&output)];
        assert_eq!(output.status.code(), Some(1), "{more:?}: {said}");
        assert!(told_wrong.contains(told), "{more:?}: {told_wrong}");
        // Its first stage is the light of the patches.
        assert!(!said.contains("direct light"), "{more:?}: {said}");
        assert!(!out.exists(), "{more:?}");
    }
}

#[test]
fn an_orbit_without_pictures_is_no_order() {
    let output = luxel(&["relight", "some.lxt", "-o", "out", "--orbit", "2", "--no-preview"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(command::stderr(&output).contains("cannot be used with"));
}

#[test]
fn points_take_rows_from_the_cache_and_keep_new_ones_there() {
    let (folder, scene) = room();
    let [at, plain, cached, cache] =
        ["at.txt", "plain.csv", "cached.csv", "cache"].map(|name| folder.path().join(name));
    fs::write(&at, "0 -1 0  0 1 0\n0.9 0 0.3  -1 0 0\n").unwrap();
    let ask = |output: &Path, more: &[&str]| {
        done(&[&["points", text(&scene), "--at", text(&at), "-o", text(output)], &QUICK[..], more].concat())
    };
    ask(&plain, &[]);
    let with = ["--cache", text(&cache)];
    let first = ask(&cached, &with);
    assert!(first.contains("used, all cast now and kept in "), "{first}");
    assert!(fs::read(&cached).unwrap() == fs::read(&plain).unwrap());
    let second = ask(&cached, &with);
    assert!(second.contains("used, all from ") && second.contains("no ray traced"), "{second}");
    assert!(fs::read(&cached).unwrap() == fs::read(&plain).unwrap());
    // Bakes and points share what is there.
    let out = folder.path().join("out");
    done(&[&["bake", text(&scene), "-o", text(&out), "--no-preview"], &QUICK[..], &with].concat());
    assert_eq!(report(&out)["rows"]["cast"], 0);
    // Other light is other light.
    ask(&cached, &["--cache", text(&cache), "--emit", "lamp=1,1,9"]);
    assert!(fs::read(&cached).unwrap() != fs::read(&plain).unwrap());
}
