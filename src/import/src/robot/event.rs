//! What a message says, as its entry in the mapping reads it: values are looked up, numbers and
//! texts are taken in the forms that robots write them, and what is missing is named. Knows no
//! order and no files.

use reel_trace::robot::{Alignment, Odometry, PrimitiveOutcome, VlaLatency};
use reel_world::{
    ToolCall, ToolSpec,
    record::{PolicyOutput, UserReply, UserSource},
    value_text,
};
use serde_json::{Map, Value, json};

use super::{
    align::RobotMap,
    decode::parse_text,
    mapping::{Entry, Kind, Mapping},
    sensors,
};
use crate::response::{self, Raw};

/// Longest duration that is believed, in seconds.
const SECONDS_MAX: f64 = 86_400.0;

/// Something that was said, and when.
pub(crate) struct Event {
    pub ns: u64,
    pub payload: EventPayload,
}

/// What a message of the recording says.
pub(crate) enum EventPayload {
    /// An episode begins, with what the message states about it.
    Begin(Box<EpisodeEvent>),
    /// The episode ends, with what the message states about it.
    End(Box<EpisodeEvent>),
    /// A tool call that the policy made.
    Call(CallEvent),
    /// What a call came to.
    Result(ResultEvent),
    /// What a skill came to.
    Primitive(PrimitiveOutcome),
    Odometry(Odometry),
    Vla(VlaLatency),
    Alignment(Alignment),
    /// Where the robot has receptacles in its map.
    Map(RobotMap),
    /// The head camera's image: file and number of its message.
    Image([u64; 2]),
    /// A message that the trace keeps as it came.
    Sensor(SensorEvent),
    /// Something of the world, under a key of the published server's debug information.
    Shows(Map<String, Value>),
    Reply(UserReply),
    Policy(PolicyOutput),
}

/// A message that the trace keeps as it came.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct SensorEvent {
    /// File and number of the message.
    pub place: [u64; 2],
    /// Which of the sources of the mapping it is of.
    pub source: usize,
    /// Where a reference says that the robot is.
    pub reference: Option<Odometry>,
}

/// What a message about the whole episode tells.
#[derive(Clone, Default)]
pub(crate) struct EpisodeEvent {
    /// Under the keys of `task_meta.json`, and whatever else the message holds.
    pub meta: Map<String, Value>,
    pub policy: Option<String>,
    pub reason: Option<String>,
    pub success: Option<bool>,
    pub shortest_path_m: Option<f32>,
}

/// A tool call as a message of the recording reports it.
pub(crate) struct CallEvent {
    pub call: ToolCall,
    /// The call as it came, where it is called otherwise there.
    pub raw: Option<String>,
    pub id: Option<String>,
}

/// What a call came to.
pub(crate) struct ResultEvent {
    pub text: String,
    /// In the robot's words.
    pub error: Option<String>,
    pub success: Option<bool>,
    pub id: Option<String>,
}

