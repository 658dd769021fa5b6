//! Buckets as a place of traces: names are URLs, and whoever asks waits, on whatever thread.

use std::{
    collections::HashMap,
    fs, io,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError, mpsc},
    time::{Duration, Instant, SystemTime},
};

use futures_util::TryStreamExt as _;
use object_store::{
    GetOptions, ObjectMeta, ObjectStore, ObjectStoreExt as _, PutPayload, WriteMultipart, path,
};
use reel_trace::{FileMetadata, Limits, RemoteFs};
use tokio::{
    runtime::{Builder, Runtime},
    sync::Semaphore,
};
use url::Url;

use crate::buckets::{BucketError, BucketHandles, Cache};

/// Bytes from which on a file is sent in parts, and bytes of a part.
const PART_BYTES: usize = 8 << 20;
/// Parts under way at a time.
const PARTS_AHEAD: usize = 4;

/// Files that are fetched before somebody asks for them, under way at a time.
const PREFETCHED_AT_ONCE: usize = 16;
/// How old a prefetched copy may be: who asks later gets what is there then.
const PREFETCHED_AGE_MAX: Duration = Duration::from_secs(60);

/// A copy on this machine, and what is known of a file that was brought anew.
type Fetched = Result<(PathBuf, Option<FileMetadata>), BucketError>;

struct Prefetched {
    asked: Instant,
    file: mpsc::Receiver<Fetched>,
}

/// The buckets that the environment gives access to.
pub struct Buckets {
    /// Started when somebody names a bucket.
    runtime: OnceLock<Runtime>,
    cache: Arc<Cache>,
    opened: BucketHandles,
    /// Of files that were listed or brought here: who goes through a folder asks for
    /// each of them once.
    seen: Mutex<HashMap<String, FileMetadata>>,
    /// Files that are on their way or here, until somebody asks for them.
    prefetched: Mutex<HashMap<String, Prefetched>>,
    prefetching: Arc<Semaphore>,
}

/// What became of a file that was to be sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum UploadOutcome {
    /// It is there now.
    Sent {
        /// Size of the file that was sent, in bytes.
        bytes: u64,
    },
    /// A file of this size was there already, and it is not older.
    Same,
}

impl Buckets {
    /// Buckets whose files are kept in a cache.
    pub fn new(cache: Cache) -> Self {
        Self {
            runtime: OnceLock::new(),
            cache: Arc::new(cache),
            opened: BucketHandles::default(),
            seen: Mutex::default(),
            prefetched: Mutex::default(),
            prefetching: Arc::new(Semaphore::new(PREFETCHED_AT_ONCE)),
        }
    }

    /// Sends a file, in parts where it is large; one that is there already is left alone.
    ///
    /// # Errors
    /// When the file cannot be read, or the store refuses.
    pub fn upload(&self, from: &Path, to: &str) -> Result<UploadOutcome, BucketError> {
        let failed = |source| BucketError::Io {
            action: "read",
            source,
            path: from.to_owned(),
        };
        let facts = fs::metadata(from).map_err(failed)?;
        let bytes = fs::read(from).map_err(failed)?;
        let (objects, place) = self.place(to)?;
        let name = to.to_owned();
        self.wait(to, async move {
            let failed = |error| refused("send", &name, &error);
            if let Ok(there) = objects.head(&place).await {
                let modified = facts.modified().unwrap_or(SystemTime::UNIX_EPOCH);
                // stores tell times in whole seconds
                if there.size == facts.len()
                    && SystemTime::from(there.last_modified) + Duration::from_secs(1) > modified
                {
                    return Ok(UploadOutcome::Same);
                }
            }
            let sent = UploadOutcome::Sent {
                bytes: bytes.len() as u64,
            };
            if bytes.len() <= PART_BYTES {
                objects
                    .put(&place, PutPayload::from(bytes))
                    .await
                    .map_err(failed)?;
                return Ok(sent);
            }
            let upload = objects.put_multipart(&place).await.map_err(failed)?;
            let mut writer = WriteMultipart::new_with_chunk_size(upload, PART_BYTES);
            for part in bytes.chunks(PART_BYTES) {
                writer
                    .wait_for_capacity(PARTS_AHEAD)
                    .await
                    .map_err(failed)?;
                writer.write(part);
            }
            // where a part fails, this gives the others back
            writer.finish().await.map_err(failed)?;
            Ok(sent)
        })
    }

    /// The bucket of a name, and the place in it.
    fn place(&self, name: &str) -> Result<(Arc<dyn ObjectStore>, path::Path), BucketError> {
        let (url, place) = split(name)?;
        Ok((self.opened.bucket(&url)?, place))
    }

