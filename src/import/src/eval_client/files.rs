//! The files of a run: `<out>/<scene>/<id>/<slug>/` for an episode, and one with
//! the results of all.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use base64::{Engine, engine::general_purpose::STANDARD};
use reel_world::value_text;
use serde_json::{Map, Value, json};

use super::{Decision, ToolResult, names::path_component};

/// Fields of a task that its files repeat, in their order.
const IDENTITY: &[&str] = &reel_world::words! {
    benchmark_task_id family global_index task_id episode_idx
};
const DESCRIPTION: &[&str] = &reel_world::words! {
    task_description scene_id source_furniture destination_furniture target_object
};

/// Why a run cannot go on.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum EvalError {
    /// The server does not end episodes.
    #[error("the server lists no tool `finish`; the evaluation gets its tasks from it")]
    NoFinish,
    /// The server did not answer a call of `finish` as a task or an end.
    #[error("`finish` failed: {what}; see the server's log")]
    Finish { what: String },
    /// `finish` did not answer with a task.
    #[error(
        "`finish` answered no task ({what}); expected a JSON object with task_id, or the end of the evaluation"
    )]
    NoTask { what: String },
    /// A trace that cannot be read.
    #[error(transparent)]
    Trace(#[from] reel_trace::TraceError),
    /// A file cannot be written.
    #[error("cannot write: {source}; check free space and permissions: {path}")]
    Write { path: PathBuf, source: io::Error },
}

/// The folder of an episode.
pub(super) struct EpisodeFiles {
    folder: PathBuf,
}

impl EpisodeFiles {
    /// Of a task: by its benchmark id, else family and id, else id.
    pub fn of(out: &Path, task: &Map<String, Value>, slug: &str) -> Self {
        let of = |key: &str| task.get(key).filter(|value| !value.is_null());
        let id = match (of("benchmark_task_id"), of("family"), of("task_id")) {
            (Some(id), _, _) => id.clone(),
            (None, Some(family), Some(id)) => {
                json!(format!("{}/{}", value_text(family), value_text(id)))
            }
            (None, _, id) => id.cloned().unwrap_or_default(),
        };
        let scene = path_component(task.get("scene_id").unwrap_or(&Value::Null));
        Self {
            folder: out.join(scene).join(path_component(&id)).join(slug),
        }
    }

    /// Whether something is there already.
    pub fn exist(&self) -> bool {
        fs::read_dir(&self.folder).is_ok_and(|mut entries| entries.next().is_some())
    }

    pub fn write_meta(
        &self,
        task: &Map<String, Value>,
        model: &str,
        metadata: &Map<String, Value>,
    ) -> Result<(), EvalError> {
        let mut meta = fields(task, IDENTITY);
        meta.extend(fields(task, DESCRIPTION));
        meta.insert("model".to_owned(), json!(model));
        meta.extend(metadata.clone());
        write_json(&self.folder.join("task_meta.json"), &Value::Object(meta))
    }

    pub fn write_summary(&self, summary: &Map<String, Value>) -> Result<(), EvalError> {
        write_json(
            &self.folder.join("episode_summary.json"),
            &Value::Object(summary.clone()),
        )
    }

    /// A step in which the agent (`inference`) or the call (`action`) failed.
    pub fn write_error(&self, step: u32, of: &str, what: &str) -> Result<(), EvalError> {
        write(
            &self.step(step).join(format!("{of}_error.txt")),
            what.as_bytes(),
        )
    }

    /// A step: what was decided, then what came of it. `Ok(Err(..))` says which image is none; what
    /// follows it is then not written.
    pub fn write_step(
        &self,
        step: u32,
        decision: &Decision,
        total_s: f64,
        result: &ToolResult,
    ) -> Result<Result<(), String>, EvalError> {
        let folder = self.step(step);
        let args = decision.args.as_object().cloned().unwrap_or_default();
        write_json(
            &folder.join("tool_call.json"),
            &json!({ "tool_name": decision.tool, "args": args }),
        )?;
        let time = json!({ "inference_time": decision.seconds, "total_inference_time": total_s });
        write_json(&folder.join("inference_time.json"), &time)?;
        match &decision.raw {
            None => {}
            Some(Value::String(text)) => write(&folder.join("raw_response.txt"), text.as_bytes())?,
            Some(message) => write_json(&folder.join("raw_response.json"), message)?,
        }
        if let Some(message) = &decision.user_message {
            write(&folder.join("user_message.txt"), message.as_bytes())?;
        }
        if let Some(text) = &result.text {
            write(&folder.join("textual_observation.txt"), text.as_bytes())?;
        }
        for (index, image) in result.images.iter().enumerate() {
            match png(image) {
                Ok(bytes) => write(
                    &folder.join(format!("image_observation_{index}.png")),
                    &bytes,
                )?,
                Err(what) => return Ok(Err(format!("image {index} of the result: {what}"))),
            }
        }
        write_json(
            &folder.join("debug_info.json"),
            &Value::Object(result.debug.clone()),
        )?;
        Ok(Ok(()))
    }

    fn step(&self, step: u32) -> PathBuf {
        self.folder.join(format!("step_{step:03}"))
    }
}

/// The fields that a summary begins with.
pub(super) fn identity(task: &Map<String, Value>) -> Map<String, Value> {
    fields(task, IDENTITY)
}

pub(super) fn write_json(path: &Path, value: &Value) -> Result<(), EvalError> {
    write(path, format!("{value:#}").as_bytes())
}

fn fields(task: &Map<String, Value>, keys: &[&str]) -> Map<String, Value> {
    keys.iter()
        .map(|key| {
            (
                (*key).to_owned(),
                task.get(*key).cloned().unwrap_or_default(),
            )
        })
        .collect()
}

fn write(path: &Path, bytes: &[u8]) -> Result<(), EvalError> {
    let failed = |source| EvalError::Write {
        path: path.to_owned(),
        source,
    };
    fs::create_dir_all(path.parent().unwrap_or(path)).map_err(failed)?;
    fs::write(path, bytes).map_err(failed)
}

/// The bytes of a PNG image in Base64.
fn png(image: &str) -> Result<Vec<u8>, String> {
    let bytes = STANDARD
        .decode(image)
        .map_err(|error| format!("no Base64 ({error})"))?;
    let side = |from: usize| {
        bytes
            .get(from..)
            .and_then(|rest| rest.first_chunk())
            .map(|side| u32::from_be_bytes(*side) as usize)
    };
    let (Some(width), Some(height)) = (side(16), side(20)) else {
        return Err("no PNG image".to_owned());
    };
    reel_trace::decode_png(&bytes, (width, height))?;
    Ok(bytes)
}
