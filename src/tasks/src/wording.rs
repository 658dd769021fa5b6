//! Instructions in varied words, as the published ones are worded.

use crate::random::Stream;

/// `{src}`, `{dest}` and `{object}` stand for phrases, `{at}` for "on" or "in".
pub const TEMPLATES: &[&str] = &[
    "Navigate to {src}, grasp {object}, and carry it to {dest}.",
    "First, drive to {src} to find {object}, then deliver it to {dest}.",
    "Go to {src}, pick up {object}, then travel to {dest} to place it.",
    "Move {object} located at {src} to {dest}.",
    "Retrieve {object} from {src} and deposit it at {dest}.",
    "Pick up {object} from {src} and place it {at} {dest}.",
    "Head over to {src}, fetch {object}, and bring it to {dest}.",
    "Transport {object} at {src} to {dest}.",
    "Take {object} from {src} and put it {at} {dest}.",
    "Bring {object} from {src} to {dest}.",
    "Get {object} from {src} and move it to {dest}.",
];

/// The phrases of an instruction.
pub(crate) struct Phrases<'a> {
    pub src: &'a str,
    pub dest: &'a str,
    /// Whether the destination is something to put into.
    pub into: bool,
}

impl Phrases<'_> {
    /// One of the wordings.
    pub fn template(stream: &mut Stream) -> &'static str {
        TEMPLATES[stream.below(TEMPLATES.len())]
    }

    /// Words an instruction about an object.
    pub fn word(&self, template: &str, object: &str) -> String {
        let at = if self.into { "in" } else { "on" };
        template.replace("{src}", self.src).replace("{dest}", self.dest).replace("{object}", object).replace("{at}", at)
    }
}

/// `Small red mug with a rim.` as `the small red mug with a rim`.
pub fn definite(caption: &str) -> String {
    let caption = caption.trim_end_matches('.');
    let mut letters = caption.chars();
    let first = letters.next().map(|first| first.to_lowercase().collect::<String>()).unwrap_or_default();
    format!("the {first}{}", letters.as_str())
}

/// `egg` as `an egg`.
pub fn indefinite(noun: &str) -> String {
    let article = if noun.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" };
    format!("{article} {noun}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phrases_read_as_english() {
        let phrases = Phrases { src: "the couch", dest: "the microwave", into: true };
        let template = "Take {object} from {src} and put it {at} {dest}.";
        assert_eq!(phrases.word(template, &indefinite("apple")), "Take an apple from the couch and put it in the microwave.");
        assert_eq!(definite("Small red mug with a rim."), "the small red mug with a rim");
    }
}
