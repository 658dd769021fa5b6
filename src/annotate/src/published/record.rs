//! The records of an annotated episode. Step 0 is before the first action and has no image; step
//! `i` shows observation `i`, with action `i` as the last and action `i + 1` (`finish` at the end)
//! as the next one.

use reel_prompt::python::{self, Ascii};
use serde_json::{Map, Value, json};

use super::{
    action::{self, action_text},
    answer::{Thought, thought},
};

/// Sentences that surround the facts of a request.
#[derive(Clone, Copy, Debug)]
pub struct RequestWording<'a> {
    /// Text of the system message, the first of a record.
    pub system: &'a str,
    /// First entry of every History, with its number 1.
    pub first_history: &'a str,
    /// `IMPORTANT`: what the answer must keep to.
    pub important: &'a str,
    /// What the receptacles of `Object disambiguation` are.
    pub disambiguation: &'a str,
    /// What is wanted of a key of the answer, by the key.
    pub asked: fn(&str) -> &'a str,
}

impl RequestWording<'static> {
    /// The sentences that Reel writes where the published ones are not given.
    pub const REEL: Self = Self {
        system: "You write down what a household robot thinks before each of its actions.",
        first_history: "1) The episode began.",
        important: "Use only what the robot has seen or was told so far. Answer with the JSON object alone.",
        disambiguation: "Where the object is and where it shall go, and the furniture that may be mistaken for either.",
        asked: |key| match key {
            "CoT" => "why the next action is right now",
            "History" => "the result of the last action, in one sentence",
            "New Schedule" => "what is left to do, as a list",
            "Current subtask" => "what the next action is for",
            "Last Action" => "the last action, unchanged",
            _ => "",
        },
    };
}

/// What is told of a task: `<n>_meta.json`.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TaskMeta {
    /// The instruction that the agent was given.
    pub task_description: String,
    /// Where the target is.
    pub src: String,
    /// Where it shall go.
    pub dest: String,
    /// Receptacles like the first.
    pub src_distractors: Vec<String>,
    /// Receptacles like the second.
    pub dest_distractors: Vec<String>,
}

impl TaskMeta {
    /// As it stands in the file.
    pub fn to_json(&self) -> Value {
        let TaskMeta {
            task_description,
            src,
            dest,
            src_distractors,
            dest_distractors,
        } = self;
        json!({
            "task_description": task_description, "src": src, "dest": dest,
            "src_distractors": src_distractors, "dest_distractors": dest_distractors,
        })
    }
}

/// An action and what was observed after it.
#[derive(Clone, PartialEq, Debug)]
pub struct StreamStep {
    /// The action in its normal form, `{tool: payload}`, under the tool's old name.
    pub action: Map<String, Value>,
    /// Text of the observation.
    pub text: String,
    /// Whether the observation is an image.
    pub image: bool,
}

/// An episode as the annotation reads it.
#[derive(Clone, PartialEq, Debug)]
pub struct Episode {
    /// Number of the episode in the job, counted from 1; it makes the id `ep_000001`.
    pub number: u32,
    /// The model that played it, if it is to be named.
    pub model_name: Option<String>,
    /// The part of the benchmark, if it is to be named.
    pub eval_subset: Option<String>,
    /// Instruction, source, destination and distractors of the episode's task.
    pub task: TaskMeta,
    /// Its actions without the final `finish`.
    pub steps: Vec<StreamStep>,
}

impl Episode {
    /// The id by which the published script names the episode's files, e.g. `ep_000001`.
    pub fn id(&self) -> String {
        format!("ep_{:06}", self.number)
    }

    /// Path of the image of a step below the folder of the set; `None` if the step shows none.
    pub fn image_path(&self, step: usize) -> Option<String> {
        let shown = &self.steps[step.checked_sub(1)?];
        let id = self.id();
        shown
            .image
            .then(|| format!("obs/images/{id}/{id}_step_{step}.png"))
    }

