//! What was there and what was done, as plain data: from a task and its records, or from rows of
//! anybody's table. Never judges.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use reel_world::{
    Door, DoorState, ErrorCode, GraphEvent, Scene, Task, ToolCall, ToolSpec, ToolText, WorldGraph,
    record::{MarkerTarget, StepRecord},
    tool_text::read_numbered,
};

/// What was there before the first decision.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct EpisodeFacts {
    /// The receptacles of the episode's scene.
    pub places: Vec<ReceptacleFacts>,
    /// The objects of the episode and where each stood at the start.
    pub things: Vec<ObjectFacts>,
    /// What the agent was told.
    #[serde(default)]
    pub instruction: String,
    /// Whether `things` and what the deeds tell of them is all there is. Without it nothing that
    /// speaks of objects is refuted.
    #[serde(default)]
    pub complete: bool,
}

/// A receptacle: its names, its room and its door at the start.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ReceptacleFacts {
    /// Id of the receptacle, e.g. `table_1`.
    pub id: String,
    /// Category of the receptacle, e.g. `table`.
    pub category: String,
    /// Its room, if known.
    #[serde(default)]
    pub room: String,
    /// How people call it.
    #[serde(default)]
    pub captions: Vec<String>,
    /// How its door stood at the start; none where it has no door, or where that is unknown.
    #[serde(default)]
    pub door: Option<DoorState>,
}

/// An object: its key, its category and its place at the start.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct ObjectFacts {
    /// What deeds call it; never compared with a text.
    pub key: String,
    /// Category of the object, e.g. `alarm clock`.
    pub category: String,
    /// How people would describe it.
    #[serde(default)]
    pub caption: Option<String>,
    /// The receptacle where it stood at the start, if known.
    #[serde(default)]
    pub place: Option<String>,
}

/// One decision and what came of it.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
pub struct StepFacts {
    /// Index of the step in its episode, from 0.
    pub step: u32,
    /// The tool's name in the paper, or the name as called where it is no tool.
    pub tool: String,
    /// Its argument as text: a receptacle, a category, a marker number, a question.
    #[serde(default)]
    pub argument: Option<String>,
    /// The error code, if it failed.
    #[serde(default)]
    pub error: Option<String>,
    /// What the user answered.
    #[serde(default)]
    pub reply: Option<String>,
    /// Key of the object that it acted on.
    #[serde(default)]
    pub object: Option<String>,
    /// The receptacle that it acted on.
    #[serde(default)]
    pub receptacle: Option<String>,
    /// Key of what the gripper held after it.
    #[serde(default)]
    pub held: Option<String>,
    /// Keys of the objects in view after it, or told by it.
    #[serde(default)]
    pub seen: Vec<String>,
    /// The marker map after it.
    #[serde(default)]
    pub markers: Vec<MarkerFacts>,
    /// What changed in the world.
    #[serde(default)]
    pub changes: Vec<GraphEvent>,
}

/// What a marker stood for.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct MarkerFacts {
    /// Number of the marker, which tools take as an argument.
    pub number: u32,
    /// Key of the object, if it was one.
    #[serde(default)]
    pub object: Option<String>,
    /// The receptacle, if it was one.
    #[serde(default)]
    pub receptacle: Option<String>,
}

impl EpisodeFacts {
    /// The setting of a recorded episode, whose world stood as `start` says
    /// before the first decision.
    pub fn of(task: &Task, scene: &Scene, start: &WorldGraph) -> Self {
        let places = scene.receptacles.iter().map(|receptacle| ReceptacleFacts {
            id: receptacle.id.as_str().to_owned(),
            category: receptacle.category.clone(),
            room: receptacle.room.clone(),
            captions: receptacle.captions.keys().cloned().collect(),
            door: (receptacle.door != Door::None)
                .then(|| start.door(&receptacle.id).unwrap_or(DoorState::Closed)),
        });
        let things = task.objects.iter().map(|object| ObjectFacts {
            key: object.instance.as_str().to_owned(),
            category: object.category.clone(),
            caption: object.caption.clone(),
            place: start
                .receptacle_of(&object.instance)
                .map(|place| place.as_str().to_owned()),
        });
        Self {
            places: places.collect(),
            things: things.collect(),
            instruction: task.instruction.clone(),
            complete: true,
        }
    }
}

impl StepFacts {
    /// The facts that the record of a step states.
    pub fn of(record: &StepRecord) -> Self {
        let key = |id: &reel_world::InstanceId| id.as_str().to_owned();
        let mut seen: Vec<String> = record
            .visible
            .iter()
            .map(|object| key(&object.object))
            .chain(record.listed.iter().map(key))
            .collect();
        seen.sort();
        seen.dedup();
        let markers = record.markers.iter().map(|marker| match &marker.target {
            MarkerTarget::Object(id) => MarkerFacts {
                number: marker.id,
                object: Some(key(id)),
                receptacle: None,
            },
            MarkerTarget::Receptacle(id) => MarkerFacts {
                number: marker.id,
                object: None,
                receptacle: Some(id.as_str().to_owned()),
            },
        });
        let called = Self::from_call(record.step, &record.input.call, &record.outcome.text);
        Self {
            error: record.outcome.error.map(|code| code.as_str().to_owned()),
            // The published servers answer a question without a user.
            reply: record
                .reply
                .as_ref()
                .map(|reply| reply.text.clone())
                .or(called.reply),
            object: record.object.as_ref().map(key),
            receptacle: record.receptacle.as_ref().map(|id| id.as_str().to_owned()),
            held: record.held.as_ref().map(key),
            seen,
            markers: markers.collect(),
            changes: record.changes.physics.clone(),
            ..called
        }
    }

    /// What a bare call and the text of its outcome tell; everything else is left open.
    pub fn from_call(step: u32, call: &ToolCall, text: &str) -> Self {
        let tool = ToolSpec::paper_name_of(&call.name);
        let argument = call.argument().or_else(|| call.values().next());
        let error = ErrorCode::from_message(text);
        let receptacle = || match tool {
            "nav_to" | "place" | "open" | "close" => ToolText::success(tool)?.value(text),
            _ => None,
        };
        let marked = |(number, item): (u32, &str)| MarkerFacts {
            number,
            object: None,
            receptacle: (tool == "show_receptacles").then(|| item.to_owned()),
        };
        Self {
            step,
            tool: tool.to_owned(),
            argument: argument.map(Cow::into_owned),
            error: error.map(|code| code.as_str().to_owned()),
            reply: (tool == "ask" && error.is_none() && !text.is_empty()).then(|| text.to_owned()),
            receptacle: receptacle().filter(|_| error.is_none()).map(str::to_owned),
            markers: if matches!(tool, "show_receptacles" | "walk_around") {
                read_numbered(text).map(marked).collect()
            } else {
                Vec::new()
            },
            ..Self::default()
        }
    }
}
