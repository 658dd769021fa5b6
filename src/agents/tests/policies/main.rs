//! Every built-in policy in a flat without physics: what it calls, and what comes of it.

#![allow(
    clippy::disallowed_methods,
    reason = "tests read files and the environment and use threads; what is recorded does not"
)]

mod flat;
mod injection;

use std::sync::Arc;

use reel_agents::{POLICIES, Policy, policy};
use reel_world::{DoorState, ErrorCode, FLOOR, HORIZON, InstanceId, PlanStep, Task, ToolSpec};

use flat::{Flat, scene, task};

fn by_name(name: &str, flat: &Flat, seed: u64) -> Box<dyn Policy + Send> {
    policy(name, &flat.task, &flat.scene, seed).unwrap()
}

fn played(name: &str, task: Task, seed: u64) -> Flat {
    let mut flat = Flat::new(task, scene());
    let mut policy = by_name(name, &flat, seed);
    flat.play(policy.as_mut());
    flat
}

fn tables() -> Task {
    task(&scene(), "table_1", "desk_1", false)
}

fn fridge() -> Task {
    task(&scene(), "table_1", "fridge_1", false)
}

fn fuzzy() -> Task {
    task(&scene(), "table_1", "desk_1", true)
}

#[test]
fn the_oracle_follows_algorithm_2() {
    let flat = played("oracle", tables(), 1);
    let expected =
        "nav_to show_object_by_category gaze_at pick nav_to show_receptacles place finish";
    assert_eq!(flat.names().join(" "), expected);
    assert!(flat.success());
}

#[test]
fn the_oracle_follows_the_published_plan_with_its_detours() {
    let mut task = tables();
    let step = |action: &str, value: &str| {
        let key = if ["find", "gaze_at", "pick"].contains(&action) {
            "target_category"
        } else {
            "receptacle_name"
        };
        PlanStep {
            action: action.into(),
            args: [(key.to_owned(), value.into())].into(),
        }
    };
    task.plan = [
        ("nav_to", "table_2"),
        ("nav_to", "table_1"),
        ("find", "apple"),
        ("gaze_at", "apple"),
        ("pick", "apple"),
    ]
    .into_iter()
    .chain([
        ("nav_to", "desk_2"),
        ("nav_to", "desk_1"),
        ("place", "desk_1"),
    ])
    .map(|(action, value)| step(action, value))
    .collect();
    let flat = played("oracle", task, 1);
    let expected = "nav_to nav_to show_object_by_category gaze_at pick nav_to nav_to show_receptacles place finish";
    assert_eq!(flat.names().join(" "), expected);
    assert!(flat.success());
}

/// A plan from table to desk with these questions: before which step, and the words,
/// if they are fixed.
fn with_questions(mut task: Task, questions: &[(usize, Option<&str>)]) -> Task {
    let step = |action: &str, key: &str, value: &str| PlanStep {
        action: action.into(),
        args: [(key.to_owned(), value.into())].into(),
    };
    let seek = ["find", "gaze_at", "pick"].map(|action| step(action, "target_category", "apple"));
    task.plan = vec![step("nav_to", "receptacle_name", "table_1")];
    task.plan.extend(seek);
    task.plan
        .extend(["nav_to", "place"].map(|action| step(action, "receptacle_name", "desk_1")));
    for (index, question) in questions.iter().rev() {
        let mut ask = step("ask", "about", "object");
        ask.args
            .extend(question.map(|question| ("question".to_owned(), question.into())));
        task.plan.insert(*index, ask);
    }
    task
}

fn asked(flat: &Flat) -> Vec<&str> {
    flat.log
        .iter()
        .filter_map(|(call, _)| call.arguments.get("question")?.as_str())
        .collect()
}

#[test]
fn the_oracle_asks_what_the_plan_says_and_nothing_by_habit() {
    let flat = played(
        "oracle",
        with_questions(fuzzy(), &[(0, Some("Which desk?"))]),
        1,
    );
    assert_eq!(
        flat.names().join(" "),
        "ask nav_to show_object_by_category gaze_at pick nav_to show_receptacles place finish"
    );
    assert_eq!(asked(&flat), ["Which desk?"]);
    assert!(flat.success());
}

