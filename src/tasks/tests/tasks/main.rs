//! The crate from outside: published tasks, fixtures of our own, scenes, the generator.

mod published;

use std::{collections::BTreeMap, path::PathBuf};

use reel_tasks::{Oddity, OddityKind};

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

fn count_by_kind(oddities: &[Oddity]) -> BTreeMap<OddityKind, usize> {
    let mut counts = BTreeMap::new();
    for oddity in oddities {
        *counts.entry(oddity.kind).or_default() += 1;
    }
    counts
}
