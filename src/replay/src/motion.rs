//! What the head camera sees between the decisions of a trace, frame by frame at a chosen rate, from
//! executing the trace again.
//!
//! Physics is shown as it is executed: objects that fall and roll, doors that swing. The simulator sets the
//! robot to its goal at once and counts the length of the route there; this module lets it turn, drive along that
//! very route and turn again, at constant speeds, while the world waits as it does in the simulator.

use std::f32::consts::{PI, TAU};

use reel_sim::{Simulator, geometry::Camera, render::Detail};
use reel_trace::Trace;
use reel_world::{
    DT_S,
    record::{RobotState, StepRecord},
};

use crate::{Replay, Verdict};

/// How far ahead on its route a driving robot looks, in metres.
const LOOK_AHEAD_M: f32 = 0.4;
/// A shorter way is none, in metres.
const STANDING_M: f32 = 0.01;

/// How fast time and the robot go between two decisions.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MotionRate {
    /// Frames per second, at least 1.
    pub fps: u32,
    /// Speed of the driving base in metres per second, above 0.
    pub drive_m_s: f32,
    /// Speed of the turning base in radians per second, above 0.
    pub turn_rad_s: f32,
}

/// What a frame shows of its call.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum MotionPhase {
    /// The state in which the call was decided: its first frame.
    Decision,
    /// The robot on its way, which the simulator takes in no time.
    Driving,
    /// The state after some physics steps of the call.
    Physics,
}

/// What the robot feels of itself.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct MotionState {
    /// Where it stands and looks, and how far it drove.
    pub robot: RobotState,
    /// Whether the gripper holds an object.
    pub holds: bool,
}

/// A frame of an episode.
#[derive(Clone, Debug)]
pub struct MotionFrame {
    /// The call that is decided or under way, from 0.
    pub call: u32,
    /// What of the call it shows.
    pub phase: MotionPhase,
    /// The state of the robot in this frame.
    pub state: MotionState,
    /// The image of the head camera, 640 x 480, RGB.
    pub rgb: Vec<u8>,
}

/// Shows the frames of an episode in order and gives the robot's state after the last call: without a rate
/// one frame for each decision, else as many as the call lasts, at least one. `marks` shows in the frame of a
/// decision what the agent got.
///
/// # Errors
/// Why nothing can be executed, or the first difference, that of the end included; what was shown before is void.
pub fn motion(
    trace: &Trace,
    rate: Option<MotionRate>,
    marks: bool,
    mut show: impl FnMut(MotionFrame),
) -> Result<MotionState, Verdict> {
    let (mut replay, start) = Replay::start(trace, Detail::Full)?;
    let mut got = Some(start.rgb);
    for (call, recorded) in (0..).zip(&trace.steps) {
        let simulator = replay.episode().simulator();
        let frame = |phase, state, rgb| MotionFrame {
            call,
            phase,
            state,
            rgb,
        };
        let before = state_of(simulator);
        let rgb = got.take().filter(|_| marks);
        let rgb = rgb.unwrap_or_else(|| simulator.render_from(&simulator.camera()).rgb);
        show(frame(MotionPhase::Decision, before, rgb));
        let mut wanted = Vec::new();
        if let Some(rate) = rate {
            let way = Way::new(simulator, recorded, rate);
            let since = simulator.sim_step();
            let frames = way.frames(recorded.sim_step.saturating_sub(since), rate);
            for time_s in (1..frames).map(|frame| f64::from(frame) / f64::from(rate.fps)) {
                if let Some(robot) = way.at(time_s) {
                    let rgb = simulator.render_from(&camera_of(&robot)).rgb;
                    let state = MotionState { robot, ..before };
                    show(frame(MotionPhase::Driving, state, rgb));
                } else {
                    let steps = ((time_s - way.duration_s()) / f64::from(DT_S)).round();
                    wanted.push((since + steps as u64).min(recorded.sim_step));
                }
            }
        }
        replay.sample_motion(wanted.iter().copied());
        got = replay
            .step()?
            .and_then(|output| output.frame)
            .map(|frame| frame.rgb);
        let samples = replay.take_samples();
        let missing = wanted.len() - samples.len();
        for sample in samples {
            let state = MotionState {
                robot: sample.robot,
                holds: sample.holds,
            };
            show(frame(MotionPhase::Physics, state, sample.rgb));
        }
        // A call without a physics step shows what it led to.
        let simulator = replay.episode().simulator();
        for _ in 0..missing {
            let rgb = simulator.render_from(&simulator.camera()).rgb;
            show(frame(MotionPhase::Physics, state_of(simulator), rgb));
        }
    }
    let end = state_of(replay.episode().simulator());
    match replay.finish(|_, _| ())? {
        verdict if verdict.is_exact() => Ok(end),
        verdict => Err(verdict),
    }
}

fn state_of(simulator: &Simulator) -> MotionState {
    MotionState {
        robot: simulator.robot(),
        holds: simulator.held().is_some(),
    }
}

fn camera_of(robot: &RobotState) -> Camera {
    Camera {
        position: robot.camera,
        yaw: robot.yaw,
        pitch: robot.pitch,
    }
}

