//! What the rules write as History beside the validator of Histories: not one claim is refuted,
//! and most are understood.

use reel_annotate::{PublicTask, Step, annotate};
use reel_history::{Checker, ClaimVerdict, EpisodeFacts, StepFacts};

use crate::traces;

#[test]
fn no_history_is_contradicted_by_the_record() {
    let (mut refuted, mut supported, mut claims_made) = (Vec::new(), 0, 0);
    for trace in traces() {
        let (task, steps) = (PublicTask::of(&trace.task, &trace.scene), Step::all(&trace));
        for seed in 0..3 {
            let mut checker = Checker::new(EpisodeFacts::of(
                &trace.task,
                &trace.scene,
                &trace.start.graphs.physics,
            ));
            for (index, note) in annotate(&task, &steps, seed).iter().enumerate() {
                for claim in checker.check(&note.history) {
                    claims_made += 1;
                    supported +=
                        usize::from(matches!(claim.verdict, ClaimVerdict::Supported { .. }));
                    if claim.is_false() {
                        let text = &note.history[claim.span.clone()];
                        refuted.push(format!(
                            "{} step {index}: {text:?} [{}] {:?}",
                            trace.path.display(),
                            claim.kind,
                            claim.verdict
                        ));
                    }
                }
                // the published `ask` has two arguments, which are one question
                let argument = steps[index].argument.as_deref().map(str::to_owned);
                checker.push_step(StepFacts {
                    argument,
                    ..StepFacts::of(&trace.steps[index])
                });
            }
        }
    }
    refuted.dedup_by(|one, other| {
        one.split_once(": ").map(|it| it.1) == other.split_once(": ").map(|it| it.1)
    });
    assert!(
        refuted.is_empty(),
        "{} of {claims_made} refuted:\n{}",
        refuted.len(),
        refuted.join("\n")
    );
    assert!(
        supported * 100 >= claims_made * 85,
        "only {supported} of {claims_made} claims are understood"
    );
    eprintln!("{supported} of {claims_made} claims are supported, none is refuted");
}
