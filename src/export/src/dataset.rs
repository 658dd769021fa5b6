//! The Parquet file: columns by Polars, and the metadata by which Hugging Face `datasets` decodes the images by itself.

use std::{collections::HashMap, fs::File, path::Path};

use arrow::datatypes::{DataType, Field, Fields, Schema};
use parquet::arrow::{ARROW_SCHEMA_META_KEY, encode_arrow_schema};
use polars_core::prelude::{BinaryChunked, Column, DataFrame, IntoSeries, NamedFrom, NewChunkedArray, Series, StructChunked};
use polars_io::parquet::write::{BatchedWriter, KeyValueMetadata, ParquetCompression, ParquetWriter};
use serde_json::{Map, Value, json};

use crate::{ExportError, Row, prompt_digest};

/// The key under which `datasets` looks for the types.
const FEATURES_KEY: &str = "huggingface";
/// Columns of text, in order; `step` stands after the second, messages and images after the last.
const TEXT_COLUMNS: [&str; 6] = ["episode_id", "task_id", "trace_uri", "trace_digest", "preset", "prompt_digest"];

/// Writes rows batch by batch.
pub(crate) struct Writer {
    writer: BatchedWriter<File>,
}

impl Writer {
    pub(crate) fn create(path: &Path) -> Result<Self, ExportError> {
        let file = File::create(path).map_err(|source| ExportError::Io { source, path: path.to_path_buf() })?;
        let metadata = KeyValueMetadata::from_static(metadata());
        let writer =
            ParquetWriter::new(file).with_compression(ParquetCompression::Zstd(None)).with_key_value_metadata(Some(metadata));
        // A frame of one row tells the types; it is not written.
        let sample = Row {
            episode_id: String::new(),
            task_id: String::new(),
            step: 0,
            trace_uri: String::new(),
            trace_digest: String::new(),
            preset: String::new(),
            messages: vec![("system", String::new())],
            images: vec![(String::new(), Vec::new())],
        };
        Ok(Self { writer: writer.batched(frame(&[sample])?.schema())? })
    }

    pub(crate) fn write(&mut self, rows: &[Row]) -> Result<(), ExportError> {
        if !rows.is_empty() {
            self.writer.write_batch(&frame(rows)?)?;
        }
        Ok(())
    }

    pub(crate) fn finish(self) -> Result<(), ExportError> {
        self.writer.finish()?;
        Ok(())
    }
}

fn frame(rows: &[Row]) -> Result<DataFrame, ExportError> {
    let text = |name: &str, value: fn(&Row) -> &str| Column::new(name.into(), rows.iter().map(value).collect::<Vec<_>>());
    let messages = rows.iter().map(|row| {
        let roles: Vec<&str> = row.messages.iter().map(|(role, _)| *role).collect();
        let contents: Vec<&str> = row.messages.iter().map(|(_, content)| content.as_str()).collect();
        fields(roles.len(), &[Series::new("role".into(), roles), Series::new("content".into(), contents)])
    });
    let images = rows.iter().map(|row| {
        let bytes =
            BinaryChunked::from_slice("bytes".into(), &row.images.iter().map(|(_, png)| png.as_slice()).collect::<Vec<_>>());
        let names: Vec<&str> = row.images.iter().map(|(name, _)| name.as_str()).collect();
        fields(names.len(), &[bytes.into_series(), Series::new("path".into(), names)])
    });
    let digest = prompt_digest().to_string();
    let columns = vec![
        text("episode_id", |row| &row.episode_id),
        text("task_id", |row| &row.task_id),
        Column::new("step".into(), rows.iter().map(|row| row.step as i32).collect::<Vec<_>>()),
        text("trace_uri", |row| &row.trace_uri),
        text("trace_digest", |row| &row.trace_digest),
        text("preset", |row| &row.preset),
        Column::new("prompt_digest".into(), vec![digest.as_str(); rows.len()]),
        Column::new("messages".into(), messages.collect::<Result<Vec<_>, _>>()?),
        Column::new("images".into(), images.collect::<Result<Vec<_>, _>>()?),
    ];
    Ok(DataFrame::new(rows.len(), columns)?)
}

fn fields(length: usize, fields: &[Series]) -> Result<Series, ExportError> {
    Ok(StructChunked::from_series("".into(), length, fields.iter())?.into_series())
}

/// What the file says of itself. Readers through Arrow take the types and the metadata from the schema that is stored in the
/// file, so it must hold the features too; Polars' own would say `string_view`, which older readers do not know.
fn metadata() -> Vec<(String, String)> {
    let features = features().to_string();
    let text = |name: &str| Field::new(name, DataType::Utf8, true);
    let list = |name: &str, fields: Vec<Field>| {
        Field::new_list(name, Field::new("element", DataType::Struct(Fields::from(fields)), true), true)
    };
    let mut columns: Vec<Field> = TEXT_COLUMNS.map(text).into();
    columns.insert(2, Field::new("step", DataType::Int32, true));
    columns.push(list("messages", vec![text("role"), text("content")]));
    columns.push(list("images", vec![Field::new("bytes", DataType::Binary, true), text("path")]));
    let schema = Schema::new(columns).with_metadata(HashMap::from([(FEATURES_KEY.to_owned(), features.clone())]));
    vec![(FEATURES_KEY.to_owned(), features), (ARROW_SCHEMA_META_KEY.to_owned(), encode_arrow_schema(&schema))]
}

/// Types of every column for `datasets`; lists in the plain form, which its older versions read too.
fn features() -> Value {
    let value = |dtype: &str| json!({ "dtype": dtype, "_type": "Value" });
    let mut features: Map<String, Value> = TEXT_COLUMNS.iter().map(|name| ((*name).to_owned(), value("string"))).collect();
    features.insert("step".into(), value("int32"));
    features.insert("messages".into(), json!([{ "role": value("string"), "content": value("string") }]));
    features.insert("images".into(), json!([{ "_type": "Image" }]));
    json!({ "info": { "features": features } })
}
