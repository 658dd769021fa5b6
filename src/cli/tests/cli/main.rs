//! The `reel` command from outside: the loop a newcomer goes through, and the exit
//! codes scripts rely on.

/// Standard output of a command that must succeed: a folder, and its arguments as one text.
macro_rules! reel {
    ($folder:expr, $arguments:literal) => {
        $crate::expect($folder, 0, &format!($arguments))
    };
}

#[cfg(feature = "service")]
mod agent_tests;
#[cfg(feature = "service")]
mod agents;
#[cfg(feature = "analytics")]
mod agreement;
#[cfg(feature = "service")]
mod annotation;
#[cfg(feature = "analytics")]
mod atif;
mod attribution;
#[cfg(feature = "analytics")]
mod bisect;
mod blame;
mod branches;
#[cfg(feature = "service")]
mod bundles;
#[cfg(feature = "analytics")]
mod claims;
#[cfg(feature = "cluster")]
mod cluster;
mod counterfactuals;
#[cfg(feature = "service")]
mod endpoint;
#[cfg(feature = "analytics")]
mod examples;
mod films;
#[cfg(feature = "analytics")]
mod fuzz;
mod gate;
#[cfg(feature = "analytics")]
mod gspo;
#[cfg(feature = "analytics")]
mod hostile;
mod import;
mod layers;
#[cfg(feature = "analytics")]
mod lerobot;
mod making;
#[cfg(feature = "analytics")]
mod meshes;
mod moments;
#[cfg(all(feature = "analytics", feature = "service"))]
mod moved;
#[cfg(feature = "analytics")]
mod otel;
#[cfg(feature = "analytics")]
mod own_tools;
#[cfg(feature = "analytics")]
mod packs;
mod pages;
mod parts;
#[cfg(feature = "analytics")]
mod publish;
mod real_bench;
#[cfg(feature = "analytics")]
mod real_contract;
mod real_formats;
mod recovery;
#[cfg(all(feature = "analytics", feature = "service"))]
mod remarks;
#[cfg(feature = "service")]
mod replay_server;
mod scene_import;
#[cfg(feature = "service")]
mod server;
#[cfg(feature = "analytics")]
mod service;
#[cfg(feature = "analytics")]
mod sets;
mod settings;
mod social;
#[cfg(feature = "service")]
mod stdio_client;
mod symbols;
#[cfg(feature = "analytics")]
mod tables;
#[cfg(feature = "analytics")]
mod taxonomy;
#[cfg(feature = "analytics")]
mod training;
mod usd_meshes;
#[cfg(feature = "analytics")]
mod user_model;
#[cfg(feature = "analytics")]
mod verdicts;
#[cfg(feature = "analytics")]
mod vocabulary;
mod web;

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// The arguments of a command: one text, in which ` | ` stands before a last argument with spaces,
/// or a list.
trait CommandLine {
    fn list(&self) -> Vec<&str>;
}

impl CommandLine for str {
    fn list(&self) -> Vec<&str> {
        let (words, last) = self.split_once(" | ").unzip();
        let words = words.unwrap_or(self).split_whitespace();
        words.chain(last).collect()
    }
}

impl CommandLine for String {
    fn list(&self) -> Vec<&str> {
        self.as_str().list()
    }
}

impl CommandLine for [&str] {
    fn list(&self) -> Vec<&str> {
        self.to_vec()
    }
}

impl<const N: usize> CommandLine for [&str; N] {
    fn list(&self) -> Vec<&str> {
        self.to_vec()
    }
}

impl CommandLine for Vec<&str> {
    fn list(&self) -> Vec<&str> {
        self.clone()
    }
}

fn reel(folder: &Path, arguments: &(impl CommandLine + ?Sized)) -> Output {
    Command::new(env!("CARGO_BIN_EXE_reel"))
        .current_dir(folder)
        .env_remove("REEL_CONFIG")
        .args(arguments.list())
        .output()
        .expect("the binary starts")
}

/// Standard output of a command that must end with the given exit code.
fn expect(folder: &Path, code: i32, arguments: &(impl CommandLine + ?Sized)) -> String {
    let output = reel(folder, arguments);
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert_eq!(
        output.status.code(),
        Some(code),
        "reel {}\n{out}\n{err}",
        arguments.list().join(" ")
    );
    out.into_owned()
}

