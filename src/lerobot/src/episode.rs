//! An episode of a dataset from a trace: its frames with state, action and words, and its video.

use reel_annotate::{PublicTask, Step, annotate, episode_seed};
use reel_replay::{MotionFrame, MotionPhase, MotionRate, MotionState, motion};
use reel_trace::Trace;
use reel_view::{Av1Encoder, EncodedFrames, VideoSettings};
use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, ToolSpec, record::StepRecord};
use serde_json::{Value, json};

use crate::{LeRobotError, statistics::ChannelHistograms};

/// Frames from one that decodes alone to the next, as LeRobot's own recorder chooses it: trainers jump.
const KEY_FRAME_INTERVAL: u64 = 2;

/// What every episode of a dataset shares.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct ExportSettings {
    /// Frames between the decisions; `None`: one frame for each decision, as if each took a second.
    pub rate: Option<MotionRate>,
    /// Whether frames of decisions show the numbers that the agent saw.
    pub marks: bool,
    /// Width of the video in pixels, an even number.
    pub width: usize,
    /// Height of the video in pixels, an even number.
    pub height: usize,
    /// Quantizer of the video from 0 (best) to 255 (smallest).
    pub quantizer: u8,
    /// Whether there are columns for subtasks and calls in words, which LeRobot reads from 0.6 on.
    pub language: bool,
    /// Seed of the wordings of subtasks.
    pub seed: u64,
}

impl ExportSettings {
    /// Frames per second of timestamps and videos.
    pub fn fps(&self) -> u32 {
        self.rate.map_or(1, |rate| rate.fps)
    }

    pub(crate) fn video(&self) -> VideoSettings {
        VideoSettings {
            width: self.width,
            height: self.height,
            key_frame_interval: KEY_FRAME_INTERVAL,
            quantizer: self.quantizer,
        }
    }
}

/// An episode that replays exactly, ready to be written.
#[derive(Clone, Debug)]
pub struct EncodedEpisode {
    /// The instruction, which is the task of every frame.
    pub(crate) task: String,
    pub(crate) frames: Vec<FrameRow>,
    /// Rows of `language_persistent`, the same in every frame.
    pub(crate) persistent: Value,
    pub(crate) video: EncodedFrames,
    pub(crate) pixels: ChannelHistograms,
    /// What leads back to the trace, by the names after `reel/` of the episode's row.
    pub(crate) origin: Value,
}

/// What is known of a frame before its place in the dataset is.
#[derive(Clone, Debug)]
pub(crate) struct FrameRow {
    pub(crate) state: [f32; 5],
    pub(crate) action: [f32; 5],
    pub(crate) call: u32,
    pub(crate) tool: i64,
    pub(crate) phase: i64,
    pub(crate) reward: f32,
    pub(crate) is_last: bool,
    /// Rows of `language_events`: a reply of the user, and the call.
    pub(crate) events: Value,
}

/// Executes a trace again and encodes what it shows.
///
/// # Errors
/// When the trace does not replay exactly, has no call, or a frame cannot be encoded.
pub fn encode(trace: &Trace, settings: &ExportSettings) -> Result<EncodedEpisode, LeRobotError> {
    if trace.steps.is_empty() {
        return Err(LeRobotError::Empty {
            path: trace.path.clone(),
        });
    }
    let mut encoder = Av1Encoder::new(settings.video())?;
    let mut pixels = ChannelHistograms::new();
    let mut moments: Vec<(u32, MotionPhase, MotionState)> = Vec::new();
    let mut problem = Ok(());
    let size = (settings.width as u32, settings.height as u32);
    let mut take = |frame: MotionFrame| -> Result<(), LeRobotError> {
        let resized =
            reel_dataset::resize(&frame.rgb, (FRAME_WIDTH as u32, FRAME_HEIGHT as u32), size);
        let rgb = resized.map_err(|reason| LeRobotError::Resize { reason })?;
        pixels.add(&rgb);
        moments.push((frame.call, frame.phase, frame.state));
        Ok(encoder.push(&rgb)?)
    };
    let ended = motion(trace, settings.rate, settings.marks, |frame| {
        if problem.is_ok() {
            problem = take(frame);
        }
    });
    problem?;
    let ended = ended.map_err(|verdict| LeRobotError::NotExact {
        path: trace.path.clone(),
        verdict: Box::new(verdict),
    })?;
    Ok(EncodedEpisode {
        task: trace.task.instruction.clone(),
        persistent: subtasks(trace, &moments, settings),
        frames: rows(trace, &moments, ended),
        video: encoder.finish()?,
        pixels,
        origin: json!({
            "episode_id": trace.header.episode_id, "task_id": trace.header.task_id, "scene_id": trace.header.scene_id,
            "policy": trace.header.policy.name, "trace_digest": trace.chain().to_string(), "verdict": "exact",
            "success": trace.end.as_ref().is_some_and(|end| end.metrics.success),
        }),
    })
}

