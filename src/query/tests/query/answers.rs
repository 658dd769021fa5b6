//! Every named query over recorded and synthetic episodes: against answers by another route, with
//! parameters, and where the right answer is known.

use reel_vectors::golden_traces;
use std::{fs, path::Path, process::Command};

use reel_query::{Format, Parameters, QuerySession, format, named};
use reel_reward::Preset;
use reel_tables::{AnswerLabelRow, Store};
use reel_taxonomy::{RuleSet, classify};
use reel_trace::{
    Images, Timing, Trace,
    robot::{Alignment, PrimitiveOutcome, VlaLatency},
};
use reel_world::{
    ErrorCode, Family,
    record::{Backend, EndReason, Parent, PolicyOutput, UserSource},
};
use tempfile::TempDir;

use crate::{
    ask,
    play::{DISTRACTOR, Play, TARGET, success},
    store,
};

#[test]
fn every_named_query_agrees_with_an_independent_path() {
    let Some(python) = reel_vectors::python("deltalake, duckdb, numpy") else {
        return;
    };
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(rich_store(dir.path())).unwrap();
    let out = dir.path().join("answers");
    fs::create_dir(&out).unwrap();
    for query in named::ALL {
        let batches = session.run(&query.with_defaults()).unwrap();
        assert!(
            batches.iter().any(|batch| batch.num_rows() > 0),
            "{}: nothing to compare",
            query.name
        );
        fs::write(
            out.join(format!("{}.json", query.name)),
            format(&batches, Format::Json).unwrap(),
        )
        .unwrap();
    }
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/check_queries.py");
    let mut check = Command::new(&python);
    check
        .env("PYTHONDONTWRITEBYTECODE", "1")
        .arg(script)
        .arg(dir.path().join("store"))
        .arg(&out);
    let said = reel_vectors::run(&mut check);
    assert_eq!(said.lines().count(), named::ALL.len());
}

#[test]
fn parameters_are_bound_as_their_defaults_are_written_in() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(rich_store(dir.path())).unwrap();
    let text = |sql: &str, parameters: &Parameters, form| {
        format(&session.run_with(sql, parameters).unwrap(), form).unwrap()
    };
    let none = Parameters::new();
    for query in named::ALL {
        let parameters: Parameters = query.parameters().into_iter().collect();
        if !parameters.is_empty() {
            // as tables: the last bits of a mean depend on the order of its sum
            let (bound, written) = (
                text(query.sql, &parameters, Format::Table),
                text(&query.with_defaults(), &none, Format::Table),
            );
            assert_eq!(bound, written, "{}", query.name);
        }
    }
    let with = |name: &str, values: &[(&str, &str)]| -> Vec<String> {
        let query = named::by_name(name).unwrap();
        let mut parameters: Parameters = query.parameters().into_iter().collect();
        parameters.extend(
            values
                .iter()
                .map(|(name, value)| ((*name).to_owned(), (*value).to_owned())),
        );
        text(query.sql, &parameters, Format::Csv)
            .lines()
            .skip(1)
            .map(str::to_owned)
            .collect()
    };
    let robots = with("real_world", &[("backend", "robot")]);
    assert_eq!(robots.len(), 3, "{robots:?}");
    assert!(robots[2].starts_with("student,all,2,0.5,"), "{robots:?}");
    let regressions = with("regressions", &[("a", "oracle"), ("b", "wrong-%")]);
    assert!(
        !regressions.is_empty()
            && regressions
                .iter()
                .all(|row| row.starts_with("oracle,wrong-")),
        "{regressions:?}"
    );
    assert_eq!(
        with("regressions", &[("a", "7")]).len(),
        0,
        "a policy may be called as a number"
    );
    let longest = with("longest_episodes", &[("top", "1")]);
    assert_eq!(
        longest.len(),
        ask(&session, "SELECT DISTINCT policy FROM episodes").len()
    );
    let asked_twice = with("episodes_matching", &[("pattern", "ask ask")]);
    assert_eq!(
        asked_twice.len(),
        2,
        "a synthetic episode and a recorded one: {asked_twice:?}"
    );
}

#[test]
fn an_answer_without_rows_has_every_column() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(rich_store(dir.path())).unwrap();
    let columns = |sql: &str| session.run(sql).unwrap()[0].num_columns();
    let all = columns("SELECT * FROM steps");
    assert!(all > 50, "{all}");
    for none in ["LIMIT 0", "WHERE FALSE", "WHERE step < -1"] {
        assert_eq!(
            columns(&format!("SELECT * FROM steps {none}")),
            all,
            "{none}"
        );
    }
}

#[test]
fn questions_are_judged_by_what_comes_of_them() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &varied())).unwrap();
    let columns = "source, answers, words, led_right, led_wrong, led_nowhere, successes";
    assert_eq!(
        ask(
            &session,
            &format!(
                "SELECT {columns} FROM user_fidelity WHERE policy = 'student' ORDER BY source"
            )
        ),
        [
            "human,2,1.5,1,1,0,1",
            "model,1,7.0,1,0,0,1",
            "rule-based,2,3.5,0,1,1,0"
        ]
    );
    assert_eq!(
        ask(&session, "SELECT count(*) FROM questions"),
        ["5"],
        "a malformed call reaches nobody"
    );
}

