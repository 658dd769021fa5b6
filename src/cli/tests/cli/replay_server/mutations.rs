//! Calls of a recording changed at random, with where and how the change deviates first.

use reel_world::ToolCall;
use serde_json::{Value, json};

/// Calls that an agent makes instead of the recorded ones.
#[derive(Debug)]
pub struct Mutation {
    pub kind: &'static str,
    pub calls: Vec<ToolCall>,
    /// Index of the first call that deviates.
    pub step: usize,
    /// What the server has to call the deviation.
    pub deviation: &'static str,
    /// The argument that it has to name, if one deviates.
    pub argument: Option<String>,
}

/// Numbers from a seed (SplitMix64).
pub struct Random(pub u64);

impl Random {
    pub fn below(&mut self, most: usize) -> usize {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut mixed = self.0;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        usize::try_from((mixed ^ (mixed >> 31)) % most as u64).unwrap()
    }
}

const KINDS: [&str; 8] = [
    "renamed", "changed", "removed", "added", "retyped", "swapped", "dropped", "extra",
];

/// A mutation of recorded calls; `None` where the one that was drawn is not possible.
pub fn mutate(recorded: &[ToolCall], random: &mut Random) -> Option<Mutation> {
    let kind = KINDS[random.below(KINDS.len())];
    let step = random.below(recorded.len());
    let mut calls = recorded.to_vec();
    match kind {
        "renamed" => {
            calls[step].name.push_str("_now");
            Some(Mutation {
                kind,
                calls,
                step,
                deviation: "tool",
                argument: None,
            })
        }
        "changed" | "retyped" | "removed" => {
            let arguments = calls[step].arguments.as_object_mut()?;
            let name = arguments.keys().next()?.clone();
            let value = arguments.shift_remove(&name)?;
            if kind != "removed" {
                arguments.insert(name.clone(), other_value(kind, &value));
            }
            of_argument(kind, calls, step, name)
        }
        "added" => {
            calls[step].arguments["carefully"] = json!(true);
            of_argument(kind, calls, step, "carefully".to_owned())
        }
        "swapped" => {
            let other = step + 1;
            if other >= recorded.len() || recorded[step] == recorded[other] {
                return None;
            }
            calls.swap(step, other);
            first_difference(kind, recorded, calls)
        }
        "dropped" => {
            calls.remove(step);
            first_difference(kind, recorded, calls)
        }
        _ => {
            let extra = json!({"receptacle_name": "nowhere"});
            calls.push(ToolCall::new("navigate_to", extra));
            Some(Mutation {
                kind,
                calls,
                step: recorded.len(),
                deviation: "extra_call",
                argument: None,
            })
        }
    }
}

/// Another value than the recorded one: of the same type, or of another.
fn other_value(kind: &str, value: &Value) -> Value {
    match (kind, value) {
        ("retyped", Value::String(_)) => json!(7),
        ("retyped", value) => json!(value.to_string()),
        (_, Value::Number(number)) => json!(number.as_i64().unwrap_or(0) + 1),
        (_, value) => json!(format!("{}x", value.as_str().unwrap_or_default())),
    }
}

fn of_argument(
    kind: &'static str,
    calls: Vec<ToolCall>,
    step: usize,
    argument: String,
) -> Option<Mutation> {
    Some(Mutation {
        kind,
        calls,
        step,
        deviation: "argument",
        argument: Some(argument),
    })
}

/// Where calls first differ from the recorded ones, found without the server's comparison.
fn first_difference(
    kind: &'static str,
    recorded: &[ToolCall],
    calls: Vec<ToolCall>,
) -> Option<Mutation> {
    let step = (0..recorded.len()).find(|step| calls.get(*step) != Some(&recorded[*step]))?;
    let (deviation, argument) = match calls.get(step) {
        None => ("missing_call", None),
        Some(call) if call.name != recorded[step].name => ("tool", None),
        Some(call) => {
            let before = recorded[step].arguments.as_object()?;
            let mut names = before.keys();
            let name =
                names.find(|name| call.arguments.get(name.as_str()) != before.get(name.as_str()));
            ("argument", name.cloned())
        }
    };
    Some(Mutation {
        kind,
        calls,
        step,
        deviation,
        argument,
    })
}
