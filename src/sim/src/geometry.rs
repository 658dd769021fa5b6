//! Shapes, poses, coloured parts and the camera: what models are made of, and what physics,
//! navigation and the renderer share. Frame: metres, z up. Bodies: quaternions x, y, z, w.

use reel_world::{FRAME_HEIGHT, FRAME_WIDTH};
use serde::{Deserialize, Serialize};

/// Focal length of the head camera in pixels (640 x 480, horizontal field of view 77 degrees).
pub const FOCAL_PX: f32 = 400.0;
/// What is nearer to the camera is not projected, in metres.
const NEAR_M: f32 = 0.05;

/// A convex primitive around its own origin. Cylinders and capsules stand along z.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Shape {
    /// A box whose sides are parallel to the axes.
    Cuboid {
        /// Half extents along x, y, z.
        half: [f32; 3],
    },
    /// A cylinder whose axis is the z axis.
    Cylinder {
        /// Radius of the cylinder, in metres.
        radius: f32,
        /// Half of the cylinder's height along z, in metres.
        half_height: f32,
    },
    /// A ball whose centre is the origin.
    Ball {
        /// Radius of the ball, in metres.
        radius: f32,
    },
    /// A cylinder with half balls at its ends.
    Capsule {
        /// Radius of the cylinder and of its end caps, in metres.
        radius: f32,
        /// Half length of the cylinder between the balls.
        half_height: f32,
    },
    /// A cone, its tip up. Looks only: never solid.
    Cone {
        /// Radius of the cone's base, in metres.
        radius: f32,
        /// Half of the cone's height along z, in metres.
        half_height: f32,
    },
}

/// How a part's colour varies over its surface.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub enum Pattern {
    /// The main colour all over, without a second one.
    #[default]
    Plain,
    /// Bands of the second colour.
    Stripes,
    /// Dots of the second colour.
    Dots,
    /// Irregular lines of the second colour along the longer side.
    Grain,
    /// Bright spots, as on polished things.
    Glossy,
}

/// A coloured primitive of a model.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Part {
    /// Shape of the part, in the part's own frame.
    pub shape: Shape,
    /// Pose in the frame of the model it belongs to.
    pub pose: Pose,
    /// Main colour of the part, as sRGB bytes.
    pub color: [u8; 3],
    /// Second colour of the pattern.
    pub accent: [u8; 3],
    /// How the colour varies over the part's surface.
    pub pattern: Pattern,
    /// Whether physics knows it: looks without a collider are false.
    pub solid: bool,
}

impl Shape {
    /// Half extents of the box around it, in its own frame.
    pub fn half_extents(&self) -> [f32; 3] {
        match *self {
            Shape::Cuboid { half } => half,
            Shape::Ball { radius } => [radius; 3],
            Shape::Cylinder {
                radius,
                half_height,
            }
            | Shape::Cone {
                radius,
                half_height,
            } => [radius, radius, half_height],
            Shape::Capsule {
                radius,
                half_height,
            } => [radius, radius, half_height + radius],
        }
    }
}

impl Part {
    /// Corners of the oriented box around it, in the frame its pose is in.
    pub fn box_corners(&self) -> [[f32; 3]; 8] {
        let [hx, hy, hz] = self.shape.half_extents();
        std::array::from_fn(|corner| {
            let signed = |bit: usize, half: f32| if corner >> bit & 1 == 1 { half } else { -half };
            add(
                self.pose
                    .rotate([signed(0, hx), signed(1, hy), signed(2, hz)]),
                self.pose.position,
            )
        })
    }
}

/// A rigid transform: a rotation followed by a translation.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Pose {
    /// Translation along x, y and z, in metres.
    pub position: [f32; 3],
    /// Quaternion x, y, z, w.
    pub rotation: [f32; 4],
}

impl Pose {
    /// The identity transform, without rotation or translation.
    pub const IDENTITY: Pose = Pose {
        position: [0.0; 3],
        rotation: [0.0, 0.0, 0.0, 1.0],
    };

    /// A translation in metres, without any rotation.
    pub fn at(position: [f32; 3]) -> Self {
        Self {
            position,
            ..Self::IDENTITY
        }
    }

