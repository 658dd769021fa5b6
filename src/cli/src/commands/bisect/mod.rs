//! `reel bisect`: the first of many builds, presets, prompts or checkpoints that changes an episode.

mod candidates;
mod measure;

use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

use anyhow::bail;
use reel_counterfactual::bisect::{Bisection, Change};
use serde_json::json;

use crate::{ExitStatus, inputs};
use candidates::Candidate;
use measure::Measurement;

/// Episodes that are listed of a candidate.
const SHOWN: usize = 10;

/// Find the first of an ordered row of candidates that flips an episode or a metric, by halving the
/// row: builds of the simulator, reward presets, prompts, checkpoints, commits. Every episode that
/// differs between the good and the bad end is searched at once, and so is the mean over all.
///
/// A candidate is measured by one of
///   --run COMMAND     a shell command, which finds the candidate in $CANDIDATE and leaves traces in
///                     $OUT, or lines like {"episode": "t1", "success": true} in $OUT/episodes.jsonl
///   --builds TRACES   the candidate is a `reel` program, which executes the traces again
///   --presets TRACES  the candidate is a reward preset, under which the traces are scored again
///
/// Examples:
///   reel bisect --good step-100 --bad step-900 --candidates step-* --run 'bash bench.sh "$CANDIDATE" "$OUT"'
///   reel bisect --good v1.txt --bad v4.txt --candidates v2.txt v3.txt --run 'reel bench --tasks tasks
///     --agent real-agent --endpoint http://localhost:8000/v1 --model m --prompt "$CANDIDATE" --out "$OUT"'
///   reel bisect --good paper --bad mine-4.toml --candidates mine-*.toml --presets traces
///   reel bisect --good old/reel --bad new/reel --candidates builds/*/reel --builds traces
///   reel bisect --git . --good v0.1 --bad main --run 'cargo build --release && target/release/reel
///     replay /data/traces --outcomes --json > "$OUT/episodes.jsonl"'
///
/// A command that exits with anything but 0 or 1 has not measured: its candidate is passed over. As
/// with `git bisect`, where a value changes back and forth two neighbours are named that differ, and
/// there may be others. What --run and --builds measured is kept in the folder OUT: the same
/// command goes on there after an interruption.
///
/// Exit code 0: something flips, and the first candidate is known; 1: nothing differs between the
/// ends, or candidates that could not be measured hide the first.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The good end: a candidate's name or file; a revision with --git
    #[arg(long, value_name = "A")]
    good: String,
    /// The bad end, named as the good one
    #[arg(long, value_name = "B")]
    bad: String,
    /// The candidates between the ends, in their order; names that differ in one number only are ordered by it
    #[arg(long, value_name = "C", num_args = 1.., conflicts_with = "git", required_unless_present = "git")]
    candidates: Vec<String>,
    /// The candidates are the commits from A to B of this repository (first parents); --run works in a checkout of each
    #[arg(long, value_name = "REPOSITORY", requires = "command")]
    git: Option<PathBuf>,
    #[command(flatten)]
    by: Way,
    /// What is compared: success, completion, reward, spl, steps or asks of the episodes, or a field of the lines in
    /// episodes.jsonl. Without it success, and reward with --presets
    #[arg(long, value_name = "METRIC")]
    metric: Option<String>,
    /// Only these episodes: ids of tasks, or as they are printed
    #[arg(long, value_name = "EPISODE", num_args = 1..)]
    episodes: Vec<String>,
    /// Folder for what the candidates leave
    #[arg(long, value_name = "DIR", default_value = "bisect-out")]
    out: PathBuf,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Print the result as one JSON object
    #[arg(long)]
    json: bool,
}

/// How candidates are measured.
#[derive(clap::Args)]
#[group(required = true, multiple = false)]
struct Way {
    /// Measure a candidate by this shell command
    #[arg(id = "command", long = "run", value_name = "COMMAND")]
    run: Option<String>,
    /// The candidates are `reel` programs, which execute these traces again
    #[arg(long, value_name = "TRACES")]
    builds: Option<PathBuf>,
    /// The candidates are reward presets (names or TOML files), under which these traces are scored
    #[arg(long, value_name = "TRACES")]
    presets: Option<PathBuf>,
}

/// Searches and prints what was found.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let candidates = candidates::row(arguments)?;
    let mut measurement = Measurement::new(arguments, &candidates)?;
    let mut bisection = Bisection::new(candidates.len());
    while let Some(number) = bisection.next_candidate() {
        let candidate = &candidates[number];
        match measurement.values(number, candidate) {
            Ok(values) => {
                bisection.record(number, Some(values));
                let mean = bisection
                    .mean(number)
                    .map(|mean| format!(", mean {mean:.3}"));
                eprintln!("reel: measured {candidate}{}", mean.unwrap_or_default());
                if number + 1 == candidates.len() {
                    every_named_episode(&arguments.episodes, &bisection, number)?;
                }
            }
            Err(reason) if number == 0 || number + 1 == candidates.len() => {
                return Err(reason.context(format!("the end {candidate} cannot be measured")));
            }
            Err(reason) => {
                eprintln!("reel: {candidate} is passed over: {reason:#}");
                bisection.record(number, None);
            }
        }
    }
    if bisection.paired() == 0 {
        bail!(
            "no episode was measured at both ends; their episodes have to be of the same tasks and seeds"
        );
    }
    let found = Found {
        changes: bisection.changes(),
        mean: bisection.mean_change(),
        metric: measurement.metric(),
        candidates: &candidates,
        bisection: &bisection,
    };
    if arguments.json {
        println!("{}", found.json());
    } else {
        found.print(&measurement);
    }
    let mut changes = found.changes.values().chain(&found.mean);
    let settled = found.mean.is_some() || !found.changes.is_empty();
    Ok(match settled && changes.all(Change::is_settled) {
        true => ExitStatus::Success,
        false => ExitStatus::CheckFailed,
    })
}

