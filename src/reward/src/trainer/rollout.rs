//! One episode as the trainer plays it, from payloads and results as they come over MCP: the
//! same rules that score records and table columns, fed by what a client is sent. Never
//! makes a call itself.

use serde_json::Value;
use thiserror::Error;

use crate::{
    facts::{Authority, Delivery, EpisodeFacts, MarkerReferent, ObjectKey, TaskFacts, ToolKind},
    preset::Preset,
    real_trainer::{TrainerEnd, TrainerState},
    score::{AppliedTerm, Scorer},
    terms::Base,
    trainer::{Categories, Graph, is_not_found, observation},
};

/// Texts in place of a task that the trainer knows as the end of the list.
const ENDS: [&str; 3] = [
    "All benchmark episodes completed",
    "All replay episodes completed",
    "All episodes completed",
];

/// What the text of the debug information begins with.
const DEBUG_INFO: &str = "Debug Info:\n";

/// One turn of the model and what came of it.
#[derive(Clone, Copy, Debug)]
pub enum Turn<'a> {
    /// The answer held no call.
    Unreadable,
    /// `finish`, which is not sent to the server.
    Finish,
    /// A call and the items of its result.
    Call {
        /// Name of the tool as the model sent it.
        tool: &'a str,
        /// Arguments of the call as the model sent them.
        arguments: &'a Value,
        /// Text and image items, as MCP has them.
        content: &'a [Value],
    },
    /// A call without an answer within the trainer's time.
    TimedOut,
    /// A call that failed for good.
    Failed,
}

/// What the trainer makes of a turn.
#[derive(Clone, PartialEq, Debug)]
pub struct TrainerStep {
    /// Reward of the step, all terms together.
    pub reward: f64,
    /// By term, in the order of the sum.
    pub terms: Vec<AppliedTerm>,
    /// What the model reads next of a call's result.
    pub observation: String,
}

/// Why the trainer starts no episode with an answer to `finish_with_id`.
#[derive(Clone, PartialEq, Eq, Debug, Error)]
#[non_exhaustive]
pub enum ResetError {
    /// No item is a text.
    #[error("the answer holds no text: send the task as the first text item")]
    NoText,
    /// The list of tasks is at its end.
    #[error("no task is left: {text}")]
    AllDone {
        /// The text as the server sent it.
        text: String,
    },
    /// The server does not know the task, so that the trainer tries another scene.
    #[error("the server does not have the task: {text}")]
    NotFound {
        /// The text as the server sent it.
        text: String,
    },
    /// The text is no payload.
    #[error("the text is not a task: {text}")]
    NoTask {
        /// The text as the server sent it.
        text: String,
    },
    /// The payload is of another task.
    #[error("asked for task '{asked}', got '{found}'")]
    OtherTask {
        /// The id that was asked for.
        asked: String,
        /// The id that the payload gives.
        found: String,
    },
    /// The payload has no start graph.
    #[error("the payload has no initial_world_graph")]
    NoGraph,
    /// Goal and start have the same objects in the same places, by category.
    #[error("the payload's goal equals its start: nothing would ever be paid")]
    NoTargets,
}

/// An episode under way.
#[derive(Debug)]
pub struct TrainerRollout {
    facts: TaskFacts,
    scorer: Scorer,
    /// The current step alone.
    moment: EpisodeFacts,
    /// The last graph that was sent, and the last one that was taken.
    shown: Graph,
    taken: Graph,
    held: Option<ObjectKey>,
    total: f64,
}

