//! Competent play, perturbed by operators at random moments, in random number and order. After a
//! perturbation the competent policy goes on with what the perturbed agent believes. Every operator
//! can be switched off with all other random choices kept, so that what it caused can be measured
//! by playing on ([`Perturbation::keeping`]).
//!
//! Never what the rules of the taxonomy or blame say: the readings of a failure stand beside each
//! operator ([`OperatorKind::reading`]) and were written from the paper.

mod kind;
mod look_alike;
mod perturbed;
mod sample;
mod script;
mod words;

use serde::{Deserialize, Serialize};

pub use kind::{OperatorFamily, OperatorKind, Reading, Split};
pub use look_alike::look_alike;
pub use perturbed::{OperatorEvent, Perturbed};
pub use sample::sample_perturbation;

/// One operator with its parameters.
#[derive(Clone, Copy, PartialEq, Debug, Serialize, Deserialize)]
pub struct Operator {
    /// Which operator it is, with its reading and its half.
    pub kind: OperatorKind,
    /// Seed of its own choices, which no other operator draws from.
    pub seed: u64,
    /// When it begins, from 0 to 1, where the kind leaves a choice.
    pub position: f64,
    /// How long or often, from 1 to 28 calls or failures.
    pub strength: u32,
    /// Whether it is played; one that is switched off keeps its place in the list.
    pub enabled: bool,
}

/// The policy whose play is perturbed.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Base {
    /// The planner, which knows only what it saw.
    Planner,
    /// The oracle, which knows the simulator's truth.
    Oracle,
}

/// Everything that distinguishes an episode from competent play.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
pub struct Perturbation {
    /// Who plays where no operator does.
    pub base: Base,
    /// The operators, in the order in which they may begin at the same moment.
    pub operators: Vec<Operator>,
    /// How it talks: 0 not at all, else one of several styles.
    pub style: usize,
    /// Seed of the base.
    pub seed: u64,
}

impl Perturbation {
    /// The same with only the operators for which `keep` holds, by index.
    #[must_use]
    pub fn keeping(&self, keep: impl Fn(usize) -> bool) -> Self {
        let operator = |(index, operator): (usize, &Operator)| Operator {
            enabled: operator.enabled && keep(index),
            ..*operator
        };
        Self {
            operators: self.operators.iter().enumerate().map(operator).collect(),
            ..self.clone()
        }
    }

    /// Whether the skills of the arm fail in it.
    pub fn has_flaky_skills(&self) -> bool {
        let is_skill = |operator: &Operator| {
            operator.enabled && operator.kind.family() == OperatorFamily::Skill
        };
        self.operators.iter().any(is_skill)
    }
}
