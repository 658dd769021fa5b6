//! Reading a trace: what the container holds, put together to records and checked
//! against the hash chain.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use reel_world::{
    Assets, Digest, FRAME_HEIGHT, FRAME_WIDTH, FrameDigests, Meshes, Scene, Task,
    record::{EndRecord, EpisodeHeader, StartRecord, StepInput, StepRecord},
};

use crate::{
    FrameLayers, McpAnswers, Timing, TraceError, TraceFiles,
    assembly::Assembly,
    chain::Covered,
    container::{self, At, Closing, Item, Visitor},
    decode_webp, files,
    limits::Limits,
    robot::{CameraImage, RobotLog},
    schema,
    sensors::SensorChannel,
};

/// How many secrets were replaced by labels before an episode was written: by step (`None`: before the first) and by the
/// name of the rule.
pub type Redactions = BTreeMap<Option<u32>, BTreeMap<String, u64>>;

/// A trace in memory: records decoded, images still encoded.
#[derive(Clone, PartialEq, Debug)]
pub struct Trace {
    /// Path of the file that the trace was read from.
    pub path: PathBuf,
    /// The inputs known before the first call.
    pub header: EpisodeHeader,
    /// The task of the episode, from the attachment `task.json`.
    pub task: Arc<Task>,
    /// The scene of the episode, from the attachment `scene.json`.
    pub scene: Arc<Scene>,
    /// The meshes that the header names, as far as [`Trace::with_meshes`] found them:
    /// no trace holds any.
    pub meshes: Meshes,
    /// The state after settling.
    pub start: StartRecord,
    /// The steps, from 0.
    pub steps: Vec<StepRecord>,
    /// The end; none where the recording broke off.
    pub end: Option<EndRecord>,
    /// Size of the file.
    pub bytes: u64,
    /// What [`recover`](crate::recover()) did to get this trace, if it did, in
    /// the order it happened.
    pub recoveries: Vec<BTreeMap<String, String>>,
    /// By step, the clock of episodes that were recorded while they were played elsewhere.
    pub timings: BTreeMap<u32, Timing>,
    /// What the MCP server answered, as it came; empty for episodes that were not recorded between an
    /// agent and its server, and where records alone were read.
    pub mcp_answers: McpAnswers,
    /// How many secrets were replaced by labels before this was written; empty where none were.
    pub redactions: Redactions,
    /// What a robot measured; empty for episodes without one.
    pub robot: RobotLog,
    /// What else the robot's recording holds; empty for episodes without a robot, and where records
    /// alone were read.
    pub sensors: Vec<SensorChannel>,
    /// Images as the camera gave them; none: of the start.
    pub(crate) originals: BTreeMap<Option<u32>, CameraImage>,
    /// WebP images; none: of the start.
    pub(crate) images: BTreeMap<Option<u32>, Vec<u8>>,
    /// Depth, little-endian; none: of the start.
    pub(crate) depths: BTreeMap<Option<u32>, Vec<u8>>,
    /// Instance ids, little-endian; none: of the start.
    pub(crate) masks: BTreeMap<Option<u32>, Vec<u8>>,
    /// By step, where its first message stands.
    pub(crate) offsets: Vec<u64>,
    /// The hash chain: the link after the start, after each step and, where links cover messages, after the end.
    pub(crate) links: Vec<Digest>,
    pub(crate) covered: Covered,
}

impl Trace {
    /// Reads a finished trace, or an unfinished recording that ends with a whole step, from a file
    /// of this machine ([`TraceFiles::read`] reads URLs, too), and verifies
    /// it: every checksum, the schemas, the order, and the hash chain over all records. Images
    /// are verified when they are decoded.
    ///
    /// # Errors
    /// The first thing that is wrong. [`TraceError::Torn`]: use [`Trace::read_partial`].
    pub fn read(path: &Path) -> Result<Trace, TraceError> {
        Self::read_with_limits(path, &Limits::default())
    }

    /// [`Trace::read`] with other limits.
    ///
    /// # Errors
    /// As [`Trace::read`].
    pub fn read_with_limits(path: &Path, limits: &Limits) -> Result<Trace, TraceError> {
        Self::read_from(&TraceFiles::default(), path, limits)
    }

    pub(crate) fn read_from(
        files: &TraceFiles,
        path: &Path,
        limits: &Limits,
    ) -> Result<Trace, TraceError> {
        Self::from_bytes(path, &files::read(files, path, limits)?, limits)
    }

