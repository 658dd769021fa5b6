//! `reel bisect`: the first of many commands, builds, presets or commits that flips an episode.

use std::{fs, os::unix::fs::PermissionsExt as _, path::Path, process::Command};

use serde_json::Value;

use crate::{complaint, expect};

const REEL: &str = env!("CARGO_BIN_EXE_reel");

fn found(folder: &Path, code: i32, arguments: &[&str]) -> Value {
    let arguments = [&["bisect", "--json"], arguments].concat();
    serde_json::from_str(&expect(folder, code, &arguments)).unwrap()
}

/// Candidates that play as the oracle up to a version, and then mistake objects.
#[test]
fn checkpoints_are_measured_by_a_command_and_few_of_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task generate --count 3 --seed 7 --out tasks");
    let command = format!(
        r#"case "$CANDIDATE" in step-[1-6]00) AGENT=oracle;; *) AGENT=wrong-object;; esac
        [ "$CANDIDATE" = step-700 ] && exit 9
        {REEL} bench --tasks tasks --agent $AGENT --no-images --out "$OUT""#
    );
    let steps: Vec<String> = (1..=12).map(|step| format!("step-{step}00")).collect();
    // as a shell lists them: step-1000 before step-200
    let mut listed: Vec<&str> = steps.iter().map(String::as_str).collect();
    listed.sort_unstable();
    let ends = [
        "--good",
        "step-100",
        "--bad",
        "step-1200",
        "--run",
        &command,
    ];
    let arguments = [&ends[..], &["--candidates"], &listed].concat();
    let result = found(folder, 1, &arguments);
    assert_eq!(result["paired_episodes"], 3);
    // the one between is broken, so that the first is one of two
    let mean = &result["mean"];
    assert_eq!(
        (&mean["last_good"], &mean["first_bad"]),
        (&"step-600".into(), &"step-800".into())
    );
    assert_eq!(
        (&mean["settled"], &mean["good"]),
        (&false.into(), &1.0.into())
    );
    let episodes = result["episodes"].as_object().unwrap();
    assert!(
        episodes
            .values()
            .all(|episode| episode["first_bad"] == "step-800"),
        "{episodes:?}"
    );
    let candidates = result["candidates"].as_array().unwrap();
    let names: Vec<&str> = candidates
        .iter()
        .filter_map(|one| one["name"].as_str())
        .collect();
    assert_eq!(names, steps);
    let measured = candidates
        .iter()
        .filter(|one| !one["mean"].is_null())
        .count();
    assert!(measured <= 6, "{measured} were measured");

    // The same search goes on where it was, and says in words what it found and where to look.
    let arguments = [&["bisect"], &arguments[..]].concat();
    let words = expect(folder, 1, &arguments);
    assert!(
        words.contains("the first is one of 2 candidates, of which 1 could not be measured"),
        "{words}"
    );
    let look = words
        .lines()
        .find_map(|line| line.strip_prefix("where they come apart: reel "));
    let compared = expect(folder, 1, look.unwrap_or_else(|| panic!("{words}")));
    assert!(
        compared.contains("success 100.0 %") || compared.contains("regressed"),
        "{compared}"
    );
    let again = complaint(folder, 1, &arguments);
    assert!(
        again.contains("were measured before") && again.contains("step-700 is passed over"),
        "{again}"
    );
    let other = complaint(
        folder,
        2,
        "bisect --good a --bad b --candidates c --run | true",
    );
    assert!(other.contains("holds another search"), "{other}");
}

#[test]
fn lines_of_any_harness_will_do() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (version, score) in [("v1", 0.9), ("v2", 0.9), ("v3", 0.2), ("v4", 0.1)] {
        let line = format!("{{\"episode\": \"t\", \"score\": {score}, \"success\": true}}\n");
        fs::write(folder.join(version), line).unwrap();
    }
    let search = |metric| {
        let command = r#"cp "$CANDIDATE" "$OUT/episodes.jsonl""#;
        let row = ["--good", "v1", "--bad", "v4", "--candidates", "v2", "v3"];
        [&row[..], &["--metric", metric, "--run", command]].concat()
    };
    let result = found(folder, 0, &search("score"));
    assert_eq!(result["episodes"]["t"]["first_bad"], "v3");
    let unchanged = found(folder, 1, &search("success"));
    assert_eq!(
        (
            &unchanged["mean"],
            unchanged["episodes"].as_object().unwrap().len()
        ),
        (&Value::Null, 0)
    );
    let wrong = complaint(folder, 2, &[&["bisect"], &search("speed")[..]].concat());
    assert!(
        wrong.contains("no episode with the metric 'speed'"),
        "{wrong}"
    );
    let elsewhere = [&["bisect"], &search("score")[..], &["--episodes", "t9"]].concat();
    let wrong = complaint(folder, 2, &elsewhere);
    assert!(
        wrong.contains("it has no episode of t9; it has "),
        "{wrong}"
    );
    fs::write(folder.join("v2"), "not json").unwrap();
    let changed = complaint(folder, 2, &[&["bisect"], &search("score")[..]].concat());
    assert!(
        changed.contains("holds another search (v2 was changed since)"),
        "a candidate is another file now: {changed}"
    );
}

