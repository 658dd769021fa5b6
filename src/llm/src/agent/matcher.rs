//! What a query means by the vectors of its text and of the categories: by an embedding model, or
//! by a file of vectors.

use std::{
    collections::{BTreeMap, HashMap},
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use crate::client::Client;
use reel_agents::{Matcher, ResponderError};
use reel_world::{Digest, record::Lookup};

/// Which categories a query means, by the cosine similarity of its vector to theirs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum MatchRule {
    /// The one category with the highest similarity, as in the paper: something always matches. Of
    /// equal ones the first in alphabetical order.
    Best,
    /// Every category from this similarity on, the most similar first; perhaps none.
    Threshold(f32),
}

/// Similarity from which a category is meant by [`MatchRule::Threshold`], if nobody says another.
/// Embedding models differ in how near unrelated words are: look at a few queries of your own
/// before you trust it.
pub const SIMILARITY_DEFAULT: f32 = 0.6;

/// Vectors of texts, each computed or read once. Shared by the episodes of a run.
pub struct TextVectors {
    source: VectorSource,
    known: Mutex<HashMap<String, Arc<[f32]>>>,
}

enum VectorSource {
    Endpoint(Arc<Client>),
    File { path: PathBuf, digest: Digest },
}

/// A file of vectors that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum VectorFileError {
    /// The file cannot be read.
    #[error("cannot read {path}")]
    Read {
        /// The error of the file system.
        source: std::io::Error,
        /// The file as it was named.
        path: PathBuf,
    },
    /// The file is no object of lists of numbers.
    #[error(
        "{path} is no file of vectors: it must be one JSON object, {{\"mug\": [0.1, -0.2, ...], ...}}"
    )]
    Form {
        /// What is wrong, with line and column.
        source: serde_json::Error,
        /// The file as it was named.
        path: PathBuf,
    },
    /// A vector has no direction, or not as many numbers as others.
    #[error("{path}: {wrong}")]
    Vector {
        /// The file as it was named.
        path: PathBuf,
        /// Which vector, and what is wrong with it.
        wrong: UselessVector,
    },
}

/// A vector that cannot be compared with others.
#[derive(Debug, thiserror::Error)]
#[error("the vector of \"{text}\" {reason}")]
pub struct UselessVector {
    text: String,
    reason: String,
}

/// Refuses what a similarity cannot be computed of; `expected` is how many numbers others have.
fn check_vector(text: &str, vector: &[f32], expected: usize) -> Result<(), UselessVector> {
    let useless = |reason: String| {
        Err(UselessVector {
            text: text.to_owned(),
            reason,
        })
    };
    if vector.len() != expected {
        return useless(format!(
            "has {} numbers, others have {expected}",
            vector.len()
        ));
    }
    if vector.iter().any(|number| !number.is_finite()) {
        return useless("has a number that is not finite".to_owned());
    }
    if vector.iter().all(|number| *number == 0.0) {
        return useless("is empty or all zero: it has no direction".to_owned());
    }
    Ok(())
}

/// A category that the file of vectors lacks.
#[derive(Debug, thiserror::Error)]
#[error("{path} has no vector of the category \"{text}\": add it, or match by an embedding model")]
struct MissingVector {
    path: PathBuf,
    text: String,
}

impl TextVectors {
    /// The vectors of an endpoint's embedding model. A client with a cache keeps them.
    pub fn of_endpoint(client: Arc<Client>) -> Self {
        Self {
            source: VectorSource::Endpoint(client),
            known: Mutex::default(),
        }
    }

