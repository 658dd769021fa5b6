//! A dataset in the making: examples in, a folder out with rows, images, card and manifest. Puts
//! the parts of this crate together; what is in it is the caller's choice.
//! [`DatasetWriter::prepare`] may run in many threads, [`DatasetWriter::push`] runs in the order
//! that the files shall have.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_prompt::Prompt;
use serde::Serialize;
use serde_json::Value;

use crate::{
    BytesOverFour, CONTEXT_TOKENS, Counts, DatasetError, EpisodeInfo, Example, Format,
    ImageOptions, ImageStore, LeakageCheck, Manifest, PromptTemplate, QWEN3_VL_SIDE, Shard, Shards,
    Split, Style, TokenCount, TokenCounter, TokenReport, Tokenizer, card::write_card,
};

/// How a dataset is written.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub struct WriterOptions {
    /// The format of its rows.
    pub format: Format,
    /// What is made of images.
    pub images: ImageOptions,
    /// Most rows in a file.
    pub rows_max: u64,
    /// Side of an image's token, in pixels (see [`crate::image_tokens`]).
    pub image_side: u32,
    /// The context of training, in tokens.
    pub budget: u32,
}

impl WriterOptions {
    /// The defaults with a format.
    pub fn new(format: Format) -> Self {
        Self {
            format,
            images: ImageOptions::default(),
            rows_max: 10_000,
            image_side: QWEN3_VL_SIDE,
            budget: CONTEXT_TOKENS,
        }
    }
}

/// What the caller knows of a dataset, for its card and manifest.
#[derive(Clone, PartialEq, Debug)]
pub struct Description {
    /// What it is called; letters, digits, `-` and `_` are safe with every loader.
    pub name: String,
    /// How a decision is put.
    pub style: Style,
    /// What single turns were put by.
    pub prompt: Arc<Prompt>,
    /// The command that makes it again.
    pub command: String,
    /// Everything that was chosen, defaults too.
    pub options: Value,
    /// Version of the table it was read from.
    pub table_version: u64,
    /// Its licence, as an SPDX name or `other`.
    pub licence: String,
}

/// An example as its row, ready to be pushed.
pub struct PreparedRow {
    row: Result<Vec<u8>, &'static str>,
    provenance: Vec<u8>,
    tokens: TokenCount,
}

/// Where images lie: beside the rows that name them; for a while elsewhere if the rows hold them.
fn frame_root(root: &Path, format: Format) -> PathBuf {
    if format.embeds_images() {
        root.join(".images")
    } else {
        root.to_owned()
    }
}

/// Writes one dataset: images, shards of rows, dataset card and manifest.
pub struct DatasetWriter {
    root: PathBuf,
    options: WriterOptions,
    tokenizer: Box<dyn Tokenizer>,
    frames: ImageStore,
    shards: BTreeMap<Split, Shards>,
    counts: Counts,
    tokens: TokenReport,
    leakage: LeakageCheck,
    /// The episode of the last example.
    noted: Option<Arc<EpisodeInfo>>,
    excluded: BTreeMap<String, u64>,
}

impl DatasetWriter {
    /// A dataset in a folder, which should be empty. Counts tokens by a rule of thumb.
    pub fn new(root: &Path, options: WriterOptions) -> Self {
        Self::with_tokenizer(root, options, Box::new(BytesOverFour))
    }

    /// A dataset whose tokens a given tokenizer counts.
    pub fn with_tokenizer(
        root: &Path,
        options: WriterOptions,
        tokenizer: Box<dyn Tokenizer>,
    ) -> Self {
        let tokens = TokenReport::new(tokenizer.as_ref(), options.image_side, options.budget);
        Self {
            root: root.to_owned(),
            options,
            tokenizer,
            frames: ImageStore::new(&frame_root(root, options.format), options.images),
            shards: BTreeMap::new(),
            counts: Counts::default(),
            tokens,
            leakage: LeakageCheck::default(),
            noted: None,
            excluded: BTreeMap::new(),
        }
    }

    /// Its images: put those of an example before it is prepared.
    pub fn images(&self) -> &ImageStore {
        &self.frames
    }

