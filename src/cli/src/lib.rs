//! The `reel` command: parses arguments, calls the crates, prints. Results go to stdout, progress
//! and complaints to stderr. Exit codes: 0 fine, 1 the answer is "no", 2 wrong usage or input, 3
//! done, but with data loss. A library, because the Python package carries the command too.

#![allow(
    rustdoc::bare_urls,
    rustdoc::broken_intra_doc_links,
    rustdoc::invalid_html_tags,
    reason = "doc comments of arguments are the text of --help"
)]

#[cfg(feature = "service")]
mod agent_arguments;
mod camera;
mod cluster_arguments;
mod commands;
#[cfg(feature = "analytics")]
mod cost;
mod html;
mod inputs;
#[cfg(feature = "service")]
mod match_arguments;
#[cfg(feature = "service")]
mod model;
mod names;
#[cfg(feature = "service")]
mod otlp;
mod progress;
#[cfg(feature = "service")]
mod prompt;
#[cfg(feature = "service")]
mod recorded;
#[cfg(feature = "service")]
mod replay_server;
mod settings;

use std::{ffi::OsString, sync::OnceLock};

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use reel_world::printable_lines;

/// Record what embodied agents do, replay it bit for bit, and ask why it failed.
///
/// A first round, on tasks that Reel generates:
///   reel task generate --count 8 --out tasks
///   reel run --tasks tasks --policy planner --out traces
///   reel replay traces
///   reel ingest traces --store store
///   reel query --store store --named benchmark
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
    #[command(about = "Play tasks in the simulator with a policy, and record every episode")]
    Run(commands::run::Arguments),
    #[command(about = "Benchmark how often an agent succeeds on tasks, or compare two agents")]
    #[cfg(feature = "service")]
    Bench(commands::bench::Arguments),
    #[command(about = "Record, replay, query and explain 210 episodes, on embedded defaults")]
    #[cfg(feature = "analytics")]
    Demo(commands::demo::Arguments),
    #[command(about = "Serve worlds to agents (MCP), and episodes to people (web pages, REST)")]
    #[cfg(feature = "service")]
    Serve(commands::serve::Arguments),
    #[command(about = "Serve one agent over standard input and output (MCP)")]
    #[cfg(feature = "service")]
    Mcp(commands::serve::Mcp),
    #[command(about = "Record any MCP server: a proxy between an agent and its tool server")]
    #[cfg(feature = "service")]
    Record(commands::record::Arguments),
    #[command(about = "Test an agent against recordings: does it still make the recorded calls?")]
    #[cfg(feature = "service")]
    Test(commands::test::Arguments),
    #[command(about = "Print a trace as a readable transcript")]
    Show(commands::show::Arguments),
    #[command(about = "Write an episode as one web page that executes it again")]
    Share(commands::share::Arguments),
    #[command(about = "Open an episode in Rerun, or in its web viewer")]
    #[cfg(feature = "rerun")]
    View(commands::view::Arguments),
    #[command(about = "Put a benchmark run into one file that carries its proof")]
    Bundle(commands::bundle::Arguments),
    #[command(about = "Execute the episodes of bundles again: does what they claim hold?")]
    Verify(commands::verify::Arguments),
    #[command(about = "Make static pages that rank bundles, each of which visitors execute again")]
    Leaderboard(commands::leaderboard::Arguments),
    #[command(about = "Make and show the keys that sign bundles")]
    Key(commands::key::Arguments),
    #[command(about = "Execute traces again and compare every digest, frame and text")]
    Replay(commands::replay::Arguments),
    #[command(about = "Pack traces into one file of their inputs: some hundred bytes an episode")]
    Pack(commands::pack::Pack),
    #[command(about = "Write the traces of a packed file again, every byte of them")]
    Unpack(commands::pack::Unpack),
    #[command(about = "Play another future of a recorded episode, from any call")]
    Branch(commands::branch::Arguments),
    #[command(
        about = "Show two traces side by side, or say why one run succeeds where another fails"
    )]
    Diff(commands::diff::Arguments),
    #[command(
        about = "Find the first build, preset, prompt or checkpoint that flips an episode or a metric"
    )]
    #[cfg(feature = "analytics")]
    Bisect(commands::bisect::Arguments),
    #[command(
        about = "Measure which call decided a failed episode, and what would have been better"
    )]
    Blame(commands::blame::Arguments),
    #[command(
        about = "Measure what each capability cost: the success rate with it perfect, with intervals"
    )]
    Attribute(commands::attribute::Arguments),
    #[command(
        about = "Play the plausible other calls of every step, and say which would have helped"
    )]
    Counterfactuals(commands::counterfactuals::Arguments),
    #[command(about = "Find the smallest change of a failed episode's calls that makes it succeed")]
    Repair(commands::repair::Arguments),
    #[command(
        about = "Classify the failed episodes of a store, and measure how often that is right"
    )]
    #[cfg(feature = "analytics")]
    Taxonomy(commands::taxonomy::Arguments),
    #[command(
        about = "Claims about episodes, counted anew over a store: check, also as a gate in CI"
    )]
    #[cfg(feature = "analytics")]
    Claims(commands::claims::Arguments),
    #[command(about = "Write a store as one HTML file: rates, reasons, examples with frames")]
    #[cfg(feature = "analytics")]
    Report(commands::report::Arguments),
    #[command(about = "Convert what other frameworks and robots recorded into traces")]
    Import(commands::import::Arguments),
    #[command(about = "Read traces into a store of tables")]
    #[cfg(feature = "analytics")]
    Ingest(commands::ingest::Arguments),
    #[command(about = "Query a store in SQL, by text or by the name of a query")]
    #[cfg(feature = "analytics")]
    Query(commands::query::Arguments),
    #[command(about = "Write training sets, and recordings for other tools")]
    Export(commands::export::Arguments),
    #[command(about = "Publish a dataset, checked: to a folder or to the Hugging Face Hub")]
    #[cfg(feature = "analytics")]
    Publish(commands::publish::Arguments),
    #[command(
        about = "Trace files: doctor, recover, compact, expand, copy, frames, video, logprobs"
    )]
    Trace(commands::trace::Arguments),
    #[command(about = "Stores: list, history, quarantine, compact, vacuum, reward, label")]
    #[cfg(feature = "analytics")]
    Store(commands::store::Arguments),
    #[command(about = "Training sets: lint, show, profile, diff, join, annotate, gspo")]
    #[cfg(feature = "analytics")]
    Dataset(commands::dataset::Arguments),
    #[command(about = "Look into a training: which rollouts made an update, and what it changed")]
    #[cfg(feature = "analytics")]
    Train(commands::train::Arguments),
    #[command(about = "Task files: check, generate, draw, annotate, report, real-bench")]
    Task(commands::task::Arguments),
    #[command(
        about = "Scenes and meshes: list, show, generate, check, objects, plan, check-assets"
    )]
    Scene(commands::scene::Arguments),
    #[command(about = "Agents to test with: faults, mock-llm")]
    Agent(commands::agent::Arguments),
    #[command(about = "Set up and look after `reel serve`: token, config, audit")]
    #[cfg(feature = "service")]
    Server(commands::server::Arguments),
    #[command(about = "Share work between machines: scheduler, executor, cert")]
    #[cfg(feature = "cluster")]
    Cluster(commands::cluster::Arguments),
    #[command(about = "Work on Reel itself: gate, mint, perf")]
    Dev(commands::dev::Arguments),
    #[command(
        about = "Show the values of reel.toml and the environment, and where each comes from"
    )]
    Config(commands::config::Arguments),
    #[command(about = "Print completions for bash, zsh, fish, elvish or PowerShell")]
    Completions(commands::setup::Completions),
    #[command(about = "Write a man page for every command")]
    Man(commands::setup::Man),
}

