//! `reel import` from outside, and what the other commands say of an imported trace: that there
//! is nothing to re-execute.

use std::{collections::BTreeMap, fs, path::Path};

use mcap::records::MessageHeader;
use serde_json::{Value, json};

use crate::{complaint, expect};

fn write(path: &Path, value: &Value) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, value.to_string()).unwrap();
}

/// An episode of one call and its end, without images, but one; made by hand.
fn episode(root: &Path, model: &str) {
    let folder = root.join("flat/FDP_t_1").join(model);
    let apple = "_a_on_table_1_at_t_1";
    let meta = json!({"benchmark_task_id": "FDP/t_1", "family": "FDP", "task_description": "Put the apple on the desk.",
        "scene_id": "flat", "source_furniture": "table_1", "destination_furniture": "desk_1",
        "target_object": {"id": "_a", "name": apple, "category": "apple"}, "model": model});
    write(&folder.join("task_meta.json"), &meta);
    let graph =
        json!({"world_graph": {"table_1": {"content": [apple]}, "desk_1": {"content": []}}});
    for (step, tool, args) in [
        (
            "step_000",
            "navigate_to",
            json!({"receptacle_name": "table_1"}),
        ),
        ("step_001", "finish", json!({})),
    ] {
        write(
            &folder.join(step).join("tool_call.json"),
            &json!({"tool_name": tool, "args": args}),
        );
        write(&folder.join(step).join("debug_info.json"), &graph);
    }
    fs::write(
        folder.join("step_001/textual_observation.txt"),
        "Episode finished. Success: False",
    )
    .unwrap();
    let mut image = Vec::new();
    let mut encoder = png::Encoder::new(&mut image, 640, 480);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .write_header()
        .unwrap()
        .write_image_data(&vec![90; 640 * 480 * 3])
        .unwrap();
    fs::write(folder.join("step_000/image_observation_0.png"), image).unwrap();
    write(
        &folder.join("episode_summary.json"),
        &json!({"status": "finished", "success": false, "total_steps": 2}),
    );
}

#[test]
fn an_imported_episode_is_shown_and_checked_but_never_executed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    episode(&folder.join("eval_output"), "m1");
    let report = reel!(folder, "import real-eval eval_output --out traces --json");
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(
        (&report["steps"], &report["end"], &report["images"]),
        (&json!(2), &json!("finished"), &json!(1))
    );
    let trace = report["trace"].as_str().unwrap();

    let said = "recorded through a proxy: nothing to re-execute";
    assert!(reel!(folder, "trace doctor {trace}").contains(said));
    assert!(expect(folder, 1, &format!("replay {trace}")).contains(said));
    assert!(expect(folder, 1, &format!("replay {trace} --explain")).contains(said));
    assert!(expect(folder, 1, &format!("replay {trace} --restored 2")).contains(said));
    assert!(expect(folder, 1, &format!("replay {trace} --outcomes")).contains(said));
    assert!(expect(folder, 1, "dev gate --corpus traces").contains("not_replayable"));
    assert!(complaint(folder, 1, &format!("trace compact {trace} --out lean")).contains(said));
    let shown = reel!(folder, "show {trace}");
    assert!(
        shown.contains("through a proxy")
            && shown.contains("Put the apple on the desk.")
            && !shown.contains("driven"),
        "{shown}"
    );
    let images = reel!(folder, "trace frames {trace} --out images");
    assert!(
        images.contains("call_000.png") && images.contains("contact_sheet.png"),
        "{images}"
    );

    #[cfg(feature = "analytics")]
    {
        reel!(folder, "ingest traces --store store");
        let class: Value =
            serde_json::from_str(&reel!(folder, "taxonomy --store store --json")).unwrap();
        let found = (&class["sub_class"], &class["step"], &class["evidence"]);
        assert_eq!(
            found,
            (&json!("never_looked"), &json!(1), &json!("reduced")),
            "{class}"
        );
    }

    // A torn episode beside it: named, and the rest goes on.
    episode(&folder.join("eval_output"), "m2");
    fs::write(
        folder.join("eval_output/flat/FDP_t_1/m2/step_001/debug_info.json"),
        "{\"world",
    )
    .unwrap();
    let complaints = complaint(folder, 3, "import real-eval eval_output --out traces");
    assert!(
        complaints.contains("m2/step_001/debug_info.json")
            && complaints.contains("the steps before it"),
        "{complaints}"
    );
    fs::remove_dir_all(folder.join("eval_output/flat/FDP_t_1/m1")).unwrap();
    fs::write(
        folder.join("eval_output/flat/FDP_t_1/m2/task_meta.json"),
        "{}",
    )
    .unwrap();
    assert!(complaint(folder, 2, "import real-eval eval_output").contains("--tasks"));
    assert!(complaint(folder, 2, "import real-eval nowhere").contains("nowhere"));
}