/// What a message says under an entry.
///
/// # Errors
/// What is missing.
pub(crate) fn read(
    entry: &Entry,
    mapping: &Mapping,
    ns: u64,
    message: &Value,
) -> Result<EventPayload, String> {
    let said = EntryMessage { entry, message };
    Ok(match entry.kind {
        Kind::Call => EventPayload::Call(call(&said, mapping)?),
        Kind::Result => EventPayload::Result(ResultEvent {
            text: said.text("text").unwrap_or_default(),
            error: said.error(),
            success: said.get("success").and_then(truth),
            id: said.text("id"),
        }),
        Kind::Primitive => EventPayload::Primitive(primitive(&said, mapping, ns)?),
        Kind::Vla => {
            let latency_ns = said
                .nanoseconds("latency_s", "latency_ms")
                .ok_or_else(|| said.missing("latency_s"))?;
            EventPayload::Vla(VlaLatency {
                step: None,
                unix_ns: ns,
                latency_ns,
            })
        }
        Kind::Odometry => EventPayload::Odometry(odometry(&said, ns)?),
        Kind::Alignment => EventPayload::Alignment(Alignment {
            step: None,
            unix_ns: ns,
            target: said.text("target").unwrap_or_default(),
            odometry_error_m: said.number("odometry_error_m"),
            yaw_error_rad: said.number("yaw_error_rad"),
            image_shift_px: said.number("image_shift_px"),
            image_rmse_px: said.number("image_rmse_px"),
        }),
        Kind::Map => EventPayload::Map(map(&said)?),
        Kind::Graph => EventPayload::Shows(shows("world_graph", said.object("graph")?)),
        Kind::Markers => EventPayload::Shows(shows("CURRENT_MARKER_MAP", said.object("markers")?)),
        Kind::Held => EventPayload::Shows(shows("CURRENT_INV", said.name("held")?)),
        Kind::Landmark => EventPayload::Shows(shows("CURRENT_LANDMARK", said.name("landmark")?)),
        Kind::Reply => {
            let source = match said.get("source").map(words).as_deref() {
                Some("rule-based" | "rules" | "task_metadata") => UserSource::RuleBased,
                Some("model" | "llm") => UserSource::Model,
                _ => UserSource::Human,
            };
            EventPayload::Reply(UserReply {
                text: words(said.get("text").ok_or_else(|| said.missing("text"))?),
                source,
            })
        }
        Kind::Policy => {
            let (raw, latency_ns) = (
                said.text("raw"),
                said.nanoseconds("latency_s", "latency_ms"),
            );
            if raw.is_none() && latency_ns.is_none() {
                return Err(said.missing("raw"));
            }
            EventPayload::Policy(PolicyOutput {
                latency_ns,
                ..response::parse(Raw::Text(raw.unwrap_or_default()))
            })
        }
        Kind::Episode => episode(&said)?,
        Kind::Joints | Kind::Transforms | Kind::Reference => {
            return Err("sensors are not read here".to_owned());
        }
        Kind::Camera => return Err("images are not read here".to_owned()),
    })
}

/// Checks a message of a sensor; of a reference it tells the pose.
///
/// # Errors
/// What is missing.
pub(crate) fn check(entry: &Entry, ns: u64, message: &Value) -> Result<Option<Odometry>, String> {
    let said = EntryMessage { entry, message };
    match entry.kind {
        Kind::Joints => sensors::check_joints(&said).map(|()| None),
        Kind::Transforms => sensors::check_transforms(&said).map(|()| None),
        Kind::Reference => odometry(&said, ns).map(Some),
        _ => Ok(None),
    }
}

fn shows(key: &str, value: Value) -> Map<String, Value> {
    Map::from_iter([(key.to_owned(), value)])
}

fn call(said: &EntryMessage<'_>, mapping: &Mapping) -> Result<CallEvent, String> {
    let name = words(said.get("tool").ok_or_else(|| said.missing("tool"))?);
    let arguments = match said.get("arguments") {
        Some(Value::String(text)) if text.is_empty() => json!({}),
        Some(Value::String(text)) => {
            parse_text(text).ok_or_else(|| format!("arguments that are not JSON: {text}"))?
        }
        Some(arguments) => arguments.clone(),
        None => json!({}),
    };
    let call = ToolCall::new(name, arguments);
    let id = said.text("id");
    Ok(match mapping.tools.call(&call) {
        Some(ours) => CallEvent {
            call: ours,
            raw: Some(json!({"name": call.name, "arguments": call.arguments}).to_string()),
            id,
        },
        None => CallEvent {
            call,
            raw: None,
            id,
        },
    })
}

