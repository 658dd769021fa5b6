//! Scenes made to fail: physics that reaches every place where an engine calls mathematics of the
//! platform. The determinism checks run them in every build, on every CPU and C library, and
//! restored in the middle of motion.
//!
//! Household scenes reach few of these places, so equal digests there prove little.

use rapier3d::prelude::*;
use reel_world::{DT_S, Digest};

/// A scene made to fail.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Stress {
    /// Tumbling compounds with parts off their axes: inertia that is not diagonal.
    Compounds,
    /// Hinges and ball joints driven against limits at odd angles.
    Limits,
    /// 1,200 colliders of all shapes, some of which come and go: large bounding-volume
    /// trees that are rebuilt.
    Crowd,
}

impl Stress {
    /// All stress scenes, in the order of their declaration.
    pub const ALL: [Stress; 3] = [Stress::Compounds, Stress::Limits, Stress::Crowd];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Stress::Compounds => "compounds",
            Stress::Limits => "limits",
            Stress::Crowd => "crowd",
        }
    }

    /// Runs so many steps of 1/240 s and gives the digest of all motion in all of them. With
    /// `restore_every` the world is written to bytes and read back each so many steps, and
    /// nothing else is kept.
    pub fn run(self, steps: u32, restore_every: Option<u32>) -> Digest {
        crate::math::link();
        let mut world = PhysicsWorld::new();
        world.gravity = Vector::new(0.0, 0.0, -9.81);
        world.integration_parameters.dt = DT_S;
        let floor = world.insert_body(RigidBodyBuilder::fixed());
        world.insert_collider(
            ColliderBuilder::cuboid(20.0, 20.0, 0.1).translation(Vector::new(0.0, 0.0, -0.1)),
            Some(floor),
        );
        let mut moving = match self {
            Stress::Compounds => (0..40).map(|index| compound(&mut world, index)).collect(),
            Stress::Limits => limits(&mut world),
            Stress::Crowd => (0..300)
                .map(|index| clutter(&mut world, index))
                .collect::<Vec<_>>(),
        };
        let mut hasher = blake3::Hasher::new();
        for step in 0..steps {
            if self == Stress::Crowd && step % 25 == 24 {
                let gone = (step as usize * 7) % moving.len();
                world.remove_body(moving[gone]);
                moving[gone] = clutter(&mut world, 300 + step);
            }
            if self == Stress::Limits && step % 60 == 30 {
                for body in &moving {
                    world.bodies[*body].apply_torque_impulse(Vector::new(0.05, -0.03, 0.07), true);
                }
            }
            if restore_every.is_some_and(|every| step % every == every - 1) {
                let bytes = postcard::to_allocvec(&world).expect("a world can be written");
                world = postcard::from_bytes(&bytes).expect("what was written can be read");
            }
            world.step();
            for body in &moving {
                let body = &world.bodies[*body];
                let (rotation, position) = (body.rotation(), body.translation());
                for value in position
                    .to_array()
                    .iter()
                    .chain(&rotation.to_array())
                    .chain(&body.angvel().to_array())
                {
                    hasher.update(&value.to_bits().to_le_bytes());
                }
            }
        }
        Digest(*hasher.finalize().as_bytes())
    }
}

/// A number between 0 and 1 that differs for every index and purpose, exactly computed.
fn share(index: u32, purpose: u32) -> f32 {
    let mixed = index
        .wrapping_mul(2_654_435_761)
        .wrapping_add(purpose.wrapping_mul(40_503))
        >> 8;
    (mixed % 65_536) as f32 / 65_536.0
}

fn place(index: u32, spread: f32) -> Pose {
    let at = |purpose| (share(index, purpose) - 0.5) * spread;
    let rotation = Rotation::from_xyzw(at(1), at(2), at(3), 1.0 + spread).normalize();
    Pose::from_parts(
        Vector::new(at(4), at(5), 0.4 + 1.6 * share(index, 6)),
        rotation,
    )
}

