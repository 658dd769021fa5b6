//! What an import approximated and what it left out, counted by kind, with the pieces it happened to.

use std::collections::BTreeMap;

use serde::Serialize;

/// Most pieces that are named of a kind; the others are counted only.
const NAMED_MAX: usize = 20;

/// How often something happened, and to what.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct Note {
    /// How often it happened.
    pub count: usize,
    /// Objects, bodies, links or prims of the file that it happened to, at most 20; empty where it
    /// concerns the whole file.
    pub of: Vec<String>,
}

/// Counts of what is not as in the file.
#[derive(Clone, PartialEq, Debug, Default)]
pub(crate) struct Notes {
    /// What is there, but not exactly so.
    pub(crate) approximated: BTreeMap<String, Note>,
    /// What is not there.
    pub(crate) left_out: BTreeMap<String, Note>,
    /// The piece of the file that is being read; empty between pieces.
    subject: String,
}

impl Notes {
    /// What is noted from now on concerns this piece of the file. Gives the piece before it, for
    /// who reads pieces within pieces.
    pub(crate) fn about(&mut self, subject: &str) -> String {
        std::mem::replace(&mut self.subject, shortened(subject.to_owned()))
    }

    pub(crate) fn approximated(&mut self, kind: impl Into<String>) {
        add(&mut self.approximated, kind.into(), &self.subject);
    }

    pub(crate) fn left_out(&mut self, kind: impl Into<String>) {
        add(&mut self.left_out, kind.into(), &self.subject);
    }
}

fn add(notes: &mut BTreeMap<String, Note>, kind: String, subject: &str) {
    let note = notes.entry(shortened(kind)).or_default();
    note.count += 1;
    if !subject.is_empty()
        && note.of.len() < NAMED_MAX
        && !note.of.iter().any(|named| named == subject)
    {
        note.of.push(subject.to_owned());
    }
}

/// Names in a file may be of any length.
fn shortened(text: String) -> String {
    const CHARACTERS_MAX: usize = 120;
    if text.chars().count() <= CHARACTERS_MAX {
        return text;
    }
    text.chars().take(CHARACTERS_MAX).chain(['…']).collect()
}
