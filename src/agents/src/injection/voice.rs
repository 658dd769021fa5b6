//! What an agent with a fault says along with its calls: reasoning, history and schedule, as it
//! believes them to be (docs/spec.md#policy-context). Never an identifier of an object, and never
//! that a fault is at work.

use std::collections::VecDeque;

use crate::plan::Intent;
use reel_episode::Observation;
use reel_world::{Tool, ToolCall, record::PolicyOutput};

/// The history of calls, in one of several manners of speaking.
#[derive(Clone, Debug, Default)]
pub(super) struct NarrationStyle {
    manner: usize,
    done: Vec<String>,
    pending: Option<String>,
    schedule: Vec<String>,
    /// Where in the history a claim stands.
    claims: Vec<usize>,
}

impl NarrationStyle {
    pub fn new(manner: usize) -> Self {
        Self {
            manner,
            ..Self::default()
        }
    }

    /// Puts something into the history that was never done; `observation` is what
    /// the last call gave.
    pub fn claim(&mut self, claim: &str, observation: &Observation) {
        self.settle(observation);
        self.claims.push(self.done.len());
        self.done.push(claim.to_owned());
    }

    /// Removes every claimed entry from the history again.
    pub fn unclaim(&mut self) {
        for index in self.claims.drain(..).rev() {
            self.done.remove(index);
        }
    }

    /// What the agent intends from here on; `name`: what it calls the thing to find.
    pub fn intend(&mut self, intents: &VecDeque<Intent>, name: Option<&str>) {
        let said = |intent: &Intent| match (intent, name) {
            (Intent::Find { .. }, Some(name)) => format!("find the {name}"),
            _ => intent.to_string(),
        };
        self.schedule = intents.iter().map(said).collect();
    }

    /// Writes down how the last call went, and says why the next one is made.
    pub fn narrate(
        &mut self,
        call: &ToolCall,
        think: Option<&str>,
        observation: &Observation,
    ) -> PolicyOutput {
        self.settle(observation);
        let Ok(tool) = Tool::parse(call) else {
            self.pending = Some(format!(
                "tried {}",
                if call.name.is_empty() {
                    "something"
                } else {
                    &call.name
                }
            ));
            return PolicyOutput {
                raw: call.to_string(),
                history: self.done.join("; "),
                ..PolicyOutput::default()
            };
        };
        self.pending = Some(self.deed(&tool));
        let subtask = self.schedule.first().map_or("finish", String::as_str);
        PolicyOutput {
            reasoning: [think.unwrap_or_default(), &self.reason(&tool)]
                .join(" ")
                .trim()
                .to_owned(),
            history: self.done.join("; "),
            plan: format!(
                "New Schedule: {}. Current subtask: {subtask}.",
                self.schedule.join("; ")
            ),
            ..PolicyOutput::default()
        }
    }

    /// Writes the last call down.
    fn settle(&mut self, observation: &Observation) {
        if let Some(deed) = self.pending.take() {
            self.done.push(match observation.error {
                None => deed,
                Some(code) => format!("{deed} (failed: {code})"),
            });
        }
    }

    fn say(&self, manners: [String; 3]) -> String {
        manners[self.manner % 3].clone()
    }

    fn deed(&self, tool: &Tool) -> String {
        let [one, two, three] = match tool {
            Tool::NavTo { receptacle } => [
                format!("went to {receptacle}"),
                format!("navigated to {receptacle}"),
                format!("now at {receptacle}"),
            ],
            Tool::WalkAround => [
                "walked around",
                "explored the receptacle",
                "looked at it from all sides",
            ]
            .map(str::to_owned),
            Tool::ShowObjectByCategory { category } => [
                format!("looked for {category}"),
                format!("marked every {category}"),
                format!("searched for a {category}"),
            ],
            Tool::ShowReceptacles => [
                "marked the receptacles",
                "highlighted the furniture",
                "numbered the furniture",
            ]
            .map(str::to_owned),
            Tool::GazeAt { marker } => [
                format!("gazed at {marker}"),
                format!("focused on marker {marker}"),
                format!("had a close look at {marker}"),
            ],
            Tool::Pick { marker } => [
                format!("picked {marker}"),
                format!("picked up marker {marker}"),
                format!("took number {marker}"),
            ],
            Tool::Place { marker } => [
                format!("placed it on {marker}"),
                format!("put it on marker {marker}"),
                format!("set it down on {marker}"),
            ],
            Tool::Open { marker } => [
                format!("opened {marker}"),
                format!("opened marker {marker}"),
                format!("opened the door of {marker}"),
            ],
            Tool::Close { marker } => [
                format!("closed {marker}"),
                format!("closed marker {marker}"),
                format!("shut the door of {marker}"),
            ],
            Tool::Ask { .. } => [
                "asked the user",
                "asked a question",
                "asked for clarification",
            ]
            .map(str::to_owned),
            Tool::Finish => ["finished", "called finish", "done"].map(str::to_owned),
            Tool::Lifecycle(_) => [(); 3].map(|()| tool.paper_name().to_owned()),
        };
        self.say([one, two, three])
    }

    fn reason(&self, tool: &Tool) -> String {
        let [one, two] = match tool {
            Tool::NavTo { receptacle } => [
                format!("What I have to do next is at {receptacle}, so I go there."),
                format!("Next I go to {receptacle}."),
            ],
            Tool::WalkAround => [
                "I do not see everything here, so I walk around.",
                "Let me see this from all sides.",
            ]
            .map(str::to_owned),
            Tool::ShowObjectByCategory { category } => [
                format!("I check whether a {category} is in view."),
                format!("I mark every {category} here."),
            ],
            Tool::ShowReceptacles => [
                "I need the number of the receptacle.",
                "Let me see which furniture is here.",
            ]
            .map(str::to_owned),
            Tool::GazeAt { marker } => [
                format!("I go close to number {marker}."),
                format!("I have a closer look at {marker}."),
            ],
            Tool::Pick { marker } => [
                format!("Number {marker} is what I am looking for, so I pick it up."),
                format!("I take {marker}."),
            ],
            Tool::Place { marker } => [
                format!("Number {marker} is where it belongs."),
                format!("I put it on {marker}."),
            ],
            Tool::Open { marker } => [
                format!("The door of number {marker} must be open."),
                format!("I open {marker}."),
            ],
            Tool::Close { marker } => [
                format!("The door of {marker} can be closed again."),
                format!("I close {marker}."),
            ],
            Tool::Ask { .. } => {
                ["I am not sure, so I ask.", "The user can tell me."].map(str::to_owned)
            }
            Tool::Finish => ["Nothing is left to do.", "The task is complete."].map(str::to_owned),
            Tool::Lifecycle(_) => [(); 2].map(|()| String::new()),
        };
        self.say([
            one.clone(),
            two.clone(),
            if self.done.len().is_multiple_of(2) {
                one
            } else {
                two
            },
        ])
    }
}
