//! One episode has one set of numbers, however it came in: its own trace, the one of a server, what
//! `reel record` wrote beside that, its `eval_output` read back, the tables, REST. Every built-in
//! policy plays, against every family.
//!
//! Of one trace every surface tells the same bits. Of two traces of an episode only what the camera
//! saw may differ: where a reward depends on it, the result says so and bounds it; a class may
//! differ only where its rule reads it.
//!
//! `REEL_SEEDS` says with how many seeds every policy plays every family in several homes, and
//! every fault of the library (`make agreement`). Without it each policy plays once or twice.

mod play;
mod surfaces;

use std::{collections::BTreeMap, fmt::Debug, path::Path};

use play::{Archive, Pair, index_of};
use reel_reward::{Preset, RewardBounds, reward_bounds};
use reel_trace::Trace;
use reel_world::record::{Backend, Metrics, RewardTerm, StepRecord};
use serde_json::{Value, json};
use surfaces::Surfaces;
use tempfile::TempDir;

use crate::expect;

/// Homes in which the long test plays; the short one plays in the first.
const SCENES: [&str; 3] = ["home", "S1", "S4"];
/// Presets under which the tables score everything again; none reads what the camera saw.
const PRESETS: [&str; 2] = ["real-repo", "real-trainer"];
/// Columns that hold what the camera saw, as rules name them.
const SIGHT: [&str; 5] = [
    "steps.candidate_count",
    "steps.new_objects",
    "steps.settles",
    "steps.visible_count",
    "steps.visible_objects",
];
/// What a class is. `evidence` says which of two traces had a simulator.
const CLASS: [&str; 6] = ["class", "sub_class", "rule", "cause", "step", "last_step"];
/// Where the task of an episode is another than that of its file, as an import says it.
const OTHER_TASK: &str = "the first graph differs from the task file";

/// Where two surfaces, or two traces, tell different numbers.
#[derive(Default)]
struct Disagreements(Vec<String>);

impl Disagreements {
    /// Notes what the two sides tell, unless it is equal.
    fn compare<T: PartialEq + Debug>(&mut self, what: &str, one: T, other: T) {
        if one != other {
            self.0.push(format!("{what}: {one:?} and {other:?}"));
        }
    }

    /// Notes what does not hold.
    fn expect(&mut self, what: &str, holds: bool) {
        if !holds {
            self.0.push(what.to_owned());
        }
    }
}

#[test]
fn one_episode_has_one_set_of_numbers() {
    let seeds = std::env::var("REEL_SEEDS").map_or(0, |text| text.parse().expect("a number"));
    let folder = TempDir::new().unwrap();
    let folder = folder.path();
    let (batches, scenes) = match seeds {
        0 => (play::short(), &SCENES[..1]),
        seeds => (play::long(seeds), &SCENES[..]),
    };
    for scene in scenes {
        reel!(
            folder,
            "task generate --scene {scene} --count 4 --seed 3 --out tasks"
        );
    }
    let mut archive = Archive::new(folder);
    for batch in &batches {
        play::play(&mut archive, batch);
    }
    for seed in 0..seeds {
        play::play_faults(&mut archive, seed);
    }
    let tables = Tables::read(folder);
    let mut found = Disagreements::default();
    let mut counts = BTreeMap::new();
    for pair in &archive.pairs {
        *counts.entry(pair.kind).or_insert(0) += 1;
        compare(&mut found, &archive, pair, &tables);
    }
    let surfaces = Surfaces::open(folder);
    for (index, trace) in archive.traces.iter().enumerate() {
        surfaces.compare(&mut found, index, trace, &tables);
    }
    let traces = archive.traces.len();
    println!("{traces} traces on every surface, and pairs of traces: {counts:?}");
    let Disagreements(found) = found;
    let shown: Vec<&str> = found.iter().take(20).map(String::as_str).collect();
    assert!(
        found.is_empty(),
        "{} disagreements; reel run plays an episode again:\n{}",
        found.len(),
        shown.join("\n")
    );
}

/// Two traces of one episode.
fn compare(found: &mut Disagreements, archive: &Archive<'_>, pair: &Pair, tables: &Tables) {
    let [one, other] = [pair.one, pair.other].map(|index| &archive.traces[index]);
    let header = &one.header;
    let what = format!(
        "{}: {} of run {}, profile {}, seed {}",
        pair.kind,
        header.task_id,
        header.run_id,
        header.profile.as_str(),
        header.seed
    );
    compare_steps(found, one, other, &what);
    compare_rewards(found, one, other, pair, &what);
    if !pair.notes.contains(OTHER_TASK) {
        for preset in PRESETS {
            let [one, other] = [pair.one, pair.other].map(|index| &tables.scored[&(index, preset)]);
            found.compare(&format!("{what} under {preset}"), one, other);
        }
    }
    let [one, other] = [pair.one, pair.other].map(|index| tables.classes.get(&index));
    compare_classes(found, one, other, &what);
}

