//! The tool names a pattern may use, and the nearest name to one that it may not.

/// The paper's names, as the column `tool` holds them, and the published repository's name
/// for the same tool.
pub(crate) const TOOLS: &[(&str, &str)] = &[
    ("nav_to", "navigate_to"),
    ("walk_around", "explore_receptacle"),
    ("show_object_by_category", "find_objects"),
    ("show_receptacles", "highlight_receptacles"),
    ("gaze_at", "focus_on"),
    ("pick", "pick"),
    ("place", "place"),
    ("open", "open"),
    ("close", "close"),
    ("ask", "ask"),
    ("finish", "finish"),
    ("list_receptacles", "list_receptacles"),
    ("list_tasks", "list_tasks"),
    ("finish_with_id", "finish_with_id"),
];

/// Whether this is one of the paper's names.
pub(crate) fn is_tool(name: &str) -> bool {
    TOOLS.iter().any(|(paper, _)| *paper == name)
}

/// What was probably meant: the paper's name for the repository's, or else the nearest name that
/// is not too far.
pub(crate) fn nearest_tool(name: &str) -> Option<&'static str> {
    let alias = TOOLS
        .iter()
        .find(|(_, repository)| *repository == name)
        .map(|(paper, _)| *paper);
    alias.or_else(|| nearest(name, TOOLS.iter().map(|(paper, _)| *paper)))
}

/// The nearest of `names`, unless more than a third of its letters differ.
pub(crate) fn nearest<'a>(name: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let (distance, best) = names
        .map(|known| (strsim::osa_distance(name, known), known))
        .min()?;
    (distance <= best.len().div_ceil(3)).then_some(best)
}

#[cfg(test)]
mod tests {
    use reel_world::ToolSpec;

    use super::*;

    #[test]
    fn the_names_are_those_of_the_world() {
        let specs: Vec<_> = ToolSpec::POLICY
            .iter()
            .map(|spec| (spec.paper_name, spec.repo_name))
            .collect();
        assert_eq!(TOOLS[..specs.len()], specs);
        assert_eq!(TOOLS.len(), specs.len() + 3, "and three lifecycle tools");
    }

    #[test]
    fn hints_are_near_or_absent() {
        assert_eq!(nearest_tool("pik"), Some("pick"));
        assert_eq!(nearest_tool("navigate_to"), Some("nav_to"));
        assert_eq!(nearest_tool("gazeat"), Some("gaze_at"));
        assert_eq!(nearest_tool("teleport"), None);
    }
}
