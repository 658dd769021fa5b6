//! MCAP files of any origin, record by record: what can be read of a file that broke
//! off or is damaged is read, and what cannot is named. Holds one record at a time;
//! knows no meaning of messages.

use std::{
    fs::File,
    io::{self, BufReader, Read, Seek, SeekFrom},
    path::Path,
};

use mcap::{
    MAGIC, McapError,
    read::ChannelAccumulator,
    records::{Record, op},
    sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions},
};

use super::seconds;

/// Opcode and length in front of every record.
const PREFIX: usize = 9;
/// Footer with its prefix, and the magic bytes at the end.
const CLOSING: i64 = (PREFIX + 20 + MAGIC.len()) as i64;
/// Largest record, compressed or not.
const BYTES_MAX: u64 = 1 << 30;

/// Opcodes from here on are of private records, which are skipped.
const PRIVATE: u8 = 0x80;
/// Length of the record at the end of the data.
const DATA_END_BYTES: u64 = 4;
/// So much is read of a record to tell whether it is one.
const PROBED: u64 = 1 << 16;
/// So many bytes at a time are searched for the record behind a damaged one.
const SEARCHED: u64 = 1 << 16;
/// So many bytes hold what a chunk says of itself before its records.
const CHUNK_HEAD: u64 = 128;
/// So many records have to follow one that was found there.
const FOLLOWING: usize = 3;

/// A message of a file.
pub(crate) struct Message<'a> {
    /// How many messages of the file stand before it.
    pub number: u64,
    pub channel: &'a mcap::Channel<'static>,
    pub log_ns: u64,
    pub publish_ns: u64,
    pub data: &'a [u8],
}

/// Hands every message of a file to the visitor, in the order of the file and always the same ones
/// under the same numbers. Says what could not be read.
pub(crate) fn walk(path: &Path, visit: &mut dyn FnMut(Message<'_>)) -> Vec<String> {
    let file = match File::open(path) {
        Ok(file) => BufReader::with_capacity(1 << 16, file),
        Err(error) => return vec![format!("it cannot be read ({error})")],
    };
    let mut walk = Walk {
        size: file.get_ref().metadata().map_or(0, |file| file.len()),
        file,
        at: 0,
        channels: ChannelAccumulator::default(),
        summarised: ChannelAccumulator::default(),
        numbered: 0,
        unknown: 0,
        visit,
        lost: Vec::new(),
    };
    if let Err(error) = walk.file() {
        walk.lost.push(format!(
            "it cannot be read from byte {} on ({error}); what stands before it is imported",
            walk.at
        ));
    }
    if walk.unknown > 0 {
        walk.lost.push(format!(
            "{} messages are of topics that nothing in the file names any more",
            walk.unknown
        ));
    }
    walk.lost
}

struct Walk<'a> {
    file: BufReader<File>,
    /// Length of the file.
    size: u64,
    /// Where the next record begins.
    at: u64,
    channels: ChannelAccumulator<'static>,
    /// What the end of the file names, for topics whose own records are damaged.
    summarised: ChannelAccumulator<'static>,
    numbered: u64,
    /// Messages whose channel is not known.
    unknown: u64,
    visit: &'a mut dyn FnMut(Message<'_>),
    lost: Vec<String>,
}

/// Where a record ends that begins with these bytes at `at`; `None` if no record of a file of this size
/// begins so.
fn record_end(bytes: &[u8], at: u64, size: u64) -> Option<u64> {
    let (opcode, rest) = bytes.split_first()?;
    let length = u64::from_le_bytes(*rest.first_chunk()?);
    let is_one = is_record(*opcode, length, size.saturating_sub(at));
    is_one.then(|| at + PREFIX as u64 + length)
}

/// Whether a record may have this opcode and length where so many bytes are left: one of the
/// specification, or a private one.
fn is_record(opcode: u8, length: u64, left: u64) -> bool {
    let known = match opcode {
        op::DATA_END => length == DATA_END_BYTES,
        op::HEADER..=op::SUMMARY_OFFSET => true,
        private => private >= PRIVATE,
    };
    known && length <= left.saturating_sub(PREFIX as u64)
}

