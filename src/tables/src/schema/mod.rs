//! The tables' columns with their types and meanings: the one source of the Arrow schemas and of
//! `schemas/tables.md`. Knows no rows and no files.
//!
//! What belongs to an episode is nested in its row, so that an episode appears and disappears as a
//! whole; the flat forms are views ([`View`]).

mod columns;

use std::{fmt::Write as _, sync::Arc};

use arrow::datatypes::{DataType, Field, Fields, Schema, SchemaRef};

pub use columns::STEP;
use columns::{
    ANSWER_LABELS, ATTRIBUTION, BLAME, CHANGE, CLAIM, CLASSES, CONTRADICTIONS, COUNTERFACTUALS,
    EPISODES, FINDING, LABELS, LOGPROBS, MARKER, MEASURED, OBJECT, QUARANTINE, RECEPTACLE, REMARKS,
    RESCORED, SCENES, SCORE, STEP_TERM, TASKS, TERM, VERDICTS, VISIBLE,
};

/// One of the tables that a store holds.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
pub enum Table {
    /// One row an episode, its steps nested.
    Episodes,
    /// One row a task, its objects nested.
    Tasks,
    /// One row a scene, its receptacles nested.
    Scenes,
    /// Rewards that were recomputed, one row an episode and version of a preset.
    Rescored,
    /// Files that were left out.
    Quarantine,
    /// Why failed episodes failed, by the rules.
    Classes,
    /// Why episodes failed, measured.
    Blame,
    /// What failed episodes come to with one capability perfect, played.
    Attribution,
    /// Why they failed, by people, judges and those who injected the fault. The
    /// rules never read it.
    Labels,
    /// Whether answers of the user are faithful, by people and models.
    AnswerLabels,
    /// Stars, tags and comments of people.
    Remarks,
    /// What plausible other calls come to, played.
    Counterfactuals,
    /// What replaying trace files found. Bound to no version of the store.
    Verdicts,
    /// What policies' Histories claim and their records refute. Bound to no version of the store.
    Contradictions,
}

/// A column: its name, type, whether it may be null, and what it says.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Name of the column in SQL and in the Arrow schema.
    pub name: &'static str,
    /// Data type of the values, nested columns included.
    pub kind: ColumnType,
    /// Whether it may be null.
    pub nullable: bool,
    /// Meaning, with the unit where it has one.
    pub meaning: &'static str,
}

