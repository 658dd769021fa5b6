//! What a dataset says of itself to programs: `manifest.json` with every file's size and digest. No
//! clock, no host: same inputs, same bytes.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    path::{Path, PathBuf},
};

use reel_world::Digest;
use serde::Serialize;
use serde_json::Value;

use crate::{
    DatasetError, Example, Format, Leakage, Shard, Split, Style, TokenReport, WriterOptions,
};

/// The manifest's name in a dataset's folder.
pub const MANIFEST: &str = "manifest.json";
/// The file that is in the folder of a dataset as long as an export writes there: a folder with
/// it is not whole.
pub const UNFINISHED: &str = ".export.jsonl";

/// How many examples there are of each kind.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct Counts {
    /// Number of all examples in the dataset.
    pub examples: u64,
    /// Images that they show; the same one may be shown often.
    pub images: u64,
    /// Number of examples in each split: train, validation and test.
    pub splits: BTreeMap<Split, u64>,
    /// Number of examples of each task family, e.g. `FDP`.
    pub families: BTreeMap<String, u64>,
    /// By tool, in its name of the paper.
    pub tools: BTreeMap<String, u64>,
    /// Number of examples of each policy, by its name.
    pub policies: BTreeMap<String, u64>,
    /// Number of examples by replay verdict: `exact`, `exact_without_rgb` or `unverified`.
    pub verdicts: BTreeMap<String, u64>,
    /// Number of examples by annotator, e.g. `rules-1` or a model's name.
    pub annotators: BTreeMap<String, u64>,
}

impl Counts {
    /// Counts one more example in every category that it belongs to.
    pub fn add(&mut self, example: &Example) {
        let about = &example.about;
        self.examples += 1;
        self.images += example.images().count() as u64;
        *self.splits.entry(about.split).or_default() += 1;
        let kinds = [
            (&mut self.families, &about.family),
            (&mut self.tools, &example.tool),
            (&mut self.policies, &about.policy),
            (&mut self.verdicts, &about.source.verdict),
            (&mut self.annotators, &about.source.annotator),
        ];
        for (counts, kind) in kinds {
            *counts.entry(kind.clone()).or_default() += 1;
        }
    }
}

/// A file of a dataset.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct FileEntry {
    /// From the dataset's folder, with `/`.
    pub path: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// BLAKE3 digest of the file's bytes.
    pub blake3: Digest,
}

/// The template that prompts were made from.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct PromptTemplate {
    /// `reel` for the one that comes along, else the file's name.
    pub name: String,
    /// Of the template's bytes.
    pub blake3: Digest,
    /// The memory options that were on (`call_log`, `keep_view`).
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub memory: Vec<String>,
}

/// A dataset as programs read about it.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Manifest {
    /// What it is called.
    pub name: String,
    /// Format in which the rows are written.
    pub format: Format,
    /// How a decision is put.
    pub style: Style,
    /// The command that makes it again.
    pub command: String,
    /// How it was written.
    pub writer: WriterOptions,
    /// Everything else that was chosen, defaults too.
    pub options: Value,
    /// Version of the table it was read from.
    pub table_version: u64,
    /// Names the texts of the prompts: template, fixed sentences, system message.
    pub prompt_digest: Digest,
    /// The template of the prompts; `None` if the style has none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub prompt_template: Option<PromptTemplate>,
    /// Its licence, as an SPDX name or `other`.
    pub licence: String,
    /// How many of what.
    pub counts: Counts,
    /// The files of rows by part.
    pub shards: BTreeMap<Split, Vec<Shard>>,
    /// How long the examples are.
    pub tokens: Option<TokenReport>,
    /// What is in several parts.
    pub leakage: Vec<Leakage>,
    /// Why episodes and decisions were left out, and how many.
    pub excluded: BTreeMap<String, u64>,
    /// Every other file, sorted by path; filled by [`Manifest::write`].
    pub files: Vec<FileEntry>,
}

impl Manifest {
    /// Lists and digests all files under the folder, then writes the manifest there.
    ///
    /// # Errors
    /// When a file cannot be read or written.
    pub fn write(&mut self, root: &Path) -> Result<(), DatasetError> {
        self.files = files(root)?;
        let mut json = serde_json::to_vec_pretty(self).expect("a manifest has text keys only");
        json.push(b'\n');
        let path = root.join(MANIFEST);
        fs::write(&path, json).map_err(DatasetError::io(&path))
    }
}

/// Every file under a folder but the manifest and [`UNFINISHED`], sorted by path.
///
/// # Errors
/// When one cannot be read.
pub fn files(root: &Path) -> Result<Vec<FileEntry>, DatasetError> {
    let mut found = Vec::new();
    let mut folders: Vec<PathBuf> = vec![root.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).map_err(DatasetError::io(&folder))? {
            let path = entry.map_err(DatasetError::io(&folder))?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path != root.join(MANIFEST) && path != root.join(UNFINISHED) {
                found.push(entry_of(root, &path)?);
            }
        }
    }
    found.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(found)
}

fn entry_of(root: &Path, path: &Path) -> Result<FileEntry, DatasetError> {
    let (digest, bytes) = File::open(path)
        .and_then(Digest::of_reader)
        .map_err(DatasetError::io(path))?;
    let parts = path.strip_prefix(root).unwrap_or(path).components();
    let name = parts
        .map(|part| part.as_os_str().to_string_lossy())
        .collect::<Vec<_>>()
        .join("/");
    Ok(FileEntry {
        path: name,
        bytes,
        blake3: digest,
    })
}
