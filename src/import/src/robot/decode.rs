//! Messages as JSON values: JSON itself, protobuf by the descriptors in the file, CDR by the
//! `ros2msg` definitions in the file. Bytes become Base64, as protobuf's own JSON has them; numbers
//! that are none become null.

use std::{collections::BTreeMap, panic::catch_unwind};

use base64::{Engine as _, engine::general_purpose::STANDARD};
use prost_reflect::{
    DescriptorPool, DynamicMessage, MapKey, MessageDescriptor, ReflectMessage as _,
};
use re_cdr::{BigEndian, CdrEndian, CdrReader, LittleEndian};
use re_ros_msg::{
    MessageSchema,
    message_spec::{
        ArraySize, BuiltInType, ComplexType, MessageSpecification, Type, message_package,
    },
};
use serde_json::{Map, Value};

/// Deepest message in messages.
const DEPTH_MAX: usize = 64;
/// What comes before a message in CDR: two bytes say how it is written.
const CDR_HEAD: usize = 4;

/// The decoders of the channels of one file.
#[derive(Default)]
pub(crate) struct Decoders(BTreeMap<u16, Result<Form, String>>);

/// How the messages of a channel are written.
enum Form {
    Json,
    Protobuf(MessageDescriptor),
    Cdr(Box<MessageSchema>),
}

impl Decoders {
    /// What a message says.
    ///
    /// # Errors
    /// Why it cannot be read.
    pub(crate) fn decode(
        &mut self,
        channel: &mcap::Channel<'_>,
        data: &[u8],
    ) -> Result<Value, String> {
        let form = self
            .0
            .entry(channel.id)
            .or_insert_with(|| Form::of(channel))
            .as_ref()
            .map_err(Clone::clone)?;
        let value = match form {
            Form::Json => {
                serde_json::from_slice(data).map_err(|error| format!("no JSON: {error}"))?
            }
            Form::Protobuf(descriptor) => {
                let message = DynamicMessage::decode(descriptor.clone(), data);
                protobuf_message(
                    &message.map_err(|error| format!("no {}: {error}", descriptor.full_name()))?,
                )
            }
            Form::Cdr(schema) => {
                cdr(schema, data).map_err(|error| format!("no {}: {error}", schema.spec.name))?
            }
        };
        Ok(told_in_text(value))
    }
}

impl Form {
    fn of(channel: &mcap::Channel<'_>) -> Result<Self, String> {
        let schema = || {
            channel
                .schema
                .as_ref()
                .ok_or_else(|| "the topic has no schema".to_owned())
        };
        match channel.message_encoding.as_str() {
            "json" => Ok(Form::Json),
            "protobuf" => {
                let schema = schema()?;
                // The library panics on some descriptors instead of refusing them.
                let pool = catch_unwind(|| {
                    DescriptorPool::decode(schema.data.as_ref()).map_err(|error| error.to_string())
                });
                let pool = pool
                    .unwrap_or_else(|_| Err("its descriptors contradict themselves".to_owned()));
                let pool = pool.map_err(|error| {
                    format!("the schema of {} cannot be read: {error}", schema.name)
                })?;
                let message = pool.get_message_by_name(&schema.name);
                message
                    .map(Form::Protobuf)
                    .ok_or_else(|| format!("the schema does not define {}", schema.name))
            }
            "cdr" => {
                let schema = schema()?;
                if schema.encoding != "ros2msg" {
                    return Err(format!(
                        "a schema in {}; of CDR only ros2msg is read",
                        schema.encoding
                    ));
                }
                let text = std::str::from_utf8(&schema.data)
                    .map_err(|_| "the schema is no text".to_owned())?;
                let parsed = MessageSchema::parse(&schema.name, text);
                parsed
                    .map(|schema| Form::Cdr(Box::new(schema)))
                    .map_err(|error| format!("the schema cannot be read: {error:#}"))
            }
            other => Err(format!(
                "messages in the encoding {other}; json, protobuf and cdr are read"
            )),
        }
    }
}

