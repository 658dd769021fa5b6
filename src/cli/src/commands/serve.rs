//! `reel serve` and `reel mcp`: live worlds for agents, and the service around them.

use std::{
    net::SocketAddr,
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use anyhow::{Context, bail};
use reel_agents::ask_user;
use reel_import::SuccessRule;
use reel_llm::{
    agent::ModelUser,
    client::{ApiKey, Cache, CallLog, Client, Endpoint},
};
use reel_server::{
    AnswerSources, AskResponder, AskUser, Config, OnTrace, Order, TapeSettings, TlsFiles,
};
use reel_world::Profile;

use crate::{
    ExitStatus,
    agent_arguments::{USER_TOKENS, user_settings},
    inputs,
    match_arguments::{EMBEDDINGS, MatchArguments, Matching},
    model::RealClock,
    otlp::OtlpArguments,
    replay_server::ReplayArguments,
};

/// Serve live worlds to agents over MCP, and recorded episodes to people over REST, until Ctrl-C.
/// Every call is persisted before it is answered. With --replay recordings answer: on /mcp and /sse, and
/// nothing else; exit code 1 then: a call differs from the recorded one, or is missing.
///
///   /mcp                 an agent with a world of its own (Streamable HTTP); /sse: the same over legacy HTTP+SSE
///   /w/NAME/mcp, .../sse a worker's world, which survives reconnects
///   /analysis/mcp        read-only tools for assistants: query, blame, explain_failure, ...
///   /api                 REST; its document is /api/openapi.json
///   /v1/traces           spans of OpenTelemetry, with --otlp-in
///   /healthz /readyz /metrics
///
/// Flags win over the environment (REEL_LISTEN, ...), the environment over --config FILE, the file
/// over the defaults; `reel server config default` prints the file with all of them.
///
/// Examples:
///   reel serve                                              # tasks that Reel makes, in its own home
///   reel serve --tasks real-bench/tasks --profile real-repo # what reel task real-bench wrote
///   reel serve --replay traces --report report.jsonl        # answer from recordings: docs/regression.md
///   reel serve --config serve.toml --listen 0.0.0.0:8801     # requires tokens: reel server token create NAME --role act
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(flatten)]
    settings: Settings,
    /// Where to listen; addresses other than loopback require tokens
    #[arg(long, value_name = "ADDRESS:PORT", env = "REEL_LISTEN")]
    listen: Option<SocketAddr>,
    /// The store of tables: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", env = "REEL_STORE")]
    store: Option<String>,
    /// File of API tokens; without it tokens.toml in the data folder
    #[arg(long, value_name = "FILE", env = "REEL_TOKENS")]
    tokens: Option<PathBuf>,
    /// Certificate of TLS (PEM); read again when it changes. Without one, plain HTTP
    #[arg(long, value_name = "FILE", env = "REEL_TLS_CERT", requires = "tls_key")]
    tls_cert: Option<PathBuf>,
    /// Private key of the certificate (PEM)
    #[arg(long, value_name = "FILE", env = "REEL_TLS_KEY", requires = "tls_cert")]
    tls_key: Option<PathBuf>,
    /// Take spans of instrumented agents at /v1/traces (OTLP over HTTP), as a collector does: each trace of theirs
    /// becomes one of Reel
    #[arg(long)]
    otlp_in: bool,
    /// Attribute of these spans that names the task; without it the conversation or trace id does
    #[arg(long, value_name = "ATTRIBUTE", requires = "otlp_in")]
    otlp_task: Option<String>,
    /// The score of these spans that says success, NAME or NAME>=VALUE; without it the first one does, if it is true or
    /// false
    #[arg(long, value_name = "SCORE", requires = "otlp_in")]
    otlp_success: Option<SuccessRule>,
    #[command(flatten)]
    otlp: OtlpArguments,
}

/// Serve one agent over standard input and output: what an MCP client starts as a command.
///
/// Example, in a client's configuration:
///   {"mcpServers": {"reel": {"command": "reel", "args": ["mcp", "--data", "/var/lib/reel"]}}}
///   {"mcpServers": {"reel": {"command": "reel", "args": ["mcp", "--replay", "/var/lib/recordings"]}}}
///
/// Exit code 1, with --replay: a call differs from the recorded one, or is missing.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Mcp {
    #[command(flatten)]
    settings: Settings,
}

