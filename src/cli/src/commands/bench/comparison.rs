//! Two agents on the same tasks and seeds: paired differences with intervals and a test.

use std::{collections::BTreeMap, path::Path};

use anyhow::bail;
use reel_agents::EpisodeReport;
use reel_statistics::{bootstrap, mcnemar};
use serde_json::{Value, json};

use super::by_family;
use crate::{ExitStatus, recorded::recorded};

/// Samples of the bootstrap, and its seed.
const SAMPLES: usize = 10_000;
const SEED: u64 = 7;

/// Two episodes of one task and seed.
#[derive(Clone, Copy)]
struct Pair<'a> {
    a: &'a EpisodeReport,
    b: &'a EpisodeReport,
}

pub(super) fn compare(a: &Path, b: &Path, as_json: bool) -> anyhow::Result<ExitStatus> {
    let (ours, theirs) = (recorded(a)?, recorded(b)?);
    let other: BTreeMap<_, _> = theirs
        .iter()
        .map(|report| ((&report.task_id, report.seed), report))
        .collect();
    let pairs: Vec<Pair<'_>> = ours
        .iter()
        .filter_map(|a| {
            Some(Pair {
                a,
                b: other.get(&(&a.task_id, a.seed))?,
            })
        })
        .collect();
    if pairs.is_empty() {
        bail!(
            "{} and {} have no task and seed in common; compare runs of the same tasks and seeds",
            a.display(),
            b.display()
        );
    }
    let alone = ours.len() + theirs.len() - 2 * pairs.len();
    let rows: Vec<Value> = by_family(pairs.iter(), |pair| pair.a.family)
        .iter()
        .map(|(name, group)| difference(name, group))
        .collect();
    if as_json {
        let names = [name_of(&ours), name_of(&theirs)];
        println!(
            "{}",
            json!({"a": names[0], "b": names[1], "pairs": pairs.len(), "unpaired": alone, "rows": rows})
        );
        return Ok(ExitStatus::Success);
    }
    println!(
        "A {} ({})\nB {} ({})",
        name_of(&ours),
        a.display(),
        name_of(&theirs),
        b.display()
    );
    println!(
        "  {:6} {:>6} {:>6} {:>6}  {:25} {:>7} {:>7} {:>8} {:>9} {:>13}",
        "family",
        "pairs",
        "SR A",
        "SR B",
        "B - A (95 %)",
        "only A",
        "only B",
        "p",
        "CR B - A",
        "reward B - A"
    );
    for row in &rows {
        let number = |key: &str| row[key].as_f64().unwrap_or_default();
        let interval = |key: &str| {
            row[key].as_array().map_or([0.0; 3], |of| {
                [0, 1, 2].map(|i| of[i].as_f64().unwrap_or_default())
            })
        };
        let [difference, low, high] = interval("success").map(|value| 100.0 * value);
        println!(
            "  {:6} {:6.0} {:6.1} {:6.1}  {difference:+6.1} ({low:+6.1} to {high:+6.1}) {:7.0} {:7.0} {:8.4} {:+9.3} {:+13.3}",
            row["family"].as_str().unwrap_or_default(),
            number("pairs"),
            100.0 * number("success_a"),
            100.0 * number("success_b"),
            number("only_a"),
            number("only_b"),
            number("p"),
            interval("completion")[0],
            interval("reward")[0],
        );
    }
    println!("intervals: paired bootstrap, {SAMPLES} samples; p: McNemar's exact test");
    if alone > 0 {
        println!("{alone} episodes have no partner and were left out");
    }
    Ok(ExitStatus::Success)
}

fn difference(name: &str, pairs: &[&Pair<'_>]) -> Value {
    let n = pairs.len() as f64;
    let count = |holds: &dyn Fn(&Pair<'_>) -> bool| pairs.iter().filter(|pair| holds(pair)).count();
    let (only_a, only_b) = (
        count(&|pair| pair.a.success && !pair.b.success),
        count(&|pair| pair.b.success && !pair.a.success),
    );
    let interval = |value: &dyn Fn(&EpisodeReport) -> f64| {
        let differences: Vec<f64> = pairs
            .iter()
            .map(|pair| value(pair.b) - value(pair.a))
            .collect();
        bootstrap(&differences, SAMPLES, SEED)
    };
    json!({
        "family": name, "pairs": pairs.len(),
        "success_a": count(&|pair| pair.a.success) as f64 / n, "success_b": count(&|pair| pair.b.success) as f64 / n,
        "success": interval(&|report| f64::from(u8::from(report.success))),
        "only_a": only_a, "only_b": only_b, "p": mcnemar(only_a as f64, only_b as f64),
        "completion": interval(&|report| report.completion),
        "reward": interval(&|report| report.total_reward),
        "steps": interval(&|report| f64::from(report.length)),
    })
}

/// The episodes of a folder that came to their end, in a fixed order.
fn name_of(reports: &[EpisodeReport]) -> String {
    reports
        .first()
        .map(|report| report.policy.clone())
        .unwrap_or_default()
}
