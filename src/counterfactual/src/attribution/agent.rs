//! The agent of a trace with one capability perfect: it makes the recorded calls, translated to
//! the state at hand, and at the failures of that capability the calls of a competent agent.
//!
//! Never repairs a failure of another capability: what the agent did wrong for another reason it
//! does again.

use std::collections::BTreeSet;

use reel_agents::{GoalHint, Planner, Policy, PolicyContext, ResponderError, plan::Objection};
use reel_episode::Privileged;
use reel_trace::Trace;
use reel_world::{
    ReceptacleId, Tool, ToolCall,
    record::{Marker, MarkerTarget, PolicyInfo, StepInput},
};

use super::Capability;

/// Calls that the competent agent may make for one failed call: a search through all receptacles
/// takes fewer.
const REPLACEMENTS_MAX: u32 = 40;

/// The agent of a trace, with one capability perfect.
pub(super) struct CuredAgent<'t> {
    trace: &'t Trace,
    capability: Capability,
    planner: Planner,
    /// Index of the recorded call that is next.
    next: usize,
    /// The competent agent acts until it has made a call of this tool, where it acts.
    repairing: Option<Repairing>,
    /// How far the search for what the next call is about has come.
    search: usize,
    /// Whether anything differs from the record.
    diverged: bool,
    last_call: Option<ToolCall>,
    old_markers: BTreeSet<u32>,
    /// Recorded calls that the competent agent's calls took the place of.
    pub replaced: u32,
    /// Recorded calls that had no counterpart.
    pub skipped: u32,
}

struct Repairing {
    tool: String,
    calls: u32,
}

impl<'t> CuredAgent<'t> {
    pub fn new(trace: &'t Trace, capability: Capability, from: usize) -> Self {
        Self {
            trace,
            capability,
            planner: Planner::new(GoalHint::of_task(&trace.task), 0),
            next: from,
            repairing: None,
            search: 0,
            diverged: false,
            last_call: None,
            old_markers: BTreeSet::new(),
            replaced: 0,
            skipped: 0,
        }
    }

    /// Translates every call from now on: the state may differ from the record.
    pub fn diverge(&mut self) {
        self.diverged = true;
    }

    /// The competent agent's call, while it stands in for a failed call.
    fn repair(&mut self, context: &PolicyContext<'_>) -> Result<Option<StepInput>, ResponderError> {
        let Some(repairing) = &mut self.repairing else {
            return Ok(None);
        };
        let made = self
            .last_call
            .as_ref()
            .is_some_and(|call| call.name == repairing.tool);
        if repairing.calls > 0 && made && context.observation.error.is_none()
            || repairing.calls >= REPLACEMENTS_MAX
        {
            self.repairing = None;
            return Ok(None);
        }
        repairing.calls += 1;
        if self.planner.advice(context) == Tool::Finish {
            // It knows nothing better: the agent goes on.
            self.repairing = None;
            return Ok(None);
        }
        self.planner.act(context).map(Some)
    }

    /// The recorded call in the state at hand: the same tool with the same object or receptacle by
    /// its current number; or a call that looks for it; none where it has no counterpart.
    fn translated(&mut self, truth: &Privileged<'_>) -> Option<(StepInput, bool)> {
        let step = &self.trace.steps[self.next];
        let input = StepInput {
            policy: None,
            ..step.input.clone()
        };
        if !self.diverged {
            return Some((input, true));
        }
        let parsed = Tool::parse(&input.call).ok();
        let Some(number) = parsed.as_ref().and_then(Tool::marker) else {
            return Some((input, true));
        };
        let Some(target) = self.recorded_target(number) else {
            // A number that was on no map then is on none now.
            let taken = |number: &u32| truth.markers.iter().any(|marker| marker.id == *number);
            let free = (number..).find(|number| !taken(number))?;
            return Some((with_marker(&input, parsed.as_ref()?, free), true));
        };
        let current = truth
            .markers
            .iter()
            .find(|Marker { target: here, .. }| *here == target);
        if let Some(current) = current {
            return Some((with_marker(&input, parsed.as_ref()?, current.id), true));
        }
        let search = looking_for(&target, truth);
        let call = search.get(self.search)?.clone();
        Some((StepInput::from_call(call.to_call()), false))
    }

    /// What a number meant when the recorded call used it.
    fn recorded_target(&self, number: u32) -> Option<MarkerTarget> {
        let before = self.next.checked_sub(1)?;
        let markers = &self.trace.steps[before].markers;
        let found = markers.iter().find(|marker| marker.id == number)?;
        Some(found.target.clone())
    }

