//! What each published client remembers from answer to answer.

use serde_json::{Map, Value, json};

use super::answer::{AgentAnswer, gym_answer, scheduler_action};
use crate::{
    PromptWording,
    python::{self, Ascii},
};

/// Characters of an unreadable answer that the scheduler shows as the last action.
const RAW_CHARS: usize = 100;

/// The memory of the trainer's rollouts, which is the one that a model is trained with: lines that
/// it numbers itself, one an answer, of which it takes the last line of the History.
#[derive(Clone, PartialEq, Debug)]
pub struct SchedulerMemory {
    lines: Vec<String>,
    last_action: Value,
}

impl Default for SchedulerMemory {
    fn default() -> Self {
        Self {
            lines: Vec::new(),
            last_action: Map::new().into(),
        }
    }
}

impl SchedulerMemory {
    /// Takes in an answer that was executed and did not end the episode.
    pub fn update(&mut self, answer: &str, wording: &PromptWording) {
        match scheduler_action(answer) {
            Some((history, action)) => {
                if let Some(line) = history.as_deref().and_then(new_step) {
                    self.note(line);
                }
                if let Some(action) = action {
                    self.last_action = action;
                }
            }
            None => {
                self.note(&wording.unreadable_answer);
                self.last_action = json!({ "raw": python::prefix(answer, RAW_CHARS) });
            }
        }
    }

    /// Appends a line under the next number; an empty one is nothing.
    pub fn note(&mut self, line: &str) {
        if !line.is_empty() {
            self.lines
                .push(format!("{}) {}", self.lines.len(), python::strip(line)));
        }
    }

    /// The remembered History, one numbered line for each answer that had one.
    pub fn lines(&self) -> &[String] {
        &self.lines
    }

    /// The last action of any type; `{}` before the first.
    pub fn last_action(&self) -> &Value {
        &self.last_action
    }

    /// The last action as the prompt shows it.
    pub fn last_action_text(&self) -> String {
        python::dumps(&self.last_action, Ascii::Escaped)
    }

    /// Sets the last action, where no answer made it.
    pub fn set_last_action(&mut self, action: Value) {
        self.last_action = action;
    }

    /// The memory as the prompt shows it: `{}`, or `{'History': '...'}` with nothing escaped.
    pub fn task_progress(&self) -> String {
        if self.lines.is_empty() {
            "{}".to_owned()
        } else {
            format!("{{'History': '{}'}}", self.lines.join("\n"))
        }
    }
}

/// The step that a History adds: its last line, without the number before it. `None`
/// if it is empty.
fn new_step(history: &str) -> Option<&str> {
    if history.is_empty() {
        return None;
    }
    let last = python::strip(
        python::strip(history)
            .rsplit('\n')
            .next()
            .unwrap_or_default(),
    );
    let number = last.trim_start_matches(char::is_numeric);
    let numbered = (number.len() < last.len())
        .then(|| number.strip_prefix(')'))
        .flatten();
    let step = numbered
        .map(|rest| rest.trim_start_matches(python::is_space))
        .filter(|rest| !rest.is_empty());
    Some(python::strip(step.unwrap_or(last)))
}

/// The memory of the evaluation agent.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct AgentMemory {
    /// The summary of the latest answer.
    pub task_progress: Map<String, Value>,
    /// The latest call; empty before the first.
    pub last_action: Map<String, Value>,
}

impl AgentMemory {
    /// Takes in an answer that could be read, once its call was made.
    pub fn update(&mut self, answer: &AgentAnswer) {
        self.task_progress.clone_from(&answer.summary);
        let call = json!({ "tool_name": answer.tool_name, "args": answer.arguments });
        self.last_action = call.as_object().cloned().unwrap_or_default();
    }

    /// The values of the agent's prompt, in the order in which they stand in it. `scene` as
    /// [`super::agent_scene`] writes it, `tools` are MCP tools.
    pub fn prompt_slots(
        &self,
        task: &str,
        scene: &str,
        tools: &[Value],
        observation: &str,
    ) -> [(&'static str, String); 6] {
        let shown =
            |object: &Map<String, Value>| python::dumps(&object.clone().into(), Ascii::Plain);
        [
            ("task", task.to_owned()),
            ("scene", scene.to_owned()),
            ("tools", super::prompt_tools(tools)),
            ("progress", shown(&self.task_progress)),
            ("last_action", shown(&self.last_action)),
            ("observation", observation.to_owned()),
        ]
    }

    /// A result as the next prompt shows it: its texts, without the debug information, and a
    /// mark for each image.
    pub fn observation(texts: &[&str], images: usize, wording: &PromptWording) -> String {
        let joined = texts.join("\n");
        let text = Some(python::strip(&joined))
            .filter(|text| !text.is_empty())
            .map(|text| format!("Text: {text}"));
        let images = (images > 0).then(|| format!("Images: {}", vec!["<image>"; images].join(" ")));
        match text.into_iter().chain(images).collect::<Vec<_>>() {
            parts if parts.is_empty() => wording.agent_nothing.clone(),
            parts => parts.join("\n"),
        }
    }
}

/// The memory of the gym environment.
#[derive(Clone, PartialEq, Debug)]
pub struct GymMemory {
    /// The latest summary, of any type.
    pub task_progress: Value,
    /// The latest action that could be read, or the raw text of the answer that could not.
    pub last_action: Value,
}

impl Default for GymMemory {
    fn default() -> Self {
        Self {
            task_progress: Map::new().into(),
            last_action: Map::new().into(),
        }
    }
}

impl GymMemory {
    /// Takes in an answer; what cannot be read keeps its former value.
    pub fn update(&mut self, answer: &str) {
        let read = gym_answer(answer);
        if let Some(progress) = read.task_progress {
            self.task_progress = progress;
        }
        if let Some(action) = read.last_action {
            self.last_action = action;
        }
    }

    /// The memory as the prompt shows it.
    pub fn task_progress_text(&self) -> String {
        let shown = if is_empty(&self.task_progress) {
            &Value::Object(Map::new())
        } else {
            &self.task_progress
        };
        python::dumps_indented(shown, Ascii::Escaped)
    }

    /// The last action as the prompt shows it.
    pub fn last_action_text(&self) -> String {
        let shown = if is_empty(&self.last_action) {
            &Value::Object(Map::new())
        } else {
            &self.last_action
        };
        python::dumps(shown, Ascii::Escaped)
    }
}

/// What Python takes for false.
fn is_empty(value: &Value) -> bool {
    match value {
        Value::Null | Value::Bool(false) => true,
        Value::Number(number) => number.as_f64() == Some(0.0),
        Value::String(text) => text.is_empty(),
        Value::Array(items) => items.is_empty(),
        Value::Object(object) => object.is_empty(),
        Value::Bool(true) => false,
    }
}
