//! Reading a shard: any episode by its number or id, from the one chunk that holds it.

use std::{
    collections::HashMap,
    ffi::OsStr,
    fs::File,
    io::{self, Cursor, Read, Seek, SeekFrom},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use mcap::{
    McapError, Summary,
    records::{ChunkIndex, Record, op},
    sans_io::{SummaryReadEvent, SummaryReader, SummaryReaderOptions},
};
use prost::Message as _;
use reel_world::{Digest, Scene, Task};
use serde::de::DeserializeOwned;

use super::{INDEX, Kind, PROFILE, PackedEpisode, bounds};
use crate::{
    TraceError,
    container::{FOOTER, RECORD_PREFIX, attachment_is_whole},
    limits::Limits,
    schema::reel,
    unpack::Unpacked,
};

/// Bytes of an entry of the index: the key of an id, and a number.
const ENTRY: usize = 12;
/// Parsed tasks and scenes that are kept, of each.
const DOCUMENTS_MAX: usize = 256;

/// What the index has of an id: eight bytes in which two ids hardly ever agree.
pub(super) fn index_key(id: &str) -> u64 {
    let digest = Digest::of(id.as_bytes());
    u64::from_be_bytes(*digest.0.first_chunk().expect("a digest has 32 bytes"))
}

/// Whether the file that begins with these bytes is a shard.
pub(crate) fn begins_as_shard(bytes: &[u8]) -> bool {
    let profile = mcap::MAGIC.len() + RECORD_PREFIX;
    let expected = [&(PROFILE.len() as u32).to_le_bytes(), PROFILE.as_bytes()].concat();
    bytes.starts_with(mcap::MAGIC)
        && bytes
            .get(profile..)
            .is_some_and(|bytes| bytes.starts_with(&expected))
}

/// The shard and the episode that `shard.mcap#EPISODE` names.
pub fn member(path: &Path) -> Option<(&Path, &str)> {
    let (shard, episode) = path.to_str()?.rsplit_once('#')?;
    (shard.ends_with(".mcap") && !episode.is_empty()).then(|| (Path::new(shard), episode))
}

/// What a trace is called, without the extension of its file: `trace` of `folder/trace.mcap`, `shard-7` of
/// `folder/shard.mcap#7`.
pub fn trace_stem(path: &Path) -> String {
    let of = |path: &Path| {
        let stem = path.file_stem().unwrap_or(OsStr::new("trace"));
        stem.to_string_lossy().into_owned()
    };
    match member(path).filter(|_| !path.exists()) {
        Some((shard, episode)) => format!("{}-{episode}", of(shard)),
        None => of(path),
    }
}

/// The path that names an episode of a shard: `shard.mcap#NUMBER`.
pub fn name_of_member(shard: &Path, number: u32) -> PathBuf {
    let mut name = shard.as_os_str().to_owned();
    name.push(format!("#{number}"));
    name.into()
}

/// A shard that is open. Many threads may read it.
pub struct Shard {
    path: PathBuf,
    file: Mutex<Box<dyn Source>>,
    chunks: Vec<ChunkIndex>,
    /// The entries of the index, sorted by their keys.
    index: Vec<u8>,
    /// The chunk that was read last, of each kind.
    last: [Mutex<Option<Arc<Chunk>>>; 3],
    tasks: Documents<Task>,
    scenes: Documents<Scene>,
}

/// Where the bytes of a shard are.
trait Source: Read + Seek + Send {}

impl<T: Read + Seek + Send> Source for T {}

/// The messages of a chunk.
struct Chunk {
    first: u64,
    messages: Vec<Vec<u8>>,
}

impl Shard {
    /// Whether a file of this machine is a shard, by its first bytes.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn is_one(path: &Path) -> io::Result<bool> {
        let mut head = [0; 64];
        let mut length = 0;
        let mut file = File::open(path)?;
        // What is read from a pipe is gone.
        if !file.metadata()?.is_file() {
            return Ok(false);
        }
        while length < head.len() {
            match file.read(&mut head[length..])? {
                0 => break,
                read => length += read,
            }
        }
        Ok(begins_as_shard(&head))
    }

    /// Opens a shard and reads its index of chunks.
    ///
    /// # Errors
    /// When it cannot be read, or is none.
    pub fn open(path: &Path) -> Result<Self, TraceError> {
        let failed = |source| TraceError::Io {
            action: "read",
            path: path.to_owned(),
            source,
        };
        if !Self::is_one(path).map_err(failed)? {
            return Err(TraceError::Packed {
                path: path.to_owned(),
                problem: "it is no file of packed episodes; `reel pack` makes one of traces"
                    .to_owned(),
            });
        }
        let file = File::open(path).map_err(failed)?;
        Self::of_source(path, Box::new(file))
    }

    /// Opens a shard that is in memory; `path` says in messages where it came from.
    ///
    /// # Errors
    /// When it is none.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, TraceError> {
        if !begins_as_shard(&bytes) {
            return Err(TraceError::Packed {
                path: path.to_owned(),
                problem: "these are no packed episodes".to_owned(),
            });
        }
        Self::of_source(path, Box::new(Cursor::new(bytes)))
    }

    fn of_source(path: &Path, mut file: Box<dyn Source>) -> Result<Self, TraceError> {
        let failed = |source| TraceError::Io {
            action: "read",
            path: path.to_owned(),
            source,
        };
        let damaged = |problem: String| TraceError::Damaged {
            path: path.to_owned(),
            offset: 0,
            problem,
        };
        let read = summary(&mut *file).and_then(|summary| {
            let index = index(&mut *file, &summary)?;
            Ok((summary, index))
        });
        let (summary, index) = read.map_err(|error| match error {
            McapError::Io(source) => failed(source),
            error => damaged(error.to_string()),
        })?;
        let mut chunks = summary.chunk_indexes;
        chunks.sort_by_key(|chunk| chunk.message_start_time);
        // Else an episode could be another one each time that it is read.
        if !chunks.is_sorted_by(|one, next| one.message_end_time < next.message_start_time) {
            return Err(damaged("two chunks have the same episode".to_owned()));
        }
        let episodes = index.len() / ENTRY;
        let last = chunks
            .iter()
            .map(|chunk| chunk.message_end_time)
            .filter(|time| *time < Kind::Task.log_time(0))
            .max();
        let expected = last.map_or(0, |last| last + 1);
        if index.len() % ENTRY != 0 || expected != episodes as u64 {
            return Err(damaged(format!(
                "{INDEX} has {episodes} episodes, and the chunks have {expected}"
            )));
        }
        Ok(Self {
            path: path.to_owned(),
            file: Mutex::new(file),
            chunks,
            index,
            last: Default::default(),
            tasks: Documents::default(),
            scenes: Documents::default(),
        })
    }

    /// How many episodes it holds.
    pub fn len(&self) -> u32 {
        u32::try_from(self.index.len() / ENTRY).unwrap_or(u32::MAX)
    }

    /// Whether it was packed from no trace at all.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The number of an episode: as it stands, or by its id; of several with one id the first.
    ///
    /// # Errors
    /// When there is none, or the file cannot be read.
    pub fn find(&self, episode: &str) -> Result<u32, TraceError> {
        let number = episode.parse::<u32>().ok();
        let number = number.filter(|number| number.to_string() == episode);
        if let Some(number) = number.filter(|number| *number < self.len()) {
            return Ok(number);
        }
        let (entries, _) = self.index.as_chunks::<ENTRY>();
        let key = index_key(episode).to_be_bytes();
        let at = entries.partition_point(|entry| entry[..8] < key[..]);
        if let Some(entry) = entries.get(at).filter(|entry| entry[..8] == key) {
            let number = entry[8..]
                .iter()
                .fold(0, |sum, byte| sum << 8 | u32::from(*byte));
            if self.episode(number)?.header.episode_id == episode {
                return Ok(number);
            }
        }
        Err(TraceError::NotInShard {
            path: self.path.clone(),
            episode: episode.to_owned(),
            episodes: self.len(),
        })
    }

    /// The episode of a number.
    ///
    /// # Errors
    /// When there is none, or what is there is damaged.
    pub fn episode(&self, number: u32) -> Result<PackedEpisode, TraceError> {
        let message = self.message(Kind::Episode, number)?;
        let damaged = |problem| self.damaged(Kind::Episode, number, problem);
        bounds::check(&message).map_err(damaged)?;
        let message = reel::PackedEpisode::decode(message.as_slice())
            .map_err(|error| damaged(error.to_string()))?;
        let task = self.document(Kind::Task, message.task, &self.tasks)?;
        let scene = self.document(Kind::Scene, message.scene, &self.scenes)?;
        PackedEpisode::decode(message, task, scene).map_err(damaged)
    }

    /// A task or scene, with the digest of its JSON.
    fn document<T: DeserializeOwned>(
        &self,
        kind: Kind,
        number: u32,
        known: &Documents<T>,
    ) -> Result<(Arc<T>, Digest), TraceError> {
        known.get(number, || {
            let json = self.message(kind, number)?;
            let value = serde_json::from_slice(&json)
                .map_err(|error| self.damaged(kind, number, error.to_string()))?;
            Ok((Arc::new(value), Digest::of(&json)))
        })
    }

    /// A message by its number.
    fn message(&self, kind: Kind, number: u32) -> Result<Vec<u8>, TraceError> {
        let time = kind.log_time(number);
        let mut last = lock(&self.last[kind as usize]);
        let of = |chunk: &Chunk| {
            let at = time.checked_sub(chunk.first)?;
            chunk.messages.get(usize::try_from(at).ok()?).cloned()
        };
        if let Some(message) = last.as_deref().and_then(of) {
            return Ok(message);
        }
        let missing = || self.damaged(kind, number, "it is missing".to_owned());
        let mut chunks = self.chunks.iter();
        let index = chunks
            .find(|chunk| (chunk.message_start_time..=chunk.message_end_time).contains(&time))
            .ok_or_else(missing)?;
        let chunk = Arc::new(self.chunk(index)?);
        let message = of(&chunk).ok_or_else(missing)?;
        *last = Some(chunk);
        Ok(message)
    }

    fn chunk(&self, index: &ChunkIndex) -> Result<Chunk, TraceError> {
        let damaged = |problem: String| TraceError::Damaged {
            path: self.path.clone(),
            offset: index.chunk_start_offset,
            problem,
        };
        let limit = bounds::CHUNK_MAX;
        let size = |bytes: u64| usize::try_from(bytes).unwrap_or(usize::MAX);
        let length = size(index.chunk_length);
        if length.max(size(index.uncompressed_size)) > limit {
            return Err(damaged(format!("a chunk is larger than {limit} bytes")));
        }
        let bytes = self.bytes(index.chunk_start_offset, length)?;
        let record = bytes
            .split_at_checked(RECORD_PREFIX)
            .filter(|(prefix, _)| prefix[0] == op::CHUNK)
            .ok_or_else(|| damaged("it is no chunk".to_owned()))?;
        let failed = |error: McapError| damaged(error.to_string());
        let Record::Chunk { header, data } =
            mcap::parse_record(op::CHUNK, record.1).map_err(failed)?
        else {
            return Err(damaged("it is no chunk".to_owned()));
        };
        if header.uncompressed_size != index.uncompressed_size {
            return Err(damaged("its size is not that of the index".to_owned()));
        }
        let mut chunk = Chunk {
            first: index.message_start_time,
            messages: Vec::new(),
        };
        let unpacked = Unpacked::of(&header, &data, limit)
            .ok_or_else(|| damaged("its checksum does not hold".to_owned()))?;
        for (_, body) in unpacked
            .records()
            .filter(|(opcode, _)| *opcode == op::MESSAGE)
        {
            let Record::Message { header, data } =
                mcap::parse_record(op::MESSAGE, body).map_err(failed)?
            else {
                continue;
            };
            // Numbers are places in the chunk, so a hole would shift all behind it.
            if header.log_time != chunk.first.wrapping_add(chunk.messages.len() as u64) {
                return Err(damaged("a message is out of place".to_owned()));
            }
            chunk.messages.push(data.into_owned());
        }
        let span = index
            .message_end_time
            .wrapping_sub(index.message_start_time);
        if span.wrapping_add(1) != chunk.messages.len() as u64 {
            return Err(damaged(
                "it has other messages than the index says".to_owned(),
            ));
        }
        Ok(chunk)
    }

    fn bytes(&self, offset: u64, length: usize) -> Result<Vec<u8>, TraceError> {
        let mut file = lock(&self.file);
        let mut bytes = vec![0; length];
        file.seek(SeekFrom::Start(offset))
            .and_then(|_| file.read_exact(&mut bytes))
            .map_err(|source| TraceError::Io {
                action: "read",
                path: self.path.clone(),
                source,
            })?;
        Ok(bytes)
    }

    fn damaged(&self, kind: Kind, number: u32, problem: String) -> TraceError {
        TraceError::Message {
            path: self.path.clone(),
            offset: 0,
            topic: kind.topic().to_owned(),
            problem: format!("number {number}: {problem}"),
        }
    }
}

