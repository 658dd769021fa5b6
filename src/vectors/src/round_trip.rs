//! What a trace is after it was written in another format and read again: everything that can be compared, which
//! fields are lost, and whether these are the listed ones.

use std::collections::BTreeSet;

use reel_trace::Trace;
use reel_world::Digest;
use serde_json::{Map, Value, json};

/// Everything of a trace that can be compared, its images as digests.
#[must_use]
pub fn parts(trace: &Trace) -> Value {
    let steps = (0..trace.steps.len() as u32).map(Some);
    let digest = |step| {
        let rgb = trace.frame_rgb(step).unwrap();
        rgb.map(|rgb| Digest::of(&rgb).to_string())
    };
    let images: Vec<Option<String>> = [None].into_iter().chain(steps).map(digest).collect();
    json!({
        "header": trace.header, "task": *trace.task, "scene": *trace.scene, "start": trace.start,
        "steps": trace.steps, "end": trace.end, "images": images,
    })
}

/// What episodes of a test may have the same on both sides, though formats lose it: one build wrote both, and not all of
/// them have each.
const MAY_STAY: &[&str] = &[
    "header.build",
    "header.meshes",
    "start.visible",
    "depth",
    "masks",
    "timings",
    "mcp_answers",
    "redactions",
    "robot",
    "sensors",
];

/// Fields that are lost on the way, as paths like `steps[].outcome.text`.
#[derive(Debug, Default)]
pub struct LostFields(BTreeSet<String>);

impl LostFields {
    /// Adds the paths of what differs between a trace and what came back of it.
    pub fn compare(&mut self, before: &Value, after: &Value) {
        self.walk("", before, after);
    }

    fn walk(&mut self, path: &str, before: &Value, after: &Value) {
        match (before, after) {
            (Value::Object(left), Value::Object(right)) => {
                let value =
                    |map: &Map<String, Value>, key| map.get(key).cloned().unwrap_or_default();
                for key in left.keys().chain(right.keys()) {
                    let below = match path {
                        "" => key.clone(),
                        path => format!("{path}.{key}"),
                    };
                    self.walk(&below, &value(left, key), &value(right, key));
                }
            }
            (Value::Array(left), Value::Array(right)) if left.len() == right.len() => {
                for (left, right) in left.iter().zip(right) {
                    self.walk(&format!("{path}[]"), left, right);
                }
            }
            _ if before == after => {}
            _ => drop(self.0.insert(path.to_owned())),
        }
    }

    /// How many of the listed fields are lost.
    ///
    /// # Panics
    /// When another field is lost, or a listed one is not that these episodes have; `absent` are further fields that they lack.
    #[must_use]
    pub fn expect_listed<'a>(
        &self,
        listed: impl IntoIterator<Item = &'a str>,
        absent: &[&str],
    ) -> usize {
        let listed: BTreeSet<&str> = listed.into_iter().collect();
        let owner = |path: &String| {
            listed.iter().copied().find(|field| {
                path.strip_prefix(*field)
                    .is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
            })
        };
        for path in &self.0 {
            assert!(owner(path).is_some(), "{path} is lost and not listed");
        }
        let seen: BTreeSet<&str> = self.0.iter().filter_map(owner).collect();
        let stays = listed.difference(&seen);
        let wrong: Vec<_> = stays
            .filter(|field| !MAY_STAY.contains(field) && !absent.contains(field))
            .collect();
        assert!(wrong.is_empty(), "listed, and not lost: {wrong:?}");
        seen.len()
    }
}
