//! Writing a shard: episodes one after the other, in memory only what a chunk holds and the ids.

use std::{
    collections::HashMap,
    fs::{self, File},
    io::{self, BufWriter},
    path::{Path, PathBuf},
};

use mcap::{
    Compression, McapError, WriteOptions,
    records::{AttachmentHeader, MessageHeader},
};
use prost::Message as _;
use reel_world::{Digest, canonical_json};

use super::{EPISODES, INDEX, Kind, PROFILE, PackedEpisode, read::index_key};
use crate::{
    Disk as _, LocalDisk, TraceError, container,
    files::{self, with_suffix},
    schema,
};

/// zstd's level: slow to write, as fast as any other to read.
const LEVEL: u32 = 19;
/// Bytes of messages in a chunk, before compression. One episode of it is read by decompressing all.
const CHUNK_BYTES: usize = 1 << 20;

/// How large a shard became.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ShardSummary {
    /// How many episodes it holds.
    pub episodes: u32,
    /// How many tasks these play.
    pub tasks: u32,
    /// How many scenes the tasks play in.
    pub scenes: u32,
    /// Size of the shard, in bytes.
    pub bytes: u64,
}

/// Messages of a kind that wait for their chunk.
#[derive(Default)]
struct Pending {
    messages: Vec<Vec<u8>>,
    bytes: usize,
    /// Number of the first of them.
    first: u32,
}

/// Writes a shard. What is not finished leaves nothing behind.
pub struct ShardWriter {
    path: PathBuf,
    temporary: PathBuf,
    /// Taken when the file is finished.
    writer: Option<mcap::Writer<BufWriter<File>>>,
    pending: [Pending; 3],
    tasks: HashMap<Digest, u32>,
    scenes: HashMap<Digest, u32>,
    /// Keys of ids, with numbers.
    ids: Vec<(u64, u32)>,
}

impl ShardWriter {
    /// Opens a file beside `path`, which [`ShardWriter::finish`] puts there.
    ///
    /// # Errors
    /// When it cannot be written, or something is there already: numbers that name episodes of a shard stay true.
    pub fn create(path: &Path) -> Result<Self, TraceError> {
        let temporary = with_suffix(path, &format!(".{}.tmp", std::process::id()));
        let create = || -> Result<_, McapError> {
            let options = WriteOptions::new()
                .profile(PROFILE)
                .library(container::LIBRARY)
                .chunk_size(None)
                .compression(Some(Compression::Zstd))
                .compression_level(LEVEL)
                .compression_threads(0)
                .emit_message_indexes(false);
            if path.exists() {
                return Err(io::Error::from(io::ErrorKind::AlreadyExists).into());
            }
            let mut writer = options.create(BufWriter::new(File::create_new(&temporary)?))?;
            writer.add_schema_with_id(
                EPISODES.id,
                EPISODES.message,
                "protobuf",
                &schema::descriptor_set_of(&EPISODES),
            )?;
            for kind in Kind::ALL {
                let id = kind as u16 + 1;
                let (schema, encoding) = match kind {
                    Kind::Episode => (EPISODES.id, "protobuf"),
                    Kind::Task | Kind::Scene => (0, "json"),
                };
                writer.add_channel_with_id(
                    id,
                    schema,
                    kind.topic(),
                    encoding,
                    &Default::default(),
                )?;
            }
            Ok(writer)
        };
        let writer = create().map_err(|error| TraceError::unwritten(path, error))?;
        Ok(Self {
            path: path.to_owned(),
            temporary,
            writer: Some(writer),
            pending: Default::default(),
            tasks: HashMap::new(),
            scenes: HashMap::new(),
            ids: Vec::new(),
        })
    }

    /// Adds an episode; gives its number.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn add(&mut self, episode: &PackedEpisode) -> Result<u32, TraceError> {
        let header = &episode.header;
        let task = match self.tasks.get(&header.task_digest) {
            Some(number) => *number,
            None => {
                let number = self.push(Kind::Task, canonical_json(&*episode.task).into_bytes())?;
                self.tasks.insert(header.task_digest, number);
                number
            }
        };
        let scene = match self.scenes.get(&header.scene_digest) {
            Some(number) => *number,
            None => {
                let number =
                    self.push(Kind::Scene, canonical_json(&*episode.scene).into_bytes())?;
                self.scenes.insert(header.scene_digest, number);
                number
            }
        };
        let message = episode.encode(task, scene).encode_to_vec();
        let number = self.push(Kind::Episode, message)?;
        self.ids.push((index_key(&header.episode_id), number));
        Ok(number)
    }

    /// Writes what waits and the index, and puts the file in its place.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> Result<ShardSummary, TraceError> {
        for kind in Kind::ALL {
            self.flush(kind)?;
        }
        let path = self.path.clone();
        self.ids.sort_unstable();
        let index: Vec<u8> = self
            .ids
            .iter()
            .flat_map(|(key, number)| {
                let (key, number) = (key.to_be_bytes(), number.to_be_bytes());
                key.into_iter().chain(number)
            })
            .collect();
        let header = AttachmentHeader {
            log_time: 0,
            create_time: 0,
            name: INDEX.to_owned(),
            media_type: "application/octet-stream".to_owned(),
        };
        let mut writer = self.writer.take().expect("it is taken only here");
        let publish = || -> Result<u64, McapError> {
            writer.attach(&container::attachment(header, &index))?;
            writer.finish()?;
            let file = writer.into_inner().into_inner().map_err(io::Error::from)?;
            file.sync_all()?;
            LocalDisk.rename_new(&self.temporary, &path)?;
            files::sync_folder(&LocalDisk, &path)?;
            Ok(file.metadata()?.len())
        };
        let bytes = publish().map_err(|error| TraceError::unwritten(&path, error))?;
        Ok(ShardSummary {
            episodes: self.ids.len() as u32,
            tasks: self.tasks.len() as u32,
            scenes: self.scenes.len() as u32,
            bytes,
        })
    }

    /// Keeps a message for the next chunk of its kind.
    fn push(&mut self, kind: Kind, message: Vec<u8>) -> Result<u32, TraceError> {
        let pending = &mut self.pending[kind as usize];
        let number = pending.first + pending.messages.len() as u32;
        pending.bytes += message.len();
        pending.messages.push(message);
        if pending.bytes >= CHUNK_BYTES {
            self.flush(kind)?;
        }
        Ok(number)
    }

    /// Writes what waits as a chunk.
    fn flush(&mut self, kind: Kind) -> Result<(), TraceError> {
        let Pending {
            messages, first, ..
        } = std::mem::take(&mut self.pending[kind as usize]);
        self.pending[kind as usize].first = first + messages.len() as u32;
        let failed = |error| TraceError::unwritten(&self.path, error);
        let writer = self.writer.as_mut().expect("it is taken at the end");
        for (number, message) in (first..).zip(&messages) {
            let header = MessageHeader {
                channel_id: kind as u16 + 1,
                sequence: number,
                log_time: kind.log_time(number),
                publish_time: kind.log_time(number),
            };
            writer
                .write_to_known_channel(&header, message)
                .map_err(failed)?;
        }
        writer.flush().map_err(failed)
    }
}

impl Drop for ShardWriter {
    fn drop(&mut self) {
        // What was finished has its name.
        drop(self.writer.take());
        let _ = fs::remove_file(&self.temporary);
    }
}
