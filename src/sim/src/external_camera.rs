//! The scene from any camera, with the robot in it: for people. No agent sees these images, and
//! taking one changes nothing.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH, Frame, InstanceId, ROBOT_INSTANCE};

use crate::{
    Simulator,
    drawn_bodies::{held_pose, robot_pose},
    geometry::{Camera, FOCAL_PX, Part, Pattern, Pose, Shape, dot, sub},
    nav::{CAMERA_HEIGHT_M, ROBOT_RADIUS_M},
    render::{Detail, Drawable},
};

/// Where a held object hangs, before the robot and above the floor, in metres.
pub(crate) const GRIPPER_M: [f32; 2] = [0.34, 0.95];
/// How far a camera that follows an object stands off, level and upwards, in metres;
/// the nearer pairs first.
const FOLLOW_M: [[f32; 2]; 3] = [[0.75, 0.55], [0.9, 1.1], [0.35, 1.3]];
/// Directions around the object that are tried.
const DIRECTIONS: usize = 12;
/// Images are this many times their focal length wide and high.
const FIELD: [f32; 2] = [
    FRAME_WIDTH as f32 / FOCAL_PX,
    FRAME_HEIGHT as f32 / FOCAL_PX,
];

impl Simulator {
    /// The image from any camera, the robot and what it holds drawn too.
    pub fn render_external(&self, camera: &Camera) -> Frame {
        let robot = robot();
        let pose = robot_pose(&self.robot);
        let mut extra = vec![Drawable {
            parts: &robot,
            mesh: None,
            pose,
            entity: ROBOT_INSTANCE,
        }];
        if let Some(held) = self.held {
            let pose = held_pose(&self.robot);
            extra.push(self.stage.object_models[held].drawable(pose, self.object_entity(held)));
        }
        self.render_with(camera, &extra, self.detail)
    }

    /// A camera above the middle of the home, so high that all of it is in the image; the
    /// longer side lies level.
    pub fn camera_above(&self) -> Camera {
        let [low, high] = self.stage.model.bounds;
        let [width, depth] = [0, 1].map(|axis| high[axis] - low[axis] + 0.3);
        let (yaw, [level, upright]) = if width >= depth {
            (std::f32::consts::FRAC_PI_2, [width, depth])
        } else {
            (0.0, [depth, width])
        };
        // The tops of the walls are nearest to it.
        let walls = self
            .stage
            .model
            .walls
            .iter()
            .map(|wall| wall.height as f32)
            .fold(0.0, f32::max);
        let height = walls + (level / FIELD[0]).max(upright / FIELD[1]);
        let middle = [(low[0] + high[0]) * 0.5, (low[1] + high[1]) * 0.5];
        Camera {
            position: [middle[0], middle[1], height],
            yaw,
            pitch: -std::f32::consts::FRAC_PI_2,
        }
    }

    /// A camera that looks at an object from near by, from where most of it is seen; none where
    /// there is no such object.
    pub fn camera_on(&self, object: &InstanceId) -> Option<Camera> {
        let index = self.object_index(object)?;
        let held = || held_pose(&self.robot).position;
        let target = self
            .physics
            .object_motion(index)
            .map_or_else(held, |motion| motion.pose.position);
        let entity = self.object_entity(index);
        // From the robot's side first: of equals that is the one to take.
        let [x, y] = self.robot.base;
        let first = libm::atan2f(y - target[1], x - target[0]);
        let cameras = FOLLOW_M.iter().flat_map(|[level, up]| {
            (0..DIRECTIONS).map(move |direction| {
                let turn = std::f32::consts::TAU * direction as f32 / DIRECTIONS as f32;
                let (sine, cosine) = (libm::sinf(first + turn), libm::cosf(first + turn));
                Camera::looking_at(
                    [
                        target[0] + level * cosine,
                        target[1] + level * sine,
                        target[2] + up,
                    ],
                    target,
                )
            })
        });
        // Pixels of the object, fewer where much of the image is something that stands before it,
        // like the edge of a wall.
        let worth = |camera: &Camera| {
            let frame = self.render_with(camera, &[], Detail::Geometry);
            let pixels = frame
                .ids
                .iter()
                .filter(|id| **id == entity)
                .count()
                .max(usize::from(self.held == Some(index)));
            let away = sub(target, camera.position);
            let before_mm = libm::sqrtf(dot(away, away)) * 600.0;
            let open = frame
                .depth_mm
                .iter()
                .filter(|depth| f32::from(**depth) >= before_mm || **depth == 0)
                .count();
            let open = open as f32 / frame.depth_mm.len() as f32;
            pixels as f32 * open * open * open * open
        };
        let mut best: Option<(f32, Camera)> = None;
        for camera in cameras {
            let worth = worth(&camera);
            if best.is_none_or(|(most, _)| worth > most * 1.25) {
                best = Some((worth, camera));
            }
        }
        best.map(|(_, camera)| camera)
    }
}

/// Base, mast and a head that looks ahead, in the robot's frame.
pub(crate) fn robot() -> [Part; 5] {
    let part = |shape, position, color| Part {
        shape,
        pose: Pose::at(position),
        color,
        accent: color,
        pattern: Pattern::default(),
        solid: false,
    };
    let (dark, light, lens) = ([52, 60, 74], [232, 122, 40], [20, 22, 26]);
    let cylinder = |radius, half_height| Shape::Cylinder {
        radius,
        half_height,
    };
    [
        part(
            cylinder(ROBOT_RADIUS_M * 0.95, 0.12),
            [0.0, 0.0, 0.14],
            dark,
        ),
        part(
            cylinder(0.05, (CAMERA_HEIGHT_M - 0.26) * 0.5),
            [0.0, 0.0, (CAMERA_HEIGHT_M + 0.26) * 0.5],
            dark,
        ),
        part(
            Shape::Cuboid {
                half: [0.1, 0.15, 0.08],
            },
            [0.0, 0.0, CAMERA_HEIGHT_M],
            light,
        ),
        part(
            Shape::Cuboid {
                half: [0.05, 0.1, 0.04],
            },
            [0.12, 0.0, CAMERA_HEIGHT_M],
            lens,
        ),
        part(
            Shape::Cuboid {
                half: [0.15, 0.03, 0.03],
            },
            [0.17, 0.0, GRIPPER_M[1] + 0.1],
            light,
        ),
    ]
}
