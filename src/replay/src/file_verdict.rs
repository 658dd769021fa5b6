//! Verdicts on files: what a replay found, and of which bytes. Whoever keeps one can tell later
//! whether a file is still the one that it was about.

use std::{
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
};

use reel_trace::{Limits, Trace, TraceFiles};
use reel_world::{Assets, Digest, NoAssets};
use serde::{Deserialize, Serialize};

use crate::{Detail, Verdict, on_workers, refused, seek, verify_trace, verify_with};

/// What the replay of a trace file found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FileVerdict {
    /// BLAKE3 of the file's bytes; none where they could not be read, or the replay panicked.
    pub file: Option<Digest>,
    /// The chain digest of the trace; none where the bytes are no sound trace.
    pub trace: Option<Digest>,
    /// Whether the episode was recorded with meshes, which must be there to execute it again.
    pub has_meshes: bool,
    /// What came of comparing every digest, text and image.
    pub verdict: Verdict,
}

impl FileVerdict {
    /// Whether it is a verdict on these bytes that holds whatever else is there next time: missing
    /// meshes refuse a trace that is sound.
    pub fn is_lasting(&self) -> bool {
        let refused = matches!(self.verdict, Verdict::Refused { .. });
        self.file.is_some() && !(refused && self.has_meshes)
    }

    /// The verdict on a file that is read once, for its digest and for its replay.
    fn of_file(files: &TraceFiles, path: &Path, verify: impl FnOnce(Trace) -> Verdict) -> Self {
        match files.bytes(path) {
            Ok(bytes) => Self::of_bytes(path, &bytes, |trace| verify(files.with_meshes(trace))),
            Err(error) => Self::without_trace(refused(&error)),
        }
    }

    /// A panic ends only this verdict, and is none that lasts.
    fn of_bytes(path: &Path, bytes: &[u8], verify: impl FnOnce(Trace) -> Verdict) -> Self {
        let file = Some(Digest::of(bytes));
        let read = || Trace::from_bytes(path, bytes, &Limits::default());
        let trace = match catch_unwind(AssertUnwindSafe(read)) {
            Ok(Ok(trace)) => trace,
            Ok(Err(error)) => {
                return Self {
                    file,
                    ..Self::without_trace(refused(&error))
                };
            }
            Err(_) => return Self::without_trace(Verdict::panicked(path)),
        };
        let (digest, has_meshes) = (Some(trace.chain()), !trace.header.meshes.is_empty());
        let verified = catch_unwind(AssertUnwindSafe(|| verify(trace)));
        Self {
            file: file.filter(|_| verified.is_ok()),
            trace: digest,
            has_meshes,
            verdict: verified.unwrap_or_else(|_| Verdict::panicked(path)),
        }
    }

    fn without_trace(verdict: Verdict) -> Self {
        Self {
            file: None,
            trace: None,
            has_meshes: false,
            verdict,
        }
    }
}

/// Replays the bytes of a trace file, drawing so much of its images; `path` says in messages where
/// they came from.
pub fn verify_bytes(files: &TraceFiles, path: &Path, bytes: &[u8], detail: Detail) -> FileVerdict {
    FileVerdict::of_bytes(path, bytes, |trace| {
        verify_with(&files.with_meshes(trace), detail)
    })
}

/// Replays a trace file with the meshes that `files` knows.
pub fn verify_file(files: &TraceFiles, path: &Path) -> FileVerdict {
    FileVerdict::of_file(files, path, |trace| verify_trace(&trace))
}

/// Replays one trace file of this machine, of primitives only.
pub fn verify(path: &Path) -> Verdict {
    verify_from(&TraceFiles::default(), path, &NoAssets).verdict
}

/// [`verify_file`], with meshes from `assets`.
pub(crate) fn verify_from(files: &TraceFiles, path: &Path, assets: &dyn Assets) -> FileVerdict {
    FileVerdict::of_file(files, path, |trace| {
        verify_trace(&trace.with_meshes(assets))
    })
}

/// Replays many trace files on so many threads; verdicts in the order of the paths.
/// Meshes come from `assets`.
pub fn verify_all<P: AsRef<Path> + Sync>(
    files: &TraceFiles,
    paths: &[P],
    assets: &dyn Assets,
    workers: usize,
    on_done: impl Fn(&Path, &Verdict) + Sync,
) -> Vec<FileVerdict> {
    on_workers(paths, workers, |path| {
        let judged = verify_from(files, path.as_ref(), assets);
        on_done(path.as_ref(), &judged.verdict);
        judged
    })
}

/// [`verify_all`], and each again from snapshots after `count` of its calls.
pub fn verify_all_from_snapshots<P: AsRef<Path> + Sync>(
    files: &TraceFiles,
    paths: &[P],
    assets: &dyn Assets,
    workers: usize,
    count: usize,
    on_done: impl Fn(&Path, &Verdict) + Sync,
) -> Vec<FileVerdict> {
    on_workers(paths, workers, |path| {
        let judged = FileVerdict::of_file(files, path.as_ref(), |trace| {
            seek::verify_restored_at_some(&trace.with_meshes(assets), count)
        });
        on_done(path.as_ref(), &judged.verdict);
        judged
    })
}

/// [`verify_with`], where a panic ends only its own verdict.
pub fn verify_catching_panics(trace: &Trace, detail: Detail) -> Verdict {
    catch_unwind(AssertUnwindSafe(|| verify_with(trace, detail)))
        .unwrap_or_else(|_| Verdict::panicked(&trace.path))
}
