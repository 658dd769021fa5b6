//! JSON written straight into a buffer, so that what is the same in many rows is
//! escaped once. Never parses.

/// Appends a text's JSON escapes, without quotes.
pub(crate) fn escape(out: &mut Vec<u8>, text: &str) {
    let bytes = text.as_bytes();
    let mut from = 0;
    for (at, byte) in bytes.iter().enumerate() {
        let short = match byte {
            b'"' => b'"',
            b'\\' => b'\\',
            b'\n' => b'n',
            b'\r' => b'r',
            b'\t' => b't',
            0..0x20 => b'u',
            _ => continue,
        };
        out.extend_from_slice(&bytes[from..at]);
        out.extend_from_slice(&[b'\\', short]);
        if short == b'u' {
            const HEX: &[u8; 16] = b"0123456789abcdef";
            out.extend_from_slice(&[
                b'0',
                b'0',
                HEX[usize::from(byte >> 4)],
                HEX[usize::from(byte & 15)],
            ]);
        }
        from = at + 1;
    }
    out.extend_from_slice(&bytes[from..]);
}

/// Appends a JSON string.
pub(crate) fn string(out: &mut Vec<u8>, text: &str) {
    out.push(b'"');
    escape(out, text);
    out.push(b'"');
}

/// The text as a JSON string, in quotes and escaped.
pub fn quoted(text: &str) -> String {
    let mut out = Vec::with_capacity(text.len() + 2);
    string(&mut out, text);
    String::from_utf8(out).expect("escapes of UTF-8 are UTF-8")
}

#[cfg(test)]
mod tests {
    #[test]
    fn as_serde_json_writes_it() {
        let text: String = (0..0x250)
            .filter_map(char::from_u32)
            .chain("\u{1f600}\"\\".chars())
            .collect();
        assert_eq!(
            serde_json::from_str::<String>(&super::quoted(&text)).unwrap(),
            text
        );
        assert_eq!(super::quoted("a\"b\n\u{1}"), r#""a\"b\n\u0001""#);
    }
}
