//! Files of rows: finds them, recognises their format by content, and reads them one row at a time.

use std::{
    fs::{self, File},
    io::BufReader,
    path::{Path, PathBuf},
};

use serde_json::{Map, Value};

use crate::lint::{
    Example, Format, ImageSource, LintError, RowError, RowLocation,
    example::FormatWarning,
    files::{PROVENANCE, row_files},
    formats::{self, Columns, EXPECTED, Source},
    json::JsonRows,
    parquet_rows::{ParquetRows, schema_notes},
};

/// Rows that are looked at to recognise a file's format.
const ROWS_LOOKED_AT: usize = 16;

/// How the names of files end that may hold training rows.
const ENDINGS: &[&str] = &[".json", ".jsonl", ".parquet"];

/// A training set: one file, a folder, or some of each.
#[derive(Debug)]
pub struct Dataset {
    files: Vec<DatasetFile>,
    skipped: Vec<(PathBuf, String)>,
    image_root: Option<PathBuf>,
}

/// One file of a training set.
#[derive(Debug)]
pub struct DatasetFile {
    /// Path of the file, as given or as found below a given folder.
    pub path: PathBuf,
    /// Format of the rows, as declared, given or recognised by content.
    pub format: Format,
    /// The split that its name, or that of its folder, tells.
    pub split: Option<String>,
    /// Whether a `dataset_info.json` names it.
    pub declared: bool,
    /// What its loader would pass over in silence in the file as a whole.
    pub(crate) notes: Vec<FormatWarning>,
    columns: Columns,
    /// A file beside it with the provenance of its rows.
    provenance: Option<PathBuf>,
}

impl Dataset {
    /// Opens files and folders; a folder is searched to any depth for `.json`, `.jsonl` and
    /// `.parquet`. Paths of images are looked up below `image_root`, if given, then beside the
    /// file and in the folders above it.
    ///
    /// # Errors
    /// [`LintError`], where a named file is no training set, or a folder holds none. Files of a
    /// folder that are something else are in [`Dataset::skipped`].
    pub fn open(
        paths: &[PathBuf],
        format: Option<Format>,
        image_root: Option<PathBuf>,
    ) -> Result<Self, LintError> {
        let mut dataset = Self {
            files: Vec::new(),
            skipped: Vec::new(),
            image_root,
        };
        for path in paths {
            let info = fs::metadata(path).map_err(|source| LintError::Io {
                path: path.clone(),
                source,
            })?;
            if !info.is_dir() {
                dataset.files.push(DatasetFile::open(
                    path,
                    path.parent().unwrap_or(Path::new("")),
                    format,
                )?);
                continue;
            }
            let before = dataset.files.len();
            for file in row_files(path, ENDINGS)? {
                match DatasetFile::open(&file, path, format) {
                    Ok(opened) => dataset.files.push(opened),
                    Err(error) => dataset.skipped.push((file, error.to_string())),
                }
            }
            if dataset.files.len() == before {
                return Err(LintError::NoRows { path: path.clone() });
            }
        }
        Ok(dataset)
    }

    /// The files, in the order of their rows.
    pub fn files(&self) -> &[DatasetFile] {
        &self.files
    }

    /// Files of folders that hold no rows, and why.
    pub fn skipped(&self) -> &[(PathBuf, String)] {
        &self.skipped
    }

    /// All rows, one at a time; what cannot be read is an error in its place.
    pub fn rows(&self) -> Rows<'_> {
        Rows {
            dataset: self,
            file: 0,
            open: None,
            beside: None,
            index: 0,
        }
    }

    /// The rows of one number, counted from 0 over all files.
    pub fn row(&self, index: u64) -> Option<Result<Example, RowError>> {
        self.rows().nth(usize::try_from(index).ok()?)
    }

    fn resolve(&self, file: &Path, image: &Path) -> PathBuf {
        let beside = file.parent().unwrap_or(Path::new(""));
        let roots = self
            .image_root
            .as_deref()
            .into_iter()
            .chain(beside.ancestors().take(3));
        let mut tried = roots.map(|root| root.join(image));
        tried
            .find(|path| path.is_file())
            .unwrap_or_else(|| self.image_root.as_deref().unwrap_or(beside).join(image))
    }
}