/// The summary, once its checksum holds.
fn summary(file: &mut dyn Source) -> Result<Summary, McapError> {
    let limit = Limits::default().chunk_bytes;
    let options = SummaryReaderOptions::default().with_record_length_limit(limit);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
            }
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
        }
    }
    let summary = reader.finish().ok_or(McapError::UnexpectedEof)?;
    let mut footer = [0; FOOTER + mcap::MAGIC.len()];
    let from = file.seek(SeekFrom::End(-(footer.len() as i64)))?;
    file.read_exact(&mut footer)?;
    let (fields, end) = footer[RECORD_PREFIX..].split_at(FOOTER - RECORD_PREFIX);
    let start = u64::from_le_bytes(*fields.first_chunk().expect("a footer has 20 bytes"));
    let length = from
        .checked_sub(start)
        .filter(|length| *length <= limit as u64);
    let length = length.ok_or(McapError::BadFooter)? as usize;
    let mut covered = vec![0; length + RECORD_PREFIX + 16];
    file.seek(SeekFrom::Start(start))?;
    file.read_exact(&mut covered)?;
    let sound = crc32fast::hash(&covered).to_le_bytes() == fields[16..20];
    match sound && end == mcap::MAGIC {
        true => Ok(summary),
        false => Err(io::Error::other("the checksum of the summary does not hold").into()),
    }
}

