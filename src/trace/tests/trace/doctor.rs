//! What the doctor finds that the reader need not: a lying index, foreign channels, other schemas,
//! broken numbering; and that it goes on after the first finding.

use std::{collections::BTreeMap, fs, io::Cursor, path::Path};

use mcap::{
    MessageStream, WriteOptions,
    read::LinearReader,
    records::{MessageHeader, Record},
};
use prost::Message as _;
use prost_types::FileDescriptorSet;
use reel_trace::{DoctorReport, Images, examine};

use crate::sample::Source;

fn trace() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let (sample, frames) = Source::seeded(3).sample(3).with_frames();
    sample
        .record_open(&path, &frames, Images::Full)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    fs::read(path).unwrap()
}

fn doctor(bytes: &[u8]) -> DoctorReport {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    fs::write(&path, bytes).unwrap();
    examine(&path).unwrap()
}

/// Offset, opcode and length of the body of every record.
fn records(bytes: &[u8]) -> Vec<(usize, u8, usize)> {
    let mut position = 8;
    let mut found = Vec::new();
    while position < bytes.len() - 8 {
        let length = u64::from_le_bytes(*bytes[position + 1..].first_chunk().unwrap()) as usize;
        found.push((position, bytes[position], length));
        position += 9 + length;
    }
    found
}

/// Makes the checksums of data section and index hold again.
fn seal(bytes: &mut [u8]) {
    let data_end = records(bytes)
        .into_iter()
        .find(|(_, opcode, _)| *opcode == 0x0f)
        .unwrap()
        .0;
    let crc = crc32fast::hash(&bytes[..data_end]).to_le_bytes();
    bytes[data_end + 9..data_end + 13].copy_from_slice(&crc);
    let footer = bytes.len() - 8 - 29;
    let crc = crc32fast::hash(&bytes[data_end + 13..footer + 25]).to_le_bytes();
    bytes[footer + 25..footer + 29].copy_from_slice(&crc);
}

#[test]
fn a_healthy_trace_has_no_findings() {
    let examination = doctor(&trace());
    assert_eq!(
        (examination.findings.len(), examination.notes.len()),
        (0, 0),
        "{examination:?}"
    );
    assert_eq!((examination.steps, examination.images), (3, 4));
    assert!(examination.end.is_some());
}

#[test]
fn an_index_that_lies_is_found() {
    let healthy = trace();
    let mut lied = BTreeMap::new();
    for (offset, opcode, length) in records(&healthy) {
        let name = match opcode {
            0x07 => "message index",
            0x08 => "chunk index",
            0x0a => "attachment index",
            0x0b => "statistics",
            0x0d => "metadata index",
            _ => continue,
        };
        // Names and media types in the index are text; the numbers before and after
        // them are compared, too.
        for at in [0, length / 2, length - 1] {
            let mut bytes = healthy.clone();
            bytes[offset + 9 + at] ^= 1;
            seal(&mut bytes);
            let found = doctor(&bytes).findings;
            let named = found
                .iter()
                .any(|finding| finding.record == name || finding.record == "index");
            assert!(named, "byte {at} of the {name} at {offset}: {found:?}");
            *lied.entry(name).or_insert(0) += 1;
        }
    }
    assert_eq!(lied.len(), 5, "{lied:?}");
}