    /// The template records: what a model is asked, with nothing in the place of its thought.
    pub fn templates(&self, wording: &RequestWording<'_>) -> Vec<Value> {
        let request = |step| {
            (
                self.request(step, wording.first_history, wording),
                String::new(),
            )
        };
        (0..=self.steps.len())
            .map(request)
            .enumerate()
            .map(|(step, (human, gpt))| self.record(step, &human, gpt, wording))
            .collect()
    }

    /// The annotated records: the answer to each request, its History replaced by the numbered list
    /// of all so far. An answer whose History is empty or unreadable adds nothing to the list; one
    /// that is unreadable stands as it came.
    pub fn samples(&self, answers: &[String], wording: &RequestWording<'_>) -> Vec<Value> {
        let mut history = wording.first_history.to_owned();
        let mut entries = 1;
        let sample = |step: usize| {
            let human = self.request(step, &history, wording);
            let answer = answers.get(step).map(String::as_str).unwrap_or_default();
            let gpt = match thought(answer) {
                Some(mut thought) => {
                    if step > 0 && !thought.history.is_empty() {
                        entries += 1;
                        history
                            .push_str(&format!("\n{entries}) {}", python::strip(&thought.history)));
                        thought.history.clone_from(&history);
                    }
                    text(&thought.to_json())
                }
                None if answer.is_empty() => text(&Thought::default().to_json()),
                None => answer.to_owned(),
            };
            self.record(step, &human, gpt, wording)
        };
        (0..=self.steps.len()).map(sample).collect()
    }

    /// What a model is asked at a step.
    fn request(&self, step: usize, history: &str, wording: &RequestWording<'_>) -> Value {
        let task = &self.task;
        let shown = step.checked_sub(1).map(|index| &self.steps[index]);
        let past = shown.map_or_else(
            || json!({}),
            |shown| json!({ "summary": { "History": history, "Last Action": action::call(&shown.action) } }),
        );
        let next = match self.steps.get(step) {
            Some(next) => action_text(&next.action),
            None => action_text(&Map::from_iter([("finish".to_owned(), json!({}))])),
        };
        let keys = ["History", "New Schedule", "Current subtask", "Last Action"];
        let keys = &keys[..if step == 0 { 3 } else { 4 }];
        let summary: Map<String, Value> = keys
            .iter()
            .map(|key| ((*key).to_owned(), json!((wording.asked)(key))))
            .collect();
        json!({
            "Task instruction": task.task_description,
            "History": past,
            "Observation": {
                "camera": shown.map(|_| "<image>"),
                "text": shown.map(|shown| shown.text.as_str()).unwrap_or_default(),
                "conversation": [],
            },
            "Next Action": next,
            "IMPORTANT": wording.important,
            "Object disambiguation metadata": wording.disambiguation,
            "Object disambiguation": {
                "src": task.src, "src_distractors": task.src_distractors,
                "dest": task.dest, "dest_distractors": task.dest_distractors,
            },
            "Output format (REQUIRED JSON)": { "CoT": (wording.asked)("CoT"), "Summary": summary },
        })
    }

    fn record(
        &self,
        step: usize,
        human: &Value,
        gpt: String,
        wording: &RequestWording<'_>,
    ) -> Value {
        let mut metadata = Map::new();
        for (key, value) in [
            ("model_name", &self.model_name),
            ("eval_subset", &self.eval_subset),
        ] {
            metadata.extend(value.as_ref().map(|value| (key.to_owned(), json!(value))));
        }
        metadata.insert("episode_id".to_owned(), json!(self.id()));
        metadata.insert("step_id".to_owned(), json!(step));
        json!({
            "metadata": metadata,
            "obs_image": self.image_path(step).unwrap_or_default(),
            "conversations": [
                { "from": "system", "value": wording.system },
                { "from": "human", "value": text(human) },
                { "from": "gpt", "value": gpt, "think_or_action": 0, "end_turn": false },
                { "from": "gpt", "value": human["Next Action"], "think_or_action": 1, "end_turn": true },
            ],
        })
    }
}

fn text(value: &Value) -> String {
    python::dumps(value, Ascii::Plain)
}
