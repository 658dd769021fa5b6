//! Privileged text planted in many ways is found; what agents read and say is not taken for it.

use std::borrow::Cow;

use base64::{Engine as _, engine::general_purpose::STANDARD};
use reel_dataset::{LeakKind, PrivilegedFacts, find_leak, strip};

pub fn secrets() -> PrivilegedFacts {
    let instance = [
        (LeakKind::Instance, "vase_03_on_shelf_1_at_home_0001"),
        (LeakKind::Instance, "vase_03"),
        (LeakKind::Instance, "_01cace88a48c"),
    ];
    let phrase = [
        (
            LeakKind::Phrase,
            "Move the tall blue vase from the oak shelf to the glass table.",
        ),
        (LeakKind::TaskPayload, "FDO/home_0001"),
    ];
    PrivilegedFacts::new(
        instance.into_iter().chain(phrase),
        ["shelf_1", "table_2", "refrigerator_1", "lamp_on_stand_1"],
    )
}

/// What was planted, and as what it is to be found.
pub fn planted() -> Vec<(LeakKind, String)> {
    use LeakKind::*;
    let texts = [
        (DebugInfo, "Debug Info:\n{\"CURRENT_POS\": [1, 2]}"),
        (DebugInfo, "debug info: {}"),
        (DebugInfo, "DEBUG_INFO = none"),
        (DebugInfo, "{\"debugInfo\": {}}"),
        (DebugInfo, "\"CURRENT_LANDMARK\": \"table_2\""),
        (DebugInfo, "CURRENT_INV is empty"),
        (DebugInfo, "current_marker_map {\"1\": 4}"),
        (DebugInfo, "the marker_map says 3"),
        (TaskPayload, "{\"task_id\": 7}"),
        (TaskPayload, "benchmark_task_id: 12"),
        (TaskPayload, "\"episode_idx\": 3"),
        (TaskPayload, "rooms_and_furniture={'kitchen': ['sink_0']}"),
        (TaskPayload, "source_furniture is shelf_1"),
        (TaskPayload, "destinationFurniture: table_2"),
        (TaskPayload, "src_distractors = [shelf_2]"),
        (TaskPayload, "destination_distractors"),
        (TaskPayload, "{'target_object': {'category': 'vase'}}"),
        (TaskPayload, "targetObjectId=9"),
        (TaskPayload, "object_distractors: two mugs"),
        (TaskPayload, "precise_instruction: take the blue one"),
        (TaskPayload, "this is FDO/home_0001"),
        (TaskPayload, "\"scene_id\":\"home\""),
        (WorldGraph, "the world graph has it on shelf_1"),
        (WorldGraph, "WORLD_GRAPH"),
        (WorldGraph, "target_world_graph: ..."),
        (WorldGraph, "{\"worldGraph\": 1}"),
        (WorldGraph, "goal graph: vase on table_2"),
        (WorldGraph, "WG_goal differs from WG_init"),
        (WorldGraph, "-vase@shelf_1 +vase@table_2"),
        (WorldGraph, "refrigerator_1.door: closed -> open"),
        (WorldGraph, "{\"shelf_1\": [\"vase\"], \"table_2\": []}"),
        (
            WorldGraph,
            "{\"shelf\": {\"content\": [\"vase\"], \"door\": \"open\"}}",
        ),
        (
            WorldGraph,
            "{\"kitchen_table_0\": {}, \"kitchen_shelf_1\": {}}",
        ),
        (WorldGraph, "delta_goal has two elements"),
        (WorldGraph, "the simulator state says so"),
        (Plan, "execution_plan: go, pick, place"),
        (Plan, "Execution plan:\n1. nav_to"),
        (
            Plan,
            "[{\"action\": \"nav_to\", \"args\": {}}, {\"action\": \"pick\", \"args\": {}}]",
        ),
        (
            Plan,
            "{\"steps\": [{\"name\": \"pick\", \"arguments\": {}}, {\"name\": \"place\", \"arguments\": {}}]}",
        ),
        (Plan, "as in the expert trajectory"),
        (Plan, "I follow the optimal plan"),
        (Pose, "the vase is at (1.25, -0.40, 0.93)"),
        (Pose, "position: [1.25, 0.4, 0.9]"),
        (Pose, "\"pos\": 1.25"),
        (Pose, "1.250 0.400 0.930"),
        (Pose, "x=1.2, y=3"),
        (Pose, "{\"x\": 1.2, \"y\": 3.4}"),
        (Pose, "yaw is 1.57"),
        (Pose, "initial_pos of the vase"),
        (Pose, "quaternion (0, 0, 0, 1)"),
        (Pose, "\"size\": [0.12, 0.08, 0.3]"),
        (Instance, "vase_03_on_shelf_1_at_home_0001"),
        (Instance, "VASE_03_ON_SHELF_1_AT_HOME_0001"),
        (Instance, "mug_9_on_table_4_at_t"),
        (Instance, "mug-9-on-table-4-at-t"),
        (Instance, "mug_9 on table_4 at home_0002"),
        (Instance, "I hold vase_03."),
        (Instance, "_01cace88a48c"),
        (Oracle, "The oracle goes left"),
        (Oracle, "ground truth: shelf_1"),
        (Oracle, "shelf_2 is only a distractor"),
        (Oracle, "is_target: true"),
        (Oracle, "reward +1.90"),
        (Oracle, "\"cumulative_reward\": 11.2"),
        (Oracle, "success = true"),
        (
            Phrase,
            "Move the tall blue vase from the oak shelf to the glass table.",
        ),
        (
            Phrase,
            "(move the TALL blue vase from the oak shelf to the glass table.)",
        ),
    ];
    let mut planted: Vec<(LeakKind, String)> = texts
        .into_iter()
        .map(|(kind, text)| (kind, text.to_owned()))
        .collect();
    let hidden = [
        (WorldGraph, "world\u{200b}_gra\u{ad}ph".to_owned()),
        (WorldGraph, r"\u0077orld_graph".to_owned()),
        (WorldGraph, "world%5Fgraph".to_owned()),
        (
            WorldGraph,
            "world&#95;graph and world&#x5f;graph".to_owned(),
        ),
        (
            WorldGraph,
            STANDARD.encode("{\"target_world_graph\": {\"shelf_1\": []}}"),
        ),
        (
            Instance,
            STANDARD.encode("take vase_03_on_shelf_1_at_home_0001"),
        ),
    ];
    planted.extend(hidden);
    planted
}

