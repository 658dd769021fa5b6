//! What a tool call came to: the text for the policy and, after an error, its
//! class and code (docs/spec.md#error-classes).

use std::fmt;

use serde::{Deserialize, Serialize};

use crate::ToolText;

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
    /// What the text of a tool says went wrong; `None` if it tells of no failure that is known.
    pub fn from_message(text: &str) -> Option<Self> {
        ToolText::failure(text)?.code()
    }
}

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

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

    /// Whether a published server's handler died of the call; then it comes without an image and
    /// without the state.
    pub fn is_exception(&self) -> bool {
        ToolText::Exception.begins(&self.text)
    }

    /// Whether the call did what it should.
    pub fn is_ok(&self) -> bool {
        self.error.is_none()
    }
}
