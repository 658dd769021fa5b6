//! Hand-made episodes whose every field can be set or left out. No physics.

use std::{path::Path, sync::Arc};

use reel_trace::{Images, RecordOptions, Recorder, Trace, TraceError, TraceSummary};
use reel_world::{Skills, record::*, *};
use serde_json::{Value, json};

/// The records of one episode.
#[derive(Clone, PartialEq, Debug)]
pub struct Sample {
    pub header: EpisodeHeader,
    pub task: Task,
    pub scene: Scene,
    pub start: StartRecord,
    pub steps: Vec<StepRecord>,
    pub end: EndRecord,
}

/// Where the values of a sample come from.
pub struct Source {
    pub texts: Vec<String>,
    pub floats: Vec<f32>,
    pub values: Vec<Value>,
    pub state: u64,
}

impl Source {
    /// Fixed values, other ones for another seed.
    pub fn seeded(seed: u64) -> Self {
        let texts = ["", "plate", "a \"quoted\"\nline", "größer 🙂", "\u{0}"]
            .map(str::to_owned)
            .to_vec();
        let values = vec![
            json!({"marker_id": 3, "why": [1.5, null]}),
            json!({}),
            Value::Null,
            json!("no object"),
            json!(u64::MAX),
        ];
        Self {
            texts,
            floats: vec![0.0, -0.0, 1.5, -1e-42, 0.1, 1e30],
            values,
            state: seed,
        }
    }

