//! The episodes of one session as records: when one begins and ends, what a call and its result
//! become, and the trace that is written meanwhile. Knows no transport.

use std::{collections::BTreeMap, path::PathBuf, sync::Arc};

use reel_import::{
    CallObservation, ObservedState, StartedEpisode, TaskSetup, same_graph_for_both, unknown_task,
};
use reel_redact::Redactions;
use reel_reward::{OpenReward, Rewarder, metrics, open_reward};
use reel_trace::{AnsweredRequest, Recorder, Timing, TraceError};
use reel_world::{
    Digest, ErrorCode, Lifecycle, Outcome, Scene, Task, Tool, ToolCall, ToolText,
    record::{
        EndReason, EndRecord, EpisodeHeader, PolicyInfo, PolicyOutput, Reported, StartRecord,
        StepInput, StepRecord,
    },
};
use serde_json::{Map, Value, json};

use crate::{ProxyEvent, Setup, image::Image, tap::ToolResultContent};

/// What is not known: a task, a scene.
const UNKNOWN: &str = "unknown";

/// The episodes of one session.
pub(crate) struct Episodes {
    setup: Arc<Setup>,
    session: String,
    policy: String,
    /// How many were begun.
    begun: u32,
    /// Calls that went by unrecorded since the last episode began.
    unrecorded: u32,
    /// The server's list of tools, if the agent asked for it.
    tools: Option<String>,
    /// How many secrets were replaced in the policy's name, and in the list of tools.
    redacted: [Redactions; 2],
    now: Now,
}

enum Now {
    Nothing,
    Playing(Box<Playing>),
    /// The recording of an episode broke off, and why.
    Broken(String),
}

struct Playing {
    recorder: Recorder,
    path: PathBuf,
    task: Task,
    scene: Scene,
    start: StartRecord,
    rewarder: Box<dyn Rewarder>,
    state: ObservedState,
    steps: Vec<StepRecord>,
    /// The input that is written and not answered, and how many secrets were replaced in it.
    under_way: Option<(StepInput, Redactions)>,
}

/// An episode whose trace is whole.
struct EndedEpisode {
    path: PathBuf,
    end: EndRecord,
    /// Whether it succeeded, where the task says what that is.
    success: Option<bool>,
    open: Option<OpenReward>,
}

/// What a call is to the recording.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    /// A decision of the episode: its input is written.
    Step,
    /// A tool around episodes: it may begin one.
    Session,
}

/// Why something could not be recorded.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct RecordingError(pub String);

impl From<TraceError> for RecordingError {
    fn from(error: TraceError) -> Self {
        RecordingError(error.to_string())
    }
}

impl Episodes {
    pub(crate) fn new(setup: Arc<Setup>, session: String) -> Self {
        let policy = setup.policy.clone().unwrap_or_else(|| "agent".to_owned());
        Self {
            setup,
            session,
            policy,
            begun: 0,
            unrecorded: 0,
            tools: None,
            redacted: <[Redactions; 2]>::default(),
            now: Now::Nothing,
        }
    }

    /// Who plays from the next episode on, where the command does not say it.
    pub(crate) fn set_policy(&mut self, name: &str, redacted: Redactions) {
        if self.setup.policy.is_none() {
            self.redacted[0] = redacted;
            self.policy = name
                .chars()
                .filter(|letter| !letter.is_control())
                .take(64)
                .collect();
        }
    }

    /// Keeps the server's list of tools for the episodes that begin from now on.
    pub(crate) fn set_tools(&mut self, tools: String, redacted: Redactions) {
        self.tools = Some(tools);
        self.redacted[1] = redacted;
    }

    /// Notes that a call goes by unrecorded.
    pub(crate) fn missed(&mut self) {
        self.unrecorded += 1;
    }

