//! Where a model is asked, and how.

use std::{env, fmt, time::Duration};

use serde_json::{Map, Value};

use crate::client::ModelError;

/// Where a model is asked, and how.
#[derive(Clone, Debug)]
pub struct Endpoint {
    /// Up to and without `/chat/completions`, mostly ending in `/v1`. Holds no secret: it
    /// is shown in errors.
    pub base_url: String,
    /// The model's name at the endpoint.
    pub model: String,
    /// Sent as bearer token; local servers want none.
    pub api_key: Option<ApiKey>,
    /// For one try, from connecting to the last byte of the answer.
    pub timeout: Duration,
    /// How often a call is tried again.
    pub retries: u32,
    /// Sampling temperature; 0 is greedy.
    pub temperature: f64,
    /// Most tokens that the model may write.
    pub max_tokens: u32,
    /// Whether the log-probabilities of the tokens that the model writes are asked for; not
    /// every endpoint gives them.
    pub logprobs: bool,
    /// Further fields of every request, e.g. `seed`; they replace fields of the same name, and
    /// `null` takes one away (models that want `max_completion_tokens` refuse `max_tokens`).
    pub extra: Map<String, Value>,
}

impl Endpoint {
    /// No key, 120 s, 4 retries, greedy, 2048 tokens, no log-probabilities.
    pub fn new(base_url: impl Into<String>, model: impl Into<String>) -> Self {
        Self {
            base_url: base_url.into(),
            model: model.into(),
            api_key: None,
            timeout: Duration::from_secs(120),
            retries: 4,
            temperature: 0.0,
            max_tokens: 2048,
            logprobs: false,
            extra: Map::new(),
        }
    }

    /// The address that requests go to.
    ///
    /// # Errors
    /// When the base is no http address, or one with parts that do not belong there: credentials
    /// would be shown in errors.
    pub fn url(&self) -> Result<String, ModelError> {
        Ok(format!("{}/chat/completions", self.base()?))
    }

    /// The address that texts go to for their vectors.
    ///
    /// # Errors
    /// As [`Endpoint::url`].
    pub fn embeddings_url(&self) -> Result<String, ModelError> {
        Ok(format!("{}/embeddings", self.base()?))
    }

    fn base(&self) -> Result<&str, ModelError> {
        let base = self.base_url.trim().trim_end_matches('/');
        let base = base.strip_suffix("/chat/completions").unwrap_or(base);
        let host = base
            .strip_prefix("http://")
            .or_else(|| base.strip_prefix("https://"));
        let wrong = match host {
            None => Some("it has to begin with http:// or https://"),
            Some(host) if host.contains('@') => Some(
                "it must hold no user name or password; the key goes into an environment variable",
            ),
            Some(host) if host.contains(['?', '#']) => Some("it must hold no query"),
            Some(host)
                if host.is_empty()
                    || host.contains(|c: char| c.is_whitespace() || c.is_control()) =>
            {
                Some("it names no host")
            }
            Some(_) => None,
        };
        match wrong {
            Some(what) => Err(ModelError::BaseUrl { problem: what }),
            None => Ok(base),
        }
    }
}

/// A secret; shown nowhere.
#[derive(Clone, PartialEq, Eq)]
pub struct ApiKey(String);

impl ApiKey {
    /// A key as it is sent, without white space around it.
    ///
    /// # Errors
    /// When it is empty or cannot stand in a header.
    pub fn new(secret: &str) -> Result<Self, ModelError> {
        let secret = secret.trim();
        match !secret.is_empty() && secret.bytes().all(|byte| byte.is_ascii_graphic()) {
            true => Ok(Self(secret.to_owned())),
            false => Err(ModelError::BadKey),
        }
    }

    /// The key in an environment variable.
    ///
    /// # Errors
    /// When there is none, or none that can be sent.
    pub fn from_env(variable: &str) -> Result<Self, ModelError> {
        let secret = env::var(variable).map_err(|_| ModelError::NoKey {
            variable: variable.to_owned(),
        })?;
        Self::new(&secret)
    }

    /// What stands in the header.
    pub(crate) fn bearer(&self) -> String {
        format!("Bearer {}", self.0)
    }

    /// A text of the endpoint's without the key: some repeat it in their errors.
    pub(crate) fn redact(&self, text: &str) -> String {
        reel_redact::replace_value(text, "key", &self.0)
    }
}

impl fmt::Debug for ApiKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("[key]")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses() {
        let url = |base: &str| Endpoint::new(base, "m").url();
        assert_eq!(
            url("http://localhost:8000/v1/").unwrap(),
            "http://localhost:8000/v1/chat/completions"
        );
        assert_eq!(
            url(" https://a.example/v1/chat/completions").unwrap(),
            "https://a.example/v1/chat/completions"
        );
        for wrong in [
            "localhost:8000/v1",
            "https://",
            "https://me:secret@a.example/v1",
            "https://a.example/v1?key=secret",
            "http://a b",
        ] {
            let message = url(wrong).unwrap_err().to_string();
            assert!(
                message.contains("base url") && !message.contains("secret"),
                "{wrong}: {message}"
            );
        }
    }

    #[test]
    fn keys() {
        assert_eq!(ApiKey::new(" sk-1\n").unwrap().bearer(), "Bearer sk-1");
        for wrong in ["", "  ", "a b", "a\nb", "schlüssel"] {
            assert!(
                matches!(ApiKey::new(wrong), Err(ModelError::BadKey)),
                "{wrong:?}"
            );
        }
        let missing = ApiKey::from_env("REEL_TEST_NO_SUCH_VARIABLE").unwrap_err();
        assert!(
            missing.to_string().contains("REEL_TEST_NO_SUCH_VARIABLE"),
            "{missing}"
        );
        assert_eq!(format!("{:?}", ApiKey::new("sk-1").unwrap()), "[key]");
    }
}
