//! Tests of scene and object models, on the reconstructed scene of REAL-Bench where it is at hand.

use std::collections::BTreeMap;

use reel_world::{Door, Room};
use serde_json::{Value, json};

use super::{parts::extent, *};
use crate::geometry::{Shape, add, sub};

/// Reads a file of the benchmark's data; `None` if there is no such data.
#[expect(
    clippy::disallowed_methods,
    reason = "tests look for outside data; the simulator itself reads nothing"
)]
fn real_data(name: &str) -> Option<Value> {
    let path = reel_vectors::real_bench()?.join(name);
    let bytes = std::fs::read(&path).expect("the benchmark has this file");
    Some(serde_json::from_slice(&bytes).expect("the file is JSON"))
}

fn real_scene() -> Option<Scene> {
    real_data("s7_scene.json")
        .map(|value| serde_json::from_value(value).expect("the file is a scene"))
}

/// One piece of each category in a room of its own.
fn showroom() -> Scene {
    let categories = reel_world::words! {
        refrigerator microwave shelf nightstand counter sofa dresser bookshelf stool bench tvstand
        oven table desk bed sink wardrobe armchair "thing of the future" dishwasher
    };
    let (mut rooms, mut receptacles) = (Vec::new(), Vec::new());
    for (index, category) in categories.into_iter().enumerate() {
        let x = index as f64 * 4.0;
        rooms
            .push(json!({"name": format!("room/{index}"), "min": [x, 0.0], "max": [x + 4.0, 4.0]}));
        let z = match category {
            "microwave" => 1.0,
            "refrigerator" => 0.6,
            _ => 0.5,
        };
        let door = matches!(
            category,
            "refrigerator" | "microwave" | "oven" | "wardrobe" | "dishwasher"
        );
        let door = if door && index % 2 == 0 {
            json!("right")
        } else {
            json!(door)
        };
        receptacles.push(json!({
            "id": format!("{category}_1"), "room": format!("room/{index}"), "category": category, "door": door,
            "surface_min": [x + 1.5, 1.7, z - 0.03], "surface_max": [x + 2.1, 2.2, z], "facing_deg": 90.0 * (index % 4) as f64,
        }));
    }
    serde_json::from_value(
        json!({"scene_id": "showroom", "rooms": rooms, "receptacles": receptacles}),
    )
    .expect("a scene")
}

/// Whether a point lies inside a part, at least `depth` deep.
fn holds(part: &Part, point: [f32; 3], depth: f32) -> bool {
    let inverse = Pose {
        position: [0.0; 3],
        rotation: part.pose.rotation.map(|c| -c),
    };
    let [x, y, z, w] = inverse.rotation;
    let inverse = Pose {
        rotation: [x, y, z, -w],
        ..inverse
    };
    let [x, y, z] = inverse.rotate(sub(point, part.pose.position)).map(f32::abs);
    let level = (x * x + y * y).sqrt();
    match part.shape {
        Shape::Cuboid { half } => x < half[0] - depth && y < half[1] - depth && z < half[2] - depth,
        Shape::Cylinder {
            radius,
            half_height,
        } => level < radius - depth && z < half_height - depth,
        other => panic!("furniture is not solid as {other:?}"),
    }
}

/// Sample points over a rectangle, its border included.
fn samples(surface: &Surface) -> Vec<[f32; 2]> {
    let at = |axis: usize, step: usize| {
        surface.min[axis] + (surface.max[axis] - surface.min[axis]) * step as f32 / 20.0
    };
    (0..=20)
        .flat_map(|i| (0..=20).map(move |j| [i, j]))
        .map(|[i, j]| [at(0, i), at(1, j)])
        .collect()
}

