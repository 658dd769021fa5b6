//! A policy that tries everything: whatever is in view, every receptacle, every tool, now and then
//! nonsense. It wants no goal; it is there to find what breaks. It sees only what an agent sees.

use std::collections::BTreeSet;

use rand_chacha::ChaCha8Rng;
use reel_world::{
    ErrorCode, HORIZON, ReceptacleId, Task, Tool, ToolCall, ToolSpec,
    record::{PolicyInfo, StepInput},
};
use serde_json::{Value, json};

use crate::{
    PerceivedItem, Policy, PolicyContext, ResponderError, planner::DOOR_WORDS, policy, random,
};

/// Fewest calls before it finishes.
const LENGTH_MIN: usize = 10;
/// One in so many calls goes by its name in the published repository.
const OTHER_NAME_EVERY: usize = 3;
/// One in so many numbers is one that stands for nothing now, or for a thing of another kind.
const ODD_NUMBER_EVERY: usize = 10;

/// What it can think of doing.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Candidate {
    Drive,
    WalkAround,
    ShowObjects,
    ShowReceptacles,
    Gaze,
    Pick,
    Place,
    Open,
    Close,
    Ask,
    List,
    Nonsense,
}

/// Tries everything, at random, but so that much happens.
#[derive(Debug)]
pub struct Explorer {
    seed: u64,
    rng: ChaCha8Rng,
    /// Calls after which it finishes, before the horizon.
    length: u32,
    holding: bool,
    /// The tool of the last call.
    last: Option<Candidate>,
    /// Numbers that were on some map.
    old_numbers: BTreeSet<u32>,
    /// Receptacles it saw objects on.
    laden: BTreeSet<ReceptacleId>,
    /// Categories of objects and furniture seen so far, for look-ups and questions.
    categories: BTreeSet<String>,
}

impl Explorer {
    /// `seed` decides everything, but otherwise in every task.
    pub fn new(task: &Task, seed: u64) -> Self {
        let mut rng = random::stream(seed, &format!("explorer/{}", task.task_id), 0);
        let length = LENGTH_MIN + random::below(&mut rng, HORIZON as usize - LENGTH_MIN);
        let length = u32::try_from(length).expect("below the horizon");
        Self {
            seed,
            rng,
            length,
            holding: false,
            last: None,
            old_numbers: BTreeSet::new(),
            laden: BTreeSet::new(),
            categories: BTreeSet::new(),
        }
    }

    fn learn(&mut self, context: &PolicyContext<'_>) {
        match self.last {
            Some(Candidate::Pick) if context.observation.error.is_none() => self.holding = true,
            Some(Candidate::Place) if context.observation.error.is_none() => self.holding = false,
            _ => {}
        }
        self.old_numbers
            .extend(context.perceived.iter().filter_map(|thing| thing.marker));
        let objects = || context.perceived.iter().filter(|thing| !thing.furniture);
        self.laden
            .extend(objects().filter_map(|thing| thing.receptacle_hint.clone()));
        self.categories
            .extend(context.perceived.iter().map(|thing| thing.category.clone()));
    }

    /// Chooses by weights that make episodes in which much happens: what is possible is likely, the
    /// rest is tried too.
    fn choose_deed(&mut self, context: &PolicyContext<'_>) -> Candidate {
        let any = |fits: fn(&PerceivedItem) -> bool| context.perceived.iter().any(fits);
        let objects = any(|thing| !thing.furniture && thing.marker.is_some());
        let unmarked = any(|thing| !thing.furniture && thing.marker.is_none());
        let furniture = any(|thing| thing.furniture && thing.marker.is_some());
        let door = any(|thing| thing.furniture && has_door(&thing.category));
        let too_far = context.observation.error == Some(ErrorCode::OutOfReach);
        let free = !self.holding;
        let if_else = |condition: bool, yes: usize, no: usize| if condition { yes } else { no };
        let weights = [
            (Candidate::Drive, if_else(self.last.is_none(), 90, 10)),
            (Candidate::WalkAround, if_else(free, 8, 3)),
            (Candidate::ShowObjects, if_else(unmarked && free, 24, 4)),
            (Candidate::ShowReceptacles, if_else(furniture, 3, 14)),
            (
                Candidate::Gaze,
                if_else(too_far, 40, if_else(objects || furniture, 9, 1)),
            ),
            (Candidate::Pick, if_else(free && objects, 30, 1)),
            (Candidate::Place, if_else(!free && furniture, 30, 1)),
            (Candidate::Open, if_else(door, 16, 1)),
            (Candidate::Close, if_else(door, 10, 1)),
            (Candidate::Ask, 2),
            (Candidate::List, 1),
            (Candidate::Nonsense, 3),
        ];
        let total = weights.iter().map(|(_, weight)| weight).sum();
        let mut ticket = random::below(&mut self.rng, total);
        for (deed, weight) in weights {
            if ticket < weight {
                return deed;
            }
            ticket -= weight;
        }
        unreachable!("the ticket is below the sum of the weights")
    }

