//! Measured blame against injected faults, and against what one would guess without measuring.

use std::{collections::BTreeMap, fs};

use anyhow::{Context, bail};
use reel_agents::Label;
use reel_counterfactual::blame::MeasuredTrace;
use reel_trace::TraceFiles;

/// What came of one kind of fault.
#[derive(Default)]
struct FaultKindRow {
    episodes: usize,
    right: usize,
    earlier: usize,
    later: usize,
    repaired: usize,
    last: usize,
    first_error: usize,
    random: f64,
}

/// Prints how often the decisive step is the call with which the first unrepaired fault began.
pub fn print(files: &TraceFiles, measured: &[MeasuredTrace]) -> anyhow::Result<()> {
    let mut rows: BTreeMap<&'static str, FaultKindRow> = BTreeMap::new();
    let (mut total, mut without, mut verified) = (FaultKindRow::default(), Vec::new(), 0);
    for one in measured
        .iter()
        .filter(|one| one.blame.success == Some(false))
    {
        let mut path = one.trace.clone().into_os_string();
        path.push(".label.json");
        let text = fs::read_to_string(&path).with_context(|| {
            format!(
                "no label beside {}; `reel agent faults run` writes them",
                one.trace.display()
            )
        })?;
        let label: Label = serde_json::from_str(&text)
            .with_context(|| format!("{} is no label", one.trace.display()))?;
        let open = label
            .faults
            .iter()
            .filter(|fault| !fault.repaired && fault.step.is_some());
        let Some(fault) = open.min_by_key(|fault| fault.step) else {
            continue;
        };
        let (began, steps) = (fault.step.unwrap_or_default(), one.blame.costs.len());
        let found = one.blame.decisive.as_ref().map(|decisive| decisive.step);
        let trace = files.read(&one.trace)?;
        let error = trace
            .steps
            .iter()
            .find(|step| step.outcome.error.is_some())
            .map(|step| step.step);
        let is_repaired = label
            .faults
            .iter()
            .any(|fault| fault.repaired && fault.step.is_some() && fault.step == found);
        for row in [rows.entry(fault.kind.name()).or_default(), &mut total] {
            row.episodes += 1;
            row.right += usize::from(found == Some(began));
            row.earlier += usize::from(found.is_some_and(|found| found < began));
            row.later += usize::from(found.is_none_or(|found| found > began));
            row.repaired += usize::from(is_repaired && found != Some(began));
            row.last += usize::from(began as usize + 1 == steps);
            row.first_error += usize::from(error == Some(began));
            row.random += 1.0 / steps.max(1) as f64;
        }
        verified += usize::from(one.alternative.as_ref().is_some_and(|found| found.verified));
        without.extend(
            one.no_alternative
                .as_ref()
                .map(|why| format!("{}: {why}", one.trace.display())),
        );
    }
    if total.episodes == 0 {
        bail!("no failed episode with an injected fault that was not repaired");
    }
    println!(
        "decisive step against the first fault that was not repaired: {} failed episodes",
        total.episodes
    );
    println!(
        "fault                episodes  right           earlier  later  a repaired one  last step  first error  random"
    );
    for (name, row) in rows
        .iter()
        .map(|(name, row)| (*name, row))
        .chain([("all", &total)])
    {
        let share = |count: usize| format!("{:.1}%", 100.0 * count as f64 / row.episodes as f64);
        println!(
            "{name:<20} {:>8}  {:>4} {:>7}  {:>10}  {:>5}  {:>14}  {:>9}  {:>11}  {:>5.1}%",
            row.episodes,
            row.right,
            share(row.right),
            row.earlier,
            row.later,
            row.repaired,
            share(row.last),
            share(row.first_error),
            100.0 * row.random / row.episodes as f64
        );
    }
    if verified > 0 {
        println!(
            "alternatives that succeed and replay exactly: {verified} of {}",
            total.episodes
        );
    }
    without.iter().for_each(|why| println!("  none: {why}"));
    Ok(())
}