    /// Makes the rows of examples, best those of an episode at once. An example that the format
    /// cannot hold becomes one left out.
    ///
    /// # Errors
    /// When an image was not put before or cannot be read.
    pub fn prepare(&self, examples: &[Example]) -> Result<Vec<PreparedRow>, DatasetError> {
        let mut counter = TokenCounter::new(self.tokenizer.as_ref(), self.options.image_side);
        let prepare = |example: &Example| {
            let mut row = Vec::new();
            let row = match self
                .options
                .format
                .write_row(example, &self.frames, &mut row)
            {
                // its rows are no text: the caller writes them
                _ if self.options.format == Format::Parquet => Ok(row),
                Ok(()) => Ok(row),
                Err(DatasetError::UnsupportedFormat { reason, .. }) => Err(reason),
                Err(error) => return Err(error),
            };
            let mut provenance = Vec::new();
            if !self.options.format.holds_provenance() {
                example.provenance(&mut provenance);
            }
            Ok(PreparedRow {
                row,
                provenance,
                tokens: counter.count(example, |image| self.frames.get(image)),
            })
        };
        examples.iter().map(prepare).collect()
    }

    /// Appends examples with their rows, in this order.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn push(
        &mut self,
        examples: &[Example],
        prepared: &[PreparedRow],
    ) -> Result<(), DatasetError> {
        assert_eq!(examples.len(), prepared.len(), "every example has its row");
        for (example, prepared) in examples.iter().zip(prepared) {
            match &prepared.row {
                Err(reason) => self.count_skipped(reason, 1),
                Ok(_) if self.options.format == Format::Parquet => {
                    self.note(example, prepared.tokens)
                }
                Ok(row) => {
                    let (root, options, split) = (&self.root, &self.options, example.about.split);
                    let shards = self.shards.entry(split).or_insert_with(|| {
                        Shards::new(root, options.format, split, options.rows_max)
                    });
                    shards.push(row, &prepared.provenance)?;
                    self.note(example, prepared.tokens);
                }
            }
        }
        Ok(())
    }

    /// Takes in a file of rows that the caller wrote, as in Parquet, after those that are there.
    pub fn add_shard(&mut self, split: Split, shard: Shard) {
        let (root, options) = (&self.root, &self.options);
        let shards = self
            .shards
            .entry(split)
            .or_insert_with(|| Shards::new(root, options.format, split, options.rows_max));
        shards.keep(shard);
    }

    fn note(&mut self, example: &Example, tokens: TokenCount) {
        let about = &example.about;
        self.counts.add(example);
        self.tokens.add(tokens);
        // examples of an episode come one after the other
        if !self
            .noted
            .as_ref()
            .is_some_and(|noted| Arc::ptr_eq(noted, about))
        {
            for (what, key) in [
                ("task", &about.task_id),
                ("scene", &about.scene_id),
                ("instruction", &about.instruction),
            ] {
                self.leakage.add(what, key, about.split);
            }
            self.noted = Some(Arc::clone(about));
        }
        for frame in example.images().filter_map(|image| self.frames.get(image)) {
            self.leakage.add("image", &frame.path, about.split);
        }
    }

    /// Counts what the caller left out, and why.
    pub fn count_skipped(&mut self, reason: &str, count: u64) {
        *self.excluded.entry(reason.to_owned()).or_default() += count;
    }

    /// Closes the files, writes card and manifest.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn finish(self, description: Description) -> Result<Manifest, DatasetError> {
        let shards: Result<BTreeMap<_, _>, DatasetError> = self
            .shards
            .into_iter()
            .map(|(split, shards)| Ok((split, shards.finish()?)))
            .collect();
        let mut manifest = Manifest {
            name: description.name,
            format: self.options.format,
            style: description.style,
            command: description.command,
            writer: self.options,
            options: description.options,
            table_version: description.table_version,
            prompt_digest: description.prompt.digest(),
            prompt_template: (description.style == Style::SingleTurn).then(|| PromptTemplate {
                name: description.prompt.name().to_owned(),
                blake3: description.prompt.template_digest(),
                memory: description
                    .prompt
                    .memory()
                    .enabled()
                    .map(str::to_owned)
                    .collect(),
            }),
            licence: description.licence,
            counts: self.counts,
            shards: shards?,
            tokens: Some(self.tokens),
            leakage: self.leakage.found(),
            excluded: self.excluded,
            files: Vec::new(),
        };
        if self.options.format.embeds_images() {
            let loose = frame_root(&self.root, self.options.format);
            match fs::remove_dir_all(&loose) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(DatasetError::io(&loose)(error));
                }
                _ => {}
            }
        }
        write_card(&self.root, &manifest)?;
        manifest.write(&self.root)?;
        Ok(manifest)
    }
}
