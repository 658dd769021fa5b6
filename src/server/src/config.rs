//! The configuration: a TOML file, with a default for everything, and what is wrong with it.

use std::{
    collections::BTreeMap,
    fs, io,
    net::{IpAddr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use reel_import::SuccessRule;
use reel_live::{Host, PreparedTaskCache, Setup, TraceObserver};
use reel_mcp::{AnswerSources, AskResponder};
use reel_reward::Preset;
use reel_tasks::{DrawOptions, ObjectOrder, SceneSource, assets::AssetFolder, draw, home_scene};
use reel_trace::{Durability, FrameLayers, Images, RecordOptions};
use reel_world::{Assets as _, Family, Meshes, Profile, Scene, Skills, Task};
use serde::{Deserialize, Serialize};

use crate::tls::TlsFiles;

/// How many tasks of each family are made where no tasks are given.
const TASKS_MADE: usize = 12;

/// The configuration of a server.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Where it listens. Anything but a loopback address demands tokens.
    pub listen: SocketAddr,
    /// Folder of traces, exports, and the store where none is named.
    pub data: PathBuf,
    /// The store of tables: a folder or s3://bucket/folder; without it `store` in the data folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub store: Option<String>,
    /// Whether new traces of the archive are read into the tables as they come; where it is not said,
    /// only into a store in the data folder, which no other server has.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ingest_new: Option<bool>,
    /// Folder of meshes of objects, which sessions play with and recordings with meshes are executed
    /// with; without it objects are primitives.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub assets: Option<PathBuf>,
    /// Folder of panels and pages of the dashboards; without it `definitions` in the data folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub definitions: Option<PathBuf>,
    /// File of tokens; without it `tokens.toml` in the data folder.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tokens: Option<PathBuf>,
    /// Names besides localhost under which clients may reach it (the `Host` header),
    /// e.g. behind a proxy.
    pub hosts: Vec<String>,
    /// Origins of web pages that may call it, e.g. `https://lab.example`.
    pub origins: Vec<String>,
    /// Whether it takes spans of OpenTelemetry at /v1/traces, from whoever may act; complete ones become traces.
    pub otlp_in: bool,
    /// The attribute of these spans that names the task, as `--task` of `reel import otel`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub otlp_task: Option<String>,
    /// The score of these spans that says success, as `--success` of `reel import otel`: `NAME` or `NAME>=VALUE`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub otlp_success: Option<SuccessRule>,
    /// Format of the server's logs: text or JSON.
    pub log: LogFormat,
    /// Which logs: a level, or directives such as `info,reel_mcp=debug`.
    pub log_filter: String,
    /// Certificate and key of TLS; without them, plain HTTP.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tls: Option<TlsFiles>,
    /// What the sessions play: tasks, seed, profile, rewards and who answers.
    pub play: Play,
    /// What clients may take.
    pub limits: Limits,
}

/// Format in which the server writes its logs.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LogFormat {
    /// Lines of plain text, to be read by people.
    #[default]
    Text,
    /// One JSON object a line.
    Json,
}

/// What the sessions play and how their episodes are recorded.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Play {
    /// Task file or folder of them; without it, tasks that Reel makes in its own home.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tasks: Option<PathBuf>,
    /// Scene file for all tasks; without it the scene that each task names, found beside the tasks
    /// or among those that come with Reel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scene: Option<PathBuf>,
    /// Order in which the tasks are played.
    pub order: Order,
    /// Seed of everything random, the order included.
    pub seed: u64,
    /// `paper`, `real-repo` or `real-gspo`.
    pub profile: Profile,
    /// How reliable the robot's skills are: `perfect`, or `real-v1` as on the paper's robot.
    pub skills: Skills,
    /// Reward preset: a built-in name, or a file.
    pub preset: String,
    /// The run that the episodes belong to; without it, one named after the time of the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
    /// Name of the policy in the traces; without it, what clients call themselves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub policy: Option<String>,
    /// Whether traces hold images; without them they are drawn again on demand.
    pub images: bool,
    /// What traces hold of each frame besides: `depth`, `masks`, both with a comma between, or nothing.
    pub record: String,
    /// What an acknowledged call survives: `write` (the death of the process) or `fsync`
    /// (the loss of power).
    pub durability: String,
    /// Who answers the `ask` calls of the policies: `rules`, `client`, `rest`, or `model`, the one of
    /// `user`.
    pub ask: AskResponder,
    /// How long a person may take to answer, in seconds.
    #[serde(alias = "ask_patience_s")]
    pub ask_timeout_s: u64,
    /// How the queries of `show_object_by_category` are matched by vectors; without it, by Reel's
    /// word list.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub matcher: Option<MatcherConfig>,
    /// The model that answers where `ask` is `model`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub user: Option<UserConfig>,
}

