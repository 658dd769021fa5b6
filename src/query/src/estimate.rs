//! How much work a question is going to be at least, as far as its text, its plan and the row
//! counts of the store's files tell. Refuses what no limit on time would let end. Runs nothing.

use std::{collections::BTreeMap, ops::ControlFlow, sync::Arc};

use arrow::datatypes::DataType;
use datafusion::{
    common::{
        JoinType,
        tree_node::{TreeNode as _, TreeNodeRecursion},
    },
    error::{DataFusionError, Result},
    logical_expr::{Expr, LogicalPlan, WindowFrameBound, WindowFrameUnits},
    physical_expr::expressions::Literal,
    physical_plan::{
        ExecutionPlan,
        joins::{CrossJoinExec, NestedLoopJoinExec},
        statistics::{StatisticsArgs, StatisticsContext},
        union::UnionExec,
        windows::{BoundedWindowAggExec, WindowAggExec},
    },
    scalar::ScalarValue,
    sql::{
        parser::Statement,
        sqlparser::ast::{self, Visit as _},
    },
};

use crate::control::StopReason;

/// Most rows that a join without a key may make: at a hundred million a second, months of work.
const ROWS_MAX: f64 = 1e15;

/// Most subqueries and tables of a question once every name stands for its query: planning writes
/// all of them out.
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
    let read = match statement.as_ref() {
        ast::Statement::Query(query) => body(query),
        other => relations(other),
    };
    let reads = read.iter().fold(0_u64, |sum, name| {
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

/// Refuses a question whose conditions hold subqueries that hold subqueries, and so on: the engine
/// checks each of them twice for every time that it checks the one around it.
pub(crate) fn check_nesting(plan: &LogicalPlan) -> Result<()> {
    let depth = nesting(plan)?;
    if depth > NESTING_MAX {
        return Err(refused(StopReason::Nesting {
            depth,
            limit: NESTING_MAX,
        }));
    }
    Ok(())
}

/// How deep subqueries in the expressions of a plan stand in each other.
fn nesting(plan: &LogicalPlan) -> Result<usize> {
    let mut deepest = 0;
    plan.apply(|node| {
        node.apply_expressions(|expression| {
            expression.apply(|part| {
                let inner = match part {
                    Expr::Exists(exists) => Some(&exists.subquery),
                    Expr::InSubquery(listed) => Some(&listed.subquery),
                    Expr::ScalarSubquery(scalar) => Some(scalar),
                    _ => None,
                };
                if let Some(inner) = inner {
                    deepest = deepest.max(1 + nesting(&inner.subquery)?);
                }
                Ok(TreeNodeRecursion::Continue)
            })
        })
    })?;
    Ok(deepest)
}

/// Refuses a plan that would pair more rows with each other than anyone waits for.
pub(crate) fn check_plan(plan: &Arc<dyn ExecutionPlan>) -> Result<()> {
    rows(plan, &StatisticsContext::new()).map(|_| ())
}

/// The rows of a batch with which the constants of a plan, written out for each row, stay small;
/// none where any number does.
pub(crate) fn batch_rows(plan: &Arc<dyn ExecutionPlan>) -> Result<Option<usize>> {
    let largest = largest_constant(plan)?;
    let rows = CONSTANTS_BYTES / largest.max(1);
    Ok((rows < BATCH_ROWS).then_some(rows.max(1)))
}

/// Size of the largest constant of a plan, in bytes.
fn largest_constant(plan: &Arc<dyn ExecutionPlan>) -> Result<usize> {
    let mut largest = 0;
    plan.apply_expressions(&mut |expression| {
        expression.apply(|part| {
            if let Some(constant) = part.downcast_ref::<Literal>() {
                largest = largest.max(constant.value().size());
            }
            Ok(TreeNodeRecursion::Continue)
        })
    })?;
    for child in plan.children() {
        largest = largest.max(largest_constant(child)?);
    }
    Ok(largest)
}

/// Rows of a batch of the engine, unless it is told otherwise.
pub(crate) const BATCH_ROWS: usize = 8_192;

/// What a constant may come to, written out for the rows of a batch, in bytes.
const CONSTANTS_BYTES: usize = 4 << 20;

/// Most subqueries that stand in each other's conditions.
const NESTING_MAX: usize = 12;

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
            self.0
                .entry(name)
                .or_default()
                .extend(body(&subquery.query));
        }
        ControlFlow::Continue(())
    }
}

impl Subqueries {
    /// How many queries and tables a name stands for. One that reads itself counts as a table
    /// there.
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

/// Names of what a query reads beside its own subqueries.
fn body(query: &ast::Query) -> Vec<String> {
    let mut query = query.clone();
    query.with = None;
    relations(&query)
}

/// Names of what a part of a statement reads, each as often as it does.
fn relations(part: &impl ast::Visit) -> Vec<String> {
    let mut names = Vec::new();
    let _ = ast::visit_relations(part, |name| {
        let last = name.0.last().and_then(|part| part.as_ident());
        names.push(
            last.map_or_else(|| name.to_string(), |name| name.value.clone())
                .to_lowercase(),
        );
        ControlFlow::<()>::Continue(())
    });
    names
}

/// Rows that an operator makes.
#[derive(Clone, Copy)]
struct Rows {
    /// As an estimate, by the product of the inputs for joins without a key.
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
    let loops = plan.downcast_ref::<NestedLoopJoinExec>();
    let without_key = plan.is::<CrossJoinExec>()
        || loops.is_some_and(|join| {
            let kinds = [
                JoinType::Inner,
                JoinType::Left,
                JoinType::Right,
                JoinType::Full,
            ];
            kinds.contains(join.join_type())
        });
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

/// Refuses windows that compute an aggregate anew for every row from all rows before it, of a large
/// table as a whole: nothing stops that within a batch.
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
        let narrow = frame.units == WindowFrameUnits::Rows
            && [&frame.start_bound, &frame.end_bound]
                .into_iter()
                .all(is_near);
        let parted = !expression.partition_by().is_empty() && input.iter().all(|rows| rows.known);
        let called = |function: &&&str| {
            let rest = expression.name().strip_prefix(**function);
            rest.is_some_and(|rest| rest.starts_with('('))
        };
        // Over the whole table others come to one value, and these to a list as long as the table,
        // for each of its rows.
        let once = |function: &&&str| whole && !COLLECTING.contains(function);
        if let Some(function) = HOLISTIC
            .iter()
            .find(called)
            .filter(|function| !(once(function) || narrow || parted))
        {
            return Err(refused(StopReason::Window {
                function: (*function).to_owned(),
                limit: WINDOW_ROWS_MAX as u64,
            }));
        }
    }
    Ok(())
}

/// Whether a bound of a frame is at most a thousand rows away.
fn is_near(bound: &WindowFrameBound) -> bool {
    match bound {
        WindowFrameBound::CurrentRow => true,
        WindowFrameBound::Preceding(rows) | WindowFrameBound::Following(rows) => {
            let rows = rows.cast_to(&DataType::UInt64);
            matches!(rows, Ok(ScalarValue::UInt64(Some(rows))) if rows <= 1_000)
        }
    }
}

/// Rows up to which any aggregate may move over them.
const WINDOW_ROWS_MAX: f64 = 20_000.0;

/// Aggregates whose value grows with the rows.
const COLLECTING: [&str; 2] = ["array_agg", "string_agg"];

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