    /// Takes a call, before it is passed on: writes it down where it is a decision. `thought_ns` is
    /// how long the agent took, `redacted` how many secrets were replaced in it.
    pub(crate) fn called(
        &mut self,
        call: &ToolCall,
        thought_ns: Option<u64>,
        redacted: Redactions,
    ) -> Result<Kind, RecordingError> {
        let ours = self
            .setup
            .mapping
            .as_ref()
            .and_then(|mapping| mapping.call(call));
        // The call as it came is kept where another stands for it.
        let raw = ours
            .as_ref()
            .map(|_| json!({"name": call.name, "arguments": call.arguments}).to_string())
            .unwrap_or_default();
        let call = ours.unwrap_or_else(|| call.clone());
        let begins = match Tool::parse(&call) {
            Ok(Tool::Lifecycle(Lifecycle::FinishWithId { .. } | Lifecycle::ListTasks)) => true,
            // A tool like others of the published servers, while an episode runs.
            Ok(Tool::Lifecycle(Lifecycle::ListReceptacles)) => {
                !self.setup.profile.is_published() || matches!(self.now, Now::Nothing)
            }
            Ok(Tool::Finish) => !matches!(self.now, Now::Playing(_)),
            _ => false,
        };
        if begins {
            return Ok(Kind::Session);
        }
        if let Now::Broken(why) = &self.now {
            return Err(RecordingError(why.clone()));
        }
        if matches!(self.now, Now::Nothing) {
            let begun = self.generic();
            // Nothing has happened yet: the next call may try again.
            self.begin(begun, None, &ToolResultContent::default())
                .inspect_err(|_| self.now = Now::Nothing)?;
        }
        let policy = PolicyOutput {
            raw,
            latency_ns: thought_ns,
            ..PolicyOutput::default()
        };
        let policy = Some(policy).filter(|policy| *policy != PolicyOutput::default());
        let input = StepInput {
            policy,
            ..StepInput::from_call(call)
        };
        let Now::Playing(playing) = &mut self.now else {
            return Err(RecordingError("no episode runs".to_owned()));
        };
        let step = playing.next();
        if let Err(error) = playing.recorder.input(step, &input) {
            return Err(self.broke(error));
        }
        playing.under_way = Some((input, redacted));
        Ok(Kind::Step)
    }

    /// Takes a result, before it is passed on: writes down what the call came to, ends the episode
    /// where it was a `finish`, and begins one where the result tells a task.
    pub(crate) fn answered(
        &mut self,
        kind: &Kind,
        answer: ToolResultContent,
        timing: Timing,
    ) -> Result<(), RecordingError> {
        let mut answer = answer;
        let payload = answer.payload();
        let debug_info = answer
            .texts
            .iter_mut()
            .filter_map(reel_import::cut_debug_info)
            .last();
        let image = self.image(&mut answer);
        let mut ends = None;
        if *kind == Kind::Step {
            let tells_another = payload.is_some();
            let image = image.as_ref().filter(|_| !tells_another);
            ends = self.step(&answer, debug_info.as_ref(), tells_another, image, timing)?;
        }
        if payload.is_some() || ends.is_some() {
            // Whatever ran is over: the server plays something else now.
            self.end(ends.unwrap_or(EndReason::Aborted));
        }
        let Some(payload) = payload else {
            return Ok(());
        };
        let begun = self.told(&payload, &debug_info.unwrap_or_default());
        self.begin(begun, image.as_ref(), &answer)
    }

    /// Ends the episode that runs, if one does. Every step of it is on disk; making its trace of
    /// that takes longer than anybody should wait.
    pub(crate) fn end(&mut self, reason: EndReason) {
        let Now::Playing(playing) = std::mem::replace(&mut self.now, Now::Nothing) else {
            return;
        };
        let (setup, session) = (self.setup.clone(), self.session.clone());
        self.setup
            .endings
            .add(move || match playing.end(&setup, reason) {
                Ok(ended) => setup.emit(ProxyEvent::Ended {
                    session: &session,
                    path: &ended.path,
                    end: &ended.end,
                    success: ended.success,
                    open: ended.open.as_ref(),
                }),
                Err(RecordingError(why)) => setup.emit(ProxyEvent::RecordingFailed {
                    session: &session,
                    problem: &why,
                }),
            });
    }

    /// Gives the recording up; what is written stays in the unfinished recording.
    fn broke(&mut self, error: TraceError) -> RecordingError {
        let trouble = RecordingError::from(error);
        self.now = Now::Broken(trouble.0.clone());
        trouble
    }

