//! Whole tasks.

use std::{collections::BTreeMap, sync::Arc};

use reel_tasks::generate::{
    scene::{built_in, names},
    task::{
        Compatibility, DraftError, GenerateOptions, GenerateReport, Placing, Rejection, SceneSites,
        SettleError, TaskType, can_be_approached, compatibility, make, real, settle, spawn,
    },
};
use reel_tasks::{home_scene, library::objects};
use reel_world::{Family, ReceptacleId, Scene, Task};

pub(crate) fn made(scenes: &[Arc<Scene>], count: usize, seed: u64, jobs: usize) -> GenerateReport {
    let (families, types) = (&Family::ALL, &TaskType::ALL);
    let (library, table) = (objects(), Compatibility::committed());
    let placing = Placing::NearEdge;
    make(
        &GenerateOptions {
            scenes,
            library,
            table,
            families,
            types,
            count,
            seed,
            placing,
            jobs,
        },
        || {},
    )
    .unwrap()
}

/// The home, and the same seen in a mirror: two scenes.
fn scenes() -> Vec<Arc<Scene>> {
    let mut mirrored = home_scene();
    mirrored.scene_id = "mirrored".to_owned();
    let flip = |low: &mut f64, high: &mut f64| (*low, *high) = (13.5 - *high, 13.5 - *low);
    for room in &mut mirrored.rooms {
        flip(&mut room.min[0], &mut room.max[0]);
    }
    for receptacle in &mut mirrored.receptacles {
        flip(
            &mut receptacle.surface_min[0],
            &mut receptacle.surface_max[0],
        );
        receptacle.facing_deg = receptacle.facing_deg.map(|degrees| 180.0 - degrees);
    }
    mirrored.robot_start = mirrored
        .robot_start
        .map(|[x, y, yaw]| [13.5 - x, y, std::f64::consts::PI - yaw]);
    vec![Arc::new(home_scene()), Arc::new(mirrored)]
}

#[test]
fn the_same_tasks_on_any_number_of_threads_and_more_begin_with_the_fewer() {
    let scenes = scenes();
    let made_once = made(&scenes, 48, 3, 1);
    assert_eq!(made_once, made(&scenes, 48, 3, 3));
    let more = made(&scenes, 96, 3, 2).tasks;
    assert!(made_once.tasks.iter().all(|task| more.contains(task)));
    assert_ne!(made_once.tasks[0], made(&scenes, 48, 4, 2).tasks[0]);
}

#[test]
fn families_scenes_and_types_take_turns() {
    let scenes = scenes();
    let made = made(&scenes, 240, 1, 2);
    assert_eq!(made.tasks.len(), 240, "{:?}", made.statistics);
    let mut counts: BTreeMap<(Family, &str), usize> = BTreeMap::new();
    for (scene, task) in &made.tasks {
        assert_eq!(task.scene_id, scenes[*scene].scene_id);
        *counts
            .entry((task.family, task.task_type.as_deref().unwrap()))
            .or_default() += 1;
    }
    for family in Family::ALL {
        let of_family: usize = counts
            .iter()
            .filter(|((of, _), _)| *of == family)
            .map(|(_, count)| count)
            .sum();
        assert_eq!(of_family, 60, "{counts:?}");
        assert!(
            TaskType::of_family(family)
                .iter()
                .all(|kind| counts.contains_key(&(family, kind.as_str()))),
            "{counts:?}"
        );
    }
    let statistics = &made.statistics;
    let rejected: usize = statistics.rejected.values().sum();
    assert_eq!((statistics.tasks, statistics.drafts), (240, 240 + rejected));
    assert_eq!(statistics.filters()[3].passed, 240);
}

#[test]
fn every_object_comes_to_rest_where_the_graph_says() {
    let scenes = scenes();
    for (scene, task) in made(&scenes, 80, 5, 2).tasks {
        let rests = settle(&spawn(&scenes[scene], &Arc::new(task.clone()))).unwrap();
        for (object, rest) in task.objects.iter().zip(rests) {
            assert_eq!(object.reference_rest, Some(rest));
            let surface = scenes[scene].receptacle(&object.receptacle).unwrap();
            let above = rest[2] - object.size[2] / 2.0 - surface.surface_height();
            assert!(
                above.abs() < 0.15,
                "{} rests {above} m above {}",
                object.instance,
                surface.id
            );
            assert!(
                surface.surface_rect().contains([rest[0], rest[1]]),
                "{}",
                object.instance
            );
        }
    }
}

