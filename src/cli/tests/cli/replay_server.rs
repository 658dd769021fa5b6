//! Recordings as MCP servers: byte for byte on tape over every transport, the first deviation by name,
//! and what follows off tape.

mod clients;
mod mutations;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use reel_trace::{RecordOptions, Recorder, Trace};
use reel_world::ToolCall;
use serde_json::{Value, json};

use crate::{
    complaint, expect,
    stdio_client::{StdioClient, traces},
};
use clients::{Client, ReplayServer, SseClient, StreamableClient};
use mutations::{Mutation, Random, mutate};

const PROFILES: [&str; 3] = ["paper", "real-repo", "real-gspo"];

/// How many of something a test takes: the number in the environment, else its own.
fn wanted(variable: &str, otherwise: usize) -> usize {
    let set = std::env::var(variable).ok();
    set.and_then(|count| count.parse().ok())
        .unwrap_or(otherwise)
}

/// What an agent does in an episode, by task: the calls of a policy, without its `finish`.
type Scripts = BTreeMap<String, Vec<ToolCall>>;

/// Tasks of a profile, and what policies call in them.
fn scripts(folder: &Path, profile: &str, tasks: usize) -> Scripts {
    let (count, seed) = (tasks.to_string(), (profile.len() * 7).to_string());
    let generate = [
        "task", "generate", "--count", &count, "--seed", &seed, "--out", "tasks",
    ];
    expect(folder, 0, &generate);
    let run = |policy: &str| {
        let out = format!("scripts-{policy}");
        let run = [
            "run",
            "--tasks",
            "tasks",
            "--policy",
            policy,
            "--profile",
            profile,
            "--no-images",
            "--out",
            &out,
        ];
        expect(folder, 0, &run);
        traces(&folder.join(out))
    };
    let (planned, explored) = (run("planner"), run("explorer"));
    // One agent in four tries every tool on whatever it sees.
    let chosen = planned
        .iter()
        .enumerate()
        .map(|(index, trace)| match index % 4 {
            3 => &explored[index],
            _ => trace,
        });
    chosen
        .map(|trace| {
            let calls = trace.steps.iter().map(|step| step.input.call.clone());
            let calls = calls.filter(|call| call.name != "finish");
            (trace.header.task_id.clone(), calls.collect())
        })
        .collect()
}

/// Plays every task of a session to its end: the text of every answer, byte for byte.
fn play(client: &mut dyn Client, scripts: &Scripts) -> Vec<String> {
    let none = json!({});
    let mut answers = vec![
        client.request("tools/list", &none),
        client.call("list_tasks", &none),
        client.call("list_receptacles", &none),
    ];
    let listed: Value = serde_json::from_str(&answers[1]).unwrap();
    let listed = listed["result"]["content"][0]["text"].as_str().unwrap();
    let tasks: Vec<String> = serde_json::from_str(listed).unwrap();
    answers.push(client.call("finish", &none));
    for task in &tasks {
        for call in &scripts[task] {
            answers.push(client.call(&call.name, &call.arguments));
        }
        answers.push(client.call("finish", &none));
    }
    answers
}

/// A recording for every task, made by a session of the live server, and what that one answered.
fn record(folder: &Path, profile: &str, scripts: &Scripts) -> Vec<String> {
    let live = ["--tasks", "tasks", "--profile", profile, "--data", "live"];
    let mut client = StdioClient::start(folder, &live);
    let answers = play(&mut client, scripts);
    client.leave();
    assert_eq!(traces(&folder.join("live/traces")).len(), scripts.len());
    answers
}

