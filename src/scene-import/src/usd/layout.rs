//! From prims to a house: which prims are rooms, walls and furniture, by their labels and names.

use std::collections::BTreeMap;

use reel_world::{Rect, Wall};

use super::{Content, JointItem, PrimItem, ShapeItem};
use crate::{
    affine::Bounds,
    categories,
    house::{Body, House, Moving, Piece, RoomPlan, Solids, SourceSolid},
    notes::Notes,
};

/// Thicker than this a wall is no wall, in metres.
const WALL_THICKNESS_MAX_M: f64 = 0.5;
/// Free floor around what is in a room whose floor is not given, in metres.
const ROOM_MARGIN_M: f64 = 1.0;

/// The house of a stage.
pub(super) fn house(content: Content) -> House {
    let Content {
        prims,
        shapes,
        joints,
        mut notes,
    } = content;
    let tree = PrimTree::of(&prims);
    let rooms = tree.rooms(&shapes, &mut notes);
    let walls = tree.walls(&shapes, &mut notes);
    let moved_by: BTreeMap<&str, &JointItem> = joints
        .iter()
        .map(|joint| (joint.moves.as_str(), joint))
        .collect();
    let mut pieces: BTreeMap<usize, Solids> = BTreeMap::new();
    for shape in &shapes {
        let Some(owner) = tree.ancestor(&shape.path, |role| matches!(role, Role::Furniture(_)))
        else {
            if tree
                .ancestor(&shape.path, |role| matches!(role, Role::Floor | Role::Wall))
                .is_none()
            {
                let kind = categories::kind_of(tree.owner_name(&shape.path));
                notes.about(&shape.path);
                notes.left_out(format!("not furniture to put objects on: {kind}"));
                notes.about("");
            }
            continue;
        };
        let solids = pieces.entry(owner).or_default();
        // The joint nearest to the root of the piece moves all below it.
        let below = ancestors(&shape.path).take_while(|path| *path != prims[owner].path);
        match below.filter_map(|path| moved_by.get(path)).last() {
            None => solids.fixed.push(shape.solid.clone()),
            Some(joint) => add_moving(solids, joint, shape.solid.clone()),
        }
    }
    let pieces = pieces.into_iter().filter_map(|(owner, mut solids)| {
        let Role::Furniture(category) = tree.roles[owner] else {
            return None;
        };
        name_joints(&mut solids);
        Some(Piece {
            source: prims[owner].path.clone(),
            category: category.to_owned(),
            body: Body::Solids(solids),
        })
    });
    House {
        name: prims
            .first()
            .map_or_else(String::new, |prim| prim.name.clone()),
        pieces: pieces.collect(),
        walls: walls.filter(|_| !rooms.is_empty()),
        rooms,
        notes,
        ..House::default()
    }
}

fn add_moving(solids: &mut Solids, joint: &JointItem, solid: SourceSolid) {
    let known = solids.moving.iter_mut();
    match known.into_iter().find(|moving| moving.source == joint.path) {
        Some(moving) => moving.solids.push(solid),
        None => solids.moving.push(Moving {
            source: joint.path.clone(),
            solids: vec![solid],
            joint: joint.joint,
        }),
    }
}

/// Calls each joint of a piece by its name, where no other has it.
fn name_joints(solids: &mut Solids) {
    let name = |path: &str| path.rsplit('/').next().unwrap_or_default().to_owned();
    let names: Vec<String> = solids.moving.iter().map(|it| name(&it.source)).collect();
    for (moving, own) in solids.moving.iter_mut().zip(&names) {
        if names.iter().filter(|other| *other == own).count() == 1 {
            moving.source.clone_from(own);
        }
    }
}

/// What a prim is in a house.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Role {
    Furniture(&'static str),
    Room(&'static str),
    Floor,
    Wall,
    /// Part of something with a role, or nothing that is known.
    Other,
}

/// A path and those above it, from below.
fn ancestors<'p>(path: &'p str) -> impl Iterator<Item = &'p str> {
    let up = |path: &&'p str| -> Option<&'p str> {
        let (above, _) = path.rsplit_once('/')?;
        (!above.is_empty()).then_some(above)
    };
    std::iter::successors(Some(path), up)
}

