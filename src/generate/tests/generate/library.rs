//! The large object library.

use std::collections::{BTreeMap, BTreeSet};

use reel_generate::{
    objects::{homes, objects},
    scene::{built_in, names},
};

#[test]
fn there_are_enough_objects_and_every_caption_is_one_objects_own() {
    let distinct = |of: fn(&reel_generate::objects::Object) -> String| objects().iter().map(of).collect::<BTreeSet<_>>().len();
    let categories = distinct(|object| object.category.to_owned());
    assert!(objects().len() >= 600 && categories >= 120, "{} objects in {categories} categories", objects().len());
    assert_eq!(distinct(|object| object.asset.to_string()), objects().len());
    assert_eq!(distinct(|object| object.caption.to_lowercase()), objects().len());
}

#[test]
fn a_caption_says_one_colour_no_other_of_the_category_has_and_a_size_that_is_true() {
    let mut seen = BTreeSet::new();
    for object in objects() {
        let [colour] = object.attributes["colour"].as_slice() else { panic!("one colour: {}", object.caption) };
        assert!(seen.insert((object.category, colour.clone())), "{colour} twice: {}", object.caption);
        let size = object.attributes.get("size").map_or("", |words| words[0].as_str());
        let first = objects().iter().find(|other| other.category == object.category).unwrap();
        let larger = object.size.iter().sum::<f64>() - first.size.iter().sum::<f64>();
        let told = if larger > 1e-9 {
            "large"
        } else if larger < -1e-9 {
            "small"
        } else {
            ""
        };
        assert_eq!(size, told, "{}", object.caption);
    }
}

#[test]
fn the_small_library_is_part_of_it() {
    let all: BTreeMap<_, _> = objects().iter().map(|object| (&object.asset, object)).collect();
    for small in reel_tasks::library::objects() {
        let large = all[&small.asset];
        assert_eq!((&small.caption, small.size, &small.attributes), (&large.caption, large.size, &large.attributes));
    }
}

#[test]
fn everything_fits_a_surface_and_has_a_home_in_every_scene() {
    for object in objects() {
        let [width, depth, height] = object.size;
        assert!((0.01..0.4).contains(&width) && (0.01..0.3).contains(&depth) && (0.02..0.3).contains(&height), "{object:?}");
        assert!(homes().contains_key(object.purpose), "{}", object.purpose);
    }
    let mut categories: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for object in objects() {
        categories.entry(object.purpose).or_default().insert(object.category);
    }
    assert!(categories.values().all(|of| of.len() >= 3), "{categories:?}");
    for name in names() {
        let scene = built_in(name).unwrap();
        let pieces =
            |purpose: &str| scene.receptacles.iter().filter(|piece| homes()[purpose].holds(&piece.room, &piece.category)).count();
        let homeless: Vec<&&str> = categories.keys().filter(|purpose| pieces(purpose) == 0).collect();
        assert!(homeless.len() <= 2, "{name}: {homeless:?}");
        // And every receptacle has something to hold.
        let empty = scene.receptacles.iter().find(|piece| !homes().values().any(|home| home.holds(&piece.room, &piece.category)));
        assert_eq!(empty.map(|piece| &piece.id), None, "{name}");
    }
}
