//! Recordings of robots hold the same in every encoding, in parts, out of order and broken; and no
//! recording makes the importer panic.

mod faults;
mod sensors;

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use mcap::Compression;
use proptest::prelude::*;
use reel_import::{
    ImportError, ImportOptions,
    robot::{Mapping, Recording, import, recordings},
};
use reel_trace::{Timing, Trace, examine};
use reel_world::{
    ErrorCode, FRAME_HEIGHT, FRAME_WIDTH,
    record::{Backend, EndReason, UserSource},
};
use serde_json::{Value, json};

use crate::{
    PLAIN,
    bags::{self, BEGIN_NS, Encoding, MAPPING, Said, TRIALS, jpeg, odometry, said},
};

const APPLE: &str = "_a1_on_table_1_at_kitchen";

struct Place {
    folder: tempfile::TempDir,
    out: PathBuf,
}

impl Place {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("traces");
        fs::create_dir_all(&out).unwrap();
        Self { folder, out }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Imports a recording with one mapping; its traces are whole and healthy.
    fn import_by(
        &self,
        mapping: &str,
        path: &Path,
        options: &ImportOptions<'_>,
    ) -> (Recording, Vec<Trace>) {
        let mapping = Mapping::parse(mapping).unwrap();
        let recording =
            import(path, &mapping, &self.out, options).unwrap_or_else(|error| panic!("{error}"));
        let traces = recording
            .episodes
            .iter()
            .map(|imported| healthy(&imported.trace))
            .collect();
        (recording, traces)
    }

    fn import(&self, path: &Path) -> (Recording, Trace) {
        let (recording, mut traces) = self.import_by(MAPPING, path, &PLAIN);
        assert_eq!(traces.len(), 1);
        (recording, traces.remove(0))
    }

    /// Writes messages in JSON and imports them.
    fn said(&self, messages: &[Said]) -> (Recording, Trace) {
        let path = self.path("said.mcap");
        bags::write(&path, messages, Encoding::Json);
        self.import(&path)
    }
}

fn healthy(path: &Path) -> Trace {
    let trace = Trace::read(path).unwrap_or_else(|error| panic!("{error}"));
    let examination = examine(path).unwrap();
    assert_eq!(examination.findings, []);
    assert_eq!(
        examination.notes,
        ["recorded on a robot: nothing to re-execute"]
    );
    trace
}

fn bytes(recording: &Recording) -> Vec<u8> {
    fs::read(&recording.episodes[0].trace).unwrap()
}

fn graph(apple: Option<&str>, open: bool) -> Value {
    let on = |place: &str| {
        if apple == Some(place) {
            vec![APPLE]
        } else {
            vec![]
        }
    };
    let graph = json!({"table_1": {"content": on("table_1")}, "fridge_0": {"content": on("fridge_0"), "door": open}});
    json!({ "data": graph.to_string() })
}

fn call(ms: u64, id: &str, tool: &str, arguments: Value) -> Said {
    said(
        ms,
        "/call",
        json!({"id": id, "tool": tool, "arguments": arguments.to_string()}),
    )
}

fn result(ms: u64, id: &str, text: &str, success: bool) -> Said {
    said(
        ms,
        "/result",
        json!({"id": id, "text": text, "success": success, "error": ""}),
    )
}

