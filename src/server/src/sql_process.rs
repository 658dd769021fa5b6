//! Questions in SQL, each in a process that nobody else depends on: what no limit foresees (memory
//! that cannot be had, a plan that never comes to an end) ends that process, and not the server.
//! Both ends are here: what the server does with such processes, and what one of them does.
//!
//! A request is a line of JSON on standard input. An answer is frames on standard output: a letter,
//! the length of what follows (four bytes, the highest first), and that.

use std::{
    ffi::OsString,
    io::{self, BufRead as _, BufReader, BufWriter, Read as _, Write},
    path::{Path, PathBuf},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        mpsc::{self, RecvTimeoutError},
    },
    thread,
    time::{Duration, Instant},
};

use arrow::{array::RecordBatch, error::ArrowError, ipc::writer::StreamWriter};
use axum::body::Bytes;
use reel_query::{
    CacheScope, Format, Limits, Parameters, ParquetStream, QueryError, QuerySession, StopReason,
    format,
};
use reel_tables::{BLOCKING_THREADS, STACK_BYTES};
use reel_trace::TraceFiles;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::{
    rest::{ApiError, OVER_LIMIT, SentError},
    store::Tables,
};

/// How much later than its limit on time a question is ended from outside: planning looks at the
/// limit now and then only.
const LATE: Duration = Duration::from_secs(5);
/// How often it is looked whether a question still has somebody who waits for it.
const LOOK_EVERY: Duration = Duration::from_millis(100);
/// How soon an end says that a process was ending before it was asked.
const AT_ONCE: Duration = Duration::from_millis(100);
/// How long a process without a question is kept.
const IDLE: Duration = Duration::from_secs(60);
/// Data that a process may have besides what its question may take, and the stacks of its threads.
const BESIDES_BYTES: u64 = 1 << 30;

/// Largest part of an answer: the server holds a few of each.
const PART_BYTES: usize = 1 << 20;
/// Largest frame: an error may quote the question.
const FRAME_BYTES_MAX: usize = 16 << 20;

/// The next part of an answer follows.
const PART: u8 = b'P';
/// The answer is whole; a [`Whole`] follows.
const WHOLE: u8 = b'W';
/// There is no answer, or no more of it; a [`SentError`] follows.
const FAILED: u8 = b'F';

/// How an answer looks.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub(crate) enum AnswerFormat {
    /// A list of objects.
    #[default]
    Json,
    /// Comma-separated, with a header line.
    Csv,
    /// An Arrow IPC stream.
    Arrow,
    /// A Parquet file, compressed by zstd.
    Parquet,
}

/// What a process is asked.
#[derive(Serialize, Deserialize)]
pub(crate) struct SqlRequest {
    pub store: String,
    /// The tables as they were at this version.
    pub at: Option<u64>,
    pub sql: String,
    pub parameters: Parameters,
    pub format: AnswerFormat,
    pub limits: SentLimits,
}

/// [`Limits`], as they are sent.
#[derive(Clone, Copy, Serialize, Deserialize)]
pub(crate) struct SentLimits {
    memory_bytes: usize,
    time_ms: u64,
    rows: usize,
}

impl From<Limits> for SentLimits {
    fn from(limits: Limits) -> Self {
        Self {
            memory_bytes: limits.memory_bytes,
            time_ms: limits.time.as_millis() as u64,
            rows: limits.rows,
        }
    }
}

impl From<SentLimits> for Limits {
    fn from(limits: SentLimits) -> Self {
        Self {
            memory_bytes: limits.memory_bytes,
            time: Duration::from_millis(limits.time_ms),
            rows: limits.rows,
        }
    }
}

/// What comes after the last part of an answer.
#[derive(Serialize, Deserialize)]
struct Whole {
    /// Whether it holds as long as nobody writes.
    lasting: bool,
    /// Whether the process has kept so much memory that it had better end.
    worn: bool,
}

/// The processes that answer questions: those that have none at the moment wait for the next.
pub(crate) struct SqlProcesses {
    program: OsString,
    /// Folder of meshes for functions that execute traces.
    assets: Option<PathBuf>,
    idle: Mutex<Vec<(Instant, SqlProcess)>>,
}

impl SqlProcesses {
    /// None yet. `program` is `reel`.
    pub fn new(program: OsString, assets: Option<PathBuf>) -> Self {
        Self {
            program,
            assets,
            idle: Mutex::default(),
        }
    }