#[test]
fn what_falls_flies_or_rests_elsewhere_is_rejected() {
    let scenes = scenes();
    let (_, task) = made(&scenes[..1], 1, 5, 1).tasks.remove(0);
    let elsewhere = scenes[0]
        .receptacles
        .iter()
        .find(|one| one.category == "table" && one.id != task.objects[0].receptacle)
        .unwrap();
    let [x, y] =
        [0, 1].map(|axis| (elsewhere.surface_min[axis] + elsewhere.surface_max[axis]) / 2.0);
    let start = scenes[0].robot_start.unwrap();
    for (at, expected) in [
        (
            [x, y, elsewhere.surface_height() + 0.1],
            SettleError::Displaced,
        ),
        ([start[0] + 0.5, start[1], 1.2], SettleError::Fell),
        ([500.0, 500.0, 1.0], SettleError::FlewAway),
    ] {
        let mut moved = task.clone();
        moved.objects[0].position = at;
        assert_eq!(
            settle(&spawn(&scenes[0], &Arc::new(moved))),
            Err(expected),
            "{at:?}"
        );
    }
}

#[test]
fn what_shall_be_moved_can_be_approached() {
    // In S3 there are beds with a gap to the wall in which no robot stands.
    let scenes = [Arc::new(built_in("S3").unwrap())];
    let made = made(&scenes, 160, 1, 2);
    assert!(
        made.tasks
            .iter()
            .all(|(_, task)| can_be_approached(&spawn(&scenes[0], &Arc::new(task.clone()))))
    );
    assert!(
        made.statistics.rejected.contains_key(&Rejection::Approach),
        "{:?}",
        made.statistics
    );
}

#[test]
fn no_word_happens_to_name_furniture_that_has_no_part_in_it() {
    // S5 has "the brown desk", and the library a brown desk clock.
    let scenes = [Arc::new(built_in("S5").unwrap())];
    let (library, table, families, types) = (
        objects(),
        Compatibility::committed(),
        &[Family::FDP],
        &[TaskType::Gather],
    );
    let options = GenerateOptions {
        scenes: &scenes,
        library,
        table,
        families,
        types,
        count: 40,
        seed: 1,
        placing: Placing::NearEdge,
        jobs: 2,
    };
    let made = make(&options, || {}).unwrap();
    for (_, task) in &made.tasks {
        let is_ours = |id: &ReceptacleId| {
            *id == task.dest || task.goal_objects().any(|object| object.receptacle == *id)
        };
        for other in scenes[0].receptacles.iter().filter(|one| !is_ours(&one.id)) {
            let named = other
                .captions
                .keys()
                .find(|caption| task.precise_instruction.contains(caption.as_str()));
            assert_eq!(
                named, None,
                "{}: {}",
                task.task_id, task.precise_instruction
            );
        }
    }
    assert!(
        made.statistics
            .rejected
            .contains_key(&Rejection::Draft(DraftError::SpeaksOfOthers)),
        "{:?}",
        made.statistics
    );
}

#[test]
fn tasks_survive_writing() {
    let scenes = scenes();
    for (scene, task) in made(&scenes, 80, 6, 2).tasks {
        let text = reel_tasks::yaml::write(&task, &scenes[scene]);
        let (again, _) = reel_tasks::parse(&text, "made.yaml", &scenes[scene]).unwrap();
        assert_eq!(again, task, "{text}");
    }
}

#[test]
fn what_gathers_moves_several_objects_and_only_that_has_no_published_form() {
    let scenes = scenes();
    for (index, (scene, task)) in made(&scenes, 80, 7, 2).tasks.iter().enumerate() {
        let changes = task.goal_changes().len();
        let gathers = task.task_type.as_deref() == Some("gather");
        assert_eq!(changes > 2, gathers, "{}", task.task_id);
        assert_eq!(
            task.plan
                .iter()
                .filter(|step| step.action == "place")
                .count(),
            changes / 2
        );
        let text = real::write(task, &scenes[*scene], index);
        assert_eq!(text.is_none(), gathers);
        let Some(text) = text else { continue };
        let (published, deviations) =
            reel_tasks::parse(&text, "real.yaml", &scenes[*scene]).unwrap();
        let same = |task: &Task| {
            (
                task.goal.clone(),
                task.instruction.clone(),
                task.precise_instruction.clone(),
                task.plan.clone(),
            )
        };
        assert_eq!(same(&published), same(task));
        assert!(
            deviations.iter().all(|odd| [
                "graph omits receptacles",
                "same asset in several places"
            ]
            .contains(&odd.kind.as_str())),
            "{deviations:?}"
        );
    }
}

