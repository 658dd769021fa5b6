//! `reel export otel`: traces as spans of OpenTelemetry, in files or to a collector.

use std::{
    fs,
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use anyhow::Context;
use chrono::DateTime;
use reel_import::otel::{self, ImageParts, LOST, LOST_IMAGES, SpanClock, SpanOptions};
use reel_otlp::{
    Acknowledged, Endpoint, ExportTraceServiceRequest, Sender, encode, json_line, span_count,
};
use reel_trace::trace_stem;
use serde_json::json;

use super::readable::{Traces, lost_fields, tell_lost};
use crate::{ExitStatus, otlp};

/// Traces as spans of OpenTelemetry, by the semantic conventions for generative AI, which collectors, Jaeger,
/// Tempo, Phoenix and Langfuse take: one trace an episode.
///
/// `invoke_agent` is the episode, `chat` a response of the policy with its tokens, `execute_tool` a call with its arguments
/// and result; success, completion and rewards are events `gen_ai.evaluation.result`. `reel.*` has what the conventions have no
/// attribute for (docs/opentelemetry.md). What `reel import otel` cannot give back is printed.
///
/// With --to spans go to a collector over HTTP, again where it is busy or absent for a moment. OTEL_EXPORTER_OTLP_HEADERS and the
/// other variables of the specification hold; --to env takes the address from OTEL_EXPORTER_OTLP_ENDPOINT, too.
///
/// Examples:
///   reel export otel traces --out spans
///   reel export otel traces --to http://localhost:4318 --images blob
///
/// Exit code 0: all exported; 1: a collector did not take all; 2: nothing could be read; 3: some traces could not be read.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Folder for the files, one a trace; made if it is not there
    #[arg(
        long,
        value_name = "DIR",
        default_value = "spans",
        conflicts_with = "to"
    )]
    out: PathBuf,
    /// The encoding of the files: jsonl (OTLP/JSON, as the collector's file exporter writes it) or protobuf
    #[arg(long, value_name = "NAME", default_value = "jsonl", value_parser = ["jsonl", "protobuf"], conflicts_with = "to")]
    format: String,
    /// Collector to send to: http://HOST:4318, https://HOST, or env for OTEL_EXPORTER_OTLP_ENDPOINT
    #[arg(long, value_name = "URL")]
    to: Option<String>,
    /// Leave out all words: messages, arguments, results and the records of Reel
    #[arg(long)]
    no_content: bool,
    /// How spans hold images: reference (by digest) or blob (in base64)
    #[arg(long, value_name = "HOW", default_value = "reference", value_parser = ["reference", "blob"])]
    images: String,
    /// When the episodes begin, in RFC 3339; without it by the clock of the trace, where that has none at the
    /// beginning of 2000, with --to when the trace was written
    #[arg(long, value_name = "TIME", value_parser = time)]
    start: Option<u64>,
    /// Print one JSON object per trace, and one of what is lost
    #[arg(long)]
    json: bool,
}

/// Nanoseconds since 1970 of a time with its zone.
fn time(text: &str) -> Result<u64, String> {
    let wrong = || format!("'{text}' is no time: write it like 2026-11-28T10:00:00Z");
    let time = DateTime::parse_from_rfc3339(text).map_err(|_| wrong())?;
    let ns = time
        .timestamp_nanos_opt()
        .and_then(|ns| u64::try_from(ns).ok());
    ns.ok_or_else(wrong)
}

impl Arguments {
    fn images(&self) -> ImageParts {
        match self.images.as_str() {
            "blob" => ImageParts::Blob,
            _ => ImageParts::Reference,
        }
    }

    fn options(&self, trace: &Path) -> SpanOptions {
        let clock = match (self.start, &self.to) {
            (Some(start), _) => SpanClock::StartsAt(start),
            (None, None) => SpanClock::Recorded,
            // Collectors throw away what is long ago.
            (None, Some(_)) => SpanClock::EndsAt(written(trace)),
        };
        SpanOptions {
            content: !self.no_content,
            images: self.images(),
            clock,
        }
    }

    /// What cannot be imported again, with what becomes of it.
    fn lost(&self) -> Vec<(&'static str, &'static str)> {
        let images = (self.images() == ImageParts::Reference).then_some(LOST_IMAGES);
        LOST.iter().copied().chain(images).collect()
    }
}

/// When a trace was written; now where that is not known.
fn written(trace: &Path) -> u64 {
    let modified = fs::metadata(trace).and_then(|facts| facts.modified()).ok();
    let since = modified.and_then(|time| time.duration_since(UNIX_EPOCH).ok());
    since.map_or_else(otlp::now_ns, |time| {
        u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)
    })
}