    /// Writes a step; says why the episode ends with it, if it does.
    fn step(
        &mut self,
        answer: &ToolResultContent,
        debug_info: Option<&Map<String, Value>>,
        tells_another: bool,
        image: Option<&Image>,
        timing: Timing,
    ) -> Result<Option<EndReason>, RecordingError> {
        let mapping = self.setup.mapping.as_ref();
        let Now::Playing(playing) = &mut self.now else {
            return Ok(None);
        };
        let Some((input, mut redacted)) = playing.under_way.take() else {
            return Ok(None);
        };
        let mapped = mapping
            .map(|mapping| mapping.state(answer.structured.as_ref(), &answer.texts))
            .unwrap_or_default();
        let told =
            mapping.and_then(|mapping| mapping.error(answer.structured.as_ref(), &answer.texts));
        // What a `finish` that tells the next task shows is not of this episode any more.
        let shown = match debug_info {
            _ if tells_another => Map::new(),
            Some(debug_info) => debug_info.clone(),
            None => mapped,
        };
        let after = playing.state.after(&shown);
        let marked = after
            .markers
            .as_ref()
            .map(Vec::len)
            .filter(|_| shown.contains_key("CURRENT_MARKER_MAP"));
        let tool = Tool::parse(&input.call).ok();
        let outcome = match told {
            _ if tells_another => Outcome::ok(""),
            Some(error) => failed(&error, answer),
            None => outcome(
                &input.call,
                tool.as_ref(),
                answer,
                debug_info.is_some(),
                marked,
            ),
        };
        let reply = reel_import::reply(tool.as_ref(), &outcome);
        let shown = CallObservation {
            input,
            tool,
            outcome,
            reply,
            frame: image.and_then(Image::digests),
        };
        let mut record = reel_import::record(playing.next(), shown, &playing.state, &after);
        record.reward = playing.rewarder.step(&record);
        let recorder = &mut playing.recorder;
        let as_it_came = answer.answer.as_deref();
        let request = AnsweredRequest::Step(record.step);
        add(&mut redacted, &answer.redacted);
        let written = recorder
            .timing(record.step, &timing)
            .and_then(|()| as_it_came.map_or(Ok(()), |json| recorder.mcp_answer(request, json)))
            .and_then(|()| count(&self.setup, recorder, Some(record.step), &redacted))
            .and_then(|()| match image {
                Some(Image::AsItCame(png)) => recorder.step_with_base64(&record, png),
                Some(Image::Fitted(original, frame)) => {
                    recorder.original(Some(record.step), original)?;
                    recorder.step(&record, Some(frame))
                }
                None => recorder.step(&record, None),
            });
        if let Err(error) = written {
            return Err(self.broke(error));
        }
        self.setup.emit(ProxyEvent::Step {
            session: &self.session,
            record: &record,
            timing,
        });
        let finished = record.tool.as_deref() == Some("finish");
        playing.state = after;
        playing.steps.push(record);
        Ok(finished.then_some(EndReason::Finished))
    }

    /// The last image of an answer, as a trace takes it.
    fn image(&self, answer: &mut ToolResultContent) -> Option<Image> {
        let (kind, data) = answer.images.pop()?;
        Image::of(data)
            .inspect_err(|why| {
                let why = format!("{why}; the server calls it {kind:?}");
                self.setup.emit(ProxyEvent::ImageOmitted {
                    session: &self.session,
                    why: &why,
                });
            })
            .ok()
    }

