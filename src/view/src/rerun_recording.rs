//! An episode as a Rerun recording: the head camera, the robot, objects and receptacles in 3D,
//! the transcript, the rewards. Timelines `step` (-1: before the first decision) and
//! `sim_time`; no wall-clock time.

use std::{
    borrow::Cow,
    collections::{BTreeMap, BTreeSet},
};

use re_sdk::{
    AsComponents, EntityPath, RecordingStream, RecordingStreamBuilder, RecordingStreamError,
    blueprint::{
        Blueprint, BlueprintPanel, Horizontal, SelectionPanel, Spatial2DView, Spatial3DView, Tabs,
        TextDocumentView, TextLogView, TimePanel, TimeSeriesView, Vertical, components::PanelState,
    },
    entity_path,
};
use re_sdk_types::{
    archetypes::{
        AnnotationContext, Boxes3D, DepthImage, EncodedImage, Mesh3D, Pinhole, Points3D, Scalars,
        SegmentationImage, TextDocument, TextLog, Transform3D, ViewCoordinates,
    },
    components::{ImageFormat, MeshFaceRendering, TextLogLevel},
    datatypes::{ChannelDatatype, Quaternion, Rgba32},
};
use reel_replay::{frames_at, replay_with};
use reel_sim::{
    geometry::{FOCAL_PX, Pose},
    render::{TriangleSurface, srgb},
};
use reel_trace::{FrameLayers, Trace};
use reel_world::{
    DT_S, FRAME_HEIGHT, FRAME_WIDTH, InstanceId, InstanceKind, ObjectInstance, Rect, Task,
    instances, little_endian,
    record::{RobotState, StepRecord},
};

use crate::{
    ViewError,
    canvas::encode_png,
    scene_bodies::{SceneBody, moments, scene_bodies},
    transcript,
};

/// Radius of the points that carry names, in metres.
const NAME_M: f32 = 0.015;

const TARGET: Rgba32 = Rgba32::from_rgb(46, 160, 67);
const DISTRACTOR: Rgba32 = Rgba32::from_rgb(227, 140, 28);
const OTHER: Rgba32 = Rgba32::from_rgb(120, 132, 150);
const FURNITURE: Rgba32 = Rgba32::from_rgb(86, 104, 168);
const DOOR: Rgba32 = Rgba32::from_rgb(150, 92, 170);

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
        bodies: scene_bodies(trace, &moments(trace)),
    };
    recording.scene()?;
    if layers.masks {
        recording.names()?;
    }
    recording.moment(-1, 0, None, &trace.start.robot)?;
    let mut total = 0.0;
    for record in &trace.steps {
        recording.moment(
            i64::from(record.step),
            record.sim_step,
            Some(record.step),
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
    bodies: Vec<SceneBody>,
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
        let rooms = scene.rooms.iter().flat_map(|room| {
            let middle =
                |rect: &Rect, axis: usize| ((rect.min[axis] + rect.max[axis]) / 2.0) as f32;
            let first = room.footprint().into_iter().next();
            first.map(|rect| {
                (
                    [middle(&rect, 0), middle(&rect, 1), 0.0],
                    room.name.as_str(),
                    OTHER,
                )
            })
        });
        self.names_at("world/names/rooms", rooms)?;
        let receptacles = scene.receptacles.iter().map(|it| {
            let middle = |axis: usize| ((it.surface_min[axis] + it.surface_max[axis]) / 2.0) as f32;
            let place = [middle(0), middle(1), it.surface_height() as f32];
            let color = if it.door.exists() { DOOR } else { FURNITURE };
            (place, it.id.as_str(), color)
        });
        self.names_at("world/names/receptacles", receptacles)?;
        for body in &self.bodies {
            self.body(body)?;
        }
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
        for body in &self.bodies {
            self.moved(body, (step + 1) as usize)?;
        }
        Ok(())
    }

    /// Names in the scene, which a viewer hides with one click.
    fn names_at<'b>(
        &self,
        entity: &str,
        names: impl Iterator<Item = ([f32; 3], &'b str, Rgba32)>,
    ) -> Result<(), ViewError> {
        let names: Vec<_> = names.collect();
        let points = Points3D::new(names.iter().map(|(place, ..)| *place))
            .with_labels(names.iter().map(|(_, name, _)| *name))
            .with_colors(names.iter().map(|(.., color)| *color))
            .with_radii([NAME_M]);
        self.log_static(entity, &points)
    }

    /// The surfaces of a body; objects have an outline that tells their part in the task, too.
    fn body(&self, body: &SceneBody) -> Result<(), ViewError> {
        if let Some(mesh) = mesh(&body.surfaces) {
            self.log_static(entity(body), &mesh)?;
        }
        let task = &self.trace.task;
        let object = match body.instance.kind {
            InstanceKind::Object => task.object(&InstanceId::from(&*body.instance.name)),
            _ => None,
        };
        let Some(object) = object else {
            return Ok(());
        };
        let half = object.size.map(|side| (side / 2.0) as f32);
        let outline = Boxes3D::from_half_sizes([half])
            .with_labels([object.category.as_str()])
            .with_colors([color_of(task, object)]);
        self.log_static(entity(body).join(&entity_path!("outline")), &outline)
    }

    /// Where a body is from this moment on; a body that stays is not told again.
    fn moved(&self, body: &SceneBody, moment: usize) -> Result<(), ViewError> {
        let Some(poses) = &body.poses else {
            return Ok(());
        };
        if moment > 0 && poses[moment] == poses[moment - 1] {
            return Ok(());
        }
        let Pose { position, rotation } = poses[moment];
        let there =
            Transform3D::from_translation_rotation(position, Quaternion::from_xyzw(rotation));
        self.log(entity(body), &there)
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
            self.log(format!("reward/{component}"), &Scalars::single(value))?;
        }
        self.log("return", &Scalars::single(total))
    }

    fn log(&self, entity: impl Into<EntityPath>, what: &dyn AsComponents) -> Result<(), ViewError> {
        self.stream
            .log(entity, what)
            .map_err(|error: RecordingStreamError| failed(&error))
    }

    fn log_static(
        &self,
        entity: impl Into<EntityPath>,
        what: &dyn AsComponents,
    ) -> Result<(), ViewError> {
        self.stream
            .log_static(entity, what)
            .map_err(|error: RecordingStreamError| failed(&error))
    }
}

