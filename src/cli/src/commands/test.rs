//! `reel test`: whether an agent still does what was recorded, one test case a recording.

mod command;
mod junit;
mod policy;

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Context, bail};
use reel_server::{Deviation, Tape};
use serde::Serialize;

use crate::{ExitStatus, agent_arguments::AgentArguments, inputs, progress};

/// Test an agent against recordings: it gets the recorded answers as long as it makes the recorded
/// calls. A test case passes if it makes these and no other; else the first other call is named.
///
/// AGENT is a name that `reel bench --agent` takes, and plays recordings of Reel. A command after
/// `--` is any agent that speaks MCP: for each recording it is started once, with the address of a
/// replay server in REEL_MCP_URL (Streamable HTTP) and REEL_SSE_URL (HTTP+SSE); {url} and {sse} in
/// its arguments stand for them. It calls `finish` to get its task, plays, and ends.
///
/// Examples:
///   reel test planner --against traces
///   reel test real-agent --endpoint http://localhost:8000/v1 --model student --against traces --outcome
///   reel test --against traces --junit junit.xml -- python my_agent.py {url}
///
/// Exit code 1: a test failed; 2: none failed, but a recording cannot be tested against.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Who is tested: a built-in policy, real-agent or function-calling
    #[arg(
        value_name = "AGENT",
        required_unless_present = "command",
        conflicts_with = "command"
    )]
    tested: Option<String>,
    /// The recordings: traces, or folders of them
    #[arg(long, value_name = "DIR", required = true, num_args = 1..)]
    against: Vec<PathBuf>,
    /// A test also passes where the agent leaves the recording and succeeds: the simulator goes on
    /// from there
    #[arg(long)]
    outcome: bool,
    /// File for the results as JUnit XML, which CI systems read
    #[arg(long, value_name = "FILE")]
    junit: Option<PathBuf>,
    /// Folder for what a command does off the recording, as branches; without it they are not kept
    #[arg(long, value_name = "DIR", requires = "command")]
    branches: Option<PathBuf>,
    /// How long a command may take for one recording, in seconds
    #[arg(long, value_name = "S", default_value_t = 600.0)]
    limit: f64,
    #[command(flatten)]
    players: AgentArguments,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Print one JSON object per test
    #[arg(long)]
    json: bool,
    /// The agent as a command
    #[arg(last = true, value_name = "COMMAND")]
    command: Vec<String>,
}

/// What a test came to.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Serialize)]
#[serde(rename_all = "snake_case")]
enum Status {
    /// All recorded calls were made and no other, or with `--outcome` the agent succeeded.
    Passed,
    /// The agent left the recording, or ended before its first call.
    Failed,
    /// The recording cannot be tested against, or the agent could not start or took too long.
    Error,
}

/// A test case: one recording.
#[derive(Clone, Debug, Serialize)]
struct Case {
    /// Path of the recording that it is tested against.
    trace: PathBuf,
    /// Id of its task; `None` if it cannot be read.
    task_id: Option<String>,
    status: Status,
    /// How many recorded calls were made before the first that differs.
    calls: u32,
    /// Where the agent left the recording; `None` if it did not.
    deviation: Option<Deviation>,
    /// Whether the agent succeeded off the recording; `None` if that was not played.
    success: Option<bool>,
    /// The trace of what followed off the recording; `None` if it was not kept.
    branch: Option<PathBuf>,
    /// What went wrong; `None` if nothing did.
    reason: Option<String>,
    /// How long the test took, in seconds.
    seconds: f64,
}

/// What playing a recording came to, before it is judged.
#[derive(Clone, Debug, Default)]
struct Outcome {
    calls: u32,
    deviation: Option<Deviation>,
    success: Option<bool>,
    branch: Option<PathBuf>,
    reason: Option<String>,
}

impl Case {
    fn new(trace: &Path, task_id: Option<&str>, outcome: Outcome, accept_success: bool) -> Self {
        let status = match &outcome {
            Outcome {
                deviation: Some(_),
                success: Some(true),
                ..
            } if accept_success => Status::Passed,
            Outcome {
                deviation: Some(_), ..
            } => Status::Failed,
            Outcome {
                reason: Some(_), ..
            } => Status::Error,
            _ => Status::Passed,
        };
        Self {
            trace: trace.to_owned(),
            task_id: task_id.map(str::to_owned),
            status,
            calls: outcome.calls,
            deviation: outcome.deviation,
            success: outcome.success,
            branch: outcome.branch,
            reason: outcome.reason,
            seconds: 0.0,
        }
    }