#[test]
fn planted_in_many_ways() {
    let secrets = secrets();
    let planted = planted();
    assert!(planted.len() >= 50);
    let mut missed = Vec::new();
    for (kind, text) in &planted {
        for carrier in [
            text.clone(),
            format!("I went to table_2. {text} Then I looked."),
            format!("{{\"History\": {}}}", serde_json::json!(text)),
        ] {
            match find_leak(&carrier, &secrets) {
                None => missed.push(format!("not found: {carrier}")),
                Some(leak) if leak.kind != *kind && carrier == *text => {
                    missed.push(format!("{:?}: {carrier}", leak.kind))
                }
                Some(leak) => assert!(carrier.get(leak.span).is_some(), "{carrier}"),
            }
        }
    }
    assert!(missed.is_empty(), "{missed:#?}");
}

#[test]
fn clean_texts_raise_no_alarm() {
    let texts = [
        "Pick up a vase from the brown shelf near the white desk and place it in the refrigerator.",
        "Arrived at refrigerator_1.",
        "Receptacles in view: \n\t1: refrigerator_1",
        "Found 2 object(s) matching 'teddy bear': marker 1, marker 2.",
        "I found the following object(s): \n\t1: a(an) apple.\n",
        "No marker map available. Use 'find_objects', 'explore_receptacle' or 'highlight_receptacles' first.",
        "Marker ID 7 not found in the marker map.",
        "You are already holding 'apple'. Place it before picking another object.",
        "Seems there is no object on the table_1's top shelf to observe.",
        "Room: living room/0\n  - table_1\n  - shelf_2\n",
        "{\"target_category\": \"vase\", \"target_description\": \"the blue one\", \"source\": \"simulated_user\"}",
        "I went to table_1. I looked for mugs and saw 2 candidates. The door of refrigerator_1 is open.",
        "My plan: first go to table_2, then place it there. Target object: the red mug, size about 0.5 litres.",
        "I am in position; the goal is to bring the mug to the table at the window.",
        "Rectangular tray with two compartments, 1.5 cm edges, soft pink and gray colors, rewarding to look at.",
        "lamp_on_stand_1 is behind me.",
        "The object is at the left, number 3; numbers 1, 2, 3 are mugs.",
        "{\"History\": \"I went to table_1.\", \"next_action\": {\"tool_name\": \"nav_to\", \"args\": {\"receptacle_name\": \"table_2\"}}}",
        "[{\"name\": \"nav_to\", \"description\": \"Go.\", \"parameters\": {\"type\": \"object\"}}, {\"name\": \"ask\", \"description\": \"Ask.\"}]",
        "{{{{{[[[[ \\ % & +1 -2 a@b.org",
        "I will ask: which of the two vases do you mean, the one on the shelf or on the desk?",
    ];
    for text in texts {
        let leak = find_leak(text, &secrets());
        assert_eq!(
            leak,
            None,
            "{text}: {}",
            leak.as_ref()
                .map(|leak| leak.excerpt(text))
                .unwrap_or_default()
        );
        assert!(
            matches!(strip(text), Cow::Borrowed(same) if same == text),
            "{text}"
        );
    }
}

