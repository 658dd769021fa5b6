//! World graphs as the trainer gets them, and which of them it refuses. Never names a category.

use serde_json::Value;

/// By how many objects a graph may grow or shrink in one call.
pub const OBJECT_DRIFT_MAX: usize = 3;

/// A name longer than this that looks like an asset's digest is an object that was not translated.
const NAME_LENGTH_MAX: usize = 30;

/// Receptacles in the order of the payload, with the names of what they hold.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Graph(pub Vec<(String, Vec<String>)>);

/// What of a graph decides whether the trainer takes it.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct GraphSize {
    /// Whether it has no receptacle.
    pub is_empty: bool,
    /// How many objects it holds.
    pub objects: usize,
    /// How many of them have unknown names ([`is_unknown`]).
    pub unknown: usize,
}

/// Why the trainer keeps the graph that it had.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum GraphRejection {
    /// A name could not be translated.
    UnknownObjects,
    /// Too many objects came or went at once.
    Drift,
}

impl GraphRejection {
    /// The reason as the published trainer writes it in its log.
    pub fn as_str(self) -> &'static str {
        match self {
            GraphRejection::UnknownObjects => "unknown_objects",
            GraphRejection::Drift => "drift",
        }
    }
}

/// Whether a translated name still looks like an instance's or an asset's.
pub fn is_unknown(name: &str) -> bool {
    let is_digest = |name: &str| {
        name.chars()
            .all(|letter| matches!(letter, '0'..='9' | 'a'..='f' | '_' | '-'))
    };
    (name.contains("_on_") && name.contains("_at_"))
        || (name.chars().count() > NAME_LENGTH_MAX && is_digest(name))
}

/// Why a graph is refused after a call; `None` if it replaces the old one.
pub fn graph_rejection(old: &GraphSize, new: &GraphSize) -> Option<GraphRejection> {
    match () {
        () if old.is_empty => None,
        () if new.unknown > 0 => Some(GraphRejection::UnknownObjects),
        () if new.objects.abs_diff(old.objects) > OBJECT_DRIFT_MAX => Some(GraphRejection::Drift),
        () => None,
    }
}

impl Graph {
    /// From JSON: `{receptacle: {content: [name]}}`. A receptacle without content is empty; entries
    /// that are no text are left out.
    pub fn of_json(graph: &Value) -> Self {
        let names = |state: &Value| -> Vec<String> {
            let content = state
                .get("content")
                .and_then(Value::as_array)
                .into_iter()
                .flatten();
            content
                .filter_map(|name| name.as_str().map(str::to_owned))
                .collect()
        };
        Self(
            graph
                .as_object()
                .into_iter()
                .flatten()
                .map(|(receptacle, state)| (receptacle.clone(), names(state)))
                .collect(),
        )
    }

    /// Lays the lines of a graph as text (`receptacle: ['name', ...]`) over this one. The text has
    /// no empty receptacles, so that one that ran empty keeps what it held.
    pub fn overlay_text(&mut self, text: &str) {
        for line in text.lines() {
            let Some((receptacle, list)) = line.split_once(": [") else {
                continue;
            };
            let list = list.trim_end().trim_end_matches(']');
            let names: Vec<String> = list
                .split(", ")
                .map(|name| name.trim_matches(['\'', '"']).to_owned())
                .filter(|name| !name.is_empty())
                .collect();
            match self.0.iter_mut().find(|(known, _)| known == receptacle) {
                Some((_, content)) => *content = names,
                None => self.0.push((receptacle.to_owned(), names)),
            }
        }
    }

    /// Its names with their receptacles.
    pub fn objects(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0.iter().flat_map(|(receptacle, names)| {
            names
                .iter()
                .map(move |name| (name.as_str(), receptacle.as_str()))
        })
    }

    /// What decides whether it is taken.
    pub fn size(&self) -> GraphSize {
        GraphSize {
            is_empty: self.0.is_empty(),
            objects: self.objects().count(),
            unknown: self.objects().filter(|(name, _)| is_unknown(name)).count(),
        }
    }
}
