//! Which steps could bring nothing new, and how far the goal is met: followed through the records
//! of an episode. Never judges: a step that repeats another may still be needed.

use std::collections::{BTreeMap, BTreeSet};

use reel_trace::Trace;
use reel_world::{
    ErrorCode, InstanceId, ReceptacleId, WorldGraph, canonical_json, record::StepRecord,
};

/// What is followed from step to step.
pub(crate) struct Revisits<'t> {
    by_registry: bool,
    graph: WorldGraph,
    /// Receptacle at which the robot stands.
    at: Option<&'t ReceptacleId>,
    held: Option<&'t InstanceId>,
    replies: BTreeSet<&'t str>,
    /// States of the world so far, and for each the calls made in it.
    states: Vec<(State<'t>, BTreeSet<Call<'t>>)>,
    goal: BTreeMap<&'t InstanceId, &'t ReceptacleId>,
}

/// All that a call may find otherwise than before.
type State<'t> = (WorldGraph, Option<&'t InstanceId>, usize);

/// A call by what it acts on, where it was made, and how it ended.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Call<'t> {
    tool: &'t str,
    at: Option<&'t ReceptacleId>,
    object: String,
    error: Option<ErrorCode>,
}

impl<'t> Revisits<'t> {
    pub(crate) fn new(trace: &'t Trace) -> Self {
        let by_registry = trace.header.profile.is_published();
        let graphs = &trace.start.graphs;
        let graph = match by_registry {
            true => graphs.registry.clone(),
            false => graphs.physics.clone(),
        };
        let goal = trace.task.goal_objects().filter_map(|object| {
            let to = trace.task.goal.receptacle_of(&object.instance)?;
            Some((&object.instance, to))
        });
        Self {
            by_registry,
            graph,
            at: None,
            held: None,
            replies: BTreeSet::new(),
            states: Vec::new(),
            goal: goal.collect(),
        }
    }

    /// Takes in a step. It is repeated if the same call was made before in the same state of the world,
    /// from the same receptacle and with the same error, if any. A question
    /// is repeated if its answer was given already.
    pub(crate) fn follow(&mut self, step: &'t StepRecord) -> bool {
        let tool = step.tool_name();
        let target = match (&step.object, &step.receptacle, &step.reply) {
            (_, _, Some(reply)) if tool == "ask" => reply.text.clone(),
            (Some(object), _, _) => object.to_string(),
            (None, Some(receptacle), _) => receptacle.to_string(),
            (None, None, _) => canonical_json(&step.input.call.arguments),
        };
        let call = Call {
            tool,
            // A drive leads to the same place from anywhere, and a question to the same answer.
            at: self.at.filter(|_| !matches!(tool, "nav_to" | "ask")),
            object: target,
            error: step.outcome.error,
        };
        let state = (self.graph.clone(), self.held, self.replies.len());
        let known = self.states.iter().position(|(known, _)| *known == state);
        let index = known.unwrap_or_else(|| {
            self.states.push((state, BTreeSet::new()));
            self.states.len() - 1
        });
        let answered = step
            .reply
            .as_ref()
            .is_some_and(|reply| self.replies.contains(reply.text.as_str()));
        let repeated = !self.states[index].1.insert(call) || answered;
        self.graph.apply(match self.by_registry {
            true => &step.changes.registry,
            false => &step.changes.physics,
        });
        self.held = step.held.as_ref();
        self.replies
            .extend(step.reply.iter().map(|reply| reply.text.as_str()));
        if tool == "nav_to" && step.outcome.error.is_none() {
            self.at = step.receptacle.as_ref().or(self.at);
        }
        repeated
    }

    /// How many of the objects that the goal moves stand where it wants them now, and how many do
    /// not.
    pub(crate) fn goals(&self) -> (usize, usize) {
        let met = |(object, to): &(&&InstanceId, &&ReceptacleId)| {
            self.held != Some(**object) && self.graph.receptacle_of(object) == Some(**to)
        };
        let met = self.goal.iter().filter(met).count();
        (met, self.goal.len() - met)
    }
}
