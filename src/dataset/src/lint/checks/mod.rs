//! The checks: each sees every row once and keeps as little as it can. [`lint`] runs them
//! all in one pass.
//!
//! Owns what is wrong and how bad it is. Never stops at a bad row.

mod answers;
mod balance;
mod duplicates;
mod history;
mod images;
mod label_noise;
mod leaks;
mod length;
mod loader;
mod near_duplicates;
mod published;
mod row_facts;
mod splits;
mod step_facts;

use std::sync::Arc;

use crate::{BytesOverFour, CONTEXT_TOKENS, QWEN3_VL_SIDE, Tokenizer};
use row_facts::{ImageProbes, RowFacts};

use crate::lint::{
    Dataset, Report, Severity,
    report::{FileReport, Findings},
};

/// What the checks go by.
#[derive(Clone, Debug)]
pub struct LintOptions {
    /// Budget of a context, in tokens.
    pub context_tokens_max: u64,
    /// Side of an image's token, in pixels: 28 for Qwen2-VL and Qwen2.5-VL, 32 for Qwen3-VL.
    pub image_side: u32,
    /// What counts the tokens of texts.
    pub tokenizer: Arc<dyn Tokenizer>,
    /// Similarity (Jaccard, of word triples) from which two rows are near-duplicates.
    pub similarity_min: f64,
    /// Rows back to which a row is compared for near-duplicates; sets the memory of that check
    /// (about 700 bytes a row).
    pub near_rows_max: usize,
    /// Share of the most frequent tool from which the tools are unbalanced.
    pub tool_share_max: f64,
    /// Findings of each kind that are kept as examples.
    pub examples_max: usize,
}

impl Default for LintOptions {
    fn default() -> Self {
        Self {
            context_tokens_max: CONTEXT_TOKENS.into(),
            image_side: QWEN3_VL_SIDE,
            tokenizer: Arc::new(BytesOverFour),
            similarity_min: 0.9,
            near_rows_max: 100_000,
            tool_share_max: 0.5,
            examples_max: 3,
        }
    }
}

/// A check: sees each row in turn, then finishes.
trait Check {
    /// Name and what it looks for.
    fn about(&self) -> (&'static str, &'static str);
    /// Checks one row and adds what is wrong to `found`.
    fn see(&mut self, seen: &RowFacts, found: &mut Findings);
    /// The end of the data.
    fn finish(&mut self, _found: &mut Findings) {}
}

/// Reads all rows once and checks them. `progress` is told the number of rows now and then.
pub fn lint(dataset: &Dataset, options: &LintOptions, mut progress: impl FnMut(u64)) -> Report {
    let findings = |about: (&'static str, &'static str)| {
        Findings::new(dataset, about.0, about.1, options.examples_max)
    };
    let mut unread = findings(("rows", "rows and files that cannot be read"));
    for (path, why) in dataset.skipped() {
        unread.add("file", Severity::Note, &[], || {
            (format!("{why} ({})", path.display()), String::new())
        });
    }
    let mut checks: Vec<(Box<dyn Check>, Findings)> = all(dataset, options)
        .into_iter()
        .map(|check| {
            let found = findings(check.about());
            (check, found)
        })
        .collect();
    let mut looks = ImageProbes::default();
    let (mut rows, mut unreadable) = (0_u64, 0_u64);
    for row in dataset.rows() {
        match row {
            Ok(example) => {
                rows += 1;
                let seen = RowFacts::new(&example, &mut looks);
                for (check, found) in &mut checks {
                    check.see(&seen, found);
                }
            }
            Err(error) => {
                unreadable += 1;
                let column = if error.column > 0 {
                    format!("column {}: ", error.column)
                } else {
                    String::new()
                };
                unread.add("row", Severity::Error, &[error.location], || {
                    (format!("{column}{}", error.message), String::new())
                });
            }
        }
        if (rows + unreadable).is_multiple_of(PROGRESS_ROWS) {
            progress(rows + unreadable);
        }
    }
    let mut reports = vec![unread.finish(rows + unreadable)];
    for (mut check, mut found) in checks {
        check.finish(&mut found);
        reports.push(found.finish(rows));
    }
    let files = dataset.files().iter().map(|file| FileReport {
        path: file.path.display().to_string(),
        format: file.format,
        split: file.split.clone(),
    });
    Report {
        files: files.collect(),
        rows,
        unreadable,
        checks: reports,
    }
}

/// Rows between two words of progress.
const PROGRESS_ROWS: u64 = 1000;

/// All checks, the most harmful first.
fn all(dataset: &Dataset, options: &LintOptions) -> Vec<Box<dyn Check>> {
    vec![
        Box::new(leaks::Leaks::new()),
        Box::new(loader::Loader::new(dataset)),
        Box::new(images::Images),
        Box::new(answers::Answers::default()),
        Box::new(published::Published::default()),
        Box::new(history::Histories::default()),
        Box::new(splits::Splits::default()),
        Box::new(label_noise::LabelNoise::default()),
        Box::new(duplicates::Duplicates::default()),
        Box::new(near_duplicates::NearDuplicates::new(
            options.similarity_min,
            options.near_rows_max,
        )),
        Box::new(length::Length::new(options)),
        Box::new(balance::Balance::new(options.tool_share_max)),
    ]
}
