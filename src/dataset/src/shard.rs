//! Rows into files of bounded size: `<split>/<split>-00000.jsonl`, or JSON arrays. Owns names and
//! framing; a file is whole or not there. Knows no row's meaning.

use std::{
    fs::{self, File},
    io::{BufWriter, Write as _},
    path::{Path, PathBuf},
};

use serde::Serialize;

use crate::{DatasetError, Format, Split};

/// A file of rows.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Shard {
    /// From the dataset's folder, with `/`.
    pub path: String,
    /// The file beside it with the provenance of its rows in their order, where the
    /// rows cannot hold it.
    pub provenance: Option<String>,
    /// Number of rows in the file.
    pub rows: u64,
}

/// Writes the rows of one split in one format, in the order given.
pub struct Shards {
    root: PathBuf,
    format: Format,
    split: Split,
    rows_max: u64,
    open: Option<Open>,
    done: Vec<Shard>,
}

struct Open {
    shard: Shard,
    rows: BufWriter<File>,
    provenance: Option<BufWriter<File>>,
}

impl Shards {
    /// Files under `<root>/<split>/` with at most `rows_max` rows each (at least 1).
    pub fn new(root: &Path, format: Format, split: Split, rows_max: u64) -> Self {
        Self {
            root: root.to_owned(),
            format,
            split,
            rows_max: rows_max.max(1),
            open: None,
            done: Vec::new(),
        }
    }

    /// Appends a row as [`Format::write_row`] made it, and its provenance, which goes into the file
    /// beside where the format wants it there.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn push(&mut self, row: &[u8], provenance: &[u8]) -> Result<(), DatasetError> {
        let array = self.format == Format::QwenVl;
        if self.open.is_none() {
            self.open = Some(self.start()?);
        }
        let Some(open) = &mut self.open else {
            return Ok(());
        };
        let between: &[u8] = if array && open.shard.rows > 0 {
            b",\n"
        } else {
            b""
        };
        let end: &[u8] = if array { b"" } else { b"\n" };
        let path = self.root.join(&open.shard.path);
        let write = |file: &mut BufWriter<File>, parts: [&[u8]; 3]| {
            parts.into_iter().try_for_each(|part| file.write_all(part))
        };
        write(&mut open.rows, [between, row, end]).map_err(DatasetError::io(&path))?;
        if let Some(file) = &mut open.provenance {
            write(file, [provenance, b"\n", b""]).map_err(DatasetError::io(&path))?;
        }
        open.shard.rows += 1;
        if open.shard.rows >= self.rows_max {
            self.close()
        } else {
            Ok(())
        }
    }

    /// Closes the last file; the files in order.
    ///
    /// # Errors
    /// When a file cannot be written.
    pub fn finish(mut self) -> Result<Vec<Shard>, DatasetError> {
        self.close()?;
        Ok(self.done)
    }

    /// Takes over a file that somebody else wrote, in place of the next one.
    pub(crate) fn keep(&mut self, shard: Shard) {
        self.done.push(shard);
    }

    fn start(&self) -> Result<Open, DatasetError> {
        let split = self.split.as_str();
        let stem = format!("{split}/{split}-{:05}", self.done.len());
        let shard = Shard {
            path: format!("{stem}.{}", self.format.extension()),
            // Outside the folder of the rows, which loaders read whole.
            provenance: (!self.format.holds_provenance())
                .then(|| format!("provenance/{stem}.provenance.jsonl")),
            rows: 0,
        };
        let create = |path: &str| {
            let path = part(&self.root.join(path));
            let folder = path.parent().unwrap_or(&self.root);
            fs::create_dir_all(folder)
                .and_then(|()| File::create(&path))
                .map(BufWriter::new)
                .map_err(DatasetError::io(&path))
        };
        let mut rows = create(&shard.path)?;
        if self.format == Format::QwenVl {
            rows.write_all(b"[\n")
                .map_err(DatasetError::io(&shard.path))?;
        }
        let provenance = shard.provenance.as_deref().map(create).transpose()?;
        Ok(Open {
            shard,
            rows,
            provenance,
        })
    }

    fn close(&mut self) -> Result<(), DatasetError> {
        let Some(mut open) = self.open.take() else {
            return Ok(());
        };
        if self.format == Format::QwenVl {
            open.rows
                .write_all(b"\n]\n")
                .map_err(DatasetError::io(&open.shard.path))?;
        }
        let files = [
            (Some(open.rows), Some(&open.shard.path)),
            (open.provenance, open.shard.provenance.as_ref()),
        ];
        for (file, path) in files.into_iter().filter_map(|(file, path)| file.zip(path)) {
            let path = self.root.join(path);
            let flushed = file
                .into_inner()
                .map_err(|error| error.into_error())
                .and_then(|file| file.sync_data());
            flushed
                .and_then(|()| fs::rename(part(&path), &path))
                .map_err(DatasetError::io(&path))?;
        }
        self.done.push(open.shard);
        Ok(())
    }
}

/// The name of a file that is not whole yet.
fn part(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".part");
    name.into()
}
