//! Files of rows as one lazy table, and the only place that executes a plan of Polars.

use std::{
    fs::File,
    io::{BufWriter, Write as _},
    num::NonZeroUsize,
    panic::{AssertUnwindSafe, catch_unwind},
    path::{Path, PathBuf},
};

use polars::lazy::prelude::PlanCallback;
use polars::prelude::{
    DataFrame, DataType, Engine, Expr, Field, IdxSize, LazyFileListReader as _, LazyFrame,
    LazyJsonLineReader, PlRefPath, PlSmallStr, PolarsResult, ScanArgsParquet, Schema, SchemaRef,
    TimeUnit, UnionArgs, col, concat, lit,
};
use reel_dataset::lint::{JsonError, JsonTexts};
use tempfile::TempDir;

use crate::{
    DataError, FileFormat, SourceFile,
    json_shape::{MixedColumn, Shape, read_row},
    parquet_check,
    sources::{self, Compression, open_text},
};

/// A column of a table.
#[derive(Clone, PartialEq, Debug)]
pub struct Column {
    /// Name of the column.
    pub name: String,
    /// Its type in words, with the types of what is nested: `list[struct{role: text}]`.
    pub type_name: String,
    pub(crate) data_type: DataType,
}

/// The rows of one or more files as one table.
pub struct Table {
    frame: LazyFrame,
    columns: Vec<Column>,
    files: Vec<SourceFile>,
    notes: Vec<String>,
    mixed: Vec<MixedColumn>,
    /// Rows that are read at a time, where the scan can begin at any row.
    slice: Option<u64>,
    /// JSON lists as lines, for the reader of Polars.
    staged: Option<TempDir>,
}

/// Files of one schema that follow each other.
struct Part {
    frame: LazyFrame,
    schema: Schema,
    path: PathBuf,
    /// Rows and their bytes, of Parquet; 0 for JSON.
    size: (u64, u64),
}

/// Bytes of rows that are read at a time. Polars decodes some thirty batches of 100,000 rows ahead
/// of what takes them.
const SLICE_BYTES: u64 = 128 << 20;
/// Rows below which reading at a time does not pay.
const SLICE_ROWS_MIN: u64 = 1 << 14;

impl Table {
    /// Opens files, folders and patterns as one table, in the order given; folders are searched to
    /// any depth. A column that some files lack is null there.
    ///
    /// JSON files are read once here, to learn their types and to find a broken row.
    ///
    /// # Errors
    /// Fails if there is no file of rows, if one cannot be read or has a broken row, or if two
    /// give a column types that have none in common.
    pub fn open(paths: &[PathBuf]) -> Result<Self, DataError> {
        let (files, notes) = sources::find(paths)?;
        let mut table = Self {
            frame: LazyFrame::default(),
            columns: Vec::new(),
            files,
            notes: notes.iter().map(|it| format!("left out: {it}")).collect(),
            mixed: Vec::new(),
            slice: None,
            staged: None,
        };
        let mut shape = Shape::default();
        let readable = table.read_json(&mut shape)?;
        let json = json_schema(&shape, &mut table.mixed);
        let parts = table.parts(&readable, &json)?;
        let first = table.first_path();
        if parts.is_empty() {
            return Err(DataError::Empty { path: first });
        }
        let schema = common_schema(&parts)?;
        if schema.is_empty() {
            return Err(DataError::Empty { path: first });
        }
        let engine = |error: polars::error::PolarsError| DataError::Engine {
            path: first.clone(),
            message: one_line(&error.to_string()),
        };
        table.slice = match &parts[..] {
            [part] if part.size.0 > 0 => {
                let row = part.size.1.div_ceil(part.size.0).max(1);
                Some((SLICE_BYTES / row).max(SLICE_ROWS_MIN))
            }
            _ => None,
        };
        let frames: Vec<LazyFrame> = parts
            .into_iter()
            .map(|part| conform(part, &schema))
            .collect();
        table.frame = match <[LazyFrame; 1]>::try_from(frames) {
            Ok([frame]) => frame,
            Err(frames) => concat(
                frames,
                UnionArgs {
                    parallel: false,
                    maintain_order: true,
                    ..UnionArgs::default()
                },
            )
            .map_err(engine)?,
        };
        table.columns = columns_of(&schema, &shape, &json);
        for mixed in &table.mixed {
            table.notes.push(format!(
                "column '{}' holds {}; it is read as text",
                mixed.path, mixed.kinds
            ));
        }
        Ok(table)
    }

    /// The columns, in the order in which the files first name them.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }

    /// The files, in the order of their rows.
    pub fn files(&self) -> &[SourceFile] {
        &self.files
    }

    /// What a reader has to know about how the files were read.
    pub fn notes(&self) -> &[String] {
        &self.notes
    }

    /// Size of all files in bytes.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }

    pub(crate) fn mixed(&self) -> &[MixedColumn] {
        &self.mixed
    }

    pub(crate) fn frame(&self) -> LazyFrame {
        self.frame.clone()
    }

    pub(crate) fn first_path(&self) -> PathBuf {
        self.files
            .first()
            .map(|file| file.path.clone())
            .unwrap_or_default()
    }

    /// The values of a column, or of a field of a struct under the names of both joined by a dot,
    /// and their type.
    pub(crate) fn value(&self, name: &str) -> Result<(Expr, DataType), DataError> {
        let columns = self.columns.iter();
        let found = columns.clone().find_map(|column| {
            let path = name.strip_prefix(&column.name)?;
            field_of(col(column.name.as_str()), &column.data_type, path)
        });
        found.ok_or_else(|| DataError::NoColumn {
            column: name.to_owned(),
            known: columns
                .map(|column| column.name.as_str())
                .collect::<Vec<_>>()
                .join(", "),
            path: self.first_path(),
        })
    }

    /// Executes a plan over the table whose result is small.
    pub(crate) fn collect(&self, plan: LazyFrame) -> Result<DataFrame, DataError> {
        executed(|| {
            let result = plan.collect_with_engine(Engine::Streaming)?;
            Ok(result.unwrap_single())
        })
        .map_err(|message| self.blame(message))
    }

    /// Executes a plan that has a row for each row of the table, and gives them to `take`, in order and in
    /// small batches.
    ///
    /// Where the scan can begin at any of the `rows`, only some are read at a time.
    pub(crate) fn for_each_row(
        &self,
        plan: &LazyFrame,
        rows: u64,
        take: impl Fn(DataFrame) -> PolarsResult<()> + Clone + Send + Sync + 'static,
    ) -> Result<(), DataError> {
        let slice = self.slice.unwrap_or(rows).max(1);
        let mut begin = 0;
        while begin < rows {
            let length = IdxSize::try_from(slice.min(rows - begin)).unwrap_or(IdxSize::MAX);
            let part = plan
                .clone()
                .slice(i64::try_from(begin).unwrap_or(i64::MAX), length);
            self.for_each_batch(part, take.clone())?;
            begin += u64::from(length);
        }
        Ok(())
    }

    /// Executes a plan over the table and gives its rows to `take`, in order and in small batches.
    pub(crate) fn for_each_batch(
        &self,
        plan: LazyFrame,
        take: impl Fn(DataFrame) -> PolarsResult<()> + Send + Sync + 'static,
    ) -> Result<(), DataError> {
        for_each_batch(plan, take).map_err(|message| self.blame(message))
    }

    /// The error of a plan, with the file that cannot be read, if it is one of them.
    fn blame(&self, message: String) -> DataError {
        for file in &self.files {
            if file.format != FileFormat::Parquet {
                continue;
            }
            let read = scan_parquet(&[&file.path]).map_err(|error| one_line(&error.to_string()));
            let read = read.and_then(|frame| for_each_batch(frame, |_| Ok(())));
            if let Err(message) = read {
                return DataError::Parquet {
                    path: file.path.clone(),
                    message,
                };
            }
        }
        DataError::Engine {
            path: self.first_path(),
            message,
        }
    }

    /// Reads every JSON file once; gives for each file of the set the path that Polars can read.
    fn read_json(&mut self, shape: &mut Shape) -> Result<Vec<PathBuf>, DataError> {
        let mut readable = Vec::with_capacity(self.files.len());
        for (index, file) in self.files.iter().enumerate() {
            if file.format != FileFormat::Json {
                readable.push(file.path.clone());
                continue;
            }
            let failed = |source| DataError::io("read", &file.path, source);
            let (mut reader, compression) = open_text(&file.path).map_err(failed)?;
            let head = reader.fill_buf().map_err(failed)?;
            let marked = head.starts_with(b"\xef\xbb\xbf");
            let list = head
                .strip_prefix(b"\xef\xbb\xbf")
                .unwrap_or(head)
                .trim_ascii_start()
                .starts_with(b"[");
            let mut staged = None;
            // Polars reads lines only, and unpacks only files that hold one compressed stream.
            if list || marked || compression != Compression::None {
                if self.staged.is_none() {
                    let made = tempfile::tempdir();
                    self.staged = Some(made.map_err(|source| {
                        DataError::io("make a temporary folder", &std::env::temp_dir(), source)
                    })?);
                }
                let folder = self.staged.as_ref().map(TempDir::path);
                let path = folder
                    .unwrap_or(Path::new(""))
                    .join(format!("{index}.jsonl"));
                let made =
                    File::create(&path).map_err(|source| DataError::io("write", &path, source))?;
                staged = Some((path, BufWriter::with_capacity(1 << 18, made)));
            }
            read_rows(reader, file, shape, staged.as_mut())?;
            readable.push(staged.map_or_else(|| file.path.clone(), |(path, _)| path));
        }
        Ok(readable)
    }

