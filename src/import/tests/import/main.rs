//! Imported episodes hold what the published files hold, and no file can make the importer panic.

mod bags;
mod eval_output;
mod fixture;
mod hostile;
mod inspect;
mod otel;
mod published;
mod real_contract;
mod robot;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use fixture::{APPLE, Episode, OTHER, SCENE, Shown};
use reel_import::{ImportError, ImportOptions, ImportedEpisode, episodes, import};
use reel_trace::{Trace, examine};
use reel_world::{
    DoorState, ErrorCode, FRAME_HEIGHT, FRAME_WIDTH, Family, Profile, Task,
    record::{Backend, EndReason, MarkerTarget, UserSource},
};
use serde_json::json;

const PLAIN: ImportOptions<'_> = ImportOptions {
    run_id: "run",
    tasks: &[],
    scenes: None,
};

/// Imports one episode; its trace is whole and healthy.
fn imported(folder: &Path, out: &Path) -> (ImportedEpisode, Trace) {
    imported_with(folder, out, &PLAIN)
}

fn imported_with(
    folder: &Path,
    out: &Path,
    options: &ImportOptions<'_>,
) -> (ImportedEpisode, Trace) {
    let imported = import(folder, out, options)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let trace = healthy(&imported.trace);
    (imported, trace)
}

fn healthy(path: &Path) -> Trace {
    let trace = Trace::read(path).unwrap_or_else(|error| panic!("{error}"));
    let examination = examine(path).unwrap();
    assert_eq!(examination.findings, []);
    assert_eq!(
        examination.notes,
        ["recorded through a proxy: nothing to re-execute"]
    );
    trace
}

fn folders() -> (tempfile::TempDir, PathBuf, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let (root, out) = (
        folder.path().join("eval_output"),
        folder.path().join("traces"),
    );
    fs::create_dir_all(&out).unwrap();
    fs::create_dir_all(&root).unwrap();
    (folder, root, out)
}

