//! Open vocabulary from outside: vectors from a file decide what a search means, and what the word
//! list does not know is counted.

use std::{fs, path::Path, process::Command, thread, time::Duration};

use reel_trace::Trace;
use serde_json::{Value, json};

use crate::{
    complaint,
    endpoint::answering,
    expect,
    stdio_client::{StdioClient, traces},
};

#[test]
fn an_agent_from_outside_is_served_by_the_same_vectors() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 1 --seed 35 --out tasks");
    reel!(folder, "run --tasks tasks --no-images --out traces");
    let oracle = only(&folder.join("traces"));
    let categories: Vec<&str> = oracle
        .task
        .objects
        .iter()
        .map(|object| object.category.as_str())
        .collect();
    let target = &oracle.task.object(&oracle.task.target).unwrap().category;
    let mut vectors: serde_json::Map<String, Value> = categories
        .iter()
        .map(|category| ((*category).to_owned(), json!([1, 0])))
        .collect();
    vectors.insert(target.clone(), json!([0, 1]));
    vectors.insert("gizmo".to_owned(), json!([0.1, 2]));
    fs::write(
        folder.join("vectors.json"),
        Value::Object(vectors).to_string(),
    )
    .unwrap();
    fs::write(
        folder.join("serve.toml"),
        "[play]\ntasks = \"tasks\"\nmatcher = { vectors = \"vectors.json\" }\n",
    )
    .unwrap();

    let by_flag = ["--tasks", "tasks", "--embedding-vectors", "vectors.json"];
    let by_file = ["--config", "serve.toml"];
    for (name, arguments) in [("flag", &by_flag[..]), ("file", &by_file)] {
        let arguments = [arguments, &["--data", name]].concat();
        let mut client = StdioClient::start(folder, &arguments);
        let search = |word: &str| json!({"target_category": word});
        // Before an episode runs there is nothing to look up.
        client.call("show_object_by_category", &search("gizmo"));
        client.call("finish", &json!({}));
        client.call("show_object_by_category", &search("gizmo"));
        // A word without a vector means nothing, and the call counts.
        let (text, failed) = client.call("show_object_by_category", &search("gadget"));
        assert!(
            failed && text.contains("No object matching 'gadget'"),
            "{text}"
        );
        client.leave();
        let trace = only(&folder.join(name).join("traces"));
        let steps = &trace.steps;
        assert_eq!(steps.len(), 2);
        let lookup = steps[0].input.lookup.as_ref().unwrap();
        assert_eq!(
            (&lookup.categories[..], lookup.source.as_str()),
            (&[target.clone()][..], "vectors.json")
        );
        let path = trace.path.display();
        assert!(reel!(folder, "replay {path}").contains("exact"));
    }
    fs::write(folder.join("vectors.json"), "[]").unwrap();
    let text = complaint(folder, 2, "mcp --config serve.toml --data none");
    assert!(text.contains("must be one JSON object"), "{text}");
}

#[test]
fn a_search_that_an_endpoint_does_not_answer_is_not_done() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 35 --out tasks");
    let none = "http://127.0.0.1:9/v1";
    let arguments = [
        "--tasks",
        "tasks",
        "--data",
        "data",
        "--embedding-model",
        "m",
        "--endpoint",
        none,
    ];
    for profile in ["paper", "real-gspo"] {
        let mut client =
            StdioClient::start(folder, &[&arguments[..], &["--profile", profile]].concat());
        client.call("finish", &json!({}));
        let name = if profile == "paper" {
            "show_object_by_category"
        } else {
            "find_objects"
        };
        let (text, failed) = client.call(name, &json!({"target_category": "mug"}));
        assert!(text.contains("cannot be looked up now"), "{text}");
        assert!(
            !text.contains("127.0.0.1"),
            "an address is no business of an agent: {text}"
        );
        // The trainer takes an error of the protocol for a broken connection.
        assert_eq!(failed, profile == "paper");
        client.leave();
    }
    let traces = traces(&folder.join("data/traces"));
    assert_eq!(traces.len(), 2);
    assert!(traces.iter().all(|trace| trace.steps.is_empty()));
}

/// An endpoint of vectors that takes its time.
fn slow_embeddings() -> String {
    answering(|request| {
        let texts = request["input"].as_array().unwrap().len();
        thread::sleep(Duration::from_millis(1500));
        json!({"data": vec![json!({"embedding": [1.0, 2.0]}); texts]})
    })
}