#[test]
fn presets_score_the_same_traces() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task generate --count 1 --seed 7 --out tasks");
    reel!(
        folder,
        "bench --tasks tasks --agent oracle --no-images --out traces"
    );
    for (version, weight) in [(2, 1.5), (3, 1.5), (10, 9.5), (11, 9.5)] {
        let preset =
            format!("name = \"mine-{version}\"\nbase = \"paper\"\n[weights]\nmatched = {weight}\n");
        fs::write(folder.join(format!("mine-{version}.toml")), preset).unwrap();
    }
    let row = [
        "--good",
        "paper",
        "--bad",
        "mine-11.toml",
        "--presets",
        "traces",
        "--candidates",
    ];
    let files = ["mine-10.toml", "mine-11.toml", "mine-2.toml", "mine-3.toml"];
    let result = found(folder, 0, &[&row[..], &files].concat());
    assert_eq!(
        (&result["metric"], &result["mean"]["first_bad"]),
        (&"reward".into(), &"mine-10.toml".into())
    );
    assert!(
        !folder.join("bisect-out").exists(),
        "nothing has to be kept"
    );
    let wrong = complaint(
        folder,
        2,
        "bisect --good paper --bad nobody --candidates real-repo --presets traces",
    );
    assert!(
        wrong.contains("the end nobody cannot be measured") && wrong.contains("built in are"),
        "{wrong}"
    );
}

#[test]
fn builds_execute_the_same_traces() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task generate --count 2 --seed 7 --out tasks");
    reel!(
        folder,
        "bench --tasks tasks --agent oracle --no-images --out traces"
    );
    // From the third on a build says of one episode that it fails.
    let names: Vec<String> = (1..=5).map(|number| format!("./build-{number}")).collect();
    for (number, name) in names.iter().enumerate() {
        let spoilt = r#"{"outcomes":{"end":{"replayed":{"success":false,"completion":0.5,"total_reward":0.1,"steps":9}}},"trace":"\1"}"#;
        let spoil = format!(r#"| sed '1s#.*"trace":"\([^"]*\)".*#{spoilt}#'"#);
        let spoil = if number >= 2 { spoil.as_str() } else { "" };
        let path = folder.join(name);
        fs::write(&path, format!("#!/bin/sh\n'{REEL}' \"$@\" {spoil}\n")).unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    let row = [
        "--good",
        "./build-1",
        "--bad",
        "./build-5",
        "--builds",
        "traces",
        "--candidates",
    ];
    let between: Vec<&str> = names[1..4].iter().map(String::as_str).collect();
    let result = found(folder, 0, &[&row[..], &between].concat());
    let episodes = result["episodes"].as_object().unwrap();
    assert_eq!(episodes.len(), 1, "{episodes:?}");
    assert!(
        episodes
            .values()
            .all(|episode| episode["first_bad"] == "./build-3")
    );
    assert_eq!(
        (&result["paired_episodes"], &result["mean"]["bad"]),
        (&2.into(), &0.5.into())
    );
}

#[test]
fn commits_are_checked_out_beside_the_repository() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let repository = folder.join("prompts");
    fs::create_dir(&repository).unwrap();
    let git = |arguments: &[&str]| {
        let named = ["-c", "user.name=t", "-c", "user.email=t@example.org"];
        let output = Command::new("git")
            .current_dir(&repository)
            .args(named)
            .args(arguments)
            .output();
        let output = output.unwrap();
        assert!(
            output.status.success(),
            "{arguments:?}: {}",
            String::from_utf8_lossy(&output.stderr)
        );
        String::from_utf8_lossy(&output.stdout).trim().to_owned()
    };
    git(&["init", "--quiet"]);
    for number in 0..7 {
        let success = number < 4;
        let line = format!("{{\"episode\": \"t\", \"success\": {success}, \"number\": {number}}}");
        fs::write(repository.join("result"), line).unwrap();
        git(&["add", "result"]);
        git(&["commit", "--quiet", "-m", &format!("change {number}")]);
    }
    fs::write(repository.join("result"), "work that is not committed").unwrap();
    let row = [
        "--git", "prompts", "--good", "HEAD~6", "--bad", "HEAD", "--out", "found",
    ];
    let run = ["--run", r#"cp result "$OUT/episodes.jsonl""#];
    let result = found(folder, 0, &[&row[..], &run].concat());
    let first = result["episodes"]["t"]["first_bad"].as_str().unwrap();
    assert_eq!(git(&["log", "-1", "--format=%s", first]), "change 4");
    assert_eq!(
        git(&["worktree", "list"]).lines().count(),
        1,
        "the checkout is gone"
    );
    assert_eq!(
        fs::read_to_string(repository.join("result")).unwrap(),
        "work that is not committed"
    );
    assert!(!folder.join("found/checkout").exists());
    let backwards = [
        "bisect", "--git", "prompts", "--good", "HEAD", "--bad", "HEAD~2", "--run", "true",
    ];
    assert!(complaint(folder, 2, &backwards).contains("is not an ancestor"));
    // Somebody's folder at that place is not touched.
    fs::create_dir_all(folder.join("mine/checkout")).unwrap();
    let taken = [
        "bisect", "--git", "prompts", "--good", "HEAD~2", "--bad", "HEAD", "--run", "true",
        "--out", "mine",
    ];
    assert!(complaint(folder, 2, &taken).contains("is no checkout of a search"));
    assert!(folder.join("mine/checkout").exists());
}
