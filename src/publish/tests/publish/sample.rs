//! A small export as `reel export sft --format trl` lays it out.

use std::{collections::BTreeMap, fs, path::Path};

use reel_publish::{Check, Publication};
use serde_json::{Value, json};

/// The card of the sample, with this license.
pub fn card(license: &str) -> String {
    format!(
        "---\npretty_name: \"sample\"\nlicense: {license}\nconfigs:\n- config_name: default\n  data_files:\n  \
         - split: train\n    path: \"train/*.jsonl\"\n---\n\n# sample\n"
    )
}

/// A row whose trace has this verdict.
pub fn row(text: &str, verdict: &str) -> Value {
    json!({
        "prompt": text, "completion": "done", "images": ["images/a.png"],
        "provenance": { "trace_digest": "ab", "trace_uri": "traces/a.mcap", "verdict": verdict },
    })
}

/// Writes an export: two rows, an image, a card.
pub fn export(root: &Path) {
    for folder in ["train", "images"] {
        fs::create_dir_all(root.join(folder)).unwrap();
    }
    let rows = [row("one", "exact"), row("two", "exact")];
    let rows: String = rows.iter().map(|row| format!("{row}\n")).collect();
    fs::write(root.join("train/train-00000.jsonl"), rows).unwrap();
    let image: Vec<u8> = (0..5000_u32).map(|at| (at * at % 251) as u8).collect();
    fs::write(root.join("images/a.png"), image).unwrap();
    fs::write(root.join("README.md"), card("cc-by-4.0")).unwrap();
    list(root);
}

/// Writes the manifest of what is in the folder.
pub fn list(root: &Path) {
    let files = reel_dataset::files(root).unwrap();
    let listed = files.iter().filter(|file| !file.path.starts_with('.'));
    let listed: Vec<_> = listed.filter(|file| file.path != "SHA256SUMS").collect();
    let manifest = json!({ "name": "sample", "format": "trl", "leakage": [], "files": listed });
    fs::write(root.join("manifest.json"), manifest.to_string()).unwrap();
}

/// The folder as it would be published.
pub fn open(root: &Path) -> Publication {
    Publication::open(root, |_| ()).unwrap()
}

/// The problems of a folder as they are shown, of one check.
pub fn problems(root: &Path, check: Check) -> Vec<String> {
    let publication = open(root);
    let problems = publication.problems().kept_problems();
    problems
        .iter()
        .filter(|problem| problem.check == check)
        .map(ToString::to_string)
        .collect()
}

/// Every file of a folder by its path.
pub fn files(root: &Path) -> BTreeMap<String, Vec<u8>> {
    let files = reel_dataset::files(root).unwrap();
    let manifest = "manifest.json".to_owned();
    let paths = files.into_iter().map(|file| file.path).chain([manifest]);
    paths
        .map(|path| (path.clone(), fs::read(root.join(path)).unwrap()))
        .collect()
}
