//! Results as text (an aligned table for people, CSV and JSON for programs) and as
//! files (Arrow IPC, Parquet).

use std::fmt::Write as _;

use arrow::{
    array::{Array, ArrayRef, AsArray, RecordBatch},
    datatypes::{DataType, Float32Type, Float64Type, SchemaRef},
    error::ArrowError,
    ipc::writer::FileWriter,
    json::{WriterBuilder, writer::JsonArray},
    util::display::{ArrayFormatter, FormatOptions},
};
use datafusion::parquet::{
    arrow::ArrowWriter,
    basic::{Compression, ZstdLevel},
    file::properties::WriterProperties,
};

/// Longest cell of the table form, in characters.
const CELL_WIDTH_MAX: usize = 100;

/// Rows in a group of a Parquet file: so many are held before they are written.
const ROWS_PER_GROUP: usize = 65_536;

/// How to print a result.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Format {
    /// Aligned, for people: floats to three digits, long text cut.
    #[default]
    Table,
    /// Comma-separated with a header line; nested values as text; nothing is cut.
    Csv,
    /// A JSON list of objects.
    Json,
}

/// Prints a result.
///
/// # Errors
/// When Arrow cannot show a value.
pub fn format(batches: &[RecordBatch], format: Format) -> Result<String, ArrowError> {
    match format {
        Format::Table => table(batches),
        Format::Csv => csv(batches),
        Format::Json => json(batches),
    }
}

/// A result as the bytes of an Arrow IPC file.
///
/// # Errors
/// When Arrow cannot write a column.
pub fn arrow_file(batches: &[RecordBatch]) -> Result<Vec<u8>, ArrowError> {
    let Some(first) = batches.first() else {
        return Ok(Vec::new());
    };
    let mut writer = FileWriter::try_new(Vec::new(), &first.schema())?;
    batches.iter().try_for_each(|batch| writer.write(batch))?;
    writer.into_inner()
}

/// A result as the bytes of a Parquet file (zstd).
///
/// # Errors
/// When Parquet cannot write a column.
pub fn parquet_file(batches: &[RecordBatch]) -> Result<Vec<u8>, ArrowError> {
    let Some(first) = batches.first() else {
        return Ok(Vec::new());
    };
    let mut stream = ParquetStream::new(first.schema())?;
    let mut file = Vec::new();
    for batch in batches {
        file.append(&mut stream.write(batch)?);
    }
    file.append(&mut stream.end()?);
    Ok(file)
}

/// A Parquet file (zstd) whose bytes are taken as it grows, a row group at a time.
pub struct ParquetStream(ArrowWriter<Vec<u8>>);

impl ParquetStream {
    /// Begins a file that has no rows yet.
    ///
    /// # Errors
    /// When Parquet has no such column.
    pub fn new(schema: SchemaRef) -> Result<Self, ArrowError> {
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .set_max_row_group_row_count(Some(ROWS_PER_GROUP))
            .build();
        let writer = ArrowWriter::try_new(Vec::new(), schema, Some(properties))?;
        Ok(Self(writer))
    }

    /// Adds rows, and gives the bytes since the last that were given.
    ///
    /// # Errors
    /// When Parquet cannot write a column.
    pub fn write(&mut self, batch: &RecordBatch) -> Result<Vec<u8>, ArrowError> {
        self.0.write(batch)?;
        Ok(std::mem::take(self.0.inner_mut()))
    }

    /// Ends the file, and gives the rest of its bytes.
    ///
    /// # Errors
    /// When Parquet cannot write a column.
    pub fn end(self) -> Result<Vec<u8>, ArrowError> {
        Ok(self.0.into_inner()?)
    }
}

fn table(batches: &[RecordBatch]) -> Result<String, ArrowError> {
    let Some(first) = batches.first() else {
        return Ok(String::new());
    };
    let schema = first.schema();
    let numeric: Vec<bool> = schema
        .fields()
        .iter()
        .map(|field| field.data_type().is_numeric())
        .collect();
    let mut rows: Vec<Vec<String>> = vec![
        schema
            .fields()
            .iter()
            .map(|field| field.name().clone())
            .collect(),
    ];
    for batch in batches {
        let columns = batch
            .columns()
            .iter()
            .map(|column| cells(column, true))
            .collect::<Result<Vec<_>, _>>()?;
        rows.extend(
            (0..batch.num_rows())
                .map(|row| columns.iter().map(|column| cut(&column[row])).collect()),
        );
    }
    let width = |column: usize| {
        rows.iter()
            .map(|row| row[column].chars().count())
            .max()
            .unwrap_or(0)
    };
    let widths: Vec<usize> = (0..numeric.len()).map(width).collect();
    let mut text = String::new();
    for (index, row) in rows.iter().enumerate() {
        let cell = |column: usize| {
            let (cell, width) = (&row[column], widths[column]);
            if numeric[column] {
                format!("{cell:>width$}")
            } else {
                format!("{cell:<width$}")
            }
        };
        let line: Vec<String> = (0..row.len()).map(cell).collect();
        text.push_str(line.join("  ").trim_end());
        text.push('\n');
        if index == 0 {
            let rule: Vec<String> = widths.iter().map(|width| "-".repeat(*width)).collect();
            text.push_str(&rule.join("  "));
            text.push('\n');
        }
    }
    if rows.len() == 1 {
        text.push_str("(no rows)\n");
    }
    Ok(text)
}

