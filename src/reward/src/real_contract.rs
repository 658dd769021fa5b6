//! What the published reward class pays for questions and picks, given the state that its
//! environment hands it. Episodes cannot be in all of these states, so that the class is asked
//! itself; the rest of `reward.json` is compared from outside.

use reel_vectors::{Report, items, load, text};
use serde_json::{Value, json};

use crate::{
    difference_reward::{Dialogue, DifferenceReward},
    facts::{Identity, TaskFacts, ToolKind},
    preset::Preset,
    score::TermSink,
    trainer::{Categories, Graph},
};

#[test]
fn questions_and_picks_are_paid_as_published() {
    let Some(document) = load("reward.json") else {
        return;
    };
    let mut report = Report::new("reward.json", "tools");
    for case in items(&document["cases"]) {
        let expected = items(&case["expect"]["partial/default"]);
        if items(&case["steps"])
            .iter()
            .any(|step| step.get("tool").is_some())
        {
            compare(&mut report, case, expected);
        }
    }
    report.finish();
}

fn compare(report: &mut Report, case: &Value, expected: &[Value]) {
    let preset = Preset::real_repo();
    let mut facts = TaskFacts::for_trainer(
        Categories::default(),
        "",
        &Graph::of_json(&case["initial"]),
        &Graph::of_json(&case["goal"]),
    );
    let mut class = DifferenceReward::new(Identity::Asset);
    class.start(&facts, &[]);
    for (index, (step, expected)) in items(&case["steps"]).iter().zip(expected).enumerate() {
        let [name, arguments, _, state] = items(&step["tool"]) else {
            panic!("a tool row has four values")
        };
        if state.get("last_ask_target").is_some() {
            report.deviation("the answer names a target instead of a marker: no published environment sets this state");
            continue;
        }
        // texts are compared, and a number is none
        let key = |facts: &mut TaskFacts, value: &Value| match value {
            Value::Null => None,
            Value::String(text) => Some(facts.text(text)),
            other => Some(facts.text(&format!("{other} (no text)"))),
        };
        let marker = key(&mut facts, &arguments["marker_id"]);
        let is = |name: &str| state[name] == true;
        let named = key(&mut facts, &state["last_ask_marker"]);
        let dialogue = Dialogue {
            ambiguous: is("distractor_visible"),
            asked: is("asked_since_ambiguity"),
            named,
        };
        let mut fired = Vec::new();
        class.tools(
            ToolKind::named(text(name)),
            marker,
            dialogue,
            &mut TermSink::new(&preset, &mut fired),
        );
        let paid: f64 = fired.iter().map(|fired| fired.value).sum();
        report.compare(
            &format!("{} {index}", text(&case["id"])),
            &expected["tool_reward"],
            &json!(paid),
        );
    }
}
