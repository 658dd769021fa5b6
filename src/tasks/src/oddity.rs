//! What is strange in a task file but taken all the same (SPEC section 10).

use std::fmt;

use serde::{Deserialize, Serialize};

/// Something strange in a task.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
pub struct Oddity {
    /// The task.
    pub task_id: String,
    /// What kind of strangeness.
    pub kind: OddityKind,
    /// Which things are concerned.
    pub detail: String,
}

/// The kinds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum OddityKind {
    /// The same asset stands on several receptacles.
    SameAssetInSeveralPlaces,
    /// The file's goal graph holds other objects than its initial one; the goal is derived instead.
    GoalDoesNotConserve,
    /// The destination is one of the receptacles like the source.
    DestinationAmongSourceDistractors,
    /// `objects` and `final_positions` name different categories; that of `objects` is taken.
    CategoryAlias,
    /// An object distractor without volume that stands nowhere.
    ZeroSizeDistractor,
    /// An object at most 1.5 mm thick.
    ThinObject,
    /// The file's graph leaves out receptacles of the scene; they are added, empty and closed.
    GraphOmitsReceptacles,
    /// The destination's geometry is made up: the scene has no data for it.
    DestinationWithoutGeometry,
    /// Something stands on, or shall go to, a receptacle that nothing can be placed on.
    UnplaceableReceptacle,
    /// The file's initial graph and its placements disagree; the placements are taken.
    InitialGraphDisagrees,
    /// `objects`, `placements` and `final_positions` do not list the same objects in the same
    /// places.
    ObjectsAndPlacementsDiffer,
}

impl OddityKind {
    /// For people.
    pub fn as_str(self) -> &'static str {
        match self {
            OddityKind::SameAssetInSeveralPlaces => "same asset in several places",
            OddityKind::GoalDoesNotConserve => "goal graph does not conserve objects",
            OddityKind::DestinationAmongSourceDistractors => {
                "destination among the source distractors"
            }
            OddityKind::CategoryAlias => "category alias",
            OddityKind::ZeroSizeDistractor => "zero-size distractor",
            OddityKind::ThinObject => "thin object",
            OddityKind::GraphOmitsReceptacles => "graph omits receptacles",
            OddityKind::DestinationWithoutGeometry => "destination without geometry",
            OddityKind::UnplaceableReceptacle => "unplaceable receptacle",
            OddityKind::InitialGraphDisagrees => "initial graph disagrees",
            OddityKind::ObjectsAndPlacementsDiffer => "objects and placements differ",
        }
    }
}

impl fmt::Display for OddityKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Display for Oddity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.task_id, self.kind, self.detail)
    }
}
