//! What the published server of branch `main` answers to `ask`: a description from the task's file, whatever was asked. Never
//! looks at the scene; the rules of the paper's user are in `user`.

use reel_sim::published::{Refusal, argument, python_text};
use reel_world::{
    AskContext, Task, ToolCall, ask_context,
    record::{UserReply, UserSource},
};
use serde_json::json;

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
        None => match ask_context(task) {
            Some(AskContext { target_category, target_description }) => {
                description_of(&target_category, &target_description, SOURCE)
            }
            None => error("simulated_user_context_unavailable"),
        },
    })
}

/// Who answers where the file does.
const SOURCE: &str = "task_metadata";

fn description_of(category: &str, description: &str, source: &str) -> String {
    let [category, description, source] = [category, description, source].map(|text| json!(text));
    format!(r#"{{"target_category": {category}, "target_description": {description}, "source": {source}}}"#)
}

fn error(what: &str) -> String {
    format!(r#"{{"error": {}, "source": {}}}"#, json!(what), json!(SOURCE))
}
