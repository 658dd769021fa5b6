//! Why a bundle cannot be made or read.

/// Why a bundle cannot be made or read. What is wrong inside one that can be read is a [`crate::Finding`].
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum BundleError {
    /// The bytes are no bundle, or one that somebody changed.
    #[error("this is no bundle as `reel bundle` writes it: {problem}")]
    Container { problem: String },
    /// A part that every bundle has is missing.
    #[error("the bundle has no {name}")]
    Missing { name: &'static str },
    /// A part cannot be read.
    #[error("{name} in the bundle cannot be read: {problem}")]
    Part { name: &'static str, problem: String },
    /// The traces are no run of a benchmark.
    #[error("these traces are no one run: {problem}")]
    NoRun { problem: String },
    /// A key cannot be read or used.
    #[error("the key cannot be used: {problem}")]
    Key { problem: String },
    /// The shard of a bundle cannot be made or read.
    #[error(transparent)]
    Trace(#[from] reel_trace::TraceError),
    /// A file cannot be read or written.
    #[error(transparent)]
    Io(#[from] std::io::Error),
}
