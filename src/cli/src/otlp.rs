//! Finished traces on their way to a collector of OpenTelemetry, while further episodes are recorded
//! (`serve`, `bench`, `record`). One function makes the spans of all three; the thread that sends them costs an
//! episode nothing.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use reel_import::otel::{self, SpanClock, SpanOptions};
use reel_otlp::{Endpoint, ExportTraceServiceRequest, Queue, Sender};
use reel_trace::{Trace, TraceFiles};
use reel_world::record::Backend;
use serde_json::Value;

/// Most traces that wait for a collector; further ones are not sent.
const WAITING_MAX: usize = 1_000;
/// How long the end of a command waits for a collector.
const PATIENCE: Duration = Duration::from_secs(15);
/// The variable by which instrumentations for generative AI are told to send words.
const CAPTURE_CONTENT: &str = "OTEL_INSTRUMENTATION_GENAI_CAPTURE_MESSAGE_CONTENT";

/// Whether and where finished episodes go as spans.
#[derive(clap::Args)]
pub struct OtlpArguments {
    /// Send each episode as spans to this collector of OpenTelemetry when it ends; without it to
    /// OTEL_EXPORTER_OTLP_ENDPOINT, if that is set
    #[arg(long = "otlp", value_name = "URL")]
    collector: Option<String>,
    /// Send the words, too: messages, arguments, results, the records of Reel
    /// (OTEL_INSTRUMENTATION_GENAI_CAPTURE_MESSAGE_CONTENT=true)
    #[arg(long = "otlp-content")]
    content: bool,
}

impl OtlpArguments {
    /// What sends finished traces; `None` if no collector is named.
    ///
    /// # Errors
    /// When the address or a variable of the specification cannot be used.
    pub fn exporter(&self) -> anyhow::Result<Option<TraceExporter>> {
        let Some(endpoint) = Endpoint::resolve(self.collector.as_deref(), variable)? else {
            return Ok(None);
        };
        let captures = variable(CAPTURE_CONTENT).is_some_and(|it| it.eq_ignore_ascii_case("true"));
        let content = self.content || captures;
        let spans = move |(path, ended_ns): (PathBuf, u64)| spans(&path, ended_ns, content);
        let queue = Queue::start(Sender::new(endpoint), WAITING_MAX, spans);
        Ok(Some(TraceExporter(Arc::new(queue))))
    }
}

/// The spans of a finished trace.
fn spans(
    path: &Path,
    ended_ns: u64,
    content: bool,
) -> Result<Vec<ExportTraceServiceRequest>, String> {
    let trace = TraceFiles::default()
        .read(path)
        .map_err(|error| error.to_string())?;
    let options = SpanOptions {
        content,
        clock: SpanClock::EndsAt(ended_ns),
        ..SpanOptions::default()
    };
    otel::requests(&trace, &tools(&trace), &options).map_err(|error| error.to_string())
}

/// Sends finished traces in the background.
#[derive(Clone)]
pub struct TraceExporter(Arc<Queue<(PathBuf, u64)>>);

impl TraceExporter {
    /// Takes a trace that is finished, without waiting.
    pub fn push(&self, trace: &Path) {
        self.0.push((trace.to_owned(), now_ns()));
    }

    /// Waits until all is sent, for a while, and says what became of it on standard error.
    pub fn finish(self) {
        let delivery = self.0.finish(PATIENCE);
        // Words of a collector stand in it, without their control characters.
        let told = delivery.to_string();
        let told: String = told.chars().filter(|letter| !letter.is_control()).collect();
        eprintln!("reel: OpenTelemetry: {told}");
    }
}

/// The time now, in nanoseconds since 1970.
pub fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH);
    since.map_or(0, |time| u64::try_from(time.as_nanos()).unwrap_or(u64::MAX))
}

/// A variable of the environment, if it is a text.
pub fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok()
}

/// The tools that the policy of a trace could call, in OpenAI's schema.
pub fn tools(trace: &Trace) -> Vec<Value> {
    let header = &trace.header;
    let tools = match header.backend {
        Backend::Sim => Some(reel_prompt::functions(header.profile.names())),
        Backend::Robot | Backend::Proxy | Backend::Imported => {
            header.policy.parameters.get("tools").cloned()
        }
    };
    let tools = tools.as_ref().and_then(Value::as_array);
    tools.cloned().unwrap_or_default()
}
