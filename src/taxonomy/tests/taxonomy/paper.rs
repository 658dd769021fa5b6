//! The worked failures and successes of the paper (Qualitative Analysis), acted out call by
//! call in the simulator: each has the class that the paper gives it, with the evidence at the
//! step that it names.

use std::{path::Path, sync::Arc};

use reel_agents::{Policy, PolicyContext, RecordTo, ResponderError, Responders, run_episode};
use reel_episode::EpisodeConfig;
use reel_query::QuerySession;
use reel_reward::Preset;
use reel_tables::Store;
use reel_taxonomy::RuleSet;
use reel_trace::{Images, RecordOptions};
use reel_world::{
    Attributes, Family, InstanceId, ObjectInstance, Profile, ReceptacleId, Scene, Skills, Task,
    Tool,
    record::{MarkerTarget, PolicyInfo, StepInput},
};
use tempfile::TempDir;

use crate::{Found, found};

/// What the agent of the paper does next; numbers are looked up when they are needed.
#[derive(Clone, Copy)]
enum Move {
    Nav(&'static str),
    Show(&'static str),
    Receptacles,
    Walk,
    Gaze(&'static str),
    Pick(&'static str),
    /// A number that is on no map.
    PickStale,
    Place(&'static str),
    Finish,
}
use Move::*;

struct Script {
    moves: Vec<Move>,
    task: Arc<Task>,
}

impl Policy for Script {
    fn info(&self) -> PolicyInfo {
        PolicyInfo {
            name: "paper".into(),
            ..PolicyInfo::default()
        }
    }

    fn needs_privileged(&self) -> bool {
        true
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        let truth = context.truth.expect("a script is shown the truth");
        let number = |wanted: &dyn Fn(&MarkerTarget) -> bool| {
            let marker = truth.markers.iter().find(|marker| wanted(&marker.target));
            marker
                .unwrap_or_else(|| {
                    panic!(
                        "step {}: no number for it on {:?}",
                        context.step, truth.markers
                    )
                })
                .id
        };
        let object = |asset: &str| {
            let id = &self
                .task
                .objects
                .iter()
                .find(|object| object.asset.as_str() == asset)
                .expect("it is in the task")
                .instance;
            number(&|target| matches!(target, MarkerTarget::Object(found) if found == id))
        };
        let place = |id: &str| {
            number(
                &|target| matches!(target, MarkerTarget::Receptacle(found) if found.as_str() == id),
            )
        };
        let tool = match self.moves.get(context.step as usize).copied() {
            Some(Nav(receptacle)) => Tool::NavTo {
                receptacle: receptacle.into(),
            },
            Some(Show(category)) => Tool::ShowObjectByCategory {
                category: category.into(),
            },
            Some(Receptacles) => Tool::ShowReceptacles,
            Some(Walk) => Tool::WalkAround,
            Some(Gaze(asset)) => Tool::GazeAt {
                marker: object(asset),
            },
            Some(Pick(asset)) => Tool::Pick {
                marker: object(asset),
            },
            Some(PickStale) => Tool::Pick { marker: 77 },
            Some(Place(receptacle)) => Tool::Place {
                marker: place(receptacle),
            },
            Some(Finish) | None => Tool::Finish,
        };
        Ok(StepInput::from_call(tool.to_call()))
    }
}

/// The home that comes with Reel; its oak shelf is a fourth cabinet.
fn scene() -> Scene {
    let mut scene = reel_tasks::home_scene();
    let shelf = scene
        .receptacles
        .iter_mut()
        .find(|receptacle| receptacle.id.as_str() == "shelf_1")
        .unwrap();
    (shelf.id, shelf.category) = ("cabinet_4".into(), "cabinet".into());
    scene
}

/// (asset, category, colour, receptacle); the first is the target. Things on one receptacle
/// stand side by side.
fn task(
    name: &str,
    instruction: &str,
    fuzzy: bool,
    dest: &str,
    objects: &[(&str, &str, &str, &str)],
) -> Task {
    let scene = scene();
    let mut placed: Vec<ObjectInstance> = Vec::new();
    for (asset, category, colour, receptacle) in objects {
        let surface = scene
            .receptacles
            .iter()
            .find(|found| found.id.as_str() == *receptacle)
            .unwrap();
        let beside = placed
            .iter()
            .filter(|other| other.receptacle == surface.id)
            .count() as f64;
        let size = [0.1, 0.1, 0.12];
        let (from, to) = (surface.surface_min, surface.surface_max);
        placed.push(ObjectInstance {
            instance: InstanceId::new(&(*asset).into(), &surface.id, name),
            asset: (*asset).into(),
            category: (*category).into(),
            caption: Some(format!("a {colour} {category}")),
            attributes: Attributes::from([("colour".into(), vec![(*colour).into()])]),
            size,
            position: [
                (from[0] + to[0]) / 2.0 - 0.25 + 0.25 * beside,
                (from[1] + to[1]) / 2.0,
                to[2] + size[2] / 2.0 + 0.02,
            ],
            yaw: 0.0,
            receptacle: surface.id.clone(),
            reference_rest: None,
        });
    }
    let target = placed[0].clone();
    placed.sort_by(|one, other| one.instance.cmp(&other.instance));
    let initial = Task::initial_graph(&scene, &placed);
    let mut goal = initial.clone();
    goal.remove(&target.receptacle, &target.instance);
    goal.add(&dest.into(), &target.instance);
    let category = |id: &ReceptacleId| scene.receptacle(id).map(|found| &found.category);
    let alike = |of: &ReceptacleId| -> Vec<ReceptacleId> {
        let others = scene
            .receptacles
            .iter()
            .map(|other| &other.id)
            .filter(|other| *other != of);
        others
            .filter(|other| category(other) == category(of))
            .cloned()
            .collect()
    };
    Task {
        placement_order: Vec::new(),
        task_id: format!("paper/{name}"),
        family: if fuzzy { Family::SUL } else { Family::FODP },
        task_type: None,
        scene_id: scene.scene_id.clone(),
        instruction: instruction.into(),
        precise_instruction: instruction.into(),
        fuzzy,
        purpose: fuzzy.then(|| "timekeeping device".into()),
        object_distractors: placed
            .iter()
            .filter(|other| other.category == target.category && other.asset != target.asset)
            .map(|other| other.asset.clone())
            .collect(),
        src_distractors: alike(&target.receptacle),
        dest_distractors: alike(&dest.into()),
        src: target.receptacle.clone(),
        dest: dest.into(),
        target: target.instance,
        objects: placed,
        initial,
        goal,
        plan: vec![],
        published_goal: None,
        extra: Default::default(),
    }
}

/// Acts a script out; what came of it, and the trace.
fn act(dir: &Path, task: Task, moves: &[Move]) -> (bool, std::path::PathBuf) {
    let (task, scene) = (Arc::new(task), Arc::new(scene()));
    let path = dir.join(format!("{}.mcap", task.task_id.replace('/', "_")));
    let config = EpisodeConfig {
        task: task.clone(),
        scene,
        seed: 0,
        profile: Profile::Paper,
        skills: Skills::Perfect,
        meshes: reel_world::Meshes::default(),
        preset: Preset::paper(),
        run_id: "paper".into(),
        policy: PolicyInfo::default(),
        rollout: None,
        parent: None,
    };
    let options = RecordOptions {
        images: Images::None,
        ..RecordOptions::default()
    };
    let mut script = Script {
        moves: moves.to_vec(),
        task,
    };
    let report = run_episode(
        config,
        &mut script,
        Responders::default(),
        Some(&RecordTo {
            path: path.clone(),
            options,
        }),
    )
    .unwrap();
    (report.success, path)
}

#[test]
fn the_worked_cases_are_what_the_paper_says() {
    let dir = TempDir::new().unwrap();
    let mut traces = Vec::new();
    let mut play = |task: Task, moves: &[Move], success: bool| {
        let name = task.task_id.clone();
        let (succeeded, path) = act(dir.path(), task, moves);
        assert_eq!(succeeded, success, "{name}");
        traces.push(path);
    };

    let clocks = [
        ("clock_white", "alarm clock", "white", "table_2"),
        ("clock_blue", "alarm clock", "blue", "table_2"),
    ];
    let white = "Retrieve the round, white alarm clock with a classic design, two bells on top, and smooth surface from the \
                 table much smaller than another one and deposit it at bed with matte white mattress cover.";
    let blue = [
        Nav("table_2"),
        Show("clock"),
        Gaze("clock_blue"),
        PickStale,
        Show("clock"),
        Pick("clock_blue"),
        Nav("bed_1"),
        Receptacles,
        Place("bed_1"),
        Finish,
    ];
    play(
        task("1-wrong-object", white, false, "bed_1", &clocks),
        &blue,
        false,
    );

    let bears = [
        ("bear_brown", "teddy bear", "brown", "bed_1"),
        ("bear_white", "teddy bear", "white", "bed_1"),
        ("bear_pink", "teddy bear", "pink", "bed_1"),
    ];
    let snack = "Transport a teddy bear figure with a round body, outstretched arms, light brown color, and smooth texture from \
                 the bed with all-white bed sheets to the table for placing my snack while watching TV.";
    let wrong_table = [
        Nav("bed_1"),
        Show("teddy bear"),
        Gaze("bear_brown"),
        Pick("bear_brown"),
        Nav("table_2"),
        Nav("table_1"),
        Receptacles,
        Place("table_1"),
    ];
    play(
        task("2-similar-furniture", snack, false, "table_2", &bears),
        &wrong_table,
        false,
    );

    let devices = [
        ("clock_white", "alarm clock", "white", "desk_1"),
        ("clock_blue", "alarm clock", "blue", "desk_1"),
    ];
    let vague = "Get a timekeeping device from white desk with rectangular wooden handles and move it to the table much larger \
                 than another one.";
    let hasty = [
        Nav("desk_1"),
        Show("clock"),
        Gaze("clock_blue"),
        Pick("clock_blue"),
        Nav("table_1"),
        Receptacles,
        Place("table_1"),
        Finish,
    ];
    play(
        task("3-no-ask", vague, true, "table_1", &devices),
        &hasty,
        false,
    );

    let dog = "Retrieve the small white dog figurine, seated, smooth surface, slight texturing, realistic proportions, upright \
               posture from the rounded rectangular table and deposit it at the desk with black handle.";
    let mut endless = vec![Nav("table_2"), Show("figurine"), Gaze("dog"), Pick("dog")];
    endless.extend([Nav("desk_1"), Nav("desk_2")].repeat(13));
    play(
        task(
            "4-lost-memory",
            dog,
            false,
            "desk_2",
            &[("dog", "figurine", "white", "table_2")],
        ),
        &endless,
        false,
    );

    let remotes = [
        ("remote_black", "remote control", "black", "table_1"),
        ("remote_white", "remote control", "white", "table_1"),
        ("remote_red", "remote control", "red", "table_1"),
    ];
    let sleek = "Get the sleek black remote control, curved design, glossy surface, colored buttons, ergonomic grip from the \
                 table where we have dinner and move it to cabinet with drawers with orange inner backing.";
    let discovered = [
        Nav("table_1"),
        Show("remote control"),
        Walk,
        Gaze("remote_black"),
        Pick("remote_black"),
        Nav("cabinet_3"),
        Receptacles,
        Place("cabinet_3"),
        Finish,
    ];
    play(
        task("5-walk-around", sleek, false, "cabinet_3", &remotes),
        &discovered,
        true,
    );

    let spiral = "Retrieve the spiral-bound notebook with a textured white cover, red edge, and lined pages with sketches from \
                  bed with plain white bedding and deposit it at whole-black cabinet with flat base.";
    let explored = [
        Nav("bed_2"),
        Nav("bed_1"),
        Show("notebook"),
        Gaze("notebook"),
        Pick("notebook"),
        Nav("cabinet_1"),
        Nav("cabinet_2"),
        Nav("cabinet_3"),
        Nav("cabinet_4"),
        Receptacles,
        Place("cabinet_4"),
        Finish,
    ];
    play(
        task(
            "6-exploration",
            spiral,
            false,
            "cabinet_4",
            &[("notebook", "notebook", "white", "bed_1")],
        ),
        &explored,
        true,
    );

    let mut store = Store::open_or_create(dir.path().join("store")).unwrap();
    let report = store.ingest(&traces, &|_, _| ()).unwrap();
    assert_eq!((report.added, report.quarantined), (6, vec![]));
    let session = QuerySession::new(store).unwrap();
    let by_task = |found: &Found| {
        let sql = format!(
            "SELECT task_id FROM episodes WHERE episode_id = '{}'",
            found.episode_id
        );
        let text =
            reel_query::format(&session.run(&sql).unwrap(), reel_query::Format::Csv).unwrap();
        text.lines().nth(1).unwrap().to_owned()
    };
    let mut classes: Vec<_> = found(&session, &RuleSet::built_in())
        .into_iter()
        .map(|found| (by_task(&found), found))
        .collect();
    classes.sort_by(|one, other| one.0.cmp(&other.0));
    let classes: Vec<_> = classes
        .iter()
        .map(|(task, found)| {
            (
                task.as_str(),
                found.class.as_str(),
                found.sub_class.as_str(),
                found.step,
                found.last_step,
            )
        })
        .collect();
    assert_eq!(
        classes,
        [
            (
                "paper/1-wrong-object",
                "Object Confusion",
                "wrong_attribute",
                5,
                9
            ),
            (
                "paper/2-similar-furniture",
                "Object Confusion",
                "similar_furniture",
                7,
                8
            ),
            ("paper/3-no-ask", "Key Action Missing", "missing_ask", 3, 7),
            // from step 4 on, to the end of the budget
            ("paper/4-lost-memory", "Lost Memory", "oscillation", 6, 29),
        ]
    );
    let stale = found(&session, &RuleSet::built_in())
        .into_iter()
        .filter(|found| found.sub_class == "wrong_attribute");
    assert_eq!(
        stale.map(|found| found.secondary).collect::<Vec<_>>(),
        [[("stale_marker".to_owned(), 3)]]
    );
}
