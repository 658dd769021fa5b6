//! Each sort of fault, planted in two rooms that are fine, is found where it is.

use reel_tasks::generate::scene::{Finding, SceneFault, check};
use reel_world::Scene;
use serde_json::{Value, json};

fn wall(from: [f64; 2], to: [f64; 2]) -> Value {
    json!({ "from": from, "to": to, "height": 2.5 })
}

/// Two rooms of 4 x 4 m with a doorway between them from y = `low` to `high`, a table in the first
/// and a cupboard with a door in the second, whose front looks to -x.
fn two_rooms([low, high]: [f64; 2]) -> Value {
    let mut walls = vec![
        wall([0.0, -0.05], [8.0, -0.05]),
        wall([0.0, 4.05], [8.0, 4.05]),
        wall([-0.05, 0.0], [-0.05, 4.0]),
        wall([8.05, 0.0], [8.05, 4.0]),
        wall([4.0, 0.0], [4.0, low]),
    ];
    if high > low {
        walls.push(wall([4.0, high], [4.0, 4.0]));
    }
    json!({
        "scene_id": "two rooms",
        "rooms": [
            { "name": "kitchen/0", "min": [0.0, 0.0], "max": [4.0, 4.0] },
            { "name": "bedroom/0", "min": [4.0, 0.0], "max": [8.0, 4.0] },
        ],
        "walls": walls,
        "robot_start": [2.0, 2.0, 0.0],
        "receptacles": [
            {
                "id": "table_1", "room": "kitchen/0", "category": "table", "captions": { "the white table": 1.0 },
                "attributes": { "colour": ["white"] }, "facing_deg": 90.0,
                "surface_min": [1.0, 0.1, 0.71], "surface_max": [2.0, 0.8, 0.74],
            },
            {
                "id": "cupboard_1", "room": "bedroom/0", "category": "cupboard", "captions": { "the cupboard": 1.0 },
                "attributes": { "colour": ["black"] }, "facing_deg": 180.0, "door": "left",
                "surface_min": [7.3, 1.5, 0.77], "surface_max": [7.9, 2.2, 0.8],
            },
        ],
    })
}

fn found(scene: &Value) -> Vec<Finding> {
    let scene: Scene = reel_tasks::scene::parse(&scene.to_string(), "planted")
        .unwrap()
        .scene;
    check(&scene)
}

/// That a fault is found of something, and how it is told.
fn assert_found(scene: &Value, fault: SceneFault, at: &str, told: &str) {
    let findings = found(scene);
    let hit = findings.iter().any(|finding| {
        finding.fault == fault && finding.at == at && finding.message.contains(told)
    });
    assert!(
        hit,
        "no {fault:?} of {at} that tells {told:?} in {findings:?}"
    );
}

const DOORWAY: [f64; 2] = [1.5, 2.5];

#[test]
fn two_rooms_are_fine() {
    assert_eq!(found(&two_rooms(DOORWAY)), []);
}

#[test]
fn overlap() {
    let mut scene = two_rooms(DOORWAY);
    let mut second = scene["receptacles"][0].clone();
    second["id"] = json!("table_2");
    second["captions"] = json!({ "the other table": 1.0 });
    second["surface_min"] = json!([1.5, 0.3, 0.71]);
    second["surface_max"] = json!([2.5, 1.0, 0.74]);
    scene["receptacles"].as_array_mut().unwrap().push(second);
    assert_found(&scene, SceneFault::Overlap, "table_2", "stands in table_1");
    let overlap = found(&scene)
        .into_iter()
        .find(|finding| finding.fault == SceneFault::Overlap)
        .unwrap();
    assert!(
        (overlap.place[0] - 1.75).abs() < 0.03 && (overlap.place[1] - 0.55).abs() < 0.03,
        "{overlap:?}"
    );
}

#[test]
fn overlap_with_a_wall_and_out_of_the_room() {
    let mut scene = two_rooms(DOORWAY);
    scene["receptacles"][0]["surface_min"] = json!([3.2, 0.1, 0.71]);
    scene["receptacles"][0]["surface_max"] = json!([4.4, 0.8, 0.74]);
    assert_found(&scene, SceneFault::Overlap, "table_1", "stands in a wall");
    assert_found(&scene, SceneFault::OutOfRoom, "table_1", "kitchen/0");
}

#[test]
fn unreachable() {
    let scene = two_rooms([4.0, 4.0]);
    assert_found(
        &scene,
        SceneFault::Unreachable,
        "bedroom/0",
        "cannot get into this room",
    );
    assert_found(
        &scene,
        SceneFault::Unreachable,
        "cupboard_1",
        "cannot come near",
    );
}

#[test]
fn narrow() {
    assert_found(
        &two_rooms([1.5, 2.15]),
        SceneFault::Narrow,
        "cupboard_1",
        "narrower than 0.9 m",
    );
}

#[test]
fn door_into_a_wall() {
    let mut scene = two_rooms(DOORWAY);
    scene["walls"]
        .as_array_mut()
        .unwrap()
        .push(wall([6.8, 1.0], [6.8, 2.8]));
    assert_found(
        &scene,
        SceneFault::Door,
        "cupboard_1",
        "its door hits a wall",
    );
}

#[test]
fn door_into_furniture() {
    let mut scene = two_rooms(DOORWAY);
    scene["receptacles"][0]["room"] = json!("bedroom/0");
    scene["receptacles"][0]["surface_min"] = json!([6.2, 1.4, 0.71]);
    scene["receptacles"][0]["surface_max"] = json!([6.9, 2.3, 0.84]);
    assert_found(
        &scene,
        SceneFault::Door,
        "cupboard_1",
        "its door hits table_1",
    );
}

#[test]
fn no_sight() {
    let mut above_the_eyes = two_rooms(DOORWAY);
    above_the_eyes["receptacles"][0]["surface_min"][2] = json!(1.77);
    above_the_eyes["receptacles"][0]["surface_max"][2] = json!(1.8);
    assert_found(
        &above_the_eyes,
        SceneFault::NoSight,
        "table_1",
        "0 of 5 points",
    );

    let mut behind_a_wall = two_rooms(DOORWAY);
    behind_a_wall["walls"]
        .as_array_mut()
        .unwrap()
        .push(wall([7.1, 0.9], [7.1, 2.8]));
    assert_found(
        &behind_a_wall,
        SceneFault::NoSight,
        "cupboard_1",
        "something stands before it",
    );
}

#[test]
fn captions_that_mislead() {
    let mut scene = two_rooms(DOORWAY);
    scene["receptacles"][1]["captions"] =
        json!({ "The White Table": 1.0, "the green cupboard": 1.0 });
    assert_found(
        &scene,
        SceneFault::Caption,
        "cupboard_1",
        "is said of table_1 too",
    );
    assert_found(&scene, SceneFault::Caption, "cupboard_1", "says green");
    scene["receptacles"][1]["captions"] = json!({});
    assert_found(&scene, SceneFault::Caption, "cupboard_1", "no caption");
}