    /// Asks; `take` gets the parts of the answer until it wants no more. Where `gone` says that
    /// nobody waits any more, the question ends. Whether the answer holds as long as nobody writes.
    pub fn ask(
        &self,
        request: &SqlRequest,
        gone: impl Fn() -> bool + Clone + Send + 'static,
        mut take: impl FnMut(Bytes) -> bool,
    ) -> Result<bool, ApiError> {
        let mut line = serde_json::to_vec(request).expect("a question is JSON");
        line.push(b'\n');
        let (mut process, reused) = self.asked(&line)?;
        let asked = Instant::now();
        let time = Duration::from_millis(request.limits.time_ms);
        let watch = Watch::begin(process.child.clone(), time + LATE, gone.clone());
        loop {
            let (kind, body) = match process.frame() {
                Ok(frame) => frame,
                Err(_) if watch.ended_it() => {
                    let seconds = time.as_secs();
                    return Err(QueryError::Stopped(StopReason::Time { seconds }).into());
                }
                // It was ending already when it was asked.
                Err(_) if reused && asked.elapsed() < AT_ONCE => {
                    drop(watch);
                    drop(process);
                    return self.ask(request, gone, take);
                }
                Err(error) => {
                    let status = process.ended();
                    tracing::warn!(%error, ?status, "a question ended its process");
                    return Err(ApiError::unprocessable(
                        OVER_LIMIT,
                        "the question ended its process, most likely because it wanted more memory than \
                         it may have (limits.sql_mib); narrow it down"
                            .to_owned(),
                    ));
                }
            };
            match kind {
                PART => {
                    if !take(body.into()) {
                        return Ok(false);
                    }
                }
                FAILED => {
                    let error = ApiError::from(read::<SentError>(&body)?);
                    // What was stopped may go on for a while, for nobody.
                    if !error.is_over_limit() {
                        self.keep(process, watch);
                    }
                    return Err(error);
                }
                _ => {
                    let whole: Whole = read(&body)?;
                    if !whole.worn {
                        self.keep(process, watch);
                    }
                    return Ok(whole.lasting);
                }
            }
        }
    }

    /// A process that has the request, and whether it had one before. One that died while it was
    /// idle has none, so a new one gets it.
    fn asked(&self, line: &[u8]) -> Result<(SqlProcess, bool), ApiError> {
        loop {
            let next = self.lock().pop();
            let Some((_, mut process)) = next else { break };
            if process.input.write_all(line).is_ok() {
                return Ok((process, true));
            }
        }
        let mut process =
            SqlProcess::start(&self.program, self.assets.as_deref()).map_err(ApiError::disk)?;
        process.input.write_all(line).map_err(ApiError::disk)?;
        Ok((process, false))
    }

    /// Keeps a process for the next question, unless somebody just ended it.
    fn keep(&self, process: SqlProcess, watch: Watch) {
        if watch.close() {
            self.lock().push((Instant::now(), process));
        }
    }

    /// Ends those that have had no question for a while.
    pub fn tidy(&self) {
        self.lock().retain(|(since, _)| since.elapsed() < IDLE);
    }

    fn lock(&self) -> MutexGuard<'_, Vec<(Instant, SqlProcess)>> {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn read<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Result<T, ApiError> {
    serde_json::from_slice(body)
        .map_err(|_| ApiError::internal("a process for SQL is of another version of Reel"))
}

/// A process for questions, which ends when this is dropped.
struct SqlProcess {
    child: Arc<Mutex<Child>>,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
}

impl SqlProcess {
    fn start(program: &OsString, assets: Option<&Path>) -> io::Result<Self> {
        let mut child = Command::new(program)
            .args(["server", "sql-process"])
            .envs(assets.map(|assets| ("REEL_ASSETS", assets)))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()?;
        let input = child.stdin.take().expect("it is piped");
        let output = BufReader::new(child.stdout.take().expect("it is piped"));
        Ok(Self {
            child: Arc::new(Mutex::new(child)),
            input,
            output,
        })
    }

    fn frame(&mut self) -> io::Result<(u8, Vec<u8>)> {
        let mut head = [0; 5];
        self.output.read_exact(&mut head)?;
        let [kind, length @ ..] = head;
        let length = u32::from_be_bytes(length) as usize;
        if length > FRAME_BYTES_MAX {
            return Err(io::Error::other("it is of another version of Reel"));
        }
        let mut body = vec![0; length];
        self.output.read_exact(&mut body)?;
        Ok((kind, body))
    }

