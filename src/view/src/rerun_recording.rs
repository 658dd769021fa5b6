//! An episode as a Rerun recording: the head camera, the robot, objects and receptacles in 3D,
//! the transcript, the rewards. Timelines `step` (-1: before the first decision) and
//! `sim_time`; no wall-clock time.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
};

use re_sdk::{
    AsComponents, RecordingStream, RecordingStreamBuilder, RecordingStreamError,
    blueprint::{
        Blueprint, BlueprintPanel, Horizontal, SelectionPanel, Spatial2DView, Spatial3DView, Tabs,
        TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical, components::PanelState,
    },
};
use re_sdk_types::{
    archetypes::{
        AnnotationContext, Boxes3D, DepthImage, EncodedImage, Pinhole, Scalars, SegmentationImage,
        TextDocument, TextLog, Transform3D, ViewCoordinates,
    },
    components::{ImageFormat, TextLogLevel},
    datatypes::{ChannelDatatype, Quaternion, Rgba32},
};
use reel_replay::{frames_at, replay_with};
use reel_trace::{FrameLayers, Trace};
use reel_world::{
    DT_S, FRAME_HEIGHT, FRAME_WIDTH, InstanceId, Task, instances, little_endian,
    record::{BodyState, RobotState, StepRecord},
};

use crate::{ViewError, canvas::encode_png, transcript};

/// Focal length of the head camera in pixels, as in the trace's camera calibration.
const FOCAL_PX: f32 = 400.0;
/// Half of the robot's box in metres: for the eye, not the collider.
const ROBOT_HALF_M: [f32; 3] = [0.22, 0.22, 0.5];

const TARGET: Rgba32 = Rgba32::from_rgb(46, 160, 67);
const DISTRACTOR: Rgba32 = Rgba32::from_rgb(227, 140, 28);
const OTHER: Rgba32 = Rgba32::from_rgb(120, 132, 150);
const FURNITURE: Rgba32 = Rgba32::from_rgb(86, 104, 168);
const DOOR: Rgba32 = Rgba32::from_rgb(150, 92, 170);
const ROBOT: Rgba32 = Rgba32::from_rgb(40, 44, 52);

/// The recording, as the content of an `.rrd` file, with a layout for it. Images that the trace
/// does not hold are drawn again where it can be replayed. Depth shows as a point cloud, too; masks
/// have the names of what they show.
///
/// # Errors
/// When an image of the trace is damaged, or depth or masks are asked for that it does not hold and
/// that cannot be drawn again.
pub fn rrd(trace: &Trace, layers: FrameLayers) -> Result<Vec<u8>, ViewError> {
    let builder =
        RecordingStreamBuilder::new("reel").recording_id(trace.header.episode_id.as_str());
    let builder = builder.recording_name(format!(
        "{} by {}",
        trace.header.task_id, trace.header.policy.name
    ));
    let (stream, storage) = builder
        .with_blueprint(layout())
        .memory()
        .map_err(|error| failed(&error))?;
    stream.set_log_tick_enabled(false);
    stream.set_log_time_enabled(false);
    let mut drawn = BTreeMap::new();
    if trace.image_count() == 0 {
        let start = trace.start.digests.frame.as_ref().map(|_| None);
        let steps = trace
            .steps
            .iter()
            .filter(|record| record.digests.frame.is_some())
            .map(|record| Some(record.step));
        let moments: BTreeSet<_> = start.into_iter().chain(steps).collect();
        drawn = frames_at(trace, &moments).unwrap_or_default();
    }
    let recording = Recording {
        trace,
        stream,
        drawn,
        layers: drawn_layers(trace, layers)?,
    };
    recording.scene()?;
    if layers.masks {
        recording.names()?;
    }
    recording.moment(-1, 0, None, &trace.start.bodies, &trace.start.robot)?;
    let mut total = 0.0;
    for record in &trace.steps {
        recording.moment(
            i64::from(record.step),
            record.sim_step,
            Some(record.step),
            &record.bodies,
            &record.robot,
        )?;
        total += record.reward_total();
        recording.told(record, total)?;
    }
    storage.drain_as_bytes().map_err(|error| failed(&error))
}

/// Depth and masks as wanted, as the trace holds them or drawn again.
fn drawn_layers(
    trace: &Trace,
    wanted: FrameLayers,
) -> Result<BTreeMap<Option<u32>, LayerValues>, ViewError> {
    let mut found = BTreeMap::new();
    if trace.has_layers(wanted) {
        let steps = trace.steps.iter().map(|step| Some(step.step));
        for step in std::iter::once(None).chain(steps) {
            let values = LayerValues {
                depth_mm: wanted
                    .depth
                    .then(|| trace.depth_mm(step))
                    .transpose()?
                    .flatten(),
                ids: wanted
                    .masks
                    .then(|| trace.instance_ids(step))
                    .transpose()?
                    .flatten(),
            };
            found.insert(step, values);
        }
        return Ok(found);
    }
    let replayed = replay_with(trace, |step, frame| {
        let values = LayerValues {
            depth_mm: wanted.depth.then(|| frame.depth_mm.clone()),
            ids: wanted.masks.then(|| frame.ids.clone()),
        };
        found.insert(step, values);
    });
    match replayed {
        Ok(_) => Ok(found),
        Err(verdict) => Err(ViewError::Rerun {
            reason: format!("depth and masks cannot be drawn again: {verdict}"),
        }),
    }
}