/// Type of a column.
#[derive(Clone, Copy, Debug)]
pub enum ColumnType {
    /// Text in UTF-8 (Arrow `Utf8`).
    Text,
    /// A boolean: true or false (Arrow `Boolean`).
    Flag,
    /// 32-bit signed integer (Arrow `Int32`).
    Int,
    /// 64-bit signed integer (Arrow `Int64`).
    Long,
    /// 64-bit unsigned integer; a decimal of 20 digits, because Delta Lake
    /// knows no unsigned numbers.
    Unsigned,
    /// 64-bit floating-point number (Arrow `Float64`).
    Float,
    /// A list whose items all have the given type.
    List(&'static ColumnType),
    /// A struct of named fields, each described as a column.
    Struct(&'static [Column]),
}

use ColumnType::{Flag, Float, Int, List, Long, Struct, Text, Unsigned};

const fn must(name: &'static str, kind: ColumnType, meaning: &'static str) -> Column {
    Column {
        name,
        kind,
        nullable: false,
        meaning,
    }
}

const fn may(name: &'static str, kind: ColumnType, meaning: &'static str) -> Column {
    Column {
        name,
        kind,
        nullable: true,
        meaning,
    }
}

impl Table {
    /// Every table, in the order of the documents.
    pub const ALL: [Table; 14] = [
        Table::Episodes,
        Table::Tasks,
        Table::Scenes,
        Table::Rescored,
        Table::Quarantine,
        Table::Classes,
        Table::Blame,
        Table::Attribution,
        Table::Labels,
        Table::AnswerLabels,
        Table::Remarks,
        Table::Counterfactuals,
        Table::Verdicts,
        Table::Contradictions,
    ];

    /// Its name in SQL and as a folder.
    pub fn name(self) -> &'static str {
        match self {
            Table::Episodes => "episodes",
            Table::Tasks => "tasks",
            Table::Scenes => "scenes",
            Table::Rescored => "rescored",
            Table::Quarantine => "quarantine",
            Table::Classes => "classes",
            Table::Blame => "blame",
            Table::Attribution => "attribution",
            Table::Labels => "labels",
            Table::AnswerLabels => "answer_labels",
            Table::Remarks => "remarks",
            Table::Counterfactuals => "counterfactuals",
            Table::Verdicts => "verdicts",
            Table::Contradictions => "contradictions",
        }
    }

    /// What a row is.
    pub fn description(self) -> &'static str {
        match self {
            Table::Episodes => "One row an episode; steps, rewards and markers are nested in it.",
            Table::Tasks => "One row a task, however many episodes play it.",
            Table::Scenes => "One row a scene.",
            Table::Rescored => {
                "One row an episode and version of a preset, written by `reel store reward`."
            }
            Table::Quarantine => "One row a file that failed to load in `reel ingest`.",
            Table::Classes => {
                "One row a failed episode: why it failed, by the rules; written by `reel taxonomy`."
            }
            Table::Blame => {
                "One row a failed episode: the decisive step, measured, and a better call; written by `reel blame`."
            }
            Table::Attribution => {
                "One row a failed episode and capability: what comes of it with that capability perfect, played; written by `reel attribute`."
            }
            Table::Labels => {
                "One row an episode and author: why it failed, by people, judges and injected faults; written by `reel store label`."
            }
            Table::AnswerLabels => {
                "One row an answer of the user and author: whether the answer is faithful to what the user wants; written by `reel store label answer`."
            }
            Table::Remarks => {
                "One row a star, tag or comment of a person on an episode; written by `reel store remark`."
            }
            Table::Counterfactuals => {
                "One row a step and plausible other call of an episode: what comes of it, played; written by `reel counterfactuals`."
            }
            Table::Verdicts => {
                "One row a trace file that was replayed for an export, and what was found; the same in every version of the store."
            }
            Table::Contradictions => {
                "One row a trace whose Histories were checked against its record, by an export or `reel ingest --check-histories`; the same in every version of the store."
            }
        }
    }

    /// The top-level columns in their stored order; nested ones are part of their types.
    pub fn columns(self) -> &'static [Column] {
        match self {
            Table::Episodes => EPISODES,
            Table::Tasks => TASKS,
            Table::Scenes => SCENES,
            Table::Rescored => RESCORED,
            Table::Quarantine => QUARANTINE,
            Table::Classes => CLASSES,
            Table::Blame => BLAME,
            Table::Attribution => ATTRIBUTION,
            Table::Labels => LABELS,
            Table::AnswerLabels => ANSWER_LABELS,
            Table::Remarks => REMARKS,
            Table::Counterfactuals => COUNTERFACTUALS,
            Table::Verdicts => VERDICTS,
            Table::Contradictions => CONTRADICTIONS,
        }
    }

    /// The Arrow schema that is made of the table's columns.
    pub fn schema(self) -> SchemaRef {
        Arc::new(Schema::new(fields(self.columns())))
    }
}

/// A flat form of what is nested in a table.
#[derive(Clone, Debug)]
pub struct View {
    /// Its name in SQL.
    pub name: &'static str,
    /// What a row is.
    pub meaning: &'static str,
    /// The `SELECT` statement that defines the view over the stored tables.
    pub sql: String,
}

