//! Many questions about single episodes as one: `SELECT value FROM episodes WHERE condition`, asked
//! in one pass over the table. Plans nothing and runs nothing.

use std::collections::BTreeSet;
use std::ops::ControlFlow;

use datafusion::sql::{
    parser::{DFParser, Statement},
    sqlparser::ast::{self, AccessExpr, Expr, SelectItem, SetExpr, TableFactor},
};

/// A question about each episode by itself.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct RowExpression {
    value: String,
    condition: Option<String>,
    columns: BTreeSet<String>,
}

impl RowExpression {
    /// Reads `SELECT <expression> AS found FROM episodes [WHERE <condition>]`. Nothing else may be
    /// in it, so that it sees the one row of its episode and nothing beside it.
    ///
    /// # Errors
    /// What it is instead.
    pub fn parse(sql: &str) -> Result<Self, String> {
        let statements = DFParser::parse_sql(sql).map_err(|error| error.to_string())?;
        let [Statement::Statement(statement)] = statements.iter().collect::<Vec<_>>()[..] else {
            return Err("it has to be one SELECT".into());
        };
        let ast::Statement::Query(query) = statement.as_ref() else {
            return Err("it has to be a SELECT".into());
        };
        let SetExpr::Select(select) = query.body.as_ref() else {
            return Err("it has to be a single SELECT".into());
        };
        let plain = query.with.is_none()
            && query.order_by.is_none()
            && query.limit_clause.is_none()
            && query.fetch.is_none();
        let [from] = &select.from[..] else {
            return Err("it has to read from `episodes` and nothing else".into());
        };
        let is_episodes = from.joins.is_empty()
            && matches!(&from.relation, TableFactor::Table { name, alias: None, args: None, .. } if name.to_string() == "episodes");
        if !is_episodes {
            return Err("it has to read from `episodes` and nothing else".into());
        }
        let grouped =
            !matches!(&select.group_by, ast::GroupByExpr::Expressions(by, _) if by.is_empty());
        if !plain || grouped || select.distinct.is_some() || select.having.is_some() {
            return Err("it has to be SELECT ... FROM episodes WHERE ..., without WITH, GROUP BY, ORDER BY or LIMIT".into());
        }
        let [SelectItem::ExprWithAlias { expr, alias }] = &select.projection[..] else {
            return Err("it has to select one expression, AS found".into());
        };
        if alias.value != "found" {
            return Err(format!(
                "its expression has to be called `found`, not `{}`",
                alias.value
            ));
        }
        let mut columns = BTreeSet::new();
        // Fields of a struct, which are visited after the expression that they belong to.
        let mut fields = Vec::new();
        let looked = ast::visit_expressions(statement.as_ref(), |expression| match expression {
            Expr::CompoundFieldAccess { access_chain, .. } => {
                fields.extend(access_chain.iter().filter_map(|access| match access {
                    AccessExpr::Dot(Expr::Identifier(name)) => Some(name.value.clone()),
                    _ => None,
                }));
                ControlFlow::Continue(())
            }
            Expr::Identifier(name) => {
                match fields.iter().position(|field| *field == name.value) {
                    Some(field) => drop(fields.swap_remove(field)),
                    None => drop(columns.insert(name.value.clone())),
                }
                ControlFlow::Continue(())
            }
            Expr::Subquery(_) | Expr::Exists { .. } | Expr::InSubquery { .. } => {
                ControlFlow::Break(())
            }
            _ => ControlFlow::Continue(()),
        });
        if looked.is_break() {
            return Err("it must not hold another SELECT".into());
        }
        Ok(Self {
            value: expr.to_string(),
            condition: select.selection.as_ref().map(ToString::to_string),
            columns,
        })
    }

    /// Columns of `episodes` that it names.
    pub fn columns(&self) -> &BTreeSet<String> {
        &self.columns
    }
}

/// One query that answers all of them for the episodes that fulfil `filter`: the columns `keep`,
/// and for each question the value (`found_0`, `found_1`, ...) and whether its condition holds
/// (`holds_0`, ...; false where that is null).
pub fn fuse(keep: &[&str], questions: &[&RowExpression], filter: &str) -> String {
    let mut columns: Vec<String> = keep.iter().map(|column| (*column).to_owned()).collect();
    for (index, question) in questions.iter().enumerate() {
        columns.push(format!("({}) AS found_{index}", question.value));
        let condition = question.condition.as_deref().unwrap_or("true");
        columns.push(format!("({condition}) IS TRUE AS holds_{index}"));
    }
    format!("SELECT {} FROM episodes WHERE {filter}", columns.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn questions_about_one_row_are_fused() {
        let one =
            RowExpression::parse("-- what\nSELECT oscillation(steps) AS found FROM episodes WHERE end_reason = 'horizon'").unwrap();
        let two = RowExpression::parse("SELECT length AS found FROM episodes").unwrap();
        let field = RowExpression::parse("SELECT oscillation(steps).length AS found FROM episodes");
        assert_eq!(
            field.unwrap().columns().iter().collect::<Vec<_>>(),
            ["steps"]
        );
        assert_eq!(
            one.columns().iter().collect::<Vec<_>>(),
            ["end_reason", "steps"]
        );
        assert_eq!(
            fuse(&["episode_id"], &[&one, &two], "NOT success"),
            "SELECT episode_id, (oscillation(steps)) AS found_0, (end_reason = 'horizon') IS TRUE AS holds_0, \
             (length) AS found_1, (true) IS TRUE AS holds_1 FROM episodes WHERE NOT success"
        );
    }

    #[test]
    fn what_sees_more_than_its_row_is_refused() {
        for (sql, complaint) in [
            ("SELECT class AS found FROM labels", "from `episodes`"),
            (
                "SELECT 1 AS found FROM episodes JOIN labels ON true",
                "from `episodes`",
            ),
            ("SELECT 1 AS found FROM episodes, labels", "from `episodes`"),
            (
                "SELECT (SELECT max(step) FROM labels) AS found FROM episodes",
                "another SELECT",
            ),
            (
                "SELECT 1 AS found FROM episodes WHERE episode_id IN (SELECT episode_id FROM labels)",
                "another SELECT",
            ),
            (
                "SELECT 1 AS found FROM episodes WHERE EXISTS (SELECT 1 FROM labels)",
                "another SELECT",
            ),
            (
                "SELECT max(length) AS found FROM episodes GROUP BY policy",
                "without WITH",
            ),
            (
                "WITH x AS (SELECT 1) SELECT 1 AS found FROM episodes",
                "without WITH",
            ),
            ("SELECT 1 AS step FROM episodes", "called `found`"),
            (
                "SELECT 1 AS found, 2 AS more FROM episodes",
                "one expression",
            ),
            ("DELETE FROM episodes", "SELECT"),
            ("SELECT 1 AS found FROM episodes; SELECT 2", "one SELECT"),
            ("SELECT", "xpected"),
        ] {
            let refused = RowExpression::parse(sql).unwrap_err();
            assert!(refused.contains(complaint), "{sql}: {refused}");
        }
    }
}
