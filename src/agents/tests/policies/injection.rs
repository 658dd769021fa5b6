//! The fault library: what is injected comes about, fails or is repaired, and is labelled. In the
//! flat without physics, and on generated tasks.

use std::{collections::BTreeMap, fs, sync::Arc};

use reel_agents::{
    Detour, EpisodeReport, Fault, FaultKind, Injected, Injection, InjectionError, Label, Policy,
    RecordTo, SampleOptions, admitted, cluttered, paper_mix, run_injected, sample,
};
use reel_episode::EpisodeConfig;
use reel_reward::Preset;
use reel_tasks::{DrawOptions, draw, home_scene};
use reel_trace::Trace;
use reel_world::{
    ErrorCode, FailureClass, Family, HORIZON, Profile, Scene, Skills, Task, record::PolicyInfo,
};

use crate::{
    flat::{self, Flat},
    fridge, fuzzy, tables,
};

/// Episodes of each kind that are not repaired, and that are.
const UNREPAIRED: usize = 3;
const REPAIRED: usize = 1;

fn one(kind: FaultKind, seed: u64) -> Injection {
    Injection {
        faults: vec![Fault::new(kind)],
        detours: Vec::new(),
        seed,
    }
}

fn unfit(task: Task, faults: &[Fault]) -> InjectionError {
    let injection = Injection {
        faults: faults.to_vec(),
        ..Injection::default()
    };
    Injected::new(&Arc::new(task), &flat::scene(), &injection).unwrap_err()
}

/// The calls in the flat, the label, and whether the goal was reached.
fn in_flat(task: Task, injection: &Injection) -> (Flat, Label) {
    let mut flat = Flat::new(task, flat::scene());
    let mut policy = Injected::new(&flat.task, &flat.scene, injection).unwrap();
    flat.play(&mut policy);
    let label = policy.label("flat", flat.success());
    (flat, label)
}

#[test]
fn every_kind_repeats_itself_and_varies_with_the_seed() {
    for task in [tables(), fridge(), fuzzy()] {
        let shared = Arc::new(task.clone());
        for kind in admitted(&shared, &flat::scene()) {
            let mut surfaces = Vec::new();
            for seed in 0..8 {
                let (played, label) = in_flat(task.clone(), &one(kind, seed));
                let (again, same) = in_flat(task.clone(), &one(kind, seed));
                assert_eq!(
                    (&played.log, &label),
                    (&again.log, &same),
                    "{kind}, seed {seed}"
                );
                assert!(played.finished || played.log.len() == HORIZON as usize);
                surfaces.push(played.log);
            }
            surfaces.dedup();
            assert!(surfaces.len() > 1, "{kind} always looks the same");
        }
    }
}

#[test]
fn a_label_names_the_decision_at_which_the_fault_began() {
    for kind in [FaultKind::WrongAttribute, FaultKind::WrongKind] {
        let (flat, label) = in_flat(tables(), &one(kind, 3));
        let step = label.faults[0].step.unwrap();
        assert_eq!(flat.log[step as usize].0.name, "pick", "{kind}");
        assert_eq!(label.primary.unwrap().step, step);
    }
    let (flat, label) = in_flat(tables(), &one(FaultKind::SimilarFurniture, 3));
    assert_eq!(
        flat.log[label.faults[0].step.unwrap() as usize].0.name,
        "place"
    );
    let (flat, label) = in_flat(fridge(), &one(FaultKind::MissingOpen, 3));
    let step = label.primary.unwrap().step as usize;
    assert_eq!(flat.log[step - 1].0.name, "nav_to");
    assert!(
        flat.log[step..]
            .iter()
            .any(|(_, error)| *error == Some(ErrorCode::DoorClosed))
    );
    let (flat, label) = in_flat(fuzzy(), &one(FaultKind::IgnoredAnswer, 3));
    let asked = flat.names().iter().position(|name| *name == "ask").unwrap();
    assert!(asked < label.primary.unwrap().step as usize);
}

