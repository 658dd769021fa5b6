//! Hand-made episodes, move by move, recorded as real traces. No physics.

#![expect(missing_docs, reason = "the moves are named like the tools")]

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use reel_trace::{Images, Recorder, Timing, Trace, robot::RobotLog};
use reel_world::{Skills, record::*, *};
use serde_json::{Value, json};

/// The clock to move, from `table_1` to `desk_1`.
pub const TARGET: &str = "clock_white_7_on_table_1_at_t";
/// Another clock beside it.
pub const DISTRACTOR: &str = "clock_blue_3_on_table_1_at_t";

/// An episode that is being made up.
#[derive(Clone)]
pub struct Play {
    pub header: EpisodeHeader,
    pub task: Task,
    pub scene: Scene,
    graph: WorldGraph,
    held: Option<InstanceId>,
    pub steps: Vec<StepRecord>,
    /// How long the calls took where they were carried out, by step.
    pub timings: BTreeMap<u32, Timing>,
    /// What a robot measured.
    pub robot: RobotLog,
    /// Made up as well: the discounted return of its metrics.
    pub discounted_return: f64,
    reason: Option<EndReason>,
}

impl Play {
    /// A new episode of a policy in a family; `FDO` has the cabinet with the closed door as
    /// destination, `SUL` a fuzzy instruction.
    pub fn new(policy: &str, family: Family, seed: u64) -> Self {
        let (scene, task) = (scene(), task(family));
        let header = EpisodeHeader {
            episode_id: format!("{policy}-{family}-{seed}"),
            run_id: "run".into(),
            group_id: None,
            rollout_index: None,
            task_id: task.task_id.clone(),
            family,
            scene_id: scene.scene_id.clone(),
            task_digest: Digest::of_json(&task),
            scene_digest: Digest::of_json(&scene),
            seed,
            sim_version: 1,
            build: "0.1.0".into(),
            profile: Profile::Paper,
            reward_preset: "paper".into(),
            policy: PolicyInfo {
                name: policy.into(),
                ..PolicyInfo::default()
            },
            backend: Backend::Sim,
            skills: Skills::Perfect,
            meshes: std::collections::BTreeMap::new(),
            parent: None,
        };
        let graph = task.initial.clone();
        Self {
            header,
            task,
            scene,
            graph,
            held: None,
            steps: Vec::new(),
            timings: BTreeMap::new(),
            robot: RobotLog::default(),
            discounted_return: 0.5,
            reason: None,
        }
    }

    /// Puts one more object into the task.
    pub fn with_object(mut self, asset: &str, category: &str, receptacle: &str) -> Self {
        let instance = InstanceId::new(&asset.into(), &receptacle.into(), "t");
        let like = self.task.target_object().clone();
        for graph in [&mut self.task.initial, &mut self.task.goal, &mut self.graph] {
            graph.add(&receptacle.into(), &instance);
        }
        self.task.objects.push(ObjectInstance {
            instance,
            asset: asset.into(),
            category: category.into(),
            receptacle: receptacle.into(),
            ..like
        });
        self.header.task_digest = Digest::of_json(&self.task);
        self
    }

    /// A call and what came of it; the moves below fill in what else it did.
    pub fn call(mut self, tool: &str, arguments: Value, outcome: Outcome) -> Self {
        let step = self.steps.len() as u32;
        let after = 0.25 * step as f32;
        self.steps.push(StepRecord {
            step,
            input: StepInput::from_call(ToolCall::new(tool, arguments)),
            outcome,
            tool: Some(tool.into()),
            reply: None,
            markers: Vec::new(),
            visible: vec![VisibleObject {
                object: TARGET.into(),
                pixels: 420,
                bbox: [10, 20, 40, 60],
            }],
            listed: Vec::new(),
            object: None,
            receptacle: None,
            held: self.held.clone(),
            changes: GraphChanges::default(),
            bodies: self.bodies(),
            robot: RobotState {
                base: [after, 1.0],
                yaw: 0.3,
                camera: [after, 1.0, 1.2],
                pitch: -0.3,
                path_length_m: after,
            },
            sim_step: u64::from(step + 1) * 20,
            reward: vec![RewardTerm {
                component: "time".into(),
                value: -0.03,
                reason: "one more decision".into(),
            }],
            digests: StateDigests {
                state: Digest::of(&step.to_le_bytes()),
                ..StateDigests::default()
            },
        });
        self
    }

