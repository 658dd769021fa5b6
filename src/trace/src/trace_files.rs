//! Where traces are read from: the files of this machine and, where a program has a [`RemoteFs`],
//! files under names like `s3://bucket/folder/trace.mcap`. This crate knows no protocol of them.

use std::{
    io,
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_world::Assets;

use crate::{Disk, Limits, LocalDisk, Trace, TraceError, files, shard};

/// What is known of a file without reading it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FileMetadata {
    /// Size of the file in bytes.
    pub bytes: u64,
    /// When it was written last, nanoseconds since 1970; 0 if unknown.
    pub modified_ns: i64,
}

/// A place of files that are named by URL.
pub trait RemoteFs: Send + Sync {
    /// The files below a folder, or the one file of this name; none where there is neither.
    ///
    /// # Errors
    /// Fails if the place cannot be reached.
    fn list(&self, folder: &str) -> io::Result<Vec<String>>;

    /// What is known of a file.
    ///
    /// # Errors
    /// Fails if it is not there, or the place cannot be reached.
    fn metadata(&self, name: &str) -> io::Result<FileMetadata>;

    /// Brings a file to this machine, as it is now, and says where it is.
    ///
    /// # Errors
    /// Fails if it is not there, or the place cannot be reached.
    fn fetch(&self, name: &str) -> io::Result<PathBuf>;

    /// Begins to bring a file that will be fetched soon, once, by this process. Waits for nothing; what
    /// goes wrong is said when it is fetched.
    fn prefetch(&self, name: &str) {
        let _ = name;
    }
}

/// Brings episodes of shards back to the bytes of their traces, by executing them.
pub trait PackedFs: Send + Sync {
    /// The trace of an episode.
    ///
    /// # Errors
    /// When the shard cannot be read, or execution does not give the trace that was packed.
    fn unpack(&self, shard: &Path, episode: &str) -> Result<Vec<u8>, TraceError>;

    /// What is known of the trace without executing: its size, and when the shard was written.
    ///
    /// # Errors
    /// When the shard cannot be read.
    fn metadata(&self, shard: &Path, episode: &str) -> Result<FileMetadata, TraceError>;
}

/// Reads traces by name. The default reads files of this machine and refuses URLs.
#[derive(Clone)]
pub struct TraceFiles {
    disk: Arc<dyn Disk>,
    remote: Option<Arc<dyn RemoteFs>>,
    packed: Option<Arc<dyn PackedFs>>,
    assets: Option<Arc<dyn Assets + Send>>,
}

impl Default for TraceFiles {
    fn default() -> Self {
        Self::on(Arc::new(LocalDisk))
    }
}

impl TraceFiles {
    /// Reads files of this disk, and refuses URLs.
    pub fn on(disk: Arc<dyn Disk>) -> Self {
        Self {
            disk,
            remote: None,
            packed: None,
            assets: None,
        }
    }

    /// Reads files of this machine, and those named by URL from `remote`.
    pub fn with_remote(remote: Arc<dyn RemoteFs>) -> Self {
        Self {
            remote: Some(remote),
            ..Self::default()
        }
    }

    /// Gives the traces that are read the meshes that they were recorded with, as far as these are
    /// among `assets`.
    #[must_use]
    pub fn with_assets(self, assets: Option<Arc<dyn Assets + Send>>) -> Self {
        Self { assets, ..self }
    }

    /// Reads episodes of shards too, named `shard.mcap#EPISODE`.
    #[must_use]
    pub fn with_packed(self, packed: Arc<dyn PackedFs>) -> Self {
        Self {
            packed: Some(packed),
            ..self
        }
    }

    /// The bytes of a trace that a shard holds; none where the path names no episode of a shard.
    pub(crate) fn unpacked(&self, path: &Path) -> Option<Result<Vec<u8>, TraceError>> {
        let (shard, episode) = self.member(path)?;
        let refused = |problem: &str| TraceError::Packed {
            path: path.to_owned(),
            problem: problem.to_owned(),
        };
        if is_remote(shard) {
            return Some(Err(refused(
                "packed episodes are executed on this machine; copy the file first, with `reel trace copy`",
            )));
        }
        let packed = self.packed.as_ref().ok_or_else(|| {
            refused("this program executes no packed episodes; unpack it first, with `reel unpack`")
        });
        Some(packed.and_then(|packed| packed.unpack(shard, episode)))
    }

