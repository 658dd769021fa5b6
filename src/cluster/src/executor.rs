//! The process that works off parts of questions.

use std::{net::SocketAddr, path::PathBuf, sync::Arc, time::Duration};

use arrow_flight::flight_service_server::FlightServiceServer;

use ballista_core::error::BallistaError;
use ballista_core::{
    config::TaskSchedulingPolicy, extension::SessionConfigExt as _,
    registry::BallistaFunctionRegistry,
};
use ballista_executor::{
    ArrowFlightServerProvider,
    executor_process::{ExecutorProcessConfig, start_executor_process},
    flight_service::BallistaFlightService,
};
use datafusion::prelude::SessionConfig;
use reel_query::{TraceAccess, every_function};
use reel_trace::TraceFiles;
use tonic::service::interceptor::InterceptedService;

use crate::{
    Address, ClusterError, Credentials, TraceJob, check_listen, client::MESSAGE_BYTES, files,
    runtime, work::Worker,
};

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
    /// Folders and places in buckets whose tables may be read; none: any.
    pub stores: Option<Vec<PathBuf>>,
    /// Where its SQL functions read traces from.
    pub files: TraceFiles,
    /// What it shows to others, and asks of them.
    pub credentials: Credentials,
    /// What it can do with traces besides SQL.
    pub works: Vec<TraceJob>,
}

/// How long it waits for a scheduler that takes it.
const PATIENCE: Duration = Duration::from_secs(30);

/// The server of parts of answers, for members alone.
fn results(
    credentials: &Credentials,
) -> Result<Arc<ArrowFlightServerProvider>, tonic::transport::Error> {
    // What is wrong with the credentials is said at once, and not by a task.
    let (server, guard) = (credentials.server()?, credentials.guard());
    Ok(Arc::new(move |folder, address, mut stopped, _| {
        let service = FlightServiceServer::new(BallistaFlightService::new(folder))
            .max_encoding_message_size(MESSAGE_BYTES)
            .max_decoding_message_size(MESSAGE_BYTES);
        let guarded = InterceptedService::new(service, guard.clone());
        let serve = server.clone().add_service(guarded);
        tokio::spawn(async move {
            let end = serve.serve_with_shutdown(address, stopped.recv()).await;
            end.map_err(BallistaError::TonicError)
        })
    }))
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
    let stores = executor.stores.clone().map(TraceAccess::Below);
    let environment =
        files::environment(stores.as_ref()).map_err(|error| failed(error.to_string()))?;
    let opens = TraceAccess::Below(executor.traces.clone());
    let mut functions = every_function(
        SessionConfig::new_with_ballista(),
        environment,
        opens.clone(),
        executor.files.clone(),
    );
    let worker = Worker {
        build: executor.credentials.build.clone(),
        works: executor.works.clone(),
        opens,
    };
    worker
        .equip(&mut functions)
        .map_err(|error| failed(error.to_string()))?;
    let endpoints = executor.credentials.endpoints();
    let produced = endpoints.clone();
    let results = results(&executor.credentials).map_err(|error| failed(error.to_string()))?;
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
        override_runtime_producer: Some(Arc::new(move |_| files::environment(stores.as_ref()))),
        override_config_producer: Some(Arc::new(move || {
            SessionConfig::new_with_ballista()
                .with_ballista_override_create_grpc_client_endpoint(produced.clone())
        })),
        override_create_grpc_client_endpoint: Some(endpoints),
        override_arrow_flight_service: Some(results),
        ..ExecutorProcessConfig::default()
    };
    // the functions that call the simulator work on several traces at a time
    rayon::ThreadPoolBuilder::new()
        .num_threads(executor.threads)
        .build_global()
        .map_err(|error| failed(error.to_string()))?;
    check_listen(executor.listen).map_err(failed)?;
    let runtime = runtime().map_err(|error| failed(error.to_string()))?;
    runtime.block_on(executor.credentials.check(&executor.scheduler, PATIENCE))?;
    runtime
        .block_on(start_executor_process(Arc::new(config)))
        .map_err(|error| failed(error.to_string()))
}
