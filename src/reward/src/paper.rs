//! Preset `paper`: the reward of the paper's Detailed Reward Configuration, by the definitions of SPEC section 5.
//!
//! The physical graph scores. Where the definitions leave a corner, it is decided so:
//! - `Delta_task` is a set union: an aux element that is a goal change already (a door to be opened and left open) is not
//!   counted twice, and source and destination that are one receptacle give one visit.
//! - Matching reads the changes of the step, so an element that happens to hold before the first decision is never matched;
//!   the +2.0 looks at the state and can be had all the same. A task without goal changes has no +2.0.
//! - `achieved` means matched in an earlier step. Only elements of `Delta_goal` can be reversed at a cost: closing a door
//!   that only had to be opened on the way is free.
//! - The -2.0 goes by where physics says the placed object came to rest. The floor is a place but no receptacle. Putting a
//!   goal object back on its source is a reversal (-0.5) and a wrong receptacle (-2.0): both rules apply.
//! - In transit: the gripper holds the instance at the end of the step and it is in no place at all. Only an instance that
//!   has both a source and a destination in `Delta_goal`.
//! - Recovery: any wrong instance put back where it lay before its pick, then any goal instance picked, in this order.
//! - Ask: candidates were seen before the question, and equal assets count as one, since words cannot tell them apart. An
//!   `ask` that fails earns nothing and costs no budget.
//! - Time: the fourth decision is the first that costs.
//!
//! # A worked example
//! A red and a green apple stand on `table_1`; "Take an apple from the table and put it into the fridge" means the red one;
//! the door of `fridge_0` is closed. `Delta_goal = {-red@table_1, +red@fridge_0}`; `Delta_aux = {nav_to(table_1),
//! nav_to(fridge_0), (fridge_0, open)}`. So `|Delta_task| = 5`, and a match gives 1.5 (task) + 2.0/5 (prog) = 1.9. One
//! distractor of the category: `B_ask = 1`.
//!
//! | step | call | terms | sum |
//! |---|---|---|---|
//! | 0 | `nav_to` table_1 | 1.9 | 1.9 |
//! | 1 | `walk_around`: lists both | | 0 |
//! | 2 | `ask`: "the red one" | ask 1.0 | 1.0 |
//! | 3 | `nav_to` fridge_0 | 1.9, time -0.03 | 1.87 |
//! | 4 | `open` | 1.9, time -0.03 | 1.87 |
//! | 5 | `nav_to` table_1 again | time -0.03 | -0.03 |
//! | 6 | `pick` green | time -0.03 | -0.03 |
//! | 7 | `place` it back on table_1 | time -0.03 | -0.03 |
//! | 8 | `pick` red | 1.9, phys 0.3 + 0.5 + 1.0, time -0.03 | 3.67 |
//! | 9 | `nav_to` fridge_0 | time -0.03 | -0.03 |
//! | 10 | `place` on an unknown marker | safe -0.5, time -0.03 | -0.53 |
//! | 11 | `place` into fridge_0 | 1.9, task 2.0, time -0.03 | 3.87 |
//! | 12 | `finish` | time -0.03 | -0.03 |
//!
//! In all 13.5. The test `worked_example` takes these steps.

use std::collections::{BTreeMap, BTreeSet};

use reel_world::{
    DoorState, ErrorClass, FLOOR, GraphEvent, InstanceId, ReceptacleId, Scene, Task, WorldGraph,
    record::{RewardTerm, StartRecord, StepRecord},
};

use crate::{Rewarder, ambiguity::Ambiguity, goal::holding};

const MATCHED: f64 = 1.5;
const ALL_HOLD: f64 = 2.0;
const PROGRESS: f64 = 2.0;
const REVERSED: f64 = -0.5;
const WRONG_RECEPTACLE: f64 = -2.0;
const VALID_PICK: f64 = 0.3;
const IN_TRANSIT: f64 = 0.5;
const RECOVERY: f64 = 1.0;
const ASK: f64 = 1.0;
const TIME: f64 = -0.03;
const FREE_DECISIONS: u32 = 3;
const SEVERE: f64 = -0.5;
const MODERATE: f64 = -0.3;

/// The reward of the paper for one episode. The module's page has the corners and a worked example:
/// `src/reward/src/paper.rs`.
#[derive(Clone, Debug)]
pub struct Paper {
    task: Task,
    /// `Delta_goal`
    goal: Vec<GraphEvent>,
    /// `Delta_rem`
    remaining: Vec<Target>,
    /// `|Delta_task|`
    targets: usize,
    achieved: BTreeSet<GraphEvent>,
    graph: WorldGraph,
    decisions: u32,
    all_held: bool,
    valid_picks: BTreeSet<InstanceId>,
    transits: BTreeSet<InstanceId>,
    recovery: Recovery,
    ambiguity: Ambiguity,
}

