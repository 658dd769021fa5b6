//! What a question is about, and how one asks which object is meant. Rules over words; never
//! looks at a task.

use reel_world::language::{is_a, names_object, words};

/// What the robot wants to know.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Topic {
    /// Which object is meant.
    Object,
    /// Where the object that is meant stands.
    Source,
    /// Where it shall go.
    Destination,
}

/// The question which object is meant, by what was seen (captions or categories) and what
/// it is wanted for.
pub fn clarifying_question<'a>(
    seen: impl Iterator<Item = &'a str>,
    purpose: Option<&str>,
) -> String {
    let mut things: Vec<String> = seen
        .map(|thing| thing.trim_end_matches('.').to_lowercase())
        .collect();
    things.dedup();
    let wanted = purpose.unwrap_or("one");
    if things.is_empty() {
        return format!("Which {wanted} do you mean?");
    }
    format!("I see: {}. Which {wanted} do you mean?", things.join("; "))
}

const BRINGING: [&str; 17] = reel_world::words! {
    put place bring deliver deposit drop carry move store leave set destination goes go into onto to
};

const LOOKING: [&str; 14] = [
    "find", "look", "search", "located", "check", "stand", "stands", "lies", "from", "explore",
    "see", "location", "get", "is",
];

impl Topic {
    pub(super) fn of(question: &str) -> Self {
        let words = words(question);
        let has = |list: &[&str]| words.iter().any(|word| list.contains(&word.as_str()));
        let takes_it = words
            .windows(2)
            .any(|pair| pair[0] == "take" && ["it", "them", "this"].contains(&pair[1].as_str()));
        let bringing = takes_it || has(&BRINGING);
        let furniture = words.iter().any(|word| is_furniture(word));
        let asked = words
            .iter()
            .position(|word| ["which", "what"].contains(&word.as_str()));
        if words.iter().any(|word| word == "destination") {
            return Topic::Destination;
        }
        if words.iter().any(|word| word == "where") {
            return if bringing {
                Topic::Destination
            } else {
                Topic::Source
            };
        }
        if let Some(asked) = asked {
            // `which of these tables should ...`
            let place = words[asked + 1..]
                .iter()
                .take(4)
                .take_while(|word| *word != "should")
                .any(|word| is_furniture(word));
            return match (place, bringing || !has(&LOOKING)) {
                (false, _) => Topic::Object,
                (true, true) => Topic::Destination,
                (true, false) => Topic::Source,
            };
        }
        match (bringing && furniture, names_object(question)) {
            (true, _) => Topic::Destination,
            (false, true) => Topic::Object,
            (false, false) if furniture => Topic::Source,
            (false, false) => Topic::Object,
        }
    }
}

/// Whether a question can be answered by yes or no: it begins with an auxiliary verb
/// and offers no choice.
pub(super) fn wants_yes_or_no(question: &str) -> bool {
    const AUXILIARIES: [&str; 16] = [
        "is", "are", "do", "does", "did", "should", "shall", "can", "could", "would", "was",
        "will", "am", "have", "has", "may",
    ];
    let words = words(question);
    let auxiliary = words
        .iter()
        .take(3)
        .any(|word| AUXILIARIES.contains(&word.as_str()));
    auxiliary
        && !words
            .iter()
            .any(|word| ["or", "which", "what", "where"].contains(&word.as_str()))
}

fn is_furniture(word: &str) -> bool {
    is_a(word, "furniture") || word == "receptacle"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics() {
        use Topic::{Destination, Object, Source};
        let cases = [
            ("Which apple do you mean?", Object),
            ("Which one should I bring to the table?", Object),
            ("Do you mean the red one?", Object),
            ("Is it the pen on the desk?", Object),
            ("What should I do?", Object),
            ("Could you describe it?", Object),
            ("Where is it?", Source),
            ("Where can I find the apple?", Source),
            ("Is it on the table?", Source),
            ("Which table should I look on?", Source),
            ("Which table?", Destination),
            ("Which of the two desks should I bring it to?", Destination),
            ("Where should I put it?", Destination),
            ("Should I place it on the white desk?", Destination),
            ("What is the destination?", Destination),
        ];
        for (question, topic) in cases {
            assert_eq!(Topic::of(question), topic, "{question}");
        }
        assert!(
            wants_yes_or_no("So, is it red?")
                && !wants_yes_or_no("Is it the red or the green one?")
        );
        assert!(!wants_yes_or_no("Which one is it?"));
    }
}
