//! `reel ingest`: traces into tables.

use std::path::PathBuf;

#[cfg(feature = "cluster")]
use reel_tables::TraceRows;
use reel_tables::{IngestReport, Progress, Store};
use reel_trace::TraceFiles;
use serde_json::json;

use crate::{ExitStatus, cluster_arguments::ClusterArguments, inputs, progress};

/// Read traces into a store of tables. Known traces stay as they are; a changed trace replaces
/// its former rows; a bad file goes into quarantine with its reason, and the others are read.
///
/// Examples:
///   reel ingest traces-out --store store
///   reel ingest s3://lab/traces --store s3://lab/store --cluster 10.0.0.1:50050
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// Trace files, or folders of them, also s3://bucket/folder
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The store: a folder, made if it is not there, or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    #[command(flatten)]
    assets: inputs::Assets,
    #[command(flatten)]
    in_cluster: ClusterArguments,
    /// Check what policies say they did (their Histories) against the record, into table
    /// `contradictions`; an export checks what it needs by itself
    #[arg(long)]
    check_histories: bool,
    /// Print counts and quarantined files as one JSON object
    #[arg(long)]
    json: bool,
}

/// Ingests traces into a store and reports what was added or quarantined.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    let files = arguments.assets.trace_files()?;
    let paths = inputs::traces(&files, &arguments.paths)?;
    let report = ingest(&files, &paths, &arguments.store, &arguments.in_cluster)?;
    if arguments.check_histories {
        let bar = progress::bar(paths.len(), "check");
        let store = Store::open(&arguments.store)?.with_trace_files(files);
        reel_export::check_histories(&store, |checked| bar.inc(checked as u64))?;
        bar.finish_and_clear();
    }
    for (path, reason) in &report.quarantined {
        eprintln!("reel: quarantined {}: {reason}", path.display());
    }
    let IngestReport {
        added,
        unchanged,
        superseded,
        quarantined,
        version,
    } = &report;
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
    Ok(if quarantined.is_empty() {
        ExitStatus::Success
    } else {
        ExitStatus::Partial
    })
}

/// Ingests with a progress bar.
///
/// # Errors
/// When the store cannot be opened or written, or the cluster does not answer.
pub fn ingest(
    files: &TraceFiles,
    paths: &[PathBuf],
    store: &str,
    in_cluster: &ClusterArguments,
) -> anyhow::Result<IngestReport> {
    let bar = progress::bar(paths.len(), "ingest");
    let progress = |done: usize, _: usize| bar.set_position(done as u64);
    let store = Store::open_or_create(store)?.with_trace_files(files.clone());
    let report = read_in_cluster(store, paths, in_cluster, &progress);
    bar.finish_and_clear();
    report
}

/// Traces that an executor turns into rows at a time.
#[cfg(feature = "cluster")]
const TRACES_PER_GROUP: usize = 16;

/// The cluster reads, if one is named; who calls this decides what goes in, and commits it.
#[cfg(feature = "cluster")]
fn read_in_cluster(
    mut store: Store,
    paths: &[PathBuf],
    in_cluster: &ClusterArguments,
    progress: Progress<'_>,
) -> anyhow::Result<IngestReport> {
    let Some(cluster) = in_cluster.open()? else {
        return Ok(store.ingest(paths, progress)?);
    };
    store.ingest_by(
        paths,
        TRACES_PER_GROUP,
        progress,
        |groups, _, done, take| {
            let mut sizes = groups.iter().map(Vec::len);
            cluster.work("ingest", "", groups, |rows| {
                take(TraceRows::from_bytes(&rows)?)?;
                done(sizes.next().unwrap_or(0));
                Ok(())
            })
        },
    )
}

#[cfg(not(feature = "cluster"))]
fn read_in_cluster(
    mut store: Store,
    paths: &[PathBuf],
    _: &ClusterArguments,
    progress: Progress<'_>,
) -> anyhow::Result<IngestReport> {
    Ok(store.ingest(paths, progress)?)
}

/// What executors do for this command.
#[cfg(feature = "cluster")]
pub fn work(files: TraceFiles) -> reel_cluster::TraceJob {
    // parses tasks and scenes once
    let reader = reel_trace::RecordsReader::new(files);
    let run = move |traces: &[PathBuf], _: &str| {
        let rows = TraceRows::read(&reader, traces, &reel_tables::DocumentSet::default());
        rows.and_then(|rows| rows.to_bytes())
            .map_err(|error| error.to_string())
    };
    reel_cluster::TraceJob {
        name: "ingest",
        traces: true,
        run: std::sync::Arc::new(run),
    }
}
