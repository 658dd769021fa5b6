//! A running episode: the step function itself.

mod records;

use std::{fmt, sync::Arc};

use reel_reward::{Rewarder, metrics};
use reel_sim::{
    ActuationNoise, CallContext, MotionSample, PreparedTask, Simulator, Snapshot, ToolResult,
    render::Detail, sim_version,
};
use reel_world::{
    ErrorCode, Frame, InstanceId, Lifecycle, Meshes, Outcome, Profile, Scene, Task, Tool, ToolText,
    WorldGraph, ask_reply, check_playable, invariants,
    record::{
        Backend, BodyState, EndReason, EndRecord, EpisodeHeader, GraphChanges, Graphs, Reported,
        StartRecord, StateDigests, StepInput, StepRecord, UserReply,
    },
};

use crate::{
    Briefing, EpisodeConfig, EpisodeError, Privileged, StepOutput, published_user, user::RuleUser,
};
use records::{digests, end, header, observe, observers};

/// What a policy is told whose answer holds no call.
const NO_CALL: &str =
    "the answer holds no call that can be read. Answer with one call of one of the tools.";

/// A running episode: simulator, user, rewards and the records so far.
pub struct Episode {
    config: EpisodeConfig,
    header: EpisodeHeader,
    simulator: Simulator,
    user: RuleUser,
    rewarder: Box<dyn Rewarder>,
    graphs: Graphs,
    start: StartRecord,
    steps: Vec<StepRecord>,
    ended: Option<EndReason>,
}

/// An episode put aside; see [`Episode::suspend`].
#[derive(Debug)]
pub struct Suspended {
    stage: Arc<PreparedTask>,
    config: EpisodeConfig,
    start: StartRecord,
    steps: Vec<StepRecord>,
    graphs: Graphs,
    snapshot: Snapshot,
    ended: Option<EndReason>,
}

impl Suspended {
    /// Goes on with it.
    ///
    /// # Errors
    /// As [`Episode::resume`].
    pub fn resume(self) -> Result<Episode, EpisodeError> {
        Episode::resume_on(
            self.stage,
            self.config,
            self.start,
            self.steps,
            &self.snapshot,
        )
    }

    /// What the robot's head sees.
    ///
    /// # Errors
    /// When the snapshot cannot be restored.
    pub fn render_frame(&self) -> Result<Frame, EpisodeError> {
        let simulator = Simulator::resume(
            self.stage.clone(),
            self.config.profile,
            self.config.seed,
            &self.snapshot,
        )?;
        Ok(simulator.render_from(&simulator.camera()))
    }

    /// Closes it where it lies, as [`Episode::end`] does.
    pub fn end(self) -> EndRecord {
        end(
            self.ended,
            &self.config,
            &self.start,
            &self.steps,
            self.graphs,
        )
    }

    /// The state before the first call.
    pub fn start_record(&self) -> &StartRecord {
        &self.start
    }

    /// The task that the suspended episode plays.
    pub fn task(&self) -> &Arc<Task> {
        &self.config.task
    }

    /// The scene that the suspended episode plays in.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.config.scene
    }

    /// The calls so far, and what came of them.
    pub fn steps(&self) -> &[StepRecord] {
        &self.steps
    }
}

impl fmt::Debug for Episode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Episode({}, {} steps, ended: {:?})",
            self.header.episode_id,
            self.steps.len(),
            self.ended
        )
    }
}

impl Episode {
    /// Builds the world, lets it settle, takes the first image.
    ///
    /// # Errors
    /// When task and scene do not belong together.
    pub fn start(config: EpisodeConfig) -> Result<(Episode, StartRecord, Frame), EpisodeError> {
        Self::start_with(config, Detail::Full)
    }

    /// [`Episode::start`] with images of so much detail. Without RGB the digests of RGB are not
    /// those of the episode; everything else is.
    ///
    /// # Errors
    /// When task and scene do not belong together.
    pub fn start_with(
        config: EpisodeConfig,
        detail: Detail,
    ) -> Result<(Episode, StartRecord, Frame), EpisodeError> {
        Ok(Self::begin(
            prepare_task(&config.scene, &config.task, &config.meshes)?,
            config,
            detail,
        ))
    }

