//! Why nothing was published, or not all of it.

use std::{io, path::PathBuf};

/// Every error of this crate. None holds a token.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum PublishError {
    /// The folder is neither an export of Reel nor a LeRobot dataset.
    #[error(
        "no dataset: {reason}; `reel export sft`, `rl`, `preferences` and `lerobot` write folders that can be published: {path}",
        path = path.display()
    )]
    NoDataset { path: PathBuf, reason: String },
    /// A file cannot be read.
    #[error("cannot read: {source}: {path}", path = path.display())]
    Read { path: PathBuf, source: io::Error },
    /// A file cannot be written.
    #[error("cannot write: {source}; nothing was published: {path}", path = path.display())]
    Write { path: PathBuf, source: io::Error },
    /// A bound on what one folder may hold.
    #[error("{message}: {path}", path = path.display())]
    TooLarge { path: PathBuf, message: String },
    /// A file is no longer what was checked.
    #[error("the file changed while it was published; run the command again: {path}", path = path.display())]
    Changed { path: PathBuf },
    /// The target is something that must not be replaced.
    #[error("{reason}: {path}", path = path.display())]
    Target { path: PathBuf, reason: String },
    /// The target's name is neither a folder nor a repository.
    #[error("'{name}' names no target: {reason}")]
    TargetName { name: String, reason: String },
    /// The address of the Hub cannot be one.
    #[error("HF_ENDPOINT: {reason}; give an address like https://huggingface.co: {endpoint}")]
    Endpoint { endpoint: String, reason: String },
    /// The token cannot stand in a header.
    #[error("the token of {origin} is empty or holds characters that cannot be sent; check it")]
    Token { origin: String },
    /// Nobody answers, or the connection breaks off.
    #[error(
        "{action}: no answer ({reason}); run the command again, what arrived is not sent again: {url}"
    )]
    Connection {
        action: String,
        url: String,
        reason: String,
    },
    /// The Hub says no.
    #[error("{action}: the Hub answers {status}{excerpt}; {hint}: {url}")]
    Status {
        action: String,
        url: String,
        status: u16,
        /// What the Hub said, behind a colon; empty if it said nothing.
        excerpt: String,
        hint: String,
    },
    /// The Hub says something that its protocol does not have.
    #[error(
        "{action}: the answer is not understood ({reason}); is this the address of a Hub? {url}"
    )]
    Answer {
        action: String,
        url: String,
        reason: String,
    },
    /// The repository is not what the command asks for.
    #[error("{reason}: {repository}")]
    Repository { repository: String, reason: String },
}

impl PublishError {
    pub(crate) fn read(path: &std::path::Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Read { path, source }
    }

    pub(crate) fn write(path: &std::path::Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Write { path, source }
    }
}
