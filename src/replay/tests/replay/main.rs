//! Replay proves what it says: recorded episodes are exact in any order, and no changed
//! trace is ever exact.

mod cameras;
mod explain;
mod forgeries;
mod golden;
mod meshes;
mod motion;
mod mutations;
mod published;
mod restore;

use reel_vectors::episodes;
use std::fs;

use reel_replay::{FileVerdict, Verdict, verify, verify_all, verify_trace};
use reel_trace::{Images, Trace};
use reel_world::{Digest, record::Backend};

use episodes::{record, tasks};

#[test]
fn what_was_recorded_is_exact_in_any_order_and_on_any_number_of_workers() {
    let folder = tempfile::tempdir().unwrap();
    let mut paths = Vec::new();
    for (index, task) in tasks().iter().enumerate() {
        let policy = if index % 2 == 0 {
            "oracle"
        } else {
            "gibberish"
        };
        let images = if index < 2 {
            Images::Full
        } else {
            Images::None
        };
        paths.push(record(
            &folder.path().join(format!("{index}.mcap")),
            task,
            policy,
            images,
        ));
    }
    let one_by_one: Vec<FileVerdict> = verify_all(
        &reel_trace::TraceFiles::default(),
        &paths,
        &reel_world::NoAssets,
        1,
        |_, _| {},
    );
    assert!(
        one_by_one.iter().all(|one| one.verdict.is_exact()),
        "{one_by_one:#?}"
    );
    for (path, judged) in paths.iter().zip(&one_by_one) {
        assert_eq!(judged.file, Some(Digest::of(&fs::read(path).unwrap())));
        assert_eq!(judged.trace, Some(Trace::read(path).unwrap().chain()));
    }
    let shuffled: Vec<_> = [2, 0, 3, 1].map(|index: usize| paths[index].clone()).into();
    let verdicts = verify_all(
        &reel_trace::TraceFiles::default(),
        &shuffled,
        &reel_world::NoAssets,
        2,
        |_, _| {},
    );
    assert_eq!(
        verdicts,
        [2, 0, 3, 1].map(|index: usize| one_by_one[index].clone())
    );

    let again = record(
        &folder.path().join("again.mcap"),
        &tasks()[0],
        "oracle",
        Images::Full,
    );
    assert!(
        fs::read(&again).unwrap() == fs::read(&paths[0]).unwrap(),
        "the same episode has other bytes"
    );
}

#[test]
fn what_cannot_be_replayed_is_said_to_be_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = record(
        &folder.path().join("a.mcap"),
        &tasks()[0],
        "oracle",
        Images::None,
    );
    let trace = Trace::read(&path).unwrap();
    let mut other = trace.clone();
    other.header.sim_version += 1;
    let (recorded, this) = (other.header.sim_version, trace.header.sim_version);
    let changes = Vec::new();
    assert_eq!(
        verify_trace(&other),
        Verdict::OtherSimulator {
            recorded,
            current: this,
            changes
        }
    );
    let mut robot = trace;
    robot.header.backend = Backend::Robot;
    assert_eq!(
        verify_trace(&robot).to_string(),
        "not replayable: recorded on a robot: nothing to re-execute"
    );
    assert!(matches!(
        verify(&folder.path().join("none.mcap")),
        Verdict::Refused { .. }
    ));
}