/// Every surface is flat at its height over its whole rectangle, and nothing solid stands in
/// the space above it.
fn check_surfaces(model: &SceneModel, skip: &[&str]) {
    for piece in model
        .furniture
        .iter()
        .filter(|piece| piece.present && !skip.contains(&piece.id.as_str()))
    {
        let others = model
            .furniture
            .iter()
            .filter(|other| other.present && other.id != piece.id)
            .flat_map(|other| &other.parts);
        let around: Vec<&Part> = others
            .chain(&model.shell)
            .chain(&piece.parts)
            .filter(|part| part.solid)
            .collect();
        let door = piece
            .door
            .iter()
            .flat_map(|door| door.parts_at(0.0))
            .filter(|part| part.solid)
            .collect::<Vec<Part>>();
        let top = piece.surface.z;
        for [x, y] in samples(&piece.surface) {
            let below = piece.parts.iter().filter(|part| part.solid).any(|part| {
                let top_of_part = part.pose.position[2] + extent(part)[2];
                (top_of_part - top).abs() < 1e-5
                    && holds(part, [x, y, part.pose.position[2]], -1e-4)
            });
            assert!(below, "{} has no solid top at {x}, {y}, {top}", piece.id);
            for step in 1..20 {
                let z =
                    top + 0.0002 + (piece.surface.clearance.min(0.6) - 0.001) * step as f32 / 20.0;
                for part in around.iter().copied().chain(&door) {
                    assert!(
                        !holds(part, [x, y, z], 1e-4),
                        "{}: {part:?} stands at {x}, {y}, {z}",
                        piece.id
                    );
                }
            }
        }
    }
}

#[test]
fn surfaces_of_the_real_scene_are_flat_and_free() {
    let Some(scene) = real_scene() else { return };
    let covered = scene_model(&scene, &BTreeSet::new());
    check_surfaces(&covered, &["pot_0"]);
    let cooking = scene_model(&scene, &BTreeSet::from(["pot_0".into()]));
    check_surfaces(&cooking, &[]);
    for (receptacle, piece) in scene.receptacles.iter().zip(&covered.furniture) {
        assert_eq!(
            piece.surface.z, receptacle.surface_max[2] as f32,
            "{}",
            piece.id
        );
        assert_eq!(
            piece.door.is_some(),
            receptacle.door.exists(),
            "{}",
            piece.id
        );
        let given = layout::rectangle(receptacle);
        let holds_it = (0..2).all(|axis| {
            piece.surface.min[axis] <= given[0][axis] && piece.surface.max[axis] >= given[1][axis]
        });
        assert!(holds_it, "{}", piece.id);
    }
}

#[test]
fn surfaces_of_any_category_are_flat_and_free() {
    check_surfaces(&scene_model(&showroom(), &BTreeSet::new()), &[]);
}

#[test]
fn furniture_stands_on_the_floor_and_inside_its_room() {
    let scenes = [Some(showroom()), real_scene()];
    for scene in scenes.into_iter().flatten() {
        let model = scene_model(&scene, &BTreeSet::new());
        for (receptacle, piece) in scene.receptacles.iter().zip(&model.furniture) {
            let lid = receptacle.category == "potlid";
            let lowest = piece
                .parts
                .iter()
                .filter(|part| part.solid)
                .map(|part| part.pose.position[2] - extent(part)[2]);
            let lowest = lowest.fold(f32::MAX, f32::min);
            assert!(
                lid || lowest.abs() < 1e-4,
                "{} starts at {lowest}",
                piece.id
            );
            let room = scene
                .rooms
                .iter()
                .find(|room| room.name == receptacle.room)
                .unwrap();
            let [low, high] = piece.bounds;
            for axis in 0..2 {
                let inside = low[axis] >= room.min[axis] as f32 + 0.05
                    && high[axis] <= room.max[axis] as f32 - 0.05;
                assert!(
                    inside,
                    "{}: {low:?} {high:?} leaves {}",
                    piece.id, room.name
                );
            }
        }
    }
}

#[test]
fn a_lid_is_taken_off_only_while_its_pot_alone_is_in_use() {
    let Some(scene) = real_scene() else { return };
    let present = |ids: &[&str]| {
        let in_use = ids.iter().map(|id| ReceptacleId::from(*id)).collect();
        let model = scene_model(&scene, &in_use);
        let lid = model
            .furniture
            .into_iter()
            .find(|piece| piece.id.as_str() == "potlid_0")
            .unwrap();
        assert_eq!(lid.present, !lid.parts.is_empty());
        lid.present
    };
    assert!(present(&[]));
    assert!(present(&["potlid_0"]));
    assert!(present(&["potlid_0", "pot_0"]));
    assert!(!present(&["pot_0", "table_1"]));
}

