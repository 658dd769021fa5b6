//! The running service: everything put together, from the first socket to the last trace.

use std::{
    future::Future,
    io,
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use axum::handler::Handler as _;
use axum::{
    Router, middleware,
    serve::{Listener, ListenerExt as _, TapIo},
};
use reel_live::{Host, Owner, SessionPool, Turn, Turns, restore_on};
use reel_mcp::{AnswerSources, Guard, Questions, ToolServerOptions};
use reel_trace::TraceFiles;
use reel_world::Assets;
use tokio::{
    net::{TcpListener, TcpStream},
    time::Instant,
};
use tokio_util::sync::CancellationToken;
use tower_http::catch_panic::CatchPanicLayer;
use tracing_appender::non_blocking::WorkerGuard;
use tracing_subscriber::{EnvFilter, fmt};

use crate::{
    AuditLog, Config, ConfigError, LogFormat, Role, TokenError, Tokens,
    archive::Archive,
    connections,
    gate::{self, Demand, Rates},
    metrics::Metrics,
    openenv::SiblingCounts,
    otlp::SpanIntake,
    rest::{self, ApiError},
    snapshots::SnapshotFolder,
    tls::{Certificate, TlsError},
};
#[cfg(feature = "tables")]
use crate::{
    intake::Intake,
    jobs::{Jobs, Paths},
    sql_process::SqlProcesses,
    store::Tables,
};

/// How often idle sessions, tokens and rates are looked after.
const TEND_EVERY: Duration = Duration::from_secs(1);

/// What every request handler sees.
pub(crate) struct App {
    pub config: Config,
    pub pool: Arc<SessionPool>,
    pub questions: Arc<Questions>,
    pub sources: AnswerSources,
    /// Spans that came to /v1/traces and whose traces are not complete.
    pub spans: SpanIntake,
    pub archive: Archive,
    pub snapshots: SnapshotFolder,
    /// How many OpenEnv episodes began at each call of a trace.
    pub siblings: SiblingCounts,
    #[cfg(feature = "tables")]
    pub jobs: Jobs,
    #[cfg(feature = "tables")]
    pub tables: Tables,
    #[cfg(feature = "tables")]
    pub intake: Intake,
    #[cfg(feature = "tables")]
    pub sql: SqlProcesses,
    pub tokens: Tokens,
    pub audit: AuditLog,
    /// What clients are shown, where it serves TLS.
    pub certificate: Option<Arc<Certificate>>,
    pub guard: Guard,
    pub rates: Rates,
    pub metrics: Arc<Metrics>,
    /// Queries, replays and renderings at once; one token leaves a place to others.
    pub analyses: Arc<Turns>,
    pub ready: AtomicBool,
    /// When there was last room for traces.
    pub room: tokio::sync::Mutex<Option<Instant>>,
    pub closing: CancellationToken,
}

impl App {
    /// Whether clients have to show tokens: where the world can reach it, or where there is
    /// a file of them.
    pub fn demands_tokens(&self) -> bool {
        !self.config.is_local() || self.tokens.in_use()
    }

    /// A place for a query, a replay or a rendering, which is waited for as long as for a worker.
    pub async fn place(&self, owner: &Owner) -> Result<Turn, ApiError> {
        let patience = Duration::from_secs(self.config.limits.worker_timeout_s);
        tokio::time::timeout(patience, self.analyses.take(owner))
            .await
            .map_err(|_| ApiError::busy("too many requests are waiting; try again in a moment"))
    }

    /// How sessions of policies behave, with the metrics told of every call.
    pub fn tool_server_options(&self) -> ToolServerOptions {
        let metrics = self.metrics.clone();
        let watch = move |tool, outcome, took| metrics.call(tool, outcome, took);
        self.config
            .options(self.sources.clone(), Some(Arc::new(watch)))
    }

    /// How long a client may take to send something.
    pub fn read_patience(&self) -> Duration {
        Duration::from_secs(self.config.limits.read_timeout_s)
    }
}

/// Why a service does not start.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ServeError {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The certificate or its key cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The tokens cannot be read.
    #[error(transparent)]
    Tokens(#[from] TokenError),
    /// The world could reach it, and there are no tokens.
    #[error(
        "{0} is not a loopback address and there are no tokens, so everyone who reaches it has every role; create a token with `reel server token create NAME --role act`, or listen on 127.0.0.1"
    )]
    Open(SocketAddr),
    /// A replay server has no tokens.
    #[error(
        "{0} is not a loopback address, and a replay server knows no tokens: listen on 127.0.0.1, and let agents of other machines come through a tunnel"
    )]
    ReplayOpen(SocketAddr),
    /// The address cannot be taken.
    #[error("cannot listen on {address}: {source}")]
    Listen {
        address: SocketAddr,
        source: io::Error,
    },
    /// The data folder cannot be used.
    #[error("cannot use the data folder: {0}")]
    Data(io::Error),
    /// The system refuses threads or sockets.
    #[error("the operating system reported an error: {0}")]
    System(io::Error),
    /// What came over standard input.
    #[error("standard input is not Model Context Protocol: {0}")]
    Protocol(String),
}

