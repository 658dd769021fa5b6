//! Rows of JSON files one by one: the items of a JSON list, or the lines of JSONL. A broken row
//! does not end the reading. [`JsonTexts`] gives the text of each row, [`JsonRows`] its value.
//!
//! Holds one row at a time; a row beyond [`ROW_BYTES_MAX`] ends its file.

use std::io::{self, BufRead};

use serde_json::Value;

/// Longest row that is read, in bytes: far beyond any context, images inside included.
const ROW_BYTES_MAX: usize = 256 << 20;

/// A row as JSON with the line where it begins, or what is wrong with it.
pub(crate) struct JsonRow {
    /// Line of its first byte, from 1.
    pub(crate) line: u32,
    pub(crate) value: Result<Value, JsonError>,
}

/// The bytes of a row with the line where it begins, or why the file ends before the row does.
pub struct JsonText {
    /// Line of its first byte, from 1.
    pub line: u32,
    column: usize,
    /// Whether the row is the last line of its file and has no line break.
    unended: bool,
    lines: bool,
    /// The row as it is written; not yet parsed.
    pub text: Result<Vec<u8>, JsonError>,
}

impl JsonText {
    /// An error of a parser that read [`JsonText::text`], at its place in the file.
    pub fn error(&self, error: &serde_json::Error) -> JsonError {
        let eof = self.lines && error.is_eof();
        let torn = if eof && self.unended {
            "the last line is torn off: "
        } else {
            ""
        };
        let expected = if eof {
            "; expected one whole JSON object a line"
        } else {
            ""
        };
        let mut found = broken(error, (self.line, self.column), torn, expected);
        // the parser takes the line break after a row for the beginning of another line
        if self.lines && found.line != self.line {
            let row = self.text.as_deref().unwrap_or_default().trim_ascii_end();
            (found.line, found.column) = (self.line, self.column + row.len());
        }
        found
    }
}

/// Why a row is no JSON.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct JsonError {
    /// Line of the offending character, from 1.
    pub line: u32,
    /// Its column, from 1; 0 where there is none.
    pub column: usize,
    /// What is wrong and what was expected.
    pub message: String,
}

/// What the file is as a whole.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Layout {
    Unknown,
    List,
    Lines,
    Over,
}

/// The rows of a JSON file.
pub(crate) struct JsonRows<R>(JsonTexts<R>);

impl<R: BufRead> JsonRows<R> {
    pub(crate) fn new(reader: R) -> Self {
        Self(JsonTexts::new(reader))
    }
}

impl<R: BufRead> Iterator for JsonRows<R> {
    type Item = JsonRow;

    fn next(&mut self) -> Option<JsonRow> {
        let mut row = self.0.next()?;
        let text = std::mem::replace(&mut row.text, Ok(Vec::new()));
        let value =
            text.and_then(|text| serde_json::from_slice(&text).map_err(|error| row.error(&error)));
        Some(JsonRow {
            line: row.line,
            value,
        })
    }
}

/// The rows of a JSON file as texts.
pub struct JsonTexts<R> {
    reader: R,
    layout: Layout,
    line: u32,
    column: usize,
}

impl<R: BufRead> JsonTexts<R> {
    /// Begins at the start of a file, whose first character says whether it is one JSON list.
    pub fn new(reader: R) -> Self {
        Self {
            reader,
            layout: Layout::Unknown,
            line: 1,
            column: 1,
        }
    }

    /// The next row; an error of the disk ends the file.
    fn read(&mut self) -> io::Result<Option<JsonText>> {
        if self.layout == Layout::Unknown {
            if self.reader.fill_buf()?.starts_with(b"\xef\xbb\xbf") {
                self.reader.consume(3);
            }
            self.layout = match self.peek_past_space()? {
                Some(b'[') => {
                    self.take_byte()?;
                    Layout::List
                }
                _ => Layout::Lines,
            };
        }
        match self.layout {
            Layout::List => self.item(),
            Layout::Lines => self.row_of_line(),
            Layout::Unknown | Layout::Over => Ok(None),
        }
    }

