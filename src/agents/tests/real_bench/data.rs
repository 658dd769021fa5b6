//! The published scene and tasks, from `REEL_REAL_BENCH` or beside the repository.

use std::sync::Arc;

use reel_world::{Scene, Task};

/// The published scene and tasks, if they are there; else it says that it skips.
pub fn real_bench() -> Option<(Arc<Scene>, Vec<Arc<Task>>)> {
    let path = reel_vectors::real_bench()?;
    let scene = reel_tasks::scene::load(&path.join("s7_scene.json"))
        .unwrap()
        .scene;
    let tasks: Vec<_> = reel_tasks::load(&path.join("tasks"), &scene)
        .tasks
        .into_iter()
        .map(Arc::new)
        .collect();
    assert_eq!(tasks.len(), 180);
    Some((Arc::new(scene), tasks))
}
