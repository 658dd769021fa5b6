//! Tokens and keys in the bytes and names of files, and shapes of absolute paths of a machine. What a match holds is never
//! reported.

use std::{borrow::Cow, sync::LazyLock};

use reel_redact::{Rules, SECRET_SHAPES};
use regex::bytes::{Regex, RegexBuilder, RegexSet, RegexSetBuilder};

/// The shapes that are found in any bytes, as they stand in [`SET`].
static SHAPES: LazyLock<Vec<(&str, &str)>> = LazyLock::new(|| {
    let shapes = SECRET_SHAPES.iter();
    shapes
        .filter_map(|shape| Some((shape.kind, shape.in_bytes?)))
        .collect()
});

/// First folders of absolute paths that lie on one machine.
const ROOTS: &str = "Users|Volumes|content|data|datasets|dbfs|etc|fsx|gpfs|home|kaggle|lustre|media|mnt|nfs|opt|private|proj\
    |projects|root|scratch|srv|storage|tmp|usr|var|work|workspace";

static SET: LazyLock<RegexSet> = LazyLock::new(|| {
    RegexSetBuilder::new(SHAPES.iter().map(|(_, shape)| shape))
        .unicode(false)
        .build()
        .expect("the shapes are regular expressions")
});

static PATHS: LazyLock<Regex> = LazyLock::new(|| {
    // before it nothing that makes it a part of a web address or of a relative path
    let unix = format!(r#"(?:^|[\s"'`(=:,;<>\[{{|])(?:file://)?/(?:{ROOTS})/[^\s"'`<>|]"#);
    let windows = r#"\b[A-Za-z]:\\{1,2}[A-Za-z0-9_.][^\s"'`<>|:*?]*\\"#;
    RegexBuilder::new(&format!("{unix}|{windows}"))
        .unicode(false)
        .multi_line(true)
        .build()
        .expect("the shapes are regular expressions")
});

/// The kinds of secrets in these bytes.
pub(crate) fn secrets_in(bytes: &[u8]) -> Vec<&'static str> {
    let mut found: Vec<&'static str> = SET
        .matches(bytes)
        .into_iter()
        .map(|index| SHAPES[index].0)
        .collect();
    found.dedup();
    found
}

/// A path as a report may show it: secrets in names are labels.
pub(crate) fn without_secrets(path: &str) -> Cow<'_, str> {
    static RULES: LazyLock<Rules> = LazyLock::new(Rules::built_in);
    if secrets_in(path.as_bytes()).is_empty() {
        Cow::Borrowed(path)
    } else {
        Cow::Owned(RULES.without_secrets(path))
    }
}

/// The first absolute path of a machine in a text, shortened to its first two folders.
pub(crate) fn local_path_in(text: &str) -> Option<String> {
    let found = PATHS.find(text.as_bytes())?;
    let from = text.as_bytes().get(found.start()..)?;
    let path = String::from_utf8_lossy(&from[..from.len().min(256)]);
    let path = path.trim_start_matches(|c: char| !c.is_ascii_alphanumeric() && c != '/');
    let end = path.find(|c: char| c.is_whitespace() || "\"'`<>|".contains(c));
    let path = &path[..end.unwrap_or(path.len())];
    let parts: Vec<&str> = path.split_inclusive(['/', '\\']).take(3).collect();
    let short = parts.concat();
    Some(if short.len() < path.len() {
        format!("{short}...")
    } else {
        short
    })
}

/// Looks for secrets in bytes that come in pieces; what lies across two pieces is found too.
#[derive(Default)]
pub(crate) struct SecretScanner {
    tail: Vec<u8>,
    found: Vec<&'static str>,
}

/// Longest secret that is found across two pieces.
const OVERLAP: usize = 4096;

impl SecretScanner {
    pub(crate) fn feed(&mut self, piece: &[u8]) {
        self.tail.extend_from_slice(piece);
        for kind in secrets_in(&self.tail) {
            if !self.found.contains(&kind) {
                self.found.push(kind);
            }
        }
        let keep_from = self.tail.len().saturating_sub(OVERLAP);
        self.tail.drain(..keep_from);
    }

