//! Scenes by seed: of any size, fit to play in, and the same again for the same seed.

use reel_tasks::generate::scene::{Brief, SceneError, check, generate};
use reel_world::Scene;

fn made(rooms: usize, receptacles: usize, seed: u64) -> Scene {
    let brief = Brief::draw(rooms, receptacles, seed).unwrap();
    generate(&brief, "flat", seed).unwrap_or_else(|error| {
        panic!(
            "{error}; reel scene generate --seed {seed} --rooms {rooms} --receptacles {receptacles}"
        )
    })
}

#[test]
fn two_hundred_scenes_of_various_sizes_pass_the_check() {
    for seed in 0..200 {
        let rooms = 1 + seed as usize % 12;
        let receptacles = rooms + (seed as usize / 12) % (rooms + 1);
        let scene = made(rooms, receptacles, seed);
        assert_eq!(
            (scene.rooms.len(), scene.receptacles.len()),
            (rooms, receptacles),
            "seed {seed}"
        );
        // `generate` checks too; here that what was written is what was checked.
        let read =
            reel_tasks::scene::parse(&serde_json::to_string(&scene).unwrap(), "made").unwrap();
        assert_eq!(read.warnings, Vec::<String>::new(), "seed {seed}");
        assert_eq!(check(&read.scene), [], "seed {seed}");
        assert!(
            scene
                .receptacles
                .iter()
                .all(|piece| !piece.captions.is_empty()),
            "seed {seed}"
        );
        if seed % 10 == 0 {
            assert_eq!(made(rooms, receptacles, seed), scene, "seed {seed}");
        }
    }
}

#[test]
fn a_large_house_has_wings() {
    let scene = made(30, 70, 1);
    assert_eq!((scene.rooms.len(), scene.receptacles.len()), (30, 70));
    assert_eq!(check(&scene), []);
}

#[test]
fn a_scene_like_another_has_its_rooms_and_furniture_elsewhere() {
    let of = reel_tasks::generate::scene::built_in("S5").unwrap();
    let brief = Brief::of(&of);
    let scene = generate(&brief, "again", 3).unwrap();
    assert_eq!(Brief::of(&scene), brief);
    assert_ne!(scene.receptacles, of.receptacles);
}

#[test]
fn what_is_too_large_is_refused_with_the_limit() {
    assert_eq!(
        Brief::draw(0, 1, 0),
        Err(SceneError::Rooms { asked: 0, most: 60 })
    );
    let error = Brief::draw(2, 40, 0).unwrap_err();
    assert_eq!(
        error.to_string(),
        "a scene of 2 rooms has 1 to 10 receptacles, not 40"
    );
}