/// What is shown of a frame besides its image.
struct LayerValues {
    depth_mm: Option<Vec<u16>>,
    ids: Option<Vec<u16>>,
}

fn failed(error: &dyn std::error::Error) -> ViewError {
    ViewError::Rerun {
        reason: error.to_string(),
    }
}

/// The world beside what the robot sees and what is said, the rewards below; time goes by steps.
fn layout() -> Blueprint {
    let told = Tabs::new([
        TextLogView::new("Transcript")
            .with_origin("transcript")
            .into(),
        TextDocumentView::new("Episode")
            .with_origin("episode")
            .into(),
    ]);
    let seen = Vertical::new([
        Spatial2DView::new("Camera")
            .with_origin("world/camera")
            .into(),
        told.into(),
    ]);
    let world = Vertical::new([
        Spatial3DView::new("World").with_origin("world").into(),
        TimeSeriesView::new("Rewards")
            .with_contents(["reward/**", "return"])
            .into(),
    ]);
    let world = world.with_row_shares([3.0, 1.0]);
    let sides = Horizontal::new([world.into(), seen.into()]).with_column_shares([3.0, 2.0]);
    Blueprint::new(sides)
        .with_blueprint_panel(BlueprintPanel::from_state(PanelState::Collapsed))
        .with_selection_panel(SelectionPanel::from_state(PanelState::Collapsed))
        .with_time_panel(TimePanel::new().with_timeline("step"))
}

struct Recording<'a> {
    trace: &'a Trace,
    stream: RecordingStream,
    /// Images that the trace does not hold.
    drawn: BTreeMap<Option<u32>, Vec<u8>>,
    layers: BTreeMap<Option<u32>, LayerValues>,
}

