//! What a reward reads of an episode, as small integers: [`TaskFacts`] once a task,
//! [`EpisodeFacts`] once an episode.
//!
//! Records ([`crate::Preset::rewarder`]) and table columns are turned into the same facts, and the
//! rules run on facts only, so both give the same bits. Never holds a reward, a pose or an image.

mod counts;
mod episode;
mod kinds;
mod names;
mod task;

use reel_world::{DoorState, ErrorClass, ErrorCode};

use crate::trainer::TextError;

pub(crate) use counts::Counts;
pub use episode::{EpisodeFacts, StartFacts, StepFacts};
pub(crate) use kinds::{Identity, KindChange, KindKey, Kinds};
pub(crate) use task::Target;
pub use task::TaskFacts;

/// Errors of calls that were none.
const NOT_UNDERSTOOD: [ErrorCode; 3] = [
    ErrorCode::UnknownTool,
    ErrorCode::BadArguments,
    ErrorCode::UnparsableOutput,
];

/// An object instance, numbered within a [`TaskFacts`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ObjectKey(pub(crate) u32);

/// A receptacle or the floor, numbered within a [`TaskFacts`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ReceptacleKey(pub(crate) u32);

/// A text of an episode (what the user or a tool said, a marker's argument), numbered within a
/// [`TaskFacts`]; valid for one episode.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct TextKey(pub(crate) u32);

/// One element of a graph difference.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Change {
    /// `-object@place`: an object left a receptacle or the floor.
    Remove {
        /// Object instance that left its place.
        object: ObjectKey,
        /// Receptacle that the object left, or the floor.
        place: ReceptacleKey,
    },
    /// `+object@place`: an object came to a receptacle or the floor.
    Add {
        /// Object instance that came to the place.
        object: ObjectKey,
        /// Receptacle that the object came to, or the floor.
        place: ReceptacleKey,
    },
    /// `place.door: from -> to`
    Door {
        /// The receptacle with the door.
        place: ReceptacleKey,
        /// State of the door before the change.
        from: DoorState,
        /// State of the door after the change.
        to: DoorState,
    },
}

impl Change {
    /// The change that undoes this one.
    pub(crate) fn reverse(self) -> Self {
        match self {
            Change::Remove { object, place } => Change::Add { object, place },
            Change::Add { object, place } => Change::Remove { object, place },
            Change::Door { place, from, to } => Change::Door {
                place,
                from: to,
                to: from,
            },
        }
    }
}

/// Whose graph changed (docs/spec.md#authority).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Authority {
    /// Where physics says the objects are.
    Physics,
    /// Where picks and places say they are.
    Registry,
}

/// What a marker stands for.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum MarkerReferent {
    /// An object instance of the task, by its number.
    Object(ObjectKey),
    /// A receptacle of the scene, by its number.
    Receptacle(ReceptacleKey),
}

/// Which tool was called, as far as a reward tells them apart.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum ToolKind {
    /// The tool `nav_to`, called `navigate_to` in the other name set.
    NavTo,
    /// The tool `walk_around`, called `explore_receptacle` in the other name set.
    WalkAround,
    /// The tool `show_object_by_category`, called `find_objects` in the other name set.
    ShowObjectByCategory,
    /// The tool `gaze_at`, called `focus_on` in the other name set.
    GazeAt,
    /// The tool `pick`, which has the same name in both name sets.
    Pick,
    /// The tool `place`, called `place_on_top` in the other name set.
    Place,
    /// The call opens a door.
    Open,
    /// The call closes a door.
    Close,
    /// The tool `ask`, which asks the user a question.
    Ask,
    /// The tool `finish`, by which the policy ends the episode.
    Finish,
    /// Any other tool, or none, e.g. if the call was not understood.
    #[default]
    Other,
}

impl ToolKind {
    /// The tool that a name means, in either name set.
    pub fn named(tool: &str) -> ToolKind {
        match tool {
            "nav_to" | "navigate_to" => ToolKind::NavTo,
            "walk_around" | "explore_receptacle" => ToolKind::WalkAround,
            "show_object_by_category" | "find_objects" => ToolKind::ShowObjectByCategory,
            "gaze_at" | "focus_on" => ToolKind::GazeAt,
            "pick" => ToolKind::Pick,
            "place" | "place_on_top" => ToolKind::Place,
            "open" => ToolKind::Open,
            "close" => ToolKind::Close,
            "ask" => ToolKind::Ask,
            "finish" => ToolKind::Finish,
            _ => ToolKind::Other,
        }
    }
}

/// How the trainer got the answer of a call.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Delivery {
    /// The call did what it should.
    #[default]
    Executed,
    /// The model's answer held no call, and none was made.
    Unreadable,
    /// Not within the time that the trainer waits. Records and tables do not say this.
    TimedOut,
    /// Never: the call failed for good. Records and tables do not say this.
    Failed,
}

/// What the trainer reads from the text of a result.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct TrainerReading {
    pub(crate) error: Option<TextError>,
    /// Of an `ask`: the words, if any reach the policy.
    pub(crate) words: Option<TextKey>,
}

/// The columns of one step that hold one value.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StepHead {
    /// The tool; none if the call was not understood (`unknown_tool`, `bad_arguments`,
    /// `unparsable_output`).
    pub tool: ToolKind,
    /// The tool that the call names, understood or not.
    pub named: ToolKind,
    /// How the answer came.
    pub delivery: Delivery,
    /// None: the call did what it should.
    pub error: Option<ErrorClass>,
    /// The marker that the call names, as text.
    pub marker: Option<TextKey>,
    /// The receptacle that a `nav_to` names, reached or not.
    pub driven_to: Option<ReceptacleKey>,
    /// The object that the call acted on.
    pub object: Option<ObjectKey>,
    /// The receptacle that the call acted on.
    pub receptacle: Option<ReceptacleKey>,
    /// What the gripper holds after the call.
    pub held: Option<ObjectKey>,
    /// What the user said.
    pub reply: Option<TextKey>,
    /// What the text of the result says; only preset `real-trainer` reads it.
    pub trainer_reading: TrainerReading,
}

impl StepHead {
    pub(crate) fn succeeded(&self, tool: ToolKind) -> bool {
        self.error.is_none() && self.tool == tool
    }
}

/// Whether a call with this error was none, whatever name it had.
fn is_no_call(error_code: Option<&str>) -> bool {
    error_code.is_some_and(|code| NOT_UNDERSTOOD.iter().any(|other| other.as_str() == code))
}
