//! Where the runner sends the records of an episode. Never decides what is in them.

use std::{error::Error, path::PathBuf};

use reel_world::{
    Frame,
    record::{EndRecord, StartRecord, StepInput, StepRecord},
};

/// What went wrong while writing.
pub type SinkError = Box<dyn Error + Send + Sync>;

/// Path and size of a finished recording.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RecordedTrace {
    /// Path of the finished trace file.
    pub path: PathBuf,
    /// Its length in bytes.
    pub bytes: u64,
}

/// Takes the records of one episode, in order.
pub trait Sink: Send {
    /// The state after the start.
    fn start(&mut self, start: &StartRecord, frame: Option<&Frame>) -> Result<(), SinkError>;
    /// A decision, before it is used.
    fn input(&mut self, step: u32, input: &StepInput) -> Result<(), SinkError>;
    /// What came of it.
    fn step(&mut self, step: &StepRecord, frame: Option<&Frame>) -> Result<(), SinkError>;
    /// The end; none where nothing was written.
    fn end(self: Box<Self>, end: &EndRecord) -> Result<Option<RecordedTrace>, SinkError>;
}

/// A sink that discards every record and writes no trace.
#[derive(Clone, Copy, Debug)]
pub struct NoSink;

impl Sink for NoSink {
    fn start(&mut self, _: &StartRecord, _: Option<&Frame>) -> Result<(), SinkError> {
        Ok(())
    }

    fn input(&mut self, _: u32, _: &StepInput) -> Result<(), SinkError> {
        Ok(())
    }

    fn step(&mut self, _: &StepRecord, _: Option<&Frame>) -> Result<(), SinkError> {
        Ok(())
    }

    fn end(self: Box<Self>, _: &EndRecord) -> Result<Option<RecordedTrace>, SinkError> {
        Ok(None)
    }
}