    /// Waits for the store, on any thread.
    fn wait<T: Send + 'static>(
        &self,
        name: &str,
        work: impl Future<Output = Result<T, BucketError>> + Send + 'static,
    ) -> Result<T, BucketError> {
        let panicked = || unusable(name, "this is a bug of reel: it panicked".to_owned());
        let result = self.begin(name, work)?.recv();
        result.unwrap_or_else(|_| Err(panicked()))
    }

    /// Runs a request on the threads for buckets; its result comes over the channel.
    fn begin<T: Send + 'static>(
        &self,
        name: &str,
        work: impl Future<Output = Result<T, BucketError>> + Send + 'static,
    ) -> Result<mpsc::Receiver<Result<T, BucketError>>, BucketError> {
        if self.runtime.get().is_none() {
            let runtime = Builder::new_multi_thread()
                .worker_threads(2)
                .thread_name("reel-buckets")
                .enable_all()
                .build();
            // of two who come at a time, one starts threads for nothing
            let _ = self
                .runtime
                .set(runtime.map_err(|error| unusable(name, error.to_string()))?);
        }
        let runtime = self.runtime.get().expect("it was just set");
        let (sender, receiver) = mpsc::sync_channel(1);
        runtime.spawn(async move { drop(sender.send(work.await)) });
        Ok(receiver)
    }

    fn fetched(&self, name: &str) -> Result<PathBuf, BucketError> {
        let prefetched = lock(&self.prefetched).remove(name);
        let prefetched = prefetched
            .filter(|prefetched| prefetched.asked.elapsed() < PREFETCHED_AGE_MAX)
            .and_then(|prefetched| prefetched.file.recv().ok()?.ok())
            // the cache may have made room
            .filter(|(copy, _)| copy.exists());
        let (copy, facts) = match prefetched {
            Some(fetched) => fetched,
            None => self.wait(name, self.fetching(name)?)?,
        };
        if let Some(facts) = facts {
            lock(&self.seen).insert(name.to_owned(), facts);
        }
        Ok(copy)
    }

    /// Brings a file, unless its copy is what is there.
    fn fetching(
        &self,
        name: &str,
    ) -> Result<impl Future<Output = Fetched> + Send + use<>, BucketError> {
        let (objects, place) = self.place(name)?;
        let (cache, name) = (self.cache.clone(), name.to_owned());
        Ok(async move {
            let known = cache.known(&name);
            let options = GetOptions::new()
                .with_if_none_match(known.as_ref().map(|(known, _)| known.etag.clone()));
            let found = match (objects.get_opts(&place, options).await, known) {
                (Err(object_store::Error::NotModified { .. }), Some((_, copy))) => {
                    cache.touch(&copy);
                    return Ok((copy, None));
                }
                (found, _) => found.map_err(|error| refused("read", &name, &error))?,
            };
            let (size, limit) = (found.meta.size, Limits::default().file_bytes);
            if size > limit {
                let reason = format!("it has {size} bytes, the limit is {limit}");
                return Err(BucketError::Store {
                    action: "read",
                    reason,
                    name,
                });
            }
            let (etag, facts) = (found.meta.e_tag.clone(), facts(&found.meta));
            let content = found
                .bytes()
                .await
                .map_err(|error| refused("read", &name, &error))?;
            // a store that tells no contents apart is asked for everything each time
            let copy = cache
                .keep(&name, etag.unwrap_or_default(), &content)
                .map_err(|source| BucketError::Io {
                    action: "keep a copy of a file of a bucket",
                    source,
                    path: name.into(),
                })?;
            Ok((copy, Some(facts)))
        })
    }

    fn begin_prefetch(&self, name: &str) -> Result<Prefetched, BucketError> {
        let (fetching, permits) = (self.fetching(name)?, self.prefetching.clone());
        let file = self.begin(name, async move {
            let _permit = permits.acquire().await;
            fetching.await
        })?;
        Ok(Prefetched {
            asked: Instant::now(),
            file,
        })
    }

    fn facts_of(&self, name: &str) -> Result<FileMetadata, BucketError> {
        if let Some(facts) = lock(&self.seen).get(name) {
            return Ok(*facts);
        }
        let (objects, place) = self.place(name)?;
        let name_of = name.to_owned();
        self.wait(name, async move {
            objects
                .head(&place)
                .await
                .map(|found| facts(&found))
                .map_err(|error| refused("look at", &name_of, &error))
        })
    }

    fn below(&self, folder: &str) -> Result<Vec<String>, BucketError> {
        let (objects, place) = self.place(folder)?;
        let name = folder.to_owned();
        let files: Vec<ObjectMeta> = self.wait(folder, async move {
            let files: Vec<ObjectMeta> = objects
                .list(Some(&place))
                .try_collect()
                .await
                .map_err(|error| refused("list", &name, &error))?;
            if !files.is_empty() {
                return Ok(files);
            }
            match objects.head(&place).await {
                Ok(file) => Ok(vec![file]),
                Err(object_store::Error::NotFound { .. }) => Ok(Vec::new()),
                Err(error) => Err(refused("look at", &name, &error)),
            }
        })?;
        let (root, _) = split(folder)?;
        let mut seen = lock(&self.seen);
        let named = files.iter().map(|file| {
            let name = format!("{root}{}", file.location);
            seen.insert(name.clone(), facts(file));
            name
        });
        Ok(named.collect())
    }
}

