//! REAL's evaluation client: ours against `eval_client.json`, and what it writes read back.

use std::{collections::BTreeMap, fs, path::Path};

use reel_import::{
    eval_client::{
        Content, Decision, EvalDriver, EvalError, RunSettings, Stop, ToolResult, is_success,
        model_slug, path_component, run, world_graph,
    },
    import,
};
use reel_trace::Trace;
use reel_vectors::{Report, items, load, text};
use reel_world::record::EndReason;
use serde_json::{Map, Value, json};

const FILE: &str = "eval_client.json";
const TAG: &str = "20260102_030405_000006";
/// A PNG image of 2 x 2 pixels, in Base64.
const IMAGE: &str =
    "iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAIAAAD91JpzAAAAC0lEQVR4nGNgQAYAAA4AAamRc7EAAAAASUVORK5CYII=";

fn content(item: &Value) -> Content {
    if item.get("type").is_none() {
        return Content::Text(item.to_string());
    }
    match text(&item["type"]) {
        "image" => Content::Image(item.get("data").map_or(IMAGE, text).to_owned()),
        "text" => Content::Text(match item.get("debug") {
            Some(Value::String(debug)) => format!("Debug Info:\n{debug}"),
            Some(debug) => format!("Debug Info:\n{debug}"),
            None => text(&item["text"]).to_owned(),
        }),
        _ => Content::Other,
    }
}

fn map(value: &Value) -> &Map<String, Value> {
    value.as_object().unwrap()
}

#[test]
fn names_of_folders() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "path");
    for case in items(&document["path"]) {
        report.compare(
            &case["value"].to_string(),
            &case["path"],
            &json!(path_component(&case["value"])),
        );
    }
    report.finish();
    let mut report = Report::new(FILE, "slug");
    for case in items(&document["slug"]) {
        report.compare(
            text(&case["model"]),
            &case["slug"],
            &json!(model_slug(text(&case["model"]))),
        );
    }
    report.finish();
}

#[test]
fn results_and_scores() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "parse");
    for (index, case) in items(&document["parse"]).iter().enumerate() {
        let items: Vec<Content> = items(&case["content"]).iter().map(content).collect();
        let result = ToolResult::of(&items);
        let shown = |image: &String| {
            if image == IMAGE {
                "⟦image 0⟧".to_owned()
            } else {
                image.clone()
            }
        };
        let ours = json!({
            "content": case["content"],
            "result_type": if result.text.is_some() { "text" } else { "image" },
            "data": result.text.clone().or_else(|| result.images.first().map(shown)),
            "debug": result.debug,
            "images": result.images.len(),
        });
        report.compare(&index.to_string(), case, &ours);
    }
    report.finish();
    let mut report = Report::new(FILE, "graph");
    for case in items(&document["graph"]) {
        report.compare(
            &case["debug"].to_string(),
            &case["graph"],
            &json!(world_graph(map(&case["debug"]))),
        );
    }
    report.finish();
    let mut report = Report::new(FILE, "evaluate");
    for (index, case) in items(&document["evaluate"]).iter().enumerate() {
        report.compare(
            &index.to_string(),
            &case["success"],
            &json!(is_success(&case["actual"], &case["target"])),
        );
    }
    report.finish();
}

/// A server and an agent that say what a run of the vectors says.
struct Scripted<'a> {
    tools: Vec<String>,
    finish: std::slice::Iter<'a, Value>,
    results: std::slice::Iter<'a, Value>,
    episodes: std::slice::Iter<'a, Value>,
    decisions: std::slice::Iter<'a, Value>,
    calls: Vec<Value>,
    observed: Vec<Vec<Value>>,
}