    /// The vectors of a file: one JSON object from text to numbers.
    ///
    /// # Errors
    /// Fails if the file cannot be read, has another form, or vectors of different lengths.
    pub fn of_file(path: &Path) -> Result<Self, VectorFileError> {
        let bytes = fs::read(path).map_err(|source| VectorFileError::Read {
            source,
            path: path.to_owned(),
        })?;
        let vectors: BTreeMap<String, Vec<f32>> =
            serde_json::from_slice(&bytes).map_err(|source| VectorFileError::Form {
                source,
                path: path.to_owned(),
            })?;
        let expected = vectors.values().next().map_or(0, Vec::len);
        for (text, vector) in &vectors {
            check_vector(text, vector, expected).map_err(|wrong| VectorFileError::Vector {
                path: path.to_owned(),
                wrong,
            })?;
        }
        let known = vectors.into_iter().map(|(text, it)| (text, it.into()));
        Ok(Self {
            source: VectorSource::File {
                path: path.to_owned(),
                digest: Digest::of(&bytes),
            },
            known: Mutex::new(known.collect()),
        })
    }

    /// What the vectors come from, for traces: the model, or the name of the file.
    pub fn name(&self) -> String {
        match &self.source {
            VectorSource::Endpoint(client) => client.endpoint().model.clone(),
            VectorSource::File { path, .. } => path
                .file_name()
                .unwrap_or(path.as_os_str())
                .to_string_lossy()
                .into_owned(),
        }
    }

    /// Digest of the file, if they come from one.
    pub fn digest(&self) -> Option<Digest> {
        match &self.source {
            VectorSource::Endpoint(_) => None,
            VectorSource::File { digest, .. } => Some(*digest),
        }
    }

    /// Whether the text can have no vector: a file lacks it.
    fn lacks(&self, text: &str) -> bool {
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        matches!(self.source, VectorSource::File { .. }) && !known.contains_key(text)
    }

    /// The vectors of texts, in their order.
    fn of(&self, texts: &[&str]) -> Result<Vec<Arc<[f32]>>, ResponderError> {
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let mut missing: Vec<&str> = {
            let known = known();
            let missing = texts.iter().filter(|text| !known.contains_key(**text));
            missing.copied().collect()
        };
        missing.sort_unstable();
        missing.dedup();
        if let Some(first) = missing.first() {
            match &self.source {
                // Nobody waits for a lock while the endpoint is asked.
                VectorSource::Endpoint(client) => {
                    let vectors = client.embed(&missing).map_err(ResponderError::new)?;
                    let mut known = known();
                    let expected = known
                        .values()
                        .next()
                        .map_or(vectors[0].len(), |it| it.len());
                    for (text, vector) in missing.iter().zip(vectors) {
                        check_vector(text, &vector, expected).map_err(ResponderError::new)?;
                        let kept = known.entry((*text).to_owned());
                        kept.or_insert_with(|| vector.into());
                    }
                }
                VectorSource::File { path, .. } => {
                    return Err(ResponderError::new(MissingVector {
                        path: path.clone(),
                        text: (*first).to_owned(),
                    }));
                }
            }
        }
        let known = known();
        Ok(texts.iter().map(|text| Arc::clone(&known[*text])).collect())
    }
}

/// Matches queries to categories by vectors.
pub struct VectorMatcher {
    vectors: Arc<TextVectors>,
    rule: MatchRule,
}

impl VectorMatcher {
    /// Matches by these vectors and this rule.
    pub fn new(vectors: Arc<TextVectors>, rule: MatchRule) -> Self {
        Self { vectors, rule }
    }
}

impl Matcher for VectorMatcher {
    fn look_up(&mut self, query: &str, categories: &[&str]) -> Result<Lookup, ResponderError> {
        let source = self.vectors.name();
        // Agents search for any word, and a file has some: for others there is nothing.
        if self.vectors.lacks(query) {
            let categories = Vec::new();
            return Ok(Lookup { categories, source });
        }
        let texts: Vec<&str> = [query].iter().chain(categories).copied().collect();
        let vectors = self.vectors.of(&texts)?;
        let similarities = vectors[1..].iter().map(|it| cosine(&vectors[0], it));
        let mut ranked: Vec<(f64, &str)> = similarities.zip(categories.iter().copied()).collect();
        ranked.sort_by(|one, other| other.0.total_cmp(&one.0).then(one.1.cmp(other.1)));
        match self.rule {
            MatchRule::Best => ranked.truncate(1),
            MatchRule::Threshold(least) => ranked.retain(|(it, _)| *it >= f64::from(least)),
        }
        Ok(Lookup {
            categories: ranked.into_iter().map(|(_, it)| it.to_owned()).collect(),
            source,
        })
    }
}