/// How the robot gets from where it stands to where a call leaves it: a turn towards the route, the route, and
/// a turn to where it looks in the end.
struct Way {
    before: RobotState,
    after: RobotState,
    /// Points of the route in metres, with their distance from its beginning; empty where the base stays.
    route: Vec<([f32; 2], f32)>,
    /// Seconds of the first turn, the drive and the last turn.
    phases_s: [f64; 3],
    drive_m_s: f32,
}

impl Way {
    fn new(simulator: &Simulator, recorded: &StepRecord, rate: MotionRate) -> Self {
        let (before, after) = (simulator.robot(), recorded.robot);
        let mut way = Self {
            before,
            after,
            route: route(simulator, before.base, after.base),
            phases_s: [0.0; 3],
            drive_m_s: rate.drive_m_s,
        };
        let turn_s = |from: f32, to: f32| f64::from(turn(from, to).abs() / rate.turn_rad_s);
        let pitch_s = f64::from((after.pitch - before.pitch).abs() / rate.turn_rad_s);
        let length = way.length_m();
        way.phases_s = if length < STANDING_M {
            [0.0, 0.0, turn_s(before.yaw, after.yaw).max(pitch_s)]
        } else {
            [
                turn_s(before.yaw, way.heading(0.0)),
                f64::from(length / rate.drive_m_s),
                turn_s(way.heading(length), after.yaw).max(pitch_s),
            ]
        };
        way
    }

    fn length_m(&self) -> f32 {
        self.route.last().map_or(0.0, |(_, along)| *along)
    }

    fn duration_s(&self) -> f64 {
        self.phases_s.iter().sum()
    }

    /// How many frames the call lasts: its way and its physics.
    fn frames(&self, physics_steps: u64, rate: MotionRate) -> u32 {
        let seconds = self.duration_s() + physics_steps as f64 * f64::from(DT_S);
        ((seconds * f64::from(rate.fps) - 1e-6).ceil() as u32).max(1)
    }

    /// The robot on its way at a time after the decision; `None` once it has arrived.
    fn at(&self, time_s: f64) -> Option<RobotState> {
        let [first, drive, last] = self.phases_s;
        let turned = |from: f32, to: f32, share: f64| from + turn(from, to) * share as f32;
        let mut robot = self.before;
        if time_s < first {
            robot.yaw = turned(robot.yaw, self.heading(0.0), time_s / first);
            return Some(robot);
        }
        let length = self.length_m();
        if time_s < first + drive {
            let along = ((time_s - first) as f32 * self.drive_m_s).min(length);
            let base = self.point(along);
            robot.yaw = self.heading(along);
            robot.camera[0] += base[0] - robot.base[0];
            robot.camera[1] += base[1] - robot.base[1];
            robot.base = base;
            let driven = self.after.path_length_m - self.before.path_length_m;
            robot.path_length_m += driven * along / length;
            return Some(robot);
        }
        let share = (time_s - first - drive) / last;
        (time_s < first + drive + last).then(|| {
            let from = if drive > 0.0 {
                self.heading(length)
            } else {
                self.before.yaw
            };
            let pitch = self.before.pitch;
            RobotState {
                yaw: turned(from, self.after.yaw, share),
                pitch: pitch + (self.after.pitch - pitch) * share as f32,
                ..self.after
            }
        })
    }

    /// The point so far along the route.
    fn point(&self, along: f32) -> [f32; 2] {
        let next = self.route.partition_point(|(_, there)| *there < along);
        let (Some((to, end)), Some((from, begin))) =
            (self.route.get(next), self.route.get(next.wrapping_sub(1)))
        else {
            let nearest = next.min(self.route.len().saturating_sub(1));
            return self.route.get(nearest).map_or(self.after.base, |it| it.0);
        };
        let share = (along - begin) / (end - begin).max(f32::MIN_POSITIVE);
        [0, 1].map(|axis| from[axis] + (to[axis] - from[axis]) * share)
    }

    /// Where the base looks on its route: at a point ahead, at the end along the last piece.
    fn heading(&self, along: f32) -> f32 {
        let along = along.min(self.length_m() - LOOK_AHEAD_M).max(0.0);
        let (from, to) = (self.point(along), self.point(along + LOOK_AHEAD_M));
        libm::atan2f(to[1] - from[1], to[0] - from[0])
    }
}

/// The route of the navigation map between two places with the distances along it; empty if it is too short.
fn route(simulator: &Simulator, from: [f32; 2], to: [f32; 2]) -> Vec<([f32; 2], f32)> {
    let cells = simulator.nav().path(from, to).unwrap_or_default();
    let inner = cells.get(1..cells.len().saturating_sub(1));
    let mut points = vec![(from, 0.0)];
    let mut along = 0.0;
    for point in inner.unwrap_or_default().iter().copied().chain([to]) {
        let last = points.last().map_or(from, |(point, _)| *point);
        along += libm::hypotf(point[0] - last[0], point[1] - last[1]);
        points.push((point, along));
    }
    if along < STANDING_M {
        points.clear();
    }
    points
}

/// The shorter turn from one heading to another, in radians.
fn turn(from: f32, to: f32) -> f32 {
    let turned = (to - from) % TAU;
    if turned > PI {
        turned - TAU
    } else if turned < -PI {
        turned + TAU
    } else {
        turned
    }
}
