//! Scene files: JSON into a [`Scene`], checked so that the simulator can rely on it.

use std::{ops::RangeInclusive, path::Path};

use reel_sim::model::takes_parts;
use reel_world::{Door, FurnitureJoint, Receptacle, ReceptacleId, Rect, Scene, SolidShape};

use crate::{TaskError, attributes, load::read_file};

/// A scene and what is doubtful in it.
#[derive(Clone, PartialEq, Debug)]
pub struct LoadedScene {
    /// The scene, checked so that the simulator can rely on it.
    pub scene: Scene,
    /// What is doubtful but can be lived with, for people.
    pub warnings: Vec<String>,
}

/// Loads a scene file.
///
/// # Errors
/// When it cannot be read, is no scene, or contradicts itself.
pub fn load(path: &Path) -> Result<LoadedScene, TaskError> {
    let file = path.display().to_string();
    parse(&read_file(path, &file)?, &file)
}

/// Reads a scene from the text of a file; `file` is its name in errors.
///
/// Furniture without attribute words gets those of its captions. A lid (category ending in `lid`)
/// without `placeable` in the file cannot be placed upon, and covers the receptacle under it.
///
/// # Errors
/// When it is no scene or contradicts itself.
pub fn parse(text: &str, file: &str) -> Result<LoadedScene, TaskError> {
    let syntax = |error: serde_json::Error| TaskError::Syntax {
        file: file.to_owned(),
        line: error.line(),
        problem: without_place(&error),
    };
    let mut scene: Scene = serde_json::from_str(text).map_err(syntax)?;
    let raw: serde_json::Value = serde_json::from_str(text).map_err(syntax)?;
    check(&scene).map_err(|(field, problem)| TaskError::Scene {
        file: file.to_owned(),
        field,
        problem,
    })?;
    for index in 0..scene.receptacles.len() {
        if scene.receptacles[index].category.ends_with("lid")
            && raw["receptacles"][index].get("placeable").is_none()
        {
            let covers = covered_by(&scene, &scene.receptacles[index]);
            let lid = &mut scene.receptacles[index];
            lid.placeable = false;
            lid.covers = lid.covers.take().or(covers);
        }
        let receptacle = &mut scene.receptacles[index];
        if receptacle.attributes.is_empty() {
            receptacle.attributes =
                attributes::from_furniture_captions(receptacle.captions.keys().map(String::as_str));
        }
    }
    let warnings = warnings(&scene);
    Ok(LoadedScene { scene, warnings })
}

/// The scene of our own: 18 receptacles in 6 rooms, three of them with doors.
pub fn home_scene() -> Scene {
    parse(include_str!("data/home.json"), "home.json")
        .expect("the committed scene is well formed")
        .scene
}

type Fault = (String, String);

fn check(scene: &Scene) -> Result<(), Fault> {
    let fault = |field: String, problem: &str| Err((field, problem.to_owned()));
    if scene.rooms.is_empty() {
        return fault("rooms".to_owned(), "none; a scene needs at least one room");
    }
    if scene.receptacles.is_empty() {
        return fault("receptacles".to_owned(), "none; a scene needs furniture");
    }
    for (index, room) in scene.rooms.iter().enumerate() {
        let field = format!("rooms[{index}] ({})", room.name);
        if scene.rooms[..index]
            .iter()
            .any(|other| other.name == room.name)
        {
            return fault(field, "this name stands twice");
        }
        for rect in room.footprint() {
            check_range(&rect.min, &rect.max).map_err(|problem| (field.clone(), problem))?;
        }
    }
    for (index, wall) in scene.walls.iter().flatten().enumerate() {
        let field = format!("walls[{index}]");
        if wall
            .from
            .iter()
            .zip(&wall.to)
            .filter(|(from, to)| from != to)
            .count()
            != 1
        {
            return fault(field, "is not a straight line along x or y");
        }
        if wall.height <= 0.0 {
            return fault(field, "height must be above 0");
        }
    }
    for (index, receptacle) in scene.receptacles.iter().enumerate() {
        let field = format!("receptacles[{index}] ({})", receptacle.id);
        if receptacle.id.as_str() == reel_world::FLOOR || receptacle.id.as_str().is_empty() {
            return fault(field, "this id is reserved");
        }
        if scene.receptacles[..index]
            .iter()
            .any(|other| other.id == receptacle.id)
        {
            return fault(field, "this id stands twice");
        }
        if !scene.rooms.iter().any(|room| room.name == receptacle.room) {
            return Err((
                field,
                format!("its room {:?} is not a room of the scene", receptacle.room),
            ));
        }
        check_range(&receptacle.surface_min, &receptacle.surface_max)
            .map_err(|problem| (field.clone(), problem))?;
        if let Some(covered) = &receptacle.covers
            && (scene.receptacle(covered).is_none() || *covered == receptacle.id)
        {
            return Err((
                field,
                format!("covers {covered}, which is not another receptacle of the scene"),
            ));
        }
        check_part(scene, receptacle)
            .and_then(|()| check_geometry(receptacle))
            .map_err(|problem| (field, problem))?;
    }
    Ok(())
}