/// A recording of a robot in JSON: topics, seconds, messages.
fn recording(path: &Path, messages: &[(&str, u64, Value)]) {
    let mut writer = mcap::Writer::new(fs::File::create(path).unwrap()).unwrap();
    for (sequence, (topic, seconds, message)) in (0..).zip(messages) {
        let channel_id = writer
            .add_channel(0, topic, "json", &BTreeMap::new())
            .unwrap();
        let time = (1_790_000_000 + seconds) * 1_000_000_000;
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time: time,
            publish_time: time,
        };
        writer
            .write_to_known_channel(&header, message.to_string().as_bytes())
            .unwrap();
    }
    writer.finish().unwrap();
}

const MAPPING: &str = r#"
[topics]
"/episode" = { is = "episode" }
"/call" = { is = "call" }
"/result" = { is = "result" }
"/primitive" = { is = "primitive" }
"/odom" = { is = "odometry" }
"/joint_states" = { is = "joints" }
"/wrist/image" = { is = "camera", name = "wrist" }
"/truth" = { is = "reference" }
"#;

/// A small image of a camera, as JSON holds it.
fn image() -> Value {
    use base64::Engine as _;
    let png = reel_trace::encode_png(&[90; 8 * 6 * 3], 8, 6);
    json!({"data": base64::engine::general_purpose::STANDARD.encode(png)})
}

