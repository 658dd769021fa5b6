//! Examining a trace: everything that is wrong with it, where, and what to do. Owns the comparison
//! of index and content; all else is what the reader checks anyway. Never changes a file.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use mcap::records::{AttachmentIndex, ChunkHeader, ChunkIndex, MetadataIndex};
use reel_world::record::EndReason;
use serde::Serialize;

use crate::{
    TraceError, TraceFiles,
    container::{self, At, Closing, Item, Visitor},
    error::position,
    files,
    limits::Limits,
    reader::Reading,
    schema::{self, SchemaMatch},
    sensors,
};

/// The result of examining a trace: its size, contents and every finding.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct DoctorReport {
    /// Path of the file that was examined.
    pub path: PathBuf,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// How many steps are whole.
    pub steps: u32,
    /// How many images there are.
    pub images: usize,
    /// How the episode ended, if it did.
    pub end: Option<EndReason>,
    /// Everything that is wrong; empty in a healthy trace.
    pub findings: Vec<Finding>,
    /// What is worth knowing but not wrong.
    pub notes: Vec<String>,
}

/// Something that is wrong.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct Finding {
    /// Byte offset of the record (of its chunk, for a message in a chunk); none where it
    /// is not one place.
    pub offset: Option<u64>,
    /// What stands there, in words: `chunk`, `message on /tool/call`, `image`, `hash chain`.
    pub record: String,
    /// The step; none before and at the start.
    pub step: Option<u32>,
    /// What is wrong with it.
    pub message: String,
    /// What the user should do about it, in words.
    pub advice: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.record)?;
        if let Some(offset) = self.offset {
            write!(f, " at byte {offset}")?;
        }
        write!(
            f,
            ", {}: {}; {}",
            position(self.step),
            self.message,
            self.advice
        )
    }
}

/// Examines a trace or an unfinished recording: magic bytes, structure, every checksum,
/// index against content, schemas against ours, order, hash chain, attachments and
/// images against their digests.
///
/// # Errors
/// When the file cannot be read at all.
pub fn examine(path: &Path) -> Result<DoctorReport, TraceError> {
    let limits = Limits::default();
    let bytes = files::read(&TraceFiles::default(), path, &limits)?;
    let mut examiner = Examiner {
        reading: Reading::new(path),
        content: Content::default(),
        findings: Vec::new(),
    };
    let walked = container::walk(&bytes, path, &limits, &mut examiner);
    let closing = walked.as_ref().ok().copied();
    let Examiner {
        reading,
        content,
        mut findings,
    } = examiner;
    let loaded = reading.finish(walked, bytes.len() as u64);

    let mut notes = content.notes;
    let mut examination = DoctorReport {
        path: path.to_owned(),
        bytes: bytes.len() as u64,
        steps: 0,
        images: 0,
        end: None,
        findings: Vec::new(),
        notes: Vec::new(),
    };
    let sound = !loaded.problems.iter().any(|p| {
        matches!(
            p.error,
            TraceError::Damaged { .. } | TraceError::Torn { .. }
        )
    });
    findings.splice(
        0..0,
        loaded
            .problems
            .iter()
            .map(|problem| finding(&problem.error, problem.steps_before, &bytes)),
    );
    match &loaded.trace {
        Ok(trace) => {
            examination.steps = trace.steps.len() as u32;
            examination.images = trace.image_count();
            examination.end = trace.end.as_ref().map(|end| end.reason);
            let frames = trace
                .moments()
                .filter_map(|step| trace.verify_frame(step).err());
            findings.extend(frames.map(|error| finding(&error, 0, &bytes)));
            if let Some(origin) = trace.header.backend.not_replayable_reason() {
                notes.push(format!("recorded {origin}: nothing to re-execute"));
            } else if trace.image_count() == 0 {
                notes.push(format!(
                    "no images; version {} of the simulator can draw them",
                    trace.header.sim_version
                ));
            }
            for recovery in &trace.recoveries {
                let of = |key: &str| recovery.get(key).map_or("", String::as_str);
                notes.push(format!(
                    "recovered from {}, {} steps, end {}",
                    of("source"),
                    of("steps_restored"),
                    of("end")
                ));
            }
        }
        // No fault of the file: it says so itself.
        Err(error @ TraceError::NothingRestored { .. }) => notes.push(error.to_string()),
        Err(error)
            if loaded.problems.is_empty() || matches!(error, TraceError::Attachment { .. }) =>
        {
            findings.push(finding(error, 0, &bytes));
        }
        Err(_) => {}
    }
    // A part is no trace, also where all that can be restored of it is in one.
    let finished = path.with_extension("");
    if path.extension().is_some_and(|it| it == "part") && finished.is_file() {
        let name = finished.file_name().unwrap_or_default().to_string_lossy();
        notes.push(format!("{name} stands beside it"));
    }
    match closing {
        Some(Closing::Finished) if sound => findings.extend(content.index.compare(&bytes)),
        Some(Closing::Finished) => {
            notes.push("the index was not compared with the damaged content".to_owned())
        }
        Some(Closing::Open) if sound => {
            let steps = examination.steps;
            let torn = TraceError::Torn {
                path: path.to_owned(),
                offset: bytes.len() as u64,
                steps_readable: steps,
                lost: "the recording was never finished".to_owned(),
            };
            findings.push(finding(&torn, steps, &bytes));
        }
        _ => {}
    }
    Ok(DoctorReport {
        findings,
        notes,
        ..examination
    })
}

