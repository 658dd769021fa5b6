//! What can be wrong with what this crate is given: preset files and log-probabilities.

use thiserror::Error;

/// Why a preset file or a list of log-probabilities is refused.
#[derive(Clone, PartialEq, Debug, Error)]
#[non_exhaustive]
pub enum RewardError {
    /// The text is no TOML.
    #[error("line {line}, column {column}: {message}")]
    Toml {
        /// Line of the syntax error in the preset file, from 1.
        line: usize,
        /// From 1, in characters.
        column: usize,
        /// What the parser says.
        message: String,
    },
    /// A key that no preset of this base has.
    #[error("line {line}, column {column}: unknown key '{key}' in {table}{hint}")]
    UnknownKey {
        /// Line of the unknown key in the preset file, from 1.
        line: usize,
        /// From 1, in characters.
        column: usize,
        /// As it stands in the file.
        key: String,
        /// Table that holds the key, e.g. `[weights] of base paper`.
        table: String,
        /// The nearest key that exists, or all of them.
        hint: String,
    },
    /// A value of another kind, or out of range.
    #[error("line {line}, column {column}: {key} must be {expected}, not {found}")]
    Value {
        /// Line of the value in the preset file, from 1.
        line: usize,
        /// From 1, in characters.
        column: usize,
        /// Whose value it is.
        key: String,
        /// What it can be.
        expected: String,
        /// As it stands in the file.
        found: String,
    },
    /// A key without which a file is no preset.
    #[error("a reward preset needs '{key}': {expected}")]
    Missing {
        /// Name of the missing key, `base` or `name`.
        key: &'static str,
        /// What it can be.
        expected: String,
    },
    /// Lists that belong together have different lengths.
    #[error(
        "{expected} values on one side and {found} on the other: give one for each token or rollout"
    )]
    Lengths {
        /// Of the first list.
        expected: usize,
        /// Number of values in the other list.
        found: usize,
    },
    /// A mean over nothing.
    #[error("no values: a ratio needs at least one token, an objective at least one rollout")]
    Empty,
    /// A log-probability that is none.
    #[error("token {token}: log-probabilities {new} and {old} must both be finite")]
    LogProbability {
        /// Index of the token in the rollout, from 0.
        token: usize,
        /// Log-probability of the token under the first policy.
        new: f64,
        /// Log-probability of the token under the policy it is compared with.
        old: f64,
    },
    /// Policies so far apart that their ratio is no number.
    #[error(
        "log-probabilities differ by {log_ratio}: their ratio is too large for a number; are they of the same tokens?"
    )]
    Overflow {
        /// Logarithm of the ratio.
        log_ratio: f64,
    },
    /// A return that is none.
    #[error("a return of group {group} is {found}; returns must be finite")]
    Return {
        /// Index of the group, from 0.
        group: usize,
        /// The return that is not finite.
        found: f64,
    },
    /// A group in which a rollout has nobody to be compared with.
    #[error("group {group} has one rollout; this estimator needs two at least (ngrpo takes one)")]
    GroupOfOne {
        /// Index of the group, from 0.
        group: usize,
    },
    /// A parameter of an estimator that is none.
    #[error("{name} must be finite and, but for virtual_max, not negative, not {found}")]
    Parameter {
        /// Name of the number that is out of range, as on the command line.
        name: &'static str,
        /// The value that was given for it.
        found: f64,
    },
    /// A clip radius that is none.
    #[error("a clip radius must be finite and not negative, not {found}")]
    ClipRadius {
        /// Radius that was given, which is negative or not finite.
        found: f64,
    },
}
