//! The rules of the presets, their laws, preset files and the quantities of GSPO, on
//! a flat without physics.

mod advantage;
mod bounds;
mod columns;
mod flat;
mod gspo;
mod laws;
mod paper;
mod presets;
mod real_contract;
mod real_repo;
mod real_trainer;

use flat::{Act, Flat, GREEN, RED};
use reel_reward::{Preset, metrics, rewards};
use reel_world::{
    ErrorCode, Task,
    record::{Graphs, Metrics, RewardTerm},
};

const NAMES_ONE: &str = "I mean the red one, marker 1.";
const REPLY: &str = "I mean the red one.";

/// The calls of the worked examples. The answer names the red apple, and marker 1.
fn worked_example(reply: &'static str) -> Vec<Act> {
    use Act::*;
    vec![
        Nav("table_1"),
        Look("table_1"),
        Ask(reply),
        Nav("fridge_0"),
        Open("fridge_0"),
        Nav("table_1"),
        Pick(GREEN),
        Place("table_1"),
        Pick(RED),
        Nav("fridge_0"),
        Fail(ErrorCode::UnknownMarker),
        Place("fridge_0"),
        Finish,
    ]
}

/// Plays a script and pays its steps.
fn play_by(preset: &Preset, task: &Task, script: &[Act]) -> (Flat, Vec<Vec<RewardTerm>>) {
    let flat = Flat::play(task, script);
    let terms = rewards(
        preset,
        task,
        &flat::task().1,
        &flat::start(task),
        &flat.steps,
    );
    (flat, terms)
}

/// Compares what each step of a successful play pays with `expected`; gives the
/// metrics of the episode.
#[track_caller]
fn close_steps(
    preset: &Preset,
    flat: &mut Flat,
    terms: &[Vec<RewardTerm>],
    expected: &[f64],
) -> Metrics {
    assert_eq!(terms.len(), expected.len());
    for (step, (terms, expected)) in terms.iter().zip(expected).enumerate() {
        assert!(
            (sum(terms) - expected).abs() < 1e-9,
            "step {step}: expected {expected}, found {terms:?}"
        );
    }
    flat.steps
        .iter_mut()
        .zip(terms)
        .for_each(|(step, terms)| step.reward.clone_from(terms));
    let (task, _) = flat::task();
    let graphs = Graphs {
        registry: flat.graph.clone(),
        ..Graphs::default()
    };
    let metrics = metrics(preset, &task, &flat::start(&task), &flat.steps, &graphs);
    assert!(metrics.success);
    metrics
}

fn sum(terms: &[RewardTerm]) -> f64 {
    terms.iter().map(|term| term.value).sum()
}

fn component(terms: &[Vec<RewardTerm>], name: &str) -> f64 {
    terms
        .iter()
        .flatten()
        .filter(|term| term.component == name)
        .map(|term| term.value)
        .sum()
}

#[track_caller]
fn close(found: f64, expected: f64) {
    assert!(
        (found - expected).abs() < 1e-9,
        "found {found}, expected {expected}"
    );
}
