//! Traces become rows, and rows stay in the store: whole, once, and whatever happens to an ingest.

mod interop;

use reel_vectors::play;
use std::{collections::BTreeSet, fs, path::PathBuf};

use arrow::{
    array::{Array, AsArray, RecordBatch},
    datatypes::{Decimal128Type, Float64Type, Int32Type},
};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use play::{DISTRACTOR, Play, TARGET, success};
use reel_tables::{
    DocumentSet, LabelRow, RescoredEpisodes, Store, StoreError, Table, TraceRows, TraceVerdict,
    episode_batch,
};
use reel_trace::Images;
use reel_world::{ErrorCode, Family, Tool, ToolCall, ToolSpec, record::EndReason};
use tempfile::TempDir;

fn texts(batch: &RecordBatch, column: &str) -> Vec<Option<String>> {
    batch
        .column_by_name(column)
        .unwrap()
        .as_string::<i32>()
        .iter()
        .map(|text| text.map(str::to_owned))
        .collect()
}

/// What a list column holds in a row, as columns.
fn nested(batch: &RecordBatch, column: &str, row: usize) -> RecordBatch {
    RecordBatch::from(batch[column].as_list::<i32>().value(row).as_struct())
}

/// All rows of a table, file by file.
fn batches(store: &Store, table: Table) -> Vec<RecordBatch> {
    let read = |url: url::Url| {
        let file = fs::File::open(url.to_file_path().unwrap()).unwrap();
        ParquetRecordBatchReaderBuilder::try_new(file)
            .unwrap()
            .build()
            .unwrap()
            .map(Result::unwrap)
            .collect::<Vec<_>>()
    };
    store.files(table).into_iter().flat_map(read).collect()
}

fn rows(store: &Store, table: Table) -> usize {
    batches(store, table)
        .iter()
        .map(RecordBatch::num_rows)
        .sum()
}

/// The traces behind the episodes.
fn traces(store: &Store) -> BTreeSet<String> {
    batches(store, Table::Episodes)
        .iter()
        .flat_map(|batch| texts(batch, "trace"))
        .flatten()
        .collect()
}

fn ingest(store: &mut Store, paths: &[PathBuf]) -> (usize, usize, usize, usize) {
    let report = store.ingest(paths, &|_, _| ()).unwrap();
    (
        report.added,
        report.unchanged,
        report.superseded,
        report.quarantined.len(),
    )
}

