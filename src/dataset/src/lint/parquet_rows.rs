//! Rows of Parquet files, images apart from the rest so that their bytes are
//! never turned into text.
//!
//! Holds one small batch at a time.

use std::{fs::File, path::Path, vec};

use arrow::{
    array::{Array, ArrayRef, AsArray, RecordBatch},
    datatypes::DataType,
    json::ArrayWriter,
};
use parquet::arrow::arrow_reader::{
    ArrowReaderOptions, ParquetRecordBatchReader, ParquetRecordBatchReaderBuilder,
};
use serde_json::{Map, Value};

use crate::lint::{Image, ImageSource, LintError, example::FormatWarning, formats::format_warning};

/// Rows in memory at a time: images are large.
const BATCH_ROWS: usize = 64;

/// A row as JSON, and the images that the file holds.
pub(crate) struct ParquetRow {
    pub(crate) fields: Map<String, Value>,
    pub(crate) images: Option<Vec<Image>>,
}

/// The rows of a Parquet file.
pub(crate) struct ParquetRows {
    batches: ParquetRecordBatchReader,
    rows: vec::IntoIter<ParquetRow>,
    read: u32,
    over: bool,
}

impl ParquetRows {
    pub(crate) fn open(path: &Path) -> Result<Self, LintError> {
        let batches = builder(path)?.with_batch_size(BATCH_ROWS).build();
        let batches = batches.map_err(|source| LintError::Parquet {
            path: path.to_owned(),
            source,
        })?;
        Ok(Self {
            batches,
            rows: Vec::new().into_iter(),
            read: 0,
            over: false,
        })
    }

    /// Number of the next row, from 1.
    pub(crate) fn number(&self) -> u32 {
        self.read.saturating_add(1)
    }
}

impl Iterator for ParquetRows {
    type Item = Result<ParquetRow, String>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(row) = self.rows.next() {
                self.read = self.read.saturating_add(1);
                return Some(Ok(row));
            }
            if self.over {
                return None;
            }
            let rows = match self.batches.next()? {
                Ok(batch) => rows_of(&batch),
                Err(error) => Err(error.to_string()),
            };
            match rows {
                Ok(rows) => self.rows = rows.into_iter(),
                Err(error) => {
                    self.over = true;
                    return Some(Err(format!(
                        "the rows from here on cannot be read: {error}"
                    )));
                }
            }
        }
    }
}

