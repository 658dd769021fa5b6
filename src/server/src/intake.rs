//! Traces that come while the server runs go to the tables by themselves: episodes of sessions,
//! branches, uploads, and what others put into the folder.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use tokio::time::{Instant, sleep};

use crate::{
    jobs::{JobState, Work},
    service::App,
};

/// Shortest pause between two looks at the folder. A round that took longer is followed by a pause as
/// long as itself.
const PAUSE_MIN: Duration = Duration::from_secs(3);
/// Longest pause, also after an ingest that failed: it would fail again.
const PAUSE_MAX: Duration = Duration::from_secs(60);
/// More traces than this are not named one by one: an ingest of the whole folder passes over what it
/// knows.
const NAMED_MAX: usize = 200;

/// Size of a file in bytes, and when it was written: another file of the same name has others.
type FileStamp = (u64, u64);

/// Traces that the server has read into the tables since it started.
#[derive(Default)]
pub(crate) struct Intake(Mutex<BTreeMap<String, FileStamp>>);

impl Intake {
    /// Names of the traces that went through an ingest. Those of an episode that the tables have from
    /// another file are among them, and in no table.
    pub fn names(&self) -> BTreeSet<String> {
        self.lock().keys().cloned().collect()
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<String, FileStamp>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reads new traces in until the server closes.
pub(crate) async fn ingest_new_traces(app: Arc<App>) {
    let mut previous_job = None;
    let mut listed_before = BTreeMap::new();
    loop {
        let begun = Instant::now();
        let mut pause = PAUSE_MIN;
        if let Some(listed) = finished_traces(&app).await {
            let ingested = app.intake.lock().clone();
            // A file that is still being copied changes between two looks.
            let (ready, whole) = {
                let new = listed
                    .iter()
                    .filter(|(name, stamp)| ingested.get(*name) != Some(*stamp));
                let ready: BTreeMap<String, FileStamp> = new
                    .filter(|(name, stamp)| listed_before.get(*name) == Some(*stamp))
                    .map(|(name, stamp)| (name.clone(), *stamp))
                    .collect();
                let whole = ready.len() > NAMED_MAX || ready.len() == listed.len();
                (ready, whole)
            };
            if !ready.is_empty() {
                let named = if whole {
                    Vec::new()
                } else {
                    ready.keys().cloned().collect()
                };
                if ingest(&app, named, &mut previous_job).await {
                    app.intake.lock().extend(ready);
                } else {
                    pause = PAUSE_MAX;
                }
            }
            listed_before = listed;
        }
        tokio::select! {
            () = sleep(begun.elapsed().clamp(pause, PAUSE_MAX)) => {}
            () = app.closing.cancelled() => return,
        }
    }
}

async fn finished_traces(app: &Arc<App>) -> Option<BTreeMap<String, FileStamp>> {
    let archive = app.archive.clone();
    let listed = app
        .pool
        .setup()
        .host
        .work
        .spawn(move || archive.list("", usize::MAX));
    let files = listed.await.ok()?.ok()?;
    // A name that no client may use is none that a job may name.
    let finished = files
        .into_iter()
        .filter(|file| !file.recording && app.archive.path(&file.trace).is_ok());
    Some(
        finished
            .map(|file| (file.trace, (file.bytes, file.written)))
            .collect(),
    )
}

/// Reads traces in, all where none is named; whether it was done. A file that is no sound trace is
/// in table `quarantine` then. The previous job leaves the list: there are many of them, and nobody
/// asked for one.
async fn ingest(app: &Arc<App>, traces: Vec<String>, previous_job: &mut Option<u64>) -> bool {
    if let Some(previous) = previous_job.take() {
        app.jobs.unlist(previous);
    }
    let Ok(job) = app.jobs.start(Work::Ingest { traces }) else {
        return false;
    };
    *previous_job = Some(job.id);
    let Ok(mut watched) = app.jobs.watch(job.id) else {
        return false;
    };
    let _ = watched.wait_for(|job| job.ended()).await;
    watched.borrow().state == JobState::Done
}