#[test]
fn what_is_noticed_but_not_undone_is_not_repaired() {
    let (mut held_on, mut undone) = (0, 0);
    for seed in 0..40 {
        let wrong = Fault {
            repaired: true,
            ..Fault::new(FaultKind::WrongAttribute)
        };
        let end = Fault {
            position: 0.9,
            ..Fault::new(FaultKind::PrematureFinish)
        };
        let injection = Injection {
            faults: vec![wrong, end],
            detours: Vec::new(),
            seed,
        };
        let (flat, label) = in_flat(tables(), &injection);
        let in_hand = flat
            .held
            .as_ref()
            .is_some_and(|held| *held != flat.task.target);
        assert_eq!(label.faults[0].repaired, !in_hand, "seed {seed}: {label:?}");
        let primary = label.primary.map(|primary| primary.sub_class);
        assert_eq!(
            primary.as_deref(),
            Some(if in_hand {
                "wrong_attribute"
            } else {
                "premature_finish"
            }),
            "seed {seed}"
        );
        if in_hand { held_on += 1 } else { undone += 1 }
    }
    assert!(held_on > 0, "{held_on} and {undone}");
}

#[test]
fn the_policy_names_no_fault() {
    let flat = Flat::new(tables(), flat::scene());
    let info = Injected::new(&flat.task, &flat.scene, &one(FaultKind::FalseHistory, 5))
        .unwrap()
        .info();
    assert_eq!(info.name, "injected");
    assert_eq!(info.parameters.keys().collect::<Vec<_>>(), ["seed"]);
}

#[test]
fn what_a_task_does_not_admit_is_said() {
    let one = |kind| [Fault::new(kind)];
    assert_eq!(
        unfit(tables(), &one(FaultKind::MissingAsk)),
        InjectionError::Precise {
            kind: FaultKind::MissingAsk
        }
    );
    assert_eq!(
        unfit(fuzzy(), &one(FaultKind::WrongInstance)),
        InjectionError::Underspecified {
            kind: FaultKind::WrongInstance
        }
    );
    assert!(matches!(
        unfit(tables(), &one(FaultKind::MissingOpen)),
        InjectionError::NoDoor { .. }
    ));
    assert!(matches!(
        unfit(fridge(), &one(FaultKind::SimilarFurniture)),
        InjectionError::NoReceptacle { .. }
    ));
    let mut alone = tables();
    alone
        .objects
        .retain(|object| object.asset != "yellow".into() && object.asset != "cup".into());
    assert_eq!(
        unfit(alone, &one(FaultKind::WrongKind)),
        InjectionError::NoObject {
            kind: FaultKind::WrongKind
        }
    );
    let finish = Fault {
        repaired: true,
        ..Fault::new(FaultKind::PrematureFinish)
    };
    assert_eq!(
        unfit(tables(), &[finish]),
        InjectionError::NotRepairable {
            kind: FaultKind::PrematureFinish
        }
    );
    let both = [FaultKind::MissingPick, FaultKind::WrongReceptacle].map(Fault::new);
    assert!(
        matches!(unfit(tables(), &both), InjectionError::Conflict { .. }),
        "nothing is placed where nothing is picked"
    );
    let long = Fault {
        strength: 9,
        ..Fault::new(FaultKind::Oscillation)
    };
    assert!(
        unfit(tables(), &[long])
            .to_string()
            .ends_with("strength 9 within 1..=3")
    );
}

#[test]
fn detours_do_no_harm_and_two_faults_may_meet() {
    for detour in Detour::ALL {
        for seed in 0..4 {
            let (flat, label) = in_flat(
                tables(),
                &Injection {
                    faults: Vec::new(),
                    detours: vec![detour],
                    seed,
                },
            );
            assert!(
                flat.success() && flat.finished && label.primary.is_none(),
                "{detour:?}: {:?}",
                flat.log
            );
        }
    }
    let fault = |kind, repaired| Fault {
        repaired,
        ..Fault::new(kind)
    };
    let injection = |faults: Vec<Fault>| Injection {
        faults,
        detours: Vec::new(),
        seed: 4,
    };
    let (flat, label) = in_flat(
        tables(),
        &injection(vec![
            fault(FaultKind::WrongReceptacle, false),
            fault(FaultKind::WrongKind, false),
        ]),
    );
    assert!(
        label.faults.iter().all(|fault| fault.step.is_some()),
        "{:?}",
        flat.log
    );
    assert_eq!(
        label.primary.unwrap().sub_class,
        "wrong_kind",
        "it picks before it places"
    );
    let (flat, label) = in_flat(
        tables(),
        &injection(vec![
            fault(FaultKind::WrongAttribute, true),
            fault(FaultKind::Oscillation, true),
        ]),
    );
    assert!(flat.success(), "{:?}", flat.log);
    assert!(label.faults.iter().all(|fault| fault.repaired) && label.primary.is_none());
    let (_, label) = in_flat(
        fuzzy(),
        &injection(vec![
            fault(FaultKind::MissingAsk, false),
            fault(FaultKind::InvalidOutput, true),
        ]),
    );
    assert_eq!(label.primary.unwrap().sub_class, "missing_ask");
}

