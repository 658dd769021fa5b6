//! The rapier world: fixed furniture, doors, drawers and free objects, stepped at 1/240 s.
//!
//! Bodies go in in canonical order (shell, furniture, doors, objects by instance), because
//! another order gives other bits. One thread owns a step. Everything that moves is named by an
//! entity number in `user_data`.

use rapier3d::prelude::*;
use reel_world::DT_S;
use serde::{Deserialize, Serialize};

use crate::{
    geometry::{self, Part},
    model::{DoorModel, DoorMotion, Hull, ObjectModel, SceneModel},
};

/// How far above its place an object is spawned (docs/spec.md#task-filters).
pub const SPAWN_OFFSET_M: f32 = 0.1;

const FRICTION: f32 = 0.7;
/// Without damping balls and cylinders would roll on for ever and never sleep.
const LINEAR_DAMPING: f32 = 0.2;
const ANGULAR_DAMPING: f32 = 2.0;
/// Critically damped door motor: 15 rad/s reaches 90 degrees to within 1.3 in 100 steps.
const DOOR_STIFFNESS: f32 = 225.0;
const DOOR_DAMPING: f32 = 30.0;
/// How fast the motor of a drawer goes, in metres per second: slow enough that friction carries
/// what lies in it.
const DRAWER_SPEED: f32 = 0.4;
/// Physics steps after which a drawer that was driven stands where its motor is.
const DRAWER_SETTLE_STEPS: f32 = 80.0;
/// Fixed bodies and doors are in all groups but this one, and what is [`DoorModel::guided`]
/// collides with this group alone: with objects, which are in all groups.
const MOVABLE: Group = Group::GROUP_32;
/// The group of guided doors.
const GUIDED: Group = Group::GROUP_31;
/// Turns the y axis, along which rapier's cylinders stand, to our z.
const Y_TO_Z: Rotation = Rotation::from_xyzw(
    std::f32::consts::FRAC_1_SQRT_2,
    0.0,
    0.0,
    std::f32::consts::FRAC_1_SQRT_2,
);

/// Motion state of one body.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Motion {
    /// Pose of the body in the scene frame, position in metres.
    pub pose: geometry::Pose,
    /// In metres per second.
    pub linear: [f32; 3],
    /// In radians per second.
    pub angular: [f32; 3],
    /// Whether physics put it to sleep.
    pub asleep: bool,
}

/// The physics of one episode. Its serialized form is a snapshot for the same build of the
/// engine, no file format.
#[derive(Serialize, Deserialize)]
pub struct Physics {
    world: PhysicsWorld,
    objects: Vec<Option<RigidBodyHandle>>,
    doors: Vec<DoorBody>,
    fault: bool,
}

#[derive(Serialize, Deserialize)]
struct DoorBody {
    body: RigidBodyHandle,
    joint: ImpulseJointHandle,
    closed: geometry::Pose,
    motion: DoorMotion,
    /// Where it is driven to: radians of a hinge, metres of a slide.
    target: f32,
    /// Where its motor wants it now. A hinge's motor wants it at the target at once.
    command: f32,
}

impl Physics {
    /// Builds the fixed world and the doors; objects come by [`Physics::insert_object`].
    pub fn new(model: &SceneModel, object_count: usize) -> Self {
        let mut world = PhysicsWorld::new();
        world.gravity = Vector::new(0.0, 0.0, -9.81);
        world.integration_parameters.dt = DT_S;
        let shell = world.insert_body(RigidBodyBuilder::fixed());
        insert_colliders(&mut world, shell, &model.shell, None, not_movable());
        let mut doors = Vec::new();
        let mut frames = Vec::new();
        for furniture in &model.furniture {
            let body = world.insert_body(RigidBodyBuilder::fixed());
            insert_colliders(&mut world, body, &furniture.parts, None, not_movable());
            frames.push(body);
        }
        for (furniture, frame) in model.furniture.iter().zip(frames) {
            if let Some(door) = &furniture.door {
                doors.push(insert_door(&mut world, frame, door));
            }
        }
        Self {
            world,
            objects: vec![None; object_count],
            doors,
            fault: false,
        }
    }

