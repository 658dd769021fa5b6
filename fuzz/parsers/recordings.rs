//! Episodes that were played elsewhere: recordings of robots, `eval_output` of REAL's agents.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::BufWriter,
    path::{Component, Path},
    sync::LazyLock,
};

use mcap::records::MessageHeader;
use reel_import::{ImportOptions, robot};

use super::{file, folder, text};

/// Begins a file in an input that stands for a folder; its path follows.
const FILE: &str = "=== ";
const SECOND_NS: u64 = 1_000_000_000;

/// A mapping of topics of every kind.
static MAPPING: LazyLock<robot::Mapping> = LazyLock::new(|| {
    robot::Mapping::parse(include_str!("../corpus/mapping/robot.toml"))
        .expect("a mapping of the corpus")
});

/// The topics that it names.
const TOPICS: &[&str] = &[
    "/agent/call",
    "/agent/output",
    "/agent/result",
    "/alignment",
    "/episode",
    "/head/image/compressed",
    "/odom",
    "/skill/outcome",
    "/user/answer",
    "/vla/latency",
];

/// A file of a robot.
pub fn bag(bytes: &[u8]) {
    file(bytes, "recording.mcap", robot_recording);
}

/// One message of a sound file: `j`, `p` or `c` (JSON, protobuf, CDR), its topic (a byte), the
/// length of its schema (two bytes), the schema, the message.
pub fn bag_message(bytes: &[u8]) {
    let [form, topic, low, high, rest @ ..] = bytes else {
        return;
    };
    let length = usize::from(u16::from_le_bytes([*low, *high]));
    let (schema, message) = rest.split_at(length.min(rest.len()));
    let topic = TOPICS[usize::from(*topic) % TOPICS.len()];
    let schema = match form {
        b'p' => Some(("m.M", "protobuf", "protobuf", schema)),
        b'c' => Some(("m/msg/M", "ros2msg", "cdr", schema)),
        _ => None,
    };
    let folder = folder();
    let path = folder.path().join("recording.mcap");
    write_bag(
        &path,
        &[
            (
                TOPICS[0],
                None,
                br#"{"tool": "nav_to", "arguments": {"receptacle_name": "table_1"}}"#,
            ),
            (topic, schema, message),
            (TOPICS[0], None, br#"{"tool": "finish", "arguments": {}}"#),
        ],
    );
    robot_recording(&path);
}

/// What rosbag2 writes beside its files.
pub fn bag_metadata(bytes: &[u8]) {
    let folder = folder();
    let bag = folder.path().join("bag");
    fs::create_dir(&bag).expect("a temporary folder");
    fs::write(bag.join("metadata.yaml"), bytes).expect("a temporary file");
    let call = br#"{"tool": "finish", "arguments": {}}"#;
    write_bag(&bag.join("bag_0.mcap"), &[(TOPICS[0], None, call)]);
    robot_recording(&bag);
}

/// The folder of an episode: files, each behind a line `=== PATH`.
pub fn eval_output(bytes: &[u8]) {
    text(bytes, |text| {
        let folder = folder();
        let (source, out) = (
            folder.path().join("in/scene/task/model"),
            folder.path().join("out"),
        );
        for path in [&source, &out] {
            fs::create_dir_all(path).expect("a temporary folder");
        }
        for part in text.split(FILE).skip(1) {
            let (name, content) = part.split_once('\n').unwrap_or((part, ""));
            write_inside(&source, name.trim(), content);
        }
        let _ = reel_import::import(&source, &out, &OPTIONS);
    });
}

const OPTIONS: ImportOptions<'_> = ImportOptions {
    run_id: "fuzz",
    tasks: &[],
    scenes: None,
};

/// Writes a file, if its path stays in the folder. What has no place there is left out.
fn write_inside(folder: &Path, name: &str, content: &str) {
    let name = Path::new(name);
    let stays = |part: Component<'_>| matches!(part, Component::Normal(_));
    if name.components().count() == 0 || !name.components().all(stays) {
        return;
    }
    let path = folder.join(name);
    if let Some(parent) = path.parent() {
        let _ = fs::create_dir_all(parent);
    }
    let _ = fs::write(path, content);
}

fn robot_recording(path: &Path) {
    let out = folder();
    let _ = robot::import(path, &MAPPING, out.path(), &OPTIONS);
}

/// Name, form, form of the messages, and text of a schema; `None` for JSON.
type Schema<'a> = Option<(&'a str, &'a str, &'a str, &'a [u8])>;

/// Writes a finished file, a message a second.
fn write_bag(path: &Path, messages: &[(&str, Schema<'_>, &[u8])]) {
    let file = BufWriter::new(File::create(path).expect("a temporary file"));
    let options = mcap::WriteOptions::new().compression(None);
    let mut writer = options.create(file).expect("a new file");
    for (number, (topic, schema, message)) in (0..).zip(messages) {
        let (schema, form) = match schema {
            Some((name, encoding, form, text)) => {
                let schema = writer.add_schema(name, encoding, text);
                (schema.expect("few schemas"), *form)
            }
            None => (0, "json"),
        };
        let channel_id = writer
            .add_channel(schema, topic, form, &BTreeMap::new())
            .expect("few channels");
        let time = SECOND_NS * u64::from(number);
        let header = MessageHeader {
            channel_id,
            sequence: number,
            log_time: time,
            publish_time: time,
        };
        writer
            .write_to_known_channel(&header, message)
            .expect("a temporary file");
    }
    writer.finish().expect("a temporary file");
}
