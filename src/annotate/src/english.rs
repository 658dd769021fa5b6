//! The little English that sentences need: articles, plurals, lists, first letters. Never
//! decides what is said.

use reel_world::language;

/// Most characters that are quoted.
const QUOTED_CHARACTERS_MAX: usize = 400;

/// Names of stuff, which take `some` instead of an article.
const STUFF: [&str; 24] = reel_world::words! {
    bread butter cereal cheese chocolate coffee detergent flour food fruit juice meat milk oil pasta
    rice salt shampoo soap soup sugar tea toothpaste water
};

/// `an apple`, `a mug`, `some bread`, `some scissors`; what has an article keeps it.
pub(crate) fn indefinite(noun: &str) -> String {
    let last = head(noun);
    let plural = last.ends_with('s')
        && !last.ends_with("ss")
        && !last.ends_with("us")
        && !last.ends_with("is");
    if determined(noun) {
        noun.to_owned()
    } else if !noun.contains(' ') && (STUFF.contains(&last) || plural) {
        format!("some {noun}")
    } else if plural {
        noun.to_owned()
    } else {
        format!("{} {noun}", article(noun))
    }
}

/// What one looks for: `an apple`, `bread`, `scissors`.
pub(crate) fn sought(noun: &str) -> String {
    let indefinite = indefinite(noun);
    indefinite
        .strip_prefix("some ")
        .map_or(indefinite.clone(), str::to_owned)
}

/// `the apple`; what has an article keeps it.
pub(crate) fn definite(noun: &str) -> String {
    if determined(noun) {
        noun.to_owned()
    } else {
        format!("the {noun}")
    }
}

/// Plural of an English noun: `tables`, `shelves`, `couches`.
pub(crate) fn plural(noun: &str) -> String {
    let cut =
        |ending: &str, new: &str| noun.strip_suffix(ending).map(|stem| format!("{stem}{new}"));
    let vowel_y = ["ay", "ey", "oy", "uy"]
        .iter()
        .any(|ending| noun.ends_with(ending));
    if noun.ends_with("shelf") {
        return cut("f", "ves").unwrap_or_default();
    }
    if noun.ends_with('y') && !vowel_y {
        return cut("y", "ies").unwrap_or_default();
    }
    if ["s", "x", "ch", "sh"]
        .iter()
        .any(|ending| noun.ends_with(ending))
    {
        format!("{noun}es")
    } else {
        format!("{noun}s")
    }
}

/// `1 candidate`, `2 candidates`.
pub(crate) fn count(number: usize, noun: &str) -> String {
    if number == 1 {
        format!("1 {noun}")
    } else {
        format!("{number} {}", plural(noun))
    }
}

/// `a`, `a and b`, `a, b and c`.
pub(crate) fn list<S: AsRef<str>>(items: &[S], conjunction: &str) -> String {
    match items {
        [] => String::new(),
        [one] => one.as_ref().to_owned(),
        [head @ .., last] => {
            let head: Vec<&str> = head.iter().map(AsRef::as_ref).collect();
            format!("{} {conjunction} {}", head.join(", "), last.as_ref())
        }
    }
}

/// A caption as a noun inside a sentence: one line, no full stop at its end, small first letter.
pub(crate) fn noun(caption: &str) -> String {
    let line = one_line(caption);
    let line = line.trim_end_matches(['.', '!', '?', ',', ';', ':', ' ']);
    let mut letters = line.chars();
    let Some(first) = letters.next() else {
        return String::new();
    };
    let shouted = letters.clone().next().is_some_and(char::is_uppercase);
    if shouted {
        line.to_owned()
    } else {
        first.to_lowercase().chain(letters).collect()
    }
}

/// A text in one line without its full stop, in quotation marks that it cannot close; of a very
/// long one the beginning.
pub(crate) fn quoted(text: &str) -> String {
    let line = one_line(text).replace('"', "'");
    match line.char_indices().nth(QUOTED_CHARACTERS_MAX) {
        Some((end, _)) => format!("\"{} ...\"", &line[..end]),
        None => format!("\"{}\"", line.trim_end_matches('.')),
    }
}

/// A text without line breaks, further control characters and runs of spaces.
pub(crate) fn one_line(text: &str) -> String {
    text.split(|letter: char| letter.is_whitespace() || letter.is_control())
        .filter(|word| !word.is_empty())
        .collect::<Vec<_>>()
        .join(" ")
}

/// A sentence begins with a capital letter, unless it begins with an id.
pub(crate) fn sentence(text: &str) -> String {
    let id = text.split(' ').next().is_some_and(|word| {
        word.contains('_') || word.chars().any(|letter| letter.is_ascii_digit())
    });
    let mut letters = text.chars();
    match letters.next() {
        Some(first) if !id => first.to_uppercase().chain(letters).collect(),
        _ => text.to_owned(),
    }
}

fn determined(noun: &str) -> bool {
    let first = noun.split(' ').next().unwrap_or_default();
    [
        "the", "a", "an", "my", "our", "your", "some", "what", "two", "three",
    ]
    .contains(&first.to_lowercase().as_str())
}

/// By the letter, but for words that sound otherwise.
fn article(noun: &str) -> &'static str {
    const OTHERWISE: [&str; 8] = reel_world::words! { uni use usb eu one hour honest heir };
    let word = noun.to_lowercase();
    let other = OTHERWISE.iter().any(|start| word.starts_with(start));
    match language::article(&word) {
        "a" if other => "an",
        "an" if other => "a",
        article => article,
    }
}

/// The word that decides on the number: `timer` of `red timer with printed minutes`.
fn head(noun: &str) -> &str {
    const ENDS: [&str; 12] = [
        "with", "of", "in", "on", "for", "at", "from", "near", "that", "who", "without", "under",
    ];
    let words = noun
        .split(' ')
        .take_while(|word| !ENDS.contains(&word.trim_end_matches(',')));
    words.last().unwrap_or_default().trim_end_matches(',')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn articles() {
        let cases = [
            ("apple", "an apple"),
            ("mug", "a mug"),
            ("bread", "some bread"),
            ("scissors", "some scissors"),
            ("glass", "a glass"),
            ("unicorn figurine", "a unicorn figurine"),
            ("hourglass", "an hourglass"),
            ("umbrella", "an umbrella"),
            ("large beige oval bread", "a large beige oval bread"),
            ("a red one", "a red one"),
            (
                "red timer with printed minutes",
                "a red timer with printed minutes",
            ),
            ("green grapes in a bowl", "green grapes in a bowl"),
        ];
        for (noun, expected) in cases {
            assert_eq!(indefinite(noun), expected);
        }
        assert_eq!(
            definite("the table where we have dinner"),
            "the table where we have dinner"
        );
    }

    #[test]
    fn numbers_and_lists() {
        assert_eq!(
            [count(1, "candidate"), count(2, "shelf"), count(3, "couch")],
            ["1 candidate", "2 shelves", "3 couches"]
        );
        assert_eq!(list(&["a", "b", "c"], "and"), "a, b and c");
        assert_eq!(list(&["a", "b"], "or"), "a or b");
    }

    #[test]
    fn captions_and_quotations() {
        assert_eq!(
            noun("Round, glossy red apple\nwith a stem."),
            "round, glossy red apple with a stem"
        );
        assert_eq!(noun("TV remote."), "TV remote");
        assert_eq!(quoted("say \"no\"\n now"), "\"say 'no' now\"");
        assert_eq!(
            (sentence("it is").as_str(), sentence("desk_1 is").as_str()),
            ("It is", "desk_1 is")
        );
    }
}