fn primitive(
    said: &EntryMessage<'_>,
    mapping: &Mapping,
    ns: u64,
) -> Result<PrimitiveOutcome, String> {
    let skill = words(said.get("skill").ok_or_else(|| said.missing("skill"))?);
    let error = said.error();
    let success = said
        .get("success")
        .and_then(truth)
        .or(error.as_ref().map(|_| false));
    let control_steps = said
        .number("control_steps")
        .filter(|steps| (1.0..=f64::from(u32::MAX)).contains(steps));
    let known = || ToolSpec::by_name(&skill).map(|spec| spec.paper_name);
    Ok(PrimitiveOutcome {
        step: None,
        unix_ns: ns,
        skill: mapping
            .tools
            .name(&skill)
            .or_else(known)
            .map_or_else(|| skill.clone(), str::to_owned),
        target: said.text("target").unwrap_or_default(),
        success: success.ok_or_else(|| said.missing("success"))?,
        duration_ns: said.nanoseconds("duration_s", "duration_ms"),
        control_steps: control_steps.map(|steps| steps as u32),
        error,
    })
}

/// A component of a vector, by its name or its place.
pub(super) fn axis(value: &Value, name: &str, index: usize) -> Option<f64> {
    let value = value.get(name).or_else(|| value.get(index));
    value.and_then(number)
}

/// A place in the plane.
fn place(value: &Value) -> Option<[f64; 2]> {
    Some([axis(value, "x", 0)?, axis(value, "y", 1)?])
}

/// The receptacles of a map: `{"table_1": {"x": 1.0, "y": 2.0}, ...}`, also as lists, or under
/// `position`.
fn map(said: &EntryMessage<'_>) -> Result<RobotMap, String> {
    let all = said.object("receptacles")?;
    let places = all.as_object().into_iter().flatten().map(|(id, value)| {
        let found = place(value).or_else(|| place(value.get("position")?));
        let found = found.ok_or_else(|| format!("{id} has no place in the map"))?;
        Ok((id.clone(), found))
    });
    places.collect()
}

fn odometry(said: &EntryMessage<'_>, ns: u64) -> Result<Odometry, String> {
    let [x, y] = said
        .all("position")
        .find_map(place)
        .ok_or_else(|| said.missing("position"))?;
    let turned = |value: &Value| {
        let [x, y, z, w] = [
            axis(value, "x", 0)?,
            axis(value, "y", 1)?,
            axis(value, "z", 2)?,
            axis(value, "w", 3)?,
        ];
        Some((2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z)))
    };
    let yaw = said
        .all("orientation")
        .find_map(turned)
        .or_else(|| said.number("yaw"));
    Ok(Odometry {
        step: None,
        unix_ns: ns,
        x,
        y,
        yaw: yaw.unwrap_or_default(),
    })
}

fn episode(said: &EntryMessage<'_>) -> Result<EventPayload, String> {
    let text = |key: &str| said.text(key);
    let shortest = said
        .number("shortest_path_m")
        .map(|length| length as f32)
        .filter(|length| length.is_finite() && *length > 0.0);
    let mut told = EpisodeEvent {
        meta: said.message.as_object().cloned().unwrap_or_default(),
        policy: text("policy"),
        reason: text("reason"),
        success: said.get("success").and_then(truth),
        shortest_path_m: shortest,
    };
    let named = [
        ("task_id", "benchmark_task_id"),
        ("instruction", "task_description"),
        ("family", "family"),
        ("scene_id", "scene_id"),
    ];
    let named = named.map(|(key, name)| (name, text(key)));
    let about_task = named.iter().any(|(_, text)| text.is_some());
    let ends = match text("event").map(|event| event.to_lowercase()).as_deref() {
        Some("start" | "started" | "begin" | "begun") => false,
        Some("end" | "ended" | "stop" | "stopped" | "finish" | "finished" | "done") => true,
        Some(other) => return Err(format!("the event '{other}'; there are: start, end")),
        None => !about_task && (told.success.is_some() || told.reason.is_some()),
    };
    for key in [
        "event",
        "task_id",
        "instruction",
        "policy",
        "reason",
        "success",
        "shortest_path_m",
    ] {
        for pointer in said.entry.places(key) {
            told.meta.shift_remove(pointer.trim_start_matches('/'));
        }
    }
    told.meta.shift_remove("header");
    told.meta.extend(
        named
            .into_iter()
            .filter_map(|(name, text)| Some((name.to_owned(), Value::from(text?)))),
    );
    Ok(if ends {
        EventPayload::End(Box::new(told))
    } else {
        EventPayload::Begin(Box::new(told))
    })
}

