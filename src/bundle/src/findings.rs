//! What does not hold in a bundle.

use reel_world::printable_line;
use serde::Serialize;

/// What a finding is about.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FindingKind {
    /// The signature is missing, of another key, or of another statement.
    Signature,
    /// The statement is not that of the parts.
    Statement,
    /// The manifest or the shard cannot be read.
    Part,
    /// Another simulator recorded it.
    Simulator,
    /// Tasks or scenes are others than claimed, or than those of the benchmark.
    Task,
    /// An episode has another seed than claimed.
    Seed,
    /// The reward preset is another.
    Preset,
    /// Policy, profile or skills are others.
    Settings,
    /// An episode of the grid is missing.
    Missing,
    /// An episode is there twice, or does not belong to the grid.
    Extra,
    /// An episode, executed again, is another.
    Episode,
    /// A metric of an episode is another.
    Metrics,
    /// The table does not follow from the episodes.
    Results,
}

/// Something that does not hold.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Finding {
    /// What it is about.
    pub kind: FindingKind,
    /// The number of the episode in the shard, where it is about one.
    pub episode: Option<u32>,
    /// The task, where it is about one of the grid.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub task: Option<String>,
    /// What is wrong, and where.
    pub text: String,
}

impl Finding {
    pub(crate) fn new(kind: FindingKind, text: impl Into<String>) -> Self {
        Self {
            kind,
            episode: None,
            task: None,
            text: text.into(),
        }
    }

    pub(crate) fn of_task(task: &str, text: String) -> Self {
        Self {
            task: Some(task.to_owned()),
            ..Self::new(FindingKind::Task, text)
        }
    }

    /// Something about an episode, by its number in the shard.
    pub fn of_episode(kind: FindingKind, episode: u32, text: impl Into<String>) -> Self {
        Self {
            episode: Some(episode),
            ..Self::new(kind, text)
        }
    }
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let text = printable_line(&self.text);
        match self.episode {
            Some(episode) => write!(f, "episode {episode}: {text}"),
            None => f.write_str(&text),
        }
    }
}
