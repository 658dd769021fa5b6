//! One episode, from its file on: what was asked of it is answered by executing it.

use std::{collections::BTreeMap, path::Path};

use reel_episode::Episode;
use reel_replay::{Detail, Fork, Replay, Verdict, Viewpoint};
use reel_sim::{SIM_VERSION, Snapshot};
use reel_trace::{Limits, Trace};
use reel_world::{
    Digest, FRAME_HEIGHT, FRAME_WIDTH, Frame, ReceptacleId, ToolCall, ToolSpec,
    record::{EndReason, EndRecord, EpisodeHeader, PolicyInfo, StepInput, StepRecord},
};
use serde::{Deserialize, Serialize};

/// What can be asked of a session. `at` counts calls: 0 is before the first.
#[derive(Clone, Debug, Deserialize)]
#[serde(tag = "request", rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Reads the trace in the bytes. A session reads one.
    Open {
        /// Name of the file, for messages.
        name: String,
    },
    /// Executes the next call again and compares it with its record, the start and the images of
    /// the file first.
    Verify,
    /// Draws what is seen after `at` calls, by executing the episode to there.
    View {
        /// How many calls came before.
        at: usize,
        /// From where.
        camera: Camera,
    },
    /// Begins another future after `at` calls; the one of before is forgotten.
    Branch {
        /// How many calls came before.
        at: usize,
    },
    /// Makes a call in the other future.
    Act {
        /// The call.
        call: ToolCall,
    },
    /// Draws the other future as it is now.
    ViewBranch {
        /// From where.
        camera: Camera,
    },
}

/// Where an image is taken from.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// `head`, `top-down`, `free` or `follow:OBJECT`, as in `reel render`.
    name: String,
    /// Where a free camera is: x, y, z in metres in the scene's frame.
    eye: Option<[f32; 3]>,
    /// What a free camera looks at: x, y, z in metres in the scene's frame.
    look_at: Option<[f32; 3]>,
}

/// What a session answers.
#[derive(Debug, Serialize)]
#[serde(tag = "answer", rename_all = "snake_case")]
pub enum Answer {
    /// The file was read.
    Opened(Box<Opened>),
    /// How far the comparison is; with a verdict it is over.
    Verified {
        /// Calls that were executed and are equal.
        calls: usize,
        /// All calls.
        of: usize,
        /// What was found.
        verdict: Option<Verdict>,
        /// The verdict in words, as `reel replay` prints it.
        text: Option<String>,
    },
    /// An image: RGBA in the bytes.
    Image(Size),
    /// A call was made in the other future; its image is in the bytes, where it has one.
    Acted {
        /// What came of it.
        step: Box<StepRecord>,
        /// Why the episode is over, where it is.
        ended: Option<EndReason>,
        /// Size of the image.
        image: Option<Size>,
    },
    /// The other future begins here.
    Branched {
        /// How many calls came before.
        at: usize,
    },
    /// It cannot be done; the text says why and what to do.
    Failed {
        /// Why.
        reason: String,
    },
}

/// What a trace says before it is executed.
#[derive(Debug, Serialize)]
pub struct Opened {
    /// Who, what, where, with which versions.
    header: EpisodeHeader,
    /// What was asked for.
    instruction: String,
    /// Calls with what came of them.
    steps: Vec<StepRecord>,
    /// The end, where the trace has one.
    end: Option<EndRecord>,
    /// Whether the task was done; none where nobody can tell.
    success: Option<bool>,
    /// Digest of the hash chain: what a verdict is about.
    trace: Digest,
    /// BLAKE3 of the file.
    file: Digest,
    /// What can be called in another future.
    tools: Vec<PolicyTool>,
    /// Where `nav_to` can go.
    receptacles: Vec<ReceptacleId>,
    /// Versions of Reel and of the simulator here.
    build: String,
}

/// A tool that a policy may call.
#[derive(Debug, Serialize)]
struct PolicyTool {
    name: &'static str,
    argument: Option<&'static str>,
    description: &'static str,
}

