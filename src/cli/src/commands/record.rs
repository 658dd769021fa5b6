//! `reel record`: a recorder between an agent and somebody else's tool server.

use std::{
    env, fs,
    io::Read,
    net::{IpAddr, Ipv4Addr, SocketAddr},
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use anyhow::{Context, bail};
use reel_proxy::{
    Bridge, Mapping, OnFull, PendingTraces, Proxy, ProxyEvent, Report, Setup, Upstream,
};
use reel_redact::{RULES_FILE_MAX, Rules};
use reel_reward::Preset;
use reel_tasks::ObjectOrder;
use reel_trace::{Durability, Images, RecordOptions};
use reel_world::{
    Profile, Scenes,
    record::{Backend, EndReason},
};

use crate::{
    ExitStatus, inputs,
    otlp::{OtlpArguments, TraceExporter},
};

/// Record any MCP tool server: a proxy between agents and the server that forwards every byte
/// unchanged and records the episodes as traces. Agents connect to this command's address instead
/// of the server's; nothing else changes for them. `reel run` plays tasks in Reel's own simulator.
///
/// A call is on disk before it is forwarded, its result before the agent receives it; `reel trace
/// recover` restores what a killed recorder leaves. Streamable HTTP, legacy HTTP+SSE and stdio are
/// recorded; other traffic is forwarded and counted. An episode begins with the task that a
/// `finish` or `finish_with_id` answers (REAL's servers and Reel's own), else with the first call
/// of a session; it ends with the next `finish`, DELETE, the end of the stream or process, or
/// Ctrl-C.
///
/// World graphs, markers and the held object come from the `Debug Info` text of REAL's servers. For
/// other servers a mapping file names the tools and where results hold the state (docs/proxy.md):
///
///   [tools.drive_to]
///   is = "nav_to"
///   arguments = { receptacle_name = "place" }
///   [state]
///   graph = "/world"
///   held = "/robot/holds"
///
/// Passwords, tokens and keys in what is recorded are replaced by labels such as `[redacted:token#1]`, never in what is
/// forwarded; a rules file adds to the built-in rules:
///
///   keys = ["pin_code"]
///   pointers = ["/arguments/card/number"]
///   [patterns]
///   ticket = 'TICKET-\d{6}'
///
/// Examples:
///   reel record --upstream http://127.0.0.1:8000/sse --out traces          # agents connect to http://127.0.0.1:8810/sse
///   reel record --upstream http://robot:8000/mcp --backend robot --mapping robot.toml --out traces --watch
///   reel record --out traces --stdio -- python my_server.py                # in the place of the server's command
///   reel record --out traces --listen 127.0.0.1:8810 --stdio -- python my_server.py   # agents connect to http://127.0.0.1:8810/mcp
///   reel record --upstream https://robot.lab.example/mcp --out traces      # certificates as this machine trusts them
///   reel record --upstream http://127.0.0.1:8801/mcp --tasks tasks --scene scene.json --out traces
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The tool server: http://HOST[:PORT][/PATH], or https
    #[arg(
        long,
        value_name = "URL",
        required_unless_present = "stdio",
        conflicts_with = "stdio"
    )]
    upstream: Option<String>,
    /// The tool server is a program that speaks over standard input and output; its command line
    /// comes last. Agents speak with this command in the same way or, with --listen, over
    /// Streamable HTTP, where each session gets a process of its own
    #[arg(long, requires = "command")]
    stdio: bool,
    /// Where agents connect; without it 127.0.0.1:8810, with --stdio nowhere
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// A name of this machine by which agents may call it, besides addresses and localhost
    #[arg(long = "host", value_name = "NAME")]
    hosts: Vec<String>,
    /// Folder for the traces; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "traces-out")]
    out: PathBuf,
    /// Name of the run that the traces belong to
    #[arg(long, value_name = "NAME")]
    run: Option<String>,
    /// What the server drives: proxy (another simulator) or robot
    #[arg(long, value_name = "KIND", default_value = "proxy")]
    backend: String,
    /// Dialect of the server where they differ: real-repo, real-gspo or paper
    #[arg(long, value_name = "NAME", default_value = "real-repo")]
    profile: String,
    /// Reward preset: a built-in name, or a file
    #[arg(long, value_name = "NAME", default_value = "paper")]
    preset: String,
    /// Task file or folder of them: the one that a server names is taken instead of what the server
    /// says of it; a single one is the task of a server that names none
    #[arg(long, alias = "task", value_name = "PATH")]
    tasks: Option<PathBuf>,
    #[command(flatten)]
    scene: inputs::SceneArguments,
    /// Mapping file: which tools are which of the eleven, and where results tell the
    /// state of the world
    #[arg(long, value_name = "FILE")]
    mapping: Option<PathBuf>,
    /// What is replaced by labels in everything that is written: a rules file, which adds to the built-in rules, or none
    #[arg(long, value_name = "FILE|none")]
    redact: Option<PathBuf>,
    /// Name of the policy in the traces; without it, what agents call themselves
    #[arg(long, value_name = "NAME")]
    policy: Option<String>,
    /// What happens when a recording cannot be written: stop (calls are refused) or continue (calls
    /// are forwarded unrecorded, with a warning)
    #[arg(long, value_name = "WHAT", default_value = "stop")]
    on_full: String,
    /// What a recorded call survives: write (the death of the process) or fsync (the loss of power)
    #[arg(long, value_name = "WHAT", default_value = "write")]
    durability: String,
    /// Record no images; their digests stay
    #[arg(long)]
    no_images: bool,
    /// Largest message that is recorded, in MiB; larger ones are forwarded with a warning
    #[arg(long, value_name = "MIB", default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=1024))]
    message_limit: u32,
    /// Seconds without a call after which an episode ends, unless the session ends it before
    #[arg(
        long = "idle-timeout",
        alias = "idle",
        value_name = "SECONDS",
        default_value_t = 1800
    )]
    idle: u64,
    /// Print the transcript while it happens, to standard error with --stdio
    #[arg(long)]
    watch: bool,
    #[command(flatten)]
    otlp: OtlpArguments,
    /// Print counts of messages and episodes as JSON at the end
    #[arg(long)]
    json: bool,
    /// With --stdio: the server's program and its arguments
    #[arg(
        value_name = "CMD",
        trailing_var_arg = true,
        allow_hyphen_values = true,
        requires = "stdio"
    )]
    command: Vec<String>,
}