    /// [`Episode::start`] on a stage that is there already: that of the task and scene
    /// of `config`, by [`prepare_task`].
    ///
    /// # Panics
    /// When it is the stage of another task or scene.
    pub fn start_on(
        stage: Arc<PreparedTask>,
        config: EpisodeConfig,
    ) -> (Episode, StartRecord, Frame) {
        Self::begin(stage, config, Detail::Full)
    }

    fn begin(
        stage: Arc<PreparedTask>,
        config: EpisodeConfig,
        detail: Detail,
    ) -> (Episode, StartRecord, Frame) {
        check_stage(&stage, &config);
        let header = header(&config, &stage);
        let mut simulator = Simulator::new(stage, config.profile, config.seed);
        simulator.set_detail(detail);
        let frame = simulator.capture_frame();
        let graphs = simulator.graphs();
        let start = StartRecord {
            graphs: graphs.clone(),
            bodies: simulator.bodies(),
            robot: simulator.robot(),
            visible: simulator.visible(),
            shortest_path_m: simulator.shortest_path_m(),
            digests: digests(&mut simulator, Some(&frame)),
        };
        let (rewarder, user) = observers(&config, &start);
        let ended = simulator.fault().then_some(EndReason::Fault);
        let episode = Episode {
            header,
            simulator,
            user,
            rewarder,
            graphs,
            start: start.clone(),
            steps: Vec::new(),
            ended,
            config,
        };
        (episode, start, frame)
    }

    /// Goes on with a recorded episode: `steps` are its calls up to the snapshot, and what comes
    /// now equals what came then, bit for bit, if the inputs are equal.
    ///
    /// # Errors
    /// When task and scene do not belong together, or the snapshot is not one of the
    /// state after these steps.
    pub fn resume(
        config: EpisodeConfig,
        start: StartRecord,
        steps: Vec<StepRecord>,
        snapshot: &Snapshot,
    ) -> Result<Episode, EpisodeError> {
        Self::resume_on(
            prepare_task(&config.scene, &config.task, &config.meshes)?,
            config,
            start,
            steps,
            snapshot,
        )
    }

    /// [`Episode::resume`] on a stage that is there already: that of the task and scene
    /// of `config`, by [`prepare_task`].
    ///
    /// # Errors
    /// When the snapshot is not one of the state after these steps.
    ///
    /// # Panics
    /// When it is the stage of another task or scene.
    pub fn resume_on(
        stage: Arc<PreparedTask>,
        config: EpisodeConfig,
        start: StartRecord,
        steps: Vec<StepRecord>,
        snapshot: &Snapshot,
    ) -> Result<Episode, EpisodeError> {
        check_stage(&stage, &config);
        let last = steps.last().map_or(&start.digests, |step| &step.digests);
        if last.state != snapshot.digest() {
            return Err(EpisodeError::SnapshotMismatch {
                steps: steps.len(),
                expected: last.state,
                found: snapshot.digest(),
            });
        }
        let simulator = Simulator::resume(stage, config.profile, config.seed, snapshot)?;
        let (mut rewarder, mut user) = observers(&config, &start);
        for step in &steps {
            // Its terms are in the record already; what counts is what the
            // rewarder remembers of it.
            let _ = rewarder.step(step);
            observe(&mut user, step);
        }
        let header = header(&config, simulator.stage());
        let graphs = simulator.graphs();
        let ended = steps
            .last()
            .and_then(|step| step.end_reason(config.profile));
        Ok(Episode {
            header,
            simulator,
            user,
            rewarder,
            graphs,
            start,
            steps,
            ended,
            config,
        })
    }

