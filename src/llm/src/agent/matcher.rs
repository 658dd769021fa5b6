//! What a query means by the vectors of an embedding model: the categories that are
//! near enough to it.

use std::{collections::BTreeMap, sync::Arc};

use crate::client::Client;
use reel_agents::{Matcher, ResponderError};
use reel_world::record::Lookup;

/// Cosine similarity from which a category is meant. Embedding models differ in how near unrelated
/// words are: look at a few queries of your own before you trust it.
pub const SIMILARITY_DEFAULT: f32 = 0.6;

/// Matches by an endpoint's `/embeddings`. Vectors of categories are asked for once.
pub struct Embeddings {
    client: Arc<Client>,
    similarity: f32,
    known: BTreeMap<String, Vec<f32>>,
}

impl Embeddings {
    /// Those of a model; a category is meant from this cosine similarity on.
    pub fn new(client: Arc<Client>, similarity: f32) -> Self {
        Self {
            client,
            similarity,
            known: BTreeMap::new(),
        }
    }
}

impl Matcher for Embeddings {
    fn look_up(&mut self, query: &str, categories: &[&str]) -> Result<Lookup, ResponderError> {
        let mut texts: Vec<&str> = [query]
            .iter()
            .chain(categories)
            .copied()
            .filter(|text| !self.known.contains_key(*text))
            .collect();
        texts.dedup();
        if !texts.is_empty() {
            let vectors = self.client.embed(&texts).map_err(ResponderError::new)?;
            self.known
                .extend(texts.iter().map(ToString::to_string).zip(vectors));
        }
        let meant = |category: &&&str| {
            cosine(&self.known[query], &self.known[**category]) >= self.similarity
        };
        let categories = categories
            .iter()
            .filter(meant)
            .map(ToString::to_string)
            .collect();
        Ok(Lookup {
            categories,
            source: self.client.endpoint().model.clone(),
        })
    }
}

/// 0 where one of them has no direction or they are of different lengths.
fn cosine(one: &[f32], other: &[f32]) -> f32 {
    let product = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| f64::from(*a) * f64::from(*b))
            .sum::<f64>()
    };
    let lengths = (product(one, one) * product(other, other)).sqrt();
    if lengths == 0.0 || one.len() != other.len() {
        0.0
    } else {
        (product(one, other) / lengths) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::cosine;

    #[test]
    fn similarity_of_vectors() {
        assert_eq!(cosine(&[1.0, 0.0], &[2.0, 0.0]), 1.0);
        assert_eq!(cosine(&[1.0, 0.0], &[0.0, 3.0]), 0.0);
        assert_eq!(cosine(&[0.0, 0.0], &[0.0, 3.0]), 0.0);
        assert_eq!(cosine(&[1.0], &[1.0, 0.0]), 0.0);
    }
}
