//! What a query may name: the tables and views that its text needs, and the traces that its
//! functions may open.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use arrow::{array::AsArray, compute::cast, datatypes::DataType};
use datafusion::{
    catalog::TableProvider,
    prelude::{DataFrame, SessionConfig, SessionContext},
};
use reel_tables::{Table, View, views};

use super::{Inner, QueryError, equip, statement::plan_of};
use crate::{
    control::TraceAccess,
    named,
    partition::TRACE,
    planning::stoppable,
    tables::{StepFields, provider},
};

impl Inner {
    /// A context with the tables and views that a text names, and those that they name.
    pub(super) async fn context(
        &self,
        sql: &str,
        fields: &StepFields,
    ) -> Result<SessionContext, QueryError> {
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
    pub(super) async fn allow_traces(&self, context: &SessionContext) -> Result<(), QueryError> {
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
}

/// The flat views and the named queries as views.
pub(super) fn all_views(fields: &StepFields) -> Vec<View> {
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
