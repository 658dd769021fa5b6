//! The oracle: executes intents with the simulator's truth (paper, Algorithm "Oracle Trajectory
//! Generation for One Episode"). Never calls anything an agent could not call, and never waits for
//! what cannot come: every failure counts, and after a few it gives up and finishes.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::Arc,
};

use crate::plan::{Intent, PlanningState, calls, plan, published_plan};
use rand_chacha::ChaCha8Rng;
use reel_episode::{Privileged, user::clarifying_question};
use reel_world::{
    DoorState, ErrorCode, HORIZON, InstanceId, PlanStep, ReceptacleId, Task, Tool, WorldGraph,
    record::{MarkerTarget, PolicyInfo, StepInput},
};
use serde_json::Value;

use crate::{
    PerceivedItem, Policy, PolicyContext, ResponderError, narration::Narration, policy, random,
};

/// Failed calls after which it gives up: a replanned pick and place may each fail twice.
const FAILURES_MAX: u32 = 5;
/// Decisions kept free for surprises before detours of a published plan are left out.
const SLACK: u32 = 4;

/// What the oracle does well; a faulty policy lacks one of them.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct OracleOptions {
    /// Probes with `show_object_by_category` before the first search.
    pub probes_first: bool,
    /// Asks once when the instruction is underspecified.
    pub asks: bool,
    /// Knows that there are doors.
    pub minds_doors: bool,
    /// Plans again from the truth when a call fails.
    pub replans: bool,
}

impl Default for OracleOptions {
    fn default() -> Self {
        Self {
            probes_first: true,
            asks: true,
            minds_doors: true,
            replans: true,
        }
    }
}

/// Executes a task with the simulator's truth.
#[derive(Debug)]
pub struct Oracle {
    name: &'static str,
    seed: u64,
    /// The task as it believes it to be.
    task: Arc<Task>,
    habits: OracleOptions,
    rng: ChaCha8Rng,
    intents: VecDeque<Intent>,
    started: bool,
    /// Whether it comes in when something was done already.
    resumed: bool,
    search: Search,
    /// Whether its plan says itself when to ask; then it asks nothing else.
    plan_asks: bool,
    /// Whether it asks which object is meant, in words for what it sees.
    asks_which: bool,
    asked: bool,
    failures: u32,
    last: Option<Tool>,
    gave_up: Option<String>,
    narration: Narration,
}

/// How far the search for an object has come.
#[derive(Clone, PartialEq, Eq, Debug)]
enum Search {
    /// The search for the object has not begun.
    Begin,
    /// `show_object_by_category` was called, with or without success.
    Probed,
    /// `walk_around` shall be called.
    Walk,
    /// `walk_around` was called; the candidates, last one first, once they are known.
    Walked(Option<Vec<InstanceId>>),
    /// `gaze_at` was called on one candidate; these are left.
    Gazing(InstanceId, Vec<InstanceId>),
    /// The target was gazed at.
    Found,
}

impl Oracle {
    /// An oracle for a task. `seed` shuffles the candidates of a search.
    pub fn new(task: Arc<Task>, seed: u64) -> Self {
        Self::faulty("oracle", task, OracleOptions::default(), seed)
    }

    /// An oracle that takes a task for another one or lacks a habit.
    pub fn faulty(name: &'static str, task: Arc<Task>, habits: OracleOptions, seed: u64) -> Self {
        let task = if habits.minds_doors {
            task
        } else {
            Arc::new(without_doors(&task))
        };
        let mut asks = task
            .plan
            .iter()
            .filter(|step| step.action == "ask")
            .peekable();
        let plan_asks = asks.peek().is_some();
        let asks_which = habits.asks
            && task.fuzzy
            && (!plan_asks || asks.any(|step| !step.args.contains_key("question")));
        Self {
            name,
            seed,
            task,
            habits,
            rng: random::stream(seed, "candidates", 0),
            intents: VecDeque::new(),
            started: false,
            resumed: false,
            search: Search::Begin,
            plan_asks,
            asks_which,
            asked: false,
            failures: 0,
            last: None,
            gave_up: None,
            narration: Narration::default(),
        }
    }

