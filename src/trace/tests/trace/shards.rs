//! Packed episodes whose index was forged: an episode is the same one each time that it is read.

use std::path::Path;

use reel_trace::{Limits, PackedEpisode, Shard, ShardWriter, Trace, TraceError};
use reel_vectors::golden_traces;

/// Opcode of a chunk index, and bytes of an opcode with a length.
const CHUNK_INDEX: u8 = 0x08;
const RECORD_PREFIX: usize = 9;
/// Bytes of a footer and of the magic behind it.
const END: usize = RECORD_PREFIX + 20 + 8;

fn packed() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("packed.mcap");
    let mut shard = ShardWriter::create(&path).unwrap();
    for trace in &golden_traces()[..2] {
        let bytes = std::fs::read(trace).unwrap();
        let read = Trace::from_bytes(trace, &bytes, &Limits::default()).unwrap();
        shard
            .add(&PackedEpisode::of(&read, &bytes, "episode").unwrap())
            .unwrap();
    }
    shard.finish().unwrap();
    std::fs::read(&path).unwrap()
}

fn opened(bytes: Vec<u8>) -> Result<Shard, TraceError> {
    Shard::from_bytes(Path::new("packed.mcap"), bytes)
}

fn number(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

/// Changes the first and last message times of each chunk, in order, and makes the checksum of the summary anew.
fn forged(mut bytes: Vec<u8>, mut change: impl FnMut(usize, &mut [u64; 2])) -> Vec<u8> {
    let footer = bytes.len() - END;
    let summary = usize::try_from(number(&bytes, footer + RECORD_PREFIX)).unwrap();
    let (mut at, mut chunk) = (summary, 0);
    while at < footer {
        let length = usize::try_from(number(&bytes, at + 1)).unwrap();
        if bytes[at] == CHUNK_INDEX {
            let body = at + RECORD_PREFIX;
            let mut times = [number(&bytes, body), number(&bytes, body + 8)];
            change(chunk, &mut times);
            bytes[body..body + 16].copy_from_slice(&times.map(u64::to_le_bytes).concat());
            chunk += 1;
        }
        at += RECORD_PREFIX + length;
    }
    assert!(chunk >= 3, "episodes, tasks and scenes have chunks");
    let end = footer + RECORD_PREFIX + 16;
    let sum = crc32fast::hash(&bytes[summary..end]);
    bytes[end..end + 4].copy_from_slice(&sum.to_le_bytes());
    bytes
}

#[test]
fn no_two_chunks_have_the_same_episode() {
    let sound = packed();
    let same = forged(sound.clone(), |_, _| ());
    assert_eq!(same, sound);
    let mut first = None;
    let overlapping = forged(sound, |_, times| {
        times[0] = *first.get_or_insert(times[0]);
    });
    let refused = opened(overlapping).err().unwrap().to_string();
    assert!(
        refused.contains("two chunks have the same episode"),
        "{refused}"
    );
}

#[test]
fn a_chunk_has_the_messages_that_the_index_says() {
    let sound = packed();
    let kept = opened(sound.clone()).unwrap();
    assert!(kept.episode(0).is_ok() && kept.episode(1).is_ok());
    let mut times = Vec::new();
    forged(sound.clone(), |_, found| times.push(*found));
    // Of the tasks or scenes, so that the number of episodes stays.
    let last = times.iter().max().copied().unwrap();
    let longer = forged(sound, |_, times| {
        if *times == last {
            times[1] += 1;
        }
    });
    let refused = opened(longer).unwrap().episode(0).unwrap_err().to_string();
    assert!(
        refused.contains("other messages than the index says"),
        "{refused}"
    );
}
