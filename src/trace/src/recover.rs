//! Saving what an unfinished, torn or damaged recording holds: its whole steps, in a finished trace
//! that says in a metadata record where it came from. Never changes the recording; deletes it only
//! when all of it is in the trace.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::TryLockError,
    io::Cursor,
    path::{Path, PathBuf},
};

use reel_world::{
    ErrorCode, Outcome, Tool, canonical_json,
    record::{
        Backend, EndReason, EndRecord, GraphChanges, Graphs, Metrics, Reported, RewardTerm,
        StateDigests, StepInput, StepRecord,
    },
};
use serde::Serialize;

use crate::{
    Disk, DiskFile, FrameLayers, Images, Trace, TraceError, TraceFiles,
    chain::Covered,
    container,
    error::position,
    files::{self, PART},
    journal::Journal,
    limits::Limits,
    reader::{Loaded, load},
    rewrite::Encoding,
    sensors::{SensorChannel, SensorKind},
};

/// What became of a recording.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RecoveryStatus {
    /// It is a whole trace; there was nothing to do.
    NotNeeded,
    /// A trace with its whole steps was written.
    Written,
    /// A whole trace that holds its steps was there already.
    Before,
    /// Not even a start could be read; a file was written that says so.
    Nothing,
}

/// What was found and done.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Recovery {
    /// Path of the recording that was to be recovered.
    pub source: PathBuf,
    /// What became of it.
    pub restored: RecoveryStatus,
    /// The whole trace, or the file that says that there is none.
    pub trace: PathBuf,
    /// How many steps it was possible to read.
    pub steps: u32,
    /// Whether the end was recorded; where not, the trace ends as aborted.
    pub end_recorded: bool,
    /// Size of the recording.
    pub bytes: u64,
    /// Where the first thing that is wrong stands; the size, where nothing is.
    pub bytes_readable: u64,
    /// Everything that is wrong with the recording, in the order of the file.
    pub problems: Vec<String>,
    /// What was recorded and could not be restored; empty where all of it was.
    pub lost: Vec<String>,
    /// Whether the trace says so already, because an earlier recovery of this recording wrote it.
    pub reported: bool,
    /// Whether the recording was deleted, because the trace holds all of it.
    pub source_deleted: bool,
}

/// Scores what is restored; a trace knows no rewards.
pub trait RestoreScorer {
    /// The metrics of an episode that ended here, with these graphs.
    fn metrics(&self, trace: &Trace, graphs: &Graphs) -> Metrics;

    /// The reward terms of one more step. None, the default: calls under way are not restored.
    fn terms(&self, _trace: &Trace, _step: &StepRecord) -> Option<Vec<RewardTerm>> {
        None
    }
}

impl<F: Fn(&Trace, &Graphs) -> Metrics> RestoreScorer for F {
    fn metrics(&self, trace: &Trace, graphs: &Graphs) -> Metrics {
        self(trace, graphs)
    }
}

/// Restores every whole step of a recording: an unfinished `.part`, or a finished trace that
/// is torn or damaged.
///
/// Writes `<name>.mcap` for `<name>.mcap.part` and `<name>.recovered.mcap` where that is taken or
/// the recording is a trace itself; with `folder`, there instead of beside the recording. A file
/// that is in place is never replaced: if it is a whole trace with all these steps, nothing is left
/// to do. The recording is deleted only if it is a part, nothing of it was lost, and no folder was
/// given. Without a recorded end the trace ends as its last step ended it, else as
/// [`EndReason::Aborted`], with the graphs that follow from the steps, and `score` gives its
/// metrics from the trace so far and these graphs.
///
/// A call that was under way did nothing in our simulator. Where the world is another one, it was
/// passed on before the recording broke off: it is restored as a step that failed, its result not
/// known, if `score` gives the terms of one.
///
/// # Errors
/// When the recording cannot be read at all, is still being written, other files take both names,
/// or the disk refuses.
pub fn recover(
    source: &Path,
    folder: Option<&Path>,
    score: impl RestoreScorer,
) -> Result<Recovery, TraceError> {
    recover_on(&TraceFiles::default(), source, folder, score)
}

