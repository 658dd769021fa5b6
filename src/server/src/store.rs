//! The store of tables, opened once and again when somebody has written: opening reads the log of
//! every table, which takes longer than most questions of a page. With it go the answers that hold
//! until then: pages ask the same of the same tables, each time one is opened.

use std::{
    collections::BTreeMap,
    sync::{Mutex, PoisonError},
};

use axum::body::Bytes;
use reel_replay::{FileVerdict, SIM_VERSION};
use reel_tables::{Stamp, Store, StoreError, TraceVerdict};
use reel_trace::TraceFiles;

/// Longest answer that is kept, in bytes.
pub(crate) const ANSWER_MAX: usize = 1 << 20;
/// All answers that are kept, in bytes; beyond that they are forgotten.
const ANSWERS_MAX: usize = 64 << 20;

/// The store of tables.
pub(crate) struct Tables {
    location: String,
    trace_files: TraceFiles,
    opened: Mutex<Option<Opened>>,
}

/// A version that nobody wrote to since.
struct Opened {
    store: Store,
    stamp: Stamp,
    answers: BTreeMap<String, Bytes>,
    bytes: usize,
}

/// A version for one question.
pub(crate) struct Newest {
    pub store: Store,
    /// None: somebody is writing.
    pub stamp: Option<Stamp>,
}

impl Tables {
    /// The store at a location, which need not be there yet.
    pub fn new(location: String, trace_files: TraceFiles) -> Self {
        Self {
            location,
            trace_files,
            opened: Mutex::default(),
        }
    }

    /// The newest version, for one question: one that does not end holds nobody else up.
    pub fn newest(&self) -> Result<Newest, StoreError> {
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(Opened { store, stamp, .. }) = opened.as_ref()
            && store.stamp()?.as_ref() == Some(stamp)
        {
            return Ok(Newest {
                store: store.reopen()?,
                stamp: Some(stamp.clone()),
            });
        }
        // What is in the way of the new one may not bring the old one back.
        *opened = None;
        let store = Store::open(&self.location)?.with_trace_files(self.trace_files.clone());
        let asked = Newest {
            store: store.reopen()?,
            stamp: store.stamp()?,
        };
        *opened = asked.stamp.clone().map(|stamp| Opened {
            store,
            stamp,
            answers: BTreeMap::new(),
            bytes: 0,
        });
        Ok(asked)
    }

    /// What tells the newest version from others; none while somebody is writing.
    pub fn stamp(&self) -> Result<Option<Stamp>, StoreError> {
        {
            let opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some(Opened { store, stamp, .. }) = opened.as_ref()
                && store.stamp()?.as_ref() == Some(stamp)
            {
                return Ok(Some(stamp.clone()));
            }
        }
        Ok(self.newest()?.stamp)
    }

    /// The answer that was given to the same question over the same version.
    pub fn cached_answer(&self, stamp: Option<&Stamp>, question: &str) -> Option<Bytes> {
        let opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        let opened = opened
            .as_ref()
            .filter(|opened| stamp == Some(&opened.stamp))?;
        opened.answers.get(question).cloned()
    }

    /// Keeps an answer for as long as nobody writes.
    pub fn cache_answer(&self, stamp: Option<&Stamp>, question: String, answer: Bytes) {
        let mut opened = self.opened.lock().unwrap_or_else(PoisonError::into_inner);
        let opened = opened
            .as_mut()
            .filter(|opened| stamp == Some(&opened.stamp) && answer.len() <= ANSWER_MAX);
        let Some(opened) = opened else { return };
        if opened.bytes + question.len() + answer.len() > ANSWERS_MAX {
            opened.answers.clear();
            opened.bytes = 0;
        }
        opened.bytes += question.len() + answer.len();
        opened.answers.insert(question, answer);
    }

