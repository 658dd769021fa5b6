//! The files of plans: local ones, and buckets as the environment describes them, all or those
//! below some folders. Opens nothing before it is asked for, and writes nothing.

use std::{fmt, path::Path as FilePath, sync::Arc};

use async_trait::async_trait;

use datafusion::{
    error::{DataFusionError, Result},
    execution::{
        object_store::ObjectStoreRegistry,
        runtime_env::{RuntimeEnv, RuntimeEnvBuilder},
    },
};
use futures_util::{StreamExt as _, future, stream, stream::BoxStream};
use object_store::{
    CopyOptions, Error as StoreError, GetOptions, GetResult, ListResult, MultipartUpload,
    ObjectMeta, ObjectStore, PutMultipartOptions, PutOptions, PutPayload, PutResult,
    Result as StoreResult, local::LocalFileSystem, path::Path,
};
use reel_query::TraceAccess;
use reel_tables::buckets::BucketHandles;
use url::Url;

/// What plans run in: every file that the process may read, or those below some folders.
pub(crate) fn environment(below: Option<&TraceAccess>) -> Result<Arc<RuntimeEnv>> {
    let locations = PlanLocations {
        buckets: BucketHandles::default(),
        below: below.cloned(),
    };
    RuntimeEnvBuilder::new()
        .with_object_store_registry(Arc::new(locations))
        .build_arc()
}

/// Every place that a plan may name.
#[derive(Debug)]
struct PlanLocations {
    buckets: BucketHandles,
    below: Option<TraceAccess>,
}

impl ObjectStoreRegistry for PlanLocations {
    /// Nobody brings stores along: each machine reaches them by itself.
    fn register_store(&self, _: &Url, _: Arc<dyn ObjectStore>) -> Option<Arc<dyn ObjectStore>> {
        None
    }

    fn get_store(&self, url: &Url) -> Result<Arc<dyn ObjectStore>> {
        let store: Arc<dyn ObjectStore> = match url.scheme() {
            "file" => Arc::new(LocalFileSystem::new()),
            _ => self
                .buckets
                .bucket(url)
                .map_err(|error| DataFusionError::External(Box::new(error)))?,
        };
        let Some(below) = &self.below else {
            return Ok(store);
        };
        let root = match url.scheme() {
            "file" => "/".to_owned(),
            scheme => format!("{scheme}://{}/", url.host_str().unwrap_or_default()),
        };
        Ok(Arc::new(Below {
            store,
            root,
            below: below.clone(),
        }))
    }
}

/// The files of a store below some folders, to be read.
#[derive(Debug)]
struct Below {
    store: Arc<dyn ObjectStore>,
    /// What stands before the paths of the store.
    root: String,
    below: TraceAccess,
}

impl fmt::Display for Below {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} below the folders of --stores", self.store)
    }
}

impl Below {
    fn check(&self, location: &Path) -> StoreResult<()> {
        let whole = format!("{}{location}", self.root);
        if self.below.allows(FilePath::new(&whole)) {
            return Ok(());
        }
        Err(refused(&whole))
    }
}

fn refused(path: &str) -> StoreError {
    StoreError::PermissionDenied {
        path: path.to_owned(),
        source: "this executor reads the tables of other folders alone (--stores)".into(),
    }
}

#[async_trait]
impl ObjectStore for Below {
    async fn get_opts(&self, location: &Path, options: GetOptions) -> StoreResult<GetResult> {
        self.check(location)?;
        self.store.get_opts(location, options).await
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, StoreResult<ObjectMeta>> {
        let root = Path::default();
        match self.check(prefix.unwrap_or(&root)) {
            Ok(()) => self.store.list(prefix),
            Err(error) => stream::once(future::ready(Err(error))).boxed(),
        }
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> StoreResult<ListResult> {
        let root = Path::default();
        self.check(prefix.unwrap_or(&root))?;
        self.store.list_with_delimiter(prefix).await
    }

    async fn put_opts(&self, to: &Path, _: PutPayload, _: PutOptions) -> StoreResult<PutResult> {
        Err(refused(to.as_ref()))
    }

    async fn put_multipart_opts(
        &self,
        to: &Path,
        _: PutMultipartOptions,
    ) -> StoreResult<Box<dyn MultipartUpload>> {
        Err(refused(to.as_ref()))
    }

    fn delete_stream(
        &self,
        locations: BoxStream<'static, StoreResult<Path>>,
    ) -> BoxStream<'static, StoreResult<Path>> {
        locations
            .map(|location| Err(refused(location?.as_ref())))
            .boxed()
    }

    async fn copy_opts(&self, _: &Path, to: &Path, _: CopyOptions) -> StoreResult<()> {
        Err(refused(to.as_ref()))
    }
}

#[cfg(test)]
mod tests {
    use object_store::ObjectStoreExt as _;

    use super::*;

    #[tokio::test]
    async fn tables_of_other_folders_are_not_read() {
        let folder = tempfile::tempdir().unwrap();
        let (ours, theirs) = (folder.path().join("ours"), folder.path().join("theirs"));
        for place in [&ours, &theirs] {
            std::fs::create_dir(place).unwrap();
            std::fs::write(place.join("part.parquet"), "rows").unwrap();
        }
        std::os::unix::fs::symlink(&theirs, ours.join("link")).unwrap();
        let below = TraceAccess::Below(vec![ours.clone()]);
        let environment = environment(Some(&below)).unwrap();
        let url = Url::parse("file:///").unwrap();
        let store = environment.object_store_registry.get_store(&url).unwrap();
        let path = |text: &str| Path::from_absolute_path(folder.path().join(text)).unwrap();
        assert!(store.get(&path("ours/part.parquet")).await.is_ok());
        for other in ["theirs/part.parquet", "ours/link/part.parquet", "none"] {
            let refused = store.get(&path(other)).await.unwrap_err();
            assert!(
                matches!(refused, StoreError::PermissionDenied { .. }),
                "{other}: {refused}"
            );
        }
        let written = store.put(&path("ours/new"), "rows".into()).await;
        assert!(written.is_err() && !ours.join("new").exists());
        assert!(store.list_with_delimiter(None).await.is_err());
    }
}
