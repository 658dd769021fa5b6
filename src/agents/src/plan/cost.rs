//! What a plan costs in tool calls. Never walks or searches: it counts what happens
//! when all goes well.

use crate::plan::{Intent, PlanningState, plan};

/// How many tool calls the plan from here takes if all goes well, `finish` included; none where the
/// goal is out of reach.
pub fn cost_to_go(situation: &PlanningState<'_>) -> Option<u32> {
    plan(situation).ok().map(|intents| calls(&intents))
}

/// How many tool calls these intents take if all goes well: the object is in view at once, and a
/// receptacle whose number is still shown is not marked again for its door.
pub fn calls(intents: &[Intent]) -> u32 {
    let mut marked = None;
    let mut total = 0;
    for intent in intents {
        total += match intent {
            Intent::NavTo(_) => {
                marked = None;
                1
            }
            // `show_object_by_category`, `gaze_at`
            Intent::Find { .. } => {
                marked = None;
                2
            }
            // `show_receptacles`, `place`
            Intent::Place(receptacle) => {
                marked = Some(receptacle);
                2
            }
            Intent::Open(receptacle) | Intent::Close(receptacle) => {
                let shown = marked == Some(receptacle);
                marked = Some(receptacle);
                if shown { 1 } else { 2 }
            }
            Intent::Pick(_) | Intent::Ask { .. } | Intent::Finish => 1,
        };
    }
    total
}
