//! Two runs of the same tasks: which episodes flip, where they come apart, and how certain the
//! difference is.

use std::{collections::BTreeMap, path::PathBuf};

use anyhow::bail;
use reel_counterfactual::{
    attribution::clustered_interval,
    regression::{Flip, Pairing, RunEpisode, flips, pair, read_run},
};
use reel_statistics::mcnemar;
use serde_json::json;

use super::Arguments;
use crate::{ExitStatus, inputs, progress};

/// Compares two folders of traces.
pub fn compare_folders(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = inputs::trace_files();
    let read = |path: &PathBuf| inputs::traces(&files, std::slice::from_ref(path));
    let paths = [read(&arguments.a)?, read(&arguments.b)?];
    compare(paths, &BTreeMap::new(), arguments)
}

/// Compares two policies or runs of a store.
#[cfg(feature = "analytics")]
pub fn compare_in_store(store: &str, arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    use reel_query::{Format, QuerySession, format};
    let session = QuerySession::new(inputs::store(store, None)?)?;
    let ask = |sql: &str| -> anyhow::Result<Vec<serde_json::Value>> {
        let text = format(&session.run(sql)?, Format::Json)?;
        Ok(serde_json::from_str(&text)?)
    };
    let traces = |name: &std::path::Path| -> anyhow::Result<Vec<PathBuf>> {
        let quoted = name.display().to_string().replace('\'', "''");
        let rows = ask(&format!(
            "SELECT trace FROM episodes WHERE policy = '{quoted}' OR run_id = '{quoted}' ORDER BY trace"
        ))?;
        let paths: Vec<PathBuf> = rows
            .iter()
            .filter_map(|row| Some(row["trace"].as_str()?.into()))
            .collect();
        if paths.is_empty() {
            bail!(
                "no episode of policy or run '{}' in {store}; `reel query --store {store} \"SELECT DISTINCT policy, run_id FROM episodes\"` lists them",
                name.display()
            );
        }
        Ok(paths)
    };
    let classes = ask("SELECT episode_id, class || ' / ' || sub_class AS class FROM classes")?
        .iter()
        .filter_map(|row| {
            let text = |field: &str| Some(row[field].as_str()?.to_owned());
            Some((text("episode_id")?, text("class")?))
        })
        .collect();
    compare(
        [traces(&arguments.a)?, traces(&arguments.b)?],
        &classes,
        arguments,
    )
}

fn compare(
    paths: [Vec<PathBuf>; 2],
    classes: &BTreeMap<String, String>,
    arguments: &Arguments,
) -> anyhow::Result<ExitStatus> {
    let bar = progress::bar(paths[0].len() + paths[1].len(), "read");
    let mut unreadable = Vec::new();
    let mut read = |paths: &[PathBuf]| -> Vec<RunEpisode> {
        let found = read_run(&inputs::trace_files(), paths, || bar.inc(1));
        found
            .into_iter()
            .filter_map(|one| one.map_err(|reason| unreadable.push(reason)).ok())
            .collect()
    };
    let (first, second) = (read(&paths[0]), read(&paths[1]));
    bar.finish_and_clear();
    let pairing = pair(first, second);
    if pairing.pairs.is_empty() {
        bail!(
            "no task and seed is in both {} and {}: nothing to pair",
            arguments.a.display(),
            arguments.b.display()
        );
    }
    let changed = pairing.pairs.iter().filter(|[a, b]| a.success != b.success);
    let bar = progress::bar(changed.count(), "compare");
    let found = flips(
        &inputs::trace_files(),
        &pairing.pairs,
        |id| classes.get(id).cloned(),
        || bar.inc(1),
    );
    bar.finish_and_clear();
    let mut all = Vec::new();
    for one in found {
        match one {
            Ok(flip) => all.push(flip),
            Err(reason) => unreadable.push(reason),
        }
    }
    for reason in &unreadable {
        eprintln!("reel: {reason}");
    }
    let summary = Summary::of(&pairing);
    if arguments.json {
        println!(
            "{}",
            json!({ "summary": summary, "flips": all, "unpaired": pairing.unpaired })
        );
    } else {
        print(&summary, &all, &pairing, arguments);
    }
    Ok(if !unreadable.is_empty() {
        ExitStatus::BadInput
    } else if all.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::CheckFailed
    })
}

/// Numbers of a pairing.
#[derive(serde::Serialize)]
pub struct Summary {
    pairs: usize,
    tasks: usize,
    /// Success rates of both runs over the pairs.
    success: [f64; 2],
    regressed: usize,
    recovered: usize,
    failed_in_both: usize,
    difference: f64,
    /// Bounds of the difference at 95 %.
    interval: Option<[f64; 2]>,
    /// Of McNemar's exact test.
    p: f64,
}

