//! How things are said. Words only: when a sentence is said stands with who says it.

pub(crate) mod history;
pub(crate) mod plan;
pub(crate) mod reasoning;

use reel_world::Digest;

use crate::voice::PhraseVariants;

/// Iterates over every wording of History, plan and reasoning.
fn all() -> impl Iterator<Item = &'static PhraseVariants> {
    history::ALL.iter().chain(plan::ALL).chain(reasoning::ALL)
}

/// Digest of every form of every wording.
pub(crate) fn digest() -> Digest {
    let forms: Vec<(&str, &[&str])> = all()
        .map(|wording| (wording.name, wording.forms()))
        .collect();
    Digest::of_json(&forms)
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    fn gaps(form: &str) -> BTreeSet<&str> {
        form.split('{')
            .skip(1)
            .map(|rest| rest.split_once('}').unwrap().0)
            .collect()
    }

    #[test]
    fn all_ways_of_a_wording_have_the_same_gaps() {
        for wording in all() {
            for form in wording.forms() {
                assert_eq!(
                    gaps(form),
                    gaps(wording.forms()[0]),
                    "{}: {form}",
                    wording.name
                );
            }
        }
    }

    #[test]
    fn names_and_forms_are_unique() {
        let names: BTreeSet<&str> = all().map(|wording| wording.name).collect();
        assert_eq!(names.len(), all().count());
        for wording in all() {
            assert_eq!(
                wording.forms().iter().collect::<BTreeSet<_>>().len(),
                wording.forms().len(),
                "{}",
                wording.name
            );
        }
    }

    #[test]
    fn sentences_have_at_least_six_ways_and_end_like_sentences() {
        for wording in history::ALL.iter().chain(reasoning::ALL) {
            assert!(
                wording.forms().len() >= 6,
                "{} has {}",
                wording.name,
                wording.forms().len()
            );
            assert!(
                wording
                    .forms()
                    .iter()
                    .all(|form| form.ends_with(['.', '?', '}'])),
                "{}",
                wording.name
            );
        }
    }
}
