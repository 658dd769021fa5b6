//! The answer of a running query: handed on batch by batch, and stopped at its limits.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use arrow::{
    array::{RecordBatch, RecordBatchOptions},
    compute::cast,
    datatypes::{Field, Schema},
    error::ArrowError,
};
use datafusion::{error::DataFusionError, physical_plan::execute_stream, prelude::SessionContext};
use futures_util::StreamExt as _;
use tokio::sync::mpsc;

use super::{CacheScope, Inner, QueryError, Question};
use crate::{control::StopReason, estimate, limits, tables::plain, watched::watched};

/// How often a running query is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// How long a query that was told to stop may take to do so before it is left alone.
const GRACE: Duration = Duration::from_secs(1);
/// Batches of an answer that wait for who takes them.
pub(super) const AHEAD: usize = 4;

/// What a running query hands on.
pub(super) enum Part {
    Batch(RecordBatch),
    End(Result<CacheScope, QueryError>),
}

impl Inner {
    /// Hands the answer on, for no longer and with no more memory than is allowed. What does not
    /// listen is left alone.
    pub(super) fn watch(
        &self,
        mut answer: mpsc::Receiver<Part>,
        mut take: impl FnMut(RecordBatch) -> bool,
    ) -> Result<CacheScope, QueryError> {
        let (begun, resident_before) = (Instant::now(), limits::resident_bytes().unwrap_or(0));
        let memory = self.limits.memory_bytes.saturating_mul(4);
        let mut looked = begun;
        let stopped = loop {
            match self.next_part(&mut answer, LOOK_EVERY) {
                Ok(Some(Part::Batch(batch))) => {
                    if !take(batch) {
                        self.control.cancel();
                        return Ok(CacheScope::Uncacheable);
                    }
                    if looked.elapsed() < LOOK_EVERY {
                        continue;
                    }
                }
                Ok(Some(Part::End(end))) => return end,
                Ok(None) => {
                    return Err(QueryError::Engine(DataFusionError::Execution(
                        "the query engine panicked".into(),
                    )));
                }
                Err(_) => {}
            }
            looked = Instant::now();
            if self.control.is_cancelled() {
                break StopReason::Cancelled;
            }
            if begun.elapsed() > self.limits.time {
                break StopReason::Time {
                    seconds: self.limits.time.as_secs(),
                };
            }
            if limits::resident_bytes()
                .unwrap_or(0)
                .saturating_sub(resident_before)
                > memory
            {
                self.control.cancel();
                return Err(QueryError::Stopped(StopReason::Memory { bytes: memory }));
            }
        };
        self.control.cancel();
        let patience = Instant::now() + GRACE;
        while let Ok(Some(Part::Batch(_))) = self.next_part(
            &mut answer,
            patience.saturating_duration_since(Instant::now()),
        ) {}
        Err(QueryError::Stopped(stopped))
    }

    /// The next part of an answer, if it comes in time; none where the query's thread is gone.
    fn next_part(
        &self,
        answer: &mut mpsc::Receiver<Part>,
        patience: Duration,
    ) -> Result<Option<Part>, tokio::time::error::Elapsed> {
        self.runtime
            .block_on(async { tokio::time::timeout(patience, answer.recv()).await })
    }

    pub(super) async fn hand_on(
        &self,
        context: &SessionContext,
        question: Question,
        to: mpsc::Sender<Part>,
    ) -> Result<(), QueryError> {
        let rows_max = self.limits.rows;
        let state = context.state();
        let columns = Arc::new(question.plan.schema().as_arrow().clone());
        let tasks = state.task_ctx();
        let physical = match &question.optimized {
            Some(plan) => {
                let planner = state.query_planner();
                planner.create_physical_plan(plan, &state).await?
            }
            None => state.create_physical_plan(&question.plan).await?,
        };
        if self.remote_engine.is_none()
            && context.copied_config().batch_size() == estimate::BATCH_ROWS
            && let Some(rows) = estimate::batch_rows(&physical)?
        {
            // Tables that are made while planning have the size of their batches from then on.
            {
                let state = context.state_ref();
                let mut state = state.write();
                let options = state.config_mut().options_mut();
                options.set("datafusion.execution.batch_size", &rows.to_string())?;
            }
            return Box::pin(self.hand_on(context, question, to)).await;
        }
        let physical = match &self.remote_engine {
            Some(_) => physical,
            None => {
                estimate::check_plan(&physical)?;
                watched(physical, &self.control)?
            }
        };
        let mut answer = tokio::spawn(async move {
            let mut stream = execute_stream(physical, tasks)?;
            let (mut rows, mut empty) = (0, true);
            while let Some(batch) = stream.next().await {
                let batch = in_plain_types(&batch?)?;
                rows += batch.num_rows();
                if rows > rows_max {
                    return Err(DataFusionError::External(Box::new(StopReason::Rows {
                        rows: rows_max,
                    })));
                }
                empty = false;
                if to.send(Part::Batch(batch)).await.is_err() {
                    return Ok(());
                }
            }
            if empty {
                let empty = in_plain_types(&RecordBatch::new_empty(columns))?;
                let _ = to.send(Part::Batch(empty)).await;
            }
            Ok::<_, DataFusionError>(())
        });
        let cancelled = async {
            while !self.control.is_cancelled() {
                tokio::time::sleep(LOOK_EVERY).await;
            }
        };
        tokio::select! {
            answer = &mut answer => Ok(answer.map_err(|error| DataFusionError::ExecutionJoin(Box::new(error)))??),
            () = cancelled => {
                answer.abort();
                // another engine is told when the answer is let go of
                let _ = tokio::time::timeout(GRACE, answer).await;
                Err(QueryError::Stopped(StopReason::Cancelled))
            }
        }
    }
}

/// An answer in the types of the tables, however they were read.
fn in_plain_types(batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    let schema = batch.schema();
    let fields: Vec<Field> = schema
        .fields()
        .iter()
        .map(|field| {
            field
                .as_ref()
                .clone()
                .with_data_type(plain(field.data_type()))
        })
        .collect();
    let columns: Result<_, _> = batch
        .columns()
        .iter()
        .zip(&fields)
        .map(|(column, field)| cast(column, field.data_type()))
        .collect();
    let rows = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
    RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), columns?, &rows)
}
