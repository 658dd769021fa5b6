//! Texts that somebody else wrote, for terminals and pages: no character of theirs moves a cursor,
//! hides, or makes its neighbours read otherwise.

/// Whether a character has no shape of its own: control characters, those that turn the direction
/// of writing, and those that take no room.
pub fn is_invisible(letter: char) -> bool {
    letter.is_control()
        || matches!(
            letter,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}' | '\u{feff}' | '\u{fffe}' | '\u{ffff}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

/// A text with an escape in place of each invisible character, ends of lines and tabs included.
pub fn printable_line(text: &str) -> String {
    escaped(text, is_invisible)
}

/// A text with an escape in place of each invisible character but ends of lines and tabs.
pub fn printable_lines(text: &str) -> String {
    escaped(text, |letter| {
        is_invisible(letter) && !matches!(letter, '\n' | '\t')
    })
}

fn escaped(text: &str, is_escaped: fn(char) -> bool) -> String {
    let mut shown = String::with_capacity(text.len());
    for letter in text.chars() {
        if is_escaped(letter) {
            shown.extend(letter.escape_default());
        } else {
            shown.push(letter);
        }
    }
    shown
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_no_shape_is_an_escape() {
        let told = "a\n\tb\u{1b}[31m\u{202e}é\u{2028}\u{200b}";
        let rest = "b\\u{1b}[31m\\u{202e}é\\u{2028}\\u{200b}";
        assert_eq!(printable_line(told), format!("a\\n\\t{rest}"));
        assert_eq!(printable_lines(told), format!("a\n\t{rest}"));
    }
}
