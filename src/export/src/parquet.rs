//! Rows as Hugging Face Parquet (docs/spec.md#dataset-formats, format vi): columns by Polars,
//! pictures inside, and the metadata by which `datasets` decodes them by itself. Owns the
//! columns; knows no store.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::BufWriter,
    path::{Path, PathBuf},
};

use arrow::datatypes::{DataType, Field, Fields, Schema};
use parquet::arrow::{ARROW_SCHEMA_META_KEY, encode_arrow_schema};
use polars_arrow::{array::ListArray, offset::Offsets};
use polars_core::prelude::{
    ArrayRef, BinaryChunked, Column, DataFrame, IntoSeries, NamedFrom, NewChunkedArray, PlSmallStr,
    Series, StructChunked,
};
use polars_io::parquet::write::{
    BatchedWriter, KeyValueMetadata, ParquetCompression, ParquetWriter,
};
use reel_dataset::{Example, ImageStore, Shard, Split};
use serde_json::{Map, Value, json};

use crate::ExportError;

/// The key under which `datasets` looks for the types.
const FEATURES_KEY: &str = "huggingface";

/// A column's name, and its value of an example.
type TextColumn = (&'static str, fn(&Example) -> &str);
type NumberColumn = (&'static str, fn(&Example) -> i64);

/// Columns of text, in order; numbers stand after them, messages and images at the end.
const TEXT_COLUMNS: [TextColumn; 16] = [
    ("example", |example| &example.id),
    ("episode_id", |example| &example.about.episode_id),
    ("task_id", |example| &example.about.task_id),
    ("family", |example| &example.about.family),
    ("scene_id", |example| &example.about.scene_id),
    ("policy", |example| &example.about.policy),
    ("tool", |example| &example.tool),
    ("trace_uri", |example| &example.about.source.trace_uri),
    ("trace_digest", |example| &example.about.source.trace_digest),
    ("verdict", |example| &example.about.source.verdict),
    ("verdict_sim_version", |example| {
        &example.about.source.verdict_sim_version
    }),
    ("preset", |example| &example.about.source.preset),
    ("preset_digest", |example| {
        &example.about.source.preset_digest
    }),
    ("rules_version", |example| {
        &example.about.source.rules_version
    }),
    ("annotator", |example| &example.about.source.annotator),
    ("tools", |example| {
        example.tools.as_ref().map_or("", |tools| tools.as_str())
    }),
];
const NUMBER_COLUMNS: [NumberColumn; 2] = [
    ("call", |example| example.call.into()),
    ("table_version", |example| {
        example.about.source.table_version as i64
    }),
];
/// Names the wording of the prompts.
const PROMPT_COLUMN: &str = "prompt_digest";

/// Rows of a row group, and pictures: what a reader decodes at a time.
const ROWS_PER_GROUP: usize = 1_024;
const PICTURES_PER_GROUP: usize = 512;

/// Writes the rows of one part into files of bounded size.
pub(crate) struct Shards {
    root: PathBuf,
    split: Split,
    rows_max: u64,
    open: Option<(BatchedWriter<BufWriter<File>>, Shard)>,
    /// The row group to come, and how many pictures are in it.
    pending: Vec<Example>,
    pending_pictures: usize,
    done: Vec<Shard>,
}

impl Shards {
    /// Files under `<root>/<split>/`, closed when they have so many rows or more: what is pushed
    /// at once stays together.
    pub fn new(root: &Path, split: Split, rows_max: u64) -> Self {
        Self {
            root: root.to_owned(),
            split,
            rows_max,
            open: None,
            pending: Vec::new(),
            pending_pictures: 0,
            done: Vec::new(),
        }
    }

    /// Closes the last file; the files in order.
    pub fn finish(mut self, pictures: &ImageStore) -> Result<Vec<Shard>, ExportError> {
        self.close(pictures)?;
        Ok(self.done)
    }

    /// Appends examples; their pictures have to be in the store.
    pub fn push(
        &mut self,
        mut examples: Vec<Example>,
        pictures: &ImageStore,
    ) -> Result<(), ExportError> {
        if examples.is_empty() {
            return Ok(());
        }
        let (_, shard) = match &mut self.open {
            Some(open) => open,
            None => {
                let open = self.start()?;
                self.open.insert(open)
            }
        };
        shard.rows += examples.len() as u64;
        let full = shard.rows >= self.rows_max;
        self.pending_pictures += examples.iter().flat_map(Example::images).count();
        self.pending.append(&mut examples);
        match full {
            true => self.close(pictures),
            false
                if self.pending.len() >= ROWS_PER_GROUP
                    || self.pending_pictures >= PICTURES_PER_GROUP =>
            {
                self.write_group(pictures)
            }
            false => Ok(()),
        }
    }

    fn write_group(&mut self, pictures: &ImageStore) -> Result<(), ExportError> {
        if let Some((writer, _)) = &mut self.open
            && !self.pending.is_empty()
        {
            writer.write_batch(&frame(&self.pending, Some(pictures))?)?;
            self.pending.clear();
            self.pending_pictures = 0;
        }
        Ok(())
    }

    fn close(&mut self, pictures: &ImageStore) -> Result<(), ExportError> {
        self.write_group(pictures)?;
        let Some((writer, shard)) = self.open.take() else {
            return Ok(());
        };
        // what is in the buffer goes out with it
        writer.finish()?;
        drop(writer);
        let path = self.root.join(&shard.path);
        fs::rename(path.with_added_extension("part"), &path)
            .map_err(|source| ExportError::Io { source, path })?;
        self.done.push(shard);
        Ok(())
    }

    fn start(&self) -> Result<(BatchedWriter<BufWriter<File>>, Shard), ExportError> {
        let split = self.split.as_str();
        let shard = Shard {
            path: format!("{split}/{split}-{:05}.parquet", self.done.len()),
            provenance: None,
            rows: 0,
        };
        let path = self.root.join(&shard.path).with_added_extension("part");
        let folder = path.parent().unwrap_or(&self.root);
        let file = fs::create_dir_all(folder)
            .and_then(|()| File::create(&path))
            .map_err(|source| ExportError::Io {
                source,
                path: path.clone(),
            })?;
        let metadata = KeyValueMetadata::from_static(metadata());
        let writer = ParquetWriter::new(BufWriter::new(file))
            .with_compression(ParquetCompression::Zstd(None))
            .with_key_value_metadata(Some(metadata));
        // a frame without rows tells the types
        Ok((writer.batched(frame(&[], None)?.schema())?, shard))
    }
}

fn frame(examples: &[Example], pictures: Option<&ImageStore>) -> Result<DataFrame, ExportError> {
    let mut columns: Vec<Column> = Vec::new();
    for (name, value) in TEXT_COLUMNS {
        columns.push(Column::new(
            name.into(),
            examples.iter().map(value).collect::<Vec<&str>>(),
        ));
    }
    for (name, value) in NUMBER_COLUMNS {
        columns.push(Column::new(
            name.into(),
            examples.iter().map(value).collect::<Vec<i64>>(),
        ));
    }
    let digests: Vec<&str> = examples
        .iter()
        .map(|example| example.about.prompt_digest.as_str())
        .collect();
    columns.push(Column::new(PROMPT_COLUMN.into(), digests));
    let messages: Vec<_> = examples.iter().map(Example::messages).collect();
    let (roles, contents): (Vec<&str>, Vec<&str>) = messages
        .iter()
        .flatten()
        .map(|(role, content)| (*role, content.as_ref()))
        .unzip();
    let said = [
        Series::new("role".into(), roles),
        Series::new("content".into(), contents),
    ];
    columns.push(lists("messages", messages.iter().map(Vec::len), &said)?);
    let (mut bytes, mut paths): (Vec<Vec<u8>>, Vec<String>) = Default::default();
    for example in examples {
        for image in example.images() {
            let Some((pictures, picture)) =
                pictures.and_then(|pictures| Some((pictures, pictures.get(image)?)))
            else {
                return Err(reel_dataset::DatasetError::Image {
                    example: example.id.clone(),
                    image: *image,
                }
                .into());
            };
            bytes.push(pictures.bytes(&picture)?);
            paths.push(picture.path);
        }
    }
    let bytes = BinaryChunked::from_slice(
        "bytes".into(),
        &bytes.iter().map(Vec::as_slice).collect::<Vec<_>>(),
    );
    let shown = [bytes.into_series(), Series::new("path".into(), paths)];
    columns.push(lists(
        "images",
        examples.iter().map(|example| example.images().count()),
        &shown,
    )?);
    Ok(DataFrame::new(examples.len(), columns)?)
}

/// A column of lists of structs, of the fields of all lists one after the other.
fn lists(
    name: &str,
    lengths: impl Iterator<Item = usize>,
    fields: &[Series],
) -> Result<Column, ExportError> {
    let length = fields.first().map_or(0, |field| field.len());
    let items = StructChunked::from_series("".into(), length, fields.iter())?
        .into_series()
        .rechunk()
        .chunks()[0]
        .clone();
    let kind = ListArray::<i64>::default_datatype(items.dtype().clone());
    let offsets: Offsets<i64> = Offsets::try_from_lengths(lengths)?;
    let list: ArrayRef = Box::new(ListArray::try_new(kind, offsets.into(), items, None)?);
    Ok(Series::try_from((PlSmallStr::from(name), list))?.into())
}

/// What the file says of itself. Readers through Arrow take the types and the metadata from the
/// schema that is stored in the file, so it must hold the features too; Polars' own would say
/// `string_view`, which older readers do not know.
fn metadata() -> Vec<(String, String)> {
    let features = features().to_string();
    let text = |name: &str| Field::new(name, DataType::Utf8, true);
    let list = |name: &str, fields: Vec<Field>| {
        Field::new_list(
            name,
            Field::new("element", DataType::Struct(Fields::from(fields)), true),
            true,
        )
    };
    let mut columns: Vec<Field> = TEXT_COLUMNS.iter().map(|(name, _)| text(name)).collect();
    columns.extend(
        NUMBER_COLUMNS
            .iter()
            .map(|(name, _)| Field::new(*name, DataType::Int64, true)),
    );
    columns.push(text(PROMPT_COLUMN));
    columns.push(list("messages", vec![text("role"), text("content")]));
    columns.push(list(
        "images",
        vec![Field::new("bytes", DataType::Binary, true), text("path")],
    ));
    let schema = Schema::new(columns)
        .with_metadata(HashMap::from([(FEATURES_KEY.to_owned(), features.clone())]));
    vec![
        (FEATURES_KEY.to_owned(), features),
        (
            ARROW_SCHEMA_META_KEY.to_owned(),
            encode_arrow_schema(&schema),
        ),
    ]
}

/// Types of every column for `datasets`; lists in the plain form, which its
/// older versions read too.
fn features() -> Value {
    let value = |dtype: &str| json!({ "dtype": dtype, "_type": "Value" });
    let mut features: Map<String, Value> = TEXT_COLUMNS
        .iter()
        .map(|(name, _)| ((*name).to_owned(), value("string")))
        .collect();
    features.extend(
        NUMBER_COLUMNS
            .iter()
            .map(|(name, _)| ((*name).to_owned(), value("int64"))),
    );
    features.insert(PROMPT_COLUMN.into(), value("string"));
    features.insert(
        "messages".into(),
        json!([{ "role": value("string"), "content": value("string") }]),
    );
    features.insert("images".into(), json!([{ "_type": "Image" }]));
    json!({ "info": { "features": features } })
}
