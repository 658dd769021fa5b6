//! What a piece of furniture consists of, where its scene says so: primitives, and the joint of its
//! door or drawer. Scenes that were imported (URDF, MJCF, USD) carry it; what it looks like where
//! a scene does not say is up to the simulator.

use serde::{Deserialize, Serialize};

/// The geometry of one receptacle. Poses are in the scene frame: metres, z up.
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FurnitureGeometry {
    /// The primitives that never move.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fixed: Vec<Solid>,
    /// The door or the drawer, as it stands when closed.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moving: Vec<Solid>,
    /// How `moving` opens; there if and only if `moving` is not empty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<FurnitureJoint>,
}

/// A coloured solid that others consist of.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Solid {
    /// Its form and size.
    pub shape: SolidShape,
    /// Where its centre is.
    pub position: [f64; 3],
    /// How it is turned, as a unit quaternion x, y, z, w.
    #[serde(default = "unturned", skip_serializing_if = "is_unturned")]
    pub rotation: [f64; 4],
    /// Its colour as sRGB bytes: red, green, blue.
    #[serde(default = "grey")]
    pub color: [u8; 3],
}

/// Form and size of a primitive, in metres.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SolidShape {
    /// A cuboid around its centre.
    Box {
        /// Half extents along x, y, z.
        half: [f64; 3],
    },
    /// A cylinder along z.
    Cylinder {
        /// Radius of its disc.
        radius: f64,
        /// Half of its height.
        half_height: f64,
    },
    /// A ball around its centre.
    Sphere {
        /// Radius of the ball.
        radius: f64,
    },
}

/// How a door or a drawer opens.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum FurnitureJoint {
    /// Turns around an axis.
    Hinge {
        /// A point of the axis.
        position: [f64; 3],
        /// Direction of the axis, a unit vector.
        axis: [f64; 3],
        /// Angle at which it is open, by the right hand, in degrees.
        open_deg: f64,
    },
    /// Slides along the floor plan.
    Slide {
        /// Where it is when open, from where it is closed: x, y.
        open_by: [f64; 2],
    },
}

fn unturned() -> [f64; 4] {
    [0.0, 0.0, 0.0, 1.0]
}

fn is_unturned(rotation: &[f64; 4]) -> bool {
    *rotation == unturned()
}

fn grey() -> [u8; 3] {
    [176, 172, 166]
}
