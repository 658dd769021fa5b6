//! The published scene and tasks, from `REEL_REAL_BENCH` or beside the repository.

use std::{path::PathBuf, sync::Arc};

use reel_world::{Scene, Task};

/// The published scene and tasks, if they are there; else it says that it skips.
pub fn real_bench() -> Option<(Arc<Scene>, Vec<Arc<Task>>)> {
    let beside = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/real-bench"));
    let path = std::env::var_os("REEL_REAL_BENCH").map_or_else(beside, PathBuf::from);
    if !path.is_dir() {
        eprintln!("skipped: no REAL-Bench data at {} (set REEL_REAL_BENCH)", path.display());
        return None;
    }
    let scene = reel_tasks::scene::load(&path.join("s7_scene.json")).unwrap().scene;
    let tasks: Vec<_> = reel_tasks::load(&path.join("tasks"), &scene).tasks.into_iter().map(Arc::new).collect();
    assert_eq!(tasks.len(), 180);
    Some((Arc::new(scene), tasks))
}
