//! Versions of a store: what a commit names is there, earlier ones stay readable until a vacuum, and
//! labels belong to one.

use std::fs;

use reel_tables::{LabelRow, Store, StoreError, Table, TraceVerdict};
use reel_trace::Images;
use reel_world::Family;
use tempfile::TempDir;

use crate::{batches, ingest, play::success, rows};

#[test]
fn what_no_commit_of_the_episodes_names_is_not_there() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("store");
    assert!(matches!(
        Store::open(&folder),
        Err(StoreError::NoStore { .. })
    ));
    let path = |name: &str| dir.path().join(name);
    let first = success("oracle", Family::FDP, 1).record_as(&path("a.mcap"), Images::None);
    let second = success("oracle", Family::FODP, 1).record_as(&path("b.mcap"), Images::None);
    let bad = path("bad.mcap");
    fs::write(&bad, "no trace").unwrap();
    let mut store = Store::open_or_create(&folder).unwrap();
    ingest(&mut store, &[first, second.clone(), bad.clone()]);
    assert_eq!(
        (rows(&store, Table::Episodes), rows(&store, Table::Tasks)),
        (2, 2)
    );
    // as an ingest leaves it that was killed before its last commit
    let newest = format!("episodes/_delta_log/{:020}.json", store.version());
    fs::remove_file(folder.join(newest)).unwrap();
    let mut reopened = Store::open(&folder).unwrap();
    assert_eq!(
        (
            rows(&reopened, Table::Episodes),
            rows(&reopened, Table::Tasks),
            rows(&reopened, Table::Scenes)
        ),
        (0, 0, 0)
    );
    assert!(reopened.quarantine().unwrap().is_empty());
    assert_eq!(ingest(&mut reopened, &[second, bad]), (1, 0, 0, 1));
    assert_eq!(reopened.quarantine().unwrap().len(), 1);
    assert_eq!(
        (
            rows(&reopened, Table::Episodes),
            rows(&reopened, Table::Tasks),
            rows(&reopened, Table::Scenes)
        ),
        (1, 2, 1)
    );
}

#[test]
fn earlier_versions_stay_readable() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("store");
    let record = |seed| {
        success("oracle", Family::FDP, seed)
            .record_as(&dir.path().join(format!("{seed}.mcap")), Images::None)
    };
    let mut store = Store::open_or_create(&folder).unwrap();
    ingest(&mut store, &[record(0)]);
    let version = store.version();
    let before = batches(&store, Table::Episodes);
    for seed in 1..=50 {
        assert_eq!(ingest(&mut store, &[record(seed)]), (1, 0, 0, 0));
    }
    let then = Store::open_at(&folder, version).unwrap();
    assert_eq!(batches(&then, Table::Episodes), before);
    assert_eq!(
        (
            rows(&store, Table::Episodes),
            store.history().unwrap().len() as u64
        ),
        (51, store.version() + 1)
    );
    assert!(
        store.files(Table::Episodes).len() < 10,
        "small files are merged: {}",
        store.files(Table::Episodes).len()
    );
    assert!(matches!(
        Store::open_at(&folder, 9999),
        Err(StoreError::NoVersion { version: 9999, .. })
    ));
    store.compact().unwrap();
    assert_eq!(
        (
            store.files(Table::Episodes).len(),
            rows(&store, Table::Episodes)
        ),
        (1, 51)
    );
    let looked = store.vacuum(0, true).unwrap();
    assert!(
        looked.dry_run && looked.deleted.len() > 40,
        "{} files",
        looked.deleted.len()
    );
    assert_eq!(
        batches(&Store::open_at(&folder, version).unwrap(), Table::Episodes),
        before,
        "a dry run deletes nothing"
    );
    assert_eq!(
        store.vacuum(0, false).unwrap().deleted.len(),
        looked.deleted.len()
    );
    assert_eq!(rows(&Store::open(&folder).unwrap(), Table::Episodes), 51);
    assert!(Store::open(&folder).unwrap().check_files().is_ok());
    assert!(matches!(
        Store::open_at(&folder, version).unwrap().check_files(),
        Err(StoreError::Missing { .. })
    ));
}

