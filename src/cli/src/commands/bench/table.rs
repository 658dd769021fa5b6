//! The table of results: rates with intervals, means and costs by family.

use std::collections::BTreeMap;

use reel_agents::EpisodeReport;
use reel_statistics::wilson;
use reel_world::Skills;
use serde_json::{Value, json};

use super::{budget::cost, by_family};

/// A line of the table: a family, or all of them.
fn row(name: &str, group: &[&EpisodeReport], prices: Option<[f64; 2]>) -> Value {
    let n = group.len() as f64;
    let mean = |value: &dyn Fn(&EpisodeReport) -> f64| {
        group.iter().map(|report| value(report)).sum::<f64>() / n
    };
    let successes = group.iter().filter(|report| report.success).count();
    let (low, high) = wilson(successes as f64, n).unwrap_or((0.0, 1.0));
    let spl: Vec<f64> = group.iter().filter_map(|report| report.spl).collect();
    let counted: Vec<[u64; 2]> = group.iter().filter_map(|report| report.tokens).collect();
    let tokens = counted.iter().fold([0, 0], |sum, tokens| {
        [sum[0] + tokens[0], sum[1] + tokens[1]]
    });
    let mut broken: BTreeMap<&str, usize> = BTreeMap::new();
    group
        .iter()
        .flat_map(|report| &report.broken_rules)
        .for_each(|rule| *broken.entry(rule).or_default() += 1);
    let mut refused: BTreeMap<&str, usize> = BTreeMap::new();
    group
        .iter()
        .flat_map(|report| &report.refused_rules)
        .for_each(|rule| *refused.entry(rule).or_default() += 1);
    json!({
        "family": name, "episodes": group.len(), "successes": successes,
        "success_rate": successes as f64 / n, "success_low": low, "success_high": high,
        "completion": mean(&|report| report.completion),
        "spl": (!spl.is_empty()).then(|| spl.iter().sum::<f64>() / spl.len() as f64),
        "steps": mean(&|report| f64::from(report.length)),
        "asks": mean(&|report| f64::from(report.asks)),
        "reward": mean(&|report| report.total_reward),
        "latency_s": mean(&|report| report.latency_ns as f64 / 1e9),
        "prompt_tokens": (!counted.is_empty()).then_some(tokens[0]),
        "completion_tokens": (!counted.is_empty()).then_some(tokens[1]),
        "cost": prices.filter(|_| !counted.is_empty()).map(|prices| cost(tokens, prices)),
        "user_rules_broken": broken,
        "user_replies_refused": refused,
    })
}

pub(super) fn rows(reports: &[EpisodeReport], prices: Option<[f64; 2]>) -> Vec<Value> {
    by_family(reports.iter(), |report| report.family)
        .iter()
        .map(|(name, group)| row(name, group, prices))
        .collect()
}

pub(super) fn table(
    name: &str,
    skills: Skills,
    reports: &[EpisodeReport],
    prices: Option<[f64; 2]>,
) -> String {
    let skills = if skills.are_perfect() {
        String::new()
    } else {
        format!(", skills {}", skills.as_str())
    };
    let mut text = format!("{name}{skills}\n");
    if reports.is_empty() {
        return text + "  no episode was played to its end\n";
    }
    text.push_str(&format!(
        "  {:6} {:>9} {:>5}  {:15} {:>6} {:>6} {:>6} {:>6} {:>7} {:>10} {:>12}\n",
        "family",
        "episodes",
        "SR %",
        "(95 %)",
        "CR %",
        "SPL",
        "steps",
        "asks",
        "reward",
        "latency s",
        "tokens"
    ));
    for row in rows(reports, prices) {
        let number = |key: &str| row[key].as_f64().unwrap_or_default();
        let spl = row["spl"]
            .as_f64()
            .map_or_else(|| "-".to_owned(), |spl| format!("{:.1}", 100.0 * spl));
        let tokens = match (
            row["prompt_tokens"].as_u64(),
            row["completion_tokens"].as_u64(),
        ) {
            (Some(read), Some(written)) => format!("{read} + {written}"),
            _ => "-".to_owned(),
        };
        text.push_str(&format!(
            "  {:6} {:9.0} {:5.1}  ({:4.1} to {:5.1}) {:6.1} {spl:>6} {:6.1} {:6.2} {:7.2} {:10.2} {tokens:>12}",
            row["family"].as_str().unwrap_or_default(),
            number("episodes"),
            100.0 * number("success_rate"),
            100.0 * number("success_low"),
            100.0 * number("success_high"),
            100.0 * number("completion"),
            number("steps"),
            number("asks"),
            number("reward"),
            number("latency_s"),
        ));
        if let Some(cost) = row["cost"].as_f64() {
            text.push_str(&format!("  cost {cost:.2}"));
        }
        text.push('\n');
        for (column, what) in [
            ("user_rules_broken", "rules that the user's answers broke"),
            (
                "user_replies_refused",
                "rules that refused answers of the user broke",
            ),
        ] {
            let counts = row[column]
                .as_object()
                .filter(|counts| row["family"] == "all" && !counts.is_empty());
            if let Some(counts) = counts {
                let counts: Vec<String> = counts
                    .iter()
                    .map(|(rule, times)| format!("{rule} {times}"))
                    .collect();
                text.push_str(&format!("  {what}: {}\n", counts.join(", ")));
            }
        }
    }
    text
}
