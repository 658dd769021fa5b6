//! Label noise: the same context (text but for white space, and images), another action.
//!
//! Why: no model can learn both. Sure: that the context is the same, yes; that it is noise, no:
//! several actions may be right, and policies may explore. Rows are compared at each turn of the
//! model. Memory: some 60 bytes for each distinct context, more for those with several actions.

use std::collections::HashMap;

use super::{
    Check, RowFacts,
    row_facts::{Key, key_of},
};
use crate::lint::{RowLocation, Severity, report::Findings};

#[derive(Default)]
pub(super) struct LabelNoise {
    first: HashMap<Key, (u64, RowLocation)>,
    /// Contexts that were met again: their actions.
    again: HashMap<Key, Vec<Action>>,
    noisy: u64,
}

struct Action {
    id: u64,
    count: u64,
    place: RowLocation,
    text: String,
}

impl Check for LabelNoise {
    fn about(&self) -> (&'static str, &'static str) {
        ("label-noise", "the same context with another action")
    }

    fn see(&mut self, seen: &RowFacts, _: &mut Findings) {
        let place = seen.place();
        for (said, context) in seen.answers.iter().zip(&seen.contexts) {
            let calls: Vec<String> = said.calls.iter().map(|call| call.canonical()).collect();
            let text = if calls.is_empty() {
                seen.example.turns[said.turn].text()
            } else {
                calls.join("; ")
            };
            let id = id_of(text.trim());
            let Some((first, first_place)) = self.first.get(context) else {
                self.first.insert(*context, (id, place));
                continue;
            };
            let actions = self.again.entry(*context).or_insert_with(|| {
                vec![Action {
                    id: *first,
                    count: 1,
                    place: *first_place,
                    text: String::new(),
                }]
            });
            match actions.iter_mut().find(|action| action.id == id) {
                Some(action) => {
                    action.count += 1;
                    action.text = short(&text);
                }
                None => actions.push(Action {
                    id,
                    count: 1,
                    place,
                    text: short(&text),
                }),
            }
            if actions.len() == 2 {
                self.noisy += 1;
            }
        }
    }

    fn finish(&mut self, found: &mut Findings) {
        let mut noisy: Vec<Vec<Action>> = self
            .again
            .drain()
            .map(|(_, actions)| actions)
            .filter(|actions| actions.len() > 1)
            .collect();
        for actions in &mut noisy {
            actions.sort_by(|a, b| b.count.cmp(&a.count).then(a.place.cmp(&b.place)));
        }
        noisy.sort_by_key(|actions| (u64::MAX - total(actions), actions[0].place));
        for actions in noisy {
            let all = total(&actions);
            let share = 100.0 * actions[0].count as f64 / all as f64;
            // The minority is what is wrong, if anything is.
            let mut places: Vec<RowLocation> = actions
                .iter()
                .skip(1)
                .map(|action| action.place)
                .take(3)
                .collect();
            places.push(actions[0].place);
            found.add("other action", Severity::Warning, &places, || {
                let told = format!(
                    "{all} rows of one context have {} actions; the majority has {share:.0}%",
                    actions.len()
                );
                let name = |action: &Action| {
                    if action.text.is_empty() {
                        "(the action of the first row)".to_owned()
                    } else {
                        action.text.clone()
                    }
                };
                (
                    told,
                    actions
                        .iter()
                        .map(|action| format!("{}x {}", action.count, name(action)))
                        .collect::<Vec<_>>()
                        .join("\n"),
                )
            });
        }
        found.note(format!(
            "{} contexts, {} of them with several actions",
            self.first.len(),
            self.noisy
        ));
    }
}

fn total(actions: &[Action]) -> u64 {
    actions.iter().map(|action| action.count).sum()
}

fn id_of(text: &str) -> u64 {
    let key = key_of(text.as_bytes());
    u64::from_le_bytes(key[..8].try_into().expect("eight of sixteen bytes"))
}

fn short(text: &str) -> String {
    text.trim().chars().take(80).collect()
}