#[test]
fn a_question_without_words_is_asked_once_after_all_was_seen() {
    let flat = played(
        "oracle",
        with_questions(fuzzy(), &[(0, Some("Which desk?")), (2, None)]),
        1,
    );
    let names = flat.names();
    let at = |name: &str| names.iter().rposition(|known| *known == name).unwrap();
    assert!(
        at("show_object_by_category") < at("ask")
            && at("ask") < at("gaze_at")
            && at("gaze_at") < at("pick"),
        "{names:?}"
    );
    let asked = asked(&flat);
    assert_eq!((asked.len(), asked[0]), (2, "Which desk?"));
    assert!(
        asked[1].contains("green pear") && asked[1].contains("fruit"),
        "{asked:?}"
    );
    assert_eq!(
        names.iter().filter(|name| **name == "gaze_at").count(),
        1,
        "who was told does not try the others: {names:?}"
    );
    assert!(flat.success());
    assert!(
        !played(
            "no-ask",
            with_questions(fuzzy(), &[(0, Some("Which desk?")), (2, None)]),
            1
        )
        .names()
        .contains(&"ask")
    );
}

#[test]
fn a_failed_call_loses_no_question_of_the_plan() {
    let task = with_questions(tables(), &[(4, Some("Which desk?"))]);
    let mut flat = Flat::new(task, scene());
    flat.bad_grips = 2;
    let mut policy = by_name("oracle", &flat, 1);
    flat.play(policy.as_mut());
    assert_eq!(asked(&flat), ["Which desk?"]);
    assert!(flat.success());
}

#[test]
fn a_hidden_target_is_searched_among_shuffled_candidates() {
    let search = |seed| {
        let mut flat = Flat::new(tables(), scene());
        flat.hidden.insert(flat.task.target.clone());
        let mut policy = by_name("oracle", &flat, seed);
        flat.play(policy.as_mut());
        assert!(flat.success());
        let names = flat.names().join(" ");
        assert!(
            names.starts_with("nav_to show_object_by_category walk_around gaze_at"),
            "{names}"
        );
        flat.names()
            .iter()
            .filter(|name| **name == "gaze_at")
            .count()
    };
    let gazes: Vec<usize> = (0..20).map(search).collect();
    assert!(gazes.contains(&1) && gazes.contains(&2), "{gazes:?}");
    assert!(
        gazes.iter().all(|gazes| *gazes <= 2),
        "only the two apples are candidates: {gazes:?}"
    );
}

#[test]
fn the_oracle_asks_once_after_it_saw_the_candidates_and_before_it_picks() {
    let flat = played("oracle", fuzzy(), 1);
    let names = flat.names();
    let at = |name: &str| names.iter().position(|known| *known == name).unwrap();
    assert_eq!(names.iter().filter(|name| **name == "ask").count(), 1);
    assert!(at("show_object_by_category") < at("ask") && at("ask") < at("pick"));
    let question = flat.log[at("ask")].0.arguments["question"]
        .as_str()
        .unwrap();
    assert!(
        question.contains("green pear") && question.contains("fruit") && !question.contains("_on_"),
        "{question}"
    );
    assert!(flat.success());
    assert!(!played("oracle", tables(), 1).names().contains(&"ask"));
}

#[test]
fn the_oracle_opens_and_closes_doors() {
    let flat = played("oracle", fridge(), 1);
    let expected = "nav_to show_receptacles open nav_to show_object_by_category gaze_at pick nav_to show_receptacles place close finish";
    assert_eq!(flat.names().join(" "), expected);
    assert!(flat.success() && flat.graph == flat.task.goal);
    let flat = played("oracle", task(&scene(), "fridge_1", "desk_1", false), 1);
    assert!(
        flat.success() && flat.graph == flat.task.goal,
        "{:?}",
        flat.names()
    );
}

#[test]
fn the_oracle_recovers_and_knows_when_to_stop() {
    let mut flat = Flat::new(tables(), scene());
    flat.bad_grips = 2;
    let mut oracle = by_name("oracle", &flat, 1);
    flat.play(oracle.as_mut());
    assert!(flat.success() && flat.finished);

    let mut flat = Flat::new(tables(), scene());
    flat.bad_grips = 1000;
    let mut oracle = by_name("oracle", &flat, 1);
    flat.play(oracle.as_mut());
    assert!(!flat.success() && flat.finished && flat.log.len() < HORIZON as usize);
    assert!(oracle.gave_up().unwrap().contains("out_of_reach"));

    let mut flat = Flat::new(tables(), scene());
    flat.slippery.insert(flat.task.target.clone());
    let mut oracle = by_name("oracle", &flat, 1);
    flat.play(oracle.as_mut());
    assert!(flat.finished && oracle.gave_up().unwrap().contains("floor"));
    assert!(flat.graph.objects_on_floor().contains(&flat.task.target));
}

