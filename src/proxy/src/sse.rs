//! Server-sent events as they are on the wire: where one ends, what it says, and another in its
//! place that is as long, so that nothing around it has to change. Sans-IO.

/// Finds the ends of events.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Scanner {
    /// Whether nothing stands in the current line.
    empty_line: bool,
    /// Whether the byte before was a carriage return, to which a line feed may belong.
    after_return: bool,
    /// Whether that return ended an event.
    after_end: bool,
}

/// What a byte does.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) enum Byte {
    /// Stands in an event.
    Within,
    /// Ends the event that is being read.
    Ends,
    /// Belongs to the end of the event before.
    Behind,
}

impl Scanner {
    pub(crate) fn take(&mut self, byte: u8) -> Byte {
        let (after_return, after_end) = (self.after_return, self.after_end);
        (self.after_return, self.after_end) = (byte == b'\r', false);
        match byte {
            b'\n' if after_return => {
                if after_end {
                    Byte::Behind
                } else {
                    Byte::Within
                }
            }
            b'\n' | b'\r' if self.empty_line => {
                self.after_end = byte == b'\r';
                Byte::Ends
            }
            b'\n' | b'\r' => {
                self.empty_line = true;
                Byte::Within
            }
            _ => {
                self.empty_line = false;
                Byte::Within
            }
        }
    }
}

/// An event: its name, its data, and its id, which is empty where it has none.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Event {
    pub name: String,
    pub data: Vec<u8>,
    pub id: Vec<u8>,
}

impl Event {
    /// Reads the bytes of one event; a comment alone is an event without data.
    pub(crate) fn read(bytes: &[u8]) -> Event {
        let mut event = Event {
            name: "message".to_owned(),
            data: Vec::new(),
            id: Vec::new(),
        };
        let (mut first, mut rest) = (true, bytes);
        while !rest.is_empty() {
            let end = memchr::memchr2(b'\n', b'\r', rest).unwrap_or(rest.len());
            let line = &rest[..end];
            rest = rest.get(end + 1..).unwrap_or_default();
            let (field, value) = match line.iter().position(|byte| *byte == b':') {
                Some(at) => (
                    &line[..at],
                    line[at + 1..].strip_prefix(b" ").unwrap_or(&line[at + 1..]),
                ),
                None => (line, &line[line.len()..]),
            };
            match field {
                b"event" => event.name = String::from_utf8_lossy(value).into_owned(),
                b"id" => event.id = value.to_vec(),
                b"data" => {
                    if !first {
                        event.data.push(b'\n');
                    }
                    first = false;
                    event.data.extend_from_slice(value);
                }
                _ => {}
            }
        }
        event
    }
}

/// An event that is exactly so long; none where that is too short.
pub(crate) fn fitted(name: &str, data: &str, length: usize) -> Option<Vec<u8>> {
    let event = format!("event: {name}\ndata: {data}\n\n");
    let room = length.checked_sub(event.len())?;
    // A comment, which readers pass over.
    let filling = match room {
        0 => String::new(),
        1 => "\n".to_owned(),
        _ => format!(":{}\n", " ".repeat(room - 2)),
    };
    Some(format!("{filling}{event}").into_bytes())
}

/// What an absolute address names behind the server: the path and the query. None where it is none.
pub(crate) fn behind_the_server(address: &str) -> Option<&str> {
    let rest = ["http://", "https://"].iter().find_map(|scheme| {
        let head = address.get(..scheme.len())?;
        head.eq_ignore_ascii_case(scheme)
            .then(|| &address[scheme.len()..])
    })?;
    let path = rest.find(['/', '?']).map_or("", |at| &rest[at..]);
    Some(if path.is_empty() { "/" } else { path })
}

/// The target that a reference in an answer to `base` names.
pub(crate) fn resolve(base: &str, reference: &str) -> String {
    if let Some(path) = behind_the_server(reference) {
        return path.to_owned();
    }
    if reference.starts_with('/') {
        return reference.to_owned();
    }
    let path = base.split('?').next().unwrap_or_default();
    let folder = path.rfind('/').map_or("/", |at| &path[..=at]);
    if reference.starts_with('?') {
        format!("{path}{reference}")
    } else {
        format!("{folder}{reference}")
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn every_event_is_found_and_nothing_panics(data in prop::collection::vec("[a-z:{} ]{0,20}", 1..6), noise in prop::collection::vec(any::<u8>(), 0..200)) {
            let stream: String = data.iter().map(|data| format!("data: {data}\n\n")).collect();
            let found: Vec<Vec<u8>> = events(stream.as_bytes()).into_iter().map(|event| event.data).collect();
            prop_assert_eq!(found, data.iter().map(|data| data.as_bytes().to_vec()).collect::<Vec<_>>());
            let mut scanner = Scanner::default();
            let _: Vec<Byte> = noise.iter().map(|byte| scanner.take(*byte)).collect();
            let _ = Event::read(&noise);
        }
    }

    fn events(stream: &[u8]) -> Vec<Event> {
        let (mut scanner, mut event, mut events) = (Scanner::default(), Vec::new(), Vec::new());
        for byte in stream {
            let what = scanner.take(*byte);
            if what != Byte::Behind {
                event.push(*byte);
            }
            if what == Byte::Ends {
                events.push(Event::read(&std::mem::take(&mut event)));
            }
        }
        assert!(event.is_empty(), "{event:?} is left");
        events
    }

    #[test]
    fn events_end_with_an_empty_line_of_any_kind() {
        for end in ["\n", "\r\n", "\r"] {
            let stream = ": ping|event: endpoint|data: /messages/?a=1||data:one|data: two||"
                .replace('|', end);
            let [hello, message] = &events(stream.as_bytes())[..] else {
                panic!("{end:?}")
            };
            assert_eq!(
                (hello.name.as_str(), hello.data.as_slice()),
                ("endpoint", b"/messages/?a=1".as_slice())
            );
            assert_eq!(
                (message.name.as_str(), message.data.as_slice()),
                ("message", b"one\ntwo".as_slice())
            );
        }
    }

    #[test]
    fn another_event_of_the_same_length() {
        for length in 28..40 {
            let bytes = fitted("message", "{}", length).unwrap();
            assert_eq!(bytes.len(), length);
            let last = events(&bytes).pop().unwrap();
            assert_eq!(last.data, b"{}");
        }
        assert_eq!(fitted("message", "{}", 20), None);
    }

    #[test]
    fn addresses() {
        assert_eq!(
            behind_the_server("HTTP://robot:8000/messages/?session_id=1"),
            Some("/messages/?session_id=1")
        );
        assert_eq!(behind_the_server("http://robot"), Some("/"));
        assert_eq!(behind_the_server("/messages"), None);
        assert_eq!(resolve("/w/a/sse?x", "messages?y"), "/w/a/messages?y");
        assert_eq!(resolve("/sse", "/messages/?y"), "/messages/?y");
        assert_eq!(resolve("/sse", "?y"), "/sse?y");
    }
}
