//! Why a client of OpenEnv gets no observation, in the words and codes of the contract.

use reel_live::LiveError;
use serde_json::{Value, json};

use crate::rest::ApiError;

/// Why a message has no answer but an error.
#[derive(Debug)]
pub(super) enum Refusal {
    /// The message is no JSON.
    Json(String),
    /// No message has this type.
    UnknownType(String),
    /// A field is wrong.
    Invalid(InvalidField),
    /// The server has no room for another session.
    Capacity {
        message: String,
        active: usize,
        most: usize,
    },
    /// The session refused, or what was asked of it failed.
    Live(LiveError),
    /// A recorded episode cannot be used, or the caller may not use it.
    Trace(ApiError),
    /// The client sends messages faster than it may.
    TooFast,
}

/// A field that is wrong, as the contract lists it.
#[derive(Debug)]
pub(super) struct InvalidField {
    /// Kind of the error, as pydantic names it, e.g. `missing`.
    pub kind: &'static str,
    /// Where the field is in the message.
    pub place: Vec<String>,
    pub message: String,
}

impl From<LiveError> for Refusal {
    fn from(error: LiveError) -> Self {
        Self::Live(error)
    }
}

impl Refusal {
    /// A field at this place is wrong.
    pub fn invalid(kind: &'static str, place: &[&str], message: impl Into<String>) -> Self {
        Self::Invalid(InvalidField {
            kind,
            place: place.iter().map(|&part| part.to_owned()).collect(),
            message: message.into(),
        })
    }

    /// The code of the contract.
    fn code(&self) -> &'static str {
        match self {
            Self::Json(_) => "INVALID_JSON",
            Self::UnknownType(_) => "UNKNOWN_TYPE",
            Self::Invalid(_) => "VALIDATION_ERROR",
            Self::Capacity { .. } => "CAPACITY_REACHED",
            Self::Live(LiveError::Closing | LiveError::OtherOwner(_)) => "SESSION_ERROR",
            Self::Live(_) | Self::Trace(_) | Self::TooFast => "EXECUTION_ERROR",
        }
    }

    /// What a person reads.
    pub fn message(&self) -> String {
        match self {
            Self::Json(why) => format!("Invalid JSON: {why}"),
            Self::UnknownType(name) => format!("Unknown message type: {name}"),
            Self::Invalid(field) => {
                format!(
                    "Invalid message: {}: {}",
                    field.place.join("."),
                    field.message
                )
            }
            Self::Capacity { message, .. } => message.clone(),
            Self::Live(error) => advice(error),
            Self::Trace(error) => error.message().to_owned(),
            Self::TooFast => {
                "rate limit exceeded (limits.requests_per_s); the message was not executed"
                    .to_owned()
            }
        }
    }

    /// The error as a message of the WebSocket.
    pub fn to_message(&self) -> Value {
        let mut data = json!({"message": self.message(), "code": self.code()});
        match self {
            Self::Invalid(field) => {
                data["errors"] =
                    json!([{"type": field.kind, "loc": field.place, "msg": field.message}]);
            }
            Self::Capacity { active, most, .. } => {
                data["active_sessions"] = json!(active);
                data["max_sessions"] = json!(most);
            }
            _ => {}
        }
        json!({"type": "error", "data": data})
    }
}

/// What to do about an error of a session, in the words of this protocol, which has `reset` where
/// others call `finish`.
fn advice(error: &LiveError) -> String {
    match error {
        LiveError::NoEpisode => "no episode is running; call reset() first".to_owned(),
        LiveError::Over(_) => "the episode is over; call reset() to begin the next one".to_owned(),
        LiveError::UnknownTask(id) => {
            format!("unknown task '{}'", id.chars().take(80).collect::<String>())
        }
        LiveError::Broken(why) => {
            format!("the episode failed and was ended: {why}; call reset() to begin the next one")
        }
        other => other.to_string(),
    }
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        let message = refusal.message();
        match refusal {
            Refusal::Json(_) => Self::bad_request("no_json", message),
            Refusal::UnknownType(_) | Refusal::Invalid(_) => {
                Self::unprocessable("bad_body", message)
            }
            Refusal::Capacity { .. } => Self::busy(message),
            Refusal::Live(error) => Self::from(error).with_message(message),
            Refusal::Trace(error) => error,
            Refusal::TooFast => Self::too_many(&message),
        }
    }
}
