//! `reel train changes`: the same tasks played before and after a training.

use std::{collections::BTreeMap, path::PathBuf};

use anyhow::bail;
use reel_counterfactual::{
    attribution::{AttributionOptions, Estimate, attribute_all, estimates},
    regression::{Pairing, RunEpisode, pair},
};
use reel_query::QuerySession;
use reel_taxonomy::{RuleSet, classify};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::ask;
use crate::{ExitStatus, commands::diff::Summary, inputs, progress};

/// Show what a training changed in behaviour: two stores with the same tasks and seeds, played
/// before and after it. Success with the paired test, which tasks flip, and for both sides how
/// often each tool is called, what explains the failures, and what each capability costs (`reel
/// attribute`).
///
/// Examples:
///   reel train changes before.store after.store
///   reel diff before after                         # flip by flip: the first call that differs
///
/// Exit code 0: both were read; 2: a store or trace cannot be read, or no task and seed is in both.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Store of what was played before the training
    #[arg(value_name = "BEFORE")]
    before: String,
    /// Store of what was played after it
    #[arg(value_name = "AFTER")]
    after: String,
    /// Leave out what capabilities cost: it plays branches of every failure
    #[arg(long)]
    no_attribution: bool,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the comparison as one JSON object
    #[arg(long)]
    json: bool,
}

/// What the episodes of one store did, as counts and means.
#[derive(Serialize)]
struct Side {
    episodes: usize,
    success: f64,
    completion: f64,
    /// Mean number of decisions of an episode.
    length: f64,
    /// Calls an episode, by tool; answers that name no tool count as `(unreadable)`.
    calls: BTreeMap<String, f64>,
    /// Failed episodes by what explains them.
    failures: BTreeMap<String, usize>,
}

/// A task whose successes differ.
#[derive(Serialize)]
struct TaskFlip {
    task_id: String,
    episodes: usize,
    /// How many of the paired episodes succeeded before the training, and after it.
    successes: [usize; 2],
}

#[derive(Deserialize)]
struct EpisodeRow {
    episode_id: String,
    task_id: String,
    seed: u64,
    success: Option<bool>,
    completion: Option<f64>,
    length: Option<u32>,
    trace: PathBuf,
}

#[derive(Deserialize)]
struct CountRow {
    name: Option<String>,
    count: usize,
}

/// Pairs the episodes of the two stores and prints what differs.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut sides = Vec::new();
    let mut costs = Vec::new();
    let mut episodes = Vec::new();
    for location in [&arguments.before, &arguments.after] {
        let session = QuerySession::new(inputs::store(location, None)?)?;
        let rows: Vec<EpisodeRow> = ask(
            &session,
            "SELECT episode_id, task_id, seed, success, completion, length, trace FROM episodes ORDER BY episode_id",
        )?;
        sides.push(side(&session, &rows)?);
        if !arguments.no_attribution {
            costs.push(cost(location, &rows, arguments.jobs)?);
        }
        let of = |row: EpisodeRow| RunEpisode {
            trace: row.trace,
            episode_id: row.episode_id,
            task_id: row.task_id,
            seed: row.seed,
            success: row.success,
        };
        episodes.push(rows.into_iter().map(of).collect::<Vec<_>>());
    }
    let (after, before) = (
        episodes.pop().unwrap_or_default(),
        episodes.pop().unwrap_or_default(),
    );
    let pairing = pair(before, after);
    if pairing.pairs.is_empty() {
        bail!(
            "no task and seed is in both {} and {}: play the same tasks with the same --seed",
            arguments.before,
            arguments.after
        );
    }
    let tasks = flipped(&pairing);
    let summary = Summary::of(&pairing);
    if arguments.json {
        println!(
            "{}",
            json!({ "summary": summary, "sides": sides, "tasks": tasks, "attribution": costs })
        );
    } else {
        summary.print();
        print(&sides, &tasks, &costs);
    }
    Ok(ExitStatus::Success)
}