#[cfg(feature = "analytics")]
pub use inputs::{buckets, store, trace_files_with as trace_files, traces as trace_paths};

static WORDS: OnceLock<Vec<OsString>> = OnceLock::new();

/// The command line of this process, the program's name first.
fn words() -> &'static [OsString] {
    WORDS.get().map_or(&[], Vec::as_slice)
}

/// Runs a command line, the program's name first, and gives the exit code of the process. What is
/// wrong with the arguments ends the process itself.
pub fn main(command_line_words: Vec<OsString>) -> u8 {
    end_with_the_reader();
    let _first_call = WORDS.set(command_line_words);
    let settings = settings::Settings::load();
    let mut command_line = names::command_line();
    if let Ok(settings) = &settings {
        command_line = settings.apply(command_line);
    }
    let parsed = command_line
        .try_get_matches_from(names::current(words().iter().cloned()))
        .and_then(|matches| Arguments::from_arg_matches(&matches));
    let command = parsed.unwrap_or_else(|error| error.exit()).command;
    // The test of the guides parses commands that it cannot run.
    if std::env::var_os("REEL_PARSE_ONLY").is_some() {
        return ExitStatus::Success.code();
    }
    match settings.and_then(|settings| run(command, &settings)) {
        Ok(answer) => answer.code(),
        #[cfg(feature = "cluster")]
        Err(error)
            if matches!(
                error.downcast_ref(),
                Some(reel_cluster::ClusterError::Stopped)
            ) =>
        {
            eprintln!("reel: {error:#}");
            // 128 + SIGINT, as the shell has it
            130
        }
        Err(error) => {
            eprintln!("reel: {}", printable_lines(&format!("{error:#}")));
            ExitStatus::BadInput.code()
        }
    }
}

