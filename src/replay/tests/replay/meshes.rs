//! Episodes whose objects are meshes: exact with the same meshes, from the start and from every
//! call; refused with others.

use std::{collections::BTreeMap, path::Path, sync::Arc};

use reel_agents::{RecordTo, Responders, policy, run_episode};
use reel_replay::{Verdict, verify_all, verify_restored, verify_trace, view_at};
use reel_sim::PreparedTask;
use reel_tasks::home_scene;
use reel_trace::{Images, Trace};
use reel_world::{
    AssetId, Assets, Mesh, NoAssets, Outcome, Task, instances,
    mesh::{Material, MeshData, Texture, Triangle},
};

use crate::episodes::{config, record, tasks};

/// A pyramid cut off above, with a texture, colours and one leaning side: nothing
/// that a primitive is.
fn mesh(tint: f32) -> Arc<Mesh> {
    let corner = |corner: usize| {
        let [x, y, z] = [corner & 1, corner >> 1 & 1, corner >> 2].map(|bit| bit as f32);
        [x * (1.0 - 0.4 * z) + 0.2 * z, y * (1.0 - 0.3 * z), z * 1.3]
    };
    let quads = [
        [0, 4, 6, 2],
        [1, 3, 7, 5],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 2, 3, 1],
        [4, 5, 7, 6],
    ];
    let rgb = (0..32 * 32)
        .flat_map(|at| {
            if (at / 4 + at / 128) % 2 == 0 {
                [240, 220, 40]
            } else {
                [20, 60, 180]
            }
        })
        .collect();
    let data = MeshData {
        positions: (0..8).map(corner).collect(),
        texture_points: (0..8)
            .map(|at| [(at & 1) as f32 * 2.0, (at >> 1) as f32 * 0.7 - 1.0])
            .collect(),
        colors: (0..8)
            .map(|at| [tint, 0.5 + 0.5 * (at & 1) as f32, 1.0])
            .collect(),
        triangles: quads
            .iter()
            .flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]])
            .map(|corners| Triangle {
                corners,
                material: 0,
            })
            .collect(),
        materials: vec![Material {
            color: [1.0; 3],
            texture: Some(0),
        }],
        textures: vec![Texture {
            width: 32,
            height: 32,
            rgb,
        }],
        ..MeshData::default()
    };
    Arc::new(Mesh::new(data).unwrap())
}

/// A mesh for the target, and for every second asset beside it.
fn meshes(task: &Task) -> BTreeMap<AssetId, Arc<Mesh>> {
    let target = task.target_object().asset.clone();
    let others = task.assets().step_by(2).cloned();
    others
        .chain([target])
        .map(|asset| (asset, mesh(0.9)))
        .collect()
}

fn play(path: &Path, task: &Arc<Task>, assets: &dyn Assets, images: Images) {
    let scene = Arc::new(home_scene());
    let mut oracle = policy("oracle", task, &scene, 3).unwrap();
    let mut config = config(task, &scene, 3);
    config.meshes = assets.meshes(&mut task.assets());
    let record = RecordTo {
        path: path.to_owned(),
        options: images.into(),
    };
    run_episode(
        config,
        oracle.as_mut(),
        Responders::default(),
        Some(&record),
    )
    .unwrap();
}

#[test]
fn an_episode_with_meshes_replays_exactly_from_its_start_and_from_every_call() {
    let folder = tempfile::tempdir().unwrap();
    for (index, task) in tasks().iter().enumerate() {
        let path = folder.path().join(format!("{index}.mcap"));
        let assets = meshes(task);
        play(
            &path,
            task,
            &assets,
            if index == 0 {
                Images::Full
            } else {
                Images::None
            },
        );
        let verdicts = verify_all(
            &reel_trace::TraceFiles::default(),
            &[&path],
            &assets,
            1,
            |_, _| {},
        );
        assert!(verdicts[0].verdict.is_exact(), "{:?}", verdicts[0]);
        assert!(verdicts[0].has_meshes && verdicts[0].is_lasting());
        let trace = Trace::read(&path).unwrap().with_meshes(&assets);
        let done = |tool: &str| {
            trace
                .steps
                .iter()
                .any(|step| step.tool_name() == tool && step.outcome.error.is_none())
        };
        assert!(
            done("pick") && done("place"),
            "the target was not moved: {:?}",
            outcomes(&trace)
        );
        assert!(
            trace.end.as_ref().unwrap().metrics.success,
            "{:?}",
            outcomes(&trace)
        );
        let calls: Vec<usize> = (0..=trace.steps.len()).collect();
        let verdict = verify_restored(&trace, &calls);
        assert!(verdict.is_exact(), "{verdict}");
    }
}

