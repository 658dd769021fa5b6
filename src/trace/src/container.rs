//! MCAP as a container: walking over its records with every checksum verified, and turning an
//! unchunked recording into a finished file. Knows nothing of what messages mean.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
    io,
    path::Path,
};

use mcap::{
    MAGIC, McapError, WriteOptions,
    records::{self, Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use crate::{TraceError, image, lengths, limits::Limits, schema, sensors, unpack::Unpacked};

/// Opcode and length in front of every record.
pub(crate) const RECORD_PREFIX: usize = 9;
/// Footer record with its prefix.
pub(crate) const FOOTER: usize = RECORD_PREFIX + 20;

/// What is wrong with a record whose lengths lead out of it.
const SHORTER: &str = "a record is shorter than it says";

/// What is wrong with a chunk, in the same words everywhere: whether zstd notices a changed byte, or only the
/// checksum does, depends on how zstd was built.
fn problem_of_chunk(error: &McapError) -> String {
    match error {
        McapError::BadChunkCrc { .. } | McapError::DecompressionError(_) => {
            "the content of a chunk was changed".to_owned()
        }
        other => other.to_string(),
    }
}

/// A thing found in the data section.
pub(crate) enum Item<'a> {
    /// A schema record, with its header and encoded data.
    Schema {
        header: &'a records::SchemaHeader,
        data: &'a [u8],
    },
    /// A channel record, which binds a topic to a schema.
    Channel(&'a records::Channel),
    /// A chunk, before what it holds.
    Chunk(&'a records::ChunkHeader),
    /// The index of one channel in the chunk before it.
    MessageIndex(&'a records::MessageIndex),
    /// A metadata record: a name with pairs of strings.
    Metadata(&'a records::Metadata),
    /// An attachment record, with its header and data.
    Attachment {
        header: &'a records::AttachmentHeader,
        data: &'a [u8],
    },
    /// A message record, with the topic of its channel.
    Message {
        header: &'a records::MessageHeader,
        topic: &'a str,
        data: &'a [u8],
    },
}

/// Where an item stands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct At {
    /// Offset of its record in the file; in a chunk, of the chunk.
    pub offset: u64,
    /// Length of that record in bytes, prefix included.
    pub length: u64,
    /// Offset of its own record in the decompressed chunk, if it is in one.
    pub in_chunk: Option<u64>,
    /// False in a chunk that is torn or whose checksum does not hold: its bytes are what they are.
    pub verified: bool,
}

/// Takes what [`walk`] finds. Closures over [`At`] and [`Item`] are visitors that stop
/// at the first problem.
pub(crate) trait Visitor {
    /// The next thing of the file.
    fn item(&mut self, at: At, item: Item) -> Result<(), TraceError>;

    /// Something of the container is wrong; an error stops the walk.
    fn problem(&mut self, problem: TraceError) -> Result<(), TraceError> {
        Err(problem)
    }
}

impl<F: FnMut(At, Item) -> Result<(), TraceError>> Visitor for F {
    fn item(&mut self, at: At, item: Item) -> Result<(), TraceError> {
        self(at, item)
    }
}

/// How the file ends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Closing {
    /// With index, checksums and magic bytes; where they are wrong, the visitor heard of it.
    Finished,
    /// Behind a whole record of a recording that was not finished.
    Open,
    /// In the middle; the visitor heard where.
    Torn,
}

/// Walks over the data section in file order and hands every item to the visitor. Each byte of a
/// finished file is covered by a checksum or compared with the only value it may have. A visitor
/// that goes on after a problem gets what still can be read: the rest of the file, and the records
/// of a torn chunk as far as it decompresses.
///
/// # Errors
/// What the visitor returns; by itself only [`TraceError::NotMcap`]. A torn end is a
/// [`TraceError::Torn`] without the count of steps.
pub(crate) fn walk(
    bytes: &[u8],
    path: &Path,
    limits: &Limits,
    visitor: &mut dyn Visitor,
) -> Result<Closing, TraceError> {
    let mut walk = Walk {
        bytes,
        path,
        limits,
        topics: BTreeMap::new(),
        schemas: BTreeMap::new(),
        chunked: false,
    };
    if !bytes.starts_with(MAGIC) {
        return Err(TraceError::NotMcap {
            path: path.to_owned(),
        });
    }
    let mut position = MAGIC.len();
    loop {
        match walk.record_at(position) {
            Ok(Some((op::DATA_END, body))) => {
                walk.verify_closing(position, body, visitor)?;
                return Ok(Closing::Finished);
            }
            Ok(Some((opcode, body))) => {
                walk.data_record(position, opcode, body, visitor)?;
                position += RECORD_PREFIX + body.len();
            }
            Ok(None) if walk.chunked => {
                visitor.problem(walk.torn(position, "index and checksums"))?;
                return Ok(Closing::Torn);
            }
            Ok(None) => return Ok(Closing::Open),
            Err(torn) => {
                visitor.problem(torn)?;
                if bytes[position] == op::CHUNK {
                    walk.chunk_records(position, &bytes[position..], false, visitor)?;
                }
                return Ok(Closing::Torn);
            }
        }
    }
}

/// The first record: opcode, body, and what is behind it. None where it is not whole.
pub(crate) fn first_record(bytes: &[u8]) -> Option<(u8, &[u8], &[u8])> {
    let (prefix, rest) = bytes.split_at_checked(RECORD_PREFIX)?;
    let length = u64::from_le_bytes(
        prefix[1..]
            .try_into()
            .expect("a prefix is an opcode and eight bytes"),
    );
    let (body, after) = rest.split_at_checked(usize::try_from(length).ok()?)?;
    Some((prefix[0], body, after))
}

/// What the record at an offset is called.
pub(crate) fn record_name(bytes: &[u8], offset: u64) -> &'static str {
    let opcode = usize::try_from(offset)
        .ok()
        .and_then(|offset| bytes.get(offset))
        .copied();
    match opcode {
        None => "end of the file",
        Some(_) if offset < MAGIC.len() as u64 => "magic bytes",
        Some(op::HEADER) => "header",
        Some(op::FOOTER) => "footer",
        Some(op::SCHEMA) => "schema",
        Some(op::CHANNEL) => "channel",
        Some(op::MESSAGE) => "message",
        Some(op::CHUNK) => "chunk",
        Some(op::MESSAGE_INDEX) => "message index",
        Some(op::CHUNK_INDEX) => "chunk index",
        Some(op::ATTACHMENT) => "attachment",
        Some(op::ATTACHMENT_INDEX) => "attachment index",
        Some(op::STATISTICS) => "statistics",
        Some(op::METADATA) => "metadata",
        Some(op::METADATA_INDEX) => "metadata index",
        Some(op::SUMMARY_OFFSET) => "summary offset",
        Some(op::DATA_END) => "end of the data section",
        Some(_) => "unknown record",
    }
}

/// Writes the finished form of an unchunked recording: same items, chunks, index and checksums.
pub(crate) fn finish(part: &[u8], path: &Path, limits: &Limits) -> Result<Vec<u8>, TraceError> {
    let failed = |error: McapError| TraceError::Io {
        action: "finish",
        path: path.to_owned(),
        source: io::Error::other(error),
    };
    let options = WriteOptions::new()
        .library(LIBRARY)
        .chunk_size(Some(CHUNK_BYTES))
        .compression_threads(0);
    let mut writer = options
        .create(io::Cursor::new(Vec::new()))
        .map_err(failed)?;
    let mut announced = BTreeSet::new();
    let mut schemas = BTreeSet::new();
    let mut write = |_: At, item: Item| match item {
        Item::Metadata(metadata) => writer.write_metadata(metadata).map_err(failed),
        Item::Attachment { header, data } => writer
            .attach(&attachment(header.clone(), data))
            .map_err(failed),
        Item::Message {
            header,
            topic,
            data,
        } => {
            let data = match topic == schema::CAMERA.topic {
                true => image::finished_message(data),
                false => Some(Cow::Borrowed(data)),
            };
            // What is no image cannot be shown: it is left out.
            let Some(data) = data else { return Ok(()) };
            if let Some(channel) =
                schema::channel(topic).filter(|channel| announced.insert(channel.id))
            {
                announce(&mut writer, &channel).map_err(failed)?;
            }
            writer.write_to_known_channel(header, &data).map_err(failed)
        }
        // Those of sensors are written as they came, the others before their first message.
        Item::Schema { header, data } => {
            if sensors::is_recorded_id(header.id) && schemas.insert(header.id) {
                return writer
                    .add_schema_with_id(header.id, &header.name, &header.encoding, data)
                    .map(drop)
                    .map_err(failed);
            }
            Ok(())
        }
        Item::Channel(channel) if sensors::is_recorded(&channel.topic) => writer
            .add_channel_with_id(
                channel.id,
                channel.schema_id,
                &channel.topic,
                &channel.message_encoding,
                &channel.metadata,
            )
            .map(drop)
            .map_err(failed),
        // The writer makes them itself.
        Item::Channel(_) | Item::Chunk(_) | Item::MessageIndex(_) => Ok(()),
    };
    walk(part, path, limits, &mut write)?;
    writer.finish().map_err(failed)?;
    Ok(writer.into_inner().into_inner())
}

/// A finished file that holds nothing but a metadata record.
pub(crate) fn only_metadata(
    name: &str,
    metadata: BTreeMap<String, String>,
) -> Result<Vec<u8>, TraceError> {
    let write = || {
        let options = WriteOptions::new().library(LIBRARY).compression_threads(0);
        let mut writer = options.create(io::Cursor::new(Vec::new()))?;
        writer.write_metadata(&records::Metadata {
            name: name.to_owned(),
            metadata,
        })?;
        writer.finish()?;
        Ok(writer.into_inner().into_inner())
    };
    write().map_err(|error: McapError| TraceError::Io {
        action: "finish",
        path: name.into(),
        source: io::Error::other(error),
    })
}

/// Bytes of messages in a chunk before it is closed.
const CHUNK_BYTES: u64 = 1 << 20;
/// Named in the file's header record; no version, so that equal episodes give equal bytes.
pub(crate) const LIBRARY: &str = "reel";

/// Writes a channel and its schema, before its first message.
pub(crate) fn announce<W: io::Write + io::Seek>(
    writer: &mut mcap::Writer<W>,
    channel: &schema::Channel,
) -> Result<(), McapError> {
    writer.add_schema_with_id(
        channel.id,
        channel.message,
        "protobuf",
        schema::descriptor_set(channel),
    )?;
    writer.add_channel_with_id(
        channel.id,
        channel.id,
        channel.topic,
        "protobuf",
        &BTreeMap::new(),
    )?;
    Ok(())
}

/// An attachment in the form that the writer takes.
pub(crate) fn attachment(header: records::AttachmentHeader, data: &[u8]) -> mcap::Attachment<'_> {
    let records::AttachmentHeader {
        log_time,
        create_time,
        name,
        media_type,
    } = header;
    mcap::Attachment {
        log_time,
        create_time,
        name,
        media_type,
        data: data.into(),
    }
}

struct Walk<'a> {
    bytes: &'a [u8],
    path: &'a Path,
    limits: &'a Limits,
    schemas: BTreeMap<u16, (String, String)>,
    topics: BTreeMap<u16, String>,
    chunked: bool,
}

