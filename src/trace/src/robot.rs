//! What a robot measured while it played an episode. Stands beside the records: no digest of the
//! hash chain covers it. Knows no files.

use serde::Serialize;

/// Where a robot measured itself to be, in the frame of its odometry.
#[derive(Clone, Copy, PartialEq, Debug, Default, Serialize)]
pub struct Odometry {
    /// The decision during which it was measured; none: before the first.
    pub step: Option<u32>,
    /// When, in nanoseconds since 1970.
    pub unix_ns: u64,
    /// Position along x in the odometry frame, in metres.
    pub x: f64,
    /// Position along y in the odometry frame, in metres.
    pub y: f64,
    /// Heading around z in radians; 0 looks along +x.
    pub yaw: f64,
}

/// What one execution of a skill came to.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize)]
pub struct PrimitiveOutcome {
    /// The decision during which it ended; none: before the first.
    pub step: Option<u32>,
    /// When it ended, in nanoseconds since 1970.
    pub unix_ns: u64,
    /// `pick`, `place`, `open`, `close`, or another name.
    pub skill: String,
    /// On what, in words: `desk`, `microwave`. Empty where nobody said.
    pub target: String,
    /// Whether it did what it should.
    pub success: bool,
    /// How long it took, in nanoseconds.
    pub duration_ns: Option<u64>,
    /// Steps of the low-level controller.
    pub control_steps: Option<u32>,
    /// What went wrong, in the words of the robot.
    pub error: Option<String>,
}

/// How long one inference of the low-level model (a chunk of actions) took.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize)]
pub struct VlaLatency {
    /// The decision during which it was made; none: before the first.
    pub step: Option<u32>,
    /// When, in nanoseconds since 1970.
    pub unix_ns: u64,
    /// Duration of the inference, in nanoseconds.
    pub latency_ns: u64,
}

/// How far a robot was off after a repeated command to navigate or gaze.
#[derive(Clone, PartialEq, Debug, Default, Serialize)]
pub struct Alignment {
    /// The decision during which it was measured; none: before the first.
    pub step: Option<u32>,
    /// When, in nanoseconds since 1970.
    pub unix_ns: u64,
    /// At what, in words. Empty where nobody said.
    pub target: String,
    /// Distance between the measured and the wanted position, in metres.
    pub odometry_error_m: Option<f64>,
    /// Difference in heading, in radians.
    pub yaw_error_rad: Option<f64>,
    /// Shift of the image, in pixels.
    pub image_shift_px: Option<f64>,
    /// Root mean square error of the image's registration, in pixels.
    pub image_rmse_px: Option<f64>,
}

/// Everything that a robot measured in an episode, each list in the order of the trace; empty for
/// episodes without a robot.
#[derive(Clone, PartialEq, Debug, Default, Serialize)]
pub struct RobotLog {
    /// Poses that the robot measured, from `/robot/odometry`.
    pub odometry: Vec<Odometry>,
    /// Outcomes of the executed skills, from `/robot/primitive`.
    pub primitives: Vec<PrimitiveOutcome>,
    /// Inference times of the low-level model, from `/robot/vla`.
    pub vla: Vec<VlaLatency>,
    /// Alignment errors after repeated commands, from `/robot/alignment`.
    pub alignments: Vec<Alignment>,
}

impl RobotLog {
    /// Whether nothing was measured.
    pub fn is_empty(&self) -> bool {
        self.odometry.is_empty()
            && self.primitives.is_empty()
            && self.vla.is_empty()
            && self.alignments.is_empty()
    }

    /// What belongs to the first so many steps.
    pub(crate) fn before(&self, steps: u32) -> RobotLog {
        let mut log = self.clone();
        log.odometry.retain(|it| it.step < Some(steps));
        log.primitives.retain(|it| it.step < Some(steps));
        log.vla.retain(|it| it.step < Some(steps));
        log.alignments.retain(|it| it.step < Some(steps));
        log
    }
}

/// A camera image as it was recorded, of any size.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct CameraImage {
    /// File format of the image: `jpeg` or `png`.
    pub format: String,
    /// The complete image file, as it was recorded.
    pub data: Vec<u8>,
}