    /// The next line that is not empty.
    fn row_of_line(&mut self) -> io::Result<Option<JsonText>> {
        loop {
            let mut text = Vec::new();
            let start = self.line;
            let limit = u64::try_from(ROW_BYTES_MAX).unwrap_or(u64::MAX);
            let read = io::Read::take(&mut self.reader, limit).read_until(b'\n', &mut text)?;
            if read == 0 {
                self.layout = Layout::Over;
                return Ok(None);
            }
            let whole = text.ends_with(b"\n");
            self.line = self.line.saturating_add(1);
            if !whole && read == ROW_BYTES_MAX {
                self.layout = Layout::Over;
                return Ok(Some(too_long(start)));
            }
            if text.trim_ascii().is_empty() {
                continue;
            }
            return Ok(Some(JsonText {
                line: start,
                column: 1,
                unended: !whole,
                lines: true,
                text: Ok(text),
            }));
        }
    }

    /// The next item of the list.
    fn item(&mut self) -> io::Result<Option<JsonText>> {
        loop {
            match self.peek_past_space()? {
                Some(b',') => self.take_byte()?,
                Some(b']') => {
                    self.layout = Layout::Over;
                    return Ok(None);
                }
                Some(_) => break,
                None => {
                    self.layout = Layout::Over;
                    return Ok(Some(self.torn(
                        self.line,
                        "the list has no end: expected ] after the last row",
                    )));
                }
            }
        }
        let start = (self.line, self.column);
        let mut text = Vec::new();
        if !self.take_item(&mut text)? {
            self.layout = Layout::Over;
            let long = text.len() >= ROW_BYTES_MAX;
            return Ok(Some(if long {
                too_long(start.0)
            } else {
                self.torn(start.0, "the last row is torn off: it has no end")
            }));
        }
        Ok(Some(JsonText {
            line: start.0,
            column: start.1,
            unended: false,
            lines: false,
            text: Ok(text),
        }))
    }

    /// Bytes up to the comma or bracket that ends an item; whether there was one.
    fn take_item(&mut self, text: &mut Vec<u8>) -> io::Result<bool> {
        let (mut depth, mut quoted, mut escaped) = (0_usize, false, false);
        loop {
            let buffer = self.reader.fill_buf()?;
            if buffer.is_empty() || text.len() >= ROW_BYTES_MAX {
                return Ok(false);
            }
            let mut used = 0;
            let mut ended = false;
            for byte in buffer {
                if quoted {
                    match byte {
                        _ if escaped => escaped = false,
                        b'\\' => escaped = true,
                        b'"' => quoted = false,
                        _ => {}
                    }
                } else {
                    match byte {
                        b'"' => quoted = true,
                        b'{' | b'[' => depth += 1,
                        b',' | b']' if depth == 0 => ended = true,
                        b'}' | b']' => depth = depth.saturating_sub(1),
                        _ => {}
                    }
                }
                if ended {
                    break;
                }
                used += 1;
                if *byte == b'\n' {
                    self.line = self.line.saturating_add(1);
                    self.column = 1;
                } else {
                    self.column += 1;
                }
            }
            text.extend_from_slice(&buffer[..used]);
            self.reader.consume(used);
            if ended {
                return Ok(true);
            }
        }
    }

    fn peek_past_space(&mut self) -> io::Result<Option<u8>> {
        loop {
            match self.reader.fill_buf()?.first() {
                Some(byte) if byte.is_ascii_whitespace() => self.take_byte()?,
                other => return Ok(other.copied()),
            }
        }
    }

    fn take_byte(&mut self) -> io::Result<()> {
        if self.reader.fill_buf()?.first() == Some(&b'\n') {
            self.line = self.line.saturating_add(1);
            self.column = 1;
        } else {
            self.column += 1;
        }
        self.reader.consume(1);
        Ok(())
    }

    fn torn(&self, start: u32, message: &str) -> JsonText {
        ended(
            start,
            JsonError {
                line: self.line,
                column: self.column,
                message: message.to_owned(),
            },
        )
    }
}