#[test]
fn on_tape_every_transport_answers_byte_for_byte() {
    let count = wanted("REEL_REPLAY_TRACES", 6).div_ceil(PROFILES.len());
    let (mut compared, mut bytes, mut played) = (0, 0, 0);
    for profile in PROFILES {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let scripts = scripts(folder, profile, count);
        let live = record(folder, profile, &scripts);
        played += scripts.len();
        let replay = ["--replay", "live/traces"];
        let check = |transport: &str, replayed: &[String]| {
            assert_eq!(replayed.len(), live.len(), "{profile}, {transport}");
            for (index, (live, replayed)) in live.iter().zip(replayed).enumerate() {
                assert!(
                    live == replayed,
                    "{profile}, {transport}, answer {index}:\n{live:.2000}\n{replayed:.2000}"
                );
            }
        };
        let mut stdio = StdioClient::start(folder, &replay);
        check("stdio", &play(&mut stdio, &scripts));
        assert_eq!(stdio.exit_code(), Some(0), "the agent stayed on tape");
        let server = ReplayServer::start(folder, &replay);
        check(
            "Streamable HTTP",
            &play(&mut StreamableClient::start(&server.address), &scripts),
        );
        check(
            "HTTP+SSE",
            &play(&mut SseClient::start(&server.address), &scripts),
        );
        compared += 3 * live.len();
        bytes += 3 * live.iter().map(String::len).sum::<usize>();
    }
    eprintln!(
        "{played} recordings over 3 transports: {compared} answers, {bytes} bytes, all equal"
    );
}

#[test]
fn recordings_without_images_are_rendered_again() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scripts = scripts(folder, "paper", 1);
    let live = record(folder, "paper", &scripts);
    let [trace] = &traces(&folder.join("live/traces"))[..] else {
        panic!("one recording")
    };
    let path = trace.path.to_str().unwrap();
    expect(folder, 0, &["trace", "compact", path, "--out", "lean"]);
    let [lean] = &traces(&folder.join("lean"))[..] else {
        panic!("one lean recording")
    };
    assert_eq!(lean.image_count(), 0);
    let mut client = StdioClient::start(folder, &["--replay", "lean"]);
    assert!(
        play(&mut client, &scripts) == live,
        "rendered again, the answers differ"
    );
    client.leave();
}

#[test]
fn the_first_deviation_of_mutated_calls_is_named() {
    let count = wanted("REEL_REPLAY_MUTATIONS", 48);
    let seed = wanted("REEL_REPLAY_SEED", 1) as u64;
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scripts = scripts(folder, "paper", 4);
    record(folder, "paper", &scripts);
    let mut random = Random(seed);
    let mut kinds: BTreeMap<&str, usize> = BTreeMap::new();
    let recorded = traces(&folder.join("live/traces"));
    for trace in &recorded {
        let calls = trace.steps.iter().map(|step| step.input.call.clone());
        let calls: Vec<ToolCall> = calls.collect();
        let drawn = std::iter::repeat_with(|| mutate(&calls, &mut random)).flatten();
        let made: Vec<Mutation> = drawn.take(count.div_ceil(recorded.len())).collect();
        for (mutation, report) in made.iter().zip(deviate(folder, trace, &made)) {
            let found = &report["deviation"];
            let told = format!("seed {seed}: {mutation:?}\n{report}");
            assert_eq!(found["step"], json!(mutation.step), "{told}");
            assert_eq!(found["kind"], mutation.deviation, "{told}");
            assert_eq!(found["argument"], json!(mutation.argument), "{told}");
            *kinds.entry(mutation.kind).or_default() += 1;
        }
    }
    let count: usize = kinds.values().sum();
    eprintln!("{count} mutations, each first deviation named: {kinds:?}");
}

/// Makes mutated calls up to the first that deviates, each in an episode of its own of one session: what
/// is reported of each.
fn deviate(folder: &Path, trace: &Trace, mutations: &[Mutation]) -> Vec<Value> {
    let path = trace.path.to_str().unwrap();
    let replay = [
        "--replay",
        path,
        "--report",
        "report.jsonl",
        "--data",
        "off",
    ];
    let mut client = StdioClient::start(folder, &replay);
    for mutation in mutations {
        client.call("finish_with_id", &json!({"task_id": trace.header.task_id}));
        let upto = mutation.calls.len().min(mutation.step + 1);
        for (index, call) in mutation.calls[..upto].iter().enumerate() {
            let answer = Client::call(&mut client, &call.name, &call.arguments);
            let answer: Value = serde_json::from_str(&answer).unwrap();
            let said = &answer["result"]["_meta"]["reel/replay"]["deviation"]["step"];
            let expected = (index == mutation.step).then_some(mutation.step as u64);
            assert_eq!(said.as_u64(), expected, "{mutation:?}\n{answer}");
        }
    }
    assert_eq!(client.exit_code(), Some(1), "calls deviated");
    let report = fs::read_to_string(folder.join("report.jsonl")).unwrap();
    let lines = report
        .lines()
        .map(|line| serde_json::from_str(line).unwrap());
    let reports: Vec<Value> = lines.collect();
    assert_eq!(reports.len(), mutations.len());
    reports
}

