//! Cuts a text into sentences and a sentence into tokens. Never looks at meaning;
//! linear in the text.

use std::ops::Range;

/// Longest quotation that is taken for one, in bytes.
const LONGEST_QUOTE: usize = 400;
/// Tokens of a sentence that are read; what follows is no claim.
const LONGEST_SENTENCE: usize = 240;

/// What a token is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Kind {
    /// Letters, digits and underscores, lower case; `didn't` gives `did` and `not`.
    Word,
    /// A number that is written in digits only.
    Number,
    /// What stands between quotation marks.
    Quote,
    /// `,`, a dash or an arrow between words.
    Comma,
    /// A colon, after which a reason may begin.
    Colon,
    /// `(` and its kin.
    Open,
    /// `)` and its kin.
    Close,
}

/// A piece of a sentence.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Token {
    pub(crate) kind: Kind,
    /// Text of the token in lower case; empty for punctuation.
    pub(crate) text: String,
    /// In the sentence, in bytes.
    pub(crate) span: Range<usize>,
}

impl Token {
    /// The word, where it is one.
    pub(crate) fn word(&self) -> &str {
        if self.kind == Kind::Word {
            &self.text
        } else {
            ""
        }
    }

    /// The number, where it is one.
    pub(crate) fn number(&self) -> Option<u32> {
        (self.kind == Kind::Number)
            .then(|| self.text.parse().ok())
            .flatten()
    }
}

/// The sentences of a text with their final mark, without the space around them. A semicolon and a
/// line's end divide too.
pub(crate) fn sentences(text: &str) -> Vec<Range<usize>> {
    let bytes = text.as_bytes();
    let mut found = Vec::new();
    let (mut start, mut depth, mut at) = (0, 0u32, 0);
    while at < bytes.len() {
        let here = at;
        at += 1;
        let ends = match bytes[here] {
            b'(' | b'[' | b'{' => {
                depth += 1;
                false
            }
            b')' | b']' | b'}' => {
                depth = depth.saturating_sub(1);
                false
            }
            b'"' | b'\'' => match quote_end(text, here) {
                Some(end) => {
                    at = end;
                    // `He said "No." Then` ends where the quotation ends
                    bytes[..end - 1]
                        .last()
                        .is_some_and(|last| b".!?".contains(last))
                        && depth == 0
                        && opens_sentence(text, end)
                }
                None => false,
            },
            b'\n' => true,
            b';' => depth == 0,
            b'!' | b'?' => depth == 0,
            b'.' => {
                depth == 0
                    && bytes.get(at).is_none_or(u8::is_ascii_whitespace)
                    && !enumerates(&text[start..here])
            }
            _ => false,
        };
        if ends {
            depth = 0;
            found.push(start..at);
            start = at;
        }
    }
    found.push(start..text.len());
    found
        .into_iter()
        .filter_map(|range| trimmed(text, range))
        .collect()
}

/// The tokens of a sentence, without the number of its line: `3) I went.` counts no things.
pub(crate) fn tokens(sentence: &str) -> Vec<Token> {
    let mut found: Vec<Token> = Vec::new();
    let begin = line_number(sentence);
    let mut letters = sentence
        .char_indices()
        .skip_while(move |(at, _)| *at < begin)
        .peekable();
    while let Some((at, letter)) = letters.next() {
        if found.len() >= LONGEST_SENTENCE {
            break;
        }
        let kind = match letter {
            '"' | '\'' | '\u{201c}' => {
                if let Some(end) = quote_end(sentence, at) {
                    while letters.next_if(|(next, _)| *next < end).is_some() {}
                    found.push(Token {
                        kind: Kind::Quote,
                        text: sentence[at..end].to_lowercase(),
                        span: at..end,
                    });
                }
                continue;
            }
            ',' | '>' | '\u{2014}' | '\u{2013}' | '\u{2192}' => Kind::Comma,
            ':' => Kind::Colon,
            '(' | '[' | '{' => Kind::Open,
            ')' | ']' | '}' => Kind::Close,
            _ if is_letter(letter) => {
                let mut end = at + letter.len_utf8();
                while let Some((next, letter)) = letters.next_if(|(next, letter)| {
                    is_letter(*letter)
                        || is_apostrophe(*letter)
                            && sentence[*next..].chars().nth(1).is_some_and(is_letter)
                        || *letter == '.' && is_decimal(sentence, *next)
                }) {
                    end = next + letter.len_utf8();
                }
                push_word(&mut found, &sentence[at..end], at);
                continue;
            }
            _ => continue,
        };
        found.push(Token {
            kind,
            text: String::new(),
            span: at..at + letter.len_utf8(),
        });
    }
    found
}

