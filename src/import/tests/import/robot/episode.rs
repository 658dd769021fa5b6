//! A recorded episode with every kind of message in it, and the messages to make others of.

use serde_json::{Value, json};

use crate::bags::{Said, jpeg, odometry, said};

pub(super) const APPLE: &str = "_a1_on_table_1_at_kitchen";

pub(super) fn graph(apple: Option<&str>, open: bool) -> Value {
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

pub(super) fn call(ms: u64, id: &str, tool: &str, arguments: Value) -> Said {
    said(
        ms,
        "/call",
        json!({"id": id, "tool": tool, "arguments": arguments.to_string()}),
    )
}

pub(super) fn result(ms: u64, id: &str, text: &str, success: bool) -> Said {
    said(
        ms,
        "/result",
        json!({"id": id, "text": text, "success": success, "error": ""}),
    )
}

/// An episode with everything in it.
pub(super) fn episode() -> Vec<Said> {
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

pub(super) fn without_images() -> Vec<Said> {
    episode()
        .into_iter()
        .filter(|message| message.topic != "/camera")
        .collect()
}