    /// The shard and the episode that a path names, unless a file has that very name.
    fn member<'p>(&self, path: &'p Path) -> Option<(&'p Path, &'p str)> {
        shard::member(path).filter(|_| !self.disk.exists(path).unwrap_or(false))
    }

    /// The disk that files without URL are on.
    pub fn disk(&self) -> &Arc<dyn Disk> {
        &self.disk
    }

    /// [`Trace::read`] of a file on this machine or of a URL, with its meshes.
    ///
    /// # Errors
    /// As [`Trace::read`], and if the file cannot be fetched.
    pub fn read(&self, path: &Path) -> Result<Trace, TraceError> {
        Ok(self.with_meshes(Trace::read_from(self, path, &Limits::default())?))
    }

    /// The bytes of a file that [`TraceFiles::read`] reads.
    ///
    /// # Errors
    /// When it cannot be read, or is larger than traces may be.
    pub fn bytes(&self, path: &Path) -> Result<Vec<u8>, TraceError> {
        Ok(files::read(self, path, &Limits::default())?.to_vec())
    }

    /// A trace that was read elsewhere, with the meshes that it was recorded with, as far as these
    /// are known here.
    #[must_use]
    pub fn with_meshes(&self, trace: Trace) -> Trace {
        match &self.assets {
            Some(assets) => trace.with_meshes(&**assets),
            None => trace,
        }
    }

    /// The files below a folder that is named by URL.
    ///
    /// # Errors
    /// Fails if the place cannot be reached, or the folder is not named by URL.
    pub fn list_remote(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        let names = self.remote(folder)?.list(url(folder).unwrap_or_default())?;
        Ok(names.into_iter().map(PathBuf::from).collect())
    }

    /// What is known of a file, wherever it lies.
    ///
    /// # Errors
    /// Fails if it is not there, or the place cannot be reached.
    pub fn metadata(&self, path: &Path) -> io::Result<FileMetadata> {
        if let Some(name) = url(path) {
            return self.remote(path)?.metadata(name);
        }
        match (&self.packed, self.member(path)) {
            (Some(packed), Some((shard, episode))) => {
                packed.metadata(shard, episode).map_err(io::Error::other)
            }
            _ => self.disk.metadata(path),
        }
    }

    /// Where a file lies on this machine, once it is fetched.
    ///
    /// # Errors
    /// Fails if it is named by URL, and not there or not reached.
    pub fn local_copy(&self, path: &Path) -> io::Result<PathBuf> {
        match url(path) {
            Some(name) => self.remote(path)?.fetch(name),
            None => Ok(path.to_owned()),
        }
    }

    /// Begins to bring files that are not on this machine and will be read soon, each once.
    pub fn prefetch(&self, paths: &[PathBuf]) {
        let Some(remote) = &self.remote else { return };
        paths
            .iter()
            .filter(|path| shard::member(path).is_none())
            .filter_map(|path| url(path))
            .for_each(|name| remote.prefetch(name));
    }

    fn remote(&self, path: &Path) -> io::Result<&dyn RemoteFs> {
        self.remote.as_deref().ok_or_else(|| {
            io::Error::other(format!(
                "only local files are read here; fetch it first, with `reel trace copy {} .`",
                path.display()
            ))
        })
    }
}

impl std::fmt::Debug for TraceFiles {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self.remote {
            None => "TraceFiles(local)",
            Some(_) => "TraceFiles(local and remote)",
        })
    }
}

/// Whether a file is named by URL.
pub fn is_remote(path: &Path) -> bool {
    url(path).is_some()
}

fn url(path: &Path) -> Option<&str> {
    path.to_str().filter(|name| name.contains("://"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn local_readers_refuse_a_url_and_name_the_command() {
        let error = Trace::read(Path::new("s3://lab/traces/a.mcap")).unwrap_err();
        let text = format!("{error} {:?}", error);
        assert!(
            text.contains("reel trace copy s3://lab/traces/a.mcap ."),
            "{text}"
        );
    }
}