/// Where agents connect where nothing else is said.
const LISTEN: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 8810);

impl Arguments {
    /// Whether this process is the server to its agent, over standard input and output.
    fn takes_its_place(&self) -> bool {
        self.stdio && self.listen.is_none()
    }
}

/// Records the episodes that pass between agents and a tool server.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let exporter = arguments.otlp.exporter()?;
    let setup = Arc::new(setup(arguments, exporter.clone())?);
    let recorded = record(arguments, &setup);
    if let Some(exporter) = exporter {
        exporter.finish();
    }
    recorded
}

fn record(arguments: &Arguments, setup: &Arc<Setup>) -> anyhow::Result<ExitStatus> {
    if arguments.takes_its_place() {
        let code = reel_proxy::run_stdio(setup.clone(), &arguments.command)?;
        let answer = answer(&setup.report, true, arguments.json)?;
        return match code {
            Some(0) | None => Ok(answer),
            Some(code) => bail!("the server ended with code {code}"),
        };
    }
    let (bridge, url) = match &arguments.upstream {
        Some(url) => (None, url.clone()),
        None => {
            let (bridge, url) = Bridge::start(&arguments.command, setup)?;
            (Some(bridge), url)
        }
    };
    let upstream = Upstream::parse(&url)?;
    let path = setup.rules.without_secrets(upstream.path());
    let proxy = Proxy::bind(setup.clone(), upstream, arguments.listen.unwrap_or(LISTEN))?;
    println!(
        "recording into {}: agents connect to http://{}{path}; Ctrl-C stops",
        setup.out.display(),
        proxy.address()?
    );
    proxy.run()?;
    if let Some(bridge) = bridge {
        bridge.end_all();
    }
    answer(&setup.report, false, arguments.json)
}