impl<'a> Walk<'a> {
    /// The record at a position; none at the end of the file.
    fn record_at(&self, position: usize) -> Result<Option<(u8, &'a [u8])>, TraceError> {
        let rest = &self.bytes[position..];
        if rest.is_empty() {
            return Ok(None);
        }
        let (opcode, body, _) = first_record(rest)
            .ok_or_else(|| self.torn(position, "the last record is not whole"))?;
        Ok(Some((opcode, body)))
    }

    fn data_record(
        &mut self,
        offset: usize,
        opcode: u8,
        body: &[u8],
        visitor: &mut dyn Visitor,
    ) -> Result<(), TraceError> {
        let length = RECORD_PREFIX + body.len();
        let at = At {
            offset: offset as u64,
            length: length as u64,
            in_chunk: None,
            verified: true,
        };
        if opcode != op::CHUNK {
            return self.record(at, opcode, body, visitor);
        }
        if !lengths::fit(opcode, body) {
            return visitor.problem(self.damaged(offset, &SHORTER));
        }
        match mcap::parse_record(opcode, body) {
            Ok(Record::Chunk { header, data }) => {
                visitor.item(at, Item::Chunk(&header))?;
                if let Some(unpacked) = Unpacked::of(&header, &data, self.limits.chunk_bytes) {
                    self.chunked = true;
                    return self.unpacked_records(at, &unpacked, visitor);
                }
            }
            Ok(_) => {}
            Err(error) => visitor.problem(self.damaged(offset, &error))?,
        }
        self.chunk_records(offset, &self.bytes[offset..offset + length], true, visitor)
    }