#[test]
fn advantages_are_relative_to_the_group() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &varied())).unwrap();
    let rows = ask(
        &session,
        "SELECT group_id, rollouts, successes, mean, worst, best, signal FROM groups ORDER BY group_id",
    );
    assert_eq!(
        rows,
        [
            "group-a,3,1,1.9583333333333333,-1.5,7.25,true",
            "group-b,2,0,2.0,2.0,2.0,false"
        ]
    );
    let rows = ask(
        &session,
        "SELECT rollout_index, round(advantage, 4) FROM group_advantages WHERE group_id = 'group-a'",
    );
    assert_eq!(rows, ["0,-0.9101", "1,1.3925", "2,-0.4824"]);
    let rows = ask(
        &session,
        "SELECT DISTINCT advantage FROM group_advantages WHERE group_id = 'group-b'",
    );
    assert_eq!(rows, ["0.0"]);
}

#[test]
fn a_policy_that_solves_a_task_now_and_then_is_unsteady() {
    let dir = TempDir::new().unwrap();
    let session = QuerySession::new(store(dir.path(), &varied())).unwrap();
    let rows = ask(
        &session,
        "SELECT policy, task_id, episodes, successes FROM flaky_tasks ORDER BY task_id",
    );
    assert_eq!(rows, ["student,FDP/t,7,2", "student,SUL/t,5,2"]);
}

/// A store of recorded and synthetic episodes, broken-off and unreadable traces, scored again
/// under the other preset.
fn rich_store(dir: &Path) -> Store {
    let mut plays = varied();
    let parents = dir.join("parents");
    fs::create_dir(&parents).unwrap();
    let branch = |play: &Play| as_branch(play, &play.record(&parents, Images::None));
    let mut branches: Vec<Play> = plays.iter().map(branch).collect();
    // rollouts of a group that begins at a recorded call
    for index in 0..2 {
        let mut play = branch(&success("student", Family::FDO, 30 + u64::from(index)));
        play.header.group_id = Some("group-c".into());
        play.header.rollout_index = Some(index);
        branches.push(play);
    }
    plays.extend(branches);
    let mut store = store(dir, &plays);
    let broken_off = Play::new("student", Family::FDP, 19)
        .nav("table_1")
        .find("alarm clock")
        .nav("table_1");
    let mut traces = golden_traces();
    traces.push(broken_off.record_as(&dir.join("broken.mcap"), Images::None));
    let no_trace = dir.join("no_trace.mcap");
    fs::write(&no_trace, "not a trace").unwrap();
    traces.push(no_trace);
    let report = store.ingest(&traces, &|_, _| ()).unwrap();
    assert_eq!(
        (report.added, report.quarantined.len()),
        (traces.len() - 1, 1)
    );
    store.rescore(&Preset::real_repo(), |_| ()).unwrap();
    // all but one policy's failures are classified
    let session = QuerySession::new(Store::open(dir.join("store")).unwrap()).unwrap();
    let verdicts = classify(&session, &RuleSet::built_in(), Some("policy <> 'student'")).unwrap();
    store.replace_classes(|| verdicts.classes()).unwrap();
    label_answers(&mut store, &session);
    store
}

/// Labels of some of the answers, on one of which two authors disagree.
fn label_answers(store: &mut Store, session: &QuerySession) {
    let labels = ["faithful", "unclear", "unfaithful", "faithful"];
    let answers = "SELECT episode_id, step FROM steps WHERE reply IS NOT NULL AND parent_trace IS NULL ORDER BY episode_id, step";
    let row = |author: &str, answer: &str, label: &str| {
        let (episode, step) = answer.split_once(',').unwrap();
        AnswerLabelRow {
            episode_id: episode.to_owned(),
            step: step.parse().unwrap(),
            author: author.to_owned(),
            label: label.to_owned(),
            note: None,
            at_ms: 0,
        }
    };
    let answers = ask(session, answers);
    let mut rows: Vec<AnswerLabelRow> = answers
        .iter()
        .zip(labels)
        .map(|(answer, label)| row("ann", answer, label))
        .collect();
    rows.push(row("ben", &answers[0], "unclear"));
    rows.push(row("ben", &answers[1], "unclear"));
    store.change_answer_labels(|_| rows.clone()).unwrap();
}

/// The same as a branch. It is no trial: whatever counts it as one counts the episode twice.
fn as_branch(play: &Play, parent: &Trace) -> Play {
    let mut play = play.clone();
    play.header.episode_id += "-branch";
    play.header.parent = Some(Parent {
        trace: parent.chain(),
        call: 1,
    });
    play
}

