//! What opens: a door on its hinge or a drawer on its slide, a body of its own.

use serde::{Deserialize, Serialize};

use super::Surface;
use crate::geometry::{Part, Pose};

/// A door or a drawer: a body of its own that turns around an axis or slides along one.
#[derive(Clone, PartialEq, Debug)]
pub struct DoorModel {
    /// Pose of its frame when closed. A hinge is the z axis of that frame; a slide goes along its x
    /// axis.
    pub closed: Pose,
    /// Parts in the frame of the door.
    pub parts: Vec<Part>,
    /// How it opens: the one way in which it moves.
    pub motion: DoorMotion,
    /// Centre of the closed door, in the scene frame: where one looks at.
    pub center: [f32; 3],
    /// Whether it runs in a piece of furniture that it never touches: a drawer, or the door of a
    /// compartment. Only objects collide with it.
    pub guided: bool,
}

/// The one degree of freedom of a door.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub enum DoorMotion {
    /// Around the z axis of its frame to this angle when open, in radians; its sign is the direction.
    Hinge(f32),
    /// Along the x axis of its frame by this distance when open, in metres.
    Slide(f32),
}

impl DoorMotion {
    /// Position when open: radians of a hinge, metres of a slide. Closed is 0.
    pub fn open_position(self) -> f32 {
        match self {
            DoorMotion::Hinge(angle) => angle,
            DoorMotion::Slide(distance) => distance,
        }
    }
}

impl DoorModel {
    /// Pose of its frame where it is open by a share, from 0 (closed) to 1.
    pub fn opened(&self, share: f32) -> Pose {
        self.closed.then(&match self.motion {
            DoorMotion::Hinge(angle) => Pose::yawed([0.0; 3], angle * share),
            DoorMotion::Slide(distance) => Pose::at([distance * share, 0.0, 0.0]),
        })
    }

    /// Its parts in the scene frame where it is open by a share.
    pub fn parts_at(&self, share: f32) -> impl Iterator<Item = Part> {
        let frame = self.opened(share);
        self.parts.iter().map(move |part| Part {
            pose: frame.then(&part.pose),
            ..*part
        })
    }

    /// Where a slide has moved to when it is at a position, in the scene frame; a hinge moves no
    /// surface.
    pub(crate) fn shift(&self, position: f32) -> [f32; 2] {
        match self.motion {
            DoorMotion::Hinge(_) => [0.0; 2],
            DoorMotion::Slide(_) => {
                let [x, y, _] = self.closed.rotate([position, 0.0, 0.0]);
                [x, y]
            }
        }
    }
}

impl Surface {
    /// The surface moved along the floor plan.
    pub(crate) fn moved(&self, by: [f32; 2]) -> Self {
        let moved = |corner: [f32; 2]| [corner[0] + by[0], corner[1] + by[1]];
        Self {
            min: moved(self.min),
            max: moved(self.max),
            ..*self
        }
    }
}
