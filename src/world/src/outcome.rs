//! What a tool call came to: the text for the policy and, after an error, its
//! class and code (docs/spec.md#error-classes).

use std::fmt;

use serde::{Deserialize, Serialize};

/// How bad an error is; the reward's `safe` term reads it (paper, Detailed Reward Configuration).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ErrorClass {
    /// Invalid API format, or a target that is not in view.
    Severe,
    /// Perception errors and violated gripper constraints.
    Moderate,
}

macro_rules! error_codes {
    ($($(#[$doc:meta])* $name:ident = $text:literal, $class:ident;)*) => {
        /// Why a call failed.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum ErrorCode { $($(#[$doc])* $name,)* }

        impl ErrorCode {
            /// Every error code, in the order of declaration.
            pub const ALL: &[ErrorCode] = &[$(ErrorCode::$name,)*];

            /// The code as it stands in traces and tables.
            pub fn as_str(self) -> &'static str {
                match self { $(ErrorCode::$name => $text,)* }
            }

            /// Reads what [`ErrorCode::as_str`] wrote.
            pub fn parse(text: &str) -> Option<Self> {
                match text { $($text => Some(ErrorCode::$name),)* _ => None }
            }

            /// The class of the error.
            pub fn class(self) -> ErrorClass {
                match self { $(ErrorCode::$name => ErrorClass::$class,)* }
            }
        }
    };
}

error_codes! {
    /// No tool of this name.
    UnknownTool = "unknown_tool", Severe;
    /// A missing, superfluous or wrongly typed argument.
    BadArguments = "bad_arguments", Severe;
    /// The policy's output holds no call.
    UnparsableOutput = "unparsable_output", Severe;
    /// No receptacle of this name in the scene.
    UnknownReceptacle = "unknown_receptacle", Severe;
    /// The marker is not in the current map.
    UnknownMarker = "unknown_marker", Severe;
    /// The marker's object is not in view.
    MarkerNotInView = "marker_not_in_view", Severe;
    /// No marker map yet.
    NoMarkerMap = "no_marker_map", Moderate;
    /// The tool needs a receptacle to stand at.
    NoLandmark = "no_landmark", Moderate;
    /// Nothing found or in view.
    NothingFound = "nothing_found", Moderate;
    /// No collision-free viewpoint with a line of sight.
    NoViewpoint = "no_viewpoint", Moderate;
    /// The thing cannot be picked.
    NotGraspable = "not_graspable", Moderate;
    /// The thing cannot be placed upon.
    NotASurface = "not_a_surface", Moderate;
    /// The surface has no free spot for the held object.
    NoFreeSpot = "no_free_spot", Moderate;
    /// The gripper already holds something.
    AlreadyHolding = "already_holding", Moderate;
    /// The gripper holds nothing.
    NothingHeld = "nothing_held", Moderate;
    /// A door wants a free hand.
    HandNotFree = "hand_not_free", Moderate;
    /// The thing has no door.
    NoDoor = "no_door", Moderate;
    /// The door is closed.
    DoorClosed = "door_closed", Moderate;
    /// Too far away for the arm.
    OutOfReach = "out_of_reach", Moderate;
    /// The robot's skill failed; the call was right.
    SkillFailed = "skill_failed", Moderate;
    /// No user was there to answer the `ask` call.
    NoUser = "no_user", Moderate;
    /// What is behind a proxy failed, or refused in words of its own.
    BackendError = "backend_error", Moderate;
    /// Physics produced a value that is not finite; the body was taken out and the episode ends.
    PhysicsFault = "physics_fault", Severe;
    /// The episode is over.
    EpisodeOver = "episode_over", Severe;
}

impl ErrorCode {
    /// What a text of the published server or of ours says went wrong; none where it says of no
    /// failure that is known. Never ask it of what a user answered.
    pub fn from_message(text: &str) -> Option<Self> {
        TOLD.iter()
            .find(|(part, _)| text.contains(part))
            .map(|(_, code)| *code)
    }
}

/// What the texts of failures hold (docs/spec.md#published-texts).
const TOLD: &[(&str, ErrorCode)] = &[
    (": the gripper ", ErrorCode::SkillFailed),
    (EXCEPTION, ErrorCode::BackendError),
    ("Input validation error", ErrorCode::BadArguments),
    ("No tool selected", ErrorCode::UnparsableOutput),
    ("not found in the scene", ErrorCode::UnknownReceptacle),
    (
        "Cannot find a non-occluded position",
        ErrorCode::NoViewpoint,
    ),
    ("Cannot compute bounding box", ErrorCode::NoViewpoint),
    ("no valid navigable component", ErrorCode::NoViewpoint),
    ("No landmark selected", ErrorCode::NoLandmark),
    ("No camera position available", ErrorCode::NoLandmark),
    ("No camera orientation available", ErrorCode::NoLandmark),
    ("Seems there is no object", ErrorCode::NothingFound),
    ("No object matching", ErrorCode::NothingFound),
    ("No receptacle is in view", ErrorCode::NothingFound),
    ("not found in the marker map", ErrorCode::UnknownMarker),
    ("No marker map available", ErrorCode::NoMarkerMap),
    ("is not in view", ErrorCode::MarkerNotInView),
    (
        "is not available. Cannot focus on it",
        ErrorCode::MarkerNotInView,
    ),
    ("You are already holding", ErrorCode::AlreadyHolding),
    ("has no graspable component", ErrorCode::NotGraspable),
    ("is not graspable", ErrorCode::NotGraspable),
    ("No object in the inventory", ErrorCode::NothingHeld),
    ("is not a valid placement surface", ErrorCode::NotASurface),
    ("has no top_shelf component", ErrorCode::NotASurface),
    ("Target furniture ", ErrorCode::NotASurface),
    ("is closed. Use", ErrorCode::DoorClosed),
    ("is out of reach", ErrorCode::OutOfReach),
    ("There is no free spot", ErrorCode::NoFreeSpot),
    ("has no door", ErrorCode::NoDoor),
    ("The hand is not free", ErrorCode::HandNotFree),
    ("not recognized", ErrorCode::UnknownTool),
    ("The episode is over", ErrorCode::EpisodeOver),
];

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// How a text begins that a handler of the published servers died with. It comes without an image
/// and without the state.
pub const EXCEPTION: &str = "Error executing ";

/// The result of a tool call as the policy reads it.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct Outcome {
    /// The text the policy gets.
    pub text: String,
    /// Absent when the call did what it should.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<ErrorCode>,
}

impl Outcome {
    /// Success with a text.
    pub fn ok(text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            error: None,
        }
    }

    /// Failure with a text.
    pub fn error(code: ErrorCode, text: impl Into<String>) -> Self {
        Self {
            text: text.into(),
            error: Some(code),
        }
    }

    /// Whether a published server's handler died of the call.
    pub fn is_exception(&self) -> bool {
        self.text.starts_with(EXCEPTION)
    }

    /// Whether the call did what it should.
    pub fn is_ok(&self) -> bool {
        self.error.is_none()
    }
}
