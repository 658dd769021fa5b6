//! The store of tables, opened once and again when somebody has written: opening reads the log of every table, which takes longer
//! than most questions of a page.

use std::sync::{Mutex, PoisonError};

use reel_tables::{Stamp, Store, StoreError};

/// The store of tables.
pub(crate) struct Tables {
    location: String,
    opened: Mutex<Option<(Store, Stamp)>>,
}

impl Tables {
    /// The store at a location, which need not be there yet.
    pub fn new(location: String) -> Self {
        Self { location, opened: Mutex::default() }
    }

    /// The newest version, for one question: one that does not end holds nobody else up.
    pub fn newest(&self) -> Result<Store, StoreError> {
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((store, stamp)) = opened.as_ref()
            && store.stamp()?.as_ref() == Some(stamp)
        {
            return store.again();
        }
        // What is in the way of the new one may not bring the old one back.
        *opened = None;
        let store = Store::open(&self.location)?;
        let asked = store.again();
        *opened = store.stamp()?.map(|stamp| (store, stamp));
        asked
    }

    /// An earlier version.
    pub fn at(&self, version: u64) -> Result<Store, StoreError> {
        Store::open_at(&self.location, version)
    }
}

impl Drop for Tables {
    /// A store has a runtime of its own, which may not end on a thread of another one.
    fn drop(&mut self) {
        let opened = self.opened.get_mut().unwrap_or_else(PoisonError::into_inner).take();
        let _ = std::thread::spawn(move || drop(opened)).join();
    }
}

#[cfg(test)]
mod tests {
    use std::{path::Path, sync::Arc};

    use reel_tables::{Store, synthesize};
    use reel_tasks::{GenerateOptions, generate, home};
    use reel_world::Family;

    use super::Tables;

    fn fill(place: &Path, seed: u64) {
        let scene = home();
        let tasks = generate(&GenerateOptions { scene: &scene, families: &Family::ALL, count: 4, seed: 7 }).tasks;
        let tasks: Vec<_> = tasks.into_iter().map(Arc::new).collect();
        synthesize(&mut Store::open_or_create(place).unwrap(), &tasks, &scene, 10, seed, |_| ()).unwrap();
    }

    #[test]
    fn what_was_written_meanwhile_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("store");
        let tables = Tables::new(place.display().to_string());
        assert!(tables.newest().is_err());
        fill(&place, 1);
        let before = tables.newest().unwrap();
        assert_eq!(tables.newest().unwrap().version(), before.version());
        Store::open(&place).unwrap().compact().unwrap();
        fill(&place, 2);
        let after = tables.newest().unwrap();
        assert!(after.version() > before.version());
        // Another store in the same place, with as many commits.
        std::fs::remove_dir_all(&place).unwrap();
        assert!(tables.newest().is_err());
        fill(&place, 3);
        assert_eq!(tables.newest().unwrap().version(), before.version());
        assert_ne!(tables.newest().unwrap().stamp().unwrap(), None);
        // A question that hangs holds up no other.
        assert!(!Arc::ptr_eq(&tables.newest().unwrap().runtime(), &tables.newest().unwrap().runtime()));
        // A server drops it while its own runtime runs.
        tokio::runtime::Runtime::new().unwrap().block_on(async { drop(tables) });
    }
}