#[test]
fn the_table_speaks_of_every_object_and_receptacle() {
    let table = Compatibility::committed();
    for object in objects() {
        assert!(
            table.knows_object(object),
            "nothing holds a {} ({})",
            object.category,
            object.purpose
        );
    }
    for scene in names().filter_map(built_in).chain([home_scene()]) {
        for receptacle in &scene.receptacles {
            let held = objects()
                .iter()
                .filter(|object| table.holds(receptacle, object))
                .count();
            assert!(
                held >= 50,
                "{}: {} holds {held} objects",
                scene.scene_id,
                receptacle.id
            );
        }
    }
    let pairs = SceneSites::survey(Arc::new(home_scene()))
        .triplets(objects(), table)
        .len();
    assert!(pairs >= 200, "{pairs} pairs in one scene");
}

#[test]
fn two_scenes_of_one_name_and_families_without_the_type_are_refused() {
    let twice = [Arc::new(home_scene()), Arc::new(home_scene())];
    let options = GenerateOptions {
        scenes: &twice,
        library: objects(),
        table: Compatibility::committed(),
        families: &[Family::SUL],
        types: &[TaskType::Gather],
        count: 1,
        seed: 1,
        placing: Placing::NearEdge,
        jobs: 1,
    };
    let error = |options: &GenerateOptions<'_>| make(options, || {}).unwrap_err().to_string();
    assert!(error(&options).starts_with("two scenes are called home"));
    assert!(
        error(&GenerateOptions {
            scenes: &twice[..1],
            ..options
        })
        .starts_with("no selected family")
    );
}

#[test]
fn a_goal_of_several_moves_is_checked_when_it_is_read() {
    let scenes = scenes();
    let gathering = made(&scenes, 24, 8, 2)
        .tasks
        .into_iter()
        .find(|(_, task)| task.goal_changes().len() > 2)
        .unwrap();
    let text = reel_tasks::yaml::write(&gathering.1, &scenes[gathering.0]);
    let broken = text.replace("moves:\n", "moves:\n      ghost_on_table_1_at_x: table_1\n");
    let error = reel_tasks::parse(&broken, "made.yaml", &scenes[gathering.0])
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("ghost_on_table_1_at_x is not an object of the task"),
        "{error}"
    );
}

#[test]
fn a_table_by_a_model_says_where_things_go() {
    let table = Compatibility::committed();
    let scenes = [Arc::new(built_in("S7").unwrap())];
    let places = table.receptacle_kinds(scenes.iter().map(Arc::as_ref));
    let couch = places.iter().find(|place| place.kind == "couch").unwrap();
    assert!(
        compatibility::question(couch, objects())
            .starts_with("Place: couch in the living room\nThings")
    );
    let judge = |answer: &str| compatibility::judge(answer, objects());
    let held = judge("[no]</think>I say\n```json\n[\"Toy\", \"mug\", \"elephant\"]\n```").unwrap();
    assert_eq!(
        (held.known, held.unknown),
        (
            vec!["mug".to_owned(), "toy".to_owned()],
            vec!["elephant".to_owned()]
        )
    );
    for nothing in [
        "",
        "[",
        "fruit",
        "[1, 2]",
        "[\"elephant\"]",
        "{\"a\": []}",
        "[\"mug\"]</think>I cannot tell.",
    ] {
        assert_eq!(judge(nothing), None, "{nothing}");
    }

    // Only mugs, and only on couch and desks: so they are all that moves.
    let only = |kind: &str| {
        if kind == "couch" || kind == "desk" {
            vec!["mug".to_owned()]
        } else {
            vec!["nothing".to_owned()]
        }
    };
    let mugs = table.with(
        places
            .iter()
            .map(|place| (place.clone(), only(&place.kind)))
            .collect(),
    );
    let mugs: Compatibility = serde_json::from_str(&serde_json::to_string(&mugs).unwrap()).unwrap();
    let (families, types) = ([Family::FDP], [TaskType::Basic]);
    let (scenes, families, types) = (&scenes[..], &families[..], &types[..]);
    let options = GenerateOptions {
        scenes,
        library: objects(),
        table: &mugs,
        families,
        types,
        count: 6,
        seed: 1,
        placing: Placing::NearEdge,
        jobs: 2,
    };
    let made = make(&options, || {}).unwrap();
    assert_eq!(made.tasks.len(), 6, "{:?}", made.statistics);
    for (_, task) in &made.tasks {
        let kind = |id: &ReceptacleId| scenes[0].receptacle(id).unwrap().category.clone();
        assert_eq!(task.target_object().category, "mug");
        assert!(
            [&task.src, &task.dest]
                .into_iter()
                .all(|end| ["couch", "desk"].contains(&kind(end).as_str())),
            "{}",
            task.task_id
        );
    }
}
