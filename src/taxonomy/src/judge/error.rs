//! Why a case has no verdict.

use reel_llm::client::ModelError;

/// Every error of the judge. Each belongs to one case; the others go on.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum JudgeError {
    /// The episode has no step that could be judged.
    #[error("the episode has no step that could be judged: {episode_id}")]
    NoSteps { episode_id: String },
    /// The model did not answer.
    #[error("{source} (episode {episode_id})")]
    Model {
        episode_id: String,
        source: ModelError,
    },
    /// It answered twice, and neither is an answer.
    #[error("the judge's answer cannot be read, and neither could the one before: {problem}{limit}; try another model, or this one again with another folder for replies (this reply is kept): {excerpt} (episode {episode_id})",
        limit = if *truncated { " (it was cut off: allow more tokens)" } else { "" })]
    Unreadable {
        episode_id: String,
        problem: String,
        truncated: bool,
        /// The beginning of the second answer, on one line.
        excerpt: String,
    },
    /// Not tried, because nobody is there.
    #[error(
        "not judged: {refused} calls in a row could not connect; start the endpoint and judge again (episode {episode_id})"
    )]
    Stopped { episode_id: String, refused: u32 },
    /// No threads to work with.
    #[error("cannot start {threads} threads: {message}; use fewer")]
    Workers { threads: usize, message: String },
}
