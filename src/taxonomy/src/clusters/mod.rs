//! Failed episodes that no rule explains, grouped by how alike their call sequences are, with what
//! each group has in common as a pattern and as the draft of a rule.
//!
//! Deterministic: nothing is drawn at random. Never says why a group failed; that is what the
//! person who edits the draft does.

mod distance;
mod group;
mod pattern;

use std::fmt::Write as _;

use arrow::array::{Array, AsArray, RecordBatch};
use reel_query::{QueryError, QuerySession};
use serde::Serialize;

pub use group::{Grouping, SAMPLE_MAX, group};
pub use pattern::common_pattern;

/// The episodes that are clustered where nothing else is asked for, as a condition in SQL.
pub const UNEXPLAINED: &str =
    "episode_id IN (SELECT episode_id FROM classes WHERE sub_class IN ('unexplained', 'timeout'))";

/// What a call looks like beside all others: the unit of the edit distance.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Debug, Serialize)]
pub struct CallKind {
    /// The paper's name of the tool, or the name as called.
    pub tool: String,
    /// The object beside the target: column `object_match` of `steps`.
    pub object: Option<String>,
    /// The receptacle beside the destination: column `receptacle_match` of `steps`.
    pub receptacle: Option<String>,
    /// The class of the error, `severe` or `moderate`; `None` if the call succeeded.
    pub error: Option<String>,
}

/// The calls of an episode.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct CallSequence {
    /// Id of the episode, as in the table `episodes`.
    pub episode_id: String,
    /// The trace file, as the table `episodes` names it.
    pub trace: String,
    /// What each call looks like, in order.
    pub calls: Vec<CallKind>,
}

/// Episodes whose calls are alike.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Cluster {
    /// Name of the cluster, which its draft of a rule is called by.
    pub name: String,
    /// Number of episodes in it.
    pub size: usize,
    /// The episode with the least total distance to all others of it.
    pub medoid: String,
    /// Mean distance of its episodes to the medoid, from 0 to 1.
    pub spread: f64,
    /// Traces of the medoid and of up to two more episodes.
    pub examples: Vec<String>,
    /// What all of its episodes have in common, in the pattern language of `sequence_match`;
    /// `None` if nothing is.
    pub pattern: Option<String>,
    /// Ids of all of its episodes.
    pub episodes: Vec<String>,
}

/// What came of clustering a selection.
#[derive(Clone, PartialEq, Debug, Serialize)]
pub struct Clusters {
    /// Failed episodes of the selection.
    pub episodes: usize,
    /// Different sequences among them.
    pub sequences: usize,
    /// Sequences whose distances decided the medoids, where not all of them did.
    pub sampled: Option<usize>,
    /// The clusters, the largest first.
    pub clusters: Vec<Cluster>,
}

/// The failed episodes that fulfil a condition in SQL, with their calls.
///
/// # Errors
/// When the store cannot be read or the condition is wrong.
pub fn sequences(session: &QuerySession, condition: &str) -> Result<Vec<CallSequence>, QueryError> {
    let sql = format!(
        "SELECT e.episode_id, e.trace, s.tool, s.object_match, s.receptacle_match, s.error_class \
         FROM (SELECT episode_id, trace FROM episodes WHERE NOT success AND ({condition})) e \
         JOIN steps s ON s.episode_id = e.episode_id ORDER BY e.episode_id, s.step"
    );
    let mut all: Vec<CallSequence> = Vec::new();
    for batch in session.run(&sql)? {
        for row in 0..batch.num_rows() {
            let id = text(&batch, 0, row).unwrap_or_default();
            if all.last().is_none_or(|last| last.episode_id != id) {
                all.push(CallSequence {
                    episode_id: id,
                    trace: text(&batch, 1, row).unwrap_or_default(),
                    calls: Vec::new(),
                });
            }
            if let Some(last) = all.last_mut() {
                last.calls.push(CallKind {
                    tool: text(&batch, 2, row).unwrap_or_default(),
                    object: text(&batch, 3, row),
                    receptacle: text(&batch, 4, row),
                    error: text(&batch, 5, row),
                });
            }
        }
    }
    Ok(all)
}

fn text(batch: &RecordBatch, column: usize, row: usize) -> Option<String> {
    let column = batch.column(column).as_string_opt::<i32>()?;
    column.is_valid(row).then(|| column.value(row).to_owned())
}

/// Clusters sequences: those within `threshold` of a medoid, as a share of the longer sequence, are
/// alike. Clusters of fewer than `smallest` episodes are left out.
pub fn clusters(sequences: &[CallSequence], threshold: f64, smallest: usize) -> Clusters {
    let Grouping {
        groups,
        sequences: different,
        sampled,
    } = group(sequences, threshold);
    let mut clusters: Vec<Cluster> = Vec::new();
    for members in groups.iter().filter(|members| members.len() >= smallest) {
        let medoid = &sequences[members[0].0];
        let calls: Vec<&[CallKind]> = members
            .iter()
            .map(|(index, _)| sequences[*index].calls.as_slice())
            .collect();
        clusters.push(Cluster {
            name: format!("cluster_{}", clusters.len() + 1),
            size: members.len(),
            medoid: medoid.episode_id.clone(),
            spread: members.iter().map(|(_, distance)| distance).sum::<f64>()
                / members.len() as f64,
            examples: members
                .iter()
                .take(3)
                .map(|(index, _)| sequences[*index].trace.clone())
                .collect(),
            pattern: common_pattern(&calls),
            episodes: members
                .iter()
                .map(|(index, _)| sequences[*index].episode_id.clone())
                .collect(),
        });
    }
    Clusters {
        episodes: sequences.len(),
        sequences: different,
        sampled,
        clusters,
    }
}

impl Cluster {
    /// The draft of a rule that finds what its episodes have in common; `None` where that is
    /// nothing. It comes before `timeout` and `unexplained` and after every other built-in rule.
    pub fn rule(&self) -> Option<String> {
        let pattern = self.pattern.as_ref()?;
        let mut text = String::new();
        let _ = write!(
            text,
            "-- {name}\n--\n-- Draft from {size} episodes whose calls are alike; the medoid is {medoid}. Say here in words \
             what goes\n-- wrong, choose the class, and narrow the pattern to what matters.\n",
            name = self.name,
            size = self.size,
            medoid = self.medoid,
        );
        for example in &self.examples {
            let _ = writeln!(text, "-- Example: reel show {example}");
        }
        let _ = write!(
            text,
            "--\n-- Class: Other\n-- Sub-class: {name}\n-- Priority: 45\nSELECT sequence_find(steps, '{pattern}') AS found\nFROM episodes\n",
            name = self.name,
            pattern = pattern.replace('\'', "''"),
        );
        Some(text)
    }
}
