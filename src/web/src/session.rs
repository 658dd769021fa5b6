//! One episode, from its file on: what was asked of it is answered by executing it.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use reel_bundle::{Bundle, CheckedBundle, Finding, Manifest, Sample, Verification};
use reel_episode::Episode;
use reel_replay::{Detail, Fork, Replay, Verdict, Viewpoint};
use reel_sim::{SIM_VERSION, Snapshot};
use reel_trace::{Limits, Trace};
use reel_world::{
    Digest, FRAME_HEIGHT, FRAME_WIDTH, Meshes, ReceptacleId, ToolCall, ToolSpec,
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
        /// From where it is drawn.
        camera: Camera,
    },
    /// Begins another future after `at` calls; the one of before is forgotten.
    Branch {
        /// How many calls came before.
        at: usize,
    },
    /// Makes a call in the other future.
    Act {
        /// A call as a policy makes it.
        call: ToolCall,
    },
    /// Draws the other future as it is now.
    ViewBranch {
        /// From where it is drawn.
        camera: Camera,
    },
    /// Reads the bundle in the bytes and compares its parts with each other.
    OpenBundle,
    /// Executes an episode of the bundle again and compares it with what is claimed of it.
    Execute {
        /// Number of the episode in the bundle.
        episode: u32,
    },
    /// Says whether the bundle holds, with what was executed until now.
    Conclude,
    /// Gives an episode of the bundle as the trace that was packed.
    Unpack {
        /// Number of the episode in the bundle.
        episode: u32,
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
#[serde(tag = "response", rename_all = "snake_case")]
pub enum Response {
    /// The file was read.
    Opened(Box<Opened>),
    /// How far the comparison is; with a verdict it is over.
    Verified {
        /// Calls that were executed and are equal.
        calls: usize,
        /// How many calls the trace has.
        of: usize,
        /// What the comparison found, once it is over.
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
        /// Whether it reached its goal, once it is over and where anybody knows.
        success: Option<bool>,
        /// Size of the image.
        image: Option<Size>,
    },
    /// The bundle was read; the findings are those before any execution.
    OpenedBundle {
        /// What the bundle claims.
        manifest: Box<Manifest>,
        /// What does not hold so far.
        findings: Vec<Finding>,
    },
    /// An episode of the bundle was executed.
    Executed {
        /// What differs from the claim.
        findings: Vec<Finding>,
    },
    /// Whether the bundle holds.
    Concluded {
        /// The whole verification, as `reel verify --json` prints it.
        verification: Box<Verification>,
        /// The same in one line.
        text: String,
    },
    /// The trace of an episode of the bundle is in the bytes.
    Unpacked {
        /// The name that its file had.
        name: String,
    },
    /// The other future begins here.
    Branched {
        /// How many calls came before.
        at: usize,
    },
    /// It cannot be done; the text says why and what to do.
    Failed {
        /// Why it cannot be done.
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
#[derive(Default)]
pub struct Session {
    /// Kept as long as the session's process or worker: it reads one trace.
    trace: Option<&'static Trace>,
    replay: Option<Replay<'static>>,
    /// The states after 0, 1, ... calls, as far as they were verified.
    snapshots: Vec<Snapshot>,
    /// The episode where it was looked at last.
    viewed: Option<(usize, Replay<'static>)>,
    branch: Option<Episode>,
    bundle: Option<CheckedBundle>,
    /// Of the bundle's episodes, those that were executed.
    executed: BTreeSet<u32>,
    findings: Vec<Finding>,
}

type Responded = (Response, Vec<u8>);

impl Session {
    /// Answers a request in JSON with bytes beside it: the answer in JSON, and its bytes.
    pub fn respond_json(&mut self, json: &[u8], bytes: &[u8]) -> (Vec<u8>, Vec<u8>) {
        let (response, bytes) = match serde_json::from_slice(json) {
            Ok(request) => self.respond(request, bytes),
            Err(error) => (
                failed(format!("the request cannot be read: {error}")),
                Vec::new(),
            ),
        };
        (
            serde_json::to_vec(&response).expect("a response is always JSON"),
            bytes,
        )
    }

    /// Responds to one request, with bytes beside it.
    pub fn respond(&mut self, request: Request, bytes: &[u8]) -> Responded {
        let responded = match request {
            Request::Open { name } => self.open(&name, bytes),
            Request::Verify => self.verify(),
            Request::View { at, camera } => self.view(at, &camera),
            Request::Branch { at } => self.begin_branch(at),
            Request::Act { call } => self.act(call),
            Request::ViewBranch { camera } => self.view_branch(&camera),
            Request::OpenBundle => self.open_bundle(bytes),
            Request::Execute { episode } => self.execute(episode),
            Request::Conclude => self.conclude(),
            Request::Unpack { episode } => self.unpack(episode),
        };
        responded.unwrap_or_else(|reason| (failed(reason), Vec::new()))
    }

    fn open(&mut self, name: &str, bytes: &[u8]) -> Result<Responded, String> {
        if self.trace.is_some() {
            return Err("this session has an episode; open another session".to_owned());
        }
        let trace = Trace::from_bytes(Path::new(name), bytes, &Limits::default())
            .map_err(|error| error.to_string())?;
        let opened = Opened::of(&trace, bytes);
        self.trace = Some(Box::leak(Box::new(trace)));
        Ok((Response::Opened(Box::new(opened)), Vec::new()))
    }

    fn trace(&self) -> Result<&'static Trace, String> {
        self.trace.ok_or_else(|| "no episode is open".to_owned())
    }

    fn verify(&mut self) -> Result<Responded, String> {
        let trace = self.trace()?;
        let of = trace.steps.len();
        let told = |calls, verdict: Option<Verdict>| {
            let text = verdict.as_ref().map(ToString::to_string);
            let response = Response::Verified {
                calls,
                of,
                verdict,
                text,
            };
            Ok((response, Vec::new()))
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

    fn view(&mut self, at: usize, camera: &Camera) -> Result<Responded, String> {
        let trace = self.trace()?;
        let viewpoint = camera.viewpoint(trace)?;
        match self.at(at) {
            Ok(replay) => {
                let drawn = viewpoint.draw(replay.episode().simulator());
                Ok(image(&drawn.map_err(|verdict| verdict.to_string())?.rgb))
            }
            // What cannot be executed, of a robot for instance, has what was recorded.
            Err(reason) if viewpoint == Viewpoint::Head => recorded(trace, at).ok_or(reason),
            Err(reason) => Err(reason),
        }
    }

    fn begin_branch(&mut self, at: usize) -> Result<Responded, String> {
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
        Ok((Response::Branched { at }, Vec::new()))
    }

    fn act(&mut self, call: ToolCall) -> Result<Responded, String> {
        let branch = self.branch.as_mut().ok_or("no other future was begun")?;
        if branch.ended().is_some() {
            return Err("that future is over; begin another".to_owned());
        }
        let output = branch.step(StepInput::from_call(call));
        let ended = branch.ended();
        let (size, bytes) = match &output.frame {
            Some(frame) => (Some(SIZE), rgba(&frame.rgb)),
            None => (None, Vec::new()),
        };
        let acted = Response::Acted {
            step: Box::new(output.record),
            ended,
            success: ended.and_then(|_| branch.end_record().success(branch.task())),
            image: size,
        };
        Ok((acted, bytes))
    }

    fn view_branch(&mut self, camera: &Camera) -> Result<Responded, String> {
        let viewpoint = camera.viewpoint(self.trace()?)?;
        let branch = self.branch.as_ref().ok_or("no other future was begun")?;
        let drawn = viewpoint.draw(branch.simulator());
        Ok(image(&drawn.map_err(|verdict| verdict.to_string())?.rgb))
    }
}

impl Session {
    fn open_bundle(&mut self, bytes: &[u8]) -> Result<Responded, String> {
        let bundle = Bundle::from_bytes(bytes).map_err(|error| error.to_string())?;
        let checked = CheckedBundle::new(&bundle, None, None).map_err(|error| error.to_string())?;
        let response = Response::OpenedBundle {
            manifest: Box::new(checked.manifest().clone()),
            findings: checked.findings().to_vec(),
        };
        self.bundle = Some(checked);
        Ok((response, Vec::new()))
    }

    fn bundle(&self) -> Result<&CheckedBundle, String> {
        self.bundle
            .as_ref()
            .ok_or_else(|| "no bundle is open".to_owned())
    }

    fn execute(&mut self, episode: u32) -> Result<Responded, String> {
        let findings = self.bundle()?.execute(episode, &Meshes::default());
        self.executed.insert(episode);
        self.findings.extend_from_slice(&findings);
        Ok((Response::Executed { findings }, Vec::new()))
    }

    fn conclude(&mut self) -> Result<Responded, String> {
        let sample = Sample {
            seed: 0,
            episodes: self.executed.iter().copied().collect(),
        };
        let verification = self.bundle()?.finish(sample, self.findings.clone());
        let response = Response::Concluded {
            text: verification.to_string(),
            verification: Box::new(verification),
        };
        Ok((response, Vec::new()))
    }

    fn unpack(&mut self, episode: u32) -> Result<Responded, String> {
        let (name, trace) = self.bundle()?.unpack(episode, &Meshes::default())?;
        Ok((Response::Unpacked { name }, trace))
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

/// The last image that the trace holds after so many calls.
fn recorded(trace: &Trace, at: usize) -> Option<Responded> {
    let steps = trace.steps[..at.min(trace.steps.len())].iter().rev();
    let moments = steps.map(|step| Some(step.step)).chain([None]);
    let mut images = moments.filter_map(|moment| trace.frame_rgb(moment).ok().flatten());
    images.next().map(|rgb| image(&rgb))
}

fn image(rgb: &[u8]) -> Responded {
    (Response::Image(SIZE), rgba(rgb))
}

/// Pixels as a canvas takes them.
fn rgba(rgb: &[u8]) -> Vec<u8> {
    let (pixels, _) = rgb.as_chunks::<3>();
    let opaque = pixels.iter().flat_map(|[r, g, b]| [*r, *g, *b, u8::MAX]);
    opaque.collect()
}

fn failed(reason: String) -> Response {
    Response::Failed { reason }
}
