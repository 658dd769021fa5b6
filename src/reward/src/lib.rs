//! Reward presets and metrics as pure functions of recorded steps (SPEC sections 5 and 6).
//!
//! A preset reads the records in their order and gives the terms of each step; it never looks ahead, at the simulator or
//! at a clock, so that recomputing a trace gives what was recorded. One preset today, [`Paper`]; [`Preset`] and [`Rewarder`]
//! are where the next one goes.

mod ambiguity;
mod goal;
mod metrics;
mod paper;

use std::fmt;

use reel_world::{
    Scene, Task, WorldGraph,
    record::{Graphs, RewardTerm, StartRecord, StepRecord},
};

pub use metrics::{advantages, discounted_return, metrics};
pub use paper::Paper;

/// A set of reward rules by name.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug, Default)]
pub enum Preset {
    /// The paper's Detailed Reward Configuration: see [`Paper`].
    #[default]
    Paper,
}

/// Gives the reward terms of an episode, step by step.
pub trait Rewarder: fmt::Debug + Send {
    /// Takes in the state before the first decision. Called once, first.
    fn start(&mut self, start: &StartRecord);

    /// The terms of the next step; those that are zero are left out. The record's own `reward` is not read.
    fn step(&mut self, step: &StepRecord) -> Vec<RewardTerm>;
}

impl Preset {
    /// Every preset.
    pub const ALL: [Preset; 1] = [Preset::Paper];

    /// As it stands on the command line and in traces.
    pub fn name(self) -> &'static str {
        match self {
            Preset::Paper => "paper",
        }
    }

    /// Reads what [`Preset::name`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|preset| preset.name() == text)
    }

    /// The rules for one episode.
    pub fn rewarder(self, task: &Task, scene: &Scene) -> Box<dyn Rewarder> {
        match self {
            Preset::Paper => Box::new(Paper::new(task, scene)),
        }
    }

    /// The graph that scores under this preset (SPEC section 1, "Authority").
    pub fn authority(self, graphs: &Graphs) -> &WorldGraph {
        match self {
            Preset::Paper => &graphs.physics,
        }
    }
}

/// The terms of all steps at once: the same as streaming them.
pub fn rewards(preset: Preset, task: &Task, scene: &Scene, start: &StartRecord, steps: &[StepRecord]) -> Vec<Vec<RewardTerm>> {
    let mut rewarder = preset.rewarder(task, scene);
    rewarder.start(start);
    steps.iter().map(|step| rewarder.step(step)).collect()
}