/// Length of the border that two rooms share, the longest stretch of it.
fn shared_border(a: &Room, b: &Room) -> f64 {
    let mut longest: f64 = 0.0;
    for (p, q) in a
        .footprint()
        .iter()
        .flat_map(|p| b.footprint().into_iter().map(move |q| (*p, q)))
    {
        for axis in 0..2 {
            if (p.max[axis] - q.min[axis]).abs() < 1e-6 || (q.max[axis] - p.min[axis]).abs() < 1e-6
            {
                let along = 1 - axis;
                longest =
                    longest.max(p.max[along].min(q.max[along]) - p.min[along].max(q.min[along]));
            }
        }
    }
    longest
}

#[test]
fn neighbouring_rooms_have_an_opening() {
    for scene in [Some(showroom()), real_scene()].into_iter().flatten() {
        let model = scene_model(&scene, &BTreeSet::new());
        let blocked = |point: [f32; 2]| {
            model
                .shell
                .iter()
                .any(|part| part.solid && holds(part, [point[0], point[1], 1.0], -0.2))
        };
        for (index, a) in scene.rooms.iter().enumerate() {
            for b in scene
                .rooms
                .iter()
                .skip(index + 1)
                .filter(|b| shared_border(a, b) >= 1.0 - 1e-6)
            {
                let mut free = 0;
                for (p, q) in a
                    .footprint()
                    .iter()
                    .flat_map(|p| b.footprint().into_iter().map(move |q| (*p, q)))
                {
                    for axis in 0..2 {
                        let along = 1 - axis;
                        let (from, to) = (
                            p.min[along].max(q.min[along]),
                            p.max[along].min(q.max[along]),
                        );
                        let borders = [(p.max[axis], q.min[axis]), (p.min[axis], q.max[axis])];
                        for (at, _) in borders
                            .into_iter()
                            .filter(|(mine, theirs)| (mine - theirs).abs() < 1e-6)
                        {
                            let mut point = [at as f32; 2];
                            for step in 0..200 {
                                let offset = from + f64::from(step) * 0.05;
                                point[along] = offset as f32;
                                free += usize::from(offset < to && !blocked(point));
                            }
                        }
                    }
                }
                // One metre less twice the radius of the robot.
                assert!(
                    free >= 10,
                    "only {free} free points between {} and {}",
                    a.name,
                    b.name
                );
            }
        }
        // All around it is closed.
        for wall in &model.walls {
            let middle = [0, 1].map(|axis| ((wall.from[axis] + wall.to[axis]) * 0.5) as f32);
            assert!(blocked(middle));
        }
        let y = (scene.rooms[0].min[1] + scene.rooms[0].max[1]) as f32 * 0.5;
        assert!(
            blocked([model.bounds[0][0], y]),
            "the scene is open at its border"
        );
    }
}

#[test]
fn doors_open_outwards_and_clear_the_front() {
    let scene = showroom();
    let model = scene_model(&scene, &BTreeSet::new());
    let mut sides = BTreeSet::new();
    for (receptacle, piece) in scene.receptacles.iter().zip(&model.furniture) {
        let Some(door) = &piece.door else { continue };
        sides.insert(door.motion.open_position() > 0.0);
        assert_eq!(
            receptacle.door == Door::Right,
            door.motion.open_position() > 0.0
        );
        let open = door.opened(1.0);
        let middle = [0, 1].map(|axis| (piece.surface.min[axis] + piece.surface.max[axis]) * 0.5);
        let ahead = |point: [f32; 3]| {
            (point[0] - middle[0]) * piece.facing[0] + (point[1] - middle[1]) * piece.facing[1]
        };
        let panel = door.parts[0];
        let [closed_at, open_at] = [door.closed, open].map(|pose| pose.apply(panel.pose.position));
        assert!(
            ahead(open_at) > ahead(closed_at) + 0.2,
            "{} opens inwards",
            piece.id
        );
        // Seen from the front, a left hinge is to the left.
        let left = [piece.facing[1], -piece.facing[0]];
        let aside = sub(door.closed.position, [middle[0], middle[1], 0.0]);
        assert_eq!(
            aside[0] * left[0] + aside[1] * left[1] > 0.0,
            receptacle.door == Door::Left,
            "{}",
            piece.id
        );
        // The open panel leaves the way to every point of the interior free.
        let panel = Part {
            pose: open.then(&panel.pose),
            ..panel
        };
        for [x, y] in samples(&piece.surface) {
            for step in 0..40 {
                let out = step as f32 * 0.02;
                let point = [
                    x + piece.facing[0] * out,
                    y + piece.facing[1] * out,
                    piece.surface.z + 0.1,
                ];
                assert!(
                    !holds(&panel, point, 1e-4),
                    "the open door of {} stands in the way",
                    piece.id
                );
            }
        }
    }
    assert_eq!(sides.len(), 2);
}

