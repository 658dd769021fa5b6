//! `reel dataset diff`: what changed between two versions of a set.

use std::path::{Path, PathBuf};

use anyhow::bail;
use reel_data_profile::{DiffOptions, PSI_THRESHOLD, Table, diff};

use crate::{ExitStatus, progress};

/// Compare two versions of a set: columns, rows that were added, removed and unchanged, drift of each
/// column, balance of classes.
///
/// Drift is the population stability index (PSI) of the values, of numbers in the tenths of the
/// old set, or of the lengths of texts and lists; the Jensen-Shannon divergence (JS, 0 to 1) is
/// shown beside it. Rows without a value have a bin of their own.
///
/// Exit code 1, with --check: a column drifted, columns changed, or one set has no rows.
///
/// Examples:
///   reel dataset diff sft-1 sft-2 --key episode_id,call
///   reel dataset diff old.parquet new.parquet --by source --check --threshold 0.1
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    /// File, folder or pattern of the old version
    #[arg(value_name = "OLD")]
    old: PathBuf,
    /// File, folder or pattern of the new version
    #[arg(value_name = "NEW")]
    new: PathBuf,
    /// Columns that name a row in both versions; without them only whole rows are compared
    #[arg(long, value_name = "COLUMN", value_delimiter = ',')]
    key: Vec<String>,
    /// Columns whose values are classes; their shares are compared
    #[arg(long, value_name = "COLUMN", value_delimiter = ',')]
    by: Vec<String>,
    /// PSI from which a column counts as drifted: up to 0.1 is no change, 0.25 a major one
    #[arg(long, value_name = "PSI", default_value_t = PSI_THRESHOLD)]
    threshold: f64,
    /// Exit with code 1 if a column drifted, the columns changed, or one set has no rows
    #[arg(long)]
    check: bool,
    /// Print the differences as one JSON object
    #[arg(long)]
    json: bool,
}

/// Compares two versions of a set and prints what changed.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    if !arguments.threshold.is_finite() || arguments.threshold <= 0.0 {
        bail!(
            "--threshold {} is no index; 0.25 is usual",
            arguments.threshold
        );
    }
    let options = DiffOptions {
        keys: arguments.key.clone(),
        by: arguments.by.clone(),
        threshold: arguments.threshold,
    };
    let spinner = progress::spinner();
    spinner.set_message("reading");
    let found =
        open_pair(&arguments.old, &arguments.new).and_then(|(old, new)| diff(&old, &new, &options));
    spinner.finish_and_clear();
    let found = found?;
    if arguments.json {
        println!("{}", serde_json::to_string(&found)?);
    } else {
        print!("{found}");
    }
    Ok(if arguments.check && found.is_drifted() {
        ExitStatus::CheckFailed
    } else {
        ExitStatus::Success
    })
}

/// Two sets, each one path.
pub(super) fn open_pair(
    first: &Path,
    second: &Path,
) -> Result<(Table, Table), reel_data_profile::DataError> {
    let open = |path: &Path| Table::open(&[path.to_owned()]);
    Ok((open(first)?, open(second)?))
}
