//! Rows as Hugging Face Parquet (docs/spec.md#dataset-formats, format vi): the images are inside,
//! and the metadata by which `datasets` decodes them by itself. Owns the columns; knows no store.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::BufWriter,
    path::{Path, PathBuf},
    sync::Arc,
};

use ::parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    file::{metadata::KeyValue, properties::WriterProperties},
    schema::types::ColumnPath,
};
use arrow::{
    array::{ArrayRef, BinaryArray, Int64Array, ListArray, RecordBatch, StringArray, StructArray},
    buffer::OffsetBuffer,
    datatypes::{DataType, Field, Fields, Schema, SchemaRef},
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

/// Rows of a row group, and images: what a reader decodes at a time.
const ROWS_PER_GROUP: usize = 1_024;
const FRAMES_PER_GROUP: usize = 512;

/// Writes the rows of one part into files of bounded size.
pub(crate) struct Shards {
    root: PathBuf,
    split: Split,
    rows_max: u64,
    open: Option<(ArrowWriter<BufWriter<File>>, Shard)>,
    /// The row group to come, and how many images are in it.
    pending: Vec<Example>,
    pending_frames: usize,
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
            pending_frames: 0,
            done: Vec::new(),
        }
    }

    /// Closes the last file; the files in order.
    pub fn finish(mut self, frames: &ImageStore) -> Result<Vec<Shard>, ExportError> {
        self.close(frames)?;
        Ok(self.done)
    }

    /// Appends examples; their images have to be in the store.
    pub fn push(
        &mut self,
        mut examples: Vec<Example>,
        frames: &ImageStore,
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
        self.pending_frames += examples.iter().flat_map(Example::images).count();
        self.pending.append(&mut examples);
        match full {
            true => self.close(frames),
            false
                if self.pending.len() >= ROWS_PER_GROUP
                    || self.pending_frames >= FRAMES_PER_GROUP =>
            {
                self.write_group(frames)
            }
            false => Ok(()),
        }
    }

    fn write_group(&mut self, frames: &ImageStore) -> Result<(), ExportError> {
        if let Some((writer, _)) = &mut self.open
            && !self.pending.is_empty()
        {
            writer.write(&batch(schema(), &self.pending, frames)?)?;
            writer.flush()?;
            self.pending.clear();
            self.pending_frames = 0;
        }
        Ok(())
    }

    fn close(&mut self, frames: &ImageStore) -> Result<(), ExportError> {
        self.write_group(frames)?;
        let Some((writer, shard)) = self.open.take() else {
            return Ok(());
        };
        writer
            .into_inner()?
            .into_inner()
            .map_err(|error| ExportError::Io {
                source: error.into_error(),
                path: self.root.join(&shard.path),
            })?;
        let path = self.root.join(&shard.path);
        fs::rename(path.with_added_extension("part"), &path)
            .map_err(|source| ExportError::Io { source, path })?;
        self.done.push(shard);
        Ok(())
    }

    fn start(&self) -> Result<(ArrowWriter<BufWriter<File>>, Shard), ExportError> {
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
        let writer = ArrowWriter::try_new(BufWriter::new(file), schema(), Some(properties()?))?;
        Ok((writer, shard))
    }
}

/// Text is compressed; images are compressed already, and no two are alike.
fn properties() -> Result<WriterProperties, ExportError> {
    let features = KeyValue::new(FEATURES_KEY.to_owned(), features().to_string());
    let images = ColumnPath::from(
        ["images", "list", "element", "bytes"]
            .map(String::from)
            .to_vec(),
    );
    Ok(WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(3)?))
        .set_column_compression(images.clone(), Compression::UNCOMPRESSED)
        .set_column_dictionary_enabled(images, false)
        .set_key_value_metadata(Some(vec![features]))
        .build())
}

