//! Traces become rows, and rows stay in the store: whole, once, and whatever happens to an ingest.

mod play;

use std::{fs, path::PathBuf};

use arrow::{
    array::{Array, AsArray, RecordBatch},
    datatypes::{Float64Type, Int32Type, UInt64Type},
};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use play::{DISTRACTOR, Play, TARGET, success};
use reel_tables::{Store, StoreError, Table, batches};
use reel_trace::Images;
use reel_world::{ErrorCode, Family, record::EndReason};
use tempfile::TempDir;

fn texts(batch: &RecordBatch, column: &str) -> Vec<Option<String>> {
    batch.column_by_name(column).unwrap().as_string::<i32>().iter().map(|text| text.map(str::to_owned)).collect()
}

fn rows(store: &Store, table: Table) -> usize {
    let read = |path: PathBuf| {
        let builder = ParquetRecordBatchReaderBuilder::try_new(fs::File::open(path).unwrap()).unwrap();
        builder.build().unwrap().map(|batch| batch.unwrap().num_rows()).sum::<usize>()
    };
    store.files(table).into_iter().map(read).sum()
}

fn ingest(store: &mut Store, paths: &[PathBuf]) -> (usize, usize, usize, usize) {
    let report = store.ingest(paths, &|_, _| ()).unwrap();
    (report.added, report.unchanged, report.superseded, report.quarantined.len())
}

#[test]
fn a_trace_becomes_rows_of_every_table() {
    let dir = TempDir::new().unwrap();
    let one = success("oracle", Family::SUL, u64::MAX).record(dir.path(), Images::None);
    let two = Play::new("lost", Family::SUL, 2).nav("table_1").fails("pick", ErrorCode::DoorClosed).ended(EndReason::Horizon);
    let two = two.record(dir.path(), Images::None);
    let tables = batches(&[one, two]).unwrap();
    let episodes = &tables[&Table::Episodes];
    assert_eq!(texts(episodes, "policy"), [Some("oracle".into()), Some("lost".into())]);
    assert_eq!(texts(episodes, "end_reason"), [Some("finished".into()), Some("horizon".into())]);
    assert_eq!(episodes["seed"].as_primitive::<UInt64Type>().value(0), u64::MAX);
    assert!(episodes["success"].as_boolean().value(0) && !episodes["success"].as_boolean().value(1));
    let steps = episodes["steps"].as_list::<i32>().value(0);
    let steps = RecordBatch::from(steps.as_struct());
    assert_eq!(steps.num_rows(), 7);
    assert_eq!(texts(&steps, "argument")[..3], [Some("table_1".into()), Some("alarm clock".into()), Some("Which one?".into())]);
    assert_eq!(
        steps["candidates"].as_primitive::<Int32Type>().values()[..2],
        [2, 2],
        "the start shows one clock, the first call the other"
    );
    let pick = 3;
    assert_eq!(texts(&steps, "object")[pick].as_deref(), Some(TARGET));
    assert!(steps["goal_object"].as_boolean().value(pick) && !steps["goal_receptacle"].as_boolean().value(pick));
    assert!(steps["goal_receptacle"].as_boolean().value(5));
    let failed = RecordBatch::from(episodes["steps"].as_list::<i32>().value(1).as_struct());
    assert_eq!(texts(&failed, "error_code"), [None, Some("door_closed".into())]);
    assert_eq!(texts(&failed, "error_class"), [None, Some("moderate".into())]);
    assert_eq!(texts(&tables[&Table::WorldDiffs], "event").len(), 4, "two moves, by both authorities");
    let rewards: f64 = tables[&Table::Rewards]["value"].as_primitive::<Float64Type>().values().iter().sum();
    assert!((rewards - (3.0 - 9.0 * 0.03)).abs() < 1e-9);
    assert_eq!(tables[&Table::Tasks].num_rows(), 1, "both play the same task");
    let roles = texts(&tables[&Table::Objects], "role");
    assert_eq!(roles, [Some("distractor".into()), Some("target".into()), Some("other".into())]);
    assert_eq!(texts(&tables[&Table::Markers], "id"), [Some(TARGET.into()), Some(DISTRACTOR.into())]);
    assert_eq!(tables[&Table::VisibleObjects]["step"].as_primitive::<Int32Type>().value(0), -1);
    assert_eq!(texts(&tables[&Table::Dialogue], "reply"), [Some("The white one, please.".into())]);
}

