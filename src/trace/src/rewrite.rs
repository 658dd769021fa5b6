//! Writing a trace again from its records: without its images, or with images
//! that were drawn again.

use std::{collections::BTreeMap, io::Cursor, path::Path};

use reel_world::{
    Digest, Frame, FrameDigests,
    record::{EndRecord, StartRecord, StepRecord},
};

use crate::{
    AnsweredRequest, FrameLayers, Images, LocalDisk, PackedEpisode, Trace, TraceError,
    TraceSummary, container, files,
    journal::{FrameSource, Journal, Layers},
    limits::Limits,
};

impl Trace {
    /// Writes the trace again, as a recording of the same records would have been: with
    /// [`Images::None`] byte for byte as if recorded without images, depth and masks; with [`Images::Full`] and
    /// the recorded images as if recorded with them. `rgb` gives the image after a step (none:
    /// of the start), 8-bit RGB, row by row from the top left; it is asked only with
    /// [`Images::Full`], and what it does not give is left out. What is in place at `path` (this
    /// very trace, too) is replaced at once; it is on the disk when this returns.
    ///
    /// # Errors
    /// When the trace has no end, an image is not the one whose digest was recorded, its messages stand in
    /// another order than a recorder's (the links would be other ones), or the file cannot be written.
    pub fn rewrite(
        &self,
        path: &Path,
        images: Images,
        mut rgb: impl FnMut(Option<u32>) -> Option<Vec<u8>>,
    ) -> Result<TraceSummary, TraceError> {
        let Some(end) = &self.end else {
            return Err(TraceError::Missing {
                path: self.path.clone(),
                part: "end of the episode",
            });
        };
        let layers = match images {
            Images::None => FrameLayers::default(),
            Images::Full => self.layers(),
        };
        let (bytes, chain) = self.rendered(
            path,
            (images, layers),
            &self.recoveries,
            end,
            |step| match images {
                Images::None => Ok(None),
                Images::Full => rgb(step)
                    .map(|rgb| self.check_rgb(step, &rgb).map(|()| Encoding::Rgb(rgb)))
                    .transpose(),
            },
        )?;
        if chain != self.chain() {
            return Err(TraceError::OtherOrder {
                path: self.path.clone(),
            });
        }
        let failed = |source| TraceError::Io {
            action: "write",
            path: path.to_owned(),
            source,
        };
        files::publish(&LocalDisk, path, &bytes).map_err(failed)?;
        Ok(TraceSummary {
            path: path.to_owned(),
            bytes: bytes.len() as u64,
            chain: self.chain(),
        })
    }

    /// The bytes of a finished trace with these records, and its last link.
    pub(crate) fn rendered(
        &self,
        path: &Path,
        stored: (Images, FrameLayers),
        recoveries: &[BTreeMap<String, String>],
        end: &EndRecord,
        mut image: impl FnMut(Option<u32>) -> Result<Option<Encoding>, TraceError>,
    ) -> Result<(Vec<u8>, Digest), TraceError> {
        let head = (&self.header, &*self.task, &*self.scene);
        let sink = Cursor::new(Vec::new());
        let mut journal = Journal::create(sink, path, head, stored, recoveries, self.covered)?;
        let answer = |journal: &mut Journal<_>, request: AnsweredRequest| {
            let json = self.mcp_answers.get(&request);
            json.map_or(Ok(()), |json| journal.mcp_answer(request, json))
        };
        let redacted = |journal: &mut Journal<_>, step: Option<u32>| {
            let count = self.redactions.get(&step);
            count.map_or(Ok(()), |count| journal.redacted(step, count))
        };
        answer(&mut journal, AnsweredRequest::ToolList)?;
        answer(&mut journal, AnsweredRequest::Start)?;
        redacted(&mut journal, None)?;
        journal.robot(None, &self.robot)?;
        if let Some(original) = self.camera_image(None) {
            journal.original(None, original)?;
        }
        let first = image(None)?;
        let first = first.as_ref().map(Encoding::image);
        journal.start(&self.start, first, self.stored_layers(None))?;
        for step in &self.steps {
            journal.input(step.step, &step.input)?;
            if let Some(timing) = self.timings.get(&step.step) {
                journal.timing(step.step, timing)?;
            }
            answer(&mut journal, AnsweredRequest::Step(step.step))?;
            redacted(&mut journal, Some(step.step))?;
            journal.robot(Some(step.step), &self.robot)?;
            if let Some(original) = self.camera_image(Some(step.step)) {
                journal.original(Some(step.step), original)?;
            }
            let taken = image(Some(step.step))?;
            let taken = taken.as_ref().map(Encoding::image);
            journal.step(step, taken, self.stored_layers(Some(step.step)))?;
        }
        journal.sensors(&self.sensors)?;
        journal.end(end)?;
        let chain = journal.chain();
        let part = journal.into_inner().into_inner();
        Ok((container::finish(&part, path, &Limits::default())?, chain))
    }

