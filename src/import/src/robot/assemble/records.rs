//! The records of an episode whose events are put together: its task, what came of each call, its
//! rewards and metrics, and the poses in the frame of the scene.

use std::path::Path;

use reel_reward::{Preset, metrics, open_reward, rewards};
use reel_trace::{
    Timing,
    robot::{Odometry, RobotLog},
};
use reel_world::{
    Digest, ErrorCode, FrameDigests, Outcome, Scene, Task, Tool,
    record::{
        Backend, EndReason, EndRecord, EpisodeHeader, PolicyInfo, Reported, RobotState,
        StartRecord, StepInput, StepRecord, UserReply, UserSource,
    },
};
use serde_json::json;

use super::{EpisodeBuilder, ImageLocation, PoseSample, Step, is_tool};
use crate::{
    ImportOptions, ObservedState, observe,
    observe::CallObservation,
    outcome,
    robot::{
        align::MapAlignment,
        event::SensorEvent,
        mapping::Mapping,
        trajectory::{INTERVAL_M, TrajectoryError},
    },
    same_graph_for_both,
    task::{self, ObservedWorld, TaskSetup},
};

/// What a step without a result says.
const NO_RESULT: &str = "no result of this call was recorded";

/// An episode ready to be recorded.
pub(crate) struct AssembledEpisode {
    pub header: EpisodeHeader,
    pub task: Task,
    pub scene: Scene,
    pub start: StartRecord,
    pub start_image: Option<ImageLocation>,
    pub steps: Vec<(StepRecord, Option<Timing>, Option<ImageLocation>)>,
    pub log: RobotLog,
    /// What the trace keeps as it came, and when it was recorded, in the order of time.
    pub sensors: Vec<(u64, SensorEvent)>,
    /// When the episode began, in nanoseconds since 1970.
    pub began_ns: u64,
    pub end: EndRecord,
    /// What the recording leaves open, and how it was decided.
    pub notes: Vec<String>,
}

impl EpisodeBuilder {
    /// When its first call was made; where there is none, when the first of its sensors spoke.
    fn began_ns(&self) -> u64 {
        let called = self.steps.first().and_then(|step| step.called_ns);
        let sensed = || self.sensors.first().map(|(ns, _)| *ns);
        called.or_else(sensed).unwrap_or_default()
    }

    /// Compares odometry and reference, where the recording has both.
    fn trajectory_error(
        &self,
        mapping: &Mapping,
        notes: &mut Vec<String>,
    ) -> Option<TrajectoryError> {
        let reference: Vec<Odometry> = self
            .sensors
            .iter()
            .filter_map(|(_, kept)| kept.reference)
            .collect();
        if reference.is_empty() || self.log.odometry.is_empty() {
            return None;
        }
        let interval_m = mapping.rpe_interval_m.unwrap_or(INTERVAL_M);
        let error = TrajectoryError::of(&self.log.odometry, &reference, interval_m);
        notes.push(error.as_ref().map_or_else(
            || "odometry and reference have no two poses at the same time".to_owned(),
            TrajectoryError::note,
        ));
        error
    }

