//! Models that commands ask, behind OpenAI-compatible endpoints.

use std::{
    path::Path,
    sync::Arc,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

use reel_llm::client::{ApiKey, Cache, CallLog, Client, Clock, Endpoint};

/// The model to ask, behind an OpenAI-compatible endpoint.
#[derive(clap::Args)]
pub struct Model {
    /// Address up to `/v1`
    #[arg(long, value_name = "URL", requires = "model")]
    endpoint: Option<String>,
    /// The model's name there
    #[arg(long, value_name = "NAME", requires = "endpoint")]
    model: Option<String>,
    /// Environment variable that holds the key, where one is needed
    #[arg(long, value_name = "VARIABLE", requires = "endpoint")]
    key_from: Option<String>,
}

impl Model {
    /// A client that keeps replies in a folder and adds every call to a file; none where
    /// no model was named.
    pub fn client(&self, cache: &Path, log: &Path) -> anyhow::Result<Option<Client>> {
        let (Some(endpoint), Some(model)) = (&self.endpoint, &self.model) else {
            return Ok(None);
        };
        let mut endpoint = Endpoint::new(endpoint, model);
        endpoint.api_key = self.key_from.as_deref().map(ApiKey::from_env).transpose()?;
        let client = Client::new(endpoint, Arc::new(RealClock))?;
        Ok(Some(
            client
                .with_cache(Cache::open(cache)?)
                .with_log(CallLog::append(log)?),
        ))
    }
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
