//! Names of objects as categories, as the trainer translates them. Owns the mapping
//! from assets to categories.

use std::borrow::Cow;

use reel_world::Task;
use serde_json::Value;

/// Categories by asset, in the order in which the trainer looks them up.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Categories(Vec<(String, String)>);

impl Categories {
    /// From the payload of `finish_with_id`: `target_object`, then `distractor_metadata`. Entries
    /// without a category are left out.
    pub fn of_payload(payload: &Value) -> Self {
        let text = |value: &Value, key: &str| {
            value
                .get(key)
                .and_then(Value::as_str)
                .unwrap_or_default()
                .to_owned()
        };
        let target = &payload["target_object"];
        let distractors = payload["distractor_metadata"]
            .as_object()
            .into_iter()
            .flatten();
        Self::new(
            &text(target, "id"),
            &text(target, "category"),
            distractors.map(|(asset, meta)| (asset, text(meta, "category"))),
        )
    }

    /// From a task, whose payload names every asset.
    pub fn of_task(task: &Task) -> Self {
        let (id, category) = task.object(&task.target).map_or(("", ""), |target| {
            (target.asset.as_str(), target.category.as_str())
        });
        Self::new(
            id,
            category,
            task.objects
                .iter()
                .map(|object| (object.asset.as_str(), object.category.clone())),
        )
    }

    fn new<A: AsRef<str>>(
        target: &str,
        category: &str,
        others: impl Iterator<Item = (A, String)>,
    ) -> Self {
        let mut categories = Self::default();
        if !target.is_empty() {
            categories.set(target, category);
            categories.set(&format!("_{target}"), category);
        }
        for (asset, category) in others {
            let asset = asset.as_ref();
            categories.set(asset, &category);
            if let Some(bare) = asset.strip_prefix('_') {
                categories.set(bare, &category);
            }
        }
        categories
    }

    fn set(&mut self, asset: &str, category: &str) {
        if category.is_empty() {
            return;
        }
        match self.0.iter_mut().find(|(known, _)| known == asset) {
            Some((_, known)) => category.clone_into(known),
            None => self.0.push((asset.to_owned(), category.to_owned())),
        }
    }

    /// Assets with their categories, in the order of look-up.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        self.0
            .iter()
            .map(|(asset, category)| (asset.as_str(), category.as_str()))
    }

    /// The category of an object of a graph: that of its asset, else of the first asset that begins
    /// the name or that the name begins. A name without any stays as it is.
    pub fn convert<'a>(&'a self, name: &'a str) -> &'a str {
        let asset = asset(name);
        let alike = || {
            self.iter()
                .find(|(known, _)| asset.starts_with(known) || known.starts_with(asset))
        };
        self.of_asset(asset)
            .or_else(|| alike().map(|(_, category)| category))
            .unwrap_or(name)
    }

    /// The category of what the gripper holds: that of its asset, else the name as it is.
    pub fn of_held<'a>(&'a self, name: &'a str) -> &'a str {
        self.of_asset(asset(name)).unwrap_or(name)
    }

    fn of_asset(&self, asset: &str) -> Option<&str> {
        self.iter()
            .find_map(|(known, category)| (known == asset).then_some(category))
    }

    /// A graph as JSON with categories for names. What is no receptacle stays as it is.
    pub fn convert_json(&self, graph: &Value) -> Value {
        let mut converted = graph.clone();
        for state in converted
            .as_object_mut()
            .into_iter()
            .flat_map(|graph| graph.values_mut())
        {
            let Some(state) = state.as_object_mut() else {
                continue;
            };
            let names = state
                .get("content")
                .and_then(Value::as_array)
                .map(Vec::as_slice)
                .unwrap_or_default();
            let name = |value: &Value| {
                value
                    .as_str()
                    .map_or_else(|| value.clone(), |name| self.convert(name).into())
            };
            let content = names.iter().map(name).collect();
            state.insert("content".to_owned(), Value::Array(content));
        }
        converted
    }
}

/// The part of a runtime name before the first `_on_`; a name without `_on_` and `_at_` is an
/// asset or a category.
fn asset(name: &str) -> &str {
    let runtime = name
        .contains("_at_")
        .then(|| name.split_once("_on_"))
        .flatten();
    runtime.map_or(name, |(asset, _)| asset)
}

/// A text as the trainer compares it.
pub(crate) fn lower(text: &str) -> Cow<'_, str> {
    if text
        .bytes()
        .any(|byte| byte.is_ascii_uppercase() || !byte.is_ascii())
    {
        text.to_lowercase().into()
    } else {
        text.into()
    }
}
