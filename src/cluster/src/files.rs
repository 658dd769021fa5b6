//! The files of plans: local ones, and buckets as the environment describes them. Opens nothing
//! before it is asked for.

use std::sync::Arc;

use datafusion::{
    error::{DataFusionError, Result},
    execution::{
        object_store::ObjectStoreRegistry,
        runtime_env::{RuntimeEnv, RuntimeEnvBuilder},
    },
};
use object_store::{ObjectStore, local::LocalFileSystem};
use reel_tables::buckets::BucketHandles;
use url::Url;

/// What plans run in.
pub(crate) fn environment() -> Result<Arc<RuntimeEnv>> {
    RuntimeEnvBuilder::new()
        .with_object_store_registry(Arc::new(PlanLocations::default()))
        .build_arc()
}

/// Every place that a plan may name.
#[derive(Debug, Default)]
struct PlanLocations(BucketHandles);

impl ObjectStoreRegistry for PlanLocations {
    /// Nobody brings stores along: each machine reaches them by itself.
    fn register_store(&self, _: &Url, _: Arc<dyn ObjectStore>) -> Option<Arc<dyn ObjectStore>> {
        None
    }

    fn get_store(&self, url: &Url) -> Result<Arc<dyn ObjectStore>> {
        match url.scheme() {
            "file" => Ok(Arc::new(LocalFileSystem::new())),
            _ => self
                .0
                .bucket(url)
                .map_err(|error| DataFusionError::External(Box::new(error))),
        }
    }
}
