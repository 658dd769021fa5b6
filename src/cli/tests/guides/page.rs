//! A Markdown page as the test reads it: its fenced blocks in order, and comments that begin with
//! `test:`. They stand before the block that they are about:
//!
//! - `<!-- test: setup` and commands up to `-->`: run without being shown; `$DEMO` is the folder of
//!   `reel demo`;
//! - `<!-- test: parse only: REASON -->`: the commands of the block are parsed and not run;
//! - `<!-- test: parse only "WORDS": REASON -->`: those that contain the words;
//! - `<!-- test: file NAME -->`: the block is the content of a file that commands use;
//! - `<!-- test: read by COMMAND -->`: this command reads the block; `{}` is its file.

/// A page with its blocks.
pub struct Page {
    /// Path from the root of the repository.
    pub path: String,
    /// The Markdown of the page, as the file has it.
    pub text: String,
    /// Fenced blocks and setups, in order.
    pub blocks: Vec<Block>,
}

/// A fenced block with what the comment before it asks for.
pub struct Block {
    /// Number of the line with the opening fence.
    pub line: usize,
    /// The info string; `setup` for the commands of a comment.
    pub language: String,
    /// Lines between the fences.
    pub text: String,
    /// What comments before it say.
    pub notes: Vec<Note>,
}

/// A comment about a block.
#[derive(Clone)]
pub enum Note {
    /// Commands that contain `words` are parsed and not run.
    ParseOnly {
        /// Empty if all commands of the block are meant.
        words: String,
    },
    /// The block is a file of this name.
    File(String),
    /// A command that reads the block.
    ReadBy(String),
}

impl Page {
    /// Reads the blocks of a page.
    ///
    /// # Panics
    /// Panics if a comment is unknown, stands before no block, or a block has no end.
    pub fn parse(path: String, text: String) -> Self {
        let mut blocks: Vec<Block> = Vec::new();
        let mut notes: Vec<Note> = Vec::new();
        let mut lines = (1..).zip(text.lines());
        while let Some((line, content)) = lines.next() {
            let place = format!("{path}:{line}");
            if let Some(comment) = content.strip_prefix("<!-- test: ") {
                let mut comment = comment.to_owned();
                while !comment.contains("-->") {
                    let (_, more) = lines
                        .next()
                        .unwrap_or_else(|| panic!("{place}: no end of the comment"));
                    comment = format!("{comment}\n{more}");
                }
                let comment = comment.trim_end().trim_end_matches("-->").trim_end();
                match comment.strip_prefix("setup\n") {
                    Some(commands) => blocks.push(Block {
                        line,
                        language: "setup".to_owned(),
                        text: commands.to_owned(),
                        notes: Vec::new(),
                    }),
                    None => notes.push(Note::parse(comment).unwrap_or_else(|| {
                        panic!("{place}: `{comment}`: page.rs lists the comments")
                    })),
                }
            } else if let Some(language) = content.trim_start().strip_prefix("```") {
                assert!(content.starts_with('`'), "{place}: an indented block");
                let body: Vec<&str> = lines
                    .by_ref()
                    .map(|(_, content)| content)
                    .take_while(|content| *content != "```")
                    .collect();
                blocks.push(Block {
                    line,
                    language: language.to_owned(),
                    text: body.join("\n"),
                    notes: std::mem::take(&mut notes),
                });
            } else {
                let is_apart = content.is_empty() || notes.is_empty();
                assert!(is_apart, "{place}: a comment before it is about no block");
            }
        }
        assert!(
            notes.is_empty(),
            "{path}: the last comment is about no block"
        );
        drop(lines);
        Self { path, text, blocks }
    }
}

impl Note {
    fn parse(comment: &str) -> Option<Self> {
        if let Some(name) = comment.strip_prefix("file ") {
            return Some(Self::File(name.to_owned()));
        }
        if let Some(command) = comment.strip_prefix("read by ") {
            return Some(Self::ReadBy(command.to_owned()));
        }
        let rest = comment.strip_prefix("parse only")?;
        let (words, reason) = match rest.strip_prefix(" \"") {
            Some(quoted) => quoted.split_once("\": ")?,
            None => ("", rest.strip_prefix(": ")?),
        };
        let words = words.to_owned();
        (!reason.trim().is_empty()).then_some(Self::ParseOnly { words })
    }
}