/// A text that is all there is (`std_msgs/String`) and holds JSON stands for what it holds.
fn told_in_text(value: Value) -> Value {
    let text = value
        .as_object()
        .filter(|object| object.len() == 1)
        .and_then(|object| object.get("data")?.as_str());
    text.and_then(parse_text).unwrap_or(value)
}

/// An object or a list that a text holds.
pub(crate) fn parse_text(text: &str) -> Option<Value> {
    text.trim_start()
        .starts_with(['{', '['])
        .then(|| serde_json::from_str(text).ok())
        .flatten()
}

fn protobuf_message(message: &DynamicMessage) -> Value {
    let descriptor = message.descriptor();
    // A field that knows no absence has its default where it is not written.
    let told = descriptor
        .fields()
        .filter(|field| message.has_field(field) || !field.supports_presence());
    Value::Object(
        told.map(|field| {
            (
                field.name().to_owned(),
                protobuf(&message.get_field(&field), &field.kind()),
            )
        })
        .collect(),
    )
}

fn protobuf(value: &prost_reflect::Value, kind: &prost_reflect::Kind) -> Value {
    use prost_reflect::Value as P;
    match value {
        P::Bool(value) => (*value).into(),
        P::I32(value) => (*value).into(),
        P::I64(value) => (*value).into(),
        P::U32(value) => (*value).into(),
        P::U64(value) => (*value).into(),
        P::F32(value) => single(*value),
        P::F64(value) => (*value).into(),
        P::String(value) => value.as_str().into(),
        P::Bytes(value) => STANDARD.encode(value).into(),
        P::EnumNumber(number) => {
            let named = kind.as_enum().and_then(|kind| kind.get_value(*number));
            named.map_or_else(|| (*number).into(), |value| value.name().into())
        }
        P::Message(message) => protobuf_message(message),
        P::List(values) => values.iter().map(|value| protobuf(value, kind)).collect(),
        P::Map(entries) => {
            let of = kind
                .as_message()
                .filter(|entry| entry.is_map_entry())
                .map(|entry| entry.map_entry_value_field().kind());
            let entries: BTreeMap<String, Value> = entries
                .iter()
                .map(|(key, value)| (map_key(key), protobuf(value, of.as_ref().unwrap_or(kind))))
                .collect();
            Value::Object(entries.into_iter().collect())
        }
    }
}

fn map_key(key: &MapKey) -> String {
    match key {
        MapKey::Bool(key) => key.to_string(),
        MapKey::I32(key) => key.to_string(),
        MapKey::I64(key) => key.to_string(),
        MapKey::U32(key) => key.to_string(),
        MapKey::U64(key) => key.to_string(),
        MapKey::String(key) => key.clone(),
    }
}

/// A number in single precision, with the digits that people wrote.
fn single(value: f32) -> Value {
    value.to_string().parse::<f64>().ok().into()
}

fn cdr(schema: &MessageSchema, data: &[u8]) -> Result<Value, String> {
    let (head, body) = data
        .split_at_checked(CDR_HEAD)
        .ok_or("fewer than four bytes")?;
    match head[..2] {
        [0, 0] => Cdr::<BigEndian>::message(schema, body),
        [0, 1] => Cdr::<LittleEndian>::message(schema, body),
        [first, second] => Err(format!(
            "CDR of the kind {first:#04x} {second:#04x}; the plain one is read"
        )),
        _ => Err("no CDR".to_owned()),
    }
}

struct Cdr<'a, Order> {
    schema: &'a MessageSchema,
    reader: CdrReader<'a, Order>,
}

impl<'a, Order: CdrEndian> Cdr<'a, Order> {
    fn message(schema: &'a MessageSchema, body: &'a [u8]) -> Result<Value, String> {
        Self {
            schema,
            reader: CdrReader::new(body),
        }
        .fields(&schema.spec, 0)
    }