    fn last(&mut self) -> &mut StepRecord {
        self.steps.last_mut().expect("a call was made")
    }

    pub fn nav(self, receptacle: &str) -> Self {
        let mut play = self.call(
            "nav_to",
            json!({ "receptacle_name": receptacle }),
            Outcome::ok(format!("You are at {receptacle}.")),
        );
        play.last().receptacle = Some(receptacle.into());
        play
    }

    pub fn find(self, category: &str) -> Self {
        let mut play = self.call(
            "show_object_by_category",
            json!({ "target_category": category }),
            Outcome::ok("Marked 2 objects."),
        );
        let seen = [TARGET, DISTRACTOR].map(InstanceId::from);
        let record = play.last();
        record.visible = seen
            .iter()
            .map(|object| VisibleObject {
                object: object.clone(),
                pixels: 300,
                bbox: [0, 0, 9, 9],
            })
            .collect();
        record.markers = (1..)
            .zip(seen)
            .map(|(id, object)| Marker {
                id,
                target: MarkerTarget::Object(object),
            })
            .collect();
        play
    }

    pub fn ask(self, question: &str, reply: &str) -> Self {
        let mut play = self.call("ask", json!({ "question": question }), Outcome::ok(reply));
        play.last().reply = Some(UserReply {
            text: reply.into(),
            source: UserSource::RuleBased,
        });
        play
    }

    pub fn pick(mut self, object: &str) -> Self {
        let object = InstanceId::from(object);
        let from = self
            .graph
            .receptacle_of(&object)
            .expect("the object is somewhere")
            .clone();
        let event = GraphEvent::Remove {
            object: object.clone(),
            receptacle: from.clone(),
        };
        self.graph.apply(std::slice::from_ref(&event));
        self.held = Some(object.clone());
        self.moved("pick", object, from, event)
    }

    pub fn place(mut self, receptacle: &str) -> Self {
        let object = self.held.take().expect("something is held");
        let event = GraphEvent::Add {
            object: object.clone(),
            receptacle: receptacle.into(),
        };
        self.graph.apply(std::slice::from_ref(&event));
        self.moved("place", object, receptacle.into(), event)
    }

    pub fn open(self, receptacle: &str) -> Self {
        self.door("open", receptacle, DoorState::Closed, DoorState::Open)
    }

    pub fn close(self, receptacle: &str) -> Self {
        self.door("close", receptacle, DoorState::Open, DoorState::Closed)
    }

    fn door(mut self, tool: &str, receptacle: &str, from: DoorState, to: DoorState) -> Self {
        let event = GraphEvent::Door {
            receptacle: receptacle.into(),
            from,
            to,
        };
        self.graph.apply(std::slice::from_ref(&event));
        let text = format!("The door is {to}.");
        let mut play = self.call(tool, json!({ "marker_id": 1 }), Outcome::ok(text));
        let record = play.last();
        record.receptacle = Some(receptacle.into());
        record.changes = GraphChanges {
            physics: vec![event.clone()],
            registry: vec![event],
        };
        play
    }

    pub fn fails(self, tool: &str, code: ErrorCode) -> Self {
        self.call(
            tool,
            json!({ "marker_id": 1 }),
            Outcome::error(code, format!("It does not work: {code}.")),
        )
    }

    pub fn finish(self) -> Self {
        let mut play = self.call("finish", json!({}), Outcome::ok("The episode is over."));
        play.reason = Some(EndReason::Finished);
        play
    }

    /// What is held falls to the floor with the last call.
    pub fn drops(mut self) -> Self {
        let object = self.held.take().expect("something is held");
        let event = GraphEvent::Add {
            object,
            receptacle: FLOOR.into(),
        };
        self.graph.apply(std::slice::from_ref(&event));
        let record = self.last();
        record.held = None;
        record.changes.physics.push(event);
        self
    }

    /// What the policy wrote down about its past with the last call.
    pub fn remembering(self, history: &str) -> Self {
        self.thinking(PolicyOutput {
            history: history.into(),
            ..PolicyOutput::default()
        })
    }

    /// Ends at the horizon, or by whatever else.
    pub fn ended(mut self, reason: EndReason) -> Self {
        self.reason = Some(reason);
        self
    }

    /// Gives the last step a policy output.
    pub fn thinking(mut self, policy: PolicyOutput) -> Self {
        self.last().input.policy = Some(policy);
        self
    }