    /// The files as scans, those of one schema that follow each other together.
    fn parts(&self, readable: &[PathBuf], json: &Schema) -> Result<Vec<Part>, DataError> {
        let mut parts: Vec<Part> = Vec::new();
        let mut group: Group = Group::default();
        let mut known: Option<(FileFormat, Schema)> = None;
        let files = self.files.iter().zip(readable);
        for (file, path) in files {
            let (schema, size) = match file.format {
                FileFormat::Json => (json.clone(), (0, 0)),
                FileFormat::Parquet => {
                    let size = parquet_check::check(&file.path)?;
                    (parquet_schema(&file.path)?, size)
                }
            };
            let found = (file.format, schema);
            if known.as_ref().is_some_and(|known| *known != found) {
                close(&mut parts, &mut group, known.take())?;
            }
            known = Some(found);
            group.paths.push(path.clone());
            group.size.0 += size.0;
            group.size.1 += size.1;
        }
        close(&mut parts, &mut group, known)?;
        Ok(parts)
    }
}

/// The field of a value under a path of names, each with a dot before it.
fn field_of(value: Expr, data_type: &DataType, path: &str) -> Option<(Expr, DataType)> {
    if path.is_empty() {
        return Some((value, data_type.clone()));
    }
    let path = path.strip_prefix('.')?;
    let DataType::Struct(fields) = data_type else {
        return None;
    };
    fields.iter().find_map(|field| {
        let rest = path.strip_prefix(field.name.as_str())?;
        let value = value.clone().struct_().field_by_name(&field.name);
        field_of(value, &field.dtype, rest)
    })
}

/// Files of one schema, with their rows and the bytes of these.
#[derive(Default)]
struct Group {
    paths: Vec<PathBuf>,
    size: (u64, u64),
}

/// Ends a group of files of one schema.
fn close(
    parts: &mut Vec<Part>,
    group: &mut Group,
    known: Option<(FileFormat, Schema)>,
) -> Result<(), DataError> {
    let Some((format, schema)) = known else {
        return Ok(());
    };
    let Group { paths, size } = std::mem::take(group);
    let Some(path) = paths.first().cloned() else {
        return Ok(());
    };
    let frame = match format {
        FileFormat::Parquet => scan_parquet(&paths),
        FileFormat::Json => scan_json(&paths, &schema),
    };
    // JSON files without a row have no column.
    if schema.is_empty() {
        return Ok(());
    }
    let frame = frame.map_err(|error| DataError::Engine {
        path: path.clone(),
        message: one_line(&error.to_string()),
    })?;
    parts.push(Part {
        frame,
        schema,
        path,
        size,
    });
    Ok(())
}

/// Reads all rows of a JSON file into a shape, and copies them as lines where asked to.
fn read_rows(
    reader: Box<dyn std::io::BufRead>,
    file: &SourceFile,
    shape: &mut Shape,
    mut staged: Option<&mut (PathBuf, BufWriter<File>)>,
) -> Result<(), DataError> {
    let broken = |error: JsonError| DataError::Row {
        path: file.path.clone(),
        line: error.line,
        column: error.column,
        message: error.message,
    };
    for row in JsonTexts::new(reader) {
        let text = row.text.as_ref().map_err(|error| broken(error.clone()))?;
        read_row(text, row.line, shape).map_err(|error| broken(row.error(&error)))?;
        if let Some((path, lines)) = staged.as_deref_mut() {
            // Line breaks between the tokens of an item; those in texts are escaped.
            let line: Vec<u8> = text
                .iter()
                .map(|byte| match byte {
                    b'\n' | b'\r' => b' ',
                    other => *other,
                })
                .collect();
            lines
                .write_all(&line)
                .and_then(|()| lines.write_all(b"\n"))
                .map_err(|source| DataError::io("write", path, source))?;
        }
    }
    if let Some((path, lines)) = staged {
        lines
            .flush()
            .map_err(|source| DataError::io("write", path, source))?;
    }
    Ok(())
}