    /// A rotation around z, in radians, then a translation.
    pub fn yawed(position: [f32; 3], yaw: f32) -> Self {
        Self {
            position,
            rotation: [0.0, 0.0, libm::sinf(yaw * 0.5), libm::cosf(yaw * 0.5)],
        }
    }

    /// Rotates a vector by this pose's quaternion.
    pub fn rotate(&self, v: [f32; 3]) -> [f32; 3] {
        let [x, y, z, w] = self.rotation;
        let u = [x, y, z];
        let t = cross(u, v).map(|c| 2.0 * c);
        let ut = cross(u, t);
        [
            v[0] + w * t[0] + ut[0],
            v[1] + w * t[1] + ut[1],
            v[2] + w * t[2] + ut[2],
        ]
    }

    /// Takes a point of this pose's frame to the outer frame.
    pub fn apply(&self, point: [f32; 3]) -> [f32; 3] {
        add(self.rotate(point), self.position)
    }

    /// The pose that undoes this one.
    pub fn inverse(&self) -> Self {
        let [x, y, z, w] = self.rotation;
        let back = Self {
            position: [0.0; 3],
            rotation: [-x, -y, -z, w],
        };
        Self {
            position: back.rotate(self.position).map(|value| -value),
            ..back
        }
    }

    /// This pose after an inner one: `outer_from_here * here_from_inner`.
    pub fn then(&self, inner: &Pose) -> Pose {
        Pose {
            position: self.apply(inner.position),
            rotation: quaternion_product(self.rotation, inner.rotation),
        }
    }
}

