//! Figures of the answers against the truth, with 95% intervals and naive baselines. Never an
//! answer of its own.

use std::{collections::BTreeMap, fmt::Write as _};

use reel_counterfactual::truth::{Failure, HarmKind, Label};
use reel_statistics::wilson;
use serde::Serialize;

use super::{Played, ReelAnswer};

/// A share with Wilson's interval at 95%.
#[derive(Clone, Copy, Serialize)]
pub struct Share {
    hits: usize,
    of: usize,
    low: f64,
    high: f64,
}

impl Share {
    fn new(hits: usize, of: usize) -> Self {
        let (low, high) = wilson(hits as f64, of as f64).unwrap_or((0.0, 1.0));
        Self {
            hits,
            of,
            low,
            high,
        }
    }

    fn text(self) -> String {
        let percent = |share: f64| 100.0 * share;
        let share = percent(self.hits as f64 / self.of.max(1) as f64);
        format!(
            "{:>4} of {:<4} {share:>5.1}% [{:.1}, {:.1}]",
            self.hits,
            self.of,
            percent(self.low),
            percent(self.high)
        )
    }
}

/// Precision and recall of one name.
#[derive(Serialize)]
pub struct NameScore {
    name: String,
    precision: Share,
    recall: Share,
    f1: f64,
}

/// Everything that is printed.
#[derive(Serialize)]
pub struct Figures {
    episodes: usize,
    failures: usize,
    unexplained_truth: usize,
    classes: Vec<NameScore>,
    class_macro_f1: f64,
    class_macro_f1_fair: f64,
    sub_classes: Vec<NameScore>,
    sub_class_macro_f1: f64,
    sub_class_macro_f1_fair: f64,
    shares: BTreeMap<&'static str, Share>,
    confusion: BTreeMap<String, BTreeMap<String, usize>>,
}

fn is_fair(failure: &Failure, label: &Label) -> bool {
    let fits = |fair: &Label| {
        fair.class == label.class && (fair.sub_class == "*" || fair.sub_class == label.sub_class)
    };
    failure.label == *label || failure.fair.iter().any(fits)
}

fn is_fair_class(failure: &Failure, label: &Label) -> bool {
    let class = &label.class;
    failure.label.class == *class || failure.fair.iter().any(|fair| fair.class == *class)
}

fn table<'a>(pairs: &[(&'a str, &'a str)]) -> (Vec<NameScore>, f64) {
    let mut names: Vec<&str> = pairs
        .iter()
        .flat_map(|(truth, found)| [*truth, *found])
        .collect();
    names.sort_unstable();
    names.dedup();
    let row = |name: &&str| {
        let count =
            |is_it: &dyn Fn(&(&str, &str)) -> bool| pairs.iter().filter(|pair| is_it(pair)).count();
        let (is, found) = (
            count(&|pair| pair.0 == *name),
            count(&|pair| pair.1 == *name),
        );
        let hits = count(&|pair| pair.0 == *name && pair.1 == *name);
        NameScore {
            name: (*name).to_owned(),
            precision: Share::new(hits, found),
            recall: Share::new(hits, is),
            f1: 2.0 * hits as f64 / (is + found).max(1) as f64,
        }
    };
    let rows: Vec<NameScore> = names.iter().map(row).collect();
    let true_rows: Vec<&NameScore> = rows.iter().filter(|row| row.recall.of > 0).collect();
    let mean = true_rows.iter().map(|row| row.f1).sum::<f64>() / true_rows.len().max(1) as f64;
    (rows, mean)
}