/// What `datasets` would not tell about the file's schema.
pub(crate) fn schema_notes(path: &Path) -> Result<Vec<FormatWarning>, LintError> {
    let builder = builder(path)?;
    let schema = builder.schema();
    let frames: Vec<&str> = schema
        .fields()
        .iter()
        .filter(|field| is_frames(field.data_type()))
        .map(|field| field.name().as_str())
        .collect();
    let mut notes = Vec::new();
    let features = features(&builder);
    if let Some(features) = &features {
        let missing: Vec<&str> = schema
            .fields()
            .iter()
            .map(|field| field.name().as_str())
            .filter(|name| !features.contains_key(*name))
            .collect();
        if !missing.is_empty() {
            let names = missing.join(", ");
            notes.push(format_warning(
                "features",
                true,
                format!("the `huggingface` metadata does not name the columns {names}: datasets refuses the file"),
            ));
        }
        if features
            .values()
            .any(|feature| feature.to_string().contains(r#""_type":"List""#))
        {
            notes.push(format_warning(
                "features",
                true,
                "a feature in the `List` form: datasets 3 fails on it; the plain form [..] loads everywhere",
            ));
        }
    }
    for name in frames {
        let decoded = features
            .as_ref()
            .and_then(|it| it.get(name))
            .is_some_and(|it| it.to_string().contains(r#""_type":"Image""#));
        if !decoded {
            let told = format!(
                "`{name}` holds images, but no `huggingface` metadata declares them: datasets returns raw bytes"
            );
            notes.push(format_warning("features", false, told));
        }
    }
    Ok(notes)
}

fn builder(path: &Path) -> Result<ParquetRecordBatchReaderBuilder<File>, LintError> {
    let file = File::open(path).map_err(|source| LintError::Io {
        path: path.to_owned(),
        source,
    })?;
    // The Arrow schema that writers store beside Parquet's own is not needed, and reading a damaged
    // one panics.
    let options = ArrowReaderOptions::new().with_skip_arrow_metadata(true);
    ParquetRecordBatchReaderBuilder::try_new_with_options(file, options).map_err(|source| {
        LintError::Parquet {
            path: path.to_owned(),
            source,
        }
    })
}

fn features(builder: &ParquetRecordBatchReaderBuilder<File>) -> Option<Map<String, Value>> {
    let entries = builder.metadata().file_metadata().key_value_metadata()?;
    let text = entries.iter().find(|entry| entry.key == "huggingface")?;
    let metadata: Value = serde_json::from_str(text.value.as_deref()?).ok()?;
    metadata.get("info")?.get("features")?.as_object().cloned()
}

fn is_frame(kind: &DataType) -> bool {
    let bytes = |kind: &DataType| {
        matches!(
            kind,
            DataType::Binary | DataType::LargeBinary | DataType::BinaryView
        )
    };
    matches!(kind, DataType::Struct(fields) if fields.iter().any(|field| field.name() == "bytes" && bytes(field.data_type())))
        || bytes(kind)
}

fn is_frames(kind: &DataType) -> bool {
    match kind {
        DataType::List(item) | DataType::LargeList(item) => is_frame(item.data_type()),
        other => is_frame(other),
    }
}

fn rows_of(batch: &RecordBatch) -> Result<Vec<ParquetRow>, String> {
    let is_column = |index: &usize| is_frames(batch.column(*index).data_type());
    let (frames, others): (Vec<usize>, Vec<usize>) = (0..batch.num_columns()).partition(is_column);
    let others = batch.project(&others).map_err(|error| error.to_string())?;
    let mut writer = ArrayWriter::new(Vec::new());
    writer
        .write(&others)
        .and_then(|()| writer.finish())
        .map_err(|error| error.to_string())?;
    let json = writer.into_inner();
    // A file of images alone writes no rows of JSON.
    let fields: Vec<Map<String, Value>> = if json.is_empty() {
        Vec::new()
    } else {
        serde_json::from_slice(&json).map_err(|error| error.to_string())?
    };
    let rows = fields.into_iter().enumerate().map(|(row, fields)| {
        let images = frames
            .iter()
            .flat_map(|index| images_of(batch.column(*index), row))
            .collect();
        ParquetRow {
            fields,
            images: (!frames.is_empty()).then_some(images),
        }
    });
    Ok(rows.collect())
}

fn images_of(column: &ArrayRef, row: usize) -> Vec<Image> {
    if column.is_null(row) {
        return Vec::new();
    }
    let items = match column.data_type() {
        DataType::List(_) => column.as_list::<i32>().value(row),
        DataType::LargeList(_) => column.as_list::<i64>().value(row),
        _ => column.slice(row, 1),
    };
    (0..items.len())
        .map(|item| image_of(&items, item))
        .collect()
}

fn image_of(items: &ArrayRef, item: usize) -> Image {
    let (bytes, name) = match items.as_struct_opt() {
        Some(fields) => (
            fields.column_by_name("bytes").cloned(),
            fields
                .column_by_name("path")
                .and_then(|path| text_of(path, item)),
        ),
        None => (Some(items.clone()), None),
    };
    let name = name.unwrap_or_default();
    let source = match bytes.and_then(|bytes| bytes_of(&bytes, item)) {
        Some(bytes) => ImageSource::Bytes(bytes),
        None if name.is_empty() => {
            ImageSource::Broken("an image without bytes and without a path".into())
        }
        None => ImageSource::File(name.clone().into()),
    };
    Image { name, source }
}

fn bytes_of(column: &ArrayRef, row: usize) -> Option<Vec<u8>> {
    let bytes = match column.data_type() {
        _ if column.is_null(row) => return None,
        DataType::Binary => column.as_binary::<i32>().value(row),
        DataType::LargeBinary => column.as_binary::<i64>().value(row),
        DataType::BinaryView => column.as_binary_view().value(row),
        _ => return None,
    };
    Some(bytes.to_vec())
}

fn text_of(column: &ArrayRef, row: usize) -> Option<String> {
    let text = match column.data_type() {
        _ if column.is_null(row) => return None,
        DataType::Utf8 => column.as_string::<i32>().value(row),
        DataType::LargeUtf8 => column.as_string::<i64>().value(row),
        DataType::Utf8View => column.as_string_view().value(row),
        _ => return None,
    };
    Some(text.to_owned())
}
