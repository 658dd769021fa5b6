//! `reel taxonomy agreement`: how far rules, people and judges agree, and how far a stated confidence
//! can be trusted.

use std::collections::{BTreeMap, BTreeSet};

use anyhow::bail;
use reel_query::QuerySession;
use reel_tables::LabelRow;
use reel_taxonomy::{
    Agreement, CLASSES, Calibration, LabelSet, StoredClass, agreement, baseline, calibration,
    disputed, label_set,
};
use serde_json::json;

use super::classes_of;
use crate::{ExitStatus, commands::query::rows, inputs};

#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// Which labels: an author, a kind (human, judge, injected), or `agreed`
    #[arg(
        long = "reference",
        alias = "with",
        value_name = "SET",
        default_value = "agreed"
    )]
    set: String,
    /// Of those, only labels whose author answered before seeing what the rules and `reel blame` say
    #[arg(long)]
    blind: bool,
    /// What is compared: `rules`, or labels of another set, e.g. `judge`
    #[arg(
        long = "prediction",
        alias = "of",
        value_name = "SET",
        default_value = "rules"
    )]
    of: String,
    /// Compare what a naive classifier says, too: the class that the last failed call suggests
    #[arg(long)]
    baseline: bool,
    /// List so many disagreements
    #[arg(
        long = "examples",
        alias = "show",
        value_name = "N",
        default_value_t = 20
    )]
    show: usize,
    /// Print the comparison and the disagreements as JSON
    #[arg(long)]
    json: bool,
}

/// Compares two sets of opinions and prints how far they agree.
pub(super) fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let session = QuerySession::new(inputs::store(&arguments.store, None)?)?;
    let labels = session.store().labels()?;
    let reference: Vec<LabelRow> = labels
        .iter()
        .filter(|label| !arguments.blind || label.blind == Some(true))
        .cloned()
        .collect();
    let truth = label_set(&reference, &arguments.set);
    let found = match arguments.of.as_str() {
        "rules" => classes_of(&session, &arguments.store)?,
        set => {
            let authors: BTreeSet<&str> = labels
                .iter()
                .filter(|label| label.kind == set)
                .map(|label| label.author.as_str())
                .collect();
            if authors.len() > 1 {
                let authors: Vec<&str> = authors.into_iter().collect();
                eprintln!(
                    "reel: '{set}' are {} authors ({}): of each episode the latest label counts; name one of them with --prediction",
                    authors.len(),
                    authors.join(", ")
                );
            }
            let traces = traces_of(&session)?;
            label_set(&labels, set)
                .into_values()
                .map(|label| as_found(label, &traces))
                .collect()
        }
    };
    let mut reports = vec![(arguments.of.as_str(), found)];
    if arguments.baseline {
        reports.push(("baseline", baseline(&session)?));
    }
    let mut printed = Vec::new();
    for (name, found) in &reports {
        let both: Vec<_> = found
            .iter()
            .filter_map(|found| Some((truth.get(&found.episode_id)?, found)))
            .collect();
        if both.is_empty() {
            let sets: BTreeSet<&str> = reference
                .iter()
                .flat_map(|label| [label.author.as_str(), label.kind.as_str()])
                .collect();
            let sets: Vec<&str> = sets.into_iter().collect();
            bail!(
                "no episode of '{name}' has a {}label of '{}'; there are labels of: {}",
                if arguments.blind { "blind " } else { "" },
                arguments.set,
                sets.join(", ")
            );
        }
        let by_class = agreement(
            both.iter()
                .map(|(label, found)| (label.class.as_str(), found.class.as_str())),
            &CLASSES,
        );
        let with_sub = both.iter().filter_map(|(label, found)| {
            Some((label.sub_class.as_deref()?, found.sub_class.as_str()))
        });
        let with_sub = with_sub.filter(|(_, found)| !found.is_empty());
        let by_sub_class = agreement(with_sub, &[]);
        let with_step = both
            .iter()
            .filter_map(|(label, found)| label.step.map(|step| (step - found.step).abs()));
        let distances: Vec<i32> = with_step.collect();
        let exact = distances.iter().filter(|distance| **distance == 0).count();
        if arguments.json {
            printed.push(json!({
                "of": name, "with": arguments.set, "classes": by_class, "sub_classes": by_sub_class,
                "steps": { "compared": distances.len(), "equal": exact },
            }));
            continue;
        }
        println!(
            "== {name} against '{}': {} episodes\n",
            arguments.set, by_class.episodes
        );
        print!("{}", report(&by_class));
        println!();
        print!("{}", confusion(&by_class));
        if by_sub_class.episodes > 0 {
            println!("\nsub-classes of {} episodes", by_sub_class.episodes);
            print!("{}", report(&by_sub_class));
        }
        if !distances.is_empty() {
            let near = distances.iter().filter(|distance| **distance <= 1).count();
            let share = |part: usize| 100.0 * part as f64 / distances.len() as f64;
            println!(
                "\ndecisive step: equal in {:.1}%, at most one off in {:.1}%",
                share(exact),
                share(near)
            );
        }
        println!();
    }
    let calibration = confidence(&labels, &arguments.of, &truth);
    if let Some(found) = calibration.as_ref().filter(|_| !arguments.json) {
        print!("{}", calibrated(&arguments.of, found));
    }
    let (_, found) = &reports[0];
    let differing: Vec<_> = found
        .iter()
        .filter_map(|found| Some((truth.get(&found.episode_id)?, found)))
        .filter(|(label, found)| {
            label.class != found.class
                || label
                    .sub_class
                    .as_ref()
                    .is_some_and(|said| !found.sub_class.is_empty() && *said != found.sub_class)
        })
        .collect();
    let open = disputed(&labels);
    if arguments.json {
        let list: Vec<_> = differing
            .iter()
            .map(|(label, found)| json!({ "label": label, "found": found }))
            .collect();
        println!(
            "{}",
            json!({
                "reports": printed, "calibration": calibration, "disagreements": list,
                "disputed": open.keys().collect::<Vec<_>>(),
            })
        );
        return Ok(ExitStatus::Success);
    }
    if !differing.is_empty() {
        println!(
            "{} disagreements{}",
            differing.len(),
            if differing.len() > arguments.show {
                ", the first of them:"
            } else {
                ":"
            }
        );
    }
    for (label, found) in differing.iter().take(arguments.show) {
        let said = label.sub_class.as_deref().unwrap_or(&label.class);
        let at = label
            .step
            .map(|step| format!(" at {step}"))
            .unwrap_or_default();
        println!(
            "  {}  {} says {said}{at}; found {} at {}\n    reel show {}",
            found.episode_id,
            label.author,
            match found.sub_class.as_str() {
                "" => &found.class,
                sub_class => sub_class,
            },
            found.step,
            found.trace
        );
    }
    if !open.is_empty() {
        println!(
            "{} episodes are disputed: `reel store label disputed` lists them",
            open.len()
        );
    }
    Ok(ExitStatus::Success)
}