fn setup(arguments: &Arguments, exporter: Option<TraceExporter>) -> anyhow::Result<Setup> {
    let backend = match arguments.backend.as_str() {
        "proxy" => Backend::Proxy,
        "robot" => Backend::Robot,
        other => bail!("--backend is proxy or robot, not '{other}'"),
    };
    let on_full = match arguments.on_full.as_str() {
        "stop" => OnFull::Stop,
        "continue" => OnFull::Continue,
        other => bail!("--on-full is stop or continue, not '{other}'"),
    };
    let profile = Profile::parse(&arguments.profile);
    let profile = profile.with_context(|| {
        format!(
            "no profile is called '{}'; there are paper, real-repo and real-gspo",
            arguments.profile
        )
    })?;
    let durability = Durability::parse(&arguments.durability);
    let durability = durability.with_context(|| {
        format!(
            "--durability is write or fsync, not '{}'",
            arguments.durability
        )
    })?;
    let images = if arguments.no_images {
        Images::None
    } else {
        Images::Full
    };
    let mapping = arguments.mapping.as_deref().map(mapping).transpose()?;
    let (tasks, scenes) = match &arguments.tasks {
        Some(path) => {
            let loaded = inputs::tasks(path, &arguments.scene, ObjectOrder::AsWritten)?;
            (loaded.tasks, loaded.scenes)
        }
        None => {
            let scene = arguments.scene.fixed()?;
            (Vec::new(), scene.map(Scenes::from).unwrap_or_default())
        }
    };
    let run = match &arguments.run {
        Some(run) => {
            reel_live::check_name(run).context("--run is part of the names of files")?;
            run.clone()
        }
        None => format!(
            "record-{}",
            SystemTime::now()
                .duration_since(UNIX_EPOCH)
                .map_or(0, |time| time.as_secs())
        ),
    };
    fs::create_dir_all(&arguments.out)
        .with_context(|| format!("cannot make the folder {}", arguments.out.display()))?;
    let (shows, to_stderr) = (arguments.watch, arguments.takes_its_place());
    Ok(Setup {
        out: arguments.out.clone(),
        run,
        backend,
        profile,
        preset: preset(&arguments.preset)?,
        tasks,
        scenes,
        policy: arguments.policy.clone(),
        mapping,
        rules: Arc::new(rules(arguments)?),
        options: RecordOptions {
            images,
            durability,
            ..RecordOptions::default()
        },
        on_full,
        message_max: arguments.message_limit as usize * (1 << 20),
        idle: Duration::from_secs(arguments.idle.max(1)),
        hosts: arguments.hosts.clone(),
        watch: Box::new(move |seen| {
            if let (Some(exporter), ProxyEvent::Ended { path, .. }) = (&exporter, &seen) {
                exporter.push(path);
            }
            tell(&seen, shows, to_stderr);
        }),
        report: Report::default(),
        endings: PendingTraces::default(),
    })
}

/// What is a secret: the built-in rules and those of the file, and the values that this process itself holds.
fn rules(arguments: &Arguments) -> anyhow::Result<Rules> {
    let rules = match arguments.redact.as_deref() {
        None => Rules::built_in(),
        Some(path) if path == Path::new("none") => Rules::none(),
        Some(path) => {
            let mut text = String::new();
            fs::File::open(path)
                // One byte more than is allowed, so that the error is about the size.
                .and_then(|file| {
                    file.take(RULES_FILE_MAX as u64 + 1)
                        .read_to_string(&mut text)
                })
                .with_context(|| {
                    format!(
                        "cannot read the rules file {}; 'none' switches redaction off",
                        path.display()
                    )
                })?;
            Rules::parse(&text)
                .with_context(|| format!("the rules file {} cannot be taken", path.display()))?
        }
    };
    let variables = env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?)));
    Ok(rules
        .with_environment(variables)
        .with_command(&arguments.command)
        .with_secrets_of(arguments.upstream.as_deref().unwrap_or_default()))
}

