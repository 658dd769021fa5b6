//! `reel ingest`: traces into tables.

use std::path::PathBuf;

use reel_tables::{IngestReport, Store};
use serde_json::json;

use crate::{Answer, inputs, progress};

/// Read traces into a store of tables. Known traces are left as they are; a changed trace replaces what it was;
/// a bad file is put in quarantine with its reason, and the rest goes on.
///
/// Example:
///   reel ingest traces-out --store store
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace files, or folders of them
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The store: a folder, made if it is not there, or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(arguments: &Arguments) -> anyhow::Result<Answer> {
    let paths = inputs::traces(&arguments.paths)?;
    let report = ingest(&paths, &arguments.store)?;
    for (path, reason) in &report.quarantined {
        eprintln!("reel: quarantined {}: {reason}", path.display());
    }
    let IngestReport { added, unchanged, superseded, quarantined, version } = &report;
    if arguments.json {
        println!(
            "{}",
            json!({ "added": added, "unchanged": unchanged, "superseded": superseded, "quarantined": quarantined, "version": version })
        );
    } else {
        println!(
            "{added} added, {superseded} replaced, {unchanged} unchanged, {} quarantined; store: {}",
            quarantined.len(),
            arguments.store
        );
    }
    Ok(if quarantined.is_empty() { Answer::Yes } else { Answer::Loss })
}

/// Ingests with a progress bar.
///
/// # Errors
/// When the store cannot be opened or written.
pub fn ingest(paths: &[PathBuf], store: &str) -> anyhow::Result<IngestReport> {
    let bar = progress::bar(paths.len(), "ingest");
    let report = Store::open_or_create(store)?.ingest(paths, &|done, _| bar.set_position(done as u64));
    bar.finish_and_clear();
    Ok(report?)
}