    /// The records of a sound chunk.
    fn unpacked_records(
        &mut self,
        chunk: At,
        unpacked: &Unpacked,
        visitor: &mut dyn Visitor,
    ) -> Result<(), TraceError> {
        let mut position = 0;
        unpacked.records().try_for_each(|(opcode, body)| {
            let at = At {
                in_chunk: Some(position),
                ..chunk
            };
            position += (RECORD_PREFIX + body.len()) as u64;
            self.record(at, opcode, body, visitor)
        })
    }

    /// The records of a chunk, one after the other. Where the chunk is not whole or its checksum
    /// does not hold, those that can be decompressed, as not verified.
    fn chunk_records(
        &mut self,
        offset: usize,
        chunk: &[u8],
        whole: bool,
        visitor: &mut dyn Visitor,
    ) -> Result<(), TraceError> {
        self.chunked = true;
        let mut verify = whole;
        loop {
            let options = LinearReaderOptions::default()
                .with_skip_start_magic(true)
                .with_skip_end_magic(true)
                .with_prevalidate_chunk_crcs(verify)
                .with_record_length_limit(self.limits.chunk_bytes);
            match self.read_chunk(
                offset,
                chunk,
                LinearReader::new_with_options(options),
                verify,
                visitor,
            )? {
                Some((error, any)) if verify => {
                    visitor.problem(self.damaged(offset, &problem_of_chunk(&error)))?;
                    if any {
                        return Ok(());
                    }
                }
                _ => return Ok(()),
            }
            verify = false;
            // What the header promises bounds what decompression may give.
            let promised = chunk
                .get(RECORD_PREFIX + 16..RECORD_PREFIX + 24)
                .and_then(|size| size.first_chunk());
            if promised
                .is_none_or(|size| u64::from_le_bytes(*size) > self.limits.chunk_bytes as u64)
            {
                return Ok(());
            }
        }
    }