/// Where a body stands in the recording.
fn entity(body: &SceneBody) -> EntityPath {
    let name = body.instance.name.as_str();
    match body.kind() {
        "object" => entity_path!("world", "objects", name),
        "receptacle" => entity_path!("world", "receptacles", name),
        "door" => entity_path!("world", "doors", name),
        _ => entity_path!("world", name),
    }
}

/// The surfaces of a body; none where nothing of it is drawn. Faces are flat, so that triangles share
/// no corner.
fn mesh(surfaces: &[TriangleSurface]) -> Option<Mesh3D> {
    let (mut corners, mut normals, mut colors) = (Vec::new(), Vec::new(), Vec::new());
    for surface in surfaces {
        for (triangle, color) in surface.triangles.iter().zip(&surface.colors) {
            let [a, b, c] = triangle.map(|corner| surface.corners[corner as usize]);
            let [red, green, blue] = srgb(*color);
            corners.extend([a, b, c]);
            normals.extend([facing(a, b, c); 3]);
            colors.extend([Rgba32::from_rgb(red, green, blue); 3]);
        }
    }
    let mesh = Mesh3D::new(corners).with_vertex_normals(normals);
    let mesh = mesh
        .with_vertex_colors(colors)
        .with_face_rendering(MeshFaceRendering::Front);
    surfaces
        .iter()
        .any(|it| !it.triangles.is_empty())
        .then_some(mesh)
}

/// Where a triangle faces, as a vector of length 1; of one without an area, nowhere.
fn facing(a: [f32; 3], b: [f32; 3], c: [f32; 3]) -> [f32; 3] {
    let side = |to: [f32; 3]| [to[0] - a[0], to[1] - a[1], to[2] - a[2]];
    let ([ux, uy, uz], [vx, vy, vz]) = (side(b), side(c));
    let across = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    let length = across.iter().map(|it| it * it).sum::<f32>().sqrt();
    across.map(|it| if length > 0.0 { it / length } else { 0.0 })
}

/// What tells the target from what is like it and from the rest.
fn color_of(task: &Task, object: &ObjectInstance) -> Rgba32 {
    let target = task.object(&task.target);
    let like_target = target.is_some_and(|target| target.category == object.category);
    match () {
        () if object.instance == task.target => TARGET,
        () if like_target || task.object_distractors.contains(&object.asset) => DISTRACTOR,
        () => OTHER,
    }
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
