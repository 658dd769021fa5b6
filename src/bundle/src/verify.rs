//! Whether what a bundle claims holds: its parts against each other first, then its episodes, executed again one by one, by whoever asks, on as
//! many threads as there are.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use reel_replay::{SIM_VERSION, unpack};
use reel_trace::{Limits, PackedEpisode, Shard, Trace};
use reel_world::{
    Assets, Digest, Meshes, canonical_json, printable_line,
    record::{EndReason, EpisodeHeader},
};
use serde::Serialize;
use serde_json::json;

use crate::{
    BundleError, Finding, FindingKind, Sample, Signer,
    archive::{Bundle, EPISODES, MANIFEST},
    make::{entry, settings, some},
    manifest::{Cell, ClaimedEpisode, FORMAT, Manifest, ResultRow, TaskEntry, results},
    miss_probability,
    statement::statement,
};

/// The tasks that should have been played, from whoever verifies.
#[derive(Clone, Debug)]
pub struct Benchmark {
    /// What to call them in messages.
    pub name: String,
    /// The tasks, by id.
    pub tasks: Vec<TaskEntry>,
}

/// A bundle whose parts were compared with each other; what is left is to execute its episodes.
pub struct CheckedBundle {
    manifest: Manifest,
    shard: Shard,
    findings: Vec<Finding>,
    signer: Option<Signer>,
    benchmark: Option<String>,
}

/// What came of verifying a bundle.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Verification {
    /// Whether everything holds that was looked at.
    pub holds: bool,
    /// Name of the run, as it is claimed.
    pub name: String,
    /// Name of the policy, as it is claimed.
    pub policy: String,
    /// The line `all` of the table.
    pub result: Option<ResultRow>,
    /// How many episodes the bundle has.
    pub episodes: u32,
    /// Which of them were executed.
    pub executed: Sample,
    /// For some numbers of forged episodes, how likely it is that none of them was executed.
    pub miss_probability: BTreeMap<u32, f64>,
    /// Fingerprint of the key that signed it.
    pub signer: Option<String>,
    /// The benchmark that its tasks were compared with.
    pub benchmark: Option<String>,
    /// Digest of what was played, without the names of run and policy: equal in two bundles of one run.
    pub run_digest: Digest,
    /// What does not hold.
    pub findings: Vec<Finding>,
}

impl CheckedBundle {
    /// Compares the parts of a bundle with each other, and its tasks with those of a benchmark. `signer` is who must have signed it.
    ///
    /// # Errors
    /// When manifest or episodes cannot be read at all.
    pub fn new(
        bundle: &Bundle,
        benchmark: Option<&Benchmark>,
        signer: Option<&Signer>,
    ) -> Result<Self, BundleError> {
        let unreadable = |problem: String| BundleError::Part {
            name: MANIFEST,
            problem,
        };
        let manifest: Manifest = serde_json::from_slice(&bundle.manifest)
            .map_err(|error| unreadable(error.to_string()))?;
        if manifest.format != FORMAT {
            return Err(unreadable(format!(
                "it has form {}, and this build reads form {FORMAT}",
                manifest.format
            )));
        }
        if canonical_json(&manifest).as_bytes() != bundle.manifest {
            return Err(unreadable("it is not in its canonical form".to_owned()));
        }
        manifest.grid.checked_len().map_err(unreadable)?;
        let shard = Shard::from_bytes(Path::new(EPISODES), bundle.episodes.clone())?;
        let mut findings = Vec::new();
        if statement(bundle, &manifest) != bundle.statement {
            findings.push(Finding::new(
                FindingKind::Statement,
                "the statement is not that of the parts: one of them was changed after the bundle was made",
            ));
        }
        let signed_by = signed_by(bundle, signer, &mut findings);
        of_grid(&manifest, benchmark, &mut findings);
        let mut checked = Self {
            manifest,
            shard,
            findings,
            signer: signed_by,
            benchmark: benchmark.map(|benchmark| benchmark.name.clone()),
        };
        checked.compare_headers();
        Ok(checked)
    }

    /// What the bundle claims.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What does not hold so far, before any episode is executed.
    pub fn findings(&self) -> &[Finding] {
        &self.findings
    }

    /// How many episodes can be executed.
    pub fn len(&self) -> u32 {
        self.shard.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.shard.is_empty()
    }