/// [`recover()`] on the disk of these files.
///
/// # Errors
/// As [`recover()`].
pub fn recover_on(
    files: &TraceFiles,
    source: &Path,
    folder: Option<&Path>,
    score: impl RestoreScorer,
) -> Result<Recovery, TraceError> {
    let disk = &**files.disk();
    let is_part = source
        .extension()
        .is_some_and(|extension| *extension == *PART.trim_start_matches('.'));
    let limits = Limits::default();
    let bytes = files::read(files, source, &limits)?;
    // Held until the recording may have been deleted.
    let _lock = if is_part {
        Some(lock(disk, source)?)
    } else {
        None
    };
    let name = PathBuf::from(source.file_name().unwrap_or(source.as_os_str()));
    let Loaded {
        mut trace,
        head,
        under_way,
        problems,
        ..
    } = load(&name, &bytes, &limits);
    let completed = match (&mut trace, &under_way) {
        (Ok(trace), Some((_, input))) if is_part => complete(trace, input, &score),
        _ => false,
    };
    let nothing_there = matches!(&trace, Err(TraceError::NothingRestored { .. }));

    let mut recovery = Recovery {
        source: source.to_owned(),
        restored: RecoveryStatus::NotNeeded,
        trace: source.to_owned(),
        steps: trace.as_ref().map_or(0, |trace| trace.steps.len() as u32),
        end_recorded: trace.as_ref().is_ok_and(|trace| trace.end.is_some()),
        bytes: bytes.len() as u64,
        bytes_readable: problems
            .first()
            .and_then(|problem| problem.error.offset())
            .unwrap_or(bytes.len() as u64),
        problems: problems
            .iter()
            .map(|problem| problem.error.to_string())
            .collect(),
        lost: Vec::new(),
        reported: false,
        source_deleted: false,
    };
    if problems.is_empty() && (recovery.end_recorded && !is_part || nothing_there) {
        return Ok(recovery);
    }
    if let Some(first) = problems
        .first()
        .filter(|_| !recovery.end_recorded && !completed)
    {
        recovery.lost.push(match (&first.error, under_way) {
            (TraceError::Torn { .. }, Some((step, input))) => {
                format!("call {step} `{}` was under way and is lost", input.call)
            }
            (error, _) => {
                let rest = recovery.bytes.saturating_sub(recovery.bytes_readable);
                format!("the last {rest} bytes hold nothing whole: {error}")
            }
        });
        if !is_part {
            recovery
                .lost
                .push("how many calls came after that is not known".to_owned());
        }
    }
    let spoilt = trace.as_ref().map(spoilt_images).unwrap_or_default();
    recovery.lost.extend(spoilt.values().cloned());

    let rendered = |recovery: &Recovery, path: &Path| match &trace {
        Ok(trace) => restored(
            trace,
            recovery,
            path,
            &spoilt.keys().copied().collect(),
            score,
        ),
        Err(_) => match &head {
            Some((header, task, scene)) => {
                let recoveries = [metadata(recovery)];
                let journal = Journal::create(
                    Cursor::new(Vec::new()),
                    path,
                    (header, task, scene),
                    (Images::None, FrameLayers::default()),
                    &recoveries,
                    Covered::Messages,
                )?;
                container::finish(&journal.into_inner().into_inner(), path, &limits)
            }
            None => container::only_metadata(crate::journal::RECOVERY_METADATA, metadata(recovery)),
        },
    };
    let (path, there) = target(files, source, folder, is_part, trace.as_ref().ok())?;
    recovery.trace = path;
    if there {
        recovery.restored = RecoveryStatus::Before;
        recovery.reported = !recovery.lost.is_empty() && tells(files, &recovery);
    } else {
        recovery.restored = if trace.is_ok() {
            RecoveryStatus::Written
        } else {
            RecoveryStatus::Nothing
        };
        let bytes = rendered(&recovery, &recovery.trace)?;
        // What does not read is not written.
        match Trace::from_bytes(&recovery.trace, &bytes, &limits) {
            Ok(_) => {}
            Err(TraceError::NothingRestored { .. }) if trace.is_err() => {}
            Err(error) => return Err(error),
        }
        let failed = |source| TraceError::Io {
            action: "write",
            path: recovery.trace.clone(),
            source,
        };
        files::publish_new(disk, &recovery.trace, &bytes).map_err(failed)?;
    }
    if is_part && folder.is_none() && recovery.lost.is_empty() {
        disk.remove_file(source).map_err(|error| TraceError::Io {
            action: "delete",
            path: source.to_owned(),
            source: error,
        })?;
        recovery.source_deleted = true;
    }
    Ok(recovery)
}

