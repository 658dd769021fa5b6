//! Going to a moment of an episode: by executing it from the start, or from a snapshot in a cache, with the same bits.
//! The cache may be deleted at any time; what is damaged in it is passed over and made again.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use reel_sim::{SIM_VERSION, Snapshot, render::Detail};
use reel_trace::Trace;
use reel_world::Digest;

use crate::{Replay, Verdict, player, verify};

/// A folder of snapshots, by the link of the hash chain they stand at and the simulator's version.
#[derive(Clone, Debug)]
pub struct SnapshotCache {
    folder: PathBuf,
}

impl SnapshotCache {
    /// A cache in a folder, which is made when the first snapshot comes.
    pub fn at(folder: &Path) -> Self {
        Self { folder: folder.to_owned() }
    }

    /// The snapshot after so many calls; none where it is not there or damaged.
    pub fn get(&self, trace: &Trace, calls: usize) -> Option<Snapshot> {
        let bytes = fs::read(self.path(trace, calls)?).ok()?;
        let (digest, snapshot) = bytes.split_first_chunk::<32>()?;
        (Digest::of(snapshot).0 == *digest).then(|| Snapshot::from_bytes(snapshot).ok()).flatten()
    }

    /// Keeps the snapshot after so many calls.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put(&self, trace: &Trace, calls: usize, snapshot: &Snapshot) -> io::Result<()> {
        let Some(path) = self.path(trace, calls) else { return Ok(()) };
        let bytes = snapshot.to_bytes();
        let mut framed = Digest::of(&bytes).0.to_vec();
        framed.extend(bytes);
        fs::create_dir_all(&self.folder)?;
        // Under a name of its own first: another process may write the same.
        let temporary = path.with_extension(format!("{}.tmp", std::process::id()));
        fs::write(&temporary, framed)?;
        fs::rename(&temporary, &path)
    }

    fn path(&self, trace: &Trace, calls: usize) -> Option<PathBuf> {
        let link = player::link_after(trace, calls)?;
        Some(self.folder.join(format!("{link}-v{SIM_VERSION}-{}.snapshot", env!("CARGO_PKG_VERSION"))))
    }
}

/// Goes to the state after the first `calls` calls: from the nearest snapshot of the cache, else from the start. What is
/// executed on the way is compared with the trace; the snapshot found there is kept.
///
/// # Errors
/// Why nothing can be executed, or the first difference on the way.
pub fn seek<'t>(trace: &'t Trace, calls: usize, cache: Option<&SnapshotCache>) -> Result<Replay<'t>, Verdict> {
    if calls > trace.steps.len() {
        let count = trace.steps.len();
        return Err(Verdict::Refused { reason: format!("there is no call {calls}: the episode has {count} calls, from 0") });
    }
    let nearest =
        |cache: &SnapshotCache| (0..=calls).rev().find_map(|calls| Replay::resume(trace, calls, &cache.get(trace, calls)?).ok());
    let mut replay = match cache.and_then(nearest) {
        Some(replay) => replay,
        None => Replay::start(trace, Detail::Picture)?.0,
    };
    let restored = replay.calls() == calls;
    while replay.calls() < calls {
        replay.step().map_err(|differing| Verdict::Diverged { divergence: differing.divergence })?;
    }
    if let (Some(cache), false) = (cache, restored) {
        // A cache that cannot be written costs time, not correctness.
        let _ = cache.put(trace, calls, &replay.episode().snapshot());
    }
    Ok(replay)
}

/// Executes an episode once, then again from a snapshot after each of the given numbers of calls to its end, comparing
/// everything with the trace. The snapshots go through their bytes.
///
/// # Errors
/// The first difference, or why nothing can be executed; with the number of calls it was restored after.
pub fn verify_restored(trace: &Trace, after: &[usize]) -> Result<(), (Option<usize>, Verdict)> {
    let (mut replay, _) = Replay::start(trace, Detail::Picture).map_err(|verdict| (None, verdict))?;
    let mut snapshots = Vec::new();
    loop {
        if after.contains(&replay.calls()) {
            snapshots.push((replay.calls(), replay.episode().snapshot().to_bytes()));
        }
        match replay.step() {
            Ok(Some(_)) => {}
            Ok(None) => break,
            Err(differing) => return Err((None, Verdict::Diverged { divergence: differing.divergence })),
        }
    }
    for (calls, bytes) in snapshots {
        let snapshot =
            Snapshot::from_bytes(&bytes).map_err(|error| (Some(calls), Verdict::Refused { reason: error.to_string() }))?;
        let resumed = Replay::resume(trace, calls, &snapshot).and_then(|replay| replay.finish(|_, _| {}));
        resumed.map_err(|verdict| (Some(calls), verdict))?;
    }
    Ok(())
}

/// Replays a trace, then again from snapshots after `count` of its calls. Which calls is decided by the trace's own
/// digest, so that the same trace is always asked the same.
pub(crate) fn verify_restored_at_some(path: &Path, count: usize) -> Verdict {
    let verdict = verify(path);
    if !verdict.is_exact() {
        return verdict;
    }
    let trace = match Trace::read(path) {
        Ok(trace) => trace,
        Err(error) => return Verdict::Refused { reason: error.to_string() },
    };
    let mut calls: Vec<usize> = (0..=trace.steps.len()).collect();
    let name = |calls: &usize| Digest::of(format!("{} {calls}", trace.start.digests.chain).as_bytes());
    calls.sort_by_key(name);
    calls.truncate(count);
    match verify_restored(&trace, &calls) {
        Ok(()) => verdict,
        Err((Some(calls), Verdict::Diverged { mut divergence })) => {
            divergence.field.push_str(&format!(" (restored after {calls} calls)"));
            Verdict::Diverged { divergence }
        }
        Err((_, verdict)) => verdict,
    }
}
