//! Sessions at work: equal to what a runner records, whoever is put aside when, and
//! whatever breaks next door.

use reel_vectors::episodes;
use std::{
    path::Path,
    sync::{Arc, Mutex},
    time::Duration,
};

use reel_live::{Host, Lease, Limits, LiveError, Owner, PreparedTaskCache, SessionPool, Setup};
use reel_replay::verify;
use reel_reward::Preset;
use reel_tasks::home_scene;
use reel_trace::{Images, Trace};
use reel_world::{
    Profile, Skills, ToolCall,
    record::{EndReason, StepInput},
};
use serde_json::json;
use tempfile::TempDir;

fn setup(folder: &Path) -> Setup {
    Setup {
        tasks: episodes::tasks().to_vec(),
        scenes: Arc::new(home_scene()).into(),
        meshes: reel_world::Meshes::default(),
        seed: 3,
        profile: Profile::Paper,
        skills: Skills::Perfect,
        preset: Preset::paper(),
        run_id: "live".to_owned(),
        folder: folder.to_owned(),
        answer_settings: Default::default(),
        options: Images::None.into(),
        host: Host::default(),
        stages: PreparedTaskCache::default(),
        on_finished: Default::default(),
    }
}

fn limits() -> Limits {
    Limits {
        sessions: 8,
        sessions_each: 2,
        in_memory: 8,
        workers: 2,
        suspend_after: Duration::from_secs(60),
        close_after: Duration::from_secs(600),
        worker_timeout: Duration::from_secs(60),
    }
}

fn call(name: &str) -> StepInput {
    StepInput::from_call(ToolCall::new(name, json!({})))
}

fn traces(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut found: Vec<_> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    found.retain(|path| {
        path.file_name()
            .is_some_and(|name| name.to_string_lossy().starts_with("live--"))
    });
    found.sort();
    found
}