/// An episode with everything in it.
fn episode() -> Vec<Said> {
    let markers = json!({"data": json!({"1": APPLE, "2": "fridge_0"}).to_string()});
    vec![
        odometry(0, -3.0, 0.0),
        odometry(50, 0.0, 0.0),
        said(
            100,
            "/episode",
            json!({"event": "start", "task_id": "FDP/apple", "instruction": "Put the apple into the fridge.",
                "policy": "", "reason": "", "success": false, "shortest_path_m": 4.0}),
        ),
        said(150, "/graph", graph(Some("table_1"), false)),
        jpeg(200, (320, 240), [200, 0, 0]),
        said(
            300,
            "/policy",
            json!({"raw": "<think>there</think>", "latency_s": 1.5}),
        ),
        call(1_000, "a", "nav_to", json!({"receptacle_name": "table_1"})),
        odometry(1_500, 3.0, 0.0),
        odometry(2_000, 3.0, 4.0),
        said(2_100, "/diagnostics", json!({"data": "all is well"})),
        said(
            2_200,
            "/alignment",
            json!({"target": "table", "odometry_error_m": 0.0178, "yaw_error_rad": -0.01, "image_shift_px": 3.5}),
        ),
        jpeg(2_400, (1280, 720), [0, 200, 0]),
        result(2_500, "a", "arrived", true),
        jpeg(2_600, (640, 480), [9, 9, 9]),
        said(2_700, "/markers", markers),
        call(3_000, "b", "grasp", json!({"number": 1})),
        said(3_100, "/vla", json!({"latency_s": 0.25})),
        said(3_200, "/vla", json!({"latency_s": 0.5})),
        said(
            3_900,
            "/primitive",
            json!({"skill": "grasp", "target": "table", "success": false, "duration_s": 0.8, "control_steps": 40, "error": "slipped"}),
        ),
        result(4_000, "b", "the gripper is empty", false),
        jpeg(4_100, (640, 480), [0, 0, 200]),
        call(5_000, "c", "grasp", json!({"number": 1})),
        said(5_800, "/held", json!({ "data": APPLE })),
        said(5_900, "/graph", graph(None, false)),
        result(6_000, "c", "", true),
        call(7_000, "d", "ask", json!({"question": "Which fridge?"})),
        said(
            8_000,
            "/reply",
            json!({"text": "The white one.", "source": ""}),
        ),
        result(8_100, "d", "The white one.", true),
        call(9_000, "e", "open", json!({"marker_id": 2})),
        said(9_500, "/graph", graph(None, true)),
        result(9_600, "e", "", true),
        call(10_000, "f", "place", json!({"marker_id": 2})),
        result(10_500, "f", "", true),
        said(10_600, "/held", json!({"data": ""})),
        said(10_700, "/graph", graph(Some("fridge_0"), true)),
        call(11_000, "g", "finish", json!({})),
        said(
            11_500,
            "/episode",
            json!({"event": "end", "task_id": "", "instruction": "", "policy": "", "reason": "", "success": true, "shortest_path_m": 0.0}),
        ),
    ]
}

fn without_images() -> Vec<Said> {
    episode()
        .into_iter()
        .filter(|message| message.topic != "/camera")
        .collect()
}