/// Columns as Arrow types. Its metadata holds the features, because `datasets` reads them from the
/// Arrow schema that is stored in the file.
fn schema() -> SchemaRef {
    let text = |name: &str| Field::new(name, DataType::Utf8, true);
    let mut columns: Vec<Field> = TEXT_COLUMNS.iter().map(|(name, _)| text(name)).collect();
    columns.extend(
        NUMBER_COLUMNS
            .iter()
            .map(|(name, _)| Field::new(*name, DataType::Int64, true)),
    );
    columns.push(text(PROMPT_COLUMN));
    columns.push(list("messages", [text("role"), text("content")]));
    columns.push(list(
        "images",
        [Field::new("bytes", DataType::Binary, true), text("path")],
    ));
    let metadata = HashMap::from([(FEATURES_KEY.to_owned(), features().to_string())]);
    Arc::new(Schema::new(columns).with_metadata(metadata))
}

fn list(name: &str, fields: [Field; 2]) -> Field {
    let element = Field::new(
        "element",
        DataType::Struct(Fields::from(fields.to_vec())),
        true,
    );
    Field::new_list(name, element, true)
}

fn batch(
    schema: SchemaRef,
    examples: &[Example],
    frames: &ImageStore,
) -> Result<RecordBatch, ExportError> {
    let text = |value: fn(&Example) -> &str| -> ArrayRef {
        Arc::new(StringArray::from_iter_values(examples.iter().map(value)))
    };
    let mut columns: Vec<ArrayRef> = TEXT_COLUMNS.iter().map(|(_, value)| text(*value)).collect();
    for (_, value) in NUMBER_COLUMNS {
        columns.push(Arc::new(Int64Array::from_iter_values(
            examples.iter().map(value),
        )));
    }
    columns.push(text(|example| &example.about.prompt_digest));
    let messages: Vec<_> = examples.iter().map(Example::messages).collect();
    let (roles, contents): (Vec<&str>, Vec<&str>) = messages
        .iter()
        .flatten()
        .map(|(role, content)| (*role, content.as_ref()))
        .unzip();
    let fields: Vec<ArrayRef> = vec![
        Arc::new(StringArray::from(roles)),
        Arc::new(StringArray::from(contents)),
    ];
    columns.push(lists(
        &schema,
        "messages",
        messages.iter().map(Vec::len),
        fields,
    )?);
    let (mut bytes, mut paths): (Vec<Vec<u8>>, Vec<String>) = Default::default();
    for example in examples {
        for image in example.images() {
            let frame = frames
                .get(image)
                .ok_or_else(|| reel_dataset::DatasetError::Image {
                    example: example.id.clone(),
                    image: *image,
                })?;
            bytes.push(frames.bytes(&frame)?);
            paths.push(frame.path);
        }
    }
    let fields: Vec<ArrayRef> = vec![
        Arc::new(BinaryArray::from_iter_values(bytes)),
        Arc::new(StringArray::from(paths)),
    ];
    let lengths = examples.iter().map(|example| example.images().count());
    columns.push(lists(&schema, "images", lengths, fields)?);
    Ok(RecordBatch::try_new(schema, columns)?)
}

/// A column of lists of structs; `fields` holds the items of all lists one after the other.
fn lists(
    schema: &Schema,
    name: &str,
    lengths: impl IntoIterator<Item = usize>,
    fields: Vec<ArrayRef>,
) -> Result<ArrayRef, ExportError> {
    let DataType::List(element) = schema.field_with_name(name)?.data_type() else {
        unreachable!("`schema` makes a list of '{name}'");
    };
    let DataType::Struct(types) = element.data_type() else {
        unreachable!("`schema` makes a list of structs of '{name}'");
    };
    let items = StructArray::try_new(types.clone(), fields, None)?;
    let offsets = OffsetBuffer::from_lengths(lengths);
    Ok(Arc::new(ListArray::try_new(
        element.clone(),
        offsets,
        Arc::new(items),
        None,
    )?))
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
