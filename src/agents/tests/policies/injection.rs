//! The fault library on generated tasks: what is injected comes about, fails or is repaired, and is labelled.

use std::{collections::BTreeMap, sync::Arc};

use reel_agents::{Detour, EpisodeReport, Fault, FaultKind, Injection, Label, SampleOptions, admitted, cluttered, run_injected, sample};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::{GenerateOptions, generate, home};
use reel_world::{Family, Profile, Scene, Task, record::PolicyInfo};

struct World {
    scene: Arc<Scene>,
    tasks: Vec<Arc<Task>>,
}

/// Generated tasks of all families, and as many with a thing more.
fn world(count: usize, seed: u64) -> World {
    let scene = Arc::new(home());
    let made = generate(&GenerateOptions { scene: &scene, families: &Family::ALL, count, seed });
    let mut tasks: Vec<Arc<Task>> = made.tasks.into_iter().map(Arc::new).collect();
    let more: Vec<Arc<Task>> = tasks.iter().filter_map(|task| cluttered(task, &scene, &tasks, seed)).map(Arc::new).collect();
    tasks.extend(more);
    World { scene, tasks }
}

impl World {
    fn play(&self, task: &Arc<Task>, injection: &Injection) -> (EpisodeReport, Label) {
        let config = EpisodeConfig {
            task: task.clone(),
            scene: self.scene.clone(),
            seed: injection.seed,
            profile: Profile::Paper,
            preset: Preset::paper(),
            run_id: "run".into(),
            policy: PolicyInfo::default(),
        };
        run_injected(config, injection, None).unwrap()
    }
}

#[test]
fn table() {
    let per: usize = std::env::var("PER").ok().and_then(|n| n.parse().ok()).unwrap_or(10);
    let world = world(24, 3);
    let begun = std::time::Instant::now();
    let mut n = 0;
    for repaired in [0.0, 1.0] {
        for kind in FaultKind::ALL {
            let kinds = [*kind];
            let options = SampleOptions { kinds: &kinds, repaired, detours: 0.3, combinations: 0.0 };
            let mut rows: Vec<(EpisodeReport, Label)> = Vec::new();
            for seed in 0..per as u64 * 10 {
                let task = &world.tasks[(seed as usize * 7) % world.tasks.len()];
                let Some(injection) = sample(task, &world.scene, seed, &options) else { continue };
                rows.push(world.play(task, &injection));
                n += 1;
                if rows.len() == per { break; }
            }
            let ran = rows.len();
            let failed = rows.iter().filter(|(report, _)| !report.success).count();
            let began = rows.iter().filter(|(_, label)| label.faults[0].step.is_some()).count();
            let rep = rows.iter().filter(|(_, label)| label.faults[0].repaired).count();
            let steps = rows.iter().map(|(report, _)| f64::from(report.length)).sum::<f64>() / ran.max(1) as f64;
            eprintln!("{:18} repaired {repaired}: ran {ran:3} began {began:3} repaired {rep:3} failed {failed:3} steps {steps:.1}", kind.name());
            for (report, label) in &rows {
                let odd = if repaired > 0.5 { !report.success || label.faults[0].step.is_none() } else { report.success || label.faults[0].step.is_none() };
                if odd { eprintln!("    {} seed {} len {} {:?} {:?} {:?} {:?}", report.task_id, label.seed, report.length, report.success, label.faults[0].step, report.unreachable, label.injection); }
            }
        }
    }
    eprintln!("{n} episodes {:.1} s", begun.elapsed().as_secs_f64());
}