    fn moved(
        self,
        tool: &str,
        object: InstanceId,
        receptacle: ReceptacleId,
        event: GraphEvent,
    ) -> Self {
        let goal = self.task.goal_changes().contains(&event);
        let mut play = self.call(tool, json!({ "marker_id": 1 }), Outcome::ok("Done."));
        let record = play.last();
        record.object = Some(object);
        record.receptacle = Some(receptacle);
        record.changes = GraphChanges {
            physics: vec![event.clone()],
            registry: vec![event.clone()],
        };
        if goal {
            record.reward.insert(
                0,
                RewardTerm {
                    component: "task".into(),
                    value: 1.5,
                    reason: event.to_string(),
                },
            );
        }
        play
    }

    /// Where the objects stand that nobody holds; a fixed height is good enough.
    fn bodies(&self) -> Vec<BodyState> {
        let still = |object: &ObjectInstance| BodyState {
            body: object.instance.as_str().into(),
            position: object.position.map(|value| value as f32),
            rotation: [0.0, 0.0, 0.0, 1.0],
            linear_velocity: [0.0; 3],
            angular_velocity: [0.0; 3],
            asleep: true,
        };
        self.task
            .objects
            .iter()
            .filter(|object| self.held.as_ref() != Some(&object.instance))
            .map(still)
            .collect()
    }

    /// Records the trace as `<episode id>.mcap`, with images or without, and reads it back.
    pub fn record(&self, dir: &Path, images: Images) -> Trace {
        Trace::read(&self.record_as(
            &dir.join(format!("{}.mcap", self.header.episode_id)),
            images,
        ))
        .unwrap()
    }

    /// Records the trace under a path; without an end it stays the `.part`
    /// of a broken-off recording.
    pub fn record_as(&self, path: &Path, images: Images) -> PathBuf {
        let mut start = StartRecord {
            graphs: Graphs {
                physics: self.task.initial.clone(),
                registry: self.task.initial.clone(),
            },
            bodies: Play {
                held: None,
                ..self.clone()
            }
            .bodies(),
            robot: RobotState {
                camera: [0.0, 1.0, 1.2],
                ..RobotState::default()
            },
            visible: vec![VisibleObject {
                object: DISTRACTOR.into(),
                pixels: 99,
                bbox: [1, 2, 3, 4],
            }],
            shortest_path_m: Some(1.5),
            digests: StateDigests::default(),
        };
        let image = |index: usize| (images == Images::Full).then(|| frame(index));
        let first = image(0);
        start.digests.frame = first.as_ref().map(Frame::digests);
        let mut recorder =
            Recorder::create(path, &self.header, &self.task, &self.scene, images).unwrap();
        recorder.start(&start, first.as_ref()).unwrap();
        for record in &self.steps {
            let mut record = record.clone();
            let image = image(record.step as usize + 1).filter(|_| record.tool_name() != "ask");
            record.digests.frame = image.as_ref().map(Frame::digests);
            recorder.input(record.step, &record.input).unwrap();
            if let Some(timing) = self.timings.get(&record.step) {
                recorder.timing(record.step, timing).unwrap();
            }
            recorder.robot(Some(record.step), &self.robot).unwrap();
            recorder.step(&record, image.as_ref()).unwrap();
        }
        let Some(reason) = self.reason else {
            return path.with_added_extension("part");
        };
        let success = self.graph == self.task.goal;
        let metrics = Metrics {
            success,
            completion: if success { 1.0 } else { 0.0 },
            total_reward: self.steps.iter().map(StepRecord::reward_total).sum(),
            discounted_return: self.discounted_return,
            length: self.steps.len() as u32,
            asks: self
                .steps
                .iter()
                .filter(|record| record.tool_name() == "ask")
                .count() as u32,
            spl: Some(if success { 0.8 } else { 0.0 }),
        };
        let graphs = Graphs {
            physics: self.graph.clone(),
            registry: self.graph.clone(),
        };
        recorder
            .end(&EndRecord {
                reason,
                graphs,
                metrics,
                steps: self.steps.len() as u32,
                reported: Reported::default(),
            })
            .unwrap();
        path.to_path_buf()
    }
}