fn json_schema(shape: &Shape, mixed: &mut Vec<MixedColumn>) -> Schema {
    let fields = shape
        .fields()
        .iter()
        .map(|(name, shape)| Field::new(PlSmallStr::from_str(name), shape.data_type(name, mixed)));
    fields.collect()
}

fn columns_of(schema: &Schema, shape: &Shape, json: &Schema) -> Vec<Column> {
    let columns = schema.iter().map(|(name, data_type)| {
        let only_null = schema.len() == json.len()
            && shape
                .fields()
                .get(name.as_str())
                .is_some_and(Shape::is_null);
        Column {
            name: name.to_string(),
            type_name: if only_null {
                "null".to_owned()
            } else {
                type_name(data_type)
            },
            data_type: data_type.clone(),
        }
    });
    columns.collect()
}

/// The columns of all parts, each with a type that holds the values of every part.
fn common_schema(parts: &[Part]) -> Result<Schema, DataError> {
    let mut common = Schema::default();
    let mut origins: Vec<&Path> = Vec::new();
    for part in parts {
        for (name, data_type) in part.schema.iter() {
            let plain = plain_type(data_type);
            let Some((index, _, known)) = common.get_full(name) else {
                common.insert(name.clone(), plain);
                origins.push(&part.path);
                continue;
            };
            let joined = common_type(known, &plain).ok_or_else(|| DataError::Conflict {
                column: name.to_string(),
                left: type_name(known),
                right: type_name(&plain),
                left_path: origins[index].to_owned(),
                right_path: part.path.clone(),
            })?;
            common.insert(name.clone(), joined);
        }
    }
    Ok(common)
}

/// Types whose values compare across files: categories become their texts.
fn plain_type(data_type: &DataType) -> DataType {
    match data_type {
        DataType::Categorical(..) | DataType::Enum(..) => DataType::String,
        DataType::List(inner) => DataType::List(Box::new(plain_type(inner))),
        other => other.clone(),
    }
}

/// The type that holds the values of both without loss, or `None` if there is none.
pub(crate) fn common_type(left: &DataType, right: &DataType) -> Option<DataType> {
    if left == right {
        return Some(left.clone());
    }
    match (left, right) {
        (DataType::Null, other) | (other, DataType::Null) => Some(other.clone()),
        (DataType::List(left), DataType::List(right)) => {
            common_type(left, right).map(|inner| DataType::List(Box::new(inner)))
        }
        (DataType::Datetime(one, zone), DataType::Datetime(other, other_zone))
            if zone == other_zone =>
        {
            let fine = [one, other].contains(&&TimeUnit::Nanoseconds);
            let unit = if fine {
                TimeUnit::Nanoseconds
            } else {
                TimeUnit::Microseconds
            };
            Some(DataType::Datetime(unit, zone.clone()))
        }
        _ => match (integer_bits(left), integer_bits(right)) {
            (Some(left), Some(right)) => integer_of(left, right),
            _ => (left.is_primitive_numeric() && right.is_primitive_numeric())
                .then_some(DataType::Float64),
        },
    }
}

/// Whether an integer type has a sign, and its bits.
fn integer_bits(data_type: &DataType) -> Option<(bool, u32)> {
    Some(match data_type {
        DataType::Int8 => (true, 8),
        DataType::Int16 => (true, 16),
        DataType::Int32 => (true, 32),
        DataType::Int64 => (true, 64),
        DataType::Int128 => (true, 128),
        DataType::UInt8 => (false, 8),
        DataType::UInt16 => (false, 16),
        DataType::UInt32 => (false, 32),
        DataType::UInt64 => (false, 64),
        _ => return None,
    })
}

/// The least integer type that holds the values of both.
fn integer_of(left: (bool, u32), right: (bool, u32)) -> Option<DataType> {
    let signed = left.0 || right.0;
    let needed = |(has_sign, bits): (bool, u32)| {
        if signed && !has_sign { 2 * bits } else { bits }
    };
    let bits = needed(left).max(needed(right));
    Some(match (signed, bits) {
        (true, 8) => DataType::Int8,
        (true, 16) => DataType::Int16,
        (true, 32) => DataType::Int32,
        (true, 64) => DataType::Int64,
        (true, 128) => DataType::Int128,
        (false, 8) => DataType::UInt8,
        (false, 16) => DataType::UInt16,
        (false, 32) => DataType::UInt32,
        (false, 64) => DataType::UInt64,
        _ => return None,
    })
}