#[test]
fn what_is_out_of_reach_from_the_start_is_named_at_once() {
    let mut flat = Flat::new(task(&scene(), "table_1", "lid_1", false), scene());
    let mut oracle = by_name("oracle", &flat, 1);
    flat.play(oracle.as_mut());
    assert_eq!(flat.names(), ["finish"]);
    assert!(
        oracle
            .gave_up()
            .unwrap()
            .ends_with("nothing can be placed on lid_1")
    );

    let mut flat = Flat::new(tables(), scene());
    let target = flat.task.target.clone();
    flat.graph.remove(&"table_1".into(), &target);
    flat.graph.add(&FLOOR.into(), &target);
    let mut oracle = by_name("oracle", &flat, 1);
    flat.play(oracle.as_mut());
    assert_eq!(flat.names(), ["finish"]);
}

#[test]
fn the_planner_finds_the_way_without_the_truth() {
    for (name, task) in [
        ("tables", tables()),
        ("fridge", fridge()),
        ("fuzzy", fuzzy()),
    ] {
        let flat = played("planner", task, 1);
        assert!(flat.success() && flat.finished, "{name}: {:?}", flat.log);
    }
    let other_way = played("planner", task(&scene(), "table_2", "desk_2", false), 1);
    assert!(other_way.success(), "{:?}", other_way.log);
    let out_of_fridge = played("planner", task(&scene(), "fridge_1", "desk_1", false), 1);
    assert!(out_of_fridge.success(), "{:?}", out_of_fridge.log);
    assert_eq!(
        out_of_fridge.graph.door(&"fridge_1".into()),
        Some(DoorState::Closed)
    );
    assert!(played("planner", fuzzy(), 1).names().contains(&"ask"));
    assert!(!played("planner", tables(), 1).names().contains(&"ask"));
}

#[test]
fn the_planner_walks_around_for_what_is_hidden() {
    let mut flat = Flat::new(fuzzy(), scene());
    flat.hidden = flat
        .task
        .objects
        .iter()
        .map(|object| object.instance.clone())
        .collect();
    let mut planner = by_name("planner", &flat, 1);
    flat.play(planner.as_mut());
    assert!(flat.success(), "{:?}", flat.log);
    assert!(flat.names().contains(&"walk_around"));
}

#[test]
fn the_wrong_object_is_a_similar_one() {
    for seed in 0..10 {
        let flat = played("wrong-object", tables(), seed);
        let moved: Vec<InstanceId> = flat.graph.objects_on(&"desk_1".into());
        assert!(
            ["green", "pear"].contains(&moved[0].asset().as_str()),
            "{moved:?}"
        );
        assert!(!flat.success() && flat.finished);
    }
    let mut alone = tables();
    alone
        .objects
        .retain(|object| object.instance == alone.target);
    alone.initial = Task::initial_graph(&scene(), &alone.objects);
    alone.goal = alone.initial.clone();
    alone.goal.remove(&"table_1".into(), &alone.target.clone());
    alone.goal.add(&"desk_1".into(), &alone.target.clone());
    let flat = played("wrong-object", alone, 1);
    assert!(
        flat.log
            .iter()
            .any(|(call, error)| call.name == "place" && *error == Some(ErrorCode::NothingHeld))
    );
    assert!(flat.finished && !flat.success());
}

#[test]
fn the_wrong_receptacle_is_a_similar_one() {
    let flat = played("wrong-receptacle", tables(), 3);
    assert_eq!(
        flat.graph
            .receptacle_of(&flat.task.target)
            .map(|id| id.as_str()),
        Some("desk_2")
    );
    assert!(flat.finished);
    assert!(!played("wrong-receptacle", fridge(), 3).success());
}

#[test]
fn no_ask_never_asks() {
    let ends: Vec<bool> = (0..20)
        .map(|seed| played("no-ask", fuzzy(), seed))
        .map(|flat| {
            assert!(!flat.names().contains(&"ask") && flat.finished);
            flat.success()
        })
        .collect();
    assert!(
        ends.contains(&true) && ends.contains(&false),
        "any object that fits may be taken: {ends:?}"
    );
    let flat = played("no-ask", tables(), 1);
    assert!(flat.success() && !flat.names().contains(&"show_object_by_category"));
}

