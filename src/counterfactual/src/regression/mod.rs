//! Two runs of the same tasks and seeds: which episodes flip between success and failure, where the
//! two episodes of a flip come apart, and why the failed one failed.
//!
//! Reads records only, and never says whether a change is more than chance.

use std::{
    collections::{BTreeMap, VecDeque},
    path::{Path, PathBuf},
};

use rayon::prelude::*;
use reel_replay::compare;
use reel_trace::{Trace, TraceFiles};
use reel_world::ToolCall;
use serde::Serialize;

use crate::blame::{blame, outcome};

/// An episode of a run.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct RunEpisode {
    /// Path of the trace.
    pub trace: PathBuf,
    /// Id of the episode, from the trace's header.
    pub episode_id: String,
    /// Id of the task that it plays.
    pub task_id: String,
    /// Seed of the episode.
    pub seed: u64,
    /// Whether it succeeded; `None` if it was broken off, or if nobody judged it.
    pub success: Option<bool>,
}

impl RunEpisode {
    /// What a trace says of its episode.
    pub fn of(trace: &Trace) -> Self {
        Self {
            trace: trace.path.clone(),
            episode_id: trace.header.episode_id.clone(),
            task_id: trace.header.task_id.clone(),
            seed: trace.header.seed,
            success: outcome(trace),
        }
    }
}

/// Reads the episodes of a run, in the order of the paths. A trace that fails to load is an error
/// in words.
pub fn read_run(
    files: &TraceFiles,
    paths: &[PathBuf],
    on_done: impl Fn() + Sync,
) -> Vec<Result<RunEpisode, String>> {
    let one = |path: &PathBuf| {
        let read = files.read(path).map(|trace| RunEpisode::of(&trace));
        on_done();
        read.map_err(|error| error.to_string())
    };
    paths.par_iter().map(one).collect()
}

/// The episodes of two runs, paired by task and seed.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct Pairing {
    /// One episode of each run; where a run repeats a task and seed, in the order of its traces.
    pub pairs: Vec<[RunEpisode; 2]>,
    /// Episodes without a counterpart, of the first and of the second run: no such task and seed
    /// there, or one of the two was broken off.
    pub unpaired: [Vec<RunEpisode>; 2],
}

/// Pairs the episodes of two runs.
pub fn pair(first: Vec<RunEpisode>, second: Vec<RunEpisode>) -> Pairing {
    let mut by_key: BTreeMap<(String, u64), [VecDeque<RunEpisode>; 2]> = BTreeMap::new();
    for (side, episodes) in [first, second].into_iter().enumerate() {
        for episode in episodes {
            let key = (episode.task_id.clone(), episode.seed);
            by_key.entry(key).or_default()[side].push_back(episode);
        }
    }
    let mut pairing = Pairing::default();
    for [mut firsts, mut seconds] in by_key.into_values() {
        for _ in 0..firsts.len().min(seconds.len()) {
            let (Some(one), Some(other)) = (firsts.pop_front(), seconds.pop_front()) else {
                break;
            };
            if one.success.is_some() && other.success.is_some() {
                pairing.pairs.push([one, other]);
            } else {
                pairing.unpaired[0].push(one);
                pairing.unpaired[1].push(other);
            }
        }
        pairing.unpaired[0].extend(firsts);
        pairing.unpaired[1].extend(seconds);
    }
    pairing
}

/// A pair of which one episode succeeded and the other failed.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Flip {
    /// Id of the task.
    pub task_id: String,
    /// Seed of both episodes.
    pub seed: u64,
    /// Whether the second run failed where the first succeeded.
    pub is_regression: bool,
    /// The episode of the first and of the second run.
    pub sides: [FlipSide; 2],
    /// Calls that both made first, with the same outcome.
    pub same_calls: usize,
    /// The inputs besides the policy that differ, e.g. the profile.
    pub inputs: Vec<&'static str>,
}

