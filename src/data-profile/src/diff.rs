//! What changed between two versions of a set: columns, rows, distributions and balance.

use std::sync::{Arc, Mutex, PoisonError};

use polars::prelude::{DataType, Expr, JoinArgs, JoinCoalesce, JoinType, LazyFrame, col, len, lit};
use serde::Serialize;

use crate::{
    DataError, Table,
    accumulate::{ConversationTotals, Totals},
    conversation,
    drift::{PSI_THRESHOLD, binned, by_value, js_divergence, psi},
    duplicates::{of_pass, passes, row_digest},
    leaves::{Leaf, Measure, leaves},
    profile::{ClassCount, balance, measure, number_of},
    table::{common_type, type_name},
};

/// How two sets are compared.
#[derive(Clone, Debug)]
pub struct DiffOptions {
    /// Columns that name a row in both sets; without them whole rows are compared.
    pub keys: Vec<String>,
    /// Columns whose values are classes.
    pub by: Vec<String>,
    /// Population stability index from which a column counts as drifted.
    pub threshold: f64,
}

impl Default for DiffOptions {
    fn default() -> Self {
        Self {
            keys: Vec::new(),
            by: Vec::new(),
            threshold: PSI_THRESHOLD,
        }
    }
}

/// What changed between two sets.
#[derive(Clone, Debug, Serialize)]
pub struct Diff {
    /// Rows of the old set and of the new one.
    pub rows: [u64; 2],
    /// Columns that were added, removed or have another type.
    pub schema: Vec<SchemaChange>,
    /// Rows of both sets as wholes, over the columns that both have.
    pub whole_rows: RowChanges,
    /// Rows of both sets by key, if keys were named.
    pub by_key: Option<KeyChanges>,
    /// Drift of the columns that both have and of the lengths of conversations (under
    /// `conversation.`), the greatest first.
    pub columns: Vec<ColumnDrift>,
    /// The threshold of [`ColumnDrift::drifted`].
    pub threshold: f64,
    /// Shares of classes in both sets, for each column of classes.
    pub balance: Vec<Balance>,
    /// How the files were read.
    pub notes: Vec<String>,
}

/// A difference of the columns.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct SchemaChange {
    /// Name of the column.
    pub column: String,
    /// Its type in the old set, or `None` if it is new.
    pub old: Option<String>,
    /// Its type in the new set, or `None` if it was removed.
    pub new: Option<String>,
}

/// Rows compared as wholes; equal ones are counted as often as they occur.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct RowChanges {
    /// Rows of the new set that the old one lacks.
    pub added: u64,
    /// Rows of the old set that the new one lacks.
    pub removed: u64,
    /// Rows that both sets have.
    pub unchanged: u64,
}

/// Keys of both sets.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct KeyChanges {
    /// Keys that only the new set has.
    pub added: u64,
    /// Keys that only the old set has.
    pub removed: u64,
    /// Keys whose rows are equal in both.
    pub unchanged: u64,
    /// Keys whose rows differ.
    pub changed: u64,
    /// Keys that several rows have, in the old set and in the new one.
    pub duplicated: [u64; 2],
    /// Rows without a key, in the old set and in the new one.
    pub without_key: [u64; 2],
}

/// How far the values of a column moved.
#[derive(Clone, Debug, Serialize)]
pub struct ColumnDrift {
    /// Name of the column.
    pub column: String,
    /// What was compared: `values`, `numbers`, `characters`, `items`, `bytes` or `presence`.
    pub compared: &'static str,
    /// Population stability index; a bin of its own holds the rows without a value.
    pub psi: f64,
    /// Jensen-Shannon divergence of the same histograms, from 0 to 1.
    pub js: f64,
    /// Whether the index reaches the threshold.
    pub drifted: bool,
    /// Shares of rows without a value, in both sets.
    pub null_share: [f64; 2],
    /// Means of the numbers or lengths that were compared, in both sets.
    pub mean: Option<[f64; 2]>,
}

/// The classes of a column in both sets.
#[derive(Clone, Debug, Serialize)]
pub struct Balance {
    /// Name of the column.
    pub column: String,
    /// Classes of the old set.
    pub old: Vec<ClassCount>,
    /// Classes of the new set.
    pub new: Vec<ClassCount>,
}

impl Diff {
    /// Whether the columns changed, or one of them drifted.
    pub fn is_drifted(&self) -> bool {
        // Of no rows there is no distribution to compare.
        let is_emptied = self.rows.contains(&0) && self.rows != [0, 0];
        is_emptied || !self.schema.is_empty() || self.columns.iter().any(|column| column.drifted)
    }
}

