//! Rewards and metrics as pure functions of what was recorded (docs/spec.md#reward-preset-paper and
//! docs/spec.md#metrics).
//!
//! One engine, two sources: records and table columns become the same facts ([`TaskFacts`],
//! [`EpisodeFacts`]), and a [`Scorer`] runs the rules of a [`Preset`] on facts alone. It reads them
//! in their order and gives the terms of each step; it never looks ahead, at the simulator or at a
//! clock, so that recomputing gives what was recorded, bit for bit.
//!
//! Rewards from columns, episode by episode; records take [`Preset::rewarder`] or
//! [`EpisodeFacts::record`]:
//!
//! ```
//! use reel_reward::{Authority, EpisodeFacts, EpisodeReward, MarkerReferent, Preset, Scorer, StepHead, TaskFacts};
//! # fn columns(task: &reel_world::Task, scene: &reel_world::Scene) -> Option<()> {
//! let mut facts = TaskFacts::new(task, scene); // once a task and thread
//! let mut scorer = Scorer::new(&Preset::paper()); // once a thread, for all tasks
//! let (mut episode, mut reward) = (EpisodeFacts::default(), EpisodeReward::default()); // buffers
//! facts.begin(&mut episode); // once an episode; first how its start differs from the task's, by authority
//! episode.change(Authority::Physics, facts.change("add", Some("red_on_table_1_at_t"), "floor", None, None)?);
//! episode.push_visible(facts.object("red_on_table_1_at_t"));
//! let call = facts.head_of_call("pick", None, Some("1")); // then each step: tool, error_code, argument
//! let red = facts.object("red_on_table_1_at_t");
//! let reply = None::<&str>.map(|text| facts.text(text));
//! let trainer_reading = facts.trainer_reading(&call, "Picked up the object."); // for `real-trainer`
//! episode.step(StepHead { error: None, object: Some(red), receptacle: None, held: Some(red), reply, trainer_reading, ..call });
//! episode.change(Authority::Registry, facts.change("remove", Some("red_on_table_1_at_t"), "table_1", None, None)?);
//! episode.push_visible(facts.object("green_on_table_1_at_t")); // seen or told for the first time
//! episode.set_markers(); // the whole map after the call; may be left out where it is as before
//! episode.mark(1, MarkerReferent::Object(red));
//! scorer.score(&mut facts, &episode, &mut reward);
//! println!("{} {} {}", reward.total(), reward.discounted_return(), reward.component("task"));
//! # Some(())
//! # }
//! ```

mod advantage;
mod ambiguity;
mod bounds;
mod difference;
mod difference_reward;
mod error;
mod facts;
mod goal;
pub mod gspo;
mod metrics;
mod paper;
mod preset;
mod preset_file;
#[cfg(test)]
mod real_contract;
mod real_repo;
mod real_trainer;
mod records;
mod returns;
mod score;
mod terms;
pub mod trainer;
mod training_metric;

use std::fmt;

use reel_world::record::{RewardTerm, StartRecord, StepRecord};

pub use advantage::{Estimator, PAPER_EPS, Scale, group_relative};
pub use bounds::{OpenReward, RewardBounds, open_reward, open_reward_of_record, reward_bounds};
pub use difference::{ComponentDifference, RewardDifference, difference};
pub use error::RewardError;
pub use facts::{
    Authority, Change, Delivery, EpisodeFacts, MarkerReferent, ObjectKey, ReceptacleKey,
    StartFacts, StepFacts, StepHead, TaskFacts, TextKey, ToolKind, TrainerReading,
};
pub use metrics::{discounted_return, metrics};
pub use preset::{Preset, rewards};
pub use real_trainer::{TrainerEnd, TrainerState};
pub use returns::Returns;
pub use score::{AppliedTerm, EpisodeReward, Scorer};
pub use terms::{Base, Term};
pub use training_metric::{EpisodeOutcome, MetricOptions, TrainingFigures, TrainingMetric};

/// Gives the reward terms of an episode, step by step, from its records.
pub trait Rewarder: fmt::Debug + Send {
    /// Takes in the state before the first decision. Called once, first.
    fn start(&mut self, start: &StartRecord);

    /// The terms of the next step; those that are zero are left out. The record's own
    /// `reward` is not read.
    fn step(&mut self, step: &StepRecord) -> Vec<RewardTerm>;
}