impl TrainerRollout {
    /// Reads the answer to `finish_with_id` for a task.
    ///
    /// # Errors
    /// If the trainer would start no episode with it.
    ///
    /// # Panics
    /// If the preset is not of base `real-trainer`: a programmer's error.
    pub fn reset(preset: &Preset, task_id: &str, content: &[Value]) -> Result<Self, ResetError> {
        assert!(
            preset.base() == Base::RealTrainer,
            "a rollout is paid by base real-trainer, not by {}",
            preset.base()
        );
        let text = content
            .iter()
            .find_map(|item| item["text"].as_str())
            .ok_or(ResetError::NoText)?;
        let payload = match serde_json::from_str::<Value>(text) {
            Ok(payload) if payload.is_object() => payload,
            _ if ENDS.iter().any(|end| text.contains(end)) => {
                return Err(ResetError::AllDone {
                    text: text.to_owned(),
                });
            }
            _ if is_not_found(text, None) => {
                return Err(ResetError::NotFound {
                    text: text.to_owned(),
                });
            }
            _ => {
                return Err(ResetError::NoTask {
                    text: text.to_owned(),
                });
            }
        };
        let found = payload["task_id"]
            .as_str()
            .map_or_else(|| payload["task_id"].to_string(), str::to_owned);
        if found != task_id {
            return Err(ResetError::OtherTask {
                asked: task_id.to_owned(),
                found,
            });
        }
        let given = |key: &str| {
            payload
                .get(key)
                .filter(|graph| graph.as_object().is_some_and(|graph| !graph.is_empty()))
        };
        let initial = Graph::of_json(given("initial_world_graph").ok_or(ResetError::NoGraph)?);
        let goal = given("goal_world_graph").or_else(|| given("target_world_graph"));
        let goal = goal.map(Graph::of_json).ok_or(ResetError::NoTargets)?;
        let category = payload["target_object"]["category"]
            .as_str()
            .unwrap_or_default();
        let mut facts =
            TaskFacts::for_trainer(Categories::of_payload(&payload), category, &initial, &goal);
        if facts.categories.goal.is_empty() {
            return Err(ResetError::NoTargets);
        }
        let (mut moment, mut scorer) = (EpisodeFacts::default(), Scorer::new(preset));
        facts.begin(&mut moment);
        scorer.start(&facts, &moment.start());
        Ok(Self {
            facts,
            scorer,
            moment,
            taken: initial.clone(),
            shown: initial,
            held: None,
            total: 0.0,
        })
    }

    /// Pays a turn; nothing once the episode is done.
    pub fn step(&mut self, turn: Turn<'_>) -> TrainerStep {
        self.moment.clear();
        let observation = match turn {
            Turn::Unreadable => self.without_call(Delivery::Unreadable),
            Turn::TimedOut => self.without_call(Delivery::TimedOut),
            Turn::Failed => self.without_call(Delivery::Failed),
            Turn::Finish => {
                let head = self.facts.head_of_call("finish", None, None);
                self.moment.step(head);
                String::new()
            }
            Turn::Call {
                tool,
                arguments,
                content,
            } => self.call(tool, arguments, content),
        };
        let mut terms = Vec::new();
        for moment in self.moment.steps() {
            self.scorer.step(&mut self.facts, &moment, &mut terms);
        }
        if self.state().refusal.is_none() {
            self.taken.clone_from(&self.shown);
        }
        let reward = terms.iter().map(|fired| fired.value).sum();
        self.total += reward;
        TrainerStep {
            reward,
            terms,
            observation,
        }
    }

    /// What was paid so far.
    pub fn total(&self) -> f64 {
        self.total
    }

    /// Why the episode is done; `None` if it goes on.
    pub fn ending(&self) -> Option<TrainerEnd> {
        self.scorer.ending()
    }

    /// What the trainer holds of the episode.
    pub fn state(&self) -> TrainerState {
        self.scorer
            .trainer_state(&self.facts)
            .expect("the preset is the trainer's")
    }

    /// How many targets the task has.
    pub fn target_count(&self) -> usize {
        self.facts.categories.goal.len()
    }

    fn without_call(&mut self, delivery: Delivery) -> String {
        self.moment.step(crate::StepHead {
            delivery,
            held: self.held,
            ..crate::StepHead::default()
        });
        String::new()
    }