/// How far the stated confidence of a set of labels goes with being right about the class; `None`
/// for the rules and for labels without a confidence.
fn confidence(labels: &[LabelRow], of: &str, truth: &LabelSet) -> Option<Calibration> {
    if of == "rules" {
        return None;
    }
    let answers: Vec<(f64, bool)> = label_set(labels, of)
        .into_values()
        .filter_map(|label| {
            let right = truth.get(&label.episode_id)?.class == label.class;
            Some((label.confidence?, right))
        })
        .collect();
    calibration(&answers)
}

fn calibrated(of: &str, found: &Calibration) -> String {
    let mut text = format!(
        "confidence of {} answers of '{of}': Brier score {:.3} ({:.3} if it always stated its accuracy), expected calibration error {:.3}\n  {:12} {:>8} {:>11} {:>9}\n",
        found.answers,
        found.brier,
        found.brier_baseline,
        found.expected_error,
        "confidence",
        "answers",
        "mean",
        "right"
    );
    for bin in &found.bins {
        let [low, high] = bin.range;
        text += &format!(
            "  {:12} {:>8} {:>11.2} {:>8.0}%\n",
            format!("{low:.1} to {high:.1}"),
            bin.answers,
            bin.confidence,
            100.0 * bin.accuracy
        );
    }
    text + "\n"
}

/// The trace of every episode, by its id.
fn traces_of(session: &QuerySession) -> anyhow::Result<BTreeMap<String, String>> {
    #[derive(serde::Deserialize)]
    struct EpisodeTrace {
        episode_id: String,
        trace: String,
    }
    let rows: Vec<EpisodeTrace> = rows(session, "SELECT episode_id, trace FROM episodes")?;
    Ok(rows
        .into_iter()
        .map(|row| (row.episode_id, row.trace))
        .collect())
}

/// A label in the place of what the rules found.
fn as_found(label: LabelRow, traces: &BTreeMap<String, String>) -> StoredClass {
    StoredClass {
        trace: traces.get(&label.episode_id).cloned().unwrap_or_default(),
        episode_id: label.episode_id,
        family: String::new(),
        policy: String::new(),
        class: label.class,
        sub_class: label.sub_class.unwrap_or_default(),
        step: label.step.unwrap_or(-1),
    }
}

fn report(agreement: &Agreement) -> String {
    let share =
        |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"));
    let mut text = format!(
        "{:24} {:>6} {:>6} {:>10} {:>7} {:>6}\n",
        "", "labels", "found", "precision", "recall", "F1"
    );
    for class in &agreement.classes {
        text += &format!(
            "{:24} {:6} {:6} {:>10} {:>7} {:6.3}\n",
            class.class,
            class.support,
            class.found,
            share(class.precision),
            share(class.recall),
            class.f1
        );
    }
    let kappa = share(agreement.kappa);
    text + &format!(
        "macro-F1 {:.3}, accuracy {:.3}, Cohen's kappa {kappa}\n",
        agreement.macro_f1, agreement.accuracy
    )
}

fn confusion(agreement: &Agreement) -> String {
    let mut text = format!("{:24}", "labelled \\ found");
    agreement
        .classes
        .iter()
        .for_each(|class| text += &format!(" {:>18}", class.class));
    text.push('\n');
    for (class, row) in agreement.classes.iter().zip(&agreement.confusion) {
        text += &format!("{:24}", class.class);
        row.iter()
            .for_each(|count| text += &format!(" {count:>18}"));
        text.push('\n');
    }
    text
}