impl Recording<'_> {
    /// What the values in masks are called.
    fn names(&self) -> Result<(), ViewError> {
        let known = instances(&self.trace.task, &self.trace.scene);
        let names = known
            .iter()
            .map(|it| (it.id, format!("{} ({})", it.category, it.name)));
        let names: Vec<(u16, String)> = names.collect();
        let context = names.iter().map(|(id, name)| (*id, name.as_str()));
        self.log_static("world/camera", &AnnotationContext::new(context))
    }

    fn scene(&self) -> Result<(), ViewError> {
        let scene = &self.trace.scene;
        self.log_static("world", &ViewCoordinates::RIGHT_HAND_Z_UP())?;
        let floors = scene.rooms.iter().flat_map(|room| {
            room.footprint()
                .into_iter()
                .map(|rect| (room.name.as_str(), rect))
        });
        let floors: Vec<_> = floors.collect();
        let mins = floors
            .iter()
            .map(|(_, rect)| [rect.min[0] as f32, rect.min[1] as f32, -0.02]);
        let sizes = floors.iter().map(|(_, rect)| {
            [
                (rect.max[0] - rect.min[0]) as f32,
                (rect.max[1] - rect.min[1]) as f32,
                0.02,
            ]
        });
        let rooms = Boxes3D::from_mins_and_sizes(mins, sizes)
            .with_labels(floors.iter().map(|(name, _)| *name));
        self.log_static("world/rooms", &rooms)?;
        let mins = scene
            .receptacles
            .iter()
            .map(|it| [it.surface_min[0] as f32, it.surface_min[1] as f32, 0.0]);
        let size = |axis: usize, it: &reel_world::Receptacle| {
            (it.surface_max[axis] - it.surface_min[axis]) as f32
        };
        let sizes = scene
            .receptacles
            .iter()
            .map(|it| [size(0, it), size(1, it), it.surface_height() as f32]);
        let furniture = Boxes3D::from_mins_and_sizes(mins, sizes)
            .with_labels(scene.receptacles.iter().map(|it| it.id.as_str()))
            .with_colors(
                scene
                    .receptacles
                    .iter()
                    .map(|it| if it.door.exists() { DOOR } else { FURNITURE }),
            );
        self.log_static("world/receptacles", &furniture)?;
        let resolution = [FRAME_WIDTH as f32, FRAME_HEIGHT as f32];
        self.log_static(
            "world/camera",
            &Pinhole::from_focal_length_and_resolution([FOCAL_PX, FOCAL_PX], resolution),
        )?;
        self.log_static(
            "episode",
            &TextDocument::from_markdown(format!("```\n{}```\n", transcript(self.trace))),
        )
    }

    fn moment(
        &self,
        step: i64,
        sim_step: u64,
        image: Option<u32>,
        bodies: &[BodyState],
        robot: &RobotState,
    ) -> Result<(), ViewError> {
        self.stream.set_time_sequence("step", step);
        self.stream
            .set_duration_secs("sim_time", sim_step as f64 * f64::from(DT_S));
        let recorded = self.trace.frame_rgb(image)?.map(Cow::Owned);
        if let Some(rgb) = recorded.or_else(|| self.drawn.get(&image).map(Cow::Borrowed)) {
            let png = encode_png(&rgb, FRAME_WIDTH as u32, FRAME_HEIGHT as u32)?;
            self.log(
                "world/camera/image",
                &EncodedImage::new(png).with_media_type("image/png"),
            )?;
        }
        if let Some(values) = self.layers.get(&image) {
            let size = [FRAME_WIDTH as u32, FRAME_HEIGHT as u32];
            if let Some(depth) = &values.depth_mm {
                let depth = DepthImage::from_gray16(little_endian(depth), size).with_meter(1000.0);
                self.log("world/camera/depth", &depth)?;
            }
            if let Some(ids) = &values.ids {
                let format = ImageFormat::segmentation(size, ChannelDatatype::U16);
                let masks = SegmentationImage::new(little_endian(ids), format);
                self.log("world/camera/instances", &masks.with_opacity(0.5))?;
            }
        }
        self.log(
            "world/camera",
            &Transform3D::from_translation_mat3x3(robot.camera, world_from_camera(robot)),
        )?;
        let base = [robot.base[0], robot.base[1], ROBOT_HALF_M[2]];
        let (sin, cos) = (robot.yaw / 2.0).sin_cos();
        let body = Boxes3D::from_centers_and_half_sizes([base], [ROBOT_HALF_M])
            .with_quaternions([Quaternion::from_xyzw([0.0, 0.0, sin, cos])])
            .with_labels(["robot"])
            .with_colors([ROBOT]);
        self.log("world/robot", &body)?;
        self.log("world/objects", &objects(&self.trace.task, bodies))
    }

    fn told(&self, record: &StepRecord, total: f64) -> Result<(), ViewError> {
        let level = if record.outcome.is_ok() {
            TextLogLevel::INFO
        } else {
            TextLogLevel::ERROR
        };
        self.log(
            "transcript",
            &TextLog::new(record.input.call.to_string()).with_level(TextLogLevel::INFO),
        )?;
        self.log(
            "transcript",
            &TextLog::new(record.outcome.text.as_str()).with_level(level),
        )?;
        for event in &record.changes.physics {
            self.log(
                "transcript",
                &TextLog::new(event.to_string()).with_level(TextLogLevel::DEBUG),
            )?;
        }
        let mut components: BTreeMap<&str, f64> = BTreeMap::new();
        for term in &record.reward {
            *components.entry(&term.component).or_default() += term.value;
        }
        for (component, value) in components {
            self.log(&format!("reward/{component}"), &Scalars::single(value))?;
        }
        self.log("return", &Scalars::single(total))
    }

    fn log(&self, entity: &str, what: &dyn AsComponents) -> Result<(), ViewError> {
        self.stream
            .log(entity, what)
            .map_err(|error: RecordingStreamError| failed(&error))
    }

    fn log_static(&self, entity: &str, what: &dyn AsComponents) -> Result<(), ViewError> {
        self.stream
            .log_static(entity, what)
            .map_err(|error: RecordingStreamError| failed(&error))
    }
}

/// Every object whose body is in the world; a held one is not.
fn objects(task: &Task, bodies: &[BodyState]) -> Boxes3D {
    let known = bodies
        .iter()
        .filter_map(|body| Some((body, task.object(&InstanceId::from(body.body.as_str()))?)));
    let known: Vec<_> = known.collect();
    let colour = |object: &reel_world::ObjectInstance| {
        let like_target = task
            .object(&task.target)
            .is_some_and(|target| target.category == object.category);
        match () {
            () if object.instance == task.target => TARGET,
            () if like_target || task.object_distractors.contains(&object.asset) => DISTRACTOR,
            () => OTHER,
        }
    };
    let halves = known
        .iter()
        .map(|(_, object)| object.size.map(|side| (side / 2.0) as f32));
    Boxes3D::from_centers_and_half_sizes(known.iter().map(|(body, _)| body.position), halves)
        .with_quaternions(
            known
                .iter()
                .map(|(body, _)| Quaternion::from_xyzw(body.rotation)),
        )
        .with_labels(known.iter().map(|(_, object)| object.category.as_str()))
        .with_colors(known.iter().map(|(_, object)| colour(object)))
}

/// Columns: right, down and forward of the camera in the world.
fn world_from_camera(robot: &RobotState) -> [[f32; 3]; 3] {
    let (sin_yaw, cos_yaw) = robot.yaw.sin_cos();
    let (sin_pitch, cos_pitch) = robot.pitch.sin_cos();
    let right = [sin_yaw, -cos_yaw, 0.0];
    let forward = [cos_pitch * cos_yaw, cos_pitch * sin_yaw, sin_pitch];
    let down = [sin_pitch * cos_yaw, sin_pitch * sin_yaw, -cos_pitch];
    [right, down, forward]
}