/// A model in the role of the user (docs/agents.md#a-model-as-the-user-and-what-a-query-matches).
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct UserConfig {
    /// The model's name at the endpoint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// OpenAI-compatible endpoint of that model, up to `/v1`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub endpoint: Option<String>,
    /// Environment variable that holds the endpoint's key.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub api_key_env: Option<String>,
}

/// Where the vectors of words come from, and what is made of them (docs/agents.md#open-vocabulary).
#[derive(Clone, PartialEq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MatcherConfig {
    /// Embedding model at the endpoint.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// OpenAI-compatible endpoint of that model, up to `/v1`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub endpoint: Option<String>,
    /// Environment variable that holds the endpoint's key.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub api_key_env: Option<String>,
    /// File of vectors, instead of a model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vectors: Option<PathBuf>,
    /// `best` (without it) or `threshold`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rule: Option<String>,
    /// Similarity from which a category is meant by `threshold`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub min_similarity: Option<f32>,
}

/// In which order tasks are played.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Order {
    /// As they are listed.
    #[default]
    Listed,
    /// Drawn by the seed.
    Shuffled,
}

/// What clients may take.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Sessions open at once.
    pub sessions: usize,
    /// Sessions of one token at once, leases among them.
    pub sessions_per_token: usize,
    /// Simulators in memory at once; the others are snapshots.
    #[serde(alias = "awake")]
    pub simulators: usize,
    /// Calls at work at once; 0: one for each core.
    pub workers: usize,
    /// Seconds after its last call until a session is put aside as a snapshot.
    #[serde(alias = "park_after_s")]
    pub suspend_after_s: u64,
    /// Seconds after its last call until a session is closed.
    pub close_after_s: u64,
    /// Seconds that a call waits for a worker.
    #[serde(alias = "patience_s")]
    pub worker_timeout_s: u64,
    /// Most client connections that are open at once.
    pub connections: usize,
    /// Seconds that a client has for the head of a request, again for its body, and for reading
    /// any of the answer.
    #[serde(alias = "read_s")]
    pub read_timeout_s: u64,
    /// Largest body of a request, in MiB.
    pub body_mib: usize,
    /// Largest trace that is taken, in MiB.
    pub upload_mib: usize,
    /// Requests a second from one client (a token, or an address).
    pub requests_per_s: u32,
    /// Requests at once from one client, after a pause.
    pub burst: u32,
    /// Longest answer to SQL, in rows.
    pub sql_rows: usize,
    /// Longest time of a query, in seconds.
    #[serde(alias = "sql_s")]
    pub sql_timeout_s: u64,
    /// Memory of a query before it spills, in MiB.
    pub sql_mib: usize,
    /// Queries, replays and renderings at once.
    pub analyses: usize,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8801)),
            data: "reel-data".into(),
            store: None,
            ingest_new: None,
            assets: None,
            definitions: None,
            tokens: None,
            hosts: Vec::new(),
            origins: Vec::new(),
            otlp_in: false,
            otlp_task: None,
            otlp_success: None,
            log: LogFormat::Text,
            log_filter: "info,rmcp=error,buoyant_kernel=warn".to_owned(),
            tls: None,
            play: Play::default(),
            limits: Limits::default(),
        }
    }
}

