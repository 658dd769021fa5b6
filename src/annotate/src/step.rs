//! A decision and what came of it, as plain borrowed data. Built from a trace here; whoever has the
//! same in columns builds it from these.

use std::borrow::Cow;

use reel_trace::Trace;
use reel_world::{
    ErrorCode, InstanceId, ObjectInstance, Task, ToolCall, ToolSpec, language,
    record::{MarkerTarget, StepRecord},
    value_text,
};
use serde_json::Value;

/// Of a longer argument that is no question only so much is repeated.
const ARGUMENT_BYTES_MAX: usize = 100;

/// A decision and what came of it.
#[derive(Clone, PartialEq, Debug)]
pub struct Step<'a> {
    /// The paper's name of the tool, or the name as called where it is no tool.
    pub tool: &'a str,
    /// The argument as text, several separated by commas; none where there is none.
    pub argument: Option<Cow<'a, str>>,
    /// Why the call failed, if it did.
    pub error: Option<ErrorCode>,
    /// What the agent was told.
    pub outcome: &'a str,
    /// What the user answered.
    pub reply: Option<&'a str>,
    /// The numbers of the map after the call.
    pub markers: Vec<(u32, MarkedItem<'a>)>,
    /// Objects that image and text of the outcome showed.
    pub visible: Vec<ObservedObject<'a>>,
    /// The receptacle that the call acted on.
    pub receptacle: Option<&'a str>,
    /// What the gripper holds after the call.
    pub held: Option<ObservedObject<'a>>,
}

/// What a number stands for.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MarkedItem<'a> {
    /// The number stands for an object that was seen.
    Object(ObservedObject<'a>),
    /// The id of a receptacle.
    Receptacle(&'a str),
}

/// An object as one sees it.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ObservedObject<'a> {
    /// Which one it is: compared, never written.
    pub key: &'a str,
    /// Category of the object, e.g. `alarm clock`.
    pub category: &'a str,
    /// What it looks like.
    pub caption: Option<&'a str>,
}

impl<'a> Step<'a> {
    /// A decision of a trace.
    pub fn of(trace: &'a Trace, index: usize) -> Option<Self> {
        trace
            .steps
            .get(index)
            .map(|record| Self::from_record(&trace.task, record))
    }

    /// Every decision of a trace.
    pub fn all(trace: &'a Trace) -> Vec<Self> {
        trace
            .steps
            .iter()
            .map(|record| Self::from_record(&trace.task, record))
            .collect()
    }

    /// A recorded decision of a task.
    pub fn from_record(task: &'a Task, record: &'a StepRecord) -> Self {
        let thing = |id: &InstanceId| task.object(id).map(ObservedObject::of);
        let marked = |target: &'a MarkerTarget| match target {
            MarkerTarget::Object(id) => thing(id).map(MarkedItem::Object),
            MarkerTarget::Receptacle(id) => Some(MarkedItem::Receptacle(id.as_str())),
        };
        let markers = record
            .markers
            .iter()
            .filter_map(|marker| Some((marker.id, marked(&marker.target)?)));
        let mut seen: Vec<ObservedObject<'_>> = Vec::new();
        for id in record
            .listed
            .iter()
            .chain(record.visible.iter().map(|visible| &visible.object))
        {
            seen.extend(thing(id).filter(|thing| !seen.contains(thing)));
        }
        Step {
            tool: record.tool_name(),
            argument: argument(&record.input.call),
            error: record.outcome.error,
            outcome: &record.outcome.text,
            reply: record.reply.as_ref().map(|reply| reply.text.as_str()),
            markers: markers.collect(),
            visible: seen,
            receptacle: record.receptacle.as_ref().map(|id| id.as_str()),
            held: record.held.as_ref().and_then(thing),
        }
    }

    /// The call alone: all that is known of a decision before it is made.
    pub(crate) fn call(&self) -> Call<'_> {
        let argument = self.argument.as_deref().unwrap_or_default().trim();
        let end = if self.tool == "ask" {
            argument.len()
        } else {
            argument.floor_char_boundary(ARGUMENT_BYTES_MAX)
        };
        Call {
            tool: self.tool,
            argument: &argument[..end],
        }
    }
}

impl<'a> ObservedObject<'a> {
    /// An object of a task.
    pub fn of(object: &'a ObjectInstance) -> Self {
        ObservedObject {
            key: object.instance.as_str(),
            category: &object.category,
            caption: object.caption.as_deref(),
        }
    }

    /// Whether a text may mean it, by what one sees of it.
    pub(crate) fn fits(&self, text: &str, purpose: Option<&str>) -> bool {
        let object = ObjectInstance {
            instance: "".into(),
            asset: "".into(),
            category: self.category.to_owned(),
            caption: self.caption.map(str::to_owned),
            attributes: language::attribute_words(self.caption.unwrap_or_default()),
            size: [0.0; 3],
            position: [0.0; 3],
            yaw: 0.0,
            receptacle: "".into(),
            reference_rest: None,
        };
        language::fits(text, &object, purpose)
    }
}

/// A call that is about to be made.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Call<'a> {
    pub tool: &'a str,
    pub argument: &'a str,
}

impl Call<'_> {
    /// Whether the tool takes an argument and gets none.
    pub fn lacks_argument(&self) -> bool {
        self.argument.is_empty()
            && ToolSpec::by_name(self.tool).is_some_and(|spec| spec.argument.is_some())
    }

    /// The number that it names.
    pub fn marker(&self) -> Option<u32> {
        self.argument.parse().ok()
    }
}

/// All arguments: the words about a call that is none of the tools repeat what it was given.
fn argument(call: &ToolCall) -> Option<Cow<'_, str>> {
    match &call.arguments {
        Value::Null => None,
        Value::Object(_) => call
            .values()
            .reduce(|all, next| format!("{all}, {next}").into()),
        other => Some(value_text(other)),
    }
}
