//! The store's tables and views in a DataFusion session: only those that a question names, and of
//! the nested steps only the fields that it reads. Runs nothing.
//!
//! A question is planned over all fields, to see which fields of `episodes.steps` it reads, and if it
//! reads some, again over a table that has no others, so that Parquet decodes no others. Where a use
//! is not understood, all are read. Texts that only our own functions on sequences look at are read
//! as the codes that Parquet keeps them in, and never made texts; other texts are views, which group
//! and compare without being copied.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
    sync::Arc,
};

use arrow::datatypes::{DataType, Field, Fields, Schema, SchemaRef};
use async_trait::async_trait;
use datafusion::{
    catalog::{
        Session, TableProvider, default_table_source::source_as_provider,
        information_schema::INFORMATION_SCHEMA,
    },
    common::{
        DFSchema,
        tree_node::{Transformed, TreeNode, TreeNodeRecursion},
    },
    datasource::{
        TableType,
        empty::EmptyTable,
        file_format::parquet::ParquetFormat,
        listing::{ListingOptions, ListingTable, ListingTableConfig, ListingTableUrl},
        physical_plan::{FileGroup, FileScanConfig},
        source::DataSourceExec,
    },
    error::Result,
    logical_expr::{EmptyRelation, Expr, ExprSchemable, LogicalPlan, TableProviderFilterPushDown},
    physical_plan::ExecutionPlan,
};
use reel_tables::{Store, Table};

use crate::functions::sequence;

/// The column of `episodes` that is read in part.
const STEPS: &str = "steps";
/// The field of the steps that is read where no other is: a list of structs needs one.
const NUMBER: &str = "step";

/// Fields of the steps that a question reads; all of them where it is not to be seen.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum StepFields {
    /// All of them, and every column in the form in which the store has it, for a question about the
    /// schema.
    Stored,
    All,
    Some(BTreeMap<String, ReadAs>),
}

/// In what form a field of the steps is read.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub(crate) enum ReadAs {
    /// Texts as codes with a dictionary.
    Codes,
    /// As the table says.
    Values,
}

impl StepFields {
    /// Whether a field of the steps is read.
    pub(crate) fn has(&self, field: &str) -> bool {
        match self {
            StepFields::Stored | StepFields::All => true,
            StepFields::Some(names) => {
                names.contains_key(field) || (names.is_empty() && field == NUMBER)
            }
        }
    }

    /// These, and the number of the step, which the flat views name whether it is asked for or not.
    pub(crate) fn with_number(&self) -> StepFields {
        match self {
            StepFields::Stored | StepFields::All => self.clone(),
            StepFields::Some(names) => {
                let mut names = names.clone();
                names.insert(NUMBER.to_owned(), ReadAs::Values);
                StepFields::Some(names)
            }
        }
    }

    /// These, all as the table says.
    pub(crate) fn as_values(&self) -> StepFields {
        match self {
            StepFields::Stored | StepFields::All => self.clone(),
            StepFields::Some(names) => StepFields::Some(
                names
                    .keys()
                    .map(|name| (name.clone(), ReadAs::Values))
                    .collect(),
            ),
        }
    }

    /// A field in the form in which it is read.
    fn form(&self, field: &Arc<Field>) -> Arc<Field> {
        match (self, field.data_type()) {
            (StepFields::Some(names), DataType::Utf8)
                if names.get(field.name()) == Some(&ReadAs::Codes) =>
            {
                let codes =
                    DataType::Dictionary(Box::new(DataType::Int32), Box::new(DataType::Utf8));
                Arc::new(field.as_ref().clone().with_data_type(codes))
            }
            _ => field.clone(),
        }
    }
}

/// A table of the store, its steps narrowed.
pub(crate) fn provider(
    store: &Store,
    table: Table,
    fields: &StepFields,
) -> Result<Arc<dyn TableProvider>> {
    let schema = match (table, fields) {
        (_, StepFields::Stored) => table.schema(),
        (Table::Episodes, _) => narrowed(&table.schema(), fields),
        _ => viewed(&table.schema()),
    };
    let files = store.files(table);
    if files.is_empty() {
        return Ok(Arc::new(EmptyTable::new(schema)));
    }
    let urls = files
        .iter()
        .map(ListingTableUrl::parse)
        .collect::<Result<Vec<_>>>()?;
    let options =
        ListingOptions::new(Arc::new(ParquetFormat::default())).with_file_extension(".parquet");
    let config = ListingTableConfig::new_with_multi_paths(urls)
        .with_listing_options(options)
        .with_schema(schema);
    let listing = ListingTable::try_new(config)?;
    let in_files = with_steps(&table.schema(), |all| {
        all.iter().map(|field| fields.form(field)).collect()
    });
    if in_files == table.schema() {
        return Ok(Arc::new(listing));
    }
    Ok(Arc::new(Coded { listing, in_files }))
}