impl Figures {
    /// Compares the answers with the truth.
    pub fn new(played: &[Played], answers: &BTreeMap<String, ReelAnswer>) -> Self {
        let none = ReelAnswer::default();
        let no_label = Label {
            class: "none".into(),
            sub_class: "none".into(),
        };
        let answer = |one: &Played| answers.get(&one.truth.episode_id).unwrap_or(&none);
        let failed: Vec<(&Played, &Failure, &ReelAnswer)> = played
            .iter()
            .filter_map(|one| Some((one, one.truth.failure.as_ref()?, answer(one))))
            .collect();
        let label =
            |answer: &'_ ReelAnswer| answer.label.clone().unwrap_or_else(|| no_label.clone());
        let found: Vec<Label> = failed.iter().map(|(.., answer)| label(answer)).collect();
        let pairs = |of: fn(&Label) -> &str| -> Vec<(&str, &str)> {
            failed
                .iter()
                .zip(&found)
                .map(|((_, failure, _), found)| (of(&failure.label), of(found)))
                .collect()
        };
        let (class_pairs, sub_pairs) =
            (pairs(|label| &label.class), pairs(|label| &label.sub_class));
        let (classes, class_macro_f1) = table(&class_pairs);
        let (sub_classes, sub_class_macro_f1) = table(&sub_pairs);
        // A fair alternative counts as the strict answer, so that how often each class is true
        // does not depend on the answers.
        let fair_pairs = |of: fn(&Label) -> &str, fits: fn(&Failure, &Label) -> bool| {
            let pair = |(failure, found)| match fits(failure, found) {
                true => (of(&failure.label), of(&failure.label)),
                false => (of(&failure.label), of(found)),
            };
            let failures = failed.iter().map(|(_, failure, _)| *failure);
            table(&failures.zip(&found).map(pair).collect::<Vec<_>>()).1
        };
        let class_macro_f1_fair = fair_pairs(|label| &label.class, is_fair_class);
        let sub_class_macro_f1_fair = fair_pairs(|label| &label.sub_class, is_fair);
        let n = failed.len();
        let count = |is_it: &dyn Fn(&Played, &Failure, &ReelAnswer) -> bool| {
            failed
                .iter()
                .filter(|(one, failure, answer)| is_it(one, failure, answer))
                .count()
        };
        let mut shares = BTreeMap::new();
        let equal =
            |pairs: &[(&str, &str)]| pairs.iter().filter(|(truth, found)| truth == found).count();
        shares.insert("class, strict", Share::new(equal(&class_pairs), n));
        shares.insert("sub-class, strict", Share::new(equal(&sub_pairs), n));
        let fair_class = count(&|_, failure, answer| is_fair_class(failure, &label(answer)));
        shares.insert("class, fair", Share::new(fair_class, n));
        shares.insert(
            "sub-class, fair",
            Share::new(
                count(&|_, failure, answer| is_fair(failure, &label(answer))),
                n,
            ),
        );
        let most = classes.iter().map(|row| row.recall.of).max().unwrap_or(0);
        shares.insert("class, baseline most frequent", Share::new(most, n));
        let most = sub_classes
            .iter()
            .map(|row| row.recall.of)
            .max()
            .unwrap_or(0);
        shares.insert("sub-class, baseline most frequent", Share::new(most, n));
        for (harm, [strict, fair, last, error, random]) in HarmKind::ALL.into_iter().zip(STEP_NAMES)
        {
            let of = count(&|_, failure, _| failure.harm == harm);
            let hits = |is_it: &dyn Fn(&Played, &Failure, &ReelAnswer) -> bool| {
                Share::new(
                    count(&|one, failure, answer| {
                        failure.harm == harm && is_it(one, failure, answer)
                    }),
                    of,
                )
            };
            let fairly = |failure: &Failure, step: Option<u32>| {
                step.is_some_and(|step| failure.fair_decisive.contains(&step))
            };
            shares.insert(
                strict,
                hits(&|_, failure, answer| {
                    answer.decisive.is_some() && failure.decisive == answer.decisive
                }),
            );
            shares.insert(
                fair,
                hits(&|_, failure, answer| fairly(failure, answer.decisive)),
            );
            shares.insert(
                last,
                hits(&|one, failure, _| fairly(failure, one.steps.checked_sub(1))),
            );
            shares.insert(
                error,
                hits(&|one, failure, _| fairly(failure, one.first_error)),
            );
            let draws = failed.iter().filter(|(_, failure, _)| failure.harm == harm);
            let expected: f64 = draws
                .map(|(one, failure, _)| {
                    failure.fair_decisive.len() as f64 / f64::from(one.steps.max(1))
                })
                .sum();
            shares.insert(random, Share::new(expected.round() as usize, of));
        }
        let successes: Vec<&Played> = played.iter().filter(|one| one.truth.success).collect();
        let explained = successes
            .iter()
            .filter(|one| answer(one).label.is_some() || answer(one).decisive.is_some());
        shares.insert(
            "successes explained away",
            Share::new(explained.count(), successes.len()),
        );
        let mut confusion: BTreeMap<String, BTreeMap<String, usize>> = BTreeMap::new();
        for (truth, found) in &sub_pairs {
            *confusion
                .entry((*truth).to_owned())
                .or_default()
                .entry((*found).to_owned())
                .or_default() += 1;
        }
        Self {
            episodes: played.len(),
            failures: n,
            unexplained_truth: played
                .iter()
                .filter(|one| !one.truth.success && one.truth.failure.is_none())
                .count(),
            class_macro_f1,
            class_macro_f1_fair,
            sub_class_macro_f1,
            sub_class_macro_f1_fair,
            shares,
            confusion,
            classes,
            sub_classes,
        }
    }

