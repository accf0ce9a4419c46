//! `luxel reference` and `luxel compare`, as a user meets them.

#[path = "common/command.rs"]
mod command;

use std::{fs, path::PathBuf};

use command::{luxel, scene, stderr, stdout, text};
use luxel::output::exr::{self, Compression, ExrChannel, ExrImage};
use tempfile::TempDir;

/// A folder with points on the floor of the Cornell box.
fn folder() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let points = folder.path().join("points.txt");
    let lines: String = (0..9).map(|i| format!("{} 0 {} 0 1 0\n", 400 + 50 * (i % 3), 20 + 12 * i)).collect();
    fs::write(&points, lines).unwrap();
    (folder, points)
}

#[test]
fn a_bake_is_compared_with_a_reference() {
    let (folder, points) = folder();
    let (reference, bake) = (folder.path().join("ref.csv"), folder.path().join("bake.csv"));
    let cornell = scene("cornell.toml");
    let output = luxel(&[
        "reference",
        text(&cornell),
        "--at",
        text(&points),
        "-o",
        text(&reference),
        "--stderr",
        "2%",
        "--seed",
        "7",
    ]);
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(stdout(&output).contains("std error"), "{}", stdout(&output));
    let csv = fs::read_to_string(&reference).unwrap();
    let header = csv.lines().next().unwrap();
    assert!(
        header.starts_with("x,y,z,nx,ny,nz,direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b,direct_r_se")
    );
    assert!(header.ends_with("total_r_se,total_g_se,total_b_se,total_luminance_se"));
    assert_eq!(csv.lines().count(), 10);
    assert!(csv.lines().all(|line| line.split(',').count() == 24));

    let output = luxel(&["points", text(&cornell), "--at", text(&points), "-o", text(&bake), "--grid", "16", "-q"]);
    assert!(output.status.success(), "{}", stderr(&output));
    let compare = |more: &[&str]| luxel(&[&["compare", text(&bake), text(&reference)], more].concat());
    let output = compare(&[]);
    assert!(output.status.success(), "{}", stderr(&output));
    for word in ["direct", "indirect", "total", "luminance", "red", "RMSE", "bias", "95 %", "worst 1 %", "noise"] {
        assert!(stdout(&output).contains(word), "{word}: {}", stdout(&output));
    }
    // Grid 16 errs by some per cent, and by more than a thousandth of one.
    let output = compare(&["--max-error", "20%"]);
    assert_eq!(output.status.code(), Some(0), "{}", stdout(&output));
    assert!(stdout(&output).contains("passed"));
    let output = compare(&["--max-error", "0.00001", "--of", "indirect"]);
    // Unless the reference's noise is more than all of the difference.
    let expected = if stdout(&output).contains("error 0.000 %") { 0 } else { 3 };
    assert_eq!(output.status.code(), Some(expected), "{}", stdout(&output));
}

#[test]
fn a_number_of_paths_is_kept_and_gives_the_same_file_on_every_backend_that_is_there() {
    let (folder, points) = folder();
    let run = |backend: &str, name: &str| {
        let out = folder.path().join(name);
        let cornell = scene("cornell.toml");
        let at =
            ["reference", text(&cornell), "--at", text(&points), "-o", text(&out), "--spp", "32", "--backend", backend];
        let output = luxel(&at);
        assert!(output.status.success(), "{}", stderr(&output));
        assert!(stdout(&output).contains("32 a point"), "{}", stdout(&output));
        fs::read_to_string(out).unwrap()
    };
    let bvh = run("bvh", "a.csv");
    assert_eq!(bvh, run("bvh", "b.csv"));
    let compare = |name: &str| luxel(&["compare", text(&folder.path().join(name)), text(&folder.path().join("a.csv"))]);
    assert!(stdout(&compare("b.csv")).contains("< noise"));
    run("brute", "c.csv");
    assert!(compare("c.csv").status.success());
}

