//! A YAML document as a tree of nodes that know their line, built with bounds: depth, alias
//! expansion, duplicate keys, non-finite numbers. Knows nothing of tasks.

use std::collections::BTreeMap;

use indexmap::IndexMap;
use saphyr::Scalar;
use saphyr_parser::{Event, Parser, Span};

use crate::error::Problem;

/// Deepest nesting; real task files have 6 levels.
const MOST_LEVELS: usize = 64;
/// Most nodes that anchors and aliases may copy, in a whole file.
const MOST_COPIES: usize = 100_000;

/// A node and the line it starts at, from 1.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Node {
    pub line: usize,
    pub content: Content,
}

/// What a node holds. Numbers are finite, mappings keep the order of the file.
#[derive(Clone, PartialEq, Debug)]
pub(crate) enum Content {
    Null,
    Bool(bool),
    Integer(i64),
    Float(f64),
    Text(String),
    List(Vec<Node>),
    Map(IndexMap<String, Node>),
}

impl Content {
    /// Name of the node's type for error messages, e.g. `a list`.
    pub fn kind(&self) -> &'static str {
        match self {
            Content::Null => "nothing",
            Content::Bool(_) => "true or false",
            Content::Integer(_) | Content::Float(_) => "a number",
            Content::Text(_) => "text",
            Content::List(_) => "a list",
            Content::Map(_) => "a mapping",
        }
    }
}

impl Node {
    /// Turns every list of that name around, at any depth.
    pub(crate) fn reverse_lists(&mut self, name: &str) {
        match &mut self.content {
            Content::List(items) => items.iter_mut().for_each(|item| item.reverse_lists(name)),
            Content::Map(entries) => {
                for (key, node) in entries {
                    if let (true, Content::List(items)) = (key == name, &mut node.content) {
                        items.reverse();
                    }
                    node.reverse_lists(name);
                }
            }
            _ => {}
        }
    }
}

/// Parses the one document of a text.
pub(crate) fn parse(text: &str) -> Result<Node, Problem> {
    let mut parser = Parser::new_from_str(text);
    let mut builder = Builder::default();
    while let Some(event) = parser.next_event() {
        let (event, span) =
            event.map_err(|error| Problem::syntax(error.marker().line(), error.info()))?;
        builder.take(event, span)?;
    }
    builder
        .root
        .ok_or_else(|| Problem::syntax(1, "the file is empty"))
}

#[derive(Default)]
struct Builder {
    open: Vec<Frame>,
    anchors: BTreeMap<usize, Node>,
    copies: usize,
    root: Option<Node>,
}

struct Frame {
    anchor: usize,
    line: usize,
    container: Container,
}

enum Container {
    List(Vec<Node>),
    Map {
        entries: IndexMap<String, Node>,
        key: Option<(String, usize)>,
    },
}

impl Builder {
    fn take(&mut self, event: Event<'_>, span: Span) -> Result<(), Problem> {
        let line = span.start.line();
        match event {
            Event::DocumentStart(_) if self.root.is_some() => {
                Err(Problem::syntax(line, "a second document; one is expected"))
            }
            Event::Nothing
            | Event::StreamStart
            | Event::StreamEnd
            | Event::DocumentStart(_)
            | Event::DocumentEnd => Ok(()),
            Event::SequenceStart(anchor, _) => {
                self.begin(anchor, line, Container::List(Vec::new()))
            }
            Event::MappingStart(anchor, _) => self.begin(
                anchor,
                line,
                Container::Map {
                    entries: IndexMap::new(),
                    key: None,
                },
            ),
            Event::SequenceEnd | Event::MappingEnd => {
                let frame = self.open.pop().expect("the parser ends only what it began");
                let content = match frame.container {
                    Container::List(items) => Content::List(items),
                    Container::Map { entries, .. } => Content::Map(entries),
                };
                self.add(
                    Node {
                        line: frame.line,
                        content,
                    },
                    frame.anchor,
                )
            }
            Event::Scalar(text, style, anchor, tag) => {
                if self.wants_key() {
                    return self.set_key(text.into_owned(), line);
                }
                let bad = || Problem::syntax(line, "a value that is not what its tag says");
                let scalar = Scalar::parse_from_cow_and_metadata(text, style, tag.as_ref())
                    .ok_or_else(bad)?;
                let content = match scalar {
                    Scalar::Null => Content::Null,
                    Scalar::Boolean(value) => Content::Bool(value),
                    Scalar::Integer(value) => Content::Integer(value),
                    Scalar::FloatingPoint(value) if value.is_finite() => Content::Float(value.0),
                    Scalar::FloatingPoint(_) => {
                        return Err(Problem::syntax(line, "a number that is not finite"));
                    }
                    Scalar::String(value) => Content::Text(value.into_owned()),
                };
                self.add(Node { line, content }, anchor)
            }
            Event::Alias(anchor) => {
                let unknown =
                    || Problem::syntax(line, "an alias of something that holds the alias itself");
                let node = self.anchors.get(&anchor).ok_or_else(unknown)?.clone();
                if self.wants_key() {
                    let Content::Text(text) = node.content else {
                        return Err(no_text_key(line));
                    };
                    return self.set_key(text, line);
                }
                self.count_copies(&node, line)?;
                self.add(node, 0)
            }
        }
    }