#[test]
fn off_tape_the_simulator_goes_on_as_a_branch() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scripts = scripts(folder, "paper", 2);
    record(folder, "paper", &scripts);
    for parent in traces(&folder.join("live/traces")) {
        let at = parent.steps.len() / 2;
        let future: Vec<ToolCall> = [
            ("walk_around", json!({})),
            ("find_objects", json!({"target_category": "cup"})),
            ("explore_receptacle", json!({"receptacle_name": "table_1"})),
            ("ask", json!({"question": "Which one do you mean?"})),
        ]
        .map(|(name, arguments)| ToolCall::new(name, arguments))
        .into();
        let data = format!("off-{}", parent.header.episode_id);
        let path = parent.path.to_str().unwrap();
        let mut client = StdioClient::start(folder, &["--replay", path, "--data", &data]);
        client.call("finish", &json!({}));
        let calls = parent.steps[..at].iter().map(|step| &step.input.call);
        for call in calls.chain(&future) {
            client.call(&call.name, &call.arguments);
        }
        assert_eq!(client.exit_code(), Some(1));
        let lines: Vec<String> = future.iter().map(|call| json!(call).to_string()).collect();
        fs::write(folder.join("calls.jsonl"), lines.join("\n")).unwrap();
        let at = at.to_string();
        let branch = [
            "branch",
            path,
            "--at",
            &at,
            "--calls",
            "calls.jsonl",
            "--out",
            "branch.mcap",
        ];
        expect(folder, 0, &branch);
        let branch = Trace::read(&folder.join("branch.mcap")).unwrap();
        let [off_tape] = &traces(&folder.join(data).join("branches"))[..] else {
            panic!("one branch")
        };
        assert_eq!(off_tape.header.parent, branch.header.parent);
        assert_eq!(off_tape.start, branch.start);
        assert_eq!(off_tape.steps, branch.steps);
        assert_eq!(off_tape.end, branch.end);
        let off_tape = off_tape.path.to_str().unwrap();
        expect(folder, 0, &["branch", path, "--check", off_tape]);
        fs::remove_file(folder.join("branch.mcap")).unwrap();
    }
}

#[test]
fn recordings_of_another_server_answer_as_it_did_and_then_say_what_was_expected() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scripts = scripts(folder, "real-repo", 2);
    let record = [
        "record",
        "--out",
        "foreign",
        "--profile",
        "real-repo",
        "--stdio",
        "--",
        env!("CARGO_BIN_EXE_reel"),
        "mcp",
        "--tasks",
        "tasks",
        "--profile",
        "real-repo",
        "--data",
        "live",
    ];
    let live = {
        let mut client = StdioClient::start_command(folder, &record);
        let none = json!({});
        let mut answers = vec![client.request_text("tools/list", &none)];
        answers.push(Client::call(&mut client, "finish", &none));
        for calls in scripts.values() {
            for call in calls {
                answers.push(Client::call(&mut client, &call.name, &call.arguments));
            }
            answers.push(Client::call(&mut client, "finish", &none));
        }
        client.leave();
        answers
    };
    let foreign = traces(&folder.join("foreign"));
    assert_eq!(foreign.len(), 2);
    let mut client = StdioClient::start(folder, &["--replay", "foreign"]);
    let none = json!({});
    let mut replayed = vec![client.request_text("tools/list", &none)];
    replayed.push(Client::call(&mut client, "finish", &none));
    for trace in &foreign {
        for step in &trace.steps {
            let call = &step.input.call;
            replayed.push(Client::call(&mut client, &call.name, &call.arguments));
        }
    }
    client.leave();
    assert_eq!(replayed.len(), live.len());
    for (index, (live, replayed)) in live.iter().zip(&replayed).enumerate() {
        assert!(
            live == replayed,
            "answer {index}:\n{live:.2000}\n{replayed:.2000}"
        );
    }
    let path = foreign[0].path.to_str().unwrap();
    let mut client = StdioClient::start(folder, &["--replay", path]);
    client.call("finish", &none);
    let wrong = json!({"receptacle_name": "the moon"});
    let expected = &foreign[0].steps[0].input.call;
    for _ in 0..2 {
        let params = json!({"name": &expected.name, "arguments": &wrong});
        let result = client.request("tools/call", &params);
        assert_eq!(result["isError"], true);
        let said = &result["structuredContent"];
        assert_eq!(said["step"], 0, "{said}");
        assert_eq!(said["expected"], json!(expected), "{said}");
        assert_eq!(said["actual"]["arguments"], wrong, "{said}");
        assert!(!said["difference"].as_array().unwrap().is_empty(), "{said}");
        let text = result["content"][0]["text"].as_str().unwrap();
        assert!(text.contains("left the recording at call 0"), "{text}");
    }
    assert_eq!(client.exit_code(), Some(1));
}

