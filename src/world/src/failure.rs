//! The classes of failure (paper, Failure Mode Taxonomy; docs/spec.md#failure-taxonomy). Names
//! only: what belongs to a class is for the rules.

use std::fmt;

use serde::{Deserialize, Serialize};

/// Why an episode failed.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
pub enum FailureClass {
    /// The wrong object, or the wrong furniture.
    #[serde(rename = "Object Confusion")]
    ObjectConfusion,
    /// Something that had to be done never was.
    #[serde(rename = "Key Action Missing")]
    KeyActionMissing,
    /// What was done or seen is forgotten or made up.
    #[serde(rename = "Lost Memory")]
    LostMemory,
    /// A failure that belongs to none of the other classes.
    #[serde(rename = "Other")]
    Other,
}

impl FailureClass {
    /// All four, in the order of the paper's figure.
    pub const ALL: [FailureClass; 4] = [
        FailureClass::ObjectConfusion,
        FailureClass::KeyActionMissing,
        FailureClass::LostMemory,
        FailureClass::Other,
    ];

    /// Their names, in the same order.
    pub const NAMES: [&str; 4] = [
        Self::ALL[0].as_str(),
        Self::ALL[1].as_str(),
        Self::ALL[2].as_str(),
        Self::ALL[3].as_str(),
    ];

    /// Its name in the paper.
    pub const fn as_str(self) -> &'static str {
        match self {
            FailureClass::ObjectConfusion => "Object Confusion",
            FailureClass::KeyActionMissing => "Key Action Missing",
            FailureClass::LostMemory => "Lost Memory",
            FailureClass::Other => "Other",
        }
    }
}

impl fmt::Display for FailureClass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
