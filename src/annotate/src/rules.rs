//! The writer by rules: notes for a whole episode, each from what was known before its decision.

use reel_world::Digest;
use serde::{Deserialize, Serialize};

use crate::{
    english, history,
    memory::Memory,
    plan, reasoning,
    step::Step,
    task::PublicTask,
    voice::PhraseChooser,
    wordings::{self, history::NOTHING_YET},
};

/// Changes with every rule that changes what is written; [`version`] covers the wordings besides.
const RULES: u32 = 1;

/// What an agent says along with a decision (docs/spec.md#policy-context).
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
pub struct Annotation {
    /// `c_t`: why the call is made.
    pub reasoning: String,
    /// `sigma_t`: what was done and learned before it.
    pub history: String,
    /// `q_t`: what is left to do.
    pub schedule: String,
    /// What is done now.
    pub subtask: String,
}

/// Writes the notes of an episode, one a decision. Each follows from the instruction, the list of
/// receptacles, the decisions before it with what they came to, and its own call; never from what
/// its call came to or from what comes later. Equal arguments give equal notes; give every episode
/// a `seed` of its own ([`episode_seed`]).
pub fn annotate(task: &PublicTask, steps: &[Step<'_>], seed: u64) -> Vec<Annotation> {
    let voice = PhraseChooser { seed };
    let mut memory = Memory::new(task);
    let mut deeds: Vec<String> = Vec::with_capacity(steps.len());
    let mut notes = Vec::with_capacity(steps.len());
    for step in steps {
        let call = step.call();
        let history = if deeds.is_empty() {
            voice.phrase(NOTHING_YET, 0, &[])
        } else {
            deeds.join(" ")
        };
        notes.push(Annotation {
            reasoning: english::one_line(&reasoning::reasoning(&memory, call, voice)),
            history,
            schedule: english::one_line(&plan::schedule(&memory, call, voice)),
            subtask: english::one_line(&plan::subtask(&memory, call, voice)),
        });
        deeds.push(english::one_line(&history::step_facts(
            &memory, step, voice,
        )));
        memory.learn(step);
    }
    notes
}

/// The seed of an episode out of that of a data set.
pub fn episode_seed(seed: u64, trace: &Digest) -> u64 {
    let digest = Digest::of(format!("{seed}/{trace}").as_bytes());
    digest.0[..8]
        .iter()
        .fold(0, |seed, byte| seed << 8 | u64::from(*byte))
}

/// Version of the writer: of its rules and of all its wordings.
pub fn version() -> Digest {
    Digest::of_json(&(RULES, wordings::digest()))
}