impl Opened {
    fn of(trace: &Trace, bytes: &[u8]) -> Self {
        let tools = ToolSpec::POLICY.iter().map(|tool| PolicyTool {
            name: tool.paper_name,
            argument: tool.argument.map(|argument| argument.name),
            description: tool.description,
        });
        let places = trace.scene.receptacles.iter();
        Self {
            header: trace.header.clone(),
            instruction: trace.task.instruction.clone(),
            steps: trace.steps.clone(),
            end: trace.end.clone(),
            success: trace.end.as_ref().and_then(|end| end.success(&trace.task)),
            trace: trace.chain(),
            file: Digest::of(bytes),
            tools: tools.collect(),
            receptacles: places.map(|place| place.id.clone()).collect(),
            build: format!(
                "reel {}, simulator {SIM_VERSION}",
                env!("CARGO_PKG_VERSION")
            ),
        }
    }
}

/// Width and height of an image in pixels.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Size {
    width: usize,
    height: usize,
}

/// One episode and what is executed of it.
#[derive(Debug, Default)]
pub struct Session {
    /// Kept as long as the session's process or worker: it reads one trace.
    trace: Option<&'static Trace>,
    replay: Option<Replay<'static>>,
    /// The states after 0, 1, ... calls, as far as they were verified.
    snapshots: Vec<Snapshot>,
    /// The episode where it was looked at last.
    viewed: Option<(usize, Replay<'static>)>,
    branch: Option<Episode>,
}

type Answered = (Answer, Vec<u8>);

impl Session {
    /// Answers a request in JSON with bytes beside it: the answer in JSON, and its bytes.
    pub fn answer_json(&mut self, json: &[u8], bytes: &[u8]) -> (Vec<u8>, Vec<u8>) {
        let (answer, bytes) = match serde_json::from_slice(json) {
            Ok(request) => self.answer(request, bytes),
            Err(error) => (
                failed(format!("the request cannot be read: {error}")),
                Vec::new(),
            ),
        };
        (
            serde_json::to_vec(&answer).expect("an answer is always JSON"),
            bytes,
        )
    }

    /// Answers a request.
    pub fn answer(&mut self, request: Request, bytes: &[u8]) -> Answered {
        let answered = match request {
            Request::Open { name } => self.open(&name, bytes),
            Request::Verify => self.verify(),
            Request::View { at, camera } => self.view(at, &camera),
            Request::Branch { at } => self.begin_branch(at),
            Request::Act { call } => self.act(call),
            Request::ViewBranch { camera } => self.view_branch(&camera),
        };
        answered.unwrap_or_else(|reason| (failed(reason), Vec::new()))
    }

    fn open(&mut self, name: &str, bytes: &[u8]) -> Result<Answered, String> {
        if self.trace.is_some() {
            return Err("this session has an episode; open another session".to_owned());
        }
        let trace = Trace::from_bytes(Path::new(name), bytes, &Limits::default())
            .map_err(|error| error.to_string())?;
        let opened = Opened::of(&trace, bytes);
        self.trace = Some(Box::leak(Box::new(trace)));
        Ok((Answer::Opened(Box::new(opened)), Vec::new()))
    }

    fn trace(&self) -> Result<&'static Trace, String> {
        self.trace.ok_or_else(|| "no episode is open".to_owned())
    }

    fn verify(&mut self) -> Result<Answered, String> {
        let trace = self.trace()?;
        let of = trace.steps.len();
        let told = |calls, verdict: Option<Verdict>| {
            let text = verdict.as_ref().map(ToString::to_string);
            let answer = Answer::Verified {
                calls,
                of,
                verdict,
                text,
            };
            Ok((answer, Vec::new()))
        };
        let Some(mut replay) = self.replay.take() else {
            if let Err(verdict) = reel_replay::check(trace, Detail::Full) {
                return told(0, Some(verdict));
            }
            return match Replay::start(trace, Detail::Full) {
                Err(verdict) => told(0, Some(verdict)),
                Ok((replay, _)) => {
                    self.snapshots = vec![replay.episode().snapshot()];
                    self.replay = Some(replay);
                    told(0, None)
                }
            };
        };
        match replay.step() {
            Err(mismatch) => told(replay.calls(), Some(mismatch.into())),
            Ok(Some(_)) => {
                let calls = replay.calls();
                self.snapshots.push(replay.episode().snapshot());
                self.replay = Some(replay);
                told(calls, None)
            }
            Ok(None) => {
                let verdict = replay.finish(|_, _| ()).unwrap_or_else(|verdict| verdict);
                told(of, Some(verdict))
            }
        }
    }

