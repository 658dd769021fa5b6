//! The `reel` command: parses arguments, calls the crates, prints. Results go to stdout, progress
//! and complaints to stderr. Exit codes: 0 fine, 1 the answer is "no", 2 wrong usage or input, 3
//! done, but with data loss.

#[cfg(feature = "service")]
mod agent_arguments;
mod camera;
mod cluster_arguments;
mod commands;
#[cfg(feature = "analytics")]
mod cost;
mod inputs;
#[cfg(feature = "service")]
mod model;
mod progress;
#[cfg(feature = "service")]
mod prompt;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Analytics and the service allocate much and from several threads. The second version of mimalloc
/// gives memory back soon.
#[cfg(feature = "service")]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Record, replay and ask about the episodes of embodied agents.
///
/// A first round, on tasks that Reel makes itself:
///   reel tasks generate --count 8 --out tasks
///   reel run --tasks tasks --policy oracle --out traces
///   reel replay traces
///   reel show traces/<episode>.mcap
#[derive(Parser)]
#[command(
    name = "reel",
    version,
    verbatim_doc_comment,
    arg_required_else_help = true
)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    #[command(about = "Play tasks with a policy and record every episode as a trace")]
    Run(commands::run::Arguments),
    #[command(about = "Benchmark an agent, built in or driven by a model, or compare two")]
    #[cfg(feature = "service")]
    Bench(commands::bench::Arguments),
    #[command(
        about = "Play tasks with a policy that makes mistakes on purpose, and label what went wrong"
    )]
    Faults(commands::faults::Arguments),
    #[command(about = "Re-execute traces and compare every digest, picture and text")]
    Replay(commands::replay::Arguments),
    #[command(
        about = "Replay a corpus with this build and another, and list which outcomes change"
    )]
    Gate(commands::gate::Arguments),
    #[command(about = "Write golden traces anew, for a reason")]
    Mint(commands::mint::Arguments),
    #[command(about = "Print a trace as a readable transcript")]
    Show(commands::show::Arguments),
    #[command(about = "Play another future of a recorded episode, from any call")]
    Branch(commands::branch::Arguments),
    #[command(
        about = "Measure why episodes failed: the step that decided, and what would have been better"
    )]
    Blame(commands::blame::Arguments),
    #[command(about = "Find the smallest change of a failed episode's calls that makes it succeed")]
    Repair(commands::repair::Arguments),
    #[command(about = "Show two traces of one task side by side, from the first difference on")]
    Diff(commands::diff::Arguments),
    #[command(about = "Restore what unfinished, torn or damaged recordings hold")]
    Recover(commands::recover::Arguments),
    #[command(about = "Check traces: checksums, index, schemas, order, hash chain, pictures")]
    Doctor(commands::doctor::Arguments),
    #[command(about = "Write the pictures of a trace as PNG files, and a contact sheet")]
    Frames(commands::frames::Arguments),
    #[command(about = "Write an episode as moving pictures, with the calls as captions")]
    Video(commands::video::Arguments),
    #[command(about = "Open an episode in Rerun, or in its web viewer")]
    #[cfg(feature = "rerun")]
    View(commands::view::Arguments),
    #[command(about = "Turn what other frameworks recorded into traces")]
    Import(commands::import::Arguments),
    #[command(about = "Read traces into a store of tables")]
    #[cfg(feature = "analytics")]
    Ingest(commands::ingest::Arguments),
    #[command(about = "Ask a store in SQL, by text or by a named query")]
    #[cfg(feature = "analytics")]
    Query(commands::query::Arguments),
    #[command(about = "Copy traces to buckets, and back")]
    #[cfg(feature = "analytics")]
    Copy(commands::copy::Arguments),
    #[command(about = "Answer questions with many machines")]
    #[cfg(feature = "cluster")]
    Cluster(commands::cluster::Arguments),
    #[command(about = "Score the episodes of a store again, under any reward preset")]
    #[cfg(feature = "analytics")]
    Reward(commands::reward::Arguments),
    #[command(about = "Compute the GSPO objective of two recorded policies over the same tokens")]
    #[cfg(feature = "analytics")]
    Gspo(Box<commands::gspo::Arguments>),
    #[command(
        about = "List the log-probabilities of recorded tokens, and add those of other policies"
    )]
    Logprobs(commands::logprobs::Arguments),
    #[command(about = "Write reasoning and History for traces that came without words")]
    #[cfg(feature = "analytics")]
    Annotate(commands::annotate::Arguments),
    #[command(
        about = "Look into training sets, ours and others': what is wrong, what an example looks like"
    )]
    #[cfg(feature = "analytics")]
    Dataset(commands::dataset::Arguments),
    #[command(about = "Say why episodes failed, and how often that is right")]
    #[cfg(feature = "analytics")]
    Taxonomy(commands::taxonomy::Arguments),
    #[command(about = "Keep what people say about failed episodes")]
    #[cfg(feature = "analytics")]
    Label(commands::label::Arguments),
    #[command(about = "Write a store as one HTML file: rates, reasons, examples with pictures")]
    #[cfg(feature = "analytics")]
    Report(commands::report::Arguments),
    #[command(about = "Look after a store: versions, quarantine, compaction, vacuum")]
    #[cfg(feature = "analytics")]
    Tables(commands::tables::Arguments),
    #[command(about = "Drop the pictures of traces; digests stay")]
    Compact(commands::repack::Compact),
    #[command(about = "Draw the pictures of lean traces again")]
    Expand(commands::repack::Expand),
    #[command(about = "Write training sets and recordings for other tools")]
    Export(commands::export::Arguments),
    #[command(about = "Check or make task files")]
    Tasks(commands::tasks::Arguments),
    #[command(about = "Check a folder of meshes of objects")]
    Assets(commands::assets::Arguments),
    #[command(about = "List, make, check and draw scenes")]
    Scene(commands::scene::Arguments),
    #[command(about = "Serve live worlds to agents (MCP), and episodes to people (REST)")]
    #[cfg(feature = "service")]
    Serve(commands::serve::Arguments),
    #[command(about = "Serve one agent over standard input and output (MCP)")]
    #[cfg(feature = "service")]
    Mcp(commands::serve::Mcp),
    #[command(
        about = "Stand in for a model: recorded decisions on the OpenAI protocol, with trouble on request"
    )]
    #[cfg(feature = "service")]
    MockLlm(commands::mock_llm::Arguments),
    #[command(about = "Stand between an agent and any tool server (MCP), and record what goes by")]
    #[cfg(feature = "service")]
    Record(commands::record::Arguments),
    #[command(about = "Make and revoke the tokens that clients of `reel serve` show")]
    #[cfg(feature = "service")]
    Token(commands::token::Arguments),
    #[command(about = "Check a configuration of `reel serve`, or print the default")]
    #[cfg(feature = "service")]
    Config(commands::config::Arguments),
    #[command(about = "The whole loop on embedded defaults: run, replay, ingest, query, picture")]
    #[cfg(feature = "analytics")]
    Demo(commands::demo::Arguments),
    #[command(about = "Measure: physics, pictures, episodes, replay, trace bytes")]
    Perf(commands::perf::Arguments),
}