/// Lets the reader read and notes what the container says of itself.
struct Examiner<'a> {
    reading: Reading<'a>,
    content: Content,
    findings: Vec<Finding>,
}

/// What was seen on the way.
#[derive(Default)]
struct Content {
    index: Index,
    notes: Vec<String>,
    schemas: BTreeMap<u16, Vec<u8>>,
    /// By channel, the sequence number of its last message.
    sequences: BTreeMap<u16, u32>,
}

impl Visitor for Examiner<'_> {
    fn item(&mut self, at: At, item: Item) -> Result<(), TraceError> {
        let step = self.reading.step_count().checked_sub(1);
        let mut wrong = |record: String, what: String, advice: &str| {
            self.findings.push(Finding {
                offset: Some(at.offset),
                record,
                step,
                message: what,
                advice: advice.to_owned(),
            });
        };
        let content = &mut self.content;
        match &item {
            Item::Schema { header, data } => {
                content.schemas.insert(header.id, data.to_vec());
            }
            Item::Channel(channel) => match schema::channel(&channel.topic) {
                None if sensors::is_recorded(&channel.topic) => {}
                None => content
                    .notes
                    .push(format!("the channel {} is not ours", channel.topic)),
                Some(ours) => match schema::compare(
                    &ours,
                    content
                        .schemas
                        .get(&channel.schema_id)
                        .map_or(&[], Vec::as_slice),
                ) {
                    SchemaMatch::Same => {}
                    SchemaMatch::Extended(what) => content
                        .notes
                        .push(format!("the schema of {}: {what}", channel.topic)),
                    SchemaMatch::Other(what) => {
                        wrong(
                            format!("schema of {}", channel.topic),
                            what,
                            "read it with the version of reel that wrote it",
                        );
                    }
                },
            },
            Item::Message { header, topic, .. } => {
                let last = content.sequences.insert(header.channel_id, header.sequence);
                if schema::channel(topic).is_some()
                    && last.is_some_and(|last| header.sequence <= last)
                {
                    let what = format!(
                        "its number {} does not come after {}",
                        header.sequence,
                        last.unwrap_or_default()
                    );
                    wrong(
                        format!("message on {topic}"),
                        what,
                        "it was changed; take another copy",
                    );
                }
            }
            Item::MessageIndex(index) => {
                let chunk = content.index.chunks.last_mut();
                let mut listed: Vec<(u64, u64)> = index
                    .records
                    .iter()
                    .map(|entry| (entry.log_time, entry.offset))
                    .collect();
                listed.sort_unstable();
                let found = chunk
                    .as_ref()
                    .and_then(|chunk| chunk.messages.get(&index.channel_id));
                if found != Some(&listed) {
                    let what = format!(
                        "it does not list the messages of channel {} in the chunk before it",
                        index.channel_id
                    );
                    wrong("message index".to_owned(), what, INDEX_ADVICE);
                }
                if let Some(chunk) = chunk {
                    chunk
                        .index
                        .message_index_offsets
                        .insert(index.channel_id, at.offset);
                    chunk.index.message_index_length += at.length;
                }
            }
            _ => {}
        }
        content.index.note(at, &item);
        self.reading.item(at, item)
    }

    fn problem(&mut self, problem: TraceError) -> Result<(), TraceError> {
        self.reading.problem(problem)
    }
}

/// What the index of the file should say.
#[derive(Default)]
struct Index {
    chunks: Vec<Chunk>,
    attachments: Vec<AttachmentIndex>,
    metadata: Vec<MetadataIndex>,
    schemas: BTreeMap<u16, String>,
    channels: BTreeMap<u16, String>,
    messages: BTreeMap<u16, u64>,
    /// First and last log time.
    span: Option<(u64, u64)>,
}

