//! Why a perturbed episode failed, by counterfactual play alone: the operators that are switched
//! off one by one with all other random choices kept, and the oracle that takes over at every call.
//!
//! What counts as truth:
//! - A *cause* is an operator without which the episode succeeds. Where there is none because
//!   several operators would each have sufficed, every operator that fails on its own is one. The
//!   *primary* cause is the one that began first; the readings of the others are fair, too.
//! - The *harm* is `world` if an object or a door is wrong at the end that was not so at the start
//!   (the target in the hand is no such object), else `ending` if the policy finished, else `time`.
//! - The *strict* decisive call is, for `world`, the first successful pick, place, open or close of
//!   the cause that brought the oracle no nearer, and after which it never again was as near as it
//!   had been at best; where there is none (the oracle itself would have put the thing down there on
//!   its way), the change that left the thing as it is at the end. For `ending` it is the finish, for
//!   `time` the onset of the primary cause.
//! - *Fair* are besides, of every cause: its onset; the first call from there on that brought the
//!   oracle no nearer (an operator may begin with what was due anyway); of one that repeats calls or
//!   places, those of its first round, with the first repetition. Where the harm is `world` and the
//!   decisive call picks the target itself, the call that places it; where the harm is `ending`, a
//!   change of the world by the same measure as for `world` (who took the target up again and
//!   finished); and, where the harm is `time`, the last call from which the oracle still succeeded.
//!
//! Never blame or a rule of the taxonomy: this judges them.

use std::{collections::BTreeSet, ops::Range};

use reel_agents::{
    AgentError, EpisodeReport, Policy, RecordTo, RunningEpisode,
    perturb::{OperatorEvent, OperatorFamily, OperatorKind, Perturbation, Perturbed, Reading},
};
use reel_episode::EpisodeConfig;
use reel_replay::Fork;
use reel_trace::Trace;
use reel_world::{
    InstanceId, ObjectInstance, ReceptacleId, Skills, WorldGraph,
    record::{EndReason, StepRecord},
};
use serde::{Deserialize, Serialize};

use crate::branch::{Branch, BranchError};

/// What kind of harm a failure ended in.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HarmKind {
    /// An object or a door was left wrong.
    World,
    /// The policy finished before the goal held.
    Ending,
    /// The decisions ran out.
    Time,
}

impl HarmKind {
    /// All three kinds, in the order of declaration.
    pub const ALL: [HarmKind; 3] = [HarmKind::World, HarmKind::Ending, HarmKind::Time];

    /// Its name, as in `truth.json`.
    pub const fn name(self) -> &'static str {
        match self {
            HarmKind::World => "world",
            HarmKind::Ending => "ending",
            HarmKind::Time => "time",
        }
    }
}

/// A class and a sub-class, by name.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
pub struct Label {
    /// Class of the paper's taxonomy.
    pub class: String,
    /// Sub-class; `*` is any of the class.
    pub sub_class: String,
}

impl Label {
    /// The label of a reading.
    pub fn of((class, sub_class): Reading) -> Self {
        Self {
            class: class.as_str().to_owned(),
            sub_class: sub_class.to_owned(),
        }
    }
}

/// Why one episode failed.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Failure {
    /// The one label that counts as right under the strict reading.
    pub label: Label,
    /// Labels that a competent reader could defend, the strict one left out.
    pub fair: Vec<Label>,
    /// What kind of harm it ended in.
    pub harm: HarmKind,
    /// The decisive call; none where counterfactual play names none.
    pub decisive: Option<u32>,
    /// All calls that may fairly be called decisive, the strict one among them.
    pub fair_decisive: BTreeSet<u32>,
    /// Operators without which it succeeds, or that each suffice, by when they began.
    pub causes: Vec<usize>,
    /// Operators that acted and are no cause.
    pub contributing: Vec<usize>,
    /// The last call from which the oracle still succeeded.
    pub last_chance: Option<u32>,
}

/// The truth of one perturbed episode.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct EpisodeTruth {
    /// Id of the episode.
    pub episode_id: String,
    /// The base play and the operators that perturbed it.
    pub perturbation: Perturbation,
    /// When each operator began.
    pub events: Vec<OperatorEvent>,
    /// Whether it succeeded all the same.
    pub success: bool,
    /// Why it failed; none for a success, and where no set of operators explains it.
    pub failure: Option<Failure>,
}

