//! Where a store lies: a local folder or a bucket (`s3://bucket/prefix`). Knows no tables.

use std::{path::PathBuf, sync::Arc};

use crate::buckets::bucket;
use deltalake::logstore::{LogStoreRef, StorageConfig, default_logstore};
use object_store::{
    ObjectMeta, ObjectStore, ObjectStoreExt as _, local::LocalFileSystem, path::Path,
    prefix::PrefixStore,
};
use reel_trace::is_remote;
use url::Url;

use super::StoreError;

/// The folder of a store, and how its files are read and written.
#[derive(Clone, Debug)]
pub struct Location {
    /// As the user wrote it.
    text: String,
    /// Ends with a slash.
    url: Url,
    /// Of the whole file system or bucket.
    objects: Arc<dyn ObjectStore>,
}

impl Location {
    /// Understands a path or a URL. What `s3://` needs comes from the environment, as
    /// for other tools of S3: `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`,
    /// `AWS_REGION`, `AWS_ENDPOINT_URL`, `AWS_ALLOW_HTTP`, ...
    ///
    /// # Errors
    /// When the URL is of a kind that is not served, or the bucket's configuration is wrong.
    pub fn parse(text: &str) -> Result<Self, StoreError> {
        Self::parse_with(text, [])
    }

    /// [`Location::parse`] with options that go before the environment's, by the same names.
    ///
    /// # Errors
    /// As [`Location::parse`].
    pub fn parse_with(
        text: &str,
        options: impl IntoIterator<Item = (String, String)>,
    ) -> Result<Self, StoreError> {
        let wrong = |reason: String| StoreError::Location {
            reason,
            location: text.to_owned(),
        };
        let (url, objects): (Url, Arc<dyn ObjectStore>) = match text.split_once("://") {
            Some(("s3", rest)) => {
                let url = Url::parse(&format!("s3://{}/", rest.trim_end_matches('/')))
                    .map_err(|error| wrong(error.to_string()))?;
                let objects = bucket(&url, options).map_err(|error| wrong(error.to_string()))?;
                (url, objects)
            }
            Some((kind, _)) if kind != "file" => {
                return Err(wrong(format!(
                    "'{kind}://' is not served; give a folder or s3://bucket/folder"
                )));
            }
            _ => {
                let folder = PathBuf::from(text.strip_prefix("file://").unwrap_or(text));
                let folder = absolute(&folder).map_err(|error| wrong(error.to_string()))?;
                let url = Url::from_directory_path(&folder)
                    .map_err(|()| wrong("no folder can be called so".into()))?;
                (url, Arc::new(LocalFileSystem::new()))
            }
        };
        Ok(Self {
            text: text.to_owned(),
            url,
            objects,
        })
    }

    /// Makes the folder; a bucket has none.
    pub(super) fn prepare(&self) -> Result<(), StoreError> {
        let Ok(folder) = self.url.to_file_path() else {
            return Ok(());
        };
        std::fs::create_dir_all(&folder).map_err(|source| StoreError::Io {
            action: "make the folder",
            source,
            path: folder,
        })
    }

    /// The bucket or file system, with its URL: what a reader of [`super::Store::files`] needs.
    pub fn objects(&self) -> (Url, Arc<dyn ObjectStore>) {
        let mut root = self.url.clone();
        root.set_path("");
        (root, self.objects.clone())
    }

    /// The file of a commit to a table, where there is one.
    pub(super) async fn commit(
        &self,
        table: &str,
        version: u64,
    ) -> Result<Option<ObjectMeta>, StoreError> {
        let file = self
            .path(table)?
            .join("_delta_log")
            .join(format!("{version:020}.json"));
        match self.objects.head(&file).await {
            Ok(commit) => Ok(Some(commit)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(StoreError::Delta {
                source: Box::new(error.into()),
                location: self.text.clone(),
            }),
        }
    }

    /// The folder of a table.
    pub(super) fn table_url(&self, table: &str) -> Url {
        self.url
            .join(&format!("{table}/"))
            .expect("the name of a table is a name in a URL")
    }

    /// The log of a table.
    pub(super) fn log(&self, table: &str) -> Result<LogStoreRef, StoreError> {
        let url = self.table_url(table);
        let prefixed = Arc::new(PrefixStore::new(self.objects.clone(), self.path(table)?));
        Ok(default_logstore(
            prefixed,
            self.objects.clone(),
            &url,
            &StorageConfig::default(),
        ))
    }

    /// Of a table's folder within [`Location::objects`].
    fn path(&self, table: &str) -> Result<Path, StoreError> {
        let wrong = |error: object_store::path::Error| StoreError::Location {
            reason: error.to_string(),
            location: self.text.clone(),
        };
        Ok(Path::from_url_path(self.url.path())
            .map_err(wrong)?
            .join(table))
    }
}

/// The path from the root, without `.` and `..`. Links are not followed. A name in a bucket is one.
pub(super) fn absolute(path: &std::path::Path) -> std::io::Result<PathBuf> {
    if is_remote(path) {
        return Ok(path.to_owned());
    }
    let mut plain = PathBuf::new();
    for part in std::path::absolute(path)?.components() {
        match part {
            std::path::Component::ParentDir => {
                plain.pop();
            }
            part => plain.push(part),
        }
    }
    Ok(plain)
}

impl std::fmt::Display for Location {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.text)
    }
}
