//! What is left to do at every moment of an episode: for a competent agent that knows what its
//! agent knew, and in truth. Never who is to blame.

use std::collections::{BTreeMap, BTreeSet};

use reel_agents::plan::Objection;
use reel_agents::{GoalHint, Planner, Policy, retrace};
use reel_trace::Trace;
use reel_world::{
    DoorState, FLOOR, HORIZON, InstanceId, ReceptacleId, Task, Tool, ToolCall, WorldGraph,
    record::{EndReason, StepRecord},
};
use serde::{Deserialize, Serialize};

/// The competent agent that an episode is measured against: a built-in policy.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum CompetentAgent {
    /// Knows which receptacles the words may mean, and the caption of a precisely described object.
    #[default]
    Planner,
    /// Knows the words: any furniture and any object of the kind that they name may be meant.
    PlannerWords,
}

impl CompetentAgent {
    /// Name of the policy that plays it.
    pub fn policy(self) -> &'static str {
        match self {
            Self::Planner => "planner",
            Self::PlannerWords => "planner-words",
        }
    }

    fn hints(self, trace: &Trace) -> Vec<GoalHint> {
        match self {
            Self::Planner => GoalHint::of_task(&trace.task),
            Self::PlannerWords => GoalHint::of_words(&trace.task, &trace.scene),
        }
    }
}

/// A moment of an episode: before a call, or after the last.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct DecisionPoint {
    /// Decisions after which a competent agent is sure to have succeeded, at worst; none where it
    /// cannot be sure of it.
    pub cost: Option<u32>,
    /// The same for one who knows besides which receptacles are meant: nothing falls
    /// by a lucky find.
    pub hindsight: Option<u32>,
    /// What is left to do in truth, wherever the robot stands and whatever is in view: calls by
    /// what has to be done with.
    pub work: BTreeMap<Item, u32>,
    /// Number of decisions that are left until the horizon.
    pub budget: u32,
    /// What the competent agent would do.
    pub advice: Tool,
    /// The question that would tell apart what fits then.
    pub question: Tool,
    /// What speaks against the call that came then.
    pub objection: Option<Objection>,
}

/// What has something left to be done with.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Item {
    /// An object that the goal moves.
    Wanted(InstanceId),
    /// Another one, that was taken.
    Taken(InstanceId),
    /// A door in the way.
    Door(ReceptacleId),
}

/// What one step cost. The costs are of what its agent knew, at worst, in decisions.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct StepCost {
    /// Index of the step in the episode, from 0.
    pub step: u32,
    /// Before it; none where success could not be had for sure within the decisions left. It may
    /// still come by luck.
    pub before: Option<u32>,
    /// Cost after the step; `None` on the same condition as for `before`.
    pub after: Option<u32>,
    /// Before it, for one who knows besides which receptacles are meant; what decides
    /// is told by this.
    pub hindsight: Option<u32>,
    /// Decisions it lost: how far the cost did not fall by one. None where success was out of
    /// reach before or after.
    pub regret: Option<u32>,
}

impl DecisionPoint {
    /// Whether success could still be had, if only by one who knows which receptacles are meant.
    pub fn is_winnable(&self) -> bool {
        [self.cost, self.hindsight]
            .iter()
            .flatten()
            .any(|cost| *cost <= self.budget)
    }

    /// The cost, where there is time for it.
    pub fn affordable(&self) -> Option<u32> {
        self.cost.filter(|cost| *cost <= self.budget)
    }
}

/// Whether an episode succeeded; none where nobody knows, or where it was broken off.
pub(crate) fn outcome(trace: &Trace) -> Option<bool> {
    let end = trace.end.as_ref()?;
    let success = end.success(&trace.task)?;
    (success || end.reason != EndReason::Aborted).then_some(success)
}