/// How far the surface of a part may stand out of that of its furniture, in metres.
const PART_MARGIN_M: f64 = 0.02;

/// Least height from the surface of a part to the next one, boards and all, in metres.
const PART_HEIGHT_M: f64 = 0.06;
/// Farthest from the origin that anything stands, and largest that anything is, in metres.
const FAR_M: f64 = 1e4;
/// How far a given door turns, in degrees: less is no door, and more would turn the other way.
const HINGE_DEG: RangeInclusive<f64> = 1.0..=175.0;
/// How far a given drawer comes out, in metres.
const SLIDE_M: RangeInclusive<f64> = 0.01..=2.0;

/// A shelf, a drawer or a compartment lies inside of its furniture.
fn check_part(scene: &Scene, part: &Receptacle) -> Result<(), String> {
    let Some(whole) = &part.part_of else {
        if part.door == Door::Drawer && part.geometry.is_none() {
            return Err("a drawer needs `part_of`, the furniture that it slides out of".to_owned());
        }
        return Ok(());
    };
    let furniture = scene.receptacle(whole).filter(|it| it.id != part.id);
    let furniture = furniture
        .ok_or_else(|| format!("part of {whole}, which is not another receptacle of the scene"))?;
    if furniture.part_of.is_some() {
        return Err(format!("part of {whole}, which is a part itself"));
    }
    if furniture.room != part.room {
        return Err(format!("part of {whole}, which is in another room"));
    }
    if furniture.geometry.is_some() != part.geometry.is_some() {
        return Err(format!(
            "part of {whole}: give geometry to both of them or to neither"
        ));
    }
    if part.geometry.is_some() {
        return Ok(());
    }
    if furniture.door.exists() {
        return Err(format!(
            "part of {whole}, which has a door: give the door to the parts"
        ));
    }
    if !takes_parts(&furniture.category) {
        return Err(format!(
            "part of {whole}, but a {} is not built with parts: give both geometry",
            furniture.category
        ));
    }
    let inside = (0..2).all(|axis| {
        part.surface_min[axis] >= furniture.surface_min[axis] - PART_MARGIN_M
            && part.surface_max[axis] <= furniture.surface_max[axis] + PART_MARGIN_M
    });
    if !inside {
        return Err(format!(
            "part of {whole}, but its surface reaches out of that one's"
        ));
    }
    if part.surface_height() + PART_HEIGHT_M > furniture.surface_height() {
        return Err(format!(
            "part of {whole}, but not {PART_HEIGHT_M} m below its surface"
        ));
    }
    let in_its_place = scene.parts_of(whole).find(|other| {
        let abreast = (0..2).all(|axis| {
            other.surface_min[axis] < part.surface_max[axis]
                && part.surface_min[axis] < other.surface_max[axis]
        });
        let rise = (other.surface_height() - part.surface_height()).abs();
        other.id != part.id && abreast && rise < PART_HEIGHT_M
    });
    match in_its_place {
        Some(other) => Err(format!(
            "lies in {}: one part is at least {PART_HEIGHT_M} m above another",
            other.id
        )),
        None => Ok(()),
    }
}