    /// Another future of a recorded episode: `config.parent` says of which, `start` and `steps` are
    /// its records up to the snapshot. They become the branch's own, linked anew under its header.
    /// `detail` is of the images to come.
    ///
    /// # Errors
    /// As [`Episode::resume`].
    pub fn branch(
        config: EpisodeConfig,
        start: StartRecord,
        steps: Vec<StepRecord>,
        snapshot: &Snapshot,
        detail: Detail,
    ) -> Result<Episode, EpisodeError> {
        let stage = prepare_task(&config.scene, &config.task, &config.meshes)?;
        Self::branch_on(stage, config, start, steps, snapshot, detail)
    }

    /// [`Episode::branch`] on a stage that is there already: that of the task and scene of
    /// `config`, by [`prepare_task`].
    ///
    /// # Errors
    /// As [`Episode::resume_on`].
    ///
    /// # Panics
    /// When it is the stage of another task or scene.
    pub fn branch_on(
        stage: Arc<PreparedTask>,
        config: EpisodeConfig,
        start: StartRecord,
        steps: Vec<StepRecord>,
        snapshot: &Snapshot,
        detail: Detail,
    ) -> Result<Episode, EpisodeError> {
        let mut episode = Self::resume_on(stage, config, start, steps, snapshot)?;
        episode.simulator.set_detail(detail);
        Ok(episode)
    }

    /// The state of the simulator after the last call, to go on from.
    pub fn snapshot(&self) -> Snapshot {
        self.simulator.snapshot()
    }

    /// Puts the episode aside: its records and a snapshot, without the engine and the last image.
    /// Its stage stays, shared with others of the task.
    pub fn suspend(self) -> Suspended {
        let (stage, snapshot) = (self.simulator.stage().clone(), self.snapshot());
        let Self {
            config,
            start,
            steps,
            graphs,
            ended,
            ..
        } = self;
        Suspended {
            stage,
            config,
            start,
            steps,
            graphs,
            snapshot,
            ended,
        }
    }

    /// The header of the trace.
    pub fn header(&self) -> &EpisodeHeader {
        &self.header
    }

    /// The task that the episode plays.
    pub fn task(&self) -> &Arc<Task> {
        &self.config.task
    }

    /// The scene that the episode plays in.
    pub fn scene(&self) -> &Arc<Scene> {
        &self.config.scene
    }

    /// The state before the first call.
    pub fn start_record(&self) -> &StartRecord {
        &self.start
    }

    /// The calls so far, and what came of them.
    pub fn steps(&self) -> &[StepRecord] {
        &self.steps
    }

    /// Both authorities' graphs after the last call.
    pub fn graphs(&self) -> &Graphs {
        &self.graphs
    }

    /// What the agent is told.
    pub fn briefing(&self) -> Briefing {
        Briefing::new(&self.config.task, &self.config.scene)
    }

    /// Takes one decision. After the end every call is an `episode_over`
    /// error that changes nothing.
    ///
    /// # Panics
    /// When the simulator breaks an invariant of its own: a programmer's error.
    pub fn step(&mut self, input: StepInput) -> StepOutput {
        let profile = self.config.profile;
        let parsed = profile.tool(&input.call);
        let (result, reply) = match &parsed {
            _ if self.ended.is_some() => {
                (ToolResult::new(ToolText::EpisodeOver.outcome(&[])), None)
            }
            _ if profile.is_published() && !is_runners(&parsed) && !says_no_call(&input) => {
                self.dispatch_published(&input)
            }
            Ok(tool) => self.dispatch(tool, &input),
            Err(_) if says_no_call(&input) => {
                (ToolResult::new(ToolText::NoCall.outcome(&[&NO_CALL])), None)
            }
            Err(error) => (refused(error.code(), &error.to_string()), None),
        };
        let graphs = self.simulator.graphs();
        let changes = GraphChanges {
            physics: graphs.physics.difference(&self.graphs.physics),
            registry: graphs.registry.difference(&self.graphs.registry),
        };
        self.graphs = graphs;
        let tool = parsed.ok();
        let mut record = StepRecord {
            step: u32::try_from(self.steps.len()).expect("an episode has few steps"),
            input,
            outcome: result.outcome,
            tool: tool.as_ref().map(|tool| tool.paper_name().to_owned()),
            reply,
            markers: self.simulator.markers().to_vec(),
            visible: self.simulator.visible(),
            listed: result.listed,
            object: result.object,
            receptacle: result.receptacle,
            held: self.simulator.held().cloned(),
            changes,
            bodies: self.simulator.bodies(),
            robot: self.simulator.robot(),
            sim_step: self.simulator.sim_step(),
            reward: Vec::new(),
            digests: digests(&mut self.simulator, result.frame.as_ref()),
        };
        if self.simulator.fault() {
            record.outcome = Outcome::error(
                ErrorCode::PhysicsFault,
                "The simulation failed; the episode ends.",
            );
        }
        record.reward = self.rewarder.step(&record);
        observe(&mut self.user, &record);
        self.check_invariants();
        self.steps.push(record.clone());
        self.ended = self.ended.or(record.end_reason(self.config.profile));
        StepOutput {
            record,
            frame: result.frame,
        }
    }

