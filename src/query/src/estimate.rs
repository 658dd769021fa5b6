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
        windows::{BoundedWindowAggExec, WindowAggExec},
    },
    sql::{
        parser::Statement,
        sqlparser::ast::{self, Visit as _},
    },
};

use crate::control::StopReason;

/// Most rows that a join without a key may make: at a hundred million a second, hours of work.
const ROWS_MAX: f64 = 1e12;

/// Most subqueries and tables of a question once every name stands for its query: planning writes all
/// of them out.
const READS_MAX: u64 = 300;

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
        let sum = reads.iter().fold(1_u64, |sum, read| {
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

/// Rows that an operator makes.
#[derive(Clone, Copy)]
struct Rows {
    /// As an estimate, from above for joins without a key.
    made: f64,
    /// Whether every table below tells how many rows it has.
    known: bool,
}

fn rows(plan: &Arc<dyn ExecutionPlan>, statistics: &StatisticsContext) -> Result<Rows> {
    let children: Vec<Rows> = plan
        .children()
        .into_iter()
        .map(|child| rows(child, statistics))
        .collect::<Result<_>>()?;
    check_windows(plan, &children)?;
    let known = children.iter().all(|child| child.known);
    let made = |made: f64| Rows { made, known };
    let without_key = plan.is::<CrossJoinExec>() || plan.is::<NestedLoopJoinExec>();
    if without_key {
        let rows: f64 = children.iter().map(|child| child.made.max(1.0)).product();
        return if rows > ROWS_MAX {
            Err(refused(StopReason::Estimate { rows }))
        } else {
            Ok(made(rows))
        };
    }
    if plan.is::<UnionExec>() {
        return Ok(made(children.iter().map(|child| child.made).sum()));
    }
    let told = statistics.compute(plan.as_ref(), &StatisticsArgs::new());
    let told = told
        .ok()
        .and_then(|told| told.num_rows.get_value().copied());
    let told = told.map(|rows| rows as f64);
    let most = children.iter().map(|child| child.made).reduce(f64::max);
    Ok(match (most, told) {
        (Some(most), Some(told)) => made(most.min(told)),
        (Some(most), None) => made(most),
        (None, told) => Rows {
            made: told.unwrap_or(1.0),
            known: told.is_some(),
        },
    })
}

/// Refuses windows that compute an aggregate anew for every row from all rows before it: nothing
/// stops that within a batch.
fn check_windows(plan: &Arc<dyn ExecutionPlan>, input: &[Rows]) -> Result<()> {
    let expressions = match (
        plan.downcast_ref::<WindowAggExec>(),
        plan.downcast_ref::<BoundedWindowAggExec>(),
    ) {
        (Some(plan), _) => plan.window_expr(),
        (_, Some(plan)) => plan.window_expr(),
        _ => return Ok(()),
    };
    if input
        .iter()
        .all(|rows| rows.known && rows.made <= WINDOW_ROWS_MAX)
    {
        return Ok(());
    }
    for expression in expressions {
        let frame = expression.get_window_frame();
        let whole = frame.start_bound.is_unbounded() && frame.end_bound.is_unbounded();
        let called = |function: &&&str| {
            let rest = expression.name().strip_prefix(**function);
            rest.is_some_and(|rest| rest.starts_with('('))
        };
        if let Some(function) = HOLISTIC.iter().find(called).filter(|_| !whole) {
            return Err(refused(StopReason::Window {
                function: (*function).to_owned(),
                limit: WINDOW_ROWS_MAX as u64,
            }));
        }
    }
    Ok(())
}

/// Rows up to which any aggregate may move over them.
const WINDOW_ROWS_MAX: f64 = 20_000.0;

/// Aggregates that have to look at all their values again for every row.
const HOLISTIC: [&str; 9] = [
    "median",
    "percentile_cont",
    "approx_median",
    "approx_percentile_cont",
    "approx_percentile_cont_with_weight",
    "array_agg",
    "string_agg",
    "quantile_cont",
    "mode",
];
