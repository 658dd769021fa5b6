//! The classes that a store holds, with what people name an episode by, and a naive classifier to
//! compare with. Reads only.

use arrow::{
    array::{Array, AsArray, RecordBatch},
    datatypes::Int32Type,
};
use reel_query::{QueryError, QuerySession};
use reel_world::FailureClass;
use serde::Serialize;

/// A failed episode with its class, sub-class and decisive step.
#[derive(Clone, PartialEq, Eq, Debug, Serialize)]
pub struct StoredClass {
    /// Id of the episode, as in the table `episodes`.
    pub episode_id: String,
    /// Task family of the episode, e.g. `FDP`.
    pub family: String,
    /// Name of the policy that played the episode.
    pub policy: String,
    /// The trace file, as the table `episodes` names it.
    pub trace: String,
    /// Failure class of the episode, e.g. `Object Confusion`.
    pub class: String,
    /// Sub-class within that class, e.g. `wrong_attribute`.
    pub sub_class: String,
    /// Index of the decisive step, from 0; also 0 if no such step is known.
    pub step: i32,
}

/// The classes of a store's failed episodes, by episode.
///
/// # Errors
/// When the store cannot be read.
pub fn stored_classes(session: &QuerySession) -> Result<Vec<StoredClass>, QueryError> {
    read(
        session,
        "c.class, c.sub_class, c.step",
        "JOIN classes c ON c.episode_id = e.episode_id AND c.trace_digest = e.trace_digest",
    )
}

/// What one gets who knows no better than the last call that failed: its error decides the class;
/// without one, Object Confusion where something was placed, else Other. The yardstick that every
/// rule set has to beat.
///
/// # Errors
/// When the store cannot be read.
pub fn baseline(session: &QuerySession) -> Result<Vec<StoredClass>, QueryError> {
    let columns = format!(
        "CASE {0} ELSE CASE WHEN place IS NULL THEN 'Other' ELSE 'Object Confusion' END END AS class, \
         CASE {1} ELSE CASE WHEN place IS NULL THEN 'timeout' ELSE 'wrong_attribute' END END AS sub_class, \
         CAST(coalesce(failed, place, 0) AS INT) AS step",
        cases(|class, _| class.as_str()),
        cases(|_, sub_class| sub_class),
    );
    let last = "JOIN (SELECT episode_id AS id, max(step) FILTER (WHERE error_code IS NOT NULL) AS failed, \
                last_value(error_code ORDER BY step) FILTER (WHERE error_code IS NOT NULL) AS code, \
                max(step) FILTER (WHERE tool = 'place' AND error_code IS NULL) AS place FROM steps GROUP BY episode_id) l \
                ON l.id = e.episode_id AND NOT e.success";
    read(session, &columns, last)
}

/// Codes of errors with the class and sub-class that they suggest.
#[rustfmt::skip]
const BY_ERROR: [(&str, FailureClass, &str); 4] = [
    ("'door_closed', 'no_door', 'hand_not_free'", FailureClass::KeyActionMissing, "missing_open"),
    (
        "'nothing_held', 'no_landmark', 'nothing_found', 'no_viewpoint'",
        FailureClass::KeyActionMissing,
        "missing_pick",
    ),
    (
        "'unknown_marker', 'marker_not_in_view', 'no_marker_map'",
        FailureClass::LostMemory,
        "stale_marker",
    ),
    ("'unknown_tool', 'bad_arguments', 'unparsable_output'", FailureClass::Other, "invalid_output"),
];

fn cases(value: impl Fn(FailureClass, &'static str) -> &'static str) -> String {
    BY_ERROR
        .iter()
        .map(|(codes, class, sub_class)| {
            format!(
                "WHEN code IN ({codes}) THEN '{}' ",
                value(*class, sub_class)
            )
        })
        .collect()
}

fn read(session: &QuerySession, columns: &str, join: &str) -> Result<Vec<StoredClass>, QueryError> {
    let batches = session.run(&format!(
        "SELECT e.episode_id, e.family, e.policy, e.trace, {columns} FROM episodes e {join} ORDER BY e.episode_id"
    ))?;
    Ok(batches.iter().flat_map(rows).collect())
}

fn rows(batch: &RecordBatch) -> Vec<StoredClass> {
    let text = |column: usize, row: usize| {
        batch
            .column(column)
            .as_string::<i32>()
            .value(row)
            .to_owned()
    };
    let step = batch.column(6).as_primitive::<Int32Type>();
    (0..batch.num_rows())
        .map(|row| StoredClass {
            episode_id: text(0, row),
            family: text(1, row),
            policy: text(2, row),
            trace: text(3, row),
            class: text(4, row),
            sub_class: text(5, row),
            step: if step.is_valid(row) {
                step.value(row)
            } else {
                0
            },
        })
        .collect()
}
