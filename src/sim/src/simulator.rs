//! The state of one episode in the simulator: physics, registry, inventory, markers, robot; its
//! graphs, images and digests. The tool handlers are in `tools`.

use std::sync::Arc;

use reel_world::{
    Digest, DoorState, FIRST_RECEPTACLE_INSTANCE, FLOOR, Frame, InstanceId, Profile,
    SHELL_INSTANCE, Scene, Task, WorldGraph,
    record::{BodyState, Graphs, Marker, MarkerTarget, RobotState, VisibleObject},
};

use crate::{
    PreparedTask,
    geometry::{Camera, Pose},
    model::{DoorMotion, ObjectModel, SceneModel, Surface},
    motion_sampler::MotionSampler,
    nav::{CAMERA_HEIGHT_M, NavMap, Viewpoint},
    physics::{Motion, Physics},
    published,
    render::{
        Detail, Drawable, OverlayMark, Region, TriangleSurface, for_runs, overlay, render,
        surfaces_of,
    },
};

/// Physics steps after spawning (docs/spec.md#task-filters).
pub const SPAWN_SETTLE_STEPS: u32 = 500;
/// Fewest pixels of a thing that is in view.
pub const VISIBLE_PIXELS: u32 = 12;
/// How far below or above a surface an object's lowest point may be and still rest
/// on it, in metres.
const REST_BELOW_M: f32 = 0.04;
const REST_ABOVE_M: f32 = 0.30;
/// How far its centre may be outside the surface, in metres.
const REST_ASIDE_M: f32 = 0.02;

/// The simulated world of one episode: physics, registry, robot and markers.
#[derive(Debug)]
pub struct Simulator {
    pub(crate) stage: Arc<PreparedTask>,
    pub(crate) profile: Profile,
    pub(crate) seed: u64,
    pub(crate) physics: Physics,
    pub(crate) registry: WorldGraph,
    /// Objects that stand somewhere, in the order in which they came there; kept by the
    /// published servers' tools only.
    pub(crate) arrivals: Vec<usize>,
    pub(crate) held: Option<usize>,
    pub(crate) markers: Vec<Marker>,
    pub(crate) has_marker_map: bool,
    /// Whether the markers stay through `gaze_at` (they stand for objects).
    pub(crate) markers_persist: bool,
    /// Furniture index of the receptacle the robot went to; `None` before it went to one.
    pub(crate) landmark: Option<usize>,
    pub(crate) robot: RobotState,
    /// What stood in the last image: (entity, pixels) runs over its rows.
    pub(crate) view: Vec<(u16, u32)>,
    pub(crate) detail: Detail,
    pub(crate) sim_step: u64,
    pub(crate) step_digests: Vec<u32>,
    /// The physics step, counted like `step_digests`, whose motion states are
    /// wanted, and these states.
    pub(crate) watch: Option<usize>,
    pub(crate) watched: Option<Vec<BodyState>>,
    pub(crate) motion: MotionSampler,
}

impl Simulator {
    /// Spawns the task's objects in the scene and lets them settle.
    pub fn new(stage: Arc<PreparedTask>, profile: Profile, seed: u64) -> Self {
        Self::new_watching(stage, profile, seed, None)
    }

    /// [`Simulator::new`], keeping the motion states after one physics step of the settling
    /// (from 0) for [`Simulator::take_watched`].
    pub fn new_watching(
        stage: Arc<PreparedTask>,
        profile: Profile,
        seed: u64,
        watch: Option<usize>,
    ) -> Self {
        let mut simulator = Self::empty(stage.clone(), profile, seed);
        simulator.watch = watch;
        for (index, object) in stage.task.objects.iter().enumerate() {
            let [x, y, z] = object.position.map(|value| value as f32);
            let lift = stage.spawn_offset(index);
            let pose = Pose::yawed([x, y, z + lift], object.yaw as f32);
            simulator
                .physics
                .insert_object(index, &stage.object_models[index], pose);
        }
        simulator.run(if profile.is_published() {
            published::START_STEPS
        } else {
            SPAWN_SETTLE_STEPS
        });
        simulator
    }

