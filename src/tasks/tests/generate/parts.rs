//! The seven scenes with shelves and drawers: they are the plain ones and what the furniture takes,
//! they pass the check, and tasks from and into their parts pass the filters.

use std::{fs, path::Path, sync::Arc};

use reel_tasks::generate::scene::{
    built_in, check, names_with_parts, receptacle_views, with_parts,
};
use reel_world::Scene;

use crate::tasks::made;

/// The scene without its parts, and the scene as [`with_parts`] makes it.
fn fitted(name: &str) -> (Scene, Scene) {
    let plain = built_in(name.strip_suffix("-parts").unwrap()).unwrap();
    let fitted = Scene {
        scene_id: name.to_owned(),
        ..with_parts(&plain)
    };
    (plain, fitted)
}

/// With `REEL_BLESS=1` it writes them.
#[test]
fn they_are_the_plain_scenes_with_parts() {
    for name in names_with_parts() {
        let (plain, fitted) = fitted(name);
        if std::env::var_os("REEL_BLESS").is_some() {
            let file = format!("data/scenes/{name}.json");
            let text = serde_json::to_string_pretty(&fitted).unwrap();
            fs::write(
                Path::new(env!("CARGO_MANIFEST_DIR")).join(file),
                text + "\n",
            )
            .unwrap();
        } else {
            assert_eq!(built_in(name).unwrap(), fitted);
        }
        let (pieces, parts): (Vec<_>, Vec<_>) = fitted
            .receptacles
            .iter()
            .partition(|receptacle| receptacle.part_of.is_none());
        for (piece, plain) in pieces.iter().zip(&plain.receptacles) {
            assert_eq!(piece.id, plain.id, "{name}");
            assert_eq!(piece.surface_min, plain.surface_min, "{name}");
            let has_parts = parts
                .iter()
                .any(|part| part.part_of.as_ref() == Some(&piece.id));
            let top = |caption: &String| caption.starts_with("the top of the ");
            assert_eq!(piece.captions.keys().all(top), has_parts, "{}", piece.id);
        }
        assert_eq!(pieces.len(), plain.receptacles.len(), "{name}");
        assert!(parts.len() >= 4, "{name}: {}", parts.len());
        assert!(parts.iter().any(|part| part.door.exists()), "{name}");
    }
}

#[test]
fn they_pass_the_check_and_every_part_is_seen() {
    for name in names_with_parts() {
        let scene = built_in(name).unwrap();
        assert_eq!(check(&scene), [], "{name}");
        for (view, receptacle) in receptacle_views(&scene).iter().zip(&scene.receptacles) {
            assert!(view.frame.is_some(), "{name}: {}", receptacle.id);
        }
    }
}

#[test]
fn tasks_go_from_and_into_parts() {
    let scenes: Vec<Arc<Scene>> = names_with_parts()
        .map(|name| Arc::new(built_in(name).unwrap()))
        .collect();
    let made = made(&scenes, 126, 5, 2);
    assert_eq!(made.tasks.len(), 126, "{:?}", made.statistics);
    let ends_in_part = |source: bool| {
        let ends = made.tasks.iter().filter(|(scene, task)| {
            let end = if source { &task.src } else { &task.dest };
            let receptacle = scenes[*scene].receptacle(end).unwrap();
            receptacle.part_of.is_some()
        });
        ends.count()
    };
    let (from, into) = (ends_in_part(true), ends_in_part(false));
    println!("{from} of 126 tasks from a shelf, drawer or compartment, {into} into one");
    assert!(from >= 8 && into >= 16, "{from}, {into}");
}