/// Every moment of an episode, one more than it has steps.
pub(crate) fn decision_points(trace: &Trace, agent: CompetentAgent) -> Vec<DecisionPoint> {
    let hints = agent.hints(trace);
    let mut knowing = Planner::new(hints.iter().map(GoalHint::in_hindsight).collect(), 0);
    let mut planner = Planner::new(hints, 0);
    let mut truth = Truth::new(trace);
    let mut failed: Option<ToolCall> = None;
    let mut moments = Vec::with_capacity(trace.steps.len() + 1);
    let ended = outcome(trace);
    retrace(
        &trace.task,
        &trace.scene,
        &trace.start,
        &trace.steps,
        |context, step| {
            let advice = planner.advice(context);
            let again = |step: &StepRecord| failed.as_ref() == Some(&step.input.call);
            let objection = step.and_then(|step| match again(step) {
                true => Some(Objection::Memory),
                false => planner.objection(context, &step.input.call),
            });
            failed = step
                .filter(|step| step.outcome.error.is_some())
                .map(|step| step.input.call.clone());
            let (cost, hindsight) = match (step, ended) {
                (None, Some(success)) => (success.then_some(0), success.then_some(0)),
                _ => (
                    planner.belief(context).cost_to_go(),
                    knowing.belief(context).cost_to_go(),
                ),
            };
            let budget = HORIZON.saturating_sub(context.step);
            moments.push(DecisionPoint {
                cost,
                hindsight,
                work: truth.work(),
                budget,
                advice,
                question: planner.question(context),
                objection,
            });
            if let Some(step) = step {
                planner.observe(context, &step.input);
                knowing.observe(context, &step.input);
                truth.follow(step);
            }
        },
    );
    moments
}

/// What every step cost.
pub(crate) fn step_costs(moments: &[DecisionPoint]) -> Vec<StepCost> {
    let cost = |(step, pair): (usize, &[DecisionPoint])| {
        let (before, after) = (pair[0].affordable(), pair[1].affordable());
        let regret = before
            .zip(after)
            .map(|(before, after)| (after + 1).saturating_sub(before));
        StepCost {
            step: step as u32,
            before,
            after,
            hindsight: pair[0].hindsight,
            regret,
        }
    };
    moments.windows(2).enumerate().map(cost).collect()
}

/// The truth of an episode, followed through its records.
struct Truth<'t> {
    task: &'t Task,
    by_registry: bool,
    graph: WorldGraph,
    held: Option<InstanceId>,
    /// What was in the hand at some time.
    taken: BTreeSet<InstanceId>,
}

/// Calls that bring a held thing to its place: `nav_to`, `show_receptacles`, `place`.
const BRING: u32 = 3;
/// Calls that take a thing: `nav_to`, a look, `gaze_at`, `pick`.
const TAKE: u32 = 4;
/// Calls that open a door: `nav_to`, `show_receptacles`, `open`.
const OPEN: u32 = 3;
/// What lies on the floor cannot be taken.
const OUT_OF_REACH: u32 = 1_000;

impl<'t> Truth<'t> {
    fn new(trace: &'t Trace) -> Self {
        let by_registry = trace.header.profile.is_published();
        let graphs = &trace.start.graphs;
        let graph = if by_registry {
            graphs.registry.clone()
        } else {
            graphs.physics.clone()
        };
        Self {
            task: &trace.task,
            by_registry,
            graph,
            held: None,
            taken: BTreeSet::new(),
        }
    }

    fn follow(&mut self, step: &StepRecord) {
        let changes = if self.by_registry {
            &step.changes.registry
        } else {
            &step.changes.physics
        };
        self.graph.apply(changes);
        self.held.clone_from(&step.held);
        self.taken.extend(step.held.clone());
    }

    /// What is left to do: everything that the goal moves, and what was taken, has to come to where
    /// the goal has it.
    fn work(&self) -> BTreeMap<Item, u32> {
        let mut work = BTreeMap::new();
        for object in &self.task.objects {
            let id = &object.instance;
            let wanted = self.task.goal.receptacle_of(id);
            let moved = wanted != self.task.initial.receptacle_of(id);
            let held = self.held.as_ref() == Some(id);
            let place = self.graph.receptacle_of(id);
            if !(moved || self.taken.contains(id)) || (place == wanted && !held) {
                continue;
            }
            let item = if moved {
                Item::Wanted(id.clone())
            } else {
                Item::Taken(id.clone())
            };
            let reachable = place.is_some_and(|place| place.as_str() != FLOOR);
            work.insert(
                item,
                if held {
                    BRING
                } else if reachable {
                    TAKE + BRING
                } else {
                    OUT_OF_REACH
                },
            );
            let closed = |id: &&ReceptacleId| self.graph.door(id) == Some(DoorState::Closed);
            let doors = place
                .filter(|_| !held)
                .into_iter()
                .chain(wanted)
                .filter(closed);
            work.extend(doors.map(|door| (Item::Door(door.clone()), OPEN)));
        }
        work
    }
}