#[test]
fn a_robots_recording_is_shown_and_checked_but_never_executed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    fs::write(folder.join("robot.toml"), MAPPING).unwrap();
    fs::create_dir(folder.join("bags")).unwrap();
    let messages = [
        (
            "/episode",
            0,
            json!({"event": "start", "task_id": "FDP/t_1", "instruction": "Put the apple on the desk.", "policy": "qwen"}),
        ),
        ("/odom", 1, json!({"x": 0.0, "y": 0.0})),
        (
            "/call",
            2,
            json!({"tool": "navigate_to", "args": {"receptacle_name": "table_1"}}),
        ),
        ("/truth", 1, json!({"x": 0.0, "y": 0.0})),
        (
            "/joint_states",
            2,
            json!({"name": ["elbow"], "position": [0.5]}),
        ),
        (
            "/joint_states",
            3,
            json!({"name": ["elbow"], "position": [0.6]}),
        ),
        ("/wrist/image", 3, image()),
        ("/odom", 3, json!({"x": 3.0, "y": 4.0, "yaw": 1.0})),
        ("/truth", 3, json!({"x": 3.0, "y": 4.1, "yaw": 1.0})),
        (
            "/primitive",
            4,
            json!({"skill": "nav_to", "target": "table", "success": true, "duration_s": 1.5}),
        ),
        ("/result", 5, json!({"text": "arrived"})),
        (
            "/call",
            5,
            json!({"tool": "place", "args": {"marker_id": 1}}),
        ),
        (
            "/primitive",
            6,
            json!({"skill": "place_inside", "target": "fridge", "success": false, "duration_s": 1.5}),
        ),
        ("/result", 6, json!({"text": "dropped", "success": false})),
        ("/call", 6, json!({"tool": "finish"})),
        ("/episode", 7, json!({"event": "end", "success": true})),
    ];
    recording(&folder.join("bags/one.mcap"), &messages);
    let import = [
        "import",
        "robot",
        "bags",
        "--mapping",
        "robot.toml",
        "--out",
        "traces",
    ];
    let report = expect(folder, 0, &[&import[..], &["--json"]].concat());
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(
        (&report["steps"], &report["end"], &report["success"]),
        (&json!(3), &json!("finished"), &json!(true))
    );
    let trace = report["trace"].as_str().unwrap();
    let said = "recorded on a robot: nothing to re-execute";
    assert!(reel!(folder, "trace doctor {trace}").contains(said));
    assert!(expect(folder, 1, &format!("replay {trace}")).contains(said));
    let shown = reel!(folder, "show {trace}");
    assert!(
        shown.contains("on a robot")
            && shown.contains("arrived")
            && shown.contains("Put the apple on the desk.")
            && shown.contains("/joint_states: joints, no schema in json, 2 messages in 1.0 s"),
        "{shown}"
    );
    let parsed: Value = serde_json::from_str(&reel!(folder, "show {trace} --json")).unwrap();
    assert_eq!(parsed["sensors"][2]["camera"], "wrist", "{parsed}");
    let error = &parsed["header"]["policy"]["parameters"]["trajectory_error"];
    assert_eq!(error["rpe_pairs"], 1, "{error}");
    let frames = "trace frames {trace} --out wrist --robot-camera".replace("{trace}", trace);
    let listed = expect(folder, 0, &format!("{frames} wrist --json"));
    let listed: Value = serde_json::from_str(&listed).unwrap();
    assert_eq!(listed["images"][0]["call"], 0, "{listed}");
    assert!(folder.join("wrist/wrist_0000.png").is_file());
    let unknown = complaint(folder, 2, &format!("{frames} /chest"));
    assert!(
        unknown.contains("there are: wrist (/wrist/image)"),
        "{unknown}"
    );

    #[cfg(feature = "analytics")]
    {
        reel!(folder, "ingest traces --store store");
        let sql = "SELECT backend, policy, success, length FROM episodes";
        let rows = expect(
            folder,
            0,
            &format!("query --store store --format csv | {sql}"),
        );
        assert!(rows.contains("robot,qwen,true,3"), "{rows}");
        let sql = "SELECT primitive, count(*) AS failed FROM steps WHERE error_code = 'skill_failed' GROUP BY primitive";
        let rows = expect(
            folder,
            0,
            &format!("query --store store --format csv | {sql}"),
        );
        assert!(rows.contains("place_inside,1"), "{rows}");
    }

    // A torn recording and a bag in SQLite beside it: named, and the rest goes on.
    let whole = fs::read(folder.join("bags/one.mcap")).unwrap();
    fs::write(folder.join("bags/two.mcap"), &whole[..whole.len() - 200]).unwrap();
    fs::write(folder.join("bags/drive.db3"), "SQLite format 3").unwrap();
    let complaints = complaint(folder, 3, &import);
    assert!(
        complaints.contains("ros2 bag convert") && complaints.contains("drive.db3"),
        "{complaints}"
    );
    fs::remove_file(folder.join("bags/one.mcap")).unwrap();
    fs::remove_file(folder.join("bags/two.mcap")).unwrap();
    assert!(complaint(folder, 2, &import).contains("drive.db3"));
    fs::write(
        folder.join("robot.toml"),
        "[topics]\n\"/odom\" = { is = \"odometer\" }\n",
    )
    .unwrap();
    let wrong = complaint(folder, 2, &import);
    assert!(
        wrong.contains("line 2") && wrong.contains("odometer"),
        "{wrong}"
    );
}
