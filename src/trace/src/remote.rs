//! Traces that do not lie on this machine, under names like `s3://bucket/folder/trace.mcap`. This
//! crate reaches none of them: the program says once who does ([`install_remote_fs`]), and from
//! then on they are read like files.

use std::{
    io,
    path::{Path, PathBuf},
    sync::OnceLock,
    time::UNIX_EPOCH,
};

/// What is known of a file without reading it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FileMetadata {
    /// Size of the file in bytes.
    pub bytes: u64,
    /// When it was written last, nanoseconds since 1970; 0 where nobody tells.
    pub modified_ns: i64,
}

/// A place of files that are named by URL.
pub trait RemoteFs: Send + Sync {
    /// The files below a folder, or the one file of this name; none where there is neither.
    ///
    /// # Errors
    /// When the place cannot be reached.
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;

    /// What is known of a file.
    ///
    /// # Errors
    /// When it is not there, or the place cannot be reached.
    fn metadata(&self, name: &str) -> io::Result<FileMetadata>;

    /// Brings a file to this machine, as it is now, and says where it is.
    ///
    /// # Errors
    /// When it is not there, or the place cannot be reached.
    fn fetch(&self, name: &str) -> io::Result<PathBuf>;
}

static REMOTE: OnceLock<Box<dyn RemoteFs>> = OnceLock::new();

/// Says who reaches the files that are named by URL. The first one that is named stays.
pub fn install_remote_fs(remote: Box<dyn RemoteFs>) {
    let _ = REMOTE.set(remote);
}

/// Whether a file is named by URL.
pub fn is_remote(path: &Path) -> bool {
    url(path).is_some()
}

/// The files below a folder that is named by URL.
///
/// # Errors
/// When nobody reaches it.
pub fn list_remote(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let Some(name) = url(folder) else {
        return Err(nobody(folder));
    };
    Ok(remote(folder)?
        .list(name)?
        .into_iter()
        .map(PathBuf::from)
        .collect())
}

/// What is known of a file, wherever it lies.
///
/// # Errors
/// When it is not there, or nobody reaches it.
pub fn file_metadata(path: &Path) -> io::Result<FileMetadata> {
    if let Some(name) = url(path) {
        return remote(path)?.metadata(name);
    }
    let data = std::fs::metadata(path)?;
    let since = data
        .modified()
        .ok()
        .and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    let modified_ns = since
        .and_then(|since| i64::try_from(since.as_nanos()).ok())
        .unwrap_or(0);
    Ok(FileMetadata {
        bytes: data.len(),
        modified_ns,
    })
}

/// Where a file lies on this machine, once it is brought here.
///
/// # Errors
/// When it is named by URL, and not there or not reached.
pub fn local_copy(path: &Path) -> io::Result<PathBuf> {
    match url(path) {
        Some(name) => remote(path)?.fetch(name),
        None => Ok(path.to_owned()),
    }
}

fn url(path: &Path) -> Option<&str> {
    path.to_str().filter(|name| name.contains("://"))
}

fn remote(path: &Path) -> io::Result<&'static dyn RemoteFs> {
    REMOTE
        .get()
        .map(|remote| &**remote)
        .ok_or_else(|| nobody(path))
}

fn nobody(path: &Path) -> io::Error {
    io::Error::other(format!(
        "this build of reel reaches no files of other machines: {}",
        path.display()
    ))
}