impl RemoteFs for Buckets {
    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        Ok(self.below(folder)?)
    }

    fn metadata(&self, name: &str) -> io::Result<FileMetadata> {
        Ok(self.facts_of(name)?)
    }

    fn fetch(&self, name: &str) -> io::Result<PathBuf> {
        Ok(self.fetched(name)?)
    }

    fn prefetch(&self, name: &str) {
        let mut prefetched = lock(&self.prefetched);
        prefetched.retain(|_, file| file.asked.elapsed() < PREFETCHED_AGE_MAX);
        if prefetched.contains_key(name) {
            return;
        }
        // What cannot be fetched is an error of `fetch`.
        if let Ok(file) = self.begin_prefetch(name) {
            prefetched.insert(name.to_owned(), file);
        }
    }
}

impl From<BucketError> for io::Error {
    fn from(error: BucketError) -> Self {
        let kind = match &error {
            BucketError::NotFound { .. } => io::ErrorKind::NotFound,
            BucketError::Io { source, .. } => source.kind(),
            BucketError::Name { .. } => io::ErrorKind::InvalidInput,
            BucketError::Settings { .. } | BucketError::Store { .. } => io::ErrorKind::Other,
        };
        io::Error::new(kind, error)
    }
}

impl std::fmt::Debug for Buckets {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Buckets")
            .field("cache", &self.cache)
            .finish_non_exhaustive()
    }
}

/// The URL of a name's bucket, and the place in it. Places are taken as they are written: nothing
/// is decoded, and no `..` leads out of a folder.
fn split(name: &str) -> Result<(Url, path::Path), BucketError> {
    let wrong = |reason: &str| BucketError::Name {
        name: name.to_owned(),
        reason: reason.to_owned(),
    };
    let rest = name
        .strip_prefix("s3://")
        .ok_or_else(|| wrong("only s3:// is served"))?;
    let (bucket, place) = rest.split_once('/').unwrap_or((rest, ""));
    let url = Url::parse(&format!("s3://{bucket}/")).map_err(|error| wrong(&error.to_string()))?;
    if bucket.is_empty() || url.host_str() != Some(bucket) {
        return Err(wrong("the name of the bucket is missing or is none"));
    }
    Ok((
        url,
        path::Path::parse(place).map_err(|error| wrong(&error.to_string()))?,
    ))
}

fn unusable(name: &str, reason: String) -> BucketError {
    BucketError::Store {
        action: "use the bucket",
        reason,
        name: name.to_owned(),
    }
}

fn refused(action: &'static str, name: &str, error: &object_store::Error) -> BucketError {
    match error {
        object_store::Error::NotFound { .. } => BucketError::NotFound {
            name: name.to_owned(),
        },
        error => BucketError::Store {
            action,
            reason: with_causes(error),
            name: name.to_owned(),
        },
    }
}

/// An error with its causes, each said once.
pub fn with_causes(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        let said = error.to_string();
        if !text.contains(&said) {
            text = format!("{text}: {said}");
        }
        cause = error.source();
    }
    text
}

fn facts(file: &ObjectMeta) -> FileMetadata {
    let modified_ns = file.last_modified.timestamp_nanos_opt().unwrap_or_default();
    FileMetadata {
        bytes: file.size,
        modified_ns,
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_taken_as_they_are_written() {
        let place = |name: &str| split(name).map(|(url, place)| format!("{url}{place}"));
        for name in [
            "s3://lab/traces/a.mcap",
            "s3://lab/50%/a b.mcap",
            "s3://lab/traces/%2e%2e/a.mcap",
            "s3://lab/a#b?c.mcap",
        ] {
            assert_eq!(place(name).unwrap(), name);
        }
        assert_eq!(place("s3://lab/traces/").unwrap(), "s3://lab/traces");
        assert_eq!(place("s3://lab").unwrap(), "s3://lab/");
        for wrong in [
            "s3:///a.mcap",
            "s3://",
            "gs://lab/a.mcap",
            "s3://lab/traces/../secrets/a.mcap",
            "s3://la b/a",
            "s3://lab:9/a",
        ] {
            assert!(place(wrong).is_err(), "{wrong}");
        }
    }
}
