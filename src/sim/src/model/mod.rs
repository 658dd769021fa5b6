//! What scenes and objects look like and consist of: furniture, walls, floor and household
//! objects as coloured parts.

mod appliances;
mod compartments;
mod details;
mod door;
mod furniture;
mod given;
mod hull;
mod layout;
mod looks;
mod meshed;
mod objects;
mod parts;
#[cfg(test)]
mod tests;
mod walls;

use std::{collections::BTreeSet, sync::Arc};

use reel_world::{Mesh, ObjectInstance, ReceptacleId, Scene, Wall};

use self::{
    appliances::Enclosure,
    compartments::Cabinet,
    furniture::Kind,
    layout::{Rectangle, Spot},
    looks::Traits,
    parts::{Parts, bounds},
};
use crate::{
    geometry::{Part, Pose},
    render::Drawable,
};

pub use self::{
    door::{DoorModel, DoorMotion},
    hull::Hull,
    meshed::MeshModel,
};

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
    /// Id of the receptacle that these parts model.
    pub id: ReceptacleId,
    /// Its fixed parts, in the scene frame; empty while it is taken off (a lid whose
    /// pot is in use).
    pub parts: Vec<Part>,
    /// The rectangle that objects are placed on, in the scene frame; that of a drawer
    /// while it is closed.
    pub surface: Surface,
    /// Bounding box of the parts (door closed, lid on): lower and upper corner.
    pub bounds: [[f32; 3]; 2],
    /// Unit vector its front looks to, on the floor.
    pub facing: [f32; 2],
    /// Its door, if it has one, or itself, if it is a drawer.
    pub door: Option<DoorModel>,
    /// The furniture whose shelf, drawer or compartment it is, as an index.
    pub part_of: Option<usize>,
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
    /// Height of the surface: its z in the scene frame, in metres.
    pub z: f32,
    /// Free height above it, in metres (up to the next shelf or the ceiling of a box).
    pub clearance: f32,
}

/// A movable object as parts, or as a mesh, around the centre of its box.
#[derive(Clone, PartialEq, Debug)]
pub struct ObjectModel {
    /// In the object's frame; the solid ones together stay within its size. None where
    /// there is a mesh.
    pub parts: Vec<Part>,
    /// What stands in for parts.
    pub mesh: Option<MeshModel>,
    /// Half extents of its box.
    pub half: [f32; 3],
    /// In kg per cubic metre.
    pub density: f32,
}

/// Height to which the space above an open surface counts as free, in metres.
const ROOM_HEIGHT_M: f32 = 2.5;

/// Builds a scene. `in_use` names the receptacles that hold objects at the start: what covers
/// them is taken off.
pub fn scene_model(scene: &Scene, in_use: &BTreeSet<ReceptacleId>) -> SceneModel {
    let covered = layout::covered(scene);
    let pieces = covered.iter().enumerate();
    let furniture: Vec<Furniture> = pieces
        .map(|(index, below)| piece(scene, index, *below, in_use))
        .collect();
    let footprints: Vec<_> = furniture
        .iter()
        .map(|piece| piece.bounds.map(|[x, y, _]| [x, y]))
        .collect();
    let walls = walls::walls(scene, &footprints);
    let shell = walls::shell(scene, &walls);
    let corners = scene
        .rooms
        .iter()
        .flat_map(|room| room.footprint())
        .flat_map(|rect| [rect.min, rect.max]);
    let bounds = corners.map(|corner| corner.map(|c| c as f32)).fold(
        None,
        |bounds: Option<[[f32; 2]; 2]>, point| {
            let [low, high] = bounds.unwrap_or([point; 2]);
            Some([
                [low[0].min(point[0]), low[1].min(point[1])],
                [high[0].max(point[0]), high[1].max(point[1])],
            ])
        },
    );
    SceneModel {
        shell,
        walls,
        furniture,
        bounds: bounds.unwrap_or_default(),
    }
}

/// Builds an object from its category, size and attribute words.
pub fn object_model(object: &ObjectInstance) -> ObjectModel {
    objects::build(object)
}

/// Builds an object from a mesh and its size. How dense it is still follows from the words.
pub fn meshed_model(object: &ObjectInstance, mesh: &Arc<Mesh>) -> ObjectModel {
    let model = objects::build(object);
    ObjectModel {
        parts: Vec::new(),
        mesh: Some(MeshModel::fit(mesh, model.half)),
        ..model
    }
}

impl ObjectModel {
    /// The object at a pose, to draw.
    pub(crate) fn drawable(&self, pose: Pose, entity: u16) -> Drawable<'_> {
        Drawable {
            parts: &self.parts,
            mesh: self.mesh.as_ref(),
            pose,
            entity,
        }
    }
}

/// What a receptacle is built as.
enum Build {
    Open(Kind),
    Enclosed(Enclosure),
    Sink,
    Pot,
    Lid,
}

/// Whether furniture of a category can have shelves, drawers and compartments: what is built as a
/// block or a board that stands on something.
pub fn takes_parts(category: &str) -> bool {
    match Build::of(category, false, false) {
        Build::Open(kind) => !matches!(kind, Kind::Bed | Kind::Couch | Kind::Seat),
        _ => false,
    }
}

impl Furniture {
    /// How far its surface has moved when it is open: that of a drawer comes out with it.
    pub fn open_shift(&self) -> [f32; 2] {
        let door = self.door.as_ref();
        door.map_or([0.0; 2], |door| door.shift(door.motion.open_position()))
    }

