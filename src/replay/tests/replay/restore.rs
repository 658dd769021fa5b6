//! From every call of an episode the future after a restore is that of the original, through bytes
//! and through the cache.

use std::{collections::BTreeSet, fs};

use rayon::prelude::*;
use reel_replay::{SnapshotCache, frames_at, seek, verify_restored};
use reel_trace::{Images, Trace};

use crate::episodes::{record, tasks};

#[test]
fn restored_after_every_call_the_rest_is_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let policies = ["oracle", "gibberish", "forgets-door", "wrong-receptacle"];
    let played: Vec<(usize, &str)> = (0..tasks().len())
        .flat_map(|task| policies.iter().map(move |policy| (task, *policy)))
        .collect();
    let restored: usize = played
        .par_iter()
        .map(|(task, policy)| {
            let path = record(
                &folder.path().join(format!("{task}-{policy}.mcap")),
                &tasks()[*task],
                policy,
                Images::None,
            );
            let trace = Trace::read(&path).unwrap();
            let calls: Vec<usize> = (0..=trace.steps.len()).collect();
            let verdict = verify_restored(&trace, &calls);
            assert!(verdict.is_exact(), "task {task}, {policy}: {verdict}");
            calls.len()
        })
        .sum();
    eprintln!("restored {restored} times in {} episodes", played.len());
    assert!(restored > 100, "{restored}");
}

#[test]
fn seeking_gives_the_same_bits_from_the_start_from_the_cache_and_past_a_damaged_cache() {
    let folder = tempfile::tempdir().unwrap();
    let path = record(
        &folder.path().join("a.mcap"),
        &tasks()[2],
        "oracle",
        Images::None,
    );
    let trace = Trace::read(&path).unwrap();
    let cache = SnapshotCache::at(&folder.path().join("cache"));
    let last = trace.steps.len();
    for calls in [0, 1, last / 2, last] {
        let expected = if calls == 0 {
            &trace.start.digests
        } else {
            &trace.steps[calls - 1].digests
        }
        .state;
        for use_cache in [None, Some(&cache), Some(&cache)] {
            let replay = seek(&trace, calls, use_cache).unwrap();
            assert_eq!(
                (replay.calls(), replay.episode().simulator().digest()),
                (calls, expected)
            );
            assert!(replay.finish(|_, _| {}).unwrap().is_exact());
        }
    }
    for file in fs::read_dir(folder.path().join("cache")).unwrap() {
        let path = file.unwrap().path();
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 4;
        fs::write(&path, bytes).unwrap();
    }
    assert!(cache.get(&trace, 1).is_none());
    assert!(
        seek(&trace, last / 2, Some(&cache))
            .unwrap()
            .finish(|_, _| {})
            .unwrap()
            .is_exact()
    );
    assert!(
        cache.get(&trace, last / 2).is_some(),
        "a damaged snapshot is not made again"
    );
    assert!(seek(&trace, last + 1, None).is_err());
}

#[test]
fn images_drawn_again_are_those_that_were_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let [full, lean] = [Images::Full, Images::None].map(|images| {
        let path = record(
            &folder.path().join(format!("{images:?}.mcap")),
            &tasks()[0],
            "oracle",
            images,
        );
        Trace::read(&path).unwrap()
    });
    assert!(full.image_count() > 0 && lean.image_count() == 0);
    let with_frame = full
        .steps
        .iter()
        .filter(|record| record.digests.frame.is_some())
        .map(|record| Some(record.step));
    let moments: BTreeSet<Option<u32>> = with_frame.step_by(2).chain([None]).collect();
    let recorded = frames_at(&full, &moments).unwrap();
    assert_eq!(
        recorded.keys().collect::<Vec<_>>(),
        moments.iter().collect::<Vec<_>>()
    );
    assert!(recorded == frames_at(&lean, &moments).unwrap());
    for trace in [&full, &lean] {
        let verdict = frames_at(trace, &BTreeSet::from([Some(999)])).unwrap_err();
        assert_eq!(
            verdict.to_string(),
            "REFUSED call 999 returned no image to the agent"
        );
    }
}