    /// Follows these intents instead of a plan of its own.
    pub fn with_script(mut self, intents: Vec<Intent>) -> Self {
        self.intents = intents.into();
        self.started = true;
        self
    }

    /// Plans from the moment it comes in instead of following the published plan; `asked` where the
    /// user was asked already.
    pub(crate) fn resumed(mut self, asked: bool) -> Self {
        self.resumed = true;
        self.asked = asked;
        self
    }

    /// The next call, without a word.
    pub(crate) fn next_tool(&mut self, context: &PolicyContext<'_>) -> Tool {
        let tool = match context.truth {
            Some(truth) => self.decide(context, truth),
            None => Tool::Finish,
        };
        self.last = Some(tool.clone());
        tool
    }

    /// What it intends, the intent of the last call first.
    pub(crate) fn intents(&self) -> &VecDeque<Intent> {
        &self.intents
    }

    fn decide(&mut self, context: &PolicyContext<'_>, truth: &Privileged<'_>) -> Tool {
        if !self.started {
            self.started = true;
            self.start(truth);
        } else if self.last.is_some() {
            match context.observation.error {
                Some(code) => self.failed(code, truth),
                None => self.succeeded(),
            }
        }
        self.leave_out_detours(HORIZON.saturating_sub(context.step));
        // An intent that needs no call is dropped or replaced; a plan is far
        // shorter than this bound.
        for _ in 0..4 * HORIZON {
            let Some(intent) = self.intents.front().cloned() else {
                break;
            };
            if let Some(tool) = self.call_for(&intent, context, truth) {
                return tool;
            }
        }
        Tool::Finish
    }

    /// Takes the published plan if the goal can be reached at all, else gives up.
    fn start(&mut self, truth: &Privileged<'_>) {
        self.replan(truth, false);
        if self.gave_up.is_none()
            && !self.resumed
            && let Some(intents) = published_plan(&self.task)
        {
            self.intents = intents.into();
        }
    }

    fn succeeded(&mut self) {
        match self.last {
            Some(
                Tool::NavTo { .. } | Tool::Place { .. } | Tool::Open { .. } | Tool::Close { .. },
            ) => self.done(),
            Some(Tool::Pick { .. }) => self.done(),
            Some(Tool::ShowObjectByCategory { .. }) => self.search = Search::Probed,
            Some(Tool::WalkAround) => self.search = Search::Walked(None),
            Some(Tool::GazeAt { .. }) => self.gazed(),
            _ => {}
        }
    }

    fn failed(&mut self, code: ErrorCode, truth: &Privileged<'_>) {
        match self.last {
            // Nothing of the category in view: that is what `walk_around` is for.
            Some(Tool::ShowObjectByCategory { .. }) => self.search = Search::Probed,
            // It may be in reach all the same; if not, `pick` fails.
            Some(Tool::GazeAt { .. }) => self.gazed(),
            Some(Tool::Ask { .. }) => {}
            Some(Tool::Pick { .. }) if self.search == Search::Found && self.failures == 0 => {
                self.failures += 1;
                self.search_again();
            }
            Some(Tool::Place { .. }) if code == ErrorCode::NotASurface => {
                let place = self
                    .task
                    .goal
                    .receptacle_of(&self.task.target)
                    .map_or("the destination", ReceptacleId::as_str);
                self.give_up(format!("nothing can be placed on {place}"));
            }
            _ => self.try_again(&format!("the last error is {code}"), truth),
        }
    }

