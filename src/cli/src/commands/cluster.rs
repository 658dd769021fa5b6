//! `reel cluster`: the processes of a cluster. What asks it is `cluster_arguments.rs`.

use std::{
    net::{IpAddr, SocketAddr},
    path::PathBuf,
    sync::Arc,
};

use reel_cluster::{
    Address, ExecutorOptions, SchedulerOptions, issue, run_executor, run_scheduler,
};

use crate::{
    ExitStatus, cluster_arguments,
    commands::{blame, ingest, replay, store::reward},
    inputs,
};

/// Share work between machines: one runs the scheduler, each of the others an executor, and
/// `--cluster` of `reel query`, `replay`, `blame`, `taxonomy`, `store reward` and `ingest` lets
/// them do the work, with the same results and exit codes as here.
///
/// All machines have to see a store's files and traces under the same name: in a bucket (s3://, as
/// AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_REGION and AWS_ENDPOINT_URL describe it to each of
/// them) or in a shared folder. All have to be the same build of reel, and others are refused. With
/// --identity all connections are encrypted, and each end shows the other a certificate of the
/// cluster's authority, which `reel cluster cert` makes; without it, whoever reaches the scheduler
/// may read these files, so keep the ports within a private network. Errors go to standard error;
/// RUST_LOG=info logs more.
///
/// Examples:
///   reel cluster cert --out lab scheduler machine-2 machine-3 ann
///   reel cluster scheduler --listen 10.0.0.1:50050 --identity scheduler.pem
///   reel cluster scheduler --listen 10.0.0.1:50050
///   reel cluster executor --scheduler 10.0.0.1:50050 --listen 10.0.0.2:50051 --traces /data/traces
///   reel query --cluster 10.0.0.1:50050 --store s3://lab/store --named benchmark
#[derive(clap::Args)]
#[command(verbatim_doc_comment)]
pub struct Arguments {
    #[command(subcommand)]
    what: Command,
}

#[derive(clap::Subcommand)]
enum Command {
    /// Plan queries and jobs, and distribute their tasks
    Scheduler {
        /// Address and port that the scheduler listens on
        #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:50050")]
        listen: SocketAddr,
        /// Name or address by which executors reach it; without it the one it listens at
        #[arg(long, value_name = "HOST")]
        advertise: Option<String>,
        /// Seconds without a heartbeat after which an executor is dead and others do its tasks. A
        /// busy executor sends one every five seconds, so less than ten would take its tasks away
        #[arg(long = "executor-timeout", alias = "patience", value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u64).range(10..))]
        patience: u64,
        /// File of identity (`reel cluster cert`); without it, anyone may connect
        #[arg(long, value_name = "FILE", env = "REEL_CLUSTER_IDENTITY")]
        identity: Option<PathBuf>,
    },
    /// Execute tasks of the scheduler
    Executor {
        /// Where the scheduler listens
        #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:50050")]
        scheduler: String,
        /// Address that serves results to other machines
        #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:50051")]
        listen: SocketAddr,
        /// Name or address by which others fetch results; without it the one it listens at
        #[arg(long, value_name = "HOST")]
        advertise: Option<String>,
        /// Tasks at a time; without it one for each core
        #[arg(long = "jobs", alias = "threads", value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
        threads: Option<u32>,
        /// Memory for sorts, joins and aggregations before they spill, in MiB; without it 70%
        /// of the machine's
        #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..))]
        memory: Option<u64>,
        /// Folder for partial results until they are fetched; without it a temporary one
        #[arg(long = "work-dir", alias = "work", value_name = "DIR")]
        work: Option<PathBuf>,
        /// Folders, also s3://bucket/folder, whose traces may be opened: by replay, blame and
        /// ingest, and by the functions of SQL that do; without it, none
        #[arg(long, value_name = "DIR", value_delimiter = ',')]
        traces: Vec<PathBuf>,
        /// Folders, also s3://bucket/folder, whose tables may be read; without it, any; --identity
        /// requires it
        #[arg(long, value_name = "DIR", value_delimiter = ',')]
        stores: Option<Vec<PathBuf>>,
        /// File of identity (`reel cluster cert`), where the scheduler has one
        #[arg(
            long,
            value_name = "FILE",
            env = "REEL_CLUSTER_IDENTITY",
            requires = "stores"
        )]
        identity: Option<PathBuf>,
        #[command(flatten)]
        assets: inputs::Assets,
    },
    /// Make files of identity: one for each machine and each person, and a small authority that
    /// signs them. Keep authority.key where nobody else can read it; give each name its own file
    Cert {
        /// Names of machines and people; each gets the file NAME.pem
        #[arg(value_name = "NAME", required = true, value_parser = name)]
        names: Vec<String>,
        /// Folder of the authority and of the files; the authority is made where there is none
        #[arg(long, value_name = "DIR", default_value = "cluster-identities")]
        out: PathBuf,
        /// Days until the files are no longer accepted
        #[arg(long, value_name = "N", default_value_t = 730, value_parser = clap::value_parser!(u32).range(1..=36_500))]
        days: u32,
    },
}

