//! Who plays: a built-in policy or a model, and who answers from outside, from the command line.

use std::{collections::BTreeMap, path::Path, sync::Arc, time::Duration};

use anyhow::{Context, bail};
use reel_agents::{AgentError, EpisodeJob, POLICIES, Participants, Responders, builtin};
use reel_llm::agent::{AgentStyle, ModelUser, agent};
use reel_llm::client::{ApiKey, Cache, CallLog, Client, Endpoint};
use reel_prompt::Prompt;
use serde_json::{Map, Value, json};

use crate::{
    match_arguments::{EMBEDDINGS, MatchArguments, Matching},
    model::RealClock,
    prompt::{MemoryArguments, PromptArguments},
};

/// Who plays, and whom they ask.
#[derive(clap::Args)]
pub struct AgentArguments {
    /// Who decides: a built-in policy, real-agent or function-calling
    #[arg(long, value_name = "NAME", default_value = "oracle")]
    pub agent: String,
    /// OpenAI-compatible endpoint of the models, up to /v1
    #[arg(long, value_name = "URL")]
    endpoint: Option<String>,
    /// The agent's model at the endpoint
    #[arg(long, value_name = "NAME")]
    model: Option<String>,
    /// Environment variable that holds the endpoint's key, where one is needed
    #[arg(long = "api-key-env", alias = "key-from", value_name = "VARIABLE")]
    key_from: Option<String>,
    #[command(flatten)]
    prompt: PromptArguments,
    #[command(flatten)]
    memory: MemoryArguments,
    /// Sampling temperature; 0 is greedy
    #[arg(long, value_name = "T", default_value_t = 0.0)]
    temperature: f64,
    /// Most tokens that the agent may write for a decision
    #[arg(long, value_name = "N", default_value_t = 4096)]
    max_tokens: u32,
    /// Record the log-probabilities of the tokens that the agent writes, where
    /// the endpoint gives them
    #[arg(long)]
    pub logprobs: bool,
    /// Further fields of every request, as a JSON object; null takes a field away
    #[arg(long = "extra-body", alias = "request", value_name = "JSON")]
    request: Option<String>,
    /// How long the endpoint may take for one answer, in seconds
    #[arg(long, value_name = "S", default_value_t = 120.0)]
    timeout: f64,
    /// How often a request is tried again after 408, 429, 5xx, a refused or cut connection, or
    /// no answer in time
    #[arg(long, value_name = "N", default_value_t = 4)]
    retries: u32,
    /// The user who answers `ask` is this model at the endpoint; without it the rules answer
    #[arg(long, value_name = "NAME")]
    user_model: Option<String>,
    #[command(flatten)]
    matching: MatchArguments,
}

/// Players that can be seated at an episode.
pub struct AgentSet {
    agent: String,
    deciding: Option<(AgentStyle, Arc<Client>)>,
    prompt: Arc<Prompt>,
    user: Option<Arc<Client>>,
    matching: Option<Matching>,
}