#[test]
fn every_field_comes_through() {
    let place = Place::new();
    let (recording, trace) = place.said(&episode());
    assert_eq!(recording.losses, []);
    assert_eq!(recording.notes, ["no message on /raw"]);
    let imported = &recording.episodes[0];
    assert_eq!(
        (
            imported.steps,
            imported.images,
            imported.end,
            imported.success
        ),
        (7, 3, EndReason::Finished, true)
    );
    assert_eq!(imported.losses, []);
    let notes = [
        "the task is not known; give its task file with --tasks",
        "nothing tells which objects fit the task's words, and from step 3 on the reward for asking depends on it: the total is a lower bound; --tasks gives the task's own file",
        "success is what the recording says (true); no graph and goal tell it",
    ];
    assert_eq!(imported.notes, notes);

    let header = &trace.header;
    assert_eq!(
        (
            header.backend,
            header.sim_version,
            header.policy.name.as_str()
        ),
        (Backend::Robot, 0, "qwen-vl")
    );
    assert_eq!(
        (trace.task.task_id.as_str(), trace.task.instruction.as_str()),
        ("FDP/apple", "Put the apple into the fridge.")
    );
    let calls: Vec<(&str, Option<ErrorCode>)> = trace
        .steps
        .iter()
        .map(|step| (step.tool_name(), step.outcome.error))
        .collect();
    let expected = ["nav_to", "pick", "pick", "ask", "open", "place", "finish"]
        .map(|tool| (tool, None::<ErrorCode>))
        .into_iter()
        .enumerate();
    let expected: Vec<_> = expected
        .map(|(step, (tool, _))| (tool, (step == 1).then_some(ErrorCode::SkillFailed)))
        .collect();
    assert_eq!(calls, expected);
    assert_eq!(
        (
            trace.steps[1].outcome.text.as_str(),
            trace.steps[0].outcome.text.as_str()
        ),
        ("the gripper is empty", "arrived")
    );

    // A call by another name is one of the eleven; as it came it is kept.
    let pick = &trace.steps[2];
    assert_eq!(
        (pick.input.call.name.as_str(), &pick.input.call.arguments),
        ("pick", &json!({"marker_id": 1}))
    );
    assert_eq!(
        pick.input.policy.as_ref().unwrap().raw,
        r#"{"name":"grasp","arguments":{"number":1}}"#
    );
    let thought = trace.steps[0].input.policy.as_ref().unwrap();
    assert_eq!(
        (thought.reasoning.as_str(), thought.latency_ns),
        ("there", Some(1_500_000_000))
    );
    let changes = |step: usize| {
        trace.steps[step]
            .changes
            .registry
            .iter()
            .map(ToString::to_string)
            .collect::<Vec<_>>()
            .join(" ")
    };
    assert_eq!(
        [1, 2, 4, 5].map(changes),
        [
            "",
            &format!("-{APPLE}@table_1"),
            "fridge_0.door: closed -> open",
            &format!("+{APPLE}@fridge_0")
        ]
    );
    assert_eq!(
        (
            pick.object.as_ref().unwrap().as_str(),
            pick.held.as_ref().unwrap().as_str()
        ),
        (APPLE, APPLE)
    );
    assert_eq!(trace.steps[5].held, None);
    let reply = trace.steps[3].reply.as_ref().unwrap();
    assert_eq!(
        (reply.text.as_str(), reply.source),
        ("The white one.", UserSource::Human)
    );

    // What was driven before the episode is not its path.
    let robot = &trace.steps[0].robot;
    assert_eq!(
        (robot.base, robot.path_length_m, trace.start.robot.base),
        ([3.0, 4.0], 7.0, [0.0, 0.0])
    );
    assert!((robot.yaw - std::f32::consts::FRAC_PI_2).abs() < 1e-6);
    assert_eq!(
        (
            trace.start.shortest_path_m,
            trace.end.as_ref().unwrap().metrics.spl
        ),
        (Some(4.0), Some(4.0 / 7.0))
    );
    let timing = Timing {
        called_unix_ns: BEGIN_NS + 1_000_000_000,
        took_ns: 1_500_000_000,
    };
    assert_eq!(trace.timings.get(&0), Some(&timing));
    assert_eq!(trace.timings.get(&6), None);

    let steps: Vec<_> = trace
        .robot
        .odometry
        .iter()
        .map(|measured| measured.step)
        .collect();
    assert_eq!(steps, [None, Some(0), Some(0)]);
    let primitive = &trace.robot.primitives[0];
    assert_eq!(
        (
            primitive.step,
            primitive.skill.as_str(),
            primitive.target.as_str(),
            primitive.success
        ),
        (Some(1), "pick", "table", false)
    );
    assert_eq!(
        (
            primitive.duration_ns,
            primitive.control_steps,
            primitive.error.as_deref()
        ),
        (Some(800_000_000), Some(40), Some("slipped"))
    );
    assert_eq!(
        trace
            .robot
            .vla
            .iter()
            .map(|measured| (measured.step, measured.latency_ns))
            .collect::<Vec<_>>(),
        [(Some(1), 250_000_000), (Some(1), 500_000_000)]
    );
    let alignment = &trace.robot.alignments[0];
    assert_eq!(
        (
            alignment.step,
            alignment.target.as_str(),
            alignment.odometry_error_m,
            alignment.image_rmse_px
        ),
        (Some(0), "table", Some(0.0178), None)
    );

    // The image up to the result, else the first after it; a wide one between black bars; each
    // as it came, too.
    let at = |step: Option<u32>, row: usize| {
        let rgb = trace.frame_rgb(step).unwrap().unwrap();
        let at = (row * FRAME_WIDTH + FRAME_WIDTH / 2) * 3;
        [rgb[at], rgb[at + 1], rgb[at + 2]].map(|value| value / 100)
    };
    assert_eq!(
        (at(None, 240), at(Some(0), 240), at(Some(1), 240)),
        ([2, 0, 0], [0, 2, 0], [0, 0, 2])
    );
    assert_eq!(
        (at(Some(0), 20), at(Some(0), FRAME_HEIGHT - 20)),
        ([0, 0, 0], [0, 0, 0])
    );
    assert_eq!(trace.image(Some(2)), None);
    let sent = STANDARD
        .decode(episode()[11].value["data"].as_str().unwrap())
        .unwrap();
    let original = trace.camera_image(Some(0)).unwrap();
    assert_eq!((original.format.as_str(), &original.data), ("jpeg", &sent));
}