/// Compares two tables.
///
/// # Errors
/// Fails if a named column does not exist in both, if a key has types that cannot be equal, or if
/// the rows cannot be read.
pub fn diff(old: &Table, new: &Table, options: &DiffOptions) -> Result<Diff, DataError> {
    for column in options.keys.iter().chain(&options.by) {
        let _ = old.value(column)?;
        let _ = new.value(column)?;
    }
    let shared = shared_columns(old, new);
    let (rows, columns) = column_drifts((old, new), options.threshold)?;
    let pair = (old, new);
    let by_key = if options.keys.is_empty() {
        None
    } else {
        Some(key_changes(pair, &options.keys, &shared, rows)?)
    };
    let balance = options.by.iter().map(|column| {
        Ok(Balance {
            column: column.clone(),
            old: balance(old, column, rows[0])?,
            new: balance(new, column, rows[1])?,
        })
    });
    let balance = balance.collect::<Result<Vec<_>, DataError>>()?;
    Ok(Diff {
        rows,
        schema: schema_changes(old, new),
        whole_rows: row_changes(pair, &shared, rows)?,
        by_key,
        columns,
        threshold: options.threshold,
        balance,
        notes: old.notes().iter().chain(new.notes()).cloned().collect(),
    })
}

/// The rows of both tables, and the drift of each column that both have, the greatest first.
fn column_drifts(
    (old, new): (&Table, &Table),
    threshold: f64,
) -> Result<([u64; 2], Vec<ColumnDrift>), DataError> {
    let old_leaves = leaves(old.columns()).0;
    let new_leaves = leaves(new.columns()).0;
    let conversations = [old, new].map(conversation::recognise);
    let (old_summary, old_totals) = measure(old, &old_leaves, conversations[0].as_ref())?;
    let (new_summary, new_totals) = measure(new, &new_leaves, conversations[1].as_ref())?;
    let rows = [&old_summary, &new_summary]
        .map(|summary| number_of(summary, "rows").unwrap_or_default() as u64);
    let mut columns = Vec::new();
    for (index, leaf) in old_leaves.iter().enumerate() {
        let twin = new_leaves.iter().position(|other| other.name == leaf.name);
        let Some(twin) = twin.filter(|twin| comparable(leaf, &new_leaves[*twin])) else {
            continue;
        };
        let number = |kind: &str| {
            [
                number_of(&old_summary, &format!("{kind}{index}")),
                number_of(&new_summary, &format!("{kind}{twin}")),
            ]
        };
        columns.push(column_drift(
            leaf,
            (&old_totals, index),
            (&new_totals, twin),
            number,
            (rows, threshold),
        ));
    }
    if conversations.iter().all(Option::is_some) {
        columns.extend(conversation_drift(
            &old_totals.conversation,
            &new_totals.conversation,
            threshold,
        ));
    }
    columns.sort_by(|a, b| {
        b.psi
            .total_cmp(&a.psi)
            .then_with(|| a.column.cmp(&b.column))
    });
    Ok((rows, columns))
}

/// Columns of both tables with a type that holds the values of either.
fn shared_columns(old: &Table, new: &Table) -> Vec<(String, DataType)> {
    old.columns()
        .iter()
        .filter_map(|column| {
            let twin = new.columns().iter().find(|it| it.name == column.name)?;
            let shared = common_type(&column.data_type, &twin.data_type)?;
            Some((column.name.clone(), shared))
        })
        .collect()
}

fn schema_changes(old: &Table, new: &Table) -> Vec<SchemaChange> {
    let find = |table: &Table, name: &str| {
        let column = table.columns().iter().find(|it| it.name == name);
        column.map(|it| it.type_name.clone())
    };
    let removed_or_changed = old.columns().iter().filter_map(|column| {
        let now = find(new, &column.name);
        (now.as_ref() != Some(&column.type_name)).then(|| SchemaChange {
            column: column.name.clone(),
            old: Some(column.type_name.clone()),
            new: now,
        })
    });
    let is_new = |column: &&crate::Column| find(old, &column.name).is_none();
    let added = new.columns().iter().filter(is_new);
    let added = added.map(|column| SchemaChange {
        column: column.name.clone(),
        old: None,
        new: Some(column.type_name.clone()),
    });
    removed_or_changed.chain(added).collect()
}

/// Whether two columns of one name hold values of one kind.
fn comparable(old: &Leaf, new: &Leaf) -> bool {
    let number = |leaf: &Leaf| matches!(leaf.measure, Measure::Integer | Measure::Float);
    old.measure == new.measure || (number(old) && number(new))
}

