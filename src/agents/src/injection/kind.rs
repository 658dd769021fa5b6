//! The kinds of fault and of harmless detour, and what each is called in the failure taxonomy.
//! Never how one is acted out.

use std::fmt;

use reel_world::FailureClass;
use serde::{Deserialize, Serialize};

macro_rules! fault_kinds {
    ($($name:ident = $text:literal, $class:ident, $sub:literal, $about:literal;)*) => {
        /// A way to fail.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
        #[serde(rename_all = "snake_case")]
        pub enum FaultKind { $(#[doc = $about] $name,)* }

        impl FaultKind {
            /// Every fault kind, in the order of declaration.
            pub const ALL: &[FaultKind] = &[$(FaultKind::$name,)*];

            /// Its name, as in labels.
            pub fn name(self) -> &'static str {
                match self { $(FaultKind::$name => $text,)* }
            }

            /// What the agent does, in one sentence.
            pub fn description(self) -> &'static str {
                match self { $(FaultKind::$name => $about,)* }
            }

            /// Failure class that the taxonomy assigns to this kind of fault.
            pub fn class(self) -> FailureClass {
                match self { $(FaultKind::$name => FailureClass::$class,)* }
            }

            /// Its sub-class; none where that depends on the object that was taken.
            pub fn sub_class(self) -> Option<&'static str> {
                let fixed = match self { $(FaultKind::$name => $sub,)* };
                (!fixed.is_empty()).then_some(fixed)
            }
        }
    };
}

fault_kinds! {
    WrongAttribute = "wrong_attribute", ObjectConfusion, "wrong_attribute",
        "Takes another asset of the target's category, or a named distractor of the target.";
    WrongInstance = "wrong_instance", ObjectConfusion, "wrong_instance",
        "Takes another instance of the target's asset.";
    WrongKind = "wrong_kind", ObjectConfusion, "wrong_kind",
        "Takes an object of another category that is no named distractor.";
    WrongReceptacle = "wrong_receptacle", ObjectConfusion, "wrong_receptacle",
        "Puts the target on furniture of another category than the destination.";
    SimilarFurniture = "similar_furniture", ObjectConfusion, "similar_furniture",
        "Puts the target on furniture like the destination.";
    IgnoredAnswer = "ignored_answer", ObjectConfusion, "ignored_answer",
        "Asks which object is meant, is told, and takes another.";
    StaleWrongObject = "stale_wrong_object", ObjectConfusion, "",
        "Picks by a number of an earlier map that now stands for another object.";
    MissingAsk = "missing_ask", KeyActionMissing, "missing_ask",
        "Asks nobody although several things fit, and takes the wrong one.";
    ClaimedAnswer = "claimed_answer", KeyActionMissing, "missing_ask",
        "Asks nobody, believes to have been answered, and takes the wrong thing.";
    NeverLooked = "never_looked", KeyActionMissing, "never_looked",
        "Never looks for the target and goes on without it.";
    MissingOpen = "missing_open", KeyActionMissing, "missing_open",
        "Never opens the door that is in the way.";
    MissingPick = "missing_pick", KeyActionMissing, "missing_pick",
        "Finds the target, does not pick it, and goes on as if it were in the hand.";
    MissingPlace = "missing_place", KeyActionMissing, "missing_place",
        "Carries the target to its destination and finishes without placing it.";
    PrematureFinish = "premature_finish", KeyActionMissing, "premature_finish",
        "Finishes in the middle of the task.";
    Oscillation = "oscillation", LostMemory, "oscillation",
        "Drives to and fro between two receptacles.";
    Circling = "circling", LostMemory, "oscillation",
        "Drives round and round between three receptacles.";
    RepeatedFailure = "repeated_failure", LostMemory, "repeated_failure",
        "Makes the same failing call again and again.";
    PickAgain = "pick_again", LostMemory, "repeated_failure",
        "Forgets that its hand is full and tries to pick again and again.";
    StaleMarker = "stale_marker", LostMemory, "stale_marker",
        "Uses numbers that are on no current map, and gives up.";
    FalseHistory = "false_history", LostMemory, "false_history",
        "Believes to have done what it did not do, and finishes.";
    Exploration = "exploration", LostMemory, "exploration",
        "Looks around at ever new places and takes nothing.";
    InvalidOutput = "invalid_output", Other, "invalid_output",
        "Puts out what is no call.";
    Dawdling = "dawdling", LostMemory, "repeated_call",
        "Makes calls that succeed and lead nowhere.";
    EndlessQuestions = "endless_questions", LostMemory, "repeated_question",
        "Asks the user one thing after another and does nothing.";
}

impl FaultKind {
    /// The kinds of a class.
    pub fn of_class(class: FailureClass) -> Vec<FaultKind> {
        Self::ALL
            .iter()
            .copied()
            .filter(|kind| kind.class() == class)
            .collect()
    }
}

impl fmt::Display for FaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Something needless that does no harm.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Detour {
    /// Looks once more than needed.
    ExtraLook,
    /// Drives to another receptacle and back, once.
    ThereAndBack,
    /// One failing call that is corrected at once.
    CorrectedSlip,
    /// Asks although there is nothing to ask.
    UnneededQuestion,
    /// Gazes at one thing more.
    ExtraGaze,
}

impl Detour {
    /// Every kind of harmless detour, in the order of declaration.
    pub const ALL: [Detour; 5] = [
        Detour::ExtraLook,
        Detour::ThereAndBack,
        Detour::CorrectedSlip,
        Detour::UnneededQuestion,
        Detour::ExtraGaze,
    ];
}
