//! Writes recordings of robots: the same messages in JSON, in protobuf with their descriptors, and
//! in CDR with `ros2msg` definitions, as MCAP files.

use std::{collections::BTreeMap, fs::File, io::BufWriter, path::Path};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use mcap::{Compression, WriteOptions, records::MessageHeader};
use prost::Message as _;
use prost_types::{
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet,
    field_descriptor_proto::{Label, Type as ProtoType},
};
use re_cdr::{CdrWriter, LittleEndian};
use serde_json::{Value, json};

/// When recordings begin, in nanoseconds since 1970.
pub const BEGIN_NS: u64 = 1_790_000_000_000_000_000;

/// How messages are written.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Encoding {
    Json,
    Protobuf,
    Cdr,
}

/// The type of a field.
#[derive(Clone, Copy)]
pub enum Field {
    Text,
    Flag,
    Count,
    Number,
    Bytes,
    Message(&'static str, &'static [(&'static str, Field)]),
    List(&'static Field),
}

use Field::{Bytes, Count, Flag, List, Message, Number, Text};

#[rustfmt::skip]
const VECTOR: Field = Message("geometry_msgs/Vector3", &[("x", Number), ("y", Number), ("z", Number)]);
#[rustfmt::skip]
const QUATERNION: Field =
    Message("geometry_msgs/Quaternion", &[("x", Number), ("y", Number), ("z", Number), ("w", Number)]);
const TRANSFORM: Field = Message(
    "geometry_msgs/TransformStamped",
    &[
        ("header", Message("std_msgs/Header", &[("frame_id", Text)])),
        ("child_frame_id", Text),
        (
            "transform",
            Message(
                "geometry_msgs/Transform",
                &[("translation", VECTOR), ("rotation", QUATERNION)],
            ),
        ),
    ],
);
const TRANSFORMS: Field = Message("tf2_msgs/TFMessage", &[("transforms", List(&TRANSFORM))]);

/// The topics, and what their messages consist of.
#[rustfmt::skip]
const TYPES: &[(&str, Field)] = &[
    (
        "/episode",
        Message(
            "robot_msgs/Episode",
            &[
                ("event", Text),
                ("task_id", Text),
                ("instruction", Text),
                ("policy", Text),
                ("reason", Text),
                ("success", Flag),
                ("shortest_path_m", Number),
            ],
        ),
    ),
    ("/call", Message("robot_msgs/Call", &[("id", Text), ("tool", Text), ("arguments", Text)])),
    (
        "/result",
        Message(
            "robot_msgs/Result",
            &[
                ("id", Text),
                ("text", Text),
                ("success", Flag),
                ("error", Text),
            ],
        ),
    ),
    (
        "/primitive",
        Message(
            "robot_msgs/Primitive",
            &[
                ("skill", Text),
                ("target", Text),
                ("success", Flag),
                ("duration_s", Number),
                ("control_steps", Count),
                ("error", Text),
            ],
        ),
    ),
    ("/vla", Message("robot_msgs/Latency", &[("latency_s", Number)])),
    (
        "/alignment",
        Message(
            "robot_msgs/Alignment",
            &[
                ("target", Text),
                ("odometry_error_m", Number),
                ("yaw_error_rad", Number),
                ("image_shift_px", Number),
            ],
        ),
    ),
    (
        "/odom",
        Message(
            "nav_msgs/Odometry",
            &[
                ("child_frame_id", Text),
                (
                    "pose",
                    Message(
                        "geometry_msgs/PoseWithCovariance",
                        &[(
                            "pose",
                            Message(
                                "geometry_msgs/Pose",
                                &[
                                    (
                                        "position",
                                        Message(
                                            "geometry_msgs/Point",
                                            &[("x", Number), ("y", Number), ("z", Number)],
                                        ),
                                    ),
                                    (
                                        "orientation",
                                        Message(
                                            "geometry_msgs/Quaternion",
                                            &[
                                                ("x", Number),
                                                ("y", Number),
                                                ("z", Number),
                                                ("w", Number),
                                            ],
                                        ),
                                    ),
                                ],
                            ),
                        )],
                    ),
                ),
            ],
        ),
    ),
    ("/camera", Message("sensor_msgs/CompressedImage", &[("format", Text), ("data", Bytes)])),
    (
        "/raw",
        Message(
            "sensor_msgs/Image",
            &[
                ("height", Count),
                ("width", Count),
                ("encoding", Text),
                ("step", Count),
                ("data", Bytes),
            ],
        ),
    ),
    ("/wrist", Message("sensor_msgs/CompressedImage", &[("format", Text), ("data", Bytes)])),
    ("/mocap", Message("geometry_msgs/Pose2D", &[("x", Number), ("y", Number), ("theta", Number)])),
    (
        "/joint_states",
        Message(
            "sensor_msgs/JointState",
            &[
                ("name", List(&Text)),
                ("position", List(&Number)),
                ("velocity", List(&Number)),
            ],
        ),
    ),
    ("/tf", TRANSFORMS),
    ("/tf_static", TRANSFORMS),
    ("/graph", Message("std_msgs/String", &[("data", Text)])),
    ("/held", Message("std_msgs/String", &[("data", Text)])),
    ("/map", Message("std_msgs/String", &[("data", Text)])),
    ("/markers", Message("std_msgs/String", &[("data", Text)])),
    ("/policy", Message("robot_msgs/Policy", &[("raw", Text), ("latency_s", Number)])),
    ("/reply", Message("robot_msgs/Reply", &[("text", Text), ("source", Text)])),
    ("/diagnostics", Message("std_msgs/String", &[("data", Text)])),
];

/// What the topics are.
pub const MAPPING: &str = r#"
policy = "qwen-vl"

[tools.grasp]
is = "pick"
arguments = { marker_id = "number" }

[topics]
"/episode" = { is = "episode" }
"/call" = { is = "call" }
"/result" = { is = "result" }
"/primitive" = { is = "primitive" }
"/vla" = { is = "vla" }
"/alignment" = { is = "alignment" }
"/odom" = { is = "odometry" }
"/camera" = { is = "camera" }
"/raw" = { is = "camera" }
"/graph" = { is = "graph" }
"/held" = { is = "held" }
"/markers" = { is = "markers" }
"/policy" = { is = "policy" }
"/reply" = { is = "reply" }
"#;

/// A mapping of trials: nobody calls.
pub const TRIALS: &str = r#"
[topics]
"/primitive" = { is = "primitive" }
"/odom" = { is = "odometry" }
"/camera" = { is = "camera" }
"/alignment" = { is = "alignment" }
"#;

/// What was said: when, on which topic, and what; bytes are in Base64.
#[derive(Clone, Debug)]
pub struct Said {
    pub ns: u64,
    pub topic: &'static str,
    pub value: Value,
    /// Written instead of it.
    pub instead: Option<Vec<u8>>,
}

/// A message, so many milliseconds after the beginning.
pub fn said(ms: u64, topic: &'static str, value: Value) -> Said {
    Said {
        ns: BEGIN_NS + ms * 1_000_000,
        topic,
        value,
        instead: None,
    }
}

/// A measured pose that looks along +y.
pub fn odometry(ms: u64, x: f64, y: f64) -> Said {
    let half = std::f64::consts::FRAC_PI_4;
    let pose = json!({"position": {"x": x, "y": y, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": half.sin(), "w": half.cos()}});
    said(
        ms,
        "/odom",
        json!({"child_frame_id": "base", "pose": {"pose": pose}}),
    )
}

/// An image of the camera: one colour, as a file in JPEG.
pub fn jpeg(ms: u64, (width, height): (u16, u16), colour: [u8; 3]) -> Said {
    let rgb = colour.repeat(usize::from(width) * usize::from(height));
    let mut data = Vec::new();
    jpeg_encoder::Encoder::new(&mut data, 95)
        .encode(&rgb, width, height, jpeg_encoder::ColorType::Rgb)
        .unwrap();
    said(
        ms,
        "/camera",
        json!({"format": "jpeg", "data": STANDARD.encode(data)}),
    )
}

/// Writes a finished file. Few messages a chunk, so that damage has somewhere to be.
pub fn write(path: &Path, messages: &[Said], encoding: Encoding) {
    write_with(path, messages, encoding, Some(Compression::Zstd));
}

pub fn write_with(
    path: &Path,
    messages: &[Said],
    encoding: Encoding,
    compression: Option<Compression>,
) {
    let options = WriteOptions::new()
        .chunk_size(Some(2_000))
        .compression(compression)
        .compression_threads(0);
    let mut writer = options
        .create(BufWriter::new(File::create(path).unwrap()))
        .unwrap();
    let mut channels = BTreeMap::new();
    for (sequence, message) in (0..).zip(messages) {
        let of = TYPES
            .iter()
            .find(|(topic, _)| *topic == message.topic)
            .unwrap_or_else(|| panic!("{} has no type", message.topic))
            .1;
        let id = *channels
            .entry(message.topic)
            .or_insert_with(|| channel(&mut writer, message.topic, of, encoding));
        let header = MessageHeader {
            channel_id: id,
            sequence,
            log_time: message.ns,
            publish_time: message.ns,
        };
        let data = message
            .instead
            .clone()
            .unwrap_or_else(|| encode(&message.value, of, encoding));
        writer.write_to_known_channel(&header, &data).unwrap();
    }
    writer.finish().unwrap();
}

fn channel(
    writer: &mut mcap::Writer<BufWriter<File>>,
    topic: &str,
    of: Field,
    encoding: Encoding,
) -> u16 {
    let Message(name, _) = of else {
        panic!("a topic has messages")
    };
    let metadata = BTreeMap::new();
    let (schema, encoding) = match encoding {
        Encoding::Json => (0, "json"),
        Encoding::Protobuf => {
            let schema = writer.add_schema(&name.replace('/', "."), "protobuf", &descriptors(of));
            (schema.unwrap(), "protobuf")
        }
        Encoding::Cdr => {
            let schema = writer.add_schema(
                &name.replace('/', "/msg/"),
                "ros2msg",
                definition(of).as_bytes(),
            );
            (schema.unwrap(), "cdr")
        }
    };
    writer
        .add_channel(schema, topic, encoding, &metadata)
        .unwrap()
}

/// Name, encoding and text of a schema.
pub type Schema<'a> = (&'a str, &'a str, &'a [u8]);

/// Writes a file with one message under a schema of any bytes.
pub fn write_under(path: &Path, schema: Schema<'_>, encoding: &str, message: &[u8]) {
    let mut writer = mcap::Writer::new(BufWriter::new(File::create(path).unwrap())).unwrap();
    let schema = writer.add_schema(schema.0, schema.1, schema.2).unwrap();
    let channel_id = writer
        .add_channel(schema, "/call", encoding, &BTreeMap::new())
        .unwrap();
    let header = MessageHeader {
        channel_id,
        sequence: 0,
        log_time: BEGIN_NS,
        publish_time: BEGIN_NS,
    };
    writer.write_to_known_channel(&header, message).unwrap();
    writer.finish().unwrap();
}

fn encode(value: &Value, of: Field, encoding: Encoding) -> Vec<u8> {
    match encoding {
        Encoding::Json => value.to_string().into_bytes(),
        Encoding::Protobuf => protobuf(value, of),
        Encoding::Cdr => {
            let mut body = Vec::new();
            cdr(&mut CdrWriter::new(&mut body), value, of);
            [vec![0, 1, 0, 0], body].concat()
        }
    }
}

/// The messages in a message, deepest last.
fn inner(of: Field) -> Vec<Field> {
    let fields = match of {
        Message(_, fields) => fields,
        List(of) => return inner(*of),
        _ => return Vec::new(),
    };
    [
        vec![of],
        fields.iter().flat_map(|(_, field)| inner(*field)).collect(),
    ]
    .concat()
}

fn definition(of: Field) -> String {
    let lines = |of: Field| -> String {
        let Message(_, fields) = of else {
            panic!("only messages are defined")
        };
        let line = |(name, field): &(&str, Field)| {
            let (field, list) = match field {
                List(of) => (*of, "[]"),
                field => (field, ""),
            };
            let word = match field {
                Text => "string",
                Flag => "bool",
                Count => "uint32",
                Number => "float64",
                Bytes => "uint8[]",
                Message(name, _) => name,
                List(_) => panic!("no list of lists"),
            };
            format!("{word}{list} {name}\n")
        };
        fields.iter().map(line).collect()
    };
    let mut text = format!("# a comment\nuint8 SOME_CONSTANT=3\n{}", lines(of));
    for of in inner(of).into_iter().skip(1) {
        let Message(name, _) = of else { continue };
        text += &format!("{}\nMSG: {name}\n{}", "=".repeat(80), lines(of));
    }
    text
}

fn descriptors(of: Field) -> Vec<u8> {
    let file = |of: Field| {
        let Message(name, fields) = of else {
            panic!("only messages are described")
        };
        let (package, name) = name.split_once('/').unwrap();
        let field = |(number, (name, field)): (i32, &(&str, Field))| {
            let (field, label) = match field {
                List(of) => (*of, Label::Repeated),
                field => (field, Label::Optional),
            };
            let (kind, type_name) = match field {
                List(_) => panic!("no list of lists"),
                Text => (ProtoType::String, None),
                Flag => (ProtoType::Bool, None),
                Count => (ProtoType::Uint32, None),
                Number => (ProtoType::Double, None),
                Bytes => (ProtoType::Bytes, None),
                Message(name, _) => (
                    ProtoType::Message,
                    Some(format!(".{}", name.replace('/', "."))),
                ),
            };
            FieldDescriptorProto {
                name: Some((*name).to_owned()),
                number: Some(number),
                label: Some(label.into()),
                r#type: Some(kind.into()),
                type_name,
                ..FieldDescriptorProto::default()
            }
        };
        let message = DescriptorProto {
            name: Some(name.to_owned()),
            field: (1..).zip(fields).map(field).collect(),
            ..DescriptorProto::default()
        };
        let imports = fields.iter().filter_map(|(_, field)| match field {
            Message(name, _) | List(Message(name, _)) => Some(format!("{name}.proto")),
            _ => None,
        });
        FileDescriptorProto {
            name: Some(format!("{package}/{name}.proto")),
            package: Some(package.to_owned()),
            dependency: imports.collect(),
            message_type: vec![message],
            syntax: Some("proto3".to_owned()),
            ..FileDescriptorProto::default()
        }
    };
    FileDescriptorSet {
        file: inner(of).into_iter().rev().map(file).collect(),
    }
    .encode_to_vec()
}

fn protobuf(value: &Value, of: Field) -> Vec<u8> {
    let Message(_, fields) = of else {
        panic!("only messages are encoded")
    };
    let mut bytes = Vec::new();
    for (number, (name, field)) in (1u8..).zip(fields) {
        let value = &value[name];
        let mut delimited = |data: &[u8]| {
            bytes.push(number << 3 | 2);
            prost::encoding::encode_varint(data.len() as u64, &mut bytes);
            bytes.extend(data);
        };
        // As proto3 does: what is zero is not written.
        match field {
            Text if value.as_str().unwrap_or_default().is_empty() => {}
            Text => delimited(value.as_str().unwrap().as_bytes()),
            Bytes => delimited(&STANDARD.decode(value.as_str().unwrap()).unwrap()),
            Message(..) => delimited(&protobuf(value, *field)),
            List(Number) => {
                let values = value.as_array().into_iter().flatten();
                let packed: Vec<u8> = values
                    .flat_map(|value| value.as_f64().unwrap().to_le_bytes())
                    .collect();
                delimited(&packed);
            }
            List(of) => {
                for value in value.as_array().into_iter().flatten() {
                    match of {
                        Text => delimited(value.as_str().unwrap().as_bytes()),
                        of => delimited(&protobuf(value, **of)),
                    }
                }
            }
            Flag | Count => {
                let value = value
                    .as_u64()
                    .unwrap_or(u64::from(value.as_bool().unwrap_or_default()));
                if value > 0 {
                    bytes.push(number << 3);
                    prost::encoding::encode_varint(value, &mut bytes);
                }
            }
            Number => {
                let value = value.as_f64().unwrap_or_default();
                if value != 0.0 {
                    bytes.push(number << 3 | 1);
                    bytes.extend(value.to_le_bytes());
                }
            }
        }
    }
    bytes
}

fn cdr(writer: &mut CdrWriter<'_, LittleEndian>, value: &Value, of: Field) {
    match of {
        Text => writer.write_string(value.as_str().unwrap_or_default()),
        Flag => writer.write_bool(value.as_bool().unwrap_or_default()),
        Count => writer.write_u32(value.as_u64().unwrap_or_default() as u32),
        Number => writer.write_f64(value.as_f64().unwrap_or_default()),
        Bytes => writer.write_bytes(&STANDARD.decode(value.as_str().unwrap()).unwrap()),
        Message(_, fields) => fields
            .iter()
            .for_each(|(name, field)| cdr(writer, &value[name], *field)),
        List(of) => {
            let values = value.as_array().cloned().unwrap_or_default();
            writer.write_u32(values.len() as u32);
            values.iter().for_each(|value| cdr(writer, value, *of));
        }
    }
}
