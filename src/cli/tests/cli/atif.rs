//! Trajectories in ATIF: what a trace is afterwards, and what becomes of those of other agents.

use std::{collections::BTreeMap, fs, path::Path};

use reel_import::atif::LOST;
use reel_trace::TraceFiles;
use reel_vectors::round_trip::{self, LostFields};
use serde_json::{Value, json};

use crate::{complaint, expect};

/// What is lost, and the page that lists it.
const LISTED: (&[(&str, &str)], &str) = (LOST, include_str!("../../../../docs/trajectories.md"));

/// Episodes of three policies in `traces`, and a branch of one of them; gives back how many.
pub(crate) fn episodes(folder: &Path) -> usize {
    let count = std::env::var("REEL_ATIF_TASKS").unwrap_or_else(|_| "3".to_owned());
    expect(
        folder,
        0,
        &[
            "task", "generate", "--count", &count, "--seed", "5", "--out", "tasks",
        ],
    );
    for (policy, images) in [
        ("oracle", None),
        ("planner", Some("--no-images")),
        ("wrong-object", Some("--no-images")),
    ] {
        let run = [
            "run", "--tasks", "tasks", "--policy", policy, "--out", "traces",
        ];
        expect(folder, 0, &[&run[..], images.as_slice()].concat());
    }
    let parent = fs::read_dir(folder.join("traces"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path();
    let branch = [
        "branch",
        parent.to_str().unwrap(),
        "--at",
        "1",
        "--policy",
        "oracle",
        "--out",
        "traces/branch.mcap",
    ];
    expect(folder, 0, &branch);
    3 * count.parse::<usize>().unwrap() + 1
}

/// What tells episodes apart whose names are lost: two with equal calls are equal.
fn played(parts: &Value) -> String {
    let calls = parts["steps"].as_array().unwrap().iter();
    let calls: Vec<&Value> = calls.map(|step| &step["input"]["call"]).collect();
    json!([
        parts["task"]["task_id"],
        parts["header"]["policy"]["name"],
        calls
    ])
    .to_string()
}

/// What the traces in `traces` are after they were exported and imported: the lines of the import. Fails where another field is
/// lost than the list says, or one that it says is not.
pub(crate) fn comes_back_but_for_what_is_listed(
    folder: &Path,
    format: &str,
    options: &[&str],
    count: usize,
    (list, page): (&[(&str, &str)], &str),
) -> Vec<Value> {
    let export = ["export", format, "traces", "--out", "documents"];
    let told = expect(folder, 0, &[&export[..], options].concat());
    for (field, what) in list {
        assert!(told.contains(&format!("{field}: {what}")), "{told}");
        assert!(page.contains(&format!("| `{field}` | {what} |")), "{field}");
    }
    let imported = ["import", format, "documents", "--out", "back", "--json"];
    let lines = expect(folder, 0, &imported);
    let lines: Vec<Value> = lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(lines.len(), count);
    let before = fs::read_dir(folder.join("traces")).unwrap();
    let before = before.map(|entry| parts(&entry.unwrap().path()));
    let before: BTreeMap<String, Value> = before.map(|parts| (played(&parts), parts)).collect();
    let mut lost = LostFields::default();
    for told in &lines {
        assert_eq!(told["losses"], json!([]), "{told}");
        let after = parts(&folder.join(told["trace"].as_str().unwrap()));
        lost.compare(&before[&played(&after)], &after);
    }
    let lost = lost.expect_listed(list.iter().map(|(field, _)| *field), &[]);
    println!("{count} episodes come back from {format} but for {lost} listed fields");

    // The traces are like others, and the same again.
    expect(folder, 0, &["ingest", "back", "--store", "store"]);
    let again = ["import", format, "documents", "--out", "again", "--json"];
    for line in expect(folder, 0, &again).lines() {
        let told: Value = serde_json::from_str(line).unwrap();
        let again = folder.join(told["trace"].as_str().unwrap());
        let first = folder.join("back").join(again.file_name().unwrap());
        assert_eq!(fs::read(again).unwrap(), fs::read(first).unwrap());
    }
    lines
}

#[test]
fn a_trace_comes_back_from_a_log_of_inspect() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let count = episodes(folder);
    comes_back_but_for_what_is_listed(folder, "inspect", &[], count, LISTED);
    let mut logs: Vec<String> = fs::read_dir(folder.join("documents"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    logs.sort();
    assert_eq!(
        logs,
        [
            "branch.eval",
            "oracle.eval",
            "planner.eval",
            "wrong-object.eval"
        ]
    );

    // A torn archive, one that is none, and one without a sample.
    let log = fs::read(folder.join("documents/oracle.eval")).unwrap();
    fs::write(folder.join("torn.eval"), &log[..log.len() / 2]).unwrap();
    fs::write(folder.join("none.eval"), "none").unwrap();
    fs::write(folder.join("empty.json"), r#"{"eval": {}, "samples": []}"#).unwrap();
    for (name, why) in [
        ("torn.eval", "not a log of Inspect"),
        ("none.eval", "not a log of Inspect"),
        ("empty.json", "the log has no sample"),
    ] {
        let told = complaint(folder, 2, &["import", "inspect", name, "--out", "bad"]);
        assert!(told.contains(why), "{told}");
    }
    let told = complaint(folder, 2, &["import", "inspect", "tasks", "--out", "bad"]);
    assert!(told.contains("no log of Inspect here"), "{told}");
    let rule = ["import", "inspect", "documents", "--success", "a>=b"];
    assert!(complaint(folder, 2, &rule).contains("give NAME or NAME>=VALUE"));
}

#[test]
fn samples_that_cannot_be_read_count_as_not_imported() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let sample = |id: &str, messages: Value| json!({"id": id, "epoch": 1, "messages": messages});
    let done = json!([{"role": "assistant", "content": "Done."}]);
    let log = json!({
        "eval": {"task": "builds", "model": "some/model"},
        "samples": [sample("a", done.clone()), sample("b", json!([])), sample("c", done)],
    });
    fs::write(folder.join("log.json"), log.to_string()).unwrap();
    let import = ["import", "inspect", "log.json", "--out", "out"];
    let told = expect(folder, 3, &import);
    let counted = "2 of 3 episodes imported into out: 0 of them with losses, 1 not imported";
    assert!(told.contains(counted), "{told}");
    let told = complaint(folder, 3, &import);
    assert!(
        told.contains("not imported: no step can be imported (sample \"b\", epoch 1:"),
        "{told}"
    );
}

#[test]
fn what_a_later_version_of_atif_may_lose_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let document = |version: &str, at: &str| {
        format!(
            r#"{{"schema_version": "{version}", "agent": {{"name": "a", "version": "1"}}, "steps": [
                {{"step_id": 1, "source": "agent", "message": "Now.", "tool_calls": [
                    {{"tool_call_id": "c", "function_name": "seek", "arguments": {{"at": {at}}}}}]}}]}}"#
        )
    };
    for (version, at, code, notes, losses) in [
        ("ATIF-v1.8", "18446744073709551615", 0, "", ""),
        (
            "ATIF-v1.9",
            "1",
            0,
            "version 'ATIF-v1.9' is read as ATIF-v1.8",
            "",
        ),
        (
            "ATIF-v1.7",
            "NaN",
            0,
            "NaN or Infinity are read as null: 1",
            "",
        ),
        (
            "ATIF-v1.7",
            "12345678901234567890123",
            3,
            "",
            "such as 12345678901234567890123",
        ),
    ] {
        fs::write(folder.join("one.json"), document(version, at)).unwrap();
        let import = ["import", "atif", "one.json", "--out", "out", "--json"];
        let told: Value = serde_json::from_str(&expect(folder, code, &import)).unwrap();
        for (name, expected) in [("notes", notes), ("losses", losses)] {
            let told = told[name].to_string();
            assert!(told.contains(expected), "{version}, {at}: {told}");
            assert_eq!(told == "[]", expected.is_empty(), "{version}, {at}: {told}");
        }
    }
}