fn column_drift(
    leaf: &Leaf,
    (old, old_index): (&Totals, usize),
    (new, new_index): (&Totals, usize),
    number: impl Fn(&str) -> [Option<f64>; 2],
    (rows, threshold): ([u64; 2], f64),
) -> ColumnDrift {
    let nulls = number("null").map(|nulls| nulls.unwrap_or_default() as u64);
    let (old, new) = (&old.leaves[old_index], &new.leaves[new_index]);
    let pair = (nulls[0], nulls[1]);
    let values = match leaf.measure {
        Measure::Text | Measure::Bool => by_value(&old.counts, &new.counts, pair),
        _ => None,
    };
    let (compared, (left, right)) = match (leaf.measure, values) {
        (_, Some(values)) => ("values", values),
        (Measure::Integer | Measure::Float, None) => {
            ("numbers", binned(&old.numbers, &new.numbers, pair))
        }
        (Measure::Text | Measure::List | Measure::Binary, None) => {
            (leaf.unit(), binned(&old.numbers, &new.numbers, pair))
        }
        _ => {
            let present = |side: usize| vec![nulls[side], rows[side].saturating_sub(nulls[side])];
            ("presence", (present(0), present(1)))
        }
    };
    let index = psi(&left, &right);
    let mean = old.numbers.mean().zip(new.numbers.mean());
    let mean = mean.filter(|_| compared != "values");
    ColumnDrift {
        column: leaf.name.clone(),
        compared,
        psi: index,
        js: js_divergence(&left, &right),
        drifted: index >= threshold,
        null_share: [0, 1].map(|side| nulls[side] as f64 / rows[side].max(1) as f64),
        mean: mean.map(|(old, new)| [old, new]),
    }
}

/// Drift of the lengths of conversations, as columns of their own.
fn conversation_drift(
    old: &ConversationTotals,
    new: &ConversationTotals,
    threshold: f64,
) -> Vec<ColumnDrift> {
    let lengths = [
        ("conversation.turns", &old.turns, &new.turns),
        ("conversation.answers", &old.answers, &new.answers),
        (
            "conversation.answer_characters",
            &old.answer_characters,
            &new.answer_characters,
        ),
        ("conversation.images", &old.images, &new.images),
    ];
    lengths
        .into_iter()
        .filter(|(_, old, new)| old.count() > 0 && new.count() > 0)
        .map(|(column, old, new)| {
            let (left, right) = binned(old, new, (0, 0));
            let index = psi(&left, &right);
            ColumnDrift {
                column: column.to_owned(),
                compared: "numbers",
                psi: index,
                js: js_divergence(&left, &right),
                drifted: index >= threshold,
                null_share: [0.0, 0.0],
                mean: old.mean().zip(new.mean()).map(|(old, new)| [old, new]),
            }
        })
        .collect()
}

/// The digest of these columns, each with the type that both tables share.
fn digest_of(columns: &[(String, DataType)]) -> Expr {
    let values = columns
        .iter()
        .map(|(name, shared)| col(name.as_str()).cast(shared.clone()));
    row_digest(values.collect())
}

/// Rows of two plans with a digest, joined on it; digests that one lacks are null there.
pub(crate) fn full_join(left: LazyFrame, right: LazyFrame) -> LazyFrame {
    let mut how = JoinArgs::new(JoinType::Full);
    how.coalesce = JoinCoalesce::CoalesceColumns;
    left.join(right, [col("digest")], [col("digest")], how)
}

fn row_changes(
    (old, new): (&Table, &Table),
    shared: &[(String, DataType)],
    rows: [u64; 2],
) -> Result<RowChanges, DataError> {
    if shared.is_empty() {
        return Ok(RowChanges {
            added: rows[1],
            removed: rows[0],
            unchanged: 0,
        });
    }
    let changes = Arc::new(Mutex::new(RowChanges::default()));
    let passes = passes(rows[0].max(rows[1]));
    for pass in 0..passes {
        let grouped = |table: &Table, name: &str| {
            let rows = table.frame().select([digest_of(shared).alias("digest")]);
            of_pass(rows, "digest", (pass, passes))
                .group_by([col("digest")])
                .agg([len().cast(DataType::UInt64).alias(name)])
        };
        let joined = full_join(grouped(old, "old"), grouped(new, "new"));
        let joined = joined.select([
            col("old").fill_null(lit(0_u64)),
            col("new").fill_null(lit(0_u64)),
        ]);
        let changes = Arc::clone(&changes);
        old.for_each_batch(joined, move |batch| {
            let old = batch.column("old")?.as_materialized_series().u64()?;
            let new = batch.column("new")?.as_materialized_series().u64()?;
            let mut changes = changes.lock().unwrap_or_else(PoisonError::into_inner);
            for (old, new) in old.iter().flatten().zip(new.iter().flatten()) {
                changes.unchanged += old.min(new);
                changes.removed += old.saturating_sub(new);
                changes.added += new.saturating_sub(old);
            }
            Ok(())
        })?;
    }
    let changes = changes.lock().unwrap_or_else(PoisonError::into_inner);
    Ok(changes.clone())
}

