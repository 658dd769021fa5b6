//! Outputs and digests changed at random by someone who makes checksums and hash chain hold again:
//! only execution can tell, and it has to tell at the changed call.

use std::env;

use rayon::prelude::*;
use reel_replay::{EpisodePosition, Verdict, verify_trace};
use reel_trace::{Images, Trace};
use reel_world::record::StepRecord;
use serde_json::Value;

use crate::episodes::{record, tasks};

#[test]
fn no_forged_output_or_digest_is_exact() {
    let wanted: u64 = env::var("REEL_FORGERIES")
        .ok()
        .and_then(|count| count.parse().ok())
        .unwrap_or(60);
    let folder = tempfile::tempdir().unwrap();
    let bases: Vec<Trace> = ["oracle", "gibberish"]
        .iter()
        .map(|policy| {
            Trace::read(&record(
                &folder.path().join(policy),
                &tasks()[2],
                policy,
                Images::None,
            ))
            .unwrap()
        })
        .collect();
    let forged: Vec<Option<String>> = (0..wanted)
        .into_par_iter()
        .map(|index| {
            let spread = (index + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
            let base = &bases[(spread % 2) as usize];
            let step = &base.steps[(spread >> 8) as usize % base.steps.len()];
            let (changed, field) = forge(step, spread >> 16)?;
            let mut trace = base.clone();
            trace.steps[step.step as usize] = changed;
            let verdict = verify_trace(&trace);
            let named = matches!(&verdict, Verdict::Diverged { divergence } if divergence.position == EpisodePosition::Call(step.step));
            assert!(named, "{field} of call {} was forged: {verdict}", step.step);
            Some(field)
        })
        .collect();
    let fields: std::collections::BTreeSet<String> = forged
        .iter()
        .flatten()
        .map(|field| {
            field
                .split(['.', '['])
                .next()
                .unwrap_or_default()
                .to_owned()
        })
        .collect();
    let count = forged.iter().flatten().count();
    eprintln!(
        "{count} forgeries, the other {} could not be told in the record's types; in {fields:?}",
        forged.len() - count
    );
    assert!(
        count * 3 > forged.len() * 2 && fields.len() >= 4,
        "{count} of {}",
        forged.len()
    );
}

/// The record with one leaf of its outputs changed as little as its type allows, and the leaf's
/// name; none where the change is not a record any more, or is none.
fn forge(step: &StepRecord, choice: u64) -> Option<(StepRecord, String)> {
    let mut value = serde_json::to_value(step).unwrap();
    let outputs = value.as_object_mut().unwrap();
    let (number, input) = (
        outputs.remove("step").unwrap(),
        outputs.remove("input").unwrap(),
    );
    // Each kind of field equally often, whatever its size.
    let kinds: Vec<String> = outputs.keys().cloned().collect();
    let kind = &kinds[choice as usize % kinds.len()];
    let mut leaves = Vec::new();
    collect(&outputs[kind], String::new(), &mut leaves);
    let leaf = leaves
        .get((choice >> 12) as usize % leaves.len().max(1))?
        .clone();
    let place = if leaf.is_empty() {
        outputs.get_mut(kind)?
    } else {
        outputs.get_mut(kind)?.pointer_mut(&leaf)?
    };
    change(place, choice >> 24);
    outputs.insert("step".into(), number);
    outputs.insert("input".into(), input);
    let changed: StepRecord = serde_json::from_value(value).ok()?;
    (changed != *step).then(|| (changed, format!("{kind}{}", leaf.replace('/', "."))))
}

fn collect(value: &Value, path: String, leaves: &mut Vec<String>) {
    match value {
        Value::Object(map) => map.iter().for_each(|(key, value)| {
            collect(value, format!("{path}/{}", key.replace('/', "~1")), leaves)
        }),
        Value::Array(items) => items
            .iter()
            .enumerate()
            .for_each(|(at, value)| collect(value, format!("{path}/{at}"), leaves)),
        Value::Null => {}
        _ => leaves.push(path),
    }
}

fn change(leaf: &mut Value, choice: u64) {
    *leaf = match &*leaf {
        Value::Bool(value) => Value::Bool(!value),
        Value::Number(number) => match number.as_u64() {
            Some(value) => (value ^ 1).into(),
            // Single precision where the number has it, so that the next float is another record.
            None => {
                let value = number.as_f64().unwrap_or_default();
                let single = f64::from(value as f32) == value;
                if single {
                    f64::from((value as f32).next_up()).into()
                } else {
                    value.next_up().into()
                }
            }
        },
        Value::String(text) => {
            let mut bytes = text.clone().into_bytes();
            let at = choice as usize % bytes.len().max(1);
            match bytes.get_mut(at) {
                Some(byte) if byte.is_ascii_alphanumeric() => *byte ^= 1,
                _ => bytes.push(b'x'),
            }
            String::from_utf8(bytes).unwrap_or_default().into()
        }
        other => other.clone(),
    };
}
