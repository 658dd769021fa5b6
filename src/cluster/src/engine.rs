//! The engine of who asks: plans run on the cluster, and are called off there where nobody waits
//! for their end any more, on Ctrl-C, at a limit, or when enough was read.

use std::{
    net::{TcpStream, ToSocketAddrs as _},
    pin::Pin,
    sync::Arc,
    task::{Context, Poll},
    thread,
    time::Duration,
};

use async_trait::async_trait;
use ballista_core::{
    config::BALLISTA_CLIENT_PULL,
    execution_plans::DistributedQueryExec,
    extension::{SessionConfigExt as _, SessionStateExt as _},
    planner::BallistaQueryPlanner,
    serde::protobuf::{CancelJobParams, scheduler_grpc_client::SchedulerGrpcClient},
};
use datafusion::{
    arrow::{
        array::RecordBatch,
        datatypes::{FieldRef, SchemaRef},
    },
    catalog::Session,
    common::{
        ScalarValue,
        tree_node::{Transformed, TreeNodeRecursion},
    },
    error::{DataFusionError, Result},
    execution::{
        RecordBatchStream, SendableRecordBatchStream, SessionState, SessionStateBuilder,
        TaskContext, context::QueryPlanner,
    },
    logical_expr::{Expr, LogicalPlan, LogicalPlanBuilder},
    physical_expr::PhysicalExpr,
    physical_plan::{DisplayAs, DisplayFormatType, ExecutionPlan, PlanProperties},
    physical_planner::{DefaultPhysicalPlanner, PhysicalPlanner as _},
};
use datafusion_proto::protobuf::LogicalPlanNode;
use futures_util::Stream;
use tonic::transport::Endpoint;

use crate::{Address, Credentials, client::MESSAGE_BYTES, lost_work::LOST};

/// How long the scheduler may take to hear that a job is called off, or to say that it is there.
const PATIENCE: Duration = Duration::from_secs(2);
/// How many jobs a question may become, when executors are lost while they run.
const JOBS_MAX: usize = 3;

type OnCluster = DistributedQueryExec<LogicalPlanNode>;

/// Makes of a session's state one whose plans run on the cluster. Functions of ours are
/// to be added afterwards.
pub(crate) fn engine(
    state: SessionState,
    address: &Address,
    credentials: &Arc<Credentials>,
) -> Result<SessionState> {
    let url = format!("http://{address}");
    let config = state
        .config()
        .clone()
        .upgrade_for_ballista()
        .with_ballista_grpc_client_max_message_size(MESSAGE_BYTES)
        .with_ballista_override_create_grpc_client_endpoint(credentials.endpoints())
        // small parts are no reason to do with one thread what costs seconds a row
        .with_ballista_coalesce_enabled(false)
        // of the two planners of Ballista, the one that gets every job to its end
        .with_ballista_adaptive_query_planner(false)
        // who is told of a job when it ends knows no name to call it off by
        .set_bool(BALLISTA_CLIENT_PULL, true);
    let ballista = BallistaQueryPlanner::new(url.clone(), config.ballista_config());
    let planner = Planner {
        ballista,
        address: address.clone(),
        credentials: credentials.clone(),
    };
    let config = config.with_ballista_query_planner(Arc::new(planner));
    SessionStateBuilder::new_from_existing(state)
        .with_config(config)
        .build()
        .upgrade_for_ballista(url)
}

#[derive(Debug)]
struct Planner {
    ballista: BallistaQueryPlanner<LogicalPlanNode>,
    address: Address,
    credentials: Arc<Credentials>,
}

#[async_trait]
impl QueryPlanner for Planner {
    async fn create_physical_plan(
        &self,
        plan: &LogicalPlan,
        session: &dyn Session,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        if let LogicalPlan::EmptyRelation(_) = plan {
            return DefaultPhysicalPlanner::default()
                .create_physical_plan(plan, session)
                .await;
        }
        let planned = self
            .ballista
            .create_physical_plan(&sent(plan)?, session)
            .await?;
        Ok(match planned.downcast_ref::<OnCluster>() {
            Some(_) => Arc::new(CancelOnDrop {
                planned,
                address: self.address.clone(),
                credentials: self.credentials.clone(),
            }),
            None => planned,
        })
    }
}

