//! `reel attribute`: what each capability of an agent cost, as success rates with intervals.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, bail};
use clap::ValueEnum;
use rand_chacha::{
    ChaCha8Rng,
    rand_core::{Rng as _, SeedableRng as _},
};
use reel_agents::Label;
use reel_counterfactual::attribution::{
    Attributed, AttributionOptions, Capability, Estimate, attribute_all, estimates, known_success,
};
#[cfg(feature = "analytics")]
use reel_tables::AttributionRow;
use reel_trace::TraceFiles;
use serde_json::json;

use crate::{ExitStatus, inputs, progress};

/// Measure what each capability cost: the success rate that the agent would have with perfect
/// perception, communication, memory or primitives (robot skills), everything else as recorded. For
/// every failed episode and capability reel plays a branch in which a competent agent decides the
/// calls that failed by that capability, and the recorded calls follow. An episode counts as rescued
/// only if its branch succeeded in the simulator.
///
/// Examples:
///   reel attribute traces-out                      # "with perfect perception 41.0% -> 63.0% [55.0, 70.4]"
///   reel attribute --store store --by policy       # the same by policy; rows go into table `attribution`
///   reel attribute traces-out --branches rescued   # keeps each successful branch, and replays it
///   reel attribute traces-out --json | jq '.estimates[] | {capability, difference}'
///   reel query --store store "SELECT capability, count(*) FROM attribution WHERE success GROUP BY capability"
///   reel attribute faulty --labels                 # how often it is right, on what `reel agent faults run` wrote
///
/// Intervals are at 95 %, exact, with tasks as clusters (docs/attribution.md). Exit code 0: every trace
/// was read; 1: some were not (3 with --store); 2: wrong usage.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace files, or folders of them
    #[arg(value_name = "PATH", required_unless_present_any = inputs::INSTEAD_OF_PATHS)]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Attribute every episode of this store, and keep the results in its table `attribution`
    #[cfg(feature = "analytics")]
    #[arg(long, value_name = "STORE", conflicts_with_all = ["paths", "labels"])]
    store: Option<String>,
    /// One estimate for each of these
    #[arg(long, value_enum, default_value_t = By::All)]
    by: By,
    /// Keep the branches that succeed in this folder, and replay them
    #[arg(long, value_name = "DIR")]
    branches: Option<PathBuf>,
    /// Compare with what injected agents do without the faults of each capability; the labels lie
    /// beside the traces
    #[arg(long)]
    labels: bool,
    /// With --labels: draw so many runs from the episodes, and count the intervals that hold the
    /// true difference
    #[arg(long, value_name = "N", requires = "labels", default_value_t = 100)]
    runs: usize,
    /// With --labels: tasks of each drawn run
    #[arg(long, value_name = "N", requires = "labels", default_value_t = 60)]
    run_tasks: usize,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print the estimates and the episodes as one JSON object
    #[arg(long)]
    json: bool,
}

/// By what episodes are grouped.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum By {
    /// One group of all episodes
    All,
    /// The command that recorded them
    Run,
    /// The policy that decided
    Policy,
    /// The family of the task
    Family,
}

impl By {
    fn group(self, episode: &Attributed) -> String {
        match self {
            By::All => "all episodes".to_owned(),
            By::Run => episode.run_id.clone(),
            By::Policy => episode.policy.clone(),
            By::Family => episode.family.to_string(),
        }
    }
}

/// Attributes the episodes, then prints their estimates and stores them.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = arguments.assets.trace_files()?;
    #[cfg(feature = "analytics")]
    let mut store = arguments
        .store
        .as_ref()
        .map(|store| arguments.assets.store(store, None))
        .transpose()?;
    #[cfg(feature = "analytics")]
    let paths = match &store {
        Some(store) => store
            .ended_traces()?
            .into_iter()
            .map(PathBuf::from)
            .collect(),
        None => inputs::traces(&files, &arguments.paths)?,
    };
    #[cfg(not(feature = "analytics"))]
    let paths = inputs::traces(&files, &arguments.paths)?;
    if let Some(folder) = &arguments.branches {
        fs::create_dir_all(folder)?;
    }
    let options = AttributionOptions {
        branches: arguments.branches.clone(),
    };
    let bar = progress::bar(paths.len(), "attribute");
    let found = attribute_all(
        &files,
        &paths,
        inputs::workers(arguments.jobs),
        &options,
        || bar.inc(1),
    );
    bar.finish_and_clear();
    let mut episodes = Vec::new();
    let mut unreadable = false;
    for one in found {
        match one {
            Ok(one) => episodes.push(one),
            Err(reason) => {
                eprintln!("reel: {reason}");
                unreadable = true;
            }
        }
    }
    if arguments.labels {
        return compare(&files, &episodes, arguments);
    }
    let estimates = estimates(&episodes, |one| arguments.by.group(one));
    #[cfg(feature = "analytics")]
    if let Some(store) = &mut store {
        let rows: Vec<AttributionRow> = episodes.iter().flat_map(rows).collect();
        store.replace_attribution(&rows)?;
    }
    if arguments.json {
        println!(
            "{}",
            json!({ "estimates": estimates, "episodes": episodes })
        );
    } else {
        print(&estimates);
        #[cfg(feature = "analytics")]
        if let Some(store) = &store {
            println!("kept in table `attribution` of {}", store.location());
        }
    }
    #[cfg(feature = "analytics")]
    if unreadable && store.is_some() {
        return Ok(ExitStatus::Partial);
    }
    Ok(if unreadable {
        ExitStatus::CheckFailed
    } else {
        ExitStatus::Success
    })
}

