//! Scene files: the committed one, the published one, broken ones; and the JSON Schema
//! agrees with the loader.

use reel_world::{Door, Rect};
use serde_json::{Value, json};

use crate::{data, real_bench};

pub(crate) fn schema() -> jsonschema::Validator {
    let schema: Value =
        serde_json::from_str(include_str!("../../../../schemas/scene.schema.json")).unwrap();
    jsonschema::validator_for(&schema).unwrap()
}

fn small() -> Value {
    json!({
        "scene_id": "small",
        "rooms": [{ "name": "hall", "min": [0, 0], "max": [3, 3] }],
        "receptacles": [{
            "id": "table_1", "room": "hall", "category": "table", "captions": { "the white table": 1 },
            "surface_min": [1, 1, 0.7], "surface_max": [2, 2, 0.75],
        }],
    })
}

fn problem(scene: &Value) -> String {
    let text = serde_json::to_string_pretty(scene).unwrap();
    reel_tasks::scene::parse(&text, "scene.json")
        .unwrap_err()
        .to_string()
}

/// The small scene with another value, or one more, at a JSON pointer.
fn changed(pointer: &str, value: Value) -> Value {
    let mut scene = small();
    let (parent, field) = pointer.rsplit_once('/').unwrap();
    scene.pointer_mut(parent).unwrap()[field] = value;
    scene
}

#[test]
fn the_home_is_as_promised() {
    let text = include_str!("../../src/data/home.json");
    assert!(schema().is_valid(&serde_json::from_str(text).unwrap()));
    let loaded = reel_tasks::scene::parse(text, "home.json").unwrap();
    assert_eq!(loaded.warnings, Vec::<String>::new());
    let home = loaded.scene;
    assert_eq!(home, reel_tasks::home_scene());
    assert_eq!((home.receptacles.len(), home.rooms.len()), (18, 6));
    let doors: Vec<&str> = home
        .receptacles
        .iter()
        .filter(|r| r.door.exists())
        .map(|r| r.category.as_str())
        .collect();
    assert_eq!(doors, ["refrigerator", "microwave", "washingmachine"]);
    let mut captions: Vec<&String> = home
        .receptacles
        .iter()
        .flat_map(|receptacle| receptacle.captions.keys())
        .collect();
    let all = captions.len();
    captions.sort();
    captions.dedup();
    assert_eq!(captions.len(), all, "every caption is unique");
    for receptacle in &home.receptacles {
        let Rect { min, max } = receptacle.surface_rect();
        let mut sides = [max[0] - min[0], max[1] - min[1]];
        sides.sort_by(f64::total_cmp);
        assert!(
            sides[0] >= 0.4 && sides[1] >= 0.5,
            "{}: {sides:?}",
            receptacle.id
        );
        let alike = |other: &&reel_world::Receptacle| {
            other.category == receptacle.category && other.id != receptacle.id
        };
        for other in home.receptacles.iter().filter(alike) {
            assert_ne!(
                other.attributes, receptacle.attributes,
                "{} and {}",
                other.id, receptacle.id
            );
        }
    }
}

#[test]
fn every_piece_of_the_home_has_free_floor_before_it_and_doorways_are_free() {
    let home = reel_tasks::home_scene();
    let mut doorways: Vec<Rect> = Vec::new();
    for (index, a) in home.rooms.iter().enumerate() {
        for b in &home.rooms[..index] {
            let from = [0, 1].map(|axis| a.min[axis].max(b.min[axis]));
            let to = [0, 1].map(|axis| a.max[axis].min(b.max[axis]));
            if (0..2).all(|axis| from[axis] <= to[axis]) && from != to {
                let middle = [0, 1].map(|axis| (from[axis] + to[axis]) / 2.0);
                doorways.push(Rect {
                    min: middle.map(|value| value - 0.7),
                    max: middle.map(|value| value + 0.7),
                });
            }
        }
    }
    assert_eq!(doorways.len(), 7);
    let overlap = |a: &Rect, b: &Rect| {
        (0..2).all(|axis| a.min[axis] < b.max[axis] - 1e-9 && b.min[axis] < a.max[axis] - 1e-9)
    };
    for receptacle in &home.receptacles {
        let Rect { min, max } = receptacle.surface_rect();
        let front = match receptacle.facing_deg.map(|degrees| degrees as i32) {
            Some(0) => Rect {
                min: [max[0], min[1]],
                max: [max[0] + 0.9, max[1]],
            },
            Some(90) => Rect {
                min: [min[0], max[1]],
                max: [max[0], max[1] + 0.9],
            },
            Some(180) => Rect {
                min: [min[0] - 0.9, min[1]],
                max: [min[0], max[1]],
            },
            Some(270) => Rect {
                min: [min[0], min[1] - 0.9],
                max: [max[0], min[1]],
            },
            other => panic!("{}: facing {other:?}", receptacle.id),
        };
        assert!(
            !doorways
                .iter()
                .any(|doorway| overlap(doorway, &receptacle.surface_rect())),
            "{} stands in a doorway",
            receptacle.id
        );
        let room = home
            .rooms
            .iter()
            .find(|room| room.name == receptacle.room)
            .unwrap();
        assert!(
            room.footprint()[0].contains(front.min) && room.footprint()[0].contains(front.max),
            "{}",
            receptacle.id
        );
        for other in home
            .receptacles
            .iter()
            .filter(|other| other.id != receptacle.id)
        {
            assert!(
                !overlap(&front, &other.surface_rect()),
                "{} stands before {}",
                other.id,
                receptacle.id
            );
            assert!(
                !overlap(&receptacle.surface_rect(), &other.surface_rect()),
                "{} stands in {}",
                other.id,
                receptacle.id
            );
        }
    }
}

