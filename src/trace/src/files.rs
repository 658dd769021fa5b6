//! Files of traces: names, reading within a limit, and putting a finished file in its place at
//! once. Knows nothing of what is in them.

use std::{
    ffi::OsString,
    io::{self, Read as _, Write as _},
    path::{Path, PathBuf},
};

use crate::{Disk, LocalDisk, TraceError, TraceFiles, buffer::Buffer, limits::Limits, shard};

/// What the name of an unfinished recording ends with.
pub(crate) const PART: &str = ".part";
/// What the name of a file ends with that is not in its place yet.
const TEMPORARY: &str = ".tmp";

/// `path` with something appended to its name.
pub(crate) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

/// The whole file, if it is not larger than the limit.
pub(crate) fn read(files: &TraceFiles, path: &Path, limits: &Limits) -> Result<Buffer, TraceError> {
    if let Some(bytes) = files.unpacked(path) {
        return Ok(bytes?.into());
    }
    let failed = |source: io::Error| {
        let part = with_suffix(path, PART);
        if source.kind() == io::ErrorKind::NotFound && files.disk().exists(&part).unwrap_or(false) {
            return TraceError::Unfinished { part };
        }
        TraceError::Io {
            action: "read",
            path: path.to_owned(),
            source,
        }
    };
    let limit = limits.file_bytes;
    let file = files
        .local_copy(path)
        .and_then(|path| files.disk().open(&path))
        .map_err(failed)?;
    let found = file.size().map_err(failed)?;
    let mut bytes = Buffer::take();
    if found <= limit {
        // one more than there is: the end is seen without growing
        bytes.reserve_exact(usize::try_from(found).unwrap_or(0) + 1);
        file.take(limit.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(failed)?;
    }
    match found.max(bytes.len() as u64) {
        found if found > limit => Err(TraceError::TooLarge {
            path: path.to_owned(),
            limit,
            found,
        }),
        _ if shard::begins_as_shard(&bytes) => Err(TraceError::Packed {
            path: path.to_owned(),
            problem: "it holds packed episodes; name one of them, as in FILE#0, or see `reel unpack --list`"
                .to_owned(),
        }),
        _ => Ok(bytes),
    }
}

/// Puts a file in its place at once: whoever looks finds what was there before, or all of it. The
/// content is on the disk before the name is, and the name before this returns.
pub(crate) fn publish(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> io::Result<()> {
    publish_by(disk, path, bytes, |from, to| disk.rename(from, to))
}

/// [`publish`] under a name that nothing has, also not since somebody looked.
pub(crate) fn publish_new(disk: &dyn Disk, path: &Path, bytes: &[u8]) -> io::Result<()> {
    publish_by(disk, path, bytes, |from, to| disk.rename_new(from, to))
}

/// Writes a file of this machine that is not there yet, at once and onto the disk.
///
/// # Errors
/// As the system says; [`io::ErrorKind::AlreadyExists`] where there is one.
pub fn write_new(path: &Path, bytes: &[u8]) -> io::Result<()> {
    publish_new(&LocalDisk, path, bytes)
}

fn publish_by(
    disk: &dyn Disk,
    path: &Path,
    bytes: &[u8],
    rename: impl FnOnce(&Path, &Path) -> io::Result<()>,
) -> io::Result<()> {
    let temporary = with_suffix(path, TEMPORARY);
    // One that a killed process left.
    let _ = disk.remove_file(&temporary);
    let write = || {
        let mut file = disk.create_new(&temporary)?;
        file.write_all(bytes)?;
        file.sync()?;
        rename(&temporary, path)
    };
    write().inspect_err(|_| drop(disk.remove_file(&temporary)))?;
    sync_folder(disk, path)
}

/// Puts the names in a file's folder on the disk.
pub(crate) fn sync_folder(disk: &dyn Disk, path: &Path) -> io::Result<()> {
    disk.sync_folder(path.parent().unwrap_or(Path::new("")))
}