    /// Puts an object into the world at a pose.
    pub fn insert_object(&mut self, index: usize, model: &ObjectModel, pose: geometry::Pose) {
        assert!(
            self.objects[index].is_none(),
            "object {index} is already in the world"
        );
        let builder = RigidBodyBuilder::dynamic()
            .pose(to_rapier(&pose))
            .linear_damping(LINEAR_DAMPING)
            .angular_damping(ANGULAR_DAMPING)
            .user_data(index as u128);
        let body = self.world.insert_body(builder);
        let density = Some(model.density);
        insert_colliders(
            &mut self.world,
            body,
            &model.parts,
            density,
            InteractionGroups::all(),
        );
        if let Some(mesh) = &model.mesh {
            insert_hull(&mut self.world, body, &mesh.hull, model.density);
        }
        self.objects[index] = Some(body);
    }

    /// Takes an object out of the world.
    pub fn remove_object(&mut self, index: usize) {
        let body = self.objects[index]
            .take()
            .expect("the object is in the world");
        self.world.remove_body(body);
    }

    /// Drives a door (in the order of the furniture that has one) towards open or closed.
    pub fn drive_door(&mut self, door: usize, open: bool) {
        let state = &mut self.doors[door];
        state.target = if open {
            state.motion.open_position()
        } else {
            0.0
        };
        if let DoorMotion::Hinge(_) = state.motion {
            let target = state.target;
            self.command(door, target);
        }
    }

    /// Physics steps that a drawer needs to open or close; none for a door, whose motor is as fast
    /// as its spring.
    pub fn travel_steps(&self, door: usize) -> u32 {
        match self.doors[door].motion {
            DoorMotion::Hinge(_) => 0,
            DoorMotion::Slide(distance) => {
                (distance / (DRAWER_SPEED * DT_S) + DRAWER_SETTLE_STEPS) as u32
            }
        }
    }

    /// Tells the motor of a door where it is wanted now.
    fn command(&mut self, door: usize, position: f32) {
        let state = &mut self.doors[door];
        state.command = position;
        let joint = self
            .world
            .impulse_joints
            .get_mut(state.joint, true)
            .expect("doors are never removed");
        joint.data.set_motor_position(
            axis_of(state.motion),
            position,
            DOOR_STIFFNESS,
            DOOR_DAMPING,
        );
        let body = state.body;
        self.world.wake_up(body, true);
    }

    /// Moves on the motors of drawers that are not where they are driven to.
    fn command_drawers(&mut self) {
        for door in 0..self.doors.len() {
            let DoorBody {
                target, command, ..
            } = self.doors[door];
            if target != command {
                let step = DRAWER_SPEED * DT_S;
                self.command(door, command + (target - command).clamp(-step, step));
            }
        }
    }

    /// How far a door is open as it stands now, in radians of a hinge or metres of a slide;
    /// closed is 0.
    pub fn door_position(&self, door: usize) -> f32 {
        let DoorBody { closed, motion, .. } = &self.doors[door];
        let pose = self.door_motion(door).pose;
        match motion {
            DoorMotion::Hinge(_) => {
                let [x, y, z, w] = pose.rotation;
                let [closed_x, closed_y, closed_z, closed_w] = closed.rotation;
                let sine = (z * closed_w - w * closed_z) + (x * closed_y - y * closed_x);
                let cosine = (w * closed_w + z * closed_z) + (x * closed_x + y * closed_y);
                2.0 * libm::atan2f(sine, cosine)
            }
            DoorMotion::Slide(_) => {
                let way = geometry::sub(pose.position, closed.position);
                geometry::dot(closed.rotate([1.0, 0.0, 0.0]), way)
            }
        }
    }

    /// Whether a door is nearer to open than to closed.
    pub fn door_is_open(&self, door: usize) -> bool {
        self.door_position(door) / self.doors[door].motion.open_position() > 0.5
    }

    /// One step of 1/240 s.
    pub fn step(&mut self) {
        self.command_drawers();
        self.world.step();
        self.fault |= !self.world.quarantine().is_empty();
    }

    /// The same step with nothing of ours around it: what measurements compare with.
    pub fn step_bare(&mut self) {
        self.world.step();
    }

    /// Whether everything sleeps, so that further steps change nothing.
    pub fn at_rest(&self) -> bool {
        self.world.islands.num_active_bodies() == 0
    }

    /// Whether physics met a value that is not finite and took the body out.
    pub fn fault(&self) -> bool {
        self.fault
    }

