//! The loop of the client: `finish` gives a task; decide, call and observe until the agent finishes
//! or the steps are used up; then the next task.

use std::path::PathBuf;

use serde_json::{Map, Value, json};

use super::{
    Content, EvalError, ToolResult,
    files::{EpisodeFiles, identity, write_json},
    names::model_slug,
    score::{is_success, world_graph},
};

/// The answer to `finish` after the last task.
pub(super) const END: &str = "All evaluation episodes completed.";
/// What stands in the place of a result if the agent named no tool.
const NO_TOOL: &str = "No tool selected.";

/// What a run is called and how far it goes.
#[derive(Clone, PartialEq, Debug)]
pub struct RunSettings {
    /// Folder for the files.
    pub out: PathBuf,
    /// Name of the model.
    pub model: String,
    /// What the file of results begins with, e.g. `qwen_agent`; also its `mode`.
    pub prefix: String,
    /// Most decisions of an episode.
    pub steps_max: u32,
    /// Tasks with a smaller `episode_idx` are passed over; those without one have -1.
    pub start_idx: i64,
    /// The first task that has this `episode_idx` or a larger one ends the run.
    pub end_idx: i64,
    /// Further keys of `task_meta.json`.
    pub metadata: Map<String, Value>,
    /// When the run began, for the name of the results: `YYYYMMDD_HHMMSS_ffffff`.
    pub run_tag: String,
}

/// What an agent decided.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct Decision {
    /// The tool under its canonical name. `None` if the agent named none.
    pub tool: Option<String>,
    /// Its arguments, an object.
    pub args: Value,
    /// The model's answer: a text, or a message of function calling. `None` if it is not known.
    pub raw: Option<Value>,
    /// What the model was asked. `None` if it is not known.
    pub user_message: Option<String>,
    /// How long the model took, in seconds.
    pub seconds: f64,
}

/// Why an agent decides nothing.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
pub enum Stop {
    /// It failed: of what. An answer that cannot be read is a failure, too.
    #[error("{0}")]
    Failed(String),
    /// It has used up its steps, fewer than those of the run.
    #[error("no steps are left")]
    OutOfSteps,
}

/// A server and the agent that plays on it.
pub trait EvalDriver {
    /// Names of the server's tools.
    fn tools(&mut self) -> Vec<String>;

    /// Calls a tool.
    ///
    /// # Errors
    /// Why the call failed. (Refusals of the server are results.)
    fn call(&mut self, tool: &str, args: &Value) -> Result<Vec<Content>, String>;

    /// Tells the policy that an episode of this task begins.
    fn begin(&mut self, task: &Map<String, Value>);

    /// What the agent does next.
    ///
    /// # Errors
    /// Why it does nothing more.
    fn decide(&mut self) -> Result<Decision, Stop>;

    /// Shows the agent what its call came to.
    fn observe(&mut self, tool: &str, result: &ToolResult);
}

/// Plays every task of the server and writes the files. Gives what the file of results holds.
///
/// # Errors
/// Fails if the server gives no tasks, or a file cannot be written. What a call or the agent fails
/// of ends its episode only.
pub fn run(settings: &RunSettings, play: &mut impl EvalDriver) -> Result<Value, EvalError> {
    if !play.tools().iter().any(|tool| tool == "finish") {
        return Err(EvalError::NoFinish);
    }
    let mut episodes: Vec<Map<String, Value>> = Vec::new();
    while let Some(task) = next_task(play)? {
        let index = task
            .get("episode_idx")
            .and_then(Value::as_i64)
            .unwrap_or(-1);
        if index < settings.start_idx {
            continue;
        }
        if index >= settings.end_idx {
            break;
        }
        episodes.push(episode(settings, play, &task)?);
    }
    let results = results(settings, &episodes);
    let name = format!(
        "{}_results_{}_{}.json",
        settings.prefix,
        model_slug(&settings.model),
        settings.run_tag
    );
    write_json(&settings.out.join(name), &results)?;
    Ok(results)
}

