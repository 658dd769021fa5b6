//! What comes from outside decides, is recorded, and is checked: a user who breaks rules, a matcher
//! who sees things otherwise, and nobody at all.

#![allow(
    clippy::disallowed_methods,
    reason = "tests read files and the environment and use threads; what is recorded does not"
)]

use std::sync::Arc;

use reel_agents::{
    AgentError, EpisodeReport, Matcher, RecordTo, ResponderError, Responders, USER_TRIES, User,
    policy, run_episode,
};
use reel_episode::{EpisodeConfig, user::UserQuestion};
use reel_reward::Preset;
use reel_tasks::{DrawOptions, draw, home_scene};
use reel_trace::{Images, Trace};
use reel_world::{
    ErrorCode, Family, Profile, Skills,
    record::{EndReason, Lookup, PolicyInfo, UserReply, UserSource},
};

/// Tells the robot an identifier of the computer so many times, and then nothing of use.
struct Blunt(usize);

impl User for Blunt {
    fn answer(&mut self, asked: &UserQuestion<'_>) -> Result<UserReply, ResponderError> {
        assert!(!asked.question.is_empty());
        let leaks = asked.refused.len() < self.0;
        let id = format!("Take {}.", asked.task.target);
        Ok(UserReply {
            text: if leaks { id } else { "How are you?".to_owned() },
            source: UserSource::Model,
        })
    }
}

struct Nobody;

impl User for Nobody {
    fn answer(&mut self, _: &UserQuestion<'_>) -> Result<UserReply, ResponderError> {
        Err(ResponderError::new("nobody is there"))
    }
}

/// Finds nothing like what was asked for.
struct Blind;

impl Matcher for Blind {
    fn look_up(&mut self, _: &str, categories: &[&str]) -> Result<Lookup, ResponderError> {
        assert!(
            categories.windows(2).all(|pair| pair[0] < pair[1]),
            "{categories:?}"
        );
        Ok(Lookup {
            categories: Vec::new(),
            source: "blind".to_owned(),
        })
    }
}

/// The oracle in a task in which it asks, with these outside.
fn play(outside: Responders, path: &std::path::Path) -> (Result<EpisodeReport, AgentError>, Trace) {
    let scene = home_scene();
    let mut tasks = draw(&DrawOptions {
        scene: &scene,
        families: &[Family::SUL],
        count: 1,
        seed: 7,
    })
    .tasks;
    let (task, scene) = (Arc::new(tasks.remove(0)), Arc::new(scene.clone()));
    let config = EpisodeConfig {
        task: task.clone(),
        scene: scene.clone(),
        seed: 0,
        profile: Profile::Paper,
        skills: Skills::Perfect,
        meshes: reel_world::Meshes::default(),
        preset: Preset::paper(),
        run_id: "outside".into(),
        policy: PolicyInfo::default(),
        rollout: None,
        parent: None,
    };
    let mut oracle = policy("oracle", &task, &scene, 0).unwrap();
    let to = RecordTo {
        path: path.to_owned(),
        options: Images::None.into(),
    };
    let report = run_episode(config, oracle.as_mut(), outside, Some(&to));
    (report, Trace::read(path).unwrap())
}

#[test]
fn what_comes_from_outside_decides_and_is_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let (report, trace) = play(
        Responders {
            user: Some(Box::new(Blunt(1))),
            ..Responders::default()
        },
        &folder.path().join("blunt.mcap"),
    );
    let report = report.unwrap();
    assert_eq!(report.broken_rules, ["not_goal_driven"]);
    assert!(report.refused_rules.contains(&"raw_id".to_owned()));
    let again = EpisodeReport::of_trace(&trace, &trace.path).unwrap();
    assert_eq!(again.broken_rules, report.broken_rules);
    assert_eq!(again.refused_rules, report.refused_rules);
    let told = trace
        .steps
        .iter()
        .find_map(|step| step.input.user_reply.as_ref())
        .unwrap();
    let answer = trace
        .steps
        .iter()
        .find_map(|step| step.reply.as_ref())
        .unwrap();
    assert_eq!((told, told.source), (answer, UserSource::Model));

    // Who cannot keep a secret is not listened to.
    let outside = Responders {
        user: Some(Box::new(Blunt(USER_TRIES))),
        ..Responders::default()
    };
    let (report, leaky) = play(outside, &folder.path().join("leaky.mcap"));
    let (_, alone) = play(Responders::default(), &folder.path().join("alone.mcap"));
    assert!(report.unwrap().broken_rules.is_empty());
    let asked = |trace: &Trace| {
        let step = trace.steps.iter().find(|step| step.reply.is_some());
        let step = step.unwrap();
        (
            step.reply.clone().unwrap(),
            step.input.refused_replies.len(),
        )
    };
    assert_eq!(asked(&leaky), (asked(&alone).0, USER_TRIES));
    assert_eq!(asked(&alone).1, 0);

    let outside = Responders {
        matcher: Some(Box::new(Blind)),
        ..Responders::default()
    };
    let (_, blind) = play(outside, &folder.path().join("blind.mcap"));
    let (_, seeing) = play(Responders::default(), &folder.path().join("seeing.mcap"));
    let shown = |trace: &Trace| {
        let step = trace
            .steps
            .iter()
            .find(|step| step.tool_name() == "show_object_by_category")
            .unwrap();
        (step.outcome.error, step.input.lookup.clone())
    };
    let nothing = Lookup {
        categories: Vec::new(),
        source: "blind".to_owned(),
    };
    assert_eq!(
        shown(&blind),
        (Some(ErrorCode::NothingFound), Some(nothing))
    );
    assert_eq!(shown(&seeing), (None, None));
}

#[test]
fn who_does_not_answer_ends_the_episode_and_what_was_done_stays() {
    let folder = tempfile::tempdir().unwrap();
    let (report, trace) = play(
        Responders {
            user: Some(Box::new(Nobody)),
            ..Responders::default()
        },
        &folder.path().join("nobody.mcap"),
    );
    let error = report.unwrap_err();
    assert!(
        matches!(&error, AgentError::NoAnswer { step, .. } if *step as usize == trace.steps.len()),
        "{error}"
    );
    assert!(!trace.steps.is_empty());
    assert_eq!(trace.end.as_ref().unwrap().reason, EndReason::Aborted);
}
