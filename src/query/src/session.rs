//! A read-only SQL session over one version of a store: plans a question, holds it to
//! its limits, collects the answer. Never writes, and reads no file but the store's and,
//! by functions, its traces.

mod statement;

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
    sync::Arc,
    time::{Duration, Instant},
};

use arrow::{
    array::{AsArray, RecordBatch, RecordBatchOptions},
    compute::cast,
    datatypes::{DataType, Field, Schema},
    error::ArrowError,
};
use datafusion::{
    catalog::TableProvider,
    common::{
        ParamValues,
        tree_node::{TreeNode as _, TreeNodeRecursion},
    },
    error::DataFusionError,
    execution::{
        SessionState,
        context::SQLOptions,
        runtime_env::{RuntimeEnv, RuntimeEnvBuilder},
    },
    logical_expr::{Expr, LogicalPlan, Volatility, expr::ScalarFunction},
    physical_plan::execute_stream,
    prelude::{DataFrame, SessionConfig, SessionContext},
    scalar::ScalarValue,
    sql::{
        parser::{DFParser, Statement},
        sqlparser::ast,
    },
};
use futures_util::StreamExt as _;
use reel_tables::{Store, Table, View, views};
use reel_trace::TraceFiles;
use tokio::{runtime::Runtime, sync::mpsc};

use crate::{
    control::{Control, StopReason, TraceAccess},
    estimate, functions,
    limits::{self, Limits, OPERATORS_MAX, SQL_BYTES_MAX},
    named,
    partition::{TRACE, partition_by_trace},
    tables::{StepFields, plain, provider, step_fields},
};
use crate::{planning::stoppable, watched::watched};
use statement::{bind, plan_of};

/// How often a running query is looked at.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// How long a query that was told to stop may take to do so before it is left alone.
const GRACE: Duration = Duration::from_secs(1);
/// Batches of an answer that wait for who takes them.
const AHEAD: usize = 4;

/// Parameters of a query, by name without `$`.
pub type Parameters = BTreeMap<String, String>;

/// Makes of a session's state one whose plans run in a cluster.
pub type EngineFactory =
    dyn Fn(SessionState) -> Result<SessionState, DataFusionError> + Send + Sync;

/// A session over one store, for one question at a time. Sees the store as it was when
/// the session was made.
pub struct QuerySession(Arc<Inner>);

struct Inner {
    store: Store,
    limits: Limits,
    control: Arc<Control>,
    environment: Arc<RuntimeEnv>,
    runtime: Arc<Runtime>,
    views: Vec<View>,
    remote_engine: Option<Box<EngineFactory>>,
}

/// What a running query hands on.
enum Part {
    Batch(RecordBatch),
    End(Result<CacheScope, QueryError>),
}

/// How long an answer holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CacheScope {
    /// As long as nobody writes to the store: the question asks its tables alone.
    StoreVersion,
    /// For the moment: the question asks the clock, chance, or the traces, or nobody
    /// waited for the end.
    Uncacheable,
}

/// Why a query has no result.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum QueryError {
    /// The text is not exactly one read-only query.
    #[error(
        "only questions are allowed here (SELECT, WITH, EXPLAIN, DESCRIBE, SHOW), one at a time: {reason}"
    )]
    ReadOnly { reason: String },
    /// The text is too long.
    #[error("the query has {bytes} bytes; the limit is {SQL_BYTES_MAX}")]
    TooLong { bytes: usize },
    /// The text nests too deep.
    #[error(
        "the query has {operators} operators; the limit is {OPERATORS_MAX}: for long lists use IN (...)"
    )]
    TooDeep { operators: usize },
    /// The query was cancelled or exceeded one of its limits.
    #[error("{0}")]
    Stopped(StopReason),
    /// A parameter is missing, unknown or no value.
    #[error("{0}")]
    Parameter(String),
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] reel_tables::StoreError),
    /// The query is wrong, too large, or a file is damaged.
    #[error("{}", message(.0))]
    Engine(DataFusionError),
    /// The result cannot be shown.
    #[error("cannot show the result: {0}")]
    Arrow(#[from] arrow::error::ArrowError),
}

