//! `reel store`: what a store holds, its versions and upkeep; rewards, labels and remarks of its
//! episodes.

mod label;
mod remark;
pub mod reward;
mod verdicts;

use std::{
    sync::Arc,
    time::{Duration, UNIX_EPOCH},
};

use anyhow::bail;
use reel_tables::{Store, Table, views};
use reel_tasks::{DrawOptions, draw};
use reel_world::{Family, Task};
use serde_json::json;

use crate::{ExitStatus, inputs, progress};
pub use verdicts::keep_verdicts;

/// Stores of tables: what they hold, their versions and upkeep; rewards, labels and remarks of episodes.
/// `reel ingest` fills a store, `reel query` asks it.
///
/// Examples:
///   reel store list --store store
///   reel store compact --store store
///   reel store vacuum --store store --dry-run
///   reel store reward --store store --preset real-trainer
///   reel store label set 3f2a91c0 --sub-class missing_ask --step 4 --author ann
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store", global = true)]
    store: String,
    /// Print results as JSON (all but `synthesize`)
    #[arg(long, global = true)]
    json: bool,
}

#[derive(clap::Subcommand)]
enum Command {
    /// The tables with their files, and the views
    List,
    /// The versions there are, the newest first; `reel query --store-version N` asks one of them
    History,
    /// Files that ingest left out, with the reason
    Quarantine,
    /// Fill a new store with synthetic episodes, to measure queries; no traces lie behind them
    Synthesize {
        /// Number of synthetic episodes to write
        #[arg(long, value_name = "N", default_value_t = 1_000_000)]
        episodes: u64,
        /// How many tasks they play
        #[arg(long, value_name = "N", default_value_t = 400)]
        tasks: usize,
        /// Seed of every random draw
        #[arg(long, value_name = "N", default_value_t = 1)]
        seed: u64,
    },
    /// Merge small files; answers do not change and earlier versions stay readable
    Compact,
    /// Delete files that no version of the last days needs; earlier versions cannot
    /// be opened any more
    Vacuum {
        /// Keep what the versions of the last so many hours need; ingests that run longer than
        /// that lose their files
        #[arg(long, value_name = "HOURS", default_value_t = 168)]
        retention_hours: u32,
        /// Only say what would be deleted
        #[arg(long)]
        dry_run: bool,
    },
    #[command(about = "Score the episodes again, under any reward preset")]
    Reward(reward::Arguments),
    #[command(about = "Keep what people say about failed episodes")]
    Label(label::Arguments),
    #[command(about = "Keep stars, tags and comments on episodes")]
    Remark(remark::Arguments),
}

/// Runs the command of the group.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let mut store = match &arguments.command {
        Command::Reward(arguments) => return reward::run(arguments),
        Command::Label(what) => return label::run(what, &arguments.store, arguments.json),
        Command::Remark(what) => return remark::run(what, &arguments.store, arguments.json),
        Command::Synthesize {
            episodes,
            tasks,
            seed,
        } => return synthesize(&arguments.store, *episodes, *tasks, *seed),
        _ => Store::open(&arguments.store)?,
    };
    match &arguments.command {
        Command::List => {
            let tables = Table::ALL.map(|table| (table, store.files(table).len()));
            if arguments.json {
                let tables: Vec<_> = tables
                    .iter()
                    .map(|(table, files)| json!({ "table": table.name(), "files": files }))
                    .collect();
                println!(
                    "{}",
                    json!({ "version": store.version(), "tables": tables })
                );
                return Ok(ExitStatus::Success);
            }
            println!("version {}", store.version());
            for (table, files) in tables {
                println!(
                    "{:16} {files:3} files  {}",
                    table.name(),
                    table.description()
                );
            }
            for view in views(|_| true) {
                println!("{:16} view       {}", view.name, view.meaning);
            }
        }
        Command::History => {
            for commit in store.history()? {
                if arguments.json {
                    println!("{}", serde_json::to_string(&commit)?);
                } else {
                    let written = commit.timestamp_ms.and_then(|ms| {
                        UNIX_EPOCH.checked_add(Duration::from_millis(ms.try_into().ok()?))
                    });
                    let age = written
                        .and_then(|time| time.elapsed().ok())
                        .map(age)
                        .unwrap_or_default();
                    println!("{:6}  {:12} {age}", commit.version, commit.operation);
                }
            }
        }
        Command::Quarantine => {
            let files = store.quarantine()?;
            if arguments.json {
                println!("{}", json!(files));
            } else {
                files
                    .iter()
                    .for_each(|(path, reason)| println!("{path}: {reason}"));
            }
        }
        Command::Synthesize { .. }
        | Command::Reward(_)
        | Command::Label(_)
        | Command::Remark(_) => {
            unreachable!("these open the store themselves")
        }
        Command::Compact => {
            let report = store.compact()?;
            if arguments.json {
                println!("{}", serde_json::to_string(&report)?);
            } else {
                println!(
                    "{} files became {}; version {}",
                    report.files_before, report.files_after, report.version
                );
            }
        }
        Command::Vacuum {
            retention_hours,
            dry_run,
        } => {
            let report = store.vacuum(*retention_hours, *dry_run)?;
            if arguments.json {
                println!("{}", serde_json::to_string(&report)?);
            } else {
                report.deleted.iter().for_each(|file| println!("{file}"));
                println!(
                    "{} files {}",
                    report.deleted.len(),
                    if *dry_run {
                        "would be deleted"
                    } else {
                        "deleted"
                    }
                );
            }
        }
    }
    Ok(ExitStatus::Success)
}

fn synthesize(store: &str, episodes: u64, tasks: usize, seed: u64) -> anyhow::Result<ExitStatus> {
    if Store::open(store).is_ok() {
        bail!("there is a store already: {store}; synthetic episodes go into a new one");
    }
    let scene = inputs::scene(None)?;
    let made = draw(&DrawOptions {
        scene: &scene,
        families: &Family::ALL,
        count: tasks,
        seed,
    });
    let tasks: Vec<Arc<Task>> = made.tasks.into_iter().map(Arc::new).collect();
    let bar = progress::bar(usize::try_from(episodes)?, "synthesize");
    let mut store = Store::open_or_create(store)?;
    reel_tables::synthesize(&mut store, &tasks, &scene, episodes, seed, |done| {
        bar.set_position(done)
    })?;
    bar.finish_and_clear();
    println!(
        "{episodes} synthetic episodes of {} tasks; version {}",
        tasks.len(),
        store.version()
    );
    Ok(ExitStatus::Success)
}

fn age(age: Duration) -> String {
    match age.as_secs() {
        seconds @ 0..120 => format!("{seconds} s ago"),
        seconds @ 120..7200 => format!("{} min ago", seconds / 60),
        seconds @ 7200..172_800 => format!("{} h ago", seconds / 3600),
        seconds => format!("{} days ago", seconds / 86_400),
    }
}