/// The entries of the index, once the checksum of their attachment holds.
fn index(file: &mut dyn Source, summary: &Summary) -> Result<Vec<u8>, McapError> {
    let wrong = |problem: &str| McapError::from(io::Error::other(format!("{INDEX}: {problem}")));
    let mut indexes = summary.attachment_indexes.iter();
    let index = indexes
        .find(|index| index.name == INDEX)
        .ok_or_else(|| wrong("it is missing"))?;
    let length = usize::try_from(index.length).unwrap_or(usize::MAX);
    if length > Limits::default().chunk_bytes {
        return Err(wrong("it is too long"));
    }
    let mut record = vec![0; length];
    file.seek(SeekFrom::Start(index.offset))?;
    file.read_exact(&mut record)?;
    let body = record.get(RECORD_PREFIX..).unwrap_or_default();
    let whole = record.first() == Some(&op::ATTACHMENT) && attachment_is_whole(body);
    let (covered, crc) = body
        .split_last_chunk::<4>()
        .filter(|_| whole)
        .ok_or_else(|| wrong("it is not whole"))?;
    if crc32fast::hash(covered).to_le_bytes() != *crc {
        return Err(wrong("its checksum does not hold"));
    }
    match mcap::parse_record(op::ATTACHMENT, body)? {
        Record::Attachment { data, .. } => Ok(data.into_owned()),
        _ => Err(wrong("it is no attachment")),
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Tasks or scenes that were parsed before, by number.
struct Documents<T>(Mutex<HashMap<u32, (Arc<T>, Digest)>>);

impl<T> Default for Documents<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Documents<T> {
    fn get(
        &self,
        number: u32,
        read: impl FnOnce() -> Result<(Arc<T>, Digest), TraceError>,
    ) -> Result<(Arc<T>, Digest), TraceError> {
        if let Some(known) = lock(&self.0).get(&number) {
            return Ok(known.clone());
        }
        let value = read()?;
        let mut known = lock(&self.0);
        if known.len() >= DOCUMENTS_MAX {
            known.clear();
        }
        known.insert(number, value.clone());
        Ok(value)
    }
}
