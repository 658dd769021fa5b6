//! Joins of two sets into one file.

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use polars::prelude::{
    DataFrame, DataType, Expr, JoinArgs, JoinBuildSide, JoinCoalesce, JoinType, LazyFrame,
    MaintainOrderJoin, ParquetWriter, PolarsResult, Schema, col, len, lit,
};
use serde::Serialize;
use tempfile::NamedTempFile;

use crate::{
    DataError, Table,
    diff::{Key, full_join, key_of, shared_keys},
    duplicates::{of_pass, passes},
    table::type_name,
};

/// Bytes of files on the right side whose rows are held in memory in one pass.
const BUILD_BYTES: u64 = 256 << 20;
/// Bytes of rows that are gathered into a row group of Parquet.
const GROUP_BYTES: usize = 64 << 20;
/// Rows of a row group at most.
const GROUP_ROWS: usize = 1 << 17;
/// What follows the name of a column on the right that the left has too.
const SUFFIX: &str = "_right";

/// Which rows a join keeps.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum JoinHow {
    /// Pairs of rows whose keys are equal.
    Inner,
    /// All rows of the left set, with those of the right one where keys are equal.
    Left,
    /// Rows of the left set whose key the right one has.
    Semi,
    /// Rows of the left set whose key the right one lacks.
    Anti,
}

/// What to join, and where to.
#[derive(Clone, Debug)]
pub struct JoinOptions {
    /// Columns that have to be equal.
    pub on: Vec<String>,
    /// Which rows are kept.
    pub how: JoinHow,
    /// The file to write, `.parquet` or `.jsonl`; it must not exist.
    pub out: PathBuf,
}

/// What a join did.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct JoinReport {
    /// Rows of the left set and of the right one.
    pub rows: [u64; 2],
    /// Rows of the left set whose key the right one lacks, and the other way round.
    pub unmatched: [u64; 2],
    /// Keys that several rows have, on the left and on the right.
    pub duplicate_keys: [u64; 2],
    /// Rows without a key, which match nothing, on the left and on the right.
    pub without_key: [u64; 2],
    /// Keys with several rows on both sides: each of their rows is paired with each.
    pub many_to_many: u64,
    /// Rows that were written.
    pub written: u64,
    /// Columns of the right set that got another name: what it was, and what it is.
    pub renamed: Vec<(String, String)>,
    /// The file that was written.
    pub out: PathBuf,
    /// How the files were read.
    pub notes: Vec<String>,
}

impl JoinReport {
    /// Whether rows of the left set occur more than once in the output.
    pub fn multiplies(&self) -> bool {
        self.written > self.rows[0]
    }
}

/// Joins two tables into a file, which appears only when it is whole. Rows follow the order of
/// the left set; if the files on the right have more than 256 MiB, the rows of each pass do.
///
/// # Errors
/// Fails if the output exists or cannot be written, if a key is missing or has types that cannot
/// be equal, if a column has no single type, or if the rows cannot be read.
pub fn join(left: &Table, right: &Table, options: &JoinOptions) -> Result<JoinReport, DataError> {
    let format = OutputFormat::of(&options.out)?;
    if options.out.symlink_metadata().is_ok() {
        return Err(DataError::Exists {
            path: options.out.clone(),
        });
    }
    let keys = shared_keys((left, right), &options.on)?;
    let sides: &[&Table] = match options.how {
        JoinHow::Inner | JoinHow::Left => &[left, right],
        JoinHow::Semi | JoinHow::Anti => &[left],
    };
    for table in sides {
        refuse_mixed(table)?;
    }
    let counts = count_keys((left, right), &keys)?;
    let renamed = renamed(left, right, options);
    let schema = joined((left, right), &keys, options.how, (0, 1)).collect_schema();
    let schema = schema.map_err(|error| DataError::Engine {
        path: left.first_path(),
        message: error.to_string(),
    })?;
    if format == OutputFormat::JsonLines {
        refuse_bytes(&schema, &options.out)?;
    }
    let output = Output::create(&options.out, format, &schema)?;
    let output = Arc::new(Mutex::new(output));
    let passes = right.bytes().div_ceil(BUILD_BYTES).max(1);
    for pass in 0..passes {
        let plan = joined((left, right), &keys, options.how, (pass, passes));
        let writer = Arc::clone(&output);
        let done = left.for_each_batch(plan, move |batch| {
            writer
                .lock()
                .unwrap_or_else(PoisonError::into_inner)
                .add(&batch)
        });
        if let Err(error) = done {
            let mut output = output.lock().unwrap_or_else(PoisonError::into_inner);
            return Err(output.failure.take().unwrap_or(error));
        }
    }
    let mut output = output.lock().unwrap_or_else(PoisonError::into_inner);
    let written = output.finish()?;
    Ok(JoinReport {
        rows: [counts.rows[0], counts.rows[1]],
        unmatched: counts.unmatched,
        duplicate_keys: counts.duplicates,
        without_key: counts.without_key,
        many_to_many: counts.many_to_many,
        written,
        renamed,
        out: options.out.clone(),
        notes: left.notes().iter().chain(right.notes()).cloned().collect(),
    })
}