/// An element of `Delta_task`.
#[derive(Clone, PartialEq, Eq, Debug)]
enum Target {
    /// Of `Delta_goal`.
    Goal(GraphEvent),
    /// First successful `nav_to`.
    Visit(ReceptacleId),
    /// `(receptacle, open)`
    Opening(ReceptacleId),
}

/// How far the recovery from a wrong pick is.
#[derive(Clone, Debug)]
enum Recovery {
    /// Wrong instances and where they lay before their pick.
    Open { origins: BTreeMap<InstanceId, ReceptacleId> },
    /// One of them was put back.
    PutBack { object: InstanceId },
    /// Rewarded.
    Done,
}

impl Paper {
    /// The rules for a task. The scene says which captions tell like receptacles apart.
    pub fn new(task: &Task, scene: &Scene) -> Self {
        let goal = task.goal_changes();
        let mut remaining: Vec<Target> = goal.iter().cloned().map(Target::Goal).collect();
        let places = if task.src == task.dest { vec![&task.src] } else { vec![&task.src, &task.dest] };
        remaining.extend(places.iter().map(|place| Target::Visit((*place).clone())));
        for place in places {
            let receptacle = place.clone();
            let opening = GraphEvent::Door { receptacle, from: DoorState::Closed, to: DoorState::Open };
            if task.initial.door(place) == Some(DoorState::Closed) && !goal.contains(&opening) {
                remaining.push(Target::Opening(place.clone()));
            }
        }
        Self {
            targets: remaining.len(),
            remaining,
            achieved: BTreeSet::new(),
            graph: task.initial.clone(),
            decisions: 0,
            all_held: false,
            valid_picks: BTreeSet::new(),
            transits: BTreeSet::new(),
            recovery: Recovery::Open { origins: BTreeMap::new() },
            ambiguity: Ambiguity::new(task, scene),
            task: task.clone(),
            goal,
        }
    }

    /// `rho`: the share of `Delta_task` that was matched.
    pub fn progress(&self) -> f64 {
        1.0 - self.remaining.len() as f64 / self.targets as f64
    }

    /// Takes in the state before the first decision.
    pub fn start(&mut self, start: &StartRecord) {
        self.graph = start.graphs.physics.clone();
        self.ambiguity.see(start.visible.iter().map(|seen| &seen.object));
    }

    /// The terms of the next step; those that are zero are left out.
    pub fn step(&mut self, step: &StepRecord) -> Vec<RewardTerm> {
        let mut terms = Vec::new();
        let progress_before = self.progress();
        self.reversals(step, &mut terms);
        let recovered = self.recover(step);
        self.graph.apply(&step.changes.physics);
        self.match_targets(step, &mut terms);
        terms.extend(term("prog", PROGRESS * (self.progress() - progress_before), "progress"));
        self.handling(step, recovered, &mut terms);
        self.ask(step, &mut terms);
        self.decisions += 1;
        if self.decisions > FREE_DECISIONS {
            terms.extend(term("time", TIME, format!("decision {}", self.decisions)));
        }
        if let Some(code) = step.outcome.error {
            let (value, class) = match code.class() {
                ErrorClass::Severe => (SEVERE, "severe"),
                ErrorClass::Moderate => (MODERATE, "moderate"),
            };
            terms.extend(term("safe", value, format!("{class} error {code}")));
        }
        let order =
            |term: &RewardTerm| ["task", "prog", "phys", "ask", "time", "safe"].iter().position(|name| term.component == *name);
        terms.sort_by_key(order);
        terms
    }

    /// -0.5 for each event that undoes an achieved goal change.
    fn reversals(&self, step: &StepRecord, terms: &mut Vec<RewardTerm>) {
        let reversed = step.changes.physics.iter().filter(|event| self.achieved.contains(&event.reverse()));
        terms.extend(reversed.flat_map(|event| term("phys", REVERSED, format!("reversed: {event}"))));
    }

    /// Follows wrong picks; true when this step completes a recovery. Reads the graph before the step.
    fn recover(&mut self, step: &StepRecord) -> bool {
        let picked = step.object.as_ref().filter(|_| succeeded(step, "pick"));
        match &mut self.recovery {
            Recovery::Open { origins } => {
                let back = step.changes.physics.iter().find_map(|event| match event {
                    GraphEvent::Add { object, receptacle } if origins.get(object) == Some(receptacle) => Some(object.clone()),
                    _ => None,
                });
                if let Some(object) = back {
                    self.recovery = Recovery::PutBack { object };
                } else if let Some(object) = picked
                    && !self.goal.iter().any(|event| event.object() == Some(object))
                    && let Some(origin) = self.graph.place_of(object)
                {
                    origins.insert(object.clone(), origin.clone());
                }
                false
            }
            Recovery::PutBack { .. } => picked.is_some_and(|object| moves_away(&self.goal, object)),
            Recovery::Done => false,
        }
    }

