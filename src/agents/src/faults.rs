//! Policies with one fault each, built on the oracle: it executes a mistaken task, lacks a habit,
//! or is interrupted. What they do is wrong on purpose; it is never an error of ours.

use std::{collections::BTreeSet, sync::Arc};

use crate::plan::Intent;
use rand_chacha::ChaCha8Rng;
use reel_episode::Observation;
use reel_world::{
    AssetId, ObjectInstance, ReceptacleId, Scene, Task, Tool, ToolCall,
    record::{MarkerTarget, PolicyInfo, StepInput},
};
use serde_json::{Value, json};

use crate::{
    Policy, PolicyContext, ResponderError,
    oracle::{Oracle, OracleOptions},
    policy, random,
};

/// Takes a similar object for the target: one of the same category or purpose, else any other on
/// the source; where there is none it goes to the destination with empty hands.
pub fn wrong_object(task: &Arc<Task>, seed: u64) -> Oracle {
    let mut rng = random::stream(seed, "wrong-object", 0);
    let dest = task.goal.receptacle_of(&task.target);
    let others: Vec<&ObjectInstance> = task
        .objects
        .iter()
        .filter(|object| {
            object.instance != task.target
                && Some(&object.receptacle) != dest
                && !task.moves(object)
        })
        .collect();
    let similar = |object: &&&ObjectInstance| is_similar(task, object);
    let on_source =
        |object: &&&ObjectInstance| object.receptacle == task.target_object().receptacle;
    let tiers: [Vec<&ObjectInstance>; 3] = [
        others
            .iter()
            .filter(similar)
            .filter(on_source)
            .copied()
            .collect(),
        others.iter().filter(similar).copied().collect(),
        others.iter().filter(on_source).copied().collect(),
    ];
    match tiers.iter().find_map(|tier| random::choose(&mut rng, tier)) {
        Some(object) => Oracle::faulty(
            "wrong-object",
            Arc::new(mistaken_task(task, Some(object), None)),
            OracleOptions::default(),
            seed,
        ),
        None => {
            let script = vec![
                Intent::NavTo(task.src.clone()),
                Intent::NavTo(task.dest.clone()),
                Intent::Place(task.dest.clone()),
                Intent::Finish,
            ];
            Oracle::faulty(
                "wrong-object",
                task.clone(),
                OracleOptions {
                    replans: false,
                    ..OracleOptions::default()
                },
                seed,
            )
            .with_script(script)
        }
    }
}

/// Takes a similar receptacle for the destination: a distractor, else one of the same
/// category, else any other.
pub fn wrong_receptacle(task: &Arc<Task>, scene: &Scene, seed: u64) -> Oracle {
    let mut rng = random::stream(seed, "wrong-receptacle", 0);
    let start = &task.target_object().receptacle;
    let right = task.goal.receptacle_of(&task.target).unwrap_or(&task.dest);
    let category = scene
        .receptacle(right)
        .map(|receptacle| &receptacle.category);
    let others: Vec<_> = scene
        .receptacles
        .iter()
        .filter(|other| other.placeable && other.id != *right && other.id != *start)
        .collect();
    let tiers: [Vec<&ReceptacleId>; 3] = [
        others
            .iter()
            .map(|other| &other.id)
            .filter(|id| task.dest_distractors.contains(id))
            .collect(),
        others
            .iter()
            .filter(|other| Some(&other.category) == category)
            .map(|other| &other.id)
            .collect(),
        others.iter().map(|other| &other.id).collect(),
    ];
    let wrong = tiers
        .iter()
        .find_map(|tier| random::choose(&mut rng, tier))
        .copied();
    Oracle::faulty(
        "wrong-receptacle",
        Arc::new(mistaken_task(task, None, wrong)),
        OracleOptions::default(),
        seed,
    )
}

