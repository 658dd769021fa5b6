//! What candidates give: the value of a metric for every episode.

use std::{
    collections::{BTreeMap, BTreeSet},
    env,
    fs::{self, File},
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::SystemTime,
};

use anyhow::{Context, bail};
use rayon::prelude::*;
use reel_agents::EpisodeReport;
use reel_counterfactual::bisect::Values;
use reel_reward::rewards;
use reel_trace::trace_stem;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    Arguments,
    candidates::{Candidate, git},
};
use crate::{commands::store::reward::PresetSource, inputs, recorded::recorded};

/// Lines of episodes, which a command may leave instead of traces.
const EPISODES: &str = "episodes.jsonl";
/// Where the output of a candidate's command is kept.
const LOG: &str = "command.log";
/// How a build says what becomes of recorded episodes.
const REPLAY: &str = r#""$CANDIDATE" replay --outcomes --json "$TRACES" > "$OUT/episodes.jsonl""#;
/// Metrics of a recorded episode.
const METRICS: [&str; 6] = ["success", "completion", "reward", "spl", "steps", "asks"];
/// Metrics in what a build says of an episode: their names here and there.
const REPLAYED: [(&str, &str); 4] = [
    ("success", "success"),
    ("completion", "completion"),
    ("reward", "total_reward"),
    ("steps", "steps"),
];
/// Lines of a command's output that are shown where it fails.
const SHOWN: usize = 5;

/// How candidates are measured, and what was measured before.
pub(super) struct Measurement<'a> {
    arguments: &'a Arguments,
    metric: &'a str,
    done: Done,
    /// Episodes that lines of `reel replay` speak of, by their files.
    traces: BTreeMap<PathBuf, EpisodeReport>,
}

/// What the folder of a search keeps: for which search it is, and which candidates are measured.
#[derive(Default, Serialize, Deserialize)]
struct Done {
    command: String,
    /// Files that the command names, with what tells that they were changed: scripts, or what it writes.
    named: Vec<String>,
    /// Names, and of files also when they were changed: a changed candidate was not measured.
    candidates: Vec<String>,
    measured: BTreeSet<usize>,
}

impl<'a> Measurement<'a> {
    pub(super) fn new(arguments: &'a Arguments, candidates: &[Candidate]) -> anyhow::Result<Self> {
        let by = &arguments.by;
        let default = if by.presets.is_some() {
            "reward"
        } else {
            "success"
        };
        let metric = arguments.metric.as_deref().unwrap_or(default);
        if by.presets.is_some() && metric != "reward" {
            bail!("a preset changes rewards only, not '{metric}'; leave --metric out");
        }
        if by.builds.is_some() && !REPLAYED.iter().any(|(name, _)| *name == metric) {
            let known = REPLAYED.map(|(name, _)| name).join(", ");
            bail!("builds of the simulator are compared by {known}, not by '{metric}'");
        }
        let mut done = Done::default();
        if let Some(command) = arguments.command() {
            done = Done::open(&arguments.out, command, candidates)?;
        }
        Ok(Self {
            arguments,
            metric,
            done,
            traces: BTreeMap::new(),
        })
    }