/// The task that `finish` answers with; `None` after the last one.
fn next_task(play: &mut impl EvalDriver) -> Result<Option<Map<String, Value>>, EvalError> {
    let content = play
        .call("finish", &json!({}))
        .map_err(|what| EvalError::Finish { what })?;
    let no_task = |what: String| EvalError::NoTask { what };
    let text = content.iter().find_map(|item| match item {
        Content::Text(text) => Some(text.trim()),
        _ => None,
    });
    let text = text.ok_or_else(|| no_task("no text".to_owned()))?;
    if text == END {
        return Ok(None);
    }
    match serde_json::from_str(text).map_err(|error| no_task(format!("no JSON: {error}")))? {
        Value::Object(task) if task.contains_key("task_id") => Ok(Some(task)),
        Value::Object(_) => Err(no_task("no task_id".to_owned())),
        _ => Err(no_task("no object".to_owned())),
    }
}

fn episode(
    settings: &RunSettings,
    play: &mut impl EvalDriver,
    task: &Map<String, Value>,
) -> Result<Map<String, Value>, EvalError> {
    let files = EpisodeFiles::of(&settings.out, task, &model_slug(&settings.model));
    let mut summary = identity(task);
    if files.exist() {
        summary.insert("status".to_owned(), json!("skipped"));
        return Ok(summary);
    }
    files.write_meta(task, &settings.model, &settings.metadata)?;
    play.begin(task);
    let mut graph = task.get("initial_world_graph").cloned().unwrap_or_default();
    let (mut steps, mut total_s, mut success, mut status) = (0, 0.0, false, "max_steps_reached");
    while steps < settings.steps_max {
        let decision = play.decide();
        if decision == Err(Stop::OutOfSteps) {
            break;
        }
        let step = steps;
        steps += 1;
        let decision = match decision {
            Ok(decision) => decision,
            Err(stop) => {
                files.write_error(step, "inference", &stop.to_string())?;
                status = "inference_error";
                break;
            }
        };
        total_s += decision.seconds;
        let told = |text: String, debug: Map<String, Value>| ToolResult {
            text: Some(text),
            images: Vec::new(),
            debug,
        };
        let result = match decision.tool.as_deref() {
            None => told(NO_TOOL.to_owned(), Map::new()),
            Some("finish") => {
                success = is_success(
                    &graph,
                    task.get("target_world_graph").unwrap_or(&Value::Null),
                );
                status = "finished";
                let said = if success { "True" } else { "False" };
                told(
                    format!("Episode finished. Success: {said}"),
                    Map::from_iter([("world_graph".to_owned(), graph.clone())]),
                )
            }
            Some(tool) => match play.call(tool, &decision.args) {
                Ok(content) => ToolResult::of(&content),
                Err(what) => {
                    files.write_error(step, "action", &what)?;
                    status = "action_error";
                    break;
                }
            },
        };
        if let Err(what) = files.write_step(step, &decision, total_s, &result)? {
            files.write_error(step, "action", &what)?;
            status = "action_error";
            break;
        }
        match decision.tool.as_deref() {
            None => {}
            Some("finish") => break,
            Some(tool) => {
                graph = world_graph(&result.debug).unwrap_or(graph);
                play.observe(tool, &result);
            }
        }
    }
    let fields = json!({
        "total_steps": steps,
        "total_inference_time": total_s,
        "final_action": (status == "finished").then_some("finish"),
        "success": success,
        "status": status,
    });
    summary.extend(fields.as_object().cloned().unwrap_or_default());
    files.write_summary(&summary)?;
    Ok(summary)
}

fn results(settings: &RunSettings, episodes: &[Map<String, Value>]) -> Value {
    let count = |statuses: &[&str]| {
        let has = |episode: &&Map<String, Value>| {
            episode
                .get("status")
                .and_then(Value::as_str)
                .is_some_and(|status| statuses.contains(&status))
        };
        episodes.iter().filter(has).count()
    };
    let finished = count(&["finished"]);
    let successes = episodes
        .iter()
        .filter(|episode| episode.get("success") == Some(&json!(true)))
        .count();
    json!({
        "mode": settings.prefix,
        "run_tag": settings.run_tag,
        "model": settings.model,
        "start_idx": settings.start_idx,
        "end_idx": settings.end_idx,
        "total": episodes.len(),
        "finished": finished,
        "successes": successes,
        "skipped": count(&["skipped"]),
        "errors": count(&["inference_error", "action_error"]),
        "success_rate": if finished == 0 { 0.0 } else { successes as f64 / finished as f64 },
        "episodes": episodes,
    })
}