/// Never asks: in a fuzzy task it takes any object that fits the instruction. In the others it does
/// not probe before it searches.
pub fn no_ask(task: &Arc<Task>, seed: u64) -> Oracle {
    let habits = OracleOptions {
        asks: false,
        probes_first: task.fuzzy,
        ..OracleOptions::default()
    };
    if !task.fuzzy {
        return Oracle::faulty("no-ask", task.clone(), habits, seed);
    }
    let here = &task.target_object().receptacle;
    let fits = |object: &&ObjectInstance| {
        object.receptacle == *here && (object.instance == task.target || is_similar(task, object))
    };
    let fitting: Vec<&ObjectInstance> = task.objects.iter().filter(fits).collect();
    let chosen = random::choose(&mut random::stream(seed, "no-ask", 0), &fitting).copied();
    Oracle::faulty(
        "no-ask",
        Arc::new(mistaken_task(task, chosen, None)),
        habits,
        seed,
    )
}

/// Never opens a door.
pub fn forgets_door(task: &Arc<Task>, seed: u64) -> Oracle {
    Oracle::faulty(
        "forgets-door",
        task.clone(),
        OracleOptions {
            minds_doors: false,
            ..OracleOptions::default()
        },
        seed,
    )
}

/// The task as one believes it who takes another object for the target or another receptacle for
/// its destination. The published plan is kept only where it still fits.
pub fn mistaken_task(
    task: &Task,
    object: Option<&ObjectInstance>,
    receptacle: Option<&ReceptacleId>,
) -> Task {
    let mut believed = task.clone();
    let target = task.target_object();
    let right = task
        .goal
        .receptacle_of(&task.target)
        .unwrap_or(&task.dest)
        .clone();
    believed.goal.remove(&right, &task.target);
    if object.is_some_and(|object| object.instance != task.target) {
        believed.goal.add(&target.receptacle, &task.target);
    }
    let object = object.unwrap_or(target);
    if object.instance != task.target {
        believed.goal.remove(&object.receptacle, &object.instance);
    }
    let dest = receptacle.unwrap_or(&right);
    believed.goal.add(dest, &object.instance);
    if *dest != right || object.receptacle != target.receptacle {
        believed.plan.clear();
    }
    for step in &mut believed.plan {
        if let Some(category) = step.args.get_mut("target_category") {
            *category = Value::from(object.category.as_str());
        }
    }
    believed.target = object.instance.clone();
    believed.src = object.receptacle.clone();
    believed.dest = dest.clone();
    believed
}

/// Whether an object is like the target: of its category, or placed as its distractor.
fn is_similar(task: &Task, object: &ObjectInstance) -> bool {
    let target = task.target_object();
    let distractor = |asset: &AssetId| *asset == object.asset;
    object.category == target.category || task.object_distractors.iter().any(distractor)
}

/// The oracle up to the pick; then it drives to and fro between two receptacles until the horizon.
#[derive(Debug)]
pub struct Oscillating {
    oracle: Oracle,
    seed: u64,
    between: [ReceptacleId; 2],
    /// How often it has driven; none before it begins.
    turns: Option<usize>,
}

impl Oscillating {
    /// Oscillates between the destination and the source, or else a receptacle that is neither.
    pub fn new(task: &Arc<Task>, scene: &Scene, seed: u64) -> Self {
        let similar = task
            .dest_distractors
            .iter()
            .chain(&task.src_distractors)
            .chain([&task.src]);
        let all = scene.receptacles.iter().map(|receptacle| &receptacle.id);
        let other = similar
            .chain(all)
            .find(|id| **id != task.dest)
            .unwrap_or(&task.src)
            .clone();
        Self {
            oracle: Oracle::new(task.clone(), seed),
            seed,
            between: [task.dest.clone(), other],
            turns: None,
        }
    }
}

impl Policy for Oscillating {
    fn info(&self) -> PolicyInfo {
        policy::info("oscillating", self.seed)
    }