    fn call(&mut self, deed: Candidate, context: &PolicyContext<'_>) -> ToolCall {
        let numbered = |furniture: bool| {
            context
                .perceived
                .iter()
                .filter(move |thing| thing.furniture == furniture)
        };
        let tool = match deed {
            Candidate::Drive => return self.drive(context),
            Candidate::WalkAround => Tool::WalkAround,
            Candidate::ShowObjects => Tool::ShowObjectByCategory {
                category: self.category(context),
            },
            Candidate::ShowReceptacles => Tool::ShowReceptacles,
            Candidate::Gaze => Tool::GazeAt {
                marker: self.number(context.perceived.iter().collect()),
            },
            Candidate::Pick => Tool::Pick {
                marker: self.number(numbered(false).collect()),
            },
            Candidate::Place => Tool::Place {
                marker: self.number(numbered(true).collect()),
            },
            Candidate::Open => Tool::Open {
                marker: self.door(numbered(true).collect()),
            },
            Candidate::Close => Tool::Close {
                marker: self.door(numbered(true).collect()),
            },
            Candidate::Ask => return self.question(),
            Candidate::List => {
                return self.one_of([
                    ToolCall::new("list_receptacles", json!({})),
                    ToolCall::new("list_tasks", json!({})),
                ]);
            }
            Candidate::Nonsense => return self.nonsense(),
        };
        tool.to_call()
    }

    /// To any receptacle, to one that may have a door, or to one with something on it.
    fn drive(&mut self, context: &PolicyContext<'_>) -> ToolCall {
        let all = &context.briefing.receptacles;
        let among: Vec<ReceptacleId> = match random::below(&mut self.rng, 3) {
            0 => all
                .iter()
                .filter(|(_, category, _)| has_door(category))
                .map(|(id, ..)| id.clone())
                .collect(),
            1 => self.laden.iter().cloned().collect(),
            _ => Vec::new(),
        };
        let anywhere = all
            .get(random::below(&mut self.rng, all.len().max(1)))
            .map(|(id, ..)| id);
        match random::choose(&mut self.rng, &among).or(anywhere) {
            Some(id) => Tool::NavTo {
                receptacle: id.clone(),
            }
            .to_call(),
            None => Tool::ShowReceptacles.to_call(),
        }
    }

    /// A category in view, one it saw before, or a word of the instruction.
    fn category(&mut self, context: &PolicyContext<'_>) -> String {
        let in_view = context
            .perceived
            .iter()
            .filter(|thing| !thing.furniture)
            .map(|thing| thing.category.clone());
        let words = context
            .briefing
            .instruction
            .split_whitespace()
            .map(|word| word.trim_matches(|c: char| !c.is_alphanumeric()));
        let among: Vec<String> = match random::below(&mut self.rng, 8) {
            0 => words
                .filter(|word| word.len() > 3)
                .map(str::to_owned)
                .collect(),
            1 => self.categories.iter().cloned().collect(),
            _ => in_view.collect(),
        };
        random::choose(&mut self.rng, &among)
            .cloned()
            .unwrap_or_else(|| "apple".to_owned())
    }

