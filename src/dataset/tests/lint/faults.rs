//! One spoiled row for each thing that is looked for, beside good ones.

use serde_json::{Value, json};

use super::{Folder, answer, count, linted, of, png, prompt, swift};

fn folder() -> Folder {
    let folder = Folder::new();
    folder.write("view.png", png(364, 273));
    folder
}

fn good(task: &str) -> Value {
    swift(
        task,
        "Arrived at table_1.",
        "pick",
        json!({ "marker_id": 1 }),
    )
}

#[test]
fn good_rows_pass() {
    let folder = folder();
    let rows: Vec<Value> = ["Bring a cup.", "Find the salt."]
        .iter()
        .map(|task| good(task))
        .collect();
    let report = linted(&folder.lines("rows.jsonl", &rows));
    // Two rows that differ in a word are near-duplicates, rightly, and two rows do
    // not call all tools.
    let expected = ["balance", "near-duplicates"];
    let worst: Vec<_> = report
        .checks
        .iter()
        .filter(|check| !expected.contains(&check.check) && check.findings > 0)
        .collect();
    assert!(worst.is_empty() && !report.is_bad(), "{report}");
}

#[test]
fn frames() {
    let folder = folder();
    folder.write("torn.png", &png(8, 8)[..40]);
    folder.write("words.png", "not an image");
    let with = |images: Value| {
        let mut row = good("Bring a cup.");
        row["images"] = images;
        row
    };
    let mut wrong_turn = good("Find it.");
    wrong_turn["messages"][1]["content"] = "look".into();
    wrong_turn["messages"][2]["content"] = format!("<image>{}", answer("finish", json!({}))).into();
    let rows = [
        with(json!(["gone.png"])),
        with(json!(["torn.png"])),
        with(json!(["words.png"])),
        with(json!([])),
        with(json!(["view.png", "view.png"])),
        wrong_turn,
    ];
    let report = linted(&folder.lines("rows.jsonl", &rows));
    let kinds = ["missing", "undecodable", "tag mismatch", "wrong turn"]
        .map(|kind| count(&report, "images", kind));
    assert_eq!(kinds, [1, 2, 2, 1], "{report}");
    assert!(report.is_bad());
}

#[test]
fn what_loaders_pass_over() {
    let folder = folder();
    let turns = |roles: &[&str]| -> Value {
        roles
            .iter()
            .map(|role| json!({ "from": role, "value": "words" }))
            .collect()
    };
    let qwen = [
        json!({ "image": "view.png", "images": ["view.png"], "conversations": [{ "from": "human", "value": "<image>" }, { "from": "gpt", "value": "a" }] }),
        json!({ "conversations": turns(&["human", "gpt", "human"]) }),
        json!({ "conversations": turns(&["gpt", "human"]) }),
        json!({ "conversations": turns(&["human", "bot"]) }),
        json!({ "conversations": turns(&["system", "human", "gpt"]) }),
    ];
    let report = linted(&folder.write("qwen.json", json!(qwen).to_string()));
    assert_eq!(
        ["ignored key", "odd turns", "order", "role"].map(|kind| count(&report, "loader", kind)),
        [1; 4],
        "{report}"
    );

    let sharegpt = json!([{ "conversations": turns(&["human", "function_call", "observation"]), "tools": "[]", "images": ["view.png"] }]);
    folder.write(
        "dataset_info.json",
        json!({ "a": { "file_name": "share.json", "formatting": "sharegpt" } }).to_string(),
    );
    let report = linted(&folder.write("share.json", sharegpt.to_string()));
    assert_eq!(
        ["ignored key", "odd turns"].map(|kind| count(&report, "loader", kind)),
        [1; 2],
        "{report}"
    );

    let call = json!({ "id": "c", "type": "function", "function": { "name": "pick", "arguments": { "marker_id": 1 } } });
    let chat = json!({ "messages": [
        { "role": "user", "content": "go" },
        { "role": "assistant", "tool_calls": [call] },
        { "role": "user", "content": "well?" },
    ]});
    let report = linted(&folder.lines("chat.jsonl", &[chat]));
    assert_eq!(
        (
            count(&report, "loader", "tool calls"),
            count(&report, "loader", "order")
        ),
        (1, 2),
        "{report}"
    );
}

