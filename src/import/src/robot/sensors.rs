//! What a recording holds besides an episode's own messages: joint states, transforms, further
//! cameras, a reference's poses. Checks each message, and puts those of an episode together to channels
//! of its trace, as they came. Knows no order of events.

use std::{collections::BTreeMap, sync::Arc};

use reel_trace::{
    Trace,
    robot::CameraImage,
    sensors::{SensorChannel, SensorKind, SensorMessage, SensorSchema, log_time_ns},
};
use serde_json::Value;

use super::{
    assemble::ImageLocation,
    bag,
    decode::Decoders,
    event::{EntryMessage, Event, EventPayload, SensorEvent, axis},
    image,
    mapping::{Entry, HEAD, Kind, Mapping},
};

/// Bytes of such messages that are kept of a recording; a trace is read as a whole.
const BYTES_MAX: u64 = 1 << 30;
/// Images a second of a camera, where the mapping does not say it.
const CAMERA_HZ: f64 = 5.0;

/// A topic whose messages are kept as they came.
pub(crate) struct SensorSource {
    topic: String,
    kind: SensorKind,
    camera: Option<String>,
    /// Where a message has its image.
    image_at: Option<String>,
    /// Least time between two messages that are kept.
    period_ns: u64,
    /// Whether what was said before an episode holds in it, as in `/tf_static`.
    pub is_latched: bool,
}

impl SensorSource {
    pub(crate) fn is_of(&self, topic: &str) -> bool {
        self.topic == topic
    }

    pub(crate) fn is_camera(&self) -> bool {
        self.kind == SensorKind::Camera
    }
}

/// Events without the images of further cameras that follow another too soon; they are in the order
/// of time.
pub(crate) fn thinned(mut events: Vec<Event>, sources: &[SensorSource]) -> Vec<Event> {
    let mut kept_ns: BTreeMap<usize, u64> = BTreeMap::new();
    events.retain(|event| {
        let EventPayload::Sensor(SensorEvent { source, .. }) = event.payload else {
            return true;
        };
        let last = kept_ns.get(&source);
        let is_due = last.is_none_or(|last| event.ns - last >= sources[source].period_ns);
        if is_due {
            kept_ns.insert(source, event.ns);
        }
        is_due
    });
    events
}

/// The topics of a mapping whose messages are kept, in the order of their names.
pub(crate) fn sources(mapping: &Mapping) -> Vec<SensorSource> {
    let topics = mapping.topics.iter();
    let kept = topics.filter_map(|(topic, entries)| {
        let (entry, kind) = entries
            .iter()
            .find_map(|entry| Some((entry, kind(entry)?)))?;
        let is_camera = kind == SensorKind::Camera;
        let hz = entry.max_hz.unwrap_or(CAMERA_HZ);
        Some(SensorSource {
            topic: topic.clone(),
            kind,
            camera: entry.name.clone(),
            image_at: is_camera.then(|| entry.places("data")[0].to_owned()),
            period_ns: if is_camera && hz > 0.0 {
                (1e9 / hz) as u64
            } else {
                0
            },
            is_latched: topic.ends_with("tf_static"),
        })
    });
    kept.collect()
}

/// What the messages of an entry are kept as; `None` if they are not.
pub(crate) fn kind(entry: &Entry) -> Option<SensorKind> {
    match entry.kind {
        Kind::Joints => Some(SensorKind::Joints),
        Kind::Transforms => Some(SensorKind::Transforms),
        Kind::Reference => Some(SensorKind::Reference),
        Kind::Camera if entry.name.as_deref().unwrap_or(HEAD) != HEAD => Some(SensorKind::Camera),
        _ => None,
    }
}

