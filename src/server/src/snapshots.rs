//! Snapshots of the moments that people look at, so that the next one is near. A folder that may be
//! deleted at any time.

use std::{
    fs,
    path::PathBuf,
    sync::atomic::{AtomicUsize, Ordering},
};

use reel_replay::SnapshotCache;

/// Snapshots that are kept, of some 150 KB each.
const KEPT: usize = 400;
/// Looks between two tidyings.
const TIDY_EVERY: usize = 32;

/// The snapshots of a service.
#[derive(Debug)]
pub(crate) struct SnapshotFolder {
    folder: PathBuf,
    cache: SnapshotCache,
    looks: AtomicUsize,
}

impl SnapshotFolder {
    /// Snapshots in a folder, which is made when the first one comes.
    pub fn at(folder: PathBuf) -> Self {
        Self {
            cache: SnapshotCache::at(&folder),
            folder,
            looks: AtomicUsize::new(0),
        }
    }

    /// For one more look. Now and then the oldest snapshots go.
    pub fn cache(&self) -> &SnapshotCache {
        if self
            .looks
            .fetch_add(1, Ordering::Relaxed)
            .is_multiple_of(TIDY_EVERY)
        {
            self.tidy();
        }
        &self.cache
    }

    fn tidy(&self) {
        let entries = fs::read_dir(&self.folder).into_iter().flatten().flatten();
        let mut files: Vec<_> = entries
            .filter_map(|entry| Some((entry.metadata().ok()?.modified().ok()?, entry.path())))
            .collect();
        files.sort();
        let spare = files.len().saturating_sub(KEPT);
        // One that somebody else has removed, or that is in use, does no harm.
        files
            .iter()
            .take(spare)
            .for_each(|(_, path)| drop(fs::remove_file(path)));
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, SystemTime};

    use super::*;

    #[test]
    fn the_oldest_go() {
        let folder = tempfile::tempdir().unwrap();
        let moments = SnapshotFolder::at(folder.path().to_owned());
        for number in 0..KEPT + 5 {
            let file = fs::File::create(folder.path().join(format!("{number}.snapshot"))).unwrap();
            file.set_modified(SystemTime::UNIX_EPOCH + Duration::from_secs(number as u64))
                .unwrap();
        }
        moments.cache();
        let left = |number: usize| folder.path().join(format!("{number}.snapshot")).exists();
        assert_eq!(
            (
                left(4),
                left(5),
                fs::read_dir(folder.path()).unwrap().count()
            ),
            (false, true, KEPT)
        );
    }
}