impl DatasetFile {
    fn open(path: &Path, root: &Path, format: Option<Format>) -> Result<Self, LintError> {
        let split = split_of(path.strip_prefix(root).unwrap_or(path));
        let opened =
            |format: Format, columns: Columns, declared: bool, notes: Vec<FormatWarning>| Self {
                path: path.to_owned(),
                format,
                split: split.clone(),
                declared,
                notes,
                columns,
                provenance: provenance_beside(path),
            };
        let parquet = path.extension().is_some_and(|it| it == "parquet");
        if parquet {
            let notes = schema_notes(path)?;
            let mut rows = ParquetRows::open(path)?;
            let row = rows.next().and_then(Result::ok).map(|row| row.fields);
            let columns = row
                .as_ref()
                .and_then(formats::recognise)
                .map_or(Columns::of(Format::Parquet), Columns::of);
            if row
                .as_ref()
                .is_some_and(|row| formats::recognise(row).is_none())
            {
                return Err(unlike(path, row.as_ref()));
            }
            return Ok(opened(Format::Parquet, columns, false, notes));
        }
        if let Some(columns) = Columns::declared(path) {
            return Ok(opened(Format::LlamaFactory, columns, true, Vec::new()));
        }
        if let Some(format) = format {
            return Ok(opened(format, Columns::of(format), false, Vec::new()));
        }
        let file = File::open(path).map_err(|source| LintError::Io {
            path: path.to_owned(),
            source,
        })?;
        let rows = JsonRows::new(BufReader::new(file)).take(ROWS_LOOKED_AT);
        let rows: Vec<Map<String, Value>> = rows
            .filter_map(|row| {
                if let Ok(Value::Object(row)) = row.value {
                    Some(row)
                } else {
                    None
                }
            })
            .collect();
        let known: Vec<Format> = rows.iter().filter_map(formats::recognise).collect();
        // A plain row of messages is of any format that has them: the rows that tell more decide.
        let format = known
            .iter()
            .find(|format| **format != Format::Trl)
            .or(known.first());
        let format = *format.ok_or_else(|| unlike(path, rows.first()))?;
        Ok(opened(format, Columns::of(format), false, Vec::new()))
    }
}

fn unlike(path: &Path, row: Option<&Map<String, Value>>) -> LintError {
    let found = match row {
        Some(row) => {
            format!(
                "the first row has the keys {}",
                row.keys()
                    .map(|key| format!("`{key}`"))
                    .collect::<Vec<_>>()
                    .join(", ")
            )
        }
        None => "no JSON object is among the first rows".to_owned(),
    };
    LintError::NotRecognised {
        path: path.to_owned(),
        found,
        expected: EXPECTED,
    }
}

/// `provenance/<folders>/<name>.provenance.jsonl` in the file's folder or one above it.
fn provenance_beside(path: &Path) -> Option<PathBuf> {
    let inside = |root: &Path| {
        path.strip_prefix(root)
            .ok()
            .map(|inside| inside.with_extension(""))
    };
    let beside = |root: &Path| {
        Some(
            root.join("provenance")
                .join(format!("{}{PROVENANCE}", inside(root)?.display())),
        )
    };
    path.ancestors()
        .skip(1)
        .take(3)
        .filter_map(beside)
        .find(|path| path.is_file())
}

/// The split that a path below the dataset's folder names.
fn split_of(path: &Path) -> Option<String> {
    let text = path.with_extension("");
    let text = text.to_string_lossy().to_lowercase();
    let known = |word: &&str| {
        matches!(
            *word,
            "train"
                | "training"
                | "test"
                | "testing"
                | "val"
                | "valid"
                | "validation"
                | "dev"
                | "eval"
                | "heldout"
        )
    };
    text.split(|c: char| !c.is_ascii_alphanumeric())
        .find(known)
        .map(formats::split_name)
}

