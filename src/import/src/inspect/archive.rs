//! The archive that a log is: a zip with a header, the samples and their summaries.

use std::{
    fs::File,
    io::{self, BufReader, Read, Write},
    path::Path,
};

use serde::de::DeserializeOwned;
use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter, write::SimpleFileOptions};

use crate::lenient;

/// Largest document of a log that is read.
const BYTES_MAX: u64 = 1 << 30;

/// A log that is open for reading.
pub(super) struct Archive {
    zip: ZipArchive<BufReader<File>>,
}

impl Archive {
    pub(super) fn open(path: &Path) -> Result<Self, String> {
        let file = File::open(path).map_err(|error| format!("cannot be read: {error}"))?;
        let zip = ZipArchive::new(BufReader::new(file))
            .map_err(|error| format!("not a log of Inspect: {error}"))?;
        Ok(Self { zip })
    }

    /// The names of its samples, sorted.
    pub(super) fn samples(&self) -> Vec<String> {
        let is_sample = |name: &&str| name.starts_with("samples/") && name.ends_with(".json");
        let names = self.zip.file_names().filter(is_sample);
        let mut names: Vec<String> = names.map(str::to_owned).collect();
        names.sort();
        names
    }

    pub(super) fn has(&self, name: &str) -> bool {
        self.zip.index_for_name(name).is_some()
    }

    /// One of its documents, and what no value of it can hold.
    pub(super) fn read<T: DeserializeOwned>(
        &mut self,
        name: &str,
    ) -> Result<(T, Option<String>), String> {
        let named = |why: &dyn std::fmt::Display| format!("{}: {why}", name.escape_debug());
        let entry = self.zip.by_name(name).map_err(|error| named(&error))?;
        let mut bytes = Vec::new();
        let read = entry.take(BYTES_MAX + 1).read_to_end(&mut bytes);
        read.map_err(|error| named(&error))?;
        if bytes.len() as u64 > BYTES_MAX {
            return Err(named(&format_args!(
                "larger than {BYTES_MAX} bytes, which are read at most"
            )));
        }
        let document = lenient::document(&bytes).map_err(|error| named(&error))?;
        Ok((document, lenient::long_integers_told(&bytes)))
    }
}

/// A log that is being written. Equal documents give equal bytes: entries have no time.
pub(super) struct ArchiveWriter {
    zip: ZipWriter<File>,
}

impl ArchiveWriter {
    pub(super) fn create(path: &Path) -> io::Result<Self> {
        Ok(Self {
            zip: ZipWriter::new(File::create(path)?),
        })
    }

    pub(super) fn add(&mut self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .last_modified_time(DateTime::default())
            .large_file(u32::try_from(bytes.len()).is_err());
        self.zip.start_file(name, options)?;
        self.zip.write_all(bytes)
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.zip.finish()?.sync_all()
    }
}