#[test]
fn a_trace_becomes_a_row_with_all_that_belongs_to_it() {
    let dir = TempDir::new().unwrap();
    let one = success("oracle", Family::SUL, u64::MAX).record(dir.path(), Images::None);
    let two = Play::new("lost", Family::SUL, 2)
        .nav("table_1")
        .fails("pick", ErrorCode::DoorClosed)
        .ended(EndReason::Horizon);
    let two = two.record(dir.path(), Images::None);
    let episodes = episode_batch(&[one, two]).unwrap();
    assert_eq!(
        texts(&episodes, "policy"),
        [Some("oracle".into()), Some("lost".into())]
    );
    assert_eq!(
        texts(&episodes, "end_reason"),
        [Some("finished".into()), Some("horizon".into())]
    );
    assert_eq!(
        episodes["seed"].as_primitive::<Decimal128Type>().value(0),
        i128::from(u64::MAX)
    );
    assert!(
        episodes["success"].as_boolean().value(0) && !episodes["success"].as_boolean().value(1)
    );
    assert_eq!(
        nested(&episodes, "start_objects", 0).num_rows(),
        1,
        "the start shows one clock"
    );
    assert_eq!(nested(&episodes, "start_changes", 0).num_rows(), 0);
    let steps = nested(&episodes, "steps", 0);
    assert_eq!(steps.num_rows(), 7);
    assert_eq!(
        texts(&steps, "argument")[..3],
        [
            Some("table_1".into()),
            Some("alarm clock".into()),
            Some("Which one?".into())
        ]
    );
    assert_eq!(
        texts(&steps, "reply")[2].as_deref(),
        Some("The white one, please.")
    );
    assert_eq!(
        steps["candidate_count"]
            .as_primitive::<Int32Type>()
            .values()[..2],
        [2, 2],
        "the start shows one clock, the first call the other"
    );
    let pick = 3;
    assert_eq!(texts(&steps, "object")[pick].as_deref(), Some(TARGET));
    assert!(
        steps["goal_object"].as_boolean().value(pick)
            && !steps["goal_receptacle"].as_boolean().value(pick)
    );
    assert!(steps["goal_receptacle"].as_boolean().value(5));
    let events = |step: usize| texts(&nested(&steps, "changes", step), "event");
    assert_eq!(
        events(pick),
        [Some("remove".into()), Some("remove".into())],
        "by both authorities"
    );
    assert_eq!(events(5), [Some("add".into()), Some("add".into())]);
    let marked: Vec<_> = (0..7)
        .flat_map(|step| texts(&nested(&steps, "marker_map", step), "id"))
        .collect();
    assert_eq!(marked, [Some(TARGET.into()), Some(DISTRACTOR.into())]);
    let failed = nested(&episodes, "steps", 1);
    assert_eq!(
        texts(&failed, "error_code"),
        [None, Some("door_closed".into())]
    );
    assert_eq!(
        texts(&failed, "error_class"),
        [None, Some("moderate".into())]
    );
    let term = |steps: &RecordBatch, step| {
        nested(steps, "terms", step)["value"]
            .as_primitive::<Float64Type>()
            .values()
            .to_vec()
    };
    let terms = (0..7)
        .flat_map(|step| term(&steps, step))
        .chain((0..2).flat_map(|step| term(&failed, step)));
    assert!((terms.sum::<f64>() - (3.0 - 9.0 * 0.03)).abs() < 1e-9);
}

#[test]
fn a_task_and_a_scene_stand_there_once() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    let paths = [
        success("oracle", Family::FDP, 1).record_as(&path("a.mcap"), Images::None),
        success("planner", Family::FDP, 1).record_as(&path("b.mcap"), Images::None),
        success("planner", Family::FODP, 1).record_as(&path("c.mcap"), Images::None),
    ];
    let mut store = Store::open_or_create(path("store")).unwrap();
    assert_eq!(ingest(&mut store, &paths[..1]), (1, 0, 0, 0));
    assert_eq!(ingest(&mut store, &paths), (2, 1, 0, 0));
    assert_eq!(
        (
            rows(&store, Table::Episodes),
            rows(&store, Table::Tasks),
            rows(&store, Table::Scenes)
        ),
        (3, 2, 1)
    );
    let tasks = batches(&store, Table::Tasks);
    let objects = nested(&tasks[0], "objects", 0);
    assert_eq!(
        texts(&objects, "role"),
        [
            Some("distractor".into()),
            Some("target".into()),
            Some("other".into())
        ]
    );
    let task: reel_world::Task =
        serde_json::from_str(texts(&tasks[0], "task")[0].as_deref().unwrap()).unwrap();
    assert_eq!(
        Some(reel_world::Digest::of_json(&task).to_string()),
        texts(&tasks[0], "task_digest")[0],
        "the whole task"
    );
}

#[test]
fn ingesting_twice_adds_nothing_and_a_changed_trace_supersedes() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.mcap");
    let paths = [
        success("oracle", Family::FDP, 1).record_as(&path, Images::None),
        dir.path().join("b.mcap"),
    ];
    success("oracle", Family::FODP, 1).record_as(&paths[1], Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    assert_eq!(ingest(&mut store, &paths), (2, 0, 0, 0));
    assert_eq!(ingest(&mut store, &paths), (0, 2, 0, 0));
    fs::remove_file(&path).unwrap();
    success("oracle", Family::FDP, 1)
        .thinking(Default::default())
        .record_as(&path, Images::None);
    assert_eq!(ingest(&mut store, &paths), (0, 1, 1, 0));
    assert_eq!(ingest(&mut store, &paths), (0, 2, 0, 0));
    assert_eq!(
        (rows(&store, Table::Episodes), rows(&store, Table::Tasks)),
        (2, 2)
    );
    let reopened = Store::open(dir.path().join("store")).unwrap();
    assert_eq!(rows(&reopened, Table::Episodes), 2);
}

