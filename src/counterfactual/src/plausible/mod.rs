//! What one other call would have changed: at every step of an episode the calls that an agent
//! might have made instead, each played in the simulator, once with the recorded calls after it and
//! once with a competent agent. Never says which call was at fault: that is [`crate::blame`].

mod outcome;

use reel_agents::{GoalHint, PerceivedItem, Planner, Policy, plan::Objection, retrace};
use reel_trace::Trace;
use reel_world::{ReceptacleId, Scene, Tool, ToolCall};
use serde::{Deserialize, Serialize};

pub use outcome::{PlayedCall, PlayedOutcome, play_all};

/// Other markers that are tried in the place of a call's marker.
const MARKERS_MAX: usize = 3;
/// Other receptacles that are tried in the place of one that was driven to.
const RECEPTACLES_MAX: usize = 2;

/// Why a call is plausible at a step.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Origin {
    /// A competent agent, which knows what the episode's agent knew, makes it.
    Advice,
    /// The question to the user that a competent agent asks where several things fit.
    Question,
    /// The recorded tool with another marker of the same kind that was in view.
    Marker,
    /// A drive to another receptacle of the same category.
    Receptacle,
}

impl Origin {
    /// The name in JSON and tables.
    pub fn name(self) -> &'static str {
        match self {
            Origin::Advice => "advice",
            Origin::Question => "question",
            Origin::Marker => "marker",
            Origin::Receptacle => "receptacle",
        }
    }
}

/// A call that might have been made at a step instead of the recorded one.
#[derive(Clone, PartialEq, Eq, Debug, Serialize, Deserialize)]
pub struct PlausibleCall {
    /// Index of the step in the episode, from 0.
    pub step: u32,
    /// The call in the place of the recorded one.
    pub call: ToolCall,
    /// By which rule it was chosen.
    pub origin: Origin,
}

/// The plausible calls of every step, in the order of the steps; nothing is executed. No call
/// stands twice at a step, and none is the recorded one.
pub fn plausible_calls(trace: &Trace) -> Vec<PlausibleCall> {
    let mut planner = Planner::new(GoalHint::of_task(&trace.task), trace.header.seed);
    let mut found: Vec<PlausibleCall> = Vec::new();
    retrace(
        &trace.task,
        &trace.scene,
        &trace.start,
        &trace.steps,
        |context, step| {
            let Some(step) = step else { return };
            let recorded = Tool::parse(&step.input.call).ok();
            let mut tools = vec![(planner.advice(context), Origin::Advice)];
            if planner.objection(context, &step.input.call) == Some(Objection::Communication) {
                tools.push((planner.question(context), Origin::Question));
            }
            match &recorded {
                Some(Tool::NavTo { receptacle }) => {
                    let others = others_of_category(&trace.scene, receptacle);
                    tools.extend(others.map(|tool| (tool, Origin::Receptacle)));
                }
                Some(tool) => {
                    let others = with_other_markers(tool, context.perceived);
                    tools.extend(others.into_iter().map(|tool| (tool, Origin::Marker)));
                }
                None => {}
            }
            let mut known: Vec<Tool> = recorded.into_iter().collect();
            for (tool, origin) in tools {
                if !known.contains(&tool) {
                    found.push(PlausibleCall {
                        step: step.step,
                        call: tool.to_call(),
                        origin,
                    });
                    known.push(tool);
                }
            }
            planner.observe(context, &step.input);
        },
    );
    found
}

/// Drives to other receptacles of the same category, in the order of the scene.
fn others_of_category(scene: &Scene, receptacle: &ReceptacleId) -> impl Iterator<Item = Tool> {
    let category = scene.receptacle(receptacle).map(|it| &it.category);
    let others = scene
        .receptacles
        .iter()
        .filter(move |it| it.id != *receptacle && Some(&it.category) == category);
    others.take(RECEPTACLES_MAX).map(|it| Tool::NavTo {
        receptacle: it.id.clone(),
    })
}

/// The same tool with other markers of its marker's kind: first those of the same category, then by
/// their numbers.
fn with_other_markers(tool: &Tool, perceived: &[PerceivedItem]) -> Vec<Tool> {
    let Some(marker) = tool.marker() else {
        return Vec::new();
    };
    let marked = perceived.iter().find(|it| it.marker == Some(marker));
    let mut others: Vec<(bool, u32)> = perceived
        .iter()
        .filter(|it| marked.is_none_or(|marked| marked.furniture == it.furniture))
        .filter_map(|it| {
            let other_category = marked.is_none_or(|marked| marked.category != it.category);
            Some((other_category, it.marker.filter(|it| *it != marker)?))
        })
        .collect();
    others.sort_unstable();
    let with = |(_, marker)| tool.clone().with_marker(marker);
    others.into_iter().take(MARKERS_MAX).map(with).collect()
}