/// The plan of one pass.
fn joined(
    (left, right): (&Table, &Table),
    keys: &[Key],
    how: JoinHow,
    pass: (u64, u64),
) -> LazyFrame {
    let name = |index: usize| format!("{MARK}{index}");
    let side = |table: &Table, side: usize| {
        let values = keys.iter().enumerate();
        let mut added: Vec<Expr> = values
            .map(|(index, key)| key.values[side].clone().alias(name(index)))
            .collect();
        if pass.1 > 1 {
            added.push(key_of(keys, side).1.alias(MARK));
        }
        of_pass(table.frame().with_columns(added), MARK, pass)
    };
    // A key that is a column of its own on the right is the one on the left.
    let kept: Vec<Expr> = right
        .columns()
        .iter()
        .filter(|column| !keys.iter().any(|key| key.name == column.name))
        .map(|column| col(column.name.as_str()))
        .chain((0..keys.len()).map(|index| col(name(index))))
        .collect();
    let mut args = JoinArgs::new(match how {
        JoinHow::Inner => JoinType::Inner,
        JoinHow::Left => JoinType::Left,
        JoinHow::Semi => JoinType::Semi,
        JoinHow::Anti => JoinType::Anti,
    });
    args.suffix = Some(SUFFIX.into());
    args.coalesce = JoinCoalesce::CoalesceColumns;
    args.maintain_order = MaintainOrderJoin::Left;
    args.build_side = Some(JoinBuildSide::ForceRight);
    let on: Vec<Expr> = (0..keys.len()).map(|index| col(name(index))).collect();
    let right_side = side(right, 1).select(kept);
    side(left, 0)
        .join(right_side, on.clone(), on, args)
        .select(output_columns((left, right), keys, how))
}

/// The columns that are written: those of the left set, then those of the right one.
fn output_columns((left, right): (&Table, &Table), keys: &[Key], how: JoinHow) -> Vec<Expr> {
    let mut columns: Vec<Expr> = left
        .columns()
        .iter()
        .map(|column| col(column.name.as_str()))
        .collect();
    if matches!(how, JoinHow::Inner | JoinHow::Left) {
        let own = right
            .columns()
            .iter()
            .filter(|column| !keys.iter().any(|key| key.name == column.name));
        columns.extend(own.map(|column| {
            if left.columns().iter().any(|it| it.name == column.name) {
                col(format!("{}{SUFFIX}", column.name))
            } else {
                col(column.name.as_str())
            }
        }));
    }
    columns
}

/// How the names of columns begin that no set has.
const MARK: &str = "\u{1}key";

fn renamed(left: &Table, right: &Table, options: &JoinOptions) -> Vec<(String, String)> {
    if matches!(options.how, JoinHow::Semi | JoinHow::Anti) {
        return Vec::new();
    }
    let taken = |name: &str| left.columns().iter().any(|column| column.name == name);
    right
        .columns()
        .iter()
        .filter(|column| taken(&column.name) && !options.on.contains(&column.name))
        .map(|column| (column.name.clone(), format!("{}{SUFFIX}", column.name)))
        .collect()
}