/// Connections from the network.
type Sockets = TapIo<TcpListener, fn(&mut TcpStream)>;

/// A service that has its address and everything it needs.
pub struct Service<L = Sockets> {
    app: Arc<App>,
    listener: L,
    router: Router,
}

impl Service {
    /// Loads the tasks, restores what an earlier server left half recorded, takes the address.
    ///
    /// # Errors
    /// When the configuration is wrong, or the address or a folder cannot be had.
    pub async fn start(
        config: Config,
        trace_files: TraceFiles,
        sources: AnswerSources,
    ) -> Result<Self, ServeError> {
        let address = config.listen;
        let listen = async move {
            let listener = TcpListener::bind(address)
                .await
                .map_err(|source| ServeError::Listen { address, source })?;
            let at_once: fn(&mut TcpStream) = |stream| drop(stream.set_nodelay(true));
            Ok(listener.tap_io(at_once))
        };
        Self::start_on(Host::default(), config, trace_files, sources, listen).await
    }
}

impl<L: Listener<Addr = SocketAddr>> Service<L> {
    /// [`Service::start`] on a certain machine, with its connections from wherever `listen` says.
    ///
    /// # Errors
    /// As [`Service::start`], and as `listen`, which is asked when all else is there.
    #[cfg_attr(
        not(feature = "tables"),
        expect(unused_variables, reason = "only a store names traces elsewhere")
    )]
    pub async fn start_on(
        host: Host,
        config: Config,
        trace_files: TraceFiles,
        sources: AnswerSources,
        listen: impl Future<Output = Result<L, ServeError>>,
    ) -> Result<Self, ServeError> {
        let tokens = Tokens::open(&config.tokens())?;
        if !config.is_local() && tokens.entries().is_empty() {
            return Err(ServeError::Open(config.listen));
        }
        let certificate = config.tls.as_ref().map(Certificate::read).transpose()?;
        let run = config.play.run.clone().unwrap_or_else(|| run_name("serve"));
        let setup = config.setup(run, |complaint| tracing::warn!("{complaint}"))?;
        let assets = config
            .meshes()?
            .map(|folder| Arc::new(folder) as Arc<dyn Assets + Send>);
        let archive = Archive::open(host.clone(), config.traces())
            .map_err(ServeError::Data)?
            .with_assets(assets.clone());
        archive.sweep();
        let moments = SnapshotFolder::at(config.snapshots());
        restore_all(&host.trace_files(), &archive);
        let listener = listen.await?;
        let closing = CancellationToken::new();
        let metrics = Arc::new(Metrics::new());
        let setup = reel_live::Setup {
            folder: archive.folder().to_owned(),
            host,
            answer_settings: sources.settings.clone(),
            ..setup
        };
        #[cfg(feature = "tables")]
        let paths = Paths {
            reel: reel_live::program()
                .map_err(ServeError::Data)?
                .into_os_string(),
            archive: archive.clone(),
            store: config.store(),
            exports: config.exports(),
            assets: config.assets.clone(),
        };
        #[cfg(feature = "tables")]
        let sql = SqlProcesses::new(own_program(&paths.reel), config.assets.clone());
        let app = Arc::new(App {
            pool: Arc::new(SessionPool::new(setup, config.pool())),
            questions: Arc::default(),
            spans: SpanIntake::default(),
            sources,
            #[cfg(feature = "tables")]
            jobs: Jobs::new(paths, closing.child_token(), metrics.jobs_running.clone()),
            #[cfg(feature = "tables")]
            tables: Tables::new(config.store(), trace_files.with_assets(assets)),
            #[cfg(feature = "tables")]
            intake: Intake::default(),
            #[cfg(feature = "tables")]
            sql,
            archive,
            snapshots: moments,
            siblings: SiblingCounts::default(),
            tokens,
            audit: AuditLog::at(config.audit()),
            certificate,
            guard: Guard {
                hosts: config.hosts.clone(),
                origins: config.origins.clone(),
            },
            rates: Rates::new(&config),
            analyses: Turns::new(
                config.limits.analyses,
                config.limits.analyses.saturating_sub(1),
            ),
            metrics,
            ready: AtomicBool::new(true),
            room: tokio::sync::Mutex::default(),
            closing,
            config,
        });
        let router = router(&app);
        Ok(Self {
            app,
            listener,
            router,
        })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// When the system does not say.
    pub fn address(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Tells somebody of each trace of a session when it is finished, on the thread of the session.
    pub fn observe_traces(&self, observe: impl Fn(&std::path::Path) + Send + Sync + 'static) {
        self.app.pool.setup().on_finished.set(observe);
    }

    /// How many tasks it serves.
    pub fn tasks(&self) -> usize {
        self.app.pool.setup().tasks.len()
    }

    /// Serves until `stop`, then lets open requests end, ends every episode and closes its trace.
    pub async fn run(self, stop: impl Future<Output = ()>) {
        let Self {
            app,
            listener,
            router,
        } = self;
        let tending = tokio::spawn(tend(app.clone()));
        #[cfg(feature = "tables")]
        if app.config.ingests_new() {
            tokio::spawn(crate::intake::ingest_new_traces(app.clone()));
        }
        if app.config.otlp_in {
            tokio::spawn(crate::otlp::write_complete_traces(app.clone()));
        }
        let closing = app.closing.clone();
        let serving = tokio::spawn(connections::serve(
            listener,
            router,
            app.clone(),
            closing.clone(),
        ));
        stop.await;
        tracing::info!("stopping: no new calls");
        app.ready.store(false, Ordering::Release);
        closing.cancel();
        let _ = serving.await;
        tending.abort();
        crate::otlp::write_all_traces(&app).await;
        let sessions = app.pool.close_all().await;
        tracing::info!(sessions, "all sessions are closed and all traces complete");
    }
}

/// This program, also where its file was replaced or removed since: processes that it talks to have
/// to be of the same version. Where the process is another program, as under Python, the file itself.
#[cfg(feature = "tables")]
fn own_program(file: &std::ffi::OsStr) -> std::ffi::OsString {
    let image = std::path::Path::new("/proc/self/exe");
    let is_this = std::env::current_exe().is_ok_and(|this| this == file);
    if is_this && image.exists() {
        image.into()
    } else {
        file.to_owned()
    }
}

/// A name for a run that has none.
pub(crate) fn run_name(what: &str) -> String {
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0, |time| time.as_secs());
    format!("{what}-{now}")
}

