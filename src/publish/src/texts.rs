//! The texts of a dataset's files, however they are escaped or compressed: lines, strings of JSON,
//! columns of Parquet. Holds one row, or one batch of rows, at a time; judges nothing.

use std::{
    fs::File,
    io::{BufRead as _, BufReader, Read as _},
    path::Path,
};

use arrow::{
    array::{Array, AsArray, RecordBatch},
    datatypes::DataType,
};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use reel_dataset::lint::JsonTexts;
use serde_json::Value;

/// Longest line of a text that is read, in bytes.
const LINE_BYTES_MAX: u64 = 64 << 20;
/// Largest file that holds one JSON object, in bytes.
const OBJECT_BYTES_MAX: u64 = 256 << 20;
/// Rows of a table in memory at a time.
const BATCH_ROWS: usize = 256;

/// What reads a file's texts.
pub(crate) trait Visitor {
    /// A text with its line or row, from 1.
    fn text(&mut self, line: u64, text: &str);
    /// Bytes of a row that are no text, e.g. an image.
    fn bytes(&mut self, line: u64, bytes: &[u8]);
    /// A row of JSON, after its texts.
    fn json_row(&mut self, line: u64, value: &Value);
    /// A row of a table: its columns of text at the top.
    fn table_row(&mut self, line: u64, value: &dyn Fn(&str) -> Option<String>);
}

/// How the texts of a file are found; `None` if it holds none (an image, a video, a trace).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Reading {
    Lines,
    JsonRows,
    JsonObject,
    Table,
}

/// Reads all texts of a file by the ending of its name. An error is a sentence for people.
pub(crate) fn visit(place: &Path, visitor: &mut dyn Visitor) -> Result<(), String> {
    let failed = |error: std::io::Error| format!("it cannot be read: {error}");
    match reading(place).map_err(failed)? {
        None => Ok(()),
        Some(Reading::Lines) => lines(place, visitor).map_err(failed),
        Some(Reading::JsonRows) => json_rows(place, visitor),
        Some(Reading::JsonObject) => json_object(place, visitor),
        Some(Reading::Table) => table(place, visitor),
    }
}

fn reading(place: &Path) -> std::io::Result<Option<Reading>> {
    let ending = place.extension().unwrap_or_default().to_string_lossy();
    Ok(match ending.to_ascii_lowercase().as_str() {
        "jsonl" | "ndjson" => Some(Reading::JsonRows),
        "json" => {
            let mut head = [0; 64];
            let mut file = File::open(place)?;
            let count = file.read(&mut head)?;
            let head = head.get(..count).unwrap_or_default();
            let first = head.iter().find(|byte| !byte.is_ascii_whitespace());
            Some(if first == Some(&b'[') {
                Reading::JsonRows
            } else {
                Reading::JsonObject
            })
        }
        "parquet" => Some(Reading::Table),
        "arrow" | "bin" | "gif" | "gz" | "jpeg" | "jpg" | "mcap" | "mp4" | "npy" | "npz"
        | "png" | "tar" | "webp" | "zip" | "zst" => None,
        _ => Some(Reading::Lines),
    })
}

fn lines(place: &Path, visitor: &mut dyn Visitor) -> std::io::Result<()> {
    let mut reader = BufReader::new(File::open(place)?);
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        if reader
            .by_ref()
            .take(LINE_BYTES_MAX)
            .read_until(b'\n', &mut line)?
            == 0
        {
            break;
        }
        visitor.text(number, &String::from_utf8_lossy(&line));
    }
    Ok(())
}

fn json_rows(place: &Path, visitor: &mut dyn Visitor) -> Result<(), String> {
    let file = File::open(place).map_err(|error| format!("it cannot be read: {error}"))?;
    for row in JsonTexts::new(BufReader::with_capacity(1 << 18, file)) {
        let text = row.text.as_ref().map_err(|error| error.message.clone())?;
        let value: Value = serde_json::from_slice(text)
            .map_err(|error| format!("line {}: {}", row.line, row.error(&error).message))?;
        let line = u64::from(row.line);
        visit_value(line, &value, visitor);
        visitor.json_row(line, &value);
    }
    Ok(())
}

fn json_object(place: &Path, visitor: &mut dyn Visitor) -> Result<(), String> {
    let value = read_json(place)?;
    visit_value(1, &value, visitor);
    Ok(())
}

/// A file that holds one JSON value, of bounded size.
pub(crate) fn read_json(place: &Path) -> Result<Value, String> {
    let failed = |error: std::io::Error| format!("it cannot be read: {error}");
    let file = File::open(place).map_err(failed)?;
    if file.metadata().map_err(failed)?.len() > OBJECT_BYTES_MAX {
        return Err("one JSON value of more than 256 MiB; write rows as JSON lines".to_owned());
    }
    serde_json::from_reader(BufReader::new(file)).map_err(|error| format!("not JSON: {error}"))
}