/// A listing that says in which form the columns of its files are to be read.
#[derive(Debug)]
struct Coded {
    listing: ListingTable,
    in_files: SchemaRef,
}

#[async_trait]
impl TableProvider for Coded {
    fn schema(&self) -> SchemaRef {
        self.listing.schema()
    }

    fn table_type(&self) -> TableType {
        self.listing.table_type()
    }

    fn supports_filters_pushdown(
        &self,
        filters: &[&Expr],
    ) -> Result<Vec<TableProviderFilterPushDown>> {
        self.listing.supports_filters_pushdown(filters)
    }

    async fn scan(
        &self,
        state: &dyn Session,
        projection: Option<&Vec<usize>>,
        filters: &[Expr],
        limit: Option<usize>,
    ) -> Result<Arc<dyn ExecutionPlan>> {
        let plan = self.listing.scan(state, projection, filters, limit).await?;
        let told = plan.transform_up(|node| {
            let config = node
                .downcast_ref::<DataSourceExec>()
                .and_then(|scan| scan.data_source().downcast_ref::<FileScanConfig>());
            let Some(config) = config else {
                return Ok(Transformed::no(node));
            };
            let mut config = config.clone();
            for group in &mut config.file_groups {
                let files = group
                    .iter()
                    .map(|file| file.clone().with_arrow_schema(self.in_files.clone()));
                *group = FileGroup::new(files.collect());
            }
            let scan: Arc<dyn ExecutionPlan> = DataSourceExec::from_data_source(config);
            Ok(Transformed::yes(scan))
        });
        Ok(told?.data)
    }
}

/// What a question sees of `episodes`: the steps' fields that it reads, and its other texts as views.
fn narrowed(schema: &SchemaRef, fields: &StepFields) -> SchemaRef {
    let steps = |all: &Fields| {
        all.iter()
            .filter(|field| fields.has(field.name()))
            .map(|field| fields.form(field))
            .collect()
    };
    viewed(&with_steps(schema, steps))
}

/// A schema whose texts are views.
fn viewed(schema: &SchemaRef) -> SchemaRef {
    let view = |field: &Arc<Field>| match field.data_type() {
        DataType::Utf8 => Arc::new(field.as_ref().clone().with_data_type(DataType::Utf8View)),
        _ => field.clone(),
    };
    Arc::new(Schema::new(
        schema.fields().iter().map(view).collect::<Fields>(),
    ))
}

/// A type as the tables have it: no views, no codes.
pub(crate) fn plain(data_type: &DataType) -> DataType {
    let field = |field: &Arc<Field>| {
        Arc::new(
            field
                .as_ref()
                .clone()
                .with_data_type(plain(field.data_type())),
        )
    };
    match data_type {
        DataType::Utf8View => DataType::Utf8,
        DataType::BinaryView => DataType::Binary,
        DataType::Dictionary(_, values) => plain(values),
        DataType::List(item) => DataType::List(field(item)),
        DataType::Struct(fields) => DataType::Struct(fields.iter().map(field).collect()),
        other => other.clone(),
    }
}

/// A schema with other fields of the steps.
fn with_steps(schema: &SchemaRef, of: impl Fn(&Fields) -> Fields) -> SchemaRef {
    let change = |field: &Arc<Field>| match step_struct(field.data_type()) {
        Some(all) if field.name() == STEPS => Arc::new(Field::new(
            STEPS,
            list_like(field.data_type(), of(all)),
            field.is_nullable(),
        )),
        _ => field.clone(),
    };
    Arc::new(Schema::new(
        schema.fields().iter().map(change).collect::<Fields>(),
    ))
}

fn list_like(list: &DataType, kept: Fields) -> DataType {
    match list {
        DataType::List(item) => DataType::List(Arc::new(
            item.as_ref().clone().with_data_type(DataType::Struct(kept)),
        )),
        other => other.clone(),
    }
}