#[test]
fn equal_in_every_encoding_and_compression() {
    let place = Place::new();
    let mut traces = Vec::new();
    for encoding in [Encoding::Json, Encoding::Protobuf, Encoding::Cdr] {
        for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
            let path = place.path(&format!("{encoding:?}-{compression:?}.mcap"));
            bags::write_with(&path, &episode(), encoding, compression);
            let (recording, _) = place.import(&path);
            assert_eq!(recording.losses, [], "{encoding:?} {compression:?}");
            traces.push(bytes(&recording));
        }
    }
    assert!(traces.iter().all(|trace| *trace == traces[0]));
}

#[test]
fn parts_of_a_recording_in_their_order() {
    let place = Place::new();
    let (whole, _) = place.said(&episode());
    let whole = bytes(&whole);
    let folder = place.path("bags/drive");
    fs::create_dir_all(&folder).unwrap();
    let messages = episode();
    for (number, part) in messages.chunks(10).enumerate() {
        bags::write(
            &folder.join(format!("drive_{number}.mcap")),
            part,
            Encoding::Cdr,
        );
    }
    // Without metadata the numbers say the order: ten stands behind two.
    let (recording, _) = place.import(&folder);
    assert!(bytes(&recording) == whole);
    assert!(
        recording.notes[0].starts_with("there is no metadata.yaml"),
        "{:?}",
        recording.notes
    );

    let names: String = (0..4)
        .map(|number| format!("    - drive_{number}.mcap\n"))
        .collect();
    let metadata = |names: &str| {
        format!("rosbag2_bagfile_information:\n  version: 8\n  relative_file_paths:\n{names}")
    };
    fs::write(folder.join("metadata.yaml"), metadata(&names)).unwrap();
    fs::copy(place.path("said.mcap"), place.path("bags/one.mcap")).unwrap();
    assert_eq!(
        recordings(&place.path("bags")).unwrap(),
        [folder.clone(), place.path("bags/one.mcap")]
    );
    let (recording, _) = place.import(&folder);
    assert!(bytes(&recording) == whole);
    assert_eq!((recording.losses.len(), recording.notes.len()), (0, 1));

    // A part that is missing is said, and the others are imported.
    fs::remove_file(folder.join("drive_3.mcap")).unwrap();
    let (recording, trace) = place.import(&folder);
    assert_eq!(
        recording.losses[0].message,
        "metadata.yaml names it, and it is not there"
    );
    assert_eq!(trace.steps.len(), 5);

    fs::write(
        folder.join("metadata.yaml"),
        metadata("    - drive_0.db3\n"),
    )
    .unwrap();
    let error = import(
        &folder,
        &Mapping::parse(MAPPING).unwrap(),
        &place.out,
        &PLAIN,
    )
    .unwrap_err();
    assert!(
        matches!(&error, ImportError::Storage { reason, .. } if reason.contains("ros2 bag convert")),
        "{error}"
    );
}