/// Checks a message of joint states: `sensor_msgs/JointState`, or a list of joints as in
/// `foxglove.JointStates`.
pub(super) fn check_joints(said: &EntryMessage<'_>) -> Result<(), String> {
    const QUANTITIES: [&str; 3] = ["position", "velocity", "effort"];
    if let Some(joints) = said.get("joints").and_then(Value::as_array) {
        for (index, joint) in joints.iter().enumerate() {
            if !joint.get("name").is_some_and(Value::is_string) {
                return Err(format!("joint {index} has no name"));
            }
            let is_told = |key: &&str| joint.get(*key).is_some_and(Value::is_number);
            if !QUANTITIES.iter().any(is_told) {
                return Err(format!("joint {index} has no position, velocity or effort"));
            }
        }
        return Ok(());
    }
    let names = said.get("name").and_then(Value::as_array);
    let names = names.ok_or_else(|| said.missing("name"))?;
    let mut told = false;
    for key in QUANTITIES {
        let Some(values) = said.get(key).and_then(Value::as_array) else {
            continue;
        };
        if !values.is_empty() && values.len() != names.len() {
            return Err(format!(
                "{} values of {key} for {} joints",
                values.len(),
                names.len()
            ));
        }
        told |= !values.is_empty();
    }
    if told || names.is_empty() {
        Ok(())
    } else {
        Err(format!(
            "{} joints without position, velocity and effort",
            names.len()
        ))
    }
}

/// Checks a message of transforms: `tf2_msgs/TFMessage`, `foxglove.FrameTransforms`, or one
/// transform as in `foxglove.FrameTransform`.
pub(super) fn check_transforms(said: &EntryMessage<'_>) -> Result<(), String> {
    let told = said
        .get("transforms")
        .ok_or_else(|| said.missing("transforms"))?;
    let one = std::slice::from_ref(told);
    let all = told.as_array().map_or(one, Vec::as_slice);
    for (index, transform) in all.iter().enumerate() {
        let named = |places: &[&str]| {
            let mut found = places.iter().filter_map(|place| transform.pointer(place));
            found.any(|name| name.as_str().is_some_and(|name| !name.is_empty()))
        };
        let has = |places: [&str; 2], axes: &[&str]| {
            let mut found = places.iter().filter_map(|place| transform.pointer(place));
            found.any(|value| {
                let mut axes = axes.iter().enumerate();
                axes.all(|(index, name)| axis(value, name, index).is_some())
            })
        };
        let missing = if !named(&["/header/frame_id", "/parent_frame_id"]) {
            "parent frame"
        } else if !named(&["/child_frame_id"]) {
            "child frame"
        } else if !has(["/transform/translation", "/translation"], &["x", "y", "z"]) {
            "translation"
        } else if !has(["/transform/rotation", "/rotation"], &["x", "y", "z", "w"]) {
            "rotation"
        } else {
            continue;
        };
        return Err(format!("transform {index} has no {missing}"));
    }
    Ok(())
}

/// The messages that episodes keep, by where they stand in the recording.
#[derive(Default)]
pub(crate) struct SensorMessages {
    kept: BTreeMap<ImageLocation, RawMessage>,
    bytes: u64,
    /// How many messages did not fit.
    left_out: u64,
}

struct RawMessage {
    encoding: String,
    schema: Option<Arc<SensorSchema>>,
    data: Vec<u8>,
}

impl SensorMessages {
    /// Takes a message of a source, unless its image cannot be read or there are too many.
    ///
    /// # Errors
    /// What is wrong with the image.
    pub(crate) fn take(
        &mut self,
        place: ImageLocation,
        source: &SensorSource,
        message: &bag::Message<'_>,
        decoders: &mut Decoders,
    ) -> Result<(), String> {
        if let Some(pointer) = &source.image_at {
            let value = decoders.decode(message.channel, message.data)?;
            image::of_message(&value, pointer)?;
        }
        let bytes = message.data.len() as u64;
        if self.bytes + bytes > BYTES_MAX {
            self.left_out += 1;
            return Ok(());
        }
        self.bytes += bytes;
        let known = self.kept.range(..place).next_back();
        let schema = message.channel.schema.as_ref().map(|schema| {
            let schema = SensorSchema {
                name: schema.name.clone(),
                encoding: schema.encoding.clone(),
                data: schema.data.to_vec(),
            };
            // Messages of a topic mostly follow each other: they share the schema.
            let before = known.and_then(|(_, message)| message.schema.clone());
            before
                .filter(|before| **before == schema)
                .unwrap_or_else(|| Arc::new(schema))
        });
        let raw = RawMessage {
            encoding: message.channel.message_encoding.clone(),
            schema,
            data: message.data.to_vec(),
        };
        self.kept.insert(place, raw);
        Ok(())
    }