    /// The meshes that an episode was recorded with, as far as `assets` has them.
    pub fn meshes(&self, number: u32, assets: Option<&dyn Assets>) -> Meshes {
        let (Some(assets), Ok(episode)) = (assets, self.shard.episode(number)) else {
            return Meshes::default();
        };
        assets.meshes(&mut episode.header.meshes.keys())
    }

    /// Executes an episode again and gives the trace that was packed, with the name of its file.
    ///
    /// # Errors
    /// Why it cannot be executed, or that it gives another trace.
    pub fn unpack(&self, number: u32, meshes: &Meshes) -> Result<(String, Vec<u8>), String> {
        let episode = self
            .shard
            .episode(number)
            .map_err(|error| error.to_string())?;
        let bytes = unpack(&episode, meshes)?;
        Ok((episode.name, bytes))
    }

    /// Whether an episode plays what it should: another task is named already, and nobody wants to wait for it.
    fn is_of_task(&self, number: u32) -> bool {
        let claimed = self.claimed(number);
        !self.findings.iter().any(|one| {
            one.kind == FindingKind::Task
                && (one.episode == Some(number)
                    || one.task.is_some() && one.task.as_ref() == claimed.map(|one| &one.task))
        })
    }

    /// Executes an episode again and compares it with what is claimed of it. Gives what differs. An episode of another task
    /// than claimed, or than the benchmark has, is not executed.
    pub fn execute(&self, number: u32, meshes: &Meshes) -> Vec<Finding> {
        if !self.is_of_task(number) {
            return Vec::new();
        }
        let differs = |text: String| vec![Finding::of_episode(FindingKind::Episode, number, text)];
        let (name, bytes) = match self.unpack(number, meshes) {
            Ok(unpacked) => unpacked,
            Err(reason) => return differs(reason),
        };
        let read = Trace::from_bytes(Path::new(&name), &bytes, &Limits::default());
        let trace = match read {
            Ok(trace) => trace,
            Err(error) => return differs(error.to_string()),
        };
        let (Some(end), Some(claimed)) = (&trace.end, self.claimed(number)) else {
            return differs("it has no end, or nothing is claimed of it".to_owned());
        };
        if end.reason == EndReason::Aborted {
            return differs("it broke off, so it was not played to its end".to_owned());
        }
        let (header, chain) = (&trace.header, trace.chain());
        // What was executed is judged, too, and not only what was there before.
        let known = self.findings.iter().any(|one| one.episode == Some(number));
        let other = of_header(&self.manifest, claimed, header, chain, number);
        if !known && !other.is_empty() {
            return other;
        }
        let found = ClaimedEpisode::of(&header.task_id, header.seed, chain, end);
        difference(claimed, &found)
            .map(|text| Finding::of_episode(FindingKind::Metrics, number, text))
            .into_iter()
            .collect()
    }

    /// What came of it, once the episodes of a sample were executed.
    pub fn finish(&self, sample: Sample, found: Vec<Finding>) -> Verification {
        let findings = [self.findings.clone(), found].concat();
        let episodes = self.len();
        let drawn = u32::try_from(sample.episodes.len()).unwrap_or(u32::MAX);
        let counts = [1, 2, 5, 10, 20, 50]
            .into_iter()
            .filter(|forged| *forged <= episodes);
        let miss_probability = counts
            .filter(|_| drawn < episodes)
            .map(|forged| (forged, miss_probability(episodes, drawn, forged)))
            .collect();
        Verification {
            holds: findings.is_empty(),
            run_digest: self.run_digest(),
            name: self.manifest.name.clone(),
            policy: self.manifest.settings.policy.name.clone(),
            result: self.manifest.results.last().cloned(),
            episodes,
            executed: sample,
            miss_probability,
            signer: self.signer.as_ref().map(ToString::to_string),
            benchmark: self.benchmark.clone(),
            findings,
        }
    }

    fn claimed(&self, number: u32) -> Option<&ClaimedEpisode> {
        self.manifest.episodes.get(number as usize)
    }

    /// Digest of what was played in all episodes that can be read.
    fn run_digest(&self) -> Digest {
        Digest::of_json(&episode_fingerprints(&self.shard))
    }