#[test]
fn bare_primitives_are_steps() {
    let place = Place::new();
    let skills = ["pick", "place", "open", "close"];
    let messages: Vec<Said> = (0..600u64)
        .flat_map(|trial| {
            let at = trial * 60_000;
            let success = trial % 10 != 3;
            let value = json!({"skill": skills[trial as usize % 4], "target": "desk", "success": success, "duration_s": 40.0,
                "control_steps": 900, "error": if success { "" } else { "missed" }});
            [odometry(at + 30_000, trial as f64, 0.0), said(at + 50_000, "/primitive", value)]
        })
        .collect();
    let path = place.path("trials.mcap");
    bags::write(&path, &messages, Encoding::Cdr);
    let (recording, traces) = place.import_by(TRIALS, &path, &PLAIN);
    assert_eq!(recording.losses, []);
    let trace = &traces[0];
    assert_eq!(
        (
            trace.steps.len(),
            trace.robot.primitives.len(),
            trace.robot.odometry.len()
        ),
        (600, 600, 600)
    );
    for (number, step) in trace.steps.iter().enumerate() {
        assert_eq!(step.tool.as_deref(), Some(skills[number % 4]));
        assert_eq!(
            step.outcome.error,
            (number % 10 == 3).then_some(ErrorCode::SkillFailed)
        );
        assert_eq!(
            step.outcome.text,
            if number % 10 == 3 { "missed" } else { "" }
        );
        assert_eq!(
            (step.robot.base, step.robot.path_length_m),
            ([number as f32, 0.0], number as f32)
        );
        let called_unix_ns = BEGIN_NS + (number as u64 * 60_000 + 10_000) * 1_000_000;
        assert_eq!(
            trace.timings.get(&step.step),
            Some(&Timing {
                called_unix_ns,
                took_ns: 40_000_000_000
            })
        );
        // Driven while the skill was executed.
        assert_eq!(trace.robot.odometry[number].step, Some(step.step));
        assert_eq!(
            (
                trace.robot.primitives[number].step,
                trace.robot.primitives[number].target.as_str()
            ),
            (Some(step.step), "desk")
        );
    }
    // Equal trials at other times are other episodes.
    let later: Vec<Said> = messages
        .iter()
        .map(|message| Said {
            ns: message.ns + 1,
            ..message.clone()
        })
        .collect();
    bags::write(&path, &later, Encoding::Cdr);
    let (again, _) = place.import_by(TRIALS, &path, &PLAIN);
    assert_ne!(again.episodes[0].trace, recording.episodes[0].trace);
}

#[test]
fn alignment_alone() {
    let place = Place::new();
    let path = place.path("alignment.mcap");
    let value = |error: f64| json!({"target": "desk", "odometry_error_m": error, "yaw_error_rad": 0.01, "image_shift_px": 1.0});
    let messages: Vec<Said> = (1..=20)
        .map(|trial| said(trial * 1_000, "/alignment", value(0.001 * trial as f64)))
        .collect();
    bags::write(&path, &messages, Encoding::Protobuf);
    let (_, traces) = place.import_by(TRIALS, &path, &PLAIN);
    assert_eq!(
        (traces[0].steps.len(), traces[0].robot.alignments.len()),
        (0, 20)
    );
    assert!(
        traces[0]
            .robot
            .alignments
            .iter()
            .all(|alignment| alignment.step.is_none() && alignment.image_shift_px == Some(1.0))
    );
}

