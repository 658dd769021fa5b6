//! The folder of traces as clients see it: names, never paths.

use std::{
    io::{self, Write as _},
    path::{Path, PathBuf},
    process,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, UNIX_EPOCH},
};

use axum::body::Bytes;
use futures_util::{Stream, StreamExt as _};
use reel_live::Host;
use reel_trace::{Disk, DiskFile, Trace, TraceFiles};
use reel_world::Assets;
use serde::Serialize;
use tokio::time::Instant;
use utoipa::ToSchema;

use crate::rest::ApiError;

/// Bytes a second that an upload must come with, its first moments apart.
const SLOWEST_UPLOAD: u64 = 16 << 10;

/// The folder of traces.
#[derive(Clone, Debug)]
pub(crate) struct Archive {
    host: Host,
    folder: PathBuf,
    /// Reads its traces, with their meshes.
    files: TraceFiles,
}

/// A file of the archive.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, ToSchema)]
pub(crate) struct TraceFile {
    /// Its name, without `.mcap`.
    pub trace: String,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// When it was written, in seconds since 1970.
    pub written: u64,
    /// Whether it is still being recorded (or broke off).
    pub recording: bool,
}

impl Archive {
    /// An archive in a folder, which is made if it is not there.
    pub fn open(host: Host, folder: PathBuf) -> io::Result<Self> {
        host.disk.create_dir_all(&folder)?;
        // Paths in tables are absolute, and a change of the working directory changes nothing.
        let folder = host.disk.canonicalize(&folder)?;
        let files = host.trace_files();
        Ok(Self {
            host,
            folder,
            files,
        })
    }

    /// Gives the traces that are read the meshes that they were recorded with.
    pub fn with_assets(mut self, assets: Option<Arc<dyn Assets + Send>>) -> Self {
        self.files = self.files.with_assets(assets);
        self
    }

    /// Reads traces of the archive by path.
    pub fn files(&self) -> &TraceFiles {
        &self.files
    }

    /// Removes what a killed server was taking in.
    pub fn sweep(&self) {
        for path in self.host.disk.list(&self.folder).into_iter().flatten() {
            let name = file_name(&path);
            if name.starts_with('.') && name.ends_with(UPLOAD) {
                let _ = self.host.disk.remove_file(&path);
            }
        }
    }

    /// Puts the names of all traces on the disk.
    pub fn sync(&self) -> io::Result<()> {
        self.host.disk.sync_folder(&self.folder)
    }

    /// Where a trace of that name lies, or would lie.
    pub fn path(&self, name: &str) -> Result<PathBuf, ApiError> {
        let allowed = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let fine = (1..=200).contains(&name.len())
            && name.chars().all(allowed)
            && name.starts_with(|c: char| c.is_ascii_alphanumeric())
            && !name.ends_with(".mcap");
        if !fine {
            let text = "a trace is named by 1 to 200 letters, digits, '-', '_' and '.', the first a letter or digit, without .mcap";
            return Err(ApiError::bad_request("bad_name", text));
        }
        Ok(self.folder.join(format!("{name}.mcap")))
    }

    /// The name of a trace, where it lies here.
    pub fn name_of(&self, path: &Path) -> Option<String> {
        let name = path
            .strip_prefix(&self.folder)
            .ok()?
            .to_str()?
            .strip_suffix(".mcap")?;
        (!name.contains(['/', '\\'])).then(|| name.to_owned())
    }

    /// An existing, finished trace.
    pub fn existing(&self, name: &str) -> Result<PathBuf, ApiError> {
        let path = self.path(name)?;
        if self.host.disk.is_file(&path) {
            return Ok(path);
        }
        if self.host.disk.is_file(&part_of(&path)) {
            return Err(ApiError::conflict(
                "recording",
                format!("{name} is still being recorded"),
            ));
        }
        Err(ApiError::not_found(format!("unknown trace {name}")))
    }

    /// Reads a finished trace of the archive by its name.
    pub fn read(&self, name: &str) -> Result<Trace, ApiError> {
        let path = self.existing(name)?;
        let trace = self.files.read(&path);
        trace.map_err(|error| ApiError::unprocessable("bad_trace", error.to_string()))
    }

    /// Deletes a finished trace.
    pub async fn delete(&self, name: &str) -> Result<(), ApiError> {
        let (path, disk) = (self.existing(name)?, self.host.disk.clone());
        let delete = move || {
            disk.remove_file(&path)?;
            disk.sync_folder(path.parent().unwrap_or(Path::new("")))
        };
        let deleted = self.host.work.spawn(delete).await;
        let deleted = deleted.map_err(io::Error::other).flatten();
        deleted.map_err(|error| match error.kind() {
            // Somebody else was faster.
            io::ErrorKind::NotFound => ApiError::not_found(format!("unknown trace {name}")),
            _ => ApiError::disk(error),
        })
    }

