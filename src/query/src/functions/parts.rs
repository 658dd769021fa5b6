//! The function by which rows are partitioned over machines. For plans, not for people.

use std::sync::Arc;

use arrow::{
    array::{Array, AsArray, Int64Array},
    compute::cast,
    datatypes::{DataType, Int64Type},
};
use datafusion::{
    error::Result,
    logical_expr::{ColumnarValue, Expr, ScalarUDF, Volatility, create_udf},
    prelude::lit,
};
use reel_world::Digest;

/// `reel_part(text, parts)`: to which of so many parts a text belongs; equal texts to the
/// same, null to none.
pub(crate) fn function() -> ScalarUDF {
    create_udf(
        "reel_part",
        vec![DataType::Utf8, DataType::Int64],
        DataType::Int64,
        Volatility::Immutable,
        Arc::new(part),
    )
}

/// To which of so many parts a text belongs.
pub(crate) fn part_of(text: Expr, parts: i64) -> Expr {
    function().call(vec![text, lit(parts)])
}

fn part(arguments: &[ColumnarValue]) -> Result<ColumnarValue> {
    let arrays = ColumnarValue::values_to_arrays(arguments)?;
    let texts = cast(&arrays[0], &DataType::Utf8)?;
    let (texts, counts) = (
        texts.as_string::<i32>(),
        arrays[1].as_primitive::<Int64Type>(),
    );
    let one = |row: usize| {
        let count = u64::try_from(counts.value(row))
            .ok()
            .filter(|count| *count > 0 && texts.is_valid(row))?;
        let Digest(bytes) = Digest::of(texts.value(row).as_bytes());
        let number = u64::from_le_bytes(*bytes.first_chunk()?);
        Some((number % count) as i64)
    };
    let parts: Int64Array = (0..texts.len()).map(one).collect();
    Ok(ColumnarValue::Array(Arc::new(parts)))
}

#[cfg(test)]
mod tests {
    use arrow::array::StringArray;

    use super::*;

    #[test]
    fn every_text_belongs_to_one_part_and_the_parts_are_about_equal() {
        let texts: StringArray = (0..6400)
            .map(|number| Some(format!("trace-{number}.mcap")))
            .chain([None])
            .collect();
        let counts = Int64Array::from(vec![64; texts.len()]);
        let arguments = [
            ColumnarValue::Array(Arc::new(texts)),
            ColumnarValue::Array(Arc::new(counts)),
        ];
        let ColumnarValue::Array(parts) = part(&arguments).unwrap() else {
            panic!("a column for columns")
        };
        let parts = parts.as_primitive::<Int64Type>();
        let mut sizes = [0; 64];
        parts
            .iter()
            .flatten()
            .for_each(|part| sizes[part as usize] += 1);
        assert!(
            parts.is_null(6400) && sizes.iter().all(|size| (50..150).contains(size)),
            "{sizes:?}"
        );
    }
}