    pub(super) fn metric(&self) -> &'a str {
        self.metric
    }

    /// The folder with a candidate's traces; none where there are none.
    pub(super) fn traces_of(&self, number: usize, candidate: &Candidate) -> Option<PathBuf> {
        let folder = self.folder(number, candidate);
        let has_traces = self.arguments.by.run.is_some() && !folder.join(EPISODES).exists();
        has_traces.then_some(folder)
    }

    /// Measures a candidate, or reads what it left when it was measured before.
    pub(super) fn values(
        &mut self,
        number: usize,
        candidate: &Candidate,
    ) -> anyhow::Result<Values> {
        let mut values = match &self.arguments.by.presets {
            Some(traces) => scored(traces, &candidate.name)?,
            None => {
                let folder = self.folder(number, candidate);
                if !self.done.measured.contains(&number) {
                    self.execute(&folder, candidate)?;
                }
                let values = self.read(&folder)?;
                self.done.measured.insert(number);
                self.done.keep(&self.arguments.out)?;
                values
            }
        };
        if values.is_empty() {
            bail!("it has no episode with the metric '{}'", self.metric);
        }
        let only = &self.arguments.episodes;
        if !only.is_empty() {
            let there: Vec<String> = values.keys().take(SHOWN).cloned().collect();
            values.retain(|key, _| only.iter().any(|id| is_of(key, id)));
            if values.is_empty() {
                bail!(
                    "it has no episode of {}; it has {}",
                    only.join(", "),
                    there.join(", ")
                );
            }
        }
        Ok(values)
    }

    fn folder(&self, number: usize, candidate: &Candidate) -> PathBuf {
        let safe = |c: char| {
            if c.is_ascii_alphanumeric() || ".-_".contains(c) {
                c
            } else {
                '-'
            }
        };
        let name: Vec<char> = candidate.name.chars().map(safe).collect();
        let name: String = name[name.len().saturating_sub(40)..].iter().collect();
        self.arguments.out.join(format!("{number:02}-{name}"))
    }

    /// Runs a candidate's command.
    fn execute(&self, folder: &Path, candidate: &Candidate) -> anyhow::Result<()> {
        let Some(command) = self.arguments.command() else {
            return Ok(());
        };
        fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
        let folder = folder.canonicalize()?;
        let log = folder.join(LOG);
        let output =
            File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
        let mut shell = Command::new("sh");
        shell
            .args(["-c", command])
            .env("CANDIDATE", &candidate.name)
            .env("OUT", &folder);
        if let Some(traces) = &self.arguments.by.builds {
            shell.env("TRACES", traces);
        }
        if let Some(assets) = self.arguments.assets.path() {
            shell.env("REEL_ASSETS", assets);
        }
        if let Some(repository) = &self.arguments.git {
            shell.current_dir(checkout(repository, &self.checkout(), &candidate.name)?);
        }
        shell
            .stdin(Stdio::null())
            .stdout(output.try_clone()?)
            .stderr(output);
        let status = shell.status().context("cannot start sh")?;
        match status.code() {
            Some(0 | 1) => Ok(()),
            _ => bail!(
                "its command ended with {status}; {} {}",
                log.display(),
                ending(&log)
            ),
        }
    }

    fn checkout(&self) -> PathBuf {
        self.arguments.out.join("checkout")
    }

    /// Reads what a command left.
    fn read(&mut self, folder: &Path) -> anyhow::Result<Values> {
        let lines = folder.join(EPISODES);
        if lines.exists() {
            return self.lines(&lines);
        }
        if !METRICS.contains(&self.metric) {
            bail!(
                "traces are compared by {}, not by '{}'",
                METRICS.join(", "),
                self.metric
            );
        }
        let reports = recorded(folder).with_context(|| {
            format!(
                "the command left neither traces nor {EPISODES} in $OUT; {} says why",
                folder.join(LOG).display()
            )
        })?;
        let value = |report| Some((key(report), metric(report, self.metric)?));
        Ok(reports.iter().filter_map(value).collect())
    }

    fn lines(&mut self, path: &Path) -> anyhow::Result<Values> {
        let text =
            fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
        let mut values = Values::new();
        for (number, line) in text
            .lines()
            .enumerate()
            .filter(|(_, line)| !line.trim().is_empty())
        {
            let place = || format!("{} line {}", path.display(), number + 1);
            let line: Value = serde_json::from_str(line).with_context(place)?;
            let found = match (line["episode"].as_str(), line["trace"].as_str()) {
                (Some(episode), _) => {
                    number_in(&line[self.metric]).map(|value| (episode.to_owned(), value))
                }
                (None, Some(trace)) => {
                    self.replayed(Path::new(trace), &line).with_context(place)?
                }
                (None, None) => bail!("{} has neither \"episode\" nor \"trace\"", place()),
            };
            if let Some((episode, value)) = found
                && values.insert(episode.clone(), value).is_some()
            {
                bail!("{} has the episode '{episode}' a second time", place());
            }
        }
        Ok(values)
    }

    /// What a line of `reel replay --outcomes --json` says of a recorded episode; none where the build
    /// could not execute it.
    fn replayed(&mut self, trace: &Path, line: &Value) -> anyhow::Result<Option<(String, f64)>> {
        let Some((_, field)) = REPLAYED.iter().find(|(name, _)| *name == self.metric) else {
            bail!("'{}' is not in what `reel replay` prints", self.metric);
        };
        if line["outcomes"].is_null() {
            return Ok(None);
        }
        let path = match &self.arguments.git {
            Some(_) => self.checkout().join(trace),
            None => trace.to_owned(),
        };
        let report = match self.traces.get(&path) {
            Some(report) => report,
            None => {
                let read = inputs::trace_files().read(&path)?;
                let report = EpisodeReport::of_trace(&read, &path);
                let report = report.with_context(|| format!("{} has no end", path.display()))?;
                self.traces.entry(path).or_insert(report)
            }
        };
        let value = match &line["outcomes"]["end"] {
            Value::Null => metric(report, self.metric),
            end => number_in(&end["replayed"][*field]),
        };
        let folder = self.arguments.by.builds.as_deref();
        Ok(value.map(|value| (name(trace, folder.unwrap_or(Path::new(""))), value)))
    }
}

