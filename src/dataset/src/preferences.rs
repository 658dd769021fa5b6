//! What a folder of preference pairs says of itself: a card as Hugging Face reads it, and a manifest
//! with the digest of every file. The caller writes pairs and value targets; no clock.

use std::{fs, path::Path};

use serde_json::json;

use crate::{CARD, DatasetError, MANIFEST, card::size_category, files, json::quoted};

/// The file of the pairs in a dataset's folder.
pub const PREFERENCES: &str = "preferences.jsonl";
/// The file of the value targets in a dataset's folder.
pub const VALUES: &str = "values.jsonl";

/// What the caller knows of a folder of preference pairs.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PreferenceDescription {
    /// What the dataset is called.
    pub name: String,
    /// Its licence, as an SPDX name or `other`.
    pub licence: String,
    /// The command that makes it again.
    pub command: String,
    /// Number of pairs of a chosen and a rejected decision.
    pub pairs: u64,
    /// Number of value targets, one for each step.
    pub values: u64,
}

/// Writes the card, then the manifest, which digests all files of the folder.
///
/// # Errors
/// When a file cannot be read or written.
pub fn write_preference_card(
    root: &Path,
    description: &PreferenceDescription,
) -> Result<(), DatasetError> {
    let path = root.join(CARD);
    fs::write(&path, card(description)).map_err(DatasetError::io(&path))?;
    let manifest = json!({
        "name": description.name, "format": "preferences", "command": description.command,
        "licence": description.licence,
        "counts": { "pairs": description.pairs, "values": description.values },
        "files": files(root)?,
    });
    let path = root.join(MANIFEST);
    fs::write(&path, format!("{manifest:#}\n")).map_err(DatasetError::io(&path))
}

fn card(description: &PreferenceDescription) -> String {
    let PreferenceDescription {
        name,
        licence,
        command,
        pairs,
        values,
    } = description;
    let mut text = format!(
        "---\npretty_name: {}\nlicense: {}\nlanguage:\n- en\ntask_categories:\n- image-text-to-text\n- robotics\n\
         size_categories:\n- {}\ntags:\n- embodied-ai\n- tool-use\n- household\n- preference\n- dpo\nconfigs:\n",
        quoted(name),
        quoted(&licence.to_lowercase()),
        size_category(*pairs),
    );
    // a viewer fails on a file without rows
    for (config, file, rows) in [("default", PREFERENCES, pairs), ("values", VALUES, values)] {
        if *rows > 0 {
            text += &format!(
                "- config_name: {config}\n  data_files:\n  - split: train\n    path: {}\n",
                quoted(file)
            );
        }
    }
    text += &format!(
        "---\n\n# {name}\n\nDecisions of household agents that failed (`rejected`) beside what a competent agent that knew \
         the same would have called (`chosen`), in `{PREFERENCES}`: {pairs} pairs. `{VALUES}` has the cost-to-go of {values} \
         steps as value targets.\n\n## Provenance\n\nMade by\n\n```sh\n{command}\n```\n\nBoth decisions of a pair name their \
         trace (`trace_digest`), call and replay verdict in `provenance`; the traces of the chosen futures are in `traces/`. \
         `manifest.json` lists every file with its BLAKE3 digest.\n\n## Loading\n\n```python\nimport datasets\n\
         pairs = datasets.load_dataset(\"json\", data_files=\"{PREFERENCES}\", split=\"train\")\n```\n\n## Licence\n\n`{licence}`\n",
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_card_names_only_files_with_rows() {
        let mut description = PreferenceDescription {
            name: "a \"b\"".into(),
            licence: "MIT".into(),
            command: "reel export preferences".into(),
            pairs: 2,
            values: 0,
        };
        let text = card(&description);
        assert!(
            text.starts_with("---\npretty_name: \"a \\\"b\\\"\"\nlicense: \"mit\"\n"),
            "{text}"
        );
        assert!(
            text.contains("path: \"preferences.jsonl\"\n---\n"),
            "{text}"
        );
        description.values = 30;
        assert!(card(&description).contains("path: \"values.jsonl\"\n---\n"));
    }

    #[test]
    fn the_manifest_lists_the_files() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(PREFERENCES), "{}\n").unwrap();
        let description = PreferenceDescription {
            name: "a".into(),
            licence: "mit".into(),
            command: "reel export preferences".into(),
            pairs: 1,
            values: 0,
        };
        write_preference_card(folder.path(), &description).unwrap();
        let manifest = fs::read(folder.path().join(MANIFEST)).unwrap();
        let manifest: serde_json::Value = serde_json::from_slice(&manifest).unwrap();
        let paths: Vec<&str> = manifest["files"]
            .as_array()
            .unwrap()
            .iter()
            .filter_map(|file| file["path"].as_str())
            .collect();
        assert_eq!(paths, [CARD, PREFERENCES]);
        assert_eq!(manifest["licence"], "mit");
    }
}