    /// Every episode of the shard has to be the one that is claimed in its place.
    fn compare_headers(&mut self) {
        let claimed = u32::try_from(self.manifest.episodes.len()).unwrap_or(u32::MAX);
        let mut findings = Vec::new();
        if claimed != self.len() {
            let text = format!(
                "{claimed} episodes are claimed, and {} are there",
                self.len()
            );
            findings.push(Finding::new(FindingKind::Missing, text));
        }
        for number in 0..self.len() {
            match self.shard.episode(number) {
                Err(error) => {
                    findings.push(Finding::of_episode(
                        FindingKind::Part,
                        number,
                        error.to_string(),
                    ));
                }
                Ok(episode) => {
                    if let Some(claimed) = self.claimed(number) {
                        let (header, chain) = (&episode.header, episode.chain);
                        findings.append(&mut of_header(
                            &self.manifest,
                            claimed,
                            header,
                            chain,
                            number,
                        ));
                    }
                }
            }
        }
        self.findings.append(&mut findings);
    }
}

/// Checks a bundle and executes all its episodes, one after the other.
///
/// # Errors
/// As [`CheckedBundle::new`].
pub fn verify(
    bundle: &Bundle,
    benchmark: Option<&Benchmark>,
    signer: Option<&Signer>,
) -> Result<Verification, BundleError> {
    let checked = CheckedBundle::new(bundle, benchmark, signer)?;
    let sample = Sample::all(checked.len());
    let executed = sample.episodes.iter();
    let found = executed.flat_map(|number| checked.execute(*number, &Meshes::default()));
    let found: Vec<Finding> = found.collect();
    Ok(checked.finish(sample, found))
}

/// For each episode a digest of what was played in it: task, scene, seed, calls and words, without the names of run and policy.
pub fn episode_fingerprints(shard: &Shard) -> BTreeSet<Digest> {
    let episodes = (0..shard.len()).filter_map(|number| shard.episode(number).ok());
    let fingerprint = |episode: PackedEpisode| {
        let played = episode.inputs.iter().map(|input| {
            let words = input
                .policy
                .as_ref()
                .map(|policy| (&policy.reasoning, &policy.raw));
            json!([input.call, words])
        });
        let played: Vec<_> = played.collect();
        let header = &episode.header;
        Digest::of_json(&json!([
            header.task_digest,
            header.scene_digest,
            header.seed,
            played
        ]))
    };
    episodes.map(fingerprint).collect()
}

/// Who signed it, if that holds.
fn signed_by(
    bundle: &Bundle,
    wanted: Option<&Signer>,
    findings: &mut Vec<Finding>,
) -> Option<Signer> {
    let mut wrong = |text: String| findings.push(Finding::new(FindingKind::Signature, text));
    let Some(signature) = &bundle.signature else {
        if let Some(wanted) = wanted {
            wrong(format!("it is not signed, and {wanted} should have"));
        }
        return None;
    };
    match Signer::of_signature(signature, &bundle.statement) {
        Ok(signer) => {
            if let Some(wanted) = wanted.filter(|wanted| !signer.is(wanted)) {
                wrong(format!("it is signed by {signer}, not by {wanted}"));
            }
            Some(signer)
        }
        Err(reason) => {
            wrong(reason);
            None
        }
    }
}

/// The manifest in itself: every cell of the grid once, the table that follows, the tasks of the benchmark.
fn of_grid(manifest: &Manifest, benchmark: Option<&Benchmark>, findings: &mut Vec<Finding>) {
    let Manifest { grid, episodes, .. } = manifest;
    let mut wrong = |kind, text: String| findings.push(Finding::new(kind, text));
    if manifest.simulator != SIM_VERSION {
        wrong(
            FindingKind::Simulator,
            format!(
                "it was recorded by simulator {}, this is {SIM_VERSION}: verify it with the build that made it (reel {})",
                manifest.simulator, manifest.build
            ),
        );
    }
    let mut left: BTreeSet<Cell<'_>> = grid.cells().collect();
    if left.is_empty() {
        wrong(
            FindingKind::Missing,
            "its grid has no episode at all".to_owned(),
        );
    }
    let extra: Vec<String> = episodes
        .iter()
        .map(ClaimedEpisode::cell)
        .filter(|cell| !left.remove(cell))
        .map(|cell| cell.to_string())
        .collect();
    if !extra.is_empty() {
        let text = format!("there twice, or not of the grid: {}", some(&extra));
        wrong(FindingKind::Extra, text);
    }
    if !grid.tasks.is_sorted_by(|a, b| a.id < b.id) || !grid.seeds.is_sorted_by(|a, b| a < b) {
        wrong(
            FindingKind::Task,
            "the grid has a task or a seed twice".to_owned(),
        );
    }
    if results(grid, episodes) != manifest.results {
        wrong(
            FindingKind::Results,
            "the table does not follow from the episodes".to_owned(),
        );
    }
    let Some(benchmark) = benchmark else { return };
    let known: BTreeMap<&str, &TaskEntry> = benchmark
        .tasks
        .iter()
        .map(|task| (task.id.as_str(), task))
        .collect();
    for task in &grid.tasks {
        let text = match known.get(task.id.as_str()) {
            Some(published) if *published == task => continue,
            Some(_) => format!(
                "{} is another task, or plays in another scene, than in {}",
                task.id, benchmark.name
            ),
            None => format!("{} is no task of {}", task.id, benchmark.name),
        };
        findings.push(Finding::of_task(&task.id, text));
    }
    let missing: Vec<String> = benchmark
        .tasks
        .iter()
        .filter(|task| grid.task(&task.id).is_none())
        .map(|task| task.id.clone())
        .collect();
    if !missing.is_empty() {
        let text = format!(
            "tasks of {} that are left out: {}",
            benchmark.name,
            some(&missing)
        );
        findings.push(Finding::new(FindingKind::Missing, text));
    }
}

