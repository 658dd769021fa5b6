//! Whether a task can be played in a scene at all: both may come from strangers, in traces and bundles, and a simulator that was
//! given the impossible would break or never end.

use std::collections::BTreeSet;

use crate::{FLOOR, InstanceId, ReceptacleId, Scene, Task, WorldGraph};

/// Longest distance from the origin, and largest size, in metres.
const LENGTH_MAX: f64 = 1000.0;
/// Most rooms, receptacles or objects; REAL-Bench's scene has 68 receptacles.
const COUNT_MAX: usize = 1000;
/// Most walls; a room has a few.
const WALLS_MAX: usize = 10 * COUNT_MAX;

/// Whether numbers, names and references of a task and its scene are possible.
///
/// # Errors
/// The first that is not.
pub fn check_playable(scene: &Scene, task: &Task) -> Result<(), String> {
    let walls = scene.walls.as_ref().map_or(0, Vec::len);
    for (name, count, most) in [
        ("rooms", scene.rooms.len(), COUNT_MAX),
        ("walls", walls, WALLS_MAX),
        ("receptacles", scene.receptacles.len(), COUNT_MAX),
        ("objects", task.objects.len(), COUNT_MAX),
    ] {
        if count > most {
            return Err(format!("it has {count} {name}, and {most} is the most"));
        }
    }
    lengths(scene, task)?;
    let mut receptacles = BTreeSet::new();
    if let Some(twice) = scene
        .receptacles
        .iter()
        .find(|receptacle| !receptacles.insert(&receptacle.id))
    {
        return Err(format!("the scene has {} twice", twice.id));
    }
    for receptacle in &scene.receptacles {
        let refers = receptacle.part_of.iter().chain(&receptacle.covers);
        for other in refers {
            if other == &receptacle.id || !receptacles.contains(other) {
                return Err(format!(
                    "{} belongs to {other}, which is no other receptacle of the scene",
                    receptacle.id
                ));
            }
        }
    }
    let mut objects = BTreeSet::new();
    for object in &task.objects {
        if !objects.insert(&object.instance) {
            return Err(format!("the task has {} twice", object.instance));
        }
        if object.receptacle.as_str() != FLOOR && !receptacles.contains(&object.receptacle) {
            return Err(format!(
                "{} stands on {}, which is no receptacle of the scene",
                object.instance, object.receptacle
            ));
        }
    }
    graph("start", &task.initial, &receptacles, &objects)?;
    graph("goal", &task.goal, &receptacles, &objects)
}

/// An object is one thing: a graph cannot have it more often than there are objects, nor somewhere that is nowhere.
fn graph(
    name: &str,
    graph: &WorldGraph,
    receptacles: &BTreeSet<&ReceptacleId>,
    objects: &BTreeSet<&InstanceId>,
) -> Result<(), String> {
    for (id, state) in &graph.receptacles {
        if id.as_str() != FLOOR && !receptacles.contains(id) {
            return Err(format!(
                "the {name} has {id}, which is no receptacle of the scene"
            ));
        }
        for (object, count) in &state.content {
            if !objects.contains(object) || *count as usize > objects.len() {
                return Err(format!(
                    "the {name} has {object} {count} times on {id}, and there is no such number of it"
                ));
            }
        }
    }
    Ok(())
}

fn lengths(scene: &Scene, task: &Task) -> Result<(), String> {
    let within = |name: &str, values: &[f64]| {
        let wrong = values.iter().find(|value| value.abs() > LENGTH_MAX);
        wrong.map_or(Ok(()), |value| {
            Err(format!(
                "{name} is {value:e} m far or large, and {LENGTH_MAX} m is the most"
            ))
        })
    };
    for room in &scene.rooms {
        within(&room.name, &[room.min, room.max].concat())?;
        for rect in &room.rects {
            within(&room.name, &[rect.min, rect.max].concat())?;
        }
    }
    for wall in scene.walls.iter().flatten() {
        within("a wall", &[wall.from, wall.to].concat())?;
        within("a wall", &[wall.height])?;
    }
    within("the robot's start", &scene.robot_start.unwrap_or_default())?;
    for receptacle in &scene.receptacles {
        let surface = [receptacle.surface_min, receptacle.surface_max].concat();
        within(receptacle.id.as_str(), &surface)?;
    }
    for object in &task.objects {
        let place = [object.position, object.size].concat();
        within(object.instance.as_str(), &place)?;
    }
    Ok(())
}
