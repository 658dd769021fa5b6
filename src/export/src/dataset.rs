//! The Parquet file: columns by Polars, and the metadata by which Hugging Face `datasets` decodes the images by itself.

use std::{fs::File, path::Path};

use polars_core::prelude::{BinaryChunked, Column, DataFrame, IntoSeries, NamedFrom, NewChunkedArray, Series, StructChunked};
use polars_io::parquet::write::{BatchedWriter, KeyValueMetadata, ParquetCompression, ParquetWriter};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde_json::{Value, json};

use crate::{ExportError, Row, prompt_digest};

/// Writes rows batch by batch.
pub(crate) struct Writer {
    writer: BatchedWriter<File>,
}

impl Writer {
    pub(crate) fn create(path: &Path) -> Result<Self, ExportError> {
        let file = File::create(path).map_err(|source| ExportError::Io { source, path: path.to_path_buf() })?;
        let metadata = KeyValueMetadata::from_static(vec![("huggingface".to_owned(), features().to_string())]);
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

/// A picture of the head camera as PNG.
///
/// # Panics
/// When the buffer is no picture of the head camera; the trace's reader gives no other.
pub(crate) fn png(rgb: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, FRAME_WIDTH as u32, FRAME_HEIGHT as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_compression(png::Compression::Fast);
    let mut writer = encoder.write_header().expect("writing to memory does not fail");
    writer.write_image_data(rgb).expect("the picture has the camera's size");
    writer.finish().expect("writing to memory does not fail");
    bytes
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

/// Types of every column for `datasets`; lists in the plain form, which its older versions read too.
fn features() -> Value {
    let value = |dtype: &str| json!({ "dtype": dtype, "_type": "Value" });
    json!({ "info": { "features": {
        "episode_id": value("string"),
        "task_id": value("string"),
        "step": value("int32"),
        "trace_uri": value("string"),
        "trace_digest": value("string"),
        "preset": value("string"),
        "prompt_digest": value("string"),
        "messages": [{ "role": value("string"), "content": value("string") }],
        "images": [{ "_type": "Image" }],
    } } })
}