    fn next(&mut self) -> u64 {
        self.state = self
            .state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        self.state >> 33
    }
    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound as u64) as usize
    }
    fn text(&mut self) -> String {
        let index = self.below(self.texts.len());
        self.texts[index].clone()
    }
    fn float(&mut self) -> f32 {
        let index = self.below(self.floats.len());
        self.floats[index]
    }
    fn floats<const N: usize>(&mut self) -> [f32; N] {
        [(); N].map(|()| self.float())
    }
    fn value(&mut self) -> Value {
        let index = self.below(self.values.len());
        self.values[index].clone()
    }
    fn digest(&mut self) -> Digest {
        Digest::of(&self.next().to_le_bytes())
    }
    fn maybe<T>(&mut self, make: impl FnOnce(&mut Self) -> T) -> Option<T> {
        (self.below(2) == 0).then(|| make(self))
    }
    fn list<T>(&mut self, mut make: impl FnMut(&mut Self) -> T) -> Vec<T> {
        (0..self.below(4)).map(|_| make(self)).collect()
    }
    fn reported(&mut self) -> Reported {
        let score = |s: &mut Self| Score {
            name: s.text(),
            value: s.maybe(|s| f64::from(s.float())),
            label: s.maybe(Self::text),
            explanation: s.maybe(Self::text),
        };
        Reported {
            success: self.maybe(|s| s.below(2) == 0),
            scores: self.list(score),
        }
    }
    fn reply(&mut self) -> UserReply {
        let source = [UserSource::RuleBased, UserSource::Model, UserSource::Human][self.below(3)];
        UserReply {
            text: self.text(),
            source,
        }
    }
    fn door(&mut self) -> DoorState {
        [DoorState::Open, DoorState::Closed][self.below(2)]
    }
    fn graph(&mut self) -> WorldGraph {
        let mut graph = WorldGraph::default();
        for index in 0..self.below(4) {
            let state = ReceptacleState {
                door: self.maybe(Self::door),
                ..Default::default()
            };
            graph
                .receptacles
                .insert(format!("table_{index}").into(), state);
            for _ in 0..self.below(3) {
                let object = self.text().into();
                graph.add(&format!("table_{index}").into(), &object);
            }
        }
        graph
    }
    fn graphs(&mut self) -> Graphs {
        Graphs {
            physics: self.graph(),
            registry: self.graph(),
        }
    }
    fn event(&mut self) -> GraphEvent {
        let receptacle = self.text().into();
        match self.below(3) {
            0 => GraphEvent::Remove {
                object: self.text().into(),
                receptacle,
            },
            1 => GraphEvent::Add {
                object: self.text().into(),
                receptacle,
            },
            _ => GraphEvent::Door {
                receptacle,
                from: self.door(),
                to: self.door(),
            },
        }
    }
    fn visible(&mut self) -> Vec<VisibleObject> {
        self.list(|s| VisibleObject {
            object: s.text().into(),
            pixels: s.next() as u32,
            bbox: [(); 4].map(|()| s.next() as u16),
        })
    }
    fn bodies(&mut self) -> Vec<BodyState> {
        self.list(|s| BodyState {
            body: s.text(),
            position: s.floats(),
            rotation: s.floats(),
            linear_velocity: s.floats(),
            angular_velocity: s.floats(),
            asleep: s.below(2) == 0,
        })
    }
    fn robot(&mut self) -> RobotState {
        RobotState {
            base: self.floats(),
            yaw: self.float(),
            camera: self.floats(),
            pitch: self.float(),
            path_length_m: self.float(),
        }
    }
    fn digests(&mut self) -> StateDigests {
        let frame = |s: &mut Self| FrameDigests {
            rgb: s.digest(),
            ids: s.digest(),
            depth: s.digest(),
        };
        StateDigests {
            state: self.digest(),
            frame: self.maybe(frame),
            physics_steps: self.list(|s| s.next() as u32),
        }
    }
    fn policy(&mut self) -> PolicyOutput {
        PolicyOutput {
            raw: self.text(),
            reasoning: self.text(),
            history: self.text(),
            plan: self.text(),
            tokens: self.maybe(|s| [s.next() as u32, s.next() as u32]),
            latency_ns: self.maybe(Self::next),
            logprobs: self.maybe(Self::logprobs),
        }
    }
    fn logprobs(&mut self) -> TokenLogprobs {
        let tokens: Vec<String> = (0..=self.below(3)).map(|_| self.text()).collect();
        let logprobs = |s: &mut Self| {
            tokens
                .iter()
                .map(|_| -(s.next() as f64) / 1e9)
                .collect::<Vec<f64>>()
        };
        let mut of = TokenLogprobs::sampled(tokens.clone(), logprobs(self)).unwrap();
        if let Some(new) = self.maybe(logprobs) {
            of.add("new", new, Some(&tokens)).unwrap();
        }
        of
    }
    fn step(&mut self, step: u32) -> StepRecord {
        let error = self.maybe(|s| ErrorCode::ALL[s.below(ErrorCode::ALL.len())]);
        let target = |s: &mut Self| match s.below(2) {
            0 => MarkerTarget::Object(s.text().into()),
            _ => MarkerTarget::Receptacle(s.text().into()),
        };
        StepRecord {
            step,
            input: StepInput {
                call: ToolCall::new(self.text(), self.value()),
                policy: self.maybe(Self::policy),
                user_reply: self.maybe(Self::reply),
                refused_replies: self.list(|s| RefusedReply {
                    text: s.text(),
                    rules: s.list(Self::text),
                }),
                lookup: self.maybe(|s| Lookup {
                    categories: s.list(Self::text),
                    source: s.text(),
                }),
            },
            outcome: Outcome {
                text: self.text(),
                error,
            },
            tool: self.maybe(Self::text),
            reply: self.maybe(Self::reply),
            markers: self.list(|s| Marker {
                id: s.next() as u32,
                target: target(s),
            }),
            visible: self.visible(),
            listed: self.list(|s| s.text().into()),
            object: self.maybe(|s| s.text().into()),
            receptacle: self.maybe(|s| s.text().into()),
            held: self.maybe(|s| s.text().into()),
            changes: GraphChanges {
                physics: self.list(Self::event),
                registry: self.list(Self::event),
            },
            bodies: self.bodies(),
            robot: self.robot(),
            sim_step: u64::from(step) * 100 + self.next() % 100,
            reward: self.list(|s| RewardTerm {
                component: s.text(),
                value: f64::from(s.float()) / 3.0,
                reason: s.text(),
            }),
            digests: self.digests(),
        }
    }

    /// An episode of so many steps.
    pub fn sample(&mut self, steps: u32) -> Sample {
        let (task, scene) = task_and_scene();
        let header = EpisodeHeader {
            episode_id: self.text(),
            run_id: self.text(),
            group_id: self.maybe(Self::text),
            rollout_index: self.maybe(|s| s.next() as u32),
            task_id: task.task_id.clone(),
            family: Family::ALL[self.below(4)],
            scene_id: scene.scene_id.clone(),
            task_digest: Digest::of_json(&task),
            scene_digest: Digest::of_json(&scene),
            seed: u64::MAX - self.next(),
            sim_version: 1,
            build: self.text(),
            profile: [Profile::Paper, Profile::RealRepo][self.below(2)],
            reward_preset: self.text(),
            policy: PolicyInfo {
                name: self.text(),
                checkpoint: self.maybe(Self::text),
                parameters: self.list(|s| (s.text(), s.value())).into_iter().collect(),
            },
            backend: [Backend::Sim, Backend::Robot, Backend::Proxy][self.below(3)],
            skills: Skills::ALL[self.below(2)],
            meshes: std::collections::BTreeMap::new(),
            parent: self.maybe(|s| Parent {
                trace: s.digest(),
                call: s.next() as u32,
            }),
        };
        let start = StartRecord {
            graphs: self.graphs(),
            bodies: self.bodies(),
            robot: self.robot(),
            visible: self.visible(),
            shortest_path_m: self.maybe(Self::float),
            digests: self.digests(),
        };
        let metrics = Metrics {
            success: self.below(2) == 0,
            completion: f64::from(self.float()),
            total_reward: f64::from(self.float()),
            discounted_return: -0.0,
            length: steps,
            asks: self.next() as u32,
            spl: self.maybe(|s| f64::from(s.float())),
        };
        let reason = [
            EndReason::Finished,
            EndReason::Horizon,
            EndReason::Fault,
            EndReason::Aborted,
        ][self.below(4)];
        let end = EndRecord {
            reason,
            graphs: self.graphs(),
            metrics,
            steps,
            reported: self.reported(),
        };
        let steps = (0..steps).map(|step| self.step(step)).collect();
        Sample {
            header,
            task,
            scene,
            start,
            steps,
            end,
        }
    }
}

