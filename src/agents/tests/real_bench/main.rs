//! The published tasks in our simulator: the oracle reaches their goals, and what stayed where it
//! was put in the simulator they were made with stays here too (docs/spec.md#real-bench). Reads the
//! data from `REEL_REAL_BENCH` or beside the repository.

#![allow(
    clippy::disallowed_methods,
    reason = "tests read files and the environment and use threads; what is recorded does not"
)]

use std::sync::Arc;

use reel_agents::{EpisodeJob, builtin, run_all};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_sim::{PreparedTask, Simulator, model::Surface};
use reel_world::{Family, ObjectInstance, Profile, Skills, Task, record::PolicyInfo};

/// How far aside of the surface's rectangle a reference rest still counts as over it, in metres.
const ASIDE_M: f64 = 0.05;
/// How far above or below the surface its bottom may be, in metres.
const HEIGHT_M: f64 = 0.15;

#[test]
fn the_oracle_reaches_the_goal_of_every_eighth_task() {
    every(8, Profile::Paper, &Preset::paper());
}

#[test]
fn the_oracle_reaches_the_goal_of_every_eighth_task_with_the_published_servers() {
    every(8, Profile::RealRepo, &Preset::real_repo());
    every(8, Profile::RealGspo, &Preset::real_repo());
}

/// The oracle in every `step`th task of each family.
fn every(step: usize, profile: Profile, preset: &Preset) {
    let Some((scene, tasks)) = reel_vectors::episodes::real_bench() else {
        return;
    };
    let mut by_family: Vec<Arc<Task>> = Vec::new();
    for family in Family::ALL {
        by_family.extend(tasks.iter().filter(|task| task.family == family).cloned());
    }
    let spread: Vec<Arc<Task>> = by_family.into_iter().step_by(step).collect();
    assert!(
        Family::ALL
            .iter()
            .all(|family| spread.iter().any(|task| task.family == *family))
    );
    let job = |task: &Arc<Task>| EpisodeJob {
        config: EpisodeConfig {
            task: task.clone(),
            scene: scene.clone(),
            seed: 1,
            profile,
            skills: Skills::Perfect,
            meshes: reel_world::Meshes::default(),
            preset: preset.clone(),
            run_id: "real-bench".into(),
            policy: PolicyInfo::default(),
            rollout: None,
            parent: None,
        },
        policy: "oracle".into(),
        record: None,
        command: "none".into(),
    };
    let reports = run_all(spread.iter().map(job).collect(), 2, builtin, |_| {});
    let failed: Vec<String> = reports
        .iter()
        .filter_map(|report| match report {
            Ok(report) if report.success => None,
            Ok(report) => Some(format!(
                "{}: {:?}, {:?}",
                report.task_id, report.end_reason, report.unreachable
            )),
            Err(error) => Some(error.to_string()),
        })
        .collect();
    eprintln!(
        "oracle, {}: {} of {} tasks",
        profile.as_str(),
        reports.len() - failed.len(),
        reports.len()
    );
    assert!(failed.is_empty(), "{failed:#?}");
}

#[test]
fn what_stayed_on_its_receptacle_there_stays_here() {
    let Some((scene, tasks)) = reel_vectors::episodes::real_bench() else {
        return;
    };
    let (mut stayed, mut excluded, mut ejected, mut without) = (0_u32, 0_u32, 0_u32, 0_u32);
    let mut exceptions = Vec::new();
    for task in &tasks {
        let simulator = Simulator::new(
            PreparedTask::new(scene.clone(), task.clone()),
            Profile::Paper,
            1,
        );
        let graph = simulator.physical_graph();
        for object in &task.objects {
            let Some(rest) = object.reference_rest else {
                without += 1;
                continue;
            };
            if ["pot", "potlid", "electriccooker"]
                .iter()
                .any(|name| object.receptacle.as_str().starts_with(&format!("{name}_")))
            {
                excluded += 1;
                continue;
            }
            let furniture = simulator
                .model()
                .furniture
                .iter()
                .find(|furniture| furniture.id == object.receptacle)
                .unwrap();
            if !rests_on(&furniture.surface, object, rest) {
                ejected += 1;
                continue;
            }
            match graph.receptacle_of(&object.instance) {
                Some(place) if *place == object.receptacle => stayed += 1,
                place => exceptions.push(format!(
                    "{}: {} ({}, {:?} m) on {} went to {place:?}; put at {:?}, rested there at {rest:?}; surface {:?}",
                    task.task_id,
                    object.instance,
                    object.category,
                    object.size,
                    object.receptacle,
                    object.position,
                    furniture.surface
                )),
            }
        }
    }
    let checked = stayed + u32::try_from(exceptions.len()).unwrap();
    for exception in &exceptions {
        eprintln!("exception: {exception}");
    }
    eprintln!(
        "{stayed} of {checked} stayed; left out: {excluded} in pot or cooker, {ejected} ejected in the reference, {without} without reference"
    );
    assert!(checked > 500, "only {checked} objects could be checked");
    assert!(
        f64::from(stayed) >= 0.98 * f64::from(checked),
        "{stayed} of {checked} stayed"
    );
}

/// Whether the other simulator left an object on the surface it was put on.
fn rests_on(surface: &Surface, object: &ObjectInstance, rest: [f64; 3]) -> bool {
    let over = (0..2).all(|axis| {
        (f64::from(surface.min[axis]) - ASIDE_M..=f64::from(surface.max[axis]) + ASIDE_M)
            .contains(&rest[axis])
    });
    over && (rest[2] - object.size[2] / 2.0 - f64::from(surface.z)).abs() <= HEIGHT_M
}