    /// Opens the recording of an episode.
    fn begin(
        &mut self,
        begun: StartedEpisode,
        image: Option<&Image>,
        answer: &ToolResultContent,
    ) -> Result<(), RecordingError> {
        let StartedEpisode {
            setting:
                TaskSetup {
                    task,
                    scene,
                    settings,
                },
            state,
            notes,
        } = begun;
        let (path, before) = self.path(&task);
        let setup = &self.setup;
        let mut parameters: BTreeMap<String, Value> = settings;
        parameters.insert("session".to_owned(), json!(self.session));
        parameters.insert("number".to_owned(), json!(self.begun));
        parameters.insert("redaction".to_owned(), json!(setup.rules.source().name()));
        for (key, count) in [("before", before), ("unrecorded_before", self.unrecorded)] {
            if count > 0 {
                parameters.insert(key.to_owned(), json!(count));
            }
        }
        let mut header = EpisodeHeader {
            run_id: setup.run.clone(),
            profile: setup.profile,
            reward_preset: setup.preset.name().to_owned(),
            policy: PolicyInfo {
                name: self.policy.clone(),
                checkpoint: None,
                parameters,
            },
            backend: setup.backend,
            ..reel_import::header(&task, &scene)
        };
        let mut start = StartRecord {
            graphs: state
                .graph
                .as_ref()
                .map(same_graph_for_both)
                .unwrap_or_default(),
            robot: state.robot(),
            ..StartRecord::default()
        };
        start.digests.frame = image.and_then(Image::digests);
        header.episode_id = Digest::of_json(&(&header, &start)).to_string()[..16].to_owned();
        header.build = env!("CARGO_PKG_VERSION").to_owned();
        let mut rewarder = setup.preset.rewarder(&task, &scene);
        rewarder.start(&start);
        let before = [
            (AnsweredRequest::ToolList, self.tools.as_deref()),
            (AnsweredRequest::Start, answer.answer.as_deref()),
        ];
        let mut redacted = answer.redacted.clone();
        self.redacted
            .iter()
            .for_each(|more| add(&mut redacted, more));
        let written = Recorder::create(&path, &header, &task, &scene, setup.options).and_then(
            |mut recorder| {
                for (request, json) in before {
                    json.map_or(Ok(()), |json| recorder.mcp_answer(request, json))?;
                }
                count(setup, &mut recorder, None, &redacted)?;
                let started = match image {
                    Some(Image::AsItCame(png)) => recorder.start_with_base64(&start, png),
                    Some(Image::Fitted(original, frame)) => {
                        recorder.original(None, original)?;
                        recorder.start(&start, Some(frame))
                    }
                    None => recorder.start(&start, None),
                };
                started.map(|()| recorder)
            },
        );
        let recorder = match written {
            Ok(recorder) => recorder,
            Err(error) => return Err(self.broke(error)),
        };
        setup.emit(ProxyEvent::Began {
            session: &self.session,
            task: &task,
            path: &path,
            notes: &notes,
        });
        self.begun += 1;
        self.unrecorded = 0;
        let playing = Playing {
            recorder,
            path,
            task,
            scene,
            start,
            rewarder,
            state,
            steps: Vec::new(),
            under_way: None,
        };
        self.now = Now::Playing(Box::new(playing));
        Ok(())
    }

    /// Where the episode is recorded, under a name that no trace and no recording has; and how many
    /// of its name there were before.
    fn path(&self, task: &Task) -> (PathBuf, u32) {
        let safe = |letter: char| !letter.is_ascii_alphanumeric() && !"-_.".contains(letter);
        let task: String = task.task_id.replace(safe, "_").chars().take(80).collect();
        let name = format!(
            "{}--{}--{:04}--{task}",
            self.setup.run, self.session, self.begun
        );
        let path = |before: u32| match before {
            0 => self.setup.out.join(format!("{name}.mcap")),
            _ => self.setup.out.join(format!("{name}--{before}.mcap")),
        };
        let taken = |path: &PathBuf| path.exists() || path.with_added_extension("part").exists();
        let mut names = (0..).map(|before| (path(before), before));
        names
            .find(|(path, _)| !taken(path))
            .expect("there is always a further number")
    }

    /// The episode that the published server's payload begins.
    fn told(
        &self,
        payload: &Map<String, Value>,
        debug_info: &Map<String, Value>,
    ) -> StartedEpisode {
        let options = reel_import::ImportOptions {
            run_id: &self.setup.run,
            tasks: &self.setup.tasks,
            scenes: Some(&self.setup.scenes),
        };
        reel_import::started_episode(payload, debug_info, &options).unwrap_or_else(|error| {
            let of = |key: &str| {
                payload
                    .get(key)
                    .and_then(Value::as_str)
                    .unwrap_or(UNKNOWN)
                    .to_owned()
            };
            let state = ObservedState::default().after(debug_info);
            let mut begun = unknown(of("task_id"), of("task_description"), of("scene_id"), state);
            begun.notes.push(error.to_string());
            begun
        })
    }