    /// Reads records until one fails; says why, and whether any was handed out before.
    fn read_chunk(
        &mut self,
        offset: usize,
        chunk: &[u8],
        mut reader: LinearReader,
        verified: bool,
        visitor: &mut dyn Visitor,
    ) -> Result<Option<(McapError, bool)>, TraceError> {
        let mut at = At {
            offset: offset as u64,
            length: chunk.len() as u64,
            in_chunk: Some(0),
            verified,
        };
        let mut input = chunk;
        while let Some(event) = reader.next_event() {
            match event {
                Err(error) => return Ok(Some((error, at.in_chunk != Some(0)))),
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let (now, later) = input.split_at(wanted.min(input.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    reader.notify_read(now.len());
                    input = later;
                }
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    self.record(at, opcode, data, visitor)?;
                    at.in_chunk = at
                        .in_chunk
                        .map(|position| position + (RECORD_PREFIX + data.len()) as u64);
                }
            }
        }
        Ok(None)
    }

    fn record(
        &mut self,
        at: At,
        opcode: u8,
        body: &[u8],
        visitor: &mut dyn Visitor,
    ) -> Result<(), TraceError> {
        let offset = at.offset as usize;
        if opcode == op::ATTACHMENT && !attachment_is_whole(body) {
            return visitor.problem(self.damaged(offset, &"an attachment is shorter than it says"));
        }
        if !lengths::fit(opcode, body) {
            return visitor.problem(self.damaged(offset, &SHORTER));
        }
        let record = match mcap::parse_record(opcode, body) {
            Ok(record) => record,
            Err(error) => return visitor.problem(self.damaged(offset, &error)),
        };
        match record {
            Record::Schema { header, data } => {
                visitor.item(
                    at,
                    Item::Schema {
                        header: &header,
                        data: &data,
                    },
                )?;
                self.schemas
                    .insert(header.id, (header.name, header.encoding));
                Ok(())
            }
            Record::Channel(channel) => {
                visitor.item(at, Item::Channel(&channel))?;
                self.add_channel(at.offset, channel, visitor)
            }
            Record::Metadata(metadata) => visitor.item(at, Item::Metadata(&metadata)),
            Record::Attachment { header, data, .. } => visitor.item(
                at,
                Item::Attachment {
                    header: &header,
                    data: &data,
                },
            ),
            Record::Message { header, data } => match self.topics.get(&header.channel_id) {
                Some(topic) => visitor.item(
                    at,
                    Item::Message {
                        header: &header,
                        topic,
                        data: &data,
                    },
                ),
                None => {
                    let what = format!("a message names the unknown channel {}", header.channel_id);
                    visitor.problem(self.damaged(offset, &what))
                }
            },
            Record::MessageIndex(index) => visitor.item(at, Item::MessageIndex(&index)),
            Record::Header(_) => Ok(()),
            _ => visitor.problem(self.damaged(
                offset,
                &format!("a record with opcode {opcode:#04x} is out of place"),
            )),
        }
    }