/// What is played, and where it is kept.
#[derive(clap::Args)]
pub struct Settings {
    /// Configuration file (TOML); flags and environment override it
    #[arg(long, value_name = "FILE", env = "REEL_SERVE_CONFIG")]
    config: Option<PathBuf>,
    /// Folder for traces, exports and tables
    #[arg(long, value_name = "DIR", env = "REEL_DATA")]
    data: Option<PathBuf>,
    /// Task file (REAL-Bench YAML) or folder of them
    #[arg(long, value_name = "PATH", env = "REEL_TASKS")]
    tasks: Option<PathBuf>,
    /// Scene for all tasks: a file (JSON), or the name of one that comes with Reel; without it the
    /// one that each task names, found beside the tasks or among those that come with Reel
    #[arg(long, value_name = "FILE", env = "REEL_SCENE")]
    scene: Option<PathBuf>,
    /// Play tasks in an order drawn by the seed
    #[arg(long)]
    shuffle: bool,
    /// Seed of every random draw
    #[arg(long, value_name = "N", env = "REEL_SEED")]
    seed: Option<u64>,
    /// paper, or a published server to the letter: real-repo (branch main, for its evaluation
    /// agents) or real-gspo (branch gspo, for its trainer)
    #[arg(long, value_name = "NAME", env = "REEL_PROFILE")]
    profile: Option<String>,
    /// Reward preset: a built-in name, or a file
    #[arg(long, value_name = "NAME", env = "REEL_PRESET")]
    preset: Option<String>,
    /// Name of the run that the episodes belong to
    #[arg(long, value_name = "NAME", env = "REEL_RUN")]
    run: Option<String>,
    /// Name of the policy in the traces; without it, what clients call themselves
    #[arg(long, value_name = "NAME", env = "REEL_POLICY")]
    policy: Option<String>,
    #[command(flatten)]
    assets: inputs::Assets,
    /// Record no images; they are rendered again on demand
    #[arg(long)]
    no_images: bool,
    /// Record of each frame besides: depth (16-bit millimetres), masks (instance ids), or both with a
    /// comma between
    #[arg(long, value_name = "LAYERS", env = "REEL_RECORD")]
    record: Option<String>,
    /// Who answers `ask`: rules, client (the person at the client, by elicitation), rest
    /// (a person, through /api/questions), or model (--user-model)
    #[arg(long, value_name = "WHO", env = "REEL_ASK")]
    ask: Option<String>,
    /// A model at the endpoint plays the user who answers `ask`; implies --ask model
    #[arg(long, value_name = "NAME")]
    user_model: Option<String>,
    #[command(flatten)]
    replay: ReplayArguments,
    #[command(flatten)]
    matching: MatchArguments,
    /// OpenAI-compatible endpoint of the user model and the embedding model, up to /v1
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// Environment variable that holds the endpoint's key, where one is needed
    #[arg(long = "api-key-env", value_name = "VARIABLE")]
    key_from: Option<String>,
}

impl Settings {
    fn config(&self) -> anyhow::Result<Config> {
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None => Config::default(),
        };
        let play = &mut config.play;
        if let Some(profile) = &self.profile {
            let known = || {
                format!(
                    "no profile is called '{profile}'; there are paper, real-repo and real-gspo"
                )
            };
            play.profile = Profile::parse(profile).with_context(known)?;
        }
        play.ask = match self.ask.as_deref() {
            // A flag wins over the environment.
            asked
                if self.user_model.is_some()
                    && asked == std::env::var("REEL_ASK").ok().as_deref() =>
            {
                AskResponder::Model
            }
            None => play.ask,
            Some("rules") => AskResponder::Rules,
            Some("client") => AskResponder::Client,
            Some("rest") => AskResponder::Rest,
            Some("model") => AskResponder::Model,
            Some(other) => bail!("--ask is rules, client, rest or model, not '{other}'"),
        };
        if self.user_model.is_some() && play.ask != AskResponder::Model {
            bail!("--user-model answers with --ask model alone: leave one of the two out");
        }
        if self.shuffle {
            play.order = Order::Shuffled;
        }
        play.images &= !self.no_images;
        play.record = self.record.clone().unwrap_or_else(|| play.record.clone());
        play.seed = self.seed.unwrap_or(play.seed);
        let or = |given: &Option<String>, otherwise: Option<String>| given.clone().or(otherwise);
        play.preset = self.preset.clone().unwrap_or_else(|| play.preset.clone());
        play.run = or(&self.run, play.run.take());
        play.policy = or(&self.policy, play.policy.take());
        play.tasks = self.tasks.clone().or_else(|| play.tasks.take());
        play.scene = self.scene.clone().or_else(|| play.scene.take());
        config.data = self.data.clone().unwrap_or(config.data);
        config.assets = self.assets.path().map(Path::to_owned).or(config.assets);
        Ok(config)
    }
}

impl Settings {
    /// Where what follows off tape is recorded, and as whose.
    fn tape_settings(&self, config: &Config) -> TapeSettings {
        TapeSettings {
            branches: config.data.join("branches"),
            policy: self.policy.clone(),
        }
    }
}

/// How long a model may take for an answer, which is asked for twice at most: an agent waits.
const ANSWER_TIMEOUT: Duration = Duration::from_secs(20);

impl Settings {
    /// Who answers from outside: by the flags, else by `[play.matcher]` and `[play.user]` of the
    /// configuration.
    fn sources(&self, config: &Config) -> anyhow::Result<AnswerSources> {
        let (matching, user) = (self.matching(config)?, self.user(config)?);
        let settings = [
            matching.as_ref().map(|it| ("matcher", it.settings())),
            user.as_ref().map(|it| ("user", user_settings(it))),
        ];
        let settings = settings.into_iter().flatten();
        Ok(AnswerSources {
            waiting: Arc::default(),
            settings: settings
                .map(|(name, value)| (name.to_owned(), value))
                .collect(),
            matcher: matching.map(Matching::look_up),
            user: user.map(|client| -> AskUser {
                Arc::new(move |situation, question, input| {
                    let mut user = ModelUser::new(client.clone());
                    Ok(ask_user(&mut user, &situation.question(question), input)?)
                })
            }),
        })
    }

