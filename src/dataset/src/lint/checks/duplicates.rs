//! Rows that say the same as an earlier one: same turns but for white space, same images.
//!
//! Why: they count double in training, and a filter or a merge probably went wrong. Sure: yes.
//! Memory: some 40 bytes for each distinct row.

use std::collections::{HashMap, hash_map::Entry};

use super::{Check, RowFacts, row_facts::Key};
use crate::lint::{RowLocation, Severity, report::Findings};

#[derive(Default)]
pub(super) struct Duplicates(HashMap<Key, RowLocation>);

impl Check for Duplicates {
    fn about(&self) -> (&'static str, &'static str) {
        (
            "duplicates",
            "rows that are the same as an earlier one, images included",
        )
    }

    fn see(&mut self, seen: &RowFacts, found: &mut Findings) {
        match self.0.entry(seen.whole) {
            Entry::Vacant(free) => {
                free.insert(seen.place());
            }
            Entry::Occupied(first) => {
                let places = [seen.place(), *first.get()];
                found.add("exact", Severity::Warning, &places, || {
                    ("the same row as before".to_owned(), answer(seen))
                });
            }
        }
    }
}

/// The last answer of a row, for excerpts.
pub(super) fn answer(seen: &RowFacts) -> String {
    let last = seen
        .answers
        .last()
        .map(|said| &seen.example.turns[said.turn]);
    let text = last.map(|turn| turn.text()).unwrap_or_default();
    let text = text
        .rsplit("</think>")
        .next()
        .unwrap_or_default()
        .trim()
        .to_owned();
    match last.and_then(|turn| turn.calls().next()) {
        Some(call) if text.is_empty() => call.canonical(),
        _ => text,
    }
}