    /// Why the episode ended; none while it runs.
    pub fn ended(&self) -> Option<EndReason> {
        self.ended
    }

    /// The true state of the simulator, which no policy under evaluation may see.
    pub fn privileged(&self) -> Privileged<'_> {
        Privileged {
            task: &self.config.task,
            scene: &self.config.scene,
            graph: self.authority(),
            markers: self.simulator.markers(),
            held: self.simulator.held(),
            landmark: self.simulator.landmark(),
        }
    }

    /// The graph that counts: where physics says the objects are, and with the published servers
    /// where picks and places do.
    fn authority(&self) -> &WorldGraph {
        if self.config.profile.is_published() {
            &self.graphs.registry
        } else {
            &self.graphs.physics
        }
    }

    /// Keeps the motion states after one physics step of the next call
    /// (from 0); see [`Episode::take_watched`].
    pub fn watch(&mut self, physics_step: usize) {
        self.simulator.watch(physics_step);
    }

    /// The motion states after the watched physics step; none where it was not executed.
    pub fn take_watched(&mut self) -> Option<Vec<BodyState>> {
        self.simulator.take_watched()
    }

    /// Renders what the head sees after these physics steps of the episode in the next call; see
    /// [`Simulator::sample_motion`].
    pub fn sample_motion(&mut self, sim_steps: impl IntoIterator<Item = u64>) {
        self.simulator.sample_motion(sim_steps);
    }

    /// The samples of the last call; see [`Simulator::take_samples`].
    pub fn take_samples(&mut self) -> Vec<MotionSample> {
        self.simulator.take_samples()
    }

    /// What the robot's head sees.
    pub fn render_frame(&self) -> Frame {
        self.simulator.render_from(&self.simulator.camera())
    }

    /// The simulator, to look at.
    pub fn simulator(&self) -> &Simulator {
        &self.simulator
    }

    /// Closes the episode: final graphs and metrics. `Aborted` if it still runs.
    pub fn end(self) -> EndRecord {
        end(
            self.ended,
            &self.config,
            &self.start,
            &self.steps,
            self.graphs,
        )
    }

    /// What [`Self::end`] would give now, of an episode that stays.
    pub fn end_record(&self) -> EndRecord {
        let graphs = self.graphs.clone();
        end(self.ended, &self.config, &self.start, &self.steps, graphs)
    }

    /// A call of a published server, which reads the arguments itself.
    fn dispatch_published(&mut self, input: &StepInput) -> (ToolResult, Option<UserReply>) {
        let call = &input.call;
        if self.config.profile == Profile::RealRepo && call.name == "ask" {
            let answer = published_user::answer(call, &self.config.task, input.user_reply.as_ref());
            let reply = answer.as_deref().ok().and_then(ask_reply);
            return (self.simulator.answer_published("ask", answer), reply);
        }
        let noise = self.noise();
        (
            self.simulator.call_published(
                call,
                CallContext {
                    noise,
                    lookup: input.lookup.as_ref(),
                },
            ),
            None,
        )
    }

    /// The noise of the next call.
    fn noise(&self) -> ActuationNoise {
        let call = u32::try_from(self.steps.len()).expect("an episode has few steps");
        ActuationNoise::of(
            self.config.skills,
            self.config.seed,
            &self.config.task.task_id,
            call,
        )
    }

    fn dispatch(&mut self, tool: &Tool, input: &StepInput) -> (ToolResult, Option<UserReply>) {
        match tool {
            Tool::Ask { question } => {
                let reply = input
                    .user_reply
                    .clone()
                    .unwrap_or_else(|| self.user.answer(question));
                (said(reply.text.clone()), Some(reply))
            }
            Tool::Finish => (ToolResult::new(ToolText::Finished.outcome(&[])), None),
            Tool::Lifecycle(Lifecycle::ListTasks) => (
                said(serde_json::json!([self.config.task.task_id]).to_string()),
                None,
            ),
            Tool::Lifecycle(Lifecycle::FinishWithId { task_id }) => {
                let outcome = ToolText::OtherTask.outcome(&[task_id]);
                (ToolResult::new(outcome), None)
            }
            tool => {
                let noise = self.noise();
                (
                    self.simulator.call(
                        tool,
                        CallContext {
                            noise,
                            lookup: input.lookup.as_ref(),
                        },
                    ),
                    None,
                )
            }
        }
    }

    fn check_invariants(&self) {
        for graph in [&self.graphs.physics, &self.graphs.registry] {
            let moment = invariants::InvariantInput {
                scene: &self.config.scene,
                task: &self.config.task,
                graph,
                held: self.simulator.held(),
                markers: self.simulator.markers(),
            };
            if let Err(violation) = invariants::check(&moment) {
                panic!(
                    "task {}, seed {}: {violation}",
                    self.config.task.task_id, self.config.seed
                );
            }
        }
    }
}

