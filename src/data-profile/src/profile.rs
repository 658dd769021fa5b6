//! The profile of a table: what each column holds, how often rows repeat, how classes are
//! balanced, and how long conversations are.

use polars::prelude::{AnyValue, DataFrame, DataType, Expr, LazyFrame, col, len};
use serde::Serialize;

use crate::{
    DataError, Duplicates, QuantileSketch, SourceFile, Table, TopValue,
    accumulate::{Gathering, LeafTotals, Totals},
    conversation::{self, Conversation},
    duplicates::duplicates,
    leaves::{Leaf, Measure, leaves},
    sketch::label,
};

/// Classes of a balance that are listed.
pub(crate) const CLASSES_MAX: u32 = 50;
/// Shares for which quantiles are computed.
pub(crate) const QUANTILES: [f64; 7] = [0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99];

/// What to profile besides the columns.
#[derive(Clone, Debug)]
pub struct ProfileOptions {
    /// Columns that should name a row once.
    pub keys: Vec<String>,
    /// Columns whose values are classes.
    pub by: Vec<String>,
    /// Frequent values that are listed of each column.
    pub top: usize,
}

impl Default for ProfileOptions {
    fn default() -> Self {
        Self {
            keys: Vec::new(),
            by: Vec::new(),
            top: 3,
        }
    }
}

/// What a table holds.
#[derive(Clone, Debug, Serialize)]
pub struct Profile {
    /// Rows of all files.
    pub rows: u64,
    /// Bytes of all files.
    pub bytes: u64,
    /// The files, in the order of their rows.
    pub files: Vec<SourceFile>,
    /// The columns, structs laid flat.
    pub columns: Vec<ColumnProfile>,
    /// Rows that are equal in all columns.
    pub duplicates: Duplicates,
    /// Rows that are equal in the keys, if keys were named.
    pub key_duplicates: Option<Duplicates>,
    /// Rows of each class, for each column of classes.
    pub balance: Vec<(String, Vec<ClassCount>)>,
    /// Lengths of conversations, if the set holds some.
    pub conversation: Option<ConversationProfile>,
    /// How the files were read, and what was left out.
    pub notes: Vec<String>,
}

/// What a column holds.
#[derive(Clone, Debug, Serialize)]
pub struct ColumnProfile {
    /// Name of the column; a field of a struct has the names of both, with a dot.
    pub name: String,
    /// Its type in words.
    #[serde(rename = "type")]
    pub type_name: String,
    /// Rows without a value.
    pub nulls: u64,
    /// Share of the rows without a value.
    pub null_share: f64,
    /// Distinct values, null left out, or `None` if they are not counted.
    pub distinct: Option<u64>,
    /// Whether [`ColumnProfile::distinct`] is exact; an estimate is off by a few per cent.
    pub distinct_exact: bool,
    /// The numbers of the column, if it holds numbers.
    pub numbers: Option<Numbers>,
    /// Lengths, if it holds texts, lists or bytes.
    pub lengths: Option<Numbers>,
    /// What lengths count: `characters`, `items` or `bytes`.
    pub length_unit: &'static str,
    /// First and last time, if it holds times.
    pub range: Option<(String, String)>,
    /// The most frequent values.
    pub top: Vec<TopValue>,
    /// Whether the counts of [`ColumnProfile::top`] are exact; otherwise they are lower bounds.
    pub top_exact: bool,
}

/// The distribution of numbers.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Numbers {
    /// How many finite numbers there are.
    pub count: u64,
    /// The least of them, in the unit of the column.
    pub min: f64,
    /// The greatest of them, in the unit of the column.
    pub max: f64,
    /// Their arithmetic mean, in the unit of the column.
    pub mean: f64,
    /// Their standard deviation, of the population.
    pub deviation: f64,
    /// Pairs of a share and the number that this share does not exceed.
    pub quantiles: Vec<(f64, f64)>,
    /// Whether quantiles are exact; otherwise they are off by at most 0.5 %.
    pub exact: bool,
}

/// A class and its rows.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct ClassCount {
    /// The value; `null` for rows without one.
    pub class: String,
    /// Rows of the class.
    pub count: u64,
    /// Share of all rows.
    pub share: f64,
}