impl Default for Play {
    fn default() -> Self {
        Self {
            tasks: None,
            scene: None,
            order: Order::Listed,
            seed: 0,
            profile: Profile::Paper,
            skills: Skills::Perfect,
            preset: "paper".to_owned(),
            run: None,
            policy: None,
            images: true,
            record: String::new(),
            durability: "write".to_owned(),
            ask: AskResponder::Rules,
            ask_timeout_s: 120,
            matcher: None,
            user: None,
        }
    }
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            sessions: 2_000,
            sessions_per_token: 1_000,
            simulators: 256,
            workers: 0,
            suspend_after_s: 30,
            close_after_s: 3_600,
            worker_timeout_s: 60,
            connections: 8_192,
            read_timeout_s: 30,
            body_mib: 4,
            upload_mib: 1_024,
            requests_per_s: 2_000,
            burst: 4_000,
            sql_rows: 1_000_000,
            sql_timeout_s: 60,
            sql_mib: 512,
            analyses: 4,
        }
    }
}

/// What is wrong with a configuration.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("cannot read {path}: {source}", path = path.display())]
    Read { path: PathBuf, source: io::Error },
    /// It is no configuration.
    #[error("{path}: {message}", path = path.display())]
    Syntax { path: PathBuf, message: String },
    /// A value that cannot be.
    #[error("{key}: {message}")]
    Value {
        /// Dotted key of the value, e.g. `limits.sessions`.
        key: &'static str,
        message: String,
    },
    /// The tasks or the scene cannot be loaded.
    #[error(transparent)]
    Tasks(#[from] reel_tasks::TaskError),
}

