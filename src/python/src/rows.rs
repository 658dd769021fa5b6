//! Rows of Arrow arrays as Python dictionaries, column by column.

use std::collections::BTreeSet;

use arrow::{
    array::{Array, ArrayRef, AsArray as _, RecordBatch},
    compute::cast,
    datatypes::{
        ArrowPrimitiveType, DataType, Decimal128Type, Float32Type, Float64Type, Int8Type,
        Int16Type, Int32Type, Int64Type, UInt8Type, UInt16Type, UInt32Type, UInt64Type,
    },
};
use pyo3::{
    IntoPyObjectExt as _,
    prelude::*,
    types::{PyDict, PyList, PyString},
};

use crate::error::{OrRaise as _, refuse};

type Object<'py> = Bound<'py, PyAny>;

/// The rows of a batch, a dictionary each.
///
/// # Errors
/// Fails if two columns have one name, of which a dictionary would hold only the last.
pub fn dictionaries<'py>(
    py: Python<'py>,
    batch: &RecordBatch,
) -> PyResult<Vec<Bound<'py, PyDict>>> {
    let schema = batch.schema();
    let mut names = BTreeSet::new();
    for field in schema.fields() {
        if !names.insert(field.name()) {
            let name = field.name();
            return Err(refuse(format!(
                "two columns of the answer are named `{name}`, and a row as a dictionary holds one; name \
                 them in the query: `SELECT a.{name} AS first_{name}, b.{name} AS second_{name}`"
            )));
        }
    }
    let rows: Vec<Bound<'py, PyDict>> = (0..batch.num_rows()).map(|_| PyDict::new(py)).collect();
    for (field, column) in schema.fields().iter().zip(batch.columns()) {
        let name = PyString::new(py, field.name());
        for (row, value) in rows.iter().zip(values(py, column)?) {
            row.set_item(&name, value)?;
        }
    }
    Ok(rows)
}

/// The values of a column: None, bool, int, float, str, bytes, lists and dictionaries; what Python has
/// no plain type for (times) as text.
fn values<'py>(py: Python<'py>, column: &ArrayRef) -> PyResult<Vec<Object<'py>>> {
    let none = || py.None().into_bound(py);
    match column.data_type() {
        DataType::Boolean => column
            .as_boolean()
            .iter()
            .map(|value| value.into_bound_py_any(py))
            .collect(),
        DataType::Int8 => numbers::<Int8Type>(py, column),
        DataType::Int16 => numbers::<Int16Type>(py, column),
        DataType::Int32 => numbers::<Int32Type>(py, column),
        DataType::Int64 => numbers::<Int64Type>(py, column),
        DataType::UInt8 => numbers::<UInt8Type>(py, column),
        DataType::UInt16 => numbers::<UInt16Type>(py, column),
        DataType::UInt32 => numbers::<UInt32Type>(py, column),
        DataType::UInt64 => numbers::<UInt64Type>(py, column),
        // Counts and seeds of 64 bits: DataFusion gives sums of them as decimals.
        DataType::Decimal128(_, 0) => numbers::<Decimal128Type>(py, column),
        DataType::Decimal128(..) => values(py, &cast(column, &DataType::Float64).or_raise()?),
        DataType::Float32 => numbers::<Float32Type>(py, column),
        DataType::Float64 => numbers::<Float64Type>(py, column),
        DataType::Utf8 => column
            .as_string::<i32>()
            .iter()
            .map(|text| text.into_bound_py_any(py))
            .collect(),
        DataType::Utf8View => column
            .as_string_view()
            .iter()
            .map(|text| text.into_bound_py_any(py))
            .collect(),
        DataType::Binary => column
            .as_binary::<i32>()
            .iter()
            .map(|bytes| bytes.into_bound_py_any(py))
            .collect(),
        DataType::Null => Ok((0..column.len()).map(|_| none()).collect()),
        DataType::List(_) => {
            let lists = column.as_list::<i32>();
            let items = values(py, lists.values())?;
            let list = |row: usize| {
                if lists.is_null(row) {
                    return Ok(none());
                }
                let (from, to) = (
                    lists.value_offsets()[row] as usize,
                    lists.value_offsets()[row + 1] as usize,
                );
                Ok(PyList::new(py, &items[from..to])?.into_any())
            };
            (0..lists.len()).map(list).collect()
        }
        DataType::Struct(fields) => {
            let records = column.as_struct();
            let rows: Vec<Bound<'py, PyDict>> =
                (0..records.len()).map(|_| PyDict::new(py)).collect();
            for (field, inner) in fields.iter().zip(records.columns()) {
                let name = PyString::new(py, field.name());
                for (row, value) in rows.iter().zip(values(py, inner)?) {
                    row.set_item(&name, value)?;
                }
            }
            let record = |(row, value): (usize, Bound<'py, PyDict>)| match records.is_null(row) {
                true => none(),
                false => value.into_any(),
            };
            Ok(rows.into_iter().enumerate().map(record).collect())
        }
        DataType::Dictionary(_, of) => values(py, &cast(column, of).or_raise()?),
        DataType::LargeUtf8 => values(py, &cast(column, &DataType::Utf8View).or_raise()?),
        DataType::LargeList(item) => {
            values(py, &cast(column, &DataType::List(item.clone())).or_raise()?)
        }
        _ => values(py, &cast(column, &DataType::Utf8View).or_raise()?),
    }
}

fn numbers<'py, T: ArrowPrimitiveType>(
    py: Python<'py>,
    column: &ArrayRef,
) -> PyResult<Vec<Object<'py>>>
where
    T::Native: IntoPyObject<'py>,
{
    column
        .as_primitive::<T>()
        .iter()
        .map(|value| value.into_bound_py_any(py))
        .collect()
}
