//! `--replay` of `reel serve` and `reel mcp`: which recordings are answered from, and what is said
//! of how agents went along them.

use std::{
    fs::File,
    io::Write as _,
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::Context;
use reel_server::{
    ReplayServer, Tape, TapeReport, TapeSessions, TapeSettings, TapeStatus, Tapes, run_replay_stdio,
};

use crate::{ExitStatus, inputs};

/// Which recordings are answered from.
#[derive(clap::Args)]
pub struct ReplayArguments {
    /// Answer from these recordings (traces, or folders of them) instead of live worlds: equal calls get
    /// the recorded answers, and the first call that differs is named. From there an episode of Reel
    /// goes on live, as a branch in DATA/branches
    #[arg(
        long,
        value_name = "TRACE",
        num_args = 1..,
        conflicts_with_all = ["tasks", "scene", "profile", "preset", "shuffle", "no_images", "record", "ask", "user_model"]
    )]
    replay: Vec<PathBuf>,
    /// File for how each recording went, one JSON object a line
    #[arg(long, value_name = "FILE", requires = "replay")]
    report: Option<PathBuf>,
}

impl ReplayArguments {
    /// Whether recordings are answered from.
    pub fn is_given(&self) -> bool {
        !self.replay.is_empty()
    }

    /// Serves one agent over standard input and output. The exit code says whether it stayed on tape.
    ///
    /// # Errors
    /// When a recording cannot be read, or what comes in is not the protocol.
    pub fn stdio(
        &self,
        settings: TapeSettings,
        assets: &inputs::Assets,
    ) -> anyhow::Result<ExitStatus> {
        let (sessions, outcome) = self.sessions(settings, assets)?;
        run_replay_stdio(&sessions)?;
        Ok(outcome.status())
    }

    /// Serves agents at an address until Ctrl-C. The exit code says whether all stayed on tape.
    ///
    /// # Errors
    /// When a recording cannot be read, or the address cannot be taken.
    pub fn http(
        &self,
        settings: TapeSettings,
        assets: &inputs::Assets,
        listen: SocketAddr,
    ) -> anyhow::Result<ExitStatus> {
        let (sessions, outcome) = self.sessions(settings, assets)?;
        let server = ReplayServer::start(sessions, listen)?;
        println!(
            "listening on http://{}: {} recordings; Ctrl-C stops",
            server.address(),
            outcome.recordings
        );
        server.wait_for_signal();
        server.stop();
        Ok(outcome.status())
    }

    fn sessions(
        &self,
        settings: TapeSettings,
        assets: &inputs::Assets,
    ) -> anyhow::Result<(TapeSessions, Outcome)> {
        let tapes = tapes(&self.replay, assets)?;
        let report = self.report.as_deref().map(create).transpose()?;
        let outcome = Outcome {
            recordings: tapes.len(),
            left: Arc::default(),
        };
        let left = outcome.left.clone();
        let report = report.map(Mutex::new);
        let observer = move |went: &TapeReport| {
            eprintln!("reel: {}", summary(went));
            let stayed = [TapeStatus::OnTape, TapeStatus::Unplayed].contains(&went.status);
            left.fetch_or(!stayed, Ordering::Relaxed);
            if let Some(file) = &report {
                let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
                let line = serde_json::to_string(went).unwrap_or_default();
                if let Err(error) = writeln!(file, "{line}") {
                    eprintln!("reel: the report cannot be written: {error}");
                }
            }
        };
        Ok((
            TapeSessions::new(Arc::new(tapes), settings, observer),
            outcome,
        ))
    }
}

/// What all sessions came to.
struct Outcome {
    recordings: usize,
    left: Arc<AtomicBool>,
}

impl Outcome {
    fn status(&self) -> ExitStatus {
        match self.left.load(Ordering::Relaxed) {
            true => ExitStatus::CheckFailed,
            false => ExitStatus::Success,
        }
    }
}

/// The recordings among the paths, in the order of their names.
///
/// # Errors
/// When one cannot be read, or they are of different kinds of server.
fn tapes(paths: &[PathBuf], assets: &inputs::Assets) -> anyhow::Result<Tapes> {
    let files = assets.trace_files()?;
    let paths = inputs::traces(&files, paths)?;
    let tapes = paths
        .iter()
        .map(|path| Ok(Tape::new(assets.read(&files, path)?)));
    Ok(Tapes::new(tapes.collect::<anyhow::Result<_>>()?)?)
}

fn create(path: &Path) -> anyhow::Result<File> {
    File::create(path).with_context(|| format!("cannot write the report {}", path.display()))
}

/// How an agent went along a recording, in a line.
fn summary(went: &TapeReport) -> String {
    let path = went.trace.display();
    let reason = went.reason.as_deref().unwrap_or_default();
    match (went.status, &went.deviation) {
        (TapeStatus::Refused, _) => format!("{path}: cannot be answered from: {reason}"),
        (TapeStatus::Unplayed, _) => format!("{path}: begun, no call made"),
        (_, Some(deviation)) => {
            let mut line = format!("{path}: left at {deviation}");
            if let Some(branch) = &went.branch {
                line += &format!("; branch: {}", branch.display());
            } else if !reason.is_empty() {
                line += &format!("; {reason}");
            }
            line
        }
        (_, None) => format!("{path}: on tape, {} calls", went.calls_on_tape),
    }
}
