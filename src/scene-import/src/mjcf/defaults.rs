//! Attributes that elements have by their class, as `<default>` says.

use std::collections::BTreeMap;

use crate::{ImportError, element::Element};

/// The class of what names none.
const MAIN: &str = "main";

/// Attributes by class and tag; a class has those of its parent too.
#[derive(Default)]
pub(super) struct Defaults {
    classes: BTreeMap<String, Attributes>,
}

type Attributes = BTreeMap<String, BTreeMap<String, String>>;

impl Defaults {
    pub(super) fn of(root: &Element) -> Result<Self, ImportError> {
        let mut defaults = Self::default();
        for element in root.children_of("default") {
            let known = defaults.classes.get(MAIN).cloned().unwrap_or_default();
            // The outermost class is that of what names none, whatever its name.
            let class = element.get("class").unwrap_or(MAIN);
            defaults.add(element, class, known)?;
            if let Some(outermost) = defaults.classes.get(class).cloned() {
                defaults.classes.insert(MAIN.to_owned(), outermost);
            }
        }
        Ok(defaults)
    }

    fn add(
        &mut self,
        element: &Element,
        class: &str,
        mut attributes: Attributes,
    ) -> Result<(), ImportError> {
        for child in element
            .children
            .iter()
            .filter(|child| child.tag != "default")
        {
            attributes
                .entry(child.tag.clone())
                .or_default()
                .extend(child.attributes.clone());
        }
        self.classes.insert(class.to_owned(), attributes.clone());
        for child in element.children_of("default") {
            let name = child
                .get("class")
                .ok_or_else(|| child.error("has no class"))?;
            self.add(child, name, attributes.clone())?;
        }
        Ok(())
    }

    /// Every class that an element or one below it names is there.
    pub(super) fn check_classes(&self, element: &Element) -> Result<(), ImportError> {
        for name in ["class", "childclass"] {
            if let Some(class) = element.get(name)
                && class != MAIN
                && !self.classes.contains_key(class)
            {
                let shown: String = class.chars().take(60).collect();
                return Err(element.error(format!("no class {shown:?} among the defaults")));
            }
        }
        element
            .children
            .iter()
            .try_for_each(|child| self.check_classes(child))
    }

    /// An attribute of an element, else that of its class. `inherited` is the class of the bodies
    /// around it.
    pub(super) fn get(
        &self,
        element: &Element,
        inherited: Option<&str>,
        name: &str,
    ) -> Option<String> {
        if let Some(own) = element.get(name) {
            return Some(own.to_owned());
        }
        let class = element.get("class").or(inherited).unwrap_or(MAIN);
        self.classes
            .get(class)?
            .get(&element.tag)?
            .get(name)
            .cloned()
    }
}
