//! The seven scenes: their counts are those of the paper, they pass the check, and their
//! plans can be read.

use std::collections::BTreeSet;

use reel_tasks::generate::scene::{Plan, built_in, check, names, receptacle_views};
use reel_world::Scene;

/// The paper's table of training scenes, then what it says of the scene to be evaluated in: kinds
/// of rooms, kinds of furniture, receptacles, captions.
const TABLE: [(&str, &str, &str, usize, usize); 7] = [
    (
        "S1",
        "balcony, bedroom, dining room, kitchen, living room, study room, toilet",
        "bed, cabinet, chest of drawers, desk, microwave, nightstand, refrigerator, shoe cabinet, table, tea table",
        17,
        32,
    ),
    (
        "S2",
        "balcony, bedroom, dining room, entry, kitchen, living room",
        "bed, cabinet, couch, desk, fridge, microwave, table",
        17,
        29,
    ),
    (
        "S3",
        "balcony, bedroom, dining room, kitchen, living room",
        "bed, couch, desk, microwave, refrigerator, table, tv stand",
        12,
        21,
    ),
    (
        "S4",
        "bathroom, bedroom, corridor, dining room, kitchen, living room",
        "bed, cabinet, couch, desk, microwave, refrigerator, table",
        12,
        24,
    ),
    (
        "S5",
        "bedroom, dining room, kitchen, living room, toilet",
        "bed, cabinet, couch, counter, desk, microwave, refrigerator, table",
        14,
        32,
    ),
    (
        "S6",
        "bedroom, dining room, kitchen, living room, toilet",
        "bed, cabinet, refrigerator, sink, table, tv stand",
        10,
        19,
    ),
    (
        "S7",
        "bedroom, dining room, kitchen, living room, study room, washroom",
        "bed, cabinet, couch, counter, desk, electric cooker, nightstand, refrigerator, sink, table, tv stand, washing machine",
        18,
        18,
    ),
];

fn scene(name: &str) -> Scene {
    built_in(name).unwrap_or_else(|| panic!("{name} comes along"))
}

fn listed<'a>(words: impl Iterator<Item = &'a str>) -> String {
    words
        .collect::<BTreeSet<_>>()
        .into_iter()
        .collect::<Vec<_>>()
        .join(", ")
}

fn captions(scene: &Scene) -> usize {
    scene
        .receptacles
        .iter()
        .map(|piece| piece.captions.len())
        .sum()
}

#[test]
fn rooms_furniture_and_counts_are_those_of_the_paper() {
    assert_eq!(names().collect::<Vec<_>>(), TABLE.map(|row| row.0));
    for (name, rooms, kinds, receptacles, least_captions) in TABLE {
        let scene = scene(name);
        assert_eq!(scene.scene_id, name);
        assert_eq!(
            listed(
                scene
                    .rooms
                    .iter()
                    .filter_map(|room| room.name.split('/').next())
            ),
            rooms,
            "{name}"
        );
        assert_eq!(
            listed(
                scene
                    .receptacles
                    .iter()
                    .map(|piece| piece.category.as_str())
            ),
            kinds,
            "{name}"
        );
        assert_eq!(scene.receptacles.len(), receptacles, "{name}");
        assert!(
            captions(&scene) >= least_captions,
            "{name}: {} captions",
            captions(&scene)
        );
    }
    let training: Vec<Scene> = TABLE[..6].iter().map(|row| scene(row.0)).collect();
    assert_eq!(
        training
            .iter()
            .map(|scene| scene.receptacles.len())
            .sum::<usize>(),
        82
    );
    assert!(training.iter().map(captions).sum::<usize>() >= 157);
}

#[test]
fn all_pass_the_check() {
    for name in names() {
        assert_eq!(check(&scene(name)), [], "{name}");
    }
}

#[test]
fn every_receptacle_is_seen_and_no_label_of_a_plan_covers_another() {
    for name in names() {
        let scene = scene(name);
        let views = receptacle_views(&scene);
        assert!(views.iter().all(|view| view.frame.is_some()), "{name}");
        let plan = Plan::of(&scene);
        assert_eq!(plan.crossings(), 0, "{name}");
        let svg = plan.svg();
        assert!(
            scene
                .receptacles
                .iter()
                .all(|piece| svg.contains(&format!(">{}</text>", piece.id))),
            "{name}"
        );
        assert!(plan.png().unwrap().starts_with(b"\x89PNG"), "{name}");
    }
}

#[test]
fn they_are_what_the_schema_says() {
    let schema: serde_json::Value =
        serde_json::from_str(include_str!("../../../../schemas/scene.schema.json")).unwrap();
    let validator = jsonschema::validator_for(&schema).unwrap();
    for name in names() {
        let value = serde_json::to_value(scene(name)).unwrap();
        assert!(
            validator.is_valid(&value),
            "{name}: {:?}",
            validator
                .iter_errors(&value)
                .map(|e| e.to_string())
                .collect::<Vec<_>>()
        );
    }
}
