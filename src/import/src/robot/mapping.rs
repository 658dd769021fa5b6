//! Mapping files of recordings: what each topic is, and where its messages say it. Never opens a
//! file: texts come. `docs/robots.md` explains the format.

use std::{borrow::Cow, collections::BTreeMap};

use toml::{Spanned, de::DeValue};

use crate::mapping::{MappingError, MappingFile, Tools};

/// The camera whose images the steps of a trace hold.
pub(crate) const HEAD: &str = "head";

/// What a topic says. The order is that of one message that says several things.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Kind {
    Graph,
    Held,
    Landmark,
    Markers,
    Map,
    Joints,
    Transforms,
    Policy,
    Call,
    Odometry,
    Reference,
    Vla,
    Alignment,
    Camera,
    Reply,
    Primitive,
    Result,
    Episode,
}

/// A key, and where its value is looked for when the file does not say it; the first
/// that is there counts.
type Key = (&'static str, &'static [&'static str]);

/// The word of each kind, and its keys.
#[rustfmt::skip]
const KINDS: &[(&str, Kind, &[Key])] = &[
    (
        "call",
        Kind::Call,
        &[
            ("tool", &["/tool", "/tool_name", "/name"]),
            ("arguments", &["/arguments", "/args"]),
            ("id", &["/id", "/call_id"]),
        ],
    ),
    (
        "result",
        Kind::Result,
        &[
            ("text", &["/text", "/result", "/message"]),
            ("error", &["/error"]),
            ("success", &["/success"]),
            ("id", &["/id", "/call_id"]),
        ],
    ),
    (
        "primitive",
        Kind::Primitive,
        &[
            ("skill", &["/skill", "/primitive", "/tool", "/name"]),
            ("target", &["/target"]),
            ("success", &["/success"]),
            ("duration_s", &["/duration_s", "/duration"]),
            ("duration_ms", &["/duration_ms"]),
            ("control_steps", &["/control_steps"]),
            ("error", &["/error"]),
        ],
    ),
    (
        "vla",
        Kind::Vla,
        &[
            ("latency_s", &["/latency_s", "/latency", "/data"]),
            ("latency_ms", &["/latency_ms"]),
        ],
    ),
    (
        "odometry",
        Kind::Odometry,
        &[
            (
                "position",
                &["/pose/pose/position", "/pose/position", "/position", ""],
            ),
            (
                "orientation",
                &[
                    "/pose/pose/orientation",
                    "/pose/orientation",
                    "/orientation",
                ],
            ),
            ("yaw", &["/yaw", "/theta"]),
        ],
    ),
    (
        "alignment",
        Kind::Alignment,
        &[
            ("target", &["/target"]),
            ("odometry_error_m", &["/odometry_error_m"]),
            ("yaw_error_rad", &["/yaw_error_rad"]),
            ("image_shift_px", &["/image_shift_px"]),
            ("image_rmse_px", &["/image_rmse_px"]),
        ],
    ),
    (
        "reference",
        Kind::Reference,
        &[
            (
                "position",
                &["/pose/pose/position", "/pose/position", "/position", ""],
            ),
            (
                "orientation",
                &[
                    "/pose/pose/orientation",
                    "/pose/orientation",
                    "/orientation",
                ],
            ),
            ("yaw", &["/yaw", "/theta"]),
        ],
    ),
    (
        "joints",
        Kind::Joints,
        &[
            ("name", &["/name", "/names"]),
            ("position", &["/position", "/positions"]),
            ("velocity", &["/velocity", "/velocities"]),
            ("effort", &["/effort", "/efforts"]),
            ("joints", &["/joints"]),
        ],
    ),
    ("transforms", Kind::Transforms, &[("transforms", &["/transforms", ""])]),
    ("camera", Kind::Camera, &[("data", &["/data"])]),
    ("graph", Kind::Graph, &[("graph", &["/world_graph", "/graph", ""])]),
    ("held", Kind::Held, &[("held", &["/held", "/data", ""])]),
    ("landmark", Kind::Landmark, &[("landmark", &["/landmark", "/data", ""])]),
    ("map", Kind::Map, &[("receptacles", &["/receptacles", "/map", ""])]),
    ("markers", Kind::Markers, &[("markers", &["/markers", "/marker_map", ""])]),
    (
        "reply",
        Kind::Reply,
        &[
            ("text", &["/text", "/reply", "/data", ""]),
            ("source", &["/source"]),
        ],
    ),
    (
        "policy",
        Kind::Policy,
        &[
            ("raw", &["/raw", "/text", "/response", "/data", ""]),
            ("latency_s", &["/latency_s", "/latency"]),
            ("latency_ms", &["/latency_ms"]),
        ],
    ),
    (
        "episode",
        Kind::Episode,
        &[
            ("event", &["/event"]),
            ("task_id", &["/task_id", "/benchmark_task_id"]),
            ("instruction", &["/instruction", "/task_description"]),
            ("family", &["/family"]),
            ("scene_id", &["/scene_id"]),
            ("policy", &["/policy", "/model"]),
            ("shortest_path_m", &["/shortest_path_m"]),
            ("reason", &["/reason", "/status"]),
            ("success", &["/success"]),
        ],
    ),
];

/// Which time of a message counts.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub(crate) enum Clock {
    /// When it was recorded.
    #[default]
    Log,
    /// When it was sent.
    Publish,
}

/// What the topics of a recording are.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Mapping {
    pub(crate) clock: Clock,
    /// Who decided, where no message says it.
    pub(crate) policy: Option<String>,
    /// Metres between the poses of a relative pose error, if the file says it.
    pub(crate) rpe_interval_m: Option<f64>,
    /// How far the receptacles of the robot's map may stay from those of the scene, in metres root
    /// mean square, if the file says it.
    pub(crate) map_error_max_m: Option<f64>,
    pub(crate) tools: Tools,
    pub(crate) topics: BTreeMap<String, Vec<Entry>>,
}