/// The columns of the frames. The action of a frame is the state of the next one: where the robot goes and
/// whether it grasps.
fn rows(
    trace: &Trace,
    moments: &[(u32, MotionPhase, MotionState)],
    ended: MotionState,
) -> Vec<FrameRow> {
    let mut rows = Vec::with_capacity(moments.len());
    for (at, (call, phase, state)) in moments.iter().enumerate() {
        let next = moments.get(at + 1);
        let record = &trace.steps[*call as usize];
        let ends_call = next.is_none_or(|(next, ..)| next != call);
        let before = (*call as usize)
            .checked_sub(1)
            .and_then(|at| trace.steps.get(at));
        let events = match phase {
            MotionPhase::Decision => events(before, record),
            _ => json!([]),
        };
        rows.push(FrameRow {
            state: vector(state),
            action: vector(next.map_or(&ended, |(.., state)| state)),
            call: *call,
            tool: tool_number(record),
            phase: *phase as i64,
            reward: if ends_call {
                record.reward_total() as f32
            } else {
                0.0
            },
            is_last: next.is_none(),
            events,
        });
    }
    rows
}

fn vector(state: &MotionState) -> [f32; 5] {
    let robot = &state.robot;
    let [x, y] = robot.base;
    [
        x,
        y,
        robot.yaw,
        robot.pitch,
        f32::from(u8::from(state.holds)),
    ]
}

/// The number of a tool among those of a policy; -1 for a call of none.
fn tool_number(record: &StepRecord) -> i64 {
    let name = record.tool_name();
    let number = ToolSpec::POLICY
        .iter()
        .position(|spec| spec.paper_name == name);
    number.map_or(-1, |number| number as i64)
}

/// What is said at a decision: the reply to the question before, and the call.
fn events(before: Option<&StepRecord>, record: &StepRecord) -> Value {
    let row = |role: &str, content: Value, style: Value, calls: Value| json!({"role": role, "content": content, "style": style, "camera": null, "tool_calls": calls});
    let reply = before.and_then(|before| before.reply.as_ref());
    let reply = reply.map(|reply| {
        row(
            "user",
            json!(reply.text),
            json!("interjection"),
            Value::Null,
        )
    });
    let call = &record.input.call;
    let call =
        json!({"type": "function", "function": {"name": call.name, "arguments": call.arguments}});
    let call = row(
        "assistant",
        Value::Null,
        Value::Null,
        json!([call.to_string()]),
    );
    reply.into_iter().chain([call]).collect()
}

/// What the robot is about, from each decision at which that changes.
fn subtasks(
    trace: &Trace,
    moments: &[(u32, MotionPhase, MotionState)],
    settings: &ExportSettings,
) -> Value {
    let task = PublicTask::of(&trace.task, &trace.scene);
    let notes = annotate(
        &task,
        &Step::all(trace),
        episode_seed(settings.seed, &trace.chain()),
    );
    let mut told: Vec<Value> = Vec::new();
    let mut current = None;
    for (at, (call, phase, _)) in moments.iter().enumerate() {
        let note = notes
            .get(*call as usize)
            .filter(|_| *phase == MotionPhase::Decision);
        let Some(note) = note.filter(|note| current != Some(note.subtask.as_str())) else {
            continue;
        };
        current = Some(note.subtask.as_str());
        told.push(json!({
            "role": "assistant", "content": note.subtask, "style": "subtask",
            "timestamp": timestamp(at, settings.fps()), "camera": null, "tool_calls": null,
        }));
    }
    json!(told)
}

/// Seconds from the start of an episode to a frame.
pub(crate) fn timestamp(frame: usize, fps: u32) -> f32 {
    (frame as f64 / f64::from(fps)) as f32
}
