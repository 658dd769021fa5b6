//! Records episodes as traces. The only file here that knows the trace crate.

use std::path::{Path, PathBuf};

use reel_trace::{RecordOptions, Recorder};
use reel_world::{
    Frame, Scene, Task,
    record::{EndRecord, EpisodeHeader, StartRecord, StepInput, StepRecord},
};

use crate::sink::{RecordedTrace, Sink, SinkError};

/// Where and how to record an episode.
#[derive(Clone, Debug)]
pub struct RecordTo {
    /// The trace to write.
    pub path: PathBuf,
    /// Whether images are stored or made again on replay, and what a recorded call survives.
    pub options: RecordOptions,
}

/// A sink that records the episode as a trace file.
pub struct TraceSink {
    recorder: Recorder,
}

impl TraceSink {
    /// Creates the trace and writes its header.
    pub fn create(
        path: &Path,
        options: RecordOptions,
        header: &EpisodeHeader,
        task: &Task,
        scene: &Scene,
    ) -> Result<Self, SinkError> {
        Ok(Self {
            recorder: Recorder::create(path, header, task, scene, options)?,
        })
    }
}

impl Sink for TraceSink {
    fn start(&mut self, start: &StartRecord, frame: Option<&Frame>) -> Result<(), SinkError> {
        Ok(self.recorder.start(start, frame)?)
    }

    fn input(&mut self, step: u32, input: &StepInput) -> Result<(), SinkError> {
        Ok(self.recorder.input(step, input)?)
    }

    fn step(&mut self, step: &StepRecord, frame: Option<&Frame>) -> Result<(), SinkError> {
        Ok(self.recorder.step(step, frame)?)
    }

    fn end(self: Box<Self>, end: &EndRecord) -> Result<Option<RecordedTrace>, SinkError> {
        let summary = self.recorder.end(end)?;
        Ok(Some(RecordedTrace {
            path: summary.path,
            bytes: summary.bytes,
        }))
    }
}
