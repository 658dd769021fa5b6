//! `reel taxonomy clusters`: groups of failures that no rule explains, and drafts of rules.

use std::{fs, path::PathBuf};

use anyhow::{Context, bail};
use reel_query::QuerySession;
use reel_taxonomy::clusters::{Cluster, UNEXPLAINED, clusters, sequences};

use crate::{ExitStatus, inputs, progress};

/// Group failed episodes whose calls are alike: by default those that the rules leave `unexplained`
/// or call `timeout`. The distance of two episodes is the edit distance of their calls (tool, object
/// beside the target, receptacle beside the destination, class of the error), as a share of the longer
/// one. Of each cluster reel prints the medoid, examples, and a pattern that all of its episodes match.
///
/// Examples:
///   reel taxonomy clusters --store store
///   reel taxonomy clusters --store store --where "policy = 'gibberish'" --threshold 0.4
///   reel taxonomy clusters --store store --propose my-rules    # a draft of a rule for each cluster
///   reel taxonomy --store store --rules my-rules --dry-run     # what the drafts would find
///   reel taxonomy clusters --store store --json | jq '.clusters[] | {size, pattern}'
///
/// Exit code 0: done, with or without clusters; 2: the store or the condition is wrong.
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// The store: a folder or s3://bucket/folder
    #[arg(long, value_name = "STORE", default_value = "store")]
    store: String,
    /// Which failed episodes, as a condition in SQL; without it those of sub-class `unexplained` or
    /// `timeout`
    #[arg(long = "where", value_name = "SQL")]
    condition: Option<String>,
    /// Largest distance to the medoid, from 0 (equal) to 1
    #[arg(long, value_name = "SHARE", default_value_t = 0.3)]
    threshold: f64,
    /// Leave out clusters of fewer episodes
    #[arg(long, value_name = "N", default_value_t = 2)]
    smallest: usize,
    /// Write a draft of a rule for each cluster into this folder; a file that is there is kept
    #[arg(long, value_name = "DIR")]
    propose: Option<PathBuf>,
    /// Print the clusters as one JSON object
    #[arg(long)]
    json: bool,
}

/// Clusters the selected failures, prints the clusters and writes the drafts.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    if !(0.0..=1.0).contains(&arguments.threshold) {
        bail!("--threshold {} is outside 0 to 1", arguments.threshold);
    }
    let spinner = progress::spinner();
    spinner.enable_steady_tick(std::time::Duration::from_millis(100));
    spinner.set_message("reading calls");
    let session = QuerySession::new(inputs::store(&arguments.store, None)?)?;
    if arguments.condition.is_none() {
        super::classes_of(&session, &arguments.store)?;
    }
    let condition = arguments.condition.as_deref().unwrap_or(UNEXPLAINED);
    let sequences = sequences(&session, condition)?;
    spinner.set_message(format!("comparing {} episodes", sequences.len()));
    let found = clusters(&sequences, arguments.threshold, arguments.smallest);
    spinner.finish_and_clear();
    if let Some(folder) = &arguments.propose {
        fs::create_dir_all(folder)?;
        for cluster in &found.clusters {
            propose(cluster, folder)?;
        }
    }
    if arguments.json {
        println!("{}", serde_json::to_string(&found)?);
        return Ok(ExitStatus::Success);
    }
    let inside: usize = found.clusters.iter().map(|cluster| cluster.size).sum();
    println!(
        "{} failed episodes, {} different sequences: {} clusters with {inside} episodes, {} alone or in smaller ones",
        found.episodes,
        found.sequences,
        found.clusters.len(),
        found.episodes - inside
    );
    if let Some(sampled) = found.sampled {
        println!(
            "the medoids come from a sample: every {}th sequence, {sampled} in all",
            found.sequences.div_ceil(sampled)
        );
    }
    for cluster in &found.clusters {
        println!(
            "\n{}: {} episodes, mean distance {:.2} to {}",
            cluster.name, cluster.size, cluster.spread, cluster.medoid
        );
        println!(
            "  {}",
            cluster.pattern.as_deref().unwrap_or("nothing in common")
        );
        for example in &cluster.examples {
            println!("  reel show {example}");
        }
    }
    Ok(ExitStatus::Success)
}

fn propose(cluster: &Cluster, folder: &std::path::Path) -> anyhow::Result<()> {
    let path = folder.join(format!("{}.sql", cluster.name));
    let Some(rule) = cluster.rule() else {
        eprintln!("reel: {} has nothing in common: no draft", cluster.name);
        return Ok(());
    };
    if path.exists() {
        eprintln!("reel: kept {}: it is there already", path.display());
        return Ok(());
    }
    fs::write(&path, rule).with_context(|| format!("cannot write {}", path.display()))?;
    eprintln!("wrote {}", path.display());
    Ok(())
}