impl Drop for Measurement<'_> {
    /// Removes the checkout of a repository, which is the search's own.
    fn drop(&mut self) {
        if let Some(repository) = &self.arguments.git
            && let Ok(folder) = self.checkout().canonicalize()
            && is_worktree(&folder)
            && let Some(folder) = folder.to_str()
        {
            let removed = git(repository, &["worktree", "remove", "--force", folder]);
            if let Err(error) = removed {
                eprintln!("reel: the checkout stays: {error:#}");
            }
        }
    }
}

impl Arguments {
    /// The command that measures a candidate; none where nothing has to be executed.
    fn command(&self) -> Option<&str> {
        let replay = self.by.builds.as_ref().map(|_| REPLAY);
        self.by.run.as_deref().or(replay)
    }
}

impl Done {
    const FILE: &'static str = "bisect.json";

    fn open(out: &Path, command: &str, candidates: &[Candidate]) -> anyhow::Result<Self> {
        let words =
            command.split(|letter: char| letter.is_whitespace() || "'\"`;|&<>()=".contains(letter));
        let named = words.filter(|word| Path::new(word).is_file()).map(identity);
        let candidates = candidates.iter();
        let new = Self {
            command: command.to_owned(),
            named: named.collect(),
            candidates: candidates
                .map(|candidate| identity(&candidate.name))
                .collect(),
            measured: BTreeSet::new(),
        };
        let path = out.join(Self::FILE);
        let Ok(text) = fs::read_to_string(&path) else {
            new.keep(out)?;
            return Ok(new);
        };
        let old: Self = serde_json::from_str(&text)
            .with_context(|| format!("{} is damaged", path.display()))?;
        if (&old.command, &old.candidates) != (&new.command, &new.candidates) {
            bail!(
                "{} holds another search ({}); name another folder by --out, or remove it",
                out.display(),
                old.difference(&new)
            );
        }
        if let Some(script) = changed(&old.named, &new.named) {
            eprintln!(
                "reel: {script}, which the command names, was changed since: what was measured before stays as it is; another --out measures it anew"
            );
        }
        if !old.measured.is_empty() {
            eprintln!(
                "reel: {} candidates were measured before, in {}",
                old.measured.len(),
                out.display()
            );
        }
        Ok(old)
    }

    /// In what another search differs, for people.
    fn difference(&self, other: &Self) -> String {
        if self.command != other.command {
            return "another command".to_owned();
        }
        match changed(&self.candidates, &other.candidates) {
            Some(name) if self.candidates.iter().any(|old| name_in(old) == name) => {
                format!("{name} was changed since")
            }
            _ => "other candidates".to_owned(),
        }
    }

    fn keep(&self, out: &Path) -> anyhow::Result<()> {
        let path = out.join(Self::FILE);
        fs::create_dir_all(out)
            .and_then(|()| fs::write(&path, serde_json::to_string_pretty(self)?))
            .with_context(|| format!("cannot write {}", path.display()))
    }
}

/// Rewards of traces under a preset.
fn scored(traces: &Path, preset: &str) -> anyhow::Result<Values> {
    let preset = PresetSource::find(preset)?.preset;
    let files = inputs::trace_files();
    let score = |path: &PathBuf| {
        let trace = files.read(path)?;
        let (start, steps) = (&trace.start, &trace.steps);
        let terms = rewards(&preset, &trace.task, &trace.scene, start, steps);
        let total = terms.iter().flatten().map(|term| term.value).sum();
        anyhow::Ok((name(path, traces), total))
    };
    let paths = inputs::traces(&files, &[traces.to_owned()])?;
    paths.par_iter().map(score).collect()
}

