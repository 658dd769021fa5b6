//! What `show_object_by_category` means by a query, from the command line: the word list of Reel,
//! an embedding model, or vectors from a file.

use std::{path::PathBuf, sync::Arc};

use anyhow::{Context, bail};
use reel_agents::{Matcher as _, Responders};
use reel_llm::{
    agent::{MatchRule, SIMILARITY_DEFAULT, TextVectors, VectorMatcher},
    client::Client,
};
use reel_server::{LookUp, MatcherConfig};
use serde_json::{Value, json};

/// Folder of kept vectors, beside the traces that a run writes.
pub const EMBEDDINGS: &str = "embeddings";

/// How queries are matched to categories.
#[derive(clap::Args)]
pub struct MatchArguments {
    /// Match the query of `show_object_by_category` by this embedding model at the endpoint;
    /// without it Reel's word list decides among the categories in view
    #[arg(
        long,
        alias = "match-model",
        value_name = "NAME",
        conflicts_with = "embedding_vectors"
    )]
    embedding_model: Option<String>,
    /// Match it by the vectors of this file: one JSON object, {"mug": [0.1, ...], ...}, with
    /// every category and every query
    #[arg(long, value_name = "FILE")]
    embedding_vectors: Option<PathBuf>,
    /// Which categories a query means by vectors: best (the most similar one of the whole scene, as
    /// in the paper; the default) or threshold (all from --min-similarity on)
    #[arg(long, value_name = "RULE", value_parser = ["best", "threshold"])]
    match_rule: Option<String>,
    /// Cosine similarity from which a category is meant; implies --match-rule threshold
    #[arg(
        long,
        alias = "match-similarity",
        value_name = "S",
        allow_negative_numbers = true
    )]
    min_similarity: Option<f32>,
}

/// A chosen way to match, shared by all episodes of a run.
pub struct Matching {
    vectors: Arc<TextVectors>,
    rule: MatchRule,
}

impl MatchArguments {
    /// These, and what a configuration says where they say nothing. A source of vectors replaces the
    /// other one.
    pub fn or(&self, configured: &MatcherConfig) -> Self {
        let (model, vectors) = match (&self.embedding_model, &self.embedding_vectors) {
            (None, None) => (configured.model.clone(), configured.vectors.clone()),
            given => (given.0.clone(), given.1.clone()),
        };
        Self {
            embedding_model: model,
            embedding_vectors: vectors,
            match_rule: self.match_rule.clone().or(configured.rule.clone()),
            min_similarity: self.min_similarity.or(configured.min_similarity),
        }
    }

    /// The way to match; `None` if the word list decides. `client` connects to a model of the
    /// endpoint.
    ///
    /// # Errors
    /// Fails if the endpoint or the file of vectors cannot be used.
    pub fn matching(
        &self,
        client: impl FnOnce(&str) -> anyhow::Result<Arc<Client>>,
    ) -> anyhow::Result<Option<Matching>> {
        if let (Some("best"), Some(_)) = (self.match_rule.as_deref(), self.min_similarity) {
            bail!(
                "rule best takes the most similar category, whatever --min-similarity says: leave one out"
            );
        }
        if let Some(least) = self.min_similarity.filter(|it| !(-1.0..=1.0).contains(it)) {
            bail!("--min-similarity is a cosine from -1 to 1, not {least}");
        }
        let vectors = match (&self.embedding_model, &self.embedding_vectors) {
            (Some(_), Some(_)) => {
                bail!("match by an embedding model or by a file of vectors, not both")
            }
            (Some(model), None) => TextVectors::of_endpoint(client(model)?),
            (None, Some(path)) => TextVectors::of_file(path).context("--embedding-vectors")?,
            (None, None) if self.min_similarity.is_some() || self.match_rule.is_some() => bail!(
                "--match-rule and --min-similarity need --embedding-model or --embedding-vectors"
            ),
            (None, None) => return Ok(None),
        };
        let rule = match (self.min_similarity, self.match_rule.as_deref()) {
            (Some(least), _) => MatchRule::Threshold(least),
            (None, Some("threshold")) => MatchRule::Threshold(SIMILARITY_DEFAULT),
            (None, None | Some("best")) => MatchRule::Best,
            (None, Some(other)) => bail!("the rule is best or threshold, not '{other}'"),
        };
        Ok(Some(Matching {
            vectors: Arc::new(vectors),
            rule,
        }))
    }
}

impl Matching {
    /// Lets it answer in an episode, and names it in the trace.
    pub fn install(&self, outside: &mut Responders) {
        outside
            .settings
            .insert("matcher".to_owned(), self.settings());
        outside.matcher = Some(Box::new(self.matcher()));
    }

    /// What a trace says of it.
    pub fn settings(&self) -> Value {
        let mut settings = match self.rule {
            MatchRule::Best => json!({"rule": "best"}),
            MatchRule::Threshold(least) => json!({"rule": "threshold", "similarity": least}),
        };
        settings["vectors"] = json!(self.vectors.name());
        if let Some(digest) = self.vectors.digest() {
            settings["blake3"] = json!(digest.to_string());
        }
        settings
    }

    /// Whether somebody is asked over the network.
    pub fn asks_endpoint(&self) -> bool {
        self.vectors.digest().is_none()
    }

    /// Lets it answer for a server.
    pub fn look_up(self) -> LookUp {
        Arc::new(move |query, categories| Ok(self.matcher().look_up(query, categories)?))
    }

    fn matcher(&self) -> VectorMatcher {
        VectorMatcher::new(Arc::clone(&self.vectors), self.rule)
    }
}