#[test]
fn every_field_comes_through() {
    let (_folder, root, out) = folders();
    let episode = fixture::full(&root);
    let (report, trace) = imported(episode.folder(), &out);
    assert_eq!((&report.losses[..], &report.notes[..]), (&[][..], &[][..]));
    assert_eq!(
        (report.steps, report.images, report.end, report.success),
        (13, 12, EndReason::Finished, Some(true))
    );

    let header = &trace.header;
    assert_eq!(
        (header.backend, header.profile, header.sim_version),
        (Backend::Proxy, Profile::RealRepo, 0)
    );
    assert_eq!(
        (header.run_id.as_str(), header.policy.name.as_str()),
        ("run", "qwen-vl")
    );
    assert_eq!(
        header.policy.parameters.get("lora_enabled"),
        Some(&json!(true))
    );
    let task = &trace.task;
    assert_eq!(
        (task.task_id.as_str(), task.family, task.fuzzy),
        ("SUL/verify_task_9", Family::SUL, true)
    );
    assert_eq!(
        (task.target.as_str(), task.src.as_str(), task.dest.as_str()),
        (APPLE, "table_1", "fridge_0")
    );
    assert_eq!(task.target_object().category, "apple");
    assert_eq!(task.object(&OTHER.into()).unwrap().category, "green apple");
    assert_eq!(task.extra.get("episode_idx"), Some(&json!(3)));
    assert_eq!(trace.scene.scene_id, SCENE);
    assert!(
        trace
            .scene
            .receptacle(&"fridge_0".into())
            .unwrap()
            .door
            .exists()
    );
    assert_eq!(
        trace.start.graphs.registry.door(&"fridge_0".into()),
        Some(DoorState::Closed)
    );

    let code = |step: usize| trace.steps[step].outcome.error;
    let failed: Vec<_> = (0..13)
        .filter_map(|step| Some((step, code(step)?)))
        .collect();
    let expected = [
        (0, ErrorCode::NoLandmark),
        (5, ErrorCode::UnknownMarker),
        (9, ErrorCode::DoorClosed),
    ];
    assert_eq!(failed, expected);
    let changes = |step: usize| {
        trace.steps[step]
            .changes
            .registry
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert_eq!(changes(6), format!("-{APPLE}@table_1"));
    assert_eq!(changes(10), "fridge_0.door: closed -> open");
    assert_eq!(changes(11), format!("+{APPLE}@fridge_0"));
    assert!(
        (0..13)
            .filter(|step| ![6, 10, 11].contains(step))
            .all(|step| changes(step).is_empty())
    );
    assert!(
        trace
            .steps
            .iter()
            .all(|step| step.changes.physics == step.changes.registry)
    );

    let pick = &trace.steps[6];
    assert_eq!(
        (pick.tool.as_deref(), pick.input.call.name.as_str()),
        (Some("pick"), "pick")
    );
    assert_eq!(pick.input.call.arguments, json!({"marker_id": "1"}));
    assert_eq!(
        (
            pick.object.as_ref().unwrap().as_str(),
            pick.receptacle.as_ref().unwrap().as_str()
        ),
        (APPLE, "table_1")
    );
    let held: Vec<usize> = trace
        .steps
        .iter()
        .enumerate()
        .filter(|(_, step)| step.held.is_some())
        .map(|(step, _)| step)
        .collect();
    assert_eq!(held, [6, 7, 8, 9, 10]);
    let place = &trace.steps[11];
    assert_eq!(
        (
            place.object.as_ref().unwrap().as_str(),
            place.receptacle.as_ref().unwrap().as_str()
        ),
        (APPLE, "fridge_0")
    );
    let go = &trace.steps[1];
    assert_eq!(
        (go.tool.as_deref(), go.input.call.name.as_str()),
        (Some("nav_to"), "navigate_to")
    );
    assert_eq!(
        (go.robot.base, go.robot.camera),
        ([1.5, -0.25], [1.5, -0.25, 1.4])
    );
    assert_eq!(trace.steps[2].listed, [APPLE.into(), OTHER.into()]);
    assert_eq!(
        trace.steps[2].markers[0].target,
        MarkerTarget::Object(APPLE.into())
    );
    assert_eq!(
        trace.steps[8].markers[0].target,
        MarkerTarget::Receptacle("fridge_0".into())
    );

    let ask = &trace.steps[3];
    let reply = ask.reply.as_ref().unwrap();
    assert_eq!(
        (reply.text.as_str(), reply.source),
        ("apple - A red apple.", UserSource::RuleBased)
    );
    assert_eq!(ask.input.user_reply.as_ref(), Some(reply));
    assert!(
        ask.outcome.text.contains(r#""source":"task_metadata""#),
        "{}",
        ask.outcome.text
    );

    let policy = trace.steps[2].input.policy.as_ref().unwrap();
    assert!(
        policy.raw.starts_with("<think>thought 2</think>"),
        "{}",
        policy.raw
    );
    assert_eq!(
        (policy.reasoning.as_str(), policy.history.as_str()),
        ("thought 2", "did 2 things")
    );
    assert_eq!(
        policy.plan,
        "New Schedule: go on Current subtask: explore_receptacle"
    );
    assert_eq!(policy.latency_ns, Some(3_250_000_000));

    for step in 0..12 {
        let rgb = trace.frame_rgb(Some(step)).unwrap().unwrap();
        assert!(
            rgb == fixture::pixels(FRAME_WIDTH, FRAME_HEIGHT, step as u8),
            "the image of step {step} changed"
        );
    }
    assert_eq!((trace.image(None), trace.image(Some(12))), (None, None));
}

#[test]
fn rewards_and_metrics_are_those_of_the_steps() {
    let (_folder, root, out) = folders();
    let (_, trace) = imported(fixture::full(&root).folder(), &out);
    let again = reel_reward::rewards(
        &Default::default(),
        &trace.task,
        &trace.scene,
        &trace.start,
        &trace.steps,
    );
    assert!(
        trace
            .steps
            .iter()
            .zip(&again)
            .all(|(step, terms)| step.reward == *terms)
    );
    let end = trace.end.as_ref().unwrap();
    assert_eq!(
        end.metrics,
        reel_reward::metrics(
            &Default::default(),
            &trace.task,
            &trace.start,
            &trace.steps,
            &end.graphs
        )
    );
    // By hand: five elements matched (1.5 + 0.4 each), all hold (2.0), valid pick and transit
    // (0.8), an ask among two apples (1.0), ten paid decisions, one severe and two moderate errors.
    let expected = 5.0 * 1.9 + 2.0 + 0.8 + 1.0 - 10.0 * 0.03 - 0.5 - 0.6;
    assert!(
        (end.metrics.total_reward - expected).abs() < 1e-9,
        "{} is not {expected}",
        end.metrics.total_reward
    );
    assert_eq!(
        (end.metrics.length, end.metrics.asks, end.metrics.spl),
        (13, 1, None)
    );
}

#[test]
fn every_status_has_its_end() {
    let (_folder, root, out) = folders();
    let [horizon, inference, action, skipped] = <[Episode; 4]>::try_from(fixture::others(&root))
        .ok()
        .unwrap();
    let (report, trace) = imported(horizon.folder(), &out);
    assert_eq!(
        (report.end, report.steps, report.losses.len()),
        (EndReason::Horizon, 4, 0)
    );
    let codes: Vec<_> = trace.steps.iter().map(|step| step.outcome.error).collect();
    let expected = [
        Some(ErrorCode::UnparsableOutput),
        None,
        Some(ErrorCode::NothingFound),
        Some(ErrorCode::BadArguments),
    ];
    assert_eq!(codes, expected);
    let policy = trace.steps[1].input.policy.as_ref().unwrap();
    assert_eq!(policy.reasoning, "thought 1");
    assert!(policy.raw.contains("\"tool_calls\""), "{}", policy.raw);
    assert_eq!(
        report.notes,
        ["no step before step 1 shows a graph; the start is taken from there"]
    );

    for failed in [inference, action] {
        let (report, trace) = imported(failed.folder(), &out);
        assert_eq!(
            (report.end, report.steps, trace.steps.len()),
            (EndReason::Fault, 1, 1)
        );
        assert_eq!((&report.losses[..], &report.notes[..]), (&[][..], &[][..]));
    }
    assert!(matches!(
        import(skipped.folder(), &out, &PLAIN),
        Err(ImportError::Skipped { .. })
    ));
}

#[test]
fn importing_again_gives_the_same_bytes_in_any_order_and_place() {
    let (folder, root, out) = folders();
    fixture::full(&root);
    fixture::others(&root);
    let found = episodes(&root).unwrap();
    assert_eq!(found.len(), 5);
    let all = |found: &[PathBuf], out: &Path| {
        fs::create_dir_all(out).unwrap();
        found
            .iter()
            .filter(|episode| import(episode, out, &PLAIN).is_ok())
            .count()
    };
    assert_eq!(all(&found, &out), 4);
    let moved = folder.path().join("elsewhere");
    fs::rename(&root, &moved).unwrap();
    let mut reversed = episodes(&moved.join(SCENE)).unwrap();
    reversed.reverse();
    let again = folder.path().join("again");
    assert_eq!(all(&reversed, &again), 4);
    let names = |folder: &Path| {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name())
            .collect();
        names.sort();
        names
    };
    assert_eq!(names(&out), names(&again));
    for name in names(&out) {
        assert!(
            fs::read(out.join(&name)).unwrap() == fs::read(again.join(&name)).unwrap(),
            "{name:?} has other bytes"
        );
    }
    // Over what is already there, too.
    let before = fs::read(again.join(&names(&again)[0])).unwrap();
    assert_eq!(all(&reversed, &again), 4);
    assert!(before == fs::read(again.join(&names(&again)[0])).unwrap());
}

#[test]
fn runs_that_went_otherwise_have_other_names() {
    let (_folder, root, out) = folders();
    let one = fixture::full(&root.join("monday"));
    let two = fixture::full(&root.join("tuesday"));
    let (a, _) = imported(one.folder(), &out);
    let (b, _) = imported(two.folder(), &out);
    assert_eq!(a.trace, b.trace);
    fs::write(
        two.folder().join("step_001/raw_response.txt"),
        "another thought",
    )
    .unwrap();
    let (b, _) = imported(two.folder(), &out);
    assert_ne!(a.trace, b.trace);
}

#[test]
fn the_older_layout_reads_the_same() {
    let (_folder, root, out) = folders();
    let mut episode = fixture::full(&root);
    let (_, new) = imported(episode.folder(), &out);
    for step in 0..13 {
        let folder = episode.folder().join(format!("step_{step:03}"));
        let debug = folder.join("debug_info.json");
        let mut debug_info: serde_json::Value =
            serde_json::from_slice(&fs::read(&debug).unwrap()).unwrap();
        let graph = debug_info["world_graph"].take();
        let full: Vec<String> = graph
            .as_object()
            .into_iter()
            .flatten()
            .filter_map(|(receptacle, state)| {
                let content: Vec<String> = state["content"]
                    .as_array()?
                    .iter()
                    .map(|object| format!("'{}'", object.as_str().unwrap()))
                    .collect();
                (!content.is_empty()).then(|| format!("{receptacle}: [{}]\n", content.join(", ")))
            })
            .collect();
        if graph.is_object() {
            debug_info["WORLD_GRAPH"] = full.concat().into();
        }
        fixture::write_json(&debug, &debug_info);
        let frame = folder.join("image_observation_0.png");
        if frame.exists() {
            fs::rename(frame, folder.join("image_observation.png")).unwrap();
        }
        fixture::write_json(
            &folder.join("inference_time.json"),
            &json!({"infer_time": 1.25 + f64::from(step)}),
        );
    }
    // A client that kept the whole `finish` payload.
    episode.write_meta(|meta| {
        meta["initial_world_graph"] =
            json!({"table_1": {"content": [APPLE, OTHER]}, "table_2": {"content": []}, "fridge_0": {"content": [], "door": false}});
        meta["rooms_and_furniture"] = json!({"kitchen/0": ["fridge_0"], "hall/0": ["table_1", "table_2"]});
        meta["destination_distractors"] = json!(["table_2"]);
    });
    let (report, old) = imported(episode.folder(), &out);
    assert_eq!(report.losses, []);
    assert_eq!(
        old.scene.receptacle(&"fridge_0".into()).unwrap().room,
        "kitchen/0"
    );
    assert_eq!(old.task.dest_distractors, ["table_2".into()]);
    assert!(report.success == Some(true) && old.start.graphs == new.start.graphs);
    for (old, new) in old.steps.iter().zip(&new.steps) {
        // The older summary has no doors: opening one is not seen.
        let changes: Vec<_> = new
            .changes
            .registry
            .iter()
            .filter(|event| event.object().is_some())
            .cloned()
            .collect();
        assert_eq!(
            (&old.changes.registry, &old.held, &old.outcome),
            (&changes, &new.held, &new.outcome)
        );
        assert_eq!(old.input, new.input);
    }
}

#[test]
fn the_task_file_is_used_where_it_is_given() {
    let (_folder, root, out) = folders();
    let episode = fixture::full(&root);
    let (_, plain) = imported(episode.folder(), &out);
    let task = Task {
        purpose: Some("fruit".into()),
        precise_instruction: "The red one.".into(),
        ..(*plain.task).clone()
    };
    let scenes = plain.scene.clone().into();
    let tasks = [
        Arc::new(Task {
            task_id: "FDP/other".into(),
            ..task.clone()
        }),
        Arc::new(task.clone()),
    ];
    let options = ImportOptions {
        tasks: &tasks,
        scenes: Some(&scenes),
        ..PLAIN
    };
    let (report, trace) = imported_with(episode.folder(), &out, &options);
    assert_eq!((&*trace.task, &report.notes[..]), (&task, &[][..]));

    // Also without a word about the task, by the name of its folder.
    fs::remove_file(episode.folder().join("task_meta.json")).unwrap();
    let (_, trace) = imported_with(episode.folder(), &out, &options);
    assert_eq!(
        (&*trace.task, trace.header.policy.name.as_str()),
        (&task, "qwen_vl")
    );
    let error = import(episode.folder(), &out, &PLAIN)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("no source_furniture") && error.contains("--tasks"),
        "{error}"
    );
}

