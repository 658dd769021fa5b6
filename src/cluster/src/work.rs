//! Work on traces that is no SQL: done by executors under a name, in parcels that
//! come back as bytes.

use std::{borrow::Cow, path::PathBuf, sync::Arc, thread};

use datafusion::{
    arrow::{
        array::{Array as _, ArrayRef, AsArray as _, BinaryBuilder, RecordBatch},
        datatypes::{DataType, Int64Type},
    },
    common::exec_err,
    error::Result,
    execution::{FunctionRegistry as _, SessionState},
    logical_expr::{
        ColumnarValue, Expr, LogicalPlan, LogicalPlanBuilder, ScalarUDF, Union, Volatility,
        create_udf, expr::ScalarFunction,
    },
    prelude::{col, lit},
};
use reel_query::{STACK_BYTES, TraceAccess};
use serde::{Deserialize, Serialize};

/// The SQL function that executors do work by. Nobody else has it.
const NAME: &str = "reel_work";
/// First byte of an answer.
const DONE: u8 = 0;
/// First byte of an answer that is a reason.
const REFUSED: u8 = 1;

/// Something that can be done with traces.
#[derive(Clone)]
pub struct TraceJob {
    /// What it is called.
    pub name: &'static str,
    /// Whether it is given traces, which an executor has to be allowed to open; else
    /// names that options explain.
    pub traces: bool,
    /// Does it with some of them. Options and answer are for whoever asks, which is the
    /// same build of Reel.
    pub run: Arc<Run>,
}

/// What work on traces is: options to an answer, or the reason why there is none.
pub type Run = dyn Fn(&[PathBuf], &str) -> Result<Vec<u8>, String> + Send + Sync;

impl std::fmt::Debug for TraceJob {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

/// Answers by group; the reason where an executor refused.
pub(crate) type GroupResults = Vec<(usize, std::result::Result<Vec<u8>, String>)>;

/// What is done with some traces.
#[derive(Serialize, Deserialize)]
struct TraceBatch<'a> {
    /// Of the program that asks.
    build: Cow<'a, str>,
    work: Cow<'a, str>,
    options: Cow<'a, str>,
    traces: Vec<PathBuf>,
}

/// Who does work, and for whom.
#[derive(Clone, Debug)]
pub(crate) struct Worker {
    pub build: String,
    pub works: Vec<TraceJob>,
    pub opens: TraceAccess,
}

impl Worker {
    /// Of who only passes plans on.
    pub(crate) fn nobody() -> Self {
        Self {
            build: String::new(),
            works: Vec::new(),
            opens: TraceAccess::Nothing,
        }
    }

    /// Adds the function to what an engine knows.
    pub(crate) fn equip(self, state: &mut SessionState) -> Result<()> {
        state.register_udf(Arc::new(self.function())).map(drop)
    }

    fn function(self) -> ScalarUDF {
        let work = move |arguments: &[ColumnarValue]| {
            let arrays = ColumnarValue::values_to_arrays(arguments)?;
            let parcels = arrays[0].as_string::<i32>();
            let mut answers = BinaryBuilder::new();
            for row in 0..parcels.len() {
                answers.append_value(match self.answer(parcels.value(row)) {
                    Ok(bytes) => [&[DONE], &*bytes].concat(),
                    Err(reason) => [&[REFUSED], reason.as_bytes()].concat(),
                });
            }
            Ok(ColumnarValue::Array(Arc::new(answers.finish()) as ArrayRef))
        };
        // volatile: nobody may work it out while planning
        create_udf(
            NAME,
            vec![DataType::Utf8],
            DataType::Binary,
            Volatility::Volatile,
            Arc::new(work),
        )
    }

    fn answer(&self, parcel: &str) -> Result<Vec<u8>, String> {
        let parcel: TraceBatch<'_> =
            serde_json::from_str(parcel).map_err(|error| format!("invalid work item: {error}"))?;
        if parcel.build != self.build {
            let (theirs, ours) = (&parcel.build, &self.build);
            return Err(format!(
                "an executor is of build {ours}, who asks is of build {theirs}: both have to be the same"
            ));
        }
        let Some(work) = self.works.iter().find(|work| work.name == parcel.work) else {
            return Err(format!(
                "an executor knows no work called '{}'",
                parcel.work
            ));
        };
        if let Some(trace) = parcel
            .traces
            .iter()
            .find(|trace| work.traces && !self.opens.allows(trace))
        {
            let trace = trace.display();
            return Err(format!(
                "an executor may not open {trace}: its folder is none of those named by `reel cluster executor --traces`"
            ));
        }
        // on a thread of its own: work may wait, and one that panics ends only its own thread
        let thread = thread::Builder::new().stack_size(STACK_BYTES);
        let done = thread::scope(|scope| {
            let thread = thread.spawn_scoped(scope, || (work.run)(&parcel.traces, &parcel.options));
            Ok(thread
                .map_err(|error| format!("an executor cannot start a thread: {error}"))?
                .join())
        });
        let panicked = || {
            format!(
                "'{}' panicked on an executor; do it without the cluster and report what it prints",
                work.name
            )
        };
        done.and_then(|done| done.unwrap_or_else(|_| Err(panicked())))
    }
}

/// A plan that does work on groups of traces, each group a part of its own, and gives the group's
/// number with its answer.
pub(crate) fn plan(
    build: &str,
    work: &str,
    options: &str,
    groups: &[(usize, &[PathBuf])],
    state: &SessionState,
) -> Result<LogicalPlan> {
    let function = state.udf(NAME)?;
    let one = |(number, traces): &(usize, &[PathBuf])| {
        let parcel = serde_json::to_string(&TraceBatch {
            build: build.into(),
            work: work.into(),
            options: options.into(),
            traces: traces.to_vec(),
        });
        let parcel = parcel
            .map_err(|error| datafusion::error::DataFusionError::External(Box::new(error)))?;
        let values = LogicalPlanBuilder::values(vec![vec![lit(*number as i64), lit(parcel)]])?;
        let done = Expr::ScalarFunction(ScalarFunction::new_udf(
            function.clone(),
            vec![col("column2")],
        ));
        Ok(Arc::new(
            values
                .project([col("column1"), done.alias("answer")])?
                .build()?,
        ))
    };
    let mut parts = groups
        .iter()
        .map(one)
        .collect::<Result<Vec<Arc<LogicalPlan>>>>()?;
    match parts.len() {
        1 => Ok(Arc::unwrap_or_clone(parts.remove(0))),
        _ => Ok(LogicalPlan::Union(Union::try_new_with_loose_types(parts)?)),
    }
}

/// What a plan gave.
pub(crate) fn answers(batches: &[RecordBatch]) -> Result<GroupResults> {
    let mut answers = Vec::new();
    for batch in batches {
        let (numbers, bytes) = (
            batch.column(0).as_primitive::<Int64Type>(),
            batch.column(1).as_binary::<i32>(),
        );
        for row in 0..batch.num_rows() {
            let number = numbers.value(row) as usize;
            answers.push(match bytes.value(row).split_first() {
                Some((&DONE, answer)) => (number, Ok(answer.to_vec())),
                Some((&REFUSED, reason)) => {
                    (number, Err(String::from_utf8_lossy(reason).into_owned()))
                }
                _ => return exec_err!("an executor gave an empty answer"),
            });
        }
    }
    Ok(answers)
}