fn refuse_mixed(table: &Table) -> Result<(), DataError> {
    match table.mixed().first() {
        Some(mixed) => Err(DataError::Mixed {
            column: mixed.path.clone(),
            kinds: mixed.kinds.clone(),
            path: table.first_path(),
        }),
        None => Ok(()),
    }
}

/// JSON has no bytes.
fn refuse_bytes(schema: &Schema, out: &Path) -> Result<(), DataError> {
    fn in_json(data_type: &DataType) -> bool {
        match data_type {
            DataType::Binary | DataType::BinaryOffset => false,
            DataType::List(inner) | DataType::Array(inner, _) => in_json(inner),
            DataType::Struct(fields) => fields.iter().all(|field| in_json(&field.dtype)),
            _ => true,
        }
    }
    match schema.iter().find(|(_, data_type)| !in_json(data_type)) {
        Some((name, data_type)) => Err(DataError::NotInJson {
            column: name.to_string(),
            kind: type_name(data_type),
            path: out.to_owned(),
        }),
        None => Ok(()),
    }
}

#[derive(Clone, Copy, Default)]
struct KeyCounts {
    rows: [u64; 2],
    keyed: [u64; 2],
    unmatched: [u64; 2],
    duplicates: [u64; 2],
    without_key: [u64; 2],
    many_to_many: u64,
}

impl KeyCounts {
    fn add(&mut self, counts: [u64; 2]) {
        for (side, count) in counts.into_iter().enumerate() {
            self.keyed[side] += count;
            self.duplicates[side] += u64::from(count > 1);
            if counts[1 - side] == 0 {
                self.unmatched[side] += count;
            }
        }
        self.many_to_many += u64::from(counts[0] > 1 && counts[1] > 1);
    }
}

fn count_keys((left, right): (&Table, &Table), keys: &[Key]) -> Result<KeyCounts, DataError> {
    let mut rows = [0; 2];
    for (table, rows) in [left, right].into_iter().zip(&mut rows) {
        let counted = table
            .frame()
            .select([len().cast(DataType::Float64).alias("rows")]);
        let counted = table.collect(counted)?;
        let counted = crate::profile::number_of(&counted, "rows");
        *rows = counted.unwrap_or_default() as u64;
    }
    let counts = Arc::new(Mutex::new(KeyCounts::default()));
    let passes = passes(rows[0].max(rows[1]));
    for pass in 0..passes {
        let grouped = |table: &Table, (side, name): (usize, &str)| {
            let (known, digest) = key_of(keys, side);
            let rows = table.frame().filter(known).select([digest.alias("digest")]);
            of_pass(rows, "digest", (pass, passes))
                .group_by([col("digest")])
                .agg([len().cast(DataType::UInt64).alias(name)])
        };
        let plan = full_join(grouped(left, (0, "left")), grouped(right, (1, "right"))).select([
            col("left").fill_null(lit(0_u64)),
            col("right").fill_null(lit(0_u64)),
        ]);
        let counts = Arc::clone(&counts);
        left.for_each_batch(plan, move |batch| {
            let left = batch.column("left")?.as_materialized_series().u64()?;
            let right = batch.column("right")?.as_materialized_series().u64()?;
            let mut counts = counts.lock().unwrap_or_else(PoisonError::into_inner);
            for (left, right) in left.iter().flatten().zip(right.iter().flatten()) {
                counts.add([left, right]);
            }
            Ok(())
        })?;
    }
    let mut counts = *counts.lock().unwrap_or_else(PoisonError::into_inner);
    counts.rows = rows;
    for (side, all) in rows.into_iter().enumerate() {
        counts.without_key[side] = all.saturating_sub(counts.keyed[side]);
        counts.unmatched[side] += counts.without_key[side];
    }
    Ok(counts)
}

