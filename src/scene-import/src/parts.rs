//! From solids with joints to receptacles: the top of a piece, its shelves, its drawers, and what
//! lies behind its doors.

use reel_world::{Door, FurnitureGeometry, FurnitureJoint, Rect, Solid};

use crate::{
    affine::{Affine, Bounds, cross},
    house::{Joint, Moving, Solids, SourceSolid},
    notes::Notes,
    surfaces::{Face, area, faces, is_open, shared, top},
};

/// Categories one puts things into, not onto.
const APPLIANCES: &[&str] = &[
    "refrigerator",
    "microwave",
    "electric cooker",
    "washing machine",
];
/// Categories without shelves that could be used.
const SHELFLESS: &[&str] = &["bed", "couch", "bench", "sink", "desk"];
/// Least free height above a shelf, in metres.
const SHELF_HEADROOM_M: f64 = 0.2;
/// A shelf has at least this share of the area of the top.
const SHELF_SHARE: f64 = 0.3;
/// Thickness of boards that stand for a mesh, in metres.
const BOARD_M: f64 = 0.015;
/// A slide or a door axis may be this far from level or plumb.
const OFF_AXIS_MAX: f64 = 0.2;
/// A door opens at most this far, in degrees.
const OPEN_DEG_MAX: f64 = 110.0;

/// A receptacle of a piece.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Part {
    /// What it is of its piece; `None` for the piece itself.
    pub(crate) role: Option<Role>,
    /// Name of the joint that opens it, if one does.
    pub(crate) joint: Option<String>,
    pub(crate) rect: Rect,
    pub(crate) z: f64,
    pub(crate) door: Door,
    pub(crate) geometry: FurnitureGeometry,
}

/// What a part is.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum Role {
    Shelf,
    Drawer,
    Compartment,
}

impl Role {
    pub(crate) fn category(self) -> &'static str {
        match self {
            Role::Shelf => "shelf",
            Role::Drawer => "drawer",
            Role::Compartment => "compartment",
        }
    }
}

/// The receptacles of a piece, itself first, and where its front looks to; empty where nothing can
/// be put on it.
pub(crate) fn parts(
    category: &str,
    mut solids: Solids,
    notes: &mut Notes,
) -> (Vec<Part>, Option<f64>) {
    keep_usable_joints(&mut solids, notes);
    let facing = solids.moving.iter().find_map(front);
    let is_bounds = solids.fixed.iter().all(|solid| solid.is_bounds);
    let is_hollowed = !solids.moving.is_empty()
        && is_bounds
        && hollow_carcass(&mut solids, facing.unwrap_or(0.0), notes);
    hollow_drawers(&mut solids, notes);
    if APPLIANCES.contains(&category)
        && let Some(part) = appliance(&mut solids, notes)
    {
        return (vec![part], facing);
    }
    let (mut inner, unused): (Vec<Part>, Vec<Moving>) = inner_parts(&mut solids, notes);
    solids
        .fixed
        .extend(unused.into_iter().flat_map(|moving| moving.solids));
    let fixed = primitives(&solids.fixed);
    let closed: Vec<&Solid> = fixed.iter().copied().chain(moving_of(&inner)).collect();
    let found = faces(&fixed, &closed);
    let Some(top_face) = top(&found) else {
        return (Vec::new(), facing);
    };
    // What lies behind the doors of a mesh is not known: it has no shelves.
    if !SHELFLESS.contains(&category) && !is_hollowed {
        let shelves = shelf_faces(&found, &top_face, &inner);
        let (open, closed_off): (Vec<Face>, Vec<Face>) =
            shelves.into_iter().partition(|face| is_open(face, &closed));
        inner.extend(open.into_iter().map(|face| part(Some(Role::Shelf), &face)));
        for _ in closed_off {
            notes.left_out("shelf: no side of it is open, as behind a door");
        }
    }
    inner.sort_by(|a, b| b.z.total_cmp(&a.z));
    let whole = Part {
        geometry: FurnitureGeometry {
            fixed: fixed.into_iter().cloned().collect(),
            ..FurnitureGeometry::default()
        },
        ..part(None, &top_face)
    };
    inner.insert(0, whole);
    (inner, facing)
}

fn part(role: Option<Role>, face: &Face) -> Part {
    Part {
        role,
        joint: None,
        rect: face.rect,
        z: face.z,
        door: Door::None,
        geometry: FurnitureGeometry::default(),
    }
}

fn primitives(solids: &[SourceSolid]) -> Vec<&Solid> {
    solids.iter().map(|solid| &solid.primitive).collect()
}

fn moving_of(parts: &[Part]) -> impl Iterator<Item = &Solid> {
    parts.iter().flat_map(|part| &part.geometry.moving)
}