    fn call_for(
        &mut self,
        intent: &Intent,
        context: &PolicyContext<'_>,
        truth: &Privileged<'_>,
    ) -> Option<Tool> {
        match intent {
            Intent::NavTo(receptacle) => {
                return Some(Tool::NavTo {
                    receptacle: receptacle.clone(),
                });
            }
            Intent::Find { category, target } => {
                return self.look_for(category, target, context, truth);
            }
            Intent::Pick(target) if truth.held == Some(target) => self.done(),
            Intent::Pick(target) => match object_marker(truth, target) {
                Some(marker) => return Some(Tool::Pick { marker }),
                None => self.try_again("its number is gone", truth),
            },
            Intent::Place(receptacle) => {
                if self.last != Some(Tool::ShowReceptacles) {
                    return Some(Tool::ShowReceptacles);
                }
                match receptacle_marker(truth, receptacle) {
                    Some(marker) => return Some(Tool::Place { marker }),
                    None => self.try_again(
                        &format!("{receptacle} is not in view from its viewpoint"),
                        truth,
                    ),
                }
            }
            Intent::Open(receptacle) | Intent::Close(receptacle) => {
                let open = matches!(intent, Intent::Open(_));
                let wanted = if open {
                    DoorState::Open
                } else {
                    DoorState::Closed
                };
                if truth.graph.door(receptacle) == Some(wanted) {
                    self.done();
                } else if let Some(marker) = receptacle_marker(truth, receptacle) {
                    return Some(if open {
                        Tool::Open { marker }
                    } else {
                        Tool::Close { marker }
                    });
                } else if self.last != Some(Tool::ShowReceptacles) {
                    return Some(Tool::ShowReceptacles);
                } else {
                    self.try_again(
                        &format!("{receptacle} is not in view from its viewpoint"),
                        truth,
                    );
                }
            }
            Intent::Ask { question, .. } => {
                self.intents.pop_front();
                return match question {
                    Some(question) => self.habits.asks.then(|| Tool::Ask {
                        question: question.clone(),
                    }),
                    None => self.question(context),
                };
            }
            Intent::Finish if self.gave_up.is_some() || !self.habits.replans => {
                return Some(Tool::Finish);
            }
            Intent::Finish => {
                self.replan(truth, false);
                if self.intents.len() <= 1 {
                    return Some(Tool::Finish);
                }
                // Something rolled away after it was placed.
                self.count_failure("the goal does not hold after the last step");
            }
        }
        None
    }

    fn look_for(
        &mut self,
        category: &str,
        target: &InstanceId,
        context: &PolicyContext<'_>,
        truth: &Privileged<'_>,
    ) -> Option<Tool> {
        match std::mem::replace(&mut self.search, Search::Begin) {
            Search::Begin if self.habits.probes_first => {
                return Some(Tool::ShowObjectByCategory {
                    category: category.to_owned(),
                });
            }
            Search::Begin | Search::Walk => return Some(Tool::WalkAround),
            Search::Probed => {
                let marker = object_marker(truth, target);
                if marker.is_none()
                    || (self.wants_to_ask() && self.has_to_look_first(context, truth))
                {
                    return Some(Tool::WalkAround);
                }
                self.search = Search::Probed;
                if let Some(question) = self.question(context) {
                    return Some(question);
                }
                self.search = Search::Gazing(target.clone(), Vec::new());
                return marker.map(|marker| Tool::GazeAt { marker });
            }
            Search::Walked(candidates) => {
                if self.wants_to_ask() {
                    self.search = Search::Walked(candidates);
                    return self.question(context);
                }
                let mut left = match candidates {
                    Some(left) => left,
                    None => self.candidates(target, context, truth),
                };
                while let Some(candidate) = left.pop() {
                    if let Some(marker) = object_marker(truth, &candidate) {
                        self.search = Search::Gazing(candidate, left);
                        return Some(Tool::GazeAt { marker });
                    }
                }
                self.try_again("it is not among what was found there", truth);
            }
            Search::Gazing(..) | Search::Found => {
                self.search = Search::Found;
                self.intents.pop_front();
            }
        }
        None
    }

