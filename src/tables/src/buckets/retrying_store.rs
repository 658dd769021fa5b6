//! A store that is asked again where an answer breaks off. The client of S3 repeats requests that
//! are refused; what it leaves to others are lists that end in the middle, and files that must not
//! be there yet and were written although nobody said so.

use std::{ops::Range, time::Duration};

use async_trait::async_trait;
use bytes::Bytes;
use futures_util::{StreamExt as _, TryStreamExt as _, stream, stream::BoxStream};
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta,
    ObjectStore, ObjectStoreExt as _, PutMode, PutMultipartOptions, PutOptions, PutPayload,
    PutResult, Result, path::Path,
};

/// How often a request is made.
const TRIES: u32 = 6;
/// How long to wait before the second one; twice as long before each further one.
const WAIT: Duration = Duration::from_millis(100);

/// An object store that retries failed requests, with exponential backoff.
#[derive(Clone, Debug)]
pub(crate) struct RetryingStore<S>(pub S);

impl<S: std::fmt::Display> std::fmt::Display for RetryingStore<S> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.fmt(f)
    }
}

/// Does something until it succeeds or fails for a reason that stays.
async fn again<T, F: Future<Output = Result<T>>>(ask: impl Fn() -> F) -> Result<T> {
    let mut tried = 1;
    loop {
        match ask().await {
            Err(Error::Generic { .. }) if tried < TRIES => {
                tokio::time::sleep(WAIT * 2u32.pow(tried - 1)).await;
                tried += 1;
            }
            done => return done,
        }
    }
}

#[async_trait]
impl<S: ObjectStore + Clone> ObjectStore for RetryingStore<S> {
    async fn put_opts(
        &self,
        location: &Path,
        payload: PutPayload,
        options: PutOptions,
    ) -> Result<PutResult> {
        for tried in 1..=TRIES {
            match self
                .0
                .put_opts(location, payload.clone(), options.clone())
                .await
            {
                Err(Error::Generic { .. }) if tried < TRIES => {
                    tokio::time::sleep(WAIT * 2u32.pow(tried - 1)).await
                }
                // somebody wrote it; if it is this, it was this one, and nobody heard of it
                Err(error @ (Error::AlreadyExists { .. } | Error::Precondition { .. }))
                    if options.mode == PutMode::Create =>
                {
                    let there = again(|| async { self.0.get(location).await }).await?;
                    let (e_tag, version) = (there.meta.e_tag.clone(), there.meta.version.clone());
                    let ours: Vec<u8> = payload.iter().flatten().copied().collect();
                    return if there.bytes().await? == ours {
                        Ok(PutResult { e_tag, version })
                    } else {
                        Err(error)
                    };
                }
                done => return done,
            }
        }
        unreachable!("the last try is returned")
    }

    async fn put_multipart_opts(
        &self,
        location: &Path,
        options: PutMultipartOptions,
    ) -> Result<Box<dyn MultipartUpload>> {
        again(|| self.0.put_multipart_opts(location, options.clone())).await
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        again(|| self.0.get_opts(location, options.clone())).await
    }

    async fn get_ranges(&self, location: &Path, ranges: &[Range<u64>]) -> Result<Vec<Bytes>> {
        again(|| self.0.get_ranges(location, ranges)).await
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, Result<Path>>,
    ) -> BoxStream<'static, Result<Path>> {
        self.0.delete_stream(locations)
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        let (store, prefix) = (self.0.clone(), prefix.cloned());
        whole(async move { again(|| store.list(prefix.as_ref()).try_collect::<Vec<_>>()).await })
    }

    fn list_with_offset(
        &self,
        prefix: Option<&Path>,
        offset: &Path,
    ) -> BoxStream<'static, Result<ObjectMeta>> {
        let (store, prefix, offset) = (self.0.clone(), prefix.cloned(), offset.clone());
        whole(async move {
            again(|| {
                store
                    .list_with_offset(prefix.as_ref(), &offset)
                    .try_collect::<Vec<_>>()
            })
            .await
        })
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        again(|| self.0.list_with_delimiter(prefix)).await
    }

    async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
        self.0.copy_opts(from, to, options).await
    }
}