impl From<DataFusionError> for QueryError {
    fn from(error: DataFusionError) -> Self {
        if let DataFusionError::External(cause) = error.find_root()
            && let Some(stopped) = cause.downcast_ref::<StopReason>()
        {
            return QueryError::Stopped(stopped.clone());
        }
        QueryError::Engine(error)
    }
}

impl QuerySession {
    /// A session with the default limits.
    ///
    /// # Errors
    /// When the engine cannot be set up.
    pub fn new(store: Store) -> Result<Self, QueryError> {
        Self::with_limits(store, Limits::default())
    }

    /// A session whose questions may cost so much.
    ///
    /// # Errors
    /// When the engine cannot be set up.
    pub fn with_limits(store: Store, limits: Limits) -> Result<Self, QueryError> {
        Self::on(store, limits, None)
    }

    /// A session whose plans run on another engine, which has our functions
    /// ([`crate::every_function`]) and reads the store's files where they lie. The limits on memory
    /// and time are those of this process then.
    ///
    /// # Errors
    /// When the engine cannot be set up.
    pub fn with_remote_engine(
        store: Store,
        limits: Limits,
        engine: Box<EngineFactory>,
    ) -> Result<Self, QueryError> {
        Self::on(store, limits, Some(engine))
    }

    fn on(
        store: Store,
        limits: Limits,
        remote_engine: Option<Box<EngineFactory>>,
    ) -> Result<Self, QueryError> {
        let runtime = store.runtime();
        let environment = RuntimeEnvBuilder::new()
            .with_memory_limit(limits.memory_bytes, 1.0)
            .with_max_temp_directory_size((limits.memory_bytes as u64).saturating_mul(8))
            .build_arc()?;
        let (root, objects) = store.objects();
        environment.register_object_store(&root, objects);
        let views = all_views(&StepFields::All);
        store.check_files()?;
        Ok(Self(Arc::new(Inner {
            control: Arc::new(Control::new(store.trace_files().clone())),
            store,
            limits,
            environment,
            runtime,
            views,
            remote_engine,
        })))
    }

    /// Stops the session's queries, and tells how far its simulator functions are.
    pub fn control(&self) -> Arc<Control> {
        self.0.control.clone()
    }

    /// From now on Ctrl-C stops the session's queries instead of the process.
    pub fn stop_on_ctrl_c(&self) {
        let control = self.control();
        self.0.runtime.spawn(async move {
            while tokio::signal::ctrl_c().await.is_ok() {
                control.cancel();
            }
        });
    }

    /// The store it asks.
    pub fn store(&self) -> &Store {
        &self.0.store
    }

    /// Runs one query. There is always a batch, if only an empty one with the columns.
    ///
    /// # Errors
    /// When it is no question, is wrong, or exceeds a limit.
    pub fn run(&self, sql: &str) -> Result<Vec<RecordBatch>, QueryError> {
        self.run_with(sql, &Parameters::new())
    }

    /// Runs one query with values for its `$parameters`.
    ///
    /// # Errors
    /// As [`QuerySession::run`], and when a parameter is missing.
    pub fn run_with(
        &self,
        sql: &str,
        parameters: &Parameters,
    ) -> Result<Vec<RecordBatch>, QueryError> {
        let mut batches = Vec::new();
        self.run_each(sql, parameters, |batch| {
            batches.push(batch);
            true
        })?;
        Ok(batches)
    }

