//! How much work a question is going to be at least, as far as its text, its plan and the row counts
//! of the store's files tell. Refuses what no limit on time would let end. Runs nothing.

use std::{collections::BTreeMap, ops::ControlFlow, sync::Arc};

use datafusion::{
    error::{DataFusionError, Result},
    physical_plan::{
        ExecutionPlan,
        joins::{CrossJoinExec, NestedLoopJoinExec},
        statistics::{StatisticsArgs, StatisticsContext},
        union::UnionExec,
    },
    sql::{
        parser::Statement,
        sqlparser::ast::{self, Visit as _},
    },
};

use crate::control::StopReason;

/// Most rows that a join without a key may make: at a hundred million a second, hours of work.
const ROWS_MAX: f64 = 1e12;

/// Most times that a question may read tables once every name stands for its query: planning writes
/// all of them out, and cannot be stopped while it does.
const READS_MAX: u64 = 1_000;

/// Refuses a question whose subqueries repeat each other too often.
pub(crate) fn check_text(statement: &Statement) -> Result<()> {
    let statement = match statement {
        Statement::Explain(explain) => return check_text(&explain.statement),
        Statement::Statement(statement) => statement,
        _ => return Ok(()),
    };
    let mut subqueries = Subqueries::default();
    let _ = statement.visit(&mut subqueries);
    let mut known = BTreeMap::new();
    let reads = relations(statement.as_ref())
        .iter()
        .fold(0, |sum: u64, name| {
            sum.saturating_add(subqueries.reads(name, &mut known))
        });
    if reads > READS_MAX {
        return Err(refused(StopReason::Expansion {
            reads,
            limit: READS_MAX,
        }));
    }
    Ok(())
}

/// Refuses a plan that would pair more rows with each other than anyone waits for.
pub(crate) fn check_plan(plan: &Arc<dyn ExecutionPlan>) -> Result<()> {
    rows(plan, &StatisticsContext::new()).map(|_| ())
}

fn refused(reason: StopReason) -> DataFusionError {
    DataFusionError::External(Box::new(reason))
}

/// Subqueries by name (`WITH name AS`), with the tables and subqueries that each reads.
#[derive(Default)]
struct Subqueries(BTreeMap<String, Vec<String>>);

impl ast::Visitor for Subqueries {
    type Break = ();

    fn pre_visit_query(&mut self, query: &ast::Query) -> ControlFlow<()> {
        for subquery in query.with.iter().flat_map(|with| &with.cte_tables) {
            let name = subquery.alias.name.value.to_lowercase();
            let reads = self.0.entry(name).or_default();
            reads.extend(relations(subquery.query.as_ref()));
        }
        ControlFlow::Continue(())
    }
}

impl Subqueries {
    /// How many queries and tables a name stands for. One that reads itself counts as a table there.
    fn reads(&self, name: &str, known: &mut BTreeMap<String, u64>) -> u64 {
        let Some(reads) = self.0.get(name) else {
            return 1;
        };
        if let Some(known) = known.get(name) {
            return *known;
        }
        known.insert(name.to_owned(), 1);
        let sum = reads.iter().fold(0_u64, |sum, read| {
            sum.saturating_add(self.reads(read, known))
        });
        known.insert(name.to_owned(), sum);
        sum
    }
}

/// Names of what a part of a statement reads, each as often as it does.
fn relations(part: &impl ast::Visit) -> Vec<String> {
    let mut names = Vec::new();
    let _ = ast::visit_relations(part, |name| {
        names.push(name.to_string().to_lowercase());
        ControlFlow::<()>::Continue(())
    });
    names
}

/// Rows that an operator makes, as an estimate from above for joins without a key.
fn rows(plan: &Arc<dyn ExecutionPlan>, statistics: &StatisticsContext) -> Result<f64> {
    let children: Vec<f64> = plan
        .children()
        .into_iter()
        .map(|child| rows(child, statistics))
        .collect::<Result<_>>()?;
    let without_key = plan.is::<CrossJoinExec>() || plan.is::<NestedLoopJoinExec>();
    if without_key {
        let made: f64 = children.iter().map(|rows| rows.max(1.0)).product();
        return if made > ROWS_MAX {
            Err(refused(StopReason::Estimate { rows: made }))
        } else {
            Ok(made)
        };
    }
    if plan.is::<UnionExec>() {
        return Ok(children.iter().sum());
    }
    let known = statistics.compute(plan.as_ref(), &StatisticsArgs::new());
    let known = known
        .ok()
        .and_then(|known| known.num_rows.get_value().copied());
    let most = children.into_iter().reduce(f64::max);
    Ok(match (most, known.map(|rows| rows as f64)) {
        (Some(most), Some(known)) => most.min(known),
        (most, known) => known.or(most).unwrap_or(1.0),
    })
}
