//! What else a robot recorded during an episode: joint states, transforms, images of further
//! cameras, poses of a reference. Each channel keeps the messages and the schema of the recording, so
//! that viewers read them as they read the robot's own file. Stands beside the records: no digest of the
//! hash chain covers it. Never decodes a message.

use std::{
    collections::BTreeMap,
    fmt,
    io::{Seek, Write},
    sync::Arc,
};

use mcap::{
    McapError,
    records::{self, MessageHeader},
};
use serde::Serialize;

use crate::journal::EPOCH_NS;

/// Topics of a trace below this one hold what a robot recorded on the topic after it.
pub const RECORDED: &str = "/recorded";

/// Key of the channel's metadata that says what the channel holds.
const KIND: &str = "reel.kind";
/// Key of the channel's metadata that names a camera.
const NAME: &str = "reel.name";
/// Key of the channel's metadata that says where a message has its image.
const DATA: &str = "reel.data";
/// Channel and schema ids from here on are those of sensors.
const FIRST_ID: u16 = 1000;

/// What a channel of sensors holds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SensorKind {
    /// Positions, velocities and efforts of joints.
    Joints,
    /// Transforms between coordinate frames.
    Transforms,
    /// Images of a camera other than the head's.
    Camera,
    /// Poses of the robot by a reference, such as motion capture.
    Reference,
}

impl SensorKind {
    const ALL: [(SensorKind, &str); 4] = [
        (SensorKind::Joints, "joints"),
        (SensorKind::Transforms, "transforms"),
        (SensorKind::Camera, "camera"),
        (SensorKind::Reference, "reference"),
    ];

    /// The word of the mapping file and of the channel's metadata.
    pub fn as_str(self) -> &'static str {
        let named = Self::ALL.iter().find(|(kind, _)| *kind == self);
        named.expect("all kinds have a word").1
    }
}

/// How the messages of a channel are to be read.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub struct SensorSchema {
    /// Name of the message type, e.g. `sensor_msgs/msg/JointState`.
    pub name: String,
    /// Encoding of the schema, e.g. `ros2msg`.
    pub encoding: String,
    /// Text or descriptors of the schema, in its encoding.
    pub data: Vec<u8>,
}

/// Messages of one topic of a robot's recording.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SensorChannel {
    /// Topic of the recording; the trace has it below [`RECORDED`].
    pub topic: String,
    /// What the messages hold.
    pub kind: SensorKind,
    /// Name of the camera; `None` if the channel is no camera.
    pub camera: Option<String>,
    /// JSON pointer to the image in a decoded message; `None` if the channel is no camera.
    pub image_at: Option<String>,
    /// Encoding of the messages: `cdr`, `protobuf` or `json`.
    pub encoding: String,
    /// How the messages are to be read; `None` if the recording does not say it.
    pub schema: Option<Arc<SensorSchema>>,
    /// The messages, in the order of the recording.
    pub messages: Vec<SensorMessage>,
}

/// One message of a robot's recording.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct SensorMessage {
    /// When it was recorded, in nanoseconds since 1970.
    pub unix_ns: u64,
    /// When it is shown, in nanoseconds on the clock of the trace.
    pub log_time_ns: u64,
    /// The message, in the encoding of its channel.
    pub data: Vec<u8>,
}

/// What a channel of sensors holds, in numbers.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct SensorSummary {
    /// Topic of the recording.
    pub topic: String,
    /// What the messages hold.
    pub kind: SensorKind,
    /// Name of the camera; `None` if the channel is no camera.
    pub camera: Option<String>,
    /// Name of the message type; `None` if the recording does not say it.
    pub schema: Option<String>,
    /// Encoding of the messages.
    pub encoding: String,
    /// How many messages there are.
    pub messages: usize,
    /// Bytes of all messages.
    pub bytes: u64,
    /// From the first message to the last, in seconds.
    pub duration_s: f64,
}

impl fmt::Display for SensorSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { topic, kind, .. } = self;
        write!(f, "{topic}: {}", kind.as_str())?;
        if let Some(camera) = &self.camera {
            write!(f, " {camera}")?;
        }
        let schema = self.schema.as_deref().unwrap_or("no schema");
        write!(
            f,
            ", {schema} in {}, {} messages in {:.1} s, {} bytes",
            self.encoding, self.messages, self.duration_s, self.bytes
        )
    }
}

impl SensorChannel {
    /// What the channel holds, in numbers.
    pub fn summary(&self) -> SensorSummary {
        let mut times: Vec<u64> = self.messages.iter().map(|it| it.unix_ns).collect();
        times.sort_unstable();
        let ends = times.first().zip(times.last());
        let bytes = self.messages.iter().map(|it| it.data.len() as u64);
        SensorSummary {
            topic: self.topic.clone(),
            kind: self.kind,
            camera: self.camera.clone(),
            schema: self.schema.as_ref().map(|schema| schema.name.clone()),
            encoding: self.encoding.clone(),
            messages: times.len(),
            bytes: bytes.sum(),
            duration_s: ends.map_or(0.0, |(first, last)| (last - first) as f64 / 1e9),
        }
    }

