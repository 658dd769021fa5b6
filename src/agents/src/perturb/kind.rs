//! The operators that perturb competent play: their families, the half of the evaluation that may
//! use them, and how a reader of the paper would label a failure that one of them alone causes.
//! Never how one is acted out.

use std::fmt;

use reel_world::FailureClass::{self, KeyActionMissing, LostMemory, ObjectConfusion, Other};
use serde::{Deserialize, Serialize};

/// The half of an evaluation. The halves share no operator, no task and no seed.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// Its episodes may be looked at while rules are written.
    Development,
    /// Only its figures are shown.
    Report,
}

impl Split {
    /// The two halves, development first.
    pub const ALL: [Split; 2] = [Split::Development, Split::Report];

    /// Its name, as in arguments and files.
    pub const fn name(self) -> &'static str {
        match self {
            Split::Development => "development",
            Split::Report => "report",
        }
    }
}

/// What several operators have in common.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OperatorFamily {
    /// Something due is left out.
    Omission,
    /// Another object is taken for the target.
    Object,
    /// Another receptacle is taken for the destination.
    Receptacle,
    /// The user is asked wrongly, or not heard.
    Dialogue,
    /// A wrong number is used.
    Marker,
    /// The robot drives about.
    Wandering,
    /// Calls are made again.
    Repetition,
    /// What is put out is no valid call.
    Output,
    /// The episode ends at the wrong time.
    Ending,
    /// A skill of the arm fails.
    Skill,
    /// What the policy says differs from what it does.
    Words,
}

/// A class of the taxonomy and a sub-class within it.
pub type Reading = (FailureClass, &'static str);

macro_rules! operators {
    ($($name:ident $text:literal $family:ident $split:ident ($class:ident, $sub:literal) [$($fair:expr),*] $about:literal;)*) => {
        /// A way to perturb competent play.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum OperatorKind { $(#[doc = $about] $name,)* }

        impl OperatorKind {
            /// Every operator, in the order of declaration.
            pub const ALL: &[OperatorKind] = &[$(OperatorKind::$name,)*];

            /// Its name, as in `truth.json`.
            pub const fn name(self) -> &'static str {
                match self { $(OperatorKind::$name => $text,)* }
            }

            /// What the agent does, in one sentence.
            pub const fn description(self) -> &'static str {
                match self { $(OperatorKind::$name => $about,)* }
            }

            /// The family that it belongs to.
            pub const fn family(self) -> OperatorFamily {
                match self { $(OperatorKind::$name => OperatorFamily::$family,)* }
            }

            /// The half of the evaluation that may use it.
            pub const fn split(self) -> Split {
                match self { $(OperatorKind::$name => Split::$split,)* }
            }

            /// How a failure by this operator alone reads in the paper's taxonomy. An empty
            /// sub-class depends on the object that was taken ([`super::look_alike`]).
            pub const fn reading(self) -> Reading {
                match self { $(OperatorKind::$name => ($class, $sub),)* }
            }

            /// Other readings that a competent reader of the paper could defend; a sub-class `*`
            /// stands for any of its class.
            pub const fn fair(self) -> &'static [Reading] {
                match self { $(OperatorKind::$name => &[$($fair),*],)* }
            }
        }
    };
}

