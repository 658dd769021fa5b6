//! An ingest takes every trace once: repeated, moved, damaged, at the same time, or read
//! by another machine.

use std::{collections::BTreeSet, fs, path::PathBuf};

use reel_tables::{DocumentSet, RescoredEpisodes, Store, StoreError, Table, TraceRows};
use reel_trace::Images;
use reel_world::Family;
use tempfile::TempDir;

use crate::{batches, ingest, nested, play::success, rows, texts};

/// The traces behind the episodes.
fn traces(store: &Store) -> BTreeSet<String> {
    batches(store, Table::Episodes)
        .iter()
        .flat_map(|batch| texts(batch, "trace"))
        .flatten()
        .collect()
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

/// Files that are written, replaced, moved, copied, exchanged and removed at random: a large store,
/// in which traces are looked up, says and holds the same as a small one, whose contents are read.
#[test]
fn a_large_store_takes_traces_as_a_small_one_does() {
    const SYNTHETIC: usize = 450;
    const FILES: [&str; 4] = ["a.mcap", "b.mcap", "c.mcap", "d.mcap"];
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name);
    let variants: Vec<PathBuf> = (0..4)
        .map(|variant| {
            let mut play = success("oracle", Family::FDP, variant / 2);
            if variant % 2 == 1 {
                play = play.thinking(Default::default());
            }
            play.record_as(&path(&format!("variant-{variant}")), Images::None)
        })
        .collect();
    let mut small = Store::open_or_create(path("small")).unwrap();
    let mut large = Store::open_or_create(path("large")).unwrap();
    let play = success("oracle", Family::FDP, 1);
    reel_tables::synthesize(
        &mut large,
        &[play.task.into()],
        &play.scene,
        SYNTHETIC as u64,
        1,
        |_| (),
    )
    .unwrap();
    let synthetic = traces(&large);
    let mut random = 7_u64;
    let mut draw = |below: usize| {
        random = random
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (random >> 33) as usize % below
    };
    let rounds = if reel_vectors::is_long() { 40 } else { 12 };
    for round in 0..rounds {
        let (one, other) = (path(FILES[draw(4)]), path(FILES[draw(4)]));
        match draw(6) {
            0 | 1 => drop(fs::copy(&variants[draw(4)], &one).unwrap()),
            2 => drop(fs::rename(&one, &other)),
            3 => drop(fs::copy(&one, &other)),
            4 => {
                let between = path("between");
                for (from, to) in [(&one, &between), (&other, &one), (&between, &other)] {
                    drop(fs::rename(from, to));
                }
            }
            _ => drop(fs::remove_file(&one)),
        }
        let there: Vec<PathBuf> = FILES
            .iter()
            .map(|name| path(name))
            .filter(|path| path.exists() && draw(4) > 0)
            .collect();
        let before = [small.version(), large.version()];
        assert_eq!(
            ingest(&mut small, &there),
            ingest(&mut large, &there),
            "round {round}"
        );
        assert_eq!(
            small.version() == before[0],
            large.version() == before[1],
            "round {round}: whether there was anything to commit"
        );
        let mut held = traces(&large);
        held.retain(|trace| !synthetic.contains(trace));
        assert_eq!(held, traces(&small), "round {round}");
        assert_eq!(
            rows(&large, Table::Episodes),
            SYNTHETIC + rows(&small, Table::Episodes)
        );
    }
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
