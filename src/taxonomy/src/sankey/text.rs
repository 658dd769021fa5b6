//! Owns what text of the diagram is fit to be shown: cleaned, measured, shortened, numbers
//! written out. Never draws.

/// How a text is set. Sizes in units of the scene.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Style {
    /// The title of the diagram.
    Title,
    /// Names that matter most.
    Strong,
    /// Names and counts in regular weight, and the subtitle.
    Plain,
    /// Headings of columns and notes.
    Small,
}

impl Style {
    /// Font size in the SVG.
    pub fn font_size(self) -> f64 {
        match self {
            Self::Title => 22.0,
            Self::Strong | Self::Plain => 13.0,
            Self::Small => 11.5,
        }
    }

    /// Height of a line, and of the bitmap font at scale 1.
    pub fn line_height(self) -> f64 {
        if self == Self::Title { 24.0 } else { 16.0 }
    }

    /// Whether it is bold.
    pub fn bold(self) -> bool {
        matches!(self, Self::Title | Self::Strong)
    }

    /// What a usual character takes at most on the average, in the bitmap font and in
    /// the common system fonts.
    fn advance(self) -> f64 {
        match self {
            Self::Title => 13.6,
            Self::Strong => 8.4,
            Self::Plain => 7.8,
            Self::Small => 7.2,
        }
    }
}

/// Stands for what is left out of a shortened name.
pub const ELLIPSIS: char = '…';

/// A name on one line that every XML parser and every eye can take: white space becomes a single
/// space, and what has no shape or turns the direction of its neighbours becomes U+FFFD.
pub fn clean(text: &str) -> String {
    let words: Vec<&str> = text.split_whitespace().collect();
    let shown = |c: char| {
        if reel_world::is_invisible(c) {
            '\u{fffd}'
        } else {
            c
        }
    };
    let cleaned: String = words.join(" ").chars().map(shown).collect();
    if cleaned.is_empty() {
        "(unnamed)".to_owned()
    } else {
        cleaned
    }
}

/// Cuts the middle out of a text that would be wider than `room`: what tells names apart is
/// mostly at either end.
pub fn elide(text: &str, style: Style, room: f64) -> String {
    if width(text, style) <= room {
        return text.to_owned();
    }
    let characters: Vec<char> = text.chars().collect();
    let shortened = |kept: usize| -> String {
        let tail = kept / 3;
        let (head, tail) = (
            &characters[..kept - tail],
            &characters[characters.len() - tail..],
        );
        head.iter().chain(&[ELLIPSIS]).chain(tail).collect()
    };
    // Few enough characters that their number never decides about the time.
    let longest = (room / style.advance()).max(0.0) as usize;
    (0..=longest.min(characters.len()))
        .rev()
        .map(shortened)
        .find(|text| width(text, style) <= room)
        .unwrap_or_default()
}

/// What a text takes at most, in units of the scene.
pub fn width(text: &str, style: Style) -> f64 {
    let advances = |c: char| match c {
        ELLIPSIS => 3.0,
        'W' | 'M' | 'm' | 'w' | '@' | '%' => 1.6,
        'A'..='Z' => 1.2,
        _ if c >= '\u{1100}' => 2.2,
        _ if !c.is_ascii() => 1.3,
        _ => 1.0,
    };
    text.chars().map(advances).sum::<f64>() * style.advance()
}

/// Formats a count with thousands separators: `1234567` as `1,234,567`.
pub fn count(number: u64) -> String {
    let digits = number.to_string();
    let mut text = String::new();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

/// `1 episode`, `2 episodes`.
pub fn counted(number: u64, noun: &str, plural: &str) -> String {
    format!(
        "{} {}",
        count(number),
        if number == 1 { noun } else { plural }
    )
}

/// A part of a whole in percent with one decimal.
pub fn share(part: u64, whole: u64) -> String {
    let percent = 100.0 * part as f64 / whole.max(1) as f64;
    if part > 0 && percent < 0.05 {
        "<0.1%".to_owned()
    } else {
        format!("{percent:.1}%")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_one_visible_line() {
        assert_eq!(clean(" a\n\tb  c "), "a b c");
        assert_eq!(
            clean("a\u{0}\u{1b}\u{202e}b\u{ffff}"),
            "a\u{fffd}\u{fffd}\u{fffd}b\u{fffd}"
        );
        assert_eq!(clean("\n"), "(unnamed)");
    }

    #[test]
    fn a_long_name_keeps_both_ends_and_fits() {
        let name = format!("begin_{}_end", "x".repeat(80));
        let short = elide(&name, Style::Plain, 160.0);
        assert!(
            short.starts_with("begin_") && short.ends_with("_end") && short.contains(ELLIPSIS),
            "{short}"
        );
        assert!(width(&short, Style::Plain) <= 160.0);
        assert!(width(&elide(&"W".repeat(80), Style::Strong, 90.0), Style::Strong) <= 90.0);
        assert_eq!(elide("abc", Style::Plain, 160.0), "abc");
        assert_eq!(elide("abc", Style::Plain, 1.0), "");
    }

    #[test]
    fn numbers_are_written_for_people() {
        assert_eq!(
            [0, 999, 1000, 1_234_567].map(count),
            ["0", "999", "1,000", "1,234,567"]
        );
        assert_eq!(count(u64::MAX), "18,446,744,073,709,551,615");
        assert_eq!(
            (share(25, 53), share(1, 100_000), share(0, 0)),
            ("47.2%".into(), "<0.1%".into(), "0.0%".into())
        );
    }
}