/// Rewrites a trace by hand: schemas and numbers as the closures say, and one message on a
/// channel that Reel does not know.
fn rewritten(
    trace: &[u8],
    schema: impl Fn(&str, &[u8]) -> Vec<u8>,
    sequence: impl Fn(&str, u32) -> u32,
) -> Vec<u8> {
    let mut writer = WriteOptions::new()
        .library("reel")
        .create(Cursor::new(Vec::new()))
        .unwrap();
    for record in LinearReader::new(trace).unwrap() {
        match record.unwrap() {
            Record::Metadata(metadata) => writer.write_metadata(&metadata).unwrap(),
            Record::Attachment { header, data, .. } => {
                let (log_time, create_time) = (header.log_time, header.create_time);
                let (name, media_type) = (header.name, header.media_type);
                writer
                    .attach(&mcap::Attachment {
                        log_time,
                        create_time,
                        name,
                        media_type,
                        data,
                    })
                    .unwrap();
            }
            _ => {}
        }
    }
    for message in MessageStream::new(trace).unwrap() {
        let message = message.unwrap();
        let ours = message.channel.schema.as_ref().unwrap();
        let data = schema(&message.channel.topic, &ours.data);
        let schema_id = writer
            .add_schema(&ours.name, &ours.encoding, &data)
            .unwrap();
        let channel_id = writer
            .add_channel(
                schema_id,
                &message.channel.topic,
                "protobuf",
                &BTreeMap::new(),
            )
            .unwrap();
        let (log_time, publish_time) = (message.log_time, message.publish_time);
        let sequence = sequence(&message.channel.topic, message.sequence);
        writer
            .write_to_known_channel(
                &MessageHeader {
                    channel_id,
                    sequence,
                    log_time,
                    publish_time,
                },
                &message.data,
            )
            .unwrap();
    }
    let channel_id = writer
        .add_channel(0, "/battery", "json", &BTreeMap::new())
        .unwrap();
    writer
        .write_to_known_channel(
            &MessageHeader {
                channel_id,
                sequence: 0,
                log_time: 1,
                publish_time: 1,
            },
            b"{}",
        )
        .unwrap();
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

#[test]
fn foreign_channels_and_newer_schemas_are_notes_changed_ones_findings() {
    let trace = trace();
    let same = |_: &str, data: &[u8]| data.to_vec();
    let number = |_: &str, sequence| sequence;
    let examination = doctor(&rewritten(&trace, same, number));
    assert_eq!(examination.findings, []);
    assert_eq!(examination.notes, ["the channel /battery is not ours"]);

    let edited = |edit: &dyn Fn(&mut prost_types::FieldDescriptorProto)| {
        rewritten(
            &trace,
            |topic, data| {
                let mut set = FileDescriptorSet::decode(data).unwrap();
                for message in set.file.iter_mut().flat_map(|file| &mut file.message_type) {
                    if topic == "/tool/call" && message.name() == "ToolCall" {
                        edit(&mut message.field[1]);
                    }
                }
                set.encode_to_vec()
            },
            number,
        )
    };
    let examination = doctor(&edited(&|field| field.number = Some(77)));
    assert_eq!(examination.findings, []);
    assert!(
        examination.notes[0].starts_with("the schema of /tool/call: of another version"),
        "{:?}",
        examination.notes
    );
    let examination = doctor(&edited(&|field| field.name = Some("other".to_owned())));
    assert_eq!(examination.findings.len(), 1);
    let finding = &examination.findings[0];
    assert!(
        finding.record == "schema of /tool/call" && finding.message.contains("reel.v1.ToolCall"),
        "{finding}"
    );
}

#[test]
fn a_number_that_comes_twice_is_found() {
    let number = |topic: &str, sequence| if topic == "/tool/result" { 1 } else { sequence };
    let found = doctor(&rewritten(&trace(), |_, data| data.to_vec(), number)).findings;
    assert_eq!(found.len(), 2, "{found:?}");
    assert!(
        found
            .iter()
            .all(|finding| finding.record == "message on /tool/result" && finding.offset.is_some())
    );
    assert_eq!((found[0].step, found[1].step), (Some(0), Some(1)));
}

#[test]
fn it_goes_on_after_the_first_finding() {
    let mut bytes = trace();
    let at = |bytes: &[u8], wanted: u8| {
        records(bytes)
            .into_iter()
            .find(|(_, opcode, _)| *opcode == wanted)
            .unwrap()
    };
    let (attachment, ..) = at(&bytes, 0x09);
    let (chunk, ..) = at(&bytes, 0x06);
    let (statistics, ..) = at(&bytes, 0x0b);
    for offset in [attachment + 100, chunk + 300, statistics + 9] {
        bytes[offset] ^= 1;
    }
    let found = doctor(&bytes).findings;
    let has = |record: &str, offset: usize| {
        found
            .iter()
            .any(|f| f.record == record && f.offset == Some(offset as u64))
    };
    assert!(
        has("attachment", attachment) && has("chunk", chunk),
        "{found:#?}"
    );
    assert!(
        found.iter().any(|f| f.message.contains("data section"))
            && found
                .iter()
                .any(|f| f.message.contains("checksum of the index"))
    );
    assert!(found.iter().all(|finding| !finding.advice.is_empty()));
    assert!(examine(Path::new("/nowhere/x.mcap")).is_err());
    assert_eq!(doctor(b"").findings.len(), 1);
}
