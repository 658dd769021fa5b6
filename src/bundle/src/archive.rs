//! The container: a zip file of entries that are stored as they are, in one order, without times. So any zip program opens it, and equal
//! contents are equal bytes.

use std::io::{Cursor, Read as _, Write as _};

use zip::{CompressionMethod, DateTime, ZipArchive, ZipWriter, write::SimpleFileOptions};

use reel_world::canonical_json;

use crate::{BundleError, Key, Manifest, statement::statement};

pub(crate) const MANIFEST: &str = "manifest.json";
pub(crate) const EPISODES: &str = "episodes.mcap";
pub(crate) const CALLS: &str = "calls.jsonl";
pub(crate) const STATEMENT: &str = "statement.json";
pub(crate) const SIGNATURE: &str = "statement.json.sig";

/// Most bytes of an entry: what a machine that verifies can hold.
const ENTRY_MAX: u64 = 2 << 30;

/// A bundle as its parts.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Bundle {
    /// What is claimed, as JSON: see [`crate::Manifest`].
    pub manifest: Vec<u8>,
    /// The episodes, packed (`reel pack`).
    pub episodes: Vec<u8>,
    /// The log of the model calls, one JSON object a line; none where none was kept.
    pub calls: Option<Vec<u8>>,
    /// The in-toto statement about the other parts.
    pub statement: Vec<u8>,
    /// Signature of the statement, as `ssh-keygen -Y sign` writes it.
    pub signature: Option<Vec<u8>>,
}

impl Bundle {
    /// The parts of what is claimed of packed episodes, with their statement; signed, where there is a key.
    pub fn of(
        manifest: &Manifest,
        episodes: Vec<u8>,
        calls: Option<Vec<u8>>,
        key: Option<&Key>,
    ) -> Self {
        let mut bundle = Self {
            manifest: canonical_json(manifest).into_bytes(),
            episodes,
            calls,
            statement: Vec::new(),
            signature: None,
        };
        bundle.statement = statement(&bundle, manifest);
        bundle.signature = key.map(|key| key.sign(&bundle.statement));
        bundle
    }

    /// The parts of a file, once the file is exactly the one that these parts make.
    ///
    /// # Errors
    /// When it is no such file.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, BundleError> {
        let damaged = |problem: String| BundleError::Container { problem };
        let mut archive =
            ZipArchive::new(Cursor::new(bytes)).map_err(|error| damaged(error.to_string()))?;
        let mut entry = |name: &'static str| -> Result<Option<Vec<u8>>, BundleError> {
            if archive.index_for_name(name).is_none() {
                return Ok(None);
            }
            let file = archive
                .by_name(name)
                .map_err(|error| damaged(format!("{name}: {error}")))?;
            if file.size() > ENTRY_MAX || file.compression() != CompressionMethod::Stored {
                return Err(damaged(format!("{name} is too large, or compressed")));
            }
            let mut content = Vec::new();
            file.take(ENTRY_MAX)
                .read_to_end(&mut content)
                .map_err(|error| damaged(format!("{name}: {error}")))?;
            Ok(Some(content))
        };
        let mut needed = |name| entry(name)?.ok_or(BundleError::Missing { name });
        let (manifest, episodes, statement) =
            (needed(MANIFEST)?, needed(EPISODES)?, needed(STATEMENT)?);
        let bundle = Self {
            manifest,
            episodes,
            calls: entry(CALLS)?,
            statement,
            signature: entry(SIGNATURE)?,
        };
        match bundle.to_bytes()? == bytes {
            true => Ok(bundle),
            false => Err(damaged(
                "written again from its parts it has other bytes".to_owned(),
            )),
        }
    }

    /// The file of these parts.
    ///
    /// # Errors
    /// When the parts are too large for the container.
    pub fn to_bytes(&self) -> Result<Vec<u8>, BundleError> {
        let mut writer = ZipWriter::new(Cursor::new(Vec::new()));
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Stored)
            .last_modified_time(DateTime::default())
            .unix_permissions(0o644);
        let failed = |error: zip::result::ZipError| BundleError::Container {
            problem: error.to_string(),
        };
        for (name, content) in self.parts() {
            writer.start_file(name, options).map_err(failed)?;
            writer.write_all(content)?;
        }
        let file = writer.finish().map_err(failed)?;
        Ok(file.into_inner())
    }

    /// The entries in their order.
    fn parts(&self) -> impl Iterator<Item = (&'static str, &[u8])> {
        self.subjects()
            .chain([(STATEMENT, self.statement.as_slice())])
            .chain(
                self.signature
                    .as_deref()
                    .map(|content| (SIGNATURE, content)),
            )
    }

    /// What the statement is about.
    pub(crate) fn subjects(&self) -> impl Iterator<Item = (&'static str, &[u8])> {
        [
            (MANIFEST, self.manifest.as_slice()),
            (EPISODES, self.episodes.as_slice()),
        ]
        .into_iter()
        .chain(self.calls.as_deref().map(|content| (CALLS, content)))
    }
}
