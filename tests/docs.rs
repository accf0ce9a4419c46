//! What the Markdown files say is there, is there.

#[path = "common/command.rs"]
mod command;

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use command::{luxel, scene, stderr, stdout, text};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn documents() -> Vec<PathBuf> {
    let folders = [root().to_path_buf(), root().join("docs")];
    let entries = folders.iter().flat_map(|folder| fs::read_dir(folder).unwrap());
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|e| e == "md"));
    files.sort();
    files
}

/// Targets of the links `[text](target)` in a text.
fn links(text: &str) -> impl Iterator<Item = &str> {
    text.split("](").skip(1).filter_map(|rest| rest.split_once(')')).map(|(target, _)| target)
}

/// The anchor that a heading gets: lower case, blanks to hyphens, other signs left out.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.collect::<String>().to_lowercase().replace(' ', "-")
}

fn anchors(text: &str) -> BTreeSet<String> {
    text.lines().filter(|line| line.starts_with('#')).map(|line| anchor(line.trim_start_matches('#'))).collect()
}

#[test]
fn links_between_files_lead_somewhere() {
    let mut seen = 0;
    for document in documents() {
        let text = fs::read_to_string(&document).unwrap();
        for link in links(&text).filter(|link| !link.contains("://")) {
            let (file, section) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { document.clone() } else { document.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: no file {link}", document.display());
            if !section.is_empty() {
                let text = fs::read_to_string(&target).unwrap();
                assert!(anchors(&text).contains(section), "{}: no section {link}", document.display());
            }
            seen += 1;
        }
    }
    assert!(seen > 40, "only {seen} links found");
}

/// Words like `--grid` in a text.
fn options(text: &str) -> BTreeSet<&str> {
    let word = |c: char| c.is_ascii_alphanumeric() || c == '-';
    let candidates = text.split(|c: char| !word(c)).filter(|w| w.starts_with("--"));
    candidates.filter(|w| w[2..].starts_with(|c: char| c.is_ascii_lowercase())).collect()
}

fn help(command: &str) -> String {
    stdout(&luxel(&command.split_whitespace().chain(["--help"]).collect::<Vec<_>>()))
}

/// Options of cargo, schedulers and their kin that the documents speak of.
const FOREIGN: [&str; 25] = [
    "--all-targets",
    "--bench",
    "--example",
    "--features",
    "--lib",
    "--no-default-features",
    "--no-deps",
    "--nocapture",
    "--plot",
    "--open",
    "--release",
    "--check",
    "--test",
    "--array",
    "--cpus-per-task",
    "--init",
    "--joblog",
    "--jobs",
    "--mem",
    "--partition",
    "--requeue",
    "--retries",
    "--rm",
    "--sshlogin",
    "--termseq",
];

const COMMANDS: [&str; 14] = [
    "bake",
    "prepare",
    "relight",
    "farm plan",
    "farm shard",
    "farm status",
    "farm merge",
    "farm submit",
    "points",
    "check",
    "reference",
    "compare",
    "selftest",
    "bench",
];

#[test]
fn every_option_that_the_documents_name_exists() {
    let texts = COMMANDS.map(help);
    let known: BTreeSet<&str> = texts.iter().flat_map(|text| options(text)).chain(FOREIGN).collect();
    for document in documents() {
        let text = fs::read_to_string(&document).unwrap();
        for option in options(&text) {
            assert!(known.contains(option), "{}: luxel has no option {option}", document.display());
        }
    }
}

#[test]
fn the_readme_names_every_option() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let named = options(&readme);
    for command in COMMANDS {
        for option in options(&help(command)).into_iter().filter(|option| *option != "--help") {
            assert!(named.contains(option), "README.md leaves out {option} of luxel {command}");
        }
    }
}

const BAKING: [&str; 8] = ["bake", "prepare", "relight", "farm plan", "farm shard", "farm merge", "points", "check"];

/// Groups of options, and which of these commands have them, as the README says.
const GROUPS: [(&str, &[&str]); 5] = [
    ("goal", &["bake", "points"]),
    ("pictures", &["bake", "relight", "farm merge"]),
    ("settings", &["bake", "prepare", "farm plan", "points", "check"]),
    ("light", &["bake", "prepare", "relight", "farm plan", "points", "check"]),
    ("running", &BAKING),
];