    /// The episode of a server that tells no task: the only one that was given, or one of
    /// which nothing is known.
    fn generic(&self) -> StartedEpisode {
        let single = match &self.setup.tasks[..] {
            [task] => self.setup.scenes.of(task).map(|scene| (task, scene)),
            _ => None,
        };
        match single {
            Some((task, scene)) => StartedEpisode {
                state: ObservedState {
                    graph: Some(task.initial.clone()),
                    ..ObservedState::default()
                },
                setting: TaskSetup {
                    task: Task::clone(task),
                    scene: Scene::clone(scene),
                    settings: BTreeMap::new(),
                },
                notes: Vec::new(),
            },
            _ => unknown(
                UNKNOWN.to_owned(),
                String::new(),
                UNKNOWN.to_owned(),
                ObservedState::default(),
            ),
        }
    }
}

fn add(sum: &mut Redactions, more: &Redactions) {
    for (rule, count) in more {
        *sum.entry(rule.clone()).or_default() += count;
    }
}

/// Writes how many secrets were replaced of a moment, if any.
fn count(
    setup: &Setup,
    recorder: &mut Recorder,
    step: Option<u32>,
    redacted: &Redactions,
) -> Result<(), TraceError> {
    if redacted.is_empty() {
        return Ok(());
    }
    let sum: u64 = redacted.values().sum();
    setup.report.count(|counts| counts.redacted += sum);
    recorder.redacted(step, redacted)
}

impl Playing {
    fn next(&self) -> u32 {
        u32::try_from(self.steps.len()).expect("an episode has few steps")
    }

    fn end(self, setup: &Setup, reason: EndReason) -> Result<EndedEpisode, RecordingError> {
        let graphs = self
            .state
            .graph
            .as_ref()
            .map(same_graph_for_both)
            .unwrap_or_default();
        let (preset, task) = (&setup.preset, &self.task);
        let metrics = metrics(preset, task, &self.start, &self.steps, &graphs);
        let (known, scene) = (&setup.tasks, &self.scene);
        let open = open_reward(preset, known, task, scene, &self.start, &self.steps);
        let steps = self.next();
        let end = EndRecord {
            reason,
            graphs,
            metrics,
            steps,
            reported: Reported::default(),
        };
        self.recorder.end(&end)?;
        Ok(EndedEpisode {
            path: self.path,
            success: end.success(&self.task),
            end,
            open,
        })
    }
}

/// What a call came to. The published server says success with an image alone, so that words of
/// its tools are failures; others say with `isError` what is one.
fn outcome(
    call: &ToolCall,
    tool: Option<&Tool>,
    answer: &ToolResultContent,
    published: bool,
    marked: Option<usize>,
) -> Outcome {
    let texts: Vec<&str> = answer
        .texts
        .iter()
        .map(String::as_str)
        .filter(|text| !text.is_empty())
        .collect();
    let text = texts.join("\n");
    if published || ToolText::Exception.begins(&text) {
        return reel_import::outcome(
            call,
            tool,
            Some(text.as_str()).filter(|text| !text.is_empty()),
            marked,
        );
    }
    if answer.failed {
        return failed(&text, answer);
    }
    Outcome {
        error: tool.and_then(|_| ErrorCode::from_message(&text)),
        text,
    }
}

fn failed(why: &str, answer: &ToolResultContent) -> Outcome {
    let text = if answer.texts.is_empty() {
        why.to_owned()
    } else {
        answer.texts.join("\n")
    };
    let code = ErrorCode::parse(why)
        .or_else(|| ErrorCode::from_message(&text))
        .unwrap_or(ErrorCode::BackendError);
    Outcome::error(code, text)
}

/// The episode of which nothing is known but, perhaps, its words.
fn unknown(
    task_id: String,
    instruction: String,
    scene_id: String,
    state: ObservedState,
) -> StartedEpisode {
    let setting = unknown_task(
        task_id,
        instruction,
        scene_id,
        state.graph.clone().unwrap_or_default(),
    );
    StartedEpisode {
        setting,
        state,
        notes: vec!["the task is not known".to_owned()],
    }
}
