//! Agents that speak MCP against recordings of any server: a process for each recording, and a replay
//! server for it alone.

use std::{
    io,
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
    sync::{Arc, Mutex, PoisonError},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use reel_server::{
    ReplayServer, Tape, TapeReport, TapeSessions, TapeSettings, TapeStatus, Tapes, deviation,
};

use super::Outcome;

/// How often it is looked whether the agent is done.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// Runs a command with the address of a replay server for this recording.
///
/// # Errors
/// When the command cannot be started, or takes too long before its first call.
pub fn play(
    command: &[String],
    tape: &Tape,
    branches: Option<&Path>,
    limit: Duration,
) -> anyhow::Result<Outcome> {
    let dropped = tempfile::tempdir().context("cannot make a temporary folder")?;
    let reports: Arc<Mutex<Vec<TapeReport>>> = Arc::default();
    let settings = TapeSettings {
        branches: branches.unwrap_or(dropped.path()).to_owned(),
        policy: None,
    };
    let kept = reports.clone();
    let observer = move |report: &TapeReport| {
        let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.push(report.clone());
    };
    let tapes = Arc::new(Tapes::new(vec![tape.clone()])?);
    let server = ReplayServer::start_anywhere(TapeSessions::new(tapes, settings, observer))?;
    let mut agent = start(command, &server)?;
    let ended = wait(&mut agent, limit);
    server.stop();
    let reports = std::mem::take(&mut *reports.lock().unwrap_or_else(PoisonError::into_inner));
    // An agent that connects more than once is judged by the first session that left the recording.
    let left = reports.iter().find(|report| report.deviation.is_some());
    let report = left.or(reports
        .iter()
        .find(|report| report.status == TapeStatus::OnTape));
    let Some(report) = report.or(reports.first()) else {
        let status = ended?;
        return Ok(Outcome {
            deviation: deviation(0, tape.call(0).as_ref(), None),
            reason: Some(without_a_call(status, tape.begins_with_finish())),
            ..Outcome::default()
        });
    };
    let mut outcome = Outcome {
        calls: report.calls_on_tape,
        deviation: report.deviation.clone(),
        success: report.success.filter(|_| report.branch.is_some()),
        branch: report.branch.clone().filter(|_| branches.is_some()),
        reason: report.reason.clone(),
    };
    if report.status == TapeStatus::Unplayed {
        outcome.deviation = deviation(0, tape.call(0).as_ref(), None);
    }
    match ended {
        Err(error) => outcome.reason = Some(format!("{error:#}")),
        Ok(status) if !status.success() && outcome.reason.is_none() => {
            outcome.reason = Some(format!("the agent ended with {status}"));
        }
        Ok(_) => {}
    }
    Ok(outcome)
}

/// How an agent ended that the replay server never heard of.
fn without_a_call(status: ExitStatus, begins_with_finish: bool) -> String {
    let first = match begins_with_finish {
        true => "it never called `finish` of the replay server",
        false => "it never called a tool of the replay server",
    };
    format!("the agent ended with {status}: {first}, whose address is in REEL_MCP_URL")
}

fn start(command: &[String], server: &ReplayServer) -> anyhow::Result<Child> {
    let address = server.address();
    let (url, sse) = (
        format!("http://{address}/mcp"),
        format!("http://{address}/sse"),
    );
    let [program, arguments @ ..] = command else {
        bail!("name the agent's command after --");
    };
    let arguments = arguments
        .iter()
        .map(|argument| argument.replace("{url}", &url).replace("{sse}", &sse));
    let started = Command::new(program)
        .args(arguments)
        .env("REEL_MCP_URL", &url)
        .env("REEL_SSE_URL", &sse)
        .stdin(Stdio::null())
        // Results alone are on standard output.
        .stdout(io::stderr())
        .spawn();
    started.with_context(|| format!("cannot start the agent {program}"))
}

/// Waits for the agent, and ends it where it takes too long.
fn wait(agent: &mut Child, limit: Duration) -> anyhow::Result<ExitStatus> {
    let begun = Instant::now();
    loop {
        if let Some(status) = agent.try_wait().context("cannot wait for the agent")? {
            return Ok(status);
        }
        if begun.elapsed() >= limit {
            agent.kill().context("cannot end the agent")?;
            agent.wait().context("cannot wait for the agent")?;
            bail!(
                "the agent took longer than {} s and was ended (--limit)",
                limit.as_secs_f64()
            );
        }
        thread::sleep(LOOK_EVERY);
    }
}
