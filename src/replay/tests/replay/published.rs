//! Episodes of the published servers: they replay, and those that an older simulator recorded are
//! told apart from what diverges.

use reel_agents::{RecordTo, Responders, policy, run_episode};
use reel_replay::{Verdict, verify_trace};
use reel_sim::sim_version;
use reel_trace::{Images, Trace};
use reel_world::{Profile, record::EndReason};

use crate::episodes::{config, tasks};

#[test]
fn episodes_of_the_published_servers_reach_the_goal_and_replay() {
    let folder = tempfile::tempdir().unwrap();
    for (task, profile) in tasks()
        .iter()
        .flat_map(|task| [Profile::RealRepo, Profile::RealGspo].map(|profile| (task, profile)))
    {
        let path = folder
            .path()
            .join(format!("{}-{}.mcap", task.short_id(), profile.as_str()));
        let scene = std::sync::Arc::new(reel_tasks::home_scene());
        let mut oracle = policy("oracle", task, &scene, 3).unwrap();
        let config = reel_episode::EpisodeConfig {
            profile,
            ..config(task, &scene, 3)
        };
        let record = RecordTo {
            path: path.clone(),
            options: Images::None.into(),
        };
        run_episode(
            config,
            oracle.as_mut(),
            Responders::default(),
            Some(&record),
        )
        .unwrap();
        let trace = Trace::read(&path).unwrap();
        let end = trace.end.as_ref().unwrap();
        let said: Vec<_> = trace
            .steps
            .iter()
            .map(|step| format!("{}: {}", step.input.call, step.outcome.text))
            .collect();
        assert_eq!(
            end.reason,
            EndReason::Finished,
            "{}, {profile:?}: {said:#?}",
            task.task_id
        );
        for (graph, authority) in [
            (&end.graphs.registry, "registry"),
            (&end.graphs.physics, "physics"),
        ] {
            assert!(
                graph.difference(&task.goal).is_empty(),
                "{}, {profile:?}, {authority}: {said:#?}",
                task.task_id
            );
        }
        assert!(verify_trace(&trace).is_exact(), "{}", verify_trace(&trace));
    }
}

#[test]
fn a_trace_of_the_old_tools_is_of_another_simulator() {
    let folder = tempfile::tempdir().unwrap();
    let path = crate::episodes::record(
        &folder.path().join("a.mcap"),
        &tasks()[0],
        "oracle",
        Images::None,
    );
    let paper = Trace::read(&path).unwrap();
    assert_eq!(
        paper.header.sim_version, 5,
        "the paper's episodes changed last with the boxes of show_receptacles"
    );
    assert!(verify_trace(&paper).is_exact());
    let mut old = paper;
    old.header.profile = Profile::RealRepo;
    old.header.sim_version = 2;
    let verdict = verify_trace(&old);
    let Verdict::OtherSimulator {
        recorded: 2,
        current,
        changes,
    } = &verdict
    else {
        panic!("{verdict}")
    };
    assert_eq!(*current, sim_version(Profile::RealRepo));
    assert!(
        changes[0].starts_with("simulator 3: the published servers' tools"),
        "{changes:?}"
    );
}
