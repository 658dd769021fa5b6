//! Versions of a store: what a commit names is there, earlier ones stay readable until a vacuum, and
//! labels belong to one.

use std::{collections::BTreeMap, fs, path::Path};

use arrow::{array::RecordBatch, error::ArrowError};
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
    let more = if reel_vectors::is_long() { 50 } else { 16 };
    for seed in 1..=more as u64 {
        assert_eq!(ingest(&mut store, &[record(seed)]), (1, 0, 0, 0));
    }
    let then = Store::open_at(&folder, version).unwrap();
    assert_eq!(batches(&then, Table::Episodes), before);
    assert_eq!(
        (
            rows(&store, Table::Episodes),
            store.history().unwrap().len() as u64
        ),
        (1 + more, store.version() + 1)
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
        (1, 1 + more)
    );
    let looked = store.vacuum(0, true).unwrap();
    assert!(
        looked.dry_run && looked.deleted.len() + 10 > more,
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
    assert_eq!(
        rows(&Store::open(&folder).unwrap(), Table::Episodes),
        1 + more
    );
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
        blind: None,
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
        at_ms: None,
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
fn of_the_replays_of_a_file_the_newest_counts() {
    let dir = TempDir::new().unwrap();
    let store = Store::open_or_create(dir.path().join("store")).unwrap();
    let mut at_ms = 0;
    let mut replayed = |verdict: &str, sim_version| {
        at_ms += 1;
        let verdict = TraceVerdict {
            file_digest: "a file".into(),
            trace_digest: "a trace".into(),
            sim_version,
            build: "0".into(),
            verdict: verdict.into(),
            reason: String::new(),
            at_ms: Some(at_ms),
        };
        store.append_new_verdicts(&[verdict]).unwrap();
        store.verdicts().unwrap().len()
    };
    assert_eq!(replayed("exact", 1), 1);
    assert_eq!(replayed("exact", 1), 1, "it says what is known");
    assert_eq!(replayed("diverged", 1), 2);
    assert_eq!(replayed("exact", 1), 3, "another than the one before");
    assert_eq!(replayed("exact_without_rgb", 1), 4, "compares less");
    assert_eq!(replayed("exact", 1), 4, "as the last of its kind");
    assert_eq!(replayed("exact", 2), 5, "another simulator");
    let said: Vec<String> = store
        .verdicts()
        .unwrap()
        .into_iter()
        .map(|one| one.verdict)
        .collect();
    assert_eq!(
        said,
        ["exact", "diverged", "exact", "exact_without_rgb", "exact"]
    );
}

/// Makes of a table one of an earlier version of Reel, which did not have a column: in its schema
/// and in its files.
fn without_column(folder: &Path, column: &str) {
    use parquet::arrow::{ArrowWriter, arrow_reader::ParquetRecordBatchReaderBuilder};
    let mut sizes = BTreeMap::new();
    for file in fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
    {
        if file.is_dir() {
            continue;
        }
        let reader = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(&file).unwrap());
        let without = |batch: Result<RecordBatch, ArrowError>| {
            let mut batch = batch.unwrap();
            batch.remove_column(batch.schema().index_of(column).unwrap());
            batch
        };
        let narrow: Vec<_> = reader.unwrap().build().unwrap().map(without).collect();
        let mut writer =
            ArrowWriter::try_new(fs::File::create(&file).unwrap(), narrow[0].schema(), None)
                .unwrap();
        narrow.iter().for_each(|batch| writer.write(batch).unwrap());
        writer.close().unwrap();
        let name = file.file_name().unwrap().to_str().unwrap().to_owned();
        sizes.insert(name, fs::metadata(&file).unwrap().len());
    }
    for log in fs::read_dir(folder.join("_delta_log")).unwrap() {
        let log = log.unwrap().path();
        let narrow = |line: &str| {
            let mut action: serde_json::Value = serde_json::from_str(line).unwrap();
            if let Some(text) = action["metaData"]["schemaString"].as_str() {
                let mut schema: serde_json::Value = serde_json::from_str(text).unwrap();
                let fields = schema["fields"].as_array_mut().unwrap();
                fields.retain(|field| field["name"] != column);
                action["metaData"]["schemaString"] = schema.to_string().into();
            }
            if let Some(path) = action["add"]["path"].as_str() {
                action["add"]["size"] = sizes[path].into();
            }
            action
                .as_object_mut()
                .unwrap()
                .retain(|_, action| !action.is_null());
            action.to_string() + "\n"
        };
        let lines: String = fs::read_to_string(&log)
            .unwrap()
            .lines()
            .map(narrow)
            .collect();
        fs::write(&log, lines).unwrap();
    }
}

#[test]
fn columns_that_an_earlier_version_lacked_read_as_null_and_are_added_by_the_next_writer() {
    let dir = TempDir::new().unwrap();
    let folder = &dir.path().join("store");
    let label = |author: &str, blind| LabelRow {
        episode_id: "an episode".into(),
        author: author.into(),
        kind: "human".into(),
        class: "Other".into(),
        sub_class: None,
        step: None,
        confidence: None,
        note: None,
        at_ms: 1,
        blind,
    };
    let verdict = |file: &str, at_ms| TraceVerdict {
        file_digest: file.into(),
        trace_digest: "a trace".into(),
        sim_version: 1,
        build: "0".into(),
        verdict: "exact".into(),
        reason: String::new(),
        at_ms,
    };
    let mut store = Store::open_or_create(folder).unwrap();
    store.change_labels(|_| vec![label("ann", None)]).unwrap();
    store.append_verdicts(&[verdict("first", None)]).unwrap();
    without_column(&folder.join("labels"), "blind");
    without_column(&folder.join("verdicts"), "at_ms");

    let mut store = Store::open(folder).unwrap();
    assert_eq!(store.labels().unwrap(), [label("ann", None)]);
    assert_eq!(store.verdicts().unwrap(), [verdict("first", None)]);
    store
        .change_labels(|mut before| {
            before.push(label("bob", Some(true)));
            before
        })
        .unwrap();
    // two who write at a time
    std::thread::scope(|scope| {
        for file in ["second", "third"] {
            let store = &store;
            scope.spawn(move || store.append_verdicts(&[verdict(file, Some(7))]).unwrap());
        }
    });
    let mut store = Store::open(folder).unwrap();
    assert_eq!(
        store.labels().unwrap(),
        [label("ann", None), label("bob", Some(true))]
    );
    let times = |store: &Store| {
        store
            .verdicts()
            .unwrap()
            .iter()
            .map(|one| one.at_ms)
            .collect::<Vec<_>>()
    };
    assert_eq!(times(&store), [None, Some(7), Some(7)]);
    // files of both kinds are merged
    assert!(store.compact().unwrap().files_after < 4);
    assert_eq!(times(&store), [None, Some(7), Some(7)]);
    let version = store.version();
    assert_eq!(
        Store::open_at(folder, version - 1)
            .unwrap()
            .labels()
            .unwrap(),
        [label("ann", None)]
    );
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