#[test]
fn samples_fit_repeat_and_spread_over_the_kinds() {
    let (task, scene) = (Arc::new(tables()), flat::scene());
    let options = SampleOptions {
        combinations: 0.3,
        repaired: 0.3,
        ..SampleOptions::default()
    };
    let mut counts: BTreeMap<FaultKind, usize> = BTreeMap::new();
    for seed in 0..2000 {
        let drawn = sample(&task, &scene, seed, &options).unwrap();
        assert_eq!(Some(&drawn), sample(&task, &scene, seed, &options).as_ref());
        *counts.entry(drawn.faults[0].kind).or_default() += 1;
    }
    let mean = 2000 / counts.len();
    assert_eq!(
        counts.keys().copied().collect::<Vec<_>>(),
        admitted(&task, &scene)
    );
    assert!(
        counts
            .values()
            .all(|count| (mean / 2..mean * 2).contains(count)),
        "{counts:?}"
    );
    let none = SampleOptions {
        kinds: &[FaultKind::MissingAsk],
        ..options
    };
    assert_eq!(sample(&task, &scene, 1, &none), None);
    let mix = paper_mix();
    let of = |class| mix.iter().filter(|wanted| **wanted == class).count();
    assert_eq!(
        (
            mix.len(),
            of(None),
            of(Some(FailureClass::ObjectConfusion)),
            of(Some(FailureClass::Other))
        ),
        (100, 47, 25, 2)
    );
    assert!(
        FailureClass::ALL
            .iter()
            .all(|class| !FaultKind::of_class(*class).is_empty())
    );
}

/// Generated tasks of all families, and as many with a thing more.
struct World {
    scene: Arc<Scene>,
    tasks: Vec<Arc<Task>>,
}

impl World {
    fn new(count: usize, seed: u64) -> World {
        let scene = Arc::new(home_scene());
        let made = draw(&DrawOptions {
            scene: &scene,
            families: &Family::ALL,
            count,
            seed,
        });
        let mut tasks: Vec<Arc<Task>> = made.tasks.into_iter().map(Arc::new).collect();
        let more: Vec<Task> = tasks
            .iter()
            .filter_map(|task| cluttered(task, &scene, &tasks, seed))
            .collect();
        tasks.extend(more.into_iter().map(Arc::new));
        World { scene, tasks }
    }

    fn play(
        &self,
        task: &Arc<Task>,
        injection: &Injection,
        record: Option<&RecordTo>,
    ) -> (EpisodeReport, Label) {
        let config = EpisodeConfig {
            task: task.clone(),
            scene: self.scene.clone(),
            seed: injection.seed,
            profile: Profile::Paper,
            skills: Skills::Perfect,
            meshes: reel_world::Meshes::default(),
            preset: Preset::paper(),
            run_id: "run".into(),
            policy: PolicyInfo::default(),
            rollout: None,
            parent: None,
        };
        run_injected(config, injection, record).unwrap()
    }

    /// So many episodes of a kind, on tasks that admit it.
    fn sampled(&self, kind: FaultKind, repaired: f64, count: usize) -> Vec<(EpisodeReport, Label)> {
        let kinds = [kind];
        let options = SampleOptions {
            kinds: &kinds,
            repaired,
            ..SampleOptions::default()
        };
        let task = |seed: u64| &self.tasks[seed as usize * 7 % self.tasks.len()];
        let fits = (0..).take(10 * self.tasks.len());
        let drawn = fits.filter_map(|seed| {
            Some((task(seed), sample(task(seed), &self.scene, seed, &options)?))
        });
        drawn
            .take(count)
            .map(|(task, injection)| self.play(task, &injection, None))
            .collect()
    }
}

