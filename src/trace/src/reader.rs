//! Reading a trace: what the container holds, put together to records and checked against the hash chain.

use std::{collections::BTreeMap, fs::File, io::Read as _, path::Path, path::PathBuf};

use reel_world::{
    Digest, FRAME_HEIGHT, FRAME_WIDTH, Scene, Task,
    record::{EndRecord, EpisodeHeader, StartRecord, StepRecord},
};

use crate::{
    TraceError,
    assembly::Assembly,
    container::{self, Closing},
    decode_webp,
    recorder::with_suffix,
};

/// Bounds of what the reader takes from a file that nobody vouches for.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Limits {
    /// Largest file, in bytes.
    pub file_bytes: u64,
    /// Largest chunk, compressed or not, in bytes; bounds every message too.
    pub chunk_bytes: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self { file_bytes: 2 << 30, chunk_bytes: 256 << 20 }
    }
}

/// A trace in memory: records decoded, pictures still encoded.
#[derive(Clone, PartialEq, Debug)]
pub struct Trace {
    /// The file.
    pub path: PathBuf,
    /// The inputs known before the first call.
    pub header: EpisodeHeader,
    /// The task.
    pub task: Task,
    /// The scene.
    pub scene: Scene,
    /// The state after settling.
    pub start: StartRecord,
    /// The steps, from 0.
    pub steps: Vec<StepRecord>,
    /// The end; none where the recording broke off.
    pub end: Option<EndRecord>,
    /// Size of the file.
    pub bytes: u64,
    /// WebP pictures; none: of the start.
    pub(crate) images: BTreeMap<Option<u32>, Vec<u8>>,
    /// By step, where its first message stands.
    pub(crate) offsets: Vec<u64>,
}

impl Trace {
    /// Reads a finished trace, or an unfinished recording that ends with a whole step, and verifies it: every
    /// checksum, the schemas, the order, and the hash chain over all records. Pictures are verified when they
    /// are decoded.
    ///
    /// # Errors
    /// The first thing that is wrong. [`TraceError::Torn`]: use [`Trace::read_partial`].
    pub fn read(path: &Path) -> Result<Trace, TraceError> {
        Self::read_within(path, &Limits::default())
    }

    /// [`Trace::read`] with other limits.
    ///
    /// # Errors
    /// As [`Trace::read`].
    pub fn read_within(path: &Path, limits: &Limits) -> Result<Trace, TraceError> {
        Self::from_bytes(path, &read_file(path, limits)?, limits)
    }

    /// [`Trace::read`] for bytes that are already in memory; `path` says in messages where they came from.
    ///
    /// # Errors
    /// As [`Trace::read`].
    pub fn from_bytes(path: &Path, bytes: &[u8], limits: &Limits) -> Result<Trace, TraceError> {
        match load(path, bytes, limits)? {
            (trace, None) => Ok(trace),
            (_, Some(problem)) => Err(problem),
        }
    }

    /// Reads what there is up to the last whole step before the first thing that is wrong, and says what is
    /// lost; nothing is, where [`Trace::read`] succeeds.
    ///
    /// # Errors
    /// When not even the state after settling can be read.
    pub fn read_partial(path: &Path) -> Result<(Trace, Option<String>), TraceError> {
        let limits = Limits::default();
        let (trace, problem) = load(path, &read_file(path, &limits)?, &limits)?;
        Ok((trace, problem.map(|problem| problem.to_string())))
    }

    /// The WebP picture after a step (none: of the start), if the trace holds it.
    pub fn image(&self, step: Option<u32>) -> Option<&[u8]> {
        self.images.get(&step).map(Vec::as_slice)
    }

    /// How many pictures the trace holds.
    pub fn image_count(&self) -> usize {
        self.images.len()
    }

    /// The picture after a step (none: of the start), decoded to RGB and checked against its recorded digest.
    ///
    /// # Errors
    /// When the picture cannot be decoded or is not the recorded one.
    pub fn frame_rgb(&self, step: Option<u32>) -> Result<Option<Vec<u8>>, TraceError> {
        let Some(webp) = self.image(step) else { return Ok(None) };
        let refuse = |what: String| TraceError::Picture { path: self.path.clone(), step, what };
        let pixels = (FRAME_WIDTH * FRAME_HEIGHT) as u32;
        let (rgb, width, height) = decode_webp(webp, pixels).ok_or_else(|| refuse("cannot be decoded as RGB in WebP".into()))?;
        if (width as usize, height as usize) != (FRAME_WIDTH, FRAME_HEIGHT) {
            return Err(refuse(format!("has {width} x {height} pixels instead of {FRAME_WIDTH} x {FRAME_HEIGHT}")));
        }
        let digests = match step {
            None => Some(&self.start.digests),
            Some(step) => self.steps.get(step as usize).map(|record| &record.digests),
        };
        if let Some(expected) = digests.and_then(|digests| digests.frame.as_ref()) {
            let found = Digest::of(&rgb);
            if found != expected.rgb {
                return Err(refuse(format!("has the digest {found} instead of {}", expected.rgb)));
            }
        }
        Ok(Some(rgb))
    }

    /// Decodes every picture and checks it against its recorded digest.
    ///
    /// # Errors
    /// The first picture that is wrong.
    pub fn verify_images(&self) -> Result<(), TraceError> {
        self.images.keys().try_for_each(|step| self.frame_rgb(*step).map(drop))
    }

    /// The last link of the hash chain.
    pub fn chain(&self) -> Digest {
        self.steps.last().map_or(self.start.digests.chain, |step| step.digests.chain)
    }

    /// Where a step's first message stands in the file: the offset of its chunk, or of the message itself in
    /// an unfinished recording. The end of the file for a step that is not there.
    pub fn offset(&self, step: u32) -> u64 {
        self.offsets.get(step as usize).copied().unwrap_or(self.bytes)
    }
}

/// Reads as far as possible: the trace, and the first thing that is wrong.
fn load(path: &Path, bytes: &[u8], limits: &Limits) -> Result<(Trace, Option<TraceError>), TraceError> {
    let mut assembly = Assembly::new(path);
    let problem = match container::walk(bytes, path, limits, &mut |offset, item| assembly.item(offset, item)) {
        Ok(Closing::Finished) => assembly.check_finished().err(),
        Ok(Closing::Open) => assembly.check_open(bytes.len() as u64).err(),
        Err(TraceError::Torn { path, offset, lost, .. }) => {
            Some(TraceError::Torn { path, offset, steps_readable: assembly.step_count(), lost })
        }
        Err(other) => Some(other),
    };
    match assembly.into_trace(bytes.len() as u64) {
        Ok(trace) => Ok((trace, problem)),
        Err(missing) => Err(problem.unwrap_or(missing)),
    }
}

fn read_file(path: &Path, limits: &Limits) -> Result<Vec<u8>, TraceError> {
    let failed = |source: std::io::Error| {
        let part = with_suffix(path, ".part");
        if source.kind() == std::io::ErrorKind::NotFound && part.exists() {
            return TraceError::Unfinished { part };
        }
        TraceError::Io { action: "read", path: path.to_owned(), source }
    };
    let limit = limits.file_bytes;
    let file = File::open(path).map_err(failed)?;
    let found = file.metadata().map_err(failed)?.len();
    let mut bytes = Vec::new();
    if found <= limit {
        file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(failed)?;
    }
    match found.max(bytes.len() as u64) {
        found if found > limit => Err(TraceError::TooLarge { path: path.to_owned(), limit, found }),
        _ => Ok(bytes),
    }
}