fn mapping(path: &Path) -> anyhow::Result<Mapping> {
    let text = fs::read_to_string(path)
        .with_context(|| format!("cannot read the mapping file {}", path.display()))?;
    Mapping::parse(&text)
        .with_context(|| format!("the mapping file {} cannot be taken", path.display()))
}

fn preset(name: &str) -> anyhow::Result<Preset> {
    if let Some(preset) = Preset::parse(name) {
        return Ok(preset);
    }
    let known = || {
        format!(
            "no preset is called '{name}' and there is no such file; built in are paper and real-repo"
        )
    };
    Ok(Preset::from_toml(
        &fs::read_to_string(name).with_context(known)?,
    )?)
}

/// Trouble is always told; the transcript where it is asked for.
fn tell(seen: &ProxyEvent<'_>, shows: bool, to_stderr: bool) {
    let text = match seen {
        ProxyEvent::RecordingFailed {
            session,
            problem: what,
        } => {
            eprintln!("reel: {session}: {what}");
            return;
        }
        ProxyEvent::ImageOmitted { session, why } => {
            eprintln!("reel: {session}: an image is left out: {why}");
            return;
        }
        ProxyEvent::Ended {
            session,
            path,
            open: Some(open),
            ..
        } if !shows => {
            eprintln!("reel: {session}: {}: {open}", path.display());
            return;
        }
        ProxyEvent::Began {
            session,
            task,
            path,
            notes,
        } if shows => {
            let notes: String = notes
                .iter()
                .map(|note| format!("\n     note     {note}"))
                .collect();
            format!(
                "\n{session}  task {}: {}\n     trace    {}{notes}\n",
                task.task_id,
                task.instruction,
                path.display()
            )
        }
        ProxyEvent::Step {
            session,
            record,
            timing,
        } if shows => {
            reel_view::step(record, Some(timing)).replacen('\n', &format!("\n{session}"), 1)
        }
        ProxyEvent::Ended {
            session,
            path,
            end,
            success,
            open,
        } if shows => {
            let verdict = match success {
                Some(true) => "SUCCESS",
                Some(false) => "FAILURE",
                None => "NOT JUDGED",
            };
            let reason = match end.reason {
                EndReason::Finished => "the policy finished",
                _ => "it was not finished",
            };
            let open = open.map(|open| format!("     note     {open}\n"));
            format!(
                "\n{session}  {verdict}: {reason} after {} decisions: {}\n{}",
                end.steps,
                path.display(),
                open.unwrap_or_default()
            )
        }
        _ => return,
    };
    if to_stderr {
        eprint!("{text}");
    } else {
        print!("{text}");
    }
}

fn answer(report: &Report, to_stderr: bool, as_json: bool) -> anyhow::Result<ExitStatus> {
    let counts = report.counts();
    let text = if as_json {
        serde_json::to_string(&counts)?
    } else {
        let odd = [
            (counts.unanswered, "calls without a result"),
            (counts.unrecorded, "UNRECORDED"),
            (counts.refused, "refused"),
            (counts.too_large, "messages over the limit"),
            (counts.strange, "messages not of the protocol"),
            (
                counts.rounded_integers,
                "integers of more than 64 bits, written as the nearest fraction",
            ),
            (counts.opaque_connections, "connections not understood"),
            (counts.images_rejected, "images left out"),
            (counts.open_rewards, "episodes with an open reward"),
            (counts.redacted, "secrets redacted"),
        ];
        let odd: String = odd
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!(", {count} {what}"))
            .collect();
        let reel_proxy::Counts {
            sessions,
            episodes,
            calls,
            session_calls,
            ..
        } = counts;
        format!(
            "{sessions} sessions, {episodes} episodes, {calls} calls and {session_calls} around episodes{odd}"
        )
    };
    if to_stderr {
        eprintln!("reel: {text}");
    } else {
        println!("{text}");
    }
    let lost = counts.unrecorded + counts.refused + counts.too_large + counts.images_rejected;
    let lost = lost + counts.rounded_integers;
    Ok(if lost > 0 {
        ExitStatus::Partial
    } else {
        ExitStatus::Success
    })
}
