//! Every term of the built-in presets by name: its component, its published weight and what it
//! pays for. The one place that preset files, their schema and the documentation are made from.
//! Never computes a reward.

use std::fmt;

/// The rules that a preset is made of.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Base {
    /// The paper's Detailed Reward Configuration (`src/reward/src/paper.rs`).
    Paper,
    /// The reward class of the published code (`src/reward/src/real_repo.rs`).
    RealRepo,
    /// What the published trainer pays (`src/reward/src/real_trainer.rs`).
    RealTrainer,
}

impl Base {
    /// All bases, in the order in which they are listed for people.
    pub const ALL: [Base; 3] = [Base::Paper, Base::RealRepo, Base::RealTrainer];

    /// As it stands in preset files.
    pub fn as_str(self) -> &'static str {
        match self {
            Base::Paper => "paper",
            Base::RealRepo => "real-repo",
            Base::RealTrainer => "real-trainer",
        }
    }

    /// Reads what [`Base::as_str`] wrote.
    pub fn parse(text: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|base| base.as_str() == text)
    }

    /// Its terms, in the order in which a step pays them.
    pub fn terms(self) -> impl Iterator<Item = Term> {
        Term::ALL
            .iter()
            .copied()
            .filter(move |term| term.belongs_to(self))
    }

    /// Its components, in the order of its terms.
    pub fn components(self) -> Vec<&'static str> {
        let mut names: Vec<&str> = self.terms().map(Term::component).collect();
        names.dedup();
        names
    }
}

