//! Leakage between splits: prompts, episodes, tasks, scenes and images that stand in two of them.
//!
//! Why: a test on what was trained says nothing. Sure: that the thing is in both, yes. A scene or a
//! image in both is wrong only where the split is by scene; the same view may be met in two
//! tasks. Memory: some 50 bytes for each distinct prompt, image, task, episode and scene.

use std::collections::HashMap;

use super::{
    Check, RowFacts,
    row_facts::{Key, key_of},
};
use crate::lint::{RowLocation, Severity, report::Findings};

#[derive(Default)]
pub(super) struct Splits {
    names: Vec<String>,
    /// The splits that have it, one bit each, and where it was first met.
    seen: HashMap<Key, (u32, RowLocation)>,
    unsplit: u64,
}

impl Check for Splits {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "splits",
            "prompts, episodes, tasks, scenes and images that are in two splits",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        let example = seen.example;
        let Some(split) = &example.split else {
            self.unsplit += 1;
            return;
        };
        let number = self
            .names
            .iter()
            .position(|name| name == split)
            .unwrap_or_else(|| {
                self.names.push(split.clone());
                self.names.len() - 1
            });
        let bit = 1_u32 << number.min(31);
        let mut meet =
            |kind: &'static str, severity: Severity, what: &[u8], words: &dyn Fn() -> String| {
                let key = key_of(&[kind.as_bytes(), b"\0", what].concat());
                let (splits, first) = self.seen.entry(key).or_insert((bit, seen.place()));
                if *splits & bit == 0 {
                    *splits |= bit;
                    found.add(kind, severity, &[seen.place(), *first], || {
                        (format!("the same {kind} is in another split"), words())
                    });
                }
            };
        if let Some(context) = seen.contexts.last() {
            let prompt = || {
                example
                    .turns
                    .iter()
                    .rev()
                    .find(|turn| !turn.role.is_answer())
                    .map(|turn| turn.text())
                    .unwrap_or_default()
            };
            meet("prompt", Severity::Error, context, &prompt);
        }
        #[rustfmt::skip]
        let named: [(&'static str, Severity, Option<String>); 3] = [
            ("episode", Severity::Error, example.episode()),
            ("task", Severity::Error, example.meta_text(&["task_id", "task", "benchmark_task_id"])),
            ("scene", Severity::Warning, example.meta_text(&["scene_id", "scene"])),
        ];
        for (kind, severity, value) in named {
            if let Some(value) = value {
                meet(kind, severity, value.as_bytes(), &|| value.clone());
            }
        }
        for (image, look) in example
            .images
            .iter()
            .zip(&seen.images)
            .filter(|(_, look)| look.header.is_some())
        {
            meet("image", Severity::Warning, &look.digest, &|| {
                image.name.clone()
            });
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        match &self.names[..] {
            [] => found.not_applicable("no row and no file name tells of a split"),
            [one] => found.not_applicable(format!("one split only: {one}")),
            names => found.note(format!("splits: {}", names.join(", "))),
        }
    }
}
