//! Log-probabilities of other policies over the tokens that an episode recorded: as lines of JSON,
//! or from the trace of another checkpoint that wrote the same tokens. Never computes with them.

use std::path::Path;

use reel_world::{OLD_POLICY, TokenLogprobs};
use serde::{Deserialize, Serialize};

use crate::{
    Images, LocalDisk, Trace, TraceError, TraceSummary, files, limits::Limits, rewrite::Encoding,
};

/// What a policy gives the tokens of one decision: a line of JSON.
#[derive(Clone, PartialEq, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoredTokens {
    /// Id of the episode whose decision was scored.
    pub episode_id: String,
    /// The decision, from 0.
    pub step: u32,
    /// The policy's name, e.g. `new` or `ref`; `old` sampled the tokens.
    pub policy: String,
    /// The tokens that were scored; `None` if nobody said, and only their number is checked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tokens: Option<Vec<String>>,
    /// Natural logarithms, at most 0, one a token.
    pub logprobs: Vec<f64>,
}

impl ScoredTokens {
    /// Reads lines of JSON; empty lines are skipped. `path` says in errors where they came from.
    ///
    /// # Errors
    /// The first line that is none.
    pub fn read_lines(text: &str, path: &Path) -> Result<Vec<ScoredTokens>, TraceError> {
        let lines = text
            .lines()
            .zip(1..)
            .filter(|(line, _)| !line.trim().is_empty());
        let read = |(text, line): (&str, u32)| {
            serde_json::from_str(text).map_err(|error| TraceError::ScoredLine {
                path: path.to_owned(),
                line,
                problem: error.to_string(),
            })
        };
        lines.map(read).collect()
    }
}

impl Trace {
    /// The decisions whose tokens were recorded, in order.
    pub fn logprobs(&self) -> impl Iterator<Item = (u32, &TokenLogprobs)> {
        self.steps
            .iter()
            .filter_map(|step| Some((step.step, step.input.policy.as_ref()?.logprobs.as_ref()?)))
    }

    /// The same as lines: one for each decision and policy.
    pub fn scored_tokens(&self) -> impl Iterator<Item = ScoredTokens> {
        self.logprobs().flat_map(move |(step, of)| {
            of.policies()
                .map(move |(policy, logprobs)| self.line(step, policy, of, logprobs))
        })
    }

    /// What the policy of this trace gave its own tokens, as lines about another episode by
    /// the name of `policy`.
    pub fn sampled_as(&self, episode_id: &str, policy: &str) -> Vec<ScoredTokens> {
        let line = |(step, of): (u32, &TokenLogprobs)| {
            let line = self.line(step, policy, of, of.of(OLD_POLICY)?);
            Some(ScoredTokens {
                episode_id: episode_id.to_owned(),
                ..line
            })
        };
        self.logprobs().filter_map(line).collect()
    }

    fn line(&self, step: u32, policy: &str, of: &TokenLogprobs, logprobs: &[f64]) -> ScoredTokens {
        ScoredTokens {
            episode_id: self.header.episode_id.clone(),
            step,
            policy: policy.to_owned(),
            tokens: Some(of.tokens().to_vec()),
            logprobs: logprobs.to_vec(),
        }
    }

    /// Adds what another policy gives the tokens of a decision. No digest changes.
    ///
    /// # Errors
    /// Fails if the decision has no recorded tokens, or the log-probabilities are not of them.
    pub fn add_scored(&mut self, scored: &ScoredTokens) -> Result<(), TraceError> {
        let ScoredTokens {
            step,
            policy,
            tokens,
            logprobs,
            ..
        } = scored;
        let path = self.path.clone();
        let record = self.steps.get_mut(*step as usize);
        match record.and_then(|record| record.input.policy.as_mut()?.logprobs.as_mut()) {
            None => Err(TraceError::NoTokens { path, step: *step }),
            Some(recorded) => recorded
                .add(policy, logprobs.clone(), tokens.as_deref())
                .map_err(|source| TraceError::Logprobs {
                    path,
                    step: *step,
                    source,
                }),
        }
    }

    /// Writes the trace again in its place, its images as they are; it is on the
    /// disk when this returns.
    ///
    /// # Errors
    /// Fails if the trace has no end, or the file cannot be written.
    pub fn save(&self) -> Result<TraceSummary, TraceError> {
        let Some(end) = &self.end else {
            return Err(TraceError::Missing {
                path: self.path.clone(),
                part: "end of the episode",
            });
        };
        let images = if self.image_count() + self.originals.len() > 0 {
            Images::Full
        } else {
            Images::None
        };
        let webp = |step| Ok(self.image(step).map(|webp| Encoding::Webp(webp.to_vec())));
        let (bytes, chain) = self.rendered(
            &self.path,
            (images, self.layers()),
            &self.recoveries,
            end,
            webp,
        )?;
        if chain != self.chain() {
            return Err(TraceError::OtherOrder {
                path: self.path.clone(),
            });
        }
        // What does not read is not written.
        Trace::from_bytes(&self.path, &bytes, &Limits::default())?;
        let failed = |source| TraceError::Io {
            action: "write",
            path: self.path.clone(),
            source,
        };
        files::publish(&LocalDisk, &self.path, &bytes).map_err(failed)?;
        Ok(TraceSummary {
            path: self.path.clone(),
            bytes: bytes.len() as u64,
            chain: self.chain(),
        })
    }
}
