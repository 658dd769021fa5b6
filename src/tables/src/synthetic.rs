//! Episodes that nobody played, for measurements of queries: the columns, lengths and mix of errors
//! are those of recorded ones, the moves come from a few scripts and chance. Calls, texts and error
//! codes are possible ones. No trace lies behind them, their digests are empty, and their rewards
//! are plausible, not computed.

use std::sync::Arc;

use arrow::array::RecordBatch;
use rayon::prelude::*;
use reel_world::{
    Digest, ErrorClass, Outcome, Primitive, Scene, Skills, Task, ToolSpec, ToolText,
    canonical_json, record::Backend, tool_text::numbered, value_text,
};
use serde_json::{Value, json};

use crate::{
    Store, StoreError, Table,
    rows::{
        Change, Episode, MarkerRow, Rows, Step, Term, Visible, door, name_of, object_match,
        receptacle_match,
    },
};

/// Episodes of one prompt group.
const GROUP: u64 = 8;
/// Episodes that one thread makes at a time.
const BATCH: u64 = 2_000;
/// Episodes of one commit.
const PORTION: u64 = 100_000;
/// Names of the synthetic policies that generated episodes are attributed to.
const POLICIES: [&str; 8] = [
    "atlas", "birch", "cedar", "delta", "ember", "fjord", "grove", "haven",
];

/// Fills a store with `count` synthetic episodes of some tasks in one scene, in groups of eight
/// rollouts. Equal arguments give equal rows. `progress` gets the number of episodes written.
///
/// # Errors
/// When the store cannot be written.
pub fn synthesize(
    store: &mut Store,
    tasks: &[Arc<Task>],
    scene: &Scene,
    count: u64,
    seed: u64,
    mut progress: impl FnMut(u64),
) -> Result<(), StoreError> {
    let rows = tasks
        .iter()
        .map(|task| Rows::task(task))
        .collect::<Result<Vec<_>, _>>()?;
    store.append(Table::Tasks, rows)?;
    store.append(Table::Scenes, vec![Rows::scene(scene)?])?;
    let maker = SyntheticWriter {
        tasks,
        scene,
        seed,
        digests: tasks
            .iter()
            .map(|task| Digest::of_json(&**task).to_string())
            .collect(),
    };
    let places: Vec<&str> = scene
        .receptacles
        .iter()
        .map(|receptacle| receptacle.id.as_str())
        .collect();
    let scene_digest = Digest::of_json(scene).to_string();
    for portion in (0..count).step_by(PORTION as usize) {
        let end = count.min(portion + PORTION);
        let starts: Vec<u64> = (portion..end).step_by(BATCH as usize).collect();
        let batch = |start: &u64| -> Result<RecordBatch, StoreError> {
            let mut rows = Rows::new(Table::Episodes)?;
            for number in *start..end.min(start + BATCH) {
                rows.push_row(&maker.episode(number, &places, &scene_digest))?;
            }
            Ok(rows.finish()?)
        };
        let batches = starts
            .par_iter()
            .map(batch)
            .collect::<Result<Vec<_>, _>>()?;
        store.append(Table::Episodes, batches)?;
        progress(end);
    }
    Ok(())
}

struct SyntheticWriter<'a> {
    tasks: &'a [Arc<Task>],
    scene: &'a Scene,
    seed: u64,
    digests: Vec<String>,
}

/// What an episode is about.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Script {
    Canonical,
    WrongObject,
    WrongPlace,
    Oscillates,
    Wanders,
    ClosedDoor,
}