#[test]
fn a_question_among_what_only_the_camera_saw_is_open() {
    let (_folder, root, out) = folders();
    let (_, full) = imported(fixture::full(&root).folder(), &out);
    let mut episode = Episode::new(&root, "SUL", "verify_task_9", "m");
    episode.landmark = json!("table_1");
    episode.text_step(
        "navigate_to",
        json!({"receptacle_name": "table_1"}),
        Shown::Image,
    );
    // The other apple is of another category and gets no marker.
    episode.markers = json!({"1": APPLE});
    episode.text_step(
        "find_objects",
        json!({"target_category": "apple"}),
        Shown::Image,
    );
    let nobody = json!({"error": "simulated_user_context_unavailable", "source": "task_metadata"});
    episode.text_step(
        "ask",
        json!({"target_category": "apple", "target_description": "which one?"}),
        Shown::Text(nobody.to_string()),
    );
    episode.finish(false);
    let (tasks, scenes) = ([full.task.clone()], full.scene.clone().into());
    let options = ImportOptions {
        tasks: &tasks,
        scenes: Some(&scenes),
        ..PLAIN
    };
    let plain = imported_with(episode.folder(), &root, &PLAIN).0;
    let open = "nothing tells which objects fit the task's words, and from step 2 on";
    assert!(
        plain.notes.iter().any(|note| note.starts_with(open)),
        "{:?}",
        plain.notes
    );
    let (report, trace) = imported_with(episode.folder(), &out, &options);
    assert_eq!(
        report.notes,
        [
            "nothing tells what the camera saw, and from step 2 on the reward for asking depends \
             on it: the total lies between 1.870 and 2.870"
        ]
    );
    let total = trace.end.as_ref().unwrap().metrics.total_reward;
    assert!((total - 1.87).abs() < 1e-9, "{total}");
}

