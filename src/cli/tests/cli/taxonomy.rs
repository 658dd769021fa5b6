//! Faults injected, classified, labelled and compared: the short form of `make eval-taxonomy`, and
//! the commands around it.

use std::{fs, path::Path};

use serde_json::Value;

use super::{complaint, endpoint::endpoint, expect};

/// Plays faulty episodes, ingests and classifies them.
fn classified(folder: &Path, count: &str) {
    reel!(folder, "task draw --count 16 --seed 1001 --out tasks");
    reel!(
        folder,
        "agent faults run --tasks tasks --episodes {count} --seed 1900000 --out faulty"
    );
    reel!(folder, "ingest faulty --store store");
    let table = reel!(
        folder,
        "taxonomy --store store --sankey why.svg --sankey why.png"
    );
    assert!(
        table.contains("Object Confusion") && table.contains("failures of"),
        "{table}"
    );
}

#[test]
fn the_rules_find_what_was_injected() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    classified(folder, "48");
    assert!(
        fs::read_to_string(folder.join("why.svg"))
            .unwrap()
            .contains("Why do they fail?")
    );
    assert!(
        fs::read(folder.join("why.png"))
            .unwrap()
            .starts_with(b"\x89PNG")
    );

    // without labels there is nothing to compare with, and it says what to do
    let refused = complaint(
        folder,
        2,
        "taxonomy agreement --store store --reference injected",
    );
    assert!(
        refused.contains("no episode of 'rules' has a label"),
        "{refused}"
    );
    reel!(folder, "store label import faulty --store store");
    let report = reel!(
        folder,
        "taxonomy agreement --store store --reference injected --baseline --json"
    );
    let report: Value = serde_json::from_str(&report).unwrap();
    let macro_f1 = |index: usize| {
        report["reports"][index]["classes"]["macro_f1"]
            .as_f64()
            .unwrap()
    };
    assert!(
        report["reports"][0]["classes"]["episodes"]
            .as_u64()
            .unwrap()
            >= 30,
        "{report}"
    );
    assert!(macro_f1(0) >= 0.9, "{report}");
    assert!(
        macro_f1(0) > macro_f1(1) + 0.2,
        "no better than a naive classifier: {report}"
    );

    // the rules see no labels: the same classes without them
    let with = reel!(folder, "taxonomy --store store --dry-run --json");
    reel!(folder, "ingest faulty --store other");
    let mut without: Vec<String> = reel!(folder, "taxonomy --store other --json")
        .lines()
        .map(str::to_owned)
        .collect();
    let mut with: Vec<String> = with.lines().map(str::to_owned).collect();
    with.sort();
    without.sort();
    assert_eq!(with, without);

    let half = "episode_id < '8'";
    let drift = expect(
        folder,
        0,
        &[
            "taxonomy",
            "drift",
            "--store",
            "store",
            "--before",
            half,
            "--after",
            "episode_id >= '8'",
        ],
    );
    assert!(
        drift.contains("Object Confusion") && drift.contains("Fisher"),
        "{drift}"
    );
}

#[test]
fn a_report_holds_everything_it_shows() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    classified(folder, "8");
    reel!(folder, "blame --store store");
    let report = ["report", "--store", "store", "--out", "why.html"];
    expect(
        folder,
        0,
        &[&report[..], &["--title", "Why <they> fail"]].concat(),
    );
    let page = fs::read_to_string(folder.join("why.html")).unwrap();
    assert!(
        page.contains("Why &lt;they&gt; fail")
            && page.contains("<svg")
            && page.contains("data:image/png;base64,")
    );
    // Nothing is fetched, and without the player nothing runs.
    expect(folder, 0, &[&report[..], &["--no-player"]].concat());
    let plain = fs::read_to_string(folder.join("why.html")).unwrap();
    for outside in ["<link", "src=\"http", "url(http", "@import"] {
        assert!(
            !page.contains(outside) && !plain.contains(outside),
            "{outside}"
        );
    }
    assert!(!plain.contains("<script") && !plain.contains("<button"));
    // With it every example that can be executed has a button, and the element that it names.
    let player = folder.join("player.html");
    fs::write(&player, "<main></main><!-- episode -->").unwrap();
    let with = ["--player", player.to_str().unwrap()];
    expect(folder, 0, &[&report[..], &with].concat());
    let page = fs::read_to_string(folder.join("why.html")).unwrap();
    let examples = page.matches("<article>").count();
    assert!(examples > 1, "{examples} examples");
    assert_eq!(page.matches("<button data-episode=").count(), examples);
    assert_eq!(page.matches(" id=\"episode-").count(), examples);
    assert_eq!(page.matches("<script>").count(), 1);
    // What cannot be read into it is told, and no file is left.
    fs::remove_file(folder.join("why.html")).unwrap();
    let refused = complaint(
        folder,
        2,
        &[&report[..], &["--where", "polcy = 'x'"]].concat(),
    );
    assert!(
        refused.contains("polcy") && !folder.join("why.html").exists(),
        "{refused}"
    );
}

