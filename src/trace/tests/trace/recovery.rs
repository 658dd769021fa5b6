//! Recordings that broke off: killed writers, cuts at every byte, flipped bytes, a full disk.
//! Whatever happened, what was acknowledged is there afterwards, in a file that reopens and
//! that other programs read.

mod cuts;
mod damage;
mod interrupted;
mod under_way;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use reel_trace::{Images, Recorder, Recovery, RecoveryStatus, Trace, TraceError, examine, recover};
use reel_world::{
    ErrorCode,
    record::{Backend, EndReason, Graphs, Metrics},
};

use crate::sample::{Sample, Source};

/// Stands for `reel_reward::metrics`, of which this crate knows nothing.
pub fn score(trace: &Trace, _: &Graphs) -> Metrics {
    Metrics {
        success: false,
        completion: 0.25,
        total_reward: trace.steps.iter().map(|step| step.reward_total()).sum(),
        discounted_return: 0.0,
        length: trace.steps.len() as u32,
        asks: 0,
        spl: None,
    }
}

fn restore(source: &Path) -> Recovery {
    recover(source, None, score).unwrap_or_else(|error| panic!("{}: {error}", source.display()))
}

fn healthy(path: &Path) {
    let found = examine(path).unwrap().findings;
    assert!(found.is_empty(), "{}: {found:?}", path.display());
}

/// Asserts that a trace holds exactly the first steps of a sample, and an end that fits.
fn assert_first_steps(trace: &Trace, sample: &Sample, steps: usize) {
    assert_eq!(trace.header, sample.header);
    assert_eq!(
        (&*trace.task, &*trace.scene, &trace.start),
        (&sample.task, &sample.scene, &sample.start)
    );
    assert_eq!(trace.steps, sample.steps[..steps]);
    let end = trace.end.as_ref().expect("a recovered trace has an end");
    if *end != sample.end {
        let error = trace.steps.last().and_then(|step| step.outcome.error);
        let horizon = trace.header.profile.horizon() as usize;
        let reason = match trace.header.backend {
            Backend::Sim if error == Some(ErrorCode::PhysicsFault) => EndReason::Fault,
            Backend::Sim if steps >= horizon => EndReason::Horizon,
            _ => EndReason::Aborted,
        };
        assert_eq!((end.reason, end.steps), (reason, steps as u32));
        assert_eq!(end.metrics, score(trace, &end.graphs));
        let mut graphs = sample.start.graphs.clone();
        trace.steps.iter().for_each(|step| {
            graphs.physics.apply(&step.changes.physics);
            graphs.registry.apply(&step.changes.registry);
        });
        assert_eq!(end.graphs, graphs);
    }
}

fn random(state: &mut u64) -> u64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    *state
}

fn files(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let paths = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut paths: Vec<PathBuf> = paths
        .filter(|path| path.extension().is_some_and(|e| e == extension))
        .collect();
    paths.sort();
    paths
}

/// A small episode, its finished bytes and those of its part, cut just before the end.
fn small() -> (Sample, Vec<u8>, Vec<u8>) {
    let sample = Source::seeded(3).sample(3);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let recorder = sample.record_open(&path, &[], Images::None).unwrap();
    let part = fs::read(folder.path().join("x.mcap.part")).unwrap();
    recorder.end(&sample.end).unwrap();
    (sample, fs::read(&path).unwrap(), part)
}

/// In memory, where there is such a folder: syncing tens of thousands of files takes minutes on a
/// disk.
fn quick_folder() -> tempfile::TempDir {
    tempfile::tempdir_in("/dev/shm")
        .or_else(|_| tempfile::tempdir())
        .unwrap()
}

const PYTHON: &str = r"
import pathlib, sys
from mcap.reader import make_reader, NonSeekingReader
count = 0
for path in sorted(pathlib.Path(sys.argv[1]).glob('*.mcap'))[::int(sys.argv[2])]:
    with open(path, 'rb') as file:
        reader = make_reader(file, validate_crcs=True)
        messages = sum(1 for _ in reader.iter_messages())
        names = [metadata.name for metadata in reader.iter_metadata()]
        assert 'reel.recovery' in names, (path, names)
        assert reader.get_summary().statistics.message_count == messages, path
        attachments = sum(1 for _ in reader.iter_attachments())
        assert attachments == (2 if 'reel.episode' in names else 0), (path, attachments)
    with open(path, 'rb') as file:
        assert sum(1 for _ in NonSeekingReader(file, validate_crcs=True).iter_messages()) == messages, path
    count += 1
print(count)
";

/// Lets the Python library read every so manieth recovered file of a folder with every checksum.
fn python_reads(folder: &Path, stride: usize) {
    let Some(python) = reel_vectors::python("mcap") else {
        return;
    };
    let mut command = Command::new(&python);
    command.args(["-c", PYTHON]).arg(folder);
    let said = reel_vectors::run(command.arg(stride.to_string()));
    let count = files(folder, "mcap").len().div_ceil(stride);
    assert_eq!(said.trim(), count.to_string());
}
