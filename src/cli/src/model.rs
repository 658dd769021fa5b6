//! Models that commands ask, behind OpenAI-compatible endpoints.

use std::{
    path::Path,
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use anyhow::Context;
use reel_llm::client::{ApiKey, Cache, CallLog, Client, Clock, Endpoint};

/// The model to ask, behind an OpenAI-compatible endpoint.
#[derive(clap::Args)]
pub struct Model {
    /// OpenAI-compatible endpoint of the model, up to /v1
    #[arg(long, value_name = "URL", requires = "model")]
    endpoint: Option<String>,
    /// The model's name at the endpoint; without it no model is asked
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// Environment variable that holds the endpoint's key, where one is needed
    #[arg(long = "api-key-env", alias = "key-from", value_name = "VARIABLE")]
    key_from: Option<String>,
}

impl Model {
    /// A client that keeps replies in a folder and adds every call to a file; none where
    /// no model was named.
    pub fn client(&self, cache: &Path, log: &Path) -> anyhow::Result<Option<Client>> {
        let Some(model) = &self.model else {
            return Ok(None);
        };
        let endpoint = self
            .endpoint
            .as_ref()
            .context("--endpoint is missing: the address of the model")?;
        let endpoint = Endpoint::new(endpoint, model);
        client_of(endpoint, self.key_from.as_deref(), cache, log).map(Some)
    }
}

/// A client of a model that keeps replies in a folder and adds every call to a file.
///
/// # Errors
/// Fails if the endpoint's address or key, the folder or the file cannot be used.
pub fn client_of(
    mut endpoint: Endpoint,
    key_from: Option<&str>,
    cache: &Path,
    log: &Path,
) -> anyhow::Result<Client> {
    endpoint.api_key = key_from.map(ApiKey::from_env).transpose()?;
    let client = Client::new(endpoint, Arc::new(RealClock))?;
    Ok(client
        .with_cache(Cache::open(cache)?)
        .with_log(CallLog::append(log)?))
}

/// Clock that reads the system time and sleeps on the calling thread.
pub struct RealClock;

impl Clock for RealClock {
    fn now_ns(&self) -> u64 {
        SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .map_or(0, |time| time.as_nanos() as u64)
    }

    fn sleep(&self, pause: Duration) {
        std::thread::sleep(pause);
    }
}