impl SyntheticWriter<'_> {
    fn episode<'a>(&'a self, number: u64, places: &[&'a str], scene_digest: &str) -> Episode<'a> {
        let group = number / GROUP;
        let mut of_group = Chance::new(self.seed, group, 0);
        let index = of_group.below(self.tasks.len());
        let policy = of_group.below(POLICIES.len());
        let mut chance = Chance::new(self.seed, number, 1);
        let task: &Task = &self.tasks[index];
        let mut play = Play::new(task, self.scene, places, chance.next());
        // later policies are better
        let good = 0.25 + 0.07 * policy as f64;
        let script = match chance.share() {
            share if share < good => Script::Canonical,
            share if share < good + 0.14 => Script::WrongObject,
            share if share < good + 0.24 => Script::WrongPlace,
            share if share < good + 0.32 => Script::Oscillates,
            share if share < good + 0.36 => Script::ClosedDoor,
            _ => Script::Wanders,
        };
        let success = play.run(script);
        let steps = play.steps;
        let rewards: Vec<f64> = steps.iter().map(|step| step.reward).collect();
        let (mut discount, mut discounted) = (1.0, 0.0);
        for reward in &rewards {
            discounted += discount * reward;
            discount *= reel_world::GAMMA;
        }
        let driven = steps
            .last()
            .map_or(0.0, |step| f64::from(step.path_length_m));
        let shortest = 3.0 + chance.share() * 9.0;
        let finished = steps.last().is_some_and(|step| step.tool == "finish");
        let target = task.object(&task.target);
        let id = Digest::of(format!("{}-{number}", self.seed).as_bytes()).to_string();
        Episode {
            episode_id: id[..16].to_owned().into(),
            run_id: "synthetic",
            group_id: Some(format!("group-{group:07}").into()),
            rollout_index: Some((number % GROUP) as u32),
            task_id: &task.task_id,
            task_digest: self.digests[index].clone(),
            scene_digest: scene_digest.to_owned(),
            family: task.family.as_str(),
            task_type: task.task_type.as_deref(),
            scene_id: &self.scene.scene_id,
            policy: POLICIES[policy],
            checkpoint: None,
            seed: number.to_string(),
            profile: "paper",
            preset: "paper",
            sim_version: 0,
            build: "",
            backend: name_of(&Backend::Proxy),
            skills: Skills::Perfect.as_str(),
            end_reason: Some(if finished { "finished" } else { "horizon" }.into()),
            success: Some(success),
            completion: Some(if success {
                1.0
            } else {
                0.5 * f64::from(u8::from(chance.share() < 0.4))
            }),
            total_reward: Some(rewards.iter().sum()),
            discounted_return: Some(discounted),
            length: Some(steps.len() as u32),
            asks: Some(steps.iter().filter(|step| step.tool == "ask").count() as u32),
            spl: Some(if success {
                shortest / driven.max(shortest)
            } else {
                0.0
            }),
            instruction: &task.instruction,
            fuzzy: task.fuzzy,
            purpose: task.purpose.as_deref(),
            target: task.target.as_str(),
            target_category: target.map_or("", |object| &object.category),
            target_caption: target.and_then(|object| object.caption.as_deref()),
            src: task.src.as_str(),
            dest: task.dest.as_str(),
            src_door: door(&task.initial, &task.src),
            dest_door: door(&task.initial, &task.dest),
            shortest_path_m: Some(shortest),
            path_length_m: driven,
            parent_trace: None,
            parent_call: None,
            start_changes: Vec::new(),
            start_objects: Vec::new(),
            trace: String::new(),
            trace_digest: id,
            trace_bytes: 0,
            trace_modified_ns: 0,
            measurements: Vec::new(),
            steps,
            reported_success: None,
            scores: Vec::new(),
        }
    }
}

/// An episode being made up.
struct Play<'a, 'p> {
    task: &'a Task,
    scene: &'a Scene,
    places: &'p [&'a str],
    chance: Chance,
    held: Option<&'a str>,
    at: &'a str,
    candidates: usize,
    sim_step: u64,
    path_m: f32,
    steps: Vec<Step<'a>>,
}

