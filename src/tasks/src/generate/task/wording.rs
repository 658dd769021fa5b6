//! Instructions in varied words. Takes phrases, never decides what they have to tell apart.

use crate::{Stream, wording::TEMPLATES};

/// Beside those of plain tasks.
const MORE: &[&str] = &[
    "Please carry {object} from {src} to {dest}.",
    "Fetch {object} from {src} and leave it {at} {dest}.",
];

/// For fuzzy instructions also these.
const CASUAL: &[&str] = &[
    "Can you bring {object} from {src} to {dest}?",
    "Could you move {object} from {src} to {dest}?",
    "Would you please take {object} from {src} and put it {at} {dest}?",
];

/// `{objects}` stands for several objects with where they are.
const GATHERING: &[&str] = &[
    "Bring {objects} to {dest}.",
    "Gather {objects} and put them {at} {dest}.",
    "Collect {objects}, and leave all of them {at} {dest}.",
    "Carry {objects} to {dest}.",
];

/// One way to say it, chosen once, so that the precise and the fuzzy instruction of a
/// task are worded alike.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InstructionWording {
    template: &'static str,
}

impl InstructionWording {
    /// Draws a template for an instruction that moves one object.
    pub(crate) fn moving(fuzzy: bool, stream: &mut Stream) -> Self {
        if fuzzy && stream.below(3) == 0 {
            return Self {
                template: CASUAL[stream.below(CASUAL.len())],
            };
        }
        let index = stream.below(TEMPLATES.len() + MORE.len());
        Self {
            template: TEMPLATES
                .get(index)
                .unwrap_or_else(|| &MORE[index - TEMPLATES.len()]),
        }
    }

    /// Draws one of the published templates.
    pub(crate) fn published(stream: &mut Stream) -> Self {
        Self {
            template: TEMPLATES[stream.below(TEMPLATES.len())],
        }
    }

    /// Draws a template for an instruction that gathers several objects.
    pub(crate) fn gathering(stream: &mut Stream) -> Self {
        Self {
            template: GATHERING[stream.below(GATHERING.len())],
        }
    }

    /// The instruction for an object on `src`; `into` where the destination is
    /// something to put into.
    pub(crate) fn say(self, object: &str, src: &str, dest: &str, into: bool) -> String {
        self.fill(dest, into)
            .replace("{src}", src)
            .replace("{object}", object)
    }

    /// The instruction for objects, each with where it stands.
    pub(crate) fn say_all(self, objects: &[(String, &str)], dest: &str, into: bool) -> String {
        let mut places: Vec<(&str, Vec<&str>)> = Vec::new();
        for (object, src) in objects {
            match places.iter_mut().find(|(place, _)| place == src) {
                Some((_, there)) => there.push(object),
                None => places.push((src, vec![object])),
            }
        }
        let parts: Vec<String> = places
            .iter()
            .map(|(src, there)| format!("{} from {src}", and(there)))
            .collect();
        let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
        self.fill(dest, into).replace("{objects}", &and(&parts))
    }

    fn fill(self, dest: &str, into: bool) -> String {
        self.template
            .replace("{dest}", dest)
            .replace("{at}", if into { "in" } else { "on" })
    }
}

fn and(phrases: &[&str]) -> String {
    match phrases {
        [] => String::new(),
        [one] => (*one).to_owned(),
        [firsts @ .., last] => format!("{} and {last}", firsts.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use crate::wording::indefinite;

    use super::*;

    #[test]
    fn phrases_read_as_english() {
        let take = InstructionWording {
            template: TEMPLATES[8],
        };
        let said = take.say(&indefinite("apple"), "the couch", "the microwave", true);
        assert_eq!(
            said,
            "Take an apple from the couch and put it in the microwave."
        );
        let gather = InstructionWording {
            template: GATHERING[0],
        };
        let objects = [
            ("the red mug".to_owned(), "the couch"),
            ("the cup".to_owned(), "the desk"),
            ("the pen".to_owned(), "the desk"),
        ];
        let said = gather.say_all(&objects, "the shelf", false);
        assert_eq!(
            said,
            "Bring the red mug from the couch and the cup and the pen from the desk to the shelf."
        );
    }
}