/// What the tables hold of every trace, by its place in the archive.
struct Tables {
    episodes: BTreeMap<usize, Value>,
    classes: BTreeMap<usize, Value>,
    /// Totals and terms under a preset.
    scored: BTreeMap<(usize, &'static str), Value>,
}

impl Tables {
    fn read(folder: &Path) -> Self {
        reel!(folder, "ingest data/traces --store data/store");
        let mut scored = BTreeMap::new();
        for preset in PRESETS {
            reel!(folder, "store reward --store data/store --preset {preset}");
            let sql = format!(
                "SELECT trace, r.total_reward AS total, r.discounted_return AS discounted, r.terms AS terms \
                 FROM rescored r JOIN episodes USING (episode_id) WHERE r.preset = '{preset}'"
            );
            for (index, row) in rows(folder, &sql) {
                let numbers = json!([row["total"], row["discounted"], row["terms"]]);
                scored.insert((index, preset), numbers);
            }
        }
        // Recorded terms are those that the columns give, bit for bit.
        reel!(folder, "store reward --store data/store --check");
        reel!(folder, "taxonomy --store data/store");
        Self {
            episodes: rows(folder, "SELECT * FROM episodes"),
            classes: classes(folder),
            scored,
        }
    }
}

/// Rows of the store with a column `trace`, by its place in the archive.
fn rows(folder: &Path, sql: &str) -> BTreeMap<usize, Value> {
    let query = ["query", "--store", "data/store", "--format", "json", sql];
    let rows: Vec<Value> = serde_json::from_str(&expect(folder, 0, &query)).unwrap();
    let keyed = |row: Value| (index_of(row["trace"].as_str().unwrap()), row);
    rows.into_iter().map(keyed).collect()
}

fn classes(folder: &Path) -> BTreeMap<usize, Value> {
    let sql = "SELECT e.trace, c.* FROM classes c JOIN episodes e USING (episode_id)";
    rows(folder, sql)
}

fn terms(steps: &[StepRecord]) -> Vec<Vec<(String, u64)>> {
    steps.iter().map(|step| bits(&step.reward)).collect()
}

fn bits(terms: &[RewardTerm]) -> Vec<(String, u64)> {
    let term = |term: &RewardTerm| (term.component.clone(), term.value.to_bits());
    terms.iter().map(term).collect()
}

/// Terms in JSON, as tables and REST have them.
fn bits_of(terms: &Value) -> Vec<(String, u64)> {
    let term = |term: &Value| {
        let component = term["component"].as_str().unwrap().to_owned();
        (component, term["value"].as_f64().unwrap().to_bits())
    };
    terms.as_array().unwrap().iter().map(term).collect()
}

fn metrics(trace: &Trace) -> &Metrics {
    &trace.end.as_ref().unwrap().metrics
}

/// Between which totals the reward of a trace lies; none where a simulator recorded it.
fn bounds(trace: &Trace) -> Option<RewardBounds> {
    if trace.header.backend == Backend::Sim {
        return None;
    }
    let preset = Preset::parse(&trace.header.reward_preset).unwrap();
    reward_bounds(
        &preset,
        &trace.task,
        &trace.scene,
        &trace.start,
        &trace.steps,
    )
}

fn compare_steps(found: &mut Disagreements, one: &Trace, other: &Trace, what: &str) {
    let facts = |step: &StepRecord| {
        (
            step.tool_name().to_owned(),
            step.outcome.error,
            step.object.clone(),
            step.receptacle.clone(),
            step.held.clone(),
        )
    };
    found.compare(what, one.steps.len(), other.steps.len());
    for (one, other) in one.steps.iter().zip(&other.steps) {
        let what = format!("{what}, step {}", one.step);
        found.compare(&what, facts(one), facts(other));
    }
    let end = |trace: &Trace| trace.end.as_ref().unwrap().reason;
    found.compare(what, end(one), end(other));
}

fn compare_rewards(found: &mut Disagreements, one: &Trace, other: &Trace, pair: &Pair, what: &str) {
    let bounds = bounds(other);
    let open_from = bounds.as_ref().map_or(u32::MAX, |bounds| bounds.first_step);
    for (one, other) in one.steps.iter().zip(&other.steps) {
        let [mut mine, mut theirs] = [one, other].map(|step| bits(&step.reward));
        if one.step >= open_from {
            for terms in [&mut mine, &mut theirs] {
                terms.retain(|(component, _)| component != "ask");
            }
        }
        found.compare(&format!("{what}, step {}", one.step), mine, theirs);
    }
    let (mine, theirs) = (metrics(one), metrics(other));
    let exact = |metrics: &Metrics| {
        (
            metrics.success,
            metrics.completion.to_bits(),
            metrics.length,
            metrics.asks,
        )
    };
    found.compare(what, exact(mine), exact(theirs));
    let Some(bounds) = bounds else {
        let totals = |metrics: &Metrics| [metrics.total_reward, metrics.discounted_return];
        found.compare(
            what,
            totals(mine).map(f64::to_bits),
            totals(theirs).map(f64::to_bits),
        );
        let silent = !pair.notes.contains("what the camera saw");
        found.expect(
            &format!("{what}: nothing is open, but {}", pair.notes),
            silent,
        );
        return;
    };
    let total = mine.total_reward;
    found.expect(
        &format!("{what}: {total}, but {bounds}"),
        bounds.lower - 1e-9 <= total && total <= bounds.upper + 1e-9,
    );
    found.expect(
        &format!("{what}: it is not said that {bounds}, but {}", pair.notes),
        pair.notes.contains(&bounds.to_string()),
    );
}

fn compare_classes(
    found: &mut Disagreements,
    one: Option<&Value>,
    other: Option<&Value>,
    what: &str,
) {
    let reads_sight = |class: &&Value| {
        let mut fields = class["fields"].as_array().unwrap().iter();
        fields.any(|field| SIGHT.contains(&field.as_str().unwrap()))
    };
    if [one, other].iter().flatten().any(reads_sight) {
        return;
    }
    let class = |class: Option<&Value>| class.map(|class| CLASS.map(|key| class[key].clone()));
    found.compare(what, class(one), class(other));
}