/// How long conversations are.
#[derive(Clone, Debug, Serialize)]
pub struct ConversationProfile {
    /// The columns with the turns.
    pub columns: String,
    /// Turns of an example.
    pub turns: Option<Numbers>,
    /// Answers of an example.
    pub answers: Option<Numbers>,
    /// Characters of an answer.
    pub answer_characters: Option<Numbers>,
    /// Images of an example.
    pub images: Option<Numbers>,
}

/// Profiles a table in a few passes over its rows.
///
/// # Errors
/// Fails if a named column does not exist or the rows cannot be read.
pub fn profile(table: &Table, options: &ProfileOptions) -> Result<Profile, DataError> {
    for column in options.by.iter().chain(&options.keys) {
        let _ = table.value(column)?;
    }
    let (leaves, left_out) = leaves(table.columns());
    let conversation = conversation::recognise(table);
    let (summary, totals) = measure(table, &leaves, conversation.as_ref())?;
    let rows = number_of(&summary, "rows").unwrap_or_default() as u64;
    let mut notes = table.notes().to_vec();
    if left_out > 0 {
        notes.push(format!("left out: {left_out} of the last columns"));
    }
    notes.extend(conversation.as_ref().and_then(|it| it.note.clone()));
    let columns = leaves.iter().enumerate().map(|(index, leaf)| {
        let totals = totals.leaves.get(index).cloned().unwrap_or_default();
        column_profile(leaf, &summary, (index, rows), &totals, options.top)
    });
    let columns: Vec<ColumnProfile> = columns.collect();
    let duplicate_rows = duplicates(table, &[], rows)?;
    let key_duplicates = if options.keys.is_empty() {
        None
    } else {
        Some(duplicates(table, &options.keys, rows)?)
    };
    let balance = options
        .by
        .iter()
        .map(|column| Ok((column.clone(), balance(table, column, rows)?)))
        .collect::<Result<Vec<_>, DataError>>()?;
    Ok(Profile {
        rows,
        bytes: table.bytes(),
        files: table.files().to_vec(),
        columns,
        duplicates: duplicate_rows,
        key_duplicates,
        balance,
        conversation: conversation.map(|it| of_conversation(&it, &totals)),
        notes,
    })
}

/// One row of aggregates, and what a pass over the batches gathers.
pub(crate) fn measure(
    table: &Table,
    leaves: &[Leaf],
    conversation: Option<&Conversation>,
) -> Result<(DataFrame, Totals), DataError> {
    // Not in one plan with the batches: aggregates run ahead of them, and Polars would keep all rows
    // that the batches have yet to see.
    let summary = table.collect(summary(table.frame(), leaves))?;
    let gathering = Gathering::new(table.frame(), leaves, conversation);
    let (plan, take) = gathering.parts();
    let rows = number_of(&summary, "rows").unwrap_or_default() as u64;
    table.for_each_row(&plan, rows, take)?;
    Ok((summary, gathering.finish()))
}

/// Counts and bounds of all leaves, as one row. What depends on the order of additions is gathered
/// in the order of the rows instead.
fn summary(frame: LazyFrame, leaves: &[Leaf]) -> LazyFrame {
    let mut read = vec![len().cast(DataType::Float64).alias("rows")];
    for (index, leaf) in leaves.iter().enumerate() {
        let named = |expr: Expr, kind: &str| expr.alias(format!("{kind}{index}"));
        let nulls = leaf.value.clone().null_count().cast(DataType::Float64);
        read.push(named(nulls, "null"));
        if let Some(number) = leaf.number() {
            read.push(named(number.clone().min(), "min"));
            read.push(named(number.max(), "max"));
        }
        let distinct = match leaf.measure {
            Measure::Integer | Measure::Text => Some(leaf.value.clone()),
            Measure::Float => Some(leaf.value.clone().cast(DataType::Float64)),
            Measure::Time => Some(leaf.value.clone().to_physical()),
            _ => None,
        };
        if let Some(distinct) = distinct {
            let distinct = distinct.approx_n_unique().cast(DataType::Float64);
            read.push(named(distinct, "distinct"));
        }
        if leaf.measure == Measure::Time {
            read.push(named(leaf.value.clone().min(), "first"));
            read.push(named(leaf.value.clone().max(), "last"));
        }
    }
    frame.select(read)
}

/// A number of the row of aggregates.
pub(crate) fn number_of(summary: &DataFrame, name: &str) -> Option<f64> {
    match summary.column(name).ok()?.get(0).ok()? {
        AnyValue::Float64(value) => Some(value),
        _ => None,
    }
}