/// Length of the `3)` with which a sentence begins, in bytes; 0 without one.
fn line_number(sentence: &str) -> usize {
    let rest = sentence.trim_start_matches(|letter: char| letter.is_ascii_digit());
    let digits = sentence.len() - rest.len();
    if digits > 0 && rest.starts_with(')') {
        digits + 1
    } else {
        0
    }
}

fn is_letter(letter: char) -> bool {
    letter.is_alphanumeric() || letter == '_'
}

fn is_apostrophe(letter: char) -> bool {
    letter == '\'' || letter == '\u{2019}'
}

fn is_decimal(text: &str, dot: usize) -> bool {
    let bytes = text.as_bytes();
    dot > 0 && bytes[dot - 1].is_ascii_digit() && bytes.get(dot + 1).is_some_and(u8::is_ascii_digit)
}

/// Splits what is written together: `didn't`, `I've`, `table_1's`.
fn push_word(found: &mut Vec<Token>, raw: &str, at: usize) {
    let text = raw.to_lowercase().replace('\u{2019}', "'");
    let span = at..at + raw.len();
    let kind = if text.bytes().all(|byte| byte.is_ascii_digit()) {
        Kind::Number
    } else {
        Kind::Word
    };
    let mut push = |text: &str| {
        found.push(Token {
            kind,
            text: text.to_owned(),
            span: span.clone(),
        })
    };
    if let Some(stem) = text.strip_suffix("n't") {
        push(match stem {
            "ca" => "can",
            "wo" => "will",
            stem => stem,
        });
        push("not");
    } else if text == "cannot" {
        push("can");
        push("not");
    } else if let Some((stem, ending)) = text.split_once('\'') {
        push(stem);
        match ending {
            "m" => push("am"),
            "ve" => push("have"),
            "re" => push("are"),
            "ll" => push("will"),
            "s" if matches!(stem, "it" | "that" | "there" | "what" | "he" | "she") => push("is"),
            _ => {}
        }
    } else {
        push(&text);
    }
}

/// End of the quotation that opens at a byte, behind its closing mark.
fn quote_end(text: &str, open: usize) -> Option<usize> {
    let mark = text[open..].chars().next()?;
    let close = if mark == '\u{201c}' { '\u{201d}' } else { mark };
    let inside = |letter: Option<char>| letter.is_some_and(char::is_alphanumeric);
    // an apostrophe opens only before a word and after none
    if mark == '\''
        && (inside(text[..open].chars().next_back()) || !inside(text[open + 1..].chars().next()))
    {
        return None;
    }
    let from = open + mark.len_utf8();
    for (at, letter) in text[from..]
        .char_indices()
        .take_while(|(at, letter)| *at < LONGEST_QUOTE && *letter != '\n')
    {
        let end = from + at + letter.len_utf8();
        if letter == close && (mark != '\'' || !inside(text[end..].chars().next())) {
            return Some(end);
        }
    }
    None
}

fn opens_sentence(text: &str, at: usize) -> bool {
    let rest = text[at..].trim_start();
    rest.len() < text.len() - at && rest.chars().next().is_some_and(char::is_uppercase)
        || rest.is_empty()
}

/// Whether a text is no more than the number of a list's item.
fn enumerates(text: &str) -> bool {
    let text = text.trim();
    !text.is_empty() && text.len() < 4 && text.bytes().all(|byte| byte.is_ascii_digit())
}

fn trimmed(text: &str, range: Range<usize>) -> Option<Range<usize>> {
    let piece = &text[range.clone()];
    let start = range.start + (piece.len() - piece.trim_start().len());
    let end = range.start + piece.trim_end().len();
    (start < end).then_some(start..end)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(text: &str) -> Vec<&str> {
        sentences(text)
            .into_iter()
            .map(|range| &text[range])
            .collect()
    }

    #[test]
    fn sentences_end_at_marks_but_not_inside_numbers_quotations_and_parentheses() {
        assert_eq!(
            texts("I went 1.5 m. Then (a. b) I left;done\n3. pick"),
            ["I went 1.5 m.", "Then (a. b) I left;", "done", "3. pick"]
        );
        assert_eq!(
            texts("The user said \"No. Not that.\" I left."),
            ["The user said \"No. Not that.\"", "I left."]
        );
        assert_eq!(texts("  "), Vec::<&str>::new());
    }

    #[test]
    fn words_that_are_written_together_are_split() {
        let words: Vec<String> = tokens("I've, didn't (it's) table_1's 3 \"Yes.\"")
            .into_iter()
            .map(|token| token.text)
            .collect();
        assert_eq!(
            tokens("3) I saw 2 cups.")
                .into_iter()
                .map(|token| token.text)
                .collect::<Vec<_>>(),
            ["i", "saw", "2", "cups"]
        );
        assert_eq!(
            words,
            [
                "i", "have", "", "did", "not", "", "it", "is", "", "table_1", "3", "\"yes.\""
            ]
        );
    }
}