    /// Runs one query, handing each batch of the answer on as it comes, until `take` wants no more.
    /// It may wait: the query waits with it. Says how long the answer holds.
    ///
    /// # Errors
    /// As [`QuerySession::run_with`]; some batches may have been handed on then.
    pub fn run_each(
        &self,
        sql: &str,
        parameters: &Parameters,
        take: impl FnMut(RecordBatch) -> bool,
    ) -> Result<CacheScope, QueryError> {
        if sql.len() > SQL_BYTES_MAX {
            return Err(QueryError::TooLong { bytes: sql.len() });
        }
        let operators = limits::operators(sql);
        if operators > OPERATORS_MAX {
            return Err(QueryError::TooDeep { operators });
        }
        self.0.control.begin();
        let (sender, answer) = mpsc::channel(AHEAD);
        let (inner, sql, parameters) = (self.0.clone(), sql.to_owned(), parameters.clone());
        // a long chain of operators is a deep tree, and planning walks down it
        let thread = std::thread::Builder::new()
            .stack_size(reel_tables::STACK_BYTES)
            .spawn(move || {
                let end = inner
                    .runtime
                    .block_on(inner.answer(&sql, &parameters, sender.clone()));
                let _ = sender.blocking_send(Part::End(end));
            });
        thread.map_err(|error| QueryError::Engine(error.into()))?;
        self.0.watch(answer, take)
    }

    /// Fields of `episodes.steps` that a query reads from disk; none: all of them.
    ///
    /// # Errors
    /// As [`QuerySession::run`].
    pub fn step_fields(&self, sql: &str) -> Result<Option<BTreeSet<String>>, QueryError> {
        self.0.runtime.block_on(async {
            let (context, plan) = self
                .0
                .planned(sql, &Parameters::new(), &StepFields::All)
                .await?;
            Ok(match step_fields(&context.state().optimize(&plan)?)? {
                StepFields::All => None,
                StepFields::Some(fields) => {
                    let planned = self
                        .0
                        .planned(sql, &Parameters::new(), &StepFields::Some(fields.clone()))
                        .await;
                    planned.is_ok().then(|| fields.into_keys().collect())
                }
            })
        })
    }
}

impl Inner {
    /// Hands the answer on, for no longer and with no more memory than is allowed. What does not
    /// listen is left alone.
    fn watch(
        &self,
        mut answer: mpsc::Receiver<Part>,
        mut take: impl FnMut(RecordBatch) -> bool,
    ) -> Result<CacheScope, QueryError> {
        let (begun, resident_before) = (Instant::now(), limits::resident_bytes().unwrap_or(0));
        let memory = self.limits.memory_bytes.saturating_mul(4);
        let mut looked = begun;
        let stopped = loop {
            match self.next_part(&mut answer, LOOK_EVERY) {
                Ok(Some(Part::Batch(batch))) => {
                    if !take(batch) {
                        self.control.cancel();
                        return Ok(CacheScope::Uncacheable);
                    }
                    if looked.elapsed() < LOOK_EVERY {
                        continue;
                    }
                }
                Ok(Some(Part::End(end))) => return end,
                Ok(None) => {
                    return Err(QueryError::Engine(DataFusionError::Execution(
                        "the query engine panicked".into(),
                    )));
                }
                Err(_) => {}
            }
            looked = Instant::now();
            if self.control.is_cancelled() {
                break StopReason::Cancelled;
            }
            if begun.elapsed() > self.limits.time {
                break StopReason::Time {
                    seconds: self.limits.time.as_secs(),
                };
            }
            if limits::resident_bytes()
                .unwrap_or(0)
                .saturating_sub(resident_before)
                > memory
            {
                self.control.cancel();
                return Err(QueryError::Stopped(StopReason::Memory { bytes: memory }));
            }
        };
        self.control.cancel();
        let patience = Instant::now() + GRACE;
        while let Ok(Some(Part::Batch(_))) = self.next_part(
            &mut answer,
            patience.saturating_duration_since(Instant::now()),
        ) {}
        Err(QueryError::Stopped(stopped))
    }

    /// The next part of an answer, if it comes in time; none where the query's thread is gone.
    fn next_part(
        &self,
        answer: &mut mpsc::Receiver<Part>,
        patience: Duration,
    ) -> Result<Option<Part>, tokio::time::error::Elapsed> {
        self.runtime
            .block_on(async { tokio::time::timeout(patience, answer.recv()).await })
    }