impl EvalDriver for Scripted<'_> {
    fn tools(&mut self) -> Vec<String> {
        self.tools.clone()
    }

    fn call(&mut self, tool: &str, args: &Value) -> Result<Vec<Content>, String> {
        self.calls.push(json!([tool, args]));
        let answers = if tool == "finish" {
            &mut self.finish
        } else {
            &mut self.results
        };
        match answers.next().expect("the script has an answer") {
            Value::String(raised) => Err(raised.clone()),
            result => Ok(items(result).iter().map(content).collect()),
        }
    }

    fn begin(&mut self, _task: &Map<String, Value>) {
        // Episodes that are skipped have an empty list.
        self.decisions = self
            .episodes
            .find(|decisions| !items(decisions).is_empty())
            .map_or([].iter(), |list| items(list).iter());
        self.observed.push(Vec::new());
    }

    fn decide(&mut self) -> Result<Decision, Stop> {
        let decision = self.decisions.next().expect("the script has a decision");
        if decision == "raise" {
            return Err(Stop::Failed("raised".to_owned()));
        }
        let raw = decision.get(2).cloned().unwrap_or(json!("raw text"));
        let tool = decision[0].as_str().map(str::to_owned);
        Ok(Decision {
            tool,
            args: decision[1].clone(),
            raw: Some(raw),
            user_message: None,
            seconds: 0.25,
        })
    }

    fn observe(&mut self, _tool: &str, result: &ToolResult) {
        let kind = if result.text.is_some() {
            "text"
        } else {
            "image"
        };
        let shown = result.text.as_ref().or(result.images.first());
        self.observed
            .last_mut()
            .unwrap()
            .push(json!([kind, shown, result.images.len()]));
    }
}

/// A run of the vectors into a folder.
fn play<'a>(case: &'a Value, out: &Path) -> (Result<Value, EvalError>, Scripted<'a>) {
    let config = map(&case["config"]);
    let number = |key: &str, otherwise: i64| {
        config
            .get(key)
            .map_or(otherwise, |value| value.as_i64().unwrap())
    };
    let settings = RunSettings {
        out: out.to_owned(),
        model: "org/My-Model.v1".to_owned(),
        prefix: "agent".to_owned(),
        steps_max: u32::try_from(number("max_steps", 5)).unwrap(),
        start_idx: number("start_idx", 0),
        end_idx: number("end_idx", 999_999),
        metadata: Map::new(),
        run_tag: TAG.to_owned(),
    };
    let tools = if case["id"] == "no-finish-tool" {
        &["pick"][..]
    } else {
        &["pick", "finish"]
    };
    let mut script = Scripted {
        tools: tools.iter().map(|tool| (*tool).to_owned()).collect(),
        finish: items(&case["finish"]).iter(),
        results: items(&case["results"]).iter(),
        episodes: items(&case["decisions"]).iter(),
        decisions: [].iter(),
        calls: Vec::new(),
        observed: Vec::new(),
    };
    if let Some(existing) = case["existing"].as_str() {
        fs::create_dir_all(out.join(existing)).unwrap();
        fs::write(out.join(existing).join("x"), "x").unwrap();
    }
    (run(&settings, &mut script), script)
}

#[test]
fn whole_runs() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "runs");
    for case in items(&document["runs"]) {
        let folder = tempfile::tempdir().unwrap();
        let (result, script) = play(case, folder.path());
        let mut files = Map::new();
        for (path, bytes) in files_of(folder.path()) {
            files.insert(path.replace(TAG, "⟦time⟧"), shown(&path, &bytes));
        }
        let mut ours = json!({
            "calls": script.calls,
            // The published client raises a RuntimeError where ours fails.
            "raises": result.err().map(|_| "RuntimeError"),
            "files": files,
        });
        let mut expected =
            json!({ "calls": case["calls"], "raises": case["raises"], "files": case["files"] });
        // An episode that is skipped never begins, and observes nothing.
        let observed = |lists: &[Value]| -> Vec<Value> {
            lists
                .iter()
                .filter(|list| !items(list).is_empty())
                .cloned()
                .collect()
        };
        expected["observed"] = json!(observed(items(&case["observed"])));
        let seen: Vec<Value> = script.observed.iter().map(|list| json!(list)).collect();
        ours["observed"] = json!(observed(&seen));
        // Files in any order, the keys of each in the published one.
        report.count(text(&case["id"]), same_files(&expected, &ours));
    }
    report.finish();
}

/// Where two runs differ.
fn same_files(expected: &Value, ours: &Value) -> Option<String> {
    let names = |run: &Value| {
        map(&run["files"])
            .keys()
            .cloned()
            .collect::<std::collections::BTreeSet<_>>()
    };
    if names(expected) != names(ours) {
        return Some(format!(
            "expected the files {:?}, found {:?}",
            names(expected),
            names(ours)
        ));
    }
    let order = reel_vectors::KeyOrder::Same;
    let of_file = |name: &String| {
        let (one, other) = (
            &expected["files"][name.as_str()],
            &ours["files"][name.as_str()],
        );
        reel_vectors::difference(one, other, order).map(|difference| format!("{name}{difference}"))
    };
    let of_key = |key: &str| {
        reel_vectors::difference(&expected[key], &ours[key], order)
            .map(|found| format!("{key}{found}"))
    };
    ["calls", "raises", "observed"]
        .into_iter()
        .find_map(of_key)
        .or_else(|| names(expected).iter().find_map(of_file))
}