#[test]
fn several_episodes_in_a_recording() {
    let place = Place::new();
    let told = |ms: u64, value: Value| said(ms, "/episode", value);
    let messages = vec![
        said(500, "/graph", graph(None, true)),
        told(
            1_000,
            json!({"event": "start", "task_id": "FDO/one", "family": "FDO", "policy": "a", "operator": "Kim"}),
        ),
        call(2_000, "", "nav_to", json!({"receptacle_name": "table_1"})),
        call(3_000, "", "pick", json!({"marker_id": 1})),
        result(4_000, "", "", false),
        told(
            5_000,
            json!({"event": "end", "reason": "max_steps", "success": false}),
        ),
        // Put back between the episodes: no change of either.
        said(5_500, "/graph", graph(Some("table_1"), false)),
        told(6_000, json!({"task_id": "SUL/two", "success": true})),
        call(7_000, "", "finish", json!({})),
        result(7_100, "", "bye", true),
        // Nobody says that the third begins.
        call(8_000, "", "walk_around", json!({})),
        result(9_000, "", "1: a(an) apple.", true),
    ];
    let path = place.path("three.mcap");
    bags::write(&path, &messages, Encoding::Json);
    let (recording, traces) = place.import_by(MAPPING, &path, &PLAIN);
    assert_eq!(recording.losses, []);
    let ends: Vec<_> = recording
        .episodes
        .iter()
        .map(|it| (it.task_id.as_str(), it.steps, it.end, it.success))
        .collect();
    let expected = [
        ("FDO/one", 2, EndReason::Horizon, false),
        ("SUL/two", 1, EndReason::Finished, false),
        ("unknown", 1, EndReason::Aborted, false),
    ];
    assert_eq!(ends, expected);
    let codes: Vec<_> = traces[0]
        .steps
        .iter()
        .map(|step| step.outcome.error)
        .collect();
    assert_eq!(
        codes,
        [Some(ErrorCode::BackendError), Some(ErrorCode::SkillFailed)]
    );
    assert_eq!(
        (
            traces[0].header.policy.name.as_str(),
            traces[1].header.policy.name.as_str()
        ),
        ("a", "qwen-vl")
    );
    assert_eq!(
        traces[0].header.policy.parameters,
        [("operator".to_owned(), json!("Kim"))].into()
    );
    assert_eq!(
        traces[1]
            .start
            .graphs
            .registry
            .receptacle_of(&APPLE.into())
            .unwrap()
            .as_str(),
        "table_1"
    );
    assert!(
        traces
            .iter()
            .flat_map(|trace| &trace.steps)
            .all(|step| step.changes.registry.is_empty())
    );
}

fn start_of_a_known_task() -> Value {
    json!({"event": "start", "task_id": "FDP/apple", "source_furniture": "table_1", "destination_furniture": "fridge_0",
        "target_object": {"name": APPLE, "id": "_a1", "category": "apple"}})
}

#[test]
fn a_task_that_is_known_is_judged_by_the_graphs() {
    let place = Place::new();
    let mut messages = episode();
    messages[2].value = start_of_a_known_task();
    messages.last_mut().unwrap().value = json!({"event": "end", "success": false});
    let (recording, trace) = place.said(&messages);
    assert!(recording.episodes[0].success);
    assert_eq!(
        recording.episodes[0].notes[1..],
        [
            "nothing tells which objects fit the task's words, and from step 3 on the reward for asking depends on it: the total is a lower bound; --tasks gives the task's own file",
            "the recording says success false, the graphs true"
        ]
    );
    assert_eq!(trace.task.target.as_str(), APPLE);

    // Its file goes before what the recording says, and is the one of recordings that name none.
    let task = Arc::new(reel_world::Task {
        instruction: "As it is in the file.".into(),
        ..reel_world::Task::clone(&trace.task)
    });
    let (tasks, path) = ([task], place.path("said.mcap"));
    let scenes = trace.scene.clone().into();
    let options = ImportOptions {
        tasks: &tasks,
        scenes: Some(&scenes),
        ..PLAIN
    };
    let (_, traces) = place.import_by(MAPPING, &path, &options);
    assert_eq!(traces[0].task.instruction, "As it is in the file.");
    messages.remove(2);
    bags::write(&path, &messages, Encoding::Json);
    let (recording, traces) = place.import_by(MAPPING, &path, &options);
    assert_eq!(
        (
            traces[0].task.instruction.as_str(),
            recording.episodes[0].success
        ),
        ("As it is in the file.", true)
    );
}