/// One thing that a topic says.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Entry {
    pub kind: Kind,
    /// As it stands in the file.
    pub word: &'static str,
    /// Name of the camera; `None` if the entry is no camera or gives none.
    pub name: Option<String>,
    /// Images a second that are kept of a further camera, 0 for all; `None` if the file does not say it.
    pub max_hz: Option<f64>,
    /// What the file says, by key.
    pub pointers: BTreeMap<&'static str, String>,
    /// Whether the topic is nothing else: only then a message as a whole may be the value.
    pub alone: bool,
}

impl Entry {
    /// Where the value of a key may be.
    pub(crate) fn places(&self, key: &str) -> Vec<&str> {
        match self.pointers.get(key) {
            Some(pointer) => vec![pointer.as_str()],
            None => {
                let places = keys(self.kind)
                    .iter()
                    .find(|(name, _)| *name == key)
                    .map(|(_, places)| *places);
                places
                    .into_iter()
                    .flatten()
                    .copied()
                    .filter(|place| self.alone || !place.is_empty())
                    .collect()
            }
        }
    }
}

impl Mapping {
    /// Reads a mapping file.
    ///
    /// # Errors
    /// With line and column, what is no TOML or means nothing.
    pub fn parse(text: &str) -> Result<Self, MappingError> {
        let (file, table) = MappingFile::parse(text)?;
        let mut mapping = Self::default();
        for (key, value) in &table {
            match key.get_ref().as_ref() {
                "clock" => mapping.clock = clock(&file, value)?,
                "policy" => {
                    mapping.policy = Some(file.text_of(value, "the name of the policy, in quotes")?)
                }
                name @ ("rpe_interval_m" | "map_error_max_m") => {
                    let metres = number_of(&file, value, "metres above 0, e.g. 1.0")?;
                    if metres <= 0.0 {
                        return Err(
                            file.error(Some(value.span()), format!("{name} must be above 0"))
                        );
                    }
                    if name == "rpe_interval_m" {
                        mapping.rpe_interval_m = Some(metres);
                    } else {
                        mapping.map_error_max_m = Some(metres);
                    }
                }
                "tools" => mapping.tools = Tools::parse(&file, value)?,
                "topics" => {
                    for (topic, value) in file.table(value, "topics")? {
                        mapping.topics.insert(
                            topic.get_ref().to_string(),
                            entries(&file, topic.get_ref(), value)?,
                        );
                    }
                }
                other => {
                    let what = format!(
                        "unknown key '{other}'; there are: clock, map_error_max_m, policy, rpe_interval_m, tools, topics"
                    );
                    return Err(file.error(Some(key.span()), what));
                }
            }
        }
        if mapping.topics.is_empty() {
            let what =
                "no topic is named; say what one is, e.g. [topics.\"/odom\"] and is = \"odometry\""
                    .to_owned();
            return Err(file.error(None, what));
        }
        Ok(mapping)
    }

