//! A bundle from the episodes of a run.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::Path,
};

use reel_replay::SIM_VERSION;
use reel_trace::{PackedEpisode, ShardWriter};
use reel_world::{
    canonical_json,
    record::{EndRecord, EpisodeHeader},
};
use serde_json::json;

use crate::{
    BundleError, Key,
    archive::Bundle,
    manifest::{Cell, ClaimedEpisode, FORMAT, Grid, Manifest, Settings, TaskEntry, results},
};

/// How many problems of one kind are told.
const TOLD: usize = 5;

/// What a bundle is made of.
#[derive(Debug)]
pub struct BundleInputs<'a> {
    /// Name of the run, for people.
    pub name: String,
    /// The episodes with their ends, as they were recorded.
    pub episodes: Vec<(PackedEpisode, EndRecord)>,
    /// All tasks of the benchmark; those of the episodes where it is empty.
    pub tasks: Vec<TaskEntry>,
    /// Whether episodes of the grid may be missing; they count as failures.
    pub partial: bool,
    /// The log of the model calls.
    pub calls: Option<Vec<u8>>,
    /// The key that signs the statement, if it is to be signed.
    pub key: Option<&'a Key>,
}

/// Makes a bundle. `scratch` is a folder for a file while it is made.
///
/// # Errors
/// When the episodes are no one run, some are missing, or nothing can be written.
pub fn make(made: BundleInputs<'_>, scratch: &Path) -> Result<Bundle, BundleError> {
    let BundleInputs {
        name,
        mut episodes,
        tasks,
        partial,
        calls,
        key,
    } = made;
    let no_run = |problem: String| BundleError::NoRun { problem };
    let (first, _) = episodes
        .first()
        .ok_or_else(|| no_run("there is none that was played to its end".to_owned()))?;
    let settings = settings(&first.header);
    if let Some((other, _)) = episodes
        .iter()
        .find(|(episode, _)| self::settings(&episode.header) != settings)
    {
        return Err(no_run(format!(
            "{} was played with {}, and {} with {}; bundle them one by one",
            first.name,
            canonical_json(&settings),
            other.name,
            canonical_json(&self::settings(&other.header))
        )));
    }
    let grid = grid(&episodes, tasks).map_err(no_run)?;
    grid.checked_len().map_err(no_run)?;
    episodes.sort_by(|(one, _), (other, _)| cell(&one.header).cmp(&cell(&other.header)));
    if let Some([(one, _), (other, _)]) = episodes
        .array_windows()
        .find(|[(one, _), (other, _)]| cell(&one.header) == cell(&other.header))
    {
        return Err(no_run(format!(
            "{} and {} are both {}",
            one.name,
            other.name,
            cell(&one.header)
        )));
    }
    let played: BTreeSet<Cell<'_>> = episodes
        .iter()
        .map(|(episode, _)| cell(&episode.header))
        .collect();
    let missing: Vec<String> = grid
        .cells()
        .filter(|cell| !played.contains(cell))
        .map(|cell| cell.to_string())
        .collect();
    if !missing.is_empty() && !partial {
        return Err(no_run(format!(
            "{} of {} episodes are missing: {}; play them, or count them as failures with --partial",
            missing.len(),
            missing.len() + played.len(),
            some(&missing)
        )));
    }

    let path = scratch.join("episodes.mcap");
    let mut shard = ShardWriter::create(&path)?;
    for (episode, _) in &episodes {
        shard.add(episode)?;
    }
    shard.finish()?;
    let claimed: Vec<ClaimedEpisode> = episodes
        .iter()
        .map(|(episode, end)| {
            let header = &episode.header;
            ClaimedEpisode::of(&header.task_id, header.seed, episode.chain, end)
        })
        .collect();
    let manifest = Manifest {
        format: FORMAT,
        name,
        build: env!("CARGO_PKG_VERSION").to_owned(),
        simulator: SIM_VERSION,
        settings,
        results: results(&grid, &claimed),
        grid,
        episodes: claimed,
    };
    let packed = fs::read(&path)?;
    fs::remove_file(&path)?;
    Ok(Bundle::of(&manifest, packed, calls, key))
}

/// A random policy has the seed of its episode: what all have in common is left.
pub(crate) fn settings(header: &EpisodeHeader) -> Settings {
    let mut policy = header.policy.clone();
    if policy.parameters.get("seed") == Some(&json!(header.seed)) {
        policy.parameters.remove("seed");
    }
    Settings {
        policy,
        profile: header.profile,
        skills: header.skills,
        preset: header.reward_preset.clone(),
    }
}

fn cell(header: &EpisodeHeader) -> Cell<'_> {
    Cell {
        task: &header.task_id,
        seed: header.seed,
    }
}

pub(crate) fn entry(header: &EpisodeHeader) -> TaskEntry {
    TaskEntry {
        id: header.task_id.clone(),
        family: header.family,
        task: header.task_digest,
        scene: header.scene_digest,
    }
}

/// Every task with every seed that any of them was played with.
fn grid(episodes: &[(PackedEpisode, EndRecord)], tasks: Vec<TaskEntry>) -> Result<Grid, String> {
    let named = !tasks.is_empty();
    let mut known: BTreeMap<String, TaskEntry> = tasks
        .into_iter()
        .map(|task| (task.id.clone(), task))
        .collect();
    for (episode, _) in episodes {
        let played = entry(&episode.header);
        match known.get(&played.id) {
            Some(task) if *task == played => {}
            Some(_) => {
                return Err(format!(
                    "{} was played with another task {} or another scene than the others",
                    episode.name, played.id
                ));
            }
            None if named => {
                return Err(format!(
                    "{} plays {}, which is none of the tasks",
                    episode.name, played.id
                ));
            }
            None => drop(known.insert(played.id.clone(), played)),
        }
    }
    let seeds: BTreeSet<u64> = episodes
        .iter()
        .map(|(episode, _)| episode.header.seed)
        .collect();
    Ok(Grid {
        tasks: known.into_values().collect(),
        seeds: seeds.into_iter().collect(),
    })
}

/// The first of them, and how many more there are.
pub(crate) fn some(all: &[String]) -> String {
    let told = all[..all.len().min(TOLD)].join(", ");
    match all.len().saturating_sub(TOLD) {
        0 => told,
        more => format!("{told} and {more} more"),
    }
}