    /// Same-category objects with a number, in random order; only the target where time is short,
    /// and nothing where it is not among them.
    fn candidates(
        &mut self,
        target: &InstanceId,
        context: &PolicyContext<'_>,
        truth: &Privileged<'_>,
    ) -> Vec<InstanceId> {
        let category = |id: &InstanceId| self.task.object(id).map(|object| object.category.clone());
        let wanted = category(target);
        let objects = truth
            .markers
            .iter()
            .filter_map(|marker| match &marker.target {
                MarkerTarget::Object(object) => Some(object),
                MarkerTarget::Receptacle(_) => None,
            });
        let mut alike: Vec<InstanceId> = objects
            .filter(|id| category(id) == wanted)
            .cloned()
            .collect();
        let needed = calls(self.intents.make_contiguous()) + alike.len() as u32;
        // Who was just told which one is meant does not try the others.
        if context.step + needed > HORIZON
            || !alike.contains(target)
            || (self.plan_asks && self.asked)
        {
            alike.retain(|id| id == target);
        }
        random::shuffle(&mut self.rng, &mut alike);
        alike
    }

    fn gazed(&mut self) {
        if let Search::Gazing(object, left) = &self.search {
            let found = matches!(self.intents.front(), Some(Intent::Find { target, .. }) if target == object);
            self.search = if found {
                Search::Found
            } else {
                Search::Walked(Some(left.clone()))
            };
        }
    }

    fn wants_to_ask(&self) -> bool {
        self.asks_which && !self.asked
    }

    /// Who has seen only one thing has nothing to ask about. Where the plan wants the question, the
    /// answer shall settle it, and so everything has to be seen first.
    fn has_to_look_first(&self, context: &PolicyContext<'_>, truth: &Privileged<'_>) -> bool {
        let there = truth
            .landmark
            .map_or(0, |here| truth.graph.objects_on(here).len());
        objects_here(context, truth).count() < if self.plan_asks { there.max(2) } else { 2 }
    }

    /// The one question, in words for what was seen; none if it was asked or need not be.
    fn question(&mut self, context: &PolicyContext<'_>) -> Option<Tool> {
        if !self.wants_to_ask() {
            return None;
        }
        self.asked = true;
        Some(Tool::Ask {
            question: question(context.perceived, self.task.purpose.as_deref()),
        })
    }

    /// The intent in front is done.
    fn done(&mut self) {
        self.intents.pop_front();
        self.search = Search::Begin;
    }

    /// Looks for the object to pick once more, walking around.
    fn search_again(&mut self) {
        if let Some(Intent::Pick(target)) = self.intents.front().cloned() {
            let category = self
                .task
                .object(&target)
                .map_or("object", |object| &object.category)
                .to_owned();
            self.intents.push_front(Intent::Find { category, target });
            self.search = Search::Walk;
        }
    }

    fn try_again(&mut self, why: &str, truth: &Privileged<'_>) {
        self.replan(truth, true);
        self.count_failure(why);
    }

    fn count_failure(&mut self, why: &str) {
        self.failures += 1;
        if self.failures >= FAILURES_MAX && self.gave_up.is_none() {
            self.give_up(format!("{FAILURES_MAX} calls failed; {why}"));
        }
    }

    /// Plans from the truth; `anew` goes to the viewpoint again even if the robot stands there.
    fn replan(&mut self, truth: &Privileged<'_>, anew: bool) {
        self.search = Search::Begin;
        // What the plan wants to ask is asked, whatever else becomes of the plan.
        self.intents.retain(|intent| {
            matches!(
                intent,
                Intent::Ask {
                    question: Some(_),
                    ..
                }
            )
        });
        if !self.habits.replans {
            self.intents = [Intent::Finish].into();
            return;
        }
        let blind = (!self.habits.minds_doors).then(|| graph_without_doors(truth.graph));
        let situation = PlanningState {
            task: &self.task,
            scene: truth.scene,
            graph: blind.as_ref().unwrap_or(truth.graph),
            held: truth.held,
            at: truth.landmark.filter(|_| !anew),
        };
        match plan(&situation) {
            Ok(intents) => self.intents.extend(intents),
            Err(unreachable) => self.give_up(unreachable.to_string()),
        }
    }

