//! The rules of the presets, their laws, preset files and the quantities of GSPO, on a flat without physics.

mod advantage;
mod columns;
mod flat;
mod gspo;
mod laws;
mod paper;
mod presets;
mod real_contract;
mod real_repo;
mod real_trainer;

use flat::{Act, GREEN, RED};
use reel_world::{ErrorCode, record::RewardTerm};

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

fn sum(terms: &[RewardTerm]) -> f64 {
    terms.iter().map(|term| term.value).sum()
}

fn component(terms: &[Vec<RewardTerm>], name: &str) -> f64 {
    terms.iter().flatten().filter(|term| term.component == name).map(|term| term.value).sum()
}

#[track_caller]
fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() < 1e-9, "found {found}, expected {expected}");
}
