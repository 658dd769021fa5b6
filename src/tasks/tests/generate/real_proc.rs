//! Made tasks as files of REAL's task generator, and back.

use std::{collections::BTreeSet, fs, sync::Arc};

use reel_tasks::generate::task::{Compatibility, GenerateOptions, Placing, TaskType, make};
use reel_tasks::{home_scene, library::objects, real_proc::export};
use reel_world::{Family, Task};

#[test]
fn a_file_for_each_type_reads_back_as_the_tasks() {
    let scene = Arc::new(home_scene());
    let options = GenerateOptions {
        scenes: std::slice::from_ref(&scene),
        library: objects(),
        table: Compatibility::committed(),
        families: &Family::ALL,
        types: &TaskType::ALL,
        count: 24,
        seed: 5,
        placing: Placing::Grid,
        jobs: 2,
    };
    let tasks: Vec<Task> = make(&options, || {})
        .unwrap()
        .tasks
        .into_iter()
        .map(|(_, task)| task)
        .collect();
    assert_eq!(tasks.len(), 24);
    let on_grid = |task: &Task| {
        task.objects.iter().all(|object| {
            let surface = scene.receptacle(&object.receptacle).unwrap().surface_rect();
            (0..2).all(|axis| {
                let cells = (object.position[axis] - surface.min[axis]) / 0.05 - 0.5;
                (cells - cells.round()).abs() < 1e-6
            })
        })
    };
    assert!(tasks.iter().all(on_grid));

    let folder = tempfile::tempdir().unwrap();
    let files = export(tasks.iter().map(|task| (task, scene.as_ref())));
    for file in &files {
        let path = folder.path().join(&file.path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, file.text()).unwrap();
    }
    let names: Vec<&str> = files
        .iter()
        .map(|file| file.path.rsplit('/').next().unwrap())
        .collect();
    assert_eq!(
        names,
        [
            "articulation.yaml",
            "basic.yaml",
            "distractor.yaml",
            "gather.yaml",
            "interactive.yaml"
        ]
    );

    let report = reel_tasks::load(folder.path(), &scene);
    assert!(report.broken.is_empty(), "{:?}", report.broken);
    assert_eq!(report.tasks.len(), tasks.len());
    // What the files say of a task; ids are theirs.
    let told = |task: &Task| {
        let objects: BTreeSet<String> = task
            .objects
            .iter()
            .map(|object| {
                format!(
                    "{} {} {} {:?} {:?}",
                    object.asset, object.category, object.receptacle, object.position, object.size
                )
            })
            .collect();
        let moved: BTreeSet<String> = task
            .goal_objects()
            .map(|object| format!("{} {}", object.asset, object.receptacle))
            .collect();
        (
            task.instruction.clone(),
            task.precise_instruction.clone(),
            task.src.clone(),
            task.dest.clone(),
            objects,
            moved,
        )
    };
    for read in &report.tasks {
        let original = tasks
            .iter()
            .find(|task| told(task) == told(read))
            .unwrap_or_else(|| panic!("{read:?}"));
        assert_eq!(read.fuzzy, original.fuzzy);
        let actions = |task: &Task| {
            task.plan
                .iter()
                .map(|step| step.action.clone())
                .collect::<Vec<_>>()
        };
        assert_eq!(actions(read), actions(original));
        assert_eq!(read.goal_changes().len(), original.goal_changes().len());
    }
}

#[test]
fn what_is_wrong_with_such_a_file_says_where() {
    let scene = home_scene();
    let file = |from: &str, to: &str| {
        let text = "scene_id: home\ntask_type: basic\nobjects:\n  obj_0: {original_id: m, category: mug, position: [1, 1, 1], size: [0.1, 0.1, 0.1]}\n\
            episodes:\n- task_id: task_0\n  task_type: basic\n  task_description: Move the mug.\n  src: table_1\n  dest: table_2\n  \
            target_object_id: m\n  execution_plan: [find mug]\n  placements:\n    obj_0: {furniture: table_1, original_id: m}\n";
        assert!(text.contains(from));
        reel_tasks::parse(&text.replace(from, to), "f.yaml", &scene)
            .map_err(|error| error.to_string())
    };
    let (task, _) = file("m", "m").unwrap();
    assert_eq!(task.task_id, "FDP/home_basic_task_0");
    assert_eq!(task.goal_changes().len(), 2);
    let error = |from, to| file(from, to).unwrap_err();
    assert!(
        error("dest: table_2", "dest: moon_1")
            .contains("episodes[0].dest: moon_1 is not a receptacle")
    );
    assert!(error("[find mug]", "[dance]").contains("execution_plan[0]: expected a step such as"));
    assert!(error("target_object_id: m", "target_object_id: k").contains("no k stands on table_1"));
    assert!(error("    obj_0: {f", "    obj_7: {f").contains("obj_7 is not among the objects"));
    assert!(
        error("size: [0.1, 0.1, 0.1]", "size: [0.1, 0, 0.1]")
            .contains("size: expected lengths above 0 m")
    );
    assert!(
        error("\n  task_type: basic", "\n  task_type: odd")
            .contains("task_type: expected basic, distractor")
    );
}