/// A row that the file does not hold whole.
fn ended(line: u32, error: JsonError) -> JsonText {
    JsonText {
        line,
        column: 1,
        unended: false,
        lines: false,
        text: Err(error),
    }
}

impl<R: BufRead> Iterator for JsonTexts<R> {
    type Item = JsonText;

    fn next(&mut self) -> Option<JsonText> {
        self.read().unwrap_or_else(|error| {
            self.layout = Layout::Over;
            Some(self.torn(self.line, &format!("the file cannot be read on: {error}")))
        })
    }
}

fn too_long(line: u32) -> JsonText {
    let message = format!(
        "a row of more than {} MiB: the rest of the file is not read",
        ROW_BYTES_MAX >> 20
    );
    ended(
        line,
        JsonError {
            line,
            column: 0,
            message,
        },
    )
}

/// An error of the parser at its place in the file; `start` is where the row begins.
fn broken(error: &serde_json::Error, start: (u32, usize), before: &str, after: &str) -> JsonError {
    let down = u32::try_from(error.line().saturating_sub(1)).unwrap_or(u32::MAX);
    let column = if down == 0 {
        start.1 + error.column().saturating_sub(1)
    } else {
        error.column()
    };
    let text = error.to_string();
    let text = text.split(" at line ").next().unwrap_or_default();
    JsonError {
        line: start.0.saturating_add(down),
        column,
        message: format!("{before}not JSON: {text}{after}"),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Line of a row, and the row or the line and column of what is wrong.
    type Read = (u32, Result<Value, (u32, usize)>);

    fn rows(text: &str) -> Vec<Read> {
        let rows = JsonRows::new(text.as_bytes());
        rows.map(|row| {
            (
                row.line,
                row.value.map_err(|broken| (broken.line, broken.column)),
            )
        })
        .collect()
    }

    #[test]
    fn a_list_and_lines_give_the_same_rows() {
        let list = "\u{feff}[\n  {\"a\": \"],}\\\"\"},\n\n {\"b\": [1, {}]}\n]\n";
        let lines = "{\"a\": \"],}\\\"\"}\n\n\n{\"b\": [1, {}]}";
        let values = |text| {
            rows(text)
                .into_iter()
                .map(|(_, value)| value.expect("whole"))
                .collect::<Vec<_>>()
        };
        assert_eq!(values(list), values(lines));
        assert_eq!(
            rows(list).iter().map(|row| row.0).collect::<Vec<_>>(),
            [2, 4]
        );
        assert_eq!(
            rows(lines).iter().map(|row| row.0).collect::<Vec<_>>(),
            [1, 4]
        );
        assert_eq!(rows("[]"), []);
        assert_eq!(rows(""), []);
    }

    #[test]
    fn a_broken_row_is_told_with_its_place_and_the_rest_goes_on() {
        let lines = rows("{\"a\": 1}\n{\"a\": x}\n{\"a\": 3}\n{\"a\": ");
        assert_eq!(lines[1], (2, Err((2, 7))));
        assert!(lines[2].1.is_ok());
        assert!(lines[3].1.is_err());
        assert_eq!(lines.len(), 4);
        let list = rows("[{\"a\": 1},\n {\"a\": x},\n {\"a\": 3}, {\"a\":");
        assert_eq!(list[1], (2, Err((2, 8))));
        assert!(list[2].1.is_ok());
        assert_eq!(list.len(), 4);
        let torn = JsonRows::new(&b"{\"a\": 1}\n{\"a\": 2"[..])
            .last()
            .expect("two rows");
        assert!(
            torn.value
                .expect_err("torn")
                .message
                .starts_with("the last line is torn off")
        );
    }

    proptest! {
        #[test]
        fn any_bytes_end(bytes in proptest::collection::vec(prop_oneof![any::<u8>(), Just(b'['), Just(b'{'), Just(b'"'), Just(b'\n')], 0..300)) {
            prop_assert!(JsonRows::new(&bytes[..]).count() <= bytes.len() + 1);
        }
    }
}
