//! Writing a trace: inputs before they are used, records as they come, the finished
//! file at the end.

use std::{
    collections::BTreeMap,
    io::{self, BufWriter},
    path::{Path, PathBuf},
    sync::Arc,
};

use reel_world::{
    Digest, Frame, Scene, Task,
    record::{EndRecord, EpisodeHeader, StartRecord, StepInput, StepRecord},
};
use serde::Serialize;

use crate::{
    AnsweredRequest, Disk, DiskFile, LocalDisk, TraceError, TraceFiles,
    chain::Covered,
    container,
    files::{self, PART},
    journal::{FrameSource, Journal, Layers},
    limits::Limits,
    robot::{Alignment, CameraImage, Odometry, PrimitiveOutcome, RobotLog, VlaLatency},
    sensors::SensorChannel,
};

/// Whether images are stored.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Images {
    /// Stores every image, encoded without loss.
    #[default]
    Full,
    /// None: only the simulator version of the header can draw them again.
    None,
}

/// What is stored of a frame besides its image, on request: without loss, and readable in Foxglove.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct FrameLayers {
    /// Depth along the optical axis, 16 bits, in millimetres; 0 is nothing.
    pub depth: bool,
    /// Instance ids, 16 bits ([`reel_world::instances`]); 0 is nothing.
    pub masks: bool,
}

impl FrameLayers {
    /// Reads names with commas between them: `depth`, `masks`; none of them is nothing.
    ///
    /// # Errors
    /// The first word that is no layer.
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut layers = Self::default();
        if text.is_empty() {
            return Ok(layers);
        }
        for name in text.split(',') {
            match name.trim() {
                "depth" => layers.depth = true,
                "masks" => layers.masks = true,
                other => return Err(format!("there are depth and masks, not '{other}'")),
            }
        }
        Ok(layers)
    }

    /// Whether any is stored.
    pub fn any(self) -> bool {
        self.depth || self.masks
    }
}

/// What an acknowledged call survives. `docs/durability.md` says what each costs.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Durability {
    /// The death of the process: what a call wrote has reached the operating
    /// system when it returns.
    #[default]
    Write,
    /// The loss of power too: what a call wrote is on the disk when it returns, as far as
    /// the disk is honest.
    Fsync,
}

impl Durability {
    /// As it stands on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Durability::Write => "write",
            Durability::Fsync => "fsync",
        }
    }

    /// Reads what [`Durability::name`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        [Durability::Write, Durability::Fsync]
            .into_iter()
            .find(|durability| durability.name() == text)
    }
}

/// How to record. From [`Images`] alone: with [`Durability::Write`].
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct RecordOptions {
    /// Whether images are stored.
    pub images: Images,
    /// What is stored of each frame besides.
    pub layers: FrameLayers,
    /// What an acknowledged call survives.
    pub durability: Durability,
}

impl From<Images> for RecordOptions {
    fn from(images: Images) -> Self {
        Self {
            images,
            ..Self::default()
        }
    }
}

/// The clock of a step that was carried out elsewhere; outside every digest.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub struct Timing {
    /// When the call came, in nanoseconds since 1970.
    pub called_unix_ns: u64,
    /// From passing the call on to having its result whole, in nanoseconds.
    pub took_ns: u64,
}

/// Path, size and chain digest of a trace that was written.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TraceSummary {
    /// Path of the finished trace file.
    pub path: PathBuf,
    /// Size of the finished file, in bytes.
    pub bytes: u64,
    /// The last link of its hash chain.
    pub chain: Digest,
}

/// Records one episode. Calls come in the order `start`, then `input` and `step` for
/// each step, then `end`.
///
/// A call that returned is acknowledged: what it wrote survives what [`Durability`] says. A
/// recorder dropped before `end` leaves `<path>.part`, which [`Trace::read`](crate::Trace::read)
/// opens and [`recover`](crate::recover()) turns into a finished trace. While it lives it holds a
/// lock on the part, so that nobody recovers it meanwhile.
pub struct Recorder {
    disk: Arc<dyn Disk>,
    path: PathBuf,
    part: PathBuf,
    durability: Durability,
    journal: Journal<BufWriter<Box<dyn DiskFile>>>,
    /// The same file as the journal's.
    file: Box<dyn DiskFile>,
    /// How many steps are acknowledged; none before the start.
    acknowledged: Option<u32>,
}

impl Recorder {
    /// Opens `<path>.part` and writes the inputs that are known before the first call.
    ///
    /// # Errors
    /// When an unfinished recording is in the way, the file cannot be written, or task or scene are
    /// not the ones the header names. No part stays then.
    pub fn create(
        path: &Path,
        header: &EpisodeHeader,
        task: &Task,
        scene: &Scene,
        options: impl Into<RecordOptions>,
    ) -> Result<Recorder, TraceError> {
        Self::create_on(Arc::new(LocalDisk), path, (header, task, scene), options)
    }

