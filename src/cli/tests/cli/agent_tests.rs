//! `reel test`: agents against recordings, as policies and as commands, with their reports.

use std::{fs, path::Path};

use reel_trace::Trace;
use serde_json::{Value, json};

use crate::{
    expect, reel,
    stdio_client::{StdioClient, traces},
};

/// An agent that speaks MCP over Streamable HTTP: it makes the calls of a file, or those that its
/// arguments leave of them.
const AGENT: &str = r#"
import json, os, sys, urllib.request

url, calls, count = os.environ["REEL_MCP_URL"], json.load(open(sys.argv[1])), int(sys.argv[2])
assert url == sys.argv[3] and os.environ["REEL_SSE_URL"].endswith("/sse")
headers = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}

def post(method, params=None, number=None):
    message = {"jsonrpc": "2.0", "method": method, **({} if number is None else {"id": number, "params": params})}
    request = urllib.request.Request(url, json.dumps(message).encode(), headers)
    with urllib.request.urlopen(request) as answer:
        headers.setdefault("Mcp-Session-Id", answer.headers.get("Mcp-Session-Id"))
        answer.read()

client = {"name": "agent", "version": "1"}
post("initialize", {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": client}, 1)
post("notifications/initialized")
post("tools/call", {"name": "finish", "arguments": {}}, 2)
for number, call in enumerate(calls[:count]):
    post("tools/call", call, number + 3)
"#;

/// A server without tools around episodes, which is slow enough for calls that are made at once.
const SERVER: &str = r#"
import json, sys, time

for line in sys.stdin:
    message = json.loads(line)
    if "id" not in message:
        continue
    if message["method"] == "initialize":
        server = {"name": "files", "version": "1"}
        result = {"protocolVersion": "2025-06-18", "capabilities": {"tools": {}}, "serverInfo": server}
    else:
        time.sleep(0.1)
        result = {"content": [{"type": "text", "text": message["params"]["arguments"]["name"]}]}
    print(json.dumps({"jsonrpc": "2.0", "id": message["id"], "result": result}), flush=True)
"#;

/// The recording of a server without `finish`: three calls at once, and one after their results.
fn recorded_at_once(folder: &Path) -> Trace {
    fs::write(folder.join("server.py"), SERVER).unwrap();
    let record = [
        "record",
        "--out",
        "files",
        "--stdio",
        "--",
        "python3",
        "server.py",
    ];
    let mut client = StdioClient::start_command(folder, &record);
    let at_once = [(10, "a"), (11, "b"), (12, "c")];
    for (id, name) in at_once {
        let params = json!({"name": "read", "arguments": {"name": name}});
        client
            .write(&json!({"jsonrpc": "2.0", "id": id, "method": "tools/call", "params": params}));
    }
    for (id, _) in at_once {
        client.answer(id);
    }
    client.call("read", &json!({"name": "last"}));
    client.leave();
    traces(&folder.join("files")).remove(0)
}

/// The recordings of a policy over some tasks.
fn recorded(folder: &Path, policy: &str) -> Vec<Trace> {
    expect(folder, 0, "task generate --count 2 --seed 9 --out tasks");
    let run = format!("run --tasks tasks --policy {policy} --out traces");
    expect(folder, 0, &run);
    traces(&folder.join("traces"))
}

/// The results that `--json` prints, and the exit code.
fn tested(folder: &Path, arguments: &[&str]) -> (Vec<Value>, Option<i32>) {
    let output = reel(folder, &[&["test", "--json"], arguments].concat()[..]);
    let text = String::from_utf8(output.stdout).unwrap();
    let lines = text.lines().map(|line| serde_json::from_str(line).unwrap());
    (lines.collect(), output.status.code())
}

#[test]
fn a_policy_passes_its_own_recordings_and_another_fails_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    recorded(folder, "planner");
    let against = ["--against", "traces"];
    let test =
        |agent: &str, more: &[&str]| tested(folder, &[&[agent], &against[..], more].concat());
    let (same, code) = test("planner", &["--junit", "passed.xml"]);
    assert_eq!((same.len(), code), (2, Some(0)), "{same:?}");
    assert!(
        same.iter().all(|case| case["status"] == "passed"),
        "{same:?}"
    );
    let passed = fs::read_to_string(folder.join("passed.xml")).unwrap();
    assert!(
        passed.contains(r#"tests="2""#) && !passed.contains("<failure"),
        "{passed}"
    );
    let (other, code) = test("oscillating", &["--outcome", "--junit", "failed.xml"]);
    assert_eq!(code, Some(1), "{other:?}");
    let failed = fs::read_to_string(folder.join("failed.xml")).unwrap();
    assert!(failed.contains("<failure"), "{failed}");
    for case in &other {
        assert_eq!(case["success"], false, "{case}");
        let step = format!("call {}: ", case["deviation"]["step"]);
        assert!(failed.contains(&step), "{step}, {failed}");
    }
    // Another way to the goal counts with --outcome alone.
    let (other_way, code) = test("oracle", &["--outcome"]);
    assert_eq!(code, Some(0), "{other_way:?}");
    assert!(
        other_way.iter().all(|case| case["success"] == true),
        "{other_way:?}"
    );
    assert_eq!(test("oracle", &[]).1, Some(1));
}

#[test]
fn a_command_is_tested_over_mcp() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let traces = recorded(folder, "planner");
    let trace = &traces[0];
    fs::write(folder.join("agent.py"), AGENT).unwrap();
    let mut calls: Vec<Value> = trace
        .steps
        .iter()
        .map(|step| json!(step.input.call))
        .collect();
    let write =
        |calls: &[Value]| fs::write(folder.join("calls.json"), json!(calls).to_string()).unwrap();
    write(&calls);
    let path = trace.path.to_str().unwrap();
    let all = calls.len().to_string();
    let test = |count: &str| {
        let agent = ["--", "python3", "agent.py", "calls.json", count, "{url}"];
        let (cases, code) = tested(
            folder,
            &[&["--against", path, "--branches", "off"], &agent[..]].concat(),
        );
        (cases[0].clone(), code)
    };
    let (case, code) = test(&all);
    assert_eq!(
        (&case["status"], code),
        (&json!("passed"), Some(0)),
        "{case}"
    );
    let (case, code) = test("2");
    assert_eq!(code, Some(1), "{case}");
    assert_eq!(case["deviation"]["kind"], "missing_call", "{case}");
    assert_eq!(case["deviation"]["step"], 2, "{case}");
    assert_eq!(test("0").0["deviation"]["step"], 0);
    calls[1] = json!({"name": "look_twice", "arguments": {}});
    write(&calls);
    let (case, code) = test("3");
    assert_eq!(code, Some(1), "{case}");
    assert_eq!(case["deviation"]["kind"], "tool", "{case}");
    assert_eq!(case["deviation"]["step"], 1, "{case}");
    let branch = case["branch"].as_str().unwrap();
    let check = ["branch", path, "--check", branch];
    expect(folder, 0, &check);
    // An agent that ends before its first call stops early.
    let broken = |command: &[&str]| tested(folder, &[&["--against", path, "--"], command].concat());
    for (agent, ended) in [("false", "exit status: 1"), ("true", "exit status: 0")] {
        let case = &stopped_early(broken(&[agent]));
        assert_eq!(
            case["deviation"]["expected"],
            json!(trace.steps[0].input.call)
        );
        let reason = case["reason"].as_str().unwrap();
        assert!(
            reason.contains(ended) && reason.contains("`finish`"),
            "{case}"
        );
    }
    // Agents that cannot be played to an end are no failures of a test.
    let slow = ["--against", path, "--limit", "0.2", "--", "sleep", "60"];
    let (cases, code) = tested(folder, &slow);
    assert_eq!(code, Some(2), "{cases:?}");
    assert!(
        cases[0]["reason"].as_str().unwrap().contains("--limit"),
        "{cases:?}"
    );
    assert_eq!(broken(&["no-such-program"]).1, Some(2));
}

/// The test case of an agent that ended before its first call: a failure.
fn stopped_early((cases, code): (Vec<Value>, Option<i32>)) -> Value {
    let case = cases[0].clone();
    assert_eq!(
        (&case["status"], code),
        (&json!("failed"), Some(1)),
        "{case}"
    );
    assert_eq!(case["deviation"]["kind"], "missing_call", "{case}");
    case
}

#[test]
fn calls_made_at_once_come_in_any_order_and_nobody_judges_them() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let trace = recorded_at_once(folder);
    assert_eq!(trace.steps.len(), 4);
    let replay = ["--replay", "files", "--report", "report.jsonl"];
    let mut client = StdioClient::start(folder, &replay);
    for name in ["c", "a", "b", "last"] {
        let answer = client.call("read", &json!({"name": name}));
        assert_eq!(answer, (name.to_owned(), false));
    }
    assert_eq!(client.exit_code(), Some(0), "the agent stayed on tape");
    let report = fs::read_to_string(folder.join("report.jsonl")).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["status"], "on_tape", "{report}");
    assert_eq!(report["success"], Value::Null, "{report}");
    // The last call was decided by the results of the others, so it is none of them.
    let mut client = StdioClient::start(folder, &["--replay", "files"]);
    client.call("read", &json!({"name": "b"}));
    let (text, failed) = client.call("read", &json!({"name": "last"}));
    assert!(failed, "{text}");
    for part in ["at call 0: ", "the call is recorded as call 3: "] {
        assert!(text.contains(part), "{part}, {text}");
    }
    assert_eq!(client.exit_code(), Some(1));
}

#[test]
fn an_agent_that_calls_nothing_is_not_told_of_a_tool_that_its_server_lacks() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    recorded_at_once(folder);
    let case = &stopped_early(tested(folder, &["--against", "files", "--", "false"]));
    let reason = case["reason"].as_str().unwrap();
    assert!(reason.contains("exit status: 1"), "{case}");
    assert!(!reason.contains("finish"), "{case}");
}