/// Sets a task up, for [`Episode::start_on`].
///
/// # Errors
/// When the task plays in another scene, or cannot be played in this one.
pub fn prepare_task(
    scene: &Arc<Scene>,
    task: &Arc<Task>,
    meshes: &Meshes,
) -> Result<Arc<PreparedTask>, EpisodeError> {
    if task.scene_id == scene.scene_id {
        check_playable(scene, task).map_err(|problem| EpisodeError::Unplayable {
            task: task.task_id.clone(),
            problem,
        })?;
        return Ok(PreparedTask::with_meshes(
            scene.clone(),
            task.clone(),
            meshes.clone(),
        ));
    }
    let (wanted, given) = (task.scene_id.clone(), scene.scene_id.clone());
    Err(EpisodeError::SceneMismatch {
        task: task.task_id.clone(),
        expected: wanted,
        found: given,
    })
}

fn check_stage(stage: &PreparedTask, config: &EpisodeConfig) {
    let its = Arc::ptr_eq(stage.task(), &config.task)
        && Arc::ptr_eq(stage.scene(), &config.scene)
        && *stage.meshes() == config.meshes;
    assert!(
        its,
        "the stage of task {} was handed to task {}",
        stage.task().task_id,
        config.task.task_id
    );
}

/// Whether a call begins, ends or lists episodes, which is no tool's business.
fn is_runners(parsed: &Result<Tool, reel_world::CallError>) -> bool {
    match parsed {
        Ok(Tool::Finish) => true,
        Ok(Tool::Lifecycle(lifecycle)) => *lifecycle != Lifecycle::ListReceptacles,
        _ => false,
    }
}

/// Whether a policy said something that holds no call.
fn says_no_call(input: &StepInput) -> bool {
    input.call.name.is_empty()
        && input
            .policy
            .as_ref()
            .is_some_and(|policy| !policy.raw.is_empty())
}

fn said(text: impl Into<String>) -> ToolResult {
    ToolResult::new(Outcome::ok(text))
}

fn refused(code: ErrorCode, text: &str) -> ToolResult {
    ToolResult::new(Outcome::error(code, text))
}
