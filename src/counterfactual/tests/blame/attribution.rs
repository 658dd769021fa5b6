//! Capabilities made perfect one at a time, against faults that were injected on purpose.

use reel_agents::{Fault, FaultKind, Injection};
use reel_counterfactual::attribution::{AttributionOptions, Capability, attribute, known_success};

use crate::stage::Stage;

const SINGLE: [FaultKind; 7] = [
    FaultKind::WrongAttribute,
    FaultKind::SimilarFurniture,
    FaultKind::MissingAsk,
    FaultKind::Oscillation,
    FaultKind::MissingPick,
    FaultKind::PrematureFinish,
    FaultKind::RepeatedFailure,
];

#[test]
fn a_fault_costs_its_own_capability_and_no_other() {
    let tasks = if reel_vectors::is_long() { 24 } else { 16 };
    let stage = Stage::new(tasks, 5);
    let (mut right, mut all, mut wrong) = (0, 0, Vec::new());
    for (index, task) in stage.tasks.iter().enumerate() {
        for (at, kind) in SINGLE.into_iter().enumerate() {
            let injection = Injection {
                faults: vec![Fault::new(kind)],
                detours: Vec::new(),
                seed: (100 * index + at) as u64,
            };
            if reel_agents::Injected::new(task, &stage.scene, &injection).is_err() {
                continue;
            }
            let (trace, label) = stage.play_injected(task, &injection);
            let found = attribute(&trace, &AttributionOptions::default());
            for capability in Capability::ALL {
                let known = known_success(&trace, &label, capability).unwrap();
                all += 1;
                match found.success_with(capability) == Some(known) {
                    true => right += 1,
                    false => wrong.push(format!(
                        "{kind} {}: known {known}, {:?}",
                        capability.name(),
                        found
                            .capabilities
                            .iter()
                            .find(|one| one.capability == capability)
                    )),
                }
            }
        }
    }
    println!("{right} of {all}\n{}", wrong.join("\n"));
    assert!(
        right * 100 >= all * 97,
        "{right} of {all}:\n{}",
        wrong.join("\n")
    );
}