/// Logs to standard error: never tokens, never what policies say. A thread of its own writes, as
/// long as the guard lives: where standard error is a full disk or a pipe that nobody empties,
/// lines are lost, and nobody waits for them.
pub fn start_logs(config: &Config) -> WorkerGuard {
    let filter = EnvFilter::try_new(&config.log_filter).unwrap_or_else(|_| EnvFilter::new("info"));
    let (writer, guard) = tracing_appender::non_blocking(io::stderr());
    let logs = fmt()
        .with_env_filter(filter)
        .with_writer(writer)
        .log_internal_errors(false);
    // Where somebody else set logs up already, theirs stay.
    let _ = match config.log {
        LogFormat::Text => logs.with_target(false).try_init(),
        LogFormat::Json => logs.json().try_init(),
    };
    guard
}

fn router(app: &Arc<App>) -> Router {
    let max_body = app.config.limits.body_mib << 20;
    let policies = reel_mcp::router(
        app.pool.clone(),
        app.questions.clone(),
        Arc::new(app.tool_server_options()),
        app.closing.clone(),
        max_body,
    );
    let router = rest::router(app, |routes| {
        let routes = routes.other(Demand::role(Role::Act), policies);
        let sockets = crate::openenv::router(app);
        let routes = routes.other(Demand::role(Role::Act).basic(), sockets);
        let routes = match app.config.otlp_in {
            true => routes.other(Demand::role(Role::Act), crate::otlp::router(app)),
            false => routes,
        };
        #[cfg(feature = "rerun")]
        let routes = routes.other(Demand::OPEN, crate::viewer::router());
        #[cfg(feature = "tables")]
        let routes = routes.other(
            Demand::role(Role::Read),
            crate::analysis::router(app, max_body),
        );
        routes
    });
    let open = middleware::from_fn_with_state((app.clone(), Demand::OPEN), gate::admit);
    #[cfg(feature = "tables")]
    let router = router.fallback(crate::pages::page.layer(open));
    #[cfg(not(feature = "tables"))]
    let router = router.fallback(rest::not_found.layer(open));
    router
        // The gate has taken bodies in already, within the limit of the configuration.
        .layer(axum::extract::DefaultBodyLimit::disable())
        .layer(middleware::from_fn_with_state(app.clone(), gate::pass))
        .layer(CatchPanicLayer::custom(rest::broke_down))
}

