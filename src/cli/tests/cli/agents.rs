//! Agents behind an endpoint: `reel bench` against `reel agent mock-llm`, with all the trouble that
//! an endpoint can make.

use std::{
    fs,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use reel_trace::Trace;
use reel_world::{
    ErrorCode,
    record::{EndReason, UserSource},
};
use serde_json::Value;

use crate::{complaint, expect, reel};

/// A stand-in for a model, until it is dropped.
pub struct Mock {
    child: Child,
    pub url: String,
}

impl Mock {
    pub fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_reel"))
            .current_dir(folder)
            .args(["agent", "mock-llm", "plans", "--listen", "127.0.0.1:0"])
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.as_mut().unwrap())
            .read_line(&mut url)
            .unwrap();
        assert!(url.starts_with("http://"), "{url:?}");
        Self {
            child,
            url: url.trim().to_owned(),
        }
    }
}

impl Drop for Mock {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Tasks, and what the oracle does in them.
pub fn plans(folder: &Path, count: &str) {
    reel!(folder, "task draw --count {count} --seed 31 --out tasks");
    reel!(
        folder,
        "run --tasks tasks --policy oracle --out plans --no-images"
    );
}

const STYLES: [&str; 2] = ["real-agent", "function-calling"];

fn bench<'a>(style: &'a str, url: &'a str, out: &'a str) -> Vec<&'a str> {
    vec![
        "bench",
        "--tasks",
        "tasks",
        "--agent",
        style,
        "--endpoint",
        url,
        "--model",
        "mock",
        "--out",
        out,
        "--no-images",
        "--json",
    ]
}

/// The row of all families.
fn all(printed: &str) -> Value {
    let told: Value = serde_json::from_str(printed).unwrap();
    told["rows"].as_array().unwrap().last().unwrap().clone()
}

/// Files of a folder that end so, in order; none where there is no folder yet.
pub fn files(folder: &Path, ending: &str) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten();
    let mut paths: Vec<_> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.retain(|path| {
        path.extension()
            .is_some_and(|extension| extension == ending)
    });
    paths.sort();
    paths
}

fn traces(folder: &Path) -> Vec<Trace> {
    files(folder, "mcap")
        .iter()
        .map(|path| Trace::read(path).unwrap())
        .collect()
}

#[test]
fn memory_options_are_named_and_change_what_is_asked() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "2");
    let mock = Mock::start(here, &[]);
    let prompts = |out: &str, options: &[&str]| {
        let arguments = [&bench("real-agent", &mock.url, out)[..], options].concat();
        let told: Value = serde_json::from_str(&expect(here, 0, &arguments)).unwrap();
        let parameters = traces(&here.join(out))[0].header.policy.parameters.clone();
        (told["memory_options"].clone(), parameters)
    };
    let (named, own) = prompts("own", &[]);
    assert_eq!(named, serde_json::json!([]));
    let (named, helped) = prompts("helped", &["--call-log", "--keep-view"]);
    assert_eq!(named, serde_json::json!(["call_log", "keep_view"]));
    assert_eq!(
        (&helped["call_log"], &helped["keep_view"]),
        (&true.into(), &true.into())
    );
    assert!(!own.contains_key("call_log") && own["prompt"] != helped["prompt"]);

    // The oracle wrote no History. What stands for it in a training set, if anything, is an option.
    reel!(here, "ingest plans --store store");
    let rows = |out: &str, options: &str| {
        reel!(
            here,
            "export sft --store store --annotations recorded --image-format none --format trl {options} --out {out}"
        );
        let files = files(&here.join(out).join("train"), "jsonl");
        files
            .iter()
            .map(|path| fs::read_to_string(path).unwrap())
            .collect::<String>()
    };
    let (own, helped) = (rows("sft", ""), rows("sft-helped", "--call-log"));
    assert!(
        !own.is_empty() && !own.contains("I have not done anything yet"),
        "{own}"
    );
    assert!(helped.contains("I have not done anything yet"), "{helped}");
    let manifest = |out: &str| fs::read_to_string(here.join(out).join("manifest.json")).unwrap();
    assert!(
        manifest("sft-helped").contains("\"call_log\"") && !manifest("sft").contains("call_log")
    );
}

