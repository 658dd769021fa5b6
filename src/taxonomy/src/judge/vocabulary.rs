//! The names that the judge may use: those that `prompts/judge.md` explains to it. What a new rule
//! is called it may propose.

use std::{collections::BTreeMap, sync::LazyLock};

use super::prompt::PROMPT;
use crate::CLASSES;

/// Sub-classes with their classes: lines `- name: ...` under `Class: ...` in the
/// prompt's section on classes.
static SUB_CLASSES: LazyLock<BTreeMap<&str, &str>> = LazyLock::new(|| {
    let section = PROMPT
        .split("\n# ")
        .find(|section| section.starts_with("Classes\n"))
        .unwrap_or_default();
    let (mut class, mut known) = (None, BTreeMap::new());
    for (name, _) in section.lines().filter_map(|line| line.split_once(": ")) {
        match name.strip_prefix("- ") {
            Some(sub_class) => known.extend(class.map(|class| (sub_class, class))),
            None => class = CLASSES.into_iter().find(|class| *class == name),
        }
    }
    known
});

/// A class, whatever its capitals and spaces.
pub(super) fn class(name: &str) -> Option<&'static str> {
    CLASSES
        .into_iter()
        .find(|class| letters(class) == letters(name))
}

/// The sub-classes of a class.
pub(super) fn sub_classes(class: &str) -> Vec<&'static str> {
    SUB_CLASSES
        .iter()
        .filter(|(_, of)| **of == class)
        .map(|(name, _)| *name)
        .collect()
}

/// The class and the sub-class of a name.
pub(super) fn sub_class(name: &str) -> Option<(&'static str, &'static str)> {
    SUB_CLASSES
        .iter()
        .find(|(known, _)| letters(known) == letters(name))
        .map(|(known, class)| (*class, *known))
}

/// What of a name has to be the same: `Sub-class`, `sub_class` and `subClass` are one.
pub(super) fn letters(name: &str) -> String {
    name.chars()
        .filter(|c| c.is_alphanumeric())
        .flat_map(char::to_lowercase)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RuleSet;

    #[test]
    fn the_judge_is_told_the_names_of_the_rules() {
        let rules = RuleSet::built_in();
        assert!(SUB_CLASSES.len() > 20, "{SUB_CLASSES:?}");
        for (sub_class, class) in SUB_CLASSES.iter() {
            assert_eq!(rules.class_of(sub_class), Some(*class), "{sub_class}");
        }
        CLASSES
            .iter()
            .for_each(|class| assert!(!sub_classes(class).is_empty(), "{class}"));
    }
}
