//! Publishing to a folder: the whole dataset is written beside the target and takes its place in
//! one step, so that the target is never half-written. Files that only the target has move along.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{self, Read},
    path::{Path, PathBuf},
};

use sha2::{Digest as _, Sha256};

use crate::{
    ExistingFile, FileDigest, Plan, Problems, Publication, PublishError, PublishedFile,
    folder::{PIECE, hex, walk},
    generated::CHECKSUMS,
};

/// The files of a target folder, by path; empty if there is no folder.
///
/// # Errors
/// Fails if the target is something that publishing must not replace, or cannot be read.
pub fn existing_files(
    source: &Path,
    target: &Path,
) -> Result<BTreeMap<String, ExistingFile>, PublishError> {
    let refuse = |reason: &str| PublishError::Target {
        path: target.to_owned(),
        reason: reason.to_owned(),
    };
    let (from, to) = (real_path(source), real_path(target));
    if from.starts_with(&to) || to.starts_with(&from) {
        return Err(refuse(
            "the target and the dataset are in each other; name another folder",
        ));
    }
    match fs::symlink_metadata(target) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(BTreeMap::new()),
        Err(error) => return Err(PublishError::read(target)(error)),
        Ok(entry) if !entry.is_dir() => {
            return Err(refuse("the target is no folder; name another one"));
        }
        Ok(_) => {}
    }
    let mut problems = Problems::default();
    let paths = walk(target, &mut problems)?;
    if let Some(problem) = problems.kept_problems().first() {
        return Err(refuse(&format!(
            "the target holds what publishing does not write ({problem}); name another folder"
        )));
    }
    if !paths.is_empty() && !paths.contains_key(CHECKSUMS) {
        return Err(refuse(
            "the target is no published dataset: it has files, and no SHA256SUMS; name another folder",
        ));
    }
    paths
        .into_iter()
        .map(|(path, place)| {
            let mut file = File::open(&place).map_err(PublishError::read(&place))?;
            let (digest, bytes) =
                copy(&mut file, &mut io::sink()).map_err(PublishError::read(&place))?;
            let digest = FileDigest::Sha256(digest);
            Ok((path, ExistingFile { bytes, digest }))
        })
        .collect()
}

/// A path without links as far as it is there.
fn real_path(path: &Path) -> PathBuf {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let known = absolute
        .ancestors()
        .find_map(|folder| Some((folder, fs::canonicalize(folder).ok()?)));
    match known {
        Some((folder, real)) => match absolute.strip_prefix(folder) {
            Ok(rest) if !rest.as_os_str().is_empty() => real.join(rest),
            _ => real,
        },
        None => absolute,
    }
}

/// Writes a dataset as a folder; with `delete` without the files that only the target has.
/// `progress` is told the bytes written.
///
/// # Errors
/// Fails if a file changed since it was checked, or cannot be read or written; the target is then
/// as it was.
pub fn publish_to_folder(
    publication: &Publication,
    plan: &Plan,
    target: &Path,
    delete: bool,
    mut progress: impl FnMut(u64),
) -> Result<(), PublishError> {
    let name = target.file_name().ok_or_else(|| PublishError::Target {
        path: target.to_owned(),
        reason: "the target has no name".to_owned(),
    })?;
    let parent = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    fs::create_dir_all(parent).map_err(PublishError::write(parent))?;
    let beside = |what: &str| {
        let name = name.to_string_lossy();
        parent.join(format!(".{name}.{what}-{}", std::process::id()))
    };
    let staged = Staged::create(beside("new"))?;
    let mut written = 0;
    for file in publication.files().values() {
        write_file(file, &staged.0)?;
        written += file.bytes;
        progress(written);
    }
    if !delete {
        for path in &plan.only_at_target {
            let (from, to) = (target.join(path), staged.0.join(path));
            make_parent(&to)?;
            fs::copy(&from, &to).map_err(PublishError::write(&to))?;
        }
    }
    staged.take_place_of(target, &beside("old"))
}

/// A folder that is removed unless it takes its place.
struct Staged(PathBuf);

impl Staged {
    fn create(path: PathBuf) -> Result<Self, PublishError> {
        fs::create_dir(&path).map_err(PublishError::write(&path))?;
        Ok(Self(path))
    }

    /// Puts the folder where the target is, and removes what was there.
    fn take_place_of(mut self, target: &Path, old: &Path) -> Result<(), PublishError> {
        let failed = || PublishError::write(target);
        if fs::symlink_metadata(target).is_err() {
            fs::rename(&self.0, target).map_err(failed())?;
            self.0 = PathBuf::new();
            return Ok(());
        }
        if exchange(&self.0, target).is_ok() {
            // dropping removes what was at the target
            return Ok(());
        }
        // a file system that cannot exchange two folders: there is a moment without the target
        fs::rename(target, old).map_err(failed())?;
        if let Err(error) = fs::rename(&self.0, target) {
            let _put_back = fs::rename(old, target);
            return Err(failed()(error));
        }
        self.0 = old.to_owned();
        Ok(())
    }
}

impl Drop for Staged {
    fn drop(&mut self) {
        if !self.0.as_os_str().is_empty() {
            let _nothing_to_do = fs::remove_dir_all(&self.0);
        }
    }
}

#[cfg(any(target_os = "linux", target_os = "macos"))]
fn exchange(one: &Path, other: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};

    renameat_with(CWD, one, CWD, other, RenameFlags::EXCHANGE).map_err(io::Error::from)
}

#[cfg(not(any(target_os = "linux", target_os = "macos")))]
fn exchange(_one: &Path, _other: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

fn make_parent(path: &Path) -> Result<(), PublishError> {
    let folder = path.parent().unwrap_or(path);
    fs::create_dir_all(folder).map_err(PublishError::write(folder))
}

/// Copies a file, and checks that its bytes are those that were checked.
fn write_file(file: &PublishedFile, root: &Path) -> Result<(), PublishError> {
    let to = root.join(&file.path);
    make_parent(&to)?;
    let mut out = File::create_new(&to).map_err(PublishError::write(&to))?;
    let (digest, bytes) = copy(&mut *file.open()?, &mut out).map_err(PublishError::write(&to))?;
    out.sync_data().map_err(PublishError::write(&to))?;
    if digest == file.sha256 && bytes == file.bytes {
        Ok(())
    } else {
        Err(PublishError::Changed { path: file.place() })
    }
}

/// Copies all bytes; their digest and number.
fn copy(from: &mut dyn Read, to: &mut dyn io::Write) -> io::Result<(String, u64)> {
    let (mut sha256, mut bytes) = (Sha256::default(), 0);
    let mut piece = vec![0; PIECE];
    loop {
        let count = from.read(&mut piece)?;
        if count == 0 {
            return Ok((hex(&sha256.finalize()), bytes));
        }
        sha256.update(&piece[..count]);
        to.write_all(&piece[..count])?;
        bytes += count as u64;
    }
}
