//! Keys of a sort that are computed are computed once, before it. The engine would do so when it
//! sorts a batch, again for each merge, and where no query can be stopped.

use datafusion::{
    common::{DFSchema, tree_node::Transformed},
    error::DataFusionError,
    logical_expr::{Expr, LogicalPlan, LogicalPlanBuilder, SortExpr},
    prelude::col,
};

/// The same plan, whose sorts compare columns only. Keys that look out of their subquery stay.
pub(crate) fn precompute_sort_keys(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    let rewritten = plan.transform_up_with_subqueries(|node| {
        let LogicalPlan::Sort(sort) = &node else {
            return Ok(Transformed::no(node));
        };
        let computes = |key: &SortExpr| !matches!(key.expr, Expr::Column(_));
        if !sort.expr.iter().any(computes) || sort.expr.iter().any(|key| key.expr.contains_outer())
        {
            return Ok(Transformed::no(node));
        }
        let columns: Vec<Expr> = sort
            .input
            .schema()
            .columns()
            .into_iter()
            .map(Expr::Column)
            .collect();
        let (mut with_keys, mut order) = (columns.clone(), Vec::new());
        for (number, key) in sort.expr.iter().enumerate() {
            let column = if computes(key) {
                let name = unused_name(sort.input.schema(), number);
                with_keys.push(key.expr.clone().alias(&name));
                col(name)
            } else {
                key.expr.clone()
            };
            order.push(column.sort(key.asc, key.nulls_first));
        }
        let sorted = LogicalPlanBuilder::from(sort.input.clone())
            .project(with_keys)?
            .sort_with_limit(order, sort.fetch)?
            .project(columns)?
            .build()?;
        Ok(Transformed::yes(sorted))
    })?;
    Ok(rewritten.data)
}

/// A name that no column of the input has.
fn unused_name(schema: &DFSchema, number: usize) -> String {
    let mut name = format!("__sort_key_{number}");
    while schema.has_column_with_unqualified_name(&name) {
        name.push('_');
    }
    name
}