    async fn answer(
        &self,
        sql: &str,
        parameters: &Parameters,
        to: mpsc::Sender<Part>,
    ) -> Result<CacheScope, QueryError> {
        let (context, plan) = self.plan(sql, parameters).await?;
        let lasting = lasting(&plan)?;
        let plan = if self.remote_engine.is_some() && opens_traces(&plan)? {
            partition_by_trace(plan)?
        } else {
            plan
        };
        self.hand_on(&context, plan, to).await?;
        Ok(lasting)
    }

    async fn plan(
        &self,
        sql: &str,
        parameters: &Parameters,
    ) -> Result<(SessionContext, LogicalPlan), QueryError> {
        let statements = DFParser::parse_sql(sql)?;
        if statements.len() != 1 {
            return Err(QueryError::ReadOnly {
                reason: format!("found {} statements", statements.len()),
            });
        }
        estimate::check_text(&statements[0])?;
        let (context, plan) = self.planned(sql, parameters, &StepFields::All).await?;
        // the columns of the tables are those of the store, not those that are read
        if matches!(plan, LogicalPlan::DescribeTable(_))
            || sql.to_ascii_lowercase().contains("information_schema")
        {
            return Ok((context, plan));
        }
        match step_fields(&context.state().optimize(&plan)?)? {
            StepFields::All => Ok((context, plan)),
            // an answer without rows reads nothing, and has its columns all the same
            fields => match self.planned(sql, parameters, &fields).await {
                Ok(narrow) if columns(&narrow.1).eq(columns(&plan)) => Ok(narrow),
                _ => Ok((context, plan)),
            },
        }
    }

    async fn planned(
        &self,
        sql: &str,
        parameters: &Parameters,
        fields: &StepFields,
    ) -> Result<(SessionContext, LogicalPlan), QueryError> {
        let context = self.context(sql, fields).await?;
        let plan = plan_of(&context, sql).await?;
        estimate::check_nesting(&plan)?;
        let questions = SQLOptions::new()
            .with_allow_ddl(false)
            .with_allow_dml(false)
            .with_allow_statements(false);
        questions
            .verify_plan(&plan)
            .map_err(|error| QueryError::ReadOnly {
                reason: message(&error),
            })?;
        let plan = bind(plan, parameters)?;
        if opens_traces(&plan)? {
            self.allow_traces(&context).await?;
        }
        Ok((context, plan))
    }

    /// A context with the tables and views that a text names, and those that they name.
    async fn context(&self, sql: &str, fields: &StepFields) -> Result<SessionContext, QueryError> {
        let config = SessionConfig::new()
            .with_information_schema(true)
            .with_target_partitions(threads());
        let context = SessionContext::new_with_config_rt(config, self.environment.clone());
        let context = match &self.remote_engine {
            Some(engine) => SessionContext::new_with_state(engine(context.state())?),
            None => SessionContext::new_with_state(stoppable(context.state(), &self.control)),
        };
        equip(&context, &self.control);
        let named = self.named(&context, sql)?;
        let flat = views(|_| true).iter().any(|view| named.contains(view.name));
        let fields = if flat { &fields.with_number() } else { fields };
        for table in Table::ALL {
            if named.contains(table.name()) {
                context.register_table(table.name(), self.provider(table, fields)?)?;
            }
        }
        for view in all_views(fields)
            .iter()
            .filter(|view| named.contains(view.name))
        {
            let plan = plan_of(&context, &view.sql).await?;
            context.register_table(view.name, DataFrame::new(context.state(), plan).into_view())?;
        }
        Ok(context)
    }

    fn provider(
        &self,
        table: Table,
        fields: &StepFields,
    ) -> Result<Arc<dyn TableProvider>, QueryError> {
        // other engines know no table that reads codes
        let fields = if self.remote_engine.is_some() {
            &fields.as_values()
        } else {
            fields
        };
        Ok(provider(&self.store, table, fields)?)
    }

