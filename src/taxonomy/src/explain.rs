//! One explanation of a failed episode from all that was found: the findings of the rules and what
//! blame measured. Owns how they are weighed against each other; asks neither.
//!
//! A measurement is a fact about the world (what was lost, and with which call), a rule a reading
//! of it (what kind of mistake that is). So the explanation is the most important finding whose
//! evidence holds the measured call; where no finding does, the two disagree, which is said.

use std::borrow::Cow;

use reel_world::FailureClass;

use crate::rules::Rule;

/// A finding: index of the rule, first and last step of its evidence.
pub(crate) type Evidence = (u16, i32, i32);

/// What blame measured of an episode: a row of table `blame`.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Measured {
    pub step: i32,
    pub harm: String,
    pub cause: String,
    pub explanation: String,
    pub advised_call: String,
}

/// Kinds of claims about what was achieved, in the words of table `contradictions`: an agent that
/// believes a false one leaves out what is due.
pub(crate) const ACHIEVEMENTS: [&str; 5] = ["pick", "hold", "place", "door act", "door state"];

/// The rule whose finding the checker of Histories confirms, refutes or adds.
const FALSE_HISTORY: &str = "false_history";

/// Steps whose History holds a claim about an achievement that the record refutes, in order.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct FalseClaims(pub Vec<i32>);

/// The findings with what the checker of Histories knows. It reads sentences, the rule only words:
/// where it checked the trace its word counts. A false claim matters if the last decisions still
/// hold it.
pub(crate) fn heed_claims(
    findings: &[Evidence],
    rules: &[Rule],
    claims: Option<&FalseClaims>,
    length: i32,
) -> Vec<Evidence> {
    let mut findings = findings.to_vec();
    let rule = rules.iter().position(|rule| rule.name == FALSE_HISTORY);
    let (Some(FalseClaims(steps)), Some(rule)) = (claims, rule) else {
        return findings;
    };
    findings.retain(|(index, ..)| usize::from(*index) != rule);
    if let (Some(first), Some(last)) = (steps.first(), steps.last())
        && last + HELD_TO_THE_END >= length
    {
        let finding = (rule as u16, *first, length - 1);
        let important = |one: &Evidence| {
            let priority = |index: u16| rules[usize::from(index)].priority;
            (priority(one.0), one.1) <= (priority(finding.0), finding.1)
        };
        let at = findings.partition_point(important);
        findings.insert(at, finding);
    }
    findings
}

/// Decisions before the end up to which a claim counts as held to the end.
const HELD_TO_THE_END: i32 = 2;

/// How sure an explanation is, from 0 to 1: the share of explanations of its kind that were right,
/// fair alternatives included, on 402 failures of the development operators of `make eval-insight`.
mod confidence {
    /// Rule and measurement name the same call and no other capacity: 356 of 390.
    pub const AGREED: f64 = 0.91;
    /// A rule without a measurement beside it: 355 of 392.
    pub const RULE_ALONE: f64 = 0.91;
    /// Rule and measurement name different calls or capacities: two cases in all, so even odds.
    pub const DISPUTED: f64 = 0.5;
    /// No rule that says why: 6 of 10.
    pub const LEFT_OVER: f64 = 0.6;
}

/// The one explanation of an episode.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Explained<'e> {
    /// Index of the finding that decides.
    pub primary: usize,
    /// Number of the decisive step in the episode.
    pub step: i32,
    /// The capacity that failed.
    pub cause: &'e str,
    /// Why, in a sentence; none where nothing was measured.
    pub sentence: Option<Cow<'e, str>>,
    /// What a competent agent would have called at the decisive step; none where another step was
    /// measured.
    pub advised_call: Option<&'e str>,
    pub confidence: f64,
    /// In which sources disagree, for a person to look at.
    pub conflicts: Vec<String>,
}

/// Weighs the findings, the most important first, against what was measured.
pub(crate) fn explain<'e>(
    findings: &[Evidence],
    rules: &'e [Rule],
    measured: Option<&'e Measured>,
) -> Option<Explained<'e>> {
    let rule = |finding: &Evidence| &rules[usize::from(finding.0)];
    let first = findings.first()?;
    let Some(measured) = measured else {
        let by_class = cause_of(rule(first));
        return Some(Explained {
            primary: 0,
            step: first.1,
            cause: by_class.unwrap_or("other"),
            sentence: None,
            advised_call: None,
            confidence: match rule(first).secondary {
                true => confidence::RULE_ALONE,
                false => confidence::LEFT_OVER,
            },
            conflicts: Vec::new(),
        });
    };
    let agreed = agreeing(findings, rules, measured);
    let primary = agreed.unwrap_or(0);
    let decides = rule(&findings[primary]);
    let by_class = cause_of(decides);
    let mut conflicts = Vec::new();
    let explains = decides.secondary;
    if agreed.is_none() && explains {
        conflicts.push(format!(
            "rule {} names call {}, blame measured call {}",
            decides.name, findings[primary].1, measured.step
        ));
    }
    let other_cause =
        by_class.is_some_and(|cause| measured.cause != "other" && cause != measured.cause);
    if other_cause {
        conflicts.push(format!(
            "rule {} is about {}, blame about {}",
            decides.name,
            by_class.unwrap_or_default(),
            measured.cause
        ));
    }
    // The step at which the fault shows that is named: the loss may have begun before it.
    let (_, first_step, last_step) = findings[primary];
    let step = match (explains, measured.harm.as_str()) {
        (false, _) => measured.step,
        (true, "time") => measured.step.clamp(first_step, last_step),
        // what led to a harmful call or to the end began before it
        (true, _) => first_step,
    };
    let sentence = match step == measured.step {
        true => Cow::Borrowed(measured.explanation.as_str()),
        false => Cow::Owned(format!("call {}: {}", measured.step, measured.explanation)),
    };
    Some(Explained {
        primary,
        step,
        cause: by_class.unwrap_or(&measured.cause),
        sentence: Some(sentence),
        advised_call: (step == measured.step).then_some(measured.advised_call.as_str()),
        confidence: match explains {
            false => confidence::LEFT_OVER,
            true if conflicts.is_empty() => confidence::AGREED,
            true => confidence::DISPUTED,
        },
        conflicts,
    })
}