    fn begin(&mut self, anchor: usize, line: usize, container: Container) -> Result<(), Problem> {
        if self.wants_key() {
            return Err(no_text_key(line));
        }
        if self.open.len() == MOST_LEVELS {
            return Err(Problem::syntax(
                line,
                format!("nested deeper than {MOST_LEVELS} levels"),
            ));
        }
        self.open.push(Frame {
            anchor,
            line,
            container,
        });
        Ok(())
    }

    fn wants_key(&self) -> bool {
        matches!(
            self.open.last(),
            Some(Frame {
                container: Container::Map { key: None, .. },
                ..
            })
        )
    }

    fn set_key(&mut self, text: String, line: usize) -> Result<(), Problem> {
        let Some(Frame {
            container: Container::Map { entries, key },
            ..
        }) = self.open.last_mut()
        else {
            unreachable!("only a mapping wants a key")
        };
        if entries.contains_key(&text) {
            return Err(Problem::syntax(
                line,
                format!("the key {text:?} stands twice in its mapping"),
            ));
        }
        *key = Some((text, line));
        Ok(())
    }

    fn add(&mut self, node: Node, anchor: usize) -> Result<(), Problem> {
        if anchor > 0 {
            self.count_copies(&node, node.line)?;
            self.anchors.insert(anchor, node.clone());
        }
        match self.open.last_mut().map(|frame| &mut frame.container) {
            None => self.root = Some(node),
            Some(Container::List(items)) => items.push(node),
            Some(Container::Map { entries, key }) => {
                let (key, _) = key.take().expect("a value follows its key");
                entries.insert(key, node);
            }
        }
        Ok(())
    }

    /// Counts a copied subtree against the bound, and its depth where it lands.
    fn count_copies(&mut self, node: &Node, line: usize) -> Result<(), Problem> {
        let (count, levels) = measure(node);
        self.copies += count;
        if self.copies > MOST_COPIES {
            return Err(Problem::syntax(
                line,
                format!("anchors and aliases copy more than {MOST_COPIES} values"),
            ));
        }
        if self.open.len() + levels > MOST_LEVELS {
            return Err(Problem::syntax(
                line,
                format!("nested deeper than {MOST_LEVELS} levels"),
            ));
        }
        Ok(())
    }
}

/// Nodes in a subtree, and levels of it.
fn measure(node: &Node) -> (usize, usize) {
    let of = |children: &mut dyn Iterator<Item = &Node>| {
        let (count, levels) = children
            .map(measure)
            .fold((0, 0), |a, b| (a.0 + b.0, a.1.max(b.1)));
        (count + 1, levels + 1)
    };
    match &node.content {
        Content::List(items) => of(&mut items.iter()),
        Content::Map(entries) => of(&mut entries.values()),
        _ => (1, 0),
    }
}

fn no_text_key(line: usize) -> Problem {
    Problem::syntax(line, "a key that is not text")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn problem(text: &str) -> String {
        let Problem { line, problem, .. } = parse(text).unwrap_err();
        format!("{line}: {problem}")
    }

    #[test]
    fn nodes_know_their_lines() {
        let Content::Map(root) = parse("a: 1\nb:\n- x\n- c: 2.5\n").unwrap().content else {
            panic!("a mapping")
        };
        assert_eq!((root["a"].line, root["b"].line), (1, 3));
        let Content::List(items) = &root["b"].content else {
            panic!("a list")
        };
        assert_eq!((items[0].line, items[1].line), (3, 4));
    }

    #[test]
    fn an_alias_is_its_value() {
        let Content::Map(root) = parse("a: &x [1, 2]\nb: *x\n").unwrap().content else {
            panic!("a mapping")
        };
        assert_eq!(root["a"].content, root["b"].content);
    }

    #[test]
    fn hostile_documents_are_refused() {
        assert_eq!(
            problem("a: 1\nb: 2\na: 3\n"),
            "3: the key \"a\" stands twice in its mapping"
        );
        assert_eq!(problem("a: .nan\n"), "1: a number that is not finite");
        assert_eq!(
            problem("a: 1\nb: 1e999\n"),
            "2: a number that is not finite"
        );
        assert_eq!(
            problem("a: 1\n---\nb: 2\n"),
            "2: a second document; one is expected"
        );
        assert_eq!(problem(""), "1: the file is empty");
        assert_eq!(problem("? [1, 2]\n: x\n"), "1: a key that is not text");
        assert_eq!(
            problem(&"- ".repeat(100_000)),
            "1: nested deeper than 64 levels"
        );
        assert_eq!(problem(&"[".repeat(100_000)), "1: recursion limit exceeded");
        let bomb: String = (1..30)
            .map(|n| format!("a{n}: &a{n} [*a{0}, *a{0}, *a{0}]\n", n - 1))
            .collect();
        assert_eq!(
            problem(&format!("a0: &a0 [1]\n{bomb}")),
            "10: anchors and aliases copy more than 100000 values"
        );
    }
}