/// A plan as it survives being sent: of a relation without rows the columns would not arrive,
/// nor would its job ever end. A row of nulls, that nobody may know to be filtered out before it
/// is, stands for it.
fn sent(plan: &LogicalPlan) -> Result<LogicalPlan> {
    let told = |node: LogicalPlan| {
        let LogicalPlan::EmptyRelation(empty) = &node else {
            return Ok(Transformed::no(node));
        };
        if empty.produce_one_row || empty.schema.fields().is_empty() {
            return Ok(Transformed::no(node));
        }
        let nothing = |field: &FieldRef| {
            Ok(Expr::Literal(
                ScalarValue::try_from(field.data_type())?,
                None,
            ))
        };
        let row = empty
            .schema
            .fields()
            .iter()
            .map(nothing)
            .collect::<Result<Vec<Expr>>>()?;
        let values = LogicalPlanBuilder::values(vec![row])?;
        let columns = values.schema().columns();
        let values = values.filter(Expr::Column(columns[0].clone()).is_not_null())?;
        let names = columns.into_iter().zip(empty.schema.iter());
        let named = names.map(|(column, (relation, field))| {
            Expr::Column(column).alias_qualified(relation.cloned(), field.name())
        });
        Ok(Transformed::yes(
            values.project(named.collect::<Vec<Expr>>())?.build()?,
        ))
    };
    Ok(plan.clone().transform_down_with_subqueries(told)?.data)
}

/// A plan on the cluster whose job ends with the last who waits for it.
#[derive(Debug)]
struct CancelOnDrop {
    planned: Arc<dyn ExecutionPlan>,
    address: Address,
    credentials: Arc<Credentials>,
}

impl DisplayAs for CancelOnDrop {
    fn fmt_as(&self, form: DisplayFormatType, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.planned.fmt_as(form, f)
    }
}

impl ExecutionPlan for CancelOnDrop {
    fn name(&self) -> &str {
        self.planned.name()
    }

    fn properties(&self) -> &Arc<PlanProperties> {
        self.planned.properties()
    }

    fn children(&self) -> Vec<&Arc<dyn ExecutionPlan>> {
        Vec::new()
    }

    fn apply_expressions(
        &self,
        _: &mut dyn FnMut(&Arc<dyn PhysicalExpr>) -> Result<TreeNodeRecursion>,
    ) -> Result<TreeNodeRecursion> {
        Ok(TreeNodeRecursion::Continue)
    }

    fn with_new_children(
        self: Arc<Self>,
        _: Vec<Arc<dyn ExecutionPlan>>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        Ok(self)
    }

    fn execute(
        &self,
        partition: usize,
        context: Arc<TaskContext>,
    ) -> Result<SendableRecordBatchStream> {
        let answer = self.planned.execute(partition, context.clone())?;
        Ok(Box::pin(ResultStream {
            answer,
            partition,
            context,
            jobs: 1,
            planned: self.planned.clone(),
            address: self.address.clone(),
            credentials: self.credentials.clone(),
            ended: false,
        }))
    }
}

/// What comes of a plan, until somebody has had enough.
struct ResultStream {
    answer: SendableRecordBatchStream,
    partition: usize,
    context: Arc<TaskContext>,
    /// How many jobs were begun for it.
    jobs: usize,
    planned: Arc<dyn ExecutionPlan>,
    address: Address,
    credentials: Arc<Credentials>,
    ended: bool,
}

impl Stream for ResultStream {
    type Item = Result<RecordBatch>;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Self::Item>> {
        let mut next = self.answer.as_mut().poll_next(context);
        // A job that lost an executor has no row, and another one does without it.
        while matches!(&next, Poll::Ready(Some(Err(error))) if error.to_string().contains(LOST))
            && self.jobs < JOBS_MAX
        {
            self.jobs += 1;
            self.answer = self.planned.execute(self.partition, self.context.clone())?;
            next = self.answer.as_mut().poll_next(context);
        }
        self.ended |= matches!(next, Poll::Ready(None | Some(Err(_))));
        next.map_err(|error| DataFusionError::Execution(failure(&self.address, &error)))
    }
}

/// What errors of connections say of themselves.
const TRANSPORT: [&str; 3] = ["transport::Error", "transport error", "GrpcConnectionError"];

/// Why a question has no answer: its scheduler is gone, or what the cluster said.
fn failure(scheduler: &Address, error: &DataFusionError) -> String {
    let place = (scheduler.host.as_str(), scheduler.port);
    let answers = place.to_socket_addrs().is_ok_and(|mut places| {
        places.any(|place| TcpStream::connect_timeout(&place, PATIENCE).is_ok())
    });
    if !answers {
        return format!(
            "the scheduler at {scheduler} went away before it had answered; run the query again once one answers \
             there (`reel cluster scheduler`)"
        );
    }
    let reason = error.strip_backtrace();
    // A scheduler that is there again, or an executor, was gone in the meantime.
    if TRANSPORT.iter().any(|raw| reason.contains(raw)) {
        return format!(
            "a node of the cluster at {scheduler} went away before it had answered; run the query again"
        );
    }
    let reason = reason.trim_start_matches("Execution error: ");
    format!("the cluster returned no answer: {reason}; if a node failed, run the query again")
}