/// A column of a key, on either side with the type that both share.
#[derive(Clone)]
pub(crate) struct Key {
    pub(crate) name: String,
    pub(crate) values: [Expr; 2],
}

/// The columns of a key in both tables.
pub(crate) fn shared_keys(
    (left, right): (&Table, &Table),
    keys: &[String],
) -> Result<Vec<Key>, DataError> {
    keys.iter()
        .map(|key| {
            let ((left, left_type), (right, right_type)) = (left.value(key)?, right.value(key)?);
            let shared =
                common_type(&left_type, &right_type).ok_or_else(|| DataError::KeyType {
                    column: key.clone(),
                    left: type_name(&left_type),
                    right: type_name(&right_type),
                })?;
            Ok(Key {
                name: key.clone(),
                values: [left.cast(shared.clone()), right.cast(shared)],
            })
        })
        .collect()
}

/// Whether a row has a key, a value in each of its columns, and the digest of these.
pub(crate) fn key_of(keys: &[Key], side: usize) -> (Expr, Expr) {
    let values = keys.iter().map(|key| key.values[side].clone());
    let known = values.clone().map(Expr::is_not_null).reduce(Expr::and);
    (known.unwrap_or(lit(true)), row_digest(values.collect()))
}

fn key_changes(
    (old, new): (&Table, &Table),
    keys: &[String],
    shared: &[(String, DataType)],
    rows: [u64; 2],
) -> Result<KeyChanges, DataError> {
    let keys = shared_keys((old, new), keys)?;
    let found = Arc::new(Mutex::new((KeyChanges::default(), [0_u64; 2])));
    let passes = passes(rows[0].max(rows[1]));
    for pass in 0..passes {
        let grouped = |table: &Table, (index, side): (usize, &str)| {
            let (known, digest) = key_of(&keys, index);
            let rows = table
                .frame()
                .filter(known)
                .select([digest.alias("digest"), digest_of(shared).alias("row")]);
            // The rows of a key are equal in both sets if their digests have one range and number.
            of_pass(rows, "digest", (pass, passes))
                .group_by([col("digest")])
                .agg([
                    len().cast(DataType::UInt64).alias(format!("{side}_count")),
                    col("row").min().alias(format!("{side}_low")),
                    col("row").max().alias(format!("{side}_high")),
                ])
        };
        let joined = full_join(grouped(old, (0, "old")), grouped(new, (1, "new")));
        let same = ["count", "low", "high"]
            .map(|part| col(format!("old_{part}")).eq(col(format!("new_{part}"))))
            .into_iter()
            .reduce(Expr::and)
            .unwrap_or(lit(true));
        let joined = joined.select([
            col("old_count").fill_null(lit(0_u64)),
            col("new_count").fill_null(lit(0_u64)),
            same.fill_null(lit(false)).alias("same"),
        ]);
        let found = Arc::clone(&found);
        old.for_each_batch(joined, move |batch| {
            let old = batch.column("old_count")?.as_materialized_series().u64()?;
            let new = batch.column("new_count")?.as_materialized_series().u64()?;
            let same = batch.column("same")?.as_materialized_series().bool()?;
            let mut found = found.lock().unwrap_or_else(PoisonError::into_inner);
            let rows = old.iter().flatten().zip(new.iter().flatten());
            for ((old, new), same) in rows.zip(same.iter().flatten()) {
                found.0.add([old, new], same);
                found.1[0] += old;
                found.1[1] += new;
            }
            Ok(())
        })?;
    }
    let found = found.lock().unwrap_or_else(PoisonError::into_inner);
    let (mut changes, counted) = found.clone();
    changes.without_key = [0, 1].map(|side| rows[side].saturating_sub(counted[side]));
    Ok(changes)
}

impl KeyChanges {
    fn add(&mut self, counts: [u64; 2], same: bool) {
        match counts {
            [0, _] => self.added += 1,
            [_, 0] => self.removed += 1,
            _ if same => self.unchanged += 1,
            _ => self.changed += 1,
        }
        for (duplicated, count) in self.duplicated.iter_mut().zip(counts) {
            *duplicated += u64::from(count > 1);
        }
    }
}
