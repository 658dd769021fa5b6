//! SQL over the tables of a store, read-only: the tables, the view `steps`, and every named query as a view.
//!
//! DataFusion stays in here: batches of Arrow go out. Never writes, never reads a file that is not the store's.

pub mod format;
pub mod named;

use std::sync::Arc;

use arrow::array::RecordBatch;
use datafusion::{
    catalog::TableProvider,
    datasource::{
        empty::EmptyTable,
        file_format::parquet::ParquetFormat,
        listing::{ListingOptions, ListingTable, ListingTableConfig, ListingTableUrl},
    },
    error::DataFusionError,
    execution::{context::SQLOptions, runtime_env::RuntimeEnvBuilder},
    prelude::{SessionConfig, SessionContext},
    sql::parser::DFParser,
};
use reel_tables::{Store, Table, views};
use tokio::runtime::Runtime;

pub use format::{Format, format};

/// Memory that sorts, joins and aggregations of a query may take before they spill to disk, in bytes.
const MEMORY_BYTES: usize = 1 << 30;

/// A session over one store. Sees the store as it was when the session was made.
pub struct Session {
    context: SessionContext,
    runtime: Arc<Runtime>,
}

/// Why a query has no result.
#[derive(Debug, thiserror::Error)]
pub enum QueryError {
    /// Not a question.
    #[error("only questions are allowed here (SELECT, WITH, EXPLAIN, DESCRIBE, SHOW), one at a time: {reason}")]
    ReadOnly {
        /// What it was instead.
        reason: String,
    },
    /// The query is wrong, too large, or a file is damaged.
    #[error("{}", message(.0))]
    Engine(#[from] DataFusionError),
    /// The result cannot be shown.
    #[error("cannot show the result: {0}")]
    Arrow(#[from] arrow::error::ArrowError),
}

/// Runs one query over a store.
///
/// # Errors
/// When it is no question, is wrong, or takes too much memory.
pub fn run(store: &Store, sql: &str) -> Result<Vec<RecordBatch>, QueryError> {
    Session::new(store)?.run(sql)
}

impl Session {
    /// Registers the store's tables and views.
    ///
    /// # Errors
    /// When a file of the store cannot be opened.
    pub fn new(store: &Store) -> Result<Self, QueryError> {
        let runtime = store.runtime();
        let environment = RuntimeEnvBuilder::new().with_memory_limit(MEMORY_BYTES, 1.0).build_arc()?;
        let config = SessionConfig::new().with_information_schema(true);
        let context = SessionContext::new_with_config_rt(config, environment);
        let (root, objects) = store.objects();
        context.register_object_store(&root, objects);
        for table in Table::ALL {
            context.register_table(table.name(), provider(store, table)?)?;
        }
        let session = Self { context, runtime };
        for view in views() {
            session.view(view.name, &view.sql)?;
        }
        for query in named::ALL {
            session.view(query.name, query.sql)?;
        }
        Ok(session)
    }

    /// Runs one query. There is always a batch, if only an empty one with the columns.
    ///
    /// # Errors
    /// When it is no question, is wrong, or takes too much memory.
    pub fn run(&self, sql: &str) -> Result<Vec<RecordBatch>, QueryError> {
        self.runtime.block_on(async {
            let count = DFParser::parse_sql(sql)?.len();
            if count != 1 {
                return Err(QueryError::ReadOnly { reason: format!("found {count} statements") });
            }
            let plan = self.context.state().create_logical_plan(sql).await?;
            let questions = SQLOptions::new().with_allow_ddl(false).with_allow_dml(false).with_allow_statements(false);
            questions.verify_plan(&plan).map_err(|error| QueryError::ReadOnly { reason: message(&error) })?;
            let frame = self.context.execute_logical_plan(plan).await?;
            let columns = Arc::new(frame.schema().as_arrow().clone());
            let mut batches = frame.collect().await?;
            if batches.is_empty() {
                batches.push(RecordBatch::new_empty(columns));
            }
            Ok(batches)
        })
    }

    fn view(&self, name: &str, sql: &str) -> Result<(), QueryError> {
        let frame = self.runtime.block_on(self.context.sql(sql))?;
        self.context.register_table(name, frame.into_view())?;
        Ok(())
    }
}

impl std::fmt::Debug for Session {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session").field("tables", &self.context.catalog_names()).finish_non_exhaustive()
    }
}

fn provider(store: &Store, table: Table) -> Result<Arc<dyn TableProvider>, QueryError> {
    let files = store.files(table);
    if files.is_empty() {
        return Ok(Arc::new(EmptyTable::new(table.schema())));
    }
    let urls = files.iter().map(|file| ListingTableUrl::parse(file)).collect::<Result<Vec<_>, _>>()?;
    let options = ListingOptions::new(Arc::new(ParquetFormat::default())).with_file_extension(".parquet");
    let config = ListingTableConfig::new_with_multi_paths(urls).with_listing_options(options).with_schema(table.schema());
    Ok(Arc::new(ListingTable::try_new(config)?))
}

/// The engine's own words, without its wrappers.
fn message(error: &DataFusionError) -> String {
    error.find_root().strip_backtrace()
}
