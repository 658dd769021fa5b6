//! What a bundle claims: which tasks were played with which seeds, by whom and how, what came of each episode, and the table of results.

use std::collections::BTreeMap;

use reel_statistics::wilson;
use reel_world::{
    Digest, Family, Profile, Skills,
    record::{EndRecord, PolicyInfo},
};
use serde::{Deserialize, Serialize};

/// Of this form of the manifest.
pub(crate) const FORMAT: u32 = 1;
/// Most episodes that a grid may have: every one of them is listed, played or not.
const CELLS_MAX: usize = 1_000_000;

/// What a bundle claims of its episodes.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Version of this form: 1.
    pub format: u32,
    /// Name of the run, for people.
    pub name: String,
    /// Version of Reel that made the bundle.
    pub build: String,
    /// Version of the simulator that the episodes were recorded by.
    pub simulator: u32,
    /// What all episodes have in common.
    pub settings: Settings,
    /// Which episodes there should be.
    pub grid: Grid,
    /// Those that were played to their end, in the order of the grid; their places are their numbers in the shard.
    pub episodes: Vec<ClaimedEpisode>,
    /// The table: by family, and all of it at the end.
    pub results: Vec<ResultRow>,
}

/// What all episodes of a run have in common.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// The policy that decided, without the seed that some have.
    pub policy: PolicyInfo,
    /// How the environment behaves where the paper and the published code differ.
    pub profile: Profile,
    /// How reliable the robot's skills are.
    pub skills: Skills,
    /// Name of the reward preset.
    pub preset: String,
}

/// Every task with every seed.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// The tasks, by id.
    pub tasks: Vec<TaskEntry>,
    /// The seeds of every task, in rising order.
    pub seeds: Vec<u64>,
}

/// A task of the grid.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskEntry {
    /// Id of the task.
    pub id: String,
    /// Family of the task.
    pub family: Family,
    /// Digest of the whole task.
    pub task: Digest,
    /// Digest of the scene that it plays in.
    pub scene: Digest,
}

/// One episode that there should be.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct Cell<'a> {
    /// Id of the task.
    pub task: &'a str,
    /// Seed of the episode.
    pub seed: u64,
}

impl std::fmt::Display for Cell<'_> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} with seed {}", self.task, self.seed)
    }
}

/// What is claimed of one episode.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClaimedEpisode {
    /// Id of the task.
    pub task: String,
    /// Seed of the episode.
    pub seed: u64,
    /// Last link of its hash chain.
    pub trace: Digest,
    /// SR: whether the goal was reached.
    pub success: bool,
    /// CR: share of the goal changes that hold at the end.
    pub completion: f64,
    /// SPL; none where the shortest path is unknown.
    pub spl: Option<f64>,
    /// Sum of the rewards.
    pub reward: f64,
    /// Number of decisions in the episode.
    pub length: u32,
    /// Number of `ask` calls.
    pub asks: u32,
}

impl ClaimedEpisode {
    pub(crate) fn of(task: &str, seed: u64, trace: Digest, end: &EndRecord) -> Self {
        let metrics = &end.metrics;
        Self {
            task: task.to_owned(),
            seed,
            trace,
            success: metrics.success,
            completion: metrics.completion,
            spl: metrics.spl,
            reward: metrics.total_reward,
            length: metrics.length,
            asks: metrics.asks,
        }
    }

    /// Its place in the grid.
    pub fn cell(&self) -> Cell<'_> {
        Cell {
            task: &self.task,
            seed: self.seed,
        }
    }
}

/// A line of the table. Episodes of the grid that were not played count as failures.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ResultRow {
    /// Name of the family, or `all`.
    pub family: String,
    /// Episodes of the grid.
    pub episodes: usize,
    /// Those that were played to their end.
    pub played: usize,
    /// Those that reached their goal.
    pub successes: usize,
    /// Successes of all episodes, from 0 to 1.
    pub success_rate: f64,
    /// Lower end of Wilson's interval at 95 %.
    pub success_low: f64,
    /// Upper end of that interval.
    pub success_high: f64,
    /// Mean completion of all episodes; 0 for those that were not played.
    pub completion: f64,
    /// Mean SPL of the episodes that have one.
    pub spl: Option<f64>,
    /// Mean number of decisions of those that were played.
    pub steps: f64,
    /// Mean number of questions of those that were played.
    pub asks: f64,
    /// Mean reward of those that were played.
    pub reward: f64,
}