fn scene() -> Scene {
    let receptacle = |id: &str, category: &str, x: f64, door: bool| {
        json!({"id": id, "room": "living room/0", "category": category, "door": door,
               "surface_min": [x, 2.0, 0.7], "surface_max": [x + 1.0, 2.6, 0.75]})
    };
    serde_json::from_value(json!({
        "scene_id": "flat", "rooms": [{"name": "living room/0", "min": [0.0, 0.0], "max": [8.0, 4.0]}],
        "receptacles": [receptacle("table_1", "table", 0.2, false), receptacle("table_2", "table", 1.6, false),
                        receptacle("desk_1", "desk", 3.0, false), receptacle("desk_2", "desk", 4.4, false),
                        receptacle("cabinet_1", "cabinet", 5.8, true)],
    }))
    .unwrap()
}

fn task(family: Family) -> Task {
    let object = |asset: &str, category: &str, colour: &str, x: f64| ObjectInstance {
        instance: InstanceId::new(&asset.into(), &"table_1".into(), "t"),
        asset: asset.into(),
        category: category.into(),
        caption: Some(format!("{colour} {category}")),
        attributes: Attributes::from([
            ("colour".into(), vec![colour.into()]),
            ("shape".into(), vec!["round".into(), "small".into()]),
        ]),
        size: [0.1, 0.1, 0.12],
        position: [x, 2.3, 0.83],
        yaw: 0.0,
        receptacle: "table_1".into(),
        reference_rest: None,
    };
    let objects = vec![
        object("clock_blue_3", "alarm clock", "blue", 0.4),
        object("clock_white_7", "alarm clock", "white", 0.6),
        object("mug_1", "mug", "red", 0.9),
    ];
    let initial = Task::initial_graph(&scene(), &objects);
    let dest = if family == Family::FDO {
        "cabinet_1"
    } else {
        "desk_1"
    };
    let mut goal = initial.clone();
    goal.remove(&"table_1".into(), &TARGET.into());
    goal.add(&dest.into(), &TARGET.into());
    if family == Family::FDO {
        goal.receptacles.get_mut(dest).unwrap().door = Some(DoorState::Open);
    }
    let fuzzy = family == Family::SUL;
    let precise = format!(
        "Move the white alarm clock from the small table to the {}.",
        dest.split('_').next().unwrap()
    );
    Task {
        placement_order: Vec::new(),
        task_id: format!("{family}/t"),
        family,
        task_type: Some("basic".into()),
        scene_id: "flat".into(),
        instruction: if fuzzy {
            "Move a timekeeping device to the desk.".into()
        } else {
            precise.clone()
        },
        precise_instruction: precise,
        fuzzy,
        purpose: fuzzy.then(|| "timekeeping device".into()),
        target: TARGET.into(),
        objects,
        initial,
        goal,
        src: "table_1".into(),
        dest: dest.into(),
        src_distractors: vec!["table_2".into()],
        dest_distractors: vec!["desk_2".into()],
        object_distractors: vec!["clock_blue_3".into()],
        plan: vec![],
        published_goal: None,
        extra: Default::default(),
    }
}

/// An image that differs by index.
fn frame(index: usize) -> Frame {
    let mut frame = Frame::new();
    for (pixel, rgb) in frame.rgb.chunks_exact_mut(3).enumerate() {
        let (x, y) = (pixel % FRAME_WIDTH, pixel / FRAME_WIDTH);
        rgb.copy_from_slice(&[
            (y / 2) as u8,
            if (x / 40 + y / 40 + index).is_multiple_of(3) {
                190
            } else {
                90
            },
            (x / 3) as u8,
        ]);
    }
    frame
}

/// An episode that does everything right.
pub fn success(policy: &str, family: Family, seed: u64) -> Play {
    let play = Play::new(policy, family, seed)
        .nav("table_1")
        .find("alarm clock");
    let play = if family == Family::SUL {
        play.ask("Which one?", "The white one, please.")
    } else {
        play
    };
    let play = if family == Family::FDO {
        play.nav("cabinet_1").open("cabinet_1").nav("table_1")
    } else {
        play
    };
    let dest = play.task.dest.as_str().to_owned();
    play.pick(TARGET).nav(&dest).place(&dest).finish()
}

/// Records episodes in a folder without images; the paths of the traces.
pub fn record_all(dir: &Path, plays: &[Play]) -> Vec<PathBuf> {
    let path = |play: &Play| dir.join(format!("{}.mcap", play.header.episode_id));
    let record = |play: &Play| play.record_as(&path(play), Images::None);
    plays.iter().map(record).collect()
}
