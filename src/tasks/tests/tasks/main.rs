//! The crate from outside: published tasks, fixtures of our own, scenes, the generator.

mod checkout;
mod draw;
mod fixtures;
mod lookup;
mod published;
mod real_contract;
mod scenes;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use reel_tasks::{TaskWarning, TaskWarningKind};
use reel_vectors::real_bench;
use reel_world::Scene;

/// Files of our own.
fn data(path: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data")).join(path)
}

/// The scene of the fixtures: the home with a pot, its lid, and a sink of unknown extent.
fn fixture_scene() -> Scene {
    reel_tasks::scene::load(&data("scene.json")).unwrap().scene
}

fn count_by_kind(deviations: &[TaskWarning]) -> BTreeMap<TaskWarningKind, usize> {
    let mut counts = BTreeMap::new();
    for deviation in deviations {
        *counts.entry(deviation.kind).or_default() += 1;
    }
    counts
}