#[test]
fn both_styles_complete_twenty_tasks_and_replay_with_nobody_there() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "20");
    {
        let mock = Mock::start(here, &[]);
        for style in STYLES {
            let mut arguments = bench(style, &mock.url, style);
            arguments.extend([
                "--user-model",
                "person",
                "--embedding-model",
                "vectors",
                "--min-similarity",
                "0.95",
            ]);
            let row = all(&expect(here, 0, &arguments));
            assert_eq!(
                (&row["episodes"], &row["successes"]),
                (&20.into(), &20.into()),
                "{style}: {row}"
            );
            assert!(
                row["prompt_tokens"].as_u64() > Some(1000) && row["latency_s"].as_f64() > Some(0.0),
                "{row}"
            );
        }
    }
    for style in STYLES {
        let traces = traces(&here.join(style));
        let families: std::collections::BTreeSet<_> =
            traces.iter().map(|trace| trace.header.family).collect();
        assert_eq!(families.len(), 4);
        let steps = || traces.iter().flat_map(|trace| &trace.steps);
        assert!(
            steps()
                .filter_map(|step| step.input.user_reply.as_ref())
                .any(|reply| reply.source == UserSource::Model)
        );
        assert!(
            steps()
                .filter_map(|step| step.input.lookup.as_ref())
                .any(|lookup| lookup.source == "vectors")
        );
        assert!(steps().all(|step| {
            step.input
                .policy
                .as_ref()
                .is_some_and(|said| !said.raw.is_empty())
        }));
        let parameters = &traces[0].header.policy.parameters;
        assert_eq!(
            (&parameters["model"], &parameters["user"]["model"]),
            (&"mock".into(), &"person".into())
        );
    }
    // The endpoint is gone.
    let replayed = expect(here, 0, &["replay", STYLES[0], STYLES[1]]);
    assert!(
        replayed.contains("40 of 40 traces replay exactly"),
        "{replayed}"
    );
    let compared = expect(here, 0, &["bench", "--compare", STYLES[0], STYLES[1]]);
    assert!(
        compared.contains("all        20  100.0  100.0"),
        "{compared}"
    );
}

#[test]
fn an_answer_that_is_none_is_feedback() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "4");
    let cases = [
        ("gibberish@2", ErrorCode::UnparsableOutput),
        ("truncated@1", ErrorCode::UnparsableOutput),
        ("unknown-tool@3", ErrorCode::UnknownTool),
    ];
    for (trouble, code) in cases {
        let mock = Mock::start(here, &["--inject", trouble]);
        for style in STYLES {
            let out = format!("{style}-{}", trouble.split('@').next().unwrap());
            let row = all(&expect(here, 0, &bench(style, &mock.url, &out)));
            assert_eq!(row["successes"], 4, "{trouble} {style}: {row}");
            for trace in traces(&here.join(&out)) {
                let failed: Vec<_> = trace
                    .steps
                    .iter()
                    .filter_map(|step| step.outcome.error)
                    .collect();
                // A cut list of arguments is still a call: its arguments are wrong.
                let expected = if (style, trouble) == ("function-calling", "truncated@1") {
                    ErrorCode::BadArguments
                } else {
                    code
                };
                assert_eq!(failed, [expected], "{trouble} {style}");
            }
        }
    }
}

#[test]
fn of_two_calls_the_first_counts() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "4");
    let mock = Mock::start(here, &["--inject", "two-calls@2"]);
    for style in STYLES {
        let row = all(&expect(here, 0, &bench(style, &mock.url, style)));
        assert_eq!(row["successes"], 4, "{style}: {row}");
        // The other call was `finish`, and nobody made it.
        let planned = traces(&here.join("plans"));
        for (trace, plan) in traces(&here.join(style)).iter().zip(&planned) {
            assert_eq!(trace.steps.len(), plan.steps.len());
        }
    }
}

