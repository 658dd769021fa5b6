//! Who asks a cluster: sessions whose plans go to a scheduler, and work on traces.

use std::{
    net::{TcpStream, ToSocketAddrs as _},
    path::PathBuf,
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};

use ballista_core::extension::SessionConfigExt as _;
use datafusion::{
    execution::SessionState,
    prelude::{SessionConfig, SessionContext},
};
use futures_util::{StreamExt as _, stream};
use reel_query::{EngineFactory, TraceAccess, every_function};
use reel_trace::TraceFiles;
use url::Url;

use crate::{
    ClusterError, Credentials, engine, files, runtime,
    work::{self, Worker},
};

/// Where schedulers listen unless they are told otherwise.
pub(crate) const PORT: u16 = 50050;
/// How long a scheduler may take to answer the door.
const PATIENCE: Duration = Duration::from_secs(5);
/// Groups of traces in one job: an answer comes when the job is done, so few; a job costs a
/// while, so not one.
const GROUPS_IN_JOB: usize = 64;
/// Jobs under way at a time: while the last parts of one are worked off, the next one is.
const JOBS_AHEAD: usize = 2;
/// How long a job that failed is tried again, counted from the first failure in a row.
const TRY_AGAIN: Duration = Duration::from_secs(180);
/// How long to wait before it is tried again.
const WAIT: Duration = Duration::from_secs(3);
/// The largest message, in bytes: a part of an answer.
pub(crate) const MESSAGE_BYTES: usize = 256 << 20;

/// Where a scheduler listens.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Address {
    /// A name or an IP address.
    pub host: String,
    /// TCP port on which the scheduler listens.
    pub port: u16,
}

impl Address {
    /// Understands `host`, `host:port` and `df://host:port`.
    ///
    /// # Errors
    /// When it is none of these.
    pub fn parse(text: &str) -> Result<Self, ClusterError> {
        let wrong = |reason: String| ClusterError::Address {
            text: text.to_owned(),
            reason,
        };
        let whole = if text.contains("://") {
            text.to_owned()
        } else {
            format!("df://{text}")
        };
        let url = Url::parse(&whole).map_err(|error| wrong(error.to_string()))?;
        if !["df", "http"].contains(&url.scheme()) {
            return Err(wrong(format!("'{}://' is not served", url.scheme())));
        }
        let host = url
            .host_str()
            .filter(|host| !host.is_empty())
            .ok_or_else(|| wrong("it names no host".to_owned()))?;
        Ok(Self {
            host: host.to_owned(),
            port: url.port().unwrap_or(PORT),
        })
    }
}

impl std::fmt::Display for Address {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}:{}", self.host, self.port)
    }
}

/// A cluster that answers.
#[derive(Clone)]
pub struct Cluster {
    address: Address,
    credentials: Arc<Credentials>,
    /// Hears why work is done again.
    trouble: fn(&str),
}

impl Cluster {
    /// The cluster of a scheduler that takes these credentials. `trouble` hears why work is done
    /// again.
    ///
    /// # Errors
    /// When no scheduler answers there, or it refuses the credentials.
    pub fn connect(
        address: &Address,
        credentials: Credentials,
        trouble: fn(&str),
    ) -> Result<Self, ClusterError> {
        let silent = |reason: String| ClusterError::Silent {
            address: address.to_string(),
            reason,
        };
        let mut places = (address.host.as_str(), address.port)
            .to_socket_addrs()
            .map_err(|error| silent(error.to_string()))?;
        let place = places
            .next()
            .ok_or_else(|| silent("the name has no address".to_owned()))?;
        TcpStream::connect_timeout(&place, PATIENCE).map_err(|error| silent(error.to_string()))?;
        let runtime = runtime().map_err(|error| silent(error.to_string()))?;
        runtime.block_on(credentials.check(address, Duration::ZERO))?;
        Ok(Self {
            address: address.clone(),
            credentials: Arc::new(credentials),
            trouble,
        })
    }

    /// The engine of sessions that let the cluster answer: `QuerySession::with_remote_engine`.
    pub fn engine(&self) -> Box<EngineFactory> {
        let (address, credentials) = (self.address.clone(), self.credentials.clone());
        Box::new(move |state: SessionState| engine::engine(state, &address, &credentials))
    }

