//! Episodes played in the home, and spoilt ones.

use std::{
    fs,
    path::{Path, PathBuf},
};

use reel_trace::{Images, Trace};

use crate::episodes::{record, record_seeded, tasks, write};

/// One task of each family, played and recorded.
pub fn play(folder: &Path, name: &str, images: Images) -> Vec<PathBuf> {
    fs::create_dir_all(folder).unwrap();
    let path = |index: usize| folder.join(format!("{name}-{index}.mcap"));
    tasks()
        .iter()
        .enumerate()
        .map(|(index, task)| record(&path(index), task, name, images))
        .collect()
}

/// Traces that must not be trained on.
pub struct Played {
    /// Its chain holds, but it is not what the simulator gives.
    pub diverging: PathBuf,
    /// A trace in which the test flips a byte after ingesting it.
    pub changed: PathBuf,
    /// To be recorded anew.
    pub renewed: PathBuf,
    /// A trace that the test deletes after ingesting it.
    pub gone: PathBuf,
}

impl Played {
    /// Four more episodes, of which one was forged.
    pub fn spoilt(folder: &Path) -> Self {
        let path = |name: &str| folder.join(format!("{name}.mcap"));
        let [diverging, changed, renewed, gone] =
            ["diverging", "changed", "renewed", "gone"].map(path);
        let task = &tasks()[0];
        for (seed, path) in [
            (11, &changed),
            (12, &gone),
            (13, &diverging),
            (14, &renewed),
        ] {
            record_seeded(path, task, "oracle", seed, Images::None);
        }
        let mut trace = Trace::read(&diverging).unwrap();
        trace.steps[1].outcome.text.push_str(" And more.");
        fs::remove_file(&diverging).unwrap();
        write(&diverging, &trace);
        Self {
            diverging,
            changed,
            renewed,
            gone,
        }
    }
}