    /// [`Recorder::create`] on a certain disk.
    ///
    /// # Errors
    /// As [`Recorder::create`].
    pub fn create_on(
        disk: Arc<dyn Disk>,
        path: &Path,
        (header, task, scene): (&EpisodeHeader, &Task, &Scene),
        options: impl Into<RecordOptions>,
    ) -> Result<Recorder, TraceError> {
        let RecordOptions {
            images,
            layers,
            durability,
        } = options.into();
        let part = files::with_suffix(path, PART);
        let failed = |source: io::Error| match source.kind() {
            io::ErrorKind::AlreadyExists => TraceError::PartExists { part: part.clone() },
            _ => TraceError::Io {
                action: "create",
                path: part.clone(),
                source,
            },
        };
        let file = disk.create_new(&part).map_err(failed)?;
        let begin = || {
            // Where there are no locks there is nobody to keep out either.
            let _ = file.try_lock();
            let sink = BufWriter::with_capacity(1 << 18, file.try_clone().map_err(failed)?);
            let journal = Journal::create(
                sink,
                &part,
                (header, task, scene),
                (images, layers),
                &[],
                Covered::Messages,
            )?;
            if durability == Durability::Fsync {
                file.sync()
                    .and_then(|()| files::sync_folder(&*disk, &part))
                    .map_err(failed)?;
            }
            Ok(journal)
        };
        match begin() {
            Ok(journal) => Ok(Recorder {
                disk,
                path: path.to_owned(),
                part,
                durability,
                journal,
                file,
                acknowledged: None,
            }),
            Err(error) => {
                let _ = disk.remove_file(&part);
                Err(error)
            }
        }
    }

    /// Records the state after settling.
    ///
    /// # Errors
    /// When it is called out of turn, the record's chain digest is not the header's and its own, or
    /// the file cannot be written.
    pub fn start(&mut self, record: &StartRecord, frame: Option<&Frame>) -> Result<(), TraceError> {
        let layers = Layers::of(frame, self.journal.wanted_layers());
        let written = self.journal.start(record, rgb(frame), layers);
        self.acknowledge(written)
    }

    /// Records the inputs of a step, before they are used.
    ///
    /// # Errors
    /// When it is called out of turn or the file cannot be written.
    pub fn input(&mut self, step: u32, input: &StepInput) -> Result<(), TraceError> {
        let written = self.journal.input(step, input);
        self.acknowledge(written)
    }

    /// Records the clock of a step, between its input and what came of it;
    /// acknowledged with the latter.
    ///
    /// # Errors
    /// When it is called out of turn or the file cannot be written.
    pub fn timing(&mut self, step: u32, timing: &Timing) -> Result<(), TraceError> {
        self.journal
            .timing(step, timing)
            .map_err(|error| self.unwritten(error))
    }

    /// Records what an MCP server answered, as it came: before the start the list of tools and the
    /// answer that began the episode, of a step between its input and what came of it. Acknowledged
    /// with what follows. With [`Images::None`] an answer that holds an image is left out.
    ///
    /// # Errors
    /// When it is called out of turn or the file cannot be written.
    pub fn mcp_answer(&mut self, request: AnsweredRequest, json: &str) -> Result<(), TraceError> {
        self.journal
            .mcp_answer(request, json)
            .map_err(|error| self.unwritten(error))
    }

    /// Records how many secrets were replaced by labels in what is written of a step (`None`: before the start), by the
    /// names of the rules; in turn as [`Recorder::mcp_answer`], once a step.
    ///
    /// # Errors
    /// As [`Recorder::mcp_answer`].
    pub fn redacted(
        &mut self,
        step: Option<u32>,
        count: &BTreeMap<String, u64>,
    ) -> Result<(), TraceError> {
        self.journal
            .redacted(step, count)
            .map_err(|error| self.unwritten(error))
    }

    /// Records where the robot was: of a step between its input and what came of it, of no step
    /// before the start. Acknowledged with what follows, as all that a robot measured.
    ///
    /// # Errors
    /// When it is called out of turn or the file cannot be written.
    pub fn odometry(&mut self, measured: &Odometry) -> Result<(), TraceError> {
        self.journal
            .odometry(measured)
            .map_err(|error| self.unwritten(error))
    }

    /// Records what one execution of a skill came to, in turn as [`Recorder::odometry`].
    ///
    /// # Errors
    /// As [`Recorder::odometry`].
    pub fn primitive(&mut self, outcome: &PrimitiveOutcome) -> Result<(), TraceError> {
        self.journal
            .primitive(outcome)
            .map_err(|error| self.unwritten(error))
    }

    /// Records how long an inference of the low-level model took,
    /// in turn as [`Recorder::odometry`].
    ///
    /// # Errors
    /// As [`Recorder::odometry`].
    pub fn vla(&mut self, measured: &VlaLatency) -> Result<(), TraceError> {
        self.journal
            .vla(measured)
            .map_err(|error| self.unwritten(error))
    }

    /// Records how far the robot was off, in turn as [`Recorder::odometry`].
    ///
    /// # Errors
    /// As [`Recorder::odometry`].
    pub fn alignment(&mut self, measured: &Alignment) -> Result<(), TraceError> {
        self.journal
            .alignment(measured)
            .map_err(|error| self.unwritten(error))
    }

