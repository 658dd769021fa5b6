//! A read-only SQL session over one version of a store: plans a question, holds it to
//! its limits, collects the answer. Never writes, and reads no file but the store's and,
//! by functions, its traces.

mod answer;
mod catalog;
mod error;
mod statement;

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use arrow::array::RecordBatch;
use datafusion::{
    common::tree_node::TreeNode as _,
    error::DataFusionError,
    execution::{
        SessionState,
        context::SQLOptions,
        runtime_env::{RuntimeEnv, RuntimeEnvBuilder},
    },
    logical_expr::{Expr, LogicalPlan, Volatility, expr::ScalarFunction},
    prelude::{SessionConfig, SessionContext},
    sql::parser::DFParser,
};
use reel_tables::{Store, View};
use reel_trace::TraceFiles;
use tokio::{runtime::Runtime, sync::mpsc};

use crate::{
    control::{Control, TraceAccess},
    estimate, functions,
    limits::{self, Limits, OPERATORS_MAX, SQL_BYTES_MAX},
    partition::partition_by_trace,
    sort_keys::precompute_sort_keys,
    tables::{StepFields, asks_schema, has_node, reads_steps, step_fields, without_empty_tables},
};
use answer::{AHEAD, Part};
use catalog::all_views;
pub use error::QueryError;
use error::message;
use statement::{bind, plan_of};

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

/// How long an answer holds.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum CacheScope {
    /// As long as nobody writes to the store: the question asks its tables alone.
    StoreVersion,
    /// For the moment: the question asks the clock, chance, or the traces, or nobody
    /// waited for the end.
    Uncacheable,
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
    /// It may wait: the query waits with it. Says how long the answer holds. What `replay` found
    /// goes to the store's table `verdicts`, unless a remote engine executes it.
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
        let scope = self.0.watch(answer, take);
        // A question that was stopped has verdicts as well, and a store that cannot be written
        // answers all the same.
        let verdicts = self.0.control.take_verdicts();
        let _ = self.0.store.append_new_verdicts(&verdicts);
        scope
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
                StepFields::Stored | StepFields::All => None,
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
    async fn answer(
        &self,
        sql: &str,
        parameters: &Parameters,
        to: mpsc::Sender<Part>,
    ) -> Result<CacheScope, QueryError> {
        let (context, mut question) = self.plan(sql, parameters).await?;
        let lasting = lasting(&question.plan)?;
        if self.remote_engine.is_some() {
            question.optimized = None;
            if opens_traces(&question.plan)? {
                question.plan = partition_by_trace(question.plan)?;
            }
        }
        self.hand_on(&context, question, to).await?;
        Ok(lasting)
    }

    async fn plan(
        &self,
        sql: &str,
        parameters: &Parameters,
    ) -> Result<(SessionContext, Question), QueryError> {
        let statements = DFParser::parse_sql(sql)?;
        if statements.len() != 1 {
            return Err(QueryError::ReadOnly {
                reason: format!("found {} statements", statements.len()),
            });
        }
        estimate::check_text(&statements[0])?;
        if let Ok(Some(question)) = self.plan_over_views(sql, parameters).await {
            return Ok(question);
        }
        let (context, plan) = self.planned(sql, parameters, &StepFields::Stored).await?;
        Ok((context, plan.into()))
    }

    /// A question over columns in the form in which they are read fastest; none if it is about the
    /// columns as the store has them. Where a text of the tables and one of the steps, which is no
    /// view, have to be of one type, there is an error: it is planned over the store's columns then.
    async fn plan_over_views(
        &self,
        sql: &str,
        parameters: &Parameters,
    ) -> Result<Option<(SessionContext, Question)>, QueryError> {
        let (context, plan) = self.planned(sql, parameters, &StepFields::All).await?;
        if asks_schema(&plan)? {
            return Ok(None);
        }
        let optimized = context.state().optimize(&plan)?;
        let fields = step_fields(&optimized)?;
        if fields != StepFields::All
            && reads_steps(&optimized)?
            && let Ok((context, narrow)) = self.planned(sql, parameters, &fields).await
            // an answer without rows reads nothing, and has its columns all the same
            && columns(&narrow).eq(columns(&plan))
        {
            return Ok(Some((context, narrow.into())));
        }
        let optimized = Some(optimized);
        Ok(Some((context, Question { plan, optimized })))
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
        let plan = precompute_sort_keys(without_empty_tables(bind(plan, parameters)?)?)?;
        if opens_traces(&plan)? {
            self.allow_traces(&context).await?;
        }
        Ok((context, plan))
    }
}

/// What is asked, planned.
struct Question {
    plan: LogicalPlan,
    /// The same as the optimizer left it, where it was asked already.
    optimized: Option<LogicalPlan>,
}

impl From<LogicalPlan> for Question {
    fn from(plan: LogicalPlan) -> Self {
        let optimized = None;
        Self { plan, optimized }
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
    has_node(plan, |node| {
        let expressions = node.expressions();
        expressions
            .iter()
            .any(|expression| expression.exists(&call).is_ok_and(|found| found))
    })
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
