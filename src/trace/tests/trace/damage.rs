//! Killed recordings, flipped bytes, changed and missing messages, gibberish.

use std::{borrow::Cow, collections::BTreeSet, fs, io::Cursor, path::Path};

use mcap::{MessageStream, WriteOptions, read::LinearReader, records::Record};
use proptest::prelude::*;
use reel_trace::{Images, Limits, RecordsReader, Trace, TraceError, TraceFiles};

use crate::sample::{Sample, Source};

pub(crate) fn read(bytes: &[u8]) -> Result<Trace, TraceError> {
    Trace::from_bytes(Path::new("x.mcap"), bytes, &Limits::default())
}

/// A finished trace and the unfinished recording it came from.
pub(crate) fn recorded(sample: &Sample) -> (Vec<u8>, Vec<u8>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let recorder = sample.record_open(&path, &[], Images::None).unwrap();
    let part = fs::read(folder.path().join("x.mcap.part")).unwrap();
    recorder.end(&sample.end).unwrap();
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        1,
        "nothing but the trace stays"
    );
    (fs::read(&path).unwrap(), part)
}

#[test]
fn a_recording_cut_at_any_byte_gives_its_whole_steps() {
    let sample = Source::seeded(3).sample(3);
    let (_, part) = recorded(&sample);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap.part");
    let mut whole = BTreeSet::new();
    for length in 0..=part.len() {
        let steps_readable = match read(&part[..length]) {
            Ok(trace) => {
                assert_eq!(trace.steps, sample.steps[..trace.steps.len()]);
                whole.insert(trace.steps.len());
                continue;
            }
            Err(TraceError::Torn {
                offset,
                steps_readable,
                ..
            }) => {
                assert!(offset <= length as u64);
                steps_readable as usize
            }
            Err(TraceError::NotMcap { .. }) if length < 8 => continue,
            Err(other) => panic!("cut at {length} of {}: {other}", part.len()),
        };
        assert_eq!(
            steps_readable,
            whole.last().copied().unwrap_or(0),
            "cut at {length}"
        );
        if length % 64 == 0 && !whole.is_empty() {
            fs::write(&path, &part[..length]).unwrap();
            let (trace, lost) = Trace::read_partial(&TraceFiles::default(), &path).unwrap();
            assert_eq!(trace.steps, sample.steps[..steps_readable]);
            assert!(lost.unwrap().contains("torn at byte"));
        }
    }
    assert_eq!(whole, BTreeSet::from([0, 1, 2, 3]));
}

#[test]
fn a_call_whose_result_was_never_written_is_named() {
    let sample = Source::seeded(3).sample(2);
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = sample
        .record_open(&folder.path().join("x.mcap"), &[], Images::None)
        .unwrap();
    recorder.input(2, &sample.steps[0].input).unwrap();
    drop(recorder);
    let (trace, lost) =
        Trace::read_partial(&TraceFiles::default(), &folder.path().join("x.mcap.part")).unwrap();
    assert_eq!(trace.steps, sample.steps);
    assert!(lost.unwrap().contains("call 2 was received"));
}

#[test]
fn no_flipped_byte_of_a_finished_trace_is_accepted() {
    let (trace, _) = recorded(&Source::seeded(3).sample(2));
    read(&trace).unwrap();
    let accepted: Vec<usize> = (0..trace.len())
        .filter(|position| {
            let mut bytes = trace.clone();
            bytes[*position] ^= 1 << (position % 8);
            read(&bytes).is_ok()
        })
        .collect();
    assert!(
        accepted.is_empty(),
        "accepted flips at {accepted:?} of {} bytes",
        trace.len()
    );
}

