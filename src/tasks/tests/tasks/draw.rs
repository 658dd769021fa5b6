//! Generated tasks: the same again, of the right family, well placed, unambiguous, and unchanged
//! by writing and reading.

use std::{collections::BTreeSet, fs};

use reel_tasks::{DrawOptions, DrawnTasks, TaskWarningKind, draw, home_scene};
use reel_world::{Family, Scene, Task};

fn generated(scene: &Scene, count: usize, seed: u64) -> DrawnTasks {
    draw(&DrawOptions {
        scene,
        families: &Family::ALL,
        count,
        seed,
    })
}

#[test]
fn the_same_seed_gives_the_same_tasks_and_more_begin_with_the_fewer() {
    let home = home_scene();
    let tasks = generated(&home, 40, 7).tasks;
    assert_eq!(tasks, generated(&home, 40, 7).tasks);
    assert_eq!(tasks[..12], generated(&home, 12, 7).tasks);
    assert_ne!(
        tasks[0].instruction,
        generated(&home, 1, 8).tasks[0].instruction
    );
}

#[test]
fn two_hundred_tasks_come_in_equal_parts_under_their_own_names() {
    let generated = generated(&home_scene(), 200, 1);
    let families = Family::ALL.map(|family| {
        generated
            .tasks
            .iter()
            .filter(|task| task.family == family)
            .count()
    });
    assert_eq!(families, [50; 4], "{:?}", generated.rejected);
    let names: BTreeSet<&str> = generated
        .tasks
        .iter()
        .map(|task| task.task_id.as_str())
        .collect();
    assert_eq!(names.len(), 200);
    assert_eq!(generated.tasks[0].task_id, "FDP/home_0001");
    assert_eq!(generated.tasks[199].task_id, "SUL/home_0050");
}

#[test]
fn families_are_what_they_are_called() {
    let home = home_scene();
    for task in generated(&home, 200, 2).tasks {
        let door = |id| home.receptacle(id).unwrap().door.exists();
        let target = task.target_object();
        let beside: Vec<_> = task
            .objects
            .iter()
            .filter(|object| object.receptacle == task.src && object.instance != task.target)
            .collect();
        let steps: Vec<&str> = task.plan.iter().map(|step| step.action.as_str()).collect();
        match task.family {
            Family::FDP => assert!(!task.src_distractors.is_empty() && beside.is_empty()),
            Family::FODP => {
                assert!(!task.src_distractors.is_empty() && !beside.is_empty());
                assert!(beside.iter().all(|other| other.category == target.category
                    && other.attributes != target.attributes));
            }
            Family::FDO => {
                assert!(
                    door(&task.src) != door(&task.dest)
                        && steps.contains(&"open")
                        && steps.ends_with(&["close"])
                );
                let expected = if door(&task.dest) {
                    "store"
                } else {
                    "retrieve"
                };
                assert_eq!(task.task_type.as_deref(), Some(expected));
            }
            Family::Other => panic!("not of REAL-Bench"),
            Family::SUL => {
                let purpose = task.purpose.as_deref().unwrap();
                assert!(
                    task.fuzzy
                        && task.instruction.contains(purpose)
                        && !task.instruction.contains(&target.category)
                );
                let fits = |asset| {
                    reel_tasks::library::objects()
                        .iter()
                        .any(|object| object.asset == asset && object.purpose == purpose)
                };
                assert!(
                    !beside.is_empty()
                        && beside
                            .iter()
                            .all(|other| fits(other.asset.clone())
                                && other.category != target.category)
                );
            }
        }
        assert_eq!(
            steps
                .iter()
                .filter(|step| ["find", "gaze_at", "pick", "place"].contains(step))
                .count(),
            4
        );
        assert_eq!(
            door(&task.src) || door(&task.dest),
            task.family == Family::FDO
        );
    }
}

