//! The files that publishing adds to a dataset: `.gitattributes`, by which Git stores large files
//! outside of its history, and `SHA256SUMS`, which `sha256sum -c` checks. Equal files give equal
//! bytes.

use std::collections::{BTreeMap, BTreeSet};

use crate::PublishedFile;

/// The name of the file that tells Git LFS its files.
pub const GIT_ATTRIBUTES: &str = ".gitattributes";
/// The name of the list of checksums.
pub const CHECKSUMS: &str = "SHA256SUMS";

/// Endings of files that are no text, or grow large.
const LARGE: [&str; 17] = [
    "arrow", "bin", "gif", "gz", "jpeg", "jpg", "jsonl", "mcap", "mp4", "npy", "npz", "parquet",
    "png", "tar", "webp", "zip", "zst",
];
/// Size in bytes from which a file of another ending is stored outside of Git's history.
const LARGE_BYTES: u64 = 10 << 20;

/// The attributes for these files.
pub(crate) fn git_attributes(files: &BTreeMap<String, PublishedFile>) -> Vec<u8> {
    let mut patterns: BTreeSet<String> = BTreeSet::new();
    for (path, file) in files {
        let name = path.rsplit('/').next().unwrap_or(path);
        let ending = name.rsplit_once('.').map(|(_, ending)| ending);
        match ending {
            Some(ending) if LARGE.contains(&ending) => {
                patterns.insert(format!("*.{ending}"));
            }
            _ if file.bytes >= LARGE_BYTES => {
                patterns.insert(format!("/{}", path.replace(' ', "[[:space:]]")));
            }
            _ => {}
        }
    }
    let lines = patterns
        .iter()
        .map(|pattern| format!("{pattern} filter=lfs diff=lfs merge=lfs -text\n"));
    lines.collect::<String>().into_bytes()
}

/// The checksums of these files, sorted by path.
pub(crate) fn checksums(files: &BTreeMap<String, PublishedFile>) -> Vec<u8> {
    let listed = files.iter().filter(|(path, _)| *path != CHECKSUMS);
    let lines = listed.map(|(path, file)| format!("{}  {path}\n", file.sha256));
    lines.collect::<String>().into_bytes()
}

/// The entries of a list of checksums, as (path, digest); `None` if it is none.
pub(crate) fn read_checksums(text: &str) -> Option<Vec<(&str, &str)>> {
    text.lines()
        .filter(|line| !line.is_empty())
        .map(|line| {
            let (digest, path) = line.split_once(' ')?;
            let path = path.strip_prefix([' ', '*'])?;
            let is_digest = digest.len() == 64 && digest.bytes().all(|it| it.is_ascii_hexdigit());
            (is_digest && !path.is_empty()).then_some((path, digest))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_read_as_they_are_written() {
        let files: BTreeMap<String, PublishedFile> = ["b c.json", "a.parquet", CHECKSUMS]
            .iter()
            .map(|path| {
                let file = PublishedFile::in_memory(path, path.as_bytes().to_vec());
                ((*path).to_owned(), file)
            })
            .collect();
        let text = String::from_utf8(checksums(&files)).unwrap();
        let entries = read_checksums(&text).unwrap();
        assert_eq!(entries.len(), 2);
        for (path, digest) in entries {
            assert_eq!(files[path].sha256, digest);
        }
        assert_eq!(read_checksums("no checksums"), None);
        assert_eq!(read_checksums(&"ä".repeat(80)), None);
        assert_eq!(
            git_attributes(&files),
            b"*.parquet filter=lfs diff=lfs merge=lfs -text\n"
        );
    }
}
