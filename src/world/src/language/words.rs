//! Tokens and lemmas of simple English. Never looks at meaning.

/// A piece of a text.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(super) enum Token {
    /// A word, lower case; hyphens split words.
    Word(String),
    /// A comma, semicolon or colon.
    Pause,
    /// The end of a sentence.
    Stop,
}

impl Token {
    pub(super) fn word(&self) -> Option<&str> {
        match self {
            Token::Word(word) => Some(word),
            Token::Pause | Token::Stop => None,
        }
    }
}

/// Splits a text into words and punctuation.
pub(super) fn tokens(text: &str) -> Vec<Token> {
    let mut found = Vec::new();
    let mut word = String::new();
    for letter in text.chars().chain([' ']) {
        match letter {
            '\'' | '\u{2019}' if !word.is_empty() => word.push('\''),
            _ if letter.is_alphanumeric() => word.extend(letter.to_lowercase()),
            _ => {
                let plain = word.trim_end_matches('\'');
                if !plain.is_empty() {
                    found.push(Token::Word(plain.to_owned()));
                }
                word.clear();
                match letter {
                    ',' | ';' | ':' => found.push(Token::Pause),
                    '.' | '!' | '?' | '\n' => found.push(Token::Stop),
                    _ => {}
                }
            }
        }
    }
    found
}

/// The words of a text in lower case, without punctuation: `"Two Spiral-bound notebooks!"` gives
/// `two`, `spiral`, `bound`, `notebooks`.
pub fn words(text: &str) -> Vec<String> {
    let word = |token| {
        if let Token::Word(word) = token {
            Some(word)
        } else {
            None
        }
    };
    tokens(text).into_iter().filter_map(word).collect()
}

/// The singular of a lower-case noun by the rules -ies, -ves, -es and -s, and a few irregular
/// ones. Words that are no plurals come back as they are, or with an ending cut that every form of
/// the word loses alike.
pub fn lemma(word: &str) -> String {
    const IRREGULAR: [(&str, &str); 9] = [
        ("knives", "knife"),
        ("shelves", "shelf"),
        ("loaves", "loaf"),
        ("leaves", "leaf"),
        ("scarves", "scarf"),
        ("mice", "mouse"),
        ("dice", "dice"),
        ("people", "person"),
        ("cookies", "cookie"),
    ];
    if let Some((_, singular)) = IRREGULAR.iter().find(|(plural, _)| *plural == word) {
        return (*singular).to_owned();
    }
    let word = word.strip_suffix("'s").unwrap_or(word);
    if word.chars().count() > 4
        && let Some(stem) = word.strip_suffix("ies")
    {
        return format!("{stem}y");
    }
    if let Some(stem) = word.strip_suffix("es")
        && ["ss", "x", "z", "ch", "sh", "o"]
            .iter()
            .any(|ending| stem.ends_with(ending))
        && stem.chars().count() > 2
    {
        return stem.to_owned();
    }
    match word.strip_suffix('s') {
        Some(stem) if stem.chars().count() > 1 && !stem.ends_with(['s', 'u', 'i']) => {
            stem.to_owned()
        }
        _ => word.to_owned(),
    }
}

/// The lemmas of a name, joined by spaces, without leading articles: the form in
/// which names are compared.
pub(super) fn normal(name: &str) -> String {
    let words = words(name);
    let first = words
        .iter()
        .position(|word| !ARTICLES.contains(&word.as_str()))
        .unwrap_or(0);
    words[first..]
        .iter()
        .map(|word| lemma(word))
        .collect::<Vec<_>>()
        .join(" ")
}

/// Words that open a noun phrase and carry no description.
pub(super) const ARTICLES: [&str; 12] = [
    "a", "an", "the", "my", "your", "our", "some", "any", "this", "that", "these", "those",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plurals_fall_together_with_their_singular() {
        let pairs = [
            ("apples", "apple"),
            ("berries", "berry"),
            ("knives", "knife"),
            ("dishes", "dish"),
            ("boxes", "box"),
            ("tomatoes", "tomato"),
            ("glasses", "glass"),
            ("mice", "mouse"),
            ("cookies", "cookie"),
            ("pies", "pie"),
            ("headphones", "headphone"),
            ("sushi", "sushi"),
            ("stylus", "stylus"),
            ("glass", "glass"),
            ("clothes", "clothe"),
        ];
        for (plural, singular) in pairs {
            assert_eq!(lemma(plural), singular, "{plural}");
        }
    }

    #[test]
    fn words_drop_case_and_punctuation() {
        assert_eq!(
            words("The user's \"Spiral-bound\" NOTEBOOK, please!"),
            ["the", "user's", "spiral", "bound", "notebook", "please"]
        );
        assert_eq!(normal("The Cell-Phones"), "cell phone");
        assert_eq!(words(" ,.!? "), Vec::<String>::new());
    }
}