    /// What says which categories a query means; `None` if Reel's word list does.
    fn matching(&self, config: &Config) -> anyhow::Result<Option<Matching>> {
        let configured = config.play.matcher.clone().unwrap_or_default();
        let arguments = self.matching.or(&configured);
        arguments.matching(|model| {
            let endpoint = self.endpoint(model, configured.endpoint.as_ref(), "play.matcher")?;
            let key_from = self.key_from.as_ref().or(configured.api_key_env.as_ref());
            let cache = Cache::open(config.data.join(EMBEDDINGS))?;
            Ok(Arc::new(
                client(config, endpoint, key_from)?.with_cache(cache),
            ))
        })
    }

    /// The model that plays the user, where one does.
    fn user(&self, config: &Config) -> anyhow::Result<Option<Arc<Client>>> {
        if config.play.ask != AskResponder::Model {
            return Ok(None);
        }
        let configured = config.play.user.clone().unwrap_or_default();
        let model = self.user_model.clone().or(configured.model).context(
            "--user-model (play.user.model) is missing: the model that answers for the user",
        )?;
        let mut endpoint = self.endpoint(&model, configured.endpoint.as_ref(), "play.user")?;
        endpoint.max_tokens = USER_TOKENS;
        let key_from = self.key_from.as_ref().or(configured.api_key_env.as_ref());
        Ok(Some(Arc::new(client(config, endpoint, key_from)?)))
    }

    fn endpoint(
        &self,
        model: &str,
        configured: Option<&String>,
        section: &str,
    ) -> anyhow::Result<Endpoint> {
        let url = self.endpoint.as_ref().or(configured).with_context(|| {
            format!("--endpoint ({section}.endpoint) is missing: the address of the model {model}")
        })?;
        let mut endpoint = Endpoint::new(url, model);
        (endpoint.timeout, endpoint.retries) = (ANSWER_TIMEOUT, 1);
        Ok(endpoint)
    }
}

/// A client that logs its calls in the data folder.
fn client(
    config: &Config,
    mut endpoint: Endpoint,
    key_from: Option<&String>,
) -> anyhow::Result<Client> {
    std::fs::create_dir_all(&config.data)
        .with_context(|| format!("cannot make the folder {}", config.data.display()))?;
    endpoint.api_key = key_from.map(|name| ApiKey::from_env(name)).transpose()?;
    let log = CallLog::append(config.data.join("calls.jsonl"))?;
    Ok(Client::new(endpoint, Arc::new(RealClock))?.with_log(log))
}

/// Applies the flags to the configuration and serves agents until Ctrl-C.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut config = arguments.settings.config()?;
    config.listen = arguments.listen.unwrap_or(config.listen);
    config.store = arguments.store.clone().or(config.store);
    config.tokens = arguments.tokens.clone().or(config.tokens);
    if let (Some(cert), Some(key)) = (&arguments.tls_cert, &arguments.tls_key) {
        config.tls = Some(TlsFiles {
            cert: cert.clone(),
            key: key.clone(),
        });
    }
    config.otlp_in |= arguments.otlp_in;
    config.otlp_task = arguments.otlp_task.clone().or(config.otlp_task);
    config.otlp_success = arguments.otlp_success.clone().or(config.otlp_success);
    config.check()?;
    let replay = &arguments.settings.replay;
    if replay.is_given() {
        let settings = arguments.settings.tape_settings(&config);
        return replay.http(settings, &arguments.settings.assets, config.listen);
    }
    let sources = arguments.settings.sources(&config)?;
    let scheme = config.tls.as_ref().map_or("http", |_| "https");
    let exporter = arguments.otlp.exporter()?;
    let on_trace = exporter
        .clone()
        .map(|exporter| -> OnTrace { Box::new(move |trace: &Path| exporter.push(trace)) });
    let served = reel_server::run(
        config,
        inputs::trace_files(),
        sources,
        on_trace,
        move |address, tasks| {
            println!("listening on {scheme}://{address}: {tasks} tasks; Ctrl-C stops");
        },
    );
    if let Some(exporter) = exporter {
        exporter.finish();
    }
    served?;
    Ok(ExitStatus::Success)
}

/// Serves one agent over standard input and output (`reel mcp`).
pub fn mcp(arguments: &Mcp) -> anyhow::Result<ExitStatus> {
    let config = arguments.settings.config()?;
    let replay = &arguments.settings.replay;
    if replay.is_given() {
        let settings = arguments.settings.tape_settings(&config);
        return replay.stdio(settings, &arguments.settings.assets);
    }
    let sources = arguments.settings.sources(&config)?;
    reel_server::run_stdio(config, sources)?;
    Ok(ExitStatus::Success)
}