fn side(session: &QuerySession, rows: &[EpisodeRow]) -> anyhow::Result<Side> {
    let count = rows.len().max(1) as f64;
    let calls: Vec<CountRow> = ask(
        session,
        "SELECT tool AS name, count(*) AS count FROM steps GROUP BY tool ORDER BY tool",
    )?;
    let mut failures = BTreeMap::new();
    for class in classify(session, &RuleSet::built_in(), None)?.classes() {
        let name = format!("{} / {}", class.class, class.sub_class);
        *failures.entry(name).or_insert(0) += 1;
    }
    Ok(Side {
        episodes: rows.len(),
        success: rows.iter().filter(|row| row.success == Some(true)).count() as f64 / count,
        completion: rows.iter().filter_map(|row| row.completion).sum::<f64>() / count,
        length: rows
            .iter()
            .filter_map(|row| row.length)
            .map(f64::from)
            .sum::<f64>()
            / count,
        calls: calls
            .into_iter()
            .map(|row| {
                let named = row.name.filter(|name| !name.is_empty());
                let name = named.unwrap_or_else(|| "(unreadable)".to_owned());
                (name, row.count as f64 / count)
            })
            .collect(),
        failures,
    })
}

fn cost(location: &str, rows: &[EpisodeRow], jobs: Option<usize>) -> anyhow::Result<Vec<Estimate>> {
    let ended = rows.iter().filter(|row| row.success.is_some());
    let paths: Vec<PathBuf> = ended.map(|row| row.trace.clone()).collect();
    let bar = progress::bar(paths.len(), "attribute");
    let found = attribute_all(
        &inputs::trace_files(),
        &paths,
        inputs::workers(jobs),
        &AttributionOptions { branches: None },
        || bar.inc(1),
    );
    bar.finish_and_clear();
    let episodes = found
        .into_iter()
        .collect::<Result<Vec<_>, _>>()
        .map_err(|reason| anyhow::anyhow!("{location}: {reason}"))?;
    Ok(estimates(&episodes, |_| location.to_owned()))
}

/// The tasks whose successes differ, those that lost most first.
fn flipped(pairing: &Pairing) -> Vec<TaskFlip> {
    let mut by_task: BTreeMap<&str, TaskFlip> = BTreeMap::new();
    for [before, after] in &pairing.pairs {
        let task = by_task.entry(&before.task_id).or_insert_with(|| TaskFlip {
            task_id: before.task_id.clone(),
            episodes: 0,
            successes: [0, 0],
        });
        task.episodes += 1;
        for (sum, episode) in task.successes.iter_mut().zip([before, after]) {
            *sum += usize::from(episode.success == Some(true));
        }
    }
    let mut all: Vec<TaskFlip> = by_task
        .into_values()
        .filter(|task| task.successes[0] != task.successes[1])
        .collect();
    all.sort_by_key(|task| task.successes[1] as i64 - task.successes[0] as i64);
    all
}

fn print(sides: &[Side], tasks: &[TaskFlip], costs: &[Vec<Estimate>]) {
    let [before, after] = sides else { return };
    println!("\n{:40} {:>9} {:>9}", "an episode", "before", "after");
    let line = |name: &str, values: [f64; 2]| {
        println!("{name:40} {:9.3} {:9.3}", values[0], values[1]);
    };
    line("success", [before.success, after.success]);
    line("completion", [before.completion, after.completion]);
    line("decisions", [before.length, after.length]);
    let names = |of: fn(&Side) -> Vec<String>| {
        let mut all: Vec<String> = sides.iter().flat_map(of).collect();
        all.sort();
        all.dedup();
        all
    };
    for name in names(|side| side.calls.keys().cloned().collect()) {
        let calls = |side: &Side| side.calls.get(&name).copied().unwrap_or(0.0);
        line(&format!("calls of {name}"), [calls(before), calls(after)]);
    }
    println!(
        "\n{:40} {:>9} {:>9}",
        "failures by what explains them", "before", "after"
    );
    for name in names(|side| side.failures.keys().cloned().collect()) {
        let of = |side: &Side| side.failures.get(&name).copied().unwrap_or(0);
        println!("{name:40} {:9} {:9}", of(before), of(after));
    }
    if let [one, other] = costs {
        println!(
            "\n{:40} {:>24} {:>24}",
            "success with a capability perfect", "before", "after"
        );
        for (one, other) in one.iter().zip(other) {
            let told = |estimate: &Estimate| {
                let of = estimate.perfect;
                format!(
                    "{:.1}% [{:.1}, {:.1}]",
                    100.0 * of.value,
                    100.0 * of.low,
                    100.0 * of.high
                )
            };
            println!(
                "{:40} {:>24} {:>24}",
                one.capability.name(),
                told(one),
                told(other)
            );
        }
    }
    println!("\n{} tasks flip", tasks.len());
    for task in tasks {
        println!(
            "  {:40} {} of {} before, {} after",
            task.task_id, task.successes[0], task.episodes, task.successes[1]
        );
    }
}