fn column_profile(
    leaf: &Leaf,
    summary: &DataFrame,
    (index, rows): (usize, u64),
    totals: &LeafTotals,
    top: usize,
) -> ColumnProfile {
    let number = |kind: &str| number_of(summary, &format!("{kind}{index}"));
    let text = |kind: &str| {
        let value = summary
            .column(&format!("{kind}{index}"))
            .ok()?
            .get(0)
            .ok()?;
        (!value.is_null()).then(|| value.to_string())
    };
    let nulls = number("null").unwrap_or_default() as u64;
    let numbers = numbers(&totals.numbers, number("min"), number("max"));
    let counted = totals.counts.total() > 0 || leaf.counted().is_some();
    let exact = counted && totals.counts.is_exact();
    let distinct = if exact {
        Some(totals.counts.distinct() as u64)
    } else {
        // Null is a value of its own in the estimate.
        let estimate = number("distinct").map(|count| count as u64);
        estimate.map(|count| count.saturating_sub(u64::from(nulls > 0)))
    };
    let (numbers, lengths) = match leaf.measure {
        Measure::Integer | Measure::Float => (numbers, None),
        _ => (None, numbers),
    };
    ColumnProfile {
        name: leaf.name.clone(),
        type_name: leaf.type_name.clone(),
        nulls,
        null_share: share(nulls, rows),
        distinct,
        distinct_exact: exact,
        numbers,
        lengths,
        length_unit: leaf.unit(),
        range: text("first").zip(text("last")),
        top: totals.counts.top(top),
        top_exact: totals.counts.is_exact(),
    }
}

/// The distribution that a sketch has, between these bounds; `None` without numbers.
fn numbers(sketch: &QuantileSketch, min: Option<f64>, max: Option<f64>) -> Option<Numbers> {
    let (min, max) = (min?, max?);
    let quantiles = QUANTILES
        .iter()
        .filter_map(|share| Some((*share, sketch.quantile(*share)?.clamp(min, max))));
    Some(Numbers {
        count: sketch.count(),
        min,
        max,
        mean: sketch.mean()?,
        deviation: sketch.deviation()?,
        quantiles: quantiles.collect(),
        exact: sketch.is_exact(),
    })
}

/// The distribution of a sketch alone.
fn of_sketch(sketch: &QuantileSketch) -> Option<Numbers> {
    numbers(sketch, sketch.quantile(0.0), sketch.quantile(1.0))
}

fn of_conversation(conversation: &Conversation, totals: &Totals) -> ConversationProfile {
    let totals = &totals.conversation;
    ConversationProfile {
        columns: conversation.columns.clone(),
        turns: of_sketch(&totals.turns),
        answers: of_sketch(&totals.answers),
        answer_characters: of_sketch(&totals.answer_characters),
        images: of_sketch(&totals.images),
    }
}

pub(crate) fn share(count: u64, rows: u64) -> f64 {
    count as f64 / rows.max(1) as f64
}

/// The largest classes of a column with their rows; the rest together as `other`.
pub(crate) fn balance(
    table: &Table,
    column: &str,
    rows: u64,
) -> Result<Vec<ClassCount>, DataError> {
    let (value, _) = table.value(column)?;
    let counts = table
        .frame()
        .select([value.alias("class")])
        .group_by([col("class")])
        .agg([len().cast(DataType::UInt64).alias("count")])
        .sort_by_exprs(
            [col("count"), col("class")],
            polars::prelude::SortMultipleOptions::default()
                .with_order_descending_multi([true, false]),
        )
        .limit(CLASSES_MAX);
    let found = table.collect(counts)?;
    let mut classes = Vec::with_capacity(found.height() + 1);
    let mut listed = 0;
    for row in 0..found.height() {
        let value = |name: &str| found.column(name).ok().and_then(|it| it.get(row).ok());
        let Some(AnyValue::UInt64(count)) = value("count") else {
            continue;
        };
        let class = match value("class") {
            None | Some(AnyValue::Null) => "null".to_owned(),
            Some(AnyValue::String(text)) => label(text),
            Some(AnyValue::StringOwned(text)) => label(&text),
            Some(other) => other.to_string(),
        };
        listed += count;
        classes.push(ClassCount {
            class,
            count,
            share: share(count, rows),
        });
    }
    if listed < rows {
        classes.push(ClassCount {
            class: "other".to_owned(),
            count: rows - listed,
            share: share(rows - listed, rows),
        });
    }
    Ok(classes)
}