    /// What did not fit, in words; `None` if all did.
    pub(crate) fn excess(&self) -> Option<String> {
        (self.left_out > 0).then(|| {
            format!(
                "{} messages of joints, transforms and cameras are left out: more than {} MiB; lower max_hz of its cameras",
                self.left_out,
                BYTES_MAX >> 20
            )
        })
    }

    /// The channels of an episode that began at `began_ns`; its events are in the order of time.
    pub(crate) fn channels(
        &self,
        events: &[(u64, SensorEvent)],
        sources: &[SensorSource],
        began_ns: u64,
    ) -> Vec<SensorChannel> {
        let mut channels: BTreeMap<_, SensorChannel> = BTreeMap::new();
        for (unix_ns, event) in events {
            let (Some(raw), source) = (self.kept.get(&event.place), &sources[event.source]) else {
                continue;
            };
            let key = (event.source, raw.encoding.clone(), raw.schema.clone());
            let channel = channels.entry(key).or_insert_with(|| SensorChannel {
                topic: source.topic.clone(),
                kind: source.kind,
                camera: source.camera.clone(),
                image_at: source.image_at.clone(),
                encoding: raw.encoding.clone(),
                schema: raw.schema.clone(),
                messages: Vec::new(),
            });
            channel.messages.push(SensorMessage {
                unix_ns: *unix_ns,
                log_time_ns: log_time_ns(*unix_ns, began_ns),
                data: raw.data.clone(),
            });
        }
        channels.into_values().collect()
    }
}

/// The images of a camera that a trace keeps beside those of the head: when each was recorded, in
/// nanoseconds since 1970, and the image or why it cannot be read. `None` if the trace has no such
/// camera; it is named by the topic of the recording or by its name in the mapping.
pub fn camera_frames(
    trace: &Trace,
    camera: &str,
) -> Option<Vec<(u64, Result<CameraImage, String>)>> {
    let is_it = |channel: &&SensorChannel| {
        channel.kind == SensorKind::Camera
            && (channel.topic == camera || channel.camera.as_deref() == Some(camera))
    };
    let channels: Vec<&SensorChannel> = trace.sensors.iter().filter(is_it).collect();
    if channels.is_empty() {
        return None;
    }
    let mut frames = Vec::new();
    for channel in channels {
        let mut decoders = Decoders::default();
        let described = described(channel);
        let pointer = channel.image_at.as_deref().unwrap_or("/data");
        for message in &channel.messages {
            let read = decoders
                .decode(&described, &message.data)
                .and_then(|value| image::of_message(&value, pointer));
            frames.push((message.unix_ns, read));
        }
    }
    frames.sort_by_key(|(unix_ns, _)| *unix_ns);
    Some(frames)
}

/// A channel of a trace as the decoders take one.
fn described(channel: &SensorChannel) -> mcap::Channel<'_> {
    let schema = channel.schema.as_ref().map(|schema| {
        Arc::new(mcap::Schema {
            id: 1,
            name: schema.name.clone(),
            encoding: schema.encoding.clone(),
            data: schema.data.as_slice().into(),
        })
    });
    mcap::Channel {
        id: 1,
        topic: channel.topic.clone(),
        schema,
        message_encoding: channel.encoding.clone(),
        metadata: BTreeMap::new(),
    }
}