#[test]
fn of_two_traces_with_one_id_the_later_path_wins_and_stays() {
    let dir = TempDir::new().unwrap();
    let paths = ["a.mcap", "b.mcap", "c.mcap"].map(|name| dir.path().join(name));
    success("oracle", Family::FDP, 1).record_as(&paths[0], Images::None);
    success("oracle", Family::FDP, 1)
        .thinking(Default::default())
        .record_as(&paths[1], Images::None);
    fs::copy(&paths[1], &paths[2]).unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    assert_eq!(ingest(&mut store, &paths), (1, 1, 1, 0));
    assert_eq!(
        traces(&store),
        BTreeSet::from([paths[1].display().to_string()])
    );
    assert_eq!(ingest(&mut store, &paths), (0, 3, 0, 0));
    assert_eq!(rows(&store, Table::Episodes), 1);
}

#[test]
fn a_moved_trace_is_found_and_an_overwritten_one_is_no_more() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    let first = success("oracle", Family::FDP, 1).record_as(&path("a.mcap"), Images::None);
    let mut store = Store::open_or_create(path("store")).unwrap();
    assert_eq!(
        ingest(&mut store, std::slice::from_ref(&first)),
        (1, 0, 0, 0)
    );
    fs::rename(&first, path("b.mcap")).unwrap();
    assert_eq!(ingest(&mut store, &[path("b.mcap")]), (0, 0, 1, 0));
    assert_eq!(
        traces(&store),
        BTreeSet::from([path("b.mcap").display().to_string()])
    );
    fs::copy(path("b.mcap"), path("c.mcap")).unwrap();
    assert_eq!(
        ingest(&mut store, &[path("c.mcap")]),
        (0, 1, 0, 0),
        "a copy changes nothing"
    );
    fs::remove_file(path("b.mcap")).unwrap();
    fs::remove_file(path("c.mcap")).unwrap();
    success("planner", Family::FDP, 2).record_as(&path("b.mcap"), Images::None);
    assert_eq!(ingest(&mut store, &[path("b.mcap")]), (1, 0, 0, 0));
    let ids: Vec<_> = batches(&store, Table::Episodes)
        .iter()
        .flat_map(|batch| texts(batch, "episode_id"))
        .flatten()
        .collect();
    assert_eq!(ids, ["planner-FDP-2"], "the file holds another episode now");
}

#[test]
fn two_files_that_change_places_keep_both_episodes() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    let paths = [path("a.mcap"), path("b.mcap")];
    success("oracle", Family::FDP, 1).record_as(&paths[0], Images::None);
    success("planner", Family::FODP, 2).record_as(&paths[1], Images::None);
    let mut store = Store::open_or_create(path("store")).unwrap();
    assert_eq!(ingest(&mut store, &paths), (2, 0, 0, 0));
    fs::rename(&paths[0], path("c")).unwrap();
    fs::rename(&paths[1], &paths[0]).unwrap();
    fs::rename(path("c"), &paths[1]).unwrap();
    assert_eq!(ingest(&mut store, &paths), (0, 0, 2, 0));
    let rows: BTreeSet<_> = batches(&store, Table::Episodes)
        .iter()
        .flat_map(|batch| {
            texts(batch, "policy")
                .into_iter()
                .zip(texts(batch, "trace"))
        })
        .map(|(policy, trace)| (policy.unwrap(), trace.unwrap()))
        .collect();
    let expected = [("oracle", &paths[1]), ("planner", &paths[0])];
    assert_eq!(
        rows,
        expected
            .map(|(policy, path)| (policy.to_owned(), path.display().to_string()))
            .into()
    );
}

