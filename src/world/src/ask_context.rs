//! `ask` of REAL's main server: what its simulated user, who reads task metadata, knows of the
//! target, and the text of the answer, written and parsed.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use crate::{
    PlanStep, Task,
    record::{UserReply, UserSource},
};

/// Which object is meant, and how it is described.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct AskContext {
    /// Category of the target, e.g. `mug`; empty if nothing names it.
    pub target_category: String,
    /// Description of the target; never empty.
    pub target_description: String,
}

/// What the server knows of the task that it serves: the first `ask` step of the plan that has a
/// description, else the `target_description` of the task file. The category is that of the step,
/// else of the target object; the server does not read the task file's own `target_category`.
/// `None` if there is no description, as in all published tasks of REAL-Bench.
pub fn ask_context(task: &Task) -> Option<AskContext> {
    let of_file = |key: &str| match key {
        "target_description" => task
            .extra
            .get("episodes[0].target_description")
            .and_then(text),
        _ => None,
    };
    first(
        task.plan.iter().cloned(),
        of_file,
        Some(&task.target_object().category),
    )
}

/// What the published code reads from an episode of a task file as it stands there: its plan may be
/// in texts, and its own `target_category` counts before `category`, which is that of the target
/// object if it is known.
pub fn ask_context_of_episode(
    episode: &Map<String, Value>,
    category: Option<&str>,
) -> Option<AskContext> {
    let plan = episode
        .get("execution_plan")
        .and_then(Value::as_array)
        .into_iter()
        .flatten();
    let step = |step: &Value| match step {
        Value::String(text) => PlanStep::from_text(text),
        _ => serde_json::from_value(step.clone()).ok(),
    };
    first(
        plan.filter_map(step),
        |key| episode.get(key).and_then(text),
        category,
    )
}

fn first<'a>(
    plan: impl Iterator<Item = PlanStep>,
    of_file: impl Fn(&str) -> Option<&'a str>,
    category: Option<&str>,
) -> Option<AskContext> {
    let described = |step: PlanStep| {
        let target_description = step.text_argument("target_description")?.to_owned();
        let target_category = step
            .text_argument("target_category")
            .or(category)
            .unwrap_or_default()
            .to_owned();
        Some(AskContext {
            target_category,
            target_description,
        })
    };
    let asked = plan.filter(|step| step.action == "ask").find_map(described);
    asked.or_else(|| {
        let target_description = of_file("target_description")?.to_owned();
        let target_category = of_file("target_category")
            .or(category)
            .unwrap_or_default()
            .to_owned();
        Some(AskContext {
            target_category,
            target_description,
        })
    })
}

/// The text of an answer: a JSON object that names the target's category, its description,
/// and who described it.
pub fn ask_answer(category: &str, description: &str, source: UserSource) -> String {
    let [category, description, source] =
        [category, description, source_name(source)].map(|text| json!(text));
    format!(
        r#"{{"target_category": {category}, "target_description": {description}, "source": {source}}}"#
    )
}

/// The text of an answer that describes nothing, because of `error`.
pub fn ask_error(error: &str) -> String {
    format!(
        r#"{{"error": {}, "source": {}}}"#,
        json!(error),
        json!(source_name(UserSource::RuleBased))
    )
}

/// What an answer says, in words: category and description. Plain words come from a model. `None`
/// if the text is empty or names an error.
pub fn ask_reply(answer: &str) -> Option<UserReply> {
    if answer.is_empty() {
        return None;
    }
    let Ok(Value::Object(object)) = serde_json::from_str::<Value>(answer) else {
        return Some(UserReply {
            text: answer.to_owned(),
            source: UserSource::Model,
        });
    };
    if object.contains_key("error") {
        return None;
    }
    let of = |key: &str| object.get(key).and_then(text);
    let said = [of("target_category"), of("target_description")]
        .into_iter()
        .flatten()
        .collect::<Vec<_>>()
        .join(" - ");
    let source = match of("source") {
        None | Some("task_metadata") => UserSource::RuleBased,
        Some("human" | "user") => UserSource::Human,
        Some(_) => UserSource::Model,
    };
    Some(UserReply {
        text: if said.is_empty() {
            answer.to_owned()
        } else {
            said
        },
        source,
    })
}

fn source_name(source: UserSource) -> &'static str {
    match source {
        UserSource::RuleBased => "task_metadata",
        UserSource::Model => "model",
        UserSource::Human => "human",
    }
}

fn text(value: &Value) -> Option<&str> {
    value
        .as_str()
        .map(str::trim)
        .filter(|text| !text.is_empty())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn of(episode: &Value, category: Option<&str>) -> Option<[String; 2]> {
        let context = ask_context_of_episode(episode.as_object().unwrap(), category)?;
        Some([context.target_category, context.target_description])
    }

    #[test]
    fn an_answer_is_read_as_it_was_written() {
        for source in [UserSource::RuleBased, UserSource::Model, UserSource::Human] {
            let reply = ask_reply(&ask_answer("cup", "the \"tall\" one", source));
            assert_eq!(
                reply,
                Some(UserReply {
                    text: "cup - the \"tall\" one".into(),
                    source
                })
            );
        }
        assert_eq!(ask_reply(&ask_error("unavailable")), None);
        assert_eq!(
            ask_reply("The tall one."),
            Some(UserReply {
                text: "The tall one.".into(),
                source: UserSource::Model
            })
        );
        assert_eq!(ask_reply(""), None);
    }

    #[test]
    fn the_first_described_question_counts_before_the_episode() {
        let episode = json!({
            "target_description": "a jug", "target_category": "jug",
            "execution_plan": ["find cup - no question", "ask cup", {"action": "ask", "args": 3}, "ask cup - the tall one", "ask cup - last"],
        });
        assert_eq!(
            of(&episode, Some("vase")),
            Some(["cup", "the tall one"].map(str::to_owned))
        );
        let plain = json!({"target_description": " a jug ", "execution_plan": ["ask cup"]});
        assert_eq!(
            of(&plain, Some("vase")),
            Some(["vase", "a jug"].map(str::to_owned))
        );
        assert_eq!(of(&plain, None), Some(["", "a jug"].map(str::to_owned)));
        assert_eq!(
            of(
                &json!({"target_description": " ", "execution_plan": "none"}),
                Some("vase")
            ),
            None
        );
    }
}