    /// Keeps what a replay found, as far as it holds as long as the file does and there are tables.
    pub fn keep(&self, judged: &FileVerdict) {
        let (true, Some(file)) = (judged.is_lasting(), judged.file) else {
            return;
        };
        let verdict = TraceVerdict::new(
            file,
            judged.trace,
            SIM_VERSION,
            judged.verdict.name().to_owned(),
            judged.verdict.to_string(),
        );
        let kept = self
            .newest()
            .and_then(|newest| newest.store.append_new_verdicts(&[verdict]));
        // Whoever asked for the verdict has it all the same.
        if let Err(error) = kept {
            tracing::info!(%error, "a verdict was not kept in the tables");
        }
    }

    /// Opens the store as it was at an earlier version of the tables.
    pub fn at(&self, version: u64) -> Result<Store, StoreError> {
        Ok(Store::open_at(&self.location, version)?.with_trace_files(self.trace_files.clone()))
    }
}

impl Drop for Tables {
    /// A store has a runtime of its own, which may not end on a thread of another one.
    fn drop(&mut self) {
        let opened = self
            .opened
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        let _ = std::thread::spawn(move || drop(opened)).join();
    }
}

#[cfg(test)]
mod tests {
    use std::{path::Path, sync::Arc};

    use reel_tables::{Store, synthesize};
    use reel_tasks::{DrawOptions, draw, home_scene};
    use reel_trace::TraceFiles;
    use reel_world::Family;

    use super::Tables;

    fn fill(place: &Path, seed: u64) {
        let scene = home_scene();
        let tasks = draw(&DrawOptions {
            scene: &scene,
            families: &Family::ALL,
            count: 4,
            seed: 7,
        })
        .tasks;
        let tasks: Vec<_> = tasks.into_iter().map(Arc::new).collect();
        synthesize(
            &mut Store::open_or_create(place).unwrap(),
            &tasks,
            &scene,
            10,
            seed,
            |_| (),
        )
        .unwrap();
    }

    #[test]
    fn what_was_written_meanwhile_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        let place = folder.path().join("store");
        let tables = Tables::new(place.display().to_string(), TraceFiles::default());
        assert!(tables.newest().is_err());
        fill(&place, 1);
        let before = tables.newest().unwrap().store;
        assert_eq!(tables.newest().unwrap().store.version(), before.version());
        Store::open(&place).unwrap().compact().unwrap();
        fill(&place, 2);
        let after = tables.newest().unwrap().store;
        assert!(after.version() > before.version());
        // Answers hold until then.
        let newest = tables.newest().unwrap();
        tables.cache_answer(newest.stamp.as_ref(), "how many".into(), "20".into());
        assert_eq!(
            tables
                .cached_answer(tables.stamp().unwrap().as_ref(), "how many")
                .as_deref(),
            Some(&b"20"[..])
        );
        assert_eq!(
            tables.cached_answer(newest.stamp.as_ref(), "how much"),
            None
        );
        tables.cache_answer(None, "who".into(), "nobody".into());
        tables.cache_answer(
            newest.stamp.as_ref(),
            "all".into(),
            vec![b' '; super::ANSWER_MAX + 1].into(),
        );
        assert_eq!(
            ["who", "all"].map(|question| tables.cached_answer(newest.stamp.as_ref(), question)),
            [None, None]
        );
        // Another store in the same place, with as many commits.
        std::fs::remove_dir_all(&place).unwrap();
        assert!(tables.newest().is_err());
        fill(&place, 3);
        assert_eq!(
            tables.cached_answer(tables.stamp().unwrap().as_ref(), "how many"),
            None
        );
        assert_eq!(tables.newest().unwrap().store.version(), before.version());
        assert_ne!(tables.newest().unwrap().stamp, None);
        // A question that hangs holds up no other.
        assert!(!Arc::ptr_eq(
            &tables.newest().unwrap().store.runtime(),
            &tables.newest().unwrap().store.runtime()
        ));
        // A server drops it while its own runtime runs.
        tokio::runtime::Runtime::new()
            .unwrap()
            .block_on(async { drop(tables) });
    }
}
