//! Rows that name traces, partitioned so that many machines can work on them. Knows neither the
//! machines nor what is done.

use std::sync::Arc;

use datafusion::{
    common::{Column, tree_node::Transformed},
    error::DataFusionError,
    logical_expr::{Expr, LogicalPlan, LogicalPlanBuilder, Union, when},
    prelude::{col, lit},
};

use crate::functions;

/// The column of `episodes` by which functions open traces.
pub(crate) const TRACE: &str = "trace";
/// Parts into which a question that opens traces is cut for other machines: enough for the slow
/// ones not to be waited for long.
const PARTS: usize = 64;

/// Deals the rows that name traces out into parts, so that many machines can work on the functions
/// that open them: a table of many episodes may well be one file. Every part reads the file and
/// keeps what is its own. A condition may be looked at for rows that another one beside it leaves
/// out, so those have no trace.
pub(crate) fn partition_by_trace(plan: LogicalPlan) -> Result<LogicalPlan, DataFusionError> {
    let deal = |node: LogicalPlan| {
        let LogicalPlan::TableScan(scan) = &node else {
            return Ok(Transformed::no(node));
        };
        if !scan
            .projected_schema
            .has_column_with_unqualified_name(TRACE)
        {
            return Ok(Transformed::no(node));
        }
        let names: Vec<_> = scan
            .projected_schema
            .iter()
            .map(|(relation, field)| (relation.cloned(), field.name().clone()))
            .collect();
        let part = |part: usize| {
            let trace = Column::new(Some(scan.table_name.clone()), TRACE);
            let mine = functions::part_of(col(trace.clone()), PARTS as i64).eq(lit(part as i64));
            let own = when(mine.clone(), col(trace.clone()))
                .end()?
                .alias_qualified(trace.relation.clone(), TRACE);
            let column = |column: Column| {
                if column == trace {
                    own.clone()
                } else {
                    Expr::Column(column)
                }
            };
            let columns: Vec<Expr> = scan
                .projected_schema
                .columns()
                .into_iter()
                .map(column)
                .collect();
            let rows = LogicalPlanBuilder::from(node.clone()).filter(mine)?;
            Ok(Arc::new(rows.project(columns)?.build()?))
        };
        let parts = (0..PARTS)
            .map(part)
            .collect::<Result<Vec<_>, DataFusionError>>()?;
        let all =
            LogicalPlanBuilder::from(LogicalPlan::Union(Union::try_new_with_loose_types(parts)?));
        let columns = all.schema().columns().into_iter().zip(names);
        let named = columns.map(|(column, (relation, name))| {
            Expr::Column(Column::from_name(column.name)).alias_qualified(relation, name)
        });
        Ok(Transformed::yes(
            all.project(named.collect::<Vec<_>>())?.build()?,
        ))
    };
    Ok(plan.transform_up_with_subqueries(deal)?.data)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use arrow::{
        array::{ArrayRef, AsArray as _, Int64Array, RecordBatch, StringArray},
        datatypes::DataType,
        util::pretty::pretty_format_batches,
    };
    use datafusion::{
        logical_expr::{ColumnarValue, Volatility, create_udf},
        prelude::SessionContext,
    };

    use super::*;
    use crate::session::equip;

    /// Every row is in one part, and a function that opens traces is given each of them once,
    /// wherever the optimiser puts it.
    #[tokio::test]
    async fn dealt_rows_are_the_same_rows_and_no_trace_is_opened_twice() {
        // of few rows most are in the same batch as those that a part leaves out
        for count in [3, 500] {
            let names: ArrayRef = Arc::new(
                (0..count)
                    .map(|number| Some(format!("trace-{number}.mcap")))
                    .collect::<StringArray>(),
            );
            let table =
                RecordBatch::try_from_iter([("episode", names.clone()), (TRACE, names)]).unwrap();
            for sql in [
                "SELECT episode, opened(trace) AS length FROM episodes ORDER BY episode",
                "SELECT e.episode, opened(e.trace) AS length, opened(e.trace) + 1 AS more FROM episodes AS e ORDER BY e.episode",
                "SELECT episode FROM episodes WHERE opened(trace) > 12 ORDER BY episode",
                "SELECT opened(trace) AS length, count(*) AS n FROM episodes GROUP BY 1 ORDER BY 1",
            ] {
                let [(here, _, opened_here), (partitioned, scans, opened)] = [
                    answer(&table, sql, false).await,
                    answer(&table, sql, true).await,
                ];
                assert_eq!(partitioned, here, "{sql}");
                assert_eq!([opened_here, opened], [count; 2], "{sql}");
                assert_eq!(scans, PARTS, "{sql}");
            }
        }
    }

    /// What a question gives, how often its plan reads the table, and how many traces it opens.
    async fn answer(table: &RecordBatch, sql: &str, deals: bool) -> (String, usize, usize) {
        let opened = Arc::new(AtomicUsize::new(0));
        let counted = opened.clone();
        let open = move |arguments: &[ColumnarValue]| {
            let traces = ColumnarValue::values_to_arrays(arguments)?;
            let traces = traces[0].as_string::<i32>();
            counted.fetch_add(traces.iter().flatten().count(), Ordering::Relaxed);
            let lengths: Int64Array = traces
                .iter()
                .map(|trace| Some(trace?.len() as i64))
                .collect();
            Ok(ColumnarValue::Array(Arc::new(lengths)))
        };
        let context = SessionContext::new();
        equip(&context, &Arc::default());
        let (text, number) = (DataType::Utf8, DataType::Int64);
        context.register_udf(create_udf(
            "opened",
            vec![text],
            number,
            Volatility::Stable,
            Arc::new(open),
        ));
        context.register_batch("episodes", table.clone()).unwrap();
        let plan = context.sql(sql).await.unwrap().into_unoptimized_plan();
        let plan = if deals {
            partition_by_trace(plan).unwrap()
        } else {
            plan
        };
        let scans = plan
            .display_indent()
            .to_string()
            .matches("TableScan")
            .count();
        let rows = context
            .execute_logical_plan(plan)
            .await
            .unwrap()
            .collect()
            .await
            .unwrap();
        (
            pretty_format_batches(&rows).unwrap().to_string(),
            scans,
            opened.load(Ordering::Relaxed),
        )
    }
}