impl Config {
    /// Reads a file.
    ///
    /// # Errors
    /// When it cannot be read, is no TOML, or has a key or value that is none.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let text = fs::read_to_string(path).map_err(|source| ConfigError::Read {
            path: path.to_owned(),
            source,
        })?;
        toml::from_str(&text).map_err(|error| ConfigError::Syntax {
            path: path.to_owned(),
            message: error.to_string().trim_end().to_owned(),
        })
    }

    /// As a file would have it.
    pub fn to_toml(&self) -> String {
        toml::to_string_pretty(self).expect("a configuration has a TOML form")
    }

    /// Where the traces lie.
    pub fn traces(&self) -> PathBuf {
        self.data.join("traces")
    }

    /// Where snapshots of moments are kept that people looked at.
    pub(crate) fn snapshots(&self) -> PathBuf {
        self.data.join("moments")
    }

    /// Where training sets are written.
    pub fn exports(&self) -> PathBuf {
        self.data.join("exports")
    }

    /// Where panels and pages of the dashboards are.
    pub fn definitions(&self) -> PathBuf {
        self.definitions
            .clone()
            .unwrap_or_else(|| self.data.join("definitions"))
    }

    /// Whether new traces are read into the tables as they come.
    pub fn ingests_new(&self) -> bool {
        self.ingest_new.unwrap_or(self.store.is_none())
    }

    /// Where the store of tables is.
    pub fn store(&self) -> String {
        self.store
            .clone()
            .unwrap_or_else(|| self.data.join("store").display().to_string())
    }

    /// File of the audit log, in the data folder.
    pub fn audit(&self) -> PathBuf {
        self.data.join("audit.jsonl")
    }

    /// The file of tokens.
    pub fn tokens(&self) -> PathBuf {
        self.tokens
            .clone()
            .unwrap_or_else(|| self.data.join("tokens.toml"))
    }

    /// Whether only this machine can reach it.
    pub fn is_local(&self) -> bool {
        match self.listen.ip() {
            IpAddr::V4(ip) => ip.is_loopback(),
            IpAddr::V6(ip) => ip.is_loopback(),
        }
    }

    /// Checks what does not need the tasks.
    ///
    /// # Errors
    /// At the first value that cannot be.
    pub fn check(&self) -> Result<(), ConfigError> {
        let wrong = |key, message: &str| {
            Err(ConfigError::Value {
                key,
                message: message.to_owned(),
            })
        };
        let limits = &self.limits;
        let counts: [(&'static str, usize); 10] = [
            ("limits.sessions", limits.sessions),
            ("limits.sessions_per_token", limits.sessions_per_token),
            ("limits.simulators", limits.simulators),
            ("limits.connections", limits.connections),
            ("limits.body_mib", limits.body_mib),
            ("limits.upload_mib", limits.upload_mib),
            ("limits.sql_rows", limits.sql_rows),
            ("limits.sql_mib", limits.sql_mib),
            ("limits.analyses", limits.analyses),
            ("limits.burst", limits.burst as usize),
        ];
        if let Some((key, _)) = counts.iter().find(|(_, count)| *count == 0) {
            return wrong(key, "must be at least 1");
        }
        let times = [
            ("limits.close_after_s", limits.close_after_s),
            ("limits.worker_timeout_s", limits.worker_timeout_s),
            ("limits.read_timeout_s", limits.read_timeout_s),
            ("limits.sql_timeout_s", limits.sql_timeout_s),
            ("limits.requests_per_s", u64::from(limits.requests_per_s)),
        ];
        if let Some((key, _)) = times.iter().find(|(_, time)| *time == 0) {
            return wrong(key, "must be at least 1");
        }
        for (key, is_given) in [
            ("otlp_task", self.otlp_task.is_some()),
            ("otlp_success", self.otlp_success.is_some()),
        ] {
            if is_given && !self.otlp_in {
                return wrong(key, "is of spans, and none are taken; set otlp_in = true");
            }
        }
        if Durability::parse(&self.play.durability).is_none() {
            return wrong("play.durability", "there are 'write' and 'fsync'");
        }
        self.layers()?;
        if let Some(run) = &self.play.run {
            reel_live::check_name(run).map_err(|_| ConfigError::Value {
                key: "play.run",
                message: format!("'{run}' could not be the name of a file"),
            })?;
        }
        if let Some(origin) = self.origins.iter().find(|origin| !origin.contains("://")) {
            return wrong(
                "origins",
                &format!("'{origin}' has no scheme; write e.g. https://{origin}"),
            );
        }
        self.preset().map(drop)
    }

    fn layers(&self) -> Result<FrameLayers, ConfigError> {
        FrameLayers::parse(&self.play.record).map_err(|message| ConfigError::Value {
            key: "play.record",
            message,
        })
    }

    /// The reward preset of `play.preset`: a built-in one, or read from a file.
    fn preset(&self) -> Result<Preset, ConfigError> {
        let wrong = |message: String| ConfigError::Value {
            key: "play.preset",
            message,
        };
        if let Some(preset) = Preset::parse(&self.play.preset) {
            return Ok(preset);
        }
        let text = fs::read_to_string(&self.play.preset).map_err(|_| {
            let known = Preset::built_in()
                .map(|preset| preset.name().to_owned())
                .join("', '");
            wrong(format!(
                "no preset is called '{}' and there is no such file; built in are '{known}'",
                self.play.preset
            ))
        })?;
        Preset::from_toml(&text).map_err(|error| wrong(format!("{}: {error}", self.play.preset)))
    }

    /// What sessions play; loads the tasks. Broken task files are left out
    /// and named by `on_broken`.
    ///
    /// # Errors
    /// When the configuration is wrong, or no task can be loaded.
    pub fn setup(
        &self,
        run_id: String,
        mut on_broken: impl FnMut(&str),
    ) -> Result<Setup, ConfigError> {
        self.check()?;
        let play = &self.play;
        let given = match &play.scene {
            Some(path) => match path
                .to_str()
                .and_then(reel_tasks::generate::scene::built_in)
            {
                Some(scene) => Some(Arc::new(scene)),
                None => {
                    let loaded = reel_tasks::scene::load(path)?;
                    loaded
                        .warnings
                        .iter()
                        .for_each(|warning| on_broken(&format!("{}: {warning}", path.display())));
                    Some(Arc::new(loaded.scene))
                }
            },
            None => None,
        };
        let (mut tasks, scenes) = match &play.tasks {
            Some(path) => {
                let by_id = SceneSource::ById {
                    built_in: reel_tasks::generate::scene::by_id,
                    folders: Vec::new(),
                };
                let source = given.map_or(by_id, SceneSource::Fixed);
                let loaded = reel_tasks::load_with(path, &source, ObjectOrder::AsWritten);
                loaded
                    .warnings
                    .iter()
                    .for_each(|warning| on_broken(warning));
                loaded
                    .report
                    .broken
                    .iter()
                    .for_each(|error| on_broken(&error.to_string()));
                (
                    loaded.report.tasks.into_iter().map(Arc::new).collect(),
                    loaded.scenes,
                )
            }
            None => {
                let scene = given.unwrap_or_else(|| Arc::new(home_scene()));
                (made(&scene, play.seed), scene.into())
            }
        };
        if tasks.is_empty() {
            let message = format!(
                "no task could be loaded from {}",
                play.tasks
                    .as_ref()
                    .map_or("".into(), |path| path.display().to_string())
            );
            return Err(ConfigError::Value {
                key: "play.tasks",
                message,
            });
        }
        if play.order == Order::Shuffled {
            tasks.sort_by_cached_key(|task: &Arc<Task>| {
                *blake3::hash(format!("{}/{}", play.seed, task.task_id).as_bytes()).as_bytes()
            });
        }
        let meshes = match self.meshes()? {
            Some(folder) => folder.meshes(&mut tasks.iter().flat_map(|task| task.assets())),
            None => Meshes::default(),
        };
        let images = if play.images {
            Images::Full
        } else {
            Images::None
        };
        let durability = Durability::parse(&play.durability).expect("the check looked at it");
        Ok(Setup {
            tasks,
            scenes,
            meshes,
            seed: play.seed,
            profile: play.profile,
            skills: play.skills,
            preset: self.preset()?,
            run_id,
            folder: self.traces(),
            answer_settings: BTreeMap::new(),
            options: RecordOptions {
                images,
                layers: self.layers()?,
                durability,
            },
            host: Host::default(),
            stages: PreparedTaskCache::default(),
            on_finished: TraceObserver::default(),
        })
    }

    /// The folder of meshes, if one is named.
    ///
    /// # Errors
    /// When it cannot be listed.
    pub fn meshes(&self) -> Result<Option<AssetFolder>, ConfigError> {
        let open = |path: &PathBuf| {
            AssetFolder::open(path).map_err(|source| ConfigError::Read {
                path: path.clone(),
                source,
            })
        };
        self.assets.as_ref().map(open).transpose()
    }

    /// How policy sessions behave: who answers from outside, and who is told of every call.
    pub fn options(
        &self,
        sources: AnswerSources,
        watch: Option<reel_mcp::CallObserver>,
    ) -> reel_mcp::ToolServerOptions {
        let play = &self.play;
        reel_mcp::ToolServerOptions {
            ask: play.ask,
            ask_patience: Duration::from_secs(play.ask_timeout_s),
            policy: play.policy.clone(),
            sources,
            watch,
        }
    }

    /// How many sessions there may be, and how long they last.
    pub fn pool(&self) -> reel_live::Limits {
        let limits = &self.limits;
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        reel_live::Limits {
            sessions: limits.sessions,
            sessions_each: limits.sessions_per_token,
            in_memory: limits.simulators,
            workers: if limits.workers == 0 {
                cores()
            } else {
                limits.workers
            },
            suspend_after: Duration::from_secs(limits.suspend_after_s),
            close_after: Duration::from_secs(limits.close_after_s),
            worker_timeout: Duration::from_secs(limits.worker_timeout_s),
        }
    }
}

/// Tasks of all families in the home that comes with Reel.
fn made(scene: &Scene, seed: u64) -> Vec<Arc<Task>> {
    let options = DrawOptions {
        scene,
        families: &Family::ALL,
        count: TASKS_MADE,
        seed,
    };
    draw(&options).tasks.into_iter().map(Arc::new).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rules_for_spans_want_spans() {
        let read = |text: &str| toml::from_str::<Config>(text).unwrap();
        let rules = "otlp_task = \"test.case.name\"\notlp_success = \"builds>=0.5\"\n";
        let told = read(rules).check().unwrap_err().to_string();
        assert!(told.contains("otlp_task"), "{told}");
        let config = read(&format!("otlp_in = true\n{rules}"));
        config.check().unwrap();
        assert_eq!(read(&config.to_toml()), config);
        let wrong = toml::from_str::<Config>("otlp_success = \"builds>=\"").unwrap_err();
        assert!(wrong.to_string().contains("NAME>=VALUE"), "{wrong}");
    }
}