#[test]
fn people_label_disagree_and_decide() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    classified(folder, "6");
    let first = expect(
        folder,
        0,
        "query --store store --format csv | \
                SELECT min(episode_id) AS id FROM classes",
    );
    let id = first.lines().nth(1).unwrap();
    let set = |arguments: &[&str], code: i32| {
        let all = [&["store", "label", "set", "--store", "store"], arguments].concat();
        expect(folder, code, &all)
    };
    set(
        &[
            id,
            "--sub-class",
            "missing_ask",
            "--step",
            "1",
            "--author",
            "ann",
            "--note",
            "two, \"clocks\"",
        ],
        0,
    );
    set(
        &[
            id,
            "--class",
            "Other",
            "--author",
            "bob",
            "--confidence",
            "0.4",
        ],
        0,
    );
    for (arguments, complaint_of) in [
        (
            vec![id, "--class", "Bad Luck", "--author", "bob"],
            "none of Object Confusion",
        ),
        (
            vec![id, "--class", "Other", "--author", "bob", "--step", "99"],
            "steps, from 0",
        ),
        (
            vec!["zzzz", "--class", "Other", "--author", "bob"],
            "0 episodes have an id",
        ),
        (
            vec![
                id,
                "--class",
                "Other",
                "--author",
                "bob",
                "--confidence",
                "3",
            ],
            "between 0 and 1",
        ),
    ] {
        let refused = complaint(
            folder,
            2,
            &[
                &["store", "label", "set", "--store", "store"],
                &arguments[..],
            ]
            .concat(),
        );
        assert!(refused.contains(complaint_of), "{refused}");
    }
    let disputed = expect(folder, 1, "store label disputed --store store");
    assert!(
        disputed.contains("ann")
            && disputed.contains("bob")
            && disputed.contains("1 episodes are disputed"),
        "{disputed}"
    );
    complaint(folder, 2, "taxonomy agreement --store store");
    set(
        &[
            id,
            "--sub-class",
            "wrong_kind",
            "--author",
            "cem",
            "--adjudicate",
        ],
        0,
    );
    assert!(reel!(folder, "store label disputed --store store").starts_with("0 episodes"));
    assert!(
        reel!(folder, "taxonomy agreement --store store").contains("against 'agreed': 1 episodes")
    );

    // out and in again, into another store
    reel!(folder, "store label export --store store --out labels.csv");
    reel!(
        folder,
        "store label export --store store --out labels.jsonl"
    );
    for file in ["labels.csv", "labels.jsonl"] {
        let other = format!("other-{file}");
        reel!(folder, "ingest faulty --store {other}");
        reel!(folder, "store label import {file} --store {other}");
        let list = |store: &str| reel!(folder, "store label list --store {store} --json");
        assert_eq!(list(&other), list("store"), "{file}");
    }
    fs::write(folder.join("bad.csv"), "episode_id,class\nx,Nonsense\n").unwrap();
    let refused = complaint(folder, 2, "store label import bad.csv --store store");
    assert!(refused.contains("bad.csv, line 2"), "{refused}");
    fs::write(folder.join("gone.csv"), "episode_id,class\nnobody,Other\n").unwrap();
    complaint(folder, 3, "store label import gone.csv --store store");
}