/// The records of a trace, changed, in a file whose checksums and chain hold.
fn forged(trace: &Trace, path: PathBuf, change: impl FnOnce(&mut Trace)) -> PathBuf {
    let mut trace = trace.clone();
    change(&mut trace);
    let options = RecordOptions::from(reel_trace::Images::None);
    let mut recorder =
        Recorder::create(&path, &trace.header, &trace.task, &trace.scene, options).unwrap();
    recorder.start(&trace.start, None).unwrap();
    for step in &trace.steps {
        recorder.input(step.step, &step.input).unwrap();
        recorder.step(step, None).unwrap();
    }
    recorder.end(trace.end.as_ref().unwrap()).unwrap();
    path
}

#[test]
fn damaged_and_diverging_recordings_say_so() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let scripts = scripts(folder, "paper", 1);
    record(folder, "paper", &scripts);
    let trace = &traces(&folder.join("live/traces"))[0];
    let bytes = fs::read(&trace.path).unwrap();
    fs::write(folder.join("torn.mcap"), &bytes[..bytes.len() / 2]).unwrap();
    fs::write(folder.join("none.mcap"), "no trace at all").unwrap();
    for name in ["torn.mcap", "none.mcap", "missing.mcap"] {
        let said = complaint(folder, 2, &["mcp", "--replay", name]);
        assert!(said.contains(name), "{said}");
    }
    let changed = forged(trace, folder.join("changed.mcap"), |trace| {
        trace.steps[1].outcome.text.push_str(" Or not.");
    });
    let older = forged(trace, folder.join("older.mcap"), |trace| {
        trace.header.sim_version -= 1;
    });
    for (path, why) in [(&changed, "DIVERGED"), (&older, "recorded by simulator")] {
        let path = path.to_str().unwrap();
        let mut client = StdioClient::start(folder, &["--replay", path]);
        let (text, failed) = client.call("finish", &json!({}));
        assert!(
            failed && text.contains(why) && text.contains(path),
            "{text}"
        );
        assert_eq!(client.exit_code(), Some(1));
        let out = expect(folder, 2, &["test", "oracle", "--against", path]);
        assert!(out.contains("ERROR"), "{out}");
    }
    // Kinds of servers do not mix, and nobody from outside is let in.
    let other = tempfile::tempdir().unwrap();
    let scripts = self::scripts(other.path(), "real-repo", 1);
    record(other.path(), "real-repo", &scripts);
    let published = other.path().join("live/traces");
    let both = [
        "mcp",
        "--replay",
        "live/traces",
        published.to_str().unwrap(),
    ];
    let said = complaint(folder, 2, &both);
    assert!(
        said.contains("serve each kind with a server of its own"),
        "{said}"
    );
    let open = ["serve", "--replay", "live/traces", "--listen", "0.0.0.0:0"];
    let said = complaint(folder, 2, &open);
    assert!(said.contains("is not a loopback address"), "{said}");
}