    /// Names of all finished traces, in order.
    #[cfg(feature = "tables")]
    pub fn finished(&self) -> io::Result<Vec<String>> {
        let paths = self.host.disk.list(&self.folder)?;
        let mut names: Vec<String> = paths.iter().filter_map(|path| self.name_of(path)).collect();
        names.retain(|name| self.path(name).is_ok());
        names.sort_unstable();
        Ok(names)
    }

    /// Traces in the order of their names, from the one after `after` on.
    pub fn list(&self, after: &str, limit: usize) -> io::Result<Vec<TraceFile>> {
        let mut names: Vec<(String, bool)> = Vec::new();
        for path in self.host.disk.list(&self.folder)? {
            let name = file_name(&path);
            let (name, recording) =
                match (name.strip_suffix(".mcap"), name.strip_suffix(".mcap.part")) {
                    (Some(name), _) => (name, false),
                    (None, Some(name)) => (name, true),
                    (None, None) => continue,
                };
            if name > after && !name.starts_with('.') {
                names.push((name.to_owned(), recording));
            }
        }
        // Where a part stands beside the trace that was restored of it, the trace is what is meant.
        names.sort_unstable();
        names.dedup_by(|part, whole| part.0 == whole.0);
        let file = |(name, recording): (String, bool)| {
            let suffix = if recording { "mcap.part" } else { "mcap" };
            let path = self.folder.join(format!("{name}.{suffix}"));
            let found = self.host.disk.metadata(&path).ok()?;
            let written = u64::try_from(found.modified_ns).unwrap_or(0) / 1_000_000_000;
            Some(TraceFile {
                trace: name,
                bytes: found.bytes,
                written,
                recording,
            })
        };
        // A file that went away meanwhile is not there.
        Ok(names.into_iter().filter_map(file).take(limit).collect())
    }

    /// The recordings that were not finished.
    pub fn unfinished(&self) -> io::Result<Vec<PathBuf>> {
        let mut parts = self.host.disk.list(&self.folder)?;
        parts.retain(|path| {
            let name = file_name(path);
            name.ends_with(".mcap.part") && !name.starts_with('.')
        });
        parts.sort_unstable();
        Ok(parts)
    }

    /// A text without the way to the data folder, which is nobody's business outside.
    pub fn redact_path(&self, text: &str) -> String {
        let data = self.folder.parent().unwrap_or(Path::new(""));
        text.replace(
            &format!("{}{}", data.display(), std::path::MAIN_SEPARATOR),
            "",
        )
    }

    /// Does something with the disk where it keeps nobody waiting.
    async fn worked<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> io::Result<T> + Send + 'static,
    ) -> Result<T, ApiError> {
        let worked = self.host.work.spawn(work).await;
        worked
            .map_err(io::Error::other)
            .flatten()
            .map_err(ApiError::disk)
    }

    /// Absolute path of the folder that holds the traces.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Whether a trace or its recording has this path.
    ///
    /// # Errors
    /// When the disk does not say.
    pub fn is_taken(&self, path: &Path) -> io::Result<bool> {
        Ok(self.host.disk.exists(path)? || self.host.disk.exists(&part_of(path))?)
    }

    /// Takes a trace in, as it comes; it is there only when all of it came and it is a sound
    /// trace. Never replaces one.
    pub async fn receive<E: std::fmt::Display>(
        &self,
        name: &str,
        limit: u64,
        patience: Duration,
        mut body: impl Stream<Item = Result<Bytes, E>> + Unpin,
    ) -> Result<TraceFile, ApiError> {
        let path = self.path(name)?;
        let taken = || {
            ApiError::conflict(
                "exists",
                format!(
                    "trace {name} exists already or is being recorded, and traces are never replaced; choose another name"
                ),
            )
        };
        // The end of a recording replaces what has its name.
        if self.is_taken(&path).map_err(ApiError::disk)? {
            return Err(taken());
        }
        let (disk, prefix) = (self.host.disk.clone(), self.folder.join(format!(".{name}")));
        // Removes itself whatever happens, even where the client is gone before it was made.
        let mut upload = self.worked(move || Upload::begin(disk, &prefix)).await?;
        let (mut bytes, begun) = (0_u64, Instant::now());
        loop {
            let part = tokio::time::timeout(patience, body.next()).await;
            let part = part.map_err(|_| {
                ApiError::timeout("the upload stalled; send it again (limits.read_timeout_s)")
            })?;
            let Some(part) = part else { break };
            let part = part.map_err(|error| {
                ApiError::bad_request("broken_body", format!("the upload broke off: {error}"))
            })?;
            bytes += part.len() as u64;
            if begun.elapsed() > patience + Duration::from_secs(bytes / SLOWEST_UPLOAD) {
                return Err(ApiError::timeout(
                    "the upload is too slow; send it again (limits.read_timeout_s)",
                ));
            }
            if bytes > limit {
                return Err(ApiError::too_large(format!(
                    "a trace may have {limit} bytes (limits.upload_mib)"
                )));
            }
            let write = move || upload.file.write_all(&part).map(|()| upload);
            upload = self.worked(write).await?;
        }
        let (files, beside) = (self.files.clone(), upload.path.clone());
        let upload = self
            .worked(move || upload.file.sync().map(|()| upload))
            .await?;
        let read = beside.clone();
        let checked = self.host.work.spawn(move || files.read(&read).map(drop));
        let checked = checked.await;
        let checked = checked.map_err(|_| {
            ApiError::unprocessable(
                "bad_trace",
                "the trace reader panicked; the log has the details".to_owned(),
            )
        })?;
        if let Err(error) = checked {
            let shown = error.to_string().replace(&*beside.to_string_lossy(), name);
            return Err(ApiError::unprocessable("bad_trace", shown));
        }
        // Fails where somebody else was faster.
        let kept = self.host.work.spawn(move || upload.keep(&path)).await;
        let kept = kept.map_err(io::Error::other).flatten();
        kept.map_err(|error| match error.kind() {
            io::ErrorKind::AlreadyExists => taken(),
            _ => ApiError::disk(error),
        })?;
        let written = std::time::SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |time| time.as_secs());
        Ok(TraceFile {
            trace: name.to_owned(),
            bytes,
            written,
            recording: false,
        })
    }
}