/// A part with the columns of the table, in their order.
fn conform(part: Part, schema: &Schema) -> LazyFrame {
    let same = part.schema.len() == schema.len()
        && part.schema.iter().zip(schema.iter()).all(|(a, b)| a == b);
    if same {
        return part.frame;
    }
    let columns: Vec<Expr> = schema
        .iter()
        .map(|(name, data_type)| match part.schema.get(name) {
            Some(own) if own == data_type => col(name.clone()),
            Some(_) => col(name.clone()).cast(data_type.clone()),
            None => lit(polars::prelude::NULL)
                .cast(data_type.clone())
                .alias(name.clone()),
        })
        .collect();
    part.frame.select(columns)
}

fn parquet_schema(path: &Path) -> Result<Schema, DataError> {
    let schema = executed(|| scan_parquet(&[path])?.collect_schema());
    let schema: SchemaRef = schema.map_err(|message| DataError::Parquet {
        path: path.to_owned(),
        message,
    })?;
    Ok((*schema).clone())
}

fn ref_paths<P: AsRef<Path>>(paths: &[P]) -> PolarsResult<Vec<PlRefPath>> {
    paths
        .iter()
        .map(|path| PlRefPath::try_from_path(path.as_ref()))
        .collect()
}

fn scan_parquet<P: AsRef<Path>>(paths: &[P]) -> PolarsResult<LazyFrame> {
    let options = ScanArgsParquet {
        glob: false,
        hive_options: polars::prelude::HiveOptions::new_disabled(),
        cache: false,
        ..ScanArgsParquet::default()
    };
    LazyFrame::scan_parquet_files(ref_paths(paths)?.into_iter().collect(), options)
}

fn scan_json<P: AsRef<Path>>(paths: &[P], schema: &Schema) -> PolarsResult<LazyFrame> {
    // This reader takes every path as a pattern.
    let paths: Vec<PathBuf> = paths
        .iter()
        .map(|path| glob::Pattern::escape(&path.as_ref().to_string_lossy()).into())
        .collect();
    LazyJsonLineReader::new_paths(ref_paths(&paths)?.into_iter().collect())
        .with_schema(Some(schema.clone().into()))
        .finish()
}

/// Rows in a batch at most. Small, since rows may hold images.
const BATCH_ROWS: usize = 8_192;

fn for_each_batch(
    plan: LazyFrame,
    take: impl Fn(DataFrame) -> PolarsResult<()> + Send + Sync + 'static,
) -> Result<(), String> {
    executed(|| {
        sink(plan, take)?
            .collect_with_engine(Engine::Streaming)
            .map(|_| ())
    })
}

/// A plan whose rows go to `take`, in order.
fn sink(
    plan: LazyFrame,
    take: impl Fn(DataFrame) -> PolarsResult<()> + Send + Sync + 'static,
) -> PolarsResult<LazyFrame> {
    let take = PlanCallback::new(move |batch: DataFrame| take(batch).map(|()| false));
    plan.sink_batches(take, true, NonZeroUsize::new(BATCH_ROWS))
}

/// What Polars computes, or its error in one line. It panics on some damaged files.
fn executed<T>(run: impl FnOnce() -> PolarsResult<T>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(run)) {
        Ok(result) => result.map_err(|error| one_line(&error.to_string())),
        Err(panic) => {
            let text = panic
                .downcast_ref::<String>()
                .map(String::as_str)
                .or_else(|| panic.downcast_ref::<&str>().copied());
            Err(format!(
                "the reader failed: {}",
                one_line(text.unwrap_or("no reason given"))
            ))
        }
    }
}

/// The first lines of a message as one, short enough for a terminal.
fn one_line(message: &str) -> String {
    let text: Vec<&str> = message.split_whitespace().collect();
    let text = text.join(" ");
    match text.char_indices().nth(300) {
        Some((end, _)) => format!("{} ...", &text[..end]),
        None => text,
    }
}

/// A type in words, with the types of what is nested.
pub(crate) fn type_name(data_type: &DataType) -> String {
    match data_type {
        DataType::String | DataType::Categorical(..) | DataType::Enum(..) => "text".to_owned(),
        DataType::Boolean => "bool".to_owned(),
        DataType::Binary | DataType::BinaryOffset => "binary".to_owned(),
        DataType::Null => "null".to_owned(),
        DataType::List(inner) => format!("list[{}]", type_name(inner)),
        DataType::Array(inner, width) => format!("array[{}; {width}]", type_name(inner)),
        DataType::Struct(fields) => {
            let fields: Vec<String> = fields
                .iter()
                .map(|field| format!("{}: {}", field.name, type_name(&field.dtype)))
                .collect();
            format!("struct{{{}}}", fields.join(", "))
        }
        other => other.to_string(),
    }
}