    /// The figures as people read them.
    pub fn text(&self) -> String {
        let mut text = format!(
            "{} episodes, {} failures with a cause, {} without one (not scored)\n",
            self.episodes, self.failures, self.unexplained_truth
        );
        for (what, rows, [mean, fair]) in [
            (
                "class",
                &self.classes,
                [self.class_macro_f1, self.class_macro_f1_fair],
            ),
            (
                "sub-class",
                &self.sub_classes,
                [self.sub_class_macro_f1, self.sub_class_macro_f1_fair],
            ),
        ] {
            let _ = writeln!(
                text,
                "\n{what:<20} macro-F1 {mean:.3}, with fair alternatives {fair:.3}"
            );
            for row in rows {
                let _ = writeln!(
                    text,
                    "  {:<20} F1 {:.3}  precision {}  recall {}",
                    row.name,
                    row.f1,
                    row.precision.text(),
                    row.recall.text()
                );
            }
        }
        text.push('\n');
        for (name, share) in &self.shares {
            let _ = writeln!(text, "{name:<40} {}", share.text());
        }
        text.push_str("\ntruth -> found\n");
        for (truth, row) in &self.confusion {
            let row: Vec<String> = row
                .iter()
                .map(|(found, count)| format!("{found} {count}"))
                .collect();
            let _ = writeln!(text, "  {truth:<20} {}", row.join(", "));
        }
        text
    }
}

const STEP_NAMES: [[&str; 5]; 3] = [
    [
        "step world, strict",
        "step world, fair",
        "step world, fair, baseline last call",
        "step world, fair, baseline first error",
        "step world, fair, baseline random",
    ],
    [
        "step ending, strict",
        "step ending, fair",
        "step ending, fair, baseline last call",
        "step ending, fair, baseline first error",
        "step ending, fair, baseline random",
    ],
    [
        "step time, strict",
        "step time, fair",
        "step time, fair, baseline last call",
        "step time, fair, baseline first error",
        "step time, fair, baseline random",
    ],
];

/// Prints up to `count` wrong answers, with truth and operators.
pub fn print_examples(played: &[Played], answers: &BTreeMap<String, ReelAnswer>, count: usize) {
    let mut shown = 0;
    for one in played {
        let (Some(failure), Some(answer)) =
            (&one.truth.failure, answers.get(&one.truth.episode_id))
        else {
            continue;
        };
        let label_is_right = answer
            .label
            .as_ref()
            .is_none_or(|label| is_fair(failure, label));
        let step_is_right = answer
            .decisive
            .is_some_and(|step| failure.fair_decisive.contains(&step));
        if shown >= count || (label_is_right && step_is_right) {
            continue;
        }
        shown += 1;
        let operators: Vec<&str> = one
            .truth
            .perturbation
            .operators
            .iter()
            .map(|one| one.kind.name())
            .collect();
        let found = answer.label.as_ref().map_or("-", |label| &label.sub_class);
        println!(
            "{}: operators {}; causes {:?}; truth {} at {:?} ({}, fair {:?}); found {found} at {:?}",
            one.trace.display(),
            operators.join(", "),
            failure.causes,
            failure.label.sub_class,
            failure.decisive,
            failure.harm.name(),
            failure.fair_decisive,
            answer.decisive
        );
    }
}