    /// Motion of an object; none while it is held.
    pub fn object_motion(&self, index: usize) -> Option<Motion> {
        self.objects[index].map(|body| motion(&self.world.bodies[body]))
    }

    /// Motion of a door.
    pub fn door_motion(&self, door: usize) -> Motion {
        motion(&self.world.bodies[self.doors[door].body])
    }

    /// Where a door is driven to, in radians of a hinge or metres of a slide.
    pub fn door_target(&self, door: usize) -> f32 {
        self.doors[door].target
    }

    /// How many objects there are, held ones included.
    pub fn object_count(&self) -> usize {
        self.objects.len()
    }

    /// How many doors there are.
    pub fn door_count(&self) -> usize {
        self.doors.len()
    }

    /// Bounding box of an object's colliders: lower and upper corner; none while it is held.
    pub fn object_bounds(&self, index: usize) -> Option<[[f32; 3]; 2]> {
        let body = &self.world.bodies[self.objects[index]?];
        let mut bounds = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
        for collider in body.colliders() {
            let collider = &self.world.colliders[*collider];
            // The body's pose, not the collider's: that one lags until the next step.
            let pose = match collider.position_wrt_parent() {
                Some(local) => *body.position() * *local,
                None => *collider.position(),
            };
            let aabb = collider.shape().compute_aabb(&pose);
            let [low, high] = &mut bounds;
            *low = std::array::from_fn(|axis| low[axis].min(aabb.mins[axis]));
            *high = std::array::from_fn(|axis| high[axis].max(aabb.maxs[axis]));
        }
        Some(bounds)
    }

    /// Feeds the motion state of everything that moves, in stable order, to a hasher.
    pub fn hash_into(&self, hasher: &mut blake3::Hasher) {
        for (index, body) in self.objects.iter().enumerate() {
            hasher.update(&(index as u32).to_le_bytes());
            match body {
                None => hasher.update(&[0]),
                Some(body) => hash_motion(hasher, &motion(&self.world.bodies[*body])),
            };
        }
        for (index, door) in self.doors.iter().enumerate() {
            hasher.update(&(index as u32).to_le_bytes());
            hasher.update(&door.target.to_bits().to_le_bytes());
            if let DoorMotion::Slide(_) = door.motion {
                hasher.update(&door.command.to_bits().to_le_bytes());
            }
            hash_motion(hasher, &motion(&self.world.bodies[door.body]));
        }
        hasher.update(&[u8::from(self.fault)]);
    }

    /// First four bytes of the digest of the motion state.
    pub fn step_digest(&self) -> u32 {
        let mut hasher = blake3::Hasher::new();
        self.hash_into(&mut hasher);
        let bytes = hasher.finalize();
        u32::from_le_bytes([
            bytes.as_bytes()[0],
            bytes.as_bytes()[1],
            bytes.as_bytes()[2],
            bytes.as_bytes()[3],
        ])
    }
}

impl std::fmt::Debug for Physics {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "Physics({} objects, {} doors)",
            self.objects.len(),
            self.doors.len()
        )
    }
}

fn insert_door(world: &mut PhysicsWorld, frame: RigidBodyHandle, door: &DoorModel) -> DoorBody {
    let builder = RigidBodyBuilder::dynamic()
        .pose(to_rapier(&door.closed))
        .angular_damping(0.5)
        .gravity_scale(0.0);
    let body = world.insert_body(builder);
    let groups = if door.guided {
        InteractionGroups::new(GUIDED, MOVABLE, InteractionTestMode::And)
    } else {
        not_movable()
    };
    insert_colliders(world, body, &door.parts, Some(300.0), groups);
    // The closed door's frame, seen from the fixed body (whose frame is the scene's) and from the
    // door. A joint turns around and slides along the x axis of its frames; a hinge is the z axis
    // of the door's frame, so there both carry the rotation of x to z.
    let x_to_z = Rotation::from_xyzw(
        0.0,
        -std::f32::consts::FRAC_1_SQRT_2,
        0.0,
        std::f32::consts::FRAC_1_SQRT_2,
    );
    let (axes, frame_of_axis) = match door.motion {
        DoorMotion::Hinge(_) => (JointAxesMask::LOCKED_REVOLUTE_AXES, x_to_z),
        DoorMotion::Slide(_) => (JointAxesMask::LOCKED_PRISMATIC_AXES, Rotation::IDENTITY),
    };
    let frame_of_axis = Pose::from_parts(Vector::ZERO, frame_of_axis);
    let axis = axis_of(door.motion);
    let joint = GenericJointBuilder::new(axes)
        .local_frame1(to_rapier(&door.closed) * frame_of_axis)
        .local_frame2(frame_of_axis)
        .motor_model(axis, MotorModel::AccelerationBased)
        .motor_position(axis, 0.0, DOOR_STIFFNESS, DOOR_DAMPING)
        .contacts_enabled(false);
    let joint = world.insert_impulse_joint(frame, body, joint);
    DoorBody {
        body,
        joint,
        closed: door.closed,
        motion: door.motion,
        target: 0.0,
        command: 0.0,
    }
}

