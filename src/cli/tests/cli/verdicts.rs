//! Verdicts of every door in one table, and branches that count as no trial.

use std::{fs, path::Path};

use serde_json::Value;

use crate::{complaint, expect, first_trace};

/// Rows of a query over the folder's store.
fn rows(folder: &Path, sql: &str) -> Vec<Value> {
    let text = expect(folder, 0, &["query", "--store", "store", "--json", sql]);
    serde_json::from_str(&text).unwrap()
}

const VERDICTS: &str = "SELECT e.trace, v.verdict, count(*) AS verdicts FROM episodes e \
                        JOIN verdicts v ON v.trace_digest = e.trace_digest GROUP BY 1, 2 ORDER BY 1";

#[test]
fn verdicts_of_every_door_are_in_one_table() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 3 --seed 5 --out tasks");
    reel!(folder, "run --tasks tasks --policy oracle --out traces");
    reel!(folder, "ingest traces --store store");
    assert!(rows(folder, VERDICTS).is_empty());
    assert!(complaint(folder, 2, "replay traces --store nowhere").contains("nowhere"));

    // By the command line, twice: the second time nothing is new.
    let first = first_trace(folder).display().to_string();
    for _ in 0..2 {
        expect(folder, 0, &["replay", &first, "--store", "store"]);
        let kept = rows(folder, VERDICTS);
        assert_eq!(kept.len(), 1, "{kept:?}");
        assert_eq!(
            (&kept[0]["verdict"], &kept[0]["verdicts"]),
            (&"exact".into(), &1.into())
        );
    }

    // By SQL: what is known is not added again, what is new is.
    let replayed = "SELECT count(*) AS exact FROM episodes WHERE replay(trace).verdict = 'exact'";
    assert_eq!(rows(folder, replayed)[0]["exact"], 3);
    assert_eq!(rows(folder, VERDICTS).len(), 3);
    assert_eq!(
        rows(folder, "SELECT count(*) AS n FROM verdicts")[0]["n"],
        3
    );

    // An export needs no replay for episodes that others proved.
    let told = reel!(
        folder,
        "export sft --store store --out set --no-replay --json"
    );
    let told: Value = serde_json::from_str(told.lines().last().unwrap()).unwrap();
    assert_eq!(told["episodes"], 3, "{told}");

    // What is no trace gets a verdict of its own, under the digest of its bytes.
    fs::write(folder.join("torn.mcap"), "no trace").unwrap();
    expect(folder, 1, &["replay", "torn.mcap", "--store", "store"]);
    let torn = rows(
        folder,
        "SELECT verdict, trace_digest FROM verdicts WHERE verdict != 'exact'",
    );
    assert_eq!(torn.len(), 1);
    assert_eq!(
        (&torn[0]["verdict"], &torn[0]["trace_digest"]),
        (&"refused".into(), &"".into())
    );
}

#[test]
fn branches_are_no_trials_of_a_policy() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 5 --out tasks");
    reel!(folder, "run --tasks tasks --policy oracle --out traces");
    let results = |name: &str| {
        expect(
            folder,
            0,
            &["query", "--store", "store", "--json", "--named", name],
        )
    };
    reel!(folder, "ingest traces --store store");
    let names = [
        "main_results",
        "success_intervals",
        "benchmark",
        "policy_comparison",
        "success_by_budget",
        "flaky_tasks",
        "failures",
        "user_fidelity",
        "object_confusions",
        "summary",
    ];
    let before = names.map(results);
    let trace = rows(folder, "SELECT trace FROM episodes ORDER BY trace")[0]["trace"]
        .as_str()
        .unwrap()
        .to_owned();
    expect(
        folder,
        0,
        &[
            "branch",
            &trace,
            "--at",
            "1",
            "--policy",
            "wrong-object",
            "--out",
            "traces/other.mcap",
            "--no-cache",
        ],
    );
    reel!(folder, "ingest traces --store store");
    assert_eq!(
        rows(
            folder,
            "SELECT count(*) AS n FROM episodes WHERE parent_trace IS NOT NULL"
        )[0]["n"],
        1
    );
    for (name, before) in names.iter().zip(before) {
        assert_eq!(results(name), before, "{name}");
    }
}

#[test]
fn labels_of_an_author_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 1 --seed 5 --out tasks");
    reel!(
        folder,
        "run --tasks tasks --policy wrong-object --out traces"
    );
    reel!(folder, "ingest traces --store store");
    let id = rows(folder, "SELECT episode_id FROM episodes")[0]["episode_id"]
        .as_str()
        .unwrap()
        .to_owned();
    for author in ["ann", "ben"] {
        expect(
            folder,
            0,
            &[
                "store",
                "label",
                "--store",
                "store",
                "set",
                &id[..8],
                "--class",
                "Other",
                "--author",
                author,
            ],
        );
    }
    expect(
        folder,
        0,
        &[
            "store",
            "label",
            "--store",
            "store",
            "remove",
            &id[..8],
            "--author",
            "ann",
        ],
    );
    let left = rows(folder, "SELECT author FROM labels");
    assert_eq!(left.len(), 1);
    assert_eq!(left[0]["author"], "ben");
    let again = format!("store label --store store remove {id} --author ann");
    assert!(complaint(folder, 2, again.as_str()).contains("ann has labelled no such episode"));
}
