//! `--cluster` of commands that work on traces: the same functions, called by the
//! executors of a cluster.

#[cfg(feature = "cluster")]
use std::path::{Path, PathBuf};

#[cfg(feature = "cluster")]
use reel_cluster::{Address, Cluster, Credentials, Identity, TraceJob};

/// The cluster that does the work of a command, if one is named.
#[derive(clap::Args, Default)]
pub struct ClusterArguments {
    /// Let the cluster of this scheduler do the work (`reel cluster`)
    #[cfg(feature = "cluster")]
    #[arg(long, value_name = "HOST:PORT", env = "REEL_CLUSTER")]
    cluster: Option<String>,
    /// File of identity that a cluster with identities asks for (`reel cluster cert`)
    #[cfg(feature = "cluster")]
    #[arg(
        long,
        value_name = "FILE",
        env = "REEL_CLUSTER_IDENTITY",
        requires = "cluster"
    )]
    identity: Option<PathBuf>,
}

impl ClusterArguments {
    /// Whether a cluster is named.
    pub fn is_set(&self) -> bool {
        #[cfg(feature = "cluster")]
        return self.cluster.is_some();
        #[cfg(not(feature = "cluster"))]
        false
    }
}

#[cfg(feature = "cluster")]
impl ClusterArguments {
    /// The cluster, if one is named.
    ///
    /// # Errors
    /// When it does not answer.
    pub fn open(&self) -> anyhow::Result<Option<Cluster>> {
        let connect = |text: &String| {
            let credentials = credentials(self.identity.as_deref())?;
            Cluster::connect(&Address::parse(text)?, credentials, |reason| {
                eprintln!("reel: the cluster is in trouble, trying again: {reason}")
            })
            .map_err(anyhow::Error::from)
        };
        self.cluster.as_ref().map(connect).transpose()
    }

    /// Does work on each trace at the cluster, if one is named: answers in the order of the traces.
    ///
    /// # Errors
    /// When the cluster does not answer or refuses.
    pub fn map_traces<T: serde::de::DeserializeOwned>(
        &self,
        work: &str,
        options: &impl serde::Serialize,
        traces: &[PathBuf],
        done: impl Fn(u64),
    ) -> anyhow::Result<Option<Vec<T>>> {
        let Some(cluster) = self.open()? else {
            return Ok(None);
        };
        let groups: Vec<Vec<PathBuf>> = traces
            .chunks(TRACES_PER_GROUP)
            .map(named_from_root)
            .collect::<anyhow::Result<_>>()?;
        let mut answers = Vec::with_capacity(traces.len());
        cluster.work(
            work,
            &serde_json::to_string(options)?,
            &groups,
            |answer| -> anyhow::Result<()> {
                let some: Vec<T> = serde_json::from_slice(&answer)?;
                done(some.len() as u64);
                answers.extend(some);
                Ok(())
            },
        )?;
        anyhow::ensure!(
            answers.len() == traces.len(),
            "the cluster gave {} answers for {} traces",
            answers.len(),
            traces.len()
        );
        Ok(Some(answers))
    }
}

#[cfg(not(feature = "cluster"))]
impl ClusterArguments {
    /// This build knows no clusters.
    #[expect(
        clippy::unused_self,
        clippy::unnecessary_wraps,
        reason = "as with the feature"
    )]
    pub fn map_traces<T>(
        &self,
        _: &str,
        _: &impl serde::Serialize,
        _: &[std::path::PathBuf],
        _: impl Fn(u64),
    ) -> anyhow::Result<Option<Vec<T>>> {
        Ok(None)
    }
}

#[cfg(feature = "analytics")]
impl ClusterArguments {
    /// A session over a store, whose plans run at the cluster if one is named.
    ///
    /// # Errors
    /// When the engine cannot be set up, or no scheduler answers.
    pub fn session(
        &self,
        store: reel_tables::Store,
        limits: reel_query::Limits,
    ) -> anyhow::Result<reel_query::QuerySession> {
        #[cfg(feature = "cluster")]
        if let Some(cluster) = self.open()? {
            return Ok(reel_query::QuerySession::with_remote_engine(
                store,
                limits,
                cluster.engine(),
            )?);
        }
        Ok(reel_query::QuerySession::with_limits(store, limits)?)
    }
}

/// Traces that one part of a job works on.
#[cfg(feature = "cluster")]
const TRACES_PER_GROUP: usize = 4;

/// Names this program to executors: verdicts of another simulator, or other answers, would not be
/// those of this one.
#[cfg(feature = "cluster")]
pub fn build_fingerprint() -> String {
    format!(
        "{} (simulator {})",
        env!("CARGO_PKG_VERSION"),
        reel_sim::SIM_VERSION
    )
}

/// What this program shows to a cluster.
///
/// # Errors
/// When the file of identity cannot be used.
#[cfg(feature = "cluster")]
pub fn credentials(identity: Option<&Path>) -> anyhow::Result<Credentials> {
    Ok(Credentials {
        identity: identity.map(Identity::read).transpose()?,
        build: build_fingerprint(),
    })
}

/// Some traces, as other machines name them.
#[cfg(feature = "cluster")]
pub fn named_from_root(traces: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    let name = |trace: &PathBuf| match reel_trace::is_remote(trace) {
        true => Ok(trace.clone()),
        false => Ok(std::path::absolute(trace)?),
    };
    traces.iter().map(name).collect()
}

/// Work whose options and answers are JSON.
#[cfg(feature = "cluster")]
pub fn work<O: serde::de::DeserializeOwned, A: serde::Serialize>(
    name: &'static str,
    run: impl Fn(&[PathBuf], O) -> Result<Vec<A>, String> + Send + Sync + 'static,
) -> TraceJob {
    let told = |error: serde_json::Error| error.to_string();
    let run = move |traces: &[PathBuf], options: &str| {
        let answers = run(traces, serde_json::from_str(options).map_err(told)?)?;
        serde_json::to_vec(&answers).map_err(told)
    };
    TraceJob {
        name,
        traces: true,
        run: std::sync::Arc::new(run),
    }
}
