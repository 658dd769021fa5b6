//! A plan that can be stopped anywhere: before every batch that any of its operators takes from
//! another one, it is asked whether the query goes on. Engines look only where they read data, and
//! an operator that makes much of little never comes back to there. Never what stops a query.

use std::{
    fmt,
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
};

use arrow::{array::RecordBatch, datatypes::SchemaRef};
use datafusion::{
    common::tree_node::TreeNodeRecursion,
    error::Result,
    execution::{RecordBatchStream, SendableRecordBatchStream, TaskContext},
    physical_expr::PhysicalExpr,
    physical_plan::{
        ChildrenPropertiesMode, DisplayAs, DisplayFormatType, ExecutionPlan, PlanProperties,
        ReplaceChildrenOptions, metrics::MetricsSet,
    },
};
use futures_util::{Stream, StreamExt as _};

use crate::control::Control;

/// Batches after which an operator lets others have the thread, though it has more.
const BATCHES_IN_A_ROW: u32 = 64;

/// The same plan, whose every operator can be stopped.
pub(crate) fn watched(
    plan: Arc<dyn ExecutionPlan>,
    control: &Arc<Control>,
) -> Result<Arc<dyn ExecutionPlan>> {
    let children: Vec<_> = plan
        .children()
        .into_iter()
        .map(|child| watched(child.clone(), control))
        .collect::<Result<_>>()?;
    let inner = if children.is_empty() {
        plan
    } else {
        plan.replace_children(children, KEEP)?
    };
    Ok(Arc::new(Watched {
        inner,
        query: control.query(),
        control: control.clone(),
    }))
}

/// What is put in the place of a child has its properties.
const KEEP: ReplaceChildrenOptions = ReplaceChildrenOptions::new(ChildrenPropertiesMode::Keep);

/// An operator, in every respect but that it can be stopped.
#[derive(Debug)]
struct Watched {
    inner: Arc<dyn ExecutionPlan>,
    control: Arc<Control>,
    query: u64,
}

impl Watched {
    fn around(&self, inner: Arc<dyn ExecutionPlan>) -> Arc<dyn ExecutionPlan> {
        Arc::new(Self {
            inner,
            control: self.control.clone(),
            query: self.query,
        })
    }
}

impl DisplayAs for Watched {
    fn fmt_as(&self, kind: DisplayFormatType, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.inner.fmt_as(kind, f)
    }
}

impl ExecutionPlan for Watched {
    fn name(&self) -> &str {
        self.inner.name()
    }

    fn downcast_delegate(&self) -> Option<&dyn ExecutionPlan> {
        Some(self.inner.as_ref())
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        self.inner.properties()
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        self.inner.children()
    }

    fn apply_expressions(
        &self,
        visit: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> Result<TreeNodeRecursion>,
    ) -> Result<TreeNodeRecursion> {
        self.inner.apply_expressions(visit)
    }

    fn replace_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn ExecutionPlan>>,
        options: ReplaceChildrenOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        Ok(self.around(self.inner.clone().replace_children(children, options)?))
    }

    fn with_new_children(
        self: Arc<Self>,
        children: Vec<Arc<dyn ExecutionPlan>>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        self.replace_children(
            children,
            ReplaceChildrenOptions::new(ChildrenPropertiesMode::Recompute),
        )
    }

    fn reset_state(self: Arc<Self>) -> Result<Arc<dyn ExecutionPlan>> {
        Ok(self.around(self.inner.clone().reset_state()?))
    }

    fn with_new_state(
        &self,
        state: Arc<dyn std::any::Any + Send + Sync>,
    ) -> Option<Arc<dyn ExecutionPlan>> {
        Some(self.around(self.inner.with_new_state(state)?))
    }

    fn execute(
        &self,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        self.control.check_query(self.query)?;
        Ok(Box::pin(WatchedStream {
            inner: self.inner.execute(partition, context)?,
            control: self.control.clone(),
            query: self.query,
            in_a_row: 0,
        }))
    }

    fn metrics(&self) -> Option<MetricsSet> {
        self.inner.metrics()
    }
}

struct WatchedStream {
    inner: SendableRecordBatchStream,
    control: Arc<Control>,
    query: u64,
    in_a_row: u32,
}

impl Stream for WatchedStream {
    type Item = Result<RecordBatch>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        if let Err(stopped) = self.control.check_query(self.query) {
            return Poll::Ready(Some(Err(stopped)));
        }
        if self.in_a_row == BATCHES_IN_A_ROW {
            self.in_a_row = 0;
            context.waker().wake_by_ref();
            return Poll::Pending;
        }
        let next = self.inner.poll_next_unpin(context);
        self.in_a_row = match next {
            Poll::Ready(_) => self.in_a_row + 1,
            Poll::Pending => 0,
        };
        next
    }
}

impl RecordBatchStream for WatchedStream {
    fn schema(&self) -> SchemaRef {
        self.inner.schema()
    }
}
