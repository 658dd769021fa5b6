//! A node with its path in the document, read with errors that name both line and path.

use reel_world::{ReceptacleId, Scene};
use serde_json::{Map, Value};

use crate::{
    document::{Content, Node},
    error::Problem,
};

/// A place in a document.
#[derive(Clone, Debug)]
pub(crate) struct Field<'a> {
    node: &'a Node,
    path: String,
}

impl<'a> Field<'a> {
    /// The root of the document, whose path is empty.
    pub fn root(node: &'a Node) -> Self {
        Self {
            node,
            path: String::new(),
        }
    }

    /// Where it is, e.g. `episodes[0].dest`.
    pub fn path(&self) -> &str {
        &self.path
    }

    /// The line it starts at, from 1.
    pub fn line(&self) -> usize {
        self.node.line
    }

    /// Reports a problem at the path and line of this field.
    pub fn problem(&self, problem: impl Into<String>) -> Problem {
        let field = if self.path.is_empty() {
            "the document".to_owned()
        } else {
            self.path.clone()
        };
        Problem {
            line: self.node.line,
            field,
            problem: problem.into(),
        }
    }

    /// A field that must be there.
    pub fn get(&self, key: &str) -> Result<Field<'a>, Problem> {
        self.find(key)?.ok_or_else(|| self.missing(key))
    }

    /// That a field is missing here.
    pub fn missing(&self, key: &str) -> Problem {
        Problem {
            line: self.node.line,
            field: self.child_path(key),
            problem: "missing".to_owned(),
        }
    }

    /// A field that may be absent or null.
    pub fn find(&self, key: &str) -> Result<Option<Field<'a>>, Problem> {
        Ok(self
            .find_or_null(key)?
            .filter(|field| field.node.content != Content::Null))
    }

    /// A field that may be absent, but not null where a value of its kind is read from it.
    pub fn find_or_null(&self, key: &str) -> Result<Option<Field<'a>>, Problem> {
        let Content::Map(entries) = &self.node.content else {
            return Err(self.expected("a mapping"));
        };
        Ok(entries.get(key).map(|node| Field {
            node,
            path: self.child_path(key),
        }))
    }

    /// The entries of a mapping, sorted by key.
    pub fn entries(&self) -> Result<Vec<(&'a str, Field<'a>)>, Problem> {
        let mut entries = self.entries_as_written()?;
        entries.sort_by_key(|(key, _)| *key);
        Ok(entries)
    }

    /// The entries of a mapping, in the order of the file.
    pub fn entries_as_written(&self) -> Result<Vec<(&'a str, Field<'a>)>, Problem> {
        let Content::Map(entries) = &self.node.content else {
            return Err(self.expected("a mapping"));
        };
        Ok(entries
            .iter()
            .map(|(key, node)| {
                (
                    key.as_str(),
                    Field {
                        node,
                        path: self.child_path(key),
                    },
                )
            })
            .collect())
    }

    /// The items of a list.
    pub fn items(&self) -> Result<Vec<Field<'a>>, Problem> {
        let Content::List(items) = &self.node.content else {
            return Err(self.expected("a list"));
        };
        Ok(items
            .iter()
            .enumerate()
            .map(|(index, node)| Field {
                node,
                path: format!("{}[{index}]", self.path),
            })
            .collect())
    }

    /// The id of a receptacle of the scene.
    pub fn receptacle(&self, scene: &Scene) -> Result<ReceptacleId, Problem> {
        let id = ReceptacleId::from(self.text()?);
        if scene.receptacle(&id).is_none() {
            return Err(self.problem(format!("{id} is not a receptacle of the scene")));
        }
        Ok(id)
    }

    /// The ids in a list of receptacles of the scene; empty if the list is absent.
    pub fn receptacles(&self, key: &str, scene: &Scene) -> Result<Vec<ReceptacleId>, Problem> {
        let list = self
            .find(key)?
            .map_or(Ok(Vec::new()), |list| list.items())?;
        list.iter().map(|item| item.receptacle(scene)).collect()
    }

    /// Text that is not empty.
    pub fn text(&self) -> Result<&'a str, Problem> {
        match &self.node.content {
            Content::Text(text) if text.trim().is_empty() => Err(self.problem("empty")),
            Content::Text(text) => Ok(text),
            _ => Err(self.expected("text")),
        }
    }

    /// Text that may be empty.
    pub fn any_text(&self) -> Result<&'a str, Problem> {
        if let Content::Text(text) = &self.node.content {
            Ok(text)
        } else {
            Err(self.expected("text"))
        }
    }

    /// Reads the value as a whole number.
    pub fn integer(&self) -> Result<i64, Problem> {
        if let Content::Integer(value) = self.node.content {
            Ok(value)
        } else {
            Err(self.expected("a whole number"))
        }
    }

    /// Reads the value as a finite number, whole or not.
    pub fn number(&self) -> Result<f64, Problem> {
        match self.node.content {
            #[expect(clippy::cast_precision_loss, reason = "lengths in metres are small")]
            Content::Integer(value) => Ok(value as f64),
            Content::Float(value) => Ok(value),
            _ => Err(self.expected("a number")),
        }
    }

    /// Reads the value as a list of exactly three finite numbers.
    pub fn vector(&self) -> Result<[f64; 3], Problem> {
        let numbers: Vec<f64> = self
            .items()?
            .iter()
            .map(Field::number)
            .collect::<Result<_, _>>()?;
        <[f64; 3]>::try_from(numbers)
            .map_err(|numbers| self.problem(format!("expected 3 numbers, found {}", numbers.len())))
    }

    /// Whether it is true or false, if it is either.
    pub fn boolean(&self) -> Option<bool> {
        if let Content::Bool(value) = self.node.content {
            Some(value)
        } else {
            None
        }
    }

    /// The subtree as JSON.
    pub fn json(&self) -> Value {
        json(self.node)
    }

    fn expected(&self, kind: &str) -> Problem {
        self.problem(format!(
            "expected {kind}, found {}",
            self.node.content.kind()
        ))
    }

    fn child_path(&self, key: &str) -> String {
        if self.path.is_empty() {
            key.to_owned()
        } else {
            format!("{}.{key}", self.path)
        }
    }
}

fn json(node: &Node) -> Value {
    match &node.content {
        Content::Null => Value::Null,
        Content::Bool(value) => Value::from(*value),
        Content::Integer(value) => Value::from(*value),
        Content::Float(value) => Value::from(*value),
        Content::Text(text) => Value::from(text.as_str()),
        Content::List(items) => Value::Array(items.iter().map(json).collect()),
        Content::Map(entries) => {
            // In the order of the file.
            Value::Object(
                entries
                    .iter()
                    .map(|(key, node)| (key.clone(), json(node)))
                    .collect::<Map<_, _>>(),
            )
        }
    }
}