fn main() -> ExitCode {
    end_with_the_reader();
    #[cfg(feature = "analytics")]
    reel_trace::install_remote_fs(Box::new(inputs::buckets()));
    let result = match Arguments::parse().command {
        Command::Run(arguments) => commands::run::run(&arguments),
        #[cfg(feature = "service")]
        Command::Bench(arguments) => commands::bench::run(&arguments),
        Command::Faults(arguments) => commands::faults::run(&arguments),
        Command::Replay(arguments) => commands::replay::run(&arguments),
        Command::Gate(arguments) => commands::gate::run(&arguments),
        Command::Mint(arguments) => commands::mint::run(&arguments),
        Command::Show(arguments) => commands::show::run(&arguments),
        Command::Branch(arguments) => commands::branch::run(&arguments),
        Command::Blame(arguments) => commands::blame::run(&arguments),
        Command::Repair(arguments) => commands::repair::run(&arguments),
        Command::Diff(arguments) => commands::diff::run(&arguments),
        Command::Recover(arguments) => commands::recover::run(&arguments),
        Command::Doctor(arguments) => commands::doctor::run(&arguments),
        Command::Frames(arguments) => commands::frames::run(&arguments),
        Command::Video(arguments) => commands::video::run(&arguments),
        #[cfg(feature = "rerun")]
        Command::View(arguments) => commands::view::run(&arguments),
        Command::Import(arguments) => commands::import::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Ingest(arguments) => commands::ingest::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Query(arguments) => commands::query::run(&arguments),
        #[cfg(feature = "cluster")]
        Command::Cluster(arguments) => commands::cluster::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Reward(arguments) => commands::reward::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Gspo(arguments) => commands::gspo::run(&arguments),
        Command::Logprobs(arguments) => commands::logprobs::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Annotate(arguments) => commands::annotate::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Dataset(arguments) => commands::dataset::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Taxonomy(arguments) => commands::taxonomy::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Label(arguments) => commands::label::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Report(arguments) => commands::report::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Tables(arguments) => commands::tables::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Copy(arguments) => commands::copy::run(&arguments),
        Command::Compact(arguments) => commands::repack::compact(&arguments),
        Command::Expand(arguments) => commands::repack::expand(&arguments),
        Command::Export(arguments) => commands::export::run(&arguments),
        Command::Tasks(arguments) => commands::tasks::run(&arguments),
        Command::Assets(arguments) => commands::assets::run(&arguments),
        Command::Scene(arguments) => commands::scene::run(&arguments),
        #[cfg(feature = "service")]
        Command::Serve(arguments) => commands::serve::run(&arguments),
        #[cfg(feature = "service")]
        Command::Mcp(arguments) => commands::serve::mcp(&arguments),
        #[cfg(feature = "service")]
        Command::MockLlm(arguments) => commands::mock_llm::run(&arguments),
        #[cfg(feature = "service")]
        Command::Record(arguments) => commands::record::run(&arguments),
        #[cfg(feature = "service")]
        Command::Token(arguments) => commands::token::run(&arguments),
        #[cfg(feature = "service")]
        Command::Config(arguments) => commands::config::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Demo(arguments) => commands::demo::run(&arguments),
        Command::Perf(arguments) => commands::perf::run(&arguments),
    };
    match result {
        Ok(answer) => answer.into(),
        #[cfg(feature = "cluster")]
        Err(error)
            if matches!(
                error.downcast_ref(),
                Some(reel_cluster::ClusterError::Stopped)
            ) =>
        {
            eprintln!("reel: {error:#}");
            // 128 + SIGINT, as the shell has it
            ExitCode::from(130)
        }
        Err(error) => {
            eprintln!("reel: {error:#}");
            ExitStatus::BadInput.into()
        }
    }
}

/// Ends as a pipe's writer should when nobody reads on (`reel show ... | head`), instead
/// of with a panic.
fn end_with_the_reader() {
    let otherwise = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let text = panic.payload_as_str().unwrap_or_default();
        if text.starts_with("failed printing to") && text.contains("Broken pipe") {
            // 128 + SIGPIPE, as the shell has it.
            std::process::exit(141);
        }
        otherwise(panic);
    }));
}

/// What a command came to.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ExitStatus {
    /// The command did what was asked (exit code 0).
    Success,
    /// The answer is "no": a replay diverged, a check failed.
    CheckFailed,
    /// Wrong usage or input.
    BadInput,
    /// Done, but something was lost or left out.
    Partial,
}

impl From<ExitStatus> for ExitCode {
    fn from(answer: ExitStatus) -> Self {
        ExitCode::from(match answer {
            ExitStatus::Success => 0,
            ExitStatus::CheckFailed => 1,
            ExitStatus::BadInput => 2,
            ExitStatus::Partial => 3,
        })
    }
}