#[test]
fn poses_are_brought_into_the_frame_of_the_scene() {
    let place = Place::new();
    let mut messages = episode();
    messages[2].value = start_of_a_known_task();
    let (_, plain) = place.said(&messages);
    let mut scene = reel_world::Scene::clone(&plain.scene);
    let centres = [[1.0, 2.0], [4.0, 2.5]];
    for (receptacle, [x, y]) in scene.receptacles.iter_mut().zip(centres) {
        receptacle.surface_min = [x - 0.5, y - 0.3, 0.7];
        receptacle.surface_max = [x + 0.5, y + 0.3, 0.7];
    }
    let (yaw, shift) = (0.6_f64, [-3.0, 1.5]);
    let moved = |[x, y]: [f64; 2]| {
        let (sine, cosine) = yaw.sin_cos();
        [
            cosine * x - sine * y + shift[0],
            sine * x + cosine * y + shift[1],
        ]
    };
    // The map is the scene, moved back; each receptacle is 5 cm off, one outwards and one inwards.
    let back = |[x, y]: [f64; 2]| {
        let [x, y] = [x - shift[0], y - shift[1]];
        let (sine, cosine) = yaw.sin_cos();
        [cosine * x + sine * y, -sine * x + cosine * y]
    };
    let between = [centres[1][0] - centres[0][0], centres[1][1] - centres[0][1]];
    let length = between[0].hypot(between[1]);
    let off = between.map(|axis| 0.05 * axis / length);
    let shown = [
        back([centres[0][0] - off[0], centres[0][1] - off[1]]),
        back([centres[1][0] + off[0], centres[1][1] + off[1]]),
    ];
    let ids: Vec<String> = scene
        .receptacles
        .iter()
        .map(|it| it.id.to_string())
        .collect();
    let map = json!({&ids[0]: shown[0], &ids[1]: {"position": {"x": shown[1][0], "y": shown[1][1]}}, "sofa_9": [0, 0]});
    messages.insert(0, said(0, "/map", json!({"data": map.to_string()})));
    let path = place.path("said.mcap");
    bags::write(&path, &messages, Encoding::Json);
    let mapping = format!("{MAPPING}\"/map\" = {{ is = \"map\" }}\n");
    let task = reel_world::Task {
        scene_id: scene.scene_id.clone(),
        ..reel_world::Task::clone(&plain.task)
    };
    let (tasks, scenes) = ([Arc::new(task)], Arc::new(scene).into());
    let options = ImportOptions {
        tasks: &tasks,
        scenes: Some(&scenes),
        ..PLAIN
    };
    let (recording, traces) = place.import_by(&mapping, &path, &options);
    let notes = recording.episodes[0].notes.join("\n");
    let wanted = "laid over the scene by 2 receptacles: turned by 34.4 degrees, moved by -3.00 m, 1.50 m; left over: 0.050 m root mean square";
    assert!(notes.contains(wanted), "{notes}");
    let settings = &traces[0].header.policy.parameters["map_alignment"];
    assert!((settings["rmse_m"].as_f64().unwrap() - 0.05).abs() < 1e-9);
    let near = |a: f64, b: f64| (a - b).abs() < 1e-6;
    assert!(!plain.robot.odometry.is_empty());
    for (before, after) in plain.robot.odometry.iter().zip(&traces[0].robot.odometry) {
        let [x, y] = moved([before.x, before.y]);
        assert!(near(after.x, x) && near(after.y, y), "{before:?} {after:?}");
        assert!(near((after.yaw - before.yaw - yaw).sin(), 0.0));
    }
    for (before, after) in plain.steps.iter().zip(&traces[0].steps) {
        assert_eq!(before.robot.path_length_m, after.robot.path_length_m);
        let [x, y] = moved(before.robot.base.map(f64::from));
        assert!((f64::from(after.robot.base[0]) - x).abs() < 1e-4);
        assert!((f64::from(after.robot.base[1]) - y).abs() < 1e-4);
    }
    // Without two receptacles of the scene nothing is moved, and it is said.
    let (recording, traces) = place.import_by(&mapping, &path, &PLAIN);
    let notes = recording.episodes[0].notes.join("\n");
    assert!(notes.contains("no two receptacles in common"), "{notes}");
    assert_eq!(traces[0].robot.odometry, plain.robot.odometry);
}

