//! The clients of `make load` (`tests/load.sh`): many sessions open in one server, some or all of
//! them acting at once with the thinking time of a policy. Prints how long each tool took, and what the
//! server needed, as lines of words.
//!
//! They repeat calls that were recorded beforehand by `reel run --policy oracle` over the tasks
//! that the server plays, with its seed and profile, so that every answer is known. When an episode
//! ends, its client goes on in the session that was idle the longest. Exits 1 when an answer is not
//! the recorded one, 2 for wrong arguments.

use std::{
    collections::{BTreeMap, VecDeque},
    error::Error,
    fs,
    path::{Path, PathBuf},
    process::exit,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use reel_trace::Trace;
use reel_world::{HORIZON, Tool, record::StepRecord};
use rmcp::{
    RoleClient, ServiceExt as _,
    model::{
        CallToolRequestParams, CallToolResult, ClientCapabilities, ClientConfig, Implementation,
        JsonObject,
    },
    service::RunningService,
    transport::StreamableHttpClientTransport,
};
use serde_json::{Value, json};
use tokio::{
    io::{AsyncReadExt as _, AsyncWriteExt as _},
    net::TcpStream,
    task::JoinSet,
    time,
};

const USAGE: &str = "usage: load --url http://ADDRESS --pid PID --calls FOLDER [--sessions 1000] [--acting 1000] [--think 5.9] \
                     [--seconds 120] [--levels 200,400] [--level-seconds 30] [--idle]
  --url      a running `reel serve` with one seed, profile paper, over the tasks of the recorded calls
  --pid      its process
  --calls    folder of traces whose calls are made
  --sessions how many sessions are open
  --acting   how many of them act at once
  --think    seconds that a policy thinks before each call, on average
  --seconds  how long they act
  --levels   before that, so many of them act, then so many, and so on: a line for each
  --level-seconds  how long each of these acts
  --idle     the server does nothing: answers are not compared";

/// The longest that a call may take before the server counts as broken.
const CALL_MAX: Duration = Duration::from_secs(120);
/// The longest that the sessions may take to come to rest.
const REST_MAX: Duration = Duration::from_secs(180);
/// How many sessions are being opened at once.
const OPENING: usize = 8;
/// Calls that are made in a session when it is opened, at most.
const FIRST_CALLS: usize = 4;
/// How many wrong answers are shown.
const SHOWN: u64 = 5;
/// And how much of each.
const SHOWN_CHARS: usize = 500;

/// In which /proc counts time.
const TICKS_PER_S: f64 = 100.0;

type Failure = Box<dyn Error + Send + Sync>;

struct Arguments {
    url: String,
    pid: u32,
    calls: PathBuf,
    sessions: usize,
    acting: usize,
    think_s: f64,
    acting_time: Duration,
    levels: Vec<usize>,
    level_time: Duration,
    idle: bool,
}

/// What was recorded of one task.
struct Tape {
    task_id: String,
    /// Which tape the server plays after it; none after the last task.
    next: Option<usize>,
    calls: Vec<Recorded>,
}

struct Recorded {
    tool: &'static str,
    name: String,
    arguments: JsonObject,
    /// What the answer says besides the image: `ok`, `text`, `markers`, `decision`.
    said: Value,
}

/// What all clients share.
struct Load {
    arguments: Arguments,
    tapes: Vec<Tape>,
    /// Milliseconds of each call, by tool.
    took_ms: Mutex<BTreeMap<&'static str, Vec<f64>>>,
    /// Sessions that nobody acts in; the one that is idle the longest is first.
    idle: Mutex<VecDeque<Session>>,
    images: AtomicU64,
    image_bytes: AtomicU64,
    wrong: AtomicU64,
}

struct Session {
    client: RunningService<RoleClient, ClientConfig>,
    tape: usize,
    /// How many of its calls were made; none where its episode was not begun.
    made: Option<usize>,
}

#[tokio::main]
async fn main() {
    let Some(arguments) = Arguments::parse() else {
        eprintln!("{USAGE}");
        exit(2);
    };
    match run(arguments).await {
        // At once: agents that vanish, whose sessions stay open in the server.
        Ok(0) => exit(0),
        Ok(wrong) => {
            eprintln!("load: {wrong} answers were not the recorded ones");
            exit(1);
        }
        Err(error) => {
            eprintln!("load: {error}");
            exit(1);
        }
    }
}

/// How many answers were wrong.
async fn run(arguments: Arguments) -> Result<u64, Failure> {
    let fresh = Usage::of(arguments.pid)?;
    let tapes = tapes(&arguments).await?;
    let count = arguments.sessions;
    println!(
        "sessions {count}\nacting {}\ntasks {}",
        arguments.acting,
        tapes.len()
    );
    let load = Arc::new(Load {
        arguments,
        tapes,
        took_ms: Mutex::default(),
        idle: Mutex::default(),
        images: AtomicU64::new(0),
        image_bytes: AtomicU64::new(0),
        wrong: AtomicU64::new(0),
    });
    let begun = Instant::now();
    load.clone().open_all().await?;
    println!("opened_s {:.1}", begun.elapsed().as_secs_f64());
    load.rest().await?;
    println!("rested_s {:.1}", begun.elapsed().as_secs_f64());
    let parked = Usage::of(load.arguments.pid)?;
    println!(
        "fresh_mb {:.1}\nparked_mb {:.1}",
        fresh.resident_mb, parked.resident_mb
    );
    println!(
        "session_mb {:.2}",
        (parked.resident_mb - fresh.resident_mb) / count as f64
    );

    for acting in load.arguments.levels.clone() {
        load.clone().level(acting).await?;
    }
    // What opening and the levels took is no part of the table.
    lock(&load.took_ms).clear();
    let (idle, own, machine_s, begun) = (
        Usage::of(load.arguments.pid)?,
        Usage::of(std::process::id())?,
        machine_cpu_s()?,
        Instant::now(),
    );
    let (acting, acting_time) = (load.arguments.acting, load.arguments.acting_time);
    load.clone().act_all(acting, acting_time).await?;
    let took_s = begun.elapsed().as_secs_f64();
    let (server, client) = (
        Usage::of(load.arguments.pid)?,
        Usage::of(std::process::id())?,
    );
    println!(
        "acting_mb {:.1}\npeak_mb {:.1}",
        server.resident_mb, server.peak_mb
    );
    let (server_s, client_s) = (server.cpu_s - idle.cpu_s, client.cpu_s - own.cpu_s);
    let others_s = machine_cpu_s()? - machine_s - server_s - client_s;
    for (whose, cpu_s) in [
        ("server", server_s),
        ("client", client_s),
        ("others", others_s),
    ] {
        println!("{whose}_cores {:.2}", cpu_s / took_s);
    }
    let took_ms = std::mem::take(&mut *lock(&load.took_ms));
    let calls: usize = took_ms.values().map(Vec::len).sum();
    println!("calls {calls}\ncalls_per_s {:.1}", calls as f64 / took_s);
    let [p50, p99, _] = quantiles(&mut took_ms.values().flatten().copied().collect::<Vec<_>>());
    println!("p50_ms {p50:.1}\np99_ms {p99:.1}");
    let images = load.images.load(Ordering::Relaxed);
    println!(
        "image_kb {:.1}",
        load.image_bytes.load(Ordering::Relaxed) as f64 / 1e3 / images.max(1) as f64
    );
    for (tool, mut took_ms) in took_ms {
        let [p50, p99, most] = quantiles(&mut took_ms);
        println!("tool {tool} {} {p50:.1} {p99:.1} {most:.1}", took_ms.len());
    }
    Ok(load.wrong.load(Ordering::Relaxed))
}

/// Half of them take at most the first, 99 of 100 the second, all the third.
fn quantiles(took_ms: &mut [f64]) -> [f64; 3] {
    took_ms.sort_by(f64::total_cmp);
    [0.5, 0.99, 1.0].map(|share| {
        let place = (took_ms.len() as f64 * share).ceil() as usize;
        let place = place.clamp(1, took_ms.len().max(1)) - 1;
        took_ms.get(place).copied().unwrap_or_default()
    })
}

impl Load {
    /// Opens every session, and makes some calls in each.
    async fn open_all(self: Arc<Self>) -> Result<(), Failure> {
        let count = self.arguments.sessions;
        let places = Arc::new(tokio::sync::Semaphore::new(OPENING));
        let mut opening = JoinSet::new();
        for number in 0..count {
            let (load, places) = (self.clone(), places.clone());
            opening.spawn(async move {
                let _place = places.acquire_owned().await?;
                let session = load.open(number).await?;
                lock(&load.idle).push_back(session);
                Ok(())
            });
        }
        all(opening).await
    }

    async fn open(&self, number: usize) -> Result<Session, Failure> {
        let transport =
            StreamableHttpClientTransport::from_uri(format!("{}/mcp", self.arguments.url));
        let config = ClientConfig::new(
            ClientCapabilities::default(),
            Implementation::new("oracle", env!("CARGO_PKG_VERSION")),
        );
        let client = time::timeout(CALL_MAX, config.serve(transport)).await??;
        let mut session = Session {
            client,
            tape: number % self.tapes.len(),
            made: None,
        };
        // So many that those who begin with it are not at the same point.
        for _ in 0..=number / self.tapes.len() % FIRST_CALLS {
            self.act(&mut session).await?;
        }
        Ok(session)
    }

    /// Waits until the server has put every session aside.
    async fn rest(&self) -> Result<(), Failure> {
        let begun = Instant::now();
        loop {
            time::sleep(Duration::from_secs(2)).await;
            if self.arguments.idle || parked(&self.arguments.url).await? == self.arguments.sessions
            {
                return Ok(());
            }
            if begun.elapsed() > REST_MAX {
                return Err(
                    format!("after {} s not every session is parked", REST_MAX.as_secs()).into(),
                );
            }
        }
    }

    /// Lets so many act for a while: calls a second, milliseconds of a call (half, 99 in 100), cores
    /// that the server and the clients kept busy.
    async fn level(self: Arc<Self>, acting: usize) -> Result<(), Failure> {
        lock(&self.took_ms).clear();
        let usage = || -> Result<[f64; 2], Failure> {
            Ok([
                Usage::of(self.arguments.pid)?.cpu_s,
                Usage::of(std::process::id())?.cpu_s,
            ])
        };
        let (before, begun) = (usage()?, Instant::now());
        let time = self.arguments.level_time;
        self.clone().act_all(acting, time).await?;
        let (after, took_s) = (usage()?, begun.elapsed().as_secs_f64());
        let mut took_ms: Vec<f64> = lock(&self.took_ms).values().flatten().copied().collect();
        let [p50, p99, _] = quantiles(&mut took_ms);
        println!(
            "level {acting} {:.1} {p50:.1} {p99:.1} {:.2} {:.2}",
            took_ms.len() as f64 / took_s,
            (after[0] - before[0]) / took_s,
            (after[1] - before[1]) / took_s,
        );
        Ok(())
    }

    async fn act_all(self: Arc<Self>, count: usize, time: Duration) -> Result<(), Failure> {
        let deadline = time::Instant::now() + time;
        let mut acting = JoinSet::new();
        for number in 0..count {
            acting.spawn(self.clone().act_until(deadline, number as u64));
        }
        all(acting).await
    }

    /// One client: thinks, calls, and goes to another session when the episode is over.
    async fn act_until(self: Arc<Self>, deadline: time::Instant, seed: u64) -> Result<(), Failure> {
        let mut random = Random(seed);
        // Nobody begins at the same time.
        let mut think_s = self.arguments.think_s * random.unit();
        loop {
            let mut session = lock(&self.idle)
                .pop_front()
                .ok_or("there are fewer sessions than clients")?;
            loop {
                let next = time::Instant::now() + Duration::from_secs_f64(think_s);
                if next > deadline {
                    lock(&self.idle).push_back(session);
                    return Ok(());
                }
                time::sleep_until(next).await;
                think_s = self.arguments.think_s * (0.5 + random.unit());
                if self.act(&mut session).await? {
                    break;
                }
            }
            lock(&self.idle).push_back(session);
        }
    }

    /// Makes the next call of a session; whether its episode is over.
    async fn act(&self, session: &mut Session) -> Result<bool, Failure> {
        let tape = &self.tapes[session.tape];
        let Some(made) = session.made else {
            let arguments = [("task_id".to_owned(), json!(tape.task_id))]
                .into_iter()
                .collect();
            let result = self
                .call(session, "finish_with_id", "finish_with_id", arguments)
                .await?;
            self.compare(&result, &json!({"ok": true, "decisions_left": HORIZON, "episode": {"task_id": tape.task_id}}));
            session.made = Some(0);
            return Ok(false);
        };
        let recorded = &tape.calls[made];
        let result = self
            .call(
                session,
                recorded.tool,
                &recorded.name,
                recorded.arguments.clone(),
            )
            .await?;
        if made + 1 < tape.calls.len() {
            self.compare(&result, &recorded.said);
            session.made = Some(made + 1);
            return Ok(false);
        }
        // The answer to `finish` is the next task.
        session.made = tape.next.map(|_| 0);
        session.tape = tape.next.unwrap_or(0);
        let next = &self.tapes[session.tape];
        self.compare(
            &result,
            &match session.made {
                Some(_) => json!({"ok": true, "episode": {"task_id": next.task_id}}),
                None => json!({"ok": true, "text": "All evaluation episodes completed."}),
            },
        );
        Ok(true)
    }

    async fn call(
        &self,
        session: &Session,
        tool: &'static str,
        name: &str,
        arguments: JsonObject,
    ) -> Result<CallToolResult, Failure> {
        let request = CallToolRequestParams::new(name.to_owned()).with_arguments(arguments);
        let begun = Instant::now();
        let result = time::timeout(CALL_MAX, session.client.call_tool(request)).await;
        let took = begun.elapsed();
        let result =
            result.map_err(|_| format!("{tool} was not answered in {} s", CALL_MAX.as_secs()))?;
        let result = result.map_err(|error| format!("{tool} failed: {error}"))?;
        lock(&self.took_ms)
            .entry(tool)
            .or_default()
            .push(took.as_secs_f64() * 1e3);
        for image in result.content.iter().filter_map(|block| block.as_image()) {
            self.images.fetch_add(1, Ordering::Relaxed);
            self.image_bytes
                .fetch_add(image.data.len() as u64 * 3 / 4, Ordering::Relaxed);
        }
        Ok(result)
    }

    /// Whether an answer says at least this.
    fn compare(&self, result: &CallToolResult, expected: &Value) {
        if self.arguments.idle {
            return;
        }
        let found = result.structured_content.clone().unwrap_or_default();
        if !says(&found, expected) && self.wrong.fetch_add(1, Ordering::Relaxed) < SHOWN {
            let found: String = found.to_string().chars().take(SHOWN_CHARS).collect();
            eprintln!(
                "load: the answer was not the recorded one\n  expected {expected}\n  found    {found}"
            );
        }
    }
}

/// Whether `found` has every field of `expected`.
fn says(found: &Value, expected: &Value) -> bool {
    match (found, expected) {
        (Value::Object(found), Value::Object(expected)) => expected
            .iter()
            .all(|(key, value)| found.get(key).is_some_and(|found| says(found, value))),
        _ => found == expected,
    }
}

/// The tapes in the order in which the server plays them.
async fn tapes(arguments: &Arguments) -> Result<Vec<Tape>, Failure> {
    let mut by_task = BTreeMap::new();
    for entry in fs::read_dir(&arguments.calls)? {
        let path = entry?.path();
        if path
            .extension()
            .is_some_and(|extension| extension == "mcap")
        {
            let trace = Trace::read(&path)?;
            by_task.insert(trace.task.task_id.clone(), calls(&trace)?);
        }
    }
    let order: Vec<String> = if arguments.idle {
        by_task.keys().cloned().collect()
    } else {
        served(&arguments.url).await?
    };
    let count = order.len();
    let tape = |(index, task_id): (usize, String)| {
        let calls = by_task
            .remove(&task_id)
            .ok_or_else(|| format!("no trace has the calls of task {task_id}"))?;
        Ok(Tape {
            task_id,
            calls,
            next: (index + 1 < count).then_some(index + 1),
        })
    };
    let tapes = order
        .into_iter()
        .enumerate()
        .map(tape)
        .collect::<Result<Vec<_>, Failure>>()?;
    if tapes.is_empty() {
        Err("there are no recorded calls".into())
    } else {
        Ok(tapes)
    }
}

fn calls(trace: &Trace) -> Result<Vec<Recorded>, Failure> {
    let recorded = |step: &StepRecord| {
        let call = &step.input.call;
        let mut markers: Vec<u32> = step.markers.iter().map(|marker| marker.id).collect();
        markers.sort_unstable();
        let (ok, text, decision) = (step.outcome.is_ok(), &step.outcome.text, step.step + 1);
        Some(Recorded {
            tool: Tool::parse(call).ok()?.paper_name(),
            name: call.name.clone(),
            arguments: call.arguments.as_object().cloned().unwrap_or_default(),
            said: json!({"ok": ok, "text": text, "markers": markers, "decision": decision}),
        })
    };
    let calls: Option<Vec<Recorded>> = trace.steps.iter().map(recorded).collect();
    calls
        .filter(|calls| calls.last().is_some_and(|call| call.tool == "finish"))
        .ok_or_else(|| {
            refused(
                &trace.path,
                "its calls do not end with 'finish', or one is no call",
            )
            .into()
        })
}

fn refused(path: &Path, why: &str) -> String {
    format!("cannot repeat {}: {why}", path.display())
}

/// The ids of the tasks that the server plays.
async fn served(url: &str) -> Result<Vec<String>, Failure> {
    let client = ()
        .serve(StreamableHttpClientTransport::from_uri(format!(
            "{url}/mcp"
        )))
        .await?;
    let result = client
        .call_tool(CallToolRequestParams::new("list_tasks"))
        .await?;
    client.cancel().await?;
    let said = result.structured_content.unwrap_or_default();
    Ok(serde_json::from_str(
        said["text"]
            .as_str()
            .ok_or("the server does not list its tasks")?,
    )?)
}

/// How many sessions the server has put aside.
async fn parked(url: &str) -> Result<usize, Failure> {
    let address = url
        .strip_prefix("http://")
        .ok_or("the url does not begin with http://")?;
    let mut stream = TcpStream::connect(address).await?;
    let request = format!("GET /metrics HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut text = String::new();
    stream.read_to_string(&mut text).await?;
    let line = text
        .lines()
        .find_map(|line| line.strip_prefix(r#"reel_sessions{state="suspended"} "#));
    Ok(line
        .ok_or("the server does not say how many sessions are parked")?
        .trim()
        .parse()?)
}

/// What a process took so far.
struct Usage {
    resident_mb: f64,
    peak_mb: f64,
    cpu_s: f64,
}

impl Usage {
    fn of(pid: u32) -> Result<Self, Failure> {
        let status = fs::read_to_string(format!("/proc/{pid}/status"))?;
        let megabytes = |key: &str| {
            let line = status
                .lines()
                .find_map(|line| line.strip_prefix(key))
                .ok_or("/proc says nothing of memory")?;
            let kib: f64 = line
                .trim_start_matches(':')
                .trim()
                .trim_end_matches("kB")
                .trim()
                .parse()?;
            Ok::<f64, Failure>(kib * 1024.0 / 1e6)
        };
        let stat = fs::read_to_string(format!("/proc/{pid}/stat"))?;
        // After the name, which may hold anything, come state and numbers; the 12th
        // and 13th are ticks.
        let (_, numbers) = stat.rsplit_once(')').ok_or("/proc says nothing of time")?;
        let ticks = numbers
            .split_whitespace()
            .skip(11)
            .take(2)
            .map(str::parse::<f64>)
            .sum::<Result<f64, _>>()?;
        Ok(Self {
            resident_mb: megabytes("VmRSS")?,
            peak_mb: megabytes("VmHWM")?,
            cpu_s: ticks / TICKS_PER_S,
        })
    }
}

/// What all processes of the machine took so far, and other machines on its processor.
fn machine_cpu_s() -> Result<f64, Failure> {
    let stat = fs::read_to_string("/proc/stat")?;
    // User, nice, system, idle, waiting for disks, two kinds of interrupts, stolen; then what is in
    // the first two already.
    let ticks = stat
        .split_whitespace()
        .skip(1)
        .take(8)
        .map(str::parse::<f64>)
        .collect::<Result<Vec<_>, _>>()?;
    let idle: f64 = ticks.iter().skip(3).take(2).sum();
    Ok((ticks.iter().sum::<f64>() - idle) / TICKS_PER_S)
}

/// SplitMix64 pseudorandom number generator, with its state.
struct Random(u64);

impl Random {
    /// From 0 to 1.
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }
}

impl Arguments {
    fn parse() -> Option<Self> {
        let mut values = BTreeMap::new();
        let mut arguments = std::env::args().skip(1);
        while let Some(argument) = arguments.next() {
            let name = argument.strip_prefix("--")?.to_owned();
            let value = if name == "idle" {
                String::new()
            } else {
                arguments.next()?
            };
            values.insert(name, value);
        }
        let mut take = |name: &str, otherwise: Option<&str>| {
            values.remove(name).or(otherwise.map(str::to_owned))
        };
        let parsed = Self {
            url: take("url", None)?.trim_end_matches('/').to_owned(),
            pid: take("pid", None)?.parse().ok()?,
            calls: take("calls", None)?.into(),
            sessions: take("sessions", Some("1000"))?.parse().ok()?,
            acting: take("acting", Some("1000"))?.parse().ok()?,
            think_s: take("think", Some("5.9"))?
                .parse()
                .ok()
                .filter(|seconds| (0.0..=3_600.0).contains(seconds))?,
            acting_time: Duration::from_secs(take("seconds", Some("120"))?.parse().ok()?),
            levels: take("levels", Some(""))?
                .split_terminator(',')
                .map(|level| level.parse().ok())
                .collect::<Option<_>>()?,
            level_time: Duration::from_secs(take("level-seconds", Some("30"))?.parse().ok()?),
            idle: take("idle", None).is_some(),
        };
        let most = parsed.levels.iter().chain([&parsed.acting]).max()?;
        (values.is_empty() && *most <= parsed.sessions).then_some(parsed)
    }
}

/// Waits for all of them, or for the first that fails.
async fn all(mut tasks: JoinSet<Result<(), Failure>>) -> Result<(), Failure> {
    while let Some(done) = tasks.join_next().await {
        done??;
    }
    Ok(())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