#[test]
fn objects_stand_apart_on_their_surfaces_within_reach() {
    let home = home_scene();
    for task in generated(&home, 200, 3).tasks {
        for (index, object) in task.objects.iter().enumerate() {
            let surface = home.receptacle(&object.receptacle).unwrap();
            let ([x, y, z], [width, depth, height]) = (object.position, object.size);
            let rect = surface.surface_rect();
            let gaps = [
                x - width / 2.0 - rect.min[0],
                rect.max[0] - x - width / 2.0,
                y - depth / 2.0 - rect.min[1],
                rect.max[1] - y - depth / 2.0,
            ];
            assert!(
                gaps.iter().all(|gap| *gap >= 0.05 - 0.001),
                "{}: {gaps:?}",
                object.instance
            );
            let edge = (x - rect.min[0])
                .min(rect.max[0] - x)
                .min(y - rect.min[1])
                .min(rect.max[1] - y);
            assert!(edge <= 0.45, "{}: {edge}", object.instance);
            assert!((z - surface.surface_height() - height / 2.0 - 0.02).abs() < 1e-4);
            for other in task.objects[..index]
                .iter()
                .filter(|other| other.receptacle == object.receptacle)
            {
                let apart = |axis: usize| {
                    (object.position[axis] - other.position[axis]).abs()
                        >= (object.size[axis] + other.size[axis]) / 2.0 + 0.05 - 1e-9
                };
                assert!(
                    apart(0) || apart(1),
                    "{} and {}",
                    object.instance,
                    other.instance
                );
            }
        }
    }
}

#[test]
fn instructions_name_source_destination_and_target_and_nothing_else() {
    let home = home_scene();
    let mut openings = BTreeSet::new();
    for task in generated(&home, 200, 4).tasks {
        for id in [&task.src, &task.dest] {
            let captions = &home.receptacle(id).unwrap().captions;
            assert!(
                captions
                    .keys()
                    .any(|caption| task.instruction.contains(caption.as_str())),
                "{}",
                task.instruction
            );
        }
        let caption = task.target_object().caption.as_deref().unwrap();
        let said = task
            .precise_instruction
            .to_lowercase()
            .contains(caption.to_lowercase().trim_end_matches('.'));
        assert_eq!(
            said,
            task.family != Family::FDO,
            "{}",
            task.precise_instruction
        );
        let alike = task.objects.iter().filter(|object| {
            object.caption.as_deref() == Some(caption) && object.receptacle == task.src
        });
        assert_eq!(alike.count(), 1);
        openings.insert(task.instruction.split(' ').next().unwrap().to_owned());
    }
    assert!(openings.len() >= 9, "{openings:?}");
}

#[test]
fn writing_and_loading_gives_the_same_tasks() {
    let home = home_scene();
    let tasks = generated(&home, 80, 5).tasks;
    let folder = tempfile::tempdir().unwrap();
    for task in &tasks {
        let path = folder.path().join(format!("{}.yaml", task.task_id));
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, reel_tasks::yaml::write(task, &home)).unwrap();
    }
    let report = reel_tasks::load(folder.path(), &home);
    assert!(report.broken.is_empty(), "{:?}", report.broken);
    let sorted = |mut tasks: Vec<Task>| {
        tasks.sort_by(|a, b| a.task_id.cmp(&b.task_id));
        tasks
    };
    assert_eq!(sorted(report.tasks), sorted(tasks));
    assert!(
        report
            .warnings
            .iter()
            .all(|deviation| deviation.kind == TaskWarningKind::SameAssetInSeveralPlaces),
        "{:#?}",
        report.warnings
    );
}

#[test]
fn a_scene_that_does_not_allow_a_family_gives_fewer_tasks_and_says_why() {
    let mut scene = home_scene();
    scene
        .receptacles
        .retain(|receptacle| !receptacle.door.exists());
    let generated = draw(&DrawOptions {
        scene: &scene,
        families: &[Family::FDO],
        count: 3,
        seed: 1,
    });
    assert_eq!(generated.tasks, vec![]);
    assert!(
        generated
            .rejected
            .keys()
            .all(|reason| reason.starts_with("the scene has no receptacle for")),
        "{:?}",
        generated.rejected
    );
}
