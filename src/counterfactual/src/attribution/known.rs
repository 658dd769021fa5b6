//! What perfecting a capability does to an episode whose faults were injected: the same agent is
//! played without the faults of that capability. Only for measuring how right an attribution is.

use reel_agents::{AgentError, FaultKind, Injected, Injection, Label, RunningEpisode};
use reel_sim::render::Detail;
use reel_trace::Trace;

use super::{Capability, played::info};
use crate::branch::{BranchError, fork};

impl Capability {
    /// The capability whose lack a fault is; `None` for what no capability explains: something due
    /// that was left out, calls without an aim, output that is no call.
    pub fn of_fault(kind: FaultKind) -> Option<Capability> {
        match kind {
            FaultKind::WrongAttribute
            | FaultKind::WrongInstance
            | FaultKind::WrongKind
            | FaultKind::WrongReceptacle
            | FaultKind::SimilarFurniture
            | FaultKind::IgnoredAnswer
            | FaultKind::StaleWrongObject => Some(Capability::Perception),
            FaultKind::MissingAsk | FaultKind::ClaimedAnswer => Some(Capability::Communication),
            FaultKind::Oscillation
            | FaultKind::Circling
            | FaultKind::RepeatedFailure
            | FaultKind::PickAgain
            | FaultKind::StaleMarker
            | FaultKind::FalseHistory => Some(Capability::Memory),
            FaultKind::Exploration
            | FaultKind::NeverLooked
            | FaultKind::MissingOpen
            | FaultKind::MissingPick
            | FaultKind::MissingPlace
            | FaultKind::PrematureFinish
            | FaultKind::InvalidOutput
            | FaultKind::Dawdling
            | FaultKind::EndlessQuestions => None,
        }
    }
}

/// Whether the agent of an injected episode succeeds without the faults of a capability.
///
/// # Errors
/// When the trace is not from this simulator, or the task does not admit the faults that are left.
pub fn known_success(
    trace: &Trace,
    label: &Label,
    capability: Capability,
) -> Result<bool, BranchError> {
    let mut injection: Injection = label.injection.clone();
    injection
        .faults
        .retain(|fault| Capability::of_fault(fault.kind) != Some(capability));
    if injection.faults.len() == label.injection.faults.len() {
        return Ok(trace.end.as_ref().is_some_and(|end| end.metrics.success));
    }
    let mut agent = Injected::new(&trace.task, &trace.scene, &injection).map_err(|source| {
        AgentError::Injection {
            task: trace.header.task_id.clone(),
            source,
        }
    })?;
    let episode = fork(trace, 0, None)?
        .open(info(trace, capability), Detail::Geometry)
        .map_err(|verdict| BranchError::Parent {
            path: trace.path.clone(),
            call: 0,
            verdict: Box::new(verdict),
        })?;
    let mut running = RunningEpisode::resume(episode, None, |_| None, None)?;
    running.play(&mut agent)?;
    Ok(running.end(None)?.success)
}
