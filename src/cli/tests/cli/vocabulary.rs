//! Open vocabulary from outside: vectors from a file decide what a search means, and what the word
//! list does not know is counted.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, Command, Stdio},
};

use reel_trace::Trace;
use serde_json::{Value, json};

use crate::{complaint, expect};

/// `reel mcp`, and a client that speaks to it over standard input and output.
struct StdioClient {
    server: Child,
    answers: BufReader<std::process::ChildStdout>,
    sent: u64,
}

impl StdioClient {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut server = Command::new(env!("CARGO_BIN_EXE_reel"))
            .current_dir(folder)
            .arg("mcp")
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let answers = BufReader::new(server.stdout.take().unwrap());
        let mut client = Self {
            server,
            answers,
            sent: 0,
        };
        let hello = json!({
            "protocolVersion": "2025-06-18", "capabilities": {},
            "clientInfo": {"name": "test", "version": "1"},
        });
        client.request("initialize", &hello);
        client.write(&json!({"jsonrpc": "2.0", "method": "notifications/initialized"}));
        client
    }

    fn write(&mut self, message: &Value) {
        let input = self.server.stdin.as_mut().unwrap();
        writeln!(input, "{message}").unwrap();
    }

    fn request(&mut self, method: &str, params: &Value) -> Value {
        self.sent += 1;
        let id = self.sent;
        self.write(&json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params}));
        loop {
            let mut line = String::new();
            assert!(self.answers.read_line(&mut line).unwrap() > 0, "it ended");
            let answer: Value = serde_json::from_str(&line).unwrap();
            if answer["id"] == id {
                return answer["result"].clone();
            }
        }
    }

    /// The text of a tool's result, and whether it is an error.
    fn call(&mut self, name: &str, arguments: &Value) -> (String, bool) {
        let result = self.request("tools/call", &json!({"name": name, "arguments": arguments}));
        let contents = result["content"].as_array().unwrap().iter();
        let text = contents
            .filter_map(|content| content["text"].as_str())
            .collect();
        (text, result["isError"] == true)
    }

    /// Goes away, and waits for the server to end.
    fn leave(mut self) {
        drop(self.server.stdin.take());
        assert!(self.server.wait().unwrap().success());
    }
}

#[test]
fn an_agent_from_outside_is_served_by_the_same_vectors() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 1 --seed 35 --out tasks");
    reel!(folder, "run --tasks tasks --no-images --out traces");
    let oracle = Trace::read(&only_trace(&folder.join("traces"))).unwrap();
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
        let (text, failed) = client.call("show_object_by_category", &search("gadget"));
        assert!(failed && text.contains("cannot be looked up"), "{text}");
        assert!(!text.contains("vectors.json"), "{text}");
        client.leave();
        let trace = only_trace(&folder.join(name).join("traces"));
        let steps = Trace::read(&trace).unwrap().steps;
        assert_eq!(steps.len(), 1, "what could not be looked up was not done");
        let lookup = steps[0].input.lookup.as_ref().unwrap();
        assert_eq!(
            (&lookup.categories[..], lookup.source.as_str()),
            (&[target.clone()][..], "vectors.json")
        );
        let trace = trace.display();
        assert!(reel!(folder, "replay {trace}").contains("exact"));
    }
    fs::write(folder.join("vectors.json"), "[]").unwrap();
    let text = complaint(folder, 2, "mcp --config serve.toml --data none");
    assert!(text.contains("must be one JSON object"), "{text}");
}

fn only_trace(folder: &Path) -> std::path::PathBuf {
    let mut paths = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    paths
        .find(|path| path.extension().is_some_and(|it| it == "mcap"))
        .unwrap()
}

#[test]
fn vectors_of_a_file_decide_and_replay_needs_no_file() {
    let Some(python) = reel_vectors::python("json") else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    reel!(folder, "task draw --count 30 --seed 35 --out tasks");
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

    // A search for a word without a vector ends the episode, and says what is missing.
    fs::write(folder.join("vectors.json"), r#"{"mug": [1, 0]}"#).unwrap();
    let text = complaint(
        folder,
        1,
        "run --tasks tasks --embedding-vectors vectors.json --out short",
    );
    assert!(text.contains("vectors.json has no vector of "), "{text}");
    let text = complaint(
        folder,
        2,
        "run --tasks tasks --min-similarity 0.9 --out short",
    );
    assert!(text.contains("need --embedding-model"), "{text}");
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