fn run(command: Command, settings: &settings::Settings) -> anyhow::Result<ExitStatus> {
    match command {
        Command::Run(arguments) => commands::run::run(&arguments),
        #[cfg(feature = "service")]
        Command::Bench(arguments) => commands::bench::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Demo(arguments) => commands::demo::run(&arguments),
        #[cfg(feature = "service")]
        Command::Serve(arguments) => commands::serve::run(&arguments),
        #[cfg(feature = "service")]
        Command::Mcp(arguments) => commands::serve::mcp(&arguments),
        #[cfg(feature = "service")]
        Command::Record(arguments) => commands::record::run(&arguments),
        #[cfg(feature = "service")]
        Command::Test(arguments) => commands::test::run(arguments),
        Command::Show(arguments) => commands::show::run(&arguments),
        Command::Share(arguments) => commands::share::run(&arguments),
        #[cfg(feature = "rerun")]
        Command::View(arguments) => commands::view::run(&arguments),
        Command::Bundle(arguments) => commands::bundle::run(&arguments),
        Command::Verify(arguments) => commands::verify::run(&arguments),
        Command::Leaderboard(arguments) => commands::leaderboard::run(&arguments),
        Command::Key(arguments) => commands::key::run(&arguments),
        Command::Replay(arguments) => commands::replay::run(&arguments),
        Command::Pack(arguments) => commands::pack::pack(&arguments),
        Command::Unpack(arguments) => commands::pack::unpack(&arguments),
        Command::Branch(arguments) => commands::branch::run(&arguments),
        Command::Diff(arguments) => commands::diff::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Bisect(arguments) => commands::bisect::run(&arguments),
        Command::Blame(arguments) => commands::blame::run(&arguments),
        Command::Attribute(arguments) => commands::attribute::run(&arguments),
        Command::Counterfactuals(arguments) => commands::counterfactuals::run(&arguments),
        Command::Repair(arguments) => commands::repair::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Taxonomy(arguments) => commands::taxonomy::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Claims(arguments) => commands::claims::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Report(arguments) => commands::report::run(&arguments),
        Command::Import(arguments) => commands::import::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Ingest(arguments) => commands::ingest::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Query(arguments) => commands::query::run(&arguments),
        Command::Export(arguments) => commands::export::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Publish(arguments) => commands::publish::run(&arguments),
        Command::Trace(arguments) => commands::trace::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Store(arguments) => commands::store::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Dataset(arguments) => commands::dataset::run(&arguments),
        #[cfg(feature = "analytics")]
        Command::Train(arguments) => commands::train::run(&arguments),
        Command::Task(arguments) => commands::task::run(&arguments),
        Command::Scene(arguments) => commands::scene::run(&arguments),
        Command::Agent(arguments) => commands::agent::run(&arguments),
        #[cfg(feature = "service")]
        Command::Server(arguments) => commands::server::run(&arguments),
        #[cfg(feature = "cluster")]
        Command::Cluster(arguments) => commands::cluster::run(&arguments),
        Command::Dev(arguments) => commands::dev::run(&arguments),
        Command::Completions(arguments) => Ok(commands::setup::completions(
            &arguments,
            Arguments::command(),
        )),
        Command::Man(arguments) => commands::setup::man(&arguments, Arguments::command()),
        Command::Config(arguments) => Ok(commands::config::run(&arguments, settings)),
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

impl ExitStatus {
    fn code(self) -> u8 {
        match self {
            ExitStatus::Success => 0,
            ExitStatus::CheckFailed => 1,
            ExitStatus::BadInput => 2,
            ExitStatus::Partial => 3,
        }
    }
}