fn only(folder: &Path) -> Trace {
    let mut traces = traces(folder);
    assert_eq!(traces.len(), 1);
    traces.remove(0)
}

#[test]
fn a_search_is_not_done_in_the_next_episode() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 35 --out tasks");
    // The `finish` that is sent behind the search overtakes it.
    let url = slow_embeddings();
    let arguments = [
        "--tasks",
        "tasks",
        "--data",
        "data",
        "--embedding-model",
        "m",
        "--endpoint",
        &url,
    ];
    let mut client = StdioClient::start(folder, &arguments);
    client.call("finish", &json!({}));
    let search =
        json!({"name": "show_object_by_category", "arguments": {"target_category": "mug"}});
    let finish = json!({"name": "finish", "arguments": {}});
    for (id, params) in [(100, search), (101, finish)] {
        // Calls that are sent at the same time have no order.
        thread::sleep(Duration::from_millis(300));
        client
            .write(&json!({"jsonrpc": "2.0", "id": id, "method": "tools/call", "params": params}));
    }
    let search = client.answer(100).to_string();
    assert!(
        search.contains("or the episode ended, while this one waited"),
        "{search}"
    );
    client.leave();
    let all = traces(&folder.join("data/traces"));
    let mut calls = all.iter().flat_map(|trace| &trace.steps);
    assert!(calls.all(|step| step.tool_name() == "finish"));
}

#[test]
fn vectors_of_a_file_decide_and_replay_needs_no_file() {
    let Some(python) = reel_vectors::python("json") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let tasks = if reel_vectors::is_long() { 30 } else { 20 };
    reel!(folder, "task draw --count {tasks} --seed 35 --out tasks");
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/vocabulary/argmax.py");
    let done = Command::new(python)
        .arg(script)
        .args([env!("CARGO_BIN_EXE_reel"), "tasks", "."])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(
        done.status.success(),
        "{}{}",
        String::from_utf8_lossy(&done.stdout),
        String::from_utf8_lossy(&done.stderr)
    );

    // A word without a vector means nothing, which is counted.
    fs::write(folder.join("few.json"), r#"{"mug": [1, 0]}"#).unwrap();
    reel!(
        folder,
        "run --tasks tasks --no-images --embedding-vectors few.json --out few"
    );
    reel!(folder, "ingest few --store few-store");
    let rows = expect(
        folder,
        0,
        "query --store few-store --named vocabulary_misses --format json",
    );
    assert!(rows.contains(r#""source":"few.json""#), "{rows}");
    for (flags, reason) in [
        ("--min-similarity 0.9", "need --embedding-model"),
        (
            "--embedding-vectors few.json --min-similarity nan",
            "is a cosine from -1 to 1",
        ),
        (
            "--embedding-vectors few.json --match-rule best --min-similarity 0.5",
            "leave one out",
        ),
    ] {
        let command = format!("run --tasks tasks --out short {flags}");
        let text = complaint(folder, 2, &command);
        assert!(text.contains(reason), "{flags}: {text}");
    }
}

#[test]
fn a_word_that_the_list_does_not_know_is_a_counted_miss() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 2 --seed 35 --out tasks");
    reel!(folder, "run --tasks tasks --no-images --out traces");
    let trace = fs::read_dir(folder.join("traces"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .min()
        .unwrap();
    let search = |word: &str| {
        format!(
            r#"{{"name": "show_object_by_category", "arguments": {{"target_category": "{word}"}}}}"#
        )
    };
    let calls = [search("Flibbertigibbet"), search("striped mug")].join("\n");
    fs::write(folder.join("calls.jsonl"), calls).unwrap();
    let trace = trace.display();
    reel!(
        folder,
        "branch {trace} --at 1 --calls calls.jsonl --out traces/branch.mcap"
    );
    reel!(folder, "ingest traces --store store");
    let rows = expect(
        folder,
        0,
        "query --store store --named vocabulary_misses --format json",
    );
    let rows: Vec<Value> = serde_json::from_str(&rows).unwrap();
    assert_eq!(rows.len(), 1, "{rows:?}");
    assert_eq!(
        (&rows[0]["query"], &rows[0]["calls"], &rows[0]["failed"]),
        (&"flibbertigibbet".into(), &1.into(), &1.into())
    );
}
