//! Why a case has no verdict.

use reel_llm::client::ModelError;

/// Every error of the judge. Each belongs to one case; the others go on.
#[derive(Debug, thiserror::Error)]
pub enum JudgeError {
    /// Nothing to judge.
    #[error("the episode has no step that could be judged: {episode_id}")]
    NoSteps {
        /// The episode.
        episode_id: String,
    },
    /// The model did not answer.
    #[error("{source} (episode {episode_id})")]
    Model {
        /// The episode.
        episode_id: String,
        /// Why not.
        source: ModelError,
    },
    /// It answered twice, and neither is an answer.
    #[error("the judge's answer cannot be read, and neither could the one before: {what}{limit}; try another model: {excerpt} (episode {episode_id})",
        limit = if *truncated { " (it was cut off: allow more tokens)" } else { "" })]
    Unreadable {
        /// The episode.
        episode_id: String,
        /// What is wrong with it.
        problem: String,
        /// Whether it was cut off at the most tokens allowed.
        truncated: bool,
        /// Its beginning.
        excerpt: String,
    },
    /// Not tried, because nobody is there.
    #[error(
        "not judged: {refused} calls in a row could not connect; start the endpoint and judge again (episode {episode_id})"
    )]
    Stopped {
        /// The episode.
        episode_id: String,
        /// How many calls failed before.
        refused: u32,
    },
    /// No threads to work with.
    #[error("cannot start {threads} threads: {message}; use fewer")]
    Workers {
        /// How many were wanted.
        threads: usize,
        /// The system's word.
        message: String,
    },
}