/// Plays a perturbed episode, records it and finds out why it failed. `None` if competent play
/// fails there, too, so that no operator is to blame.
///
/// # Errors
/// When an episode cannot be played or its trace cannot be written or read.
pub fn play_perturbed(
    config: &EpisodeConfig,
    perturbation: &Perturbation,
    record: &RecordTo,
) -> Result<Option<EpisodeTruth>, BranchError> {
    let mut policy = Perturbed::new(&config.task, &config.scene, perturbation);
    let played = EpisodeConfig {
        skills: skills(perturbation),
        ..config.clone()
    };
    let report = run(played, &mut policy, Some(record))?;
    let trace = Trace::read(&record.path).map_err(|error| BranchError::Unreadable {
        path: record.path.clone(),
        error: error.to_string(),
    })?;
    let truth = EpisodeTruth {
        episode_id: report.episode_id.clone(),
        perturbation: perturbation.clone(),
        events: policy.events(),
        success: report.success,
        failure: None,
    };
    if report.success {
        return Ok(Some(truth));
    }
    let replay = |perturbation: &Perturbation| succeeds(config, &trace, perturbation);
    if !replay(&perturbation.keeping(|_| false))? {
        return Ok(None);
    }
    let acted: Vec<usize> = truth
        .events
        .iter()
        .filter(|event| event.onset.is_some())
        .map(|event| event.operator)
        .collect();
    let mut causes = Vec::new();
    for index in &acted {
        if replay(&perturbation.keeping(|other| other != *index))? {
            causes.push(*index);
        }
    }
    if causes.is_empty() {
        for index in &acted {
            if !replay(&perturbation.keeping(|other| other == *index))? {
                causes.push(*index);
            }
        }
    }
    causes.sort_by_key(|index| truth.events[*index].onset);
    let Some(primary) = causes.first().copied() else {
        return Ok(Some(truth));
    };
    let failure = failure(&trace, &policy, &truth, primary, causes, &acted)?;
    Ok(Some(EpisodeTruth {
        failure: Some(failure),
        ..truth
    }))
}

fn failure(
    trace: &Trace,
    policy: &Perturbed,
    truth: &EpisodeTruth,
    primary: usize,
    causes: Vec<usize>,
    acted: &[usize],
) -> Result<Failure, BranchError> {
    let operators = &truth.perturbation.operators;
    let onset = truth.events[primary].onset.unwrap_or_default();
    let label = named(policy, primary, trace);
    let mut fair: BTreeSet<Label> = BTreeSet::new();
    for index in &causes {
        fair.insert(named(policy, *index, trace));
        fair.extend(operators[*index].kind.fair().iter().copied().map(Label::of));
    }
    fair.remove(&label);
    let harm = harm(trace);
    let costs = takeovers(trace)?;
    let last_chance = costs
        .iter()
        .rposition(Option::is_some)
        .map(|call| call as u32);
    let last = trace.steps.len().saturating_sub(1) as u32;
    let damage = damage(trace, &costs, onset);
    let (decisive, other) = match harm {
        HarmKind::World => {
            let decisive = damage.or_else(|| last_change_of_wrong(trace));
            let placing = decisive.and_then(|call| placing_of_target(trace, call));
            (decisive, placing)
        }
        HarmKind::Ending => (Some(last), damage),
        HarmKind::Time => (Some(onset), last_chance),
    };
    let of_causes = causes.iter().flat_map(|cause| {
        let onset = truth.events[*cause].onset;
        let loss = onset.and_then(|onset| first_loss(&costs, onset));
        let round = first_round(trace, policy, *cause);
        [onset, loss].into_iter().flatten().chain(round)
    });
    let fair_decisive = [decisive, other].into_iter().flatten().chain(of_causes);
    let fair_decisive = fair_decisive.collect();
    Ok(Failure {
        label,
        fair: fair.into_iter().collect(),
        harm,
        decisive,
        fair_decisive,
        contributing: acted
            .iter()
            .copied()
            .filter(|index| !causes.contains(index))
            .collect(),
        causes,
        last_chance,
    })
}