/// All strings and keys of a value. The parser bounds its depth.
fn visit_value(line: u64, value: &Value, visitor: &mut dyn Visitor) {
    match value {
        Value::String(text) => visitor.text(line, text),
        Value::Array(items) => items
            .iter()
            .for_each(|item| visit_value(line, item, visitor)),
        Value::Object(entries) => {
            for (key, value) in entries {
                visitor.text(line, key);
                visit_value(line, value, visitor);
            }
        }
        Value::Null | Value::Bool(_) | Value::Number(_) => {}
    }
}

fn table(place: &Path, visitor: &mut dyn Visitor) -> Result<(), String> {
    let failed = |error: &dyn std::fmt::Display| format!("no whole Parquet file: {error}");
    let file = File::open(place).map_err(|error| failed(&error))?;
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| failed(&error))?;
    let metadata = builder.metadata().file_metadata().key_value_metadata();
    for entry in metadata.into_iter().flatten() {
        visitor.text(0, &entry.key);
        visitor.text(0, entry.value.as_deref().unwrap_or_default());
    }
    let batches = builder
        .with_batch_size(BATCH_ROWS)
        .build()
        .map_err(|error| failed(&error))?;
    let mut first = 1;
    for batch in batches {
        let batch = batch.map_err(|error| failed(&error))?;
        visit_batch(first, &batch, visitor);
        first += batch.num_rows() as u64;
    }
    Ok(())
}

fn visit_batch(first: u64, batch: &RecordBatch, visitor: &mut dyn Visitor) {
    let columns: Vec<&dyn Array> = batch
        .columns()
        .iter()
        .map(|column| &**column)
        .filter(|column| has_text(column.data_type(), 0))
        .collect();
    for row in 0..batch.num_rows() {
        let line = first + row as u64;
        for column in &columns {
            visit_cell(line, *column, row, visitor);
        }
        let value = |name: &str| {
            let column = batch.column_by_name(name)?;
            text_of(column.as_ref(), row).map(str::to_owned)
        };
        visitor.table_row(line, &value);
    }
}

/// Deepest nesting of a column's type.
const LEVELS_MAX: usize = 32;

fn has_text(kind: &DataType, level: usize) -> bool {
    let inside = |field: &arrow::datatypes::FieldRef| has_text(field.data_type(), level + 1);
    match kind {
        _ if level > LEVELS_MAX => false,
        DataType::Utf8
        | DataType::LargeUtf8
        | DataType::Utf8View
        | DataType::Binary
        | DataType::LargeBinary
        | DataType::BinaryView => true,
        DataType::List(field)
        | DataType::LargeList(field)
        | DataType::FixedSizeList(field, _)
        | DataType::Map(field, _) => inside(field),
        DataType::Struct(fields) => fields.iter().any(inside),
        DataType::Dictionary(_, values) => has_text(values, level + 1),
        _ => false,
    }
}

fn text_of(array: &dyn Array, row: usize) -> Option<&str> {
    if array.is_null(row) {
        return None;
    }
    match array.data_type() {
        DataType::Utf8 => Some(array.as_string::<i32>().value(row)),
        DataType::LargeUtf8 => Some(array.as_string::<i64>().value(row)),
        DataType::Utf8View => Some(array.as_string_view().value(row)),
        DataType::Dictionary(..) => {
            let dictionary = array.as_any_dictionary_opt()?;
            let key = *dictionary.normalized_keys().get(row)?;
            text_of(dictionary.values().as_ref(), key)
        }
        _ => None,
    }
}

fn visit_cell(line: u64, array: &dyn Array, row: usize, visitor: &mut dyn Visitor) {
    if array.is_null(row) {
        return;
    }
    let mut items = |list: &dyn Array| {
        (0..list.len()).for_each(|item| visit_cell(line, list, item, visitor));
    };
    match array.data_type() {
        DataType::List(_) => items(array.as_list::<i32>().value(row).as_ref()),
        DataType::LargeList(_) => items(array.as_list::<i64>().value(row).as_ref()),
        DataType::FixedSizeList(..) => items(array.as_fixed_size_list().value(row).as_ref()),
        DataType::Map(..) => items(&array.as_map().value(row)),
        DataType::Struct(_) => {
            for column in array.as_struct().columns() {
                visit_cell(line, column.as_ref(), row, visitor);
            }
        }
        DataType::Binary => visitor.bytes(line, array.as_binary::<i32>().value(row)),
        DataType::LargeBinary => visitor.bytes(line, array.as_binary::<i64>().value(row)),
        DataType::BinaryView => visitor.bytes(line, array.as_binary_view().value(row)),
        _ => {
            if let Some(text) = text_of(array, row) {
                visitor.text(line, text);
            }
        }
    }
}