impl Summary {
    /// Counts which episodes of the pairs succeeded.
    pub fn of(pairing: &Pairing) -> Self {
        let pairs = &pairing.pairs;
        let is = |which: [bool; 2]| {
            pairs
                .iter()
                .filter(|[a, b]| [a.success == Some(true), b.success == Some(true)] == which)
                .count()
        };
        let (regressed, recovered) = (is([true, false]), is([false, true]));
        let both = is([true, true]);
        let share = |count: usize| count as f64 / pairs.len() as f64;
        let mut by_task: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
        let mut flipped: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
        for [a, b] in pairs {
            by_task.entry(&a.task_id).or_default().1 += 1;
            if a.success != b.success {
                let (hits, trials) = flipped.entry(&a.task_id).or_default();
                *hits += usize::from(b.success == Some(true));
                *trials += 1;
            }
        }
        let discordant = regressed + recovered;
        // Given how many pairs flip, the share that flips upwards is binomial.
        let bounds = clustered_interval(&flipped.into_values().collect::<Vec<_>>(), 0.0);
        let interval = bounds
            .map(|bounds| [bounds.low, bounds.high].map(|up| (2.0 * up - 1.0) * share(discordant)));
        Self {
            pairs: pairs.len(),
            tasks: by_task.len(),
            success: [share(both + regressed), share(both + recovered)],
            regressed,
            recovered,
            failed_in_both: is([false, false]),
            difference: share(recovered) - share(regressed),
            interval: interval.or((discordant == 0).then_some([0.0, 0.0])),
            p: mcnemar(regressed as f64, recovered as f64)
                .expect("counts of pairs are whole numbers below ten million"),
        }
    }

    /// Prints them in two lines.
    pub fn print(&self) {
        let percent = |share: f64| 100.0 * share;
        println!(
            "{} pairs of {} tasks: success {:.1}% -> {:.1}%",
            self.pairs,
            self.tasks,
            percent(self.success[0]),
            percent(self.success[1])
        );
        let interval = self.interval.map_or_else(String::new, |[low, high]| {
            format!(" [{:+.1}, {:+.1}]", percent(low), percent(high))
        });
        println!(
            "difference {:+.1} points{interval}, McNemar's exact p = {:.3}: {} regressed, {} recovered, {} failed in both",
            percent(self.difference),
            self.p,
            self.regressed,
            self.recovered,
            self.failed_in_both
        );
    }
}

fn print(summary: &Summary, all: &[Flip], pairing: &Pairing, arguments: &Arguments) {
    summary.print();
    let mut groups: BTreeMap<(&str, &str), Vec<&Flip>> = BTreeMap::new();
    for flip in all {
        let [a, b] = &flip.sides;
        groups.entry((&a.class, &b.class)).or_default().push(flip);
    }
    let mut groups: Vec<_> = groups.into_iter().collect();
    groups.sort_by_key(|((from, to), members)| (std::cmp::Reverse(members.len()), *from, *to));
    for ((from, to), members) in groups {
        println!("\n{} episodes: {from} -> {to}", members.len());
        for flip in members.iter().take(arguments.examples) {
            example(flip);
        }
    }
    for (name, unpaired) in [&arguments.a, &arguments.b].iter().zip(&pairing.unpaired) {
        if unpaired.is_empty() {
            continue;
        }
        println!("\n{} episodes only in {}:", unpaired.len(), name.display());
        for one in unpaired {
            let broken = if one.success.is_none() {
                ", broken off or not judged"
            } else {
                ""
            };
            println!(
                "  {} seed {}{broken}  {}",
                one.task_id,
                one.seed,
                one.trace.display()
            );
        }
    }
}

fn example(flip: &Flip) {
    let [a, b] = &flip.sides;
    let call = |call: &Option<String>| call.clone().unwrap_or_else(|| "(ended)".to_owned());
    println!(
        "  {} seed {}: the same for {} calls, then {} | {}",
        flip.task_id,
        flip.seed,
        flip.same_calls,
        call(&a.first_difference),
        call(&b.first_difference)
    );
    for side in [a, b] {
        if let (Some(step), Some(call)) = (side.decisive_step, &side.decisive_call) {
            let why = side.explanation.as_deref().unwrap_or_default();
            println!("    decided at call {step}: {call}: {why}");
        }
    }
    println!("    reel diff {} {}", a.trace.display(), b.trace.display());
}