/// The format of an output.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum OutputFormat {
    Parquet,
    JsonLines,
}

impl OutputFormat {
    fn of(path: &Path) -> Result<Self, DataError> {
        match path.extension().and_then(|it| it.to_str()) {
            Some("parquet") => Ok(Self::Parquet),
            Some("jsonl" | "ndjson") => Ok(Self::JsonLines),
            _ => Err(DataError::OutputFormat {
                path: path.to_owned(),
            }),
        }
    }
}

enum Writer {
    Parquet(Box<polars::io::parquet::write::BatchedWriter<File>>),
    JsonLines(BufWriter<File>),
}

/// A file under a temporary name beside its place.
struct Output {
    path: PathBuf,
    file: Option<NamedTempFile>,
    writer: Writer,
    gathered: Option<DataFrame>,
    written: u64,
    failure: Option<DataError>,
}

impl Output {
    fn create(path: &Path, format: OutputFormat, schema: &Schema) -> Result<Self, DataError> {
        let failed = |source| DataError::io("write", path, source);
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let file = NamedTempFile::with_prefix_in(".reel-join-", folder).map_err(failed)?;
        let handle = file.reopen().map_err(failed)?;
        let writer = match format {
            OutputFormat::Parquet => {
                let writer = ParquetWriter::new(handle).batched(schema);
                Writer::Parquet(Box::new(writer.map_err(|error| DataError::Engine {
                    path: path.to_owned(),
                    message: error.to_string(),
                })?))
            }
            OutputFormat::JsonLines => Writer::JsonLines(BufWriter::with_capacity(1 << 18, handle)),
        };
        Ok(Self {
            path: path.to_owned(),
            file: Some(file),
            writer,
            gathered: None,
            written: 0,
            failure: None,
        })
    }

    /// Takes rows, and writes them when there are enough for a row group.
    fn add(&mut self, batch: &DataFrame) -> PolarsResult<()> {
        self.written += batch.height() as u64;
        match &mut self.gathered {
            Some(gathered) => {
                gathered.vstack_mut(batch)?;
            }
            None => self.gathered = Some(batch.clone()),
        }
        let enough = self.gathered.as_ref().is_some_and(|rows| {
            rows.height() >= GROUP_ROWS || rows.estimated_size() >= GROUP_BYTES
        });
        if enough { self.write() } else { Ok(()) }
    }

    fn write(&mut self) -> PolarsResult<()> {
        let Some(mut rows) = self.gathered.take() else {
            return Ok(());
        };
        rows.rechunk_mut();
        let written = match &mut self.writer {
            Writer::Parquet(writer) => writer.write_batch(&rows),
            Writer::JsonLines(lines) => {
                polars::io::json::BatchedWriter::new(lines).write_batch(&rows)
            }
        };
        if let Err(error) = &written {
            self.failure = Some(self.cannot_write(error.to_string()));
        }
        written
    }

    fn cannot_write(&self, message: String) -> DataError {
        DataError::io("write", &self.path, std::io::Error::other(message))
    }

    /// Ends the file and gives it its name.
    fn finish(&mut self) -> Result<u64, DataError> {
        if let Err(error) = self.write() {
            return Err(self.cannot_write(error.to_string()));
        }
        let path = self.path.clone();
        let failed = |source| DataError::io("write", &path, source);
        match &mut self.writer {
            Writer::Parquet(writer) => {
                let ended = writer.finish().map_err(|error| error.to_string());
                ended.map_err(|message| self.cannot_write(message))?;
            }
            Writer::JsonLines(lines) => lines.flush().map_err(failed)?,
        }
        let Some(file) = self.file.take() else {
            return Ok(self.written);
        };
        file.as_file().sync_all().map_err(failed)?;
        file.persist_noclobber(&self.path)
            .map_err(|error| match error.error.kind() {
                std::io::ErrorKind::AlreadyExists => DataError::Exists { path: path.clone() },
                _ => DataError::io("write", &path, error.error),
            })?;
        Ok(self.written)
    }
}