/// What a trace is called: its path below the folder, without the extension.
fn name(trace: &Path, folder: &Path) -> String {
    let below = trace.strip_prefix(folder).unwrap_or(trace);
    let shown = below.display().to_string();
    match shown.is_empty() {
        true => trace_stem(trace),
        false => shown.trim_end_matches(".mcap").to_owned(),
    }
}

fn key(report: &EpisodeReport) -> String {
    format!("{} seed {}", report.task_id, report.seed)
}

fn metric(report: &EpisodeReport, metric: &str) -> Option<f64> {
    match metric {
        "success" => Some(f64::from(u8::from(report.success))),
        "completion" => Some(report.completion),
        "reward" => Some(report.total_reward),
        "spl" => report.spl,
        "steps" => Some(f64::from(report.length)),
        "asks" => Some(f64::from(report.asks)),
        _ => None,
    }
}

fn number_in(value: &Value) -> Option<f64> {
    let truth = value.as_bool().map(|truth| f64::from(u8::from(truth)));
    truth.or_else(|| value.as_f64())
}

/// Whether an episode is one of a task, or the one that is printed so: `TASK seed 0`; of traces `TASK--POLICY--0`.
pub(super) fn is_of(key: &str, id: &str) -> bool {
    [id.to_owned(), id.replace('/', "_")].iter().any(|id| {
        let rest = key.strip_prefix(id.as_str());
        rest.is_some_and(|rest| {
            rest.is_empty() || rest.starts_with(" seed ") || rest.starts_with("--")
        })
    })
}

/// The name of the first identity that is new or other.
fn changed(old: &[String], new: &[String]) -> Option<String> {
    let first = new.iter().find(|identity| !old.contains(identity))?;
    Some(name_in(first).to_owned())
}

fn name_in(identity: &str) -> &str {
    identity.split_once('\t').map_or(identity, |(name, _)| name)
}

/// A name, and of a file or folder what tells that it was changed.
fn identity(name: &str) -> String {
    let (mut files, mut bytes, mut newest) = (0_u32, 0, SystemTime::UNIX_EPOCH);
    let mut waiting = vec![PathBuf::from(name)];
    while let Some(path) = waiting.pop() {
        let Ok(found) = fs::symlink_metadata(&path) else {
            continue;
        };
        if found.is_dir() {
            let entries = fs::read_dir(&path).into_iter().flatten().flatten();
            waiting.extend(entries.map(|entry| entry.path()));
        } else {
            files += 1;
            bytes += found.len();
            newest = found
                .modified()
                .map_or(newest, |modified| newest.max(modified));
        }
    }
    match files {
        0 => name.to_owned(),
        _ => format!("{name}\t{files} {bytes} {newest:?}"),
    }
}

/// What the last lines of a file are, as the end of a sentence.
fn ending(path: &Path) -> String {
    let text = fs::read(path).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let lines: Vec<&str> = text.lines().collect();
    match lines.len().saturating_sub(SHOWN) {
        _ if lines.is_empty() => "is empty: it printed nothing".to_owned(),
        before => format!("ends with\n{}", lines[before..].join("\n")),
    }
}

/// A checkout of a commit beside the repository's own, which keeps what an earlier build left there.
fn checkout(repository: &Path, folder: &Path, commit: &str) -> anyhow::Result<PathBuf> {
    let path = env::current_dir()?.join(folder);
    let text = path
        .to_str()
        .context("the folder OUT has a name that is not UTF-8")?;
    if !path.exists() {
        git(repository, &["worktree", "prune"])?;
        git(repository, &["worktree", "add", "--detach", text, commit])?;
    }
    if !is_worktree(&path) {
        bail!(
            "{} is no checkout of a search; remove it, or name another folder by --out",
            path.display()
        );
    }
    git(
        &path,
        &["checkout", "--quiet", "--detach", "--force", commit],
    )?;
    Ok(path)
}

/// Whether a folder is a checkout beside a repository, which has a file `.git`; anything else would be
/// somebody's work.
fn is_worktree(folder: &Path) -> bool {
    folder.join(".git").is_file()
}
