//! The files of plans: local ones, and buckets as the environment describes them. Opens nothing before it is asked for.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use datafusion::{
    error::{DataFusionError, Result},
    execution::{
        object_store::ObjectStoreRegistry,
        runtime_env::{RuntimeEnv, RuntimeEnvBuilder},
    },
};
use object_store::{ObjectStore, local::LocalFileSystem};
use reel_buckets::bucket;
use url::Url;

/// What plans run in.
pub(crate) fn environment() -> Result<Arc<RuntimeEnv>> {
    RuntimeEnvBuilder::new().with_object_store_registry(Arc::new(Places::default())).build_arc()
}

/// Stores of files by URL, made when they are first named.
#[derive(Debug, Default)]
struct Places {
    known: Mutex<BTreeMap<String, Arc<dyn ObjectStore>>>,
}

impl ObjectStoreRegistry for Places {
    fn register_store(&self, url: &Url, store: Arc<dyn ObjectStore>) -> Option<Arc<dyn ObjectStore>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner).insert(root(url), store)
    }

    fn get_store(&self, url: &Url) -> Result<Arc<dyn ObjectStore>> {
        if url.scheme() == "file" {
            return Ok(Arc::new(LocalFileSystem::new()));
        }
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(store) = known.get(&root(url)) {
            return Ok(store.clone());
        }
        let store = bucket(url, []).map_err(|error| DataFusionError::External(Box::new(error)))?;
        known.insert(root(url), store.clone());
        Ok(store)
    }
}

/// A bucket's name, without what lies in it.
fn root(url: &Url) -> String {
    format!("{}://{}", url.scheme(), url.host_str().unwrap_or_default())
}
