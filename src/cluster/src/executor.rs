//! The process that works off parts of questions.

use std::{net::SocketAddr, path::PathBuf, sync::Arc};

use ballista_core::{
    config::TaskSchedulingPolicy, extension::SessionConfigExt as _,
    registry::BallistaFunctionRegistry,
};
use ballista_executor::executor_process::{ExecutorProcessConfig, start_executor_process};
use datafusion::prelude::SessionConfig;
use reel_query::{TraceAccess, every_function};
use reel_trace::TraceFiles;

use crate::{Address, ClusterError, TraceJob, client::MESSAGE_BYTES, files, runtime, work::Worker};

/// An executor to be.
#[derive(Clone, Debug)]
pub struct ExecutorOptions {
    /// Where the scheduler listens.
    pub scheduler: Address,
    /// Where answers are fetched from it.
    pub listen: SocketAddr,
    /// The name or address by which others fetch them.
    pub advertise: String,
    /// Parts at a time.
    pub threads: usize,
    /// Memory for sorts, joins and aggregations, in bytes; none: most of what there is.
    pub memory_bytes: Option<u64>,
    /// Where parts of answers lie until they are fetched; none: a folder that
    /// goes with the process.
    pub work: Option<PathBuf>,
    /// Folders and places in buckets whose traces may be opened.
    pub traces: Vec<PathBuf>,
    /// Where its SQL functions read traces from.
    pub files: TraceFiles,
    /// Names this program: it does no work for another one.
    pub build: String,
    /// What it can do with traces besides SQL.
    pub works: Vec<TraceJob>,
}

/// Runs an executor until the process is told to end.
///
/// # Errors
/// When it cannot listen, or there is no scheduler.
pub fn run(executor: &ExecutorOptions) -> Result<(), ClusterError> {
    let failed = |reason: String| ClusterError::Run {
        action: "the executor ended",
        reason,
    };
    let environment = files::environment().map_err(|error| failed(error.to_string()))?;
    let opens = TraceAccess::Below(executor.traces.clone());
    let mut functions = every_function(
        SessionConfig::new_with_ballista(),
        environment,
        opens.clone(),
        executor.files.clone(),
    );
    let worker = Worker {
        build: executor.build.clone(),
        works: executor.works.clone(),
        opens,
    };
    worker
        .equip(&mut functions)
        .map_err(|error| failed(error.to_string()))?;
    let config = ExecutorProcessConfig {
        bind_host: executor.listen.ip().to_string(),
        external_host: Some(executor.advertise.clone()),
        port: executor.listen.port(),
        // only schedulers that push talk to it there
        grpc_port: executor.listen.port().wrapping_add(1),
        scheduler_host: executor.scheduler.host.clone(),
        scheduler_port: executor.scheduler.port,
        scheduler_connect_timeout_seconds: 30,
        vcores: executor.threads,
        task_scheduling_policy: TaskSchedulingPolicy::PullStaged,
        work_dir: executor
            .work
            .as_ref()
            .map(|folder| folder.display().to_string()),
        grpc_max_decoding_message_size: MESSAGE_BYTES as u32,
        grpc_max_encoding_message_size: MESSAGE_BYTES as u32,
        memory_pool_size: executor.memory_bytes,
        override_function_registry: Some(Arc::new(BallistaFunctionRegistry::from(&functions))),
        override_runtime_producer: Some(Arc::new(|_| files::environment())),
        override_config_producer: Some(Arc::new(SessionConfig::new_with_ballista)),
        ..ExecutorProcessConfig::default()
    };
    // the functions that call the simulator work on several traces at a time
    rayon::ThreadPoolBuilder::new()
        .num_threads(executor.threads)
        .build_global()
        .map_err(|error| failed(error.to_string()))?;
    let runtime = runtime().map_err(|error| failed(error.to_string()))?;
    runtime
        .block_on(start_executor_process(Arc::new(config)))
        .map_err(|error| failed(error.to_string()))
}
