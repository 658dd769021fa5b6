//! Jobs that lost an executor while they ran: they end in an error, and who asked asks again.
//!
//! Ballista goes on with such a job: what the executor had done is handed out once more. But where
//! a stage is done again whose results a later stage has in part, those stay beside the new ones;
//! the job ends well, and its rows are doubled or missing (the test below has one). Nobody could
//! tell that from the right answer, so no answer counts for which anything was done twice.

use std::{collections::HashMap, sync::Arc};

use async_trait::async_trait;
use ballista_core::{
    JobId,
    serde::protobuf::{
        CancelJobParams, CancelJobResult, CleanJobDataParams, CleanJobDataResult,
        CreateUpdateSessionParams, CreateUpdateSessionResult, ExecuteQueryParams,
        ExecuteQueryResult, ExecutorStoppedParams, ExecutorStoppedResult, FailedJob, FailedTask,
        GetJobMetricsParams, GetJobMetricsResult, GetJobStatusParams, GetJobStatusResult,
        HeartBeatParams, HeartBeatResult, PollWorkParams, PollWorkResult, RegisterExecutorParams,
        RegisterExecutorResult, RemoveSessionParams, RemoveSessionResult, UpdateTaskStatusParams,
        UpdateTaskStatusResult, failed_task::FailedReason, job_status::Status as JobEnd,
        scheduler_grpc_server::SchedulerGrpc, task_status::Status as TaskEnd,
    },
};
use ballista_scheduler::{
    cluster::JobState, scheduler_server::SchedulerServer, state::execution_stage::ExecutionStage,
};
use datafusion_proto::protobuf::{LogicalPlanNode, PhysicalPlanNode};
use futures_util::stream;
use tonic::{Request, Response, Status};

/// The error of a job that lost an executor; who asked knows it by this.
pub(crate) const LOST: &str = "an executor was lost while the job ran";

/// Ballista's scheduler, whose jobs end in an error where an executor was lost.
pub(crate) struct Scheduler {
    pub server: SchedulerServer<LogicalPlanNode, PhysicalPlanNode>,
    /// The jobs that have ended.
    pub ended: Arc<dyn JobState>,
}

impl Scheduler {
    /// The state of a job, and its end where it cannot be trusted any more.
    async fn state(&self, asked: GetJobStatusParams) -> Result<GetJobStatusResult, Status> {
        let job_id = asked.job_id.clone();
        let mut answer = self
            .server
            .get_job_status(Request::new(asked))
            .await?
            .into_inner();
        let state = answer
            .status
            .as_mut()
            .and_then(|status| status.status.as_mut());
        let Some(state @ (JobEnd::Running(_) | JobEnd::Successful(_))) = state else {
            return Ok(answer);
        };
        if self.lost_work(&job_id.clone().into()).await? {
            *state = JobEnd::Failed(FailedJob {
                error: LOST.to_owned(),
                ..FailedJob::default()
            });
            // One that has ended already cannot be called off, and need not be.
            let _ = self.server.cancel_job(job_id.into()).await;
        }
        Ok(answer)
    }

    async fn lost_work(&self, job: &JobId) -> Result<bool, Status> {
        let running = self.server.state.task_manager.get_running_job_cache();
        if let Some(job) = running.get(job) {
            return Ok(was_redone(job.execution_graph.read().await.stages()));
        }
        let ended = self.ended.get_execution_graph(job).await;
        let ended = ended.map_err(|error| Status::internal(error.to_string()))?;
        Ok(ended.is_some_and(|graph| was_redone(graph.stages())))
    }
}

/// Whether a stage of a job, or a task of one, was begun more than once.
fn was_redone(stages: &HashMap<usize, ExecutionStage>) -> bool {
    let attempt = |stage: &ExecutionStage| match stage {
        ExecutionStage::UnResolved(stage) => stage.stage_attempt_num,
        ExecutionStage::Resolved(stage) => stage.stage_attempt_num,
        ExecutionStage::Running(stage) => stage.stage_attempt_num,
        ExecutionStage::Successful(stage) => stage.stage_attempt_num,
        ExecutionStage::Failed(stage) => stage.stage_attempt_num,
    };
    let taken_back = |end: &TaskEnd| {
        let TaskEnd::Failed(FailedTask { failed_reason, .. }) = end else {
            return false;
        };
        matches!(
            failed_reason,
            Some(FailedReason::ResultLost(_) | FailedReason::TaskKilled(_))
        )
    };
    stages.values().any(|stage| {
        let mut tasks = stage.task_infos().into_iter().flatten();
        attempt(stage) > 0 || tasks.any(|task| taken_back(&task.task_status))
    })
}