#[test]
fn zeroed_checksums_do_not_switch_verification_off() {
    let (trace, _) = recorded(&Source::seeded(3).sample(2));
    let mut position = 8;
    let mut zeroed = 0;
    while position < trace.len() - 8 {
        let length =
            u64::from_le_bytes(trace[position + 1..position + 9].try_into().unwrap()) as usize;
        let body = position + 9;
        let crc = match trace[position] {
            0x02 => Some(body + 16),         // footer
            0x06 => Some(body + 24),         // chunk
            0x09 => Some(body + length - 4), // attachment
            0x0f => Some(body),              // end of the data section
            _ => None,
        };
        if let Some(crc) = crc {
            let mut bytes = trace.clone();
            bytes[crc..crc + 4].fill(0);
            assert!(read(&bytes).is_err(), "checksum at {crc}");
            zeroed += 1;
        }
        position = body + length;
    }
    assert_eq!(zeroed, 5, "two attachments, a chunk, data section, summary");
}

#[test]
fn a_finished_trace_cut_anywhere_is_torn() {
    let (trace, _) = recorded(&Source::seeded(3).sample(2));
    for length in 8..trace.len() {
        let error = read(&trace[..length]).unwrap_err();
        assert!(
            matches!(error, TraceError::Torn { .. }),
            "cut at {length}: {error}"
        );
    }
    let mut longer = trace.clone();
    longer.extend_from_slice(b"more");
    assert!(read(&longer).is_err(), "bytes behind the end");
    let twice = [trace.as_slice(), trace.as_slice()].concat();
    assert!(read(&twice).is_err(), "two files in one");
}

