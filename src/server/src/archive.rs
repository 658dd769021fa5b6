//! The folder of traces as clients see it: names, never paths.

use std::{
    fs, io,
    path::{Path, PathBuf},
    time::{Duration, Instant, UNIX_EPOCH},
};

use axum::body::Bytes;
use futures_util::{Stream, StreamExt as _};
use reel_trace::Trace;
use serde::Serialize;
use tempfile::NamedTempFile;
use tokio::io::AsyncWriteExt as _;
use utoipa::ToSchema;

use crate::rest::ApiError;

/// Bytes a second that an upload must come with, its first moments apart.
const SLOWEST_UPLOAD: u64 = 16 << 10;

/// The folder of traces.
#[derive(Clone, Debug)]
pub(crate) struct Archive {
    folder: PathBuf,
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
    pub fn open(folder: PathBuf) -> io::Result<Self> {
        fs::create_dir_all(&folder)?;
        // Paths in tables are absolute, and a change of the working directory changes nothing.
        Ok(Self {
            folder: folder.canonicalize()?,
        })
    }

    /// Removes what a killed server was taking in.
    pub fn sweep(&self) {
        for entry in fs::read_dir(&self.folder).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.starts_with('.') && name.ends_with(".upload") {
                let _ = fs::remove_file(entry.path());
            }
        }
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
        if path.is_file() {
            return Ok(path);
        }
        if path.with_added_extension("part").is_file() {
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
        Trace::read(&path).map_err(|error| ApiError::unprocessable("bad_trace", error.to_string()))
    }

    /// Traces in the order of their names, from the one after `after` on.
    pub fn list(&self, after: &str, limit: usize) -> io::Result<Vec<TraceFile>> {
        let mut names: Vec<(String, bool)> = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let Ok(name) = entry?.file_name().into_string() else {
                continue;
            };
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
            let found = fs::metadata(self.folder.join(format!("{name}.{suffix}"))).ok()?;
            let written = found
                .modified()
                .ok()?
                .duration_since(UNIX_EPOCH)
                .map_or(0, |time| time.as_secs());
            Some(TraceFile {
                trace: name,
                bytes: found.len(),
                written,
                recording,
            })
        };
        // A file that went away meanwhile is not there.
        Ok(names.into_iter().filter_map(file).take(limit).collect())
    }

    /// The recordings that were not finished.
    pub fn unfinished(&self) -> io::Result<Vec<PathBuf>> {
        let mut parts = Vec::new();
        for entry in fs::read_dir(&self.folder)? {
            let path = entry?.path();
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            if name.ends_with(".mcap.part") && !name.starts_with('.') {
                parts.push(path);
            }
        }
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

    /// Absolute path of the folder that holds the traces.
    pub fn folder(&self) -> &Path {
        &self.folder
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
                    "trace {name} exists already, and traces are never replaced; choose another name"
                ),
            )
        };
        if path.exists() {
            return Err(taken());
        }
        let beside = {
            let (folder, prefix) = (self.folder.clone(), format!(".{name}."));
            tokio::task::spawn_blocking(move || half_taken(&folder, &prefix)).await
        };
        // Removes itself whatever happens, even where the client is gone before it was made.
        let beside = beside
            .map_err(io::Error::other)
            .flatten()
            .map_err(ApiError::disk)?;
        let file = beside.as_file().try_clone().map_err(ApiError::disk)?;
        let mut file = tokio::fs::File::from_std(file);
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
            file.write_all(&part).await.map_err(ApiError::disk)?;
        }
        file.sync_all().await.map_err(ApiError::disk)?;
        drop(file);
        let checked = {
            let beside = beside.path().to_owned();
            tokio::task::spawn_blocking(move || Trace::read(&beside).map(drop)).await
        };
        let checked = checked.map_err(|_| {
            ApiError::unprocessable(
                "bad_trace",
                "the trace reader panicked; the log has the details".to_owned(),
            )
        })?;
        if let Err(error) = checked {
            let shown = error
                .to_string()
                .replace(&*beside.path().to_string_lossy(), name);
            return Err(ApiError::unprocessable("bad_trace", shown));
        }
        // Fails where somebody else was faster, which a rename would not.
        let kept = beside.persist_noclobber(&path);
        kept.map_err(|lost| match lost.error.kind() {
            io::ErrorKind::AlreadyExists => taken(),
            _ => ApiError::disk(lost.error),
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

/// A new file for an upload that has not ended, readable by whom finished traces are readable by.
fn half_taken(folder: &Path, prefix: &str) -> io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(prefix).suffix(".upload");
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder)
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use futures_util::{FutureExt as _, stream};

    use super::*;

    /// The server drops the handling of a request when its client goes: at its first wait, the file
    /// is just being made on another thread.
    #[test]
    fn an_upload_dropped_while_its_file_is_made_leaves_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let archive = Archive::open(folder.path().to_owned()).expect("an archive");
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
        let left = fs::read_dir(folder.path()).expect("the folder").count();
        assert_eq!(left, 0, "files of uploads are left");
    }
}
