//! One JSON line a call.

use std::{
    fs::OpenOptions,
    io::Write,
    path::PathBuf,
    sync::{Mutex, PoisonError},
};

use reel_world::Digest;
use serde::{Deserialize, Serialize};

use crate::client::ModelError;

/// A call as the log holds it.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct LoggedCall {
    /// When it began, in nanoseconds since the Unix epoch.
    pub time_ns: u64,
    /// Of the request's canonical JSON; names the file of the cache.
    pub request: Digest,
    /// URL of the endpoint that the call is for.
    pub url: String,
    /// Name of the model that the endpoint serves.
    pub model: String,
    /// How often the endpoint was asked; 0 for a kept reply.
    pub attempts: u32,
    /// Whether the reply was kept from an equal request.
    pub cached: bool,
    /// Tokens read, where they were counted.
    #[serde(alias = "tokens_read")]
    pub prompt_tokens: Option<u32>,
    /// Tokens written, where they were counted.
    #[serde(alias = "tokens_written")]
    pub completion_tokens: Option<u32>,
    /// How long this call took, all tries and pauses.
    pub latency_ns: u64,
    /// Why there is no reply.
    pub error: Option<String>,
}

/// A file that gets a line for every call.
pub struct CallLog {
    path: PathBuf,
    out: Mutex<Box<dyn Write + Send>>,
}

impl CallLog {
    /// Appends to a file, which is made if it is not there.
    ///
    /// # Errors
    /// When it cannot be opened.
    pub fn append(path: impl Into<PathBuf>) -> Result<Self, ModelError> {
        let path = path.into();
        match OpenOptions::new().create(true).append(true).open(&path) {
            Ok(file) => Ok(Self {
                path,
                out: Mutex::new(Box::new(file)),
            }),
            Err(source) => Err(ModelError::Write {
                action: "open the log of calls",
                path,
                source,
            }),
        }
    }

    /// One write a line: lines of several threads, or programs, do not mix.
    pub(crate) fn write(&self, call: &LoggedCall) -> Result<(), ModelError> {
        let mut line = serde_json::to_string(call).expect("a call is always JSON");
        line.push('\n');
        let mut out = self.out.lock().unwrap_or_else(PoisonError::into_inner);
        out.write_all(line.as_bytes())
            .map_err(|source| ModelError::Write {
                action: "log a call",
                path: self.path.clone(),
                source,
            })
    }
}
