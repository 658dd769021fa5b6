//! What a reward reads of an episode, as small integers: [`TaskFacts`] once a task, [`EpisodeFacts`] once an episode.
//!
//! Records ([`crate::Preset::rewarder`]) and table columns are turned into the same facts, and the rules run on facts only, so
//! both give the same bits. Never holds a reward, a pose or a picture.

mod counts;
mod episode;
mod names;
mod task;

use reel_world::{DoorState, ErrorClass, ErrorCode};

pub(crate) use counts::Counts;
pub use episode::{EpisodeFacts, StartFacts, StepFacts};
pub(crate) use task::Target;
pub use task::TaskFacts;

/// Errors of calls that were none.
const NOT_UNDERSTOOD: [ErrorCode; 3] = [ErrorCode::UnknownTool, ErrorCode::BadArguments, ErrorCode::UnparsableOutput];

/// An object instance, numbered within a [`TaskFacts`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ObjectKey(pub(crate) u32);

/// A receptacle or the floor, numbered within a [`TaskFacts`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct PlaceKey(pub(crate) u32);

/// An asset, numbered within a [`TaskFacts`].
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub(crate) struct AssetKey(pub(crate) u32);

/// A reply of the user, numbered within a [`TaskFacts`]; valid for one episode.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub struct ReplyKey(pub(crate) u32);

/// One element of a graph difference.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Change {
    /// `-object@place`
    Remove {
        /// What left.
        object: ObjectKey,
        /// Where.
        place: PlaceKey,
    },
    /// `+object@place`
    Add {
        /// What came.
        object: ObjectKey,
        /// Where.
        place: PlaceKey,
    },
    /// `place.door: from -> to`
    Door {
        /// The receptacle with the door.
        place: PlaceKey,
        /// Before.
        from: DoorState,
        /// After.
        to: DoorState,
    },
}

impl Change {
    /// The change that undoes this one.
    pub(crate) fn reverse(self) -> Self {
        match self {
            Change::Remove { object, place } => Change::Add { object, place },
            Change::Add { object, place } => Change::Remove { object, place },
            Change::Door { place, from, to } => Change::Door { place, from: to, to: from },
        }
    }
}

/// An element of a difference of graphs whose objects are assets: what preset `real-repo` compares.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct AssetChange {
    pub(crate) asset: AssetKey,
    pub(crate) place: PlaceKey,
    pub(crate) add: bool,
}

/// Whose graph changed (SPEC section 1, "Authority").
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Authority {
    /// Where physics says the objects are.
    Physics,
    /// Where picks and places say they are.
    Registry,
}

/// What a marker stands for.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Marked {
    /// An object.
    Object(ObjectKey),
    /// A receptacle.
    Place(PlaceKey),
}

/// Which tool was called, as far as a reward tells them apart.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Called {
    /// `nav_to`
    NavTo,
    /// `walk_around`
    WalkAround,
    /// `show_object_by_category`
    ShowObjectByCategory,
    /// `gaze_at`
    GazeAt,
    /// `pick`
    Pick,
    /// `place`
    Place,
    /// `ask`
    Ask,
    /// `finish`
    Finish,
    /// Another, or none.
    #[default]
    Other,
}

impl Called {
    /// By the tool's name in the paper and the code of the step's error. A call that was not understood (`unknown_tool`,
    /// `bad_arguments`, `unparsable_output`) called none, whatever name it had.
    pub fn parse(tool: &str, error_code: Option<&str>) -> Called {
        match tool {
            _ if error_code.is_some_and(|code| NOT_UNDERSTOOD.iter().any(|other| other.as_str() == code)) => Called::Other,
            "nav_to" => Called::NavTo,
            "walk_around" => Called::WalkAround,
            "show_object_by_category" => Called::ShowObjectByCategory,
            "gaze_at" => Called::GazeAt,
            "pick" => Called::Pick,
            "place" => Called::Place,
            "ask" => Called::Ask,
            "finish" => Called::Finish,
            _ => Called::Other,
        }
    }
}

/// The columns of one step that hold one value.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct StepHead {
    /// The tool.
    pub tool: Called,
    /// None: the call did what it should.
    pub error: Option<ErrorClass>,
    /// The marker that the call names.
    pub marker: Option<u32>,
    /// The receptacle that a `nav_to` names, reached or not.
    pub driven_to: Option<PlaceKey>,
    /// The object that the call acted on.
    pub object: Option<ObjectKey>,
    /// The receptacle that the call acted on.
    pub receptacle: Option<PlaceKey>,
    /// What the gripper holds after the call.
    pub held: Option<ObjectKey>,
    /// What the user said.
    pub reply: Option<ReplyKey>,
}

impl StepHead {
    pub(crate) fn succeeded(&self, tool: Called) -> bool {
        self.error.is_none() && self.tool == tool
    }
}
