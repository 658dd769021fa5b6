//! Tasks and scenes that strangers could put into a trace: what no simulator could play is refused before it tries.

use std::sync::Arc;

use reel_episode::{EpisodeError, prepare_task};
use reel_world::{Meshes, ReceptacleId, Scene, Task};

/// What becomes of the home and a task in it, once they were changed.
fn refused(change: impl FnOnce(&mut Scene, &mut Task)) -> Option<String> {
    let (mut scene, mut task) = crate::home();
    change(&mut scene, &mut task);
    match prepare_task(&Arc::new(scene), &Arc::new(task), &Meshes::default()) {
        Ok(_) => None,
        Err(EpisodeError::Unplayable { problem, .. }) => Some(problem),
        Err(other) => panic!("{other}"),
    }
}

#[test]
fn what_nothing_was_done_to_is_played() {
    assert_eq!(refused(|_, _| ()), None);
}

#[test]
fn what_cannot_be_is_refused_and_named() {
    type Change = fn(&mut Scene, &mut Task);
    let changes: [(Change, &str); 10] = [
        (
            |_, task| task.objects.push(task.objects[0].clone()),
            "twice",
        ),
        (|_, task| task.objects.clear(), "no such number of it"),
        (|_, task| task.objects[0].position[2] = 1e9, "1e9 m far"),
        (|_, task| task.objects[0].size[0] = -1e300, "m far or large"),
        (
            |_, task| {
                let states = task.goal.receptacles.values_mut();
                let counts = states.flat_map(|state| state.content.values_mut());
                counts.for_each(|count| *count = u32::MAX);
            },
            "the goal has",
        ),
        (
            |scene, _| scene.receptacles.clear(),
            "no receptacle of the scene",
        ),
        (
            |scene, _| scene.receptacles.push(scene.receptacles[0].clone()),
            "twice",
        ),
        (
            |scene, _| {
                let id: ReceptacleId = scene.receptacles[0].id.clone();
                scene.receptacles[0].covers = Some(id);
            },
            "no other receptacle",
        ),
        (
            |scene, _| scene.receptacles[0].surface_max[0] = 1e9,
            "1e9 m",
        ),
        (
            |scene, _| {
                let rooms = scene.rooms.clone();
                scene.rooms = rooms.into_iter().cycle().take(1001).collect();
            },
            "1001 rooms, and 1000 is the most",
        ),
    ];
    for (change, expected) in changes {
        let problem = refused(change).expect(expected);
        assert!(problem.contains(expected), "{problem}, not {expected}");
    }
}
