//! What prims are called: their semantic labels, and whether they are models of their own.

use reel_tasks::assets::usd::{Prim, values::token};

/// What a prim is labelled as: `semantics:labels:*` of UsdSemantics, or `semanticData` of Isaac Sim
/// for the type `class`.
pub(super) fn label(prim: &Prim) -> Option<String> {
    let names = prim.property_names().ok()?;
    let mut named = names.iter().map(|name| name.as_str());
    let found = named.find(|name| {
        name.starts_with("semantics:labels:")
            || (name.starts_with("semantic:") && name.ends_with(":params:semanticData"))
    })?;
    token(prim, found).filter(|label| !label.is_empty())
}

/// Whether a prim is a model of its own.
pub(super) fn is_model(prim: &Prim, name: &str) -> bool {
    let kind = prim.kind().ok().flatten();
    kind.is_some_and(|kind| kind.as_str() == "component")
        || prim.has_composition_arc().unwrap_or(false)
        || name.starts_with("model_")
}
