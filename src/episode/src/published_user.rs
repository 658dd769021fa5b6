//! What the published server of branch `main` answers to `ask`: a description from the task's file, whatever was asked. Never
//! looks at the scene; the rules of the paper's user are in `user`.

use reel_sim::published::{Refusal, argument, python_text};
use reel_world::{
    Task, ToolCall,
    record::{UserReply, UserSource},
};
use serde_json::{Value, json};

/// Where the task file's own description is kept (see [`Task::extra`]).
const DESCRIPTION: &str = "episodes[0].target_description";

/// The text of an answer. `reply` is what somebody outside said, who goes before the file.
///
/// # Errors
/// Fails if an argument is missing.
pub(crate) fn answer(call: &ToolCall, task: &Task, reply: Option<&UserReply>) -> Result<String, Refusal> {
    let [category, description] = [argument(call, "target_category")?, argument(call, "target_description")?].map(python_text);
    if category.trim().is_empty() || description.trim().is_empty() {
        return Ok(error("target_category and target_description must be non-empty"));
    }
    Ok(match reply {
        Some(UserReply { text, source: UserSource::Human }) => description_of(&category, text, "human"),
        Some(UserReply { text, .. }) => description_of(&category, text, "model"),
        None => match described(task) {
            Some((category, description)) => description_of(&category, &description, SOURCE),
            None => error("simulated_user_context_unavailable"),
        },
    })
}

/// Who answers where the file does.
const SOURCE: &str = "task_metadata";

/// Category and description of the target: those of the plan's first question that has a description, else the task's own. Unlike
/// [`reel_world::ask_context`], the server names the category of the target object, whatever category the file gives.
fn described(task: &Task) -> Option<(String, String)> {
    let of_target = || task.target_object().category.clone();
    let text = |value: &Value| value.as_str().filter(|text| !text.trim().is_empty()).map(str::to_owned);
    let planned = task.plan.iter().filter(|step| step.action == "ask").find_map(|step| {
        let description = step.args.get("target_description").and_then(text)?;
        Some((step.args.get("target_category").and_then(text).unwrap_or_else(of_target), description))
    });
    planned.or_else(|| Some((of_target(), task.extra.get(DESCRIPTION).and_then(text)?)))
}

fn description_of(category: &str, description: &str, source: &str) -> String {
    let [category, description, source] = [category, description, source].map(|text| json!(text));
    format!(r#"{{"target_category": {category}, "target_description": {description}, "source": {source}}}"#)
}

fn error(what: &str) -> String {
    format!(r#"{{"error": {}, "source": {}}}"#, json!(what), json!(SOURCE))
}
