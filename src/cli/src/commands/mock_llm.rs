//! `reel mock-llm`: a stand-in for a model.

use std::{net::SocketAddr, path::PathBuf, time::Duration};

use reel_llm::agent::script::{InjectedError, Script};
use reel_server::{MockOptions, mock_llm};
use reel_trace::Trace;

use crate::{ExitStatus, inputs};

/// Stand in for a model: give the decisions of recorded episodes to whoever plays them again, on
/// the protocol of OpenAI-compatible endpoints (chat completions with and without functions,
/// embeddings), until Ctrl-C. For tests and demos, and to try an installation before there is a
/// model. Where a conversation stands is read from the prompt; nothing is kept.
///
/// Examples:
///   reel run --tasks tasks --policy oracle --out traces
///   reel mock-llm traces --listen 127.0.0.1:8000
///   reel bench --tasks tasks --agent real-agent --endpoint http://127.0.0.1:8000/v1 --model mock
///   reel mock-llm traces --trouble gibberish@2 --trouble rate-limit@4 --trouble stall@5 --stall 60
///
/// Trouble at a call (from 0) of every episode: gibberish, truncated, two-calls, unknown-tool; once
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
    /// What goes wrong, and at which call; may be repeated
    #[arg(long, value_name = "KIND@CALL", value_parser = InjectedError::parse)]
    trouble: Vec<(InjectedError, usize)>,
    /// How long every answer takes, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 0)]
    delay: u64,
    /// How long an answer takes that stalls, in seconds
    #[arg(long, value_name = "S", default_value_t = 60)]
    stall: u64,
    /// What Retry-After says where calls are limited, in seconds
    #[arg(long, value_name = "S", default_value_t = 1)]
    retry_after: u64,
}

/// Serves the decisions of recorded episodes as a mock model until stopped.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let paths = inputs::traces(&arguments.traces)?;
    let traces = paths
        .iter()
        .map(|path| Trace::read(path))
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