/// The label of a cause: a wrong number that took another object is named by that object.
fn named(policy: &Perturbed, index: usize, trace: &Trace) -> Label {
    let (class, sub_class) = policy.reading(index);
    let kind = policy_kind(policy, index);
    let by_number = matches!(kind, OperatorKind::StaleNumber | OperatorKind::RandomNumber);
    let taken = trace
        .steps
        .iter()
        .filter(|step| by_number && is_change(step, "pick"))
        .find_map(|step| {
            let object = trace.task.object(step.object.as_ref()?)?;
            (object.instance != trace.task.target).then_some(object)
        });
    match taken {
        Some(object) => Label::of(reel_agents::perturb::look_alike(&trace.task, object)),
        None => Label::of((class, sub_class)),
    }
}

fn policy_kind(policy: &Perturbed, index: usize) -> OperatorKind {
    policy.perturbation().operators[index].kind
}

fn is_change(step: &StepRecord, tool: &str) -> bool {
    step.outcome.error.is_none() && step.tool.as_deref() == Some(tool)
}

/// What kind of harm the episode ended in.
fn harm(trace: &Trace) -> HarmKind {
    let Some(end) = &trace.end else {
        return HarmKind::Time;
    };
    let (objects, doors) = left_wrong(trace, &end.graphs.physics);
    if !objects.is_empty() || !doors.is_empty() {
        HarmKind::World
    } else if end.reason == EndReason::Finished {
        HarmKind::Ending
    } else {
        HarmKind::Time
    }
}

/// The objects and the doors that are wrong at the end and were not so at the start.
fn left_wrong<'t>(
    trace: &'t Trace,
    graph: &WorldGraph,
) -> (Vec<&'t InstanceId>, Vec<&'t ReceptacleId>) {
    let (task, start) = (&trace.task, &trace.start.graphs.physics);
    let is_wrong = |object: &&ObjectInstance| {
        let now = graph.receptacle_of(&object.instance);
        let right = [
            start.receptacle_of(&object.instance),
            task.goal.receptacle_of(&object.instance),
        ];
        let in_hand = now.is_none() && object.instance == task.target;
        !in_hand && !right.contains(&now)
    };
    // Put back where it was counts as placed wrongly, as it was moved.
    let put_back = trace.steps.iter().any(|step| is_change(step, "place"))
        && graph.receptacle_of(&task.target) == start.receptacle_of(&task.target);
    let objects = task.objects.iter().filter(is_wrong);
    let objects = objects
        .map(|object| &object.instance)
        .chain(put_back.then_some(&task.target));
    // A door that the goal does not move may stay open: success does not need it closed.
    let moved = |id: &&ReceptacleId| task.goal.door(id) != task.initial.door(id);
    let doors = start.receptacles.keys().filter(moved);
    let doors = doors.filter(|id| graph.door(id) != task.goal.door(id));
    (objects.collect(), doors.collect())
}

/// The last change of what is wrong at the end.
fn last_change_of_wrong(trace: &Trace) -> Option<u32> {
    let (objects, doors) = left_wrong(trace, &trace.end.as_ref()?.graphs.physics);
    let mut graph = trace.start.graphs.physics.clone();
    let state = |graph: &WorldGraph| {
        let places = objects.iter().map(|id| graph.receptacle_of(id).cloned());
        let doors = doors.iter().map(|id| graph.door(id));
        (places.collect::<Vec<_>>(), doors.collect::<Vec<_>>())
    };
    let mut last = None;
    for step in &trace.steps {
        let before = state(&graph);
        graph.apply(&step.changes.physics);
        if state(&graph) != before {
            last = Some(step.step);
        }
    }
    last
}

/// By call: how many calls the oracle needs that takes over there; none where it fails.
fn takeovers(trace: &Trace) -> Result<Vec<Option<u32>>, BranchError> {
    let forks = Fork::at_every_call(trace).map_err(|verdict| BranchError::Parent {
        path: trace.path.clone(),
        call: 0,
        verdict: Box::new(verdict),
    })?;
    let play = |fork: &Fork<'_>| {
        let report = Branch::policy("oracle", trace.header.seed).play(fork, None)?;
        Ok(report
            .success
            .then(|| report.length.saturating_sub(fork.call() as u32)))
    };
    forks.iter().map(play).collect()
}

