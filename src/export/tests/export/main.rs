//! Training sets out of a store of played episodes: what a row holds, what is refused, equal
//! bytes, going on after a break, rollout groups, notes, and that the loaders get the frames
//! that are drawn again.

mod annotations;
mod buckets;
mod equal_bytes;
mod gspo;
mod loaders;
mod played;
mod refusals;
mod rollouts;
mod selection;

use std::{collections::BTreeMap, fs, path::Path};

use reel_dataset::{Format, Ratios, Style, WriterOptions};
use reel_export::{AnnotationSource, ExportOptions, ExportReport, Selection, SplitBy};
use reel_tables::Store;
use reel_vectors::episodes;
use serde_json::Value;

fn options(format: Format) -> ExportOptions {
    ExportOptions {
        selection: Selection::default(),
        writer: WriterOptions {
            rows_max: 20,
            ..WriterOptions::new(format)
        },
        style: Style::SingleTurn,
        prompt: reel_prompt::Prompt::builtin(),
        words: AnnotationSource::Auto,
        split_by: SplitBy::Task,
        ratios: Ratios::new([1.0, 0.0, 0.0]).unwrap(),
        images: false,
        allow_unverified: false,
        replay: true,
        rollouts: None,
        tokenizer: None,
        trace_base: None,
        name: "test".into(),
        licence: "MIT".into(),
        command: "reel export sft".into(),
    }
}

fn export(store: &Store, out: &Path, options: &ExportOptions) -> ExportReport {
    reel_export::export(store, out, options, &|_| (), &|_| ()).unwrap()
}

/// Every file of a folder with its bytes.
fn files(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(
                    path.strip_prefix(folder).unwrap().display().to_string(),
                    fs::read(&path).unwrap(),
                );
            }
        }
    }
    found
}

/// The rows of a part, each a line of JSON.
fn rows(folder: &Path, split: &str) -> Vec<Value> {
    let files = files(&folder.join(split));
    files
        .values()
        .flat_map(|bytes| {
            String::from_utf8(bytes.clone())
                .unwrap()
                .lines()
                .map(line)
                .collect::<Vec<_>>()
        })
        .collect()
}

fn line(text: &str) -> Value {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}
