//! `reel dev gate`: replays a corpus with this build and another, and says which
//! episodes and outcomes change.

use std::{
    collections::BTreeMap,
    io::ErrorKind,
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, bail};
use reel_replay::{ChangedOutcome, Changes, EndSummary, corpus, replay_outcomes_all};
use reel_world::Outcome;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{ExitStatus, inputs, progress};

/// Traces that the other build is asked for at a time: a command line has its limits.
const TRACES_PER_CALL: usize = 500;

/// Replay a corpus of traces and list which episodes are not exact, and which outcomes change:
/// what the policy was told, and how the episode ended. With --against the same for another
/// build of reel, side by side. Folders v1, v2, ... of the corpus hold traces of older
/// simulators and are left out.
///
/// Examples:
///   reel dev gate --corpus traces/golden
///   reel dev gate --corpus traces/golden --against ./reel-of-last-week
///
/// Exit code 0: every trace is exact, in both builds; 1: one is not.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Folder of the traces
    #[arg(long, value_name = "DIR")]
    corpus: PathBuf,
    /// Another build of reel
    #[arg(long, value_name = "BIN")]
    against: Option<PathBuf>,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Traces at a time; without it one for each core
    #[arg(long, value_name = "N")]
    jobs: Option<usize>,
    /// Print one JSON object per trace
    #[arg(long)]
    json: bool,
}

/// A line of `reel replay --outcomes --json`, of this build or another.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct OutcomeLine {
    trace: PathBuf,
    verdict: String,
    outcomes: Option<Changes>,
    /// What else the verdict says.
    #[serde(flatten)]
    more: BTreeMap<String, Value>,
}

/// A trace in both builds.
#[derive(Serialize)]
struct TraceComparison {
    trace: PathBuf,
    current: OutcomeLine,
    other: Option<OutcomeLine>,
}

