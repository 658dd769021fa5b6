//! XML as a tree of its own, with files and lines for errors, and typed reading of attributes.

use std::{collections::BTreeMap, rc::Rc};

use crate::{
    ImportError,
    files::{ImportFiles, number_list, numbers, parse_xml},
};

/// An element with its attributes and children.
#[derive(Clone, PartialEq, Debug)]
pub(crate) struct Element {
    pub(crate) tag: String,
    pub(crate) attributes: BTreeMap<String, String>,
    pub(crate) children: Vec<Element>,
    pub(crate) file: Rc<str>,
    pub(crate) line: usize,
}

impl Element {
    /// The root element of a file of the folder.
    pub(crate) fn read(files: &ImportFiles, name: &str) -> Result<Self, ImportError> {
        let text = files.text(name)?;
        let document = parse_xml(&text, name)?;
        Ok(Self::of(
            document.root_element(),
            &document,
            &Rc::from(name),
        ))
    }

    fn of(
        node: roxmltree::Node<'_, '_>,
        document: &roxmltree::Document<'_>,
        file: &Rc<str>,
    ) -> Self {
        let attributes = node.attributes();
        Self {
            tag: node.tag_name().name().to_owned(),
            attributes: attributes
                .map(|own| (own.name().to_owned(), own.value().to_owned()))
                .collect(),
            children: node
                .children()
                .filter(roxmltree::Node::is_element)
                .map(|child| Self::of(child, document, file))
                .collect(),
            file: file.clone(),
            line: document.text_pos_at(node.range().start).row as usize,
        }
    }

    /// How many elements it has, itself included.
    pub(crate) fn count(&self) -> usize {
        1 + self.children.iter().map(Element::count).sum::<usize>()
    }

    pub(crate) fn get(&self, name: &str) -> Option<&str> {
        self.attributes.get(name).map(String::as_str)
    }

    pub(crate) fn name(&self) -> &str {
        self.get("name").unwrap_or_default()
    }

    /// The first child of a tag.
    pub(crate) fn child(&self, tag: &str) -> Option<&Element> {
        self.children.iter().find(|child| child.tag == tag)
    }

    pub(crate) fn children_of<'a>(&'a self, tag: &'a str) -> impl Iterator<Item = &'a Element> {
        self.children.iter().filter(move |child| child.tag == tag)
    }

    /// An error at this element.
    pub(crate) fn error(&self, problem: impl Into<String>) -> ImportError {
        ImportError::Syntax {
            file: self.file.to_string(),
            line: self.line,
            problem: format!("<{}>: {}", self.tag, problem.into()),
        }
    }

    /// The numbers of an attribute's value, exactly so many.
    pub(crate) fn numbers_in<const N: usize>(
        &self,
        name: &str,
        text: &str,
    ) -> Result<[f64; N], ImportError> {
        numbers(text).ok_or_else(|| {
            let shown: String = text.chars().take(60).collect();
            self.error(format!(
                "{name}=\"{shown}\" is not {N} finite numbers within a million"
            ))
        })
    }

    /// An attribute of so many numbers; `None` where it is absent.
    pub(crate) fn numbers<const N: usize>(
        &self,
        name: &str,
    ) -> Result<Option<[f64; N]>, ImportError> {
        self.get(name)
            .map(|text| self.numbers_in(name, text))
            .transpose()
    }

    /// The numbers of an attribute's value, however many.
    pub(crate) fn list_in(&self, name: &str, text: &str) -> Result<Vec<f64>, ImportError> {
        number_list(text).ok_or_else(|| {
            let shown: String = text.chars().take(60).collect();
            self.error(format!(
                "{name}=\"{shown}\" is no list of finite numbers within a million"
            ))
        })
    }
}