/// A list that is whole before its first entry is given.
fn whole(
    list: impl Future<Output = Result<Vec<ObjectMeta>>> + Send + 'static,
) -> BoxStream<'static, Result<ObjectMeta>> {
    stream::once(list)
        .map_ok(|files| stream::iter(files.into_iter().map(Ok)))
        .try_flatten()
        .boxed()
}

#[cfg(test)]
mod tests {
    use std::sync::{
        Arc,
        atomic::{AtomicU32, Ordering},
    };

    use object_store::memory::InMemory;

    use super::*;

    /// Obeys, but of three requests two end before anybody hears of it.
    #[derive(Clone, Debug)]
    struct Bad {
        store: Arc<InMemory>,
        asked: Arc<AtomicU32>,
    }

    impl std::fmt::Display for Bad {
        fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
            f.write_str("bad")
        }
    }

    impl Bad {
        fn told<T>(&self, done: Result<T>) -> Result<T> {
            let lost = || Error::Generic {
                store: "bad",
                source: "broken off".into(),
            };
            if done.is_ok() && self.asked.fetch_add(1, Ordering::Relaxed) % 3 != 2 {
                Err(lost())
            } else {
                done
            }
        }
    }

    #[async_trait]
    impl ObjectStore for Bad {
        async fn put_opts(
            &self,
            location: &Path,
            payload: PutPayload,
            options: PutOptions,
        ) -> Result<PutResult> {
            self.told(self.store.put_opts(location, payload, options).await)
        }

        async fn put_multipart_opts(
            &self,
            location: &Path,
            options: PutMultipartOptions,
        ) -> Result<Box<dyn MultipartUpload>> {
            self.store.put_multipart_opts(location, options).await
        }

        async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
            self.told(self.store.get_opts(location, options).await)
        }

        fn delete_stream(
            &self,
            locations: BoxStream<'static, Result<Path>>,
        ) -> BoxStream<'static, Result<Path>> {
            self.store.delete_stream(locations)
        }

        fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
            let end = stream::iter(self.told(Ok(())).err().map(Err));
            self.store.list(prefix).chain(end).boxed()
        }

        async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
            self.told(self.store.list_with_delimiter(prefix).await)
        }

        async fn copy_opts(&self, from: &Path, to: &Path, options: CopyOptions) -> Result<()> {
            self.store.copy_opts(from, to, options).await
        }
    }

    #[tokio::test]
    async fn a_write_that_nobody_heard_of_is_known_again_and_one_of_another_is_not() {
        let store = RetryingStore(Bad {
            store: Arc::default(),
            asked: Arc::default(),
        });
        let once = PutOptions {
            mode: PutMode::Create,
            ..PutOptions::default()
        };
        let place = Path::from("log/1.json");
        store
            .put_opts(&place, "mine".into(), once.clone())
            .await
            .unwrap();
        let other = store
            .put_opts(&place, "yours".into(), once)
            .await
            .unwrap_err();
        assert!(matches!(other, Error::AlreadyExists { .. }), "{other}");
        assert_eq!(
            store.get(&place).await.unwrap().bytes().await.unwrap(),
            "mine"
        );
    }

    #[tokio::test]
    async fn a_list_that_breaks_off_is_asked_for_again_and_each_file_named_once() {
        let store = RetryingStore(Bad {
            store: Arc::default(),
            asked: Arc::default(),
        });
        for number in 0..5 {
            store
                .0
                .store
                .put(&Path::from(format!("traces/{number}.mcap")), "x".into())
                .await
                .unwrap();
        }
        let listed: Vec<ObjectMeta> = store.list(None).try_collect().await.unwrap();
        assert_eq!(listed.len(), 5);
        assert_eq!(
            store
                .list_with_delimiter(None)
                .await
                .unwrap()
                .common_prefixes
                .len(),
            1
        );
        let missing = store.get(&Path::from("nowhere")).await.unwrap_err();
        assert!(matches!(missing, Error::NotFound { .. }), "{missing}");
    }
}