    /// Makes the records. `frame` tells the digests of an image, if there is one at a place.
    pub(crate) fn finish(
        mut self,
        mapping: &Mapping,
        options: &ImportOptions<'_>,
        (path, lost): (&Path, &[&str]),
        frame: &dyn Fn(ImageLocation) -> Option<FrameDigests>,
    ) -> AssembledEpisode {
        let mut notes = Vec::new();
        let (
            TaskSetup {
                task,
                scene,
                mut settings,
            },
            known,
        ) = self.setting(options, path, &mut notes);
        if let Some(error) = self.trajectory_error(mapping, &mut notes) {
            settings.insert("trajectory_error".to_owned(), error.settings());
        }
        if !lost.is_empty() {
            settings.insert("losses".to_owned(), json!(lost));
        }
        let began_ns = self.began_ns();
        if let Some(map) = self.map.take() {
            match MapAlignment::of(&map, &scene) {
                Ok(alignment) => {
                    let fits = alignment.check(mapping.map_error_max_m);
                    settings.insert("map_alignment".to_owned(), alignment.settings(fits.is_ok()));
                    match fits {
                        Ok(()) => {
                            self.align(&alignment);
                            notes.push(alignment.note());
                        }
                        Err(problem) => notes.push(problem),
                    }
                }
                Err(why) => notes.push(format!("{why}; poses stay in the robot's frame")),
            }
        }
        let reason = self.reason(&mut notes);
        let ended = self.ended.as_deref();
        let told_success = ended.and_then(|told| told.success);

        let initial = self
            .first
            .clone()
            .or_else(|| known.then(|| task.initial.clone()));
        let mut before = ObservedState {
            graph: initial.clone(),
            ..ObservedState::default()
        };
        let start_place = self.start.image;
        let mut start = StartRecord {
            graphs: initial
                .as_ref()
                .map(same_graph_for_both)
                .unwrap_or_default(),
            robot: robot(&mut before, &self.start),
            shortest_path_m: self
                .told
                .shortest_path_m
                .or_else(|| ended.and_then(|told| told.shortest_path_m)),
            ..StartRecord::default()
        };
        start.digests.frame = start_place.and_then(frame);
        let mut steps = Vec::new();
        for (number, step) in (0..).zip(self.steps) {
            let mut after = ObservedState {
                graph: step.state.graph.clone().or_else(|| before.graph.clone()),
                ..step.state.clone()
            };
            let robot = robot(&mut after, &step.moment);
            let timing = step.timing();
            let image = step.moment.image;
            let skill = step.skill;
            let shown = step.shown(image.and_then(frame));
            let mut record = observe::record(number, shown, &before, &after);
            record.robot = robot;
            record.tool = record.tool.or(skill.map(str::to_owned));
            steps.push((record, timing, image));
            before = after;
        }

        let preset = Preset::default();
        let mut records: Vec<StepRecord> =
            steps.iter().map(|(record, ..)| record.clone()).collect();
        let terms = rewards(&preset, &task, &scene, &start, &records);
        for (record, terms) in records.iter_mut().zip(terms) {
            record.reward = terms;
        }
        let open = open_reward(&preset, options.tasks, &task, &scene, &start, &records);
        notes.extend(open.map(|open| open.to_string()));
        let policy = self
            .told
            .policy
            .or_else(|| ended.and_then(|told| told.policy.clone()))
            .or_else(|| mapping.policy.clone());
        let mut header = EpisodeHeader {
            run_id: options.run_id.to_owned(),
            reward_preset: preset.name().to_owned(),
            policy: PolicyInfo {
                name: policy.unwrap_or_else(|| "unknown".to_owned()),
                checkpoint: None,
                parameters: settings,
            },
            backend: Backend::Robot,
            ..observe::header(&task, &scene)
        };
        // Many trials of a skill have equal records; what was measured and when tells them apart.
        let times: Vec<&Option<Timing>> = steps.iter().map(|(_, timing, _)| timing).collect();
        header.episode_id = Digest::of_json(&(&header, &start, &records, times, &self.log))
            .to_string()[..16]
            .to_owned();
        header.build = env!("CARGO_PKG_VERSION").to_owned();

        let graphs = before
            .graph
            .as_ref()
            .map(same_graph_for_both)
            .unwrap_or_default();
        let judged = match told_success {
            // Nothing shows how the world was left: the word of the recording counts.
            Some(success) if self.first.is_none() || !known => {
                notes.push(format!(
                    "success is what the recording says ({success}); no graph and goal tell it"
                ));
                same_graph_for_both(if success { &task.goal } else { &task.initial })
            }
            Some(_) => graphs.clone(),
            None => {
                if self.first.is_none() || !known {
                    let counts = if task.has_goal() {
                        "; it counts as a failure"
                    } else {
                        ""
                    };
                    notes.push(format!(
                        "the recording does not say whether the episode succeeded{counts}"
                    ));
                }
                graphs.clone()
            }
        };
        let metrics = metrics(&preset, &task, &start, &records, &judged);
        if task.has_goal() && told_success.is_some_and(|told| told != metrics.success) {
            notes.push(format!(
                "the recording says success {}, the graphs {}",
                !metrics.success, metrics.success
            ));
        }
        let end = EndRecord {
            reason,
            graphs,
            metrics,
            steps: records.len() as u32,
            reported: Reported {
                success: told_success,
                ..Reported::default()
            },
        };
        let steps = records
            .into_iter()
            .zip(steps)
            .map(|(record, (_, timing, image))| (record, timing, image))
            .collect();
        AssembledEpisode {
            header,
            task,
            scene,
            start,
            start_image: start_place,
            steps,
            log: self.log,
            sensors: self.sensors,
            began_ns,
            end,
            notes,
        }
    }

    /// Brings every pose into the frame of the scene.
    fn align(&mut self, alignment: &MapAlignment) {
        let steps = self.steps.iter_mut().map(|step| &mut step.moment.pose);
        let poses = steps.chain([&mut self.start.pose]).flatten();
        for pose in poses.chain(&mut self.log.odometry) {
            *pose = alignment.pose(*pose);
        }
    }

    /// Its task: of the files given, else of its messages, else none; and whether it is known.
    fn setting(
        &self,
        options: &ImportOptions<'_>,
        path: &Path,
        notes: &mut Vec<String>,
    ) -> (TaskSetup, bool) {
        let mut meta = self.told.meta.clone();
        for (key, value) in self.ended.iter().flat_map(|told| &told.meta) {
            meta.entry(key).or_insert_with(|| value.clone());
        }
        let mut seen = ObservedWorld {
            first: self.first.clone(),
            ..ObservedWorld::default()
        };
        for graph in self.first.iter().chain(
            self.steps
                .iter()
                .filter_map(|step| step.state.graph.as_ref()),
        ) {
            seen.take_in(graph);
        }
        // A single task that was given is that of episodes that name none.
        if let (None, [task]) = (task::text(&meta, "benchmark_task_id"), options.tasks) {
            meta.insert("benchmark_task_id".to_owned(), task.task_id.clone().into());
        }
        let mut told = task::TaskSource {
            meta: &meta,
            folders: [None, None],
            path,
            notes: Vec::new(),
        };
        let setting = task::setting(&mut told, &seen, options);
        notes.append(&mut told.notes);
        match setting {
            Ok(setting) => (setting, true),
            Err(_) => {
                notes.push("the task is not known; give its task file with --tasks".to_owned());
                (
                    task::unknown(&told, self.first.clone().unwrap_or_default()),
                    false,
                )
            }
        }
    }

