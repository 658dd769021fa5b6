//! Going to a moment of an episode: by executing it from the start, or from a snapshot in a
//! cache, with the same bits. The cache may be deleted at any time; what is damaged in it is
//! passed over and made again.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs, io,
    path::{Path, PathBuf},
};

use reel_sim::{SIM_VERSION, Snapshot, render::Detail};
use reel_trace::Trace;
use reel_world::{Digest, Frame};

use crate::{Replay, Verdict, refused};

/// A folder of snapshots, by the link of the hash chain they stand at and the simulator's version.
#[derive(Clone, Debug)]
pub struct SnapshotCache {
    folder: PathBuf,
}

impl SnapshotCache {
    /// A cache in a folder, which is made when the first snapshot comes.
    pub fn at(folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
        }
    }

    /// The snapshot after so many calls; none where it is not there or damaged.
    pub fn get(&self, trace: &Trace, calls: usize) -> Option<Snapshot> {
        let bytes = fs::read(self.path(trace, calls)?).ok()?;
        let (digest, snapshot) = bytes.split_first_chunk::<32>()?;
        (Digest::of(snapshot).0 == *digest)
            .then(|| Snapshot::from_bytes(snapshot).ok())
            .flatten()
    }

    /// Keeps the snapshot after so many calls.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put(&self, trace: &Trace, calls: usize, snapshot: &Snapshot) -> io::Result<()> {
        let Some(path) = self.path(trace, calls) else {
            return Ok(());
        };
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
        let link = link_after(trace, calls)?;
        Some(self.folder.join(format!(
            "{link}-v{SIM_VERSION}-{}.snapshot",
            env!("CARGO_PKG_VERSION")
        )))
    }
}

/// The frame after a call (none: before the first), drawn again whether or not
/// the trace holds it.
///
/// # Errors
/// Why nothing can be executed, the first difference on the way, or that there is no such call.
pub fn frame_at(
    trace: &Trace,
    call: Option<u32>,
    cache: Option<&SnapshotCache>,
) -> Result<Frame, Verdict> {
    let Some(call) = call else {
        return Replay::start(trace, Detail::Full).map(|(_, frame)| frame);
    };
    let mut replay = seek(trace, call as usize, cache)?;
    let output = replay
        .step()?
        .ok_or_else(|| no_call(trace, call as usize))?;
    let simulator = replay.episode().simulator();
    Ok(output
        .frame
        .unwrap_or_else(|| simulator.render_from(&simulator.camera())))
}

/// The images (RGB) that the agent got at these moments (none: before the first call): those that
/// the trace holds, or drawn again.
///
/// # Errors
/// Why an image cannot be had, or the first difference on the way.
pub fn frames_at(
    trace: &Trace,
    moments: &BTreeSet<Option<u32>>,
) -> Result<BTreeMap<Option<u32>, Vec<u8>>, Verdict> {
    let none = |moment: &Option<u32>| Verdict::Refused {
        reason: match moment {
            Some(call) => format!("call {call} returned no image to the agent"),
            None => "the agent got no image before the first call".into(),
        },
    };
    if trace.image_count() > 0 {
        let frame = |moment: &Option<u32>| {
            let pixels = trace.frame_rgb(*moment).map_err(|error| refused(&error))?;
            Ok((*moment, pixels.ok_or_else(|| none(moment))?))
        };
        return moments.iter().map(frame).collect();
    }
    let Some(last) = moments.last() else {
        return Ok(BTreeMap::new());
    };
    let mut found = BTreeMap::new();
    let (mut replay, start) = Replay::start(trace, Detail::Full)?;
    if moments.contains(&None) {
        found.insert(None, start.rgb);
    }
    while found.keys().next_back() < Some(last) {
        let output = replay.step()?.ok_or_else(|| none(last))?;
        let moment = Some(output.record.step);
        if let Some(frame) = output.frame.filter(|_| moments.contains(&moment)) {
            found.insert(moment, frame.rgb);
        }
    }
    match moments.iter().find(|moment| !found.contains_key(*moment)) {
        Some(moment) => Err(none(moment)),
        None => Ok(found),
    }
}