fn check_geometry(receptacle: &Receptacle) -> Result<(), String> {
    let Some(geometry) = &receptacle.geometry else {
        return Ok(());
    };
    if geometry.fixed.is_empty() && geometry.moving.is_empty() {
        return Err("its geometry is empty".to_owned());
    }
    for (index, primitive) in geometry.fixed.iter().chain(&geometry.moving).enumerate() {
        let sizes: &[f64] = match &primitive.shape {
            SolidShape::Box { half } => half,
            SolidShape::Cylinder {
                radius,
                half_height,
            } => &[*radius, *half_height],
            SolidShape::Sphere { radius } => &[*radius],
        };
        if !sizes.iter().all(|size| *size > 0.0 && *size < FAR_M) {
            return Err(format!(
                "primitive {index} of its geometry: every size must be above 0 and below {FAR_M} m"
            ));
        }
        if !primitive.position.iter().all(|value| value.abs() < FAR_M) {
            return Err(format!(
                "primitive {index} of its geometry: its position is not within {FAR_M} m"
            ));
        }
        if !is_unit(&primitive.rotation) {
            return Err(format!(
                "primitive {index} of its geometry: its rotation is no unit quaternion"
            ));
        }
    }
    if geometry.moving.is_empty() != geometry.joint.is_none() {
        return Err("its geometry needs both `moving` and `joint`, or neither".to_owned());
    }
    match (&geometry.joint, receptacle.door) {
        (None, Door::None)
        | (Some(FurnitureJoint::Slide { .. }), Door::Drawer)
        | (Some(FurnitureJoint::Hinge { .. }), Door::Left | Door::Right) => {}
        _ => {
            return Err(
                "its door is not what its geometry says: a slide is a drawer, a hinge is left or right, and without a joint there is no door"
                    .to_owned(),
            );
        }
    }
    match geometry.joint {
        Some(FurnitureJoint::Hinge { axis, .. }) if !is_unit(&axis) => {
            Err("the axis of its hinge is no unit vector".to_owned())
        }
        Some(FurnitureJoint::Hinge {
            position, open_deg, ..
        }) if !HINGE_DEG.contains(&open_deg.abs())
            || !position.iter().all(|value| value.abs() < FAR_M) =>
        {
            Err(format!(
                "its hinge opens by {open_deg} degrees: {} to {} either way are possible, within {FAR_M} m",
                HINGE_DEG.start(),
                HINGE_DEG.end()
            ))
        }
        Some(FurnitureJoint::Slide { open_by: [x, y] })
            if !SLIDE_M.contains(&libm::hypot(x, y)) =>
        {
            Err(format!(
                "its slide opens by {} m: {} to {} m are possible",
                libm::hypot(x, y),
                SLIDE_M.start(),
                SLIDE_M.end()
            ))
        }
        _ => Ok(()),
    }
}

fn is_unit(vector: &[f64]) -> bool {
    let square: f64 = vector.iter().map(|value| value * value).sum();
    (square - 1.0).abs() < 1e-3
}

fn check_range(min: &[f64], max: &[f64]) -> Result<(), String> {
    if !min.iter().chain(max).all(|value| value.abs() < FAR_M) {
        return Err(format!("it is not within {FAR_M} m of the origin"));
    }
    if min.iter().zip(max).all(|(min, max)| min < max) {
        return Ok(());
    }
    Err(format!(
        "its minimum {min:?} is not below its maximum {max:?}"
    ))
}

fn warnings(scene: &Scene) -> Vec<String> {
    let mut warnings = Vec::new();
    for receptacle in &scene.receptacles {
        let room = scene
            .rooms
            .iter()
            .find(|room| room.name == receptacle.room)
            .expect("checked: the room is there");
        let Rect { min, max } = receptacle.surface_rect();
        let corners = [min, max, [min[0], max[1]], [max[0], min[1]]];
        if !corners
            .iter()
            .all(|corner| room.footprint().iter().any(|rect| rect.contains(*corner)))
        {
            warnings.push(format!(
                "{} reaches out of its room {}",
                receptacle.id, room.name
            ));
        }
    }
    let unnamed: Vec<&str> = scene
        .receptacles
        .iter()
        .filter(|receptacle| receptacle.captions.is_empty())
        .map(|r| r.id.as_str())
        .collect();
    if !unnamed.is_empty() {
        warnings.push(format!(
            "no instruction can name what has no caption: {}",
            unnamed.join(", ")
        ));
    }
    warnings
}

/// The highest receptacle under a lid.
fn covered_by(scene: &Scene, lid: &Receptacle) -> Option<ReceptacleId> {
    let centre = [0, 1].map(|axis| (lid.surface_min[axis] + lid.surface_max[axis]) / 2.0);
    let under = scene.receptacles.iter().filter(|other| {
        other.id != lid.id
            && other.surface_rect().contains(centre)
            && other.surface_height() < lid.surface_height()
    });
    under
        .max_by(|a, b| a.surface_height().total_cmp(&b.surface_height()))
        .map(|receptacle| receptacle.id.clone())
}

/// The message of a JSON error without "at line 1 column 2", which stands before it already.
fn without_place(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.split(" at line ").next().unwrap_or(&text).to_owned()
}