#[test]
fn exit_codes_tell_a_difference_from_wrong_input_and_wrong_usage() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, text: &str| {
        let path = folder.path().join(name);
        fs::write(&path, text).unwrap();
        path.to_str().unwrap().to_string()
    };
    let header = "x,y,z,direct_r,direct_g,direct_b,indirect_r,indirect_g,indirect_b\n";
    let a = file("a.csv", &format!("{header}0,0,0,1,1,1,1,1,1\n1,0,0,1,1,1,1,1,1\n"));
    let b = file("b.csv", &format!("{header}0,0,0,1,1,1,1.5,1.5,1.5\n1,0,0,1,1,1,1,1,1\n"));
    // Indirect: sqrt(0.25 / 2) / 1.25 = 28.28 %; total: 0.3536 / 2.25 = 15.71 %; direct: none.
    let code = |of: &str, most: &str| luxel(&["compare", &a, &b, "--of", of, "--max-error", most]).status.code();
    assert_eq!(code("total", "15.8%"), Some(0));
    assert_eq!(code("total", "15.6%"), Some(3));
    assert_eq!(code("indirect", "0.283"), Some(0));
    assert_eq!(code("indirect", "0.282"), Some(3));
    assert_eq!(code("direct", "0.01%"), Some(0));
    let table = stdout(&luxel(&["compare", &a, &b]));
    assert!(table.contains("28.284") && table.contains("15.713") && table.contains("unknown"), "{table}");

    let fails = |args: &[&str], code: i32, message: &str| {
        let output = luxel(args);
        assert_eq!(output.status.code(), Some(code), "{args:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(message), "{args:?}: {}", stderr(&output));
    };
    let only = file("only.csv", "x,y,z,direct_r,direct_g,direct_b\n0,0,0,1,1,1\n1,0,0,1,1,1\n");
    fails(&["compare", &only, &b, "--max-error", "1%"], 1, "no total light in common");
    let nan = file("nan.csv", &format!("{header}0,0,0,1,1,1,1,NaN,1\n1,0,0,1,1,1,1,1,1\n"));
    fails(&["compare", &nan, &b], 1, "nan.csv: point 1: indirect green is NaN");
    let moved = file("moved.csv", &format!("{header}0,0,0,1,1,1,1,1,1\n2,0,0,1,1,1,1,1,1\n"));
    fails(&["compare", &moved, &b], 1, "point 2: lies at [2.0, 0.0, 0.0]");
    let one = file("one.csv", &format!("{header}0,0,0,1,1,1,1,1,1\n"));
    fails(&["compare", &one, &b], 1, "1 points, but");
    fails(&["compare", &file("x.txt", "1"), &b], 1, "a .csv, .ply or .exr file was expected");
    fails(&["compare", "missing.csv", &b], 1, "missing.csv");
    fails(&["compare", &a, &b, "--difference", "d.exr"], 1, "needs two EXR images");
    fails(&["compare", &a, &b, "--max-error", "2"], 2, "was 2% meant?");
    fails(&["compare", &a], 2, "required");
    fails(&["compare", &a, &b, "--of", "sky"], 2, "possible values");
}

