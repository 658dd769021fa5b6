//! What is strange in a task file but taken all the same (docs/spec.md#real-bench-deviations).

use std::fmt;

use serde::{Deserialize, Serialize};

/// Something strange in a task.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Debug, Serialize, Deserialize)]
pub struct TaskWarning {
    /// Id of the task that the warning is about.
    pub task_id: String,
    /// What kind of strangeness.
    pub kind: TaskWarningKind,
    /// Which things are concerned.
    pub detail: String,
}

/// What can be strange in a task file that is loaded all the same.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TaskWarningKind {
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
    /// `objects`, `placements` and `final_positions` do not list the same objects
    /// in the same places.
    ObjectsAndPlacementsDiffer,
}

impl TaskWarningKind {
    /// The kind as a phrase for messages, e.g. `thin object`.
    pub fn as_str(self) -> &'static str {
        match self {
            TaskWarningKind::SameAssetInSeveralPlaces => "same asset in several places",
            TaskWarningKind::GoalDoesNotConserve => "goal graph does not conserve objects",
            TaskWarningKind::DestinationAmongSourceDistractors => {
                "destination among the source distractors"
            }
            TaskWarningKind::CategoryAlias => "category alias",
            TaskWarningKind::ZeroSizeDistractor => "zero-size distractor",
            TaskWarningKind::ThinObject => "thin object",
            TaskWarningKind::GraphOmitsReceptacles => "graph omits receptacles",
            TaskWarningKind::DestinationWithoutGeometry => "destination without geometry",
            TaskWarningKind::UnplaceableReceptacle => "unplaceable receptacle",
            TaskWarningKind::InitialGraphDisagrees => "initial graph disagrees",
            TaskWarningKind::ObjectsAndPlacementsDiffer => "objects and placements differ",
        }
    }
}

impl fmt::Display for TaskWarningKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Display for TaskWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}: {}", self.task_id, self.kind, self.detail)
    }
}