    /// What no call changes, to be shared with others of this task.
    pub fn stage(&self) -> &Arc<PreparedTask> {
        &self.stage
    }

    /// The task that this episode is about, shared through the stage.
    pub fn task(&self) -> &Task {
        &self.stage.task
    }

    /// The scene in which the episode takes place, shared through the stage.
    pub fn scene(&self) -> &Scene {
        &self.stage.scene
    }

    /// The scene as parts.
    pub fn model(&self) -> &SceneModel {
        &self.stage.model
    }

    /// The object models, in the order of the task's objects.
    pub fn object_models(&self) -> &[ObjectModel] {
        &self.stage.object_models
    }

    /// The navigation map of the scene, shared through the stage.
    pub fn nav(&self) -> &NavMap {
        &self.stage.nav
    }

    /// What the gripper holds.
    pub fn held(&self) -> Option<&InstanceId> {
        self.held
            .map(|index| &self.stage.task.objects[index].instance)
    }

    /// The current marker map; empty if there is none.
    pub fn markers(&self) -> &[Marker] {
        &self.markers
    }

    /// Whether there is a marker map, an empty one included.
    pub fn has_marker_map(&self) -> bool {
        self.has_marker_map
    }

    /// The receptacle the robot stands at.
    pub fn landmark(&self) -> Option<&reel_world::ReceptacleId> {
        self.landmark
            .map(|index| &self.stage.model.furniture[index].id)
    }

    /// The robot's state: base, heading, camera and length of the path driven.
    pub fn robot(&self) -> RobotState {
        self.robot
    }

    /// Physics steps since the start, those of a world at rest included.
    pub fn sim_step(&self) -> u64 {
        self.sim_step
    }

    /// Whether physics met a value that is not finite.
    pub fn fault(&self) -> bool {
        self.physics.fault()
    }

