//! Planning that can be stopped: before every rule that rewrites a plan, and before every node that
//! the optimizer takes one to, it is asked whether the query goes on. The analyzer's rules are not
//! asked. Never what a rule does.

use std::sync::Arc;

use datafusion::{
    common::tree_node::Transformed,
    config::ConfigOptions,
    error::Result,
    execution::{SessionState, session_state::SessionStateBuilder},
    logical_expr::LogicalPlan,
    optimizer::{ApplyOrder, OptimizerConfig, OptimizerRule},
    physical_optimizer::{PhysicalOptimizerContext, PhysicalOptimizerRule},
    physical_plan::ExecutionPlan,
};

use crate::control::Control;

/// The same state, whose planning can be stopped.
pub(crate) fn stoppable(state: SessionState, control: &Arc<Control>) -> SessionState {
    let rule = |rule: &Arc<dyn OptimizerRule + Send + Sync>| {
        Arc::new(Stoppable {
            rule: rule.clone(),
            control: control.clone(),
            query: control.query(),
        }) as Arc<dyn OptimizerRule + Send + Sync>
    };
    let physical = |rule: &Arc<dyn PhysicalOptimizerRule + Send + Sync>| {
        Arc::new(Stoppable {
            rule: rule.clone(),
            control: control.clone(),
            query: control.query(),
        }) as Arc<dyn PhysicalOptimizerRule + Send + Sync>
    };
    let rules = state.optimizers().iter().map(rule).collect();
    let physical = state.physical_optimizers().iter().map(physical).collect();
    SessionStateBuilder::new_from_existing(state)
        .with_optimizer_rules(rules)
        .with_physical_optimizer_rules(physical)
        .build()
}

/// A rule, in every respect but that it can be stopped.
#[derive(Debug)]
struct Stoppable<R: ?Sized> {
    control: Arc<Control>,
    query: u64,
    rule: Arc<R>,
}

impl OptimizerRule for Stoppable<dyn OptimizerRule + Send + Sync> {
    fn name(&self) -> &str {
        self.rule.name()
    }

    fn apply_order(&self) -> Option<ApplyOrder> {
        self.rule.apply_order()
    }

    fn rewrite(
        &self,
        plan: LogicalPlan,
        config: &dyn OptimizerConfig,
    ) -> Result<Transformed<LogicalPlan>> {
        self.control.check_query(self.query)?;
        self.rule.rewrite(plan, config)
    }
}

impl PhysicalOptimizerRule for Stoppable<dyn PhysicalOptimizerRule + Send + Sync> {
    fn optimize(
        &self,
        plan: Arc<dyn ExecutionPlan>,
        config: &ConfigOptions,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        self.control.check_query(self.query)?;
        self.rule.optimize(plan, config)
    }

    fn optimize_with_context(
        &self,
        plan: Arc<dyn ExecutionPlan>,
        context: &dyn PhysicalOptimizerContext,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        self.control.check_query(self.query)?;
        self.rule.optimize_with_context(plan, context)
    }

    fn name(&self) -> &str {
        self.rule.name()
    }

    fn schema_check(&self) -> bool {
        self.rule.schema_check()
    }
}