/// The prims of a stage with what they are.
struct PrimTree<'a> {
    prims: &'a [PrimItem],
    index: BTreeMap<&'a str, usize>,
    children: BTreeMap<&'a str, Vec<usize>>,
    /// In the order of the prims.
    roles: Vec<Role>,
}

impl<'a> PrimTree<'a> {
    fn of(prims: &'a [PrimItem]) -> Self {
        let mut tree = Self {
            prims,
            index: prims
                .iter()
                .enumerate()
                .map(|(index, prim)| (prim.path.as_str(), index))
                .collect(),
            children: BTreeMap::new(),
            roles: Vec::new(),
        };
        for (index, prim) in prims.iter().enumerate() {
            if let Some((above, _)) = prim.path.rsplit_once('/') {
                tree.children.entry(above).or_default().push(index);
            }
        }
        // Parents stand before their children: what is below furniture is part of it.
        for prim in prims {
            let is_part = tree
                .ancestor(&prim.path, |role| matches!(role, Role::Furniture(_)))
                .is_some();
            let role = if is_part {
                Role::Other
            } else {
                tree.role(prim)
            };
            tree.roles.push(role);
        }
        tree
    }

    fn parent(&self, prim: &PrimItem) -> Option<(usize, &'a PrimItem)> {
        let index = *self.index.get(ancestors(&prim.path).nth(1)?)?;
        Some((index, &self.prims[index]))
    }

    /// The lowest prim at or above a path that has such a role, of those whose role is known.
    fn ancestor(&self, path: &str, is: impl Fn(&Role) -> bool) -> Option<usize> {
        ancestors(path)
            .filter_map(|path| self.index.get(path).copied())
            .find(|index| self.roles.get(*index).is_some_and(&is))
    }

    fn role(&self, prim: &PrimItem) -> Role {
        let words = categories::kind_of(&prim.label);
        let has = |word: &str| words.split(' ').any(|own| own == word);
        if has("floor") && !has("lamp") {
            return Role::Floor;
        }
        if has("wall") || has("walls") {
            return Role::Wall;
        }
        if let Some(category) = categories::furniture(&prim.label) {
            return if self.is_group(prim) {
                Role::Other
            } else {
                Role::Furniture(category)
            };
        }
        // In exports by category the group has the name, and its models have none.
        if prim.is_model
            && let Some((_, group)) = self.parent(prim)
            && let Some(category) = categories::furniture(&group.label)
        {
            return Role::Furniture(category);
        }
        match categories::room(&prim.label) {
            Some(kind) if prim.children > 0 => Role::Room(kind),
            _ => Role::Other,
        }
    }

    /// Whether a prim named as furniture only groups models of that kind: all of its children are
    /// models, or furniture of that name themselves.
    fn is_group(&self, prim: &PrimItem) -> bool {
        let category = categories::furniture(&prim.label);
        let children = self
            .children
            .get(prim.path.as_str())
            .map_or(&[][..], Vec::as_slice);
        let is_one = |child: &usize| {
            let child = &self.prims[*child];
            child.is_model
                || (child.children > 0 && categories::furniture(&child.label) == category)
        };
        !prim.is_model && !children.is_empty() && children.iter().all(is_one)
    }