/// The first call from the onset on after which the oracle needs no fewer calls than before it.
fn first_loss(costs: &[Option<u32>], onset: u32) -> Option<u32> {
    let needs = |call: usize| costs.get(call).copied().flatten().unwrap_or(u32::MAX);
    (onset as usize..costs.len())
        .find(|call| needs(call + 1) >= needs(*call))
        .map(|call| call as u32)
}

/// The calls of an operator that repeats calls or places, up to the first with which it repeats
/// itself: where in its first round it goes wrong is a matter of taste.
fn first_round(trace: &Trace, policy: &Perturbed, operator: usize) -> Vec<u32> {
    let repeats = [OperatorFamily::Repetition, OperatorFamily::Wandering];
    if !repeats.contains(&policy_kind(policy, operator).family()) {
        return Vec::new();
    }
    let (mut made, mut round) = (BTreeSet::new(), Vec::new());
    let steps = trace.steps.iter().zip(policy.made_by());
    for (step, _) in steps.filter(|(_, by)| **by == Some(operator)) {
        round.push(step.step);
        if !made.insert(step.input.call.to_string()) {
            return round;
        }
    }
    Vec::new()
}

/// Where a call picks the target, the next one that places it.
fn placing_of_target(trace: &Trace, call: u32) -> Option<u32> {
    let is_target = |step: &&StepRecord| step.object.as_ref() == Some(&trace.task.target);
    let from = |call: u32| trace.steps.iter().skip(call as usize);
    from(call)
        .next()
        .filter(|step| is_change(step, "pick"))
        .filter(is_target)?;
    let placing = from(call).find(|step| is_change(step, "place"))?;
    Some(placing.step)
}

/// The first change of the world from the onset on that brought the oracle no nearer, and was never
/// made good: what led up to it (a look at the wrong object) may have cost something, too.
fn damage(trace: &Trace, costs: &[Option<u32>], onset: u32) -> Option<u32> {
    let needs = |call: usize| costs.get(call).copied().flatten().unwrap_or(u32::MAX);
    let least = |calls: Range<usize>| calls.map(needs).min().unwrap_or(u32::MAX);
    let changes = ["pick", "place", "open", "close"];
    let mut found = trace.steps.iter().filter(|step| step.step >= onset);
    let step = found.find(|step| {
        let call = step.step as usize;
        changes.iter().any(|tool| is_change(step, tool))
            && needs(call + 1) >= needs(call)
            && least(call + 1..costs.len()) >= least(0..call + 1)
    });
    step.map(|step| step.step)
}

fn skills(perturbation: &Perturbation) -> Skills {
    if perturbation.has_flaky_skills() {
        Skills::RealV1
    } else {
        Skills::Perfect
    }
}

/// Whether the episode succeeds with another perturbation and the same seed.
fn succeeds(
    config: &EpisodeConfig,
    trace: &Trace,
    perturbation: &Perturbation,
) -> Result<bool, BranchError> {
    let skills = skills(perturbation);
    let mut policy = Perturbed::new(&config.task, &config.scene, perturbation);
    if skills != trace.header.skills {
        let config = EpisodeConfig {
            skills,
            ..config.clone()
        };
        return Ok(run(config, &mut policy, None)?.success);
    }
    let fork = crate::branch::fork(trace, 0, None)?;
    let episode = fork
        .open(policy.info(), reel_sim::render::Detail::Geometry)
        .map_err(|verdict| BranchError::Parent {
            path: trace.path.clone(),
            call: 0,
            verdict: Box::new(verdict),
        })?;
    let mut running = RunningEpisode::resume(episode, None, |_| None, None)?;
    running.play(&mut policy)?;
    Ok(running.end(None)?.success)
}

fn run(
    config: EpisodeConfig,
    policy: &mut Perturbed,
    record: Option<&RecordTo>,
) -> Result<EpisodeReport, AgentError> {
    reel_agents::run_episode(config, policy, reel_agents::Responders::default(), record)
}