    /// Why it did not pass, in a line.
    fn message(&self) -> String {
        let deviation = self.deviation.as_ref().map(ToString::to_string);
        let went_on = match self.success {
            Some(true) => Some("succeeded off the recording".to_owned()),
            Some(false) => Some("failed off the recording".to_owned()),
            None => None,
        };
        let parts: Vec<String> = [deviation, went_on, self.reason.clone()]
            .into_iter()
            .flatten()
            .collect();
        parts.join("; ")
    }
}

/// Plays a recording with the agent that is tested.
type Player = Box<dyn FnMut(&Tape) -> anyhow::Result<Outcome>>;

/// Tests an agent against every recording.
pub fn run(mut arguments: Arguments) -> anyhow::Result<ExitStatus> {
    let limit = Duration::try_from_secs_f64(arguments.limit)
        .context("--limit must be a time in seconds")?;
    let files = arguments.assets.trace_files()?;
    let paths = inputs::traces(&files, &arguments.against)?;
    let player: Player = match arguments.tested.take() {
        Some(tested) => {
            arguments.players.agent = tested;
            let log = std::env::temp_dir().join(format!("reel-test-{}.jsonl", std::process::id()));
            let agents = arguments.players.agent_set(&log)?;
            let outcome = arguments.outcome;
            Box::new(move |tape| policy::play(&agents, tape, outcome))
        }
        None if arguments.command.is_empty() => bail!("name an agent, or a command after --"),
        None => {
            let command = arguments.command.clone();
            let branches = arguments.branches.clone();
            Box::new(move |tape| command::play(&command, tape, branches.as_deref(), limit))
        }
    };
    let cases = cases(&arguments, &paths, player)?;
    if let Some(path) = &arguments.junit {
        let xml = junit::report(&arguments.name(), &cases)?;
        std::fs::write(path, xml)
            .with_context(|| format!("cannot write the report {}", path.display()))?;
    }
    let count = |status: Status| cases.iter().filter(|case| case.status == status).count();
    let (failed, errors) = (count(Status::Failed), count(Status::Error));
    if !arguments.json {
        let passed = count(Status::Passed);
        println!(
            "{} tests: {passed} passed, {failed} failed, {errors} errors",
            cases.len()
        );
    }
    Ok(match (failed, errors) {
        (0, 0) => ExitStatus::Success,
        (0, _) => ExitStatus::BadInput,
        _ => ExitStatus::CheckFailed,
    })
}

impl Arguments {
    /// What the agent is called in reports.
    fn name(&self) -> String {
        match self.command.first() {
            Some(program) => program.clone(),
            None => self.players.agent.clone(),
        }
    }
}

fn cases(
    arguments: &Arguments,
    paths: &[PathBuf],
    mut player: Player,
) -> anyhow::Result<Vec<Case>> {
    let files = arguments.assets.trace_files()?;
    let bar = progress::bar(paths.len(), &arguments.name());
    let mut cases = Vec::with_capacity(paths.len());
    for path in paths {
        let begun = Instant::now();
        let broken = |error: &anyhow::Error| Outcome {
            reason: Some(format!("{error:#}")),
            ..Outcome::default()
        };
        let (task, outcome) = match arguments.assets.read(&files, path) {
            Ok(trace) => {
                let tape = Tape::new(trace);
                let outcome = player(&tape).unwrap_or_else(|error| broken(&error));
                (Some(tape.trace().task.task_id.clone()), outcome)
            }
            Err(error) => (None, broken(&error)),
        };
        let mut case = Case::new(path, task.as_deref(), outcome, arguments.outcome);
        case.seconds = begun.elapsed().as_secs_f64();
        bar.suspend(|| print(arguments, &case))?;
        bar.inc(1);
        cases.push(case);
    }
    bar.finish_and_clear();
    Ok(cases)
}

fn print(arguments: &Arguments, case: &Case) -> anyhow::Result<()> {
    if arguments.json {
        println!("{}", serde_json::to_string(case)?);
        return Ok(());
    }
    let path = case.trace.display();
    match case.status {
        Status::Passed if case.deviation.is_some() => {
            println!("ok      {path}: {}", case.message())
        }
        Status::Passed => println!("ok      {path}: {} calls", case.calls),
        Status::Failed => println!("FAILED  {path}: {}", case.message()),
        Status::Error => println!("ERROR   {path}: {}", case.message()),
    }
    Ok(())
}
