//! What mapping files have in common: which tools of another world are which of the eleven, and
//! mistakes that are named with line and column. Never opens a file: texts come.

use std::{borrow::Cow, collections::BTreeMap, ops::Range};

use reel_world::{ToolCall, ToolSpec};
use serde_json::Value;
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

/// What is wrong with a mapping file.
#[derive(Clone, PartialEq, Eq, Debug, thiserror::Error)]
#[error("line {line}, column {column}: {problem}")]
pub struct MappingError {
    /// Line of the mistake in the mapping file, from 1.
    pub line: usize,
    /// From 1, in characters.
    pub column: usize,
    /// What is wrong, and what could stand there.
    pub problem: String,
}

/// An argument of `ask` beside the one that the paper gives it.
const MORE_OF_ASK: [&str; 2] = ["target_category", "target_description"];

/// Tools of another world, and which of the eleven they are: the tables `[tools.<name>]`.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub struct Tools(BTreeMap<String, Mapped>);

#[derive(Clone, PartialEq, Eq, Debug)]
struct Mapped {
    is: &'static str,
    /// Our argument and the one there.
    arguments: Vec<(String, String)>,
}

impl Tools {
    /// Reads the table `tools`.
    ///
    /// # Errors
    /// With line and column, what means nothing.
    pub fn parse(
        file: &MappingFile<'_>,
        value: &Spanned<DeValue<'_>>,
    ) -> Result<Self, MappingError> {
        let tools = file.table(value, "tools")?;
        let tool = |(name, tool): (&Spanned<Cow<'_, str>>, _)| {
            Ok((name.get_ref().to_string(), file.tool(name.get_ref(), tool)?))
        };
        Ok(Self(
            tools
                .into_iter()
                .map(tool)
                .collect::<Result<_, MappingError>>()?,
        ))
    }

    /// The call as one of the eleven; none where the file does not name the tool.
    pub fn call(&self, call: &ToolCall) -> Option<ToolCall> {
        let mapped = self.0.get(&call.name)?;
        let mut arguments = call.arguments.as_object().cloned().unwrap_or_default();
        for (ours, theirs) in &mapped.arguments {
            if let Some(value) = arguments.shift_remove(theirs) {
                arguments.insert(ours.clone(), value);
            }
        }
        Some(ToolCall::new(mapped.is, Value::Object(arguments)))
    }

    /// The paper's name of a tool there; none where the file does not name it.
    pub fn name(&self, name: &str) -> Option<&'static str> {
        self.0.get(name).map(|mapped| mapped.is)
    }
}

/// A text whose errors have lines.
#[derive(Clone, Copy, Debug)]
pub struct MappingFile<'a> {
    text: &'a str,
}

/// The entries of a table.
pub type Entries<'t, 'i> = Vec<(&'t Spanned<Cow<'i, str>>, &'t Spanned<DeValue<'i>>)>;

impl<'a> MappingFile<'a> {
    /// The keys of the file, and what helps to read them.
    ///
    /// # Errors
    /// With line and column, what is no TOML.
    pub fn parse(text: &'a str) -> Result<(Self, DeTable<'a>), MappingError> {
        let file = Self { text };
        let table = DeTable::parse(text)
            .map_err(|error| file.error(error.span(), error.message().replace('\n', "; ")))?;
        Ok((file, table.into_inner()))
    }

    /// A mistake, and where it is; without a place, at the end of the text.
    pub fn error(&self, span: Option<Range<usize>>, what: String) -> MappingError {
        let before = span
            .and_then(|span| self.text.get(..span.start))
            .unwrap_or(self.text);
        let line = before.rsplit('\n').next().unwrap_or_default();
        MappingError {
            line: before.matches('\n').count() + 1,
            column: line.chars().count() + 1,
            problem: what,
        }
    }

    /// A value that must be a table.
    ///
    /// # Errors
    /// When it is none.
    pub fn table<'t, 'i>(
        &self,
        value: &'t Spanned<DeValue<'i>>,
        name: &str,
    ) -> Result<Entries<'t, 'i>, MappingError> {
        let table = value
            .get_ref()
            .as_table()
            .ok_or_else(|| self.error(Some(value.span()), format!("{name} must be a table")))?;
        Ok(table.iter().collect())
    }

    /// A value that must be a text.
    ///
    /// # Errors
    /// When it is none.
    pub fn text_of(
        &self,
        value: &Spanned<DeValue<'_>>,
        expected: &str,
    ) -> Result<String, MappingError> {
        let text = value.get_ref().as_str().map(str::to_owned);
        text.ok_or_else(|| self.error(Some(value.span()), format!("expected {expected}")))
    }

    /// A value that must be a JSON pointer.
    ///
    /// # Errors
    /// When it is none.
    pub fn pointer_of(&self, value: &Spanned<DeValue<'_>>) -> Result<String, MappingError> {
        let pointer = self.text_of(value, "a JSON pointer in quotes, e.g. \"/robot/holds\"")?;
        if !pointer.is_empty() && !pointer.starts_with('/') {
            return Err(self.error(
                Some(value.span()),
                format!("'{pointer}' is not a JSON pointer; begin it with '/'"),
            ));
        }
        Ok(pointer)
    }

    fn tool(&self, name: &str, value: &Spanned<DeValue<'_>>) -> Result<Mapped, MappingError> {
        let mut spec: Option<&ToolSpec> = None;
        let mut arguments = Vec::new();
        for (key, value) in self.table(value, name)? {
            match key.get_ref().as_ref() {
                "is" => {
                    let is = self.text_of(value, "the name of one of the eleven tools")?;
                    let known = || {
                        ToolSpec::POLICY
                            .iter()
                            .map(|spec| spec.paper_name)
                            .collect::<Vec<_>>()
                            .join(", ")
                    };
                    let unknown = || {
                        self.error(
                            Some(value.span()),
                            format!("unknown tool '{is}'; the eleven tools are: {}", known()),
                        )
                    };
                    spec = Some(ToolSpec::by_name(&is).ok_or_else(unknown)?);
                }
                "arguments" => {
                    for (ours, theirs) in self.table(value, "arguments")? {
                        let text =
                            self.text_of(theirs, "the name of the argument there, in quotes")?;
                        arguments.push((ours, text));
                    }
                }
                other => {
                    let what = format!(
                        "unknown key '{other}' in [tools.{name}]; there are: is, arguments"
                    );
                    return Err(self.error(Some(key.span()), what));
                }
            }
        }
        let spec = spec.ok_or_else(|| {
            self.error(
                Some(value.span()),
                format!("[tools.{name}] needs 'is': one of the eleven tools"),
            )
        })?;
        for (ours, _) in &arguments {
            let name = ours.get_ref().as_ref();
            let known = spec.argument.is_some_and(|argument| argument.name == name)
                || spec.paper_name == "ask" && MORE_OF_ASK.contains(&name);
            if !known {
                let takes = spec
                    .argument
                    .map_or("no argument", |argument| argument.name);
                let what = format!(
                    "{} takes no argument '{name}'; it takes {takes}",
                    spec.paper_name
                );
                return Err(self.error(Some(ours.span()), what));
            }
        }
        let arguments = arguments
            .into_iter()
            .map(|(ours, theirs)| (ours.get_ref().to_string(), theirs))
            .collect();
        Ok(Mapped {
            is: spec.paper_name,
            arguments,
        })
    }
}
