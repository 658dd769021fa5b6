//! `reel agent mock-llm`: a stand-in for a model.

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use reel_llm::agent::script::{InjectedError, Script};
use reel_server::{MockOptions, mock_llm};

use crate::{ExitStatus, inputs};

/// Stand in for a model: serve the decisions of recorded episodes on the protocol of
/// OpenAI-compatible endpoints (chat completions with and without functions, embeddings), until
/// Ctrl-C. For tests and demos, and to try an installation before there is a model. The server has
/// no state: it reads from the prompt where a conversation stands.
///
/// Examples:
///   reel run --tasks tasks --policy oracle --out traces
///   reel agent mock-llm traces --listen 127.0.0.1:8000
///   reel bench --tasks tasks --agent real-agent --endpoint http://127.0.0.1:8000/v1 --model mock
///   reel agent mock-llm traces --inject gibberish@2 --inject rate-limit@4 --inject stall@5 --stall 60
///
/// Failures at a call (from 0) of every episode: gibberish, truncated, two-calls, unknown-tool; once
/// a request: rate-limit, error, stall, cut.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Traces or folders of them
    #[arg(required = true, value_name = "TRACE")]
    traces: Vec<PathBuf>,
    /// Address and port that the mock endpoint listens on
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8000")]
    listen: SocketAddr,
    /// Failure to inject, and the call; may be repeated
    #[arg(long = "inject", alias = "trouble", value_name = "KIND@CALL", value_parser = InjectedError::parse)]
    trouble: Vec<(InjectedError, usize)>,
    /// Latency of every answer, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 0)]
    delay: u64,
    /// Latency of an answer that stalls, in seconds
    #[arg(long, value_name = "S", default_value_t = 60)]
    stall: u64,
    /// Value of Retry-After where calls are limited, in seconds
    #[arg(long, value_name = "S", default_value_t = 1)]
    retry_after: u64,
}

/// Serves the decisions of recorded episodes as a mock model until stopped.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = inputs::trace_files();
    let paths = inputs::traces(&files, &arguments.traces)?;
    let traces = paths
        .iter()
        .map(|path| files.read(path))
        .collect::<Result<Vec<_>, _>>()?;
    let script = Script::new(&traces, arguments.trouble.clone());
    let options = MockOptions {
        delay: Duration::from_millis(arguments.delay),
        stall: Duration::from_secs(arguments.stall),
        retry_after_s: arguments.retry_after,
    };
    let known = script.instructions();
    mock_llm(arguments.listen, script, options, |address| {
        println!("http://{address}/v1");
        println!(
            "knows {known} instructions of {} episodes; Ctrl-C stops",
            traces.len()
        );
    })?;
    Ok(ExitStatus::Success)
}
