//! The files of a folder that is to be published, with their digests: what is no plain file, has a
//! name that is unsafe elsewhere or holds a secret is a problem. Follows no link.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs::{self, File},
    io::Read,
    path::{Path, PathBuf},
};

use sha1::Sha1;
use sha2::{Digest as _, Sha256};

use crate::{
    Check, Problems, PublishError,
    generated::{CHECKSUMS, GIT_ATTRIBUTES},
    secrets::{SecretScanner, secrets_in},
};

/// Most files of a dataset.
const FILES_MAX: usize = 100_000;
/// Most files and folders of one folder; the Hub shows and lists no more.
const ENTRIES_MAX: usize = 10_000;
/// Deepest nesting of folders.
const LEVELS_MAX: usize = 16;
/// Longest name of a file or folder, in bytes.
const NAME_BYTES_MAX: usize = 200;
/// Largest file that is sent in one piece of the Hub's storage.
const FILE_BYTES_MAX: u64 = 50_000_000_000;
/// Bytes in memory while a file is read.
pub(crate) const PIECE: usize = 1 << 20;

/// Where the bytes of a published file come from.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Content {
    Disk(PathBuf),
    Memory(Vec<u8>),
}

/// A file as it is published.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PublishedFile {
    /// From the dataset's folder, with `/`.
    pub path: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// SHA-256 of the file's bytes, in hexadecimal digits.
    pub sha256: String,
    /// The id that Git gives such a file, which the Hub lists for small ones.
    pub git_blob: String,
    pub(crate) blake3: String,
    /// The kinds of secrets in its bytes as they stand on the disk.
    pub(crate) secrets: Vec<&'static str>,
    pub(crate) content: Content,
}

impl PublishedFile {
    pub(crate) fn in_memory(path: &str, bytes: Vec<u8>) -> Self {
        let mut digests = Digests::new(bytes.len() as u64);
        digests.update(&bytes);
        digests.finish(path, Content::Memory(bytes))
    }

    /// The bytes of the file, which must still be what was checked.
    pub(crate) fn open(&self) -> Result<Box<dyn Read + Send + '_>, PublishError> {
        match &self.content {
            Content::Memory(bytes) => Ok(Box::new(bytes.as_slice())),
            Content::Disk(path) => {
                let file = File::open(path).map_err(PublishError::read(path))?;
                Ok(Box::new(file))
            }
        }
    }

    /// Where the file lies on the disk, or what it is called.
    pub(crate) fn place(&self) -> PathBuf {
        match &self.content {
            Content::Memory(_) => PathBuf::from(&self.path),
            Content::Disk(path) => path.clone(),
        }
    }
}

/// The digests of one file as its bytes come.
struct Digests {
    bytes: u64,
    sha256: Sha256,
    git_blob: Sha1,
    blake3: blake3::Hasher,
}

impl Digests {
    fn new(bytes: u64) -> Self {
        let mut git_blob = Sha1::default();
        sha1::Digest::update(&mut git_blob, format!("blob {bytes}\0"));
        Self {
            bytes: 0,
            sha256: Sha256::default(),
            git_blob,
            blake3: blake3::Hasher::new(),
        }
    }

    fn update(&mut self, piece: &[u8]) {
        self.bytes += piece.len() as u64;
        self.sha256.update(piece);
        sha1::Digest::update(&mut self.git_blob, piece);
        self.blake3.update(piece);
    }

    fn finish(self, path: &str, content: Content) -> PublishedFile {
        PublishedFile {
            path: path.to_owned(),
            bytes: self.bytes,
            sha256: hex(&self.sha256.finalize()),
            git_blob: hex(&sha1::Digest::finalize(self.git_blob)),
            blake3: self.blake3.finalize().to_hex().to_string(),
            secrets: Vec::new(),
            content,
        }
    }
}

pub(crate) fn hex(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len() * 2);
    for byte in bytes {
        let _ = write!(text, "{byte:02x}");
    }
    text
}

/// Every file below a folder, by path, with its digests. `progress` is told the bytes read.
///
/// # Errors
/// Fails if a folder or file cannot be read, or the folder holds too much.
pub(crate) fn scan(
    root: &Path,
    problems: &mut Problems,
    progress: &mut dyn FnMut(u64),
) -> Result<BTreeMap<String, PublishedFile>, PublishError> {
    let paths = walk(root, problems)?;
    let mut files = BTreeMap::new();
    let mut read = 0;
    for (path, place) in paths {
        for kind in secrets_in(path.as_bytes()) {
            let message = format!(
                "{kind} is in its name; revoke it where it was issued, and rename the file"
            );
            problems.add(Check::Secrets, &path, None, &message);
        }
        let file = read_file(&path, &place, problems)?;
        read += file.bytes;
        progress(read);
        files.insert(path, file);
    }
    Ok(files)
}