fn step_struct(data_type: &DataType) -> Option<&Fields> {
    match data_type {
        DataType::List(item) => match item.data_type() {
            DataType::Struct(fields) => Some(fields),
            _ => None,
        },
        _ => None,
    }
}

/// A plan in which a table without a file is an empty relation: the optimizer does away with it, and
/// with what is joined with it. A union stays as it is: its columns have the names of its first part,
/// and the optimizer loses them with that part.
pub(crate) fn without_empty_tables(plan: LogicalPlan) -> Result<LogicalPlan> {
    if has_node(&plan, |node| matches!(node, LogicalPlan::Union(_)))? {
        return Ok(plan);
    }
    let emptied = plan.transform_up_with_subqueries(|node| match &node {
        LogicalPlan::TableScan(scan) if source_as_provider(&scan.source)?.is::<EmptyTable>() => Ok(
            Transformed::yes(LogicalPlan::EmptyRelation(EmptyRelation {
                produce_one_row: false,
                schema: scan.projected_schema.clone(),
            })),
        ),
        _ => Ok(Transformed::no(node)),
    });
    Ok(emptied?.data)
}

/// Which fields of the steps an optimized plan reads.
pub(crate) fn step_fields(plan: &LogicalPlan) -> Result<StepFields> {
    let schema = Table::Episodes.schema();
    let list = schema.field_with_name(STEPS)?.data_type().clone();
    let Some(fields) = step_struct(&list) else {
        return Ok(StepFields::All);
    };
    let mut reader = Reader {
        step: DataType::Struct(fields.clone()),
        list,
        names: BTreeMap::new(),
    };
    if reader.holds_steps(plan.schema()) {
        return Ok(StepFields::All);
    }
    let mut all = false;
    plan.apply_with_subqueries(|node| {
        all = all || reader.node(node)?.is_break();
        Ok(if all {
            TreeNodeRecursion::Stop
        } else {
            TreeNodeRecursion::Continue
        })
    })?;
    Ok(if all {
        StepFields::All
    } else {
        StepFields::Some(reader.names)
    })
}

/// Whether a table of an optimized plan reads the steps at all.
pub(crate) fn reads_steps(plan: &LogicalPlan) -> Result<bool> {
    has_node(plan, |node| match node {
        LogicalPlan::TableScan(scan) => scan
            .projected_schema
            .has_column_with_unqualified_name(STEPS),
        _ => false,
    })
}

/// Whether a plan asks which tables and columns there are.
pub(crate) fn asks_schema(plan: &LogicalPlan) -> Result<bool> {
    has_node(plan, |node| match node {
        LogicalPlan::DescribeTable(_) => true,
        LogicalPlan::TableScan(scan) => scan.table_name.schema() == Some(INFORMATION_SCHEMA),
        _ => false,
    })
}

/// Whether a plan or a subquery in it has such a node.
pub(crate) fn has_node(plan: &LogicalPlan, is: impl Fn(&LogicalPlan) -> bool) -> Result<bool> {
    let mut found = false;
    plan.apply_with_subqueries(|node| {
        found = found || is(node);
        Ok(if found {
            TreeNodeRecursion::Stop
        } else {
            TreeNodeRecursion::Continue
        })
    })?;
    Ok(found)
}

struct Reader {
    list: DataType,
    step: DataType,
    names: BTreeMap<String, ReadAs>,
}

/// Break: something reads the steps in a way that is not understood.
type Understood = ControlFlow<()>;

