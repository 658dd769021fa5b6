//! Agents outside of homes, with tools of their own and no goal that Reel knows: what is told is
//! kept, nothing is measured, and whole conversations become training rows.

use std::{fs, path::Path};

use serde_json::Value;
use tempfile::TempDir;

use crate::expect;

/// A coding agent's trajectory that nobody judged, and a log of four samples, two of which
/// succeeded; ingested and classified in `store`.
fn foreign(here: &Path) {
    let examples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/formats/foreign");
    for (format, file) in [("atif", "trajectory.json"), ("inspect", "log.json")] {
        let document = fs::read_to_string(examples.join(file)).unwrap();
        // Coordinates are nothing that this agent must not say.
        let document = document
            .replace(
                r#""path": "parser.c""#,
                r#""path": "parser.c", "x": 1, "y": 2"#,
            )
            .replace(
                r#""additionalProperties": false"#,
                r#""additionalProperties": true"#,
            );
        fs::write(here.join(file), document).unwrap();
        expect(here, 0, &["import", format, file, "--out", "traces"]);
    }
    reel!(here, "ingest traces --store store");
    fs::create_dir(here.join("rules")).unwrap();
    fs::write(
        here.join("rules/untested.sql"),
        "-- The last change of a file was never tested.\n--\n-- The agent wrote a file, and ran no test after it.\n--\n\
         -- Class: Verification Missing\n-- Sub-class: untested_change\n-- Priority: 10\n\
         SELECT sequence_find(steps, '\"write_file\" !(\"run_tests\")* $') AS found FROM episodes\n",
    )
    .unwrap();
    reel!(here, "taxonomy --store store --rules rules");
}

#[test]
fn nothing_is_measured_against_a_goal_that_is_none() {
    let folder = TempDir::new().unwrap();
    let here = folder.path();
    foreign(here);
    let sql = "SELECT trace, task_id, success FROM episodes ORDER BY task_id";
    let traces = expect(
        here,
        0,
        &["query", "--store", "store", "--format", "json", sql],
    );
    let traces: Vec<Value> = serde_json::from_str(&traces).unwrap();
    let trace = |task: &str| {
        let row = traces.iter().find(|row| row["task_id"] == task).unwrap();
        row["trace"].as_str().unwrap().to_owned()
    };
    let (parser, lexer) = (trace("builds/parser"), trace("builds/lexer"));

    let blame: Value =
        serde_json::from_str(&expect(here, 0, &["blame", &parser, "--json"])).unwrap();
    assert_eq!(blame["success"], true, "what was told");
    assert_eq!(blame["costs"], Value::Array(Vec::new()));
    let blame = expect(here, 0, &["blame", &lexer]);
    assert!(
        blame.contains("failed after 3 calls; its task has no goal"),
        "{blame}"
    );
    let blame = reel!(here, "blame --store store");
    assert!(blame.starts_with("0 of 0 episodes failed"), "{blame}");
    assert!(
        blame.contains("\n2 more failed as told; their tasks have no goal"),
        "{blame}"
    );
    let attributed = reel!(here, "attribute --store store");
    assert!(
        attributed.starts_with("no episode whose task has a goal"),
        "{attributed}"
    );

    let diff = expect(here, 0, &["diff", &parser, &parser]);
    assert!(diff.contains("finished after 5 calls, success\n"), "{diff}");
    let runs = expect(here, 0, &["diff", "traces", "traces"]);
    assert!(
        runs.starts_with("4 pairs of 4 tasks: success 50.0% -> 50.0%"),
        "{runs}"
    );
    reel!(here, "report --store store --out report.html");
    let report = fs::read_to_string(here.join("report.html")).unwrap();
    assert!(
        report.contains("1 more of which nobody told whether they succeeded"),
        "{report}"
    );
    // A failure that a rule found counts, whether or not somebody told.
    let failed = reel!(
        here,
        "query --store store --format json --named failed_episodes"
    );
    let failed: Vec<Value> = serde_json::from_str(&failed).unwrap();
    assert_eq!(failed.len(), 3, "{failed:?}");
}

#[test]
fn conversations_of_other_agents_become_training_rows() {
    let folder = TempDir::new().unwrap();
    let here = folder.path();
    foreign(here);
    let left_out = reel!(
        here,
        "export sft --store store --allow-unverified --out single"
    );
    assert!(
        left_out.contains("9 decisions of agents with tools of their own"),
        "{left_out}"
    );

    for format in ["openai", "ms-swift", "trl", "qwen-vl", "parquet"] {
        let told = reel!(
            here,
            "export sft --store store --style multi-turn --format {format} --allow-unverified --seed 1 --out {format}"
        );
        assert!(told.starts_with("2 examples"), "{format}: {told}");
        reel!(here, "dataset lint {format}");
        let card = fs::read_to_string(here.join(format).join("README.md")).unwrap();
        assert!(
            card.contains("\nDecisions of agents that call tools"),
            "{card}"
        );
        assert!(
            card.contains("task_categories:\n- text-generation\n"),
            "{card}"
        );
        assert!(card.contains("tags:\n- tool-use\nconfigs:"), "{card}");
        assert!(card.contains("| Tool of the last turn |"), "{card}");
    }
    let words = "export sft --store store --style multi-turn --format llama-factory --allow-unverified --out words";
    let left_out = expect(here, 0, words);
    let why = "2 examples that the format cannot hold: its trainer reads no words beside a call";
    assert!(left_out.contains(why), "{left_out}");
    let mut rows = Vec::new();
    for split in ["train", "val", "test"] {
        let folder = here.join("openai").join(split);
        for file in fs::read_dir(folder).into_iter().flatten() {
            let text = fs::read_to_string(file.unwrap().path()).unwrap();
            rows.extend(
                text.lines()
                    .map(|line| serde_json::from_str::<Value>(line).unwrap()),
            );
        }
    }
    let row = rows
        .iter()
        .find(|row| row["messages"][1]["content"][0]["text"] == "Mend the printer.")
        .unwrap();
    let messages = row["messages"].as_array().unwrap();
    assert_eq!(messages[0]["content"], "You write code.");
    let call = &messages[2];
    assert_eq!(call["content"], "Now read_file.");
    assert_eq!(call["tool_calls"][0]["function"]["name"], "read_file");
    assert_eq!(messages[3]["content"], "result 0");
    // What was said at the end, without a call, is an answer.
    assert_eq!(messages.last().unwrap()["content"], "Done.");
    assert_eq!(messages.len(), 2 + 3 * 2 + 1);
    let declared = row["tools"].as_array().unwrap();
    let names: Vec<&Value> = declared
        .iter()
        .map(|tool| &tool["function"]["name"])
        .collect();
    assert_eq!(names, ["read_file", "write_file", "run_tests"]);
    let path = &declared[0]["function"]["parameters"]["properties"]["path"];
    assert_eq!(path["type"], "string");
}