    fn call(&mut self, tool: &str, arguments: &Value, content: &[Value]) -> String {
        let observation = observation(content);
        let debug = content
            .last()
            .and_then(|item| item["text"].as_str())
            .and_then(debug_information);
        if let Some(held) = debug.as_ref().and_then(|debug| debug.inventory.as_ref()) {
            self.held = held.as_deref().map(|held| self.facts.object(held));
        }
        // only texts are compared: a number equals none
        let of_key = |key: &str| {
            arguments.get(key).map(|value| {
                value
                    .as_str()
                    .map_or_else(|| format!("{value} (no text)"), str::to_owned)
            })
        };
        let argument = of_key("receptacle_name").or_else(|| of_key("marker_id"));
        let mut head = self.facts.head_of_call(tool, None, argument.as_deref());
        head.trainer_reading = self.facts.trainer_reading(&head, &observation);
        head.held = self.held;
        let marks = debug.as_ref().and_then(|debug| debug.markers.as_deref());
        let perceives = matches!(
            head.named,
            ToolKind::WalkAround | ToolKind::ShowObjectByCategory
        );
        let anti_exploit = self.scorer.preset().rules.anti_exploit;
        if anti_exploit
            && perceives
            && marks.is_some_and(|marks| marks.iter().any(|mark| !mark.is_text))
        {
            // as published: the anti-exploit terms compare markers as a set, and fail on objects
            head.delivery = Delivery::Failed;
        }
        self.moment.step(head);
        if let Some(marks) = marks {
            self.moment.set_markers();
            for Mark { number, name, .. } in marks {
                let is_receptacle = self
                    .shown
                    .0
                    .iter()
                    .any(|(receptacle, _)| receptacle == name);
                let marked = if is_receptacle {
                    MarkerReferent::Receptacle(self.facts.receptacle(name))
                } else {
                    MarkerReferent::Object(self.facts.object(name))
                };
                self.moment.mark(*number, marked);
            }
        }
        if let Some(sent) = debug.and_then(|debug| debug.graph) {
            let graph = match sent {
                SentGraph::Whole(graph) => graph,
                SentGraph::Lines(text) => {
                    let mut graph = self.taken.clone();
                    graph.overlay_text(&text);
                    graph
                }
            };
            self.show(graph);
        }
        observation
    }

    /// Tells the rules how the graph differs from the one that was sent before.
    fn show(&mut self, graph: Graph) {
        let sorted = |graph: &Graph| {
            let mut objects: Vec<(String, String)> = graph
                .objects()
                .map(|(name, place)| (name.to_owned(), place.to_owned()))
                .collect();
            objects.sort();
            objects
        };
        let (before, after) = (sorted(&self.shown), sorted(&graph));
        for (event, objects, others) in [("remove", &before, &after), ("add", &after, &before)] {
            let mut left = others.clone();
            for object in objects {
                if let Ok(at) = left.binary_search(object) {
                    left.remove(at);
                    continue;
                }
                if let Some(change) =
                    self.facts
                        .change(event, Some(&object.0), &object.1, None, None)
                {
                    self.moment.change(Authority::Registry, change);
                }
            }
        }
        self.shown = graph;
    }
}

/// What the last item of a result tells besides the observation.
struct DebugInformation {
    /// What is held, where this is told.
    inventory: Option<Option<String>>,
    /// The marker map, where this is told; empty for none.
    markers: Option<Vec<Mark>>,
    graph: Option<SentGraph>,
}

struct Mark {
    number: u32,
    name: String,
    /// Whether the map holds the name alone.
    is_text: bool,
}

enum SentGraph {
    Whole(Graph),
    /// Lines of the receptacles that hold something.
    Lines(String),
}

fn debug_information(text: &str) -> Option<DebugInformation> {
    let name = |value: &Value| value.as_str().map(str::to_owned);
    let Some(json) = text.strip_prefix(DEBUG_INFO) else {
        // the oldest servers send the graph alone, with the inventory as one more key
        let mut graph: Value = serde_json::from_str(text).ok()?;
        let held = graph.as_object_mut()?.shift_remove("robot_inv");
        let graph = Some(SentGraph::Whole(Graph::of_json(&graph)));
        return Some(DebugInformation {
            inventory: held.as_ref().map(name),
            markers: None,
            graph,
        });
    };
    let debug: Value = serde_json::from_str(json).ok()?;
    let whole = debug
        .get("world_graph")
        .filter(|graph| graph.is_object())
        .map(|graph| SentGraph::Whole(Graph::of_json(graph)));
    let lines = || name(&debug["WORLD_GRAPH"]).map(SentGraph::Lines);
    Some(DebugInformation {
        inventory: debug.get("CURRENT_INV").map(name),
        markers: debug.get("CURRENT_MARKER_MAP").map(marks),
        graph: whole.or_else(lines),
    })
}

/// A map from numbers to names, or to objects with a category or a name. Other keys
/// and values mark nothing.
fn marks(map: &Value) -> Vec<Mark> {
    let mark = |(number, value): (&String, &Value)| {
        let told = value
            .get("category")
            .or_else(|| value.get("name"))
            .unwrap_or(value);
        Some(Mark {
            number: number.parse().ok()?,
            name: told.as_str()?.to_owned(),
            is_text: value.is_string(),
        })
    };
    map.as_object()
        .into_iter()
        .flatten()
        .filter_map(mark)
        .collect()
}
