//! Near-duplicates in a planted set: how many of the pairs are found, and how many that
//! are found were planted.

use std::collections::BTreeSet;

use reel_dataset::lint::{LintOptions, lint};
use serde_json::{Value, json};

use super::{Folder, open};

const WORDS: [&str; 40] = [
    "cup", "table", "red", "walk", "shelf", "door", "blue", "lamp", "pick", "salt", "desk",
    "bring", "green", "box", "room", "left", "right", "under", "near", "bottle", "open", "plate",
    "small", "large", "metal", "wooden", "towel", "fork", "chair", "window", "kitchen", "basket",
    "yellow", "round", "square", "paper", "glass", "remote", "pillow", "mirror",
];
/// Words of a text.
const LENGTH: usize = 150;
const ORIGINALS: usize = 600;

/// A small generator, so that the set is the same everywhere.
struct Numbers(u64);

impl Numbers {
    fn below(&mut self, bound: usize) -> usize {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % bound
    }

    fn words(&mut self) -> Vec<&'static str> {
        (0..LENGTH)
            .map(|_| WORDS[self.below(WORDS.len())])
            .collect()
    }
}

fn row(words: &[&str]) -> Value {
    let task = format!(
        "You are a household robot.\nTask: {}\nAnswer in one word.",
        words.join(" ")
    );
    json!({ "prompt": task, "completion": "yes" })
}

/// Precision and recall where near-duplicates have so many words otherwise.
fn precision_and_recall(other_words: usize) -> (f64, f64) {
    let mut numbers = Numbers(7);
    let originals: Vec<Vec<&str>> = (0..ORIGINALS).map(|_| numbers.words()).collect();
    let mut rows: Vec<Value> = originals.iter().map(|words| row(words)).collect();
    // Every third has a near-duplicate, every fourth of the others a text that shares
    // half of its words.
    let mut planted = BTreeSet::new();
    for (number, words) in originals.iter().enumerate() {
        if number % 3 == 0 {
            let mut near = words.clone();
            (0..other_words).for_each(|_| near[numbers.below(LENGTH)] = "elsewhere");
            planted.insert((rows.len() as u64, number as u64));
            rows.push(row(&near));
        } else if number % 4 == 0 {
            rows.push(row(
                &[&words[..LENGTH / 2], &numbers.words()[LENGTH / 2..]].concat()
            ));
        }
    }
    let folder = Folder::new();
    let dataset = open(&folder.lines("rows.jsonl", &rows));
    let options = LintOptions {
        examples_max: usize::MAX,
        ..LintOptions::default()
    };
    let report = lint(&dataset, &options, |_| ());
    let near = report.check("near-duplicates").expect("it is there");
    let found: BTreeSet<(u64, u64)> = near
        .examples
        .iter()
        .map(|it| (it.examples[0].index, it.examples[1].index))
        .collect();
    let hits = found.intersection(&planted).count() as f64;
    let (precision, recall) = (
        hits / found.len().max(1) as f64,
        hits / planted.len() as f64,
    );
    eprintln!(
        "{other_words} of {LENGTH} words otherwise: {} planted, precision {precision:.3}, recall {recall:.3}",
        planted.len()
    );
    (precision, recall)
}

#[test]
fn planted_pairs_are_found_and_little_else() {
    // One word otherwise is a similarity of 0.96, two are 0.92, ten are 0.67; the threshold is 0.9.
    let (precision, recall) = precision_and_recall(1);
    assert!(
        precision >= 0.99 && recall >= 0.97,
        "precision {precision}, recall {recall}"
    );
    let (precision, recall) = precision_and_recall(2);
    assert!(
        precision >= 0.99 && recall >= 0.7,
        "precision {precision}, recall {recall}"
    );
    let (_, recall) = precision_and_recall(10);
    assert!(recall <= 0.01, "recall {recall} of what is not near");
}

#[test]
fn steps_of_one_episode_are_not_compared() {
    let folder = Folder::new();
    let words = Numbers(3).words();
    let step = |episode: &str, last: &str| {
        let mut row = row(&[&words[..], &[last]].concat());
        row["episode_id"] = episode.into();
        row
    };
    let near = |rows: &[Value]| {
        let report = lint(
            &open(&folder.lines("rows.jsonl", rows)),
            &LintOptions::default(),
            |_| (),
        );
        report
            .check("near-duplicates")
            .expect("it is there")
            .findings
    };
    assert_eq!(near(&[step("a", "one"), step("a", "two")]), 0);
    assert_eq!(near(&[step("a", "one"), step("b", "two")]), 1);
}