fn name(text: &str) -> Result<String, String> {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
    let fine = text.chars().all(plain) && text.starts_with(|c: char| c.is_ascii_alphanumeric());
    match fine && text != "authority" {
        true => Ok(text.to_owned()),
        false => Err(
            "letters, digits, '-', '_' and '.', the first a letter or digit, and not 'authority'"
                .to_owned(),
        ),
    }
}

/// Runs a scheduler or an executor of a cluster until it is stopped.
pub fn run(arguments: &Arguments) -> anyhow::Result<ExitStatus> {
    env_logger::Builder::from_env(env_logger::Env::default().default_filter_or("warn")).init();
    match &arguments.what {
        Command::Scheduler {
            listen,
            advertise,
            patience,
            identity,
        } => {
            eprintln!("reel: scheduler at {listen}; Ctrl-C ends it");
            run_scheduler(&SchedulerOptions {
                listen: *listen,
                advertise: reached(advertise.as_deref(), listen.ip()),
                credentials: cluster_arguments::credentials(identity.as_deref())?,
                patience_s: *patience,
            })?;
        }
        Command::Executor {
            scheduler,
            listen,
            advertise,
            threads,
            memory,
            work,
            traces,
            stores,
            identity,
            assets,
        } => {
            let assets = Arc::new(assets.open()?);
            let files = inputs::trace_files();
            let works = replay::works(&files, &assets)
                .into_iter()
                .chain([
                    blame::work(files.clone()),
                    ingest::work(files.clone()),
                    reward::work(),
                ])
                .collect();
            let cores = std::thread::available_parallelism().map_or(1, usize::from);
            let executor = ExecutorOptions {
                scheduler: Address::parse(scheduler)?,
                listen: *listen,
                advertise: reached(advertise.as_deref(), listen.ip()),
                threads: threads.map_or(cores, |threads| threads as usize),
                memory_bytes: memory.map(|mib| mib << 20),
                work: work.clone(),
                traces: traces.clone(),
                stores: stores.clone(),
                files,
                credentials: cluster_arguments::credentials(identity.as_deref())?,
                works,
            };
            eprintln!(
                "reel: executor of {} at {listen}, {} parts at a time; Ctrl-C ends it",
                executor.scheduler, executor.threads
            );
            run_executor(&executor)?;
        }
        Command::Cert { names, out, days } => {
            for path in issue(out, names, *days)? {
                println!("{}", path.display());
            }
        }
    }
    Ok(ExitStatus::Success)
}

/// Where a process that listens at an address is reached.
fn reached(advertise: Option<&str>, listen: IpAddr) -> String {
    advertise.map_or_else(|| listen.to_string(), str::to_owned)
}