    pub(crate) fn finish(self) -> Vec<&'static str> {
        self.found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// In two parts, so that no scanner takes this file for a leak.
    fn tokens() -> Vec<String> {
        let letters = "aB3".repeat(30);
        [
            ("hf", "_", 34),
            ("sk", "-proj-", 48),
            ("sk", "-ant-api03-", 60),
            ("ghp", "_", 36),
            ("glpat", "-", 20),
            ("AI", "za", 35),
            ("nvapi", "-", 60),
            ("gsk", "_", 52),
        ]
        .iter()
        .map(|(one, two, length)| format!("{one}{two}{}", &letters[..*length]))
        .chain([
            format!("AK{}{}", "IA", "Z2".repeat(8)),
            format!("-----BEGIN {} KEY-----", "RSA PRIVATE"),
            format!("https://me:{}@example.org/x", "s3cret"),
            format!("postgres://admin:{}@db.example.com:5432/x", "Zk39slQpz71"),
            format!("mongodb+srv://u:{}@h", "p"),
            format!("redis://:{}@h", "pw"),
            format!("re{}_{}", "el", "0f".repeat(32)),
        ])
        .collect()
    }

    #[test]
    fn tokens_are_found_wherever_they_are_cut() {
        for token in tokens() {
            let text = format!("{} \"{token}\" {}", "x".repeat(100), "y".repeat(100));
            assert_eq!(secrets_in(text.as_bytes()).len(), 1, "{token}");
            for cut in 90..120 + token.len() {
                let (one, two) = text.as_bytes().split_at(cut.min(text.len()));
                let mut scanner = SecretScanner::default();
                scanner.feed(one);
                scanner.feed(two);
                assert_eq!(scanner.finish().len(), 1, "{token} cut at {cut}");
            }
        }
    }

    #[test]
    fn words_and_digests_are_no_secrets() {
        for text in [
            "hf_hub downloads hf_transfer",
            "the desk-lamp-on-the-left-side-of-the-very-long-table-in-the-kitchen",
            "risk-averse-policies-are-not-what-one-wants-in-a-household-with-children",
            "https://huggingface.co/datasets/a/b@main https://example.org:8080/x",
            "46007a202c8bdb9319231d1337aa222c7c50acf6b1ab1bda4172d55687fd583a",
            "reel_publish AKIA",
            "postgres://db.example.org:5432/x redis://h:6379 mailto:me@example.org ssh://git@h:22/x",
        ] {
            assert_eq!(secrets_in(text.as_bytes()), Vec::<&str>::new(), "{text}");
        }
    }

    #[test]
    fn absolute_paths_are_told_from_addresses_and_relative_ones() {
        let home = concat!("/ho", "me");
        for (text, shown) in [
            (
                format!("--prompt {home}/me/x.txt"),
                format!("{home}/me/..."),
            ),
            (format!("\"{home}/me\""), format!("{home}/me")),
            (
                "see file:///tmp/a/b.mcap".to_owned(),
                "file:///...".to_owned(),
            ),
            ("--store=/mnt/store".to_owned(), "/mnt/store".to_owned()),
            (
                r"C:\Users\me\traces".to_owned(),
                r"C:\Users\me\...".to_owned(),
            ),
        ] {
            assert_eq!(local_path_in(&text), Some(shown), "{text}");
        }
        for text in [
            "https://example.org/data/x.html".to_owned(),
            "s3://bucket/data/x.mcap".to_owned(),
            "traces/data/x.mcap and ../tmp/x".to_owned(),
            format!("a{home}/x"),
            "and/or, 1/2, /think, </think>, kitchen/0: table_1".to_owned(),
            "3:\\n".to_owned(),
        ] {
            assert_eq!(local_path_in(&text), None, "{text}");
        }
    }
}
