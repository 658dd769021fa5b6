//! Log-probabilities of the tokens that a model wrote for a decision, under one or several
//! policies. Never computes with them: ratios and objectives are `reel-reward`'s.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The policy that sampled the tokens (`pi_old` of GSPO).
pub const OLD_POLICY: &str = "old";

/// The tokens of one decision, and what each policy gives them: one log-probability a
/// token (natural logarithm, at most 0). The tokens stand there once, so all policies are
/// about the same ones.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(try_from = "Unchecked")]
pub struct TokenLogprobs {
    tokens: Vec<String>,
    logprobs: BTreeMap<String, Vec<f64>>,
}

/// The same, as it is read.
#[derive(Deserialize)]
struct Unchecked {
    tokens: Vec<String>,
    logprobs: BTreeMap<String, Vec<f64>>,
}

/// Why log-probabilities are refused.
#[derive(Clone, PartialEq, Debug, Error)]
pub enum LogprobError {
    /// A decision of no tokens.
    #[error("there is no token")]
    NoTokens,
    /// A list of another length than the tokens.
    #[error(
        "policy '{policy}' has {found} log-probabilities for {expected} tokens; give one for each"
    )]
    Lengths {
        /// Name of the policy whose list has another length than the tokens.
        policy: String,
        /// How many tokens there are.
        expected: usize,
        /// How many log-probabilities there are.
        found: usize,
    },
    /// A number that is no log-probability.
    #[error(
        "the log-probability of token {token} under policy '{policy}' is {found}; it must be finite and at most 0"
    )]
    Value {
        /// Name of the policy that gave the number.
        policy: String,
        /// Index of the token, from 0.
        token: usize,
        /// The number that is no log-probability.
        found: f64,
    },
    /// Log-probabilities of other tokens.
    #[error(
        "token {token} is {found:?}, but {expected:?} was recorded; log-probabilities must be of the recorded tokens"
    )]
    OtherTokens {
        /// Index of the first token that differs, from 0.
        token: usize,
        /// The recorded token; empty beyond the last.
        expected: String,
        /// The other one; empty beyond the last.
        found: String,
    },
    /// The policy that sampled is recorded with the tokens, and by nobody else.
    #[error(
        "policy '{OLD_POLICY}' is the one that sampled the tokens; give these log-probabilities another name"
    )]
    Sampled,
    /// A policy without a name.
    #[error("a policy needs a name, e.g. 'new' or 'ref'")]
    NoName,
}

impl TokenLogprobs {
    /// What the policy that sampled the tokens gave them, under the name [`OLD_POLICY`].
    ///
    /// # Errors
    /// Fails if there is no token, the lengths differ, or a log-probability is
    /// positive or not finite.
    pub fn sampled(tokens: Vec<String>, logprobs: Vec<f64>) -> Result<Self, LogprobError> {
        Self::new(tokens, BTreeMap::from([(OLD_POLICY.to_owned(), logprobs)]))
    }

    /// Tokens and log-probabilities by policy.
    ///
    /// # Errors
    /// As [`TokenLogprobs::sampled`], and if a policy has no name.
    pub fn new(
        tokens: Vec<String>,
        logprobs: BTreeMap<String, Vec<f64>>,
    ) -> Result<Self, LogprobError> {
        if tokens.is_empty() {
            return Err(LogprobError::NoTokens);
        }
        logprobs
            .iter()
            .try_for_each(|(policy, logprobs)| check(policy, logprobs, tokens.len()))?;
        Ok(Self { tokens, logprobs })
    }

    /// Adds what another policy gives the same tokens; what it gave before is replaced. `tokens`
    /// are the tokens that were scored, `None` if nobody said.
    ///
    /// # Errors
    /// As [`TokenLogprobs::new`], and if the tokens are other ones or the policy is
    /// the one that sampled.
    pub fn add(
        &mut self,
        policy: &str,
        logprobs: Vec<f64>,
        tokens: Option<&[String]>,
    ) -> Result<(), LogprobError> {
        if policy == OLD_POLICY {
            return Err(LogprobError::Sampled);
        }
        if let Some(tokens) = tokens {
            self.expect_tokens(tokens)?;
        }
        check(policy, &logprobs, self.tokens.len())?;
        self.logprobs.insert(policy.to_owned(), logprobs);
        Ok(())
    }

    /// The tokens as the endpoint names them, in order.
    pub fn tokens(&self) -> &[String] {
        &self.tokens
    }

    /// One policy's log-probabilities, one a token; `None` if it gave none.
    pub fn of(&self, policy: &str) -> Option<&[f64]> {
        self.logprobs.get(policy).map(Vec::as_slice)
    }