    /// Whether making this call now is a failure of the capability.
    fn fails(&mut self, context: &PolicyContext<'_>, call: &ToolCall) -> bool {
        if self.capability == Capability::Primitives {
            return false;
        }
        let truth_holds = context.truth.is_some_and(|truth| truth.held.is_some());
        if truth_holds && matches!(Tool::parse(call), Ok(Tool::Pick { .. })) {
            // A full hand takes nothing: there is no choice to replace, only a call in vain.
            let again = self.last_call.as_ref() == Some(call);
            return self.capability == Capability::Memory && again;
        }
        let again = context.observation.error.is_some() && self.last_call.as_ref() == Some(call);
        let objection = failure(&mut self.planner, context, call, again, &self.old_markers);
        objection == Some(self.capability)
    }
}

/// The capability that a call fails by, as [`Objection`] tells from what could be known then. A
/// failed call made again and a number of an earlier map are failures of memory.
pub(super) fn failure(
    planner: &mut Planner,
    context: &PolicyContext<'_>,
    call: &ToolCall,
    again: bool,
    old_markers: &BTreeSet<u32>,
) -> Option<Capability> {
    let number = Tool::parse(call).ok().as_ref().and_then(Tool::marker);
    let is_current = |number: u32| {
        let mut perceived = context.perceived.iter();
        perceived.any(|item| item.marker == Some(number))
    };
    let stale = number.is_some_and(|number| !is_current(number) && old_markers.contains(&number));
    if again || stale {
        return Some(Capability::Memory);
    }
    planner
        .objection(context, call)
        .map(|objection| match objection {
            Objection::Perception => Capability::Perception,
            Objection::Communication => Capability::Communication,
            Objection::Memory => Capability::Memory,
        })
}

fn with_marker(input: &StepInput, tool: &Tool, marker: u32) -> StepInput {
    StepInput {
        call: tool.clone().with_marker(marker).to_call(),
        ..input.clone()
    }
}

/// Calls after which something is numbered, that decide nothing: a look, a drive to where it
/// stands, a look there.
fn looking_for(target: &MarkerTarget, truth: &Privileged<'_>) -> Vec<Tool> {
    let (look, place): (Tool, Option<ReceptacleId>) = match target {
        MarkerTarget::Object(id) => (
            Tool::ShowObjectByCategory {
                category: truth
                    .task
                    .object(id)
                    .map_or_else(String::new, |known| known.category.clone()),
            },
            truth.graph.receptacle_of(id).cloned(),
        ),
        MarkerTarget::Receptacle(id) => (Tool::ShowReceptacles, Some(id.clone())),
    };
    let drive = place.map(|receptacle| Tool::NavTo { receptacle });
    [look.clone()]
        .into_iter()
        .chain(drive)
        .chain([look])
        .collect()
}

impl Policy for CuredAgent<'_> {
    fn info(&self) -> PolicyInfo {
        self.trace.header.policy.clone()
    }

    /// Numbers are translated by what they stand for; no choice is made by it.
    fn needs_privileged(&self) -> bool {
        true
    }

    fn act(&mut self, context: &PolicyContext<'_>) -> Result<StepInput, ResponderError> {
        let Some(truth) = context.truth else {
            return Ok(StepInput::from_call(Tool::Finish.to_call()));
        };
        self.old_markers
            .extend(truth.markers.iter().map(|marker| marker.id));
        loop {
            if let Some(input) = self.repair(context)? {
                self.last_call = Some(input.call.clone());
                return Ok(input);
            }
            if self.next >= self.trace.steps.len() {
                // What the agent would have done after its last call is not known.
                return Err(ResponderError::new("the recorded calls end here"));
            }
            let Some((input, is_own)) = self.translated(truth) else {
                self.skipped += 1;
                self.search = 0;
                self.next += 1;
                continue;
            };
            if !is_own {
                self.search += 1;
                self.planner.observe(context, &input);
                self.last_call = Some(input.call.clone());
                return Ok(input);
            }
            self.search = 0;
            if self.fails(context, &input.call) {
                let tool = Tool::parse(&input.call)
                    .map_or_else(|_| input.call.name.clone(), |tool| tool.to_call().name);
                let is_deed = tool == "pick" || tool == "place";
                self.next += 1;
                self.diverged = true;
                self.replaced += 1;
                if is_deed && self.capability != Capability::Memory {
                    self.repairing = Some(Repairing { tool, calls: 0 });
                    continue;
                }
                let advised = self.planner.act(context)?;
                self.last_call = Some(advised.call.clone());
                return Ok(advised);
            }
            self.next += 1;
            self.planner.observe(context, &input);
            self.last_call = Some(input.call.clone());
            return Ok(input);
        }
    }

    fn observe(&mut self, context: &PolicyContext<'_>, input: &StepInput) {
        self.old_markers
            .extend(context.perceived.iter().filter_map(|seen| seen.marker));
        self.planner.observe(context, input);
        self.last_call = Some(input.call.clone());
    }
}
