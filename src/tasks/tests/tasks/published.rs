//! All published tasks load, with the deviations known of them.

use reel_tasks::TaskWarningKind::*;
use reel_world::Family;

use crate::{count_by_kind, real_bench};

#[test]
fn every_published_task_loads_and_its_deviations_are_listed() {
    let Some(data) = real_bench() else { return };
    let loaded = reel_tasks::scene::load(&data.join("s7_scene.json")).unwrap();
    assert_eq!(loaded.warnings, Vec::<String>::new());
    let report = reel_tasks::load(&data.join("tasks"), &loaded.scene);
    assert!(report.broken.is_empty(), "{:#?}", report.broken);
    let families = Family::ALL.map(|family| {
        report
            .tasks
            .iter()
            .filter(|task| task.family == family)
            .count()
    });
    assert_eq!(families, [54, 42, 36, 48]);
    let expected = [
        (SameAssetInSeveralPlaces, 118),
        (GoalDoesNotConserve, 59),
        (DestinationAmongSourceDistractors, 22),
        (CategoryAlias, 50),
        (ZeroSizeDistractor, 1),
        (ThinObject, 2),
        (GraphOmitsReceptacles, 144),
        (DestinationWithoutGeometry, 15),
        (UnplaceableReceptacle, 2),
    ];
    assert_eq!(count_by_kind(&report.warnings), expected.into());
}

#[test]
fn goals_move_one_instance_and_nothing_else() {
    let Some(data) = real_bench() else { return };
    let scene = reel_tasks::scene::load(&data.join("s7_scene.json"))
        .unwrap()
        .scene;
    for task in reel_tasks::load(&data.join("tasks"), &scene).tasks {
        let changes: Vec<String> = task
            .goal_changes()
            .iter()
            .map(ToString::to_string)
            .collect();
        let mut expected = [
            format!("-{}@{}", task.target, task.src),
            format!("+{}@{}", task.target, task.dest),
        ];
        expected.sort_by_key(|text| text.starts_with('+'));
        assert_eq!(changes, expected, "{}", task.task_id);
        assert_eq!(task.initial.receptacles.len(), 18, "{}", task.task_id);
    }
}

#[test]
fn published_tasks_survive_writing() {
    let Some(data) = real_bench() else { return };
    let scene = reel_tasks::scene::load(&data.join("s7_scene.json"))
        .unwrap()
        .scene;
    for task in reel_tasks::load(&data.join("tasks"), &scene).tasks {
        let text = reel_tasks::yaml::write(&task, &scene);
        let (again, _) = reel_tasks::parse(&text, "written.yaml", &scene).unwrap();
        assert_eq!(again, task, "{}", task.task_id);
    }
}