/// The plain files below a folder, by path.
pub(crate) fn walk(
    root: &Path,
    problems: &mut Problems,
) -> Result<BTreeMap<String, PathBuf>, PublishError> {
    let mut found = BTreeMap::new();
    let mut folders = vec![(root.to_owned(), String::new(), 0)];
    while let Some((folder, prefix, level)) = folders.pop() {
        let too_large = |message: &str| PublishError::TooLarge {
            path: folder.clone(),
            message: message.to_owned(),
        };
        if level > LEVELS_MAX {
            return Err(too_large("more than 16 folders below each other"));
        }
        let entries = fs::read_dir(&folder).map_err(PublishError::read(&folder))?;
        let mut count = 0;
        for entry in entries {
            let entry = entry.map_err(PublishError::read(&folder))?;
            count += 1;
            if count > ENTRIES_MAX {
                return Err(too_large(
                    "more than 10,000 files and folders in one folder, which the Hub does not take; \
                     embed images in Parquet or write larger files",
                ));
            }
            let place = entry.path();
            let kind = entry.file_type().map_err(PublishError::read(&place))?;
            let name = entry.file_name();
            let lossy = format!("{prefix}{}", name.to_string_lossy());
            if let Some(wrong) = wrong_name(name.to_str(), &prefix, kind.is_dir()) {
                problems.add(Check::Files, &lossy, None, wrong);
            } else if kind.is_dir() {
                folders.push((place, format!("{lossy}/"), level + 1));
            } else if kind.is_symlink() {
                let message = "a link, which may lead out of the folder; put a copy in its place";
                problems.add(Check::Files, &lossy, None, message);
            } else if !kind.is_file() {
                problems.add(Check::Files, &lossy, None, "no plain file; remove it");
            } else {
                found.insert(lossy, place);
            }
            if found.len() > FILES_MAX {
                return Err(too_large("more than 100,000 files"));
            }
        }
    }
    Ok(found)
}

/// What is wrong with a name, if something is.
fn wrong_name(name: Option<&str>, prefix: &str, is_folder: bool) -> Option<&'static str> {
    let Some(name) = name else {
        return Some("the name is no Unicode; rename it");
    };
    let is_attributes = prefix.is_empty() && name == GIT_ATTRIBUTES && !is_folder;
    if name == reel_dataset::UNFINISHED {
        Some("the export was broken off; run it again with the same command")
    } else if name.starts_with('.') && !is_attributes {
        Some("hidden, and no part of a dataset; remove it")
    } else if name.chars().any(char::is_control) {
        Some("control characters in the name; rename it")
    } else if name.contains(['\\', ':', '*', '?', '"', '<', '>', '|']) {
        Some("characters in the name that not every system takes; rename it")
    } else if name.starts_with(' ') || name.ends_with([' ', '.']) {
        Some("the name begins with a space, or ends with one or with a dot; rename it")
    } else if name.len() > NAME_BYTES_MAX {
        Some("a name of more than 200 bytes; rename it")
    } else {
        None
    }
}

/// Reads a file once: digests, and which secrets its bytes hold.
fn read_file(
    path: &str,
    place: &Path,
    problems: &mut Problems,
) -> Result<PublishedFile, PublishError> {
    let failed = || PublishError::read(place);
    let mut file = File::open(place).map_err(failed())?;
    let size = file.metadata().map_err(failed())?.len();
    if size == 0 {
        let message = "an empty file; remove it, or export again";
        problems.add(Check::Files, path, None, message);
    }
    if size > FILE_BYTES_MAX {
        return Err(PublishError::TooLarge {
            path: place.to_owned(),
            message: "more than 50 GB in one file; export with fewer rows in a file".to_owned(),
        });
    }
    let mut digests = Digests::new(size);
    let mut scanner = SecretScanner::default();
    let mut piece = vec![0; PIECE];
    loop {
        let count = file.read(&mut piece).map_err(failed())?;
        if count == 0 {
            break;
        }
        digests.update(&piece[..count]);
        scanner.feed(&piece[..count]);
    }
    let mut read = digests.finish(path, Content::Disk(place.to_owned()));
    read.secrets = scanner.finish();
    if read.bytes == size {
        Ok(read)
    } else {
        Err(PublishError::Changed {
            path: place.to_owned(),
        })
    }
}

/// What a person does about a secret.
pub(crate) fn secret_message(kind: &str) -> String {
    format!("{kind} is in it; revoke it where it was issued, remove it and export again")
}

/// Whether a file belongs to the layout and is not listed in the manifest of the export.
pub(crate) fn is_generated(path: &str) -> bool {
    path == GIT_ATTRIBUTES || path == CHECKSUMS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn digests_are_those_of_other_programs() {
        // sha256sum, and git hash-object
        let file = PublishedFile::in_memory("a", b"hello\n".to_vec());
        assert_eq!(
            file.sha256,
            "5891b5b522d5df086d0ff0b110fbd9d21bb4fc7163af34d08286a2e846f6be03"
        );
        assert_eq!(file.git_blob, "ce013625030ba8dba906f756967f9e9ca394464a");
        assert_eq!(file.bytes, 6);
    }

    #[test]
    fn names_that_are_unsafe_elsewhere_are_refused() {
        for name in ["a.jsonl", "train-00000.parquet", "ä ö", "a-b_c.1"] {
            assert_eq!(wrong_name(Some(name), "", false), None, "{name}");
        }
        assert_eq!(wrong_name(Some(GIT_ATTRIBUTES), "", false), None);
        for name in [
            ".env", "a\nb", "a\\b", "con:", " a", "a.", "a\u{7f}", ".git",
        ] {
            assert!(wrong_name(Some(name), "", false).is_some(), "{name:?}");
        }
        assert!(wrong_name(Some(GIT_ATTRIBUTES), "train/", false).is_some());
        assert!(wrong_name(None, "", false).is_some());
        assert!(wrong_name(Some(&"x".repeat(201)), "", false).is_some());
    }
}