    fn add_channel(
        &mut self,
        offset: u64,
        channel: records::Channel,
        visitor: &mut dyn Visitor,
    ) -> Result<(), TraceError> {
        let mut topic = channel.topic;
        if let Some(known) = schema::channel(&topic) {
            let schema = self
                .schemas
                .get(&channel.schema_id)
                .map(|(name, encoding)| (name.as_str(), encoding.as_str()));
            if schema != Some((known.message, "protobuf")) || channel.message_encoding != "protobuf"
            {
                let what = format!(
                    "its schema is {schema:?}, but must be {} in protobuf",
                    known.message
                );
                // Its messages are nobody's then.
                let topic = std::mem::take(&mut topic);
                visitor.problem(TraceError::Message {
                    path: self.path.into(),
                    offset,
                    topic,
                    problem: what,
                })?;
            }
        }
        self.topics.insert(channel.id, topic);
        Ok(())
    }

    /// Everything from the end of the data section on, and the checksum over all that is before it.
    fn verify_closing(
        &self,
        data_end: usize,
        body: &[u8],
        visitor: &mut dyn Visitor,
    ) -> Result<(), TraceError> {
        let summary = data_end + RECORD_PREFIX + body.len();
        let Some(footer) = self
            .bytes
            .len()
            .checked_sub(FOOTER + MAGIC.len())
            .filter(|footer| *footer >= summary)
        else {
            return visitor.problem(self.torn(data_end, "the index is not whole"));
        };
        if !self.bytes.ends_with(MAGIC) {
            return visitor
                .problem(self.torn(data_end, "the file does not end with the magic bytes"));
        }
        if *body != crc32fast::hash(&self.bytes[..data_end]).to_le_bytes() {
            visitor
                .problem(self.damaged(data_end, &"the checksum of the data section is wrong"))?;
        }
        let (prefix, fields) = self.bytes[footer..].split_at(RECORD_PREFIX);
        if prefix != [op::FOOTER, 20, 0, 0, 0, 0, 0, 0, 0]
            || fields[..8] != (summary as u64).to_le_bytes()
        {
            visitor.problem(self.damaged(footer, &"the footer is wrong"))?;
        }
        if fields[16..20]
            != crc32fast::hash(&self.bytes[summary..footer + RECORD_PREFIX + 16]).to_le_bytes()
        {
            visitor.problem(self.damaged(footer, &"the checksum of the index is wrong"))?;
        }
        Ok(())
    }

    fn torn(&self, offset: usize, lost: &str) -> TraceError {
        TraceError::Torn {
            path: self.path.into(),
            offset: offset as u64,
            steps_readable: 0,
            lost: lost.into(),
        }
    }

    fn damaged(&self, offset: usize, what: &dyn std::fmt::Display) -> TraceError {
        TraceError::Damaged {
            path: self.path.into(),
            offset: offset as u64,
            problem: what.to_string(),
        }
    }
}

/// Whether an attachment's lengths fit its record; the parser trusts them.
pub(crate) fn attachment_is_whole(body: &[u8]) -> bool {
    let text = |body: &[u8]| -> Option<usize> {
        Some(u32::from_le_bytes(*body.first_chunk()?) as usize + 4)
    };
    let header = || {
        let name = 16 + text(body.get(16..)?)?;
        let media_type = name + text(body.get(name..)?)?;
        let length = u64::from_le_bytes(*body.get(media_type..)?.first_chunk()?);
        Some((media_type as u64 + 8 + 4).checked_add(length)? == body.len() as u64)
    };
    header().unwrap_or(false)
}