impl<'a> Play<'a, '_> {
    fn new<'p>(task: &'a Task, scene: &'a Scene, places: &'p [&'a str], seed: u64) -> Play<'a, 'p> {
        let chance = Chance(seed);
        Play {
            task,
            scene,
            places,
            chance,
            held: None,
            at: "",
            candidates: 0,
            sim_step: 0,
            path_m: 0.0,
            steps: Vec::new(),
        }
    }

    /// Plays a script; whether the goal is reached.
    fn run(&mut self, script: Script) -> bool {
        let (src, dest) = (self.task.src.as_str(), self.task.dest.as_str());
        let fillers = self.chance.below(6);
        self.fill(fillers);
        self.nav(src);
        self.show();
        if self.task.fuzzy && script == Script::Canonical && self.chance.share() < 0.8 {
            self.ask();
        }
        if self.chance.share() < 0.5 {
            self.call("gaze_at", Some(json!(1)), ToolText::LookingAt.text(&[&1]));
        }
        match script {
            Script::Oscillates => {
                let (one, other) = (self.any_place(), self.any_place());
                for turn in 0..4 + self.chance.below(12) {
                    self.nav(if turn % 2 == 0 { one } else { other });
                }
                return false;
            }
            Script::Wanders => {
                let more = 4 + self.chance.below(14);
                self.fill(more);
                self.end();
                return false;
            }
            Script::ClosedDoor => {
                self.pick(true);
                self.nav(dest);
                let tries = 1 + self.chance.below(3);
                let failure = ToolText::DoorClosed.outcome(&[&dest]);
                (0..tries).for_each(|_| self.fails("place", json!(2), &failure));
                self.end();
                return false;
            }
            _ => {}
        }
        self.pick(script != Script::WrongObject);
        let fillers = self.chance.below(3);
        self.fill(fillers);
        let place = if script == Script::WrongPlace {
            self.any_place()
        } else {
            dest
        };
        self.nav(place);
        if self.chance.share() < 0.6 {
            let line = numbered([(2, place)].into_iter());
            let text = ToolText::ReceptaclesInView.text(&[&line]);
            self.call("show_receptacles", None, text);
        }
        self.place(place);
        self.end();
        script == Script::Canonical && place == dest
    }

    fn end(&mut self) {
        if self.chance.share() < 0.85 {
            self.call("finish", None, "");
        }
    }

    fn fill(&mut self, count: usize) {
        for _ in 0..count {
            match self.chance.below(6) {
                0 | 1 => {
                    let place = self.any_place();
                    self.nav(place);
                }
                2 => self.show(),
                3 => self.walk_around(),
                4 => {
                    let failure = ToolText::UnknownMarker.outcome(&[&7]);
                    self.fails("pick", json!(7), &failure);
                }
                _ => {
                    let failure = ToolText::UnknownReceptacle.outcome(&[&"shelf_99"]);
                    self.fails("nav_to", json!("shelf_99"), &failure);
                }
            }
        }
    }

    fn any_place(&mut self) -> &'a str {
        self.places[self.chance.below(self.places.len())]
    }

    fn nav(&mut self, place: &'a str) {
        self.path_m += 0.5 + self.chance.share() as f32 * 4.0;
        self.at = place;
        self.call(
            "nav_to",
            Some(json!(place)),
            ToolText::Arrived.text(&[&place]),
        );
        let like = receptacle_match(self.task, self.scene, &place.into());
        let step = self.last();
        (step.receptacle, step.receptacle_match) = (Some(place), Some(like));
    }

    fn walk_around(&mut self) {
        let objects = self.task.objects.iter().take(3);
        let lines = objects.map(|object| format!("a(an) {}.", object.category));
        let text = ToolText::Contents.text(&[&numbered((0..).zip(lines))]);
        self.call("walk_around", None, text);
    }

    fn show(&mut self) {
        let category = self
            .task
            .object(&self.task.target)
            .map_or("thing", |object| object.category.as_str());
        let seen: Vec<&'a str> = self
            .task
            .objects
            .iter()
            .take(3)
            .map(|object| object.instance.as_str())
            .collect();
        let first = self.candidates == 0;
        self.candidates = self.candidates.max(1 + self.chance.below(3));
        let numbers: Vec<String> = (1..=seen.len()).map(|id| format!("marker {id}")).collect();
        let text = ToolText::Found.text(&[&seen.len(), &category, &numbers.join(", ")]);
        self.call("show_object_by_category", Some(json!(category)), text);
        let step = self.last();
        step.marker_count = seen.len();
        step.marker_map = (1..)
            .zip(&seen)
            .map(|(marker, id)| MarkerRow {
                marker,
                kind: "object",
                id,
            })
            .collect();
        if first {
            step.new_objects.clone_from(&seen);
        }
    }

    fn ask(&mut self) {
        let (question, reply) = ("Which one do you mean?", "The one by the window, please.");
        self.call("ask", Some(json!(question)), reply);
        let step = self.last();
        (step.question, step.reply) = (Some(question.into()), Some(reply));
        (step.reply_source, step.settles) = (Some("rule-based".into()), Some(true));
        step.terms.push(Term {
            component: "ask",
            value: 1.0,
            reason: "asked among 2 candidates",
        });
    }

    fn pick(&mut self, right: bool) {
        let others = &self.task.objects;
        let other = others[self.chance.below(others.len())].instance.as_str();
        let object = if right {
            self.task.target.as_str()
        } else {
            other
        };
        let goal = object == self.task.target.as_str();
        let at = self.at;
        let like = (
            object_match(self.task, &object.into()),
            receptacle_match(self.task, self.scene, &at.into()),
        );
        self.held = Some(object);
        self.call("pick", Some(json!(1)), ToolText::PickedUp.text(&[&1]));
        let step = self.last();
        (step.object, step.receptacle) = (Some(object), Some(at));
        (step.goal_object, step.goal_receptacle) = (Some(goal), Some(false));
        (step.object_match, step.receptacle_match) = (Some(like.0), Some(like.1));
        step.changes = both("remove", object, at);
        if goal {
            step.terms.push(Term {
                component: "task",
                value: 1.5,
                reason: "",
            });
            step.terms.push(Term {
                component: "prog",
                value: 0.5,
                reason: "",
            });
        }
    }

    fn place(&mut self, place: &'a str) {
        let Some(object) = self.held.take() else {
            return;
        };
        let goal = object == self.task.target.as_str();
        let right = goal && place == self.task.dest.as_str();
        let like = (
            object_match(self.task, &object.into()),
            receptacle_match(self.task, self.scene, &place.into()),
        );
        self.call("place", Some(json!(2)), ToolText::Placed.text(&[&place]));
        let step = self.last();
        (step.object, step.receptacle) = (Some(object), Some(place));
        (step.goal_object, step.goal_receptacle, step.put_back) =
            (Some(goal), Some(right), Some(false));
        (step.object_match, step.receptacle_match) = (Some(like.0), Some(like.1));
        step.changes = both("add", object, place);
        (step.goals_met, step.goals_missing) = (usize::from(right), usize::from(!right));
        let value = if right { 3.5 } else { -2.0 };
        step.terms.push(Term {
            component: if right { "task" } else { "phys" },
            value,
            reason: "",
        });
    }

    fn fails(&mut self, tool: &'static str, argument: Value, failure: &Outcome) {
        self.call(tool, Some(argument), failure.text.as_str());
        let step = self.last();
        let code = failure.error.expect("a failure has a code");
        let (class, value) = match code.class() {
            ErrorClass::Severe => ("severe", -0.5),
            ErrorClass::Moderate => ("moderate", -0.3),
        };
        (step.error_code, step.error_class) = (Some(code.as_str()), Some(class));
        step.terms.push(Term {
            component: "safe",
            value,
            reason: "",
        });
    }

    fn last(&mut self) -> &mut Step<'a> {
        self.steps.last_mut().expect("a call was made")
    }

    fn call(&mut self, tool: &'static str, argument: Option<Value>, text: impl Into<String>) {
        // the step before is complete now
        if let Some(before) = self.steps.last_mut() {
            before.reward = before.terms.iter().map(|term| term.value).sum();
        }
        let step = self.steps.len() as u32;
        self.sim_step += 20 + self.chance.below(200) as u64;
        let time = (step >= 3).then_some(Term {
            component: "time",
            value: -0.03,
            reason: "",
        });
        let visible = self.task.objects.iter().take(self.chance.below(4));
        let visible = visible.map(|object| Visible {
            object: object.instance.as_str(),
            pixels: 900,
            x_min: 100,
            y_min: 120,
            x_max: 140,
            y_max: 160,
        });
        let visible_objects: Vec<Visible<'a>> = visible.collect();
        let spec = ToolSpec::by_name(tool).expect("a tool of the paper");
        let before = self.steps.last();
        let since = self.steps.iter().rposition(|step| !step.changes.is_empty());
        let in_this_state = &self.steps[since.map_or(0, |step| step + 1)..];
        let text_of = |value: &Value| value_text(value).into_owned();
        let repeated = tool == "nav_to"
            && in_this_state.iter().any(|step| {
                step.tool == tool
                    && step.argument == argument.as_ref().map(|value| text_of(value).into())
            });
        let arguments = match (spec.argument, &argument) {
            (Some(key), Some(value)) => json!({ key.name: value }),
            _ => json!({}),
        };
        self.steps.push(Step {
            step,
            tool,
            call_name: tool,
            arguments: canonical_json(&arguments),
            argument: argument.map(|value| value_text(&value).into_owned().into()),
            text: text.into().into(),
            error_code: None,
            error_class: None,
            object: None,
            receptacle: None,
            goal_object: None,
            goal_receptacle: None,
            object_match: None,
            receptacle_match: None,
            put_back: None,
            repeated,
            goals_met: before.map_or(0, |step| step.goals_met),
            goals_missing: before.map_or(1, |step| step.goals_missing),
            primitive: Primitive::parse(tool).map(Primitive::as_str),
            fell: None,
            held: self.held,
            marker_count: 0,
            visible_count: visible_objects.len(),
            candidate_count: self.candidates,
            reward: time.as_ref().map_or(0.0, |term| term.value),
            sim_step: self.sim_step,
            robot_x_m: self.chance.share() as f32 * 8.0,
            robot_y_m: self.chance.share() as f32 * 6.0,
            robot_yaw_rad: self.chance.share() as f32 * std::f32::consts::TAU,
            path_length_m: self.path_m,
            latency_ns: Some(400_000_000 + self.chance.next() % 900_000_000),
            duration_ns: None,
            reasoning: None,
            history: None,
            plan: None,
            question: None,
            reply: None,
            reply_source: None,
            refused_replies: None,
            match_source: (tool == "show_object_by_category").then_some("words"),
            match_categories: None,
            query_known: (tool == "show_object_by_category").then_some(true),
            settles: None,
            raw: None,
            prompt_tokens: Some(900 + self.chance.below(600) as u32),
            completion_tokens: Some(60 + self.chance.below(200) as u32),
            tokens: None,
            logprobs: Vec::new(),
            listed_objects: Vec::new(),
            new_objects: Vec::new(),
            changes: Vec::new(),
            terms: time.into_iter().collect(),
            marker_map: Vec::new(),
            visible_objects,
            state_digest: String::new(),
            chain_digest: String::new(),
            trace_offset: 0,
        });
    }
}

fn both(event: &'static str, object: &str, receptacle: &str) -> Vec<Change> {
    let change = |authority| Change {
        authority,
        event,
        object: Some(object.to_owned()),
        asset: Some(
            object
                .split_once("_on_")
                .map_or(object, |(asset, _)| asset)
                .to_owned(),
        ),
        receptacle: receptacle.to_owned(),
        door_from: None,
        door_to: None,
    };
    vec![change("physics"), change("registry")]
}

/// Numbers by chance: SplitMix64 (Steele, Lea, Flood 2014), seeded by what they are for.
struct Chance(u64);

impl Chance {
    fn new(seed: u64, number: u64, purpose: u64) -> Self {
        let mut chance = Chance(
            seed ^ number.wrapping_mul(0x9e37_79b9_7f4a_7c15)
                ^ purpose.wrapping_mul(0xd1b5_4a32_d192_ed03),
        );
        Chance(chance.next())
    }

    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut bits = self.0;
        bits = (bits ^ (bits >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        bits = (bits ^ (bits >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        bits ^ (bits >> 31)
    }

    /// From 0 to 1.
    fn share(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn below(&mut self, count: usize) -> usize {
        ((u128::from(self.next()) * count as u128) >> 64) as usize
    }
}
