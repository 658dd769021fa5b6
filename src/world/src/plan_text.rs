//! Plan steps as the one-line texts of REAL's task generator, and back. Owns that wording; whether
//! a plan makes sense is for `reel-plan`.

use std::collections::BTreeMap;

use serde_json::Value;

use crate::{PlanStep, spaced_json};

/// Steps whose text is a verb and a receptacle.
const AT_RECEPTACLE: [(&str, &str); 4] = [
    ("nav_to", "navigate to "),
    ("place", "place on "),
    ("open", "open "),
    ("close", "close "),
];
/// Steps whose text is a verb and an object: its category, and its description if there is one.
const ABOUT_OBJECT: [(&str, &str); 4] = [
    ("find", "find "),
    ("gaze_at", "gaze at "),
    ("pick", "pick "),
    ("ask", "ask "),
];
/// Between a category and a description.
const SEPARATOR: &str = " - ";

impl PlanStep {
    /// A step with arguments that are texts.
    pub fn new(action: &str, args: &[(&str, &str)]) -> Self {
        let args = args
            .iter()
            .map(|(key, value)| ((*key).to_owned(), Value::from(*value)))
            .collect();
        Self {
            action: action.to_owned(),
            args,
        }
    }

    /// An argument that is a text; surrounding blanks do not belong to it. `None` if it is absent,
    /// empty or no text.
    pub fn text_argument(&self, name: &str) -> Option<&str> {
        self.args
            .get(name)
            .and_then(Value::as_str)
            .map(str::trim)
            .filter(|text| !text.is_empty())
    }

    /// The step as a text, e.g. `find mug - A red mug.`; a `pick` also names `object`,
    /// the id of what it picks. An action that the generator does not know is its name
    /// and its arguments as JSON.
    pub fn to_text(&self, object: &str) -> String {
        let argument = |name: &str| {
            self.args
                .get(name)
                .and_then(Value::as_str)
                .unwrap_or_default()
        };
        if let Some((_, verb)) = AT_RECEPTACLE
            .iter()
            .find(|(action, _)| *action == self.action)
        {
            return format!("{verb}{}", argument("receptacle_name"));
        }
        let Some((_, verb)) = ABOUT_OBJECT
            .iter()
            .find(|(action, _)| *action == self.action)
        else {
            let args = self
                .args
                .iter()
                .map(|(name, value)| (name.clone(), value.clone()))
                .collect();
            return format!("{} {}", self.action, spaced_json(&Value::Object(args)));
        };
        let mut text = format!("{verb}{}", argument("target_category"));
        if !argument("target_description").is_empty() {
            text.push_str(SEPARATOR);
            text.push_str(argument("target_description"));
        }
        if self.action == "pick" {
            text.push_str(&format!(" ({object})"));
        }
        text
    }

    /// Reads a text that [`PlanStep::to_text`] wrote: case and the number of blanks after the
    /// verb do not matter, and the object that a `pick` names is left out, because a task
    /// names its target. `None` if the text begins with no known verb and is no action with
    /// its arguments as JSON.
    pub fn from_text(text: &str) -> Option<Self> {
        let text = text.trim();
        if let Some((action, rest)) = AT_RECEPTACLE
            .iter()
            .find_map(|(action, verb)| Some((*action, after(text, verb)?)))
        {
            return Some(Self::with_args(action, &[("receptacle_name", rest)]));
        }
        let about_object = ABOUT_OBJECT
            .iter()
            .find_map(|(action, verb)| Some((*action, after(text, verb)?)));
        let Some((action, mut rest)) = about_object else {
            let (action, args) = text.split_once(' ')?;
            return Some(Self {
                action: action.to_owned(),
                args: serde_json::from_str(args).ok()?,
            });
        };
        if let ("pick", Some((before, _))) = (
            action,
            rest.strip_suffix(')')
                .and_then(|rest| rest.rsplit_once(" (")),
        ) {
            rest = before;
        }
        let (category, description) = rest.split_once(SEPARATOR).unwrap_or((rest, ""));
        let args = [
            ("target_category", category.trim()),
            ("target_description", description.trim()),
        ];
        Some(Self::with_args(action, &args))
    }

    /// A step with these text arguments; empty ones are left out.
    fn with_args(action: &str, args: &[(&str, &str)]) -> Self {
        let given = args.iter().filter(|(_, text)| !text.is_empty());
        let args = given
            .map(|(name, text)| ((*name).to_owned(), Value::from(*text)))
            .collect::<BTreeMap<_, _>>();
        Self {
            action: action.to_owned(),
            args,
        }
    }
}

/// What follows a verb, whatever its case; the verb ends with a blank.
fn after<'a>(text: &'a str, verb: &str) -> Option<&'a str> {
    let head = text.get(..verb.len())?;
    head.eq_ignore_ascii_case(verb)
        .then(|| text[verb.len()..].trim())
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn step(action: &str, args: Value) -> PlanStep {
        PlanStep {
            action: action.to_owned(),
            args: args.as_object().unwrap().clone().into_iter().collect(),
        }
    }

    #[test]
    fn a_text_is_the_step_again() {
        let cup =
            || json!({"target_category": "tea cup", "target_description": "Blue - and small."});
        #[rustfmt::skip]
        let steps = [
            (step("nav_to", json!({"receptacle_name": "shelf_2"})), "navigate to shelf_2"),
            (step("open", json!({"receptacle_name": "shelf_2"})), "open shelf_2"),
            (step("close", json!({"receptacle_name": "shelf_2"})), "close shelf_2"),
            (step("place", json!({"receptacle_name": "shelf_2"})), "place on shelf_2"),
            (step("find", json!({"target_category": "tea cup"})), "find tea cup"),
            (step("gaze_at", cup()), "gaze at tea cup - Blue - and small."),
            (step("ask", cup()), "ask tea cup - Blue - and small."),
            (step("pick", cup()), "pick tea cup - Blue - and small. (cup_7)"),
        ];
        for (step, text) in steps {
            assert_eq!(step.to_text("cup_7"), text);
            assert_eq!(PlanStep::from_text(text), Some(step));
        }
    }

    #[test]
    fn texts_of_no_known_verb_are_no_steps() {
        assert_eq!(PlanStep::from_text("dance (now)"), None);
        assert_eq!(PlanStep::from_text("finder of cups"), None);
        assert_eq!(PlanStep::from_text("pïck"), None);
        let dance = step("dance", json!({"to": "jazz", "times": 2}));
        assert_eq!(dance.to_text(""), "dance {\"times\": 2, \"to\": \"jazz\"}");
        assert_eq!(PlanStep::from_text(&dance.to_text("")), Some(dance));
    }
}