    fn needs_privileged(&self) -> bool {
        true
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        if self.turns.is_none() && context.truth.is_none_or(|truth| truth.held.is_none()) {
            let input = self.oracle.act(context)?;
            // It does not know when to stop, either.
            if input.call.name != Tool::Finish.paper_name() {
                return Ok(input);
            }
        }
        let turn = self.turns.map_or(0, |turn| turn + 1);
        self.turns = Some(turn);
        let receptacle = self.between[turn % 2].clone();
        Ok(StepInput::from_call(Tool::NavTo { receptacle }.to_call()))
    }

    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.oracle.observe(context, input);
    }
}

/// The oracle, but about one call in four is nonsense; it goes on as if nothing had happened.
#[derive(Debug)]
pub struct Gibberish {
    oracle: Oracle,
    seed: u64,
    rng: ChaCha8Rng,
    /// What the oracle's own last call gave, while nonsense came between.
    kept: Option<Observation>,
    /// Numbers that were on some map.
    old_markers: BTreeSet<u32>,
    talking_nonsense: bool,
}

impl Gibberish {
    /// `seed` decides when and what.
    pub fn new(task: &Arc<Task>, seed: u64) -> Self {
        Self {
            oracle: Oracle::new(task.clone(), seed),
            seed,
            rng: random::stream(seed, "gibberish", 0),
            kept: None,
            old_markers: BTreeSet::new(),
            talking_nonsense: false,
        }
    }

    fn nonsense(&mut self, context: &PolicyContext<'_>) -> ToolCall {
        let current = |id: &u32| {
            context
                .truth
                .is_some_and(|truth| truth.markers.iter().any(|marker| marker.id == *id))
        };
        let stale = self
            .old_markers
            .iter()
            .copied()
            .find(|id| !current(id))
            .unwrap_or(97);
        let calls = [
            ToolCall::new("teleport", json!({ "receptacle_name": "the moon" })),
            ToolCall::new("", Value::Null),
            ToolCall::new("nav_to", json!({ "receptacle_name": "atlantis_0" })),
            ToolCall::new("nav_to", json!({ "receptacle_name": 7 })),
            ToolCall::new("nav_to", json!(["table"])),
            ToolCall::new("pick", json!({})),
            ToolCall::new("pick", json!({ "marker_id": "the red one" })),
            ToolCall::new("pick", json!({ "marker_id": -1 })),
            ToolCall::new("gaze_at", json!({ "marker_id": stale })),
            ToolCall::new("place", json!({ "marker_id": u64::MAX })),
            ToolCall::new("open", json!({ "marker_id": stale })),
            ToolCall::new("ask", json!({ "question": 42 })),
            ToolCall::new("show_object_by_category", json!({ "category": "apple" })),
        ];
        let index = random::below(&mut self.rng, calls.len());
        calls[index].clone()
    }
}

impl Policy for Gibberish {
    fn info(&self) -> PolicyInfo {
        policy::info("gibberish", self.seed)
    }

    fn needs_privileged(&self) -> bool {
        true
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        if let Some(truth) = context.truth {
            let objects = truth
                .markers
                .iter()
                .filter(|marker| matches!(marker.target, MarkerTarget::Object(_)));
            self.old_markers.extend(objects.map(|marker| marker.id));
        }
        if !self.talking_nonsense {
            let Observation {
                text, error, held, ..
            } = context.observation;
            self.kept = Some(Observation {
                text: text.clone(),
                error: *error,
                frame: None,
                held: held.clone(),
            });
        }
        self.talking_nonsense = random::below(&mut self.rng, 4) == 0;
        if self.talking_nonsense {
            return Ok(StepInput::from_call(self.nonsense(context)));
        }
        let observation = self.kept.as_ref().unwrap_or(context.observation);
        self.oracle.act(&PolicyContext {
            observation,
            ..*context
        })
    }

    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.old_markers.extend(
            context
                .perceived
                .iter()
                .filter(|thing| !thing.furniture)
                .filter_map(|thing| thing.marker),
        );
        self.kept = None;
        self.talking_nonsense = false;
        self.oracle.observe(context, input);
    }

    fn gave_up(&self) -> Option<String> {
        self.oracle.gave_up()
    }
}
