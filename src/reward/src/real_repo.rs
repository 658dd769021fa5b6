//! Preset `real-repo`: the reward of the published code (REAL's gspo branch), number for number, by
//! the definitions of docs/spec.md#reward-preset-real-repo.
//!
//! The registry scores, and objects count as their assets. What is repeated here is the
//! published *reward class* (`src/difference_reward.rs` has its rules); a step is a decision of
//! the record, also `finish` and calls that are none, and what is held counts as its asset, as
//! the published environment translates it.
//!
//! What the class is told by its environment is derived so:
//! - Several were seen: after `walk_around` or `show_object_by_category` the marker map held more
//!   than one object whose category contains the target's. A successful pick forgets it.
//! - The answer names a marker: the longest number of the current marker map that occurs in it (the
//!   smallest of equally long ones); without a map, the word that follows `marker`. It stays until
//!   another answer names one or a pick succeeds.
//! - An `ask` followed: any `ask` since several were seen first.
//! - A pick is judged by what was known before it. (The published environment forgets that before
//!   it judges, so that there only picks that fail can earn or cost; and only an answer that names
//!   a marker counts. `pick_clears_first` does the same.)
//! - Markers are compared as texts; a number stands for its digits.
//!
//! What the published environment pays besides (errors, the hand, `finish`, the horizon), and that
//! it compares categories, is preset `real-trainer` (`src/real_trainer.rs`).
//!
//! # A worked example
//! The task and the calls of the example in `paper.rs`: a red and a green apple on `table_1`, the
//! red one goes to `fridge_0`. Targets: `{-red@table_1, +red@fridge_0}`, so that a match gives 1.5
//! (diff_match) + 2.0/2 (progress_shaping) = 2.5.
//!
//! | step | call | terms | sum |
//! |---|---|---|---|
//! | 0 | `nav_to` table_1 | | 0 |
//! | 1 | `walk_around`: marks both | | 0 |
//! | 2 | `ask`: "marker 1" | ask 1.0, ask_when_ambiguous 0.5 | 1.5 |
//! | 3 | `nav_to` fridge_0 | step_penalty -0.03 | -0.03 |
//! | 4 | `open` | step_penalty -0.03 | -0.03 |
//! | 5 | `nav_to` table_1 again | step_penalty -0.03 | -0.03 |
//! | 6 | `pick` green | step_penalty -0.03 | -0.03 |
//! | 7 | `place` it back on table_1 | step_penalty -0.03 | -0.03 |
//! | 8 | `pick` red | 2.5, pick_correct_object 0.3, partial_move 0.5, step_penalty -0.03 | 3.27 |
//! | 9 | `nav_to` fridge_0 | step_penalty -0.03 | -0.03 |
//! | 10 | `place` on an unknown marker | step_penalty -0.03 | -0.03 |
//! | 11 | `place` into fridge_0 | 2.5, perfect_match 2.0, step_penalty -0.03 | 4.47 |
//! | 12 | `finish` | step_penalty -0.03 | -0.03 |
//!
//! In all 9.0. The green apple is not what the answer named, but somebody was asked, so that pick
//! costs nothing; and it forgets the answer. With the anti-exploit terms: +1.0 (step 1, red has a
//! marker), +0.3 each in steps 0 and 3, -0.2 each in steps 5 and 9. The test
//! `worked_example_of_the_published_code` takes these steps.

use crate::{
    difference_reward::{Dialogue, DifferenceReward},
    facts::{Identity, MarkerReferent, StartFacts, StepFacts, TaskFacts, TextKey, ToolKind},
    score::{Cause, TermSink},
    terms::Term,
    trainer::marker_in_answer,
};

/// The state of the rules during one episode. The page of this module has a worked example.
#[derive(Clone, Debug)]
pub(crate) struct RealRepo {
    reward: DifferenceReward,
    map: Vec<(u32, MarkerReferent)>,
    dialogue: Dialogue,
}

impl RealRepo {
    pub(crate) fn new() -> Self {
        Self {
            reward: DifferenceReward::new(Identity::Asset),
            map: Vec::new(),
            dialogue: Dialogue::default(),
        }
    }

    /// Takes in the state before the first decision.
    pub(crate) fn start(&mut self, facts: &TaskFacts, start: &StartFacts) {
        self.reward.start(facts, start.registry);
        self.map.clear();
        self.dialogue = Dialogue::default();
    }

    /// The share of the targets that was matched; 1 where there are none.
    pub(crate) fn completion(&self) -> f64 {
        self.reward.completion()
    }

    /// Pays the terms of the next step, in the order of the published code.
    pub(crate) fn step(&mut self, facts: &mut TaskFacts, step: &StepFacts, paid: &mut TermSink) {
        let (head, rules) = (&step.head, paid.preset().rules);
        if let Some(map) = step.markers {
            self.map.clear();
            self.map.extend_from_slice(map);
        }
        let held = head.held.map(|held| facts.held_kind(Identity::Asset, held));
        self.reward
            .step(facts, step.registry, held, &self.map, paid);
        self.reward.track(facts, head, &self.map, paid);
        let remaining = self.reward.remaining();
        if rules.anti_exploit && head.tool == ToolKind::Finish && remaining > 0 {
            paid.once(Term::PrematureFinish, Cause::Count(remaining as u32));
        }
        let picked = head.succeeded(ToolKind::Pick);
        if picked && rules.pick_clears_first {
            self.dialogue = Dialogue::default();
        }
        match head.tool {
            ToolKind::WalkAround | ToolKind::ShowObjectByCategory => {
                let like = |marked: &MarkerReferent| matches!(marked, MarkerReferent::Object(object) if facts.of(*object).like_target);
                if self.map.iter().filter(|(_, marked)| like(marked)).count() > 1 {
                    self.dialogue.see_several();
                }
            }
            ToolKind::Ask => {
                let named = head
                    .reply
                    .and_then(|reply| named_marker(facts, reply, &self.map));
                self.dialogue.asked |= named.is_some() || !rules.pick_clears_first;
                self.dialogue.named = named.or(self.dialogue.named);
            }
            _ => {}
        }
        self.reward
            .tools(head.tool, head.marker, self.dialogue, paid);
        if picked {
            self.dialogue = Dialogue::default();
        }
    }
}

/// The marker that an answer names, given the current map.
pub(crate) fn named_marker(
    facts: &mut TaskFacts,
    answer: TextKey,
    map: &[(u32, MarkerReferent)],
) -> Option<TextKey> {
    let known: Vec<String> = map.iter().map(|(number, _)| number.to_string()).collect();
    let named = marker_in_answer(facts.text_of(answer), &known)?;
    Some(facts.text(&named))
}