#[test]
fn the_published_scene_loads() {
    let Some(real) = real_bench() else { return };
    let text = std::fs::read_to_string(real.join("s7_scene.json")).unwrap();
    assert!(schema().is_valid(&serde_json::from_str(&text).unwrap()));
    let scene = reel_tasks::scene::parse(&text, "s7_scene.json")
        .unwrap()
        .scene;
    let lid = scene.receptacle(&"potlid_0".into()).unwrap();
    assert_eq!(
        (lid.placeable, lid.covers.as_ref().map(|id| id.as_str())),
        (false, Some("pot_0"))
    );
    let desk = scene.receptacle(&"desk_1".into()).unwrap();
    assert_eq!(
        (
            desk.attributes["colour"].join(" "),
            desk.attributes["handles"].join(" ")
        ),
        ("white".into(), "wooden wood orange".into())
    );
}

#[test]
fn a_fixture_lid_covers_its_pot() {
    let scene = reel_tasks::scene::load(&data("scene.json")).unwrap().scene;
    let lid = scene.receptacle(&"potlid_0".into()).unwrap();
    assert_eq!(
        (lid.placeable, lid.covers.as_ref().map(|id| id.as_str())),
        (false, Some("pot_0"))
    );
}

#[test]
fn what_the_schema_refuses_the_loader_refuses() {
    let schema = schema();
    assert!(schema.is_valid(&small()));
    assert_eq!(
        reel_tasks::scene::parse(&small().to_string(), "small.json")
            .unwrap()
            .warnings,
        Vec::<String>::new()
    );
    for (scene, expected) in [
        (
            changed("/rooms", json!([])),
            "scene.json: rooms: none; a scene needs at least one room",
        ),
        (
            changed("/receptacles", json!([])),
            "scene.json: receptacles: none; a scene needs furniture",
        ),
        (
            changed("/scene_id", json!(7)),
            "scene.json:2: invalid type: integer `7`, expected a string",
        ),
        (
            changed("/receptacles/0/id", json!("floor")),
            "scene.json: receptacles[0] (floor): this id is reserved",
        ),
        (
            changed("/receptacles/0/surface_max", json!([2, 2])),
            "scene.json:32: invalid length 2, expected an array of length 3",
        ),
    ] {
        assert!(!schema.is_valid(&scene), "{expected}");
        assert_eq!(problem(&scene), expected);
    }
}

