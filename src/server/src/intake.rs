//! Traces that come while the server runs go to the tables by themselves: episodes of sessions,
//! branches, uploads, and what others put into the folder.

use std::{collections::BTreeSet, sync::Arc, time::Duration};

use tokio::time::{Instant, sleep};

use crate::{
    jobs::{JobState, Work},
    service::App,
};

/// How often it is looked at least for new traces.
const LOOK_EVERY: Duration = Duration::from_secs(3);
/// How long it waits after what failed: it would fail again.
const AFTER_FAILURE: Duration = Duration::from_secs(60);
/// How much longer it waits than looking and reading in took: both stay a small part of the work.
const PAUSE: u32 = 10;

/// Reads new traces in until the server closes.
pub(crate) async fn take_in(app: Arc<App>) {
    // Where nothing was looked at yet, all that the folder holds is new.
    let mut seen: Option<BTreeSet<String>> = None;
    let mut earlier = None;
    loop {
        let begun = Instant::now();
        let mut least = LOOK_EVERY;
        if let Some(names) = finished(&app).await {
            let new: Vec<String> = match &seen {
                Some(seen) => names.difference(seen).cloned().collect(),
                None => Vec::new(),
            };
            let any = seen.as_ref().map_or(!names.is_empty(), |_| !new.is_empty());
            if !any || ingest(&app, new, &mut earlier).await {
                seen = Some(names);
            } else {
                least = AFTER_FAILURE;
            }
        }
        let pause = least.max(begun.elapsed() * PAUSE);
        tokio::select! {
            () = sleep(pause) => {}
            () = app.closing.cancelled() => return,
        }
    }
}

async fn finished(app: &Arc<App>) -> Option<BTreeSet<String>> {
    let archive = app.archive.clone();
    let listed = app.pool.setup().host.work.spawn(move || archive.finished());
    listed.await.ok()?.ok().map(BTreeSet::from_iter)
}

/// Reads traces in, all where none is named; whether it was done. A file that is no sound trace is
/// in table `quarantine` then. The `earlier` job leaves the list: there are many of them, and nobody
/// asked for one.
async fn ingest(app: &Arc<App>, traces: Vec<String>, earlier: &mut Option<u64>) -> bool {
    if let Some(earlier) = earlier.take() {
        app.jobs.forget(earlier);
    }
    let Ok(job) = app.jobs.start(Work::Ingest { traces }) else {
        return false;
    };
    let Ok(mut watched) = app.jobs.watch(job.id) else {
        return true;
    };
    let _ = watched.wait_for(|job| job.ended()).await;
    let state = watched.borrow().state;
    *earlier = (state == JobState::Done).then_some(job.id);
    // Whoever cancels it does not want it again at once.
    state != JobState::Failed
}