/// Sum of two vectors.
#[inline(always)]
pub fn add(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Difference of two vectors.
#[inline(always)]
pub fn sub(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Scalar product of two 3D vectors.
#[inline(always)]
pub fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Right-handed vector product `a x b` of two 3D vectors.
#[inline(always)]
pub fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// Distance of two points on the floor plan.
pub fn distance_2d(a: [f32; 2], b: [f32; 2]) -> f32 {
    libm::sqrtf((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]))
}

fn quaternion_product([ax, ay, az, aw]: [f32; 4], [bx, by, bz, bw]: [f32; 4]) -> [f32; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// The head camera. Camera frame: x right, y down, z forward.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Camera {
    /// Position in the scene's frame, in metres.
    pub position: [f32; 3],
    /// Around z, in radians; 0 looks along +x.
    pub yaw: f32,
    /// In radians; negative looks down.
    pub pitch: f32,
}

impl Camera {
    /// Looks from a point at a point.
    pub fn looking_at(position: [f32; 3], target: [f32; 3]) -> Self {
        let d = sub(target, position);
        let level = libm::sqrtf(d[0] * d[0] + d[1] * d[1]);
        Self {
            position,
            yaw: libm::atan2f(d[1], d[0]),
            pitch: libm::atan2f(d[2], level),
        }
    }

    /// Rows of the rotation that takes scene vectors to the camera frame: right, down, forward.
    pub fn axes(&self) -> [[f32; 3]; 3] {
        let (sy, cy) = (libm::sinf(self.yaw), libm::cosf(self.yaw));
        let (sp, cp) = (libm::sinf(self.pitch), libm::cosf(self.pitch));
        let forward = [cy * cp, sy * cp, sp];
        let right = [sy, -cy, 0.0];
        [right, cross(forward, right), forward]
    }

    /// A scene point in the camera frame.
    pub fn to_camera(&self, point: [f32; 3]) -> [f32; 3] {
        let d = sub(point, self.position);
        self.axes().map(|axis| dot(axis, d))
    }

    /// Pixel coordinates of a scene point in front of the camera.
    pub fn project(&self, point: [f32; 3]) -> Option<[f32; 2]> {
        let [x, y, z] = self.to_camera(point);
        (z > NEAR_M).then(|| [320.0 + FOCAL_PX * x / z, 240.0 + FOCAL_PX * y / z])
    }

    /// The pixels that a box of the scene (lower and upper corner) covers at most: x and y of the
    /// first and of the last. `None` where it is outside of the image or behind the camera.
    pub fn projected(&self, [low, high]: [[f32; 3]; 2]) -> Option<[u16; 4]> {
        let corner = |number: usize| {
            let of_axis = |axis: usize| {
                if number >> axis & 1 == 0 {
                    low[axis]
                } else {
                    high[axis]
                }
            };
            self.to_camera([0, 1, 2].map(of_axis))
        };
        let corners: [[f32; 3]; 8] = std::array::from_fn(corner);
        let mut covered = [f32::MAX, f32::MAX, f32::MIN, f32::MIN];
        let mut cover = |[x, y, z]: [f32; 3]| {
            let at = [320.0 + FOCAL_PX * x / z, 240.0 + FOCAL_PX * y / z];
            for axis in 0..2 {
                covered[axis] = covered[axis].min(at[axis]);
                covered[axis + 2] = covered[axis + 2].max(at[axis]);
            }
        };
        for from in 0..8 {
            if corners[from][2] > NEAR_M {
                cover(corners[from]);
            }
            // Edges go from a corner to those that differ in one axis; some are cut where they come
            // too near.
            for to in (0..3).map(|axis| from ^ 1 << axis).filter(|to| *to > from) {
                let (a, b) = (corners[from], corners[to]);
                if (a[2] > NEAR_M) != (b[2] > NEAR_M) {
                    let part = (NEAR_M - a[2]) / (b[2] - a[2]);
                    let [x, y] = [0, 1].map(|axis| a[axis] + (b[axis] - a[axis]) * part);
                    cover([x, y, NEAR_M]);
                }
            }
        }
        let [left, top, right, bottom] = covered;
        let size = [FRAME_WIDTH as f32, FRAME_HEIGHT as f32];
        let is_seen = left < size[0] && top < size[1] && right > 0.0 && bottom > 0.0;
        let clip =
            |value: f32, axis: usize| libm::floorf(value.clamp(0.0, size[axis] - 1.0)) as u16;
        is_seen.then(|| [clip(left, 0), clip(top, 1), clip(right, 0), clip(bottom, 1)])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn camera_axes_point_right_down_forward() {
        let camera = Camera {
            position: [1.0, 2.0, 1.0],
            yaw: 0.0,
            pitch: 0.0,
        };
        // Looking along +x, +y is on the left and +z is up.
        assert_eq!(camera.to_camera([3.0, 2.0, 1.0]), [0.0, 0.0, 2.0]);
        assert!(camera.project([3.0, 2.5, 1.0]).unwrap()[0] < 320.0);
        assert!(camera.project([3.0, 2.0, 1.5]).unwrap()[1] < 240.0);
        let down = Camera::looking_at([0.0, 0.0, 1.4], [1.0, 1.0, 0.4]);
        let [x, y] = down.project([1.0, 1.0, 0.4]).unwrap();
        assert!((x - 320.0).abs() < 0.01 && (y - 240.0).abs() < 0.01);
    }

    #[test]
    fn a_box_covers_what_its_corners_do_and_is_clipped() {
        let camera = Camera {
            position: [0.0; 3],
            yaw: 0.0,
            pitch: 0.0,
        };
        // Looking along +x: two metres away the image is 3.2 m wide and 2.4 m high.
        let ahead = camera.projected([[2.0, -0.4, -0.2], [3.0, 0.4, 0.2]]);
        assert_eq!(ahead, Some([240, 200, 400, 280]));
        let beside = camera
            .projected([[-1.0, 0.5, -9.0], [4.0, 0.6, 0.1]])
            .unwrap();
        assert_eq!(
            (beside[0], beside[3]),
            (0, 479),
            "it passes the camera: {beside:?}"
        );
        assert!(beside[2] < 320, "it is on the left: {beside:?}");
        assert_eq!(
            camera.projected([[-3.0, -1.0, -1.0], [-2.0, 1.0, 1.0]]),
            None
        );
        assert_eq!(camera.projected([[2.0, 5.0, 0.0], [2.5, 6.0, 0.5]]), None);
    }

    #[test]
    fn yaw_turns_x_towards_y() {
        let pose = Pose::yawed([1.0, 0.0, 0.0], std::f32::consts::FRAC_PI_2);
        let [x, y, z] = pose.apply([1.0, 0.0, 0.0]);
        assert!((x - 1.0).abs() < 1e-6 && (y - 1.0).abs() < 1e-6 && z == 0.0);
        let twice = pose.then(&pose).apply([0.0; 3]);
        assert!((twice[0] - 1.0).abs() < 1e-6 && (twice[1] - 1.0).abs() < 1e-6);
    }
}
