//! MCAP as a container: walking over its records with every checksum verified, and turning an unchunked
//! recording into a finished file. Knows nothing of what messages mean.

use std::{
    collections::{BTreeMap, BTreeSet},
    io,
    path::Path,
};

use mcap::{
    MAGIC, McapError, WriteOptions,
    records::{self, Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use crate::{TraceError, reader::Limits, schema};

/// Opcode and length in front of every record.
const RECORD_PREFIX: usize = 9;
/// Footer record with its prefix.
const FOOTER: usize = RECORD_PREFIX + 20;

/// A thing found in the data section.
pub(crate) enum Item<'a> {
    /// A metadata record.
    Metadata(&'a records::Metadata),
    /// An attachment.
    Attachment { header: &'a records::AttachmentHeader, data: &'a [u8] },
    /// A message.
    Message { header: &'a records::MessageHeader, topic: &'a str, data: &'a [u8] },
}

/// How the file ends.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Closing {
    /// With index, checksums and magic bytes.
    Finished,
    /// Behind a whole record of a recording that was not finished.
    Open,
}

/// Walks over the data section in file order and hands every item to `visit` with the offset of its record
/// (of its chunk, in a chunked file). A finished file is first verified as a whole: each of its bytes is
/// covered by a checksum or compared with the only value it may have.
///
/// # Errors
/// The first thing that is wrong; a torn end is a [`TraceError::Torn`] without the count of steps.
pub(crate) fn walk(
    bytes: &[u8],
    path: &Path,
    limits: &Limits,
    visit: &mut dyn FnMut(u64, Item) -> Result<(), TraceError>,
) -> Result<Closing, TraceError> {
    let mut walk = Walk { bytes, path, limits, topics: BTreeMap::new(), schemas: BTreeMap::new(), chunked: false };
    if !bytes.starts_with(MAGIC) {
        return Err(TraceError::NotMcap { path: path.to_owned() });
    }
    let mut position = MAGIC.len();
    loop {
        let Some((opcode, body)) = walk.record_at(position)? else {
            return if walk.chunked { Err(walk.torn(position, "index and checksums")) } else { Ok(Closing::Open) };
        };
        if opcode == op::DATA_END {
            walk.verify_closing(position, body)?;
            return Ok(Closing::Finished);
        }
        walk.data_record(position, opcode, body, visit)?;
        position += RECORD_PREFIX + body.len();
    }
}

/// Writes the finished form of an unchunked recording: same items, chunks, index and checksums.
pub(crate) fn finish(part: &[u8], path: &Path, limits: &Limits) -> Result<Vec<u8>, TraceError> {
    let failed = |error: McapError| TraceError::Io { action: "finish", path: path.to_owned(), source: io::Error::other(error) };
    let options = WriteOptions::new().library(LIBRARY).chunk_size(Some(CHUNK_BYTES)).compression_threads(0);
    let mut writer = options.create(io::Cursor::new(Vec::new())).map_err(failed)?;
    let mut announced = BTreeSet::new();
    walk(part, path, limits, &mut |_, item| match item {
        Item::Metadata(metadata) => writer.write_metadata(metadata).map_err(failed),
        Item::Attachment { header, data } => writer.attach(&attachment(header.clone(), data)).map_err(failed),
        Item::Message { header, topic, data } => {
            if let Some(channel) = schema::channel(topic).filter(|channel| announced.insert(channel.id)) {
                announce(&mut writer, &channel).map_err(failed)?;
            }
            writer.write_to_known_channel(header, data).map_err(failed)
        }
    })?;
    writer.finish().map_err(failed)?;
    Ok(writer.into_inner().into_inner())
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
    writer.add_schema_with_id(channel.id, channel.message, "protobuf", &schema::descriptor_set(channel))?;
    writer.add_channel_with_id(channel.id, channel.id, channel.topic, "protobuf", &BTreeMap::new())?;
    Ok(())
}

/// An attachment in the form that the writer takes.
pub(crate) fn attachment(header: records::AttachmentHeader, data: &[u8]) -> mcap::Attachment<'_> {
    let records::AttachmentHeader { log_time, create_time, name, media_type } = header;
    mcap::Attachment { log_time, create_time, name, media_type, data: data.into() }
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
        let torn = || self.torn(position, "the last record is not whole");
        let (prefix, rest) = rest.split_at_checked(RECORD_PREFIX).ok_or_else(torn)?;
        let length = u64::from_le_bytes(prefix[1..].try_into().expect("a prefix is an opcode and eight bytes"));
        let body = usize::try_from(length).ok().and_then(|length| rest.get(..length)).ok_or_else(torn)?;
        Ok(Some((prefix[0], body)))
    }

    fn data_record(
        &mut self,
        offset: usize,
        opcode: u8,
        body: &[u8],
        visit: &mut dyn FnMut(u64, Item) -> Result<(), TraceError>,
    ) -> Result<(), TraceError> {
        if opcode != op::CHUNK {
            return self.record(offset, opcode, body, visit);
        }
        self.chunked = true;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(self.limits.chunk_bytes);
        let mut reader = LinearReader::new_with_options(options);
        let mut input = &self.bytes[offset..offset + RECORD_PREFIX + body.len()];
        while let Some(event) = reader.next_event() {
            match event.map_err(|error| self.damaged(offset, &error))? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let (now, later) = input.split_at(wanted.min(input.len()));
                    reader.insert(now.len()).copy_from_slice(now);
                    reader.notify_read(now.len());
                    input = later;
                }
                LinearReadEvent::Record { opcode, data } => self.record(offset, opcode, data, visit)?,
            }
        }
        Ok(())
    }

    fn record(
        &mut self,
        offset: usize,
        opcode: u8,
        body: &[u8],
        visit: &mut dyn FnMut(u64, Item) -> Result<(), TraceError>,
    ) -> Result<(), TraceError> {
        if opcode == op::ATTACHMENT && !attachment_is_whole(body) {
            return Err(self.damaged(offset, &"an attachment is shorter than it says"));
        }
        let record = mcap::parse_record(opcode, body).map_err(|error| self.damaged(offset, &error))?;
        let offset_u64 = offset as u64;
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, (header.name, header.encoding));
            }
            Record::Channel(channel) => self.add_channel(offset, channel)?,
            Record::Metadata(metadata) => visit(offset_u64, Item::Metadata(&metadata))?,
            Record::Attachment { header, data, .. } => visit(offset_u64, Item::Attachment { header: &header, data: &data })?,
            Record::Message { header, data } => {
                let Some(topic) = self.topics.get(&header.channel_id) else {
                    return Err(self.damaged(offset, &format!("a message names the unknown channel {}", header.channel_id)));
                };
                visit(offset_u64, Item::Message { header: &header, topic, data: &data })?;
            }
            Record::Header(_) | Record::MessageIndex(_) => {}
            _ => return Err(self.damaged(offset, &format!("a record with opcode {opcode:#04x} is out of place"))),
        }
        Ok(())
    }

    fn add_channel(&mut self, offset: usize, channel: records::Channel) -> Result<(), TraceError> {
        if let Some(known) = schema::channel(&channel.topic) {
            let schema = self.schemas.get(&channel.schema_id).map(|(name, encoding)| (name.as_str(), encoding.as_str()));
            if schema != Some((known.message, "protobuf")) || channel.message_encoding != "protobuf" {
                let what = format!("its schema is {schema:?}, but must be {} in protobuf", known.message);
                return Err(TraceError::Message { path: self.path.into(), offset: offset as u64, topic: channel.topic, what });
            }
        }
        self.topics.insert(channel.id, channel.topic);
        Ok(())
    }

    /// Everything from the end of the data section on, and the checksum over all that is before it.
    fn verify_closing(&self, data_end: usize, body: &[u8]) -> Result<(), TraceError> {
        let summary = data_end + RECORD_PREFIX + body.len();
        let Some(footer) = self.bytes.len().checked_sub(FOOTER + MAGIC.len()).filter(|footer| *footer >= summary) else {
            return Err(self.torn(data_end, "the index is not whole"));
        };
        if !self.bytes.ends_with(MAGIC) {
            return Err(self.torn(data_end, "the file does not end with the magic bytes"));
        }
        if *body != crc32fast::hash(&self.bytes[..data_end]).to_le_bytes() {
            return Err(self.damaged(data_end, &"the checksum of the data section is wrong"));
        }
        let (prefix, fields) = self.bytes[footer..].split_at(RECORD_PREFIX);
        if prefix != [op::FOOTER, 20, 0, 0, 0, 0, 0, 0, 0] || fields[..8] != (summary as u64).to_le_bytes() {
            return Err(self.damaged(footer, &"the footer is wrong"));
        }
        if fields[16..20] != crc32fast::hash(&self.bytes[summary..footer + RECORD_PREFIX + 16]).to_le_bytes() {
            return Err(self.damaged(footer, &"the checksum of the index is wrong"));
        }
        Ok(())
    }

    fn torn(&self, offset: usize, lost: &str) -> TraceError {
        TraceError::Torn { path: self.path.into(), offset: offset as u64, steps_readable: 0, lost: lost.into() }
    }

    fn damaged(&self, offset: usize, what: &dyn std::fmt::Display) -> TraceError {
        TraceError::Damaged { path: self.path.into(), offset: offset as u64, what: what.to_string() }
    }
}

/// Whether an attachment's lengths fit its record; the parser trusts them.
fn attachment_is_whole(body: &[u8]) -> bool {
    let text = |body: &[u8]| -> Option<usize> { Some(u32::from_le_bytes(*body.first_chunk()?) as usize + 4) };
    let header = || {
        let name = 16 + text(body.get(16..)?)?;
        let media_type = name + text(body.get(name..)?)?;
        let length = u64::from_le_bytes(*body.get(media_type..)?.first_chunk()?);
        Some((media_type as u64 + 8 + 4).checked_add(length)? == body.len() as u64)
    };
    header().unwrap_or(false)
}