    /// The policies by name, each with one log-probability a token.
    pub fn policies(&self) -> impl Iterator<Item = (&str, &[f64])> {
        self.logprobs
            .iter()
            .map(|(policy, logprobs)| (policy.as_str(), logprobs.as_slice()))
    }

    fn expect_tokens(&self, found: &[String]) -> Result<(), LogprobError> {
        let of = |tokens: &[String], at: usize| tokens.get(at).cloned().unwrap_or_default();
        let longest = self.tokens.len().max(found.len());
        match (0..longest).find(|at| self.tokens.get(*at) != found.get(*at)) {
            None => Ok(()),
            Some(token) => Err(LogprobError::OtherTokens {
                token,
                expected: of(&self.tokens, token),
                found: of(found, token),
            }),
        }
    }
}

impl TryFrom<Unchecked> for TokenLogprobs {
    type Error = LogprobError;

    fn try_from(read: Unchecked) -> Result<Self, LogprobError> {
        Self::new(read.tokens, read.logprobs)
    }
}

fn check(policy: &str, logprobs: &[f64], tokens: usize) -> Result<(), LogprobError> {
    let policy = || policy.to_owned();
    if policy().is_empty() {
        return Err(LogprobError::NoName);
    }
    if logprobs.len() != tokens {
        return Err(LogprobError::Lengths {
            policy: policy(),
            expected: tokens,
            found: logprobs.len(),
        });
    }
    match logprobs
        .iter()
        .position(|logprob| !(logprob.is_finite() && *logprob <= 0.0))
    {
        None => Ok(()),
        Some(token) => Err(LogprobError::Value {
            policy: policy(),
            token,
            found: logprobs[token],
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn words(text: &str) -> Vec<String> {
        text.split_inclusive(' ').map(str::to_owned).collect()
    }

    #[test]
    fn all_policies_are_about_the_same_tokens() {
        let mut pick = TokenLogprobs::sampled(words("pick it up"), vec![-0.5, -1.0, 0.0]).unwrap();
        pick.add("new", vec![-0.4, -1.1, -0.1], Some(&words("pick it up")))
            .unwrap();
        pick.add("new", vec![-0.3, -1.1, -0.1], None).unwrap();
        assert_eq!(
            pick.policies()
                .map(|(policy, _)| policy)
                .collect::<Vec<_>>(),
            ["new", "old"]
        );
        assert_eq!(pick.of("new"), Some([-0.3, -1.1, -0.1].as_slice()));
        assert_eq!(pick.of("ref"), None);
        let json = serde_json::to_string(&pick).unwrap();
        assert_eq!(serde_json::from_str::<TokenLogprobs>(&json).unwrap(), pick);
    }

    #[test]
    fn what_is_no_log_probability_is_refused() {
        for (wrong, word) in [
            (f64::NAN, "NaN"),
            (f64::NEG_INFINITY, "-inf"),
            (0.25, "0.25"),
        ] {
            let error = TokenLogprobs::sampled(words("a b"), vec![-1.0, wrong])
                .unwrap_err()
                .to_string();
            assert!(
                error.contains("token 1") && error.contains(word) && error.contains("at most 0"),
                "{error}"
            );
        }
        assert_eq!(
            TokenLogprobs::sampled(vec![], vec![]),
            Err(LogprobError::NoTokens)
        );
        let mut two = TokenLogprobs::sampled(words("a b"), vec![-1.0, -1.0]).unwrap();
        let lengths = LogprobError::Lengths {
            policy: "new".into(),
            expected: 2,
            found: 1,
        };
        assert_eq!(two.add("new", vec![-1.0], None), Err(lengths));
        assert_eq!(
            two.add("old", vec![-1.0, -1.0], None),
            Err(LogprobError::Sampled)
        );
        assert_eq!(
            two.add("", vec![-1.0, -1.0], None),
            Err(LogprobError::NoName)
        );
        let other = two
            .add("new", vec![-1.0, -1.0], Some(&words("a c")))
            .unwrap_err();
        assert!(
            other
                .to_string()
                .starts_with("token 1 is \"c\", but \"b\" was recorded"),
            "{other}"
        );
        assert!(
            two.add("new", vec![-1.0, -1.0], Some(&words("a b c")))
                .is_err()
        );
        assert!(
            serde_json::from_str::<TokenLogprobs>(
                r#"{"tokens": ["a"], "logprobs": {"old": [0.5]}}"#
            )
            .is_err()
        );
    }
}