    /// +1.5 for each newly matched element, +2.0 the first time that all goal changes hold.
    fn match_targets(&mut self, step: &StepRecord, terms: &mut Vec<RewardTerm>) {
        let mut events: Vec<Target> = step.changes.physics.iter().cloned().map(Target::Goal).collect();
        let opened = step.changes.physics.iter().filter_map(|event| match event {
            GraphEvent::Door { receptacle, to: DoorState::Open, .. } => Some(Target::Opening(receptacle.clone())),
            _ => None,
        });
        events.extend(opened);
        if succeeded(step, "nav_to") {
            events.extend(step.receptacle.clone().map(Target::Visit));
        }
        for event in events {
            let Some(found) = self.remaining.iter().position(|target| *target == event) else { continue };
            self.remaining.remove(found);
            let reason = match event {
                Target::Goal(event) => {
                    let reason = format!("goal change {event}");
                    self.achieved.insert(event);
                    reason
                }
                Target::Visit(receptacle) => format!("first visit of {receptacle}"),
                Target::Opening(receptacle) => format!("opened {receptacle}"),
            };
            terms.extend(term("task", MATCHED, reason));
        }
        if !self.all_held && !self.goal.is_empty() && holding(&self.task, &self.goal, &self.graph) == self.goal.len() {
            self.all_held = true;
            terms.extend(term("task", ALL_HOLD, "all goal changes hold"));
        }
    }

    /// Picks, transit, recovery and wrong places. Reads the graph after the step.
    fn handling(&mut self, step: &StepRecord, recovered: bool, terms: &mut Vec<RewardTerm>) {
        if let Some(object) = step.object.as_ref().filter(|_| succeeded(step, "place")) {
            let wrong = step.changes.physics.iter().find(|event| self.is_wrong_place(event, object));
            terms.extend(wrong.and_then(|event| term("phys", WRONG_RECEPTACLE, format!("wrong receptacle: {event}"))));
        }
        if let Some(object) = step.object.as_ref().filter(|_| succeeded(step, "pick"))
            && moves_away(&self.goal, object)
            && self.valid_picks.insert(object.clone())
        {
            terms.extend(term("phys", VALID_PICK, format!("valid pick of {object}")));
        }
        if let Some(object) = &step.held
            && moves_away(&self.goal, object)
            && destination(&self.goal, object).is_some()
            && self.graph.place_of(object).is_none()
            && self.transits.insert(object.clone())
        {
            terms.extend(term("phys", IN_TRANSIT, format!("{object} in transit")));
        }
        if recovered && let Recovery::PutBack { object } = std::mem::replace(&mut self.recovery, Recovery::Done) {
            terms.extend(term("phys", RECOVERY, format!("recovery: {object} was put back")));
        }
    }

    fn is_wrong_place(&self, event: &GraphEvent, placed: &InstanceId) -> bool {
        let GraphEvent::Add { object, receptacle } = event else { return false };
        object == placed
            && receptacle.as_str() != FLOOR
            && destination(&self.goal, object).is_some()
            && !self.goal.contains(event)
    }

    /// +1.0 for a question while it is needed and the budget lasts.
    fn ask(&mut self, step: &StepRecord, terms: &mut Vec<RewardTerm>) {
        if succeeded(step, "ask") {
            let reply = step.reply.as_ref().map_or("", |reply| reply.text.as_str());
            if let Some(among) = self.ambiguity.ask(reply) {
                terms.extend(term("ask", ASK, format!("asked among {among} candidates")));
            }
        }
        self.ambiguity.see(step.visible.iter().map(|seen| &seen.object).chain(&step.listed));
    }
}

impl Rewarder for Paper {
    fn start(&mut self, start: &StartRecord) {
        Paper::start(self, start);
    }

    fn step(&mut self, step: &StepRecord) -> Vec<RewardTerm> {
        Paper::step(self, step)
    }
}

fn term(component: &str, value: f64, reason: impl Into<String>) -> Option<RewardTerm> {
    (value != 0.0).then(|| RewardTerm { component: component.to_owned(), value, reason: reason.into() })
}

fn succeeded(step: &StepRecord, tool: &str) -> bool {
    step.outcome.is_ok() && step.tool.as_deref() == Some(tool)
}

/// Whether the goal takes the object away from somewhere.
fn moves_away(goal: &[GraphEvent], object: &InstanceId) -> bool {
    goal.iter().any(|event| matches!(event, GraphEvent::Remove { object: moved, .. } if moved == object))
}

/// Where the goal wants the object, if it moves it.
fn destination<'a>(goal: &'a [GraphEvent], object: &InstanceId) -> Option<&'a ReceptacleId> {
    goal.iter().find_map(|event| match event {
        GraphEvent::Add { object: moved, receptacle } if moved == object => Some(receptacle),
        _ => None,
    })
}