#[test]
fn on_generated_tasks_faults_fail_and_repaired_ones_do_not() {
    let world = World::new(24, 3);
    let rows = |kind: &FaultKind| {
        (
            *kind,
            world.sampled(*kind, 0.0, UNREPAIRED),
            world.sampled(*kind, 1.0, REPAIRED),
        )
    };
    let (early, late) = FaultKind::ALL.split_at(FaultKind::ALL.len() / 2);
    let table: Vec<_> = std::thread::scope(|scope| {
        let other = scope.spawn(|| late.iter().map(rows).collect::<Vec<_>>());
        let mut table: Vec<_> = early.iter().map(rows).collect();
        table.extend(other.join().unwrap());
        table
    });
    let (mut begun, mut failed, mut all_repaired, mut succeeded) = (0, 0, 0, 0);
    eprintln!(
        "{:18} {:>4} {:>6} {:>6} {:>6}   repaired: {:>4} {:>6} {:>6}",
        "kind", "ran", "begun", "failed", "steps", "ran", "failed", "steps"
    );
    for (kind, wrong, repaired) in &table {
        let steps = |rows: &[(EpisodeReport, Label)]| {
            rows.iter()
                .map(|(report, _)| f64::from(report.length))
                .sum::<f64>()
                / rows.len().max(1) as f64
        };
        let failures = |rows: &[(EpisodeReport, Label)]| {
            rows.iter().filter(|(report, _)| !report.success).count()
        };
        let came: Vec<_> = wrong
            .iter()
            .filter(|(_, label)| label.faults[0].step.is_some())
            .collect();
        let came_and_failed = came.iter().filter(|(report, _)| !report.success).count();
        eprintln!(
            "{:18} {:4} {:6} {:6} {:6.1}             {:4} {:6} {:6.1}",
            kind.name(),
            wrong.len(),
            came.len(),
            failures(wrong),
            steps(wrong),
            repaired.len(),
            failures(repaired),
            steps(repaired)
        );
        assert_eq!(wrong.len(), UNREPAIRED, "{kind}: too few tasks admit it");
        // An old number need not mean another object on every table.
        assert!(
            came.len() == UNREPAIRED || (*kind == FaultKind::StaleWrongObject && !came.is_empty()),
            "{kind} did not come about"
        );
        for (report, label) in &came {
            let primary = label.primary.as_ref().filter(|_| !report.success);
            assert!(
                primary.is_none_or(
                    |primary| primary.class == kind.class() && primary.step < report.length
                ),
                "{label:?}"
            );
        }
        begun += came.len();
        failed += came_and_failed;
        let corrected = repaired
            .iter()
            .filter(|(_, label)| label.faults[0].repaired);
        let results: Vec<bool> = corrected.map(|(report, _)| report.success).collect();
        all_repaired += results.len();
        succeeded += results.iter().filter(|success| **success).count();
    }
    assert!(failed * 100 >= begun * 95, "{failed} of {begun} failed");
    assert!(
        all_repaired >= 20 && succeeded * 10 >= all_repaired * 8,
        "{succeeded} of {all_repaired} succeeded"
    );
}

#[test]
fn the_label_lies_beside_the_trace_and_only_there() {
    let world = World::new(4, 5);
    let folder = tempfile::tempdir().unwrap();
    let record = RecordTo {
        path: folder.path().join("episode.mcap"),
        options: reel_trace::RecordOptions::default(),
    };
    let (report, label) = world.play(
        &world.tasks[0],
        &one(FaultKind::FalseHistory, 9),
        Some(&record),
    );
    let mut beside = report.trace.clone().unwrap().into_os_string();
    beside.push(".label.json");
    assert_eq!(
        serde_json::from_str::<Label>(&fs::read_to_string(beside).unwrap()).unwrap(),
        label
    );

    let trace = Trace::read(&report.trace.unwrap()).unwrap();
    assert_eq!(trace.header.policy, label.policy);
    let said = serde_json::to_string(&trace.steps).unwrap();
    assert!(
        !said.contains("false_history") && !said.contains("False"),
        "{said}"
    );
    // What the history claims was placed, no call placed.
    let last = trace.steps.last().unwrap().input.policy.as_ref().unwrap();
    let deeds = last.history.split("; ").count();
    assert!(deeds > trace.steps.len() - 1, "{}", last.history);
}