/// Standard error of a command that must end with the given exit code.
fn complaint(folder: &Path, code: i32, arguments: &(impl CommandLine + ?Sized)) -> String {
    let output = reel(folder, arguments);
    assert_eq!(
        output.status.code(),
        Some(code),
        "reel {}",
        arguments.list().join(" ")
    );
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn first_trace(folder: &Path) -> PathBuf {
    let mut traces: Vec<PathBuf> = fs::read_dir(folder.join("traces"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    traces.sort();
    traces.remove(0)
}

/// A lean trace in which the wrong object was brought.
fn failed_episode(folder: &Path) -> PathBuf {
    reel!(
        folder,
        "task draw --count 1 --families FDP --seed 4 --out tasks"
    );
    reel!(
        folder,
        "run --tasks tasks --policy wrong-object --out traces --no-images"
    );
    first_trace(folder)
}

#[test]
fn the_loop_end_to_end() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 4 --seed 3 --out tasks");
    assert!(reel!(folder, "task check tasks").contains("4 of 4 tasks load"));
    let run = [
        "run", "--tasks", "tasks", "--out", "traces", "--jobs", "2", "--json",
    ];
    let reports = expect(folder, 0, &run);
    assert_eq!(
        reports
            .lines()
            .filter(|line| line.contains(r#""success":true"#))
            .count(),
        4,
        "{reports}"
    );
    assert!(reel!(folder, "replay traces --jobs 1").starts_with("4 of 4 traces replay exactly"));

    let trace = first_trace(folder);
    let trace_name = trace.to_str().unwrap();
    assert!(reel!(folder, "show {trace_name}").contains("nav_to"));
    assert!(reel!(folder, "trace frames {trace_name} --out images").contains("contact_sheet.png"));

    // The same run again, with one worker and the tasks the other way round, gives the same bytes.
    let before = fs::read(&trace).unwrap();
    reel!(folder, "run --tasks tasks --out traces --jobs 1 --reversed");
    assert!(
        before == fs::read(&trace).unwrap(),
        "a trace depends on workers or order"
    );

    // Without images the trace still gives them: rendered again, the same to the pixel.
    reel!(folder, "run --tasks tasks --out lean --no-images");
    let lean = folder.join("lean").join(trace.file_name().unwrap());
    expect(
        folder,
        0,
        &["trace", "frames", lean.to_str().unwrap(), "--out", "again"],
    );
    assert_eq!(
        fs::read(folder.join("images/call_000.png")).unwrap(),
        fs::read(folder.join("again/call_000.png")).unwrap()
    );
}

#[test]
fn exit_codes_and_complaints() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let missing = complaint(folder, 2, "replay nowhere");
    assert!(
        missing.contains("no such trace or folder: nowhere"),
        "{missing}"
    );
    let policy = complaint(folder, 2, "run --tasks tasks --policy clever");
    assert!(
        policy.contains("no policy is called 'clever'") && policy.contains("oscillating"),
        "{policy}"
    );

    reel!(folder, "task draw --count 1 --families FDP --out tasks");
    fs::write(
        folder.join("tasks/broken.yaml"),
        "scene_id: home\nepisodes: 3\n",
    )
    .unwrap();
    expect(folder, 1, "task check tasks");
    // One broken file is named, the rest is played: done, but with something left out.
    let run = complaint(folder, 3, "run --tasks tasks --out traces");
    assert!(run.contains("broken.yaml"), "{run}");

    let trace = first_trace(folder);
    let mut bytes = fs::read(&trace).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&trace, bytes).unwrap();
    let verdict = expect(folder, 1, &["replay", trace.to_str().unwrap(), "--json"]);
    assert!(verdict.contains(r#""verdict":"refused""#), "{verdict}");
}

#[cfg(feature = "analytics")]
#[test]
fn tables_questions_and_training_rows() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 4 --seed 3 --out tasks");
    for policy in ["oracle", "wrong-object"] {
        reel!(folder, "run --tasks tasks --policy {policy} --out traces");
    }
    assert!(reel!(folder, "ingest traces --store store").starts_with("8 added"));
    assert!(
        reel!(folder, "ingest traces --store store")
            .starts_with("0 added, 0 replaced, 8 unchanged")
    );
    let count = expect(
        folder,
        0,
        "query --store store --format csv | SELECT count(*) AS n FROM episodes",
    );
    assert_eq!(count.trim(), "n\n8");
    for named in ["benchmark", "failures", "oscillations"] {
        reel!(folder, "query --store store --named {named} --format json");
    }
    let refused = complaint(folder, 2, "query --store store | DROP TABLE episodes");
    assert!(!refused.is_empty());

    let report = reel!(
        folder,
        "export sft --store store --out sft --format trl --json"
    );
    let report: serde_json::Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["episodes"], 4, "{report}");
    assert!(
        report["examples"]["train"].as_u64().unwrap() >= 24,
        "{report}"
    );
    let linted = reel!(folder, "dataset lint sft --json");
    let linted: serde_json::Value = serde_json::from_str(&linted).unwrap();
    assert_eq!(linted["rows"], report["examples"]["train"], "{linted}");
    let shown = reel!(folder, "dataset show sft --row 1 --images-out shown");
    assert!(
        shown.contains("Last action:") && shown.contains("next action"),
        "{shown}"
    );
    assert!(folder.join("shown/row-1-1.png").exists());
    let full = complaint(folder, 2, "export sft --store store --out sft");
    assert!(full.contains("not empty"), "{full}");
}

/// The commands that a help lists.
fn commands(help: &str) -> Vec<String> {
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1);
    let name = |line: &str| {
        line.strip_prefix("  ")
            .filter(|line| !line.starts_with(' '))?
            .split(' ')
            .next()
            .map(str::to_owned)
    };
    listed
        .take_while(|line| *line != "Options:")
        .filter_map(name)
        .filter(|name| name != "help")
        .collect()
}

#[test]
fn every_command_shows_an_example() {
    let folder = tempfile::tempdir().unwrap();
    // with whether the group that it belongs to has examples
    let mut open: Vec<(Vec<String>, bool)> = vec![(Vec::new(), false)];
    let mut without = Vec::new();
    while let Some((path, group)) = open.pop() {
        let arguments: Vec<&str> = path.iter().map(String::as_str).chain(["--help"]).collect();
        let help = expect(folder.path(), 0, &arguments);
        let below = commands(&help);
        let shows = help.contains("Example");
        if below.is_empty() && !shows && !group {
            without.push(path.join(" "));
        }
        open.extend(
            below
                .into_iter()
                .map(|name| ([path.as_slice(), &[name]].concat(), shows)),
        );
    }
    assert!(
        without.is_empty(),
        "no example in the help of: {}",
        without.join(", ")
    );
}