pub(crate) fn no_call(trace: &Trace, call: usize) -> Verdict {
    let count = trace.steps.len();
    Verdict::Refused {
        reason: format!("unknown call {call}: the episode has {count} calls, from 0"),
    }
}

/// Goes to the state after the first `calls` calls: from the nearest snapshot of the cache,
/// else from the start. What is executed on the way is compared with the trace; the snapshot
/// found there is kept.
///
/// # Errors
/// Why nothing can be executed, or the first difference on the way.
pub fn seek<'t>(
    trace: &'t Trace,
    calls: usize,
    cache: Option<&SnapshotCache>,
) -> Result<Replay<'t>, Verdict> {
    if calls > trace.steps.len() {
        return Err(no_call(trace, calls));
    }
    let nearest = |cache: &SnapshotCache| {
        (0..=calls)
            .rev()
            .find_map(|calls| Replay::resume(trace, calls, &cache.get(trace, calls)?).ok())
    };
    let mut replay = match cache.and_then(nearest) {
        Some(replay) => replay,
        None => Replay::start(trace, Detail::Full)?.0,
    };
    let restored = replay.calls() == calls;
    while replay.calls() < calls {
        replay.step()?;
    }
    if let (Some(cache), false) = (cache, restored) {
        // A cache that cannot be written costs time, not correctness.
        let _ = cache.put(trace, calls, &replay.episode().snapshot());
    }
    Ok(replay)
}

/// Executes an episode once, then again from a snapshot after each of the given numbers of calls to
/// its end, comparing everything with the trace. The snapshots go through their bytes. Exact only
/// if all of it is.
pub fn verify_restored(trace: &Trace, after: &[usize]) -> Verdict {
    let run = || {
        let (mut replay, _) = Replay::start(trace, Detail::Full)?;
        let mut snapshots = Vec::new();
        loop {
            if after.contains(&replay.calls()) {
                snapshots.push((replay.calls(), replay.episode().snapshot().to_bytes()));
            }
            if replay.step()?.is_none() {
                break;
            }
        }
        let exact = replay.finish(|_, _| {})?;
        for (calls, bytes) in snapshots {
            go_on(trace, calls, &bytes).map_err(|verdict| said_of_restored(verdict, calls))?;
        }
        Ok(exact)
    };
    run().unwrap_or_else(|verdict| verdict)
}

/// Replays a trace, then again from snapshots after `count` of its calls. Which calls is decided by
/// the trace's own digest, so that the same trace is always asked the same.
pub(crate) fn verify_restored_at_some(trace: &Trace, count: usize) -> Verdict {
    if let Err(error) = trace.verify_images() {
        return refused(&error);
    }
    let mut calls: Vec<usize> = (0..=trace.steps.len()).collect();
    calls.sort_by_key(|calls| Digest::of(format!("{} {calls}", trace.chain()).as_bytes()));
    calls.truncate(count);
    verify_restored(trace, &calls)
}

/// From a snapshot to the end.
fn go_on(trace: &Trace, calls: usize, snapshot: &[u8]) -> Result<Verdict, Verdict> {
    let snapshot = Snapshot::from_bytes(snapshot).map_err(|error| Verdict::Refused {
        reason: error.to_string(),
    })?;
    Replay::resume(trace, calls, &snapshot)?.finish(|_, _| {})
}

fn said_of_restored(mut verdict: Verdict, calls: usize) -> Verdict {
    let note = format!(" (restored after {calls} calls)");
    match &mut verdict {
        Verdict::Diverged { divergence } => divergence.field.push_str(&note),
        Verdict::Refused { reason } => reason.push_str(&note),
        _ => {}
    }
    verdict
}

/// The link of the hash chain after so many calls: it names the state and all that led to it.
fn link_after(trace: &Trace, calls: usize) -> Option<Digest> {
    let last = calls.checked_sub(1).map(u32::try_from).transpose();
    trace.link(last.ok()?)
}