    /// The number of one of these things; now and then another one.
    fn number(&mut self, things: Vec<&PerceivedItem>) -> u32 {
        let numbers: Vec<u32> = things.iter().filter_map(|thing| thing.marker).collect();
        if numbers.is_empty() || random::below(&mut self.rng, ODD_NUMBER_EVERY) == 0 {
            let old: Vec<u32> = self.old_numbers.iter().copied().chain([0, 97]).collect();
            return random::choose(&mut self.rng, &old).copied().unwrap_or(97);
        }
        random::choose(&mut self.rng, &numbers)
            .copied()
            .unwrap_or(97)
    }

    /// The number of a thing that looks as if it had a door, most of the time.
    fn door(&mut self, things: Vec<&PerceivedItem>) -> u32 {
        let doors: Vec<&PerceivedItem> = things
            .iter()
            .filter(|thing| has_door(&thing.category))
            .copied()
            .collect();
        let doors = if random::below(&mut self.rng, 5) == 0 || doors.is_empty() {
            things
        } else {
            doors
        };
        self.number(doors)
    }

    fn question(&mut self) -> ToolCall {
        let seen: Vec<String> = self.categories.iter().cloned().collect();
        let category = random::choose(&mut self.rng, &seen)
            .cloned()
            .unwrap_or_else(|| "thing".to_owned());
        self.one_of([
            ToolCall::new(
                "ask",
                json!({ "question": format!("Do you want the {category}?") }),
            ),
            ToolCall::new(
                "ask",
                json!({ "question": "Which of them do you mean, and where does it go?" }),
            ),
            ToolCall::new("ask", json!({ "question": "" })),
            ToolCall::new(
                "ask",
                json!({ "target_category": category, "target_description": "the one on the left" }),
            ),
        ])
    }

    fn nonsense(&mut self) -> ToolCall {
        self.one_of([
            ToolCall::new("throw", json!({ "marker_id": 1 })),
            ToolCall::new("nav_to", json!({ "receptacle_name": "garage_0" })),
            ToolCall::new("nav_to", json!({})),
            ToolCall::new("pick", json!({ "marker_id": "the left one" })),
            ToolCall::new("place", json!({ "marker_id": 1.5 })),
            ToolCall::new("open", json!([1])),
            ToolCall::new("show_object_by_category", json!({ "target_category": "" })),
            ToolCall::new("gaze_at", Value::Null),
            ToolCall::new("finish_with_id", json!({ "task_id": "another" })),
        ])
    }

    fn one_of<const N: usize>(&mut self, calls: [ToolCall; N]) -> ToolCall {
        calls[random::below(&mut self.rng, N)].clone()
    }
}

impl Policy for Explorer {
    fn info(&self) -> PolicyInfo {
        policy::info("explorer", self.seed)
    }

    fn needs_privileged(&self) -> bool {
        false
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        self.learn(context);
        let call = if context.step >= self.length {
            Tool::Finish.to_call()
        } else {
            let deed = self.choose_deed(context);
            self.last = Some(deed);
            self.call(deed, context)
        };
        let other_name = random::below(&mut self.rng, OTHER_NAME_EVERY) == 0;
        let call = match ToolSpec::by_name(&call.name) {
            Some(spec) if other_name => ToolCall {
                name: spec.repo_name.to_owned(),
                ..call
            },
            _ => call,
        };
        Ok(StepInput::from_call(call))
    }

    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.learn(context);
        self.last = Some(match Tool::parse(&input.call) {
            Ok(Tool::NavTo { .. }) => Candidate::Drive,
            Ok(Tool::WalkAround) => Candidate::WalkAround,
            Ok(Tool::ShowObjectByCategory { .. }) => Candidate::ShowObjects,
            Ok(Tool::ShowReceptacles) => Candidate::ShowReceptacles,
            Ok(Tool::GazeAt { .. }) => Candidate::Gaze,
            Ok(Tool::Pick { .. }) => Candidate::Pick,
            Ok(Tool::Place { .. }) => Candidate::Place,
            Ok(Tool::Open { .. }) => Candidate::Open,
            Ok(Tool::Close { .. }) => Candidate::Close,
            Ok(Tool::Ask { .. }) => Candidate::Ask,
            Ok(Tool::Finish | Tool::Lifecycle(_)) => Candidate::List,
            Err(_) => Candidate::Nonsense,
        });
    }
}

fn has_door(name: &str) -> bool {
    let name = name.to_lowercase();
    DOOR_WORDS.iter().any(|word| name.contains(word))
}