impl AgentArguments {
    /// The players, with a log of their calls where models are asked.
    ///
    /// # Errors
    /// When there is no such agent, or what it needs is missing.
    pub fn agent_set(&self, log: &Path) -> anyhow::Result<AgentSet> {
        let style = AgentStyle::parse(&self.agent);
        if style.is_none() && !POLICIES.iter().any(|(name, _)| *name == self.agent) {
            let models =
                AgentStyle::ALL.map(|(style, what)| format!("  {:17} {what}", style.as_str()));
            let known = POLICIES
                .iter()
                .map(|(name, what)| format!("  {name:17} {what}"))
                .chain(models);
            bail!(
                "no agent is called '{}'; there are\n{}",
                self.agent,
                known.collect::<Vec<_>>().join("\n")
            );
        }
        let connect = |model: &str, max_tokens: u32, logprobs: bool| -> anyhow::Result<Client> {
            let url = self
                .endpoint
                .as_deref()
                .context("--endpoint is missing: the address of the model")?;
            let mut endpoint = Endpoint::new(url, model);
            endpoint.api_key = self.key_from.as_deref().map(ApiKey::from_env).transpose()?;
            endpoint.temperature = self.temperature;
            endpoint.max_tokens = max_tokens;
            endpoint.logprobs = logprobs;
            endpoint.retries = self.retries;
            endpoint.timeout = Duration::try_from_secs_f64(self.timeout)
                .context("--timeout must be a time in seconds")?;
            endpoint.extra = self.extra()?;
            Ok(Client::new(endpoint, Arc::new(RealClock))?.with_log(CallLog::append(log)?))
        };
        let client =
            |model: &str, max_tokens, logprobs| connect(model, max_tokens, logprobs).map(Arc::new);
        let deciding = match style {
            Some(style) => {
                let model = self
                    .model
                    .as_deref()
                    .with_context(|| format!("{} needs --endpoint and --model", self.agent))?;
                Some((style, client(model, self.max_tokens, self.logprobs)?))
            }
            None if self.logprobs => bail!("--logprobs needs an agent that a model drives"),
            None => None,
        };
        let user = self
            .user_model
            .as_deref()
            .map(|model| client(model, USER_TOKENS, false))
            .transpose()?;
        let matching = self.matching.matching(|model| {
            let cache = Cache::open(log.with_file_name(EMBEDDINGS))?;
            Ok(Arc::new(connect(model, 0, false)?.with_cache(cache)))
        })?;
        let prompt = self.memory.apply(&self.prompt.prompt()?);
        Ok(AgentSet {
            agent: self.agent.clone(),
            deciding,
            prompt,
            user,
            matching,
        })
    }

    fn extra(&self) -> anyhow::Result<Map<String, Value>> {
        let Some(text) = &self.request else {
            return Ok(Map::new());
        };
        serde_json::from_str(text)
            .context("--extra-body must be a JSON object, like '{\"top_p\": 1}'")
    }
}

/// Most tokens that a user may write.
pub const USER_TOKENS: u32 = 1024;

/// What a trace says of a model that plays the user.
pub fn user_settings(client: &Client) -> Value {
    let prompt = ModelUser::prompt_digest().to_string();
    json!({"model": client.endpoint().model, "prompt": prompt})
}

impl AgentSet {
    /// What the players are called: of a model with its name.
    pub fn name(&self) -> String {
        match &self.deciding {
            Some((style, client)) => format!("{}:{}", style.as_str(), client.endpoint().model),
            None => self.agent.clone(),
        }
    }

    /// The memory options of the prompt that are on, if the agent is asked by it.
    pub fn memory_options(&self) -> Vec<&'static str> {
        match &self.deciding {
            Some((AgentStyle::SingleTurn, _)) => self.prompt.memory().enabled().collect(),
            _ => Vec::new(),
        }
    }

    /// Whether anybody is asked over the network.
    pub fn uses_model(&self) -> bool {
        self.deciding.is_some()
            || self.user.is_some()
            || self.matching.as_ref().is_some_and(Matching::asks_endpoint)
    }

    /// Seats them at an episode.
    ///
    /// # Errors
    /// Never for names that [`AgentArguments::agent_set`] let through.
    pub fn instantiate(&self, job: &EpisodeJob) -> Result<Participants, AgentError> {
        let outside = self.outside();
        match &self.deciding {
            Some((style, client)) => {
                let policy = agent(
                    *style,
                    client.clone(),
                    &self.prompt,
                    job.config.profile.names(),
                    job.config.seed,
                );
                Ok(Participants { policy, outside })
            }
            None => Ok(Participants {
                outside,
                ..builtin(job)?
            }),
        }
    }

    fn outside(&self) -> Responders {
        let mut outside = Responders {
            user: None,
            matcher: None,
            settings: BTreeMap::new(),
        };
        if let Some(client) = &self.user {
            outside
                .settings
                .insert("user".to_owned(), user_settings(client));
            outside.user = Some(Box::new(ModelUser::new(client.clone())));
        }
        if let Some(matching) = &self.matching {
            matching.install(&mut outside);
        }
        outside
    }
}
