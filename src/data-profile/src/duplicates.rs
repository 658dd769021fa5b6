//! Rows that occur more than once, by a digest of 64 bits over all or some columns.

use std::{
    hash::{DefaultHasher, Hasher as _},
    sync::{Arc, Mutex, PoisonError},
};

use polars::prelude::{
    Column as Values, DataType, Expr, Field, IntoColumn as _, LazyFrame, NamedFrom as _,
    PlSmallStr, PolarsResult, Series, col, len, lit, map_multiple,
    row_encode::_get_rows_encoded_ca_unordered,
};
use serde::Serialize;

use crate::{DataError, Table};

/// Distinct digests that a pass holds, less than 1 GB; sets with more rows are read in several
/// passes.
const PASS_ROWS: u64 = 8 << 20;
/// Examples of repeated rows.
const EXAMPLES: usize = 3;

/// How many rows are equal to an earlier one.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct Duplicates {
    /// The columns that are compared; all if there are none.
    pub columns: Vec<String>,
    /// How many distinct rows there are.
    pub distinct: u64,
    /// Rows beyond the first of their kind.
    pub repeated: u64,
    /// Kinds of rows that occur more than once.
    pub groups: u64,
    /// Rows without a value in any of the columns, which are not compared.
    pub without_key: u64,
    /// Number from 0 of the first row of the largest groups, and the size of each.
    pub largest: Vec<(u64, u64)>,
}

/// The digest of a row over these values; equal rows have equal digests.
pub(crate) fn row_digest(values: Vec<Expr>) -> Expr {
    map_multiple(digests, values, |_, _| {
        Ok(Field::new("digest".into(), DataType::UInt64))
    })
}

fn digests(columns: &mut [Values]) -> PolarsResult<Values> {
    let name = PlSmallStr::from_static("digest");
    let rows = _get_rows_encoded_ca_unordered(name.clone(), columns)?;
    let digests: Vec<u64> = rows
        .iter()
        .map(|row| {
            let mut hasher = DefaultHasher::new();
            hasher.write(row.unwrap_or_default());
            hasher.finish()
        })
        .collect();
    Ok(Series::new(name, digests).into_column())
}

/// Passes that keep the digests of this many rows within their memory.
pub(crate) fn passes(rows: u64) -> u64 {
    rows.div_ceil(PASS_ROWS).max(1)
}

/// The part of a plan whose digests belong to one of several passes.
pub(crate) fn of_pass(plan: LazyFrame, digest: &str, (pass, passes): (u64, u64)) -> LazyFrame {
    if passes == 1 {
        return plan;
    }
    plan.filter((col(digest) % lit(passes)).eq(lit(pass)))
}

/// Counts rows that are equal in these columns, or in all if none is named.
pub(crate) fn duplicates(
    table: &Table,
    columns: &[String],
    rows: u64,
) -> Result<Duplicates, DataError> {
    let values: Vec<Expr> = if columns.is_empty() {
        let all = table.columns().iter();
        all.map(|column| col(column.name.as_str())).collect()
    } else {
        let values = columns.iter().map(|name| Ok(table.value(name)?.0));
        values.collect::<Result<_, DataError>>()?
    };
    let known = values
        .iter()
        .map(|value| value.clone().is_not_null())
        .reduce(Expr::or)
        .unwrap_or(lit(true));
    let found = Arc::new(Mutex::new(Duplicates {
        columns: columns.to_vec(),
        ..Duplicates::default()
    }));
    let mut plan = table
        .frame()
        .select([row_digest(values).alias("digest"), known.alias("known")])
        .with_row_index("row", None);
    if !columns.is_empty() {
        plan = plan.filter(col("known"));
    }
    let passes = passes(rows);
    for pass in 0..passes {
        let groups = of_pass(plan.clone(), "digest", (pass, passes))
            .group_by([col("digest")])
            .agg([
                len().cast(DataType::UInt64).alias("count"),
                col("row").min().cast(DataType::UInt64),
            ])
            .select([col("count"), col("row")]);
        let found = Arc::clone(&found);
        table.for_each_batch(groups, move |batch| {
            let counts = batch.column("count")?.as_materialized_series().u64()?;
            let rows = batch.column("row")?.as_materialized_series().u64()?;
            let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
            for (count, row) in counts.iter().flatten().zip(rows.iter().flatten()) {
                found.add(count, row);
            }
            Ok(())
        })?;
    }
    let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
    let mut found = std::mem::take(&mut *found);
    found.without_key = rows.saturating_sub(found.distinct + found.repeated);
    Ok(found)
}

impl Duplicates {
    fn add(&mut self, count: u64, row: u64) {
        self.distinct += 1;
        if count < 2 {
            return;
        }
        self.groups += 1;
        self.repeated += count - 1;
        let before = |(a_row, a_count): &(u64, u64), b: (u64, u64)| {
            *a_count > b.1 || (*a_count == b.1 && *a_row < b.0)
        };
        let place = self
            .largest
            .iter()
            .take_while(|known| before(known, (row, count)))
            .count();
        self.largest.insert(place, (row, count));
        self.largest.truncate(EXAMPLES);
    }
}