#[test]
fn a_bad_file_is_quarantined_and_the_rest_goes_on() {
    let dir = TempDir::new().unwrap();
    let good =
        success("oracle", Family::FDP, 1).record_as(&dir.path().join("a.mcap"), Images::None);
    let bad = dir.path().join("b.mcap");
    let mut bytes = fs::read(&good).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&bad, &bytes).unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let paths = [bad.clone(), good.clone(), dir.path().join("missing.mcap")];
    assert_eq!(ingest(&mut store, &paths), (1, 0, 0, 2));
    assert_eq!(store.quarantine().unwrap().len(), 2);
    fs::copy(&good, &bad).unwrap();
    assert_eq!(ingest(&mut store, &[bad]), (0, 1, 0, 0));
    assert_eq!(
        store.quarantine().unwrap().len(),
        1,
        "a sound file leaves the quarantine"
    );
}

#[test]
fn a_broken_off_recording_is_an_episode_without_an_end() {
    let dir = TempDir::new().unwrap();
    let path = Play::new("killed", Family::FDP, 1)
        .nav("table_1")
        .record_as(&dir.path().join("a.mcap"), Images::None);
    let trace = reel_trace::Trace::read(&path).unwrap();
    let episodes = episode_batch(&[trace]).unwrap();
    assert!(episodes["end_reason"].is_null(0) && episodes["success"].is_null(0));
}

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
fn two_ingests_at_a_time_lose_nothing_and_double_nothing() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("store");
    let record = |seed| {
        success("oracle", Family::FDP, seed)
            .record_as(&dir.path().join(format!("{seed}.mcap")), Images::None)
    };
    let paths: Vec<PathBuf> = (0..24).map(record).collect();
    // every pair overlaps: each episode is ingested by two
    let parts: Vec<Vec<PathBuf>> = (0..4)
        .map(|part| {
            paths
                .iter()
                .cycle()
                .skip(part * 6)
                .take(12)
                .cloned()
                .collect()
        })
        .collect();
    let folder = &folder;
    std::thread::scope(|scope| {
        for part in &parts {
            scope.spawn(move || {
                let mut store = Store::open_or_create(folder).unwrap();
                for path in part {
                    ingest(&mut store, std::slice::from_ref(path));
                }
            });
        }
    });
    let store = Store::open(folder).unwrap();
    assert_eq!(
        (rows(&store, Table::Episodes), traces(&store).len()),
        (24, 24)
    );
    assert_eq!(
        (rows(&store, Table::Tasks), rows(&store, Table::Scenes)),
        (1, 1)
    );
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

/// What was made up could have been recorded: every call is one of a tool, every failure has a
/// code, its class and the text of that code.
#[test]
fn a_store_without_a_table_of_today_says_what_to_do() {
    let dir = TempDir::new().unwrap();
    let store = dir.path().join("store");
    drop(Store::open_or_create(&store).unwrap());
    fs::remove_dir_all(store.join("attribution")).unwrap();
    let Err(error) = Store::open(&store) else {
        panic!("a table is missing, and it opens");
    };
    assert!(matches!(error, StoreError::OtherColumns { .. }), "{error}");
    assert!(error.to_string().contains("reel ingest"), "{error}");
}