/// An episode against what is claimed of the run and of this episode.
fn of_header(
    manifest: &Manifest,
    claimed: &ClaimedEpisode,
    header: &EpisodeHeader,
    chain: Digest,
    number: u32,
) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut wrong = |kind, text: String| findings.push(Finding::of_episode(kind, number, text));
    if header.seed != claimed.seed {
        wrong(
            FindingKind::Seed,
            format!(
                "it has seed {}, and {} is claimed",
                header.seed,
                claimed.cell()
            ),
        );
    }
    if manifest.grid.task(&claimed.task) != Some(&entry(header)) {
        wrong(
            FindingKind::Task,
            format!(
                "it plays another task, or in another scene, than the claimed {}",
                claimed.task
            ),
        );
    }
    if chain != claimed.trace {
        wrong(
            FindingKind::Episode,
            "it is another episode than the claimed one".to_owned(),
        );
    }
    let (settings, wanted) = (settings(header), &manifest.settings);
    if settings.preset != wanted.preset {
        wrong(
            FindingKind::Preset,
            format!(
                "its rewards are of preset {}, and {} is claimed",
                settings.preset, wanted.preset
            ),
        );
    }
    if (&settings.policy, settings.profile, settings.skills)
        != (&wanted.policy, wanted.profile, wanted.skills)
    {
        wrong(
            FindingKind::Settings,
            format!(
                "it was played with {}, and {} is claimed",
                canonical_json(&settings),
                canonical_json(wanted)
            ),
        );
    }
    findings
}

/// A name that somebody chose, which cannot read as part of a verdict.
fn quoted(name: &str) -> String {
    format!("\"{}\"", printable_line(name).replace('"', "\\\""))
}

/// The first metric that differs, with both values.
fn difference(claimed: &ClaimedEpisode, found: &ClaimedEpisode) -> Option<String> {
    let (claimed, found) = (json!(claimed), json!(found));
    let fields = claimed.as_object().into_iter().flatten();
    fields
        .filter(|(name, value)| found[name.as_str()] != **value)
        .map(|(name, value)| {
            format!(
                "{name}: {value} is claimed, and it is {}",
                found[name.as_str()]
            )
        })
        .next()
}

impl std::fmt::Display for Verification {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (name, policy) = (quoted(&self.name), quoted(&self.policy));
        if !self.holds {
            let first = self
                .findings
                .first()
                .map(ToString::to_string)
                .unwrap_or_default();
            write!(f, "DOES NOT HOLD: {name} of {policy}: {first}")?;
            return match self.findings.len() {
                0 | 1 => Ok(()),
                more => write!(f, " (and {} more)", more - 1),
            };
        }
        write!(f, "HOLDS: {name} of {policy}")?;
        if let Some(result) = &self.result {
            write!(f, ": {result}")?;
        }
        match self.executed.episodes.len() {
            all if all == self.episodes as usize => {
                write!(f, "; all {all} episodes executed again")
            }
            some => write!(
                f,
                "; so far as {some} of {} episodes, drawn by lot and executed again, can tell",
                self.episodes
            ),
        }
    }
}
