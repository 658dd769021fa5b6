//! `reel train log`: the steps of a training, and the episodes of a step.

use std::{collections::BTreeMap, path::PathBuf};

use anyhow::{Context, bail};
use reel_export::{Figures, LoggedStep, Sequence, TrainingLog};
use reel_query::QuerySession;
use reel_reward::Preset;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::ask;
use crate::{ExitStatus, commands::store::reward::PresetSource};

/// How far a figure of the log may be from the same figure of the traces, which trainers compute
/// from log-probabilities in 32 bits.
const CLOSE: f64 = 1e-5;

/// Show a training step by step, and hold its log against the traces of its rollouts: ratio, clip
/// shares, KL and loss are computed from the log-probabilities that the traces hold. With --step,
/// the episodes of that step: what each was paid by which reward term, its advantage in its group,
/// and its share of the weight in the gradient.
///
/// Examples:
///   reel train log loop-data/gspo
///   reel train log loop-data/gspo --step 41
///   reel train log loop-data/gspo --json | jq '.steps[] | {step, apart}'
///
/// Exit code 0: every figure is that of the traces within 0.00001; 1: one is not; 2: the log, or a
/// store that it names, cannot be read.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder with training.json and steps.jsonl
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Show the episodes of this step
    #[arg(long, value_name = "N")]
    step: Option<u32>,
    /// Print the steps and their episodes as one JSON object
    #[arg(long)]
    json: bool,
}

/// A step, as logged and from its traces.
#[derive(Serialize)]
struct Checked<'l> {
    #[serde(flatten)]
    logged: &'l LoggedStep,
    figures: Figures,
    from_traces: Figures,
    apart: f64,
    episodes: Vec<Episode>,
}

/// An episode of a step.
#[derive(Serialize)]
struct Episode {
    #[serde(flatten)]
    sequence: Sequence,
    #[serde(flatten)]
    row: EpisodeRow,
    /// Its part of the sum of `|ratio * advantage|` over the episodes that are not clipped.
    share: f64,
    /// Sums of the reward terms, by component.
    terms: BTreeMap<String, f64>,
}

#[derive(Clone, Serialize, Deserialize)]
struct EpisodeRow {
    #[serde(skip_serializing)]
    episode_id: String,
    task_id: String,
    success: Option<bool>,
    length: u32,
    trace: String,
}

#[derive(Deserialize)]
struct TermRow {
    episode_id: String,
    component: String,
    value: f64,
}

/// Prints the steps of a training, or the episodes of one step.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let log = TrainingLog::open(&arguments.run)?;
    let preset = log.objective.preset.as_deref();
    let preset = preset.map(PresetSource::find).transpose()?;
    let preset = preset.map(|named| named.preset);
    let steps: Vec<&LoggedStep> = match arguments.step {
        None => log.steps.iter().collect(),
        Some(number) => {
            let found = log.steps.iter().find(|one| one.step == number);
            let numbers =
                [log.steps.first(), log.steps.last()].map(|one| one.map_or(0, |one| one.step));
            let [first, last] = numbers;
            vec![found.with_context(|| {
                format!(
                    "{} has no step {number}; it has {first} to {last}",
                    arguments.run.display()
                )
            })?]
        }
    };
    if steps.is_empty() {
        bail!("{} has no step yet", arguments.run.display());
    }
    let checked = steps
        .into_iter()
        .map(|step| check(&log, step, preset.as_ref()))
        .collect::<anyhow::Result<Vec<_>>>()?;
    if let Some(preset) = &preset
        && arguments.step.is_some()
        && checked[0].episodes.iter().all(|one| one.terms.is_empty())
    {
        bail!(
            "the store has no rewards under {preset}; add them with `reel store reward --store {store} --preset {preset}`",
            preset = preset.name(),
            store = arguments.run.join(&checked[0].logged.store).display()
        );
    }
    if arguments.json {
        println!(
            "{}",
            json!({ "objective": log.objective, "steps": checked })
        );
    } else if arguments.step.is_some() {
        print!("{}", episodes(&checked[0]));
    } else {
        print!("{}", overview(&checked));
    }
    Ok(if checked.iter().all(|step| step.apart <= CLOSE) {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn check<'l>(
    log: &TrainingLog,
    step: &'l LoggedStep,
    preset: Option<&Preset>,
) -> anyhow::Result<Checked<'l>> {
    let report = log
        .from_traces(step, preset.cloned())
        .with_context(|| format!("step {}", step.step))?;
    let session = QuerySession::new(log.store(step)?)?;
    let rows: Vec<EpisodeRow> = ask(
        &session,
        "SELECT episode_id, task_id, success, length, trace FROM episodes",
    )?;
    let rows: BTreeMap<String, EpisodeRow> = rows
        .into_iter()
        .map(|row| (row.episode_id.clone(), row))
        .collect();
    let mut terms: BTreeMap<String, BTreeMap<String, f64>> = BTreeMap::new();
    // As recorded; under a preset of its own a training is paid by what `reel store reward` adds.
    let version = match preset {
        None => "version IS NULL".to_owned(),
        Some(preset) => format!("version = '{}'", preset.version()),
    };
    let sums: Vec<TermRow> = ask(
        &session,
        &format!(
            "SELECT episode_id, component, sum(value) AS value FROM rewards WHERE {version} GROUP BY episode_id, component"
        ),
    )?;
    for TermRow {
        episode_id,
        component,
        value,
    } in sums
    {
        terms
            .entry(episode_id)
            .or_default()
            .insert(component, value);
    }
    let weight = |one: &Sequence| {
        if one.clipped.is_some() {
            0.0
        } else {
            (one.ratio * one.advantage).abs()
        }
    };
    let all: f64 = report.sequences.iter().map(weight).sum();
    let figures = step.figures();
    let from_traces = Figures::of(&report);
    let mut episodes = Vec::new();
    for sequence in report.sequences {
        let id = &sequence.episode_id;
        let row = rows
            .get(id)
            .with_context(|| format!("episode {id} is not in the store"))?
            .clone();
        episodes.push(Episode {
            share: if all > 0.0 {
                weight(&sequence) / all
            } else {
                0.0
            },
            terms: terms.remove(id).unwrap_or_default(),
            sequence,
            row,
        });
    }
    episodes.sort_by(|a, b| b.share.total_cmp(&a.share));
    Ok(Checked {
        logged: step,
        figures,
        from_traces,
        apart: figures.apart(from_traces),
        episodes,
    })
}