impl Walk<'_> {
    fn file(&mut self) -> io::Result<()> {
        let magic = self.read(MAGIC.len() as u64)?;
        if magic != MAGIC {
            self.lost.push("it is no MCAP file".to_owned());
            return Ok(());
        }
        // Topics are named in chunks, any of which may be damaged, and again at the end.
        self.summary();
        self.at = MAGIC.len() as u64;
        self.file.seek(SeekFrom::Start(self.at))?;
        while let Some((opcode, length)) = self.prefix()? {
            if opcode == op::DATA_END && length == DATA_END_BYTES {
                return Ok(());
            }
            if !is_record(opcode, length, self.size.saturating_sub(self.at)) {
                let torn = opcode == op::CHUNK && self.is_chunk_of(length)?;
                let next = if torn { None } else { self.next_record()? };
                if let Some(next) = next {
                    self.lost.push(format!(
                        "bytes {} to {} are damaged and left out",
                        self.at,
                        next - 1
                    ));
                    self.at = next;
                    self.file.seek(SeekFrom::Start(next))?;
                    continue;
                }
                self.file.seek(SeekFrom::Start(self.at + PREFIX as u64))?;
            }
            let wanted = matches!(opcode, op::CHUNK | op::MESSAGE | op::CHANNEL | op::SCHEMA);
            if wanted && length > BYTES_MAX {
                self.lost
                    .push(format!("the record at byte {} would have {length} bytes; nothing is read from there on", self.at));
                return Ok(());
            }
            let (body, found) = match wanted {
                true => {
                    let body = self.read(length)?;
                    let found = body.len() as u64;
                    (body, found)
                }
                false => (
                    Vec::new(),
                    io::copy(&mut self.file.by_ref().take(length), &mut io::sink())?,
                ),
            };
            match opcode {
                op::CHUNK => self.chunk(length, &body),
                _ if found < length => {}
                _ => self.record(opcode, &body),
            }
            if found < length {
                break;
            }
            self.at += PREFIX as u64 + length;
        }
        self.lost.push(format!(
            "the recording breaks off at byte {}; what stands before it is imported",
            self.at
        ));
        Ok(())
    }

    /// Whether the chunk that begins here says itself that it has this length: then the file breaks off in
    /// it.
    fn is_chunk_of(&mut self, length: u64) -> io::Result<bool> {
        self.file.seek(SeekFrom::Start(self.at + PREFIX as u64))?;
        let head = self.read(CHUNK_HEAD)?;
        // Two times, two lengths and a checksum, and between them the name of the compression.
        let name = head.get(28..).and_then(|rest| rest.first_chunk());
        let Some(name) = name.map(|name| u64::from(u32::from_le_bytes(*name))) else {
            return Ok(false);
        };
        let records = usize::try_from(32 + name)
            .ok()
            .and_then(|from| head.get(from..)?.first_chunk());
        let records = records.map(|records| u64::from_le_bytes(*records));
        Ok(records.and_then(|records| records.checked_add(40 + name)) == Some(length))
    }

    /// Where the next record begins after one that cannot be one: the first place from which records
    /// follow each other. `None` where there is none, as where the file breaks off.
    fn next_record(&mut self) -> io::Result<Option<u64>> {
        let mut from = self.at + 1;
        while from < self.size {
            self.file.seek(SeekFrom::Start(from))?;
            let bytes = self.read(SEARCHED + PREFIX as u64)?;
            let places = bytes.len().saturating_sub(PREFIX);
            for place in 0..places {
                let at = from + place as u64;
                if let Some(end) = record_end(&bytes[place..], at, self.size)
                    && self.follows(at, end)?
                {
                    return Ok(Some(at));
                }
            }
            from += SEARCHED;
        }
        Ok(None)
    }

    /// Whether a record from `at` to `end` can be read, and so many others come right behind it.
    fn follows(&mut self, at: u64, mut end: u64) -> io::Result<bool> {
        for _ in 0..FOLLOWING {
            self.file.seek(SeekFrom::Start(end))?;
            let prefix = self.read(PREFIX as u64)?;
            // Behind the last record there is nothing, or the file says that it is whole.
            if prefix.is_empty() || prefix.starts_with(MAGIC) {
                break;
            }
            match record_end(&prefix, end, self.size) {
                Some(next) => end = next,
                None => return Ok(false),
            }
        }
        self.file.seek(SeekFrom::Start(at))?;
        Ok(match self.prefix()? {
            Some((opcode @ (op::SCHEMA | op::CHANNEL | op::MESSAGE), length)) => {
                let body = self.read(length.min(PROBED))?;
                // A long message is known by its head.
                (length > PROBED && opcode == op::MESSAGE)
                    || mcap::parse_record(opcode, &body).is_ok()
            }
            Some(_) => true,
            None => false,
        })
    }

    /// Opcode and length of the next record; none where the file ends.
    fn prefix(&mut self) -> io::Result<Option<(u8, u64)>> {
        let prefix = self.read(PREFIX as u64)?;
        let Some((opcode, length)) = prefix.split_first() else {
            return Ok(None);
        };
        Ok(length
            .try_into()
            .ok()
            .map(|length| (*opcode, u64::from_le_bytes(length))))
    }

    /// So many bytes, or fewer where the file ends.
    fn read(&mut self, length: u64) -> io::Result<Vec<u8>> {
        let mut bytes = Vec::new();
        self.file.by_ref().take(length).read_to_end(&mut bytes)?;
        Ok(bytes)
    }

    /// Learns the topics that stand at the end of a finished file; one that is not
    /// finished has none there.
    fn summary(&mut self) {
        let footer = self
            .file
            .seek(SeekFrom::End(-CLOSING))
            .and_then(|_| self.read(CLOSING as u64));
        let Some((op::FOOTER, rest)) = footer
            .as_ref()
            .ok()
            .and_then(|bytes| bytes.split_first())
            .map(|(op, rest)| (*op, rest))
        else {
            return;
        };
        let start = rest
            .get(PREFIX - 1..)
            .and_then(|rest| rest.first_chunk())
            .map(|start| u64::from_le_bytes(*start));
        let Some(start) = start.filter(|start| *start > 0 && rest.ends_with(MAGIC)) else {
            return;
        };
        if self.file.seek(SeekFrom::Start(start)).is_err() {
            return;
        }
        while let Ok(Some((opcode @ (op::SCHEMA | op::CHANNEL), length))) = self.prefix() {
            match self.read(length.min(BYTES_MAX)) {
                // A damaged summary is no loss: the data names its topics itself.
                Ok(body) if body.len() as u64 == length => {
                    drop(learn(&mut self.summarised, opcode, &body));
                }
                _ => return,
            }
        }
    }

    /// The records of a chunk: all of them if its checksum holds, and as far as they go where the
    /// file ends in it.
    fn chunk(&mut self, length: u64, body: &[u8]) {
        let torn = (body.len() as u64) < length;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(!torn)
            .with_record_length_limit(BYTES_MAX as usize);
        let mut reader = LinearReader::new_with_options(options);
        let mut prefix = vec![op::CHUNK];
        prefix.extend(length.to_le_bytes());
        let mut input = prefix.as_slice().chain(body);
        while let Some(event) = reader.next_event() {
            match event {
                Ok(LinearReadEvent::ReadRequest(wanted)) => {
                    let room = reader.insert(wanted.min(PREFIX + body.len()));
                    let read = input.read(room).expect("memory can be read");
                    reader.notify_read(read);
                }
                Ok(LinearReadEvent::Record { opcode, data }) => {
                    let data = data.to_vec();
                    self.record(opcode, &data);
                }
                // That the file ends here is said once.
                Err(_) if torn => return,
                Err(error) => return self.damaged(body, &error),
            }
        }
    }

    fn damaged(&mut self, chunk: &[u8], error: &McapError) {
        let time = |from: usize| {
            chunk
                .get(from..)
                .and_then(|rest| rest.first_chunk())
                .map(|ns| seconds(u64::from_le_bytes(*ns)))
        };
        let when = match (time(0), time(8)) {
            (Some(first), Some(last)) => format!(", with the messages from {first} to {last},"),
            _ => String::new(),
        };
        self.lost.push(format!(
            "the chunk at byte {}{when} is damaged ({error}) and left out",
            self.at
        ));
    }

    fn record(&mut self, opcode: u8, body: &[u8]) {
        if opcode != op::MESSAGE {
            return self.name(opcode, body);
        }
        let Ok(Record::Message { header, data }) = mcap::parse_record(opcode, body) else {
            self.lost
                .push(format!("a message at byte {} has no head", self.at));
            return;
        };
        let number = self.numbered;
        self.numbered += 1;
        let id = header.channel_id;
        match self.channels.get(id).or_else(|| self.summarised.get(id)) {
            Some(channel) => {
                let (log_ns, publish_ns) = (header.log_time, header.publish_time);
                (self.visit)(Message {
                    number,
                    channel: &channel,
                    log_ns,
                    publish_ns,
                    data: &data,
                });
            }
            None => self.unknown += 1,
        }
    }

    /// Learns a topic. One that cannot be told is missed by its messages.
    fn name(&mut self, opcode: u8, body: &[u8]) {
        if !matches!(opcode, op::SCHEMA | op::CHANNEL) {
            return;
        }
        if let Err(error) = learn(&mut self.channels, opcode, body) {
            self.lost.push(format!(
                "a topic at byte {} cannot be read ({error})",
                self.at
            ));
        }
    }
}

/// Adds a topic or its schema to those that are known.
fn learn(
    channels: &mut ChannelAccumulator<'static>,
    opcode: u8,
    body: &[u8],
) -> Result<(), McapError> {
    match mcap::parse_record(opcode, body)? {
        Record::Schema { header, data } => channels.add_schema_from_slice(header, &data),
        Record::Channel(channel) => channels.add_channel(channel),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests;