    /// Its surface when it is open.
    pub fn open_surface(&self) -> Surface {
        self.surface.moved(self.open_shift())
    }
}

impl Build {
    fn of(category: &str, has_door: bool, is_cover: bool) -> Self {
        let letters: String = category
            .to_lowercase()
            .chars()
            .filter(|letter| letter.is_alphanumeric())
            .collect();
        if is_cover || letters.ends_with("lid") {
            Build::Lid
        } else if let Some(enclosure) = Enclosure::of(&letters, has_door) {
            Build::Enclosed(enclosure)
        } else if letters.contains("sink") || letters.contains("basin") {
            Build::Sink
        } else if matches!(letters.as_str(), "pot" | "pan" | "stockpot" | "saucepan") {
            Build::Pot
        } else {
            Build::Open(Kind::of(&letters))
        }
    }

    fn least_size(&self) -> [f32; 2] {
        match self {
            Build::Open(kind) => kind.least_size(),
            Build::Enclosed(enclosure) => enclosure.least_size(),
            Build::Sink => [0.4, 0.5],
            // Round things whose size the whole stove shows.
            Build::Pot | Build::Lid => [0.2, 0.2],
        }
    }
}

/// A piece before it knows its name: what was built of a receptacle.
struct Built {
    spot: Spot,
    surface: Rectangle,
    clearance: f32,
    door: Option<DoorModel>,
    parts: Vec<Part>,
}

fn piece(
    scene: &Scene,
    index: usize,
    below: Option<usize>,
    in_use: &BTreeSet<ReceptacleId>,
) -> Furniture {
    let receptacle = &scene.receptacles[index];
    let part_of = receptacle.part_of.as_ref();
    let part_of = part_of.and_then(|id| scene.receptacles.iter().position(|it| it.id == *id));
    let built = match (&receptacle.geometry, part_of) {
        (Some(geometry), _) => given::build(scene, index, geometry),
        (None, Some(whole)) => part(scene, index, whole),
        (None, None) => whole(scene, index, below),
    };
    let door_parts: Vec<Part> = built
        .door
        .iter()
        .flat_map(|door| door.parts_at(0.0))
        .collect();
    let taken_off = below.is_some_and(|below| in_use.contains(&scene.receptacles[below].id))
        && !in_use.contains(&receptacle.id);
    Furniture {
        id: receptacle.id.clone(),
        bounds: bounds(built.parts.iter().chain(&door_parts)),
        surface: Surface {
            min: built.surface[0],
            max: built.surface[1],
            z: receptacle.surface_max[2] as f32,
            clearance: built.clearance,
        },
        facing: built.spot.frame.turn([1.0, 0.0]),
        door: built.door,
        part_of,
        present: !taken_off,
        parts: if taken_off { Vec::new() } else { built.parts },
    }
}

/// A piece of furniture that its scene describes in words.
fn whole(scene: &Scene, index: usize, below: Option<usize>) -> Built {
    let receptacle = &scene.receptacles[index];
    let (build, spot) = standing(scene, index, below.is_some());
    let z = receptacle.surface_max[2] as f32;
    let traits = Traits::of(receptacle);
    let mut parts = Parts::new(spot.frame);
    let mut clearance = (ROOM_HEIGHT_M - z).max(0.1);
    let mut door = None;
    match build {
        Build::Open(kind) => match Cabinet::of(scene, index, spot) {
            Some(cabinet) => cabinet.build(&traits, &mut parts),
            None => furniture::build(kind, &spot, z, &traits, &mut parts),
        },
        Build::Enclosed(enclosure) => {
            clearance = enclosure.clearance();
            door = appliances::enclosure(enclosure, receptacle.door, &spot, z, &traits, &mut parts);
        }
        Build::Sink => appliances::sink(&spot, z, &traits, &mut parts),
        Build::Pot => appliances::pot(&spot, z, &traits, &mut parts),
        Build::Lid => {
            let on = below.map(|below| scene.receptacles[below].surface_max[2] as f32);
            appliances::lid(&spot, z, on, &traits, &mut parts);
        }
    }
    Built {
        spot,
        surface: spot.surface,
        clearance,
        door,
        parts: parts.finish(),
    }
}

/// A shelf, a drawer or a compartment of a piece that its scene describes in words.
fn part(scene: &Scene, index: usize, whole: usize) -> Built {
    let (_, spot) = standing(scene, whole, false);
    let receptacle = &scene.receptacles[index];
    let traits = [index, whole].map(|index| Traits::of(&scene.receptacles[index]));
    let mut parts = Parts::new(spot.frame);
    let cabinet = Cabinet::of(scene, whole, spot).expect("its part is one");
    let built = cabinet.part(index, receptacle.door, traits.each_ref(), &mut parts);
    Built {
        spot,
        surface: layout::rectangle(receptacle),
        clearance: built.clearance,
        door: built.door,
        parts: parts.finish(),
    }
}

/// What a piece is built as, and where it stands.
fn standing(scene: &Scene, index: usize, is_cover: bool) -> (Build, Spot) {
    let receptacle = &scene.receptacles[index];
    let build = Build::of(&receptacle.category, receptacle.door.exists(), is_cover);
    let front_is_short = matches!(build, Build::Open(Kind::Bed));
    let spot = Spot::of(scene, index, build.least_size(), front_is_short);
    (build, spot)
}