#[test]
fn synthetic_steps_are_possible_ones() {
    #[derive(serde::Deserialize)]
    struct Row {
        steps: Vec<Step>,
    }
    #[derive(serde::Deserialize)]
    struct Step {
        tool: String,
        call_name: String,
        arguments: String,
        text: String,
        error_code: Option<String>,
        error_class: Option<String>,
    }
    let dir = TempDir::new().unwrap();
    let trace = success("oracle", Family::FDP, 1).record(dir.path(), Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let (tasks, scene) = ([trace.task.clone()], &trace.scene);
    reel_tables::synthesize(&mut store, &tasks, scene, 400, 7, |_| ()).unwrap();
    let mut codes = BTreeSet::new();
    for batch in batches(&store, Table::Episodes) {
        let rows: Vec<Row> = reel_tables::rows_from(&batch).unwrap();
        for step in rows.into_iter().flat_map(|row| row.steps) {
            let arguments = serde_json::from_str(&step.arguments).unwrap();
            let call = ToolCall::new(&step.call_name, arguments);
            assert!(Tool::parse(&call).is_ok(), "{call}");
            assert_eq!(ToolSpec::by_name(&step.tool).unwrap().paper_name, step.tool);
            let code = step.error_code.map(|code| ErrorCode::parse(&code).unwrap());
            assert_eq!(ErrorCode::from_message(&step.text), code, "{}", step.text);
            let class = code.map(|code| format!("{:?}", code.class()).to_lowercase());
            assert_eq!(step.error_class, class);
            codes.extend(code);
        }
    }
    assert_eq!(codes.len(), 3);
}

/// What another machine reads goes in as if it had been read here.
#[test]
fn rows_survive_the_way_from_another_machine() {
    let dir = TempDir::new().unwrap();
    let record = |seed: u64| {
        let path = dir.path().join(format!("{seed}.mcap"));
        success("oracle", Family::SUL, seed).record_as(&path, Images::None)
    };
    let mut paths: Vec<PathBuf> = (0..5).map(record).collect();
    paths.push(dir.path().join("bad.mcap"));
    fs::write(&paths[5], "no trace").unwrap();
    let (here, there) = (dir.path().join("here"), dir.path().join("there"));
    let report = Store::open_or_create(&here)
        .unwrap()
        .ingest(&paths, &|_, _| ())
        .unwrap();
    let reader = reel_trace::RecordsReader::default();
    let away = |groups: &[Vec<PathBuf>],
                _: DocumentSet,
                done: &(dyn Fn(usize) + Sync),
                take: &mut dyn FnMut(TraceRows) -> Result<(), StoreError>| {
        for group in groups {
            let bytes = TraceRows::read(&reader, group, &DocumentSet::default())?.to_bytes()?;
            for cut in (0..bytes.len()).step_by(bytes.len() / 97 + 1) {
                assert!(
                    TraceRows::from_bytes(&bytes[..cut]).is_err(),
                    "cut after {cut} bytes"
                );
            }
            take(TraceRows::from_bytes(&bytes)?)?;
            done(group.len());
        }
        Ok(())
    };
    let mut store = Store::open_or_create(&there).unwrap();
    assert_eq!(
        store.ingest_by(&paths, 2, &|_, _| (), away).unwrap(),
        report
    );
    let here = Store::open(&here).unwrap();
    for table in [
        Table::Episodes,
        Table::Tasks,
        Table::Scenes,
        Table::Quarantine,
    ] {
        let of = |store: &Store| {
            arrow::compute::concat_batches(&table.schema(), &batches(store, table)).unwrap()
        };
        assert_eq!(of(&store), of(&here), "{table:?}");
    }

    let preset = reel_reward::Preset::parse("real-repo").unwrap();
    let files = store.file_names(Table::Episodes);
    let mut scored = RescoredEpisodes::default();
    for file in files {
        let bytes = store
            .rescore_in(&[file], &preset, |_| ())
            .unwrap()
            .to_bytes()
            .unwrap();
        assert!(RescoredEpisodes::from_bytes(&bytes[..bytes.len() / 2]).is_err());
        scored.append(RescoredEpisodes::from_bytes(&bytes).unwrap());
    }
    assert_eq!(store.append_rescored(scored, &preset).unwrap().scored, 5);
    assert_eq!(store.rescore(&preset, |_| ()).unwrap().unchanged, 5);
}