    /// Digests of the physics steps executed since this was last asked.
    pub fn take_step_digests(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.step_digests)
    }

    /// Keeps the motion states after one physics step of the next call
    /// (from 0) for [`Simulator::take_watched`].
    pub fn watch(&mut self, step: usize) {
        self.watch = Some(step);
    }

    /// The motion states after the watched physics step; none where it was not executed.
    pub fn take_watched(&mut self) -> Option<Vec<BodyState>> {
        self.watch = None;
        self.watched.take()
    }

    /// The world graphs of both authorities: physics, and the registry of picks and places.
    pub fn graphs(&self) -> Graphs {
        Graphs {
            physics: self.physical_graph(),
            registry: self.registry.clone(),
        }
    }

    /// Where physics says the objects are, and how the doors stand.
    pub fn physical_graph(&self) -> WorldGraph {
        let mut graph = WorldGraph::default();
        for (index, furniture) in self.stage.model.furniture.iter().enumerate() {
            let state = graph.receptacles.entry(furniture.id.clone()).or_default();
            state.door = self.door_state(index);
        }
        for (index, object) in self.stage.task.objects.iter().enumerate() {
            if let Some(place) = self.support_of(index) {
                let id = place.map_or_else(
                    || FLOOR.into(),
                    |furniture| self.stage.model.furniture[furniture].id.clone(),
                );
                graph.add(&id, &object.instance);
            }
        }
        graph
    }

    /// Door state of a piece of furniture; none where it has no door.
    pub fn door_state(&self, furniture: usize) -> Option<DoorState> {
        let door = self.stage.door_of[furniture]?;
        Some(if self.physics.door_is_open(door) {
            DoorState::Open
        } else {
            DoorState::Closed
        })
    }

    /// How far a drawer is out now, as a vector on the floor; zero for all other furniture.
    fn shift(&self, furniture: usize) -> [f32; 2] {
        let door = &self.stage.model.furniture[furniture].door;
        match (door, self.stage.door_of[furniture]) {
            (Some(door), Some(body)) if matches!(door.motion, DoorMotion::Slide(_)) => {
                door.shift(self.physics.door_position(body))
            }
            _ => [0.0; 2],
        }
    }

    /// The surface of a piece of furniture where it is now: that of a drawer comes out with it.
    pub(crate) fn surface(&self, furniture: usize) -> Surface {
        self.stage.model.furniture[furniture]
            .surface
            .moved(self.shift(furniture))
    }

    /// The bounding box of a piece of furniture where it is now, any hinged door closed.
    fn furniture_bounds(&self, furniture: usize) -> [[f32; 3]; 2] {
        let [x, y] = self.shift(furniture);
        self.stage.model.furniture[furniture]
            .bounds
            .map(|corner| [corner[0] + x, corner[1] + y, corner[2]])
    }

    /// The furniture an object rests on: `Some(None)` is the floor, `None` is the gripper.
    pub fn support_of(&self, object: usize) -> Option<Option<usize>> {
        let bounds = self.physics.object_bounds(object)?;
        let center = [
            (bounds[0][0] + bounds[1][0]) * 0.5,
            (bounds[0][1] + bounds[1][1]) * 0.5,
        ];
        let bottom = bounds[0][2];
        let mut best: Option<(f32, usize)> = None;
        let furniture = self.stage.model.furniture.iter().enumerate();
        for (index, _) in furniture.filter(|(_, furniture)| furniture.present) {
            let surface = self.surface(index);
            let inside = (0..2).all(|axis| {
                center[axis] >= surface.min[axis] - REST_ASIDE_M
                    && center[axis] <= surface.max[axis] + REST_ASIDE_M
            });
            let height = bottom - surface.z;
            if inside
                && (-REST_BELOW_M..=REST_ABOVE_M).contains(&height)
                && best.is_none_or(|(z, _)| surface.z > z)
            {
                best = Some((surface.z, index));
            }
        }
        Some(best.map(|(_, index)| index))
    }

    /// Motion state of every body, objects by instance and then doors.
    pub fn bodies(&self) -> Vec<BodyState> {
        let objects = self
            .stage
            .task
            .objects
            .iter()
            .enumerate()
            .filter_map(|(index, object)| {
                Some(body_state(
                    object.instance.to_string(),
                    self.physics.object_motion(index)?,
                ))
            });
        let doors = self
            .stage
            .model
            .furniture
            .iter()
            .zip(&self.stage.door_of)
            .filter_map(|(furniture, door)| {
                Some(body_state(
                    format!("door:{}", furniture.id),
                    self.physics.door_motion((*door)?),
                ))
            });
        objects.chain(doors).collect()
    }

    /// Digest of the whole state: motion, registry, inventory, markers, robot, counters.
    pub fn digest(&self) -> Digest {
        let mut hasher = blake3::Hasher::new();
        self.physics.hash_into(&mut hasher);
        hasher.update(reel_world::canonical_json(&self.registry).as_bytes());
        hasher.update(
            &self
                .held
                .map_or(u32::MAX, |index| index as u32)
                .to_le_bytes(),
        );
        hasher.update(reel_world::canonical_json(&self.markers).as_bytes());
        hasher.update(&[
            u8::from(self.has_marker_map),
            u8::from(self.markers_persist),
        ]);
        hasher.update(
            &self
                .landmark
                .map_or(u32::MAX, |index| index as u32)
                .to_le_bytes(),
        );
        let robot = &self.robot;
        let values = robot.base.iter().chain(&robot.camera).chain([
            &robot.yaw,
            &robot.pitch,
            &robot.path_length_m,
        ]);
        for value in values {
            hasher.update(&value.to_bits().to_le_bytes());
        }
        hasher.update(&self.seed.to_le_bytes());
        hasher.update(&self.sim_step.to_le_bytes());
        if self.profile.is_published() {
            for index in &self.arrivals {
                hasher.update(&(*index as u32).to_le_bytes());
            }
        }
        Digest(*hasher.finalize().as_bytes())
    }

    /// Shortest base path start -> src -> dest with a perfect map, in metres (`l` of SPL).
    pub fn shortest_path_m(&self) -> Option<f32> {
        let index = |id: &reel_world::ReceptacleId| {
            self.stage
                .model
                .furniture
                .iter()
                .position(|furniture| furniture.id == *id)
        };
        let source = self.stage.nav.viewpoint(
            &self.stage.model,
            self.robot.base,
            index(&self.stage.task.src)?,
        )?;
        let destination = self.stage.nav.viewpoint(
            &self.stage.model,
            source.base,
            index(&self.stage.task.dest)?,
        )?;
        Some(source.path_length_m + destination.path_length_m)
    }

    /// How much of each image is drawn from now on. Ids and depth, and so all that follows, do
    /// not depend on it.
    pub fn set_detail(&mut self, detail: Detail) {
        self.detail = detail;
    }

    /// Takes the image from the robot's head and remembers what is in view.
    pub fn capture_frame(&mut self) -> Frame {
        let frame = self.render_from(&self.camera());
        self.view = runs(&frame.ids);
        frame
    }

    /// [`Simulator::capture_frame`] for what stands in it alone.
    pub(crate) fn update_visible(&mut self) {
        self.view = runs(&self.render_with(&self.camera(), &[], Detail::Geometry).ids);
    }

    /// The image from any camera; changes nothing.
    pub fn render_from(&self, camera: &Camera) -> Frame {
        self.render_with(camera, &[], self.detail)
    }

    /// The image from any camera, with more in it than the scene.
    pub(crate) fn render_with(
        &self,
        camera: &Camera,
        extra: &[Drawable<'_>],
        detail: Detail,
    ) -> Frame {
        let mut drawables = self.drawables();
        drawables.extend_from_slice(extra);
        render(camera, &drawables, detail)
    }

    /// How many pixels of an instance a camera would see if nothing stood before it.
    pub fn unoccluded_pixels(&self, camera: &Camera, instance: u16) -> usize {
        let mut alone = self.drawables();
        alone.retain(|drawable| drawable.entity == instance);
        let frame = render(camera, &alone, Detail::Geometry);
        frame.ids.iter().filter(|id| **id == instance).count()
    }

    /// The surfaces that frames show, as triangles in the scene's frame: one for each part of an
    /// instance, in the order of the instances.
    pub fn surfaces(&self) -> Vec<TriangleSurface> {
        self.drawables().iter().flat_map(surfaces_of).collect()
    }

    /// What stands in the scene: shell, furniture with its doors, and objects.
    fn drawables(&self) -> Vec<Drawable<'_>> {
        let shell = Drawable {
            parts: &self.stage.model.shell,
            mesh: None,
            pose: Pose::IDENTITY,
            entity: SHELL_INSTANCE,
        };
        let mut drawables = vec![shell];
        for (index, furniture) in self.stage.model.furniture.iter().enumerate() {
            let entity = furniture_entity(index);
            drawables.push(Drawable {
                parts: &furniture.parts,
                mesh: None,
                pose: Pose::IDENTITY,
                entity,
            });
            if let (Some(door), Some(body)) = (&furniture.door, self.stage.door_of[index]) {
                let pose = self.physics.door_motion(body).pose;
                drawables.push(Drawable {
                    parts: &door.parts,
                    mesh: None,
                    pose,
                    entity,
                });
            }
        }
        for (index, shape) in self.stage.object_models.iter().enumerate() {
            if let Some(motion) = self.physics.object_motion(index) {
                drawables.push(shape.drawable(motion.pose, self.object_entity(index)));
            }
        }
        drawables
    }

    /// Camera pose of the robot's head: position, yaw and pitch.
    pub fn camera(&self) -> Camera {
        Camera {
            position: self.robot.camera,
            yaw: self.robot.yaw,
            pitch: self.robot.pitch,
        }
    }

    /// Objects in the last image, in the task's order.
    pub fn visible(&self) -> Vec<VisibleObject> {
        let seen = seen_entities(&self.view);
        let objects = self.stage.task.objects.iter().enumerate();
        let visible = objects.filter_map(|(index, object)| {
            let sight = seen
                .get(usize::from(self.object_entity(index)))?
                .filter(|sight| sight.pixels >= VISIBLE_PIXELS)?;
            Some(VisibleObject {
                object: object.instance.clone(),
                pixels: sight.pixels,
                bbox: sight.bbox,
            })
        });
        visible.collect()
    }

    /// How each entity stands in the last image, by entity number.
    pub(crate) fn sights(&self) -> Vec<Option<VisibleEntity>> {
        seen_entities(&self.view)
    }

    pub(crate) fn object_entity(&self, index: usize) -> u16 {
        furniture_entity(self.stage.model.furniture.len() + index)
    }

    /// The entity that a marker stands for.
    pub(crate) fn entity(&self, target: &MarkerTarget) -> Option<u16> {
        match target {
            MarkerTarget::Object(object) => self
                .object_index(object)
                .map(|index| self.object_entity(index)),
            MarkerTarget::Receptacle(id) => self.furniture_index(id).map(furniture_entity),
        }
    }

    pub(crate) fn object_index(&self, instance: &InstanceId) -> Option<usize> {
        self.stage
            .task
            .objects
            .iter()
            .position(|object| object.instance == *instance)
    }

    pub(crate) fn furniture_index(&self, id: &reel_world::ReceptacleId) -> Option<usize> {
        self.stage
            .model
            .furniture
            .iter()
            .position(|furniture| furniture.id == *id)
    }

    /// The scene with its doors, and the robot at its start; no objects yet.
    fn empty(stage: Arc<PreparedTask>, profile: Profile, seed: u64) -> Self {
        let physics = Physics::new(&stage.model, stage.object_models.len());
        Self {
            registry: stage.task.initial.clone(),
            arrivals: stage.task.placement_order(),
            robot: start_robot(&stage.scene, &stage.model, &stage.nav),
            stage,
            profile,
            seed,
            physics,
            held: None,
            markers: Vec::new(),
            has_marker_map: false,
            markers_persist: false,
            landmark: None,
            view: runs(&Frame::new().ids),
            detail: Detail::Full,
            sim_step: 0,
            step_digests: Vec::new(),
            watch: None,
            watched: None,
            motion: MotionSampler::default(),
        }
    }

    /// Runs physics for so many steps, or until everything sleeps: the rest would change nothing.
    pub(crate) fn run(&mut self, steps: u32) {
        for executed in 0..steps {
            // What was just inserted or driven joins the active bodies only in the next step.
            if executed > 0 && self.physics.at_rest() {
                break;
            }
            self.physics.step();
            if self.watch == Some(self.step_digests.len()) {
                self.watched = Some(self.bodies());
            }
            self.step_digests.push(self.physics.step_digest());
            self.sample_due(self.sim_step + u64::from(executed) + 1);
        }
        self.sim_step += u64::from(steps);
        self.sample_due(self.sim_step);
    }

    /// Drives the robot to a viewpoint.
    pub(crate) fn go(&mut self, viewpoint: &Viewpoint) {
        self.robot.base = viewpoint.base;
        self.robot.camera = viewpoint.camera.position;
        self.robot.yaw = viewpoint.camera.yaw;
        self.robot.pitch = viewpoint.camera.pitch;
        self.robot.path_length_m += viewpoint.path_length_m;
    }

    /// Draws the current markers into an image, those of them that are in it.
    pub(crate) fn draw_markers(&self, frame: &mut Frame) {
        if self.detail == Detail::Geometry {
            return;
        }
        let sights = self.sights();
        let marks: Vec<OverlayMark> = self
            .markers
            .iter()
            .filter_map(|marker| {
                let entity = self.entity(&marker.target)?;
                sights
                    .get(usize::from(entity))?
                    .filter(|sight| sight.pixels >= VISIBLE_PIXELS)?;
                let region = match &marker.target {
                    MarkerTarget::Object(_) => Region::Entity(entity),
                    MarkerTarget::Receptacle(id) => {
                        let index = self.furniture_index(id)?;
                        let bounds = self.furniture_bounds(index);
                        let covered = self.camera().projected(bounds);
                        covered.map_or(Region::Entity(entity), Region::Rectangle)
                    }
                };
                Some(OverlayMark {
                    number: marker.id,
                    region,
                })
            })
            .collect();
        overlay(frame, &marks);
    }
}

