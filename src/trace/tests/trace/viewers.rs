//! Other programs read our files: the Python library `mcap`, where it is installed;
//! Foxglove with our layout.

use std::{collections::BTreeSet, fs, path::Path, process::Command};

use mcap::MessageStream;
use reel_trace::Images;
use serde_json::Value;

use crate::sample::Source;

const SCRIPT: &str = r"
import sys
from mcap.reader import make_reader, NonSeekingReader
from mcap_protobuf.decoder import DecoderFactory
path = sys.argv[1]
with open(path, 'rb') as file:
    reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
    names = sorted(attachment.name for attachment in reader.iter_attachments())
    assert names == ['scene.json', 'task.json'], names
    assert [metadata.name for metadata in reader.iter_metadata()] == ['reel.episode']
    seen = {}
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        seen.setdefault(channel.topic, []).append(decoded)
    assert reader.get_summary().statistics.message_count == sum(map(len, seen.values()))
with open(path, 'rb') as file:
    reader = NonSeekingReader(file, validate_crcs=True)
    assert sum(1 for _ in reader.iter_messages()) == sum(map(len, seen.values()))
assert len(seen['/tool/call']) == len(seen['/sim/digest']) - 1 == 3, seen.keys()
assert [call.step for call in seen['/tool/call']] == [0, 1, 2]
image = seen['/camera/head'][0]
assert image.format == 'webp' and image.data[:4] == b'RIFF', image.format
assert seen['/camera/head/calibration'][0].width == 640
assert {t.child_frame_id for t in seen['/tf'][0].transforms} >= {'base', 'camera'}
assert len(seen['/scene'][0].entities) == 4
print('read')
";

/// Every text of a JSON value that begins with a slash.
fn topics(value: &Value, found: &mut BTreeSet<String>) {
    let mut take = |text: &str| {
        if text.starts_with('/') {
            found.insert(text.to_owned());
        }
    };
    match value {
        Value::String(text) => take(text),
        Value::Object(fields) => {
            fields.keys().for_each(|key| take(key));
            fields.values().for_each(|value| topics(value, found));
        }
        Value::Array(values) => values.iter().for_each(|value| topics(value, found)),
        _ => {}
    }
}

#[test]
fn the_layout_for_foxglove_names_topics_that_traces_have() {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../dashboards/foxglove-layout.json");
    let mut named = BTreeSet::new();
    topics(
        &serde_json::from_slice(&fs::read(file).unwrap()).unwrap(),
        &mut named,
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let (sample, frames) = Source::seeded(4).sample(3).with_frames();
    sample
        .record_open(&path, &frames, Images::Full)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    let trace = fs::read(path).unwrap();
    let written: BTreeSet<String> = MessageStream::new(&trace)
        .unwrap()
        .map(|message| message.unwrap().channel.topic.clone())
        .collect();
    let unknown: Vec<_> = named.difference(&written).collect();
    assert!(
        named.len() >= 6 && unknown.is_empty(),
        "{unknown:?} of {named:?}"
    );
}

#[test]
fn the_python_library_reads_it_and_validates_the_checksums() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let (sample, frames) = Source::seeded(4).sample(3).with_frames();
    sample
        .record_open(&path, &frames, Images::Full)
        .unwrap()
        .end(&sample.end)
        .unwrap();
    let Some(python) = reel_vectors::python("mcap, mcap_protobuf") else {
        return;
    };
    let said = reel_vectors::run(Command::new(python).args(["-c", SCRIPT]).arg(path));
    assert_eq!(said, "read\n");
}