/// The finished trace of the whole steps.
fn restored(
    trace: &Trace,
    recovery: &Recovery,
    path: &Path,
    spoilt: &BTreeSet<Option<u32>>,
    score: impl RestoreScorer,
) -> Result<Vec<u8>, TraceError> {
    let end = trace.end.clone().unwrap_or_else(|| aborted(trace, score));
    let recoveries: Vec<_> = trace
        .recoveries
        .iter()
        .cloned()
        .chain([metadata(recovery)])
        .collect();
    let mut kept = trace.clone();
    for step in spoilt {
        // As its image below.
        kept.depths.remove(step);
        kept.masks.remove(step);
    }
    let trace = &kept;
    let is_camera = |channel: &SensorChannel| channel.kind == SensorKind::Camera;
    let images =
        if trace.image_count() + trace.originals.len() > 0 || trace.sensors.iter().any(is_camera) {
            Images::Full
        } else {
            Images::None
        };
    trace
        .rendered(path, (images, trace.layers()), &recoveries, &end, |step| {
            Ok(trace
                .image(step)
                .filter(|_| !spoilt.contains(&step))
                .map(|webp| Encoding::Webp(webp.to_vec())))
        })
        .map(|(bytes, _)| bytes)
}

/// Adds the call that was under way in a world that is not ours.
fn complete(trace: &mut Trace, input: &StepInput, score: &impl RestoreScorer) -> bool {
    if trace.header.backend == Backend::Sim || trace.end.is_some() {
        return false;
    }
    let (last, step) = (trace.steps.last(), trace.steps.len() as u32);
    let mut record = StepRecord {
        step,
        input: input.clone(),
        outcome: Outcome::error(
            ErrorCode::BackendError,
            "no result: the recording broke off before it was written",
        ),
        tool: Tool::parse(&input.call)
            .ok()
            .map(|tool| tool.paper_name().to_owned()),
        reply: None,
        markers: last.map(|last| last.markers.clone()).unwrap_or_default(),
        visible: Vec::new(),
        listed: Vec::new(),
        object: None,
        receptacle: None,
        held: last.and_then(|last| last.held.clone()),
        changes: GraphChanges::default(),
        bodies: Vec::new(),
        robot: last.map_or(trace.start.robot, |last| last.robot),
        sim_step: last.map_or(0, |last| last.sim_step),
        reward: Vec::new(),
        digests: StateDigests::default(),
    };
    let Some(terms) = score.terms(trace, &record) else {
        return false;
    };
    record.reward = terms;
    trace.steps.push(record);
    trace.offsets.push(trace.bytes);
    true
}

/// The end of an episode that nobody ended.
fn aborted(trace: &Trace, score: impl RestoreScorer) -> EndRecord {
    let mut graphs = trace.start.graphs.clone();
    for step in &trace.steps {
        graphs.physics.apply(&step.changes.physics);
        graphs.registry.apply(&step.changes.registry);
    }
    let metrics = score.metrics(trace, &graphs);
    EndRecord {
        reason: ended(trace).unwrap_or(EndReason::Aborted),
        metrics,
        steps: trace.steps.len() as u32,
        graphs,
        reported: Reported::default(),
    }
}

/// Why the last step ended the episode, if it did: in our simulator that follows from the records,
/// and a replay comes to the same.
fn ended(trace: &Trace) -> Option<EndReason> {
    let last = trace.steps.last()?;
    (trace.header.backend == Backend::Sim)
        .then(|| last.end_reason(trace.header.profile))
        .flatten()
}

/// The frames of which something is not what was recorded, and why; all of such a frame is dropped.
fn spoilt_images(trace: &Trace) -> BTreeMap<Option<u32>, String> {
    let steps = std::iter::once(None).chain((0..trace.steps.len()).map(|step| Some(step as u32)));
    let refused = steps.filter_map(|step| Some((step, trace.verify_frame(step).err()?)));
    refused
        .map(|(step, error)| {
            (
                step,
                format!("the image of {} is dropped: {error}", position(step)),
            )
        })
        .collect()
}