/// What the oracle does in the first task.
fn oracle_calls(folder: &Path) -> Vec<StepInput> {
    let path = episodes::record(
        &folder.join("oracle.mcap"),
        &episodes::tasks()[0],
        "oracle",
        Images::None,
    );
    Trace::read(&path)
        .unwrap()
        .steps
        .into_iter()
        .map(|step| step.input)
        .collect()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn however_few_may_be_awake_the_episodes_are_the_same() {
    let folder = TempDir::new().unwrap();
    let calls = oracle_calls(folder.path());
    let mut links = Vec::new();
    for awake in [8, 1] {
        let traced = folder.path().join(format!("awake-{awake}"));
        let pool = Arc::new(SessionPool::new(
            setup(&traced),
            Limits {
                in_memory: awake,
                ..limits()
            },
        ));
        let names = ["a", "b", "c"];
        for name in names {
            pool.open(name, &Owner::default()).unwrap();
            pool.with_session(name, |session| session.begin_next())
                .await
                .unwrap()
                .unwrap()
                .unwrap();
        }
        // In turns, so that each is put aside before each of its calls where only one may be awake.
        for input in &calls {
            for name in names {
                let input = input.clone();
                let made = pool
                    .with_session(name, move |session| session.call(input))
                    .await
                    .unwrap()
                    .unwrap();
                assert_eq!(
                    made.ended.is_some(),
                    made.step.step as usize + 1 == calls.len()
                );
            }
            let playing = pool
                .entries()
                .iter()
                .filter(|entry| entry.state.state == "playing")
                .count();
            assert!(playing <= awake, "{playing} are awake of {awake}");
        }
        let states: Vec<_> = pool
            .entries()
            .into_iter()
            .map(|entry| (entry.state.state, entry.state.ended.unwrap().success))
            .collect();
        assert_eq!(states, [("ended", true); 3]);
        let paths = traces(&traced);
        assert_eq!(paths.len(), 3);
        let read: Vec<Trace> = paths
            .iter()
            .map(|path| Trace::read(path).unwrap())
            .collect();
        for path in &paths {
            assert!(
                verify(path).is_exact(),
                "{}: {}",
                path.display(),
                verify(path)
            );
        }
        let ids: std::collections::BTreeSet<&str> = read
            .iter()
            .map(|trace| trace.header.episode_id.as_str())
            .collect();
        assert_eq!(
            ids.len(),
            3,
            "two sessions that do the same are two episodes"
        );
        links.push(read.iter().map(|trace| trace.chain()).collect::<Vec<_>>());
    }
    assert_eq!(links[0], links[1]);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_is_left_ends_as_aborted_and_what_was_played_is_over() {
    let folder = TempDir::new().unwrap();
    let pool = Arc::new(SessionPool::new(setup(folder.path()), limits()));
    let finished = Arc::new(Mutex::new(Vec::new()));
    let observed = Arc::clone(&finished);
    pool.setup().on_finished.set(move |trace| {
        // It is whole by then.
        observed
            .lock()
            .unwrap()
            .push(Trace::read(trace).unwrap().steps.len());
    });
    pool.open("a", &Owner::default()).unwrap();
    let none = pool
        .with_session("a", |session| session.call(call("walk_around")))
        .await
        .unwrap();
    assert!(matches!(none, Err(LiveError::NoEpisode)), "{none:?}");
    let begun = pool
        .with_session("a", |session| session.begin("nobody's task"))
        .await
        .unwrap();
    assert!(matches!(begun, Err(LiveError::UnknownTask(_))), "{begun:?}");
    let last = episodes::tasks()[3].task_id.clone();
    pool.with_session("a", move |session| session.begin(&last))
        .await
        .unwrap()
        .unwrap();
    pool.with_session("a", |session| session.call(call("walk_around")))
        .await
        .unwrap()
        .unwrap();
    // It was the last of the list: nothing comes after it.
    assert!(
        pool.with_session("a", |session| session.begin_next())
            .await
            .unwrap()
            .unwrap()
            .is_none()
    );
    let state = pool.close("a").await.unwrap();
    let trace = Trace::read(&state.trace.unwrap()).unwrap();
    assert_eq!(
        (trace.end.unwrap().reason, trace.steps.len()),
        (EndReason::Aborted, 1)
    );
    assert!(matches!(pool.close("a").await, Err(LiveError::Unknown(_))));

    pool.open("b", &Owner::default()).unwrap();
    pool.with_session("b", |session| session.begin_next())
        .await
        .unwrap()
        .unwrap()
        .unwrap();
    let made = pool
        .with_session("b", |session| session.call(call("finish")))
        .await
        .unwrap()
        .unwrap();
    assert_eq!(made.ended, Some(EndReason::Finished));
    assert_eq!(*finished.lock().unwrap(), [1, 1]);
    let after = pool
        .with_session("b", |session| session.call(call("walk_around")))
        .await
        .unwrap();
    assert!(
        matches!(after, Err(LiveError::Over(EndReason::Finished))),
        "{after:?}"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_panic_in_one_session_leaves_the_others_alone_and_its_trace_whole() {
    let folder = TempDir::new().unwrap();
    let pool = Arc::new(SessionPool::new(setup(folder.path()), limits()));
    for name in ["broken", "whole"] {
        pool.open(name, &Owner::default()).unwrap();
        pool.with_session(name, |session| session.begin_next())
            .await
            .unwrap()
            .unwrap()
            .unwrap();
        pool.with_session(name, |session| session.call(call("walk_around")))
            .await
            .unwrap()
            .unwrap();
    }
    let broken = pool
        .with_session("broken", |session| {
            session.inject_failure("the roof fell in")
        })
        .await;
    assert!(
        matches!(&broken, Err(LiveError::Broken(why)) if why.contains("the roof fell in")),
        "{broken:?}"
    );
    assert_eq!(pool.entry("broken").unwrap().state.state, "failed");
    let after = pool
        .with_session("broken", |session| session.call(call("walk_around")))
        .await
        .unwrap();
    assert!(matches!(after, Err(LiveError::Broken(_))), "{after:?}");
    pool.with_session("whole", |session| session.call(call("finish")))
        .await
        .unwrap()
        .unwrap();
    // The next episode begins as if nothing had been, and what was done before is a trace.
    pool.with_session("broken", |session| session.begin_next())
        .await
        .unwrap()
        .unwrap()
        .unwrap();
    let state = pool.entry("broken").unwrap().state;
    let trace = Trace::read(&state.trace.unwrap()).unwrap();
    assert_eq!(
        (trace.end.unwrap().reason, trace.steps.len()),
        (EndReason::Aborted, 1)
    );
    pool.close_all().await;
    for path in traces(folder.path()) {
        assert!(
            verify(&path).is_exact(),
            "{}: {}",
            path.display(),
            verify(&path)
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_prompt_group_plays_one_task_so_many_times() {
    let folder = TempDir::new().unwrap();
    let pool = Arc::new(SessionPool::new(setup(folder.path()), limits()));
    let task_id = episodes::tasks()[1].task_id.clone();
    let lease = Lease {
        group_id: "group-1".to_owned(),
        task_id: task_id.clone(),
        seed: 11,
        rollouts: 3,
    };
    pool.open_for("w-trainer", &Owner::default(), Some(lease.clone()))
        .unwrap();
    pool.open("w-trainer", &Owner::default()).unwrap();
    let other = pool.open_for(
        "w-trainer",
        &Owner::default(),
        Some(Lease {
            rollouts: 4,
            ..lease.clone()
        }),
    );
    assert!(matches!(other, Err(LiveError::Taken(_))), "{other:?}");
    let unknown = pool.open_for(
        "w-2",
        &Owner::default(),
        Some(Lease {
            task_id: "x".to_owned(),
            ..lease
        }),
    );
    assert!(
        matches!(unknown, Err(LiveError::UnknownTask(_))),
        "{unknown:?}"
    );
    for index in 0..3 {
        let begun = pool
            .with_session("w-trainer", |session| session.begin_next())
            .await
            .unwrap()
            .unwrap()
            .unwrap();
        assert_eq!(
            (begun.task.task_id.as_str(), begun.number),
            (task_id.as_str(), index)
        );
        pool.with_session("w-trainer", |session| session.call(call("finish")))
            .await
            .unwrap()
            .unwrap();
    }
    assert!(
        pool.with_session("w-trainer", |session| session.begin_next())
            .await
            .unwrap()
            .unwrap()
            .is_none()
    );
    for (index, path) in (0..).zip(traces(folder.path())) {
        let trace = Trace::read(&path).unwrap();
        let header = &trace.header;
        assert_eq!(
            (
                header.group_id.as_deref(),
                header.rollout_index,
                header.seed
            ),
            (Some("group-1"), Some(index), 11)
        );
        assert!(verify(&path).is_exact(), "{}", verify(&path));
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_idle_are_put_aside_and_then_closed() {
    let folder = TempDir::new().unwrap();
    let (park_after, close_after) = (Duration::from_millis(50), Duration::from_millis(400));
    let pool = Arc::new(SessionPool::new(
        setup(folder.path()),
        Limits {
            suspend_after: park_after,
            close_after,
            sessions: 1,
            ..limits()
        },
    ));
    pool.open("a", &Owner::default()).unwrap();
    let full = pool.open("b", &Owner::default());
    assert!(matches!(full, Err(LiveError::Full(1))), "{full:?}");
    pool.with_session("a", |session| session.begin_next())
        .await
        .unwrap()
        .unwrap()
        .unwrap();
    tokio::time::sleep(park_after * 2).await;
    pool.reap_idle().await;
    assert_eq!(pool.entry("a").unwrap().state.state, "suspended");
    pool.with_session("a", |session| session.call(call("walk_around")))
        .await
        .unwrap()
        .unwrap();
    tokio::time::sleep(close_after).await;
    pool.reap_idle().await;
    assert!(pool.entries().is_empty());
    assert_eq!(
        Trace::read(&traces(folder.path())[0]).unwrap().steps.len(),
        1
    );
    for name in ["", "../up", "a/b", ".hidden", &"x".repeat(65)] {
        assert!(
            matches!(pool.open(name, &Owner::default()), Err(LiveError::Name(_))),
            "{name}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_call_that_finds_no_worker_in_time_was_not_made() {
    let folder = TempDir::new().unwrap();
    let pool = Arc::new(SessionPool::new(
        setup(folder.path()),
        Limits {
            workers: 1,
            worker_timeout: Duration::from_millis(100),
            ..limits()
        },
    ));
    pool.open("a", &Owner::default()).unwrap();
    pool.open("b", &Owner::default()).unwrap();
    let busy = {
        let pool = pool.clone();
        tokio::spawn(async move {
            pool.with_session("a", |_| std::thread::sleep(Duration::from_millis(400)))
                .await
        })
    };
    tokio::time::sleep(Duration::from_millis(50)).await;
    let refused = pool.with_session("b", |_| panic!("it has no worker")).await;
    assert!(
        matches!(refused, Err(LiveError::Busy(_))),
        "{:?}",
        refused.map(|_: ()| ())
    );
    busy.await.unwrap().unwrap();
    pool.with_session("b", |_| ()).await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_is_its_owners_and_nobody_has_more_than_their_share() {
    let folder = TempDir::new().unwrap();
    let pool = Arc::new(SessionPool::new(setup(folder.path()), limits()));
    let (one, other) = (Owner::named("one"), Owner::named("other"));
    pool.open("w-a", &one).unwrap();
    pool.open("w-b", &one).unwrap();
    pool.open("w-a", &one).unwrap();
    let many = pool.open("w-c", &one);
    assert!(matches!(many, Err(LiveError::Quota { limit: 2, .. })));
    let stranger = pool.open("w-a", &other);
    assert!(matches!(stranger, Err(LiveError::OtherOwner(_))));
    pool.open("w-c", &other).unwrap();
    pool.with_session("w-a", |session| session.begin_next())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(pool.entry("w-a").unwrap().owner.as_deref(), Some("one"));
    assert_eq!(pool.close_of(&one).await, 2);
    let left: Vec<String> = pool
        .entries()
        .into_iter()
        .map(|entry| entry.session)
        .collect();
    assert_eq!(left, ["w-c"]);
    let traces = std::fs::read_dir(folder.path()).unwrap().count();
    assert_eq!(traces, 1, "the episode that ran is a whole trace");
}