    /// [`Trace::read`] for bytes that are already in memory; `path` says in messages
    /// where they came from.
    ///
    /// # Errors
    /// As [`Trace::read`].
    pub fn from_bytes(path: &Path, bytes: &[u8], limits: &Limits) -> Result<Trace, TraceError> {
        load(path, bytes, limits).sound()
    }

    /// Reads the whole steps that there are, and says what is wrong first; nothing is, where
    /// [`Trace::read`] succeeds. The hash chain vouches for the steps, also for those of a
    /// torn or damaged chunk.
    ///
    /// # Errors
    /// When not even the state after settling can be read.
    pub fn read_partial(
        files: &TraceFiles,
        path: &Path,
    ) -> Result<(Trace, Option<String>), TraceError> {
        let limits = Limits::default();
        let loaded = load(path, &files::read(files, path, &limits)?, &limits);
        let problem = loaded.problems.into_iter().next();
        match (loaded.trace, problem) {
            (Ok(trace), problem) => Ok((trace, problem.map(|problem| problem.error.to_string()))),
            (Err(_), Some(problem)) => Err(problem.error),
            (Err(missing), None) => Err(missing),
        }
    }

    /// How many secrets were replaced by labels in the whole episode, by the name of the rule.
    pub fn redacted(&self) -> BTreeMap<&str, u64> {
        let mut total = BTreeMap::new();
        for (rule, count) in self.redactions.values().flatten() {
            let sum: &mut u64 = total.entry(rule.as_str()).or_default();
            *sum = sum.saturating_add(*count);
        }
        total
    }

    /// The trace with the meshes that its header names, those of them that are there.
    #[must_use]
    pub fn with_meshes(mut self, assets: &dyn Assets) -> Self {
        self.meshes = assets.meshes(&mut self.header.meshes.keys());
        self
    }

    /// The WebP image after a step (none: of the start), if the trace holds it.
    pub fn image(&self, step: Option<u32>) -> Option<&[u8]> {
        self.images.get(&step).map(Vec::as_slice)
    }

    /// The image after a step (none: of the start) as the robot's camera gave it, if
    /// the trace holds it.
    pub fn camera_image(&self, step: Option<u32>) -> Option<&CameraImage> {
        self.originals.get(&step)
    }

    /// How many images the trace holds.
    pub fn image_count(&self) -> usize {
        self.images.len()
    }

    /// The image after a step (none: of the start), decoded to RGB and checked
    /// against its recorded digest.
    ///
    /// # Errors
    /// When the image cannot be decoded or is not the recorded one.
    pub fn frame_rgb(&self, step: Option<u32>) -> Result<Option<Vec<u8>>, TraceError> {
        let Some(webp) = self.image(step) else {
            return Ok(None);
        };
        let refuse = |what: String| TraceError::Image {
            path: self.path.clone(),
            step,
            problem: what,
        };
        let pixels = (FRAME_WIDTH * FRAME_HEIGHT) as u32;
        let (rgb, width, height) = decode_webp(webp, pixels)
            .ok_or_else(|| refuse("cannot be decoded as RGB in WebP".into()))?;
        if (width as usize, height as usize) != (FRAME_WIDTH, FRAME_HEIGHT) {
            return Err(refuse(format!(
                "has {width} x {height} pixels instead of {FRAME_WIDTH} x {FRAME_HEIGHT}"
            )));
        }
        self.check_rgb(step, &rgb)?;
        Ok(Some(rgb))
    }

    /// What is stored of any frame besides images.
    pub fn layers(&self) -> FrameLayers {
        FrameLayers {
            depth: !self.depths.is_empty(),
            masks: !self.masks.is_empty(),
        }
    }

    /// Whether these are stored of every frame.
    pub fn has_layers(&self, wanted: FrameLayers) -> bool {
        let mut frames = self
            .moments()
            .filter(|step| self.frame_digests(*step).is_some());
        frames.all(|step| {
            (!wanted.depth || self.depths.contains_key(&step))
                && (!wanted.masks || self.masks.contains_key(&step))
        })
    }

    /// The depth of the frame after a step (none: of the start) in millimetres, 0 where nothing is,
    /// checked against its recorded digest; `None` if the trace does not hold it.
    ///
    /// # Errors
    /// When it is not the recorded one.
    pub fn depth_mm(&self, step: Option<u32>) -> Result<Option<Vec<u16>>, TraceError> {
        self.layer(step, "depth", &self.depths, |digests| digests.depth)
    }

    /// The instance ids ([`reel_world::instances`]) of the frame after a step (none: of the start),
    /// checked against their recorded digest; `None` if the trace does not hold them.
    ///
    /// # Errors
    /// When they are not the recorded ones.
    pub fn instance_ids(&self, step: Option<u32>) -> Result<Option<Vec<u16>>, TraceError> {
        self.layer(step, "masks", &self.masks, |digests| digests.ids)
    }

