//! One rendered image with its instance ids and depth.

use serde::{Deserialize, Serialize};

use crate::{Digest, Scene, Task};

/// Width of the head camera's image, in pixels.
pub const FRAME_WIDTH: usize = 640;
/// Height of the head camera's image, in pixels.
pub const FRAME_HEIGHT: usize = 480;

/// An image of the head camera, row by row from the top left.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Frame {
    /// 8-bit RGB, `FRAME_WIDTH * FRAME_HEIGHT * 3` bytes, Set-of-Mark overlay included.
    pub rgb: Vec<u8>,
    /// Instance id of every pixel ([`instances`]; 0 is nothing).
    pub ids: Vec<u16>,
    /// Depth along the optical axis in millimetres; 0 is nothing.
    pub depth_mm: Vec<u16>,
    /// Where the numbers of the overlay are, in the order in which they were drawn; empty also for
    /// images that were not drawn here.
    pub marker_boxes: Vec<MarkerBox>,
}

/// Where a number of the Set-of-Mark overlay is in an image: x, y of the first and of the last pixel.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
pub struct MarkerBox {
    /// Number of the marker, as tools take it in `marker_id`.
    pub id: u32,
    /// Bounding box of what is marked.
    pub bbox: [u16; 4],
    /// Bounding box of the label with the number.
    pub label: [u16; 4],
}

/// Digests of a frame's raw buffers, never of encoded bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct FrameDigests {
    /// Of the RGB bytes.
    pub rgb: Digest,
    /// Of the instance ids, little-endian.
    pub ids: Digest,
    /// Of the depth, little-endian.
    pub depth: Digest,
}

impl Frame {
    /// A black frame in which every entity id and depth is 0.
    pub fn new() -> Self {
        let pixels = FRAME_WIDTH * FRAME_HEIGHT;
        Self {
            rgb: vec![0; pixels * 3],
            ids: vec![0; pixels],
            depth_mm: vec![0; pixels],
            marker_boxes: Vec::new(),
        }
    }

    /// An image of which only the RGB is known.
    pub fn of_rgb(rgb: Vec<u8>) -> Self {
        Self {
            rgb,
            ids: Vec::new(),
            depth_mm: Vec::new(),
            marker_boxes: Vec::new(),
        }
    }

    /// Digests of the three buffers.
    pub fn digests(&self) -> FrameDigests {
        let le = |values: &[u16]| Digest::of(&little_endian(values));
        FrameDigests {
            rgb: Digest::of(&self.rgb),
            ids: le(&self.ids),
            depth: le(&self.depth_mm),
        }
    }
}

impl Default for Frame {
    fn default() -> Self {
        Self::new()
    }
}

/// The bytes of depth or instance ids, as digests, traces and viewers take them.
pub fn little_endian(values: &[u16]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

/// Instance id of walls, floor and ceiling.
pub const SHELL_INSTANCE: u16 = 1;
/// Instance id of the first receptacle of the scene; the others, then the objects of the task follow
/// in their order.
pub const FIRST_RECEPTACLE_INSTANCE: u16 = 2;
/// Instance id of the robot, which only cameras outside of it show.
pub const ROBOT_INSTANCE: u16 = u16::MAX;

/// What an instance id of a frame stands for.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct FrameInstance {
    /// The value of its pixels.
    pub id: u16,
    /// What kind of thing it is.
    pub kind: InstanceKind,
    /// Id of the object or receptacle; `shell` and `robot` for these.
    pub name: String,
    /// Its category; `shell` and `robot` for these.
    pub category: String,
}

/// Kinds of things that a frame shows.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum InstanceKind {
    /// Walls, floor and ceiling.
    Shell,
    /// A receptacle of the scene, its door included.
    Receptacle,
    /// An object of the task.
    Object,
    /// The robot itself, in images of other cameras than its own.
    Robot,
}

/// What the instance ids in the frames of an episode stand for, by id.
pub fn instances(task: &Task, scene: &Scene) -> Vec<FrameInstance> {
    let fixed = |id, kind, name: &str| FrameInstance {
        id,
        kind,
        name: name.to_owned(),
        category: name.to_owned(),
    };
    let receptacles = scene
        .receptacles
        .iter()
        .map(|it| (InstanceKind::Receptacle, it.id.to_string(), &it.category));
    let objects = task
        .objects
        .iter()
        .map(|it| (InstanceKind::Object, it.instance.to_string(), &it.category));
    let ids = FIRST_RECEPTACLE_INSTANCE..ROBOT_INSTANCE;
    let things = ids.zip(receptacles.chain(objects));
    let things = things.map(|(id, (kind, name, category))| FrameInstance {
        id,
        kind,
        name,
        category: category.clone(),
    });
    let shell = fixed(SHELL_INSTANCE, InstanceKind::Shell, "shell");
    let robot = fixed(ROBOT_INSTANCE, InstanceKind::Robot, "robot");
    std::iter::once(shell)
        .chain(things)
        .chain([robot])
        .collect()
}