/// Of vectors of one length that have a direction.
fn cosine(one: &[f32], other: &[f32]) -> f64 {
    let product = |a: &[f32], b: &[f32]| {
        a.iter()
            .zip(b)
            .map(|(a, b)| f64::from(*a) * f64::from(*b))
            .sum::<f64>()
    };
    product(one, other) / (product(one, one) * product(other, other)).sqrt()
}

#[cfg(test)]
mod tests {
    use std::{error::Error, fs, sync::Arc};

    use reel_agents::Matcher;
    use tempfile::TempDir;

    use super::{MatchRule, TextVectors, VectorMatcher, cosine};

    const VECTORS: &str =
        r#"{"cup": [1, 0], "mug": [0.9, 0.1], "plate": [0.1, 0.9], "bowl": [0.1, 0.9]}"#;

    fn matcher(folder: &TempDir, rule: MatchRule) -> VectorMatcher {
        let path = folder.path().join("vectors.json");
        fs::write(&path, VECTORS).unwrap();
        VectorMatcher::new(Arc::new(TextVectors::of_file(&path).unwrap()), rule)
    }

    #[test]
    fn similarity_of_vectors() {
        assert_eq!(cosine(&[1.0, 0.0], &[2.0, 0.0]), 1.0);
        assert_eq!(cosine(&[1.0, 0.0], &[0.0, 3.0]), 0.0);
    }

    #[test]
    fn a_rule_decides_which_categories_are_meant() {
        let folder = TempDir::new().unwrap();
        let categories = ["bowl", "mug", "plate"];
        let found = |rule, query| {
            let mut matcher = matcher(&folder, rule);
            matcher.look_up(query, &categories).unwrap().categories
        };
        assert_eq!(found(MatchRule::Best, "cup"), ["mug"]);
        // Equal ones: the first by name.
        assert_eq!(found(MatchRule::Best, "plate"), ["bowl"]);
        assert_eq!(found(MatchRule::Best, "bowl"), ["bowl"]);
        assert_eq!(
            found(MatchRule::Threshold(0.05), "cup"),
            ["mug", "bowl", "plate"]
        );
        assert_eq!(found(MatchRule::Threshold(0.95), "cup"), ["mug"]);
        assert!(found(MatchRule::Threshold(0.9999), "cup").is_empty());
    }

    #[test]
    fn a_file_that_lacks_a_text_or_has_another_form_is_named() {
        let folder = TempDir::new().unwrap();
        let mut matcher = matcher(&folder, MatchRule::Best);
        let error = matcher.look_up("mug", &["spoon"]).unwrap_err().to_string();
        assert!(
            error.contains("vectors.json has no vector of the category \"spoon\""),
            "{error}"
        );
        // For a word that it lacks there is nothing.
        let none = matcher.look_up("spoon", &["mug"]).unwrap();
        assert!(none.categories.is_empty() && none.source == "vectors.json");
        let path = folder.path().join("wrong.json");
        let refused = |text: &str| {
            fs::write(&path, text).unwrap();
            let error = TextVectors::of_file(&path).err().unwrap();
            format!("{error}: {:?}", error.source().map(ToString::to_string))
        };
        for (text, reason) in [
            (r#"{"a": [0, 0]}"#, "is empty or all zero"),
            (r#"{"a": []}"#, "is empty or all zero"),
            (r#"{"a": [1e39]}"#, "out of range"),
        ] {
            assert!(refused(text).contains(reason), "{text}: {}", refused(text));
        }
        assert!(refused("[1, 2]").contains("must be one JSON object"));
        assert!(refused(r#"{"mug": [1, "x"]}"#).contains("line 1"));
        assert!(
            refused(r#"{"a": [1, 2], "b": [1]}"#)
                .contains("the vector of \"b\" has 1 numbers, others have 2")
        );
        assert!(TextVectors::of_file(&folder.path().join("none")).is_err());
    }
}
