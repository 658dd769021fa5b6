//! A folder of played episodes and of branches.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use reel_agents::RecordTo;
use reel_counterfactual::branch::Branch;
use reel_trace::{Images, Trace};
use reel_world::Task;
use tempfile::TempDir;

use crate::episodes::record;

/// A folder of traces.
pub struct Folder {
    folder: TempDir,
    count: AtomicUsize,
}

impl Folder {
    pub fn new() -> Self {
        Self {
            folder: tempfile::tempdir().unwrap(),
            count: AtomicUsize::new(0),
        }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A name that nobody has.
    pub fn next(&self) -> PathBuf {
        self.path(&format!(
            "{}.mcap",
            self.count.fetch_add(1, Ordering::Relaxed)
        ))
    }

    /// Plays a task and records it.
    pub fn play(&self, task: &Arc<Task>, name: &str, images: Images) -> Trace {
        Trace::read(&record(&self.next(), task, name, images)).unwrap()
    }

    /// Plays a branch and records it.
    pub fn branch(&self, branch: &Branch, parent: &Trace, at: usize, images: Images) -> Trace {
        let record = RecordTo {
            path: self.next(),
            options: images.into(),
        };
        branch.play_at(parent, at, Some(&record)).unwrap();
        Trace::read(&record.path).unwrap()
    }
}