#[test]
fn images_are_compared_layer_by_layer_and_their_difference_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let image = |name: &str, layers: &[&str], light: f32| {
        let channels = layers.iter().flat_map(|layer| {
            ["R", "G", "B"].map(|band| ExrChannel {
                name: format!("{layer}{band}"),
                half: false,
                values: vec![light, 1.0, 1.0, 1.0],
            })
        });
        let path = folder.path().join(name);
        let image = ExrImage { width: 2, height: 2, channels: channels.collect(), attributes: vec![] };
        exr::write(&path, &image, Compression::Zip).unwrap();
        path.to_str().unwrap().to_string()
    };
    let preview = ["", "direct.", "secondary.", "combined.", "albedo."];
    let (a, b) = (image("a.exr", &preview, 3.0), image("b.exr", &preview, 1.0));
    let out = folder.path().join("d.exr");
    let output = luxel(&["compare", &a, &b, "--difference", text(&out)]);
    assert!(output.status.success(), "{}", stderr(&output));
    // sqrt(4 / 4) / 1
    assert!(stdout(&output).contains("indirect") && stdout(&output).contains("100.000"), "{}", stdout(&output));
    assert!(!stdout(&output).contains("albedo"));
    let difference = exr::read(&out).unwrap();
    assert_eq!(difference.channels.len(), 9);
    assert_eq!(difference.channels[0].values, [2.0, 0.0, 0.0, 0.0]);
    let out = folder.path().join("d.png");
    let output = luxel(&["compare", &a, &b, "--difference", text(&out)]);
    assert!(output.status.success() && fs::read(&out).unwrap().starts_with(b"\x89PNG"), "{}", stderr(&output));
    let output = luxel(&["compare", &a, &b, "--difference", "d.jpg"]);
    assert_eq!(output.status.code(), Some(1));

    // Images of other programs: all of their colours.
    let (a, b) = (image("c.exr", &["", "view."], 2.0), image("d2.exr", &["", "view."], 1.0));
    let output = luxel(&["compare", &a, &b, "--max-error", "49%"]);
    assert_eq!(output.status.code(), Some(3));
    assert!(stdout(&output).contains("view"));
    let small = folder.path().join("small.exr");
    let channels = ["R", "G", "B"].map(|n| ExrChannel { name: n.into(), half: false, values: vec![1.0] }).to_vec();
    exr::write(&small, &ExrImage { width: 1, height: 1, channels, attributes: vec![] }, Compression::Zip).unwrap();
    let output = luxel(&["compare", text(&small), &b]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("1 x 1 pixels"), "{}", stderr(&output));
}

#[test]
fn vertices_of_two_bakes_are_compared() {
    let folder = tempfile::tempdir().unwrap();
    let bake = |name: &str, rays: &str| {
        let out = folder.path().join(name);
        let furnace = scene("furnace_box.toml");
        let output = luxel(&[
            "bake",
            text(&furnace),
            "-o",
            text(&out),
            "--grid",
            "4",
            "--rays",
            rays,
            "--no-preview",
            "--quiet",
        ]);
        assert!(output.status.success(), "{}", stderr(&output));
        out.join("vertices.ply").to_str().unwrap().to_string()
    };
    let (a, b) = (bake("a", "16"), bake("b", "64"));
    // A furnace is lit alike by any rays.
    let output = luxel(&["compare", &a, &b, "--max-error", "0.1%"]);
    assert_eq!(output.status.code(), Some(0), "{}{}", stdout(&output), stderr(&output));
}

#[test]
fn a_reference_fails_without_leaving_a_file() {
    let (folder, points) = folder();
    let out = folder.path().join("out/ref.csv");
    let cornell = scene("cornell.toml");
    let base = ["reference", text(&cornell), "--at", text(&points), "-o", text(&out)];
    let fails = |more: &[&str], code: i32, message: &str| {
        let output = luxel(&[&base, more].concat());
        assert_eq!(output.status.code(), Some(code), "{more:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(message), "{more:?}: {}", stderr(&output));
        assert!(!out.exists() && !out.parent().unwrap().exists());
    };
    fails(&["--stderr", "0"], 2, "must be above 0");
    fails(&["--stderr", "3"], 2, "was 3% meant?");
    fails(&["--spp", "1"], 2, "--spp");
    fails(&["--grid", "32"], 2, "--grid");
    fails(&["--stderr", "1%", "--spp", "8"], 1, "at least 64");
    // The lamp put out.
    fails(&["--emit", "light=0,0,0"], 1, "has no light");
    let nowhere = folder.path().join("nowhere.txt");
    let output = luxel(&["reference", text(&cornell), "--at", text(&nowhere), "-o", text(&out)]);
    assert_eq!(output.status.code(), Some(1));
    assert!(stderr(&output).contains("nowhere.txt"));
}