/// The rows of a dataset, one at a time.
pub struct Rows<'a> {
    dataset: &'a Dataset,
    file: usize,
    open: Option<Reader>,
    /// The provenance of the file's rows, in their order.
    beside: Option<JsonRows<BufReader<File>>>,
    index: u64,
}

enum Reader {
    Json(Box<JsonRows<BufReader<File>>>),
    Parquet(Box<ParquetRows>),
    Failed(Option<String>),
}

impl Reader {
    fn open(file: &DatasetFile) -> Self {
        if file.format == Format::Parquet {
            return match ParquetRows::open(&file.path) {
                Ok(rows) => Self::Parquet(Box::new(rows)),
                Err(error) => Self::Failed(Some(error.to_string())),
            };
        }
        match File::open(&file.path) {
            Ok(opened) => Self::Json(Box::new(JsonRows::new(BufReader::with_capacity(
                1 << 18,
                opened,
            )))),
            Err(error) => Self::Failed(Some(format!("cannot open the file: {error}"))),
        }
    }
}

impl Rows<'_> {
    /// The next row of the file that is open: where it begins, and what was read.
    fn read(&mut self, file: &DatasetFile) -> Option<Result<Example, RowError>> {
        if self.open.is_none() {
            self.beside = file
                .provenance
                .as_ref()
                .and_then(|path| File::open(path).ok())
                .map(|it| JsonRows::new(BufReader::new(it)));
        }
        let reader = self.open.get_or_insert_with(|| Reader::open(file));
        let mut place = RowLocation {
            index: self.index,
            file: u32::try_from(self.file).unwrap_or(u32::MAX),
            line: 1,
        };
        let (row, inside) = match reader {
            Reader::Failed(message) => {
                let message = message.take()?;
                return Some(Err(RowError {
                    location: place,
                    column: 0,
                    message,
                }));
            }
            Reader::Json(rows) => {
                let row = rows.next()?;
                place.line = row.line;
                match row.value {
                    Ok(value) => (value, None),
                    Err(broken) => {
                        self.beside.as_mut().and_then(Iterator::next);
                        place.line = broken.line;
                        return Some(Err(RowError {
                            location: place,
                            column: broken.column,
                            message: broken.message,
                        }));
                    }
                }
            }
            Reader::Parquet(rows) => {
                place.line = rows.number();
                match rows.next()? {
                    Ok(row) => (Value::Object(row.fields), row.images),
                    Err(message) => {
                        return Some(Err(RowError {
                            location: place,
                            column: 0,
                            message,
                        }));
                    }
                }
            }
        };
        let provenance = self
            .beside
            .as_mut()
            .and_then(Iterator::next)
            .and_then(|row| row.value.ok());
        let Value::Object(mut row) = row else {
            let message = "the row is no JSON object: expected one with turns".to_owned();
            return Some(Err(RowError {
                location: place,
                column: 1,
                message,
            }));
        };
        if let Some(provenance) = provenance {
            row.entry("provenance").or_insert(provenance);
        }
        let resolve = |image: &Path| ImageSource::File(self.dataset.resolve(&file.path, image));
        let source = Source {
            place,
            format: file.format,
            columns: &file.columns,
            split: file.split.as_deref(),
            resolve: &resolve,
        };
        Some(
            formats::example(row, inside, &source).map_err(|message| RowError {
                location: place,
                column: 0,
                message,
            }),
        )
    }
}

impl Iterator for Rows<'_> {
    type Item = Result<Example, RowError>;

    fn next(&mut self) -> Option<Self::Item> {
        while let Some(file) = self.dataset.files.get(self.file) {
            if let Some(row) = self.read(file) {
                self.index += 1;
                return Some(row);
            }
            self.file += 1;
            self.open = None;
        }
        None
    }
}
