//! The rules on hand-made episodes, a case each, and the judge before a scripted endpoint.

mod clusters;
mod judge;
mod paper;
mod rules;

use reel_vectors::play;
use reel_vectors::scripted;
use std::path::Path;

use play::Play;
use reel_query::QuerySession;
use reel_tables::Store;
use reel_taxonomy::{RuleSet, classify};

/// A failed episode as it was classified.
#[derive(Debug)]
pub(crate) struct Found {
    pub(crate) episode_id: String,
    pub(crate) class: String,
    pub(crate) sub_class: String,
    pub(crate) step: i32,
    pub(crate) last_step: i32,
    pub(crate) evidence: String,
    pub(crate) fields: Vec<String>,
    pub(crate) secondary: Vec<(String, i32)>,
}

/// Ingests episodes and classifies them by the rules that come with Reel, sorted by their ids.
pub(crate) fn classified(dir: &Path, plays: &[Play]) -> Vec<Found> {
    let paths = play::record_all(dir, plays);
    let mut store = Store::open_or_create(dir.join("store")).unwrap();
    let report = store.ingest(&paths, &|_, _| ()).unwrap();
    assert_eq!((report.added, report.quarantined), (plays.len(), vec![]));
    found(&QuerySession::new(store).unwrap(), &RuleSet::built_in())
}

/// What a set of rules finds in a store.
pub(crate) fn found(session: &QuerySession, rules: &RuleSet) -> Vec<Found> {
    let verdicts = classify(session, rules, None).unwrap();
    let mut found: Vec<Found> = verdicts
        .classes()
        .map(|class| Found {
            episode_id: class.episode_id.to_owned(),
            class: class.class.to_owned(),
            sub_class: class.sub_class.to_owned(),
            step: class.step,
            last_step: class.last_step,
            evidence: class.evidence.to_owned(),
            fields: class.fields.to_vec(),
            secondary: class
                .secondary
                .iter()
                .map(|other| (other.sub_class.to_owned(), other.step))
                .collect(),
        })
        .collect();
    found.sort_by(|one, other| one.episode_id.cmp(&other.episode_id));
    found
}