    /// How it ended, once it has.
    fn ended(&self) -> Option<std::process::ExitStatus> {
        lock(&self.child).wait().ok()
    }
}

impl Drop for SqlProcess {
    fn drop(&mut self) {
        let mut child = lock(&self.child);
        let _ = child.kill();
        let _ = child.wait();
    }
}

fn lock(child: &Mutex<Child>) -> MutexGuard<'_, Child> {
    child.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Ends a process when its question takes too long or nobody waits for it, until this is dropped.
struct Watch {
    over: mpsc::Sender<()>,
    ended: Arc<Mutex<bool>>,
}

impl Watch {
    fn begin(
        child: Arc<Mutex<Child>>,
        patience: Duration,
        gone: impl Fn() -> bool + Send + 'static,
    ) -> Self {
        let (over, is_over) = mpsc::channel();
        let ended = Arc::new(Mutex::new(false));
        let (ends, begun) = (ended.clone(), Instant::now());
        thread::spawn(move || {
            while is_over.recv_timeout(LOOK_EVERY) == Err(RecvTimeoutError::Timeout) {
                if begun.elapsed() > patience || gone() {
                    let mut ended = ends.lock().unwrap_or_else(PoisonError::into_inner);
                    // The question may have ended meanwhile, and its process may have the next one.
                    if is_over.try_recv() == Err(mpsc::TryRecvError::Empty) {
                        *ended = true;
                        let _ = lock(&child).kill();
                    }
                    return;
                }
            }
        });
        Self { over, ended }
    }

    /// Watches no longer; whether the process was left alone.
    fn close(self) -> bool {
        let Self { over, ended } = self;
        let ended = ended.lock().unwrap_or_else(PoisonError::into_inner);
        drop(over);
        !*ended
    }

    fn ended_it(&self) -> bool {
        *self.ended.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Answers the questions that come over standard input, until it closes: what a process for SQL
/// does. Functions that read traces read them from `trace_files`.
///
/// # Errors
/// When what comes is no request, or nobody takes the answers.
pub fn answer_sql(trace_files: TraceFiles) -> io::Result<()> {
    let mut output = BufWriter::new(io::stdout().lock());
    let mut tables: Option<(String, Tables)> = None;
    let before = resident_bytes();
    let (sender, requests) = mpsc::channel();
    thread::spawn(move || {
        for line in io::stdin().lock().lines().map_while(Result::ok) {
            let _ = sender.send(line);
        }
        // The server is gone, and whatever is being computed is for nobody.
        std::process::exit(0);
    });
    for line in requests {
        let request: SqlRequest = serde_json::from_str(&line)?;
        let tables = match &mut tables {
            Some((store, tables)) if *store == request.store => tables,
            other => {
                let new = Tables::new(request.store.clone(), trace_files.clone());
                &mut other.insert((request.store.clone(), new)).1
            }
        };
        limit_data(&request.limits);
        match answer(tables, &request, &mut output) {
            Ok(lasting) => {
                let kept = resident_bytes().saturating_sub(before);
                let worn = kept > request.limits.memory_bytes as u64;
                send(
                    &mut output,
                    WHOLE,
                    &serde_json::to_vec(&Whole { lasting, worn })?,
                )?;
            }
            Err(error) => {
                let error = SentError::from(ApiError::from(error));
                send(&mut output, FAILED, &serde_json::to_vec(&error)?)?;
            }
        }
    }
    Ok(())
}

fn answer(
    tables: &Tables,
    request: &SqlRequest,
    output: &mut impl Write,
) -> Result<bool, QueryError> {
    let store = match request.at {
        None => tables.newest()?.store,
        Some(version) => tables.at(version)?,
    };
    let session = QuerySession::with_limits(store, request.limits.into())?;
    let mut encoder = Encoder::new(request.format);
    let mut failure = None;
    let mut part = |part: Result<Bytes, ArrowError>| match part {
        // Where nobody reads any more, the question ends.
        Ok(part) => part
            .chunks(PART_BYTES)
            .all(|piece| send(output, PART, piece).is_ok()),
        Err(error) => {
            failure = Some(error);
            false
        }
    };
    let mut reading = true;
    let scope = session.run_each(&request.sql, &request.parameters, |batch| {
        reading = part(encoder.encode(&batch));
        reading
    })?;
    let whole = reading && part(encoder.end());
    match failure {
        Some(error) => Err(error.into()),
        None => Ok(whole && scope == CacheScope::StoreVersion),
    }
}

fn send(output: &mut impl Write, kind: u8, body: &[u8]) -> io::Result<()> {
    output.write_all(&[kind])?;
    output.write_all(&(body.len() as u32).to_be_bytes())?;
    output.write_all(body)?;
    output.flush()
}

/// Lets the system refuse this process more data than a question may take, four times over as the
/// session allows it, beside what it has: no question can take the memory of the machine.
fn limit_data(limits: &SentLimits) {
    let threads = 2 * thread::available_parallelism().map_or(1, usize::from) + BLOCKING_THREADS;
    let stacks = (threads * STACK_BYTES) as u64;
    let question = 4 * limits.memory_bytes as u64;
    let most = status_bytes("VmData:") + question + stacks + BESIDES_BYTES;
    if let Ok((_, hard)) = rlimit::Resource::DATA.get() {
        let _ = rlimit::Resource::DATA.set(most.min(hard), hard);
    }
}

fn resident_bytes() -> u64 {
    status_bytes("VmRSS:")
}

/// What the system says of this process; 0 where it does not.
fn status_bytes(what: &str) -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix(what));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) << 10
}

