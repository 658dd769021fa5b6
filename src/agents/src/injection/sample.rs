//! Draws injections that fit a task, by seed. Never plays them.

use std::sync::Arc;

use rand_chacha::ChaCha8Rng;
use reel_world::{FailureClass, Scene, Task};

use super::{Detour, Fault, FaultKind, Injected, Injection};
use crate::random;

/// Draws of a second fault before the first stays alone.
const SECOND_TRIES: usize = 12;
/// Most detours of an episode that has any.
const DETOURS_MAX: usize = 2;

/// What to draw from, and how often what comes. Shares are from 0 to 1.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SampleOptions<'a> {
    /// Share of episodes with two faults.
    pub combinations: f64,
    /// Share of faults that are repaired, of those that can be.
    pub repaired: f64,
    /// Share of episodes with detours.
    pub detours: f64,
    /// The kinds to draw from.
    pub kinds: &'a [FaultKind],
}

impl Default for SampleOptions<'_> {
    /// Every kind alone, never repaired, a detour in every third episode.
    fn default() -> Self {
        Self {
            combinations: 0.0,
            repaired: 0.0,
            detours: 1.0 / 3.0,
            kinds: FaultKind::ALL,
        }
    }
}

/// The kinds that a task admits.
pub fn admitted(task: &Arc<Task>, scene: &Scene) -> Vec<FaultKind> {
    let fits = |kind: &FaultKind| {
        let injection = Injection {
            faults: vec![Fault::new(*kind)],
            ..Injection::default()
        };
        Injected::new(task, scene, &injection).is_ok()
    };
    FaultKind::ALL.iter().copied().filter(fits).collect()
}

/// An injection that the task admits, each admitted kind equally likely; none where it admits
/// none of the kinds.
pub fn sample(
    task: &Arc<Task>,
    scene: &Scene,
    seed: u64,
    options: &SampleOptions<'_>,
) -> Option<Injection> {
    let mut rng = random::stream(seed, &format!("sample/{}", task.task_id), 0);
    let kinds: Vec<FaultKind> = admitted(task, scene)
        .into_iter()
        .filter(|kind| options.kinds.contains(kind))
        .collect();
    let kind = *random::choose(&mut rng, &kinds)?;
    let first = draw_fault(&mut rng, kind, options);
    let mut injection = Injection {
        faults: vec![first],
        detours: Vec::new(),
        seed,
    };
    if happens(&mut rng, options.combinations) {
        for _ in 0..SECOND_TRIES {
            let kind = *random::choose(&mut rng, &kinds)?;
            let faults = vec![first, draw_fault(&mut rng, kind, options)];
            let both = Injection {
                faults,
                ..injection.clone()
            };
            if Injected::new(task, scene, &both).is_ok() {
                injection = both;
                break;
            }
        }
    }
    if happens(&mut rng, options.detours) {
        let count = 1 + random::below(&mut rng, DETOURS_MAX);
        injection
            .detours
            .extend((0..count).filter_map(|_| random::choose(&mut rng, &Detour::ALL).copied()));
    }
    Injected::new(task, scene, &injection)
        .is_ok()
        .then_some(injection)
}

/// A hundred episodes in the proportions of the paper's analysis: the class wanted of each,
/// none for a success.
pub fn paper_mix() -> Vec<Option<FailureClass>> {
    let counts = [
        (None, 47),
        (Some(FailureClass::ObjectConfusion), 25),
        (Some(FailureClass::KeyActionMissing), 17),
        (Some(FailureClass::LostMemory), 9),
        (Some(FailureClass::Other), 2),
    ];
    counts
        .into_iter()
        .flat_map(|(class, count)| std::iter::repeat_n(class, count))
        .collect()
}

fn draw_fault(rng: &mut ChaCha8Rng, kind: FaultKind, options: &SampleOptions<'_>) -> Fault {
    let position = random::below(rng, 1000) as f64 / 1000.0;
    let strength = 1 + random::below(rng, 3) as u32;
    let repaired = happens(rng, options.repaired) && kind != FaultKind::PrematureFinish;
    Fault {
        kind,
        position,
        strength,
        repaired,
    }
}

fn happens(rng: &mut ChaCha8Rng, share: f64) -> bool {
    (random::below(rng, 10_000) as f64) < share * 10_000.0
}
