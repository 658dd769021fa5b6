//! The process that plans questions and hands their parts to executors.

use std::{net::SocketAddr, sync::Arc};

use ballista_core::{
    config::TaskSchedulingPolicy, extension::SessionConfigExt as _,
    serde::protobuf::scheduler_grpc_server::SchedulerGrpcServer,
};
use ballista_scheduler::{
    cluster::BallistaCluster, config::SchedulerConfig, scheduler_process::create_scheduler,
};
use datafusion::prelude::SessionConfig;
use reel_query::{TraceAccess, every_function};
use reel_trace::TraceFiles;
use tonic::service::interceptor::InterceptedService;

use crate::{
    ClusterError, Credentials, check_listen, client::MESSAGE_BYTES, files, lost_work::Scheduler,
    runtime, work::Worker,
};

/// A scheduler to be.
#[derive(Clone, Debug)]
pub struct SchedulerOptions {
    /// Socket address on which the scheduler accepts connections.
    pub listen: SocketAddr,
    /// The name or address by which executors reach it.
    pub advertise: String,
    /// What it shows to others, and asks of them.
    pub credentials: Credentials,
    /// An executor that was not heard of for so long counts as dead, in seconds.
    pub patience_s: u64,
}

/// Runs a scheduler until the process is told to end.
///
/// # Errors
/// When it cannot listen.
pub fn run(scheduler: &SchedulerOptions) -> Result<(), ClusterError> {
    let failed = |reason: String| ClusterError::Run {
        action: "the scheduler ended",
        reason,
    };
    let config = SchedulerConfig {
        bind_host: scheduler.listen.ip().to_string(),
        bind_port: scheduler.listen.port(),
        external_host: scheduler.advertise.clone(),
        // executors fetch their work, so nobody has to reach them but who fetches answers
        scheduling_policy: TaskSchedulingPolicy::PullStaged,
        executor_timeout_seconds: scheduler.patience_s,
        expire_dead_executor_interval_seconds: (scheduler.patience_s / 4).max(1),
        no_executors_grace_period_seconds: scheduler.patience_s,
        // plans name every file of a table
        grpc_server_max_decoding_message_size: MESSAGE_BYTES as u32,
        grpc_server_max_encoding_message_size: MESSAGE_BYTES as u32,
        grpc_client_max_message_size: MESSAGE_BYTES as u32,
        override_config_producer: Some(Arc::new(SessionConfig::new_with_ballista)),
        override_create_grpc_client_endpoint: Some(scheduler.credentials.endpoints()),
        override_session_builder: Some(Arc::new(|config| {
            let mut state = every_function(
                config,
                files::environment(None)?,
                TraceAccess::Nothing,
                TraceFiles::default(),
            );
            Worker::nobody().equip(&mut state)?;
            Ok(state)
        })),
        ..SchedulerConfig::default()
    };
    check_listen(scheduler.listen).map_err(failed)?;
    let runtime = runtime().map_err(|error| failed(error.to_string()))?;
    let serve = async {
        let cluster = BallistaCluster::new_from_config(&config).await?;
        let ended = cluster.job_state();
        let server = create_scheduler(cluster, Arc::new(config)).await?;
        let service = SchedulerGrpcServer::new(Scheduler { server, ended })
            .max_encoding_message_size(MESSAGE_BYTES)
            .max_decoding_message_size(MESSAGE_BYTES);
        let guarded = InterceptedService::new(service, scheduler.credentials.guard());
        let server = scheduler.credentials.server()?.add_service(guarded);
        server.serve(scheduler.listen).await?;
        Ok::<_, Box<dyn std::error::Error + Send + Sync>>(())
    };
    runtime.block_on(async {
        tokio::select! {
            end = serve => end.map_err(|error| failed(error.to_string())),
            _ = tokio::signal::ctrl_c() => Ok(()),
        }
    })
}