    /// The topic in the trace.
    pub fn trace_topic(&self) -> String {
        format!("{RECORDED}/{}", self.topic.trim_start_matches('/'))
    }

    fn metadata(&self) -> BTreeMap<String, String> {
        let mut metadata = BTreeMap::from([(KIND.to_owned(), self.kind.as_str().to_owned())]);
        let named = [(NAME, &self.camera), (DATA, &self.image_at)];
        for (key, value) in named {
            metadata.extend(value.clone().map(|value| (key.to_owned(), value)));
        }
        metadata
    }

    /// Writes schema, channel and messages as the channel number `index` of the sensors.
    pub(crate) fn write<W: Write + Seek>(
        &self,
        index: usize,
        writer: &mut mcap::Writer<W>,
    ) -> Result<(), McapError> {
        let id = u16::try_from(index)
            .ok()
            .and_then(|index| index.checked_add(FIRST_ID))
            .ok_or(McapError::TooManyChannels)?;
        let schema_id = match &self.schema {
            Some(schema) => {
                writer.add_schema_with_id(id, &schema.name, &schema.encoding, &schema.data)?;
                id
            }
            None => 0,
        };
        writer.add_channel_with_id(
            id,
            schema_id,
            &self.trace_topic(),
            &self.encoding,
            &self.metadata(),
        )?;
        for (sequence, message) in (1..).zip(&self.messages) {
            let header = MessageHeader {
                channel_id: id,
                sequence,
                log_time: message.log_time_ns,
                publish_time: message.unix_ns,
            };
            writer.write_to_known_channel(&header, &message.data)?;
        }
        Ok(())
    }
}

/// The moment on the clock of viewers of something that was recorded at `unix_ns`, in an episode whose
/// first call came at `began_unix_ns`: as long after the start of the clock, or before it.
pub fn log_time_ns(unix_ns: u64, began_unix_ns: u64) -> u64 {
    let since = i128::from(unix_ns) - i128::from(began_unix_ns);
    let at = (i128::from(EPOCH_NS) + since).clamp(0, i128::from(u64::MAX));
    u64::try_from(at).expect("it is clamped")
}

/// Whether a schema or channel of this id is one of sensors.
pub(crate) fn is_recorded_id(id: u16) -> bool {
    id >= FIRST_ID
}

/// Whether a topic of a trace holds what a robot recorded.
pub(crate) fn is_recorded(topic: &str) -> bool {
    topic
        .strip_prefix(RECORDED)
        .is_some_and(|rest| rest.starts_with('/'))
}

/// The channels of sensors while a trace is read.
#[derive(Default)]
pub(crate) struct SensorReader {
    schemas: BTreeMap<u16, Arc<SensorSchema>>,
    channels: BTreeMap<u16, SensorChannel>,
}

impl SensorReader {
    /// Takes a schema, of whatever channel.
    pub(crate) fn schema(&mut self, header: &records::SchemaHeader, data: &[u8]) {
        if is_recorded_id(header.id) {
            let schema = SensorSchema {
                name: header.name.clone(),
                encoding: header.encoding.clone(),
                data: data.to_vec(),
            };
            self.schemas.insert(header.id, Arc::new(schema));
        }
    }

    /// Takes a channel if it is one of sensors and says what it holds.
    pub(crate) fn channel(&mut self, channel: &records::Channel) {
        let said = channel.metadata.get(KIND);
        let kind = SensorKind::ALL
            .iter()
            .find(|(_, word)| said.is_some_and(|said| said == word));
        let topic = channel.topic.strip_prefix(RECORDED);
        let (Some((kind, _)), Some(topic)) = (kind, topic.filter(|it| it.starts_with('/'))) else {
            return;
        };
        // A file repeats its channels, in each chunk and in the index.
        self.channels
            .entry(channel.id)
            .or_insert_with(|| SensorChannel {
                topic: topic.to_owned(),
                kind: *kind,
                camera: channel.metadata.get(NAME).cloned(),
                image_at: channel.metadata.get(DATA).cloned(),
                encoding: channel.message_encoding.clone(),
                schema: self.schemas.get(&channel.schema_id).cloned(),
                messages: Vec::new(),
            });
    }

    /// Takes a message of a channel of sensors.
    pub(crate) fn message(&mut self, header: &MessageHeader, data: &[u8]) {
        if let Some(channel) = self.channels.get_mut(&header.channel_id) {
            channel.messages.push(SensorMessage {
                unix_ns: header.publish_time,
                log_time_ns: header.log_time,
                data: data.to_vec(),
            });
        }
    }

    /// The channels in the order in which they were written.
    pub(crate) fn into_channels(self) -> Vec<SensorChannel> {
        self.channels.into_values().collect()
    }
}