#[test]
fn a_command_has_all_options_of_its_groups_and_none_of_the_others() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    for (group, having) in GROUPS {
        let (_, rows) = readme.split_once(&format!("\n| {group} | `")).expect(group);
        let own = rows.lines().enumerate().take_while(|(n, line)| *n == 0 || line.starts_with("| | "));
        let names = own.map(|(_, line)| line.trim_start_matches("| | `").split('|').next().unwrap());
        let text: Vec<&str> = names.collect();
        let text = text.join(" ");
        let named = options(&text);
        assert!(named.len() > 1, "{group}: {text}");
        for command in BAKING {
            let help = help(command);
            let there = options(&help);
            for option in &named {
                assert_eq!(there.contains(option), having.contains(&command), "{option} of luxel {command}");
            }
        }
    }
}

#[test]
fn the_help_says_what_is_written_as_the_readme_does() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let (mut command, mut seen) = ("", 0);
    for line in readme.lines().filter(|line| line.starts_with("| ")) {
        let line = line.trim_start_matches("| ");
        command = line.split(" | ").next().filter(|first| !first.starts_with(['|', '`'])).unwrap_or(command);
        let Some((_, place)) = line.split_once("`--output ") else { continue };
        let place = place.split('`').next().unwrap().replace('\\', "");
        assert!(help(command).contains(&format!("--output <{place}>")), "luxel {command}: --output {place}");
        seen += 1;
    }
    assert!(seen >= 9, "only {seen} commands found");
}

#[test]
fn every_subcommand_and_scene_that_the_readme_uses_exists() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let commands = help("");
    let mut seen = 0;
    for line in readme.lines().filter_map(|line| line.split_once("luxel ").filter(|(before, _)| before.ends_with('/')))
    {
        let words: Vec<&str> = line.1.split_whitespace().collect();
        assert!(commands.lines().any(|l| l.trim_start().starts_with(words[0])), "no subcommand {}", words[0]);
        for file in words.iter().filter(|word| word.starts_with("scenes/")) {
            assert!(root().join(file).is_file(), "README.md: no scene {file}");
        }
        seen += 1;
    }
    assert!(seen >= 3, "only {seen} command lines found");
}

#[test]
fn the_pipeline_names_the_stages_of_the_report() {
    let readme = fs::read_to_string(root().join("README.md")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let scene = scene("furnace_box.toml");
    let quick = ["bake", "--grid", "4", "--preview-size", "16x12", "--quiet"];
    let bake = luxel(&[&quick[..], &[text(&scene), "-o", text(folder.path())]].concat());
    assert!(bake.status.success(), "{}", stderr(&bake));
    let report = fs::read_to_string(folder.path().join("bake.json")).unwrap();
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    let mut at = 0;
    for stage in report["stages"].as_array().unwrap() {
        let name = format!("**{}**", stage["name"].as_str().unwrap());
        at += readme[at..].find(&name).unwrap_or_else(|| panic!("README.md: no stage {name} in its place"));
    }
    // And every file that was written stands in the table of outputs.
    for entry in fs::read_dir(folder.path()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(readme.contains(&format!("`{name}`")), "README.md leaves out {name}");
    }
}

#[test]
fn the_shard_numbers_of_schedulers_are_those_that_the_document_derives_from_their_variables() {
    let text = fs::read_to_string(root().join("docs/FARM.md")).unwrap();
    let mut seen = 0;
    // Rows `| scheduler | array | `expression` |`.
    for line in text.lines().filter(|line| line.starts_with("| ")) {
        let Some(expression) = line.strip_suffix("` |").and_then(|line| line.rsplit_once("| `")).map(|(_, e)| e) else {
            continue;
        };
        if !expression.starts_with('$') {
            continue;
        }
        let word = |c: char| c.is_ascii_uppercase() || c == '_';
        let variable = expression.split(|c| !word(c)).find(|w| !w.is_empty()).unwrap();
        let counts_from_one = line.contains("1-16");
        let shell = Command::new("sh").args(["-c", &format!("echo {expression}")]).env(variable, "8").output().unwrap();
        let number = String::from_utf8(shell.stdout).unwrap();
        assert_eq!(number.trim(), if counts_from_one { "7" } else { "8" }, "{line}");
        seen += 1;
    }
    assert!(seen >= 8, "only {seen} schedulers found");
}