/// One episode of a flip.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct FlipSide {
    /// Path of the trace.
    pub trace: PathBuf,
    /// `success`, else the class of the failure.
    pub class: String,
    /// The call at which the two come apart; `None` if this episode has no call there.
    pub first_difference: Option<String>,
    /// The decisive step, where the episode failed and lost something.
    pub decisive_step: Option<u32>,
    /// The call at that step.
    pub decisive_call: Option<ToolCall>,
    /// Why it did harm, in a sentence.
    pub explanation: Option<String>,
}

/// The flips among pairs, in their order. `class` names the class of a failed episode by its id;
/// where it has none, the cause that [`blame`] measures stands for it.
pub fn flips(
    files: &TraceFiles,
    pairs: &[[RunEpisode; 2]],
    class: impl Fn(&str) -> Option<String> + Sync,
    on_done: impl Fn() + Sync,
) -> Vec<Result<Flip, String>> {
    let flipped: Vec<&[RunEpisode; 2]> = pairs
        .iter()
        .filter(|[one, other]| one.success != other.success)
        .collect();
    let one = |pair: &&[RunEpisode; 2]| {
        let found = flip(files, pair, &class);
        on_done();
        found
    };
    flipped.par_iter().map(one).collect()
}

fn flip(
    files: &TraceFiles,
    pair: &[RunEpisode; 2],
    class: &impl Fn(&str) -> Option<String>,
) -> Result<Flip, String> {
    let read = |path: &Path| files.read(path).map_err(|error| error.to_string());
    let traces = [read(&pair[0].trace)?, read(&pair[1].trace)?];
    let beside = compare(&traces[0], &traces[1]).map_err(|error| error.to_string())?;
    let side = |index: usize| {
        let (episode, trace) = (&pair[index], &traces[index]);
        let measured = blame(trace);
        let decisive = measured.decisive;
        let named = || class(&episode.episode_id);
        let cause = || {
            decisive
                .as_ref()
                .map_or("other", |decisive| decisive.cause.name())
                .to_owned()
        };
        let call = trace.steps.get(beside.same_calls);
        FlipSide {
            trace: episode.trace.clone(),
            class: match episode.success {
                Some(true) => "success".to_owned(),
                _ => named().unwrap_or_else(cause),
            },
            first_difference: call.map(|step| step.input.call.to_string()),
            decisive_step: decisive.as_ref().map(|decisive| decisive.step),
            decisive_call: decisive.as_ref().map(|decisive| decisive.call.clone()),
            explanation: decisive
                .as_ref()
                .map(|decisive| decisive.explanation.clone()),
        }
    };
    Ok(Flip {
        task_id: pair[0].task_id.clone(),
        seed: pair[0].seed,
        is_regression: pair[0].success == Some(true),
        same_calls: beside.same_calls,
        inputs: beside.inputs.clone(),
        sides: [side(0), side(1)],
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(name: &str, task: &str, seed: u64, success: Option<bool>) -> RunEpisode {
        RunEpisode {
            trace: name.into(),
            episode_id: name.into(),
            task_id: task.into(),
            seed,
            success,
        }
    }

    #[test]
    fn episodes_pair_by_task_and_seed_and_the_others_are_listed() {
        let yes = Some(true);
        let first = vec![
            episode("a1", "t1", 1, yes),
            episode("a2", "t1", 2, yes),
            episode("a3", "t1", 2, yes),
            episode("a4", "t2", 1, yes),
            episode("a5", "t3", 1, None),
        ];
        let second = vec![
            episode("b1", "t1", 2, Some(false)),
            episode("b2", "t1", 1, yes),
            episode("b3", "t4", 1, yes),
            episode("b4", "t3", 1, yes),
        ];
        let found = pair(first, second);
        let names = |episodes: &[RunEpisode]| -> Vec<String> {
            let mut names: Vec<String> =
                episodes.iter().map(|one| one.episode_id.clone()).collect();
            names.sort();
            names
        };
        let pairs: Vec<Vec<String>> = found.pairs.iter().map(|pair| names(pair)).collect();
        assert_eq!(pairs, [["a1", "b2"], ["a2", "b1"]]);
        assert_eq!(names(&found.unpaired[0]), ["a3", "a4", "a5"]);
        assert_eq!(names(&found.unpaired[1]), ["b3", "b4"]);
    }
}
