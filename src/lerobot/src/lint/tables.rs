//! Parquet files in batches, and their columns as numbers.

use std::{collections::BTreeMap, fs::File, path::Path};

use arrow::{
    array::{Array, ArrayRef, AsArray, Float64Array, RecordBatch},
    compute::cast,
    datatypes::{DataType, Schema},
};
use parquet::arrow::{ProjectionMask, arrow_reader::ParquetRecordBatchReaderBuilder};

/// Rows that are in memory at once.
const BATCH_ROWS: usize = 4096;

/// The columns of a file, and its rows in batches; only the columns that `wanted` chooses are read.
pub(super) fn open(
    path: &Path,
    wanted: impl Fn(&str) -> bool,
) -> Result<(Schema, impl Iterator<Item = Result<RecordBatch, String>>), String> {
    let file = File::open(path).map_err(|error| error.to_string())?;
    let builder =
        ParquetRecordBatchReaderBuilder::try_new(file).map_err(|error| error.to_string())?;
    let schema = builder.schema().as_ref().clone();
    let roots = (0..schema.fields().len()).filter(|index| wanted(schema.field(*index).name()));
    let mask = ProjectionMask::roots(builder.parquet_schema(), roots);
    let reader = builder
        .with_projection(mask)
        .with_batch_size(BATCH_ROWS)
        .build();
    let reader = reader.map_err(|error| error.to_string())?;
    Ok((
        schema,
        reader.map(|batch| batch.map_err(|error| error.to_string())),
    ))
}

/// The numbers of a column, row by row.
pub(super) struct Numbers {
    values: Float64Array,
    /// Where the numbers of each row begin; one more for the end.
    offsets: Vec<usize>,
}

impl Numbers {
    /// `None` if the column does not hold numbers, or lists of them.
    pub(super) fn of(column: &ArrayRef) -> Option<Self> {
        let inner = |values: &ArrayRef, starts: Vec<usize>| {
            let inner = Self::of(values)?;
            let offsets = starts
                .into_iter()
                .map(|start| inner.offsets[start])
                .collect();
            Some(Self {
                values: inner.values,
                offsets,
            })
        };
        match column.data_type() {
            DataType::List(_) => {
                let list = column.as_list::<i32>();
                let starts = list.value_offsets().iter().map(|offset| *offset as usize);
                inner(list.values(), starts.collect())
            }
            DataType::LargeList(_) => {
                let list = column.as_list::<i64>();
                let starts = list.value_offsets().iter().map(|offset| *offset as usize);
                inner(list.values(), starts.collect())
            }
            DataType::FixedSizeList(_, size) => {
                let size = *size as usize;
                let starts = (0..=column.len()).map(|row| row * size);
                inner(column.as_fixed_size_list().values(), starts.collect())
            }
            data_type if data_type.is_numeric() || *data_type == DataType::Boolean => {
                let values = cast(column, &DataType::Float64).ok()?;
                Some(Self {
                    values: values.as_primitive_opt()?.clone(),
                    offsets: (0..=column.len()).collect(),
                })
            }
            _ => None,
        }
    }

    /// The numbers of a row; null is no number.
    pub(super) fn row(&self, row: usize) -> Vec<f64> {
        let range = self.offsets[row]..self.offsets[row + 1];
        range
            .map(|at| {
                if self.values.is_null(at) {
                    f64::NAN
                } else {
                    self.values.value(at)
                }
            })
            .collect()
    }

    /// The first number of a row as an integer.
    pub(super) fn integer(&self, row: usize) -> Option<i64> {
        let value = *self.row(row).first()?;
        (value.is_finite() && value.fract() == 0.0).then_some(value as i64)
    }
}

/// The texts of a column, row by row; `None` if it does not hold texts, or lists of them. Null is no text.
pub(super) fn texts(column: &ArrayRef) -> Option<Vec<Vec<String>>> {
    let rows = |column: &dyn Array| (0..column.len()).collect::<Vec<usize>>();
    let of_list = |values: ArrayRef| Some(texts(&values)?.into_iter().flatten().collect());
    let nulls = column.clone();
    let row_of = |row: usize, values: &dyn Fn(usize) -> ArrayRef| {
        if nulls.is_null(row) {
            return Some(Vec::new());
        }
        of_list(values(row))
    };
    match column.data_type() {
        DataType::List(_) => {
            let list = column.as_list::<i32>();
            let rows = rows(list).into_iter();
            rows.map(|row| row_of(row, &|row| list.value(row)))
                .collect()
        }
        DataType::LargeList(_) => {
            let list = column.as_list::<i64>();
            let rows = rows(list).into_iter();
            rows.map(|row| row_of(row, &|row| list.value(row)))
                .collect()
        }
        DataType::Utf8 | DataType::LargeUtf8 | DataType::Utf8View => {
            let column = cast(column, &DataType::Utf8).ok()?;
            let texts = column.as_string::<i32>().iter();
            Some(
                texts
                    .map(|text| text.map(str::to_owned).into_iter().collect())
                    .collect(),
            )
        }
        _ => None,
    }
}

/// The columns of a batch that hold numbers, by name.
pub(super) fn columns(batch: &RecordBatch) -> BTreeMap<&str, Numbers> {
    let names = batch.schema_ref().fields().iter();
    names
        .zip(batch.columns())
        .filter_map(|(field, column)| Some((field.name().as_str(), Numbers::of(column)?)))
        .collect()
}