/// An L with a ball on an arm: no axis of it is an axis of its inertia.
fn compound(world: &mut PhysicsWorld, index: u32) -> RigidBodyHandle {
    let body = RigidBodyBuilder::dynamic()
        .pose(place(index, 3.0))
        .angvel(Vector::new(share(index, 7) * 9.0, -4.0, 2.0));
    let body = world.insert_body(body);
    let size = 0.05 + 0.1 * share(index, 8);
    let tilted = |x: f32, y: f32, z: f32| {
        Pose::from_parts(
            Vector::new(x * size, y * size, z * size),
            Rotation::from_xyzw(share(index, 9), 0.3, share(index, 10) - 0.5, 1.0).normalize(),
        )
    };
    let parts = [
        ColliderBuilder::cuboid(size, size * 0.3, size * 0.2).position(tilted(1.0, 0.2, 0.1)),
        ColliderBuilder::cylinder(size, size * 0.3).position(tilted(-0.4, 0.9, 0.5)),
        ColliderBuilder::capsule_z(size * 0.7, size * 0.2).position(tilted(0.1, -0.8, 0.6)),
        ColliderBuilder::ball(size * 0.5).position(tilted(0.6, 0.5, -1.1)),
    ];
    for part in parts {
        world.insert_collider(
            part.density(300.0 + 900.0 * share(index, 11))
                .friction(0.6)
                .restitution(0.4),
            Some(body),
        );
    }
    body
}

/// Chains of bars on joints whose limits lie at angles that no table has.
fn limits(world: &mut PhysicsWorld) -> Vec<RigidBodyHandle> {
    let mut moving = Vec::new();
    for chain in 0..12 {
        let x = chain as f32 * 0.7 - 4.0;
        let mut before =
            world.insert_body(RigidBodyBuilder::fixed().translation(Vector::new(x, 0.0, 2.0)));
        for link in 0..5 {
            let index = chain * 5 + link;
            let at = Vector::new(x, 0.3 + 0.3 * link as f32, 2.0);
            let bar = world.insert_body(
                RigidBodyBuilder::dynamic()
                    .translation(at)
                    .angular_damping(0.1),
            );
            world.insert_collider(
                ColliderBuilder::cuboid(0.03, 0.14, 0.02).density(800.0),
                Some(bar),
            );
            let [low, high] = [-0.1 - 1.3 * share(index, 12), 0.1 + 1.9 * share(index, 13)];
            let anchors = |joint: GenericJointBuilder| {
                let (near, far) = (Vector::new(0.0, 0.15, 0.0), Vector::new(0.0, -0.15, 0.0));
                joint
                    .local_anchor1(near)
                    .local_anchor2(far)
                    .contacts_enabled(false)
            };
            let joint = if index % 2 == 0 {
                anchors(GenericJointBuilder::new(
                    JointAxesMask::LOCKED_REVOLUTE_AXES,
                ))
                .limits(JointAxis::AngX, [low, high])
                .motor_velocity(
                    JointAxis::AngX,
                    2.0 - 4.0 * share(index, 14),
                    0.6,
                )
            } else {
                anchors(GenericJointBuilder::new(
                    JointAxesMask::LOCKED_SPHERICAL_AXES,
                ))
                .limits(JointAxis::AngX, [low, high])
                .limits(JointAxis::AngY, [low * 0.4, high * 0.3])
                .limits(JointAxis::AngZ, [low * 0.7, high * 0.6])
            };
            world.insert_impulse_joint(before, bar, joint);
            moving.push(bar);
            before = bar;
        }
    }
    moving
}

/// One of many things of all shapes, four colliders each.
fn clutter(world: &mut PhysicsWorld, index: u32) -> RigidBodyHandle {
    let body = world.insert_body(
        RigidBodyBuilder::dynamic()
            .pose(place(index, 5.0))
            .angular_damping(0.5),
    );
    for part in 0..4 {
        let (index, size) = (index * 4 + part, 0.02 + 0.05 * share(index * 4 + part, 15));
        let builder = match index % 4 {
            0 => ColliderBuilder::cuboid(size, size * 1.7, size * 0.6),
            1 => ColliderBuilder::ball(size),
            2 => ColliderBuilder::cylinder(size, size * 0.8),
            _ => ColliderBuilder::capsule_x(size, size * 0.5),
        };
        let offset = Vector::new(
            share(index, 16) - 0.5,
            share(index, 17) - 0.5,
            share(index, 18) - 0.5,
        ) * 0.15;
        world.insert_collider(
            builder.translation(offset).friction(0.5).density(500.0),
            Some(body),
        );
    }
    body
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn restored_in_the_middle_of_motion_the_rest_is_the_same() {
        let steps = if reel_vectors::is_long() { 90 } else { 30 };
        for scene in Stress::ALL {
            let through = scene.run(steps, None);
            for every in [1, 7] {
                assert_eq!(
                    scene.run(steps, Some(every)),
                    through,
                    "{}, restored every {every} steps",
                    scene.name()
                );
            }
        }
    }
}