    /// Tables and views that a text needs.
    fn named(&self, context: &SessionContext, sql: &str) -> Result<BTreeSet<String>, QueryError> {
        let state = context.state();
        let mut named = BTreeSet::new();
        let mut open = vec![sql.to_owned()];
        while let Some(sql) = open.pop() {
            let dialect = state.config().options().sql_parser.dialect;
            let statement = state.sql_to_statement(&sql, &dialect)?;
            let references: BTreeSet<String> = state
                .resolve_table_references(&statement)?
                .iter()
                .map(|reference| reference.table().to_owned())
                .collect();
            // who lists the tables wants to see them all
            let all = references.iter().any(|name| !self.knows(name))
                || sql.to_ascii_lowercase().contains("show ");
            let wanted: Vec<String> = if all {
                self.names().map(str::to_owned).collect()
            } else {
                references.into_iter().collect()
            };
            for name in wanted {
                if named.insert(name.clone()) {
                    open.extend(
                        self.views
                            .iter()
                            .filter(|view| view.name == name)
                            .map(|view| view.sql.clone()),
                    );
                }
            }
        }
        Ok(named)
    }

    fn names(&self) -> impl Iterator<Item = &'static str> {
        Table::ALL
            .into_iter()
            .map(Table::name)
            .chain(self.views.iter().map(|view| view.name))
    }

    fn knows(&self, name: &str) -> bool {
        self.names().any(|known| known == name)
    }

    /// Lets the functions open the traces of the store, and no other files.
    async fn allow_traces(&self, context: &SessionContext) -> Result<(), QueryError> {
        // in a cluster, whoever runs the functions decides which files they open
        if self.control.knows_traces() || self.remote_engine.is_some() {
            return Ok(());
        }
        let table = self.provider(Table::Episodes, &StepFields::Some(BTreeMap::new()))?;
        let batches = context
            .read_table(table)?
            .select_columns(&[TRACE])?
            .collect()
            .await?;
        let mut traces = BTreeSet::new();
        for batch in &batches {
            let column = cast(batch.column(0), &DataType::Utf8)?;
            traces.extend(
                column
                    .as_string::<i32>()
                    .iter()
                    .flatten()
                    .map(str::to_owned),
            );
        }
        self.control.allow(TraceAccess::These(traces));
        Ok(())
    }

    async fn hand_on(
        &self,
        context: &SessionContext,
        plan: LogicalPlan,
        to: mpsc::Sender<Part>,
    ) -> Result<(), QueryError> {
        let rows_max = self.limits.rows;
        let frame = context.execute_logical_plan(plan.clone()).await?;
        let columns = Arc::new(frame.schema().as_arrow().clone());
        let tasks = Arc::new(frame.task_ctx());
        let physical = frame.create_physical_plan().await?;
        if self.remote_engine.is_none()
            && context.copied_config().batch_size() == estimate::BATCH_ROWS
            && let Some(rows) = estimate::batch_rows(&physical)?
        {
            // Tables that are made while planning have the size of their batches from then on.
            {
                let state = context.state_ref();
                let mut state = state.write();
                let options = state.config_mut().options_mut();
                options.set("datafusion.execution.batch_size", &rows.to_string())?;
            }
            return Box::pin(self.hand_on(context, plan, to)).await;
        }
        let physical = match &self.remote_engine {
            Some(_) => physical,
            None => {
                estimate::check_plan(&physical)?;
                watched(physical, &self.control)?
            }
        };
        let mut answer = tokio::spawn(async move {
            let mut stream = execute_stream(physical, tasks)?;
            let (mut rows, mut empty) = (0, true);
            while let Some(batch) = stream.next().await {
                let batch = in_plain_types(&batch?)?;
                rows += batch.num_rows();
                if rows > rows_max {
                    return Err(DataFusionError::External(Box::new(StopReason::Rows {
                        rows: rows_max,
                    })));
                }
                empty = false;
                if to.send(Part::Batch(batch)).await.is_err() {
                    return Ok(());
                }
            }
            if empty {
                let empty = in_plain_types(&RecordBatch::new_empty(columns))?;
                let _ = to.send(Part::Batch(empty)).await;
            }
            Ok::<_, DataFusionError>(())
        });
        let cancelled = async {
            while !self.control.is_cancelled() {
                tokio::time::sleep(LOOK_EVERY).await;
            }
        };
        tokio::select! {
            answer = &mut answer => Ok(answer.map_err(|error| DataFusionError::ExecutionJoin(Box::new(error)))??),
            () = cancelled => {
                answer.abort();
                // another engine is told when the answer is let go of
                let _ = tokio::time::timeout(GRACE, answer).await;
                Err(QueryError::Stopped(StopReason::Cancelled))
            }
        }
    }
}

