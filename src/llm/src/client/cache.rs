//! Replies and vectors kept in a folder, one file a request, named after the request's digest.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use reel_world::Digest;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::client::{ModelError, reply::Answer};

/// Replies by the digest of the request, which names model and parameters but neither address nor
/// key: the folder gives the same replies wherever it lies. Models that differ under one name need
/// folders of their own.
#[derive(Clone, Debug)]
pub struct Cache {
    folder: PathBuf,
}

impl Cache {
    /// The folder, made if it is not there.
    ///
    /// # Errors
    /// When it cannot be made.
    pub fn open(folder: impl Into<PathBuf>) -> Result<Self, ModelError> {
        let folder = folder.into();
        match fs::create_dir_all(&folder) {
            Ok(()) => Ok(Self { folder }),
            Err(source) => Err(ModelError::Write {
                action: "make the folder of kept replies",
                path: folder,
                source,
            }),
        }
    }

    /// Where the reply to a request lies.
    pub fn path(&self, request: &Digest) -> PathBuf {
        self.folder.join(format!("{request}.json"))
    }

    /// What was kept for a request. A file that is not as it was written is as good as none,
    /// and is written again.
    pub(crate) fn get<T: Serialize + DeserializeOwned>(&self, request: &Digest) -> Option<T> {
        let file: File<T> = serde_json::from_slice(&fs::read(self.path(request)).ok()?).ok()?;
        (file.digest == digest(request, &file.kept)).then_some(file.kept)
    }

    /// Keeps what a request gave: the file is there as a whole or not at all.
    pub(crate) fn put<T: Serialize>(&self, request: &Digest, kept: T) -> Result<(), ModelError> {
        let path = self.path(request);
        let file = File {
            digest: digest(request, &kept),
            kept,
        };
        let text = serde_json::to_string_pretty(&file).expect("an answer is always JSON");
        publish(&self.folder, &path, text.as_bytes()).map_err(|source| ModelError::Write {
            action: "keep a reply",
            path,
            source,
        })
    }
}

/// What is kept of a reply.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub(crate) struct CachedReply {
    pub answer: Answer,
    pub latency_ns: u64,
}

#[derive(Serialize, Deserialize)]
struct File<T> {
    kept: T,
    /// Of request and content.
    digest: Digest,
}

fn digest<T: Serialize>(request: &Digest, kept: &T) -> Digest {
    Digest::of_json(&(request, kept))
}

fn publish(folder: &Path, path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(bytes)?;
    file.as_file().sync_data()?;
    file.persist(path)?;
    Ok(())
}