/// Where the spans of a command go.
enum Target {
    Files {
        folder: PathBuf,
        extension: &'static str,
    },
    Collector(Sender),
}

impl Target {
    fn of(arguments: &Arguments, traces: &Traces) -> anyhow::Result<Self> {
        if let Some(to) = &arguments.to {
            let address = (to != "env").then_some(to.as_str());
            let endpoint = Endpoint::resolve(address, otlp::variable)?;
            let endpoint = endpoint.context(
                "--to env: no collector is named; set OTEL_EXPORTER_OTLP_ENDPOINT, or give --to http://HOST:4318",
            )?;
            return Ok(Target::Collector(Sender::new(endpoint)));
        }
        traces.expect_distinct_names()?;
        let folder = arguments.out.clone();
        fs::create_dir_all(&folder)
            .with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let extension = match arguments.format.as_str() {
            "protobuf" => "binpb",
            _ => "jsonl",
        };
        Ok(Target::Files { folder, extension })
    }

    /// Writes or sends the spans of a trace; where they are, and what a collector said.
    fn take(
        &self,
        trace: &Path,
        requests: &[ExportTraceServiceRequest],
    ) -> anyhow::Result<(String, Acknowledged)> {
        let mut taken = Acknowledged::default();
        match self {
            Target::Files { folder, extension } => {
                let file = folder.join(format!("{}.{extension}", trace_stem(trace)));
                let mut bytes = Vec::new();
                for request in requests {
                    match *extension {
                        "binpb" => bytes.extend(encode(request)),
                        _ => bytes.extend(json_line(request)?),
                    }
                    taken.accepted += span_count(request);
                }
                fs::write(&file, bytes)
                    .with_context(|| format!("cannot write {}", file.display()))?;
                Ok((file.display().to_string(), taken))
            }
            Target::Collector(sender) => {
                for request in requests {
                    let sleep = |pause| {
                        std::thread::sleep(pause);
                        true
                    };
                    let answer = sender.send(request, sleep)?;
                    taken.accepted += answer.accepted;
                    taken.rejected += answer.rejected;
                    if !answer.message.is_empty() {
                        taken.message = answer.message;
                    }
                }
                Ok((sender.endpoint().url.clone(), taken))
            }
        }
    }
}

/// Writes or sends the spans of each trace.
pub fn execute(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut traces = Traces::find(&arguments.paths)?;
    let target = Target::of(arguments, &traces)?;
    let (mut spans, mut rejected) = (0, 0);
    traces.each(|path, trace, bar| {
        let tools = otlp::tools(&trace);
        let requests = otel::requests(&trace, &tools, &arguments.options(path))?;
        let (place, taken) = target.take(path, &requests)?;
        spans += taken.accepted;
        rejected += taken.rejected;
        if !taken.message.is_empty() {
            // Words of another program, without its control characters.
            let words = taken.message.escape_debug();
            bar.suspend(|| eprintln!("reel: {}: the collector says: {words}", path.display()));
        }
        if arguments.json {
            let told = json!({"trace": path, "to": place, "spans": taken.accepted, "rejected": taken.rejected});
            bar.suspend(|| println!("{told}"));
        }
        Ok(())
    })?;
    tell(arguments, &target, traces.exported(), spans, rejected);
    Ok(match traces.status() {
        status @ ExitStatus::BadInput => status,
        _ if rejected > 0 => ExitStatus::CheckFailed,
        status => status,
    })
}

/// What was written or sent, and what an import of files does not give back.
fn tell(arguments: &Arguments, target: &Target, traces: usize, spans: u64, rejected: u64) {
    let lost = arguments.lost();
    if arguments.json {
        let told = json!({"lost": lost_fields(&lost), "content": !arguments.no_content});
        println!("{told}");
        return;
    }
    let place = match target {
        Target::Files { folder, .. } => folder.display().to_string(),
        Target::Collector(sender) => sender.endpoint().url.clone(),
    };
    let rejected = match rejected {
        0 => String::new(),
        count => format!(", {count} rejected"),
    };
    println!("{traces} episodes, {spans} spans: {place}{rejected}");
    // A collector gets them to be looked at, files to be imported somewhere else.
    if matches!(target, Target::Collector(_)) {
        return;
    }
    if arguments.no_content {
        println!(
            "reel import otel gives back the calls, their errors and tokens: the words are left out"
        );
        return;
    }
    tell_lost("otel", &lost, false);
}