struct Chunk {
    index: ChunkIndex,
    /// By channel, log time and offset in the chunk, in order.
    messages: BTreeMap<u16, Vec<(u64, u64)>>,
    span: Option<(u64, u64)>,
}

impl Index {
    fn note(&mut self, at: At, item: &Item) {
        match item {
            Item::Schema { header, .. } => {
                drop(self.schemas.insert(header.id, header.name.clone()))
            }
            Item::Channel(channel) => drop(self.channels.insert(channel.id, channel.topic.clone())),
            Item::Chunk(header) => self.chunks.push(Chunk::new(at, header)),
            Item::Metadata(metadata) => {
                self.metadata.push(MetadataIndex {
                    offset: at.offset,
                    length: at.length,
                    name: metadata.name.clone(),
                });
            }
            Item::Attachment { header, data } => self.attachments.push(AttachmentIndex {
                offset: at.offset,
                length: at.length,
                log_time: header.log_time,
                create_time: header.create_time,
                data_size: data.len() as u64,
                name: header.name.clone(),
                media_type: header.media_type.clone(),
            }),
            Item::Message { header, .. } => {
                *self.messages.entry(header.channel_id).or_insert(0) += 1;
                widen(&mut self.span, header.log_time);
                if let (Some(position), Some(chunk)) = (at.in_chunk, self.chunks.last_mut()) {
                    chunk
                        .messages
                        .entry(header.channel_id)
                        .or_default()
                        .push((header.log_time, position));
                    widen(&mut chunk.span, header.log_time);
                }
            }
            Item::MessageIndex(_) => {}
        }
    }

    /// Where the index of a finished file says something else.
    fn compare(&self, bytes: &[u8]) -> Vec<Finding> {
        let mut findings = Vec::new();
        let mut differs = |offset: Option<u64>, record: &str, what: String| {
            let (record, advice) = (record.to_owned(), INDEX_ADVICE.to_owned());
            findings.push(Finding {
                offset,
                record,
                step: None,
                message: what,
                advice,
            });
        };
        let summary = match mcap::Summary::read(bytes) {
            Ok(Some(summary)) => summary,
            Ok(None) => {
                differs(None, "index", "there is none".to_owned());
                return findings;
            }
            Err(error) => {
                differs(None, "index", format!("it cannot be read: {error}"));
                return findings;
            }
        };
        let mut chunks = summary.chunk_indexes;
        chunks.sort_by_key(|index| index.chunk_start_offset);
        let expected: Vec<&ChunkIndex> = self.chunks.iter().map(|chunk| &chunk.index).collect();
        if let Some(at) = first_difference(&chunks, &expected, |found, expected| found == *expected)
        {
            let offset = expected.get(at).map(|chunk| chunk.chunk_start_offset);
            differs(
                offset,
                "chunk index",
                format!("chunk {at} is not where or what it says"),
            );
        }
        for chunk in &self.chunks {
            let found = (chunk.index.message_start_time, chunk.index.message_end_time);
            if found != chunk.span.unwrap_or_default() {
                let what = "its first and last time are not those of its messages".to_owned();
                differs(Some(chunk.index.chunk_start_offset), "chunk", what);
            }
        }
        if let Some(at) = first_difference(
            &summary.attachment_indexes,
            &self.attachments,
            PartialEq::eq,
        ) {
            let offset = self.attachments.get(at).map(|attachment| attachment.offset);
            differs(
                offset,
                "attachment index",
                format!("attachment {at} is not where or what it says"),
            );
        }
        if let Some(at) = first_difference(&summary.metadata_indexes, &self.metadata, PartialEq::eq)
        {
            let offset = self.metadata.get(at).map(|metadata| metadata.offset);
            differs(
                offset,
                "metadata index",
                format!("metadata record {at} is not where or what it says"),
            );
        }
        let channels: BTreeMap<u16, String> = summary
            .channels
            .iter()
            .map(|(id, channel)| (*id, channel.topic.clone()))
            .collect();
        let schemas: BTreeMap<u16, String> = summary
            .schemas
            .iter()
            .map(|(id, schema)| (*id, schema.name.clone()))
            .collect();
        if channels != self.channels || schemas != self.schemas {
            differs(
                None,
                "index",
                "its channels and schemas are not those of the content".to_owned(),
            );
        }
        let Some(stats) = summary.stats else {
            differs(None, "statistics", "there are none".to_owned());
            return findings;
        };
        let (first, last) = self.span.unwrap_or_default();
        #[rustfmt::skip]
        let counts = [
            ("messages", stats.message_count, self.messages.values().sum()),
            ("schemas", stats.schema_count.into(), self.schemas.len() as u64),
            ("channels", stats.channel_count.into(), self.channels.len() as u64),
            ("attachments", stats.attachment_count.into(), self.attachments.len() as u64),
            ("metadata records", stats.metadata_count.into(), self.metadata.len() as u64),
            ("chunks", stats.chunk_count.into(), self.chunks.len() as u64),
            ("nanoseconds at the first message", stats.message_start_time, first),
            ("nanoseconds at the last message", stats.message_end_time, last),
        ];
        for (what, said, found) in counts {
            if said != found {
                differs(
                    None,
                    "statistics",
                    format!("{said} {what}, but there are {found}"),
                );
            }
        }
        if stats.channel_message_counts != self.messages {
            differs(
                None,
                "statistics",
                "the messages of each channel are miscounted".to_owned(),
            );
        }
        findings
    }
}

