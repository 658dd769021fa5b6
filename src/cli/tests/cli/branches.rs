//! Other futures of an episode, and two episodes side by side, from outside.

use std::fs;

use serde_json::Value;

use crate::{complaint, expect, failed_episode, first_trace};

#[test]
fn a_branch_is_made_checked_compared_and_branched_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let trace = failed_episode(folder);
    let trace = trace.to_str().unwrap();
    let json = |text: String| -> Value { serde_json::from_str(&text).unwrap() };

    let call = r#"{"name": "pick", "arguments": {"marker_id": 99}}"#;
    let told = expect(
        folder,
        0,
        &[
            "branch",
            trace,
            "--at",
            "2",
            "--call",
            call,
            "--out",
            "a.mcap",
            "--no-cache",
        ],
    );
    assert!(
        told.contains("2  pick(marker_id=99)") && told.contains("aborted after 3 calls"),
        "{told}"
    );
    let branch = [
        "branch",
        trace,
        "--at",
        "2",
        "--policy",
        "oracle",
        "--out",
        "b.mcap",
        "--cache",
        "snapshots",
        "--json",
    ];
    let made = json(expect(folder, 0, &branch));
    assert_eq!(
        (
            &made["success"],
            &made["parent"]["call"],
            &made["substituted"]["then"]["policy"]
        ),
        (&true.into(), &2.into(), &"oracle".into())
    );
    // From a snapshot of the cache it is the same.
    let before = fs::read(folder.join("b.mcap")).unwrap();
    expect(folder, 0, &branch);
    assert!(before == fs::read(folder.join("b.mcap")).unwrap());
    assert!(reel!(folder, "replay b.mcap").contains("exact"));
    let checked = reel!(folder, "branch {trace} --check a.mcap --check b.mcap");
    assert!(
        checked.contains("a.mcap: branches at call 2, the same before; exact: 3 calls"),
        "{checked}"
    );

    fs::write(
        folder.join("calls.jsonl"),
        "{\"tool_name\": \"walk_around\"}\n\n{\"name\": \"show_receptacles\"}\n",
    )
    .unwrap();
    let calls = [
        "branch",
        "b.mcap",
        "--at",
        "1",
        "--calls",
        "calls.jsonl",
        "--then",
        "parent",
        "--no-cache",
        "--out",
        "c.mcap",
    ];
    assert!(expect(folder, 0, &calls).contains("of the parent, from its call 3 on"));
    let grandchild = json(reel!(folder, "branch b.mcap --check c.mcap --json"));
    assert_eq!(
        (&grandchild["holds"], &grandchild["verdict"]),
        (&true.into(), &"exact".into())
    );
    let stranger = expect(folder, 1, &format!("branch {trace} --check c.mcap"));
    assert!(
        stranger.contains("NO BRANCH of it: it branches from the trace"),
        "{stranger}"
    );

    let beside = expect(folder, 1, &format!("diff {trace} b.mcap"));
    assert!(
        beside.contains("branches from A at call 2")
            && beside.contains("calls 0 to 1 are the same"),
        "{beside}"
    );
    assert!(
        beside.contains("the world of B in the end, beside that of A"),
        "{beside}"
    );
    let beside = json(expect(folder, 1, &format!("diff {trace} b.mcap --json")));
    let first = |side: &str| beside["rows"][0][side]["call"].as_u64();
    assert_eq!(
        (&beside["same_calls"], first("a").or(first("b"))),
        (&2.into(), Some(2)),
        "{beside}"
    );
    assert!(reel!(folder, "diff {trace} {trace}").contains("all that came of them"));
}

#[test]
fn what_cannot_be_branched_or_compared_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(
        folder,
        "task draw --count 2 --families FDP,FDO --seed 4 --out tasks"
    );
    reel!(folder, "run --tasks tasks --out traces --no-images");
    let trace = first_trace(folder);
    let trace = trace.to_str().unwrap();
    let refused = |rest: &[&str]| {
        complaint(
            folder,
            2,
            &[&["branch", trace, "--no-cache", "--at"], rest].concat(),
        )
    };
    assert!(refused(&["2"]).contains("name what follows at call 2"));
    assert!(refused(&["99", "--policy", "oracle"]).contains("unknown call 99"));
    assert!(refused(&["2", "--policy", "clever"]).contains("no policy is called 'clever'"));
    assert!(refused(&["2", "--call", "pick(1)"]).contains("write a call as {\"name\": \"pick\""));
    assert!(refused(&["2", "--then", "parent:x"]).contains("--then parent:x"));
    assert!(refused(&["2", "--then", "parent:99"]).contains("cannot continue from call 99"));
    assert!(refused(&["2", "--policy", "oracle", "--out", trace]).contains("is the parent"));
    let steps: Value = serde_json::from_str(&reel!(folder, "show {trace} --json")).unwrap();
    let last = steps["steps"].as_array().unwrap().len().to_string();
    assert!(refused(&[&last, "--policy", "oracle"]).contains("the episode ended with call"));
    assert!(!folder.join("traces").read_dir().unwrap().any(|entry| {
        entry
            .unwrap()
            .path()
            .extension()
            .is_some_and(|e| e == "part")
    }));

    let mut traces: Vec<_> = fs::read_dir(folder.join("traces"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    traces.sort();
    let other = complaint(
        folder,
        2,
        &[
            "diff",
            traces[0].to_str().unwrap(),
            traces[1].to_str().unwrap(),
        ],
    );
    assert!(other.contains("episodes of different tasks"), "{other}");
}
