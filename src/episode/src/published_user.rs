//! What the published server of branch `main` answers to `ask`: a description from the task's file,
//! whatever was asked. Never looks at the scene; the rules of the paper's user are in `user`.

use reel_sim::published::{PublishedError, argument, python_text};
use reel_world::{
    AskContext, Task, ToolCall, ask_answer, ask_context, ask_error,
    record::{UserReply, UserSource},
};

/// The text of an answer. `reply` is what somebody outside said, who goes before the file.
///
/// # Errors
/// Fails if an argument is missing.
pub(crate) fn answer(
    call: &ToolCall,
    task: &Task,
    reply: Option<&UserReply>,
) -> Result<String, PublishedError> {
    let [category, description] = [
        argument(call, "target_category")?,
        argument(call, "target_description")?,
    ]
    .map(python_text);
    if category.trim().is_empty() || description.trim().is_empty() {
        return Ok(ask_error(
            "target_category and target_description must be non-empty",
        ));
    }
    if let Some(reply) = reply {
        // A server that reads the file knows no other kind than a model.
        let source = if reply.source == UserSource::Human {
            UserSource::Human
        } else {
            UserSource::Model
        };
        return Ok(ask_answer(&category, &reply.text, source));
    }
    Ok(match ask_context(task) {
        Some(AskContext {
            target_category,
            target_description,
        }) => ask_answer(&target_category, &target_description, UserSource::RuleBased),
        None => ask_error("simulated_user_context_unavailable"),
    })
}