    /// Whether any topic says such a thing.
    pub(crate) fn has(&self, kind: Kind) -> bool {
        self.topics
            .values()
            .flatten()
            .any(|entry| entry.kind == kind)
    }
}

/// A number that is not negative.
fn number_of(
    file: &MappingFile<'_>,
    value: &Spanned<DeValue<'_>>,
    expected: &str,
) -> Result<f64, MappingError> {
    let told = match value.get_ref() {
        DeValue::Integer(number) => number.to_string().parse().ok(),
        DeValue::Float(number) => number.to_string().parse().ok(),
        _ => None,
    };
    told.filter(|number: &f64| number.is_finite() && *number >= 0.0)
        .ok_or_else(|| file.error(Some(value.span()), format!("expected {expected}")))
}

fn keys(kind: Kind) -> &'static [Key] {
    KINDS
        .iter()
        .find(|(_, found, _)| *found == kind)
        .map(|(_, _, keys)| *keys)
        .expect("every kind has keys")
}

fn clock(file: &MappingFile<'_>, value: &Spanned<DeValue<'_>>) -> Result<Clock, MappingError> {
    match file
        .text_of(value, "\"log_time\" or \"publish_time\"")?
        .as_str()
    {
        "log_time" => Ok(Clock::Log),
        "publish_time" => Ok(Clock::Publish),
        other => Err(file.error(
            Some(value.span()),
            format!("unknown clock '{other}'; use log_time or publish_time"),
        )),
    }
}

/// What a topic says: a table, or several in a list.
fn entries(
    file: &MappingFile<'_>,
    topic: &str,
    value: &Spanned<DeValue<'_>>,
) -> Result<Vec<Entry>, MappingError> {
    let mut entries = match value.get_ref().as_array() {
        Some(list) => list
            .iter()
            .map(|value| entry(file, topic, value))
            .collect::<Result<Vec<_>, _>>()?,
        None => vec![entry(file, topic, value)?],
    };
    let alone = entries.len() == 1;
    entries.iter_mut().for_each(|entry| entry.alone = alone);
    entries.sort_by_key(|entry| entry.kind);
    Ok(entries)
}