#[test]
fn trouble_on_the_way_is_waited_out() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "4");
    let trouble = [
        "--inject",
        "rate-limit@1",
        "--inject",
        "error@2",
        "--inject",
        "cut@3",
        "--inject",
        "stall@4",
        "--stall",
        "60",
    ];
    let mock = Mock::start(here, &trouble);
    for style in STYLES {
        let mut arguments = bench(style, &mock.url, style);
        // A stall of a minute is no answer in time.
        arguments.extend(["--timeout", "2"]);
        let begun = Instant::now();
        let row = all(&expect(here, 0, &arguments));
        assert_eq!(row["successes"], 4, "{style}: {row}");
        assert!(begun.elapsed() < Duration::from_secs(50));
        let calls = fs::read_to_string(here.join(style).join("calls.jsonl")).unwrap();
        let tried_twice = calls
            .lines()
            .filter(|line| line.contains("\"attempts\":2"))
            .count();
        assert_eq!(
            tried_twice, 16,
            "each of four troubles once in each of four episodes"
        );
    }
}

#[test]
fn who_is_not_there_ends_the_episode_and_another_run_plays_it() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "4");
    let url = { Mock::start(here, &[]).url.clone() };
    let mut arguments = bench("real-agent", &url, "out");
    arguments.extend(["--retries", "0"]);
    let output = reel(here, &arguments);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(
        told.contains("no answer; the episode ended at step 0 as aborted")
            && told.contains("is the endpoint running"),
        "{told}"
    );
    let ends: Vec<_> = traces(&here.join("out"))
        .iter()
        .map(|trace| trace.end.as_ref().unwrap().reason)
        .collect();
    assert_eq!(ends, [EndReason::Aborted; 4]);
    let mock = Mock::start(here, &[]);
    let row = all(&expect(here, 0, &bench("real-agent", &mock.url, "out")));
    assert_eq!(row["successes"], 4, "{row}");
    // Other settings are another benchmark.
    let mut arguments = bench("real-agent", &mock.url, "out");
    arguments.extend(["--temperature", "0.5"]);
    assert!(complaint(here, 2, &arguments).contains("give another folder with --out"));
    let unknown = complaint(here, 2, "bench --tasks tasks --agent nobody");
    assert!(
        unknown.contains("real-agent") && unknown.contains("planner"),
        "{unknown}"
    );
}

#[test]
fn a_run_that_is_killed_three_times_ends_with_the_same_table() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "8");
    let mock = Mock::start(here, &["--delay", "40"]);
    let mut whole: Value =
        serde_json::from_str(&expect(here, 0, &bench("real-agent", &mock.url, "whole"))).unwrap();
    let mut killed_midway = 0;
    for kill in 1..=3 {
        let mut arguments = bench("real-agent", &mock.url, "parts");
        arguments.extend(["--jobs", "1"]);
        let mut child = Command::new(env!("CARGO_BIN_EXE_reel"))
            .current_dir(here)
            .args(&arguments)
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let end = Instant::now() + Duration::from_secs(60);
        let under_way = || !files(&here.join("parts"), "part").is_empty();
        while (files(&here.join("parts"), "mcap").len() < 2 * kill || !under_way())
            && Instant::now() < end
        {
            thread::sleep(Duration::from_millis(20));
        }
        // In the middle of the next episode.
        thread::sleep(Duration::from_millis(50));
        child.kill().unwrap();
        child.wait().unwrap();
        killed_midway += files(&here.join("parts"), "part").len();
    }
    assert!(killed_midway > 0, "no episode was under way");
    let mut parts: Value =
        serde_json::from_str(&expect(here, 0, &bench("real-agent", &mock.url, "parts"))).unwrap();
    for told in [&mut whole, &mut parts] {
        // How long the endpoint took is no result.
        told["rows"]
            .as_array_mut()
            .unwrap()
            .iter_mut()
            .for_each(|row| row["latency_s"] = Value::Null);
    }
    assert_eq!(whole, parts);
    assert_eq!(all(&parts.to_string())["episodes"], 8);
}

#[test]
fn a_budget_ends_a_run_that_can_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    plans(here, "4");
    let mock = Mock::start(here, &[]);
    let mut arguments = bench("real-agent", &mock.url, "out");
    arguments.extend(["--jobs", "1", "--prices", "1,2", "--max-cost", "0.000001"]);
    let output = reel(here, &arguments);
    assert_eq!(output.status.code(), Some(1));
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&told["played"], &told["episodes"]), (&1.into(), &4.into()));
    assert!(String::from_utf8_lossy(&output.stderr).contains("3 episodes were not begun"));
    assert_eq!(
        all(&expect(here, 0, &bench("real-agent", &mock.url, "out")))["successes"],
        4
    );
}