#[test]
fn raw_images_in_every_order_of_colours() {
    let place = Place::new();
    let mut messages = Vec::new();
    let orders: [(&str, &[u8], u32); 5] = [
        ("rgb8", &[250, 130, 10], 0),
        ("bgr8", &[10, 130, 250], 6),
        ("rgba8", &[250, 130, 10, 7], 0),
        ("bgra8", &[10, 130, 250, 7], 1),
        ("mono8", &[99], 3),
    ];
    for (number, (encoding, pixel, padding)) in (1..).zip(orders) {
        let row = [pixel.repeat(640), vec![0; padding as usize]].concat();
        let data = STANDARD.encode(row.repeat(480));
        let value = json!({"width": 640, "height": 480, "encoding": encoding, "step": row.len(), "data": data});
        messages.extend([
            call(number * 100, "", "walk_around", json!({})),
            said(number * 100 + 1, "/raw", value),
        ]);
    }
    let broken = json!({"width": 640, "height": 480, "encoding": "rgb8", "step": 1920, "data": ""});
    messages.extend([
        call(900, "", "walk_around", json!({})),
        said(901, "/raw", broken),
    ]);
    let path = place.path("raw.mcap");
    bags::write(&path, &messages, Encoding::Cdr);
    let (recording, trace) = place.import(&path);
    assert!(
        recording.losses[0]
            .message
            .contains("(0 bytes for 640 x 480 pixels in rgb8)"),
        "{:?}",
        recording.losses
    );
    for (step, expected) in [
        (0, [250, 130, 10]),
        (1, [250, 130, 10]),
        (2, [250, 130, 10]),
        (3, [250, 130, 10]),
        (4, [99, 99, 99]),
    ] {
        let rgb = trace.frame_rgb(Some(step)).unwrap().unwrap();
        assert!(
            rgb.chunks_exact(3).all(|pixel| pixel == expected),
            "step {step}"
        );
        // The image of the step is all there is to it.
        assert_eq!(trace.camera_image(Some(step)), None);
    }
    assert_eq!(trace.image(Some(5)), None);
}

#[test]
fn the_example_of_a_mapping_is_one() {
    let path =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../schemas/robot_mapping.example.toml");
    let text = fs::read_to_string(path).unwrap();
    Mapping::parse(&text).unwrap_or_else(|error| panic!("{error}"));
    // It names every kind of topic.
    for kind in [
        "call",
        "result",
        "primitive",
        "vla",
        "odometry",
        "alignment",
        "camera",
        "graph",
        "held",
        "landmark",
        "map",
        "markers",
        "reply",
        "policy",
        "episode",
    ] {
        assert!(text.contains(&format!("is = \"{kind}\"")), "{kind}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn changed_bytes_never_panic(
        encoding in prop_oneof![Just(Encoding::Json), Just(Encoding::Protobuf), Just(Encoding::Cdr)],
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let place = Place::new();
        let path = place.path("changed.mcap");
        // Without compression and checksums every change reaches the messages.
        bags::write_with(&path, &without_images(), encoding, None);
        let mut bytes = fs::read(&path).unwrap();
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()));
        }
        fs::write(&path, &bytes).unwrap();
        if let Ok(recording) = import(&path, &Mapping::parse(MAPPING).unwrap(), &place.out, &PLAIN) {
            recording.episodes.iter().for_each(|imported| drop(healthy(&imported.trace)));
        }
    }

    #[test]
    fn changed_messages_never_panic(
        encoding in prop_oneof![Just(Encoding::Json), Just(Encoding::Protobuf), Just(Encoding::Cdr)],
        changes in prop::collection::vec((any::<prop::sample::Index>(), prop::collection::vec(any::<u8>(), 0..80)), 1..12),
    ) {
        let place = Place::new();
        let path = place.path("changed.mcap");
        let mut messages = without_images();
        messages.insert(6, jpeg(2_400, (64, 64), [1, 2, 3]));
        for (index, bytes) in changes {
            index.get_mut(&mut messages).instead = Some(bytes);
        }
        bags::write_with(&path, &messages, encoding, None);
        if let Ok(recording) = import(&path, &Mapping::parse(MAPPING).unwrap(), &place.out, &PLAIN) {
            recording.episodes.iter().for_each(|imported| drop(healthy(&imported.trace)));
        }
    }
}