#[test]
fn looks_follow_captions() {
    let Some(scene) = real_scene() else { return };
    let model = scene_model(&scene, &BTreeSet::new());
    let looks = |id: &str| -> BTreeSet<([u8; 3], bool)> {
        let piece = model
            .furniture
            .iter()
            .find(|piece| piece.id.as_str() == id)
            .unwrap();
        piece
            .parts
            .iter()
            .map(|part| (part.color, part.solid))
            .collect()
    };
    for [a, b] in [
        ["desk_1", "desk_2"],
        ["bed_1", "bed_2"],
        ["table_1", "table_2"],
        ["sink_0", "sink_1"],
        ["cabinet_8", "cabinet_10"],
    ] {
        assert_ne!(looks(a), looks(b), "{a} looks like {b}");
    }
    let brightness = |color: [u8; 3]| color.iter().map(|c| u32::from(*c)).sum::<u32>();
    let has =
        |id: &str, test: &dyn Fn([u8; 3]) -> bool| looks(id).iter().any(|(color, _)| test(*color));
    assert!(
        has("desk_1", &|c| c[0] > 200 && c[2] < 60),
        "orange drawer pulls"
    );
    assert!(has("desk_2", &|c| brightness(c) < 120), "black handle");
    assert!(has("bed_1", &|c| brightness(c) > 690), "white bedding");
    assert!(has("bed_2", &|c| brightness(c) < 120), "dark bedding");
    assert!(
        has("cabinet_8", &|[r, g, b]| g > r && g > b && g > 100),
        "green cabinet"
    );
    assert!(
        has("cabinet_6", &|c| c[0] > 220 && c[2] < 60),
        "orange inner backing"
    );
}

#[test]
fn equal_scenes_give_equal_models() {
    for scene in [Some(showroom()), real_scene()].into_iter().flatten() {
        let copy: Scene = serde_json::from_value(serde_json::to_value(&scene).unwrap()).unwrap();
        assert_eq!(
            scene_model(&scene, &BTreeSet::new()),
            scene_model(&copy, &BTreeSet::new())
        );
    }
}

fn object(
    id: &str,
    category: &str,
    caption: Option<&str>,
    attributes: Value,
    size: [f64; 3],
) -> ObjectInstance {
    let attributes: BTreeMap<String, Vec<String>> =
        serde_json::from_value(attributes).expect("attribute words");
    ObjectInstance {
        instance: format!("{id}_on_table_1_at_test").into(),
        asset: id.into(),
        category: category.to_owned(),
        caption: caption.map(str::to_owned),
        attributes,
        size,
        position: [0.0; 3],
        yaw: 0.0,
        receptacle: "table_1".into(),
        reference_rest: None,
    }
}

