//! What scenes and objects look like and consist of: furniture, walls, floor and household objects as coloured parts.

use std::collections::BTreeSet;

use reel_world::{ObjectInstance, ReceptacleId, Scene, Wall};

use crate::geometry::{Part, Pose};

/// A scene as parts, in the scene frame.
#[derive(Clone, PartialEq, Debug)]
pub struct SceneModel {
    /// Floor slabs by room, then walls; all solid.
    pub shell: Vec<Part>,
    /// The walls as segments (given or derived), for navigation and floor plans.
    pub walls: Vec<Wall>,
    /// The furniture, in the scene's order.
    pub furniture: Vec<Furniture>,
    /// Lower and upper corner of all rooms: x, y.
    pub bounds: [[f32; 2]; 2],
}

/// One receptacle as parts.
#[derive(Clone, PartialEq, Debug)]
pub struct Furniture {
    /// Which.
    pub id: ReceptacleId,
    /// Its fixed parts, in the scene frame; empty while it is taken off (a lid whose pot is in use).
    pub parts: Vec<Part>,
    /// The interaction surface.
    pub surface: Surface,
    /// Bounding box of the parts (door closed): lower and upper corner.
    pub bounds: [[f32; 3]; 2],
    /// Unit vector its front looks to, on the floor.
    pub facing: [f32; 2],
    /// Its door, if it has one.
    pub door: Option<DoorModel>,
    /// Whether it is there (see `parts`).
    pub present: bool,
}

/// A horizontal rectangle that holds objects.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct Surface {
    /// Lower corner: x, y.
    pub min: [f32; 2],
    /// Upper corner: x, y.
    pub max: [f32; 2],
    /// Height.
    pub z: f32,
    /// Free height above it, in metres (up to the next shelf or the ceiling of a box).
    pub clearance: f32,
}

/// A hinged door: a body of its own that turns around a vertical axis.
#[derive(Clone, PartialEq, Debug)]
pub struct DoorModel {
    /// Pose of the door's frame when closed; its origin lies on the hinge axis, its z is the axis.
    pub closed: Pose,
    /// Parts in the door's frame.
    pub parts: Vec<Part>,
    /// Angle around z when open, in radians (its sign is the direction).
    pub open_angle: f32,
    /// Centre of the closed door, in the scene frame: where one looks at.
    pub center: [f32; 3],
}

/// A movable object as parts around the centre of its box.
#[derive(Clone, PartialEq, Debug)]
pub struct ObjectModel {
    /// In the object's frame; the solid ones together stay within its size.
    pub parts: Vec<Part>,
    /// Half extents of its box.
    pub half: [f32; 3],
    /// In kg per cubic metre.
    pub density: f32,
}

/// Builds a scene. `in_use` names the receptacles that hold objects at the start: what covers them is taken off.
pub fn scene_model(scene: &Scene, in_use: &BTreeSet<ReceptacleId>) -> SceneModel {
    let _ = (scene, in_use);
    unimplemented!("by the model helper")
}

/// Builds an object from its category, size and attribute words.
pub fn object_model(object: &ObjectInstance) -> ObjectModel {
    let _ = object;
    unimplemented!("by the model helper")
}