    fn layer(
        &self,
        step: Option<u32>,
        name: &str,
        layer: &BTreeMap<Option<u32>, Vec<u8>>,
        expected: fn(&FrameDigests) -> Digest,
    ) -> Result<Option<Vec<u16>>, TraceError> {
        let Some(bytes) = layer.get(&step) else {
            return Ok(None);
        };
        let refuse = |problem: String| TraceError::Image {
            path: self.path.clone(),
            step,
            problem,
        };
        let Some(expected) = self.frame_digests(step).map(expected) else {
            return Err(refuse(format!("has {name}, and no digest of them")));
        };
        let found = Digest::of(bytes);
        if found != expected {
            return Err(refuse(format!(
                "has {name} with the digest {found} instead of {expected}"
            )));
        }
        let values = bytes.as_chunks().0.iter();
        Ok(Some(
            values.map(|value| u16::from_le_bytes(*value)).collect(),
        ))
    }

    /// Decodes every image, depth and mask and checks it against its recorded digest.
    ///
    /// # Errors
    /// The first that is wrong.
    pub fn verify_images(&self) -> Result<(), TraceError> {
        self.moments().try_for_each(|step| self.verify_frame(step))
    }

    /// Decodes what is stored of the frame after a step (none: of the start), and checks it.
    pub(crate) fn verify_frame(&self, step: Option<u32>) -> Result<(), TraceError> {
        self.frame_rgb(step)?;
        self.depth_mm(step)?;
        self.instance_ids(step).map(drop)
    }

    /// The start (none), and every step.
    pub(crate) fn moments(&self) -> impl Iterator<Item = Option<u32>> {
        std::iter::once(None).chain(self.steps.iter().map(|step| Some(step.step)))
    }

    /// The last link of the hash chain.
    pub fn chain(&self) -> Digest {
        self.links.last().copied().unwrap_or_default()
    }

    /// The link of the hash chain after a step (none: of the start): it names this moment and all that led to it.
    pub fn link(&self, step: Option<u32>) -> Option<Digest> {
        let moment = step.map_or(0, |step| step as usize + 1);
        self.links
            .get(moment)
            .filter(|_| moment <= self.steps.len())
            .copied()
    }

    /// Where a step's first message stands in the file: the offset of its chunk, or of the message
    /// itself in an unfinished recording. The end of the file for a step that is not there.
    pub fn offset(&self, step: u32) -> u64 {
        self.offsets
            .get(step as usize)
            .copied()
            .unwrap_or(self.bytes)
    }
}

/// Reads many traces, from several threads at a time, where their images are not asked for:
/// verified as [`Trace::read`] does, but no image is kept, and a task or scene that traces
/// share is parsed once.
#[derive(Default)]
pub struct RecordsReader {
    files: TraceFiles,
    limits: Limits,
    known: DocumentCache,
}

impl RecordsReader {
    /// A reader of these files; the default reads those of this machine.
    pub fn new(files: TraceFiles) -> Self {
        Self {
            files,
            ..Self::default()
        }
    }

    /// Where it reads traces from.
    pub fn files(&self) -> &TraceFiles {
        &self.files
    }

    /// Reads a trace without its images.
    ///
    /// # Errors
    /// As [`Trace::read`].
    pub fn read(&self, path: &Path) -> Result<Trace, TraceError> {
        let bytes = files::read(&self.files, path, &self.limits)?;
        let mut reading = Reading {
            assembly: Assembly::records_only(path, &self.known),
            problems: Vec::new(),
            refused: false,
        };
        let walked = container::walk(&bytes, path, &self.limits, &mut reading);
        reading.finish(walked, bytes.len() as u64).sound()
    }
}

/// Tasks and scenes that were parsed before.
#[derive(Default)]
pub(crate) struct DocumentCache {
    pub tasks: Parsed<Task>,
    pub scenes: Parsed<Scene>,
}

/// Values by the digest of their JSON.
pub(crate) struct Parsed<T>(Mutex<BTreeMap<Digest, Arc<Document<T>>>>);

/// A value, and the JSON text that it is of.
struct Document<T> {
    json: Vec<u8>,
    value: Arc<T>,
}

impl<T> Default for Parsed<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Parsed<T> {
    /// More are not kept.
    const MAX: usize = 1024;

    /// The value of a JSON text that has this digest for sure: one of the same bytes had it.
    pub(crate) fn get(&self, digest: &Digest, json: &[u8]) -> Option<Arc<T>> {
        let known = self
            .0
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .get(digest)
            .cloned()?;
        (known.json == json).then(|| known.value.clone())
    }

