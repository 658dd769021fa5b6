//! Injected faults: the measured step against the step at which the fault began, and what
//! comes of the advice.

use reel_agents::{FaultKind, Injection, Label, RecordTo, SampleOptions, sample};
use reel_counterfactual::blame::{CompetentAgent, Edit, Harm, alternative, blame, repair};
use reel_counterfactual::branch::{Branch, Continuation};
use reel_trace::{Images, RecordOptions, Trace};
use reel_world::{Family, ToolCall};

use crate::stage::{Stage, told};

const KINDS: [FaultKind; 6] = [
    FaultKind::WrongAttribute,
    FaultKind::MissingAsk,
    FaultKind::SimilarFurniture,
    FaultKind::MissingPick,
    FaultKind::PrematureFinish,
    FaultKind::Oscillation,
];

/// Failed episodes of the stage's tasks under injections of these kinds.
fn failed(
    stage: &Stage,
    options: &SampleOptions<'_>,
    seeds: std::ops::Range<u64>,
) -> Vec<(Trace, Injection, Label)> {
    let mut failed = Vec::new();
    for (seed, task) in seeds.zip(stage.tasks.iter().cycle()) {
        let Some(injection) = sample(task, &stage.scene, seed, options) else {
            continue;
        };
        let (trace, label) = stage.play_injected(task, &injection);
        if label.primary.is_some() && trace.end.as_ref().is_some_and(|end| !end.metrics.success) {
            failed.push((trace, injection, label));
        }
    }
    failed
}

/// The first fault that was never repaired counts.
fn began(label: &Label) -> Option<u32> {
    label
        .faults
        .iter()
        .filter(|fault| !fault.repaired)
        .filter_map(|fault| fault.step)
        .min()
}

#[test]
fn the_decisive_step_is_where_the_fault_began_and_the_advice_succeeds() {
    let stage = Stage::new(24, 5);
    let options = SampleOptions {
        combinations: 0.3,
        repaired: 0.3,
        kinds: &KINDS,
        ..SampleOptions::default()
    };
    let (mut all, mut right, mut wrong) = (0, 0, Vec::new());
    for (trace, injection, label) in failed(&stage, &options, 40..72) {
        let Some(step) = began(&label) else { continue };
        let found = blame(&trace);
        let decisive = found.decisive.expect("it failed");
        all += 1;
        if decisive.step == step {
            right += 1;
        } else {
            let found = blame(&trace);
            wrong.push(format!(
                "{injection:?}: it began at {step}, found {}\n{}",
                decisive.step,
                told(&trace, &found)
            ));
        }
        let better = alternative(
            &trace,
            &decisive,
            Some(&stage.folder().join("better.mcap")),
            CompetentAgent::default(),
        )
        .unwrap();
        let better = better.unwrap_or_else(|why| panic!("{why}\n{}", told(&trace, &blame(&trace))));
        assert!(better.verified);
    }
    assert!(all >= 15, "only {all} failed");
    assert!(
        right * 20 >= all * 19,
        "{right} of {all}:\n{}",
        wrong.join("\n")
    );
}

#[test]
fn a_wrong_object_is_repaired_by_one_number() {
    let stage = Stage::new(24, 5);
    let kinds = [FaultKind::WrongAttribute, FaultKind::MissingAsk];
    let options = SampleOptions {
        kinds: &kinds,
        detours: 0.0,
        ..SampleOptions::default()
    };
    let (mut all, mut single) = (0, 0);
    for (trace, _, _) in failed(&stage, &options, 0..12) {
        let found = blame(&trace);
        let decisive = found.decisive.unwrap();
        assert_eq!(
            (decisive.harm, decisive.tool.as_str()),
            (Harm::World, "pick")
        );
        let repair = repair(
            &trace,
            &decisive,
            Some(&stage.folder().join("repaired.mcap")),
        )
        .unwrap()
        .unwrap();
        assert!(repair.verified && !repair.edits.is_empty(), "{repair:?}");
        let repaired = Trace::read(repair.trace.as_ref().unwrap()).unwrap();
        assert!(repaired.end.as_ref().unwrap().metrics.success);
        assert_eq!(blame(&repaired).decisive, None);
        all += 1;
        single += usize::from(repair.edits.len() == 1);
    }
    assert!(all >= 3 && single * 2 >= all, "{single} of {all}");
}

#[test]
fn a_door_closed_again_is_to_blame_and_one_call_less_repairs_it() {
    let stage = Stage::new(8, 5);
    let mut found = 0;
    for task in stage.tasks.iter().filter(|task| task.family == Family::FDO) {
        let parent = stage.play(task, "oracle");
        let Some(open) = parent
            .steps
            .iter()
            .position(|step| step.tool_name() == "open")
        else {
            continue;
        };
        let close = ToolCall {
            name: "close".into(),
            ..parent.steps[open].input.call.clone()
        };
        let path = stage.folder().join("closed.mcap");
        let record = RecordTo {
            path: path.clone(),
            options: RecordOptions::from(Images::None),
        };
        let branch = Branch {
            calls: vec![close],
            continuation: Continuation::Parent(open + 1),
        };
        branch.play_at(&parent, open + 1, Some(&record)).unwrap();
        let trace = Trace::read(&path).unwrap();
        let decisive = blame(&trace).decisive.unwrap();
        assert_eq!(
            (decisive.step as usize, decisive.harm),
            (open + 1, Harm::World),
            "{}",
            told(&trace, &blame(&trace))
        );
        let repair = repair(&trace, &decisive, None).unwrap().unwrap();
        assert_eq!(repair.edits, [Edit::Delete { at: open + 1 }]);
        found += 1;
    }
    assert!(found >= 1);
}
