//! What every format is read into: rooms, walls, and furniture as solids with joints or as a size.
//! Metres, z up, the frame of the scene.

use reel_world::{Rect, Solid, Wall};

use crate::notes::Notes;

/// A house, or furniture without one.
#[derive(Clone, Debug, Default)]
pub(crate) struct House {
    /// What it is called in its file.
    pub(crate) name: String,
    /// Empty where the file has furniture only.
    pub(crate) rooms: Vec<RoomPlan>,
    /// `None` where the simulator is to build them around the rooms.
    pub(crate) walls: Option<Vec<Wall>>,
    pub(crate) robot_start: Option<[f64; 3]>,
    pub(crate) pieces: Vec<Piece>,
    pub(crate) notes: Notes,
}

/// A room by its kind and its disjoint rectangles.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct RoomPlan {
    /// What people call it, e.g. `living room`.
    pub(crate) kind: String,
    pub(crate) rects: Vec<Rect>,
}

/// A piece of furniture.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Piece {
    /// Its id, body, link or prim in the file.
    pub(crate) source: String,
    /// Category of the scene, e.g. `chest of drawers`.
    pub(crate) category: String,
    pub(crate) body: Body,
}

/// What is known of a piece.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Body {
    /// How large it is and where it stands: the simulator builds it by its category.
    Sized(Extent),
    /// What it consists of.
    Solids(Solids),
}

/// A box that a piece fills.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) struct Extent {
    /// Middle of its footprint.
    pub(crate) center: [f64; 2],
    /// From side to side, from back to front, and up.
    pub(crate) size: [f64; 3],
    /// Where its front looks to; a multiple of 90.
    pub(crate) facing_deg: f64,
}

/// Solids that stand still, and those on joints.
#[derive(Clone, PartialEq, Debug, Default)]
pub(crate) struct Solids {
    pub(crate) fixed: Vec<SourceSolid>,
    pub(crate) moving: Vec<Moving>,
}

/// A solid of a piece as its file gives it.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct SourceSolid {
    pub(crate) primitive: Solid,
    /// Whether it only bounds what is there, as the box of a mesh.
    pub(crate) is_bounds: bool,
    /// Whether the file gives its colour.
    pub(crate) is_coloured: bool,
}

/// A door or a drawer, closed.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Moving {
    /// Name of the joint in the file.
    pub(crate) source: String,
    pub(crate) solids: Vec<SourceSolid>,
    pub(crate) joint: Joint,
}

/// How a door or a drawer opens.
#[derive(Clone, Copy, PartialEq, Debug)]
pub(crate) enum Joint {
    /// Moves by so much.
    Slide { open_by: [f64; 3] },
    /// Turns around an axis, a unit vector, so far by the right hand.
    Hinge {
        position: [f64; 3],
        axis: [f64; 3],
        open_deg: f64,
    },
}

impl Solids {
    /// Every solid of it, while it is closed.
    pub(crate) fn all(&self) -> impl Iterator<Item = &Solid> {
        let moving = self.moving.iter().flat_map(|moving| &moving.solids);
        self.fixed
            .iter()
            .chain(moving)
            .map(|solid| &solid.primitive)
    }

    /// Moves all of it.
    pub(crate) fn shift(&mut self, by: [f64; 3]) {
        let moved = |point: &mut [f64; 3]| {
            point
                .iter_mut()
                .zip(by)
                .for_each(|(value, by)| *value += by);
        };
        let moving = self.moving.iter_mut();
        for part in moving {
            if let Joint::Hinge { position, .. } = &mut part.joint {
                moved(position);
            }
            part.solids
                .iter_mut()
                .for_each(|solid| moved(&mut solid.primitive.position));
        }
        self.fixed
            .iter_mut()
            .for_each(|solid| moved(&mut solid.primitive.position));
    }
}