    /// The episode after so many calls, from the nearest state that is known.
    fn at(&mut self, at: usize) -> Result<&Replay<'static>, String> {
        let trace = self.trace()?;
        if at > trace.steps.len() {
            return Err(format!(
                "the episode has {} calls, and {at} were asked for",
                trace.steps.len()
            ));
        }
        let usable = self.viewed.take().filter(|(viewed, _)| *viewed <= at);
        let known = self.snapshots.len().min(at + 1);
        let mut replay = match usable {
            Some((viewed, replay)) if viewed + 1 >= known => replay,
            _ => match known.checked_sub(1) {
                Some(calls) => Replay::resume(trace, calls, &self.snapshots[calls]),
                None => Replay::start(trace, Detail::Full).map(|(replay, _)| replay),
            }
            .map_err(|verdict| verdict.to_string())?,
        };
        while replay.calls() < at {
            replay
                .step()
                .map_err(|mismatch| Verdict::from(mismatch).to_string())?;
        }
        Ok(&self.viewed.insert((at, replay)).1)
    }

    fn view(&mut self, at: usize, camera: &Camera) -> Result<Answered, String> {
        let viewpoint = camera.viewpoint(self.trace()?)?;
        let frame = viewpoint
            .draw(self.at(at)?.episode().simulator())
            .map_err(|verdict| verdict.to_string())?;
        Ok(image(&frame))
    }

    fn begin_branch(&mut self, at: usize) -> Result<Answered, String> {
        let fork = Fork::of(self.at(at)?).ok_or_else(|| {
            format!(
                "the episode is over after call {}: begin earlier",
                at.saturating_sub(1)
            )
        })?;
        let branch = fork
            .open(person(), Detail::Full)
            .map_err(|verdict| verdict.to_string())?;
        self.branch = Some(branch);
        Ok((Answer::Branched { at }, Vec::new()))
    }

    fn act(&mut self, call: ToolCall) -> Result<Answered, String> {
        let branch = self.branch.as_mut().ok_or("no other future was begun")?;
        if branch.ended().is_some() {
            return Err("that future is over; begin another".to_owned());
        }
        let output = branch.step(StepInput::from_call(call));
        let (size, bytes) = match &output.frame {
            Some(frame) => (Some(SIZE), rgba(frame)),
            None => (None, Vec::new()),
        };
        let acted = Answer::Acted {
            step: Box::new(output.record),
            ended: branch.ended(),
            image: size,
        };
        Ok((acted, bytes))
    }

    fn view_branch(&mut self, camera: &Camera) -> Result<Answered, String> {
        let viewpoint = camera.viewpoint(self.trace()?)?;
        let branch = self.branch.as_ref().ok_or("no other future was begun")?;
        let frame = viewpoint
            .draw(branch.simulator())
            .map_err(|verdict| verdict.to_string())?;
        Ok(image(&frame))
    }
}

impl Camera {
    fn viewpoint(&self, trace: &Trace) -> Result<Viewpoint, String> {
        let text = |point: Option<[f32; 3]>| point.map(|[x, y, z]| format!("{x},{y},{z}"));
        let (eye, look_at) = (text(self.eye), text(self.look_at));
        Viewpoint::named(&self.name, eye.as_deref(), look_at.as_deref(), &trace.task)
            .map_err(|error| error.to_string())
    }
}

/// Who decides in another future.
fn person() -> PolicyInfo {
    PolicyInfo {
        name: "person".to_owned(),
        checkpoint: None,
        parameters: BTreeMap::new(),
    }
}

const SIZE: Size = Size {
    width: FRAME_WIDTH,
    height: FRAME_HEIGHT,
};

fn image(frame: &Frame) -> Answered {
    (Answer::Image(SIZE), rgba(frame))
}

/// As a canvas takes it.
fn rgba(frame: &Frame) -> Vec<u8> {
    let (pixels, _) = frame.rgb.as_chunks::<3>();
    pixels
        .iter()
        .flat_map(|[r, g, b]| [*r, *g, *b, u8::MAX])
        .collect()
}

fn failed(reason: String) -> Answer {
    Answer::Failed { reason }
}