    fn fields(&mut self, spec: &'a MessageSpecification, depth: usize) -> Result<Value, String> {
        if depth > DEPTH_MAX {
            return Err("messages in messages without end".to_owned());
        }
        let mut fields = Map::new();
        for field in &spec.fields {
            fields.insert(field.name.clone(), self.value(spec, &field.ty, depth)?);
        }
        Ok(Value::Object(fields))
    }

    fn value(
        &mut self,
        scope: &'a MessageSpecification,
        of: &'a Type,
        depth: usize,
    ) -> Result<Value, String> {
        match of {
            Type::BuiltIn(of) => self.scalar(of),
            Type::Array { ty, size } => {
                let count = match size {
                    ArraySize::Fixed(count) => *count,
                    ArraySize::Bounded(_) | ArraySize::Unbounded => {
                        self.reader.read_sequence_length().map_err(told)?
                    }
                };
                // Every element has at least one byte.
                if count > self.reader.remaining() {
                    return Err(format!(
                        "{count} elements in {} bytes",
                        self.reader.remaining()
                    ));
                }
                if matches!(
                    **ty,
                    Type::BuiltIn(BuiltInType::UInt8 | BuiltInType::Byte | BuiltInType::Char)
                ) {
                    return Ok(STANDARD
                        .encode(self.reader.read_bytes(count).map_err(told)?)
                        .into());
                }
                (0..count)
                    .map(|_| self.value(scope, ty, depth + 1))
                    .collect()
            }
            Type::Complex(of) => {
                let spec = self.find(scope, of)?;
                match spec
                    .underlying_type_if_enum_like()
                    .map_err(|error| error.to_string())?
                {
                    Some(of) => self.scalar(of),
                    None => self.fields(spec, depth + 1),
                }
            }
        }
    }

    fn scalar(&mut self, of: &BuiltInType) -> Result<Value, String> {
        let reader = &mut self.reader;
        let value = match of {
            BuiltInType::Bool => reader.read_bool().map(Value::from),
            BuiltInType::Byte | BuiltInType::Char | BuiltInType::UInt8 => {
                reader.read_u8().map(Value::from)
            }
            BuiltInType::Int8 => reader.read_i8().map(Value::from),
            BuiltInType::Int16 => reader.read_i16().map(Value::from),
            BuiltInType::UInt16 => reader.read_u16().map(Value::from),
            BuiltInType::Int32 => reader.read_i32().map(Value::from),
            BuiltInType::UInt32 => reader.read_u32().map(Value::from),
            BuiltInType::Int64 => reader.read_i64().map(Value::from),
            BuiltInType::UInt64 => reader.read_u64().map(Value::from),
            BuiltInType::Float32 => reader.read_f32().map(single),
            BuiltInType::Float64 => reader.read_f64().map(Value::from),
            BuiltInType::String(_) => reader.read_string().map(Value::from),
            BuiltInType::WString(_) => return Err("a wstring, which is not read".to_owned()),
        };
        value.map_err(told)
    }

    /// The definition of a message in a message; without a package it is of the same one.
    fn find(
        &self,
        scope: &MessageSpecification,
        of: &ComplexType,
    ) -> Result<&'a MessageSpecification, String> {
        let short = |name: &str| name.replace("/msg/", "/");
        let wanted = match of {
            ComplexType::Absolute { package, name } => short(&format!("{package}/{name}")),
            ComplexType::Relative { name } => match message_package(&scope.name) {
                Some(package) => format!("{package}/{name}"),
                None => name.clone(),
            },
        };
        let mut known = self.schema.dependencies.iter();
        known
            .find(|spec| short(&spec.name) == wanted)
            .ok_or_else(|| format!("the schema does not define {wanted}"))
    }
}

fn told(error: re_cdr::Error) -> String {
    error.to_string()
}