    fn give_up(&mut self, why: String) {
        self.gave_up = Some(why);
        self.intents = [Intent::Finish].into();
    }

    /// A published plan also visits furniture that is only similar. Where time is
    /// short it does not.
    fn leave_out_detours(&mut self, decisions_left: u32) {
        if calls(self.intents.make_contiguous()) + SLACK > decisions_left {
            let next: Vec<Option<Intent>> = (1..=self.intents.len())
                .map(|index| self.intents.get(index).cloned())
                .collect();
            let mut next = next.into_iter();
            let is_visit = |intent: &Intent| matches!(intent, Intent::NavTo(_));
            self.intents.retain(|intent| {
                let follower = next.next().flatten();
                !(is_visit(intent) && follower.as_ref().is_some_and(is_visit))
            });
        }
    }
}

impl Policy for Oracle {
    fn info(&self) -> PolicyInfo {
        policy::info(self.name, self.seed)
    }

    fn needs_privileged(&self) -> bool {
        true
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        let tool = self.next_tool(context);
        let output = self
            .narration
            .narrate(&tool, &self.intents, context.observation);
        Ok(StepInput::with_policy_output(tool.to_call(), output))
    }

    /// It comes in when something was done already, and plans from what it finds.
    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.narration.watch(&input.call, context.observation);
        if let Ok(Tool::Ask { question }) = Tool::parse(&input.call) {
            let of_plan = |step: &PlanStep| {
                step.args.get("question").and_then(Value::as_str) == Some(&question)
            };
            self.asked |= !self.task.plan.iter().any(of_plan);
        }
        self.last = None;
        self.resumed = true;
        // Who cannot plan keeps to its script.
        self.started &= !self.habits.replans;
    }

    fn gave_up(&self) -> Option<String> {
        self.gave_up.clone()
    }
}

/// A question that names what was seen, in the words one sees it by.
pub(crate) fn question(seen: &[PerceivedItem], purpose: Option<&str>) -> String {
    let things = seen.iter().filter(|thing| !thing.furniture);
    clarifying_question(
        things.map(|thing| thing.caption.as_deref().unwrap_or(&thing.category)),
        purpose,
    )
}

fn objects_here<'a>(
    context: &'a PolicyContext<'_>,
    truth: &'a Privileged<'_>,
) -> impl Iterator<Item = &'a PerceivedItem> {
    context
        .perceived
        .iter()
        .filter(|thing| !thing.furniture && thing.receptacle_hint.as_ref() == truth.landmark)
}

fn object_marker(truth: &Privileged<'_>, object: &InstanceId) -> Option<u32> {
    let is_it = |target: &MarkerTarget| matches!(target, MarkerTarget::Object(id) if id == object);
    truth
        .markers
        .iter()
        .find(|marker| is_it(&marker.target))
        .map(|marker| marker.id)
}

fn receptacle_marker(truth: &Privileged<'_>, receptacle: &ReceptacleId) -> Option<u32> {
    let is_it =
        |target: &MarkerTarget| matches!(target, MarkerTarget::Receptacle(id) if id == receptacle);
    truth
        .markers
        .iter()
        .find(|marker| is_it(&marker.target))
        .map(|marker| marker.id)
}

/// The task for one who does not know that there are doors.
fn without_doors(task: &Task) -> Task {
    let mut task = task.clone();
    task.initial = graph_without_doors(&task.initial);
    task.goal = graph_without_doors(&task.goal);
    task.plan
        .retain(|step| step.action != "open" && step.action != "close");
    task
}

fn graph_without_doors(graph: &WorldGraph) -> WorldGraph {
    let mut receptacles: BTreeMap<_, _> = graph.receptacles.clone();
    receptacles.values_mut().for_each(|state| state.door = None);
    WorldGraph { receptacles }
}
