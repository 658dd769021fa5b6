//! Privileged text, planted in more than fifty ways, is found; clean rows raise no alarm.

use serde_json::{Value, json};

use super::{Folder, answer, linted, of, png, prompt, swift};

/// A row with a text added to the prompt.
fn in_prompt(text: &str) -> Value {
    swift(
        &format!("Bring the cup. {text}"),
        "Arrived at table_1.",
        "pick",
        json!({ "marker_id": 1 }),
    )
}

/// A row with a text as the last outcome.
fn in_outcome(text: &str) -> Value {
    swift("Bring the cup.", text, "pick", json!({ "marker_id": 1 }))
}

/// A row with a text in the reasoning.
fn in_reasoning(text: &str) -> Value {
    let mut row = in_prompt("");
    row["messages"][2]["content"] =
        format!("<think>{text}</think>{}", answer("finish", json!({}))).into();
    row
}

/// A row whose answer's JSON has one more entry.
fn in_answer(key: &str, value: Value) -> Value {
    let mut row = in_prompt("");
    let mut object = json!({ "History": "I went to table_1.", "next_action": { "tool_name": "finish", "args": {} } });
    object[key] = value;
    row["messages"][2]["content"] = object.to_string().into();
    row
}

fn messages(turns: &[(&str, &str)]) -> Value {
    let turns: Vec<Value> = turns
        .iter()
        .map(|(role, content)| json!({ "role": role, "content": content }))
        .collect();
    json!({ "messages": turns, "images": [] })
}

fn call(name: &str, arguments: &Value) -> Value {
    let calls = json!([{ "id": "1", "type": "function", "function": { "name": name, "arguments": arguments.to_string() } }]);
    json!({ "messages": [{ "role": "user", "content": "go" }, { "role": "assistant", "content": null, "tool_calls": calls }] })
}

fn planted() -> Vec<(&'static str, Value)> {
    let graph =
        json!({ "table_1": { "content": ["cup_3_on_table_1_at_FDP_1"], "door": "closed" } });
    let nested = json!({ "note": graph.to_string() }).to_string();
    let twice = json!(nested).to_string();
    vec![
        (
            "the block itself",
            in_outcome("Arrived.\nDebug Info:\n{\"CURRENT_POS\": [1.0, 2.0, 0.0]}"),
        ),
        ("its title alone", in_outcome("Arrived. Debug Info:")),
        ("in lower case", in_outcome("debug info follows")),
        ("in upper case", in_outcome("DEBUG INFO: none")),
        ("as a key", in_outcome("{\"debug_info\": {}}")),
        ("as a camel", in_outcome("debugInfo: {}")),
        ("with a dash", in_outcome("debug-info")),
        ("over two lines", in_outcome("Debug\nInfo: {}")),
        ("with two spaces", in_outcome("Debug  Info: {}")),
        ("in bold", in_outcome("**Debug** **Info**")),
        ("in wide letters", in_outcome("Ｄｅｂｕｇ Ｉｎｆｏ")),
        ("in letters of another alphabet", in_outcome("Dеbug Infо")),
        (
            "with a letter that has no width",
            in_outcome("De\u{200b}bug Info"),
        ),
        ("letter by letter", in_outcome("w o r l d _ g r a p h")),
        (
            "a key of the payload",
            in_outcome("CURRENT_LANDMARK is table_1"),
        ),
        (
            "the map of markers",
            in_outcome("{\"CURRENT_MARKER_MAP\": {\"1\": \"cup\"}}"),
        ),
        ("a world graph", in_prompt("world_graph: {}")),
        ("in words", in_prompt("The world graph says so.")),
        ("as a camel too", in_prompt("{\"worldGraph\": 1}")),
        ("the goal's", in_prompt("{\"target_world_graph\": {}}")),
        ("the initial", in_prompt("initial_world_graph")),
        ("without its key", in_prompt(&graph.to_string())),
        ("inside a text of JSON", in_prompt(&nested)),
        ("inside a text of a text of JSON", in_prompt(&twice)),
        ("a signed event", in_prompt("+cup_3@fridge_1")),
        (
            "a change of a door",
            in_prompt("fridge_1.door: open -> closed"),
        ),
        ("a plan", in_prompt("execution_plan: see below")),
        ("a plan in words", in_prompt("Execution Plan")),
        (
            "a plan without its key",
            in_prompt(
                "[{\"action\": \"nav_to\", \"args\": {}}, {\"action\": \"pick\", \"args\": {}}]",
            ),
        ),
        (
            "a plan of an expert",
            in_reasoning("The expert trajectory goes to fridge_1."),
        ),
        ("an instance", in_prompt("Take cup_3_on_table_1_at_FDP_1.")),
        (
            "an instance in the reasoning",
            in_reasoning("It is cup_3_on_table_1."),
        ),
        (
            "an instance in capitals",
            in_reasoning("IT IS CUP_3_ON_TABLE_1_AT_FDP."),
        ),
        (
            "an instance in the history",
            in_answer("History", "I picked up mug_0_on_desk_2_at_SUL_7.".into()),
        ),
        (
            "a position",
            in_prompt("The cup is at position [1.25, 0.50, 0.91]."),
        ),
        (
            "numbers alone",
            in_prompt("It stands at (1.25, -0.50, 0.91)."),
        ),
        ("x and y", in_reasoning("It is at x=1.25, y=0.5.")),
        ("a pose", in_reasoning("pose: 0.1 0.2 0.3 0.0 0.0 0.0 1.0")),
        ("a turn", in_prompt("quaternion unknown")),
        ("a frame", in_prompt("world_from_camera")),
        ("the oracle", in_reasoning("The oracle knows.")),
        (
            "the truth",
            in_reasoning("By ground truth it is the left one."),
        ),
        ("a distractor", in_prompt("object_distractors: none")),
        ("a mark of the target", in_answer("is_target", true.into())),
        ("a reward", in_reasoning("The reward is 1.5 then.")),
        (
            "the source",
            in_answer("source_furniture", "table_1".into()),
        ),
        (
            "the target's id",
            in_answer("target_object_id", "cup_3".into()),
        ),
        ("a task's number", in_prompt("benchmark_task_id 7")),
        (
            "the end's payload",
            in_outcome("{\"episode_idx\": 3, \"rooms_and_furniture\": {}}"),
        ),
        (
            "as base64",
            in_prompt("eyJ0YXJnZXRfd29ybGRfZ3JhcGgiOiB7InRhYmxlXzEiOiBbXX19"),
        ),
        ("with escapes", in_prompt(r"\u0077orld_graph")),
        ("as in a web page", in_prompt("world&#95;graph")),
        ("as in an address", in_prompt("world%5Fgraph")),
        (
            "in the system's turn",
            messages(&[
                ("system", "world_graph"),
                ("user", "go"),
                ("assistant", "yes"),
            ]),
        ),
        (
            "over two turns",
            messages(&[("user", "{\"world_"), ("assistant", "graph\": {}}")]),
        ),
        (
            "over two turns, at a space",
            messages(&[
                ("user", "here is the Debug"),
                ("assistant", "Info: nothing"),
            ]),
        ),
        (
            "in a call's arguments",
            call(
                "ask",
                &json!({ "question": "is it cup_3_on_table_1_at_FDP_1?" }),
            ),
        ),
        (
            "in a key of a call's arguments",
            call("pick", &json!({ "target_object_id": 1 })),
        ),
        ("in a tool's description", {
            let mut row = messages(&[("user", "go"), ("assistant", "yes")]);
            row["tools"] =
                json!([{ "name": "pick", "description": "Picks by instance_id.", "parameters": {} }]).to_string().into();
            row
        }),
        (
            "at the end of a long text",
            in_prompt(&format!("{} world_graph", "I went on. ".repeat(2000))),
        ),
    ]
}