fn entry(
    file: &MappingFile<'_>,
    topic: &str,
    value: &Spanned<DeValue<'_>>,
) -> Result<Entry, MappingError> {
    let table = file.table(value, topic)?;
    let is = table.iter().find(|(key, _)| key.get_ref() == "is");
    let words = || {
        KINDS
            .iter()
            .map(|(word, ..)| *word)
            .collect::<Vec<_>>()
            .join(", ")
    };
    let Some((_, is)) = is else {
        return Err(file.error(
            Some(value.span()),
            format!("[topics.\"{topic}\"] needs 'is': one of {}", words()),
        ));
    };
    let word = file.text_of(is, "what the topic is, in quotes")?;
    let Some((word, kind, keys)) = KINDS.iter().find(|(known, ..)| *known == word) else {
        return Err(file.error(
            Some(is.span()),
            format!(
                "'{word}' is nothing that a topic can be; there are: {}",
                words()
            ),
        ));
    };
    let mut entry = Entry {
        kind: *kind,
        word,
        name: None,
        max_hz: None,
        pointers: BTreeMap::new(),
        alone: true,
    };
    for (key, value) in table {
        let name: &Cow<'_, str> = key.get_ref();
        match keys.iter().find(|(known, _)| known == name) {
            Some((known, _)) => drop(entry.pointers.insert(known, file.pointer_of(value)?)),
            None if name == "is" => {}
            None if name == "name" && *kind == Kind::Camera => {
                entry.name = Some(file.text_of(
                    value,
                    "the name of the camera, in quotes; head is the one whose images steps have",
                )?);
            }
            None if name == "max_hz" && *kind == Kind::Camera => {
                entry.max_hz = Some(number_of(
                    file,
                    value,
                    "images a second, from 0 (all) on, e.g. 5",
                )?);
            }
            None => {
                let more = if *kind == Kind::Camera {
                    &["is", "name", "max_hz"][..]
                } else {
                    &["is"]
                };
                let known: Vec<&str> = more
                    .iter()
                    .copied()
                    .chain(keys.iter().map(|(key, _)| *key))
                    .collect();
                let what = format!(
                    "unknown key '{name}' in [topics.\"{topic}\"]; {word} has: {}",
                    known.join(", ")
                );
                return Err(file.error(Some(key.span()), what));
            }
        }
    }
    Ok(entry)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_and_their_pointers() {
        let text = r#"
clock = "publish_time"
policy = "qwen-vl"
[tools.grasp]
is = "pick"
[topics]
"/odom" = { is = "odometry" }
"/cam" = { is = "camera", name = "wrist" }
[[topics."/result"]]
is = "result"
text = "/said"
[[topics."/result"]]
is = "graph"
graph = "/world"
"#;
        let mapping = Mapping::parse(text).unwrap();
        assert_eq!(
            (
                mapping.clock,
                mapping.policy.as_deref(),
                mapping.tools.name("grasp")
            ),
            (Clock::Publish, Some("qwen-vl"), Some("pick"))
        );
        let result = &mapping.topics["/result"];
        // What a message says of the world stands before what it says of the call.
        assert_eq!(
            (result[0].kind, result[1].kind),
            (Kind::Graph, Kind::Result)
        );
        assert_eq!(
            (result[1].places("text"), result[1].places("id")),
            (vec!["/said"], vec!["/id", "/call_id"])
        );
        assert_eq!(mapping.topics["/cam"][0].name.as_deref(), Some("wrist"));
        assert_eq!(mapping.topics["/odom"][0].places("yaw"), ["/yaw", "/theta"]);
        // A message is a value as a whole only where it is nothing else.
        let graphs =
            Mapping::parse("[topics]\n\"/a\" = { is = \"graph\" }\n\"/b\" = [{ is = \"graph\" }, { is = \"held\" }]\n").unwrap();
        assert_eq!(
            graphs.topics["/a"][0].places("graph"),
            ["/world_graph", "/graph", ""]
        );
        assert_eq!(
            graphs.topics["/b"][0].places("graph"),
            ["/world_graph", "/graph"]
        );
    }

    #[test]
    fn mistakes_have_lines() {
        let error = |text: &str| Mapping::parse(text).unwrap_err().to_string();
        assert!(
            error("[topics.\"/a\"]\nis = \"fly\"\n")
                .starts_with("line 2, column 6: 'fly' is nothing that a topic can be")
        );
        assert!(
            error("[topics.\"/a\"]\nis = \"odometry\"\nx = \"/x\"\n")
                .starts_with("line 3, column 1: unknown key 'x'")
        );
        assert!(
            error("[topics.\"/a\"]\nis = \"odometry\"\nyaw = \"yaw\"\n")
                .starts_with("line 3, column 7: 'yaw' is not a JSON pointer")
        );
        assert!(error("[topics.\"/a\"]\nyaw = \"/yaw\"\n").contains("needs 'is'"));
        assert!(error("clock = \"mine\"\n").starts_with("line 1, column 9: unknown clock 'mine'"));
        assert!(error("[topics.\"/a\"]\nis = 3\n").starts_with("line 2, column 6: expected"));
        assert!(error("[tools.a]\nis = \"fly\"\n").starts_with("line 2, column 6"));
        assert!(error("topics = 3\n").contains("topics must be a table"));
        assert!(error("\n[topic]\n").starts_with("line 2, column 2: unknown key 'topic'"));
        assert!(error("policy = \"x\"\n").starts_with("line 2, column 1: no topic is named"));
        assert!(error("[topics\n").starts_with("line 1"));
        assert!(
            error("[topics.\"/a\"]\nis = \"odometry\"\nname = \"x\"\n")
                .contains("unknown key 'name'")
        );
    }
}