/// The axis of a joint that a door moves along or around.
fn axis_of(motion: DoorMotion) -> JointAxis {
    match motion {
        DoorMotion::Hinge(_) => JointAxis::AngX,
        DoorMotion::Slide(_) => JointAxis::LinX,
    }
}

/// The groups of what guided doors pass.
fn not_movable() -> InteractionGroups {
    InteractionGroups::new(
        Group::ALL.difference(MOVABLE),
        Group::ALL,
        InteractionTestMode::And,
    )
}

fn insert_colliders(
    world: &mut PhysicsWorld,
    body: RigidBodyHandle,
    parts: &[Part],
    density: Option<f32>,
    groups: InteractionGroups,
) {
    for part in parts.iter().filter(|part| part.solid) {
        let pose = to_rapier(&part.pose);
        let upright = pose * Pose::from_parts(Vector::ZERO, Y_TO_Z);
        let (builder, pose) = match part.shape {
            geometry::Shape::Cuboid { half: [x, y, z] } => (ColliderBuilder::cuboid(x, y, z), pose),
            geometry::Shape::Ball { radius } => (ColliderBuilder::ball(radius), pose),
            geometry::Shape::Cylinder {
                radius,
                half_height,
            } => (ColliderBuilder::cylinder(half_height, radius), upright),
            geometry::Shape::Capsule {
                radius,
                half_height,
            } => (ColliderBuilder::capsule_y(half_height, radius), upright),
            geometry::Shape::Cone { .. } => unreachable!("a cone is never solid"),
        };
        let builder = builder
            .position(pose)
            .friction(FRICTION)
            .restitution(0.0)
            .collision_groups(groups);
        let builder = match density {
            Some(density) => builder.density(density),
            None => builder,
        };
        world.insert_collider(builder, Some(body));
    }
}

fn insert_hull(world: &mut PhysicsWorld, body: RigidBodyHandle, hull: &Hull, density: f32) {
    let points = hull
        .points
        .iter()
        .map(|point| Vector::from(*point))
        .collect();
    let builder = ColliderBuilder::convex_mesh(points, &hull.triangles).expect("a hull is closed");
    world.insert_collider(
        builder.friction(FRICTION).restitution(0.0).density(density),
        Some(body),
    );
}

fn to_rapier(pose: &geometry::Pose) -> Pose {
    let [x, y, z, w] = pose.rotation;
    Pose::from_parts(Vector::from(pose.position), Rotation::from_xyzw(x, y, z, w))
}

fn motion(body: &RigidBody) -> Motion {
    let (position, rotation) = (body.translation(), body.rotation());
    let (linear, angular) = (body.linvel(), body.angvel());
    Motion {
        pose: geometry::Pose {
            position: position.into(),
            rotation: [rotation.x, rotation.y, rotation.z, rotation.w],
        },
        linear: linear.into(),
        angular: angular.into(),
        asleep: body.is_sleeping(),
    }
}

fn hash_motion<'h>(hasher: &'h mut blake3::Hasher, motion: &Motion) -> &'h mut blake3::Hasher {
    let values = motion
        .pose
        .position
        .iter()
        .chain(&motion.pose.rotation)
        .chain(&motion.linear)
        .chain(&motion.angular);
    let mut bytes = [0u8; 13 * 4 + 1];
    for (slot, value) in bytes.chunks_exact_mut(4).zip(values) {
        slot.copy_from_slice(&value.to_bits().to_le_bytes());
    }
    bytes[52] = u8::from(motion.asleep);
    hasher.update(&bytes)
}