fn print(estimates: &[Estimate]) {
    let mut group = None;
    for one in estimates {
        if group != Some(&one.group) {
            println!(
                "{}: {} episodes of {} tasks, success {:.1}%",
                one.group,
                one.episodes,
                one.tasks,
                100.0 * one.observed
            );
            group = Some(&one.group);
        }
        let percent = |share: f64| 100.0 * share;
        let (perfect, more) = (one.perfect, one.difference);
        println!(
            "  with perfect {:<14} {:>5.1}% -> {:>5.1}% [{:.1}, {:.1}]   +{:.1} points [{:.1}, {:.1}]   {} branches{}",
            one.capability.name(),
            percent(one.observed),
            percent(perfect.value),
            percent(perfect.low),
            percent(perfect.high),
            percent(more.value),
            percent(more.low),
            percent(more.high),
            one.branches,
            match one.no_future {
                0 => String::new(),
                count => format!(", {count} episodes without a playable future"),
            }
        );
    }
    if estimates.is_empty() {
        println!("no episode whose task has a goal was played to an end");
    }
}

/// Rows of table `attribution`.
#[cfg(feature = "analytics")]
fn rows(episode: &Attributed) -> Vec<AttributionRow> {
    let small = |number: u32| i32::try_from(number).unwrap_or(i32::MAX);
    let row = |one: &reel_counterfactual::attribution::CapabilityBranch| AttributionRow {
        episode_id: episode.episode_id.clone(),
        trace_digest: episode.trace_digest.to_string(),
        capability: one.capability.name().to_owned(),
        failures: small(one.failures),
        first_step: one.first_step.map(small),
        played: one.played,
        success: one.success,
        replaced: small(one.replaced),
        skipped: small(one.skipped),
        length: one.length.map(small),
        branch: one.branch.as_ref().map(|path| path.display().to_string()),
        verified: one.verified,
        reason: one.reason.clone(),
    };
    episode.capabilities.iter().map(row).collect()
}

/// Compares with the agents that have the same faults but those of one capability, and draws runs.
fn compare(
    files: &TraceFiles,
    episodes: &[Attributed],
    arguments: &Arguments,
) -> anyhow::Result<ExitStatus> {
    let mut known: BTreeMap<Capability, Vec<bool>> = BTreeMap::new();
    let bar = progress::bar(episodes.len(), "injected agents");
    for episode in episodes {
        let (trace, label) = (files.read(&episode.trace)?, label(&episode.trace)?);
        for capability in Capability::ALL {
            // What succeeds as it is stays so: only failures are repaired.
            let succeeds =
                episode.success == Some(true) || known_success(&trace, &label, capability)?;
            known.entry(capability).or_default().push(succeeds);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    let mut tasks: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (index, episode) in episodes.iter().enumerate() {
        tasks.entry(&episode.task_id).or_default().push(index);
    }
    let tasks: Vec<Vec<usize>> = tasks.into_values().collect();
    if tasks.is_empty() {
        bail!("no episode with a label");
    }
    println!(
        "{} episodes of {} tasks; {} drawn runs of {} tasks",
        episodes.len(),
        tasks.len(),
        arguments.runs,
        arguments.run_tasks
    );
    println!(
        "capability       true    found   rescued: both  only true  only found   intervals that hold the true difference"
    );
    let mut enough = true;
    for capability in Capability::ALL {
        let failed = |index: &usize| episodes[*index].success == Some(false);
        let truly = |index: &usize| failed(index) && known[&capability][*index];
        let found = |index: &usize| {
            failed(index) && episodes[*index].success_with(capability) == Some(true)
        };
        let all: Vec<usize> = (0..episodes.len()).collect();
        let count = |which: &dyn Fn(&usize) -> bool| all.iter().filter(|one| which(one)).count();
        let share = |hits: usize| 100.0 * hits as f64 / all.len() as f64;
        let truth = count(&truly) as f64 / all.len() as f64;
        let mut random = ChaCha8Rng::seed_from_u64(17);
        let mut held = 0;
        for _ in 0..arguments.runs {
            let mut sample = Vec::new();
            for draw in 0..arguments.run_tasks {
                let pick = (u128::from(random.next_u64()) * tasks.len() as u128) >> 64;
                for index in &tasks[pick as usize] {
                    // A task drawn twice is two tasks.
                    sample.push(Attributed {
                        task_id: format!("{draw}"),
                        ..episodes[*index].clone()
                    });
                }
            }
            let estimates = estimates(&sample, |_| String::new());
            held += estimates
                .iter()
                .filter(|one| one.capability == capability)
                .filter(|one| one.difference.low <= truth && truth <= one.difference.high)
                .count();
        }
        enough &= held * 100 >= arguments.runs * 95;
        println!(
            "{:<14} {:>5.1}%  {:>5.1}%   {:>13}  {:>9}  {:>10}   {held} of {}",
            capability.name(),
            share(count(&truly)),
            share(count(&found)),
            count(&|index| truly(index) && found(index)),
            count(&|index| truly(index) && !found(index)),
            count(&|index| !truly(index) && found(index)),
            arguments.runs
        );
    }
    Ok(if enough {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

fn label(trace: &Path) -> anyhow::Result<Label> {
    let mut path = trace.to_owned().into_os_string();
    path.push(".label.json");
    let text = fs::read_to_string(&path).with_context(|| {
        format!(
            "no label beside {}; `reel agent faults run` writes them",
            trace.display()
        )
    })?;
    serde_json::from_str(&text).with_context(|| format!("{} has no valid label", trace.display()))
}
