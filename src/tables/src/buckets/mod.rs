//! Files in buckets of an S3-compatible store, `s3://bucket/folder/file`: listed, fetched into a
//! cache on this machine, and sent. What the store needs to know comes from the environment, as for
//! other tools of S3 (`AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`,
//! `AWS_ENDPOINT_URL`, `AWS_ALLOW_HTTP`, ...). Requests that fail are repeated.
//!
//! Knows nothing of what is in the files.

mod cache;
mod remote;
mod retrying_store;

use std::{
    collections::BTreeMap,
    io,
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use object_store::{
    ObjectStore,
    aws::{AmazonS3Builder, AmazonS3ConfigKey},
};
use url::Url;

use crate::buckets::retrying_store::RetryingStore;

pub use cache::Cache;
pub use remote::{Buckets, UploadOutcome, with_causes};

/// Why a file of a bucket cannot be had, or sent.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum BucketError {
    /// A name is no name of a file or folder of a bucket.
    #[error(
        "this names no file or folder of a bucket: {reason}; write s3://bucket/folder/file: {name}"
    )]
    Name { name: String, reason: String },
    /// The environment describes no store that can be used.
    #[error("the environment's settings of S3 cannot be used: {reason}: {name}")]
    Settings { name: String, reason: String },
    /// There is no such file.
    #[error("no such file in the bucket: {name}")]
    NotFound { name: String },
    /// The store refuses, or cannot be reached, also when it was asked again.
    #[error("cannot {action}: {reason}: {name}")]
    Store {
        /// The action that failed, as words for the message, e.g. `read`.
        action: &'static str,
        reason: String,
        name: String,
    },
    /// A file of this machine cannot be read or written.
    #[error("cannot {action}: {source}: {path}", path = path.display())]
    Io {
        /// The action that failed, as words for the message, e.g. `read`.
        action: &'static str,
        source: io::Error,
        path: PathBuf,
    },
}

/// A bucket, named by the URL of anything in it, with options that go before the environment's,
/// by the same names.
///
/// # Errors
/// When the URL names no bucket, or the settings are wrong. Nothing is asked of the store yet.
pub fn bucket(
    url: &Url,
    options: impl IntoIterator<Item = (String, String)>,
) -> Result<Arc<dyn ObjectStore>, BucketError> {
    let settings = |reason: String| BucketError::Settings {
        name: url.to_string(),
        reason,
    };
    if url.scheme() != "s3" {
        let reason = format!("'{}://' is not served", url.scheme());
        return Err(BucketError::Name {
            name: url.to_string(),
            reason,
        });
    }
    let mut builder = AmazonS3Builder::from_env().with_url(url.as_str());
    for (name, value) in options {
        let key: AmazonS3ConfigKey = name
            .to_ascii_lowercase()
            .parse()
            .map_err(|_| settings(format!("'{name}' is not an option of S3")))?;
        builder = builder.with_config(key, value);
    }
    if builder
        .get_config_value(&AmazonS3ConfigKey::Region)
        .is_none()
    {
        builder = builder.with_region("us-east-1");
    }
    Ok(Arc::new(RetryingStore(
        builder
            .build()
            .map_err(|error| settings(error.to_string()))?,
    )))
}

/// The buckets that the environment gives access to, each opened when it is first named.
#[derive(Debug, Default)]
pub struct BucketHandles(Mutex<BTreeMap<Url, Arc<dyn ObjectStore>>>);

impl BucketHandles {
    /// The bucket of a URL.
    ///
    /// # Errors
    /// As [`bucket`].
    pub fn bucket(&self, url: &Url) -> Result<Arc<dyn ObjectStore>, BucketError> {
        let mut root = url.clone();
        root.set_path("/");
        let mut opened = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(objects) = opened.get(&root) {
            return Ok(objects.clone());
        }
        let objects = bucket(&root, [])?;
        opened.insert(root, objects.clone());
        Ok(objects)
    }
}