/// Level slides and upright hinges stay; what is on other joints stands still.
fn keep_usable_joints(solids: &mut Solids, notes: &mut Notes) {
    let (usable, others): (Vec<Moving>, Vec<Moving>) = std::mem::take(&mut solids.moving)
        .into_iter()
        .partition(|moving| match moving.joint {
            Joint::Slide { open_by: [x, y, z] } => {
                let level = libm::hypot(x, y);
                level > 0.05 && z.abs() <= OFF_AXIS_MAX * level
            }
            Joint::Hinge { axis, open_deg, .. } => {
                axis[2].abs() >= 1.0 - OFF_AXIS_MAX * OFF_AXIS_MAX && open_deg.abs() > 10.0
            }
        });
    solids.moving = usable;
    for moving in others {
        notes.left_out(match moving.joint {
            Joint::Slide { .. } => {
                "joint: a slide that is not level or moves under 5 cm, kept closed"
            }
            Joint::Hinge { .. } => {
                "joint: a hinge that is not upright or opens under 10 degrees, kept closed"
            }
        });
        solids.fixed.extend(moving.solids);
    }
}

/// Where the front looks to that a door or drawer opens at, in degrees, a multiple of 90.
fn front(moving: &Moving) -> Option<f64> {
    let bounds = Bounds::of_all(moving.solids.iter().map(|solid| &solid.primitive))?;
    let [x, y] = match moving.joint {
        Joint::Slide { open_by: [x, y, _] } => [x, y],
        Joint::Hinge {
            position,
            axis,
            open_deg,
        } => {
            let center = bounds.center();
            let arm: [f64; 3] = std::array::from_fn(|side| center[side] - position[side]);
            let [x, y, _] = cross(axis, arm);
            let sign = open_deg.signum();
            [x * sign, y * sign]
        }
    };
    if x == 0.0 && y == 0.0 {
        return None;
    }
    let quarter = if x.abs() >= y.abs() {
        if x > 0.0 { 0.0 } else { 180.0 }
    } else if y > 0.0 {
        90.0
    } else {
        270.0
    };
    Some(quarter)
}

/// A carcass that is only known by its bounds becomes five boards, open at the front; false where it
/// is too thin for that.
fn hollow_carcass(solids: &mut Solids, facing: f64, notes: &mut Notes) -> bool {
    let Some(bounds) = Bounds::of_all(solids.fixed.iter().map(|solid| &solid.primitive)) else {
        return false;
    };
    if bounds.half().iter().any(|half| *half < 3.0 * BOARD_M) {
        return false;
    }
    notes.approximated("carcass given as a mesh: five boards, open at the front");
    let open = match facing as i64 {
        0 => (0, true),
        90 => (1, true),
        180 => (0, false),
        _ => (1, false),
    };
    let first = solids.fixed[0].clone();
    solids.fixed = boards(&bounds, Some(open), true, &first);
    true
}

/// Boards of a box, without the side `open` (axis, upper) and maybe without a lid.
fn boards(
    bounds: &Bounds,
    open: Option<(usize, bool)>,
    has_lid: bool,
    like: &SourceSolid,
) -> Vec<SourceSolid> {
    let mut found = Vec::new();
    for axis in 0..3 {
        for upper in [false, true] {
            if open == Some((axis, upper)) || (axis == 2 && upper && !has_lid) {
                continue;
            }
            let mut board = *bounds;
            if upper {
                board.low[axis] = bounds.high[axis] - BOARD_M;
            } else {
                board.high[axis] = bounds.low[axis] + BOARD_M;
            }
            found.push(SourceSolid {
                primitive: board.solid(like.primitive.color),
                is_bounds: false,
                is_coloured: like.is_coloured,
            });
        }
    }
    found
}

/// A drawer without a floor to put things on becomes a box of boards.
fn hollow_drawers(solids: &mut Solids, notes: &mut Notes) {
    for moving in &mut solids.moving {
        let own = primitives(&moving.solids);
        let Joint::Slide { .. } = moving.joint else {
            continue;
        };
        if drawer_floor(&own).is_some() {
            continue;
        }
        let bounds = Bounds::of_all(own);
        let Some(bounds) = bounds.filter(|bounds| bounds.half().iter().all(|half| *half > 0.06))
        else {
            continue;
        };
        notes.approximated("drawer given as a mesh or one block: a box of boards");
        let like = moving.solids[0].clone();
        moving.solids = boards(&bounds, None, false, &like);
    }
}

/// The floor of a drawer: its lowest level face, with walls around.
fn drawer_floor(own: &[&Solid]) -> Option<Face> {
    let bounds = Bounds::of_all(own.iter().copied())?;
    let inside = bounds.low[2] + (bounds.high[2] - bounds.low[2]) * 0.5;
    // Its walls are lower than what stands in it may be.
    let found = faces(own, own);
    found
        .into_iter()
        .rev()
        .find(|face| face.z < inside && face.area() > 0.03)
}

