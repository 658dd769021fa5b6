//! A run in a few sentences, each with its evidence: the named query `summary` over the episodes of a report.

use anyhow::Context as _;
use reel_query::{QuerySession, named};
use serde::{Deserialize, Serialize};

use crate::commands::query::rows;

/// A sentence and traces that show what it says.
#[derive(Clone, PartialEq, Debug, Deserialize, Serialize)]
pub(super) struct Statement {
    pub sentence: String,
    /// How many episodes it holds for.
    pub episodes: u64,
    /// How many it is a share of.
    pub of: u64,
    pub traces: Vec<String>,
}

/// The statements about these episodes, a table expression in SQL.
pub(super) fn statements(session: &QuerySession, these: &str) -> anyhow::Result<Vec<Statement>> {
    let query = named::by_name("summary").context("the query `summary` is built in")?;
    let body = query.sql.lines().skip_while(|line| line.starts_with("--"));
    let body = body.collect::<Vec<_>>().join("\n");
    let tables = body
        .strip_prefix("WITH ")
        .context("the query `summary` begins with its tables")?;
    // the query reads `episodes`: those of the report stand in front of the table
    rows(
        session,
        &format!("WITH episodes AS (SELECT * FROM {these}), {tables}"),
    )
}