/// The flat views, in the order of the documents. Of the fields of a step the view `steps` has
/// those that are `available`: all of them, but for a reader that leaves some of them out.
pub fn views(available: impl Fn(&str) -> bool) -> Vec<View> {
    let step: Vec<Column> = STEP
        .iter()
        .filter(|column| available(column.name))
        .copied()
        .collect();
    let view = |name, meaning, sql| View { name, meaning, sql };
    // what one of the step's lists holds, a row each
    let of_steps = |list: &str, columns: &[Column]| {
        format!(
            "SELECT episode_id, step, {} FROM (SELECT episode_id, s['step'] AS step, unnest(s['{list}']) AS item \
             FROM (SELECT episode_id, unnest(steps) AS s FROM episodes))",
            flat("item", columns)
        )
    };
    vec![
        view(
            "steps",
            "One row a decision: `episode_id, policy, family, task_id, success, parent_trace` and the columns of a step.",
            format!(
                "SELECT episode_id, policy, family, task_id, success, parent_trace, {} \
                 FROM (SELECT episode_id, policy, family, task_id, success, parent_trace, unnest(steps) AS s FROM episodes)",
                flat("s", &step)
            ),
        ),
        view(
            "world_diffs",
            "`episode_id`, `step` and the columns of a change; moving an object gives two rows.",
            of_steps("changes", CHANGE),
        ),
        view(
            "rewards",
            "`episode_id, preset, version, step, component, value, reason`: reward terms that are not zero, as recorded \
             (`version` null) and as recomputed.",
            "SELECT episode_id, preset, CAST(NULL AS VARCHAR) AS version, step, t['component'] AS component, \
             t['value'] AS value, t['reason'] AS reason \
             FROM (SELECT episode_id, preset, s['step'] AS step, unnest(s['terms']) AS t \
             FROM (SELECT episode_id, preset, unnest(steps) AS s FROM episodes)) \
             UNION ALL SELECT episode_id, preset, version, t['step'], t['component'], t['value'], '' \
             FROM (SELECT r.episode_id, r.preset, r.version, unnest(r.terms) AS t FROM rescored r \
             JOIN episodes e ON e.episode_id = r.episode_id AND e.trace_digest = r.trace_digest)"
                .into(),
        ),
        view(
            "objects",
            "`task_id`, `task_digest` and the columns of an object.",
            format!(
                "SELECT task_id, task_digest, {} FROM (SELECT task_id, task_digest, unnest(objects) AS o FROM tasks)",
                flat("o", OBJECT)
            ),
        ),
        view("markers", "`episode_id`, `step` and the columns of a marker.", of_steps("marker_map", MARKER)),
        view(
            "visible_objects",
            "`episode_id`, `step` and the columns of a visible object; step -1 is before the first decision.",
            format!(
                "{} UNION ALL SELECT episode_id, CAST(-1 AS INT), {} \
                 FROM (SELECT episode_id, unnest(start_objects) AS item FROM episodes)",
                of_steps("visible_objects", VISIBLE),
                flat("item", VISIBLE)
            ),
        ),
        view(
            "measurements",
            "`episode_id`, `policy`, `backend`, `parent_trace` and the columns of a measurement.",
            format!(
                "SELECT episode_id, policy, backend, parent_trace, {} \
                 FROM (SELECT episode_id, policy, backend, parent_trace, unnest(measurements) AS m FROM episodes)",
                flat("m", MEASURED)
            ),
        ),
        view(
            "logprobs",
            "`episode_id, step, policy, tokens, logprobs`: one row a decision and policy whose log-probabilities are known.",
            "SELECT episode_id, step, l['policy'] AS policy, tokens, l['logprobs'] AS logprobs \
             FROM (SELECT episode_id, s['step'] AS step, s['tokens'] AS tokens, unnest(s['logprobs']) AS l \
             FROM (SELECT episode_id, unnest(steps) AS s FROM episodes))"
                .into(),
        ),
        view(
            "dialogue",
            "`episode_id, step, question, reply, source`: one row a question.",
            "SELECT episode_id, s['step'] AS step, s['question'] AS question, s['reply'] AS reply, \
             s['reply_source'] AS source FROM (SELECT episode_id, unnest(steps) AS s FROM episodes) \
             WHERE s['question'] IS NOT NULL"
                .into(),
        ),
        view(
            "refuted_claims",
            "`episode_id`, `checker_version` and the columns of a claim that the record refutes.",
            format!(
                "SELECT DISTINCT episode_id, checker_version, {} FROM (SELECT c.episode_id, c.checker_version, \
                 unnest(c.claims) AS claim FROM contradictions c \
                 JOIN episodes e ON e.episode_id = c.episode_id AND e.trace_digest = c.trace_digest)",
                flat("claim", CLAIM)
            ),
        ),
    ]
}

/// The fields of a struct as columns of their own.
fn flat(of: &str, columns: &[Column]) -> String {
    let column = |column: &Column| format!("{of}['{0}'] AS {0}", column.name);
    columns.iter().map(column).collect::<Vec<_>>().join(", ")
}

/// Delta Lake's name for what a list holds.
const LIST_ITEM: &str = "element";

fn fields(columns: &[Column]) -> Fields {
    columns
        .iter()
        .map(|column| Field::new(column.name, data_type(column.kind), column.nullable))
        .collect()
}

