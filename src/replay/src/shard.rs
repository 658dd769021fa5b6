//! Traces to packed episodes and back: what a shard leaves out is executed again.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::{SystemTime, UNIX_EPOCH},
};

use reel_episode::Episode;
use reel_sim::render::Detail;
use reel_trace::{FileMetadata, PackedEpisode, PackedFs, Rendering, Shard, Trace, TraceError};
use reel_world::{Assets, Meshes};

use crate::{
    Verdict,
    player::{check_version, config_of},
};

/// The inputs of a trace, once these gave every byte of it again.
///
/// # Errors
/// Why the inputs do not give the trace, in words.
pub fn pack(trace: &Trace, bytes: &[u8], name: &str) -> Result<PackedEpisode, String> {
    // What is executed is what will be read.
    let packed = PackedEpisode::of(trace, bytes, name)?.stored()?;
    let again = unpack(&packed, &trace.meshes)?;
    match again == bytes {
        true => Ok(packed),
        false => Err("executed again, it has other bytes".to_owned()),
    }
}

/// The bytes of the trace that was packed, with all its images.
///
/// # Errors
/// Why the inputs cannot be executed, or that they give another trace.
pub fn unpack(packed: &PackedEpisode, meshes: &Meshes) -> Result<Vec<u8>, String> {
    let verdict = |verdict: Verdict| verdict.to_string();
    check_version(&packed.header).map_err(verdict)?;
    let config = config_of(&packed.header, &packed.task, &packed.scene, meshes).map_err(verdict)?;
    let (mut episode, start, frame) =
        Episode::start_with(config, Detail::Full).map_err(|error| error.to_string())?;
    let mut header = episode.header().clone();
    header.build.clone_from(&packed.header.build);
    if header != packed.header {
        return Err("its header is not that of its inputs".to_owned());
    }
    let trace = || -> Result<Vec<u8>, TraceError> {
        let mut trace = Rendering::new(packed)?;
        trace.start(&start, &frame)?;
        for input in &packed.inputs {
            let output = episode.step(input.clone());
            trace.step(&output.record, output.frame.as_ref())?;
        }
        trace.end(&episode.end())
    };
    trace().map_err(|error| error.to_string())
}

/// Shards on this machine, whose episodes are executed when their traces are read.
#[derive(Default)]
pub struct PackedTraces {
    assets: Option<Arc<dyn Assets + Send>>,
    /// With when each was written: another file may come in its place.
    open: Mutex<HashMap<PathBuf, (SystemTime, Arc<Shard>)>>,
}

impl PackedTraces {
    /// With these meshes for what was recorded with meshes.
    pub fn with_assets(assets: Option<Arc<dyn Assets + Send>>) -> Self {
        Self {
            assets,
            ..Self::default()
        }
    }

    fn episode(&self, path: &Path, episode: &str) -> Result<PackedEpisode, TraceError> {
        let written = written(path)?;
        let shard = {
            let mut open = self.open.lock().unwrap_or_else(PoisonError::into_inner);
            match open.get(path) {
                Some((at, shard)) if *at == written => shard.clone(),
                _ => {
                    let shard = Arc::new(Shard::open(path)?);
                    open.insert(path.to_owned(), (written, shard.clone()));
                    shard
                }
            }
        };
        shard.episode(shard.find(episode)?)
    }
}

/// When a file was written.
fn written(path: &Path) -> Result<SystemTime, TraceError> {
    let metadata = std::fs::metadata(path).and_then(|metadata| metadata.modified());
    metadata.map_err(|source| TraceError::Io {
        action: "read",
        path: path.to_owned(),
        source,
    })
}

impl PackedFs for PackedTraces {
    fn unpack(&self, shard: &Path, episode: &str) -> Result<Vec<u8>, TraceError> {
        let packed = self.episode(shard, episode)?;
        let assets = packed.header.meshes.keys();
        let meshes = match &self.assets {
            Some(known) => known.meshes(&mut { assets }),
            None => Meshes::default(),
        };
        unpack(&packed, &meshes).map_err(|problem| TraceError::Packed {
            path: format!("{}#{episode}", shard.display()).into(),
            problem,
        })
    }

    fn metadata(&self, shard: &Path, episode: &str) -> Result<FileMetadata, TraceError> {
        let packed = self.episode(shard, episode)?;
        let since = written(shard)?.duration_since(UNIX_EPOCH);
        let nanoseconds = since.map_or(0, |since| since.as_nanos());
        Ok(FileMetadata {
            bytes: packed.bytes,
            modified_ns: i64::try_from(nanoseconds).unwrap_or(i64::MAX),
        })
    }
}