#[test]
fn ingesting_twice_adds_nothing_and_a_changed_trace_supersedes() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("a.mcap");
    let paths = [success("oracle", Family::FDP, 1).record_as(&path, Images::None), dir.path().join("b.mcap")];
    success("oracle", Family::FODP, 1).record_as(&paths[1], Images::None);
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    assert_eq!(ingest(&mut store, &paths), (2, 0, 0, 0));
    assert_eq!(ingest(&mut store, &paths), (0, 2, 0, 0));
    fs::remove_file(&path).unwrap();
    success("oracle", Family::FDP, 1).thinking(Default::default()).record_as(&path, Images::None);
    assert_eq!(ingest(&mut store, &paths), (0, 1, 1, 0));
    assert_eq!(ingest(&mut store, &paths), (0, 2, 0, 0));
    assert_eq!((rows(&store, Table::Episodes), rows(&store, Table::Tasks), rows(&store, Table::WorldDiffs)), (2, 2, 8));
    let reopened = Store::open(dir.path().join("store")).unwrap();
    assert_eq!(reopened.episodes().count(), 2);
    assert_eq!(
        fs::read_dir(dir.path().join("store/episodes")).unwrap().count(),
        reopened.files(Table::Episodes).len(),
        "nothing unused is left"
    );
}

#[test]
fn of_two_traces_with_one_id_the_later_path_wins_and_stays() {
    let dir = TempDir::new().unwrap();
    let paths = ["a.mcap", "b.mcap", "c.mcap"].map(|name| dir.path().join(name));
    success("oracle", Family::FDP, 1).record_as(&paths[0], Images::None);
    success("oracle", Family::FDP, 1).thinking(Default::default()).record_as(&paths[1], Images::None);
    fs::copy(&paths[1], &paths[2]).unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    assert_eq!(ingest(&mut store, &paths), (1, 1, 1, 0));
    assert_eq!(store.episodes().next().unwrap().1, paths[1]);
    assert_eq!(ingest(&mut store, &paths), (0, 3, 0, 0));
    assert_eq!(rows(&store, Table::Episodes), 1);
}

#[test]
fn a_bad_file_is_quarantined_and_the_rest_goes_on() {
    let dir = TempDir::new().unwrap();
    let good = success("oracle", Family::FDP, 1).record_as(&dir.path().join("a.mcap"), Images::None);
    let bad = dir.path().join("b.mcap");
    let mut bytes = fs::read(&good).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&bad, &bytes).unwrap();
    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let paths = [bad.clone(), good.clone(), dir.path().join("missing.mcap")];
    assert_eq!(ingest(&mut store, &paths), (1, 0, 0, 2));
    assert_eq!(store.quarantine().count(), 2);
    fs::copy(&good, &bad).unwrap();
    assert_eq!(ingest(&mut store, &[bad]), (0, 1, 0, 0));
    assert_eq!(store.quarantine().count(), 1, "a sound file leaves the quarantine");
}

#[test]
fn a_broken_off_recording_is_an_episode_without_an_end() {
    let dir = TempDir::new().unwrap();
    let path = Play::new("killed", Family::FDP, 1).nav("table_1").record_as(&dir.path().join("a.mcap"), Images::None);
    let trace = reel_trace::Trace::read(&path).unwrap();
    let tables = batches(&[trace]).unwrap();
    assert!(tables[&Table::Episodes]["end_reason"].is_null(0) && tables[&Table::Episodes]["success"].is_null(0));
}

#[test]
fn what_the_manifest_does_not_name_is_not_there() {
    let dir = TempDir::new().unwrap();
    let folder = dir.path().join("store");
    assert!(matches!(Store::open(&folder), Err(StoreError::NoStore { .. })));
    let path = success("oracle", Family::FDP, 1).record_as(&dir.path().join("a.mcap"), Images::None);
    let mut store = Store::open_or_create(&folder).unwrap();
    ingest(&mut store, &[path]);
    // as an ingest leaves it that was killed between its parts and its manifest
    let part = &store.files(Table::Episodes)[0];
    fs::copy(part, folder.join("episodes/part-000007.parquet")).unwrap();
    fs::write(folder.join("manifest.json.new"), "{\"format\":").unwrap();
    let mut reopened = Store::open(&folder).unwrap();
    assert_eq!(rows(&reopened, Table::Episodes), 1);
    assert_eq!(ingest(&mut reopened, &[]), (0, 0, 0, 0));
    assert!(!folder.join("episodes/part-000007.parquet").exists());
    fs::write(folder.join("manifest.json"), "{\"format\": 99}").unwrap();
    assert!(matches!(Store::open(&folder), Err(StoreError::OtherFormat { found: 99, .. })));
}

#[test]
fn two_ingests_at_a_time_are_refused() {
    let dir = TempDir::new().unwrap();
    let mut store = Store::open_or_create(dir.path()).unwrap();
    let lock = fs::File::create(dir.path().join("lock")).unwrap();
    lock.try_lock().unwrap();
    assert!(matches!(store.ingest(&[], &|_, _| ()), Err(StoreError::Busy { .. })));
}