impl Sample {
    /// Gives every moment an image and its digests.
    pub fn with_frames(mut self) -> (Self, Vec<Frame>) {
        let frames: Vec<Frame> = (0..=self.steps.len()).map(frame).collect();
        self.start.digests.frame = Some(frames[0].digests());
        for (step, frame) in self.steps.iter_mut().zip(&frames[1..]) {
            step.digests.frame = Some(frame.digests());
        }
        (self, frames)
    }

    /// Records everything but the end.
    pub fn record_open(
        &self,
        path: &Path,
        frames: &[Frame],
        options: impl Into<RecordOptions>,
    ) -> Result<Recorder, TraceError> {
        let mut recorder = Recorder::create(path, &self.header, &self.task, &self.scene, options)?;
        recorder.start(&self.start, frames.first())?;
        for (index, step) in self.steps.iter().enumerate() {
            recorder.input(step.step, &step.input)?;
            recorder.step(step, frames.get(index + 1))?;
        }
        Ok(recorder)
    }

    /// Records everything, without images.
    pub fn record(&self, path: &Path) -> TraceSummary {
        self.record_open(path, &[], Images::None)
            .unwrap()
            .end(&self.end)
            .unwrap()
    }

    /// Asserts that a trace holds exactly these records.
    pub fn assert_is(&self, trace: &Trace) {
        let Trace {
            header,
            task,
            scene,
            start,
            steps,
            end,
            ..
        } = trace.clone();
        let (task, scene) = (Arc::unwrap_or_clone(task), Arc::unwrap_or_clone(scene));
        let read = Sample {
            header,
            task,
            scene,
            start,
            steps,
            end: end.expect("the trace has an end"),
        };
        // Debug tells zero from minus zero, equality does not.
        assert_eq!(format!("{self:?}"), format!("{read:?}"));
        assert_eq!(*self, read);
    }
}

fn task_and_scene() -> (Task, Scene) {
    let receptacle = |id: &str, x: f64| {
        json!({"id": id, "room": "kitchen/0", "category": "table", "door": x > 1.0, "captions": {"the table": 1.0 / 3.0},
               "surface_min": [x, 0.1, 0.7], "surface_max": [x + 1.1, 0.9, 0.75]})
    };
    let scene = json!({
        "scene_id": "flat", "rooms": [{"name": "kitchen/0", "min": [0.0, 0.0], "max": [5.000000000000001, 4.0]}],
        "receptacles": [receptacle("table_0", 0.5), receptacle("table_1", 2.5)], "unknown": {"kept": [1, 2.5]},
    });
    let scene: Scene = serde_json::from_value(scene).unwrap();
    let object = |name: &str, x: f64| ObjectInstance {
        instance: format!("{name}_on_table_0_at_t").as_str().into(),
        asset: name.into(),
        category: "plate".into(),
        caption: None,
        attributes: Attributes::new(),
        size: [0.2, 0.2, 0.1 + 0.2],
        position: [x, 0.5, 0.92],
        yaw: 0.0,
        receptacle: "table_0".into(),
        reference_rest: None,
    };
    let objects = vec![object("cup", 0.7), object("plate", 1.1)];
    let initial = Task::initial_graph(&scene, &objects);
    let mut goal = initial.clone();
    goal.remove(&"table_0".into(), &objects[1].instance);
    goal.add(&"table_1".into(), &objects[1].instance);
    let task = Task {
        placement_order: Vec::new(),
        task_id: "FDP/t".into(),
        family: Family::FDP,
        task_type: None,
        scene_id: "flat".into(),
        instruction: "Put the plate on the other table.".into(),
        precise_instruction: "Put the plate on table_1.".into(),
        fuzzy: false,
        purpose: None,
        target: objects[1].instance.clone(),
        objects,
        initial,
        goal,
        src: "table_0".into(),
        dest: "table_1".into(),
        src_distractors: vec![],
        dest_distractors: vec![],
        object_distractors: vec![],
        plan: vec![],
        published_goal: None,
        extra: Default::default(),
    };
    (task, scene)
}

/// An image with areas, a gradient and some detail.
fn frame(index: usize) -> Frame {
    let mut frame = Frame::new();
    for (pixel, rgb) in frame.rgb.chunks_exact_mut(3).enumerate() {
        let (x, y) = (pixel % FRAME_WIDTH, pixel / FRAME_WIDTH);
        rgb[0] = (y / 4) as u8;
        rgb[1] = if (x / 40 + y / 40 + index).is_multiple_of(3) {
            200
        } else {
            60
        };
        rgb[2] = if (x + index * 7) % 97 < 2 {
            255
        } else {
            (x / 8) as u8
        };
    }
    frame
}
