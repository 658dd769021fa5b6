//! From SQL text to a bound plan: dotted names become field access, parameters become values.

use std::{
    collections::{BTreeMap, BTreeSet},
    ops::ControlFlow,
};

use arrow::datatypes::DataType;
use datafusion::{
    common::{
        ParamValues,
        tree_node::{TreeNode as _, TreeNodeRecursion},
    },
    error::DataFusionError,
    logical_expr::{Expr, LogicalPlan, expr::Placeholder},
    prelude::SessionContext,
    scalar::ScalarValue,
    sql::{parser::Statement, sqlparser::ast},
};

use super::{Parameters, QueryError};
use crate::tables::plain;

/// Plans one statement. Fields are taken with a dot from anything, not
/// from columns alone: `replay(trace).verdict`.
pub(super) async fn plan_of(
    context: &SessionContext,
    sql: &str,
) -> Result<LogicalPlan, DataFusionError> {
    let state = context.state();
    let dialect = state.config().options().sql_parser.dialect;
    let mut statement = state.sql_to_statement(sql, &dialect)?;
    fields_by_dot(&mut statement);
    state.statement_to_plan(statement).await
}

pub(super) fn fields_by_dot(statement: &mut Statement) {
    match statement {
        Statement::Explain(explain) => fields_by_dot(&mut explain.statement),
        Statement::Statement(statement) => {
            let _ = ast::visit_expressions_mut(statement.as_mut(), |expression| {
                if let ast::Expr::CompoundFieldAccess { root, access_chain } = expression {
                    join_names(root, access_chain);
                    access_chain.iter_mut().for_each(dot_to_subscript);
                }
                ControlFlow::<()>::Continue(())
            });
        }
        _ => {}
    }
}

/// `a.steps[1]`: the names before the first bracket are one name, of a column of a table or of a
/// field of a column.
pub(super) fn join_names(root: &mut ast::Expr, chain: &mut Vec<ast::AccessExpr>) {
    let mut names = match root {
        ast::Expr::Identifier(name) => vec![name.clone()],
        ast::Expr::CompoundIdentifier(names) => names.clone(),
        _ => return,
    };
    while let Some(ast::AccessExpr::Dot(ast::Expr::Identifier(name))) = chain.first() {
        names.push(name.clone());
        chain.remove(0);
    }
    if names.len() > 1 {
        *root = ast::Expr::CompoundIdentifier(names);
    }
}

pub(super) fn dot_to_subscript(access: &mut ast::AccessExpr) {
    if let ast::AccessExpr::Dot(ast::Expr::Identifier(name)) = access {
        let index = ast::Expr::Value(ast::Value::SingleQuotedString(name.value.clone()).into());
        *access = ast::AccessExpr::Subscript(ast::Subscript::Index { index });
    }
}

/// Puts values in the place of `$parameters`, of the types that the query asks for.
pub(super) fn bind(plan: LogicalPlan, parameters: &Parameters) -> Result<LogicalPlan, QueryError> {
    let wanted: BTreeSet<String> = plan
        .get_parameter_names()?
        .iter()
        .map(|name| name.trim_start_matches('$').to_owned())
        .collect();
    let listed = |names: &BTreeSet<String>| {
        names
            .iter()
            .map(|name| format!("${name}"))
            .collect::<Vec<_>>()
            .join(", ")
    };
    let missing: BTreeSet<String> = wanted
        .iter()
        .filter(|name| !parameters.contains_key(*name))
        .cloned()
        .collect();
    if !missing.is_empty() {
        return Err(QueryError::Parameter(format!(
            "the query needs values for its parameters {}",
            listed(&missing)
        )));
    }
    if let Some(unknown) = parameters.keys().find(|name| !wanted.contains(*name)) {
        let known = if wanted.is_empty() {
            "it has none".to_owned()
        } else {
            format!("it has {}", listed(&wanted))
        };
        return Err(QueryError::Parameter(format!(
            "the query has no parameter ${unknown}; {known}"
        )));
    }
    if wanted.is_empty() {
        return Ok(plan);
    }
    let types = parameter_types(&plan)?;
    let value = |name: &String, text: &String| match types.get(&format!("${name}")).cloned() {
        Some(DataType::Utf8) => Ok(ScalarValue::from(text.as_str())),
        Some(data_type) => ScalarValue::try_from_string(text.clone(), &data_type).map_err(|_| {
            QueryError::Parameter(format!(
                "${name} must be of type {data_type}, found '{text}'"
            ))
        }),
        // nothing says what it must be: a number where it looks exactly like one
        None => Ok(match text.parse::<i64>() {
            Ok(number) if number.to_string() == *text => ScalarValue::from(number),
            _ => text
                .parse::<f64>()
                .ok()
                .filter(|number| number.to_string() == *text)
                .map_or_else(|| ScalarValue::from(text.as_str()), ScalarValue::from),
        }),
    };
    let values = parameters
        .iter()
        .map(|(name, text)| Ok((name.clone(), value(name, text)?)));
    let values: Vec<(String, ScalarValue)> = values.collect::<Result<_, QueryError>>()?;
    Ok(plan.with_param_values(ParamValues::from(values))?)
}

/// What each parameter has to be, by its name with `$`, where something says so. Texts are one type,
/// in whatever form they are read.
fn parameter_types(plan: &LogicalPlan) -> Result<BTreeMap<String, DataType>, QueryError> {
    let mut types: BTreeMap<String, DataType> = BTreeMap::new();
    let mut conflict = None;
    plan.apply_with_subqueries(|node| {
        node.apply_expressions(|expression| {
            expression.apply(|part| {
                if let Expr::Placeholder(Placeholder {
                    id,
                    field: Some(field),
                }) = part
                {
                    let wanted = plain(field.data_type());
                    let known = types.entry(id.clone()).or_insert_with(|| wanted.clone());
                    if *known != wanted {
                        conflict = Some(format!("{id} would be both {known} and {wanted}"));
                    }
                }
                Ok(TreeNodeRecursion::Continue)
            })
        })
    })?;
    conflict.map_or(Ok(types), |conflict| Err(QueryError::Parameter(conflict)))
}
