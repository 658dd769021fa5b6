//! Copies of files of buckets on this machine, kept by the digest of their content. The folder may
//! be deleted at any time.

use std::{
    fs, io,
    io::Write as _,
    path::{Path, PathBuf},
    sync::atomic::{AtomicU64, Ordering},
    time::SystemTime,
};

use reel_world::Digest;
use serde::{Deserialize, Serialize};
use tempfile::NamedTempFile;

/// Bytes that may come until somebody looks whether it is too much.
const LOOK_AFTER: u64 = 256 << 20;
/// Part of the limit down to which old files are deleted.
const DOWN_TO: f64 = 0.9;

/// A folder of copies: `files` by the digest of their content, `names` that say which file a name
/// was when the store was asked last. A copy that is not what its digest says is fetched anew.
#[derive(Debug)]
pub struct Cache {
    folder: PathBuf,
    bytes_max: u64,
    since_looked: AtomicU64,
}

/// What a name stood for.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub(crate) struct CachedName {
    /// By which the store tells contents apart.
    pub etag: String,
    /// Digest of the file's content, by which the cache names its copy.
    digest: Digest,
}

impl Cache {
    /// A cache in a folder, which is made when something is kept.
    pub fn at(folder: impl Into<PathBuf>, bytes_max: u64) -> Self {
        // looked through at the first file that comes: another process may have left it full
        Self {
            folder: folder.into(),
            bytes_max,
            since_looked: AtomicU64::new(LOOK_AFTER),
        }
    }

    /// What a name stood for when it was fetched last, if its copy is still there and whole.
    pub(crate) fn known(&self, name: &str) -> Option<(CachedName, PathBuf)> {
        let known: CachedName =
            serde_json::from_slice(&fs::read(self.name_file(name)).ok()?).ok()?;
        let copy = self.copy(known.digest);
        if Digest::of(&fs::read(&copy).ok()?) != known.digest {
            let _ = fs::remove_file(&copy);
            return None;
        }
        Some((known, copy))
    }

    /// Keeps a content under a name.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub(crate) fn keep(&self, name: &str, etag: String, content: &[u8]) -> io::Result<PathBuf> {
        let known = CachedName {
            etag,
            digest: Digest::of(content),
        };
        let copy = self.copy(known.digest);
        if !copy.exists() {
            publish(&copy, content)?;
        }
        publish(&self.name_file(name), &serde_json::to_vec(&known)?)?;
        let bytes = content.len() as u64;
        if self.since_looked.fetch_add(bytes, Ordering::Relaxed) + bytes >= LOOK_AFTER {
            self.since_looked.store(0, Ordering::Relaxed);
            self.make_room(&copy);
        }
        Ok(copy)
    }

    /// Says that a copy is in use, so that others go first.
    pub(crate) fn touch(&self, copy: &Path) {
        let _ = fs::File::open(copy).and_then(|file| file.set_modified(SystemTime::now()));
    }

    /// Deletes what was not used for longest, but not what just came.
    fn make_room(&self, but: &Path) {
        let Ok(folders) = fs::read_dir(self.folder.join("files")) else {
            return;
        };
        let files = folders
            .flatten()
            .filter_map(|folder| fs::read_dir(folder.path()).ok())
            .flatten()
            .flatten();
        let facts = |file: fs::DirEntry| {
            file.metadata()
                .ok()
                .and_then(|data| Some((data.modified().ok()?, data.len(), file.path())))
        };
        let mut files: Vec<(SystemTime, u64, PathBuf)> = files.filter_map(facts).collect();
        let mut bytes: u64 = files.iter().map(|file| file.1).sum();
        files.retain(|file| file.2 != but);
        if bytes <= self.bytes_max {
            return;
        }
        files.sort();
        for (_, size, path) in files {
            if bytes as f64 <= self.bytes_max as f64 * DOWN_TO {
                return;
            }
            // who reads it has it open, or fetches it again
            if fs::remove_file(path).is_ok() {
                bytes -= size;
            }
        }
    }

    fn copy(&self, digest: Digest) -> PathBuf {
        let digest = digest.to_string();
        self.folder.join("files").join(&digest[..2]).join(digest)
    }

    fn name_file(&self, name: &str) -> PathBuf {
        let key = Digest::of(name.as_bytes()).to_string();
        self.folder.join("names").join(&key[..2]).join(key)
    }
}

/// Puts a file in its place at once, whoever does the same at the time.
fn publish(path: &Path, content: &[u8]) -> io::Result<()> {
    let folder = path
        .parent()
        .expect("it was put together of a folder and a name");
    fs::create_dir_all(folder)?;
    let mut file = NamedTempFile::new_in(folder)?;
    file.write_all(content)?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_copy_is_kept_by_its_digest_and_a_damaged_one_is_no_copy() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::at(folder.path(), 1 << 20);
        assert!(cache.known("s3://lab/a").is_none());
        let copy = cache.keep("s3://lab/a", "tag".into(), b"content").unwrap();
        assert_eq!(
            cache
                .keep("s3://lab/b", "other".into(), b"content")
                .unwrap(),
            copy,
            "equal contents are kept once"
        );
        let (known, path) = cache.known("s3://lab/a").unwrap();
        assert_eq!((known.etag.as_str(), &path), ("tag", &copy));
        fs::write(&copy, b"contenT").unwrap();
        assert!(cache.known("s3://lab/a").is_none() && !copy.exists());
        cache
            .keep("s3://lab/b", "other".into(), b"content")
            .unwrap();
        assert!(
            cache.known("s3://lab/a").is_some(),
            "the same content serves both names"
        );
    }

    #[test]
    fn what_was_used_longest_ago_goes_first() {
        let folder = tempfile::tempdir().unwrap();
        let cache = Cache::at(folder.path(), 2_500);
        let content = |byte: u8| vec![byte; 1000];
        let copies: Vec<PathBuf> = (0..3)
            .map(|byte| {
                cache
                    .keep(&byte.to_string(), "tag".into(), &content(byte))
                    .unwrap()
            })
            .collect();
        let age = |copy: &Path, seconds: u64| {
            let time = SystemTime::now() - std::time::Duration::from_secs(seconds);
            fs::File::options()
                .write(true)
                .open(copy)
                .unwrap()
                .set_modified(time)
                .unwrap();
        };
        age(&copies[0], 50);
        age(&copies[1], 100);
        cache.touch(&copies[0]);
        cache.make_room(&copies[2]);
        let there: Vec<bool> = copies.iter().map(|copy| copy.exists()).collect();
        assert_eq!(there, [true, false, true]);
    }
}