impl Grid {
    /// Every cell, task by task.
    pub fn cells(&self) -> impl Iterator<Item = Cell<'_>> {
        self.tasks.iter().flat_map(|task| {
            self.seeds.iter().map(|seed| Cell {
                task: &task.id,
                seed: *seed,
            })
        })
    }

    /// The task of an id, where the tasks are in order.
    pub fn task(&self, id: &str) -> Option<&TaskEntry> {
        let found = self.tasks.binary_search_by(|task| task.id.as_str().cmp(id));
        self.tasks.get(found.ok()?)
    }

    /// How many cells there are, if nobody would have to wait for them.
    pub(crate) fn checked_len(&self) -> Result<usize, String> {
        let cells = self.tasks.len().saturating_mul(self.seeds.len());
        match cells {
            0..=CELLS_MAX => Ok(cells),
            _ => Err(format!(
                "{} tasks with {} seeds are {cells} episodes, and {CELLS_MAX} is the most",
                self.tasks.len(),
                self.seeds.len()
            )),
        }
    }
}

/// The table that follows from episodes of a grid.
pub fn results(grid: &Grid, episodes: &[ClaimedEpisode]) -> Vec<ResultRow> {
    let families: BTreeMap<&str, Family> = grid
        .tasks
        .iter()
        .map(|task| (task.id.as_str(), task.family))
        .collect();
    let row = |name: &str, wanted: Option<Family>| {
        let fits = |id: &str| {
            let family = families.get(id);
            family.is_some() && wanted.is_none_or(|wanted| family == Some(&wanted))
        };
        let tasks = grid.tasks.iter().filter(|task| fits(&task.id)).count();
        let played: Vec<&ClaimedEpisode> = episodes
            .iter()
            .filter(|episode| fits(&episode.task))
            .collect();
        ResultRow::of(name, tasks * grid.seeds.len(), &played)
    };
    let mut rows: Vec<ResultRow> = Family::ALL
        .iter()
        .map(|family| row(family.as_str(), Some(*family)))
        .filter(|row| row.episodes > 0)
        .collect();
    rows.push(row("all", None));
    rows
}

impl ResultRow {
    fn of(family: &str, episodes: usize, played: &[&ClaimedEpisode]) -> Self {
        let mean = |of: usize, value: &dyn Fn(&ClaimedEpisode) -> f64| {
            played.iter().map(|episode| value(episode)).sum::<f64>() / of.max(1) as f64
        };
        let successes = played.iter().filter(|episode| episode.success).count();
        let (low, high) = wilson(successes as f64, episodes as f64).unwrap_or((0.0, 1.0));
        let spl: Vec<f64> = played.iter().filter_map(|episode| episode.spl).collect();
        Self {
            family: family.to_owned(),
            episodes,
            played: played.len(),
            successes,
            success_rate: successes as f64 / episodes.max(1) as f64,
            success_low: low,
            success_high: high,
            completion: mean(episodes, &|episode| episode.completion),
            spl: (!spl.is_empty()).then(|| spl.iter().sum::<f64>() / spl.len() as f64),
            steps: mean(played.len(), &|episode| f64::from(episode.length)),
            asks: mean(played.len(), &|episode| f64::from(episode.asks)),
            reward: mean(played.len(), &|episode| episode.reward),
        }
    }
}

impl std::fmt::Display for ResultRow {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "success {:.1} % [{:.1}, {:.1}], completion {:.1} %",
            100.0 * self.success_rate,
            100.0 * self.success_low,
            100.0 * self.success_high,
            100.0 * self.completion
        )?;
        match self.episodes - self.played.min(self.episodes) {
            0 => Ok(()),
            left => write!(
                f,
                "; {left} of {} not played, which count as failures",
                self.episodes
            ),
        }
    }
}
