//! Why a case has no verdict.

use reel_llm::client::ModelError;

/// Every error of the judge. Each belongs to one case; the others go on.
#[derive(Debug, thiserror::Error)]
pub enum JudgeError {
    /// The episode has no step that could be judged.
    #[error("the episode has no step that could be judged: {episode_id}")]
    NoSteps {
        /// Id of the episode without a step to judge.
        episode_id: String,
    },
    /// The model did not answer.
    #[error("{source} (episode {episode_id})")]
    Model {
        /// Id of the episode whose request failed.
        episode_id: String,
        /// The error that the model client reported.
        source: ModelError,
    },
    /// It answered twice, and neither is an answer.
    #[error("the judge's answer cannot be read, and neither could the one before: {problem}{limit}; try another model: {excerpt} (episode {episode_id})",
        limit = if *truncated { " (it was cut off: allow more tokens)" } else { "" })]
    Unreadable {
        /// Id of the episode whose answers cannot be read.
        episode_id: String,
        /// What is wrong with it.
        problem: String,
        /// Whether it was cut off at the most tokens allowed.
        truncated: bool,
        /// The beginning of the second answer, on one line.
        excerpt: String,
    },
    /// Not tried, because nobody is there.
    #[error(
        "not judged: {refused} calls in a row could not connect; start the endpoint and judge again (episode {episode_id})"
    )]
    Stopped {
        /// Id of the episode that was not judged.
        episode_id: String,
        /// How many calls failed before.
        refused: u32,
    },
    /// No threads to work with.
    #[error("cannot start {threads} threads: {message}; use fewer")]
    Workers {
        /// How many were wanted.
        threads: usize,
        /// The thread pool's message why the threads cannot be started.
        message: String,
    },
}
