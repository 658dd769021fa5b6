//! The names that the judge may use. `prompts/judge.md` says what they mean; a test holds the two together.

/// The class of what nothing explains.
pub(super) const OTHER: &str = "Other";

/// The classes with their sub-classes.
pub(super) const CLASSES: &[(&str, &[&str])] = &[
    (
        "Object Confusion",
        &["wrong_attribute", "wrong_instance", "wrong_kind", "wrong_receptacle", "similar_furniture", "ignored_answer"],
    ),
    ("Key Action Missing", &["missing_ask", "never_looked", "missing_open", "missing_pick", "missing_place", "premature_finish"]),
    ("Lost Memory", &["oscillation", "repeated_failure", "stale_marker", "false_history", "exploration"]),
    (OTHER, &["invalid_output", "physical_failure", "primitive_failure", "timeout"]),
];

/// The class of a name and its sub-classes, whatever its capitals and spaces.
pub(super) fn class(name: &str) -> Option<(&'static str, &'static [&'static str])> {
    CLASSES.iter().find(|(class, _)| letters(class) == letters(name)).copied()
}

/// The class and the sub-class of a name.
pub(super) fn sub_class(name: &str) -> Option<(&'static str, &'static str)> {
    let all = CLASSES.iter().flat_map(|(class, sub_classes)| sub_classes.iter().map(move |sub_class| (*class, *sub_class)));
    all.into_iter().find(|(_, sub_class)| letters(sub_class) == letters(name))
}

/// What of a name has to be the same: `Sub-class`, `sub_class` and `subClass` are one.
pub(super) fn letters(name: &str) -> String {
    name.chars().filter(|c| c.is_alphanumeric()).flat_map(char::to_lowercase).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RuleSet;

    #[test]
    fn the_judge_and_the_rules_use_the_same_names() {
        let rules = RuleSet::built_in();
        for rule in rules.rules().iter().filter(|rule| rule.sub_class != "unexplained") {
            let known = sub_class(&rule.sub_class);
            assert_eq!(known.map(|(class, name)| (class, name.to_owned())), Some((rule.class, rule.sub_class.clone())));
        }
        for (class, sub_classes) in CLASSES {
            sub_classes.iter().for_each(|name| assert_eq!(rules.class_of(name), Some(*class), "{name}"));
        }
    }
}
