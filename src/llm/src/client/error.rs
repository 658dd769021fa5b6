//! Why a model did not answer.

use std::{io, path::PathBuf};

/// Every error of this crate. None holds the key.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ModelError {
    /// The address cannot be one.
    #[error(
        "the base url of the endpoint is wrong: {problem}; give it up to /v1, like http://localhost:8000/v1"
    )]
    BaseUrl { problem: &'static str },
    /// No key where it should be.
    #[error("no key: set the environment variable {variable}, or name another one")]
    NoKey { variable: String },
    /// A key that cannot be sent.
    #[error(
        "the key is empty or holds characters that cannot be sent; check the environment variable it comes from"
    )]
    BadKey,
    /// Nobody answers at the address.
    #[error("cannot connect ({problem}) after {tries}; is the endpoint running, and its address right? {url}", tries = tries(*attempts))]
    Connect {
        url: String,
        attempts: u32,
        problem: String,
    },
    /// The connection broke off.
    #[error("the connection broke off ({problem}) after {tries}; see the endpoint's log: {url}", tries = tries(*attempts))]
    Cut {
        url: String,
        attempts: u32,
        problem: String,
    },
    /// The TLS connection could not be established.
    #[error(
        "no secure connection ({problem}); check the endpoint's certificate and this machine's root certificates: {url}"
    )]
    Tls { url: String, problem: String },
    /// It takes too long.
    #[error("no answer within {timeout_s} s after {tries}; allow more time, or ask for fewer tokens: {url}", tries = tries(*attempts))]
    Timeout {
        url: String,
        attempts: u32,
        timeout_s: f64,
    },
    /// The endpoint says no.
    #[error("the endpoint answers {status} after {tries}: {excerpt}; {hint}: {url}", tries = tries(*attempts), hint = hint(*status))]
    Status {
        url: String,
        attempts: u32,
        status: u16,
        excerpt: String,
    },
    /// What came is no answer of a chat.
    #[error(
        "not the answer of a chat completion: {problem}; does the address speak the OpenAI protocol? {url}: {excerpt}"
    )]
    Answer {
        url: String,
        problem: String,
        /// Beginning of the answer's body; it never holds the API key.
        excerpt: String,
    },
    /// A reply cannot be kept, or a call not logged.
    #[error("cannot {action}: {source}; check the disk and the permissions: {path}", path = path.display())]
    Write {
        action: &'static str,
        path: PathBuf,
        source: io::Error,
    },
}

impl ModelError {
    /// Whether nobody was there: the next call will probably find nobody either.
    pub fn is_unreachable(&self) -> bool {
        matches!(self, ModelError::Connect { .. })
    }

    /// Whether another try may help.
    pub(crate) fn is_transient(&self) -> bool {
        match self {
            ModelError::Connect { .. } | ModelError::Cut { .. } | ModelError::Timeout { .. } => {
                true
            }
            ModelError::Status { status, .. } => matches!(status, 408 | 429 | 500..=599),
            _ => false,
        }
    }
}

/// The beginning of what an endpoint said, on one line.
pub(crate) fn excerpt(text: &str) -> String {
    const CHARACTERS: usize = 300;
    let mut words: String = text
        .chars()
        .take(CHARACTERS)
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    if text.chars().nth(CHARACTERS).is_some() {
        words.push_str(" ...");
    }
    match words.trim() {
        "" => "(nothing)".to_owned(),
        words => words.to_owned(),
    }
}

fn tries(attempts: u32) -> String {
    match attempts {
        1 => "1 try".to_owned(),
        attempts => format!("{attempts} tries"),
    }
}

fn hint(status: u16) -> &'static str {
    match status {
        300..=399 => "give the address it leads to",
        401 | 403 => "check the key in the environment variable",
        404 => "check the base url (mostly it ends in /v1) and the model's name",
        413 => "send fewer images or less text",
        429 => "the limit of calls or the quota is used up: use fewer threads, or wait",
        500..=599 => "its own trouble: see its log, or try again later",
        _ => {
            "the endpoint rejects this request: check the model's name, and whether it accepts images, `temperature` and `max_tokens`"
        }
    }
}
