//! Which files a set consists of: named files, folders and patterns, and what each file holds.

use std::{
    fs::{self, File},
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
};

use reel_dataset::lint::row_files;
use serde::Serialize;

use crate::DataError;

/// How the names of files end that a folder is searched for.
const ENDINGS: &[&str] = &[
    ".parquet",
    ".jsonl",
    ".ndjson",
    ".json",
    ".jsonl.gz",
    ".jsonl.zst",
    ".ndjson.gz",
    ".ndjson.zst",
    ".json.gz",
    ".json.zst",
];

/// What a file holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum FileFormat {
    /// A file of Apache Parquet.
    Parquet,
    /// One JSON object a line, or one JSON list of objects; gzip and zstd are unpacked.
    Json,
}

/// How a file is compressed as a whole.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Compression {
    None,
    Gzip,
    Zstd,
}

/// A file of a set.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct SourceFile {
    /// Path of the file, as given or as found.
    pub path: PathBuf,
    /// What the file holds, by its content.
    pub format: FileFormat,
    /// Size of the file in bytes.
    pub bytes: u64,
}

/// The files that these paths name, and what was left out, with the reason.
pub(crate) fn find(paths: &[PathBuf]) -> Result<(Vec<SourceFile>, Vec<String>), DataError> {
    let (mut files, mut left_out) = (Vec::new(), Vec::new());
    for path in paths {
        let before = files.len();
        for path in expand(path)? {
            let info =
                fs::metadata(&path).map_err(|source| DataError::io("read", &path, source))?;
            if info.is_dir() {
                for file in row_files(&path, ENDINGS)? {
                    match SourceFile::open(&file)? {
                        Some(file) => files.push(file),
                        None => left_out.push(format!("{}: no rows", file.display())),
                    }
                }
            } else {
                let file = SourceFile::open(&path)?;
                files.push(file.ok_or_else(|| DataError::UnknownFormat { path: path.clone() })?);
            }
        }
        if files.len() == before {
            return Err(DataError::NoFiles { path: path.clone() });
        }
    }
    let mut known = std::collections::BTreeSet::new();
    files.retain(|file| known.insert(file.path.clone()));
    Ok((files, left_out))
}

/// The path itself if it is there, or what matches it as a pattern.
fn expand(path: &Path) -> Result<Vec<PathBuf>, DataError> {
    let text = path.to_string_lossy();
    if path.exists() || !text.contains(['*', '?', '[']) {
        return Ok(vec![path.to_owned()]);
    }
    let matches = glob::glob(&text).map_err(|error| DataError::Pattern {
        path: path.to_owned(),
        message: error.msg.to_owned(),
    })?;
    matches
        .map(|found| {
            found.map_err(|error| {
                let path = error.path().to_owned();
                DataError::io("read", &path, error.into())
            })
        })
        .collect()
}

impl SourceFile {
    /// The file with its format by content, or `None` if it holds no rows.
    fn open(path: &Path) -> Result<Option<Self>, DataError> {
        let failed = |source| DataError::io("read", path, source);
        let file = File::open(path).map_err(failed)?;
        let bytes = file.metadata().map_err(failed)?.len();
        let named = |ending: &str| path.extension().is_some_and(|it| it == ending);
        let mut head = [0_u8; 4];
        let mut reader = BufReader::new(file);
        let read = read_some(&mut reader, &mut head).map_err(failed)?;
        let format = if head.starts_with(b"PAR1") || named("parquet") {
            FileFormat::Parquet
        } else if read == 0 {
            FileFormat::Json
        } else {
            match first_byte(path).map_err(failed)? {
                // One object in a `.json` file is a configuration more often than a row.
                Some(b'{') if named("json") && !several_lines(path).map_err(failed)? => {
                    return Ok(None);
                }
                Some(b'{' | b'[') => FileFormat::Json,
                // A broken row is told with its line; something else entirely is told as such.
                _ if named("jsonl") || named("ndjson") => FileFormat::Json,
                _ => return Ok(None),
            }
        };
        Ok(Some(Self {
            path: path.to_owned(),
            format,
            bytes,
        }))
    }
}

/// Whether the first line of a JSON file is an object of its own.
fn several_lines(path: &Path) -> std::io::Result<bool> {
    let mut line = Vec::new();
    let mut reader = BufReader::new(File::open(path)?).take(1 << 28);
    reader.read_until(b'\n', &mut line)?;
    Ok(serde_json::from_slice::<serde::de::IgnoredAny>(&line).is_ok())
}

/// The first byte that is no space, after decompression.
fn first_byte(path: &Path) -> std::io::Result<Option<u8>> {
    let (mut reader, _) = open_text(path)?;
    loop {
        let buffer = reader.fill_buf()?;
        if buffer.is_empty() {
            return Ok(None);
        }
        let text = buffer.strip_prefix(b"\xef\xbb\xbf").unwrap_or(buffer);
        if let Some(byte) = text.iter().find(|byte| !byte.is_ascii_whitespace()) {
            return Ok(Some(*byte));
        }
        let used = buffer.len();
        reader.consume(used);
    }
}

/// The text of a JSON file, unpacked, and how it was compressed.
pub(crate) fn open_text(path: &Path) -> std::io::Result<(Box<dyn BufRead>, Compression)> {
    let mut reader = BufReader::with_capacity(1 << 18, File::open(path)?);
    let mut head = [0_u8; 4];
    let read = read_some(&mut reader, &mut head)?;
    let reader = BufReader::with_capacity(1 << 18, File::open(path)?);
    Ok(match &head[..read] {
        [0x1f, 0x8b, ..] => {
            let unpacked = flate2::bufread::MultiGzDecoder::new(reader);
            (
                Box::new(BufReader::with_capacity(1 << 18, unpacked)),
                Compression::Gzip,
            )
        }
        [0x28, 0xb5, 0x2f, 0xfd] => {
            let unpacked = zstd::stream::read::Decoder::with_buffer(reader)?;
            (
                Box::new(BufReader::with_capacity(1 << 18, unpacked)),
                Compression::Zstd,
            )
        }
        _ => (Box::new(reader), Compression::None),
    })
}

/// Reads until the buffer is full or the file ends; how much was read.
fn read_some(reader: &mut impl Read, buffer: &mut [u8]) -> std::io::Result<usize> {
    let mut read = 0;
    while read < buffer.len() {
        match reader.read(&mut buffer[read..])? {
            0 => break,
            more => read += more,
        }
    }
    Ok(read)
}