/// What the names of uploads end with that have not ended.
const UPLOAD: &str = ".upload";

/// A file that is being taken in. It is removed when nobody needs it any more.
struct Upload {
    disk: Arc<dyn Disk>,
    path: PathBuf,
    file: Box<dyn DiskFile>,
}

impl Upload {
    /// A new file, whose name begins so.
    fn begin(disk: Arc<dyn Disk>, prefix: &Path) -> io::Result<Self> {
        static COUNT: AtomicU64 = AtomicU64::new(0);
        loop {
            let own = COUNT.fetch_add(1, Ordering::Relaxed);
            let path = prefix.with_added_extension(format!("{}-{own}{UPLOAD}", process::id()));
            match disk.create_new(&path) {
                Ok(file) => return Ok(Self { disk, path, file }),
                // Another server has it: in containers, every server may be process 1.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
    }

    /// Gives it its name, which nothing else has; both are on the disk when this returns.
    fn keep(self, path: &Path) -> io::Result<()> {
        // A recording of that name may have begun while the upload came.
        if self.disk.exists(&part_of(path))? {
            return Err(io::ErrorKind::AlreadyExists.into());
        }
        self.disk.rename_new(&self.path, path)?;
        self.disk
            .sync_folder(path.parent().unwrap_or(Path::new("")))
    }
}

impl Drop for Upload {
    fn drop(&mut self) {
        // It is not there any more where it was kept.
        let _ = self.disk.remove_file(&self.path);
    }
}

/// Where the recording of a trace lies that has not ended.
fn part_of(path: &Path) -> PathBuf {
    path.with_added_extension("part")
}

fn file_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default();
    name.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use futures_util::{FutureExt as _, stream};

    use super::*;

    #[test]
    fn an_upload_does_not_take_the_name_of_a_recording() {
        let folder = tempfile::tempdir().expect("a folder");
        let archive = Archive::open(Host::default(), folder.path().to_owned()).expect("an archive");
        std::fs::write(folder.path().join("a.mcap.part"), "").expect("a recording");
        let body = stream::empty::<Result<Bytes, Infallible>>();
        let received = archive.receive("a", 1, Duration::from_mins(1), body);
        let refused = received.now_or_never().expect("it is refused at once");
        assert!(refused.is_err(), "its end would replace the upload");
    }

    /// The server drops the handling of a request when its client goes: at its first wait, the file
    /// is just being made on another thread.
    #[test]
    fn an_upload_dropped_while_its_file_is_made_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let archive = Archive::open(Host::default(), folder.path().to_owned()).expect("an archive");
        let runtime = tokio::runtime::Runtime::new().expect("a runtime");
        runtime.block_on(async {
            for _ in 0..100 {
                let body = stream::pending::<Result<Bytes, Infallible>>();
                let received = archive.receive("a", 1, Duration::from_mins(1), body);
                assert!(received.now_or_never().is_none(), "it waits for its body");
            }
        });
        // Waits for the threads that make files.
        drop(runtime);
        let left = std::fs::read_dir(folder.path())
            .expect("the folder")
            .count();
        assert_eq!(left, 0, "files of uploads are left");
    }
}