impl Reader {
    fn node(&mut self, node: &LogicalPlan) -> Result<Understood> {
        let passes = matches!(
            node,
            LogicalPlan::Projection(_)
                | LogicalPlan::Filter(_)
                | LogicalPlan::SubqueryAlias(_)
                | LogicalPlan::TableScan(_)
                | LogicalPlan::Unnest(_)
                | LogicalPlan::Limit(_)
                | LogicalPlan::Union(_)
                | LogicalPlan::Join(_)
                | LogicalPlan::Sort(_)
                | LogicalPlan::Aggregate(_)
                | LogicalPlan::Window(_)
                | LogicalPlan::Explain(_)
                | LogicalPlan::Analyze(_)
        );
        let inputs = node.inputs();
        if !passes && inputs.iter().any(|input| self.holds_steps(input.schema())) {
            return Ok(Understood::Break(()));
        }
        // what a scan filters with are expressions over its own columns
        let mut schema = DFSchema::empty();
        for input in &inputs {
            schema = schema.join(input.schema()).unwrap_or(schema);
        }
        if let LogicalPlan::TableScan(scan) = node {
            schema = scan.projected_schema.as_ref().clone();
            let full = DFSchema::try_from_qualified_schema(
                scan.table_name.clone(),
                &scan.source.schema(),
            )?;
            schema.merge(&full);
        }
        // a projection hands columns on; elsewhere the steps themselves are no key and no condition
        let hands_on = matches!(
            node,
            LogicalPlan::Projection(_) | LogicalPlan::Unnest(_) | LogicalPlan::TableScan(_)
        );
        for expression in node.expressions() {
            if self.expression(&expression, &schema, hands_on)?.is_break() {
                return Ok(Understood::Break(()));
            }
        }
        Ok(Understood::Continue(()))
    }

    /// `hands_on`: whether the value itself may be steps.
    fn expression(
        &mut self,
        expression: &Expr,
        schema: &DFSchema,
        hands_on: bool,
    ) -> Result<Understood> {
        let is_steps = self.is_steps(expression, schema);
        match expression {
            Expr::Column(_) => {
                return Ok(if is_steps && !hands_on {
                    Understood::Break(())
                } else {
                    Understood::Continue(())
                });
            }
            Expr::Alias(alias) => return self.expression(&alias.expr, schema, hands_on),
            Expr::ScalarFunction(call) => {
                let taken = call
                    .args
                    .first()
                    .is_some_and(|first| self.is_steps(first, schema));
                if taken {
                    // a step or some steps themselves are no key and no condition
                    if is_steps && !hands_on {
                        return Ok(Understood::Break(()));
                    }
                    let Some((names, form)) = self.taken(call.name(), &call.args) else {
                        return Ok(Understood::Break(()));
                    };
                    for name in names {
                        let known = self.names.entry(name).or_insert(form);
                        *known = form.max(*known);
                    }
                    let rest = &call.args[1..];
                    if self.expression(&call.args[0], schema, true)?.is_break() {
                        return Ok(Understood::Break(()));
                    }
                    for argument in rest {
                        if self.expression(argument, schema, false)?.is_break() {
                            return Ok(Understood::Break(()));
                        }
                    }
                    return Ok(Understood::Continue(()));
                }
            }
            _ => {}
        }
        if is_steps && !hands_on {
            return Ok(Understood::Break(()));
        }
        let mut understood = Understood::Continue(());
        expression.apply_children(|child| {
            understood = self.expression(child, schema, matches!(expression, Expr::Unnest(_)))?;
            Ok(if understood.is_break() {
                TreeNodeRecursion::Stop
            } else {
                TreeNodeRecursion::Continue
            })
        })?;
        Ok(understood)
    }

    /// Fields that a function reads whose first argument are steps or a step, and in what form
    /// it can take them.
    fn taken(&self, name: &str, arguments: &[Expr]) -> Option<(BTreeSet<String>, ReadAs)> {
        match name {
            "get_field" => match arguments.get(1)? {
                Expr::Literal(value, _) => Some((
                    BTreeSet::from([value.try_as_str().flatten()?.to_owned()]),
                    ReadAs::Values,
                )),
                _ => None,
            },
            "array_length" | "cardinality" | "array_element" | "array_slice"
            | "array_pop_front" | "array_pop_back" => Some((BTreeSet::new(), ReadAs::Values)),
            _ => Some((sequence::needs(name, arguments)?, ReadAs::Codes)),
        }
    }

    fn is_steps(&self, expression: &Expr, schema: &DFSchema) -> bool {
        expression
            .get_type(schema)
            .is_ok_and(|found| found == self.list || found == self.step)
    }

    fn holds_steps(&self, schema: &DFSchema) -> bool {
        schema
            .fields()
            .iter()
            .any(|field| self.within(field.data_type()))
    }

    fn within(&self, data_type: &DataType) -> bool {
        *data_type == self.list
            || *data_type == self.step
            || match data_type {
                DataType::List(item) => self.within(item.data_type()),
                DataType::Struct(fields) => {
                    fields.iter().any(|field| self.within(field.data_type()))
                }
                _ => false,
            }
    }
}