#[test]
fn oscillating_drives_to_and_fro_after_the_pick() {
    let flat = played("oscillating", tables(), 1);
    assert_eq!(flat.log.len(), HORIZON as usize);
    let after = &flat.names()[4..];
    assert!(after.iter().all(|name| *name == "nav_to"));
    assert_ne!(flat.log[10].0, flat.log[11].0);
    assert_eq!(flat.log[10].0, flat.log[12].0);
    assert!(flat.held.is_some());
}

#[test]
fn forgets_door_stands_before_a_closed_door() {
    let flat = played("forgets-door", fridge(), 1);
    assert!(!flat.names().contains(&"open") && !flat.success() && flat.finished);
    assert!(
        flat.log
            .iter()
            .any(|(_, error)| *error == Some(ErrorCode::DoorClosed))
    );
    assert!(played("forgets-door", tables(), 1).success());
}

#[test]
fn gibberish_goes_on_after_its_errors() {
    let flats: Vec<Flat> = (0..20)
        .map(|seed| played("gibberish", tables(), seed))
        .collect();
    assert!(flats.iter().all(|flat| flat.success() && flat.finished));
    let codes = |flat: &Flat| {
        flat.log
            .iter()
            .filter_map(|(_, error)| *error)
            .collect::<Vec<_>>()
    };
    let all: Vec<ErrorCode> = flats.iter().flat_map(codes).collect();
    for code in [
        ErrorCode::UnknownTool,
        ErrorCode::BadArguments,
        ErrorCode::UnknownReceptacle,
    ] {
        assert!(all.contains(&code), "{code} never came");
    }
}

#[test]
fn the_explorer_tries_every_tool_and_meets_every_error_the_flat_has() {
    let flats: Vec<Flat> = (0..40)
        .map(|seed| played("explorer", fridge(), seed))
        .collect();
    assert!(
        flats
            .iter()
            .all(|flat| flat.finished && flat.log.len() <= HORIZON as usize)
    );
    let calls: Vec<_> = flats.iter().flat_map(|flat| &flat.log).collect();
    for spec in ToolSpec::POLICY {
        for name in [spec.paper_name, spec.repo_name] {
            assert!(
                calls
                    .iter()
                    .any(|(call, error)| call.name == name && error.is_none()),
                "{name} never came to anything"
            );
        }
    }
    let codes = [
        ErrorCode::UnknownTool,
        ErrorCode::BadArguments,
        ErrorCode::UnknownReceptacle,
        ErrorCode::UnknownMarker,
        ErrorCode::NothingFound,
        ErrorCode::NotGraspable,
        ErrorCode::NotASurface,
        ErrorCode::AlreadyHolding,
        ErrorCode::NothingHeld,
        ErrorCode::NoDoor,
        ErrorCode::DoorClosed,
    ];
    for code in codes {
        assert!(
            calls.iter().any(|(_, error)| *error == Some(code)),
            "{code} never came"
        );
    }
    let other = Task {
        task_id: "another".into(),
        ..fridge()
    };
    assert_ne!(
        flats[0].log,
        played("explorer", other, 0).log,
        "the task must change what is tried"
    );
}

#[test]
fn every_policy_repeats_itself_and_ends_whatever_happens() {
    let tasks = [
        tables(),
        fridge(),
        fuzzy(),
        task(&scene(), "fridge_1", "desk_2", true),
        task(&scene(), "table_2", "lid_1", false),
    ];
    for (name, _) in POLICIES {
        for task in &tasks {
            for grips in [0, 3] {
                let play = || {
                    let mut flat = Flat::new(task.clone(), scene());
                    flat.bad_grips = grips;
                    let mut policy = by_name(name, &flat, 5);
                    assert_eq!(policy.info().name, *name);
                    flat.play(policy.as_mut());
                    flat
                };
                let flat = play();
                assert_eq!(flat.log, play().log, "{name}");
                assert!(flat.finished || flat.log.len() == HORIZON as usize);
            }
        }
    }
}

#[test]
fn an_unknown_name_lists_the_known_ones() {
    let scene = scene();
    let error = policy("clever", &Arc::new(tables()), &scene, 0)
        .err()
        .unwrap()
        .to_string();
    assert!(
        error.starts_with(
            "no policy is called 'clever'; known are oracle, planner, planner-words, wrong-object"
        ),
        "{error}"
    );
}
