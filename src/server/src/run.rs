//! The service as a whole process: runtime, signals, the limit on open files.

use std::{io, net::SocketAddr, path::Path, sync::Arc, time::Duration};

use reel_live::{SessionPool, Setup};
use reel_mcp::AnswerSources;
use reel_trace::TraceFiles;
use tokio::{
    runtime::{Builder, Runtime},
    signal,
};

use crate::{Config, ServeError, Service, service::run_name, start_logs};

/// What is called with a trace when it is finished, on the thread of its session.
pub type OnTrace = Box<dyn Fn(&Path) + Send + Sync>;

/// How long work that nobody waits for may take to end.
pub(crate) const AT_LAST: Duration = Duration::from_secs(1);

/// Serves until Ctrl-C or a service manager ends it. `on_listening` is told the address and the
/// number of tasks. Questions about the store read traces from `trace_files`; `sources` answer
/// policies from outside; `on_trace` is told of each trace of a session when it is finished.
///
/// # Errors
/// When the service cannot start.
pub fn run(
    config: Config,
    trace_files: TraceFiles,
    sources: AnswerSources,
    on_trace: Option<OnTrace>,
    on_listening: impl FnOnce(SocketAddr, usize),
) -> Result<(), ServeError> {
    let _logs = start_logs(&config);
    raise_file_limit();
    let runtime = runtime(None)?;
    let served = runtime.block_on(async {
        // Whoever is told the address may end the service at once.
        let stopped = stopped();
        let service = Service::start(config, trace_files, sources).await?;
        if let Some(observe) = on_trace {
            service.observe_traces(observe);
        }
        on_listening(
            service.address().map_err(ServeError::System)?,
            service.tasks(),
        );
        service.run(stopped).await;
        Ok(())
    });
    // Every trace is whole by now; what still computes (a question, a replay) is for nobody.
    runtime.shutdown_timeout(AT_LAST);
    served
}

/// Serves one agent over standard input and output, until it goes.
///
/// # Errors
/// When the configuration is wrong, or what comes in is not the protocol.
pub fn run_stdio(config: Config, sources: AnswerSources) -> Result<(), ServeError> {
    let _logs = start_logs(&config);
    let run = config
        .play
        .run
        .clone()
        .unwrap_or_else(|| format!("{}-{}", run_name("mcp"), std::process::id()));
    let setup = config.setup(run, |complaint| tracing::warn!("{complaint}"))?;
    std::fs::create_dir_all(&setup.folder).map_err(ServeError::Data)?;
    let setup = Setup {
        answer_settings: sources.settings.clone(),
        ..setup
    };
    let options = config.options(sources, None);
    let pool = Arc::new(SessionPool::new(setup, config.pool()));
    let runtime = runtime(Some(2))?;
    let served = runtime.block_on(async {
        let served = tokio::select! {
            served = reel_mcp::stdio(pool.clone(), options) => served,
            () = stopped() => Ok(()),
        };
        pool.close_all().await;
        served
    });
    // A thread may still wait for standard input.
    runtime.shutdown_background();
    served.map_err(|error| ServeError::Protocol(error.to_string()))
}

pub(crate) fn runtime(threads: Option<usize>) -> Result<Runtime, ServeError> {
    let mut builder = Builder::new_multi_thread();
    if let Some(threads) = threads {
        builder.worker_threads(threads);
    }
    builder.enable_all().build().map_err(ServeError::System)
}

/// Ctrl-C, or what a service manager sends, from now on: also before anybody waits for it.
pub(crate) fn stopped() -> impl Future<Output = ()> {
    #[cfg(unix)]
    {
        use signal::unix::{Signal, SignalKind, signal};
        async fn comes(sent: io::Result<Signal>) {
            match sent {
                Ok(mut sent) => drop(sent.recv().await),
                Err(_) => std::future::pending().await,
            }
        }
        let (interrupted, terminated) = (
            signal(SignalKind::interrupt()),
            signal(SignalKind::terminate()),
        );
        async move {
            tokio::select! {
                () = comes(interrupted) => {}
                () = comes(terminated) => {}
            }
        }
    }
    #[cfg(not(unix))]
    async {
        drop(signal::ctrl_c().await);
    }
}

/// A session has a trace open, and a client two sockets: as many files as the system lets us.
fn raise_file_limit() {
    match rlimit::increase_nofile_limit(u64::MAX) {
        Ok(limit) if limit < 8_192 => {
            tracing::warn!(
                limit,
                "the limit of open files is low; raise it with `ulimit -n`"
            )
        }
        _ => {}
    }
}