/// How one entity stands in an image.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct VisibleEntity {
    pub(crate) pixels: u32,
    pub(crate) bbox: [u16; 4],
    /// Sum of the columns, for the mean.
    pub(crate) column_sum: u64,
}

impl VisibleEntity {
    /// Mean column times 16, so that things can be put in order from left to right.
    pub(crate) fn column(&self) -> u64 {
        self.column_sum * 16 / u64::from(self.pixels)
    }
}

pub(crate) fn furniture_entity(index: usize) -> u16 {
    FIRST_RECEPTACLE_INSTANCE + u16::try_from(index).expect("a scene has fewer than 65,000 things")
}

/// The entities of an image as runs.
fn runs(ids: &[u16]) -> Vec<(u16, u32)> {
    let mut runs = Vec::new();
    for_runs(ids, |run, id| runs.push((id, run.len() as u32)));
    runs
}

fn seen_entities(view: &[(u16, u32)]) -> Vec<Option<VisibleEntity>> {
    const WIDTH: u32 = reel_world::FRAME_WIDTH as u32;
    let mut seen: Vec<Option<VisibleEntity>> = Vec::new();
    let mut at = 0;
    for &(id, pixels) in view {
        let (id, end) = (usize::from(id), at + pixels);
        if id >= seen.len() {
            seen.resize(id + 1, None);
        }
        while at < end {
            let (row, first) = (at / WIDTH, at % WIDTH);
            let last = (first + end - at - 1).min(WIDTH - 1);
            let (x0, x1, y) = (first as u16, last as u16, row as u16);
            let sight = seen[id].get_or_insert(VisibleEntity {
                pixels: 0,
                bbox: [x0, y, x1, y],
                column_sum: 0,
            });
            sight.pixels += last - first + 1;
            sight.column_sum += u64::from(first + last) * u64::from(last - first + 1) / 2;
            let [left, top, right, bottom] = sight.bbox;
            sight.bbox = [left.min(x0), top.min(y), right.max(x1), bottom.max(y)];
            at += last - first + 1;
        }
    }
    seen
}

fn body_state(body: String, motion: Motion) -> BodyState {
    BodyState {
        body,
        position: motion.pose.position,
        rotation: motion.pose.rotation,
        linear_velocity: motion.linear,
        angular_velocity: motion.angular,
        asleep: motion.asleep,
    }
}

/// The given start, or the free place nearest to the middle of the scene, looking along +x.
fn start_robot(scene: &Scene, model: &SceneModel, nav: &NavMap) -> RobotState {
    let [x, y, yaw] = scene.robot_start.unwrap_or_else(|| {
        let [min, max] = model.bounds;
        [
            f64::from(min[0] + max[0]) * 0.5,
            f64::from(min[1] + max[1]) * 0.5,
            0.0,
        ]
    });
    let wanted = [x as f32, y as f32];
    let base = nav.free_near(wanted).unwrap_or(wanted);
    RobotState {
        base,
        yaw: yaw as f32,
        camera: [base[0], base[1], CAMERA_HEIGHT_M],
        pitch: -0.3,
        path_length_m: 0.0,
    }
}