/// A message under an entry.
pub(super) struct EntryMessage<'a> {
    entry: &'a Entry,
    message: &'a Value,
}

impl<'a> EntryMessage<'a> {
    /// Every value that is where the one of a key may be.
    fn all(&self, key: &str) -> impl Iterator<Item = &'a Value> {
        let message = self.message;
        self.entry
            .places(key)
            .into_iter()
            .map(str::to_owned)
            .filter_map(move |place| message.pointer(&place))
    }

    pub(super) fn get(&self, key: &str) -> Option<&'a Value> {
        self.all(key).find(|value| !value.is_null())
    }

    fn text(&self, key: &str) -> Option<String> {
        self.get(key).map(words).filter(|text| !text.is_empty())
    }

    fn number(&self, key: &str) -> Option<f64> {
        self.get(key).and_then(number)
    }

    /// A duration, under a key in seconds or another in milliseconds. Zero says nothing: many
    /// messages cannot leave a field out.
    fn nanoseconds(&self, seconds: &str, milliseconds: &str) -> Option<u64> {
        let told = self
            .get(seconds)
            .and_then(duration)
            .or_else(|| self.number(milliseconds).map(|told| told / 1e3))?;
        (told > 0.0 && told <= SECONDS_MAX).then(|| (told * 1e9).round() as u64)
    }

    /// What went wrong; nothing under null, false and an empty text.
    fn error(&self) -> Option<String> {
        match self.get("error")? {
            Value::Bool(false) => None,
            Value::String(text) if text.is_empty() => None,
            other => Some(words(other)),
        }
    }

    /// An object, perhaps in a text.
    fn object(&self, key: &str) -> Result<Value, String> {
        let value = self.get(key).ok_or_else(|| self.missing(key))?;
        let value = value
            .as_str()
            .and_then(parse_text)
            .unwrap_or_else(|| value.clone());
        if value.is_object() {
            Ok(value)
        } else {
            Err(format!("{key} is not an object"))
        }
    }

    /// A name, or null for nothing.
    fn name(&self, key: &str) -> Result<Value, String> {
        let value = self.all(key).next().ok_or_else(|| self.missing(key))?;
        if value.is_string() || value.is_null() {
            Ok(value.clone())
        } else {
            Err(format!("{key} is not a name"))
        }
    }

    pub(super) fn missing(&self, key: &str) -> String {
        let places: Vec<String> = self
            .entry
            .places(key)
            .iter()
            .map(|place| format!("'{place}'"))
            .collect();
        format!(
            "a {} without {key} (looked for at {})",
            self.entry.word,
            places.join(", ")
        )
    }
}

/// A text as it is, anything else as JSON.
fn words(value: &Value) -> String {
    value_text(value).into_owned()
}

fn number(value: &Value) -> Option<f64> {
    value
        .as_f64()
        .or_else(|| value.as_str()?.trim().parse().ok())
        .filter(|number: &f64| number.is_finite())
}

fn truth(value: &Value) -> Option<bool> {
    match value {
        Value::Bool(value) => Some(*value),
        Value::Number(number) => Some(number.as_f64()? != 0.0),
        Value::String(text) => match text.to_lowercase().as_str() {
            "true" | "success" | "succeeded" => Some(true),
            "false" | "failure" | "failed" => Some(false),
            _ => None,
        },
        _ => None,
    }
}

/// Seconds, as a number or as ROS and protobuf write durations.
fn duration(value: &Value) -> Option<f64> {
    let part = |names: &[&str]| names.iter().find_map(|name| number(value.get(name)?));
    number(value).or_else(|| {
        Some(
            part(&["sec", "secs", "seconds"])?
                + part(&["nanosec", "nsec", "nsecs", "nanos"]).unwrap_or(0.0) / 1e9,
        )
    })
}