#[test]
fn payloads_are_stripped() {
    let graph = r#"{"shelf_1": {"content": ["vase_03_on_shelf_1_at_home_0001"]}, "table_2": {"content": []}}"#;
    for (text, kept) in [
        (
            format!("Arrived at table_2.\nDebug Info:\n{{\"CURRENT_POS\": [1.0, 2.0], \"world_graph\": {graph}}}"),
            "Arrived at table_2.",
        ),
        (format!("Arrived.\nDebug Info:\n{{\"world_graph\": {graph}}}\nGo on."), "Arrived.\n\nGo on."),
        ("Arrived.\nDebug Info:\n{\"CURRENT_POS\": [1.0,".to_owned(), "Arrived."),
        ("Debug Info: nothing".to_owned(), ""),
        (
            format!("{{\"task_id\": 3, \"task_description\": \"Go.\", \"target_world_graph\": {graph}, \"execution_plan\": []}}"),
            "",
        ),
        (format!("You see {graph} here."), "You see  here."),
        (
            "Take [{\"action\": \"nav_to\", \"args\": {}}, {\"action\": \"pick\", \"args\": {}}] as given.".to_owned(),
            "Take  as given.",
        ),
    ] {
        let stripped = strip(&text);
        assert_eq!(stripped, kept);
        assert_eq!(find_leak(&stripped, &secrets()), None, "{stripped}");
    }
    let sentence = "The world graph says shelf_1.";
    assert_eq!(
        strip(sentence),
        sentence,
        "a sentence is refused, never cut"
    );
    assert!(find_leak(sentence, &PrivilegedFacts::none()).is_some());
}

#[test]
fn hostile_texts_take_no_time() {
    for text in [
        "{".repeat(200_000),
        "[{\"a\":".repeat(50_000),
        "a_on_".repeat(50_000),
        "1.0 ".repeat(2) + &"%5F".repeat(50_000),
    ] {
        let _ = (find_leak(&text, &secrets()), strip(&text));
    }
}