fn csv(batches: &[RecordBatch]) -> Result<String, ArrowError> {
    let Some(first) = batches.first() else {
        return Ok(String::new());
    };
    let mut text = String::new();
    let mut line = |cells: Vec<&str>| {
        let quoted: Vec<String> = cells.into_iter().map(quote).collect();
        text.push_str(&quoted.join(","));
        text.push('\n');
    };
    line(
        first
            .schema()
            .fields()
            .iter()
            .map(|field| field.name().as_str())
            .collect(),
    );
    for batch in batches {
        let columns = batch
            .columns()
            .iter()
            .map(|column| cells(column, false))
            .collect::<Result<Vec<_>, _>>()?;
        for row in 0..batch.num_rows() {
            line(columns.iter().map(|column| column[row].as_str()).collect());
        }
    }
    Ok(text)
}

fn quote(cell: &str) -> String {
    if cell.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", cell.replace('"', "\"\""))
    } else {
        cell.to_owned()
    }
}

fn json(batches: &[RecordBatch]) -> Result<String, ArrowError> {
    let mut bytes = Vec::new();
    let mut writer = WriterBuilder::new()
        .with_explicit_nulls(true)
        .build::<_, JsonArray>(&mut bytes);
    writer.write_batches(&batches.iter().collect::<Vec<_>>())?;
    writer.finish()?;
    let mut text =
        String::from_utf8(bytes).map_err(|error| ArrowError::JsonError(error.to_string()))?;
    if text.is_empty() {
        text.push_str("[]");
    }
    text.push('\n');
    Ok(text)
}

/// The cells of a column as text; null is empty.
fn cells(column: &ArrayRef, short_floats: bool) -> Result<Vec<String>, ArrowError> {
    let rows = 0..column.len();
    let float = |value: Option<f64>| value.map(|value| format!("{value:.3}")).unwrap_or_default();
    Ok(match column.data_type() {
        DataType::Float64 if short_floats => column
            .as_primitive::<Float64Type>()
            .iter()
            .map(float)
            .collect(),
        DataType::Float32 if short_floats => column
            .as_primitive::<Float32Type>()
            .iter()
            .map(|value| float(value.map(f64::from)))
            .collect(),
        _ => {
            let options = FormatOptions::default();
            let formatter = ArrayFormatter::try_new(column, &options)?;
            let mut cells = Vec::with_capacity(column.len());
            for row in rows {
                let mut cell = String::new();
                write!(cell, "{}", formatter.value(row))
                    .map_err(|error| ArrowError::ComputeError(error.to_string()))?;
                cells.push(cell);
            }
            cells
        }
    })
}

/// One line, not too long.
fn cut(cell: &str) -> String {
    let line = cell.replace(['\n', '\r', '\t'], " ");
    match line.char_indices().nth(CELL_WIDTH_MAX) {
        Some(_) => line
            .chars()
            .take(CELL_WIDTH_MAX - 3)
            .chain("...".chars())
            .collect(),
        None => line,
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use arrow::array::{Float64Array, Int32Array, StringArray};

    use super::*;

    fn batch() -> RecordBatch {
        let long = "x".repeat(120);
        RecordBatch::try_from_iter([
            (
                "policy",
                Arc::new(StringArray::from(vec![
                    Some("oracle"),
                    Some("a \"b\", c"),
                    None,
                ])) as ArrayRef,
            ),
            (
                "n",
                Arc::new(Int32Array::from(vec![Some(1), None, Some(300)])),
            ),
            (
                "sr",
                Arc::new(Float64Array::from(vec![Some(0.123_456), Some(1.0), None])),
            ),
            (
                "text",
                Arc::new(StringArray::from(vec!["one\ntwo", long.as_str(), ""])),
            ),
        ])
        .unwrap()
    }

    #[test]
    fn a_table_is_aligned_and_cut() {
        let text = format(&[batch()], Format::Table).unwrap();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "policy      n     sr  text");
        assert_eq!(lines[2], "oracle      1  0.123  one two");
        assert_eq!(
            lines[3],
            format!("a \"b\", c       1.000  {}...", "x".repeat(97))
        );
        assert_eq!(lines[4], "          300");
    }

    #[test]
    fn csv_quotes_and_cuts_nothing() {
        let text = format(&[batch()], Format::Csv).unwrap();
        assert_eq!(
            text,
            format!(
                "policy,n,sr,text\noracle,1,0.123456,\"one\ntwo\"\n\"a \"\"b\"\", c\",,1.0,{}\n,300,,\n",
                "x".repeat(120)
            )
        );
    }

    #[test]
    fn json_names_every_column() {
        let text = format(&[batch().slice(0, 1)], Format::Json).unwrap();
        assert_eq!(
            text,
            "[{\"policy\":\"oracle\",\"n\":1,\"sr\":0.123456,\"text\":\"one\\ntwo\"}]\n"
        );
        assert_eq!(
            format(&[batch().slice(0, 0)], Format::Json).unwrap(),
            "[]\n"
        );
        assert!(
            format(&[batch().slice(2, 1)], Format::Json)
                .unwrap()
                .contains("\"policy\":null")
        );
    }

    #[test]
    fn no_rows_still_show_the_columns() {
        assert!(
            format(&[batch().slice(0, 0)], Format::Table)
                .unwrap()
                .starts_with("policy")
        );
    }
}