/// Writes a trace again with correct checksums: each message as `change` returns it, or not at all.
pub(crate) fn rewritten(trace: &[u8], change: impl Fn(&str, &[u8]) -> Option<Vec<u8>>) -> Vec<u8> {
    let mut writer = WriteOptions::new()
        .library("reel")
        .create(Cursor::new(Vec::new()))
        .unwrap();
    for record in LinearReader::new(trace).unwrap() {
        match record.unwrap() {
            Record::Metadata(metadata) => writer.write_metadata(&metadata).unwrap(),
            Record::Attachment { header, data, .. } => {
                let data = change(&header.name, &data).unwrap();
                let (log_time, create_time) = (header.log_time, header.create_time);
                let (name, media_type) = (header.name, header.media_type);
                writer
                    .attach(&mcap::Attachment {
                        log_time,
                        create_time,
                        name,
                        media_type,
                        data: data.into(),
                    })
                    .unwrap();
            }
            _ => {}
        }
    }
    for message in MessageStream::new(trace).unwrap() {
        let mut message = message.unwrap();
        if let Some(data) = change(&message.channel.topic, &message.data) {
            message.data = Cow::Owned(data);
            writer.write(&message).unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

fn replace(data: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    match data.windows(from.len()).position(|window| window == from) {
        Some(at) => [&data[..at], to, &data[at + from.len()..]].concat(),
        None => data.to_vec(),
    }
}

#[test]
fn a_forger_with_correct_checksums_is_found_by_the_chain() {
    let mut sample = Source::seeded(3).sample(3);
    sample.steps[1].input.call =
        reel_world::ToolCall::new("pick", serde_json::json!({"marker_id": 3}));
    let (trace, _) = recorded(&sample);
    sample.assert_is(&read(&rewritten(&trace, |_, data| Some(data.to_vec()))).unwrap());

    let argument = rewritten(&trace, |topic, data| {
        Some(if topic == "/tool/call" {
            replace(data, br#"{"marker_id":3}"#, br#"{"marker_id":4}"#)
        } else {
            data.to_vec()
        })
    });
    let error = read(&argument).unwrap_err();
    assert!(
        matches!(error, TraceError::ChainBroken { step: Some(1), .. }),
        "{error}"
    );

    let task = rewritten(&trace, |topic, data| {
        Some(if topic == "task.json" {
            replace(data, b"other table", b"wrong table")
        } else {
            data.to_vec()
        })
    });
    let error = read(&task).unwrap_err();
    assert!(
        matches!(
            error,
            TraceError::Attachment {
                attachment: "task.json",
                ..
            }
        ),
        "{error}"
    );

    // a reader that has seen the task under this digest is not taken in either
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        path
    };
    let (sound, forged) = (file("sound.mcap", &trace), file("forged.mcap", &task));
    let reader = RecordsReader::default();
    for _ in 0..2 {
        sample.assert_is(&reader.read(&sound).unwrap());
        let error = reader.read(&forged).unwrap_err();
        assert!(
            matches!(
                error,
                TraceError::Attachment {
                    attachment: "task.json",
                    ..
                }
            ),
            "{error}"
        );
    }
}

#[test]
fn every_message_is_missed() {
    let sample = Source::seeded(3).sample(3);
    let (trace, _) = recorded(&sample);
    let topics: Vec<String> = MessageStream::new(&trace)
        .unwrap()
        .map(|message| message.unwrap().channel.topic.clone())
        .collect();
    for (index, topic) in topics.iter().enumerate() {
        let counter = std::cell::Cell::new(0);
        let without = rewritten(&trace, |name, data| {
            if !name.starts_with('/') {
                return Some(data.to_vec());
            }
            counter.set(counter.get() + 1);
            (counter.get() != index + 1).then(|| data.to_vec())
        });
        // what viewers draw, and what stands beside the records
        let beside = ["/tf", "/scene", "/log", "/logprobs", "/reported"];
        let may_be_missing = beside.contains(&topic.as_str());
        assert_eq!(
            read(&without).is_ok(),
            may_be_missing,
            "without message {index} on {topic}"
        );
    }
}

#[test]
fn errors_say_what_where_and_what_to_do() {
    let (trace, part) = recorded(&Source::seeded(3).sample(2));
    let mut flipped = trace.clone();
    flipped[trace.len() / 2] ^= 1;
    let text = read(&flipped).unwrap_err().to_string();
    assert!(
        text.contains("damaged at byte") && text.ends_with("x.mcap"),
        "{text}"
    );
    let text = read(&part[..part.len() - 1]).unwrap_err().to_string();
    assert!(
        text.contains("torn at byte") && text.contains("1 steps are readable, recover them"),
        "{text}"
    );
    let small = Limits {
        file_bytes: 100,
        ..Limits::default()
    };
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    fs::write(&path, &trace).unwrap();
    assert!(matches!(
        Trace::read_with_limits(&path, &small),
        Err(TraceError::TooLarge { limit: 100, .. })
    ));
    let small = Limits {
        chunk_bytes: 100,
        ..Limits::default()
    };
    assert!(matches!(
        Trace::read_with_limits(&path, &small),
        Err(TraceError::Damaged { .. })
    ));
    assert!(matches!(
        Trace::read(folder.path()),
        Err(TraceError::Io { .. })
    ));
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2000) })]
    #[test]
    fn gibberish_never_panics(
        records in proptest::collection::vec((0..20u8, 0..80u64, proptest::collection::vec(any::<u8>(), 0..60)), 0..8),
        honest in any::<bool>(),
    ) {
        let mut bytes = mcap::MAGIC.to_vec();
        for (opcode, length, body) in &records {
            bytes.push(*opcode);
            bytes.extend_from_slice(&if honest { body.len() as u64 } else { *length }.to_le_bytes());
            bytes.extend_from_slice(body);
        }
        prop_assert!(read(&bytes).is_err());
        bytes.extend_from_slice(mcap::MAGIC);
        prop_assert!(read(&bytes).is_err());
    }

    #[test]
    fn a_shuffled_recording_never_panics(edits in proptest::collection::vec((any::<u16>(), any::<u16>(), any::<u8>()), 1..6)) {
        thread_local! { static PART: Vec<u8> = recorded(&Source::seeded(3).sample(2)).1; }
        let mut bytes = PART.with(Clone::clone);
        for (at, length, byte) in edits {
            let at = usize::from(at) % bytes.len();
            let end = (at + usize::from(length % 64)).min(bytes.len());
            bytes.splice(at..end, std::iter::repeat_n(byte, usize::from(length % 48)));
        }
        let _ = read(&bytes);
    }
}