impl Chunk {
    fn new(at: At, header: &ChunkHeader) -> Self {
        let index = ChunkIndex {
            message_start_time: header.message_start_time,
            message_end_time: header.message_end_time,
            chunk_start_offset: at.offset,
            chunk_length: at.length,
            message_index_offsets: BTreeMap::new(),
            message_index_length: 0,
            compression: header.compression.clone(),
            compressed_size: header.compressed_size,
            uncompressed_size: header.uncompressed_size,
        };
        Self {
            index,
            messages: BTreeMap::new(),
            span: None,
        }
    }
}

/// The data is there in full; only finding it is not.
const INDEX_ADVICE: &str =
    "the content is whole: write the trace again with `reel trace compact` or `reel trace expand`";

fn widen(span: &mut Option<(u64, u64)>, time: u64) {
    let (first, last) = span.unwrap_or((time, time));
    *span = Some((first.min(time), last.max(time)));
}

fn first_difference<A, B>(a: &[A], b: &[B], equal: impl Fn(&A, &B) -> bool) -> Option<usize> {
    let common = a.iter().zip(b).position(|(a, b)| !equal(a, b));
    common.or_else(|| (a.len() != b.len()).then_some(a.len().min(b.len())))
}

/// An error of the reader as a finding.
fn finding(error: &TraceError, steps_before: u32, bytes: &[u8]) -> Finding {
    const RECOVER: &str = "`reel trace recover` restores the whole steps";
    const COPY: &str = "take another copy; `reel trace recover` restores the whole steps before it";
    const CHANGED: &str = "it was changed or written by another program; `reel trace recover` restores the steps before it";
    let offset = error.offset();
    let at = |offset: Option<u64>| {
        offset
            .map_or("trace", |offset| container::record_name(bytes, offset))
            .to_owned()
    };
    let mut step = steps_before.checked_sub(1);
    let (record, what, advice) = match error {
        TraceError::NotMcap { .. } => (
            at(offset),
            "they are not those of an MCAP file".to_owned(),
            RECOVER,
        ),
        TraceError::Torn { lost, .. } => (at(offset), lost.clone(), RECOVER),
        TraceError::Damaged { problem: what, .. } => (at(offset), what.clone(), COPY),
        TraceError::Message {
            topic,
            problem: what,
            ..
        } => (format!("message on {topic}"), what.clone(), CHANGED),
        TraceError::Missing { part: what, .. } => {
            ("trace".to_owned(), format!("it holds no {what}"), CHANGED)
        }
        TraceError::Attachment {
            attachment,
            expected,
            found,
            ..
        } => (
            format!("attachment {attachment}"),
            format!("its digest is {found}, but {expected} in the header"),
            COPY,
        ),
        TraceError::ChainBroken {
            step: broken,
            expected,
            found,
            ..
        } => {
            step = *broken;
            (
                "hash chain".to_owned(),
                format!("the records give {expected}, but {found} is written"),
                CHANGED,
            )
        }
        TraceError::Image {
            step: of,
            problem: what,
            ..
        } => {
            step = *of;
            let advice = "take another copy, or drop the images with `reel trace compact` and draw them again with `reel trace expand`";
            ("image".to_owned(), format!("it {what}"), advice)
        }
        other => ("trace".to_owned(), other.to_string(), COPY),
    };
    Finding {
        offset,
        record,
        step,
        message: what,
        advice: advice.to_owned(),
    }
}