/// Replays a corpus, also with another build if named, and lists what changed.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let folder = &arguments.corpus;
    let paths =
        corpus(folder).with_context(|| format!("cannot list the corpus {}", folder.display()))?;
    if paths.is_empty() {
        bail!(
            "no .mcap file in {}; `reel run` records some",
            folder.display()
        );
    }
    let workers = inputs::workers(arguments.jobs);
    let bar = progress::bar(paths.len(), "gate");
    let judgements = replay_outcomes_all(
        &reel_trace::TraceFiles::default(),
        &paths,
        &arguments.assets.open()?,
        workers,
        |_, _| bar.inc(1),
    );
    bar.finish_and_clear();
    let this = judgements
        .iter()
        .map(|judgement| Ok(serde_json::from_value(serde_json::to_value(judgement)?)?));
    let this: Vec<OutcomeLine> = this.collect::<anyhow::Result<_>>()?;
    let that = match &arguments.against {
        Some(binary) => ask(binary, &paths, arguments.assets.path(), workers)?
            .into_iter()
            .map(Some)
            .collect(),
        None => vec![None; paths.len()],
    };
    let rows: Vec<TraceComparison> = paths
        .into_iter()
        .zip(this)
        .zip(that)
        .map(|((trace, current), other)| TraceComparison {
            trace,
            current,
            other,
        })
        .collect();
    if arguments.json {
        for row in &rows {
            println!("{}", serde_json::to_string(row)?);
        }
    } else {
        print!("{}", table(folder, &rows, arguments.against.as_deref()));
    }
    let exact = rows
        .iter()
        .all(|row| row.current.is_exact() && row.other.as_ref().is_none_or(OutcomeLine::is_exact));
    Ok(if exact {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

/// Has another build replay the traces; its lines in the order of the paths.
fn ask(
    binary: &Path,
    paths: &[PathBuf],
    assets: Option<&Path>,
    workers: usize,
) -> anyhow::Result<Vec<OutcomeLine>> {
    let name = binary.display();
    let mut lines = BTreeMap::new();
    for group in paths.chunks(TRACES_PER_CALL) {
        let output = Command::new(binary)
            .args([
                "replay",
                "--outcomes",
                "--json",
                "--jobs",
                &workers.to_string(),
                "--",
            ])
            .args(group)
            // Not as an argument, which builds without meshes do not know.
            .envs(assets.map(|assets| ("REEL_ASSETS", assets)))
            .output()
            .map_err(|error| match error.kind() {
                ErrorKind::NotFound => anyhow::anyhow!(
                    "there is no program {name}; a path with a folder is needed, e.g. ./reel"
                ),
                _ => anyhow::anyhow!("cannot start {name}: {error}"),
            })?;
        let complaint = String::from_utf8_lossy(&output.stderr);
        let complaint = complaint
            .lines()
            .find(|line| !line.trim().is_empty())
            .unwrap_or("it says nothing");
        if !matches!(output.status.code(), Some(0 | 1)) {
            bail!(
                "{name} is no reel that knows `replay --outcomes` ({}): {complaint}",
                output.status
            );
        }
        for text in String::from_utf8_lossy(&output.stdout).lines() {
            let line: OutcomeLine = serde_json::from_str(text).with_context(|| {
                format!(
                    "{name} is no reel that knows `replay --outcomes`: it printed '{}'",
                    shorten(text)
                )
            })?;
            lines.insert(line.trace.clone(), line);
        }
        if let Some(path) = group.iter().find(|path| !lines.contains_key(*path)) {
            bail!(
                "{name} is no reel that knows `replay --outcomes`: it says nothing of {}: {complaint}",
                path.display()
            );
        }
    }
    Ok(paths.iter().filter_map(|path| lines.remove(path)).collect())
}

impl OutcomeLine {
    fn is_exact(&self) -> bool {
        self.verdict == "exact"
    }

    fn changed(&self, call: u32) -> Option<&ChangedOutcome> {
        self.outcomes
            .iter()
            .flat_map(|changes| &changes.outcomes)
            .find(|changed| changed.call == call)
    }
}

impl TraceComparison {
    fn lines(&self) -> impl Iterator<Item = (&'static str, &OutcomeLine)> {
        [("this", Some(&self.current)), ("that", self.other.as_ref())]
            .into_iter()
            .filter_map(|(name, line)| Some((name, line?)))
    }

    /// Every outcome that changes in either build, and the end, as text; and how many.
    fn changes(&self, name: &str) -> (usize, String) {
        let all = || self.lines().filter_map(|(_, line)| line.outcomes.as_ref());
        let calls: BTreeMap<u32, &ChangedOutcome> = all()
            .flat_map(|changes| &changes.outcomes)
            .map(|changed| (changed.call, changed))
            .collect();
        let mut text = String::new();
        for (call, known) in &calls {
            text.push_str(&format!(
                "{name}: call {call} {}\n  recorded  {}\n",
                known.call_text,
                outcome_line(&known.recorded)
            ));
            for (build, line) in self.lines() {
                let now = match (line.changed(*call), &line.outcomes) {
                    (Some(changed), _) => outcome_line(&changed.replayed),
                    (None, Some(_)) => "as recorded".to_owned(),
                    (None, None) => format!("({})", line.verdict),
                };
                text.push_str(&format!("  {build}      {now}\n"));
            }
        }
        let end = all().find_map(|changes| changes.end);
        if let Some(end) = end {
            text.push_str(&format!("{name}: end\n  recorded  {}\n", end.recorded));
            for (build, line) in self.lines() {
                let now = line
                    .outcomes
                    .as_ref()
                    .map(|changes| changes.end.map(|end| end.replayed));
                let now = now.map_or_else(
                    || format!("({})", line.verdict),
                    |now: Option<EndSummary>| {
                        now.map_or_else(|| "as recorded".to_owned(), |end| end.to_string())
                    },
                );
                text.push_str(&format!("  {build}      {now}\n"));
            }
        }
        (calls.len() + usize::from(end.is_some()), text)
    }
}

fn table(folder: &Path, rows: &[TraceComparison], against: Option<&Path>) -> String {
    let name = |row: &TraceComparison| {
        row.trace
            .strip_prefix(folder)
            .unwrap_or(&row.trace)
            .with_extension("")
            .display()
            .to_string()
    };
    let width = rows
        .iter()
        .map(|row| name(row).len())
        .max()
        .unwrap_or(0)
        .max("episode".len());
    let that = if against.is_some() { "that" } else { "" };
    let mut text = format!("{:width$}  {:16}  {that}\n", "episode", "this").replace(" \n", "\n");
    let (mut changes, mut count) = (String::new(), 0);
    for row in rows {
        let verdicts: Vec<String> = row
            .lines()
            .map(|(_, line)| format!("{:16}", line.verdict))
            .collect();
        text.push_str(&format!(
            "{:width$}  {}\n",
            name(row),
            verdicts.join("  ").trim_end()
        ));
        let (number, lines) = row.changes(&name(row));
        count += number;
        changes.push_str(&lines);
    }
    if count > 0 {
        text.push_str(&format!("\noutcomes that change: {count}\n{changes}"));
    }
    let exact = |line: fn(&TraceComparison) -> Option<&OutcomeLine>| {
        rows.iter()
            .filter_map(line)
            .filter(|line| line.is_exact())
            .count()
    };
    text.push_str(&format!(
        "\n{} of {} traces are exact in this build",
        exact(|row| Some(&row.current)),
        rows.len()
    ));
    if let Some(binary) = against {
        text.push_str(&format!(
            ", {} in {}",
            exact(|row| row.other.as_ref()),
            binary.display()
        ));
    }
    text.push_str(&format!("; {count} outcomes change\n"));
    text
}

/// An outcome in a line.
pub fn outcome_line(outcome: &Outcome) -> String {
    let code = outcome.error.map_or("ok", |code| code.as_str());
    format!(
        "{code}: {}",
        shorten(
            &outcome
                .text
                .split_whitespace()
                .collect::<Vec<_>>()
                .join(" ")
        )
    )
}

fn shorten(text: &str) -> String {
    match text.char_indices().nth(100) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}