impl RecordBatchStream for ResultStream {
    fn schema(&self) -> SchemaRef {
        self.answer.schema()
    }
}

impl Drop for ResultStream {
    fn drop(&mut self) {
        let job = self
            .planned
            .downcast_ref::<OnCluster>()
            .and_then(OnCluster::job_id);
        let Some(job) = job.filter(|_| !self.ended) else {
            return;
        };
        let endpoint = Endpoint::from_shared(format!("http://{}", self.address));
        let (endpoints, job_id) = (self.credentials.endpoints(), job.to_string());
        // a thread of its own: whoever drops this may be about to end, and need not be
        // where one can wait
        let call_off = thread::spawn(move || {
            let Ok(runtime) = tokio::runtime::Builder::new_current_thread()
                .enable_all()
                .build()
            else {
                return;
            };
            let called_off = async {
                let channel = endpoints(endpoint.ok()?).ok()?.connect().await.ok()?;
                let mut scheduler = SchedulerGrpcClient::new(channel);
                scheduler.cancel_job(CancelJobParams { job_id }).await.ok()
            };
            let _ = runtime.block_on(async { tokio::time::timeout(PATIENCE, called_off).await });
        });
        let _ = call_off.join();
    }
}

#[cfg(test)]
mod tests {
    use std::{
        net::TcpListener,
        sync::atomic::{AtomicUsize, Ordering::Relaxed},
    };

    use datafusion::{
        arrow::datatypes::Schema,
        common::exec_err,
        physical_plan::{
            collect,
            stream::RecordBatchStreamAdapter,
            streaming::{PartitionStream, StreamingTableExec},
        },
    };
    use futures_util::stream;

    use super::*;

    #[test]
    fn a_scheduler_that_is_gone_is_named_and_its_transport_is_not() {
        let raw = DataFusionError::Execution(
            "Status { code: Unavailable, source: Some(tonic::transport::Error(Transport)) }"
                .to_owned(),
        );
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::parse(&listener.local_addr().unwrap().to_string()).unwrap();
        let said = failure(&address, &raw);
        assert!(
            said.starts_with("a node of the cluster") && !said.contains("tonic"),
            "{said}"
        );
        let planned = DataFusionError::Execution("no such column".to_owned());
        let said = failure(&address, &planned);
        assert!(
            said.contains("no answer: no such column; if a node failed"),
            "{said}"
        );
        drop(listener);
        let said = failure(&address, &raw);
        assert!(
            said.starts_with(&format!("the scheduler at {address} went away"))
                && !said.contains("tonic"),
            "{said}"
        );
    }

    /// A plan on a cluster that loses executors, so often.
    #[derive(Debug)]
    struct Losing {
        schema: SchemaRef,
        left: AtomicUsize,
    }

    impl PartitionStream for Losing {
        fn schema(&self) -> &SchemaRef {
            &self.schema
        }

        fn execute(&self, _: Arc<TaskContext>) -> SendableRecordBatchStream {
            let fewer = |left: usize| left.checked_sub(1);
            let lost = self.left.fetch_update(Relaxed, Relaxed, fewer).is_ok();
            let answer = match lost {
                true => exec_err!("Job 7 failed: {LOST}"),
                false => Ok(RecordBatch::new_empty(self.schema.clone())),
            };
            let stream = stream::iter([answer]);
            Box::pin(RecordBatchStreamAdapter::new(self.schema.clone(), stream))
        }
    }

    #[tokio::test]
    async fn a_job_that_lost_an_executor_is_begun_anew_twice() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::parse(&listener.local_addr().unwrap().to_string()).unwrap();
        let ask = async |losses: usize| {
            let schema = SchemaRef::new(Schema::empty());
            let left = AtomicUsize::new(losses);
            let losing: Arc<dyn PartitionStream> = Arc::new(Losing {
                schema: schema.clone(),
                left,
            });
            let planned =
                StreamingTableExec::try_new(schema, vec![losing], None, [], false, None).unwrap();
            let plan = CancelOnDrop {
                planned: Arc::new(planned),
                address: address.clone(),
                credentials: Arc::new(Credentials {
                    identity: None,
                    build: String::new(),
                }),
            };
            collect(Arc::new(plan), Arc::default()).await
        };
        assert_eq!(ask(0).await.unwrap().len(), 1);
        assert_eq!(ask(2).await.unwrap().len(), 1);
        let failed = ask(3).await.unwrap_err().to_string();
        assert!(failed.contains(LOST), "{failed}");
    }
}