fn data_type(kind: ColumnType) -> DataType {
    match kind {
        Text => DataType::Utf8,
        Flag => DataType::Boolean,
        Int => DataType::Int32,
        Long => DataType::Int64,
        Unsigned => DataType::Decimal128(20, 0),
        Float => DataType::Float64,
        List(item) => DataType::List(Arc::new(Field::new(LIST_ITEM, data_type(*item), false))),
        Struct(columns) => DataType::Struct(fields(columns)),
    }
}

/// The tables as a Markdown page: `schemas/tables.md`.
pub fn document() -> String {
    let mut page = String::from(
        "# Tables\n\nWritten by `reel ingest`, read by `reel query`. Delta Lake (Parquet with zstd), one folder a table.\nThe \
         parts of an episode are nested in its row; the views below are their flat forms.\n",
    );
    for table in Table::ALL {
        let _ = write!(page, "\n## `{}`\n{}\n\n", table.name(), table.description());
        document_columns(table.columns(), &mut page);
    }
    for (title, columns) in NESTED {
        let _ = write!(page, "\n## {title}\n\n");
        document_columns(columns, &mut page);
    }
    page.push_str("\n## Views\n\n| view | rows |\n|---|---|\n");
    for view in views(|_| true) {
        let _ = writeln!(page, "| `{}` | {} |", view.name, view.meaning);
    }
    page
}

/// Nested structs with a section of their own.
#[rustfmt::skip]
const NESTED: [(&str, &[Column]); 13] = [
    ("A step (`episodes.steps`, view `steps`)", STEP),
    ("A measurement of a robot (`episodes.measurements`, view `measurements`)", MEASURED),
    ("A reported score (`episodes.scores`)", SCORE),
    ("Log-probabilities (`steps.logprobs`, view `logprobs`)", LOGPROBS),
    ("A change (`steps.changes`, `episodes.start_changes`, view `world_diffs`)", CHANGE),
    ("A reward term (`steps.terms`, view `rewards`)", TERM),
    ("A marker (`steps.marker_map`, view `markers`)", MARKER),
    (
        "A visible object (`steps.visible_objects`, `episodes.start_objects`, view `visible_objects`)",
        VISIBLE,
    ),
    ("An object (`tasks.objects`, view `objects`)", OBJECT),
    ("A receptacle (`scenes.receptacles`)", RECEPTACLE),
    ("A recomputed term (`rescored.terms`, view `rewards`)", STEP_TERM),
    ("A finding (`classes.secondary`)", FINDING),
    ("A refuted claim (`contradictions.claims`, view `refuted_claims`)", CLAIM),
];

fn has_section(columns: &[Column]) -> bool {
    NESTED.iter().any(|(_, nested)| {
        nested
            .iter()
            .map(|column| column.name)
            .eq(columns.iter().map(|column| column.name))
    })
}

fn document_columns(columns: &[Column], page: &mut String) {
    page.push_str("| column | type | meaning |\n|---|---|---|\n");
    for column in columns {
        let null = if column.nullable { ", may be null" } else { "" };
        page.push_str(&format!(
            "| `{}` | {}{null} | {} |\n",
            column.name,
            type_name(column.kind),
            column.meaning
        ));
    }
}

fn type_name(kind: ColumnType) -> String {
    match kind {
        Text => "text".into(),
        Flag => "boolean".into(),
        Int => "int32".into(),
        Long => "int64".into(),
        Unsigned => "decimal(20, 0)".into(),
        Float => "float64".into(),
        List(Struct(columns)) if has_section(columns) => "list, see below".into(),
        List(item) => format!("list of {}", type_name(*item)),
        Struct(columns) => {
            let inner: Vec<String> = columns
                .iter()
                .map(|column| format!("{} {}", column.name, type_name(column.kind)))
                .collect();
            format!("struct({})", inner.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `REEL_BLESS=1 cargo test -p reel-tables` rewrites the page.
    #[test]
    fn the_page_says_what_the_schemas_say() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../schemas/tables.md");
        if std::env::var_os("REEL_BLESS").is_some() {
            std::fs::write(path, document()).unwrap();
        }
        let page = std::fs::read_to_string(path).unwrap_or_default();
        assert_eq!(
            page,
            document(),
            "schemas/tables.md is stale: run REEL_BLESS=1 cargo test -p reel-tables"
        );
    }
}
