//! How much work a plan is at least going to be, as far as its shape and the row counts of the
//! store's files tell. Refuses what no limit on time would let end. Runs nothing.

use std::sync::Arc;

use datafusion::{
    error::{DataFusionError, Result},
    physical_plan::{
        ExecutionPlan,
        joins::{CrossJoinExec, NestedLoopJoinExec},
        union::UnionExec,
    },
};

use crate::control::StopReason;

/// Most rows that an operator may have to make: at a hundred million a second, hours of work.
const ROWS_MAX: f64 = 1e12;

/// Refuses a plan that would pair more rows with each other than anyone waits for.
pub(crate) fn check(plan: &Arc<dyn ExecutionPlan>) -> Result<()> {
    rows(plan).map(|_| ())
}

/// Rows that an operator makes, as an estimate from above for joins without a key.
fn rows(plan: &Arc<dyn ExecutionPlan>) -> Result<f64> {
    let children: Vec<f64> = plan
        .children()
        .into_iter()
        .map(rows)
        .collect::<Result<_>>()?;
    let known = || {
        let statistics = plan.partition_statistics(None).ok()?;
        Some(*statistics.num_rows.get_value()? as f64)
    };
    let pairs = plan.is::<CrossJoinExec>() || plan.is::<NestedLoopJoinExec>();
    let made = if pairs {
        children.iter().map(|rows| rows.max(1.0)).product()
    } else if plan.is::<UnionExec>() {
        children.iter().sum()
    } else {
        let most = children.into_iter().reduce(f64::max);
        let known = known();
        match (most, known) {
            (Some(most), Some(known)) => most.min(known),
            (most, known) => known.or(most).unwrap_or(1.0),
        }
    };
    if pairs && made > ROWS_MAX {
        return Err(DataFusionError::External(Box::new(
            StopReason::Estimate { rows: made },
        )));
    }
    Ok(made)
}
