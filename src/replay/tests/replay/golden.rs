//! The old-log gate: every golden trace replays bit for bit, and together they hold what
//! an episode can hold.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

use reel_replay::{changes, corpus, verify_all};
use reel_trace::Trace;
use reel_world::{
    DoorState, ErrorCode, FLOOR, Family, GraphEvent, Profile, ToolSpec, record::EndReason,
};

/// No recorded episode of the simulator meets these; traces/golden/NOTES.md says why.
const UNREACHABLE: &[ErrorCode] = &[
    ErrorCode::NoUser,
    ErrorCode::BackendError,
    ErrorCode::EpisodeOver,
    ErrorCode::PhysicsFault,
];
const MOST_BYTES: u64 = 1_300_000;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../traces/golden")
}

#[test]
fn every_golden_trace_is_exact() {
    let paths = corpus(&folder()).unwrap();
    assert!(paths.len() >= 24, "{}", paths.len());
    for (path, verdict) in paths.iter().zip(verify_all(
        &reel_trace::TraceFiles::default(),
        &paths,
        &reel_world::NoAssets,
        2,
        |_, _| {},
    )) {
        assert!(
            verdict.verdict.is_exact(),
            "{}: {}\nif this change is meant: raise SIM_VERSION and `reel dev mint`",
            path.display(),
            verdict.verdict
        );
    }
}

#[test]
fn the_corpus_holds_what_an_episode_can_hold() {
    let paths = corpus(&folder()).unwrap();
    let bytes: u64 = paths
        .iter()
        .map(|path| fs::metadata(path).unwrap().len())
        .sum();
    assert!(bytes < MOST_BYTES, "{bytes} bytes");
    let traces: Vec<Trace> = paths
        .iter()
        .map(|path| Trace::read(path).unwrap())
        .collect();
    let (mut families, mut profiles, mut tools, mut codes) = (
        BTreeSet::new(),
        BTreeSet::new(),
        BTreeSet::new(),
        BTreeSet::new(),
    );
    let (mut doors, mut falls, mut ends) = (BTreeSet::new(), 0, BTreeSet::new());
    for trace in &traces {
        assert_eq!(
            trace.image_count(),
            0,
            "{} is not lean",
            trace.path.display()
        );
        families.insert(trace.header.family);
        profiles.insert(trace.header.profile.as_str());
        let floor = trace
            .start
            .graphs
            .physics
            .receptacles
            .iter()
            .find(|(id, _)| id.as_str() == FLOOR);
        falls += usize::from(floor.is_some_and(|(_, state)| !state.content.is_empty()));
        let end = trace.end.as_ref().unwrap();
        ends.insert((end.metrics.success, end.reason == EndReason::Horizon));
        for step in &trace.steps {
            match step.outcome.error {
                Some(code) => drop(codes.insert(code)),
                None => drop(tools.insert(step.tool_name().to_owned())),
            }
            for event in &step.changes.physics {
                if let GraphEvent::Door { to, .. } = event {
                    doors.insert(*to == DoorState::Open);
                }
            }
        }
    }
    assert_eq!(families, Family::ALL.into_iter().collect());
    assert_eq!(profiles, Profile::ALL.map(Profile::as_str).into());
    for spec in ToolSpec::POLICY {
        assert!(
            tools.contains(spec.paper_name),
            "no {} succeeds",
            spec.paper_name
        );
    }
    let missing: Vec<_> = ErrorCode::ALL
        .iter()
        .filter(|code| !codes.contains(code) && !UNREACHABLE.contains(code))
        .collect();
    assert!(missing.is_empty(), "never met: {missing:?}");
    assert_eq!(
        (doors.len(), falls > 0),
        (2, true),
        "doors opened and closed, things that fell"
    );
    assert!(
        [(true, false), (false, false), (false, true)]
            .iter()
            .all(|end| ends.contains(end)),
        "{ends:?}"
    );
}

#[test]
fn golden_traces_of_older_simulators_can_be_read_and_executed() {
    let mut old = 0;
    for entry in fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        if !path.is_dir()
            || !path
                .file_name()
                .is_some_and(|name| name.to_string_lossy().starts_with('v'))
        {
            continue;
        }
        for path in corpus(&path).unwrap() {
            changes(&Trace::read(&path).unwrap())
                .unwrap_or_else(|verdict| panic!("{}: {verdict}", path.display()));
            old += 1;
        }
    }
    eprintln!("{old} golden traces of older simulators");
}