/// The service of [`Scheduler`], which passes these calls on as they are.
macro_rules! pass_on {
    ($($call:ident($params:ty) -> $result:ty;)*) => {
        #[async_trait]
        impl SchedulerGrpc for Scheduler {
            type ExecuteQueryPushStream = stream::Empty<Result<GetJobStatusResult, Status>>;

            $(
                async fn $call(
                    &self,
                    request: Request<$params>,
                ) -> Result<Response<$result>, Status> {
                    SchedulerGrpc::$call(&self.server, request).await
                }
            )*

            async fn get_job_status(
                &self,
                request: Request<GetJobStatusParams>,
            ) -> Result<Response<GetJobStatusResult>, Status> {
                self.state(request.into_inner()).await.map(Response::new)
            }

            async fn execute_query_push(
                &self,
                _: Request<ExecuteQueryParams>,
            ) -> Result<Response<Self::ExecuteQueryPushStream>, Status> {
                Err(Status::unimplemented(
                    "the state of a job is asked for here, and not pushed (ballista.client.pull)",
                ))
            }
        }
    };
}

pass_on! {
    poll_work(PollWorkParams) -> PollWorkResult;
    register_executor(RegisterExecutorParams) -> RegisterExecutorResult;
    heart_beat_from_executor(HeartBeatParams) -> HeartBeatResult;
    update_task_status(UpdateTaskStatusParams) -> UpdateTaskStatusResult;
    create_update_session(CreateUpdateSessionParams) -> CreateUpdateSessionResult;
    remove_session(RemoveSessionParams) -> RemoveSessionResult;
    execute_query(ExecuteQueryParams) -> ExecuteQueryResult;
    get_job_metrics(GetJobMetricsParams) -> GetJobMetricsResult;
    executor_stopped(ExecutorStoppedParams) -> ExecutorStoppedResult;
    cancel_job(CancelJobParams) -> CancelJobResult;
    clean_job_data(CleanJobDataParams) -> CleanJobDataResult;
}

#[cfg(test)]
mod tests {
    use ballista_core::{
        extension::SessionConfigExt as _,
        serde::{
            protobuf::{FetchPartitionError, ShuffleWritePartition, SuccessfulTask, TaskStatus},
            scheduler::{
                ExecutorMetadata, ExecutorOperatingSystemSpecification, ExecutorSpecification,
                TaskKey,
            },
        },
    };
    use ballista_scheduler::{
        cluster::BallistaCluster,
        config::SchedulerConfig,
        planner::DefaultDistributedPlanner,
        scheduler_process::create_scheduler,
        state::{
            execution_graph::{
                ExecutionGraph as _, ExecutionGraphBox, StaticExecutionGraph, TaskDescription,
                create_task_info,
            },
            execution_stage::TaskInfo,
        },
    };
    use datafusion::{
        arrow::{
            array::{Int64Array, RecordBatch},
            datatypes::{DataType, Field, Schema},
        },
        datasource::MemTable,
        prelude::{SessionConfig, SessionContext},
    };

    use super::*;

    /// Counting by key in order, over two parts: three stages, each of which needs the one before.
    async fn job() -> StaticExecutionGraph {
        let context = SessionContext::new_with_config(
            SessionConfig::new_with_ballista().with_target_partitions(2),
        );
        let schema = Arc::new(Schema::new(vec![Field::new("a", DataType::Int64, false)]));
        let part = || {
            let column = Arc::new(Int64Array::from(vec![1, 2, 3]));
            vec![RecordBatch::try_new(schema.clone(), vec![column]).unwrap()]
        };
        let table = MemTable::try_new(schema.clone(), vec![part(), part()]).unwrap();
        context.register_table("t", Arc::new(table)).unwrap();
        let sql = "SELECT a, count(*) FROM t GROUP BY a ORDER BY a";
        let plan = context.sql(sql).await.unwrap();
        let plan = plan.create_physical_plan().await.unwrap();
        let config = Arc::new(context.copied_config());
        let mut planner = DefaultDistributedPlanner::new();
        let (job, session) = (JobId::from("job"), "session");
        StaticExecutionGraph::new("", &job, "", session, plan, 0, config, &mut planner, None)
            .unwrap()
    }

    fn executor(id: &str) -> ExecutorMetadata {
        ExecutorMetadata {
            id: id.to_owned(),
            host: "localhost".to_owned(),
            port: 1,
            grpc_port: 2,
            specification: ExecutorSpecification::default(),
            os_info: ExecutorOperatingSystemSpecification::default(),
        }
    }

    /// The next task, for an executor; as Ballista's own tests take one, by what is public of it.
    fn take(job: &mut StaticExecutionGraph, id: &str) -> Option<TaskDescription> {
        job.revive();
        let session_config = job.session_config();
        let stage = job.fetch_running_stage(&[])?;
        let partitions = stage.pending.next_slice(1);
        let task = TaskDescription {
            session_id: "session".to_owned(),
            key: TaskKey {
                job_id: "job".into(),
                stage_id: stage.stage_id,
                task_id: stage.task_infos.len(),
            },
            stage_attempt_num: stage.stage_attempt_num,
            task_attempt: 0,
            global_input_partition_ids: partitions.clone(),
            vcores_consumed: 1,
            plan: stage.plan.clone(),
            session_config,
        };
        stage.task_infos.push(TaskInfo {
            global_input_partition_ids: partitions,
            ..create_task_info(id.to_owned(), task.key.task_id)
        });
        Some(task)
    }