/// The solid parts stay in the box, stand on its bottom with a base, and have a sane volume.
fn check_object(object: &ObjectInstance) {
    let model = object_model(object);
    let what = format!("{} ({}, {:?})", object.asset, object.category, object.size);
    let solid: Vec<&Part> = model.parts.iter().filter(|part| part.solid).collect();
    assert!(!solid.is_empty(), "{what} has no collider");
    let mut lowest = f32::MAX;
    for part in &solid {
        let (half, center) = (extent(part), part.pose.position);
        for axis in 0..3 {
            let reach = center[axis].abs() + half[axis];
            assert!(
                reach <= model.half[axis] + 1e-5,
                "{what}: {part:?} leaves {:?}",
                model.half
            );
            assert!(half[axis] >= 0.0004, "{what}: {part:?} is too thin");
        }
        assert!(
            !matches!(part.shape, Shape::Cone { .. }),
            "{what}: cones are never solid"
        );
        lowest = lowest.min(center[2] - half[2]);
    }
    assert!(
        (lowest + model.half[2]).abs() < 1e-5,
        "{what} starts at {lowest} instead of {}",
        -model.half[2]
    );
    assert!((200.0..=1000.0).contains(&model.density), "{what}");
    for (part, index) in model.parts.iter().zip(0..) {
        let far = add(part.pose.position.map(f32::abs), extent(part));
        let most = model
            .half
            .iter()
            .fold(0.0_f32, |most, half| most.max(*half));
        assert!(
            far.iter().all(|reach| *reach <= most * 1.5 + 0.01),
            "{what}: look {index} is far off: {part:?}"
        );
    }
    // What lies on one round part alone would roll away; balls are damped.
    let rolls = solid
        .iter()
        .all(|part| matches!(part.shape, Shape::Capsule { .. }));
    assert!(!rolls, "{what} rolls");
    assert_eq!(model, object_model(object), "{what}");
}

#[test]
fn real_objects_stay_in_their_boxes() {
    let Some(objects) = real_data("objects.json") else {
        return;
    };
    let mut checked = 0;
    for row in objects.as_array().expect("a list") {
        let size: [f64; 3] = serde_json::from_value(row["size"].clone()).expect("three numbers");
        if size.iter().all(|side| *side > 0.0) {
            let (id, category) = (
                row["id"].as_str().unwrap(),
                row["category"].as_str().unwrap(),
            );
            check_object(&object(
                id,
                category,
                row["caption"].as_str(),
                row["attributes"].clone(),
                size,
            ));
            checked += 1;
        }
    }
    assert!(checked > 200, "only {checked} objects");
}

#[test]
fn any_category_and_size_stays_in_its_box() {
    let categories = reel_world::words! {
        apple "coffee mug" "frying pan" bottle "wine glass" spoons "teddy bear" laptop "alarm clock"
        hourglass banana headphones towel "paper towel" watch "coffee maker" broccoli tray
        "photo frame" soap "unheard of" vase
    };
    let sizes = [
        [0.1, 0.1, 0.1],
        [0.3, 0.05, 0.04],
        [0.05, 0.3, 0.04],
        [0.05, 0.06, 0.3],
        [0.2, 0.15, 0.001],
        [0.3, 0.02, 0.2],
        [0.004; 3],
    ];
    for category in categories {
        for size in sizes {
            check_object(&object(category, category, None, json!({}), size));
        }
    }
}

#[test]
fn objects_take_the_colours_that_are_said() {
    let main = |object: &ObjectInstance| object_model(object).parts[0].color;
    let size = [0.08, 0.08, 0.1];
    let red = object("a", "can", None, json!({"colour": ["red", "white"]}), size);
    let blue = object(
        "a",
        "can",
        Some("A blue can with white letters"),
        json!({}),
        size,
    );
    let [r, g, b] = main(&red);
    assert!(r > 150 && g < 80 && b < 80);
    let [r, _, b] = main(&blue);
    assert!(b > 150 && r < 80);
    // Attribute lists of the real data name white first, whatever its share.
    let listed = object(
        "a",
        "notebook",
        Some("notebook with a brown cover and white band"),
        json!({"colour": ["white", "brown"]}),
        size,
    );
    assert_eq!(main(&listed), [122, 78, 44]);
    let wooden = object("a", "box", None, json!({"material": ["wooden"]}), size);
    assert_eq!(
        object_model(&wooden).parts[0].pattern,
        crate::geometry::Pattern::Grain
    );
    let [r, g, b] = main(&object("x", "banana", None, json!({}), size));
    assert!(r > 200 && g > 150 && b < 120, "a banana is yellow");
}
