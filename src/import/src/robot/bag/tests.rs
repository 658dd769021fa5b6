//! What is read of files with damage outside of chunks.

use std::{collections::BTreeMap, fs, ops::Range};

use mcap::{WriteOptions, records::MessageHeader};

use super::*;

const MESSAGES: u64 = 20;

/// An unchunked file of numbered messages, and where the record of each lies.
fn file() -> (Vec<u8>, Vec<Range<usize>>) {
    let mut bytes = io::Cursor::new(Vec::new());
    let options = WriteOptions::new().use_chunks(false);
    let mut writer = options.create(&mut bytes).unwrap();
    let channel_id = writer
        .add_channel(0, "/said", "json", &BTreeMap::new())
        .unwrap();
    for number in 0..MESSAGES {
        let header = MessageHeader {
            channel_id,
            sequence: number as u32,
            log_time: number,
            publish_time: number,
        };
        let data = format!("{{\"number\": {number}}}").repeat(1 + number as usize % 3);
        writer
            .write_to_known_channel(&header, data.as_bytes())
            .unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    let bytes = bytes.into_inner();
    let (mut records, mut at) = (Vec::new(), MAGIC.len());
    while bytes[at] != op::DATA_END {
        let length = u64::from_le_bytes(*bytes[at + 1..].first_chunk().unwrap()) as usize;
        let end = at + PREFIX + length;
        if bytes[at] == op::MESSAGE {
            records.push(at..end);
        }
        at = end;
    }
    assert_eq!(records.len() as u64, MESSAGES);
    (bytes, records)
}

/// The times of the messages that are read, and what is said to be lost.
fn read(bytes: &[u8]) -> (Vec<u64>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    fs::write(&path, bytes).unwrap();
    let mut read = Vec::new();
    let lost = walk(&path, &mut |message| read.push(message.log_ns));
    (read, lost)
}

fn all_but(number: usize) -> Vec<u64> {
    (0..MESSAGES)
        .filter(|other| *other != number as u64)
        .collect()
}

#[test]
fn a_record_whose_head_is_damaged_is_skipped() {
    let (whole, records) = file();
    assert_eq!(read(&whole), ((0..MESSAGES).collect(), Vec::new()));
    for (number, record) in records.iter().enumerate() {
        for head in [[0xff; PREFIX], [0; PREFIX], [0x47; PREFIX], [0x0f; PREFIX]] {
            let mut bytes = whole.clone();
            bytes[record.start..record.start + PREFIX].copy_from_slice(&head);
            let (found, lost) = read(&bytes);
            assert_eq!(found, all_but(number), "{head:?} at {record:?}");
            let end = record.end - 1;
            assert_eq!(
                lost,
                [format!(
                    "bytes {} to {end} are damaged and left out",
                    record.start
                )]
            );
        }
    }
}

#[test]
fn a_record_whose_length_is_wrong_costs_no_other() {
    let (whole, records) = file();
    for (number, record) in records.iter().enumerate() {
        let mut bytes = whole.clone();
        // Too short: what follows is no record.
        bytes[record.start + 1] = 3;
        let (found, lost) = read(&bytes);
        assert_eq!(found, all_but(number), "{lost:?}");
        assert_eq!(lost.len(), 2, "{lost:?}");
    }
}

#[test]
fn bytes_between_records_are_skipped() {
    let (whole, records) = file();
    for record in &records {
        for foreign in [&[0; 300][..], b"not a record of this file", &[0x05; 40]] {
            let mut bytes = whole[..record.start].to_vec();
            bytes.extend(foreign);
            bytes.extend(&whole[record.start..]);
            let (found, lost) = read(&bytes);
            assert_eq!(found, (0..MESSAGES).collect::<Vec<_>>(), "{lost:?}");
            assert_eq!(lost.len(), 1, "{lost:?}");
        }
    }
}

#[test]
fn a_file_that_breaks_off_still_says_so() {
    let (whole, records) = file();
    let cut = &whole[..records[7].end - 4];
    let (found, lost) = read(cut);
    assert_eq!(found, (0..7).collect::<Vec<_>>());
    assert_eq!(lost.len(), 1);
    assert!(lost[0].contains("breaks off at byte"), "{lost:?}");
}