    /// Records everything that a log holds of a step (none: of before the start),
    /// in turn as [`Recorder::odometry`].
    ///
    /// # Errors
    /// As [`Recorder::odometry`].
    pub fn robot(&mut self, step: Option<u32>, log: &RobotLog) -> Result<(), TraceError> {
        self.journal
            .robot(step, log)
            .map_err(|error| self.unwritten(error))
    }

    /// Records what else the robot's recording holds, after the last step and before the end; with
    /// [`Images::None`] without its cameras.
    ///
    /// # Errors
    /// When it is called out of turn or the file cannot be written.
    pub fn sensors(&mut self, channels: &[SensorChannel]) -> Result<(), TraceError> {
        self.journal
            .sensors(channels)
            .map_err(|error| self.unwritten(error))
    }

    /// Records an image of the camera as it came, beside the one of 640 x 480 that the step holds;
    /// in turn as [`Recorder::odometry`], once a step. With [`Images::None`] it is left out.
    ///
    /// # Errors
    /// As [`Recorder::odometry`].
    pub fn original(&mut self, step: Option<u32>, image: &CameraImage) -> Result<(), TraceError> {
        self.journal
            .original(step, image)
            .map_err(|error| self.unwritten(error))
    }

    /// Records what came of a step.
    ///
    /// # Errors
    /// When it is called out of turn or with other inputs than [`Recorder::input`], the record's
    /// chain digest is not that of the records, or the file cannot be written.
    pub fn step(&mut self, record: &StepRecord, frame: Option<&Frame>) -> Result<(), TraceError> {
        let layers = Layers::of(frame, self.journal.wanted_layers());
        let written = self.journal.step(record, rgb(frame), layers);
        self.acknowledge(written)
    }

    /// [`Recorder::start`] with an image as a protocol brings it, a PNG file in Base64: kept as it
    /// came until the end, then as all images. It is not decoded before, so the record cannot
    /// have its digest; what is no image is left out of the finished file.
    ///
    /// # Errors
    /// As [`Recorder::start`].
    pub fn start_with_base64(&mut self, record: &StartRecord, png: &str) -> Result<(), TraceError> {
        let image = Some(FrameSource::Base64(png));
        let written = self.journal.start(record, image, Layers::default());
        self.acknowledge(written)
    }

    /// [`Recorder::step`] with an image as in [`Recorder::start_with_base64`].
    ///
    /// # Errors
    /// As [`Recorder::step`].
    pub fn step_with_base64(&mut self, record: &StepRecord, png: &str) -> Result<(), TraceError> {
        let image = Some(FrameSource::Base64(png));
        let written = self.journal.step(record, image, Layers::default());
        self.acknowledge(written)
    }

    /// Records the end, writes the finished file under its name and deletes the part, in this
    /// order: at every moment there is a whole part, a whole trace, or both.
    ///
    /// # Errors
    /// When it is called out of turn, the end does not fit the steps, or a file cannot be written.
    /// The part stays then.
    pub fn end(mut self, record: &EndRecord) -> Result<TraceSummary, TraceError> {
        self.journal
            .end(record)
            .map_err(|error| self.unwritten(error))?;
        if self.durability == Durability::Fsync {
            self.file
                .sync()
                .map_err(|source| self.write_failed(source))?;
        }
        let failed = |action| {
            let path = self.path.clone();
            move |source| TraceError::Io {
                action,
                path,
                source,
            }
        };
        let files = TraceFiles::on(self.disk.clone());
        // A part is as long as it became. The finished file, which is smaller, has the limit.
        let all = Limits {
            file_bytes: u64::MAX,
            ..Limits::default()
        };
        let part = files::read(&files, &self.part, &all)?;
        let bytes = container::finish(&part, &self.path, &Limits::default())?;
        files::publish(&*self.disk, &self.path, &bytes)
            .map_err(|source| self.write_failed(source))?;
        self.disk
            .remove_file(&self.part)
            .map_err(failed("delete the part of"))?;
        Ok(TraceSummary {
            path: self.path.clone(),
            bytes: bytes.len() as u64,
            chain: self.journal.chain(),
        })
    }

    /// Makes what was written last as much as is promised.
    fn acknowledge(&mut self, written: Result<(), TraceError>) -> Result<(), TraceError> {
        written.map_err(|error| self.unwritten(error))?;
        if self.durability == Durability::Fsync {
            self.file
                .sync()
                .map_err(|source| self.write_failed(source))?;
        }
        self.acknowledged = self.journal.steps();
        Ok(())
    }

    fn unwritten(&self, error: TraceError) -> TraceError {
        match error {
            TraceError::Io { source, .. } => self.write_failed(source),
            other => other,
        }
    }

    fn write_failed(&self, source: io::Error) -> TraceError {
        TraceError::Write {
            part: self.part.clone(),
            steps: self.acknowledged,
            source,
        }
    }
}

fn rgb(frame: Option<&Frame>) -> Option<FrameSource<'_>> {
    frame.map(|frame| FrameSource::Rgb(&frame.rgb))
}