    fn done(job: &mut StaticExecutionGraph, task: &TaskDescription, id: &str) {
        let partitions = (0..task.get_output_partition_number() as u64)
            .map(|partition_id| ShuffleWritePartition {
                partition_id,
                num_rows: 3,
                ..ShuffleWritePartition::default()
            })
            .collect();
        let end = TaskEnd::Successful(SuccessfulTask {
            executor_id: id.to_owned(),
            partitions,
            ..SuccessfulTask::default()
        });
        end_task(job, task, id, end);
    }

    fn end_task(job: &mut StaticExecutionGraph, task: &TaskDescription, id: &str, end: TaskEnd) {
        let status = TaskStatus {
            task_id: task.key.task_id as u32,
            job_id: "job".to_owned(),
            stage_id: task.key.stage_id as u32,
            stage_attempt_num: task.stage_attempt_num as u32,
            status: Some(end),
            ..TaskStatus::default()
        };
        job.update_task_status(&executor(id), vec![status], 4, 4)
            .unwrap();
    }

    fn do_rest(job: &mut StaticExecutionGraph, id: &str) {
        while let Some(task) = take(job, id) {
            done(job, &task, id);
        }
        assert!(job.is_successful(), "{job:?}");
    }

    /// How many results of the stage before the last one reads.
    fn read_by_last(job: &StaticExecutionGraph) -> usize {
        let last = job.stages().values().find_map(|stage| match stage {
            ExecutionStage::Successful(stage) if stage.output_links.is_empty() => Some(stage),
            _ => None,
        });
        let inputs = last.expect("the job has ended").inputs.values();
        let results = inputs.flat_map(|input| input.partition_locations.values());
        results.map(Vec::len).sum()
    }

    /// A job that counts three rows of which two executors did a part, until one of them is lost.
    async fn disturbed() -> StaticExecutionGraph {
        let mut job = job().await;
        // Each has done a part of the first stage, and one of them a part of the second.
        for id in ["one", "other", "one"] {
            let task = take(&mut job, id).unwrap();
            done(&mut job, &task, id);
        }
        assert!(!was_redone(job.stages()));
        job.reset_stages_on_lost_executor("other").unwrap();
        job
    }

    #[tokio::test]
    async fn an_executor_that_is_lost_doubles_rows_and_its_job_does_not_count() {
        let mut undisturbed = job().await;
        do_rest(&mut undisturbed, "one");
        assert!(!was_redone(undisturbed.stages()));

        let mut disturbed = disturbed().await;
        assert!(was_redone(disturbed.stages()));
        do_rest(&mut disturbed, "one");
        assert!(was_redone(disturbed.stages()));
        // Where this fails Ballista has mended it, and jobs may go on without who is lost.
        assert_eq!(
            (read_by_last(&undisturbed), read_by_last(&disturbed)),
            (2, 3)
        );
    }

    #[tokio::test]
    async fn a_task_that_is_taken_back_is_noticed_in_its_first_stage_too() {
        let mut disturbed = job().await;
        take(&mut disturbed, "other").unwrap();
        disturbed.reset_stages_on_lost_executor("other").unwrap();
        assert!(was_redone(disturbed.stages()));
    }

    #[tokio::test]
    async fn a_stage_that_is_begun_anew_is_noticed_where_no_task_was_lost() {
        let mut disturbed = job().await;
        for _ in 0..2 {
            let task = take(&mut disturbed, "one").unwrap();
            done(&mut disturbed, &task, "one");
        }
        let task = take(&mut disturbed, "one").unwrap();
        let missing = FetchPartitionError {
            executor_id: "nobody any more".to_owned(),
            map_stage_id: 1,
            ..FetchPartitionError::default()
        };
        let end = TaskEnd::Failed(FailedTask {
            failed_reason: Some(FailedReason::FetchPartitionError(missing)),
            ..FailedTask::default()
        });
        end_task(&mut disturbed, &task, "one", end);
        assert!(was_redone(disturbed.stages()));
    }

    #[tokio::test]
    async fn who_asks_for_a_job_that_lost_an_executor_hears_that_it_failed() {
        for (mut job, lost) in [(job().await, false), (disturbed().await, true)] {
            do_rest(&mut job, "one");
            job.succeed_job().unwrap();
            let config = SchedulerConfig::default();
            let cluster = BallistaCluster::new_from_config(&config).await.unwrap();
            let (id, ended) = (JobId::from("job"), cluster.job_state());
            let job: ExecutionGraphBox = Box::new(job);
            ended.accept_job(&id, "", 0).unwrap();
            ended.submit_job(id.clone(), &job, None).await.unwrap();
            ended.save_job(&id, &job).await.unwrap();
            let server = create_scheduler(cluster, Arc::new(config)).await.unwrap();
            let scheduler = Scheduler { server, ended };
            let asked = Request::new(GetJobStatusParams { job_id: id.into() });
            let answer = scheduler.get_job_status(asked).await.unwrap().into_inner();
            match answer.status.unwrap().status.unwrap() {
                JobEnd::Failed(failed) if lost => assert_eq!(failed.error, LOST),
                JobEnd::Successful(_) if !lost => {}
                other => panic!("lost: {lost}, {other:?}"),
            }
        }
    }
}