fn overview(steps: &[Checked<'_>]) -> String {
    let mut text = format!(
        "{:>5} {:>8} {:>8} {:>9} {:>10} {:>9} {:>6} {:>6} {:>9}  {}\n",
        "step", "episodes", "success", "return", "loss", "ratio", "low", "high", "KL", "traces"
    );
    for step in steps {
        let count = step.episodes.len() as f64;
        let wins = step
            .episodes
            .iter()
            .filter(|one| one.row.success == Some(true))
            .count() as f64;
        let paid: f64 = step
            .episodes
            .iter()
            .map(|one| one.sequence.episode_return)
            .sum();
        let of = step.figures;
        text += &format!(
            "{:5} {:8} {:7.1}% {:9.3} {:+10.6} {:9.6} {:6.3} {:6.3} {:9.6}  {}\n",
            step.logged.step,
            step.episodes.len(),
            100.0 * wins / count,
            paid / count,
            of.loss,
            of.ratio,
            of.low,
            of.high,
            of.kl,
            agreement(step)
        );
    }
    text
}

fn agreement(step: &Checked<'_>) -> String {
    if step.apart <= CLOSE {
        "equal".to_owned()
    } else {
        format!("off by {:.2e}", step.apart)
    }
}

fn episodes(step: &Checked<'_>) -> String {
    let mut text = format!(
        "step {}: weights {} -> {}\n",
        step.logged.step,
        step.logged.weights_before.as_deref().unwrap_or("?"),
        step.logged.weights.as_deref().unwrap_or("?")
    );
    let (logged, traced) = (step.figures, step.from_traces);
    text += &format!(
        "loss {:+.6}, ratio {:.6}, clipped low {:.3} and high {:.3}, KL {:.6}; from the traces: {}\n",
        logged.loss,
        logged.ratio,
        logged.low,
        logged.high,
        logged.kl,
        agreement(step)
    );
    if step.apart > CLOSE {
        text += &format!(
            "the traces give loss {:+.6}, ratio {:.6}, clipped low {:.3} and high {:.3}, KL {:.6}\n",
            traced.loss, traced.ratio, traced.low, traced.high, traced.kl
        );
    }
    for (number, update) in step.logged.updates.iter().enumerate() {
        let norm = update.gradient_norm.map_or_else(String::new, |norm| {
            format!(", norm of the gradient {norm:.3}")
        });
        text += &format!(
            "  update {}: {} episodes, loss {:+.6}{norm}\n",
            number + 1,
            update.episodes,
            update.figures.loss
        );
    }
    text += &format!(
        "{:>7} {:>9} {:>8} {:>9} {:>7} {:>6}  {:32} {}\n",
        "share", "advantage", "return", "ratio", "clipped", "calls", "task", "reward terms"
    );
    for one in &step.episodes {
        let terms: Vec<String> = one
            .terms
            .iter()
            .map(|(name, value)| format!("{name} {value:+.2}"))
            .collect();
        let clipped = match one.sequence.clipped {
            None => "",
            Some(reel_reward::gspo::ClipSide::Low) => "low",
            Some(reel_reward::gspo::ClipSide::High) => "high",
        };
        let outcome = if one.row.success == Some(true) {
            "succeeded"
        } else {
            "failed"
        };
        text += &format!(
            "{:6.1}% {:+9.3} {:8.3} {:9.6} {:>7} {:6}  {:32} {outcome}: {}\n",
            100.0 * one.share,
            one.sequence.advantage,
            one.sequence.episode_return,
            one.sequence.ratio,
            clipped,
            one.row.length,
            one.row.task_id,
            terms.join(", ")
        );
    }
    text
}
