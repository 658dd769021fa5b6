//! Draws perturbations: which operators, how many, when and how strong. Never what comes of them.

use rand_chacha::{ChaCha8Rng, rand_core::Rng as _};
use reel_world::Task;

use super::{Base, Operator, OperatorFamily, OperatorKind, Perturbation, Split};
use crate::random;

/// Share of episodes, in a hundred, with 0, 1, 2, 3 and 4 operators.
const HOW_MANY: [usize; 5] = [4, 50, 26, 13, 7];
/// Longest series of calls of an operator.
const STRENGTH_MAX: usize = 28;

/// A perturbation of a task by operators of one half. Equal arguments give equal perturbations.
pub fn sample_perturbation(task: &Task, split: Split, seed: u64) -> Perturbation {
    let mut rng = random::stream(
        seed,
        &format!("perturb/{}/{}", split.name(), task.task_id),
        0,
    );
    let mut draw = random::below(&mut rng, 100);
    let mut count = 0;
    while draw >= HOW_MANY[count] {
        draw -= HOW_MANY[count];
        count += 1;
    }
    let kinds: Vec<OperatorKind> = OperatorKind::of(split)
        .into_iter()
        .filter(|kind| admits(task, *kind))
        .collect();
    let families: Vec<OperatorFamily> = {
        let mut all: Vec<_> = kinds.iter().map(|kind| kind.family()).collect();
        all.sort_unstable();
        all.dedup();
        all
    };
    let mut operators = Vec::new();
    for _ in 0..count {
        // families first, so that one with many operators is drawn no more often
        let Some(family) = random::choose(&mut rng, &families).copied() else {
            break;
        };
        let of: Vec<OperatorKind> = kinds
            .iter()
            .copied()
            .filter(|kind| kind.family() == family)
            .collect();
        if let Some(kind) = random::choose(&mut rng, &of).copied() {
            operators.push(operator(kind, &mut rng));
        }
    }
    let talks = operators
        .iter()
        .any(|one| one.kind.family() == OperatorFamily::Words);
    let style = random::below(&mut rng, 4);
    let scripted = |one: &Operator| {
        matches!(
            one.kind.family(),
            OperatorFamily::Wandering | OperatorFamily::Repetition | OperatorFamily::Output
        )
    };
    let oracle = random::below(&mut rng, 3) == 0 && operators.iter().all(scripted);
    Perturbation {
        base: if oracle { Base::Oracle } else { Base::Planner },
        operators,
        style: if talks { style.max(1) } else { style },
        seed,
    }
}

fn operator(kind: OperatorKind, rng: &mut ChaCha8Rng) -> Operator {
    let seed = rng.next_u64();
    let position = random::below(rng, 1000) as f64 / 1000.0;
    // half of the series are short, so that many of them are survived
    let strength = match random::below(rng, 2) {
        0 => 1 + random::below(rng, 6),
        _ => 7 + random::below(rng, STRENGTH_MAX - 6),
    };
    Operator {
        kind,
        seed,
        position,
        strength: strength as u32,
        enabled: true,
    }
}

/// Whether the operator can come about at all in this task.
fn admits(task: &Task, kind: OperatorKind) -> bool {
    match kind.family() {
        OperatorFamily::Dialogue => task.fuzzy,
        OperatorFamily::Object => !task.fuzzy,
        _ => true,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shares_of_operators_add_up() {
        assert_eq!(HOW_MANY.iter().sum::<usize>(), 100);
    }
}