/// The drawers, and the compartments behind doors; what moves but holds nothing comes back.
fn inner_parts(solids: &mut Solids, notes: &mut Notes) -> (Vec<Part>, Vec<Moving>) {
    let (mut inner, mut unused) = (Vec::new(), Vec::new());
    for moving in std::mem::take(&mut solids.moving) {
        let own = primitives(&moving.solids);
        let found = match moving.joint {
            Joint::Slide { open_by: [x, y, _] } => drawer_floor(&own).map(|face| Part {
                joint: Some(moving.source.clone()),
                door: Door::Drawer,
                geometry: geometry(&own, FurnitureJoint::Slide { open_by: [x, y] }),
                ..part(Some(Role::Drawer), &face)
            }),
            Joint::Hinge { .. } => hinged(&moving, &primitives(&solids.fixed), Role::Compartment),
        };
        match found {
            Some(part) => inner.push(part),
            None => {
                notes.left_out(match moving.joint {
                    Joint::Slide { .. } => "drawer: without a floor, kept closed",
                    Joint::Hinge { .. } => "door: no space behind it, kept closed",
                });
                unused.push(moving);
            }
        }
    }
    (inner, unused)
}

fn geometry(moving: &[&Solid], joint: FurnitureJoint) -> FurnitureGeometry {
    FurnitureGeometry {
        fixed: Vec::new(),
        moving: moving
            .iter()
            .map(|primitive| (*primitive).clone())
            .collect(),
        joint: Some(joint),
    }
}

/// The space behind a door, if there is a floor in it.
fn hinged(moving: &Moving, fixed: &[&Solid], role: Role) -> Option<Part> {
    let Joint::Hinge {
        position,
        axis,
        open_deg,
    } = moving.joint
    else {
        return None;
    };
    let own = primitives(&moving.solids);
    let panel = Bounds::of_all(own.iter().copied())?;
    let facing = front(moving)?;
    let across = usize::from(facing == 0.0 || facing == 180.0);
    let behind = faces(fixed, fixed).into_iter().filter_map(|face| {
        let mut opening = face.rect;
        opening.min[across] = panel.low[across];
        opening.max[across] = panel.high[across];
        let rect = shared(&face.rect, &opening)?;
        let reaches = face.z > panel.low[2] - 0.1 && face.z < panel.high[2] - 0.15;
        let is_near = (panel.center()[1 - across]
            - (rect.min[1 - across] + rect.max[1 - across]) * 0.5)
            .abs()
            < rect.max[1 - across] - rect.min[1 - across] + 0.1;
        (reaches && is_near && face.headroom.is_finite() && area(&rect) > 0.03)
            .then_some(Face { rect, ..face })
    });
    // Of several boards behind one door the one with most space.
    let floor = behind.max_by(|a, b| a.headroom.total_cmp(&b.headroom))?;
    let turn = Affine::turned(2, facing.to_radians());
    let [left, ..] = [turn.axes[1], turn.axes[0]];
    let toward_hinge: f64 = (0..2)
        .map(|side| (position[side] - panel.center()[side]) * left[side])
        .sum();
    // Who looks at the front has its left where the front has its right.
    let door = if toward_hinge < 0.0 {
        Door::Left
    } else {
        Door::Right
    };
    let joint = FurnitureJoint::Hinge {
        position,
        axis: [0.0, 0.0, axis[2].signum()],
        open_deg: open_deg.clamp(-OPEN_DEG_MAX, OPEN_DEG_MAX),
    };
    Some(Part {
        joint: Some(moving.source.clone()),
        door,
        geometry: geometry(&own, joint),
        ..part(Some(role), &floor)
    })
}

/// An appliance is one receptacle: what lies behind its largest door.
fn appliance(solids: &mut Solids, notes: &mut Notes) -> Option<Part> {
    let fixed = primitives(&solids.fixed);
    let doors = solids.moving.iter().enumerate();
    let found = doors
        .filter_map(|(index, moving)| Some((index, hinged(moving, &fixed, Role::Compartment)?)));
    let (index, mut part) = found.max_by(|a, b| area(&a.1.rect).total_cmp(&area(&b.1.rect)))?;
    for (other, moving) in std::mem::take(&mut solids.moving).into_iter().enumerate() {
        if other != index {
            notes.left_out("door: a second one of an appliance, kept closed");
            solids.fixed.extend(moving.solids);
        }
    }
    part.role = None;
    part.geometry.fixed = solids
        .fixed
        .iter()
        .map(|solid| solid.primitive.clone())
        .collect();
    Some(part)
}

/// Faces below the top that can be used as shelves, each level once.
fn shelf_faces(found: &[Face], top_face: &Face, inner: &[Part]) -> Vec<Face> {
    let mut shelves: Vec<Face> = Vec::new();
    for face in found {
        let is_taken = inner
            .iter()
            .any(|part| (part.z - face.z).abs() < 0.01 && shared(&part.rect, &face.rect).is_some());
        let is_again = shelves.iter().any(|other| {
            (other.z - face.z).abs() < 0.05 && shared(&other.rect, &face.rect).is_some()
        });
        if face.z < top_face.z - 0.05
            && face.headroom >= SHELF_HEADROOM_M
            && face.headroom.is_finite()
            && face.area() >= top_face.area() * SHELF_SHARE
            && !is_taken
            && !is_again
        {
            shelves.push(*face);
        }
    }
    shelves
}
