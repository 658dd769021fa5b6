//! Choosing among wordings: one ChaCha8 stream for each (seed, wording, step), so that one sentence
//! more or less somewhere changes none elsewhere. Never decides what is said, only how.

use std::collections::BTreeMap;

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use reel_world::Digest;

use crate::english;

/// Ways to say one thing. Gaps stand in braces.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PhraseVariants {
    /// Its name, which is the purpose of its stream.
    pub name: &'static str,
    /// Every way by the name of the wording; all have the same gaps.
    pub forms: fn(&str) -> &'static [&'static str],
}

impl PhraseVariants {
    /// Every way to say it.
    pub fn forms(self) -> &'static [&'static str] {
        (self.forms)(self.name)
    }
}

/// Ways to say things, by the name of the wording.
pub(crate) type Forms = BTreeMap<&'static str, Vec<&'static str>>;

/// Reads a file of wordings: a name a line, and below it every form, indented.
pub(crate) fn forms(text: &'static str) -> Forms {
    let mut all = Forms::new();
    let mut name = "";
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        match line.strip_prefix("  ") {
            Some(form) => all.entry(name).or_default().push(form),
            None => name = line,
        }
    }
    all
}

/// The wordings of a text file as constants, and all of them in `ALL`.
macro_rules! wordings {
    ($file:literal: $($name:ident)*) => {
        static FORMS: std::sync::LazyLock<$crate::voice::Forms> =
            std::sync::LazyLock::new(|| $crate::voice::forms(include_str!($file)));

        fn forms(name: &str) -> &'static [&'static str] {
            &FORMS[name]
        }

        $(pub(crate) const $name: $crate::voice::PhraseVariants =
            $crate::voice::PhraseVariants { name: stringify!($name), forms };)*
        /// Every wording of this file.
        pub(crate) const ALL: &[$crate::voice::PhraseVariants] = &[$($name),*];
    };
}
pub(crate) use wordings;

/// Chooses among the forms of a wording, by seed, wording and step.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PhraseChooser {
    /// Seed of the choice of wordings, one per episode.
    pub seed: u64,
}

impl PhraseChooser {
    /// One of the ways, its gaps filled, as a sentence.
    pub fn phrase(self, wording: PhraseVariants, step: usize, gaps: &[(&str, &str)]) -> String {
        english::sentence(&self.words(wording, step, gaps))
    }

    /// The same as part of a sentence.
    pub fn words(self, wording: PhraseVariants, step: usize, gaps: &[(&str, &str)]) -> String {
        let key = Digest::of(format!("{}/{}/{step}", self.seed, wording.name).as_bytes());
        // The bias of the remainder is below 2^-60 for a handful of forms.
        let index = ChaCha8Rng::from_seed(key.0).next_u64() % wording.forms().len() as u64;
        fill(wording.forms()[index as usize], gaps)
    }
}

/// Fills gaps in one pass, so that what fills a gap is never read as one.
fn fill(form: &str, gaps: &[(&str, &str)]) -> String {
    let mut text = String::with_capacity(form.len() + 32);
    let mut rest = form;
    while let Some((before, after)) = rest.split_once('{') {
        let (name, after) = after.split_once('}').expect("a gap is closed");
        let filled = gaps.iter().find(|(gap, _)| *gap == name);
        text.push_str(before);
        text.push_str(
            filled
                .unwrap_or_else(|| panic!("nothing fills {{{name}}} of \"{form}\""))
                .1,
        );
        rest = after;
    }
    text + rest
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn what_fills_a_gap_is_no_gap() {
        assert_eq!(
            fill("{a} and {b}", &[("a", "{b}"), ("b", "x")]),
            "{b} and x"
        );
    }

    #[test]
    fn every_way_is_chosen_and_the_choice_repeats() {
        let wording = PhraseVariants {
            name: "TEST",
            forms: |_| &["a", "b", "c", "d", "e", "f"],
        };
        let said = |seed| {
            (0..200)
                .map(|step| PhraseChooser { seed }.words(wording, step, &[]))
                .collect::<Vec<_>>()
        };
        assert_eq!(said(1), said(1));
        assert_ne!(said(1), said(2));
        assert_eq!(said(1).into_iter().collect::<BTreeSet<_>>().len(), 6);
    }
}