#[test]
fn answers() {
    let folder = folder();
    let said = |text: String| {
        let mut row = good("Bring a cup.");
        row["messages"][2]["content"] = text.into();
        row
    };
    let rows = [
        good("Find the salt."),
        said("I do not know.".into()),
        said(r#"{"History": "none"}"#.into()),
        said(answer("fly", json!({}))),
        said(answer("pick", json!({}))),
        said(answer("pick", json!({ "marker_id": "1" }))),
        said(answer("finish", json!({ "because": "done" }))),
    ];
    let report = linted(&folder.lines("rows.jsonl", &rows));
    let kinds = reel_world::words! {
        unread "no action" "unknown tool" "missing argument" "wrong type" "unknown argument"
    };
    assert_eq!(
        kinds.map(|kind| count(&report, "answers", kind)),
        [1; 6],
        "{report}"
    );
    let talk = json!({ "prompt": "one and one", "completion": "two" });
    let report = linted(&folder.lines("talk.jsonl", &[talk]));
    assert!(
        !of(&report, "answers").applies && !report.is_bad(),
        "{report}"
    );
}

#[test]
fn arguments_that_a_schema_does_not_name() {
    let folder = folder();
    let found = |parameters: serde_json::Value| {
        let function = json!({ "name": "edit", "parameters": parameters });
        let call = json!({ "name": "edit", "arguments": { "path": "a.c", "line": 2 } });
        let chat = json!({
            "tools": [{ "type": "function", "function": function }],
            "messages": [
                { "role": "user", "content": "go" },
                { "role": "assistant", "tool_calls": [{ "id": "c", "type": "function", "function": call }] },
            ],
        });
        let report = linted(&folder.lines("rows.jsonl", &[chat]));
        assert!(of(&report, "answers").applies, "{report}");
        count(&report, "answers", "unknown argument")
    };
    let named = json!({ "path": { "type": "string" } });
    assert_eq!(found(json!({ "type": "object", "properties": named })), 1);
    for (others, faults) in [(json!(false), 1), (json!(true), 0), (json!({}), 0)] {
        let schema = json!({ "properties": named, "additionalProperties": others });
        assert_eq!(found(schema), faults, "{others}");
    }
    assert_eq!(found(json!({})), 0, "a schema that names nothing");
}

#[test]
fn one_context_and_three_actions() {
    let folder = folder();
    let act = |marker: u32| {
        swift(
            "Bring a cup.",
            "Marked 3 cups.",
            "pick",
            json!({ "marker_id": marker }),
        )
    };
    let rows = [
        act(1),
        good("Find the salt."),
        act(2),
        act(1),
        act(1),
        act(3),
    ];
    let report = linted(&folder.lines("rows.jsonl", &rows));
    let noise = of(&report, "label-noise");
    assert_eq!(noise.findings, 1);
    assert!(
        noise.examples[0]
            .message
            .starts_with("5 rows of one context have 3 actions; the majority has 60%"),
        "{report}"
    );
    assert_eq!(
        noise.examples[0]
            .examples
            .iter()
            .map(|it| it.line)
            .collect::<Vec<_>>(),
        [3, 6, 1]
    );
    assert_eq!(count(&report, "duplicates", "exact"), 2);
}

#[test]
fn too_long_and_unbalanced() {
    let folder = folder();
    let mut rows: Vec<Value> = (0..9)
        .map(|number| good(&format!("Bring cup {number}.")))
        .collect();
    rows.push(swift(
        &"far away ".repeat(5000),
        "Arrived.",
        "finish",
        json!({}),
    ));
    let report = linted(&folder.lines("rows.jsonl", &rows));
    assert_eq!(count(&report, "length", "over budget"), 1);
    assert_eq!(
        (
            count(&report, "balance", "tool"),
            count(&report, "balance", "never called")
        ),
        (1, 1),
        "{report}"
    );
    assert!(
        of(&report, "balance")
            .note
            .starts_with("pick 9 (90%), finish 1 (10%)")
    );
}

#[test]
fn leakage_between_splits() {
    let folder = folder();
    let of_task = |task: &str, id: &str, scene: &str| {
        let mut row = good(task);
        row["meta"] = json!({ "task_id": id, "scene_id": scene });
        row
    };
    folder.lines(
        "train.jsonl",
        &[
            of_task("Bring a cup.", "FDP/1", "home_1"),
            of_task("Find the salt.", "FDP/2", "home_1"),
        ],
    );
    let report = linted(&folder.0.path().join("train.jsonl"));
    assert!(!of(&report, "splits").applies);
    folder.lines(
        "test.jsonl",
        &[
            of_task("Bring a cup.", "FDP/3", "home_2"),
            of_task("Open it.", "FDP/2", "home_1"),
        ],
    );
    let report = linted(folder.path());
    let kinds =
        ["prompt", "task", "scene", "image", "episode"].map(|kind| count(&report, "splits", kind));
    assert_eq!(kinds, [1, 1, 1, 1, 0], "{report}");
    assert!(report.is_bad());
}

#[test]
fn the_report_for_people_and_for_machines() {
    let folder = folder();
    let mut row = good("Bring a cup.");
    row["images"] = json!(["gone.png"]);
    let report = linted(&folder.lines("rows.jsonl", &[good("Find the salt."), row]));
    let text = report.to_string();
    assert!(
        text.contains("rows.jsonl:2 (row 1): no such file\n      | gone.png"),
        "{text}"
    );
    assert!(
        text.lines()
            .any(|line| line.starts_with("images") && line.contains("ERROR")),
        "{text}"
    );
    let json = serde_json::to_value(&report).expect("plain data");
    assert_eq!(json["rows"], 2);
    let images = json["checks"]
        .as_array()
        .expect("checks")
        .iter()
        .find(|check| check["check"] == "images")
        .expect("it is there");
    assert_eq!(
        (images["worst"].as_str(), images["share"].as_f64()),
        (Some("error"), Some(0.5))
    );
}

#[test]
fn a_history_that_the_rows_refute() {
    let folder = folder();
    let row = |number: u32, last: &str, outcome: &str, history: &str| {
        let mut row = good("Bring a cup.");
        let text = prompt("Bring a cup.", outcome);
        let last = format!("Last action: {last}\n");
        let old =
            "Last action: {\"tool_name\":\"nav_to\",\"args\":{\"receptacle_name\":\"table_1\"}}\n";
        row["messages"][1]["content"] = text.replace(old, &last).into();
        let object =
            json!({ "History": history, "next_action": { "tool_name": "finish", "args": {} } });
        row["messages"][2]["content"] = object.to_string().into();
        row["meta"] = json!({ "episode_id": "e1", "call": number });
        row
    };
    let nav = |place: &str| {
        format!("{{\"tool_name\":\"nav_to\",\"args\":{{\"receptacle_name\":\"{place}\"}}}}")
    };
    let pick = "{\"tool_name\":\"pick\",\"args\":{\"marker_id\":1}}";
    let refused = "No marker map available. Use 'find_objects' or 'explore_receptacle' first.";
    // Not in their order.
    #[rustfmt::skip]
    let rows = [
        row(2, pick, refused, "I went to table_1. I picked up the cup."),
        row(0, "none", "The episode begins.", "Nothing has been done yet."),
        row(1, &nav("table_1"), "Arrived at table_1.", "I went to fridge_1."),
        row(3, &nav("fridge_1"), "Arrived at fridge_1.", "I went to table_1, then to fridge_1."),
    ];
    let report = linted(&folder.lines("rows.jsonl", &rows));
    let history = of(&report, "history");
    assert!(
        history.note.ends_with("in 4 rows, 0 rows not judged"),
        "{report}"
    );
    assert_eq!(
        history
            .examples
            .iter()
            .map(|it| it.examples[0].index)
            .collect::<Vec<_>>(),
        [2, 0],
        "{report}"
    );
    // Without the second, what came after it cannot be judged.
    let report = linted(&folder.lines(
        "rows.jsonl",
        &[rows[0].clone(), rows[1].clone(), rows[3].clone()],
    ));
    assert_eq!(of(&report, "history").findings, 0, "{report}");
    assert!(
        of(&report, "history")
            .note
            .ends_with("in 1 rows, 2 rows not judged"),
        "{report}"
    );
}
