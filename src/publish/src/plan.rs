//! What publishing would do to a target: which files are new, changed or equal there, and which are
//! there only. Compares digests; writes nothing.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::{
    PublishedFile,
    generated::{CHECKSUMS, GIT_ATTRIBUTES},
};

/// A file that is at the target already.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct ExistingFile {
    /// Size of the file in bytes.
    pub bytes: u64,
    /// The digest by which the target knows it.
    pub digest: FileDigest,
}

/// The digest by which a target knows a file, in hexadecimal digits.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum FileDigest {
    /// SHA-256 of the bytes, of files on a disk and of large ones on the Hub.
    Sha256(String),
    /// The id of a blob in Git, of small files on the Hub.
    GitBlob(String),
}

/// How a file compares with the target.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum FileStatus {
    /// The target has no such file.
    New,
    /// The target's file has other bytes.
    Changed,
    /// The target's file has the same bytes; it is not written.
    Equal,
}

impl FileStatus {
    /// The word for a table of files.
    pub fn as_str(self) -> &'static str {
        match self {
            FileStatus::New => "new",
            FileStatus::Changed => "changed",
            FileStatus::Equal => "equal",
        }
    }
}

/// A file with what publishing does to it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct PlannedFile {
    /// From the dataset's folder, with `/`.
    pub path: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// SHA-256 of the file's bytes.
    pub sha256: String,
    /// How it compares with the target.
    pub status: FileStatus,
}

/// What publishing does to a target.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct Plan {
    /// The files of the dataset, by path.
    pub files: Vec<PlannedFile>,
    /// Files that only the target has. They stay, unless the caller asks to delete them.
    pub only_at_target: Vec<String>,
}

impl Plan {
    /// Compares the files of a dataset with those of a target.
    pub fn new(
        files: &BTreeMap<String, PublishedFile>,
        existing: &BTreeMap<String, ExistingFile>,
    ) -> Self {
        let planned = files.values().map(|file| PlannedFile {
            path: file.path.clone(),
            bytes: file.bytes,
            sha256: file.sha256.clone(),
            status: match existing.get(&file.path) {
                None => FileStatus::New,
                Some(there) if there.has_bytes_of(file) => FileStatus::Equal,
                Some(_) => FileStatus::Changed,
            },
        });
        let extra = existing.keys().filter(|path| !files.contains_key(*path));
        Self {
            files: planned.collect(),
            only_at_target: extra.cloned().collect(),
        }
    }

    /// How many files have a status.
    pub fn count(&self, status: FileStatus) -> usize {
        self.files
            .iter()
            .filter(|file| file.status == status)
            .count()
    }

    /// Size of all files in bytes.
    pub fn bytes(&self) -> u64 {
        self.files.iter().map(|file| file.bytes).sum()
    }

    /// Size in bytes of the files that are new or changed.
    pub fn bytes_to_write(&self) -> u64 {
        self.to_write().map(|file| file.bytes).sum()
    }

    /// The files that are new or changed, in the order in which they are written: what says how
    /// others are stored first, what says that the dataset is whole last.
    pub fn to_write(&self) -> impl Iterator<Item = &PlannedFile> {
        let mut files: Vec<&PlannedFile> = self
            .files
            .iter()
            .filter(|file| file.status != FileStatus::Equal)
            .collect();
        files.sort_by_key(|file| (rank(&file.path), &file.path));
        files.into_iter()
    }

    /// Whether the target has all files already, and nothing that shall be deleted.
    pub fn is_done(&self, delete: bool) -> bool {
        (self.only_at_target.is_empty() || !delete) && self.to_write().next().is_none()
    }
}

impl ExistingFile {
    fn has_bytes_of(&self, file: &PublishedFile) -> bool {
        match &self.digest {
            FileDigest::Sha256(digest) => *digest == file.sha256 && self.bytes == file.bytes,
            FileDigest::GitBlob(digest) => *digest == file.git_blob,
        }
    }
}

fn rank(path: &str) -> u8 {
    match path {
        GIT_ATTRIBUTES => 0,
        CHECKSUMS => 3,
        reel_dataset::CARD | reel_dataset::MANIFEST | "meta/info.json" => 2,
        _ => 1,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_compared_by_their_digests() {
        let files: BTreeMap<String, PublishedFile> = [CHECKSUMS, "README.md", "a", "b", "c"]
            .iter()
            .map(|path| {
                let file = PublishedFile::in_memory(path, path.as_bytes().to_vec());
                ((*path).to_owned(), file)
            })
            .collect();
        let there = |digest| ExistingFile { bytes: 1, digest };
        let sha256 = |of: &str| FileDigest::Sha256(files[of].sha256.clone());
        let existing = BTreeMap::from([
            ("a".to_owned(), there(sha256("a"))),
            (
                "b".to_owned(),
                there(FileDigest::GitBlob(files["b"].git_blob.clone())),
            ),
            ("c".to_owned(), there(sha256("b"))),
            ("z".to_owned(), there(sha256("b"))),
        ]);
        let plan = Plan::new(&files, &existing);
        assert_eq!(plan.count(FileStatus::Equal), 2);
        assert_eq!(plan.only_at_target, ["z"]);
        let written: Vec<&str> = plan.to_write().map(|file| file.path.as_str()).collect();
        assert_eq!(written, ["c", "README.md", CHECKSUMS]);
        assert!(!plan.is_done(false));
        let all = files.keys().map(|path| (path.clone(), there(sha256(path))));
        let mut all: BTreeMap<String, ExistingFile> = all.collect();
        for (path, there) in &mut all {
            there.bytes = files[path].bytes;
        }
        assert!(Plan::new(&files, &all).is_done(true));
    }
}