async fn tend(app: Arc<App>) {
    let mut ticks = tokio::time::interval(TEND_EVERY);
    // A clock that jumped, or a machine that slept, makes up for nothing.
    ticks.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        ticks.tick().await;
        app.pool.reap_idle().await;
        app.rates.tidy();
        #[cfg(feature = "tables")]
        app.sql.tidy();
        match app.certificate.as_ref().map(|it| it.refresh()) {
            None | Some(Ok(false)) => {}
            Some(Ok(true)) => tracing::info!("new connections get the new certificate"),
            Some(Err(error)) => tracing::warn!(%error, "the certificate is unchanged"),
        }
        match app.tokens.refresh() {
            Ok(revoked) => revoked.into_iter().for_each(|name| {
                let pool = app.pool.clone();
                tokio::spawn(async move {
                    let owner = Owner::named(&name);
                    let mut sessions = pool.close_of(&owner).await;
                    tracing::info!(token = name, sessions, "token revoked, its sessions closed");
                    // One that was busy for too long is closed later.
                    while sessions > 0 {
                        tokio::time::sleep(TEND_EVERY).await;
                        sessions = pool.close_of(&owner).await;
                    }
                });
            }),
            Err(error) => {
                tracing::warn!(%error, "cannot reload the token file; the tokens are unchanged")
            }
        }
    }
}

/// What an earlier server left half recorded becomes whole traces. A recording that somebody still
/// writes is locked, and stays.
fn restore_all(files: &TraceFiles, archive: &Archive) {
    for part in archive.unfinished().unwrap_or_default() {
        let file = part.file_name().unwrap_or_default().to_string_lossy();
        let trace = file.trim_end_matches(".mcap.part");
        match restore_on(files, &part, None) {
            // What is lost may hold words of the policy, which no log has.
            Ok(recovery) if !recovery.reported => tracing::info!(
                trace,
                steps = recovery.steps,
                lost = recovery.lost.len(),
                "restored what broke off"
            ),
            Ok(_) => tracing::debug!(trace, "restored before"),
            Err(error) => tracing::warn!(trace, %error, "could not be restored"),
        }
    }
    // A server that was killed between giving a trace its name and syncing the folder left a name
    // that a loss of power takes away. From here on clients are shown it.
    if let Err(error) = archive.sync() {
        tracing::warn!(%error, "the names of traces could not be synced");
    }
}