#[test]
fn a_judge_says_what_it_thinks_and_overturns_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    classified(folder, "6");
    let classes = |store: &str| {
        expect(
            folder,
            0,
            &format!(
                "query --store {store} --format csv | \
                SELECT episode_id, class, sub_class FROM classes ORDER BY 1"
            ),
        )
    };
    let before = classes("store");
    let url = endpoint(
        r#"{"class": "Other", "sub_class": null, "step": 0, "decisive": true, "comment": "it rained", "confidence": 0.9}"#,
    );
    let judge = [
        "taxonomy",
        "judge",
        "--store",
        "store",
        "--endpoint",
        &url,
        "--model",
        "scripted",
        "--max",
        "4",
    ];
    let said = expect(folder, 0, &judge);
    assert!(said.starts_with("4 episodes judged"), "{said}");
    assert_eq!(classes("store"), before);
    let labels = reel!(folder, "store label list --store store");
    assert_eq!(labels.matches("judge").count(), 4, "{labels}");
    assert!(labels.contains("it rained"), "{labels}");
    assert_eq!(
        fs::read_to_string(folder.join("judge-calls.jsonl"))
            .unwrap()
            .lines()
            .count(),
        4
    );
    // asked again it answers from what was kept, without the endpoint
    let gone = "taxonomy judge --store store --endpoint http://127.0.0.1:9/v1 --model scripted \
        --max 4";
    assert!(expect(folder, 0, gone).starts_with("4 episodes judged"));
    let agreement = reel!(folder, "taxonomy agreement --store store --reference judge");
    assert!(
        agreement.contains("rules against 'judge': 4 episodes"),
        "{agreement}"
    );
    // and the judge beside people
    let judged = labels
        .lines()
        .next()
        .unwrap()
        .split_whitespace()
        .next()
        .unwrap();
    reel!(
        folder,
        "store label set {judged} --class Other --author ann --store store"
    );
    let agreement = reel!(
        folder,
        "taxonomy agreement --store store --prediction judge --reference ann"
    );
    assert!(
        agreement.contains("judge against 'ann': 1 episodes")
            && agreement.contains("accuracy 1.000"),
        "{agreement}"
    );
    let calibrated = "confidence of 1 answers of 'judge': Brier score 0.010 (0.000 if it always";
    assert!(agreement.contains(calibrated), "{agreement}");
    // another reading is another author
    let by_steps = [&judge[..], &["--step-by-step"]].concat();
    assert!(expect(folder, 0, &by_steps).starts_with("4 episodes judged"));
    let labels = reel!(folder, "store label list --store store");
    assert_eq!(
        labels.matches("scripted step by step").count(),
        4,
        "{labels}"
    );
    let calls = fs::read_to_string(folder.join("judge-calls.jsonl")).unwrap();
    assert!(calls.lines().count() >= 4 + 2 * 4, "two calls an episode");
}

#[test]
fn clusters_become_drafts_that_are_rules() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    classified(folder, "32");
    let found = reel!(
        folder,
        "taxonomy clusters --store store --propose drafts --json | --where=NOT success"
    );
    let found: Value = serde_json::from_str(&found).unwrap();
    let clusters = found["clusters"].as_array().unwrap();
    assert!(!clusters.is_empty(), "{found}");
    for cluster in clusters
        .iter()
        .filter(|cluster| !cluster["pattern"].is_null())
    {
        let pattern = cluster["pattern"].as_str().unwrap().replace('\'', "''");
        let ids: Vec<String> = cluster["episodes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|id| format!("'{}'", id.as_str().unwrap()))
            .collect();
        let sql = format!(
            "SELECT count(*) AS n FROM episodes WHERE sequence_match(steps, '{pattern}') AND episode_id IN ({})",
            ids.join(", ")
        );
        let count = expect(
            folder,
            0,
            &["query", "--store", "store", "--format", "csv", &sql],
        );
        assert_eq!(count, format!("n\n{}\n", cluster["size"]), "{cluster}");
    }
    reel!(folder, "taxonomy --store store --rules drafts --dry-run");
    let rules = reel!(folder, "taxonomy rules --rules drafts");
    assert!(rules.contains("cluster_1"), "{rules}");
    assert!(
        complaint(folder, 2, "taxonomy clusters --store store --threshold 2")
            .contains("outside 0 to 1")
    );
}
