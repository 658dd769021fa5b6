//! Why episodes fail: a versioned set of rules in SQL gives every failed episode a class with its
//! evidence (paper, Failure Mode Taxonomy; docs/spec.md#failure-taxonomy), and labels of people,
//! judges and injected faults tell how often the rules are right.
//!
//! The rules see the table `episodes` and nothing else, never a label. Nothing here reads a
//! trace or runs physics.

mod agreement;
mod calibration;
mod classify;
pub mod clusters;
mod drift;
mod explain;
pub mod judge;
mod labels;
mod rules;
pub mod sankey;
mod stored;

use std::path::PathBuf;

pub use agreement::{Agreement, ClassAgreement, agreement};
pub use calibration::{Calibration, CalibrationBin, calibration};
pub use classify::{Classification, classify};
pub use drift::{Drift, drift};
pub use labels::{
    Defaults, LabelSet, disputed, from_csv, from_json, injected, label_set, to_csv, to_json,
};
pub use rules::{CLASSES, Rule, RuleSet};
pub use stored::{StoredClass, baseline, stored_classes};

/// What can go wrong with rules and labels.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TaxonomyError {
    /// A rule file is no rule.
    #[error("rule '{rule}': {reason}; docs/taxonomy.md shows what a rule looks like")]
    Rule { rule: String, reason: String },
    /// A file cannot be read.
    #[error("cannot read {path}: {source}", path = path.display())]
    Io {
        path: PathBuf,
        source: std::io::Error,
    },
    /// The rules cannot be asked.
    #[error(transparent)]
    Query(#[from] reel_query::QueryError),
    /// A label is none.
    #[error("{place}: {reason}")]
    Label { place: String, reason: String },
}