#[test]
fn a_trace_comes_back_but_for_what_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let count = episodes(folder);
    comes_back_but_for_what_is_listed(folder, "atif", &[], count, LISTED);
    // A document that somebody changed is any agent's.
    let document = fs::read_dir(folder.join("documents"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .find(|path| path.extension().is_some_and(|end| end == "json"))
        .unwrap();
    let mut changed: Value = serde_json::from_slice(&fs::read(document).unwrap()).unwrap();
    // Without its end it broke off, and what was reached until then counts.
    let mut broken_off = changed.clone();
    let ours = broken_off["extra"]["reel"].as_object_mut().unwrap();
    let end = ours.remove("end").unwrap();
    fs::write(
        folder.join("documents/broken_off.json"),
        broken_off.to_string(),
    )
    .unwrap();
    let arguments = [
        "import",
        "atif",
        "documents/broken_off.json",
        "--out",
        "broken",
        "--json",
    ];
    let told: Value = serde_json::from_str(&expect(folder, 0, &arguments)).unwrap();
    assert_eq!(told["end"], "aborted");
    let trace = TraceFiles::default().read(&folder.join(told["trace"].as_str().unwrap()));
    let broken_off = json!(trace.unwrap().end.unwrap());
    assert_eq!(broken_off["graphs"], end["graphs"]);
    fs::remove_file(folder.join("documents/broken_off.json")).unwrap();
    changed["steps"].as_array_mut().unwrap().pop();
    fs::write(folder.join("changed.json"), changed.to_string()).unwrap();
    let arguments = ["import", "atif", "changed.json", "--out", "changed"];
    let told = complaint(folder, 3, &arguments);
    assert!(told.contains("extra.reel does not fit"), "{told}");

    let twin = folder.join("traces/sub");
    fs::create_dir(&twin).unwrap();
    fs::copy(folder.join("traces/branch.mcap"), twin.join("branch.mcap")).unwrap();
    let told = complaint(folder, 2, &["export", "atif", "traces", "--out", "twice"]);
    assert!(told.contains("two traces are called branch"), "{told}");
}

/// Everything of a trace in a file that can be compared.
fn parts(path: &Path) -> Value {
    round_trip::parts(&TraceFiles::default().read(path).unwrap())
}

/// Harbor's models, those of the package `atif`, and Inspect Scout.
#[test]
fn third_party_readers_agree() {
    crate::service::script("formats/trajectories.py", &[]);
}

#[test]
fn what_other_agents_did_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let subagent = json!({
        "schema_version": "ATIF-v1.7", "trajectory_id": "helper", "agent": {"name": "searcher", "version": "1"},
        "steps": [
            {"step_id": 1, "source": "user", "message": "Look it up."},
            {"step_id": 2, "source": "agent", "message": "It is 3.", "llm_call_count": 1},
        ],
    });
    let document = json!({
        "schema_version": "ATIF-v1.7", "session_id": "fix-the-build",
        "agent": {"name": "coder", "version": "2.1", "model_name": "a-model", "extra": null},
        "steps": [
            {"step_id": 1, "source": "system", "message": "You write code."},
            {"step_id": 2, "source": "user", "message": [{"type": "text", "text": "Mend the build."}]},
            {"step_id": 3, "source": "agent", "message": "old", "is_copied_context": true},
            {"step_id": 4, "source": "agent", "message": "Two looks.", "reasoning_content": "Where is it?",
             "tool_calls": [
                {"tool_call_id": "a", "function_name": "bash", "arguments": {"command": "ls"}},
                {"tool_call_id": "b", "function_name": "pick", "arguments": {"marker_id": 7}},
             ],
             "observation": {"results": [
                {"source_call_id": "b", "content": "No marker with id 7."},
                {"source_call_id": "a", "content": [
                    {"type": "text", "text": "Makefile"},
                    {"type": "image", "source": {"media_type": "image/png", "path": "https://example.org/a.png"}},
                ]},
             ]},
             "metrics": {"prompt_tokens": 10, "completion_tokens": 5, "cost_usd": 0.1}},
            {"step_id": 5, "source": "user", "message": "And the tests?"},
            {"step_id": 6, "source": "agent", "message": "All pass."},
        ],
        "subagent_trajectories": [subagent],
    });
    fs::write(folder.join("one.json"), document.to_string()).unwrap();
    // Folders of jobs hold other files, too.
    fs::write(folder.join("config.json"), "{}").unwrap();
    let lines = expect(
        folder,
        3,
        &["import", "atif", ".", "--out", "out", "--json"],
    );
    let told: Vec<Value> = lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    assert_eq!(told.len(), 2, "{lines}");
    let losses = told[0]["losses"].to_string();
    assert!(
        losses.contains("step 4: image https://example.org/a.png is left out"),
        "{losses}"
    );
    assert!(
        told[0]["notes"].to_string().contains("step 3 is copied"),
        "{lines}"
    );
    let trace = TraceFiles::default()
        .read(&folder.join(told[0]["trace"].as_str().unwrap()))
        .unwrap();
    assert_eq!(trace.task.instruction, "Mend the build.");
    assert_eq!(trace.header.policy.name, "coder");
    assert_eq!(trace.header.policy.parameters["model"], "a-model");
    assert_eq!(
        trace.header.policy.parameters["system_prompt"],
        "You write code."
    );
    let calls: Vec<&str> = trace
        .steps
        .iter()
        .map(|step| step.input.call.name.as_str())
        .collect();
    assert_eq!(calls, ["bash", "pick", "message"]);
    let said = trace.steps[0].input.policy.as_ref().unwrap();
    assert_eq!(
        (said.raw.as_str(), said.reasoning.as_str(), said.tokens),
        ("Two looks.", "Where is it?", Some([10, 5]))
    );
    assert_eq!(trace.steps[0].outcome.text, "Makefile");
    assert_eq!(
        trace.steps[1].outcome.text,
        "No marker with id 7.\nAnd the tests?"
    );
    assert_eq!(
        trace.steps[2].input.policy.as_ref().unwrap().raw,
        "All pass."
    );
    assert_eq!(trace.end.unwrap().success(&trace.task), None);
    assert!(!trace.task.has_goal());
    expect(folder, 0, &["ingest", "out", "--store", "store"]);
    let replayed = expect(folder, 1, &["replay", "out"]);
    assert!(replayed.contains("nothing to re-execute"), "{replayed}");

    // Equal documents at once are one episode, and nothing unfinished stays.
    for number in 0..12 {
        let copy = folder.join(format!("copies/{number}/trajectory.json"));
        fs::create_dir_all(copy.parent().unwrap()).unwrap();
        fs::write(copy, subagent.to_string()).unwrap();
    }
    let many = ["import", "atif", "copies", "--out", "one", "--jobs", "4"];
    let told = expect(folder, 0, &many);
    assert!(told.contains("12 of 12 episodes imported"), "{told}");
    assert_eq!(fs::read_dir(folder.join("one")).unwrap().count(), 1);

    // What other libraries may write, and nothing that is read without end.
    let mut odd = subagent.clone();
    odd["steps"][1]["message"] =
        json!([{"type": "image", "source": {"media_type": "image/png", "path": "/dev/zero"}}]);
    odd["steps"][1]["metrics"] =
        json!({"prompt_tokens": "12", "completion_tokens": -1, "logprobs": [null, -0.5]});
    odd["subagent_trajectories"] = json!([
        {"schema_version": "ATIF-v1.7", "trajectory_id": "a", "agent": {"name": "idle", "version": "1"},
         "steps": [{"step_id": 1, "source": "user", "message": "Wait."}]},
    ]);
    fs::write(folder.join("odd.json"), odd.to_string()).unwrap();
    let told = complaint(folder, 3, &["import", "atif", "odd.json", "--out", "odd"]);
    assert!(
        told.contains("image /dev/zero is left out: it lies outside of the document's folder"),
        "{told}"
    );
    assert!(
        told.contains("not imported: no step can be imported"),
        "{told}"
    );

    for (text, expected) in [
        (
            r#"{"schema_version": "ATIF-v2.0", "agent": {"name": "a", "version": "1"}, "steps": []}"#,
            "version 'ATIF-v2.0' is not read",
        ),
        (
            r#"{"schema_version": "ATIF-v1.7", "agent": {"name": "a", "version": "1"}, "steps": []}"#,
            "the agent does nothing in it",
        ),
        (
            r#"{"schema_version": "ATIF-v1.7", "steps": []}"#,
            "missing field `agent`",
        ),
        (
            r#"{"schema_version": "ATIF-v1.7", "agent""#,
            "not a trajectory of ATIF",
        ),
    ] {
        fs::write(folder.join("bad.json"), text).unwrap();
        let told = complaint(folder, 2, &["import", "atif", "bad.json", "--out", "out"]);
        assert!(
            told.contains(expected) && told.contains("bad.json"),
            "{told}"
        );
    }
    // In a folder, too, none is passed over in silence.
    fs::create_dir(folder.join("mixed")).unwrap();
    fs::write(folder.join("mixed/a.json"), subagent.to_string()).unwrap();
    let later =
        r#"{"schema_version": "ATIF-v2.0", "agent": {"name": "a", "version": "1"}, "steps": []}"#;
    fs::write(folder.join("mixed/b.json"), later).unwrap();
    let told = complaint(
        folder,
        3,
        &["import", "atif", "mixed", "--out", "mixed-out"],
    );
    assert!(
        told.contains("version 'ATIF-v2.0' is not read") && told.contains("b.json"),
        "{told}"
    );
    fs::create_dir(folder.join("empty")).unwrap();
    let told = complaint(folder, 2, &["import", "atif", "empty"]);
    assert!(told.contains("no trajectory of ATIF here"), "{told}");
}
