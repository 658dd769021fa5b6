//! Which of the scores that were reported says that an episode was a success.

use std::{fmt, str::FromStr};

use reel_world::record::Score;
use serde::{Deserialize, Serialize};

/// Which score says that an episode was a success, and from which value on: `NAME` or `NAME>=VALUE`.
/// Without one the first score does, if it is correct or incorrect (`C`, `I`, `N`), true or
/// false, 1 or 0; of any other value nobody knows.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SuccessRule {
    /// The score, as [`Score::name`] names it.
    name: String,
    /// The smallest value of a success.
    at_least: f64,
}

impl FromStr for SuccessRule {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, at_least) = text.split_once(">=").unwrap_or((text, "1"));
        let wrong =
            || format!("'{text}' is no score: give NAME or NAME>=VALUE, e.g. includes>=0.5");
        let (name, at_least) = (name.trim(), at_least.trim().parse().map_err(|_| wrong())?);
        if name.is_empty() || !f64::is_finite(at_least) {
            return Err(wrong());
        }
        Ok(Self {
            name: name.to_owned(),
            at_least,
        })
    }
}

impl TryFrom<String> for SuccessRule {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl fmt::Display for SuccessRule {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}>={}", self.name, self.at_least)
    }
}

impl From<SuccessRule> for String {
    fn from(rule: SuccessRule) -> Self {
        rule.to_string()
    }
}

impl SuccessRule {
    /// What is to be said of a rule that names a score that an episode does not have.
    pub(crate) fn unmet(rule: Option<&Self>, scores: &[Score]) -> Option<String> {
        let rule = rule.filter(|rule| scores.iter().all(|score| score.name != rule.name))?;
        let names: Vec<&str> = scores.iter().map(|score| score.name.as_str()).collect();
        Some(match names.is_empty() {
            true => format!("no score is called '{}', for there are none", rule.name),
            false => format!(
                "no score is called '{}'; there are: {}",
                rule.name,
                names.join(", ").escape_debug()
            ),
        })
    }

    /// Whether the scores say success: by the rule, or without one by the first score. `None` if they do not say.
    pub(crate) fn judge(rule: Option<&Self>, scores: &[Score]) -> Option<bool> {
        match rule {
            Some(rule) => {
                let score = scores.iter().find(|score| score.name == rule.name)?;
                Some(score.value? >= rule.at_least)
            }
            None => match scores.first()?.value? {
                1.0 => Some(true),
                0.0 => Some(false),
                _ => None,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rule_without_its_score_is_said() {
        let rule: SuccessRule = "nosuch>=0.5".parse().unwrap();
        let score = |name: &str| Score {
            name: name.to_owned(),
            ..Score::default()
        };
        let said = |scores: &[Score]| SuccessRule::unmet(Some(&rule), scores);
        assert_eq!(
            said(&[score("includes"), score("match")]).unwrap(),
            "no score is called 'nosuch'; there are: includes, match"
        );
        assert!(said(&[]).unwrap().contains("there are none"));
        assert_eq!(said(&[score("nosuch")]), None);
        assert_eq!(SuccessRule::unmet(None, &[]), None);
    }
}