    /// The name of the prim that a shape belongs to, for people: that of its parent, unless this is a
    /// room or the root.
    fn owner_name(&self, path: &str) -> &'a str {
        let Some(own) = self.index.get(path).map(|index| &self.prims[*index]) else {
            return "prim";
        };
        let owner = self.parent(own).filter(|(index, parent)| {
            parent.path.matches('/').count() > 1 && !matches!(self.roles[*index], Role::Room(_))
        });
        owner.map_or(&own.label, |(_, parent)| &parent.label)
    }

    /// Rooms: prims named as one, on the floor in them or around what is in them; else every floor.
    fn rooms(&self, shapes: &[ShapeItem], notes: &mut Notes) -> Vec<RoomPlan> {
        let (mut floors, mut contents) = (BTreeMap::new(), BTreeMap::new());
        let mut outermost = BTreeMap::new();
        for shape in shapes {
            let bounds = Bounds::of(&shape.solid.primitive);
            let floor = self.ancestor(&shape.path, |role| *role == Role::Floor);
            if let Some(room) = self.ancestor(&shape.path, |role| matches!(role, Role::Room(_))) {
                join(&mut contents, room, bounds);
                if floor.is_some() {
                    join(&mut floors, room, bounds);
                }
            }
            // Of a floor group the models in it are the floors, if it has any.
            if let Some(floor) = floor {
                join(&mut outermost, floor, bounds);
            }
        }
        let mut rooms: Vec<RoomPlan> = Vec::new();
        for (index, role) in self.roles.iter().enumerate() {
            let Role::Room(kind) = role else { continue };
            let floor = floors.get(&index).copied().or_else(|| {
                let mut around: Bounds = contents.get(&index).copied()?;
                notes.approximated("room without a floor: around what is in it");
                for axis in 0..2 {
                    around.low[axis] -= ROOM_MARGIN_M;
                    around.high[axis] += ROOM_MARGIN_M;
                }
                Some(around)
            });
            add_room(&mut rooms, kind, floor, notes);
        }
        if rooms.is_empty() {
            for floor in outermost.into_values() {
                add_room(&mut rooms, "room", Some(floor), notes);
            }
        }
        rooms
    }

    /// Walls by the boxes of prims named so; `None` where there are none that run along an axis.
    fn walls(&self, shapes: &[ShapeItem], notes: &mut Notes) -> Option<Vec<Wall>> {
        let mut walls = Vec::new();
        for shape in shapes {
            if self
                .ancestor(&shape.path, |role| *role == Role::Wall)
                .is_none()
            {
                continue;
            }
            match wall(&Bounds::of(&shape.solid.primitive)) {
                Some(wall) => walls.push(wall),
                None => notes.left_out("wall that is no thin box along an axis"),
            }
        }
        (!walls.is_empty()).then_some(walls)
    }
}

fn join(found: &mut BTreeMap<usize, Bounds>, index: usize, bounds: Bounds) {
    let known = found.get(&index).copied();
    found.insert(index, known.map_or(bounds, |known| known.with(bounds)));
}

fn add_room(rooms: &mut Vec<RoomPlan>, kind: &str, floor: Option<Bounds>, notes: &mut Notes) {
    let Some(Bounds { low, high }) = floor else {
        return;
    };
    let round = |value: f64| (value * 1000.0).round() / 1000.0;
    let rect = Rect {
        min: [round(low[0]), round(low[1])],
        max: [round(high[0]), round(high[1])],
    };
    let overlaps = |other: &Rect| {
        (0..2).all(|axis| {
            rect.min[axis] + 0.05 < other.max[axis] && other.min[axis] + 0.05 < rect.max[axis]
        })
    };
    if (0..2).any(|axis| rect.max[axis] - rect.min[axis] < 0.5) {
        notes.left_out("room under half a metre wide");
    } else if rooms.iter().flat_map(|room| &room.rects).any(overlaps) {
        notes.left_out("room that overlaps another");
    } else {
        rooms.push(RoomPlan {
            kind: kind.to_owned(),
            rects: vec![rect],
        });
    }
}

/// The wall that a box is; `None` where it is too thick for one.
fn wall(bounds: &Bounds) -> Option<Wall> {
    let [width, depth, _] = bounds.half().map(|half| 2.0 * half);
    if width.min(depth) > WALL_THICKNESS_MAX_M || width.max(depth) < 0.1 {
        return None;
    }
    let along = usize::from(depth > width);
    let round = |value: f64| (value * 1000.0).round() / 1000.0;
    let end = |at: f64| {
        let mut point = [round(bounds.center()[0]), round(bounds.center()[1])];
        point[along] = round(at);
        point
    };
    Some(Wall {
        from: end(bounds.low[along]),
        to: end(bounds.high[along]),
        height: round(bounds.high[2]).max(0.1),
    })
}
