//! What a built-in policy says along with its calls: reasoning, history and schedule (paper,
//! Problem Formulation and Context Management; docs/spec.md#policy-context). Never an identifier of
//! an object, so that a data set may hold it.

use std::collections::VecDeque;

use crate::plan::Intent;
use reel_episode::Observation;
use reel_world::{Tool, ToolCall, record::PolicyOutput};

/// The history of calls, in words.
#[derive(Clone, Debug, Default)]
pub struct Narration {
    done: Vec<String>,
    pending: Option<String>,
}

impl Narration {
    /// Writes down how the last call went, and says why the next one is made.
    pub fn narrate(
        &mut self,
        tool: &Tool,
        schedule: &VecDeque<Intent>,
        observation: &Observation,
    ) -> PolicyOutput {
        self.settle(observation);
        self.pending = Some(deed(tool));
        let steps: Vec<String> = schedule.iter().map(ToString::to_string).collect();
        let subtask = steps.first().map_or("finish", String::as_str);
        PolicyOutput {
            reasoning: reason(tool),
            history: self.done.join("; "),
            plan: format!(
                "New Schedule: {}. Current subtask: {subtask}.",
                steps.join("; ")
            ),
            ..PolicyOutput::default()
        }
    }

    /// Writes down how the last call went, and that this one was made.
    pub fn watch(&mut self, call: &ToolCall, observation: &Observation) {
        self.settle(observation);
        self.pending = Some(
            Tool::parse(call).map_or_else(|_| "made an invalid call".into(), |tool| deed(&tool)),
        );
    }

    fn settle(&mut self, observation: &Observation) {
        if let Some(deed) = self.pending.take() {
            self.done.push(match observation.error {
                None => deed,
                Some(code) => format!("{deed} (failed: {code})"),
            });
        }
    }
}

fn deed(tool: &Tool) -> String {
    match tool {
        Tool::NavTo { receptacle } => format!("went to {receptacle}"),
        Tool::WalkAround => "walked around".into(),
        Tool::ShowObjectByCategory { category } => format!("looked for {category}"),
        Tool::ShowReceptacles => "marked the receptacles".into(),
        Tool::GazeAt { marker } => format!("gazed at {marker}"),
        Tool::Pick { marker } => format!("picked {marker}"),
        Tool::Place { marker } => format!("placed it on {marker}"),
        Tool::Open { marker } => format!("opened {marker}"),
        Tool::Close { marker } => format!("closed {marker}"),
        Tool::Ask { .. } => "asked the user".into(),
        Tool::Finish => "finished".into(),
        Tool::Lifecycle(_) => tool.paper_name().into(),
    }
}

fn reason(tool: &Tool) -> String {
    match tool {
        Tool::NavTo { receptacle } => {
            format!("What I have to do next is at {receptacle}, so I go there.")
        }
        Tool::WalkAround => "I do not see everything here, so I walk around and take stock.".into(),
        Tool::ShowObjectByCategory { category } => {
            format!("Before I pick I check whether a {category} is in view.")
        }
        Tool::ShowReceptacles => "I need the number of the receptacle before I can use it.".into(),
        Tool::GazeAt { marker } => format!("I go close to number {marker} and look at it."),
        Tool::Pick { marker } => {
            format!("Number {marker} is what I am looking for, so I pick it up.")
        }
        Tool::Place { marker } => {
            format!("Number {marker} is where it belongs, so I place it there.")
        }
        Tool::Open { marker } => {
            format!("The door of number {marker} must be open, and my hand is free.")
        }
        Tool::Close { marker } => format!("The door of number {marker} is no longer needed open."),
        Tool::Ask { .. } => {
            "Several things fit what I was told, so I ask which one is meant.".into()
        }
        Tool::Finish => "Nothing is left that I can do.".into(),
        Tool::Lifecycle(_) => String::new(),
    }
}