/// Whether a plan calls a function that opens traces.
fn opens_traces(plan: &LogicalPlan) -> Result<bool, DataFusionError> {
    calls(plan, |call| functions::opens_traces(call.name()))
}

fn lasting(plan: &LogicalPlan) -> Result<CacheScope, DataFusionError> {
    let moves = |call: &ScalarFunction| call.func.signature().volatility != Volatility::Immutable;
    Ok(if opens_traces(plan)? || calls(plan, moves)? {
        CacheScope::Uncacheable
    } else {
        CacheScope::StoreVersion
    })
}

/// Whether a plan calls such a function.
fn calls(
    plan: &LogicalPlan,
    such: impl Fn(&ScalarFunction) -> bool,
) -> Result<bool, DataFusionError> {
    let call =
        |expression: &Expr| Ok(matches!(expression, Expr::ScalarFunction(call) if such(call)));
    let mut found = false;
    plan.apply_with_subqueries(|node| {
        for expression in node.expressions() {
            found = found || expression.exists(&call)?;
        }
        Ok(if found {
            TreeNodeRecursion::Stop
        } else {
            TreeNodeRecursion::Continue
        })
    })?;
    Ok(found)
}

/// An answer in the types of the tables, however they were read.
fn in_plain_types(batch: &RecordBatch) -> Result<RecordBatch, ArrowError> {
    let schema = batch.schema();
    let fields: Vec<Field> = schema
        .fields()
        .iter()
        .map(|field| {
            field
                .as_ref()
                .clone()
                .with_data_type(plain(field.data_type()))
        })
        .collect();
    let columns: Result<_, _> = batch
        .columns()
        .iter()
        .zip(&fields)
        .map(|(column, field)| cast(column, field.data_type()))
        .collect();
    let rows = RecordBatchOptions::new().with_row_count(Some(batch.num_rows()));
    RecordBatch::try_new_with_options(Arc::new(Schema::new(fields)), columns?, &rows)
}

impl std::fmt::Debug for QuerySession {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Session")
            .field("store", &self.0.store)
            .field("limits", &self.0.limits)
            .finish_non_exhaustive()
    }
}

/// The state of an engine that has every function a session has, for who runs the plans of
/// sessions with a remote engine; the functions read traces from `files`.
pub fn every_function(
    config: SessionConfig,
    environment: Arc<RuntimeEnv>,
    opens: TraceAccess,
    files: TraceFiles,
) -> SessionState {
    let context = SessionContext::new_with_config_rt(config, environment);
    let control = Arc::new(Control::new(files));
    control.allow(opens);
    equip(&context, &control);
    context.state()
}

/// Our functions, and a guard before those that make much of little.
pub(crate) fn equip(context: &SessionContext, control: &Arc<Control>) {
    limits::guard(context);
    functions::all(control)
        .into_iter()
        .for_each(|function| context.register_udf(function));
}

/// Names of the columns of an answer.
fn columns(plan: &LogicalPlan) -> impl Iterator<Item = &String> {
    plan.schema().fields().iter().map(|field| field.name())
}

/// The flat views and the named queries as views.
fn all_views(fields: &StepFields) -> Vec<View> {
    let named = |query: &named::NamedQuery| View {
        name: query.name,
        meaning: "",
        sql: query.with_defaults(),
    };
    let flat = views(|field| fields.has(field));
    flat.into_iter()
        .chain(named::ALL.iter().map(named))
        .collect()
}

fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// The engine's own words, without its wrappers and its names for where the tables are.
fn message(error: &DataFusionError) -> String {
    error
        .find_root()
        .strip_backtrace()
        .replace("datafusion.public.", "")
}
