//! Claims and verdicts: what is handed out. Never how they are found.

use std::{fmt, ops::Range};

/// A claim that a text makes, and what the record says to it.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Claim {
    /// Where it stands in the text, in bytes.
    pub span: Range<usize>,
    /// What it is about.
    pub kind: ClaimKind,
    /// Whether the record supports the claim, contradicts it or leaves it open.
    pub verdict: ClaimVerdict,
    /// What to write instead, by place in the text, where the record
    /// determines it; empty otherwise.
    pub fix: Vec<(Range<usize>, String)>,
}

impl Claim {
    /// Whether the record refutes it.
    pub fn is_false(&self) -> bool {
        matches!(self.verdict, ClaimVerdict::Contradicted { .. })
    }
}

/// What the record says to a claim.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum ClaimVerdict {
    /// The record shows that the claim is true.
    Supported {
        /// The decision that shows it; none for what holds all along.
        step: Option<u32>,
    },
    /// It does not hold.
    Contradicted {
        /// What the record says instead, for people.
        why: String,
        /// The decision that refutes it; none where nothing of the kind was done.
        step: Option<u32>,
    },
    /// The record does not decide it, or it is not understood.
    Unknown,
}

macro_rules! claim_kinds {
    ($($(#[$doc:meta])* $name:ident = $text:literal,)*) => {
        /// What a claim is about.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum ClaimKind { $($(#[$doc])* $name,)* }

        impl ClaimKind {
            /// Its name in reports.
            pub fn as_str(self) -> &'static str {
                match self { $(ClaimKind::$name => $text,)* }
            }
        }
    };
}

claim_kinds! {
    /// Being or having been at a receptacle.
    Visit = "visit",
    /// Walking around a receptacle.
    Explore = "explore",
    /// Looking for a category.
    Search = "search",
    /// Having seen or found something, or nothing.
    Sight = "sight",
    /// Having marked receptacles, or what a marker stands for.
    Marker = "marker",
    /// Whether the robot gazed at something.
    Gaze = "gaze",
    /// Whether the robot picked something up.
    Pick = "pick",
    /// What the gripper holds.
    Hold = "hold",
    /// Whether the robot placed something somewhere.
    Place = "place",
    /// Opening or closing a door.
    DoorAct = "door act",
    /// A door that stands open or closed.
    DoorState = "door state",
    /// Whether the robot asked the user something.
    Ask = "ask",
    /// What the user said.
    Answer = "answer",
    /// Ending the episode with the `finish` tool.
    Finish = "finish",
    /// Where an object is.
    Location = "location",
    /// What came before what.
    Order = "order",
    /// How a call went, and why.
    Outcome = "outcome",
    /// What was done last.
    Last = "last action",
    /// A call as it was made.
    Call = "call",
}

impl fmt::Display for ClaimKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