/// What the recovered file says of its past.
fn metadata(recovery: &Recovery) -> BTreeMap<String, String> {
    let name = recovery
        .source
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    let end = match (recovery.restored, recovery.end_recorded) {
        (RecoveryStatus::Nothing, _) => "none",
        (_, true) => "recorded",
        (_, false) => "aborted",
    };
    let fields = [
        ("source", name),
        ("source_bytes", recovery.bytes.to_string()),
        ("bytes_readable", recovery.bytes_readable.to_string()),
        ("steps_restored", recovery.steps.to_string()),
        ("end", end.to_owned()),
        ("problems", recovery.problems.join("\n")),
        ("lost", recovery.lost.join("\n")),
    ];
    fields
        .into_iter()
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}

/// Where the trace goes, and whether a file is there that already holds all of it.
fn target(
    files: &TraceFiles,
    source: &Path,
    folder: Option<&Path>,
    is_part: bool,
    trace: Option<&Trace>,
) -> Result<(PathBuf, bool), TraceError> {
    let finished = if is_part {
        source.with_extension("")
    } else {
        source.to_owned()
    };
    let finished = match (folder, finished.file_name()) {
        (Some(folder), Some(name)) => folder.join(name),
        _ => finished,
    };
    let second = finished.with_extension("recovered.mcap");
    for path in [&finished, &second] {
        if path == source {
            continue;
        }
        let exists = files.disk().exists(path).map_err(|source| TraceError::Io {
            action: "look for",
            path: path.clone(),
            source,
        })?;
        if !exists {
            return Ok((path.clone(), false));
        }
        if holds(files, path, trace) {
            return Ok((path.clone(), true));
        }
    }
    Err(TraceError::TargetExists {
        of: source.to_owned(),
        path: second,
    })
}

/// Whether a file is whole and holds everything that could be read of a recording.
fn holds(files: &TraceFiles, path: &Path, recording: Option<&Trace>) -> bool {
    let Some(recording) = recording else {
        // Where nothing was read, a file that says so is as good as any whole trace.
        return matches!(
            files.read(path),
            Ok(_) | Err(TraceError::NothingRestored { .. })
        );
    };
    let Ok(whole) = files.read(path) else {
        return false;
    };
    let steps = whole.steps.get(..recording.steps.len());
    let records = steps.is_some_and(|steps| {
        canonical_json(&(&whole.header, &whole.start, steps))
            == canonical_json(&(&recording.header, &recording.start, &recording.steps))
    });
    let end = recording.end.is_none() || recording.end == whole.end;
    let read = recording.robot.before(recording.steps.len() as u32);
    let robot = whole.robot.before(recording.steps.len() as u32) == read;
    let sensors = recording.sensors.iter().all(|channel| {
        let there = |other: &SensorChannel| {
            other.topic == channel.topic && other.messages.len() >= channel.messages.len()
        };
        whole.sensors.iter().any(there)
    });
    records
        && end
        && robot
        && sensors
        && recording
            .images
            .keys()
            .all(|step| whole.images.contains_key(step))
        && recording
            .depths
            .keys()
            .all(|step| whole.depths.contains_key(step))
        && recording
            .masks
            .keys()
            .all(|step| whole.masks.contains_key(step))
        && recording
            .originals
            .keys()
            .all(|step| whole.originals.contains_key(step))
}

/// Whether the trace of an earlier recovery says what is lost of this recording.
fn tells(files: &TraceFiles, recovery: &Recovery) -> bool {
    let lost = recovery.lost.join("\n");
    match files.read(&recovery.trace) {
        Ok(trace) => trace
            .recoveries
            .iter()
            .any(|before| before.get("lost") == Some(&lost)),
        Err(TraceError::NothingRestored { lost: before, .. }) => before == lost,
        Err(_) => false,
    }
}

/// Keeps a recorder out, or says that there is one.
fn lock(disk: &dyn Disk, part: &Path) -> Result<Box<dyn DiskFile>, TraceError> {
    let file = disk.open(part).map_err(|source| TraceError::Io {
        action: "read",
        path: part.to_owned(),
        source,
    })?;
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Err(TraceError::InUse {
            part: part.to_owned(),
        }),
        // Where there are no locks, nobody can be asked.
        Ok(()) | Err(TryLockError::Error(_)) => Ok(file),
    }
}