#[test]
fn what_no_schema_can_say_the_loader_says() {
    let mut twice = small();
    let table = twice["receptacles"][0].clone();
    twice["receptacles"].as_array_mut().unwrap().push(table);
    let mut rooms = small();
    let room = rooms["rooms"][0].clone();
    rooms["rooms"].as_array_mut().unwrap().push(room);
    let mut wall = small();
    wall["walls"] = json!([{ "from": [0, 0], "to": [1, 1], "height": 2.5 }]);
    let mut lid = small();
    lid["receptacles"][0]["covers"] = json!("pot_7");
    for (scene, expected) in [
        (twice, "receptacles[1] (table_1): this id stands twice"),
        (rooms, "rooms[1] (hall): this name stands twice"),
        (wall, "walls[0]: is not a straight line along x or y"),
        (
            lid,
            "receptacles[0] (table_1): covers pot_7, which is not another receptacle of the scene",
        ),
        (
            changed("/receptacles/0/part_of", json!("dresser_1")),
            "receptacles[0] (table_1): part of dresser_1, which is not another receptacle of the scene",
        ),
        (
            changed("/receptacles/0/door", json!("drawer")),
            "receptacles[0] (table_1): a drawer needs `part_of`, the furniture that it slides out of",
        ),
        (
            changed(
                "/receptacles/0/geometry",
                json!({
                    "moving": [{"shape": {"sphere": {"radius": 0.1}}, "position": [0, 0, 0]}],
                    "joint": {"slide": {"open_by": [1e300, 0]}}
                }),
            ),
            "receptacles[0] (table_1): its door is not what its geometry says: a slide is a drawer, a hinge is left or right, and without a joint there is no door",
        ),
        (
            changed("/receptacles/0/geometry", json!({})),
            "receptacles[0] (table_1): its geometry is empty",
        ),
        (
            changed("/receptacles/0/surface_max", json!([1e300, 2, 0.75])),
            "receptacles[0] (table_1): it is not within 10000 m of the origin",
        ),
        (
            changed(
                "/receptacles/0/geometry",
                json!({"fixed": [{"shape": {"box": {"half": [0.1, 0, 0.1]}}, "position": [0, 0, 0]}]}),
            ),
            "receptacles[0] (table_1): primitive 0 of its geometry: every size must be above 0 and below 10000 m",
        ),
        (
            changed("/receptacles/0/room", json!("attic")),
            "receptacles[0] (table_1): its room \"attic\" is not a room of the scene",
        ),
        (
            changed("/receptacles/0/surface_max", json!([0.5, 2, 0.75])),
            "receptacles[0] (table_1): its minimum [1.0, 1.0, 0.7] is not below its maximum [0.5, 2.0, 0.75]",
        ),
        (
            changed("/rooms/0/max", json!([3, -1])),
            "rooms[0] (hall): its minimum [0.0, 0.0] is not below its maximum [3.0, -1.0]",
        ),
    ] {
        assert_eq!(problem(&scene), format!("scene.json: {expected}"));
    }
    let infinite = small().to_string().replace("0.75", "1e999");
    assert_eq!(
        reel_tasks::scene::parse(&infinite, "scene.json")
            .unwrap_err()
            .to_string(),
        "scene.json:1: number out of range"
    );
}

#[test]
fn furniture_outside_its_room_is_a_warning() {
    let scene = changed("/receptacles/0/surface_max", json!([3.5, 2, 0.75]));
    let loaded = reel_tasks::scene::parse(&scene.to_string(), "scene.json").unwrap();
    assert_eq!(loaded.warnings, ["table_1 reaches out of its room hall"]);
    assert_eq!(loaded.scene.receptacles[0].door, Door::None);
}

/// A chest with two drawers, and what is wrong with the second where it is `changed`.
fn with_drawers(change: impl Fn(&mut Value, &mut Value)) -> Value {
    let mut scene = small();
    let table = scene["receptacles"][0].clone();
    let part = |id: &str, below: f64| {
        let mut part = table.clone();
        part["id"] = json!(id);
        part["part_of"] = table["id"].clone();
        part["door"] = json!("drawer");
        for corner in ["surface_min", "surface_max"] {
            part[corner][2] = json!(table[corner][2].as_f64().unwrap() - below);
        }
        part
    };
    let (lower, mut upper) = (part("lower", 0.4), part("upper", 0.2));
    change(&mut scene["receptacles"][0], &mut upper);
    for part in [lower, upper] {
        scene["receptacles"].as_array_mut().unwrap().push(part);
    }
    scene
}

#[test]
fn parts_lie_in_furniture_that_takes_them_and_not_in_each_other() {
    let whole = with_drawers(|_, _| {});
    assert!(schema().is_valid(&whole));
    assert!(reel_tasks::scene::parse(&whole.to_string(), "scene.json").is_ok());
    type Change = fn(&mut Value, &mut Value);
    let cases: [(Change, &str); 6] = [
        (
            |_, part| part["surface_max"][2] = json!(0.36),
            "lies in upper: one part is at least 0.06 m above another",
        ),
        (
            |_, part| part["surface_max"][2] = json!(5.0),
            "but not 0.06 m below its surface",
        ),
        (
            |_, part| part["surface_max"][0] = json!(9.0),
            "its surface reaches out of that one's",
        ),
        (
            |whole, _| whole["category"] = json!("microwave"),
            "a microwave is not built with parts: give both geometry",
        ),
        (
            |whole, _| whole["door"] = json!("left"),
            "give the door to the parts",
        ),
        (
            |whole, _| {
                whole["geometry"] = json!({
                    "fixed": [{"shape": {"sphere": {"radius": 0.1}}, "position": [0, 0, 0]}]
                });
            },
            "give geometry to both of them or to neither",
        ),
    ];
    for (change, expected) in cases {
        let said = problem(&with_drawers(change));
        assert!(said.contains(expected), "{said}");
    }
}