/// The most important finding whose evidence holds the measured call: the first one about the
/// capacity that was measured, else, where time was lost, the first one about more than the end of
/// the stretch, else the first. Slips come after all others, unless theirs is the capacity.
fn agreeing(findings: &[Evidence], rules: &[Rule], measured: &Measured) -> Option<usize> {
    let rule = |finding: &Evidence| &rules[usize::from(finding.0)];
    let holding = || {
        let all = findings.iter().enumerate();
        all.filter(|(_, finding)| rule(finding).secondary && agrees(finding, measured))
    };
    let same_cause = |finding: &Evidence| cause_of(rule(finding)) == Some(&measured.cause);
    let is_stretch = |(_, first, last): &Evidence| {
        measured.harm == "time" && (first < last || *first <= measured.step)
    };
    let explaining = || holding().filter(|(_, finding)| !rule(finding).slip);
    let is_slip = |finding: &Evidence| rule(finding).slip;
    let is_about = |finding: &Evidence| match is_slip(finding) {
        true => same_cause(finding),
        false => is_stretch(finding),
    };
    let found = explaining()
        .find(|(_, finding)| same_cause(finding))
        .or_else(|| holding().find(|(_, finding)| is_about(finding)))
        .or_else(|| explaining().next())
        .or_else(|| holding().next());
    found.map(|(index, _)| index)
}

/// Whether the evidence of a finding holds the measured call. Harm to the world and endings are one
/// call; lost time is a stretch that begins with the measured one.
fn agrees((_, first, last): &Evidence, measured: &Measured) -> bool {
    match measured.harm.as_str() {
        "time" => *last >= measured.step,
        _ => (*first..=*last).contains(&measured.step),
    }
}

/// The capacity that a rule is about, in the words of blame; none where its class does not say.
fn cause_of(rule: &Rule) -> Option<&'static str> {
    match (rule.class.as_str(), rule.sub_class.as_str()) {
        (_, "missing_ask" | "uninformative_ask") => Some("communication"),
        (_, "primitive_failure" | "physical_failure") => Some("primitive"),
        (class, _) if class == FailureClass::ObjectConfusion.as_str() => Some("perception"),
        (class, _) if class == FailureClass::LostMemory.as_str() => Some("memory"),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::RuleSet;

    /// Rule, step and sentence of what decides, and the advised call.
    fn decided(
        found: &[(&str, i32, i32)],
        (harm, step, cause): (&str, i32, &str),
    ) -> (String, i32, String, Option<String>) {
        let set = RuleSet::built_in();
        let number = |name: &str| set.rules().iter().position(|rule| rule.name == name);
        let findings: Vec<Evidence> = found
            .iter()
            .map(|(name, first, last)| (number(name).unwrap() as u16, *first, *last))
            .collect();
        let measured = Measured {
            step,
            harm: harm.into(),
            cause: cause.into(),
            explanation: "why".into(),
            advised_call: "better".into(),
        };
        let told = explain(&findings, set.rules(), Some(&measured)).unwrap();
        (
            found[told.primary].0.to_owned(),
            told.step,
            told.sentence.unwrap().into_owned(),
            told.advised_call.map(str::to_owned),
        )
    }

    #[test]
    fn slips_come_after_what_explains() {
        let end = ("never_looked_at_source", 26, 26);
        let stretch = decided(&[("invalid_output", 3, 26), end], ("time", 1, "other"));
        assert_eq!(
            stretch,
            ("invalid_output".into(), 3, "call 1: why".into(), None)
        );
        let slip = [end, ("oscillation_slip", 2, 26)];
        assert_eq!(decided(&slip, ("time", 1, "other")).0, end.0);
        assert_eq!(decided(&slip, ("time", 1, "memory")).0, "oscillation_slip");
    }

    #[test]
    fn the_step_is_one_at_which_the_fault_shows() {
        let found = [("stale_marker", 5, 20)];
        let (_, step, sentence, advised) = decided(&found, ("time", 7, "other"));
        assert_eq!((step, sentence.as_str()), (7, "why"));
        assert_eq!(advised.as_deref(), Some("better"));
        let (_, step, sentence, advised) = decided(&found, ("world", 19, "other"));
        assert_eq!(
            (step, sentence.as_str(), advised),
            (5, "call 19: why", None)
        );
    }
}