    /// Why it ended: as its message says, else as its calls do.
    fn reason(&self, notes: &mut Vec<String>) -> EndReason {
        let told = self.ended.as_deref();
        let word = told
            .and_then(|told| told.reason.as_deref())
            .map(str::to_lowercase);
        match word.as_deref() {
            Some("finished" | "finish" | "done" | "success" | "succeeded" | "completed") => {
                EndReason::Finished
            }
            Some("horizon" | "max_steps" | "max_steps_reached" | "timeout") => EndReason::Horizon,
            Some("fault" | "error" | "inference_error" | "action_error") => EndReason::Fault,
            Some("aborted" | "abort" | "stopped" | "interrupted" | "cancelled") => {
                EndReason::Aborted
            }
            _ if self.finished => EndReason::Finished,
            Some(other) => {
                notes.push(format!(
                    "the reason of the end is '{other}'; taken as broken off"
                ));
                EndReason::Aborted
            }
            // Somebody looked at how it went.
            None if told.is_some_and(|told| told.success.is_some()) => EndReason::Finished,
            None => {
                notes.push(
                    "nothing says how the episode ended; it is taken as broken off".to_owned(),
                );
                EndReason::Aborted
            }
        }
    }
}

impl Step {
    fn timing(&self) -> Option<Timing> {
        let (called, (answered, _)) = (self.called_ns?, self.answer.as_ref()?);
        Some(Timing {
            called_unix_ns: called,
            took_ns: answered.saturating_sub(called),
        })
    }

    fn shown(self, frame: Option<FrameDigests>) -> CallObservation {
        let tool = Tool::parse(&self.call).ok();
        let outcome = self.outcome(tool.as_ref());
        let asks = is_tool(&self.call, "ask");
        // An answer of which nobody says from whom it is came from a person: this is no simulation.
        let of_result = || {
            outcome::reply(tool.as_ref(), &outcome).map(|reply| UserReply {
                source: UserSource::Human,
                ..reply
            })
        };
        let reply = self.reply.filter(|_| asks).or_else(of_result);
        let input = StepInput {
            policy: self.policy,
            user_reply: reply.clone(),
            ..StepInput::from_call(self.call)
        };
        CallObservation {
            input,
            tool,
            outcome,
            reply,
            frame,
        }
    }

    /// What the call came to. An error code of Reel's is taken, and so are the published server's
    /// words; else what moves the robot failed by its skill.
    fn outcome(&self, tool: Option<&Tool>) -> Outcome {
        let Some((_, answer)) = &self.answer else {
            return match &self.reply {
                Some(reply) if is_tool(&self.call, "ask") => Outcome::ok(reply.text.clone()),
                _ if is_tool(&self.call, "finish") => Outcome::ok(""),
                _ => Outcome::error(ErrorCode::BackendError, NO_RESULT),
            };
        };
        let tool = tool.map(Tool::paper_name).or(self.skill);
        let told = || {
            ErrorCode::from_message(&answer.text).filter(|_| tool.is_some_and(|tool| tool != "ask"))
        };
        let failed = answer.error.is_some() || answer.success == Some(false);
        if !failed {
            let error = if answer.success.is_none() {
                told()
            } else {
                None
            };
            return Outcome {
                text: answer.text.clone(),
                error,
            };
        }
        let named = answer.error.as_deref().unwrap_or_default();
        let moves = matches!(
            tool,
            Some("nav_to" | "walk_around" | "gaze_at" | "pick" | "place" | "open" | "close")
        );
        let otherwise = if moves || self.skill.is_some() {
            ErrorCode::SkillFailed
        } else {
            ErrorCode::BackendError
        };
        let code =
            ErrorCode::parse(named).or_else(|| told().or_else(|| ErrorCode::from_message(named)));
        let text = [answer.text.as_str(), named, "the call failed"]
            .into_iter()
            .find(|text| !text.is_empty());
        Outcome::error(code.unwrap_or(otherwise), text.unwrap_or_default())
    }
}

/// The robot at a moment; the state learns its position.
fn robot(state: &mut ObservedState, moment: &PoseSample) -> RobotState {
    state.position = moment.pose.map(|pose| [pose.x as f32, pose.y as f32, 0.0]);
    let yaw = moment.pose.map_or(0.0, |pose| pose.yaw as f32);
    RobotState {
        yaw,
        path_length_m: moment.path_m as f32,
        ..state.robot()
    }
}