#[test]
fn meshes_are_seen_and_make_another_episode() {
    let folder = tempfile::tempdir().unwrap();
    let task = &tasks()[0];
    let (with, without) = (
        folder.path().join("with.mcap"),
        folder.path().join("without.mcap"),
    );
    let assets = meshes(task);
    play(&with, task, &assets, Images::None);
    record(&without, task, "oracle", Images::None);
    let (with, without) = (
        Trace::read(&with).unwrap().with_meshes(&assets),
        Trace::read(&without).unwrap(),
    );
    assert_eq!(with.header.meshes.len(), assets.len());
    assert!(without.header.meshes.is_empty());
    assert!(
        !serde_json::to_string(&without.header)
            .unwrap()
            .contains("meshes"),
        "a header without meshes is as it was"
    );
    assert_ne!(with.header.episode_id, without.header.episode_id);
    assert_ne!(with.start.digests.frame, without.start.digests.frame);
    let camera = reel_replay::Viewpoint::Follow(task.target.clone());
    assert_ne!(
        view_at(&with, None, &camera, None).unwrap().rgb,
        view_at(&without, None, &camera, None).unwrap().rgb
    );
}

#[test]
fn without_its_meshes_or_with_others_a_replay_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mcap");
    let task = &tasks()[0];
    let mut assets = meshes(task);
    play(&path, task, &assets, Images::None);
    let refused = |assets: &dyn Assets| match verify_trace(
        &Trace::read(&path).unwrap().with_meshes(assets),
    ) {
        Verdict::Refused { reason } => reason,
        verdict => panic!("{verdict}"),
    };
    let target = task.target_object().asset.clone();
    assert!(refused(&NoAssets).contains(&format!(
        "{target} ({}) is missing",
        mesh(0.9).digest().short()
    )));
    assets.insert(target.clone(), mesh(0.8));
    let reason = refused(&assets);
    let (here, recorded) = (mesh(0.8).digest().short(), mesh(0.9).digest().short());
    assert!(
        reason.contains(&format!(
            "{target} is {here} here, and was {recorded} when it was recorded"
        )),
        "{reason}"
    );
    assert!(reason.contains("--assets DIR"), "{reason}");
}

fn outcomes(trace: &Trace) -> Vec<(&str, &Outcome)> {
    trace
        .steps
        .iter()
        .map(|step| (step.tool_name(), &step.outcome))
        .collect()
}

/// What viewers draw of a mesh: a colour for each triangle, of its texture, its vertices and its
/// material together.
#[test]
fn triangles_of_a_mesh_have_the_colours_that_it_shows() {
    let task = &tasks()[0];
    let scene = Arc::new(home_scene());
    let colors = |tint: f32| -> Vec<[f32; 3]> {
        let target = task.target_object().asset.clone();
        let assets = BTreeMap::from([(target, mesh(tint))]);
        let meshes = assets.meshes(&mut task.assets());
        let stage = PreparedTask::with_meshes(scene.clone(), task.clone(), meshes);
        let known = instances(task, &scene);
        let id = known
            .iter()
            .find(|it| it.name == task.target.as_str())
            .unwrap()
            .id;
        let bodies = stage.drawn_bodies();
        let body = bodies.iter().find(|it| it.instance == id).unwrap();
        assert_eq!(
            body.surfaces.len(),
            1,
            "a mesh, and none of the parts that it replaces"
        );
        body.surfaces[0].colors.clone()
    };
    let linear = |value: f32| ((value / 255.0 + 0.055) / 1.055).powf(2.4);
    let (tinted, untinted) = (colors(1.0), colors(0.0));
    assert_eq!((tinted.len(), untinted.len()), (12, 12));
    for (tinted, untinted) in tinted.iter().zip(&untinted) {
        // The texture is yellow and blue; vertices take green away, and red where they have no tint.
        assert!(
            (linear(20.0)..=linear(240.0)).contains(&tinted[0]),
            "{tinted:?}"
        );
        assert!(
            untinted[0] == 0.0 && tinted[1..] == untinted[1..],
            "{untinted:?}"
        );
        assert!(
            (0.5 * linear(60.0)..=linear(220.0)).contains(&tinted[1]),
            "{tinted:?}"
        );
        assert!(
            (linear(40.0)..=linear(180.0)).contains(&tinted[2]),
            "{tinted:?}"
        );
    }
}