/// What the recorded traces lack: people and models that answer, time to think, prompt groups, a
/// robot, tasks that the same policy solves now and then.
fn varied() -> Vec<Play> {
    let asked = |policy: &str, seed: u64, source: UserSource, reply: &str, object: &str| {
        let play = Play::new(policy, Family::SUL, seed)
            .nav("table_1")
            .find("alarm clock")
            .ask("Which one?", reply);
        let mut play = play.pick(object).nav("desk_1").place("desk_1").finish();
        play.steps[2].reply.as_mut().unwrap().source = source;
        play
    };
    let slow = |mut play: Play, first_ms: u64| {
        for (step, latency_ms) in play.steps.iter_mut().zip((first_ms..).step_by(137)) {
            let tokens = (latency_ms % 2 == 0).then_some([1800 + latency_ms as u32, 60]);
            step.input.policy = Some(PolicyOutput {
                tokens,
                latency_ns: Some(latency_ms * 1_000_000),
                ..PolicyOutput::default()
            });
        }
        play
    };
    let rollout = |mut play: Play, group: &str, index: u32, discounted_return: f64| {
        play.header.group_id = Some(group.into());
        play.header.rollout_index = Some(index);
        play.discounted_return = discounted_return;
        play
    };
    let on_robot = |mut play: Play| {
        play.header.backend = Backend::Robot;
        play
    };
    let measured = |mut play: Play| {
        play.timings.insert(
            0,
            Timing {
                called_unix_ns: 1,
                took_ns: 8_250_000_000,
            },
        );
        let primitive =
            |step: u32, target: &str, success: bool, seconds: Option<u64>| PrimitiveOutcome {
                step: Some(step),
                skill: "open".into(),
                target: target.into(),
                success,
                duration_ns: seconds.map(|seconds| seconds * 1_000_000_000),
                control_steps: Some(1000),
                ..PrimitiveOutcome::default()
            };
        let vla = |step: u32, latency_ns: u64| VlaLatency {
            step: Some(step),
            latency_ns,
            ..VlaLatency::default()
        };
        let alignment =
            |step: Option<u32>, target: &str, centimetres: f64, shift: Option<f64>| Alignment {
                step,
                target: target.into(),
                odometry_error_m: Some(centimetres / 100.0),
                yaw_error_rad: Some(-0.01 * centimetres),
                image_shift_px: shift,
                image_rmse_px: shift.map(|shift| shift / 10.0),
                ..Alignment::default()
            };
        play.robot.primitives = vec![
            primitive(1, "cupboard", false, Some(60)),
            primitive(2, "", true, None),
        ];
        play.robot.vla = vec![vla(1, 80_000_000), vla(1, 95_000_000), vla(2, 70_000_000)];
        play.robot.alignments = vec![
            alignment(Some(0), "cabinet", 1.5, Some(20.0)),
            alignment(Some(0), "cabinet", 2.25, Some(31.0)),
            alignment(Some(2), "", 1.75, None),
        ];
        play
    };
    let failing = |seed: u64| {
        Play::new("student", Family::FDP, seed)
            .nav("table_1")
            .pick(TARGET)
            .nav("desk_2")
            .place("desk_2")
    };
    vec![
        asked("student", 1, UserSource::Human, "the white one", TARGET),
        asked("student", 2, UserSource::Human, "", DISTRACTOR),
        asked(
            "student",
            3,
            UserSource::Model,
            "I mean  the\nwhite, round alarm clock. ",
            TARGET,
        ),
        asked(
            "student",
            4,
            UserSource::RuleBased,
            "The white one, please.",
            DISTRACTOR,
        ),
        Play::new("student", Family::SUL, 5)
            .ask("Which one?", "The white one.")
            .fails("ask", ErrorCode::BadArguments)
            .finish(),
        slow(failing(6).finish(), 900),
        slow(success("student", Family::FDP, 7), 1200),
        slow(success("teacher", Family::FDO, 8), 20_000),
        on_robot(slow(success("student", Family::FODP, 9), 4001)),
        on_robot(measured(
            Play::new("student", Family::FDO, 10)
                .nav("cabinet_1")
                .fails("open", ErrorCode::OutOfReach)
                .open("cabinet_1")
                .finish(),
        )),
        rollout(success("student", Family::FDP, 11), "group-a", 1, 7.25),
        rollout(failing(12).finish(), "group-a", 0, -1.5),
        rollout(failing(13).ended(EndReason::Fault), "group-a", 2, 0.125),
        rollout(failing(14).finish(), "group-b", 0, 2.0),
        rollout(failing(15).finish(), "group-b", 1, 2.0),
        Play::new("teacher", Family::FDP, 16)
            .nav("table_1")
            .pick(DISTRACTOR)
            .place("table_1")
            .pick(TARGET)
            .nav("desk_1")
            .finish(),
        Play::new("teacher", Family::FDP, 17)
            .nav("desk_1")
            .nav("desk_2")
            .nav("desk_1")
            .nav("table_1")
            .nav("table_2")
            .nav("table_1")
            .nav("table_2")
            .ended(EndReason::Horizon),
        Play::new("teacher", Family::FODP, 18)
            .fails("pick", ErrorCode::NoMarkerMap)
            .fails("pick", ErrorCode::NoMarkerMap)
            .pick(TARGET)
            .finish(),
    ]
}