/// A file as the vectors show it.
fn shown(path: &str, bytes: &[u8]) -> Value {
    let name = path.rsplit('/').next().unwrap();
    if name.ends_with(".png") {
        assert!(bytes.starts_with(b"\x89PNG"));
        return json!("⟦png⟧");
    }
    if name.ends_with("_error.txt") {
        return json!("⟦traceback⟧");
    }
    let text = String::from_utf8(bytes.to_vec()).unwrap();
    if !name.ends_with(".json") {
        return json!(text);
    }
    let mut value: Value = serde_json::from_str(&text).unwrap();
    hide_times(&mut value);
    value
}

fn hide_times(value: &mut Value) {
    match value {
        Value::Object(entries) => {
            for (key, value) in entries {
                match key.as_str() {
                    "inference_time" | "total_inference_time" if value.is_f64() => {
                        *value = json!(format!("⟦{key}⟧"))
                    }
                    "run_tag" => *value = json!("⟦run_tag⟧"),
                    _ => hide_times(value),
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(hide_times),
        _ => {}
    }
}

/// Every file below a folder.
fn files_of(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path
                    .strip_prefix(root)
                    .unwrap()
                    .to_str()
                    .unwrap()
                    .to_owned();
                files.insert(name, fs::read(&path).unwrap());
            }
        }
    }
    files
}

#[test]
fn runs_read_back() {
    let Some(document) = load(FILE) else { return };
    let mut report = Report::new(FILE, "runs read back");
    let mut differing = Vec::new();
    for case in items(&document["runs"]) {
        let folder = tempfile::tempdir().unwrap();
        let (root, out) = (
            folder.path().join("eval_output"),
            folder.path().join("traces"),
        );
        fs::create_dir_all(&root).unwrap();
        fs::create_dir_all(&out).unwrap();
        let _ = play(case, &root);
        for (path, bytes) in files_of(&root)
            .iter()
            .filter(|(path, _)| path.ends_with("episode_summary.json"))
        {
            let episode = root.join(path).parent().unwrap().to_owned();
            let summary: Value = serde_json::from_slice(bytes).unwrap();
            let calls: Vec<Value> = (0..)
                .map(|step| episode.join(format!("step_{step:03}/tool_call.json")))
                .map_while(|call| serde_json::from_slice(&fs::read(call).ok()?).ok())
                .collect();
            let imported =
                import(&episode, &out, &crate::PLAIN).unwrap_or_else(|error| panic!("{error}"));
            let trace = Trace::read(&imported.trace).unwrap();
            let read = trace.steps.iter().map(|step| {
                let name = &step.input.call.name;
                json!({ "tool_name": (!name.is_empty()).then_some(name), "args": step.input.call.arguments })
            });
            let ends = match imported.end {
                EndReason::Finished => "finished",
                EndReason::Horizon => "max_steps_reached",
                EndReason::Fault if text(&summary["status"]).ends_with("_error") => {
                    text(&summary["status"])
                }
                other => panic!("{path}: {other:?}"),
            };
            // The client's success differs from ours where the goal is more than the target at its
            // destination, which the files do not say, and where it was reached without a `finish`.
            // A note says so.
            let differs = imported
                .notes
                .iter()
                .any(|note| note.starts_with("the agent's summary says success"));
            if differs {
                differing.push(text(&case["id"]));
            }
            let success = if differs {
                summary["success"].clone()
            } else {
                json!(imported.success)
            };
            let ours =
                json!({ "calls": read.collect::<Vec<_>>(), "status": ends, "success": success });
            let expected = json!({ "calls": calls, "status": summary["status"], "success": summary["success"] });
            report.compare(&format!("{} {path}", text(&case["id"])), &expected, &ours);
        }
    }
    report.finish();
    assert_eq!(differing, ["door", "initial-graph", "max-steps"]);
}