/// Fails where an episode that was asked for is at neither end.
fn every_named_episode(named: &[String], bisection: &Bisection, last: usize) -> anyhow::Result<()> {
    let ends = [0, last].into_iter();
    let there = ends.filter_map(|end| bisection.values(end));
    let there: BTreeSet<&String> = there.flat_map(|values| values.keys()).collect();
    for id in named {
        if !there.iter().any(|key| measure::is_of(key, id)) {
            bail!("neither end has an episode of {id}");
        }
    }
    Ok(())
}

struct Found<'a> {
    changes: BTreeMap<String, Change>,
    mean: Option<Change>,
    metric: &'a str,
    candidates: &'a [Candidate],
    bisection: &'a Bisection,
}

impl Found<'_> {
    fn json(&self) -> serde_json::Value {
        let change = |change: &Change| {
            json!({
                "good": change.good, "bad": change.bad, "settled": change.is_settled(),
                "last_good": self.candidates[change.last_good].name, "first_bad": self.candidates[change.first_bad].name,
            })
        };
        let candidates = self
            .candidates
            .iter()
            .enumerate()
            .map(|(number, candidate)| {
                json!({
                    "name": candidate.name, "about": candidate.about,
                    "mean": self.bisection.mean(number), "episodes": self.bisection.values(number),
                })
            });
        let episodes = self
            .changes
            .iter()
            .map(|(episode, one)| (episode.clone(), change(one)));
        json!({
            "metric": self.metric, "paired_episodes": self.bisection.paired(), "mean": self.mean.as_ref().map(change),
            "episodes": episodes.collect::<serde_json::Map<_, _>>(), "candidates": candidates.collect::<Vec<_>>(),
        })
    }

    fn print(&self, measurement: &Measurement<'_>) {
        let [first, .., last] = self.candidates else {
            return;
        };
        let numbers = 0..self.candidates.len();
        let measured = numbers.filter(|number| self.bisection.values(*number).is_some());
        println!(
            "{} differs in {} of {} paired episodes between {first} and {last}; {} of {} candidates measured",
            self.metric,
            self.changes.len(),
            self.bisection.paired(),
            measured.count(),
            self.candidates.len()
        );
        match &self.mean {
            Some(change) => println!("  {}", self.line("mean", change)),
            None => println!("  the mean is the same at both ends"),
        }
        let mut firsts: BTreeMap<usize, Vec<(&String, &Change)>> = BTreeMap::new();
        for (episode, change) in &self.changes {
            firsts
                .entry(change.first_bad)
                .or_default()
                .push((episode, change));
        }
        for (first_bad, episodes) in &firsts {
            println!("{}: {}", self.candidates[*first_bad], flips(episodes.len()));
            for (episode, change) in episodes.iter().take(SHOWN) {
                println!("  {}", self.line(episode, change));
            }
            if episodes.len() > SHOWN {
                println!("  and {} more; --json lists all", episodes.len() - SHOWN);
            }
        }
        let Some(change) = self.mean.as_ref().or_else(|| self.changes.values().next()) else {
            println!("nothing differs: no episode flips between the ends");
            return;
        };
        let folders = [change.last_good, change.first_bad]
            .map(|number| measurement.traces_of(number, &self.candidates[number]));
        if let [Some(good), Some(bad)] = folders {
            println!(
                "where they come apart: reel diff {} {}",
                good.display(),
                bad.display()
            );
        }
    }

    fn line(&self, what: &str, change: &Change) -> String {
        let [last_good, first_bad] =
            [change.last_good, change.first_bad].map(|number| &self.candidates[number].name);
        let value = |candidate: usize| match what {
            "mean" => self.bisection.mean(candidate),
            episode => self
                .bisection
                .values(candidate)
                .and_then(|values| values.get(episode).copied()),
        };
        let value = |candidate| value(candidate).map_or_else(|| "-".to_owned(), number);
        let (good, bad) = (value(change.last_good), value(change.first_bad));
        let hidden = match change.first_bad - change.last_good - 1 {
            0 => String::new(),
            between => format!(
                "; the first is one of {} candidates, of which {between} could not be measured",
                between + 1
            ),
        };
        format!("{what}: {good} at {last_good}, {bad} at {first_bad}{hidden}")
    }
}

fn flips(episodes: usize) -> String {
    match episodes {
        1 => "1 episode flips".to_owned(),
        many => format!("{many} episodes flip"),
    }
}

/// A value with up to three digits behind the point.
fn number(value: f64) -> String {
    let text = format!("{value:.3}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}
