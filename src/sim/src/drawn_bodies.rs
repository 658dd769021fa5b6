//! What frames show, body by body and each in its own frame: for viewers that draw a scene
//! themselves. Says nothing about where bodies are; that is in the records.

use reel_world::{FIRST_RECEPTACLE_INSTANCE, ROBOT_INSTANCE, SHELL_INSTANCE, record::RobotState};

use crate::{
    PreparedTask,
    external_camera::{GRIPPER_M, robot},
    geometry::Pose,
    render::{Drawable, TriangleSurface, surfaces_of},
};

/// A body that frames show, with all of its surfaces.
#[derive(Clone, PartialEq, Debug)]
pub struct DrawnBody {
    /// The value that its pixels have in masks; a door has that of its receptacle.
    pub instance: u16,
    /// Whether it is the door of that receptacle.
    pub is_door: bool,
    /// Its surfaces in its own frame, in metres.
    pub surfaces: Vec<TriangleSurface>,
}

impl PreparedTask {
    /// Every body: the shell, each piece of furniture with its door, the objects and the robot.
    pub fn drawn_bodies(&self) -> Vec<DrawnBody> {
        let robot = robot();
        let body = |instance, is_door, drawable: Drawable<'_>| DrawnBody {
            instance,
            is_door,
            surfaces: surfaces_of(&drawable),
        };
        let of_parts = |parts, entity| Drawable {
            parts,
            mesh: None,
            pose: Pose::IDENTITY,
            entity,
        };
        let mut bodies = vec![body(
            SHELL_INSTANCE,
            false,
            of_parts(&self.model.shell, SHELL_INSTANCE),
        )];
        let mut next = FIRST_RECEPTACLE_INSTANCE;
        for (furniture, door_body) in self.model.furniture.iter().zip(&self.door_of) {
            bodies.push(body(next, false, of_parts(&furniture.parts, next)));
            if let (Some(door), Some(_)) = (&furniture.door, door_body) {
                bodies.push(body(next, true, of_parts(&door.parts, next)));
            }
            next += 1;
        }
        for model in &self.object_models {
            bodies.push(body(next, false, model.drawable(Pose::IDENTITY, next)));
            next += 1;
        }
        bodies.push(body(
            ROBOT_INSTANCE,
            false,
            of_parts(&robot, ROBOT_INSTANCE),
        ));
        bodies
    }
}

/// Where the robot's base is, as a pose in the scene's frame.
pub fn robot_pose(state: &RobotState) -> Pose {
    let [x, y] = state.base;
    Pose::yawed([x, y, 0.0], state.yaw)
}

/// Where a held object is drawn, in the scene's frame: before the robot. Physics does not know it
/// while it is held.
pub fn held_pose(state: &RobotState) -> Pose {
    let [ahead, up] = GRIPPER_M;
    robot_pose(state).then(&Pose::at([ahead, 0.0, up]))
}