#[test]
fn labels_of_two_at_a_time_stay() {
    let dir = TempDir::new().unwrap();
    let folder = &dir.path().join("store");
    Store::open_or_create(folder).unwrap();
    let label = |author: &str, episode: usize| LabelRow {
        episode_id: format!("e{episode}"),
        author: author.into(),
        kind: "human".into(),
        class: "Other".into(),
        sub_class: None,
        step: None,
        confidence: None,
        note: None,
        at_ms: 1,
    };
    std::thread::scope(|scope| {
        for author in ["ann", "bob", "cem"] {
            scope.spawn(move || {
                let mut store = Store::open(folder).unwrap();
                for episode in 0..4 {
                    let said = |mut before: Vec<LabelRow>| {
                        before.push(label(author, episode));
                        before
                    };
                    store.change_labels(said).unwrap();
                }
            });
        }
    });
    let store = Store::open(folder).unwrap();
    let mut said: Vec<(String, String)> = store
        .labels()
        .unwrap()
        .into_iter()
        .map(|label| (label.author, label.episode_id))
        .collect();
    assert_eq!(said.len(), 12);
    said.sort();
    said.dedup();
    assert_eq!(said.len(), 12);
    // the labels of an earlier version are still those of that version
    let before = Store::open_at(folder, store.version() - 1).unwrap();
    assert_eq!(before.labels().unwrap().len(), 11);
    // who takes all of them out and is killed before that is named has not done it, and can
    let mut store = store;
    store.change_labels(|_| Vec::new()).unwrap();
    let newest = format!("episodes/_delta_log/{:020}.json", store.version());
    fs::remove_file(folder.join(newest)).unwrap();
    let mut reopened = Store::open(folder).unwrap();
    assert_eq!(reopened.labels().unwrap().len(), 12);
    reopened.change_labels(|_| Vec::new()).unwrap();
    assert!(reopened.labels().unwrap().is_empty());
}

#[test]
fn verdicts_belong_to_no_version() {
    let dir = TempDir::new().unwrap();
    let folder = &dir.path().join("store");
    let store = Store::open_or_create(folder).unwrap();
    let verdict = |file: usize| TraceVerdict {
        file_digest: format!("file {file}"),
        trace_digest: "a trace".into(),
        sim_version: 1,
        build: "0".into(),
        verdict: "exact".into(),
        reason: "it is".into(),
    };
    std::thread::scope(|scope| {
        for writer in 0..3 {
            let store = &store;
            scope.spawn(move || {
                (0..4).for_each(|file| {
                    store
                        .append_verdicts(&[verdict(4 * writer + file)])
                        .unwrap()
                })
            });
        }
    });
    let mut kept = Store::open_at(folder, store.version())
        .unwrap()
        .verdicts()
        .unwrap();
    kept.sort_by_key(|verdict| verdict.file_digest[5..].parse::<usize>().unwrap());
    assert_eq!(kept, (0..12).map(verdict).collect::<Vec<_>>());
    // merging their files keeps them, and moves no version either
    let mut store = Store::open(folder).unwrap();
    let version = store.version();
    let report = store.compact().unwrap();
    assert_eq!(
        (report.files_before, report.files_after, report.version),
        (12, 1, version)
    );
    assert_eq!(store.verdicts().unwrap().len(), 12);
}

#[test]
fn a_store_without_a_table_of_today_says_what_to_do() {
    let dir = TempDir::new().unwrap();
    let store = dir.path().join("store");
    drop(Store::open_or_create(&store).unwrap());
    for table in ["attribution", "remarks", "counterfactuals"] {
        fs::remove_dir_all(store.join(table)).unwrap();
        let Err(error) = Store::open(&store) else {
            panic!("table {table} is missing, and it opens");
        };
        assert!(matches!(error, StoreError::OtherColumns { .. }), "{error}");
        assert!(error.to_string().contains("reel ingest"), "{error}");
        // An ingest makes it.
        drop(Store::open_or_create(&store).unwrap());
        assert!(Store::open(&store).is_ok());
    }
}