/// Batches as the parts of one answer.
enum Encoder {
    Json { begun: bool },
    Csv { begun: bool },
    Arrow(Option<Box<StreamWriter<Vec<u8>>>>),
    Parquet(Option<Box<ParquetStream>>),
}

impl Encoder {
    fn new(format: AnswerFormat) -> Self {
        match format {
            AnswerFormat::Json => Encoder::Json { begun: false },
            AnswerFormat::Csv => Encoder::Csv { begun: false },
            AnswerFormat::Arrow => Encoder::Arrow(None),
            AnswerFormat::Parquet => Encoder::Parquet(None),
        }
    }

    fn encode(&mut self, batch: &RecordBatch) -> Result<Bytes, ArrowError> {
        let one = std::slice::from_ref(batch);
        match self {
            Encoder::Json { begun } => {
                let list = format(one, Format::Json)?;
                let list = list.trim();
                let rows = list
                    .strip_prefix('[')
                    .and_then(|list| list.strip_suffix(']'))
                    .unwrap_or(list);
                if rows.is_empty() {
                    return Ok(Bytes::new());
                }
                let before = if std::mem::replace(begun, true) {
                    ","
                } else {
                    "["
                };
                Ok(format!("{before}{rows}").into())
            }
            Encoder::Csv { begun } => {
                let text = format(one, Format::Csv)?;
                if !std::mem::replace(begun, true) {
                    return Ok(text.into());
                }
                let header = format(&[RecordBatch::new_empty(batch.schema())], Format::Csv)?;
                Ok(text
                    .strip_prefix(header.as_str())
                    .unwrap_or(&text)
                    .to_owned()
                    .into())
            }
            Encoder::Arrow(writer) => {
                let writer = match writer {
                    Some(writer) => writer,
                    None => writer.insert(Box::new(StreamWriter::try_new(
                        Vec::new(),
                        &batch.schema(),
                    )?)),
                };
                writer.write(batch)?;
                Ok(std::mem::take(writer.get_mut()).into())
            }
            Encoder::Parquet(stream) => {
                let stream = match stream {
                    Some(stream) => stream,
                    None => stream.insert(Box::new(ParquetStream::new(batch.schema())?)),
                };
                Ok(stream.write(batch)?.into())
            }
        }
    }

    /// What comes after the last batch.
    fn end(self) -> Result<Bytes, ArrowError> {
        match self {
            Encoder::Json { begun } => Ok(if begun { "]" } else { "[]" }.into()),
            Encoder::Csv { .. } | Encoder::Arrow(None) | Encoder::Parquet(None) => Ok(Bytes::new()),
            Encoder::Parquet(Some(stream)) => Ok(stream.end()?.into()),
            Encoder::Arrow(Some(mut writer)) => {
                writer.finish()?;
                Ok(std::mem::take(writer.get_mut()).into())
            }
        }
    }
}
