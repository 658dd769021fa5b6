//! Going to a moment, dropping images and drawing them again,
//! explaining, distrusting: from outside.

use std::{
    fs,
    process::{Command, Stdio},
};

use crate::{complaint, first_trace};

#[test]
fn any_moment_is_shown_with_the_same_bits_from_a_snapshot_and_from_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task draw --count 1 --families FDO --seed 5 --out tasks"
    );
    let played = reel!(folder, "run --tasks tasks --out traces --check-isolation");
    assert!(
        played.contains("1 episodes are the same under another heap layout"),
        "{played}"
    );
    let trace = first_trace(folder);
    let trace = trace.to_str().unwrap();

    let executed = reel!(folder, "show {trace} --at 4 --json --no-cache");
    for _ in 0..2 {
        assert_eq!(
            reel!(folder, "show {trace} --at 4 --json --cache snapshots"),
            executed
        );
    }
    assert_eq!(fs::read_dir(folder.join("snapshots")).unwrap().count(), 1);
    let state: serde_json::Value = serde_json::from_str(&executed).unwrap();
    let whole: serde_json::Value =
        serde_json::from_str(&reel!(folder, "show {trace} --json")).unwrap();
    assert_eq!(state["state_digest"], whole["steps"][3]["digests"]["state"]);
    let text = reel!(folder, "show {trace} --at 4 --cache snapshots");
    assert!(
        text.contains(state["state_digest"].as_str().unwrap()) && text.contains("robot"),
        "{text}"
    );

    reel!(folder, "trace frames {trace} --out all");
    reel!(
        folder,
        "trace frames {trace} --out one --at 4 --cache snapshots"
    );
    let read = |path: &str| fs::read(folder.join(path)).unwrap();
    assert!(read("one/call_004.png") == read("all/call_004.png"));
    let beyond = complaint(folder, 2, &format!("show {trace} --at 99 --no-cache"));
    assert!(beyond.contains("unknown call 99"), "{beyond}");

    assert!(reel!(folder, "replay {trace} --restored 3").contains("exact"));
    assert!(reel!(folder, "replay {trace} --explain").contains("exact"));
    let states = reel!(folder, "replay {trace} --state-at start:10");
    assert!(states.contains("linear_velocity"), "{states}");
    for wrong in ["start", "x:1", "0:y"] {
        complaint(folder, 2, &format!("replay {trace} --state-at {wrong}"));
    }
}

#[test]
fn nobody_reading_on_is_no_panic() {
    let golden = concat!(env!("CARGO_MANIFEST_DIR"), "/../../traces/golden");
    let mut child = Command::new(env!("CARGO_BIN_EXE_reel"))
        .args(["replay", golden, "--outcomes", "--json"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    let complaint = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.code() == Some(141) && !complaint.contains("panicked"),
        "{:?} {complaint}",
        output.status
    );
}

#[test]
fn images_are_dropped_and_drawn_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 6 --out tasks");
    reel!(folder, "run --tasks tasks --out traces");
    let compacted = reel!(folder, "trace compact traces --out lean");
    assert!(
        compacted.contains("2 of 2 traces") && compacted.contains("/camera/head"),
        "{compacted}"
    );
    reel!(folder, "trace expand lean --out full --json");
    for entry in fs::read_dir(folder.join("traces")).unwrap() {
        let (path, name) = entry
            .map(|entry| (entry.path(), entry.file_name()))
            .unwrap();
        assert!(
            fs::read(path).unwrap() == fs::read(folder.join("full").join(&name)).unwrap(),
            "{name:?} came back other"
        );
    }
    reel!(folder, "trace compact full --in-place");
    reel!(folder, "replay full");
    complaint(folder, 2, "trace compact traces");
}