    pub(crate) fn keep(&self, digest: Digest, json: &[u8], value: &Arc<T>) {
        let mut values = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if values.len() >= Self::MAX {
            values.clear();
        }
        values.insert(
            digest,
            Arc::new(Document {
                json: json.to_vec(),
                value: value.clone(),
            }),
        );
    }
}

/// What could be read of a file, and everything that is wrong with it.
pub(crate) struct Loaded {
    /// The whole steps; an error where there is not even a start.
    pub trace: Result<Trace, TraceError>,
    /// What is known before the first call, where there is not even a start.
    pub head: Option<(EpisodeHeader, Arc<Task>, Arc<Scene>)>,
    /// The call that was received, but of which nothing came that is whole.
    pub under_way: Option<(u32, StepInput)>,
    /// What is wrong, in the order of the file.
    pub problems: Vec<Problem>,
}

impl Loaded {
    /// The trace, if nothing is wrong with it.
    fn sound(self) -> Result<Trace, TraceError> {
        match self.problems.into_iter().next() {
            None => self.trace,
            Some(problem) => Err(problem.error),
        }
    }
}

/// Something that is wrong.
pub(crate) struct Problem {
    /// What is wrong, with its place in the file if that is known.
    pub error: TraceError,
    /// How many whole steps were read before it.
    pub steps_before: u32,
}

/// More are not kept.
const PROBLEMS_MAX: usize = 100;

/// Reads on after problems of the container; of the records, up to the first that is refused.
pub(crate) struct Reading<'a> {
    assembly: Assembly<'a>,
    problems: Vec<Problem>,
    refused: bool,
}

impl Visitor for Reading<'_> {
    fn item(&mut self, at: At, item: Item) -> Result<(), TraceError> {
        // Links over records do not cover the end, so only a checksum vouches for it.
        let doubtful_end = matches!(&item, Item::Message { topic, .. } if *topic == schema::EPISODE.topic)
            && !at.verified
            && self.assembly.linked_over_records();
        if self.refused || doubtful_end {
            return Ok(());
        }
        if let Err(error) = self.assembly.item(at.offset, item) {
            self.refused = true;
            self.problem(error)?;
        }
        Ok(())
    }

    fn problem(&mut self, error: TraceError) -> Result<(), TraceError> {
        if self.problems.len() < PROBLEMS_MAX {
            self.problems.push(Problem {
                error,
                steps_before: self.assembly.step_count(),
            });
        }
        Ok(())
    }
}

impl<'a> Reading<'a> {
    pub(crate) fn new(path: &'a Path) -> Self {
        Self {
            assembly: Assembly::new(path),
            problems: Vec::new(),
            refused: false,
        }
    }

    /// How many steps are whole so far.
    pub(crate) fn step_count(&self) -> u32 {
        self.assembly.step_count()
    }

    /// Takes what the walk came to.
    pub(crate) fn finish(mut self, walked: Result<Closing, TraceError>, bytes: u64) -> Loaded {
        let ending = match walked {
            Ok(_) if self.assembly.nothing_restored().is_some() => Ok(()),
            Ok(Closing::Finished) => self.assembly.check_finished(),
            Ok(Closing::Open) if !self.refused => self.assembly.check_open(bytes),
            Ok(Closing::Open | Closing::Torn) => Ok(()),
            Err(other) => Err(other),
        };
        let steps_before = self.assembly.step_count();
        // What is missing at the end only follows from an earlier problem.
        if let Err(error) = ending
            && self.problems.is_empty()
        {
            self.problems.push(Problem {
                error,
                steps_before,
            });
        }
        for problem in &mut self.problems {
            if let TraceError::Torn { steps_readable, .. } = &mut problem.error {
                *steps_readable = steps_before;
            }
        }
        let under_way = self.assembly.under_way();
        let head = if self.assembly.has_start() {
            None
        } else {
            self.assembly.head().ok()
        };
        let nothing = self.assembly.nothing_restored();
        let trace = self
            .assembly
            .into_trace(bytes)
            .map_err(|missing| nothing.unwrap_or(missing));
        Loaded {
            trace,
            head,
            under_way,
            problems: self.problems,
        }
    }
}

/// Reads as far as possible.
pub(crate) fn load(path: &Path, bytes: &[u8], limits: &Limits) -> Loaded {
    let mut reading = Reading::new(path);
    let walked = container::walk(bytes, path, limits, &mut reading);
    reading.finish(walked, bytes.len() as u64)
}