    fn stored_layers(&self, step: Option<u32>) -> Layers<'_> {
        let stored = |layer: &'_ BTreeMap<Option<u32>, Vec<u8>>| layer.get(&step).cloned();
        Layers {
            depth: stored(&self.depths).map(Into::into),
            masks: stored(&self.masks).map(Into::into),
        }
    }

    /// The digests of the frame after a step (none: of the start), where there is one.
    pub(crate) fn frame_digests(&self, step: Option<u32>) -> Option<&FrameDigests> {
        let digests = match step {
            None => Some(&self.start.digests),
            Some(step) => self.steps.get(step as usize).map(|record| &record.digests),
        };
        digests?.frame.as_ref()
    }

    /// Checks an image against its recorded digest, where there is one.
    pub(crate) fn check_rgb(&self, step: Option<u32>, rgb: &[u8]) -> Result<(), TraceError> {
        let Some(expected) = self.frame_digests(step) else {
            return Ok(());
        };
        let found = Digest::of(rgb);
        if found == expected.rgb {
            return Ok(());
        }
        let what = format!("has the digest {found} instead of {}", expected.rgb);
        Err(TraceError::Image {
            path: self.path.clone(),
            step,
            problem: what,
        })
    }
}

/// A packed episode on its way back to the bytes of its trace: the records of an execution, written
/// as its recorder would have written them.
pub struct Rendering<'a> {
    packed: &'a PackedEpisode,
    journal: Journal<Cursor<Vec<u8>>>,
}

impl<'a> Rendering<'a> {
    /// Writes the inputs that are known before the first call.
    ///
    /// # Errors
    /// When task or scene are not those of the header.
    pub fn new(packed: &'a PackedEpisode) -> Result<Self, TraceError> {
        let head = (&packed.header, &*packed.task, &*packed.scene);
        let (path, stored) = (Path::new(&packed.name), (packed.images, packed.layers));
        let sink = Cursor::new(Vec::new());
        let journal = Journal::create(sink, path, head, stored, &[], packed.covered)?;
        Ok(Self { packed, journal })
    }

    /// Writes the state after settling, with its frame.
    ///
    /// # Errors
    /// When it is called out of turn.
    pub fn start(&mut self, record: &StartRecord, frame: &Frame) -> Result<(), TraceError> {
        let layers = Layers::of(Some(frame), self.packed.layers);
        self.journal
            .start(record, Some(FrameSource::Rgb(&frame.rgb)), layers)
    }

    /// Writes a step with its inputs, as an execution gave it.
    ///
    /// # Errors
    /// When it is called out of turn.
    pub fn step(&mut self, record: &StepRecord, frame: Option<&Frame>) -> Result<(), TraceError> {
        self.journal.input(record.step, &record.input)?;
        if let Some(timing) = self.packed.timings.get(&record.step) {
            self.journal.timing(record.step, timing)?;
        }
        let layers = Layers::of(frame, self.packed.layers);
        let image = frame.map(|frame| FrameSource::Rgb(&frame.rgb));
        self.journal.step(record, image, layers)
    }

    /// Writes the end, and gives the bytes of the trace.
    ///
    /// # Errors
    /// When it is called out of turn, or they are not those that were packed.
    pub fn end(mut self, record: &EndRecord) -> Result<Vec<u8>, TraceError> {
        self.journal.end(record)?;
        let (path, chain) = (Path::new(&self.packed.name), self.journal.chain());
        let refused = |problem: String| TraceError::Packed {
            path: path.to_owned(),
            problem,
        };
        if chain != self.packed.chain {
            return Err(refused(format!(
                "executed again, it ends with the link {chain} instead of {}",
                self.packed.chain
            )));
        }
        let part = self.journal.into_inner().into_inner();
        let bytes = container::finish(&part, path, &Limits::default())?;
        let digest = Digest::of(&bytes);
        if digest != self.packed.digest {
            return Err(refused(format!(
                "every record is what was packed, but in {} bytes with the digest {digest} instead of {} with {}; another version of Reel wrote it",
                bytes.len(),
                self.packed.bytes,
                self.packed.digest
            )));
        }
        Ok(bytes)
    }
}

/// An image in one of its forms.
pub(crate) enum Encoding {
    /// 8-bit RGB pixels, still to be encoded as WebP.
    Rgb(Vec<u8>),
    /// A WebP image, already encoded and stored as it is.
    Webp(Vec<u8>),
}

impl Encoding {
    fn image(&self) -> FrameSource<'_> {
        match self {
            Encoding::Rgb(rgb) => FrameSource::Rgb(rgb),
            Encoding::Webp(webp) => FrameSource::Webp(webp),
        }
    }
}