#[test]
fn every_plant_is_found() {
    let planted = planted();
    assert!(planted.len() >= 50);
    let folder = Folder::new();
    folder.write("view.png", png(28, 28));
    let missed: Vec<&str> = planted
        .iter()
        .filter(|(_, row)| {
            of(
                &linted(&folder.lines("rows.jsonl", std::slice::from_ref(row))),
                "leaks",
            )
            .findings
                == 0
        })
        .map(|(how, _)| *how)
        .collect();
    assert_eq!(missed, Vec::<&str>::new());
    // And among clean rows, all of them in one file.
    let rows: Vec<Value> = planted
        .into_iter()
        .flat_map(|(_, row)| [clean(1), row])
        .collect();
    let report = linted(&folder.lines("all.jsonl", &rows));
    assert_eq!(of(&report, "leaks").rows, rows.len() as u64 / 2);
}

fn clean(number: usize) -> Value {
    let outcome = [
        "Arrived at table_1.",
        "I found the following object(s): \n\t1: a(an) apple.\n\t2: a(an) red cup.\n",
        "No marker map available. Use 'find_objects' or 'explore_receptacle' first.",
        "The door of 'fridge_1' is closed. Use 'open' first.",
        "Marked 2 candidates: 1, 2.",
        "The user says: the one on the left, please.",
    ];
    let task = [
        "Bring the cup to the fridge.",
        "Find the world map and put it on the desk.",
        "Plan: pick up 3 apples, 2.5 l of milk.",
    ];
    swift(
        task[number % 3],
        outcome[number % 6],
        "nav_to",
        json!({ "receptacle_name": "table_1" }),
    )
}

#[test]
fn clean_rows_raise_no_alarm() {
    let folder = Folder::new();
    folder.write("view.png", png(28, 28));
    let rows: Vec<Value> = (0..18)
        .map(clean)
        .chain([messages(&[
            ("user", &prompt("Wait.", "ok")),
            ("assistant", "fine"),
        ])])
        .collect();
    let report = linted(&folder.lines("rows.jsonl", &rows));
    assert_eq!(of(&report, "leaks").findings, 0, "{report}");
}
