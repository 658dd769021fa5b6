//! What an import approximated and what it left out, counted by kind.

use std::collections::BTreeMap;

/// Counts of what is not as in the file.
#[derive(Clone, PartialEq, Debug, Default)]
pub(crate) struct Notes {
    /// What is there, but not exactly so.
    pub(crate) approximated: BTreeMap<String, usize>,
    /// What is not there.
    pub(crate) left_out: BTreeMap<String, usize>,
}

impl Notes {
    pub(crate) fn approximated(&mut self, kind: impl Into<String>) {
        *self.approximated.entry(shortened(kind.into())).or_default() += 1;
    }

    pub(crate) fn left_out(&mut self, kind: impl Into<String>) {
        *self.left_out.entry(shortened(kind.into())).or_default() += 1;
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