impl fmt::Display for Base {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

macro_rules! terms {
    ($($(#[doc = $doc:literal])* $name:ident = $bases:expr, $component:literal, $text:literal, $weight:literal;)*) => {
        /// One term of a preset. Its weight is what it pays once (or by how much it multiplies).
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum Term { $($(#[doc = $doc])* $name,)* }

        impl Term {
            /// Every term, those of `paper` first.
            pub const ALL: &[Term] = &[$(Term::$name,)*];

            /// The rules it belongs to.
            pub fn bases(self) -> &'static [Base] {
                match self { $(Term::$name => $bases,)* }
            }

            /// As it stands under `[weights]`; unique within its base.
            pub fn name(self) -> &'static str {
                match self { $(Term::$name => $text,)* }
            }

            /// The component of the reward that it adds to.
            pub fn component(self) -> &'static str {
                match self { $(Term::$name => $component,)* }
            }

            /// The term's published weight, which a preset file may override.
            pub fn published_weight(self) -> f64 {
                match self { $(Term::$name => $weight,)* }
            }

            /// What it pays for.
            pub fn doc(self) -> &'static str {
                match self { $(Term::$name => concat!($($doc),*).trim_ascii(),)* }
            }
        }
    };
}

const PAPER: &[Base] = &[Base::Paper];
/// The reward class alone pays the trainer's graph, tool and anti-exploit terms too.
const CLASS: &[Base] = &[Base::RealRepo, Base::RealTrainer];
const TRAINER: &[Base] = &[Base::RealTrainer];

terms! {
    /// For each newly matched element of the task's changes: goal changes, first visits,
    /// doors to be opened.
    Matched = PAPER, "task", "matched", 1.5;
    /// Once, the first time that all goal changes hold.
    AllHold = PAPER, "task", "all_hold", 2.0;
    /// Times the change of the share of the task's changes that were matched.
    Progress = PAPER, "prog", "progress", 2.0;
    /// For each event that reverses an achieved goal change.
    Reversed = PAPER, "phys", "reversed", -0.5;
    /// For placing a goal object on a receptacle that is not its goal.
    WrongReceptacle = PAPER, "phys", "wrong_receptacle", -2.0;
    /// For the first pick of an object that the goal moves away.
    ValidPick = PAPER, "phys", "valid_pick", 0.3;
    /// The first time that an object is carried between its source and its goal.
    InTransit = PAPER, "phys", "in_transit", 0.5;
    /// Once, for picking a goal object after a wrong one was put back.
    Recovery = PAPER, "phys", "recovery", 1.0;
    /// For a question while it is needed and its budget lasts.
    Ask = PAPER, "ask", "ask", 1.0;
    /// For each decision after the free ones.
    Time = PAPER, "time", "time", -0.03;
    /// For an invisible target or a call that is none.
    Severe = PAPER, "safe", "severe", -0.5;
    /// For an error of perception or of the gripper.
    Moderate = PAPER, "safe", "moderate", -0.3;

    /// For `pick`, `open` or `close` while the hand counts as occupied, and for `place` while
    /// it counts as empty.
    HandViolation = TRAINER, "hand", "hand_violation", -0.3;
    /// For an answer that holds a listed severe text.
    ListedSevere = TRAINER, "listed_error", "listed_severe", -0.5;
    /// For an answer that holds another listed text.
    ListedModerate = TRAINER, "listed_error", "listed_moderate", -0.3;

    /// For each change that is among the remaining targets, which it leaves.
    DiffMatch = CLASS, "diff_match", "diff_match", 1.5;
    /// For each change whose reverse is a target.
    WrongDiff = CLASS, "wrong_diff", "wrong_diff", -0.5;
    /// For each change that is neither a remaining target nor the reverse of a target.
    NeutralDiff = CLASS, "neutral_diff", "neutral_diff", 0.0;
    /// For adding an object that has a target to a place where no target is left for it.
    PlaceWrongFurniture = CLASS, "place_wrong_furniture", "place_wrong_furniture", -2.0;
    /// Once, when no target remains.
    PerfectMatch = CLASS, "perfect_match", "perfect_match", 2.0;
    /// Times the change of completion.
    ProgressShaping = CLASS, "progress_shaping", "progress_shaping", 2.0;
    /// For each step after the free ones.
    StepPenalty = CLASS, "step_penalty", "step_penalty", -0.03;
    /// Once an object, when one is held that has a target `remove`.
    PickCorrectObject = CLASS, "pick_correct_object", "pick_correct_object", 0.3;
    /// Once an object, when something is held and the object is neither at its source
    /// nor at its goal.
    PartialMove = CLASS, "partial_move", "partial_move", 0.5;
    /// Once, when a target object is held after a wrong one was returned.
    ReplanRecoverPick = CLASS, "replan_recover_pick", "replan_recover_pick", 1.0;
    /// The first time that a target object has a marker (anti-exploit).
    TargetFirstDiscovered = CLASS, "target_first_discovered", "target_first_discovered", 1.0;
    /// The first call of `nav_to` for a receptacle of a target (anti-exploit).
    FirstVisitTargetFurniture = CLASS, "first_visit_target_furniture", "first_visit_target_furniture", 0.3;
    /// Times how often the receptacle is among the last ones driven to (anti-exploit).
    NavRevisitWindow = CLASS, "nav_revisit_window", "nav_revisit_window", -0.2;
    /// For a perception call that marks what the one before marked (anti-exploit).
    RepeatedPerception = CLASS, "repeated_perception", "repeated_perception", -0.3;
    /// For a gaze at the marker of the gaze before (anti-exploit).
    RepeatedGaze = CLASS, "repeated_gaze", "repeated_gaze", -0.2;
    /// For `finish` while targets remain (`real-repo`: anti-exploit).
    PrematureFinish = CLASS, "premature_finish", "premature_finish", -3.0;
    /// For the first questions.
    AskTool = CLASS, "ask", "ask", 1.0;
    /// For the first questions while several objects of the target's category were seen.
    AskWhenAmbiguous = CLASS, "ask_when_ambiguous", "ask_when_ambiguous", 0.5;
    /// For a pick with the marker that the last answer named.
    UsedMarkerFromAnswer = CLASS, "used_marker_from_answer", "used_marker_from_answer", 0.5;
    /// For any other pick while several were seen and nobody was asked.
    BlindPick = CLASS, "blind_pick", "blind_pick", -0.15;

    /// For `finish` when no target remains.
    FinishComplete = TRAINER, "finish", "finish_complete", 2.0;
    /// For `finish` while targets remain.
    FinishIncomplete = TRAINER, "finish", "finish_incomplete", -1.0;
    /// Times the completion, for `finish` while targets remain.
    FinishCompletion = TRAINER, "finish", "finish_completion", 1.0;
    /// For an answer of the model that holds no call.
    UnreadableAnswer = TRAINER, "unreadable_answer", "unreadable_answer", -0.5;
    /// For a call that took longer than the trainer waits.
    CallTimeout = TRAINER, "call_timeout", "call_timeout", -0.3;
    /// For a call that failed for good, which ends the episode.
    CallFailed = TRAINER, "call_failed", "call_failed", -1.0;
    /// At the environment's step limit while targets remain.
    StepLimit = TRAINER, "step_limit", "step_limit", -1.0;
    /// At the scheduler's turn limit, if the episode did not end before.
    TurnLimit = TRAINER, "turn_limit", "turn_limit", -1.0;
}

impl Term {
    /// Whether presets of a base have it.
    pub fn belongs_to(self, base: Base) -> bool {
        self.bases().contains(&base)
    }

    /// Whether it is one of the published anti-exploit terms, which are off unless
    /// a preset says otherwise.
    pub fn is_anti_exploit(self) -> bool {
        (Term::TargetFirstDiscovered..=Term::PrematureFinish).contains(&self)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    #[test]
    fn names_are_unique_within_a_base_and_components_stand_together() {
        for base in Base::ALL {
            let names: BTreeSet<&str> = base.terms().map(Term::name).collect();
            assert_eq!(names.len(), base.terms().count());
            let components: BTreeSet<&str> = base.components().into_iter().collect();
            assert_eq!(components.len(), base.components().len());
            assert_eq!(Base::parse(base.as_str()), Some(base));
        }
        assert_eq!(
            Base::Paper.components(),
            ["task", "prog", "phys", "ask", "time", "safe"]
        );
        assert_eq!(
            Term::ALL
                .iter()
                .filter(|term| term.is_anti_exploit())
                .count(),
            6
        );
    }
}