// The split was written down before any of Reel's answers was computed on these episodes.
#[rustfmt::skip]
operators! {
    SkipAsk "skip_ask" Dialogue Development (KeyActionMissing, "missing_ask") [(ObjectConfusion, "wrong_attribute")]
        "Asks nobody although several things fit, and takes one of the others.";
    IgnoreReply "ignore_reply" Dialogue Development (ObjectConfusion, "ignored_answer") [(ObjectConfusion, "*"), (LostMemory, "*")]
        "Asks, is told, and takes another object than the reply names.";
    AskBesides "ask_besides" Dialogue Report (KeyActionMissing, "missing_ask") [(ObjectConfusion, "*")]
        "Asks something that tells nothing apart, and takes one of the others.";
    ForgetReply "forget_reply" Dialogue Report (ObjectConfusion, "ignored_answer") [(ObjectConfusion, "*"), (LostMemory, "*")]
        "Asks, wanders off to another receptacle, and takes another object than the reply names.";

    SkipPick "skip_pick" Omission Development (KeyActionMissing, "missing_pick") [(KeyActionMissing, "missing_place"), (LostMemory, "false_history"), (LostMemory, "repeated_failure"), (KeyActionMissing, "premature_finish")]
        "Finds the target, believes it is in the hand, and goes on.";
    SkipPlace "skip_place" Omission Development (KeyActionMissing, "missing_place") [(KeyActionMissing, "premature_finish"), (LostMemory, "false_history")]
        "Reaches the destination, believes the object is placed, and goes on.";
    SkipOpen "skip_open" Omission Development (KeyActionMissing, "missing_open") [(LostMemory, "repeated_failure"), (KeyActionMissing, "never_looked"), (KeyActionMissing, "missing_place"), (KeyActionMissing, "missing_pick"), (KeyActionMissing, "premature_finish")]
        "Passes over a door that has to be opened, tries as if it were open, and gives up.";
    SkipSearch "skip_search" Omission Report (KeyActionMissing, "never_looked") [(KeyActionMissing, "missing_pick"), (LostMemory, "false_history"), (LostMemory, "repeated_failure"), (KeyActionMissing, "missing_place"), (KeyActionMissing, "premature_finish")]
        "Drives to the destination as if it had searched and picked.";
    SkipRest "skip_rest" Omission Report (KeyActionMissing, "premature_finish") [(KeyActionMissing, "*")]
        "Holds the object and leaves out everything between that and the end.";
    SkipClose "skip_close" Omission Development (KeyActionMissing, "premature_finish") [(KeyActionMissing, "*"), (Other, "*")]
        "Leaves a door as it is that a careful agent closes.";

    SameCategory "same_category" Object Development (ObjectConfusion, "") [(ObjectConfusion, "wrong_attribute"), (ObjectConfusion, "wrong_instance")]
        "Takes an object of the target's category with another look.";
    OtherCategory "other_category" Object Report (ObjectConfusion, "") [(ObjectConfusion, "wrong_kind"), (ObjectConfusion, "wrong_attribute")]
        "Takes an object of another category.";
    AnyObjectThere "any_object_there" Object Report (ObjectConfusion, "") [(ObjectConfusion, "*")]
        "Takes any other object of the receptacle where the target stands.";

    SimilarReceptacle "similar_receptacle" Receptacle Development (ObjectConfusion, "similar_furniture") [(ObjectConfusion, "wrong_receptacle")]
        "Takes furniture of the destination's category for the destination.";
    UnrelatedReceptacle "unrelated_receptacle" Receptacle Development (ObjectConfusion, "wrong_receptacle") [(ObjectConfusion, "similar_furniture")]
        "Takes furniture of another category for the destination.";
    NearReceptacle "near_receptacle" Receptacle Report (ObjectConfusion, "") [(ObjectConfusion, "wrong_receptacle"), (ObjectConfusion, "similar_furniture")]
        "Places on the furniture that stands nearest to the destination.";
    BackOnSource "back_on_source" Receptacle Report (ObjectConfusion, "wrong_receptacle") [(LostMemory, "*"), (ObjectConfusion, "similar_furniture"), (KeyActionMissing, "missing_place")]
        "Puts the target back where it was and finishes.";

    StaleNumber "stale_number" Marker Development (LostMemory, "stale_marker") [(LostMemory, "repeated_failure"), (ObjectConfusion, "*"), (KeyActionMissing, "missing_pick"), (KeyActionMissing, "premature_finish")]
        "Uses numbers of an earlier map and gives up after some failures.";
    RandomNumber "random_number" Marker Report (LostMemory, "stale_marker") [(LostMemory, "repeated_failure"), (ObjectConfusion, "*"), (KeyActionMissing, "missing_pick"), (KeyActionMissing, "premature_finish")]
        "Uses numbers of no map and gives up after some failures.";

    ToAndFro "to_and_fro" Wandering Development (LostMemory, "oscillation") [(LostMemory, "exploration")]
        "Drives to and fro between two receptacles, with up to two looks at each.";
    UnseenDetours "unseen_detours" Wandering Development (LostMemory, "exploration") [(LostMemory, "oscillation"), (Other, "timeout")]
        "Drives to receptacles it has not seen, one after another.";
    Rounds "rounds" Wandering Report (LostMemory, "oscillation") [(LostMemory, "exploration"), (Other, "timeout")]
        "Drives round between three to six receptacles, with up to two looks at each.";
    DoorAgain "door_again" Wandering Report (LostMemory, "oscillation") [(Other, "*"), (LostMemory, "*")]
        "Opens and closes the same door again and again.";

    SameCall "same_call" Repetition Development (Other, "timeout") [(LostMemory, "*")]
        "Makes a call that succeeds again and again.";
    FailingCall "failing_call" Repetition Development (LostMemory, "repeated_failure") [(Other, "invalid_output"), (LostMemory, "stale_marker"), (Other, "timeout")]
        "Makes a call that fails again and again.";
    SegmentAgain "segment_again" Repetition Report (Other, "timeout") [(LostMemory, "*")]
        "Looks, gazes and looks again, in the same order, again and again.";
    FailuresInTurn "failures_in_turn" Repetition Report (LostMemory, "repeated_failure") [(Other, "invalid_output"), (LostMemory, "stale_marker"), (Other, "timeout")]
        "Makes two calls that fail in turn.";
    AskAgain "ask_again" Repetition Report (Other, "timeout") [(LostMemory, "*")]
        "Asks the user one thing after another.";

    NoCall "no_call" Output Development (Other, "invalid_output") [(LostMemory, "repeated_failure"), (Other, "timeout")]
        "Puts out text without a call.";
    UnknownTool "unknown_tool" Output Development (Other, "invalid_output") [(LostMemory, "repeated_failure"), (Other, "timeout")]
        "Calls tools that do not exist.";
    BadArguments "bad_arguments" Output Report (Other, "invalid_output") [(LostMemory, "repeated_failure"), (Other, "timeout")]
        "Calls tools with arguments that nothing fits.";
    NoSuchReceptacle "no_such_receptacle" Output Report (Other, "invalid_output") [(LostMemory, "repeated_failure"), (Other, "timeout"), (ObjectConfusion, "wrong_receptacle")]
        "Drives to receptacles that the home does not have.";

    EarlyFinish "early_finish" Ending Development (KeyActionMissing, "premature_finish") [(KeyActionMissing, "*")]
        "Finishes at a random moment.";
    FinishSoon "finish_soon" Ending Report (KeyActionMissing, "premature_finish") [(KeyActionMissing, "*")]
        "Finishes just before one of the calls that matter.";
    UndoSuccess "undo_success" Ending Report (ObjectConfusion, "wrong_receptacle") [(LostMemory, "*"), (ObjectConfusion, "*"), (KeyActionMissing, "missing_place"), (Other, "*")]
        "Takes the placed object up again, and puts it elsewhere or keeps it.";
    NeverFinish "never_finish" Ending Development (Other, "timeout") [(LostMemory, "*"), (KeyActionMissing, "*")]
        "Goes on with useless calls instead of finishing.";

    FlakySkills "flaky_skills" Skill Development (Other, "primitive_failure") [(Other, "*"), (LostMemory, "repeated_failure")]
        "Its skills fail as often as on the paper's robot, and it gives up soon.";
    SkillsAndNoRetry "skills_and_no_retry" Skill Report (Other, "primitive_failure") [(Other, "*"), (KeyActionMissing, "*"), (LostMemory, "false_history")]
        "Its skills fail, and it finishes after the first failure.";

    ClaimsPlaced "claims_placed" Words Development (LostMemory, "false_history") [(KeyActionMissing, "*")]
        "Writes down that it placed the object, did not, and finishes.";
    ClaimsPicked "claims_picked" Words Report (LostMemory, "false_history") [(KeyActionMissing, "*"), (LostMemory, "repeated_failure")]
        "Writes down, in one of several languages, that it picked the object, did not, and goes on.";
    IdleClaims "idle_claims" Words Development (LostMemory, "false_history") [(Other, "*")]
        "Writes false things down that nothing follows from.";
    Intentions "intentions" Words Report (LostMemory, "false_history") [(Other, "*")]
        "Writes down negations and intentions, all of them true.";
}

impl OperatorKind {
    /// The operators that a half may use.
    pub fn of(split: Split) -> Vec<OperatorKind> {
        Self::ALL
            .iter()
            .copied()
            .filter(|kind| kind.split() == split)
            .collect()
    }
}

impl fmt::Display for OperatorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn every_family_has_operators_in_both_halves() {
        let of = |split: Split| -> BTreeSet<OperatorFamily> {
            OperatorKind::of(split)
                .iter()
                .map(|kind| kind.family())
                .collect()
        };
        assert_eq!(of(Split::Development), of(Split::Report));
        let [a, b] = Split::ALL.map(|split| OperatorKind::of(split).len());
        assert_eq!(a + b, OperatorKind::ALL.len());
    }
}