#[test]
fn what_the_files_leave_open_is_said() {
    let (_folder, root, out) = folders();
    let mut episode = Episode::new(&root, "FDP", "verify_task_7", "m");
    episode.text_step(
        "navigate_to",
        json!({"receptacle_name": "table_1"}),
        Shown::Image,
    );
    fs::write(
        episode.next_step().join("user_message.txt"),
        "You are a robot.",
    )
    .unwrap();
    let (report, _) = imported(episode.folder(), &out);
    assert_eq!((report.end, report.steps), (EndReason::Aborted, 1));
    assert_eq!(
        report.notes,
        ["step 1 was begun, and no call of it was written down"]
    );

    episode.write_meta(|meta| {
        meta["family"] = serde_json::Value::Null;
        meta["benchmark_task_id"] = json!("verify_task_7");
    });
    episode.summary("finished", true);
    let renamed = root.join("one-folder");
    fs::rename(episode.folder(), &renamed).unwrap();
    let (report, trace) = imported(&renamed, &out);
    assert_eq!(
        (trace.task.task_id.as_str(), trace.task.family),
        ("verify_task_7", Family::FDP)
    );
    assert!(
        report
            .notes
            .iter()
            .any(|note| note.starts_with("the family is not known")),
        "{:?}",
        report.notes
    );
    assert!(
        report
            .notes
            .iter()
            .any(|note| note.contains("success true, the graphs false")),
        "{:?}",
        report.notes
    );
}
