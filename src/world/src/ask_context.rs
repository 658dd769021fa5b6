//! What a simulated user that reads task metadata knows of the target: the answer of REAL's main server to `ask`. It says no
//! sentence; who serves it does.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use crate::{PlanStep, Task};

/// Which object is meant, and how it is described.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct AskContext {
    /// Category of the target, e.g. `mug`; empty if nothing names it.
    pub target_category: String,
    /// Description of the target; never empty.
    pub target_description: String,
}

/// The context of a task: the first `ask` step of its plan that has a description, else the `target_description` of the task
/// file. `None` if there is neither, as in all published tasks of REAL-Bench.
pub fn ask_context(task: &Task) -> Option<AskContext> {
    let of_file = |key: &str| task.extra.get(&format!("episodes[0].{key}")).and_then(text);
    first(task.plan.iter().cloned(), of_file, Some(&task.target_object().category))
}

/// [`ask_context`] for an episode of a task file as it stands there, whose plan may be in texts. `category` is that of the target,
/// if it is known.
pub fn ask_context_of_episode(episode: &Map<String, Value>, category: Option<&str>) -> Option<AskContext> {
    let plan = episode.get("execution_plan").and_then(Value::as_array).into_iter().flatten();
    let step = |step: &Value| match step {
        Value::String(text) => PlanStep::from_text(text),
        _ => serde_json::from_value(step.clone()).ok(),
    };
    first(plan.filter_map(step), |key| episode.get(key).and_then(text), category)
}

fn first<'a>(
    plan: impl Iterator<Item = PlanStep>,
    of_file: impl Fn(&str) -> Option<&'a str>,
    category: Option<&str>,
) -> Option<AskContext> {
    let described = |step: PlanStep| {
        let target_description = step.text_argument("target_description")?.to_owned();
        let target_category = step.text_argument("target_category").or(category).unwrap_or_default().to_owned();
        Some(AskContext { target_category, target_description })
    };
    let asked = plan.filter(|step| step.action == "ask").find_map(described);
    asked.or_else(|| {
        let target_description = of_file("target_description")?.to_owned();
        let target_category = of_file("target_category").or(category).unwrap_or_default().to_owned();
        Some(AskContext { target_category, target_description })
    })
}

fn text(value: &Value) -> Option<&str> {
    value.as_str().map(str::trim).filter(|text| !text.is_empty())
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
    fn the_first_described_question_counts_before_the_episode() {
        let episode = json!({
            "target_description": "a jug", "target_category": "jug",
            "execution_plan": ["find cup - no question", "ask cup", {"action": "ask", "args": 3}, "ask cup - the tall one", "ask cup - last"],
        });
        assert_eq!(of(&episode, Some("vase")), Some(["cup", "the tall one"].map(str::to_owned)));
        let plain = json!({"target_description": " a jug ", "execution_plan": ["ask cup"]});
        assert_eq!(of(&plain, Some("vase")), Some(["vase", "a jug"].map(str::to_owned)));
        assert_eq!(of(&plain, None), Some(["", "a jug"].map(str::to_owned)));
        assert_eq!(of(&json!({"target_description": " ", "execution_plan": "none"}), Some("vase")), None);
    }
}
