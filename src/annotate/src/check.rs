//! The History of a note beside the validator of Histories. Never judges by itself.

use reel_history::{Checker, ClaimVerdict, EpisodeFacts, StepFacts};

/// A check for [`crate::ModelAnnotator`]: what the record refutes in a History, by the
/// deeds before its decision.
pub fn history_check(
    setting: EpisodeFacts,
    deeds: Vec<StepFacts>,
) -> impl Fn(usize, &str) -> Option<String> {
    move |index, history| {
        let mut checker = Checker::new(setting.clone());
        deeds
            .iter()
            .take(index)
            .cloned()
            .for_each(|deed| checker.push_step(deed));
        checker
            .check(history)
            .into_iter()
            .find_map(|claim| match claim.verdict {
                ClaimVerdict::Contradicted { why, .. } => {
                    let said = history.get(claim.span).unwrap_or_default();
                    Some(format!(
                        "its history says what is not so: \"{said}\": {why}"
                    ))
                }
                _ => None,
            })
    }
}
