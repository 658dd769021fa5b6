//! SQL functions of our own. Each file holds a family: what they are called, what they take and
//! give, and an example that the tests run. Nothing here plans or runs a query.

pub mod blame;
mod conditions;
pub mod gspo;
mod parts;
pub mod sequence;
pub mod simulator;
pub mod statistics;

use datafusion::logical_expr::ScalarUDF;

pub(crate) use parts::part_of;

use crate::control::Control;

/// What a function is for, for people: `reel query --functions`.
#[derive(Clone, Copy, Debug)]
pub struct FunctionHelp {
    /// How it is called.
    pub call: &'static str,
    /// What the function returns, as `reel query --functions` prints it.
    pub meaning: &'static str,
    /// SQL that works on every store.
    pub example: &'static str,
}

/// Every function, in the order of the documents.
pub fn help() -> impl Iterator<Item = FunctionHelp> {
    sequence::HELP
        .iter()
        .chain(statistics::HELP)
        .chain(gspo::HELP)
        .chain(simulator::HELP)
        .chain([&blame::HELP])
        .copied()
}

/// Whether a function opens traces.
pub(crate) fn opens_traces(name: &str) -> bool {
    simulator::NAMES.contains(&name) || name == blame::NAME
}

/// Every function, for a session.
pub(crate) fn all(control: &std::sync::Arc<Control>) -> Vec<ScalarUDF> {
    sequence::functions()
        .into_iter()
        .chain(statistics::functions())
        .chain(gspo::functions())
        .chain(simulator::functions(control))
        .chain([blame::function(control), parts::function()])
        .collect()
}
