//! Agents of Reel against recordings of Reel: each decides beside the recording, in this process.

use anyhow::{Context, bail};
use reel_agents::{EpisodeJob, RunningEpisode};
use reel_episode::Detail;
use reel_replay::episode_config;
use reel_server::{Deviation, Tape, deviation};
use reel_world::record::{StepInput, StepRecord};

use super::Outcome;
use crate::agent_arguments::AgentSet;

/// Lets an agent decide every call of a recording, until it decides another. With `go_on` the
/// simulator plays on from there.
///
/// # Errors
/// When the recording cannot be executed, or does not replay; or a model does not answer.
pub fn play(agents: &AgentSet, tape: &Tape, go_on: bool) -> anyhow::Result<Outcome> {
    if !tape.is_simulated() {
        bail!(
            "it was recorded with another server than Reel's, so only an agent that speaks MCP can be \
             tested against it: reel test --against ... -- COMMAND"
        );
    }
    let trace = tape.trace();
    let config = episode_config(trace)
        .map_err(|verdict| anyhow::anyhow!("it cannot be executed: {verdict}"))?;
    let job = EpisodeJob {
        config,
        policy: agents.name(),
        record: None,
        command: format!(
            "reel test {} --against {}",
            agents.name(),
            trace.path.display()
        ),
    };
    let players = agents.instantiate(&job)?;
    let mut policy = players.policy;
    // Only a model looks at images.
    let detail = match agents.uses_model() {
        true => Detail::Full,
        false => Detail::Geometry,
    };
    let running = RunningEpisode::start_with(job.config, detail, None)?;
    let mut running = running.with_responders(players.outside);
    let mut outcome = Outcome::default();
    for step in &trace.steps {
        let decided = running.decide(&mut *policy)?;
        let expected = tape.call(step.step as usize);
        if let Some(left) = deviation(step.step, expected.as_ref(), Some(&decided.call)) {
            if go_on {
                outcome.success = Some(future(running, &mut *policy, decided, &left)?);
            }
            outcome.deviation = Some(left);
            return Ok(outcome);
        }
        let input = StepInput {
            policy: decided.policy,
            ..step.input.clone()
        };
        running.execute(input, None)?;
        check(step, running.episode().steps().last())?;
        outcome.calls += 1;
    }
    Ok(outcome)
}

/// Whether the agent succeeds from the call on with which it left the recording.
fn future(
    mut running: RunningEpisode,
    policy: &mut dyn reel_agents::Policy,
    decided: StepInput,
    left: &Deviation,
) -> anyhow::Result<bool> {
    let played = running
        .execute(decided, None)
        .and_then(|()| running.play(policy));
    played.with_context(|| format!("the agent left the recording at {left} and did not go on"))?;
    Ok(running.end(policy.gave_up())?.success)
}

/// Refuses a recording that this build does not execute as it was recorded.
fn check(recorded: &StepRecord, executed: Option<&StepRecord>) -> anyhow::Result<()> {
    let same = executed.is_some_and(|executed| {
        executed.outcome == recorded.outcome && executed.digests.state == recorded.digests.state
    });
    if !same {
        bail!(
            "it no longer replays exactly: call {} came to something else; `reel replay` tells what",
            recorded.step
        );
    }
    Ok(())
}
