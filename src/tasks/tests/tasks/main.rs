//! The crate from outside: published tasks, fixtures of our own, scenes, the generator.

mod fixtures;
mod generator;
mod published;
mod scenes;

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use reel_tasks::{Oddity, OddityKind};
use reel_world::Scene;

/// The published data, if it is there.
fn real_bench() -> Option<PathBuf> {
    let beside = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/real-bench"));
    let path = std::env::var_os("REEL_REAL_BENCH").map_or_else(beside, PathBuf::from);
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("skipped: no REAL-Bench data at {} (set REEL_REAL_BENCH)", path.display());
    None
}

/// Files of our own.
fn data(path: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data")).join(path)
}

/// The scene of the fixtures: the home with a pot, its lid, and a sink of unknown extent.
fn fixture_scene() -> Scene {
    reel_tasks::scene::load(&data("scene.json")).unwrap().scene
}

fn count_by_kind(oddities: &[Oddity]) -> BTreeMap<OddityKind, usize> {
    let mut counts = BTreeMap::new();
    for oddity in oddities {
        *counts.entry(oddity.kind).or_default() += 1;
    }
    counts
}
