//! Secrets in what is about to be written: [`Rules`] say what a secret is, a [`Redactor`] replaces each by a label
//! such as `[redacted:token#1]`. Equal secrets of one redactor get equal labels, numbered in order of appearance; a
//! label is no function of its secret, so that nobody can test guesses against it. A number becomes 0 instead.
//!
//! `rules` reads rules and holds the built-in ones, but for the `shapes`; `redactor` applies them to texts and JSON
//! values, `escapes` looks through JSON escapes inside of texts, `nested` finds values within brackets there. Never opens
//! a file and never reads the environment: both are arguments. Never reads Base64.

mod escapes;
mod nested;
mod redactor;
mod rules;
mod shapes;

pub use redactor::{Redactions, Redactor, Scope, is_recorded_as, replace_value};
pub use rules::{RULES_FILE_MAX, RuleSource, Rules, RulesError};
pub use shapes::{SECRET_SHAPES, SecretShape};