    /// Does work on groups of traces; `take` gets each group's answer once, in their order. What
    /// fails because a machine or the scheduler went away is done again, for some minutes.
    /// Ctrl-C calls it off.
    ///
    /// # Errors
    /// When an executor refuses, the cluster stays away, or somebody called it off; what `take`
    /// says. Some groups were handed on then.
    pub fn work<E: From<ClusterError>>(
        &self,
        work: &str,
        options: &str,
        groups: &[Vec<PathBuf>],
        mut take: impl FnMut(Vec<u8>) -> Result<(), E>,
    ) -> Result<(), E> {
        let failed = |reason: String| ClusterError::Run {
            action: "the cluster cannot be asked",
            reason,
        };
        let runtime = runtime().map_err(|error| failed(error.to_string()))?;
        let numbered: Vec<(usize, &[PathBuf])> =
            groups.iter().map(Vec::as_slice).enumerate().collect();
        let (sender, receiver) = mpsc::sync_channel(0);
        let ask = async move {
            let jobs: Vec<_> = numbered
                .chunks(GROUPS_IN_JOB)
                .map(|groups| self.job(work, options, groups))
                .collect();
            let mut jobs = stream::iter(jobs).buffered(JOBS_AHEAD);
            loop {
                let answers = tokio::select! {
                    answers = jobs.next() => answers,
                    _ = tokio::signal::ctrl_c() => Some(Err(ClusterError::Stopped)),
                };
                let Some(answers) = answers else { return };
                let last = answers.is_err();
                // whoever takes them is not on a thread of the runtime, and may wait; when it takes
                // no more, jobs are called off
                if sender.send(answers).is_err() || last {
                    return;
                }
            }
        };
        std::thread::scope(|scope| {
            scope.spawn(move || runtime.block_on(ask));
            let mut answers = receiver.into_iter();
            answers.try_for_each(|answers| answers?.into_iter().try_for_each(&mut take))
        })
    }

    /// Groups of traces in one job, which is done again where it fails.
    async fn job(
        &self,
        work: &str,
        options: &str,
        groups: &[(usize, &[PathBuf])],
    ) -> Result<Vec<Vec<u8>>, ClusterError> {
        let mut first_failure = None;
        loop {
            let reason = match self.try_job(work, options, groups).await {
                Ok(mut answers) => {
                    answers.sort_by_key(|(number, _)| *number);
                    let answers = answers.into_iter().map(|(_, answer)| answer);
                    return answers
                        .collect::<Result<_, String>>()
                        .map_err(|reason| ClusterError::Refused { reason });
                }
                Err(error) => error.to_string(),
            };
            if first_failure.get_or_insert_with(Instant::now).elapsed() > TRY_AGAIN {
                return Err(ClusterError::Lost {
                    address: self.address.to_string(),
                    reason,
                });
            }
            (self.trouble)(&reason);
            tokio::time::sleep(WAIT).await;
        }
    }

    async fn try_job(
        &self,
        work: &str,
        options: &str,
        groups: &[(usize, &[PathBuf])],
    ) -> datafusion::error::Result<work::GroupResults> {
        let config = SessionConfig::new_with_ballista();
        let state = every_function(
            config,
            files::environment(None)?,
            TraceAccess::Nothing,
            TraceFiles::default(),
        );
        let mut state = engine::engine(state, &self.address, &self.credentials)?;
        Worker::nobody().equip(&mut state)?;
        let context = SessionContext::new_with_state(state);
        let plan = work::plan(
            &self.credentials.build,
            work,
            options,
            groups,
            &context.state(),
        )?;
        let answers = work::answers(&context.execute_logical_plan(plan).await?.collect().await?)?;
        if answers.len() == groups.len() {
            return Ok(answers);
        }
        datafusion::common::exec_err!("{} of {} parts came back", answers.len(), groups.len())
    }
}

impl std::fmt::Debug for Cluster {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Cluster")
            .field("address", &self.address)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_understood_as_people_write_them() {
        let parsed = |text: &str| Address::parse(text).map(|address| address.to_string());
        assert_eq!(parsed("10.0.0.1").unwrap(), "10.0.0.1:50050");
        assert_eq!(parsed("lab:7").unwrap(), "lab:7");
        assert_eq!(parsed("df://lab:7").unwrap(), "lab:7");
        for wrong in ["", "https://lab", "lab:seven", "df://"] {
            assert!(
                parsed(wrong).unwrap_err().to_string().contains("host:port"),
                "{wrong}"
            );
        }
    }
}
