//! HTTP/1.1 as it is on the wire: where a head ends, what it says, where a body ends. Sans-IO;
//! changes no byte by itself, and believes nothing: what it cannot read, it says so.

use std::ops::Range;

/// Bytes after which an incomplete head counts as unreadable.
pub(crate) const HEAD_MAX: usize = 64 << 10;
const HEADERS_MAX: usize = 128;

/// What came is not HTTP/1.1 as it can be followed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Unreadable;

/// First line of a head.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Start {
    Request { method: String, target: String },
    Response { status: u16 },
}

/// A head, and where its values stand in its bytes.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) struct Head {
    pub start: Start,
    /// With the empty line.
    pub bytes: Vec<u8>,
    headers: Vec<(String, Range<usize>)>,
}

impl Head {
    /// The head of a request at the beginning of a buffer, if it is whole.
    pub(crate) fn request(buffer: &[u8]) -> Result<Option<Head>, Unreadable> {
        let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
        let mut request = httparse::Request::new(&mut headers);
        let length = match request.parse(buffer) {
            Ok(httparse::Status::Complete(length)) => length,
            Ok(httparse::Status::Partial) => return partial(buffer),
            Err(_) => return Err(Unreadable),
        };
        let (method, target) = (
            request.method.unwrap_or_default().to_owned(),
            request.path.unwrap_or_default().to_owned(),
        );
        Ok(Some(Self::new(
            Start::Request { method, target },
            buffer,
            length,
            request.headers,
        )))
    }

    /// The head of a response at the beginning of a buffer, if it is whole.
    pub(crate) fn response(buffer: &[u8]) -> Result<Option<Head>, Unreadable> {
        let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
        let mut response = httparse::Response::new(&mut headers);
        let length = match response.parse(buffer) {
            Ok(httparse::Status::Complete(length)) => length,
            Ok(httparse::Status::Partial) => return partial(buffer),
            Err(_) => return Err(Unreadable),
        };
        Ok(Some(Self::new(
            Start::Response {
                status: response.code.unwrap_or_default(),
            },
            buffer,
            length,
            response.headers,
        )))
    }

    fn new(start: Start, buffer: &[u8], length: usize, headers: &[httparse::Header<'_>]) -> Head {
        let place = |value: &[u8]| {
            let from = (value.as_ptr() as usize).saturating_sub(buffer.as_ptr() as usize);
            from..from + value.len()
        };
        let headers = headers
            .iter()
            .map(|header| (header.name.to_ascii_lowercase(), place(header.value)))
            .collect();
        Head {
            start,
            bytes: buffer[..length].to_vec(),
            headers,
        }
    }

    /// The first value under a name in lower case, if it is text.
    pub(crate) fn value(&self, name: &str) -> Option<&str> {
        let (_, place) = self.headers.iter().find(|(found, _)| found == name)?;
        std::str::from_utf8(self.bytes.get(place.clone())?)
            .ok()
            .map(str::trim)
    }

    /// The secrets in the headers by the names of these: what authorizes, cookies, keys, the session.
    pub(crate) fn secrets(&self) -> Vec<(&str, &str)> {
        let mut secrets = Vec::new();
        for (name, place) in &self.headers {
            let value = std::str::from_utf8(&self.bytes[place.clone()]).unwrap_or_default();
            let value = value.trim();
            match name.as_str() {
                // Behind the scheme, if it has one.
                "authorization" | "proxy-authorization" => {
                    secrets.push((name.as_str(), value.rsplit(' ').next().unwrap_or(value)));
                }
                "cookie" => {
                    let pairs = value.split(';').filter_map(|pair| pair.split_once('='));
                    secrets.extend(pairs.map(|(_, value)| (name.as_str(), value.trim())));
                }
                "mcp-session-id" => secrets.push(("session", value)),
                _ if ["key", "token", "secret", "password"]
                    .iter()
                    .any(|end| name.ends_with(end)) =>
                {
                    secrets.push((name.as_str(), value));
                }
                _ => {}
            }
        }
        secrets
    }

    /// Whether a header's list of words holds one.
    pub(crate) fn says(&self, name: &str, word: &str) -> bool {
        self.value(name).is_some_and(|value| {
            value
                .split(',')
                .any(|part| part.trim().eq_ignore_ascii_case(word))
        })
    }

    /// The type of the body, without parameters and in lower case.
    pub(crate) fn content_type(&self) -> String {
        self.value("content-type")
            .and_then(|value| value.split(';').next())
            .unwrap_or_default()
            .trim()
            .to_ascii_lowercase()
    }

    /// The bytes with other values under some names; everything else is as it came.
    pub(crate) fn with_values(&self, values: &[(&str, &str)]) -> Vec<u8> {
        let mut places: Vec<(Range<usize>, &str)> = Vec::new();
        for (name, place) in &self.headers {
            if let Some((_, value)) = values.iter().find(|(wanted, _)| wanted == name) {
                places.push((place.clone(), value));
            }
        }
        places.sort_by_key(|(place, _)| place.start);
        let mut bytes = Vec::with_capacity(self.bytes.len() + 64);
        let mut from = 0;
        for (place, value) in places {
            bytes.extend_from_slice(&self.bytes[from..place.start]);
            bytes.extend_from_slice(value.as_bytes());
            from = place.end;
        }
        bytes.extend_from_slice(&self.bytes[from..]);
        bytes
    }

    /// How long the body is. `to_head` is whether a response answers `HEAD`.
    pub(crate) fn body(&self, to_head: bool) -> Result<Body, Unreadable> {
        if let Start::Response { status } = self.start
            && (to_head || status < 200 || status == 204 || status == 304)
        {
            return Ok(Body::Length(0));
        }
        let lengths: Vec<&str> = self.all("content-length");
        if self.value("transfer-encoding").is_some() {
            // Both at once is how requests are smuggled past whoever stands between.
            return if self.says("transfer-encoding", "chunked") && lengths.is_empty() {
                Ok(Body::Chunked(Chunks::default()))
            } else {
                Err(Unreadable)
            };
        }
        match lengths[..] {
            [] if matches!(self.start, Start::Request { .. }) => Ok(Body::Length(0)),
            [] => Ok(Body::UntilClose),
            [length] => length.parse().map(Body::Length).map_err(|_| Unreadable),
            _ => Err(Unreadable),
        }
    }

    fn all(&self, name: &str) -> Vec<&str> {
        let found = self.headers.iter().filter(|(found, _)| found == name);
        found
            .map(|(_, place)| {
                std::str::from_utf8(&self.bytes[place.clone()])
                    .unwrap_or_default()
                    .trim()
            })
            .collect()
    }
}

fn partial(buffer: &[u8]) -> Result<Option<Head>, Unreadable> {
    if buffer.len() > HEAD_MAX {
        Err(Unreadable)
    } else {
        Ok(None)
    }
}

/// A body that is being followed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub(crate) enum Body {
    /// So many bytes are to come.
    Length(u64),
    Chunked(Chunks),
    UntilClose,
}

impl Body {
    /// Takes what came next: how many of these bytes belong to the body, and where in
    /// them its content stands.
    pub(crate) fn take(&mut self, wire: &[u8]) -> Result<(usize, Vec<Range<usize>>), Unreadable> {
        match self {
            Body::Length(left) => {
                let taken = usize::try_from(*left).unwrap_or(usize::MAX).min(wire.len());
                *left -= taken as u64;
                Ok((
                    taken,
                    std::iter::once(0..taken)
                        .filter(|range| !range.is_empty())
                        .collect(),
                ))
            }
            Body::UntilClose => Ok((
                wire.len(),
                std::iter::once(0..wire.len())
                    .filter(|range| !range.is_empty())
                    .collect(),
            )),
            Body::Chunked(chunks) => chunks.take(wire),
        }
    }

    /// Whether all of it came.
    pub(crate) fn is_whole(&self) -> bool {
        matches!(
            self,
            Body::Length(0) | Body::Chunked(Chunks { at: At::End, .. })
        )
    }

    /// Whether something of another kind could stand here: nothing of a chunk is half on its way.
    pub(crate) fn is_between(&self) -> bool {
        matches!(
            self,
            Body::UntilClose
                | Body::Chunked(Chunks {
                    at: At::Size { digits: 0 },
                    ..
                })
        )
    }
}

/// The chunked transfer coding.
#[derive(Clone, PartialEq, Eq, Debug, Default)]
pub(crate) struct Chunks {
    size: u64,
    at: At,
}

#[derive(Clone, PartialEq, Eq, Debug)]
enum At {
    /// In the digits of a size.
    Size { digits: u8 },
    /// Behind the size, in the same line.
    Extension,
    /// In the content; so many bytes are to come.
    Content(u64),
    /// In the line end behind the content.
    ContentEnd,
    /// In the lines behind the last chunk; how long this one is so far.
    Trailer(usize),
    /// Behind all of it.
    End,
}

impl Default for At {
    fn default() -> Self {
        At::Size { digits: 0 }
    }
}

impl Chunks {
    fn take(&mut self, wire: &[u8]) -> Result<(usize, Vec<Range<usize>>), Unreadable> {
        let (mut position, mut content) = (0, Vec::new());
        while position < wire.len() && self.at != At::End {
            if let At::Content(left) = &mut self.at {
                let here = usize::try_from(*left)
                    .unwrap_or(usize::MAX)
                    .min(wire.len() - position);
                *left -= here as u64;
                content.push(position..position + here);
                position += here;
                if *left == 0 {
                    self.at = At::ContentEnd;
                }
                continue;
            }
            let byte = wire[position];
            position += 1;
            self.at = match (&self.at, byte) {
                (At::Size { digits }, _) if byte.is_ascii_hexdigit() && *digits < 16 => {
                    let digit = char::from(byte).to_digit(16).unwrap_or_default();
                    self.size = if *digits == 0 { 0 } else { self.size << 4 } | u64::from(digit);
                    At::Size { digits: digits + 1 }
                }
                (At::Size { digits: 1.. }, b'\r' | b';' | b' ' | b'\t') => At::Extension,
                (At::Size { digits: 1.. } | At::Extension, b'\n') => match self.size {
                    0 => At::Trailer(0),
                    size => At::Content(size),
                },
                (At::Extension, _) => At::Extension,
                (At::ContentEnd, b'\r') => At::ContentEnd,
                (At::ContentEnd, b'\n') => At::Size { digits: 0 },
                (At::Trailer(0), b'\n') => At::End,
                (At::Trailer(_), b'\n') => At::Trailer(0),
                (At::Trailer(length), b'\r') => At::Trailer(*length),
                (At::Trailer(length), _) => At::Trailer(length + 1),
                _ => return Err(Unreadable),
            };
        }
        Ok((position, content))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn nothing_panics(bytes in prop::collection::vec(any::<u8>(), 0..300), text in "(HTTP/1.1 200|GET / HTTP/1.1|[ -~]|\r\n|:){0,60}") {
            for bytes in [bytes.as_slice(), text.as_bytes()] {
                for head in [Head::request(bytes), Head::response(bytes)].into_iter().flatten().flatten() {
                    let _ = (head.body(false), head.content_type(), head.with_values(&[("host", "x")]));
                }
                let _ = Body::Chunked(Chunks::default()).take(bytes);
            }
        }
    }

    #[test]
    fn a_head_and_its_values() {
        let bytes = b"POST /mcp?a=b HTTP/1.1\r\nHost: localhost:1\r\nX-Odd:  kept \r\nContent-Length: 3\r\n\r\nabc";
        assert_eq!(Head::request(&bytes[..30]), Ok(None));
        let head = Head::request(bytes).unwrap().unwrap();
        assert_eq!(
            head.start,
            Start::Request {
                method: "POST".into(),
                target: "/mcp?a=b".into()
            }
        );
        assert_eq!(
            (head.value("host"), head.value("x-odd"), head.body(false)),
            (Some("localhost:1"), Some("kept"), Ok(Body::Length(3)))
        );
        let other = String::from_utf8(head.with_values(&[("host", "robot:8000"), ("absent", "x")]))
            .unwrap();
        assert_eq!(
            other,
            "POST /mcp?a=b HTTP/1.1\r\nHost: robot:8000\r\nX-Odd:  kept \r\nContent-Length: 3\r\n\r\n"
        );
        assert_eq!(
            Head::request(b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"),
            Err(Unreadable)
        );
    }

    #[test]
    fn which_bodies_responses_have() {
        let body = |text: &str, to_head| {
            Head::response(text.as_bytes())
                .unwrap()
                .unwrap()
                .body(to_head)
        };
        assert_eq!(body("HTTP/1.1 200 OK\r\n\r\n", false), Ok(Body::UntilClose));
        assert_eq!(
            body("HTTP/1.1 204 No Content\r\n\r\n", false),
            Ok(Body::Length(0))
        );
        assert_eq!(
            body("HTTP/1.1 200 OK\r\nContent-Length: 7\r\n\r\n", true),
            Ok(Body::Length(0))
        );
        assert_eq!(
            body(
                "HTTP/1.1 200 OK\r\nContent-Length: 7\r\nTransfer-Encoding: chunked\r\n\r\n",
                false
            ),
            Err(Unreadable)
        );
        assert_eq!(
            body(
                "HTTP/1.1 200 OK\r\nContent-Length: 7\r\nContent-Length: 8\r\n\r\n",
                false
            ),
            Err(Unreadable)
        );
    }

    #[test]
    fn chunks_in_any_pieces() {
        let wire = b"4;x=y\r\nWiki\r\n5\r\npedia\r\n0\r\nTrailer: t\r\n\r\nnext";
        for size in 1..wire.len() {
            let (mut body, mut content, mut taken) =
                (Body::Chunked(Chunks::default()), Vec::new(), 0);
            for piece in wire.chunks(size) {
                let (used, ranges) = body.take(piece).unwrap();
                ranges
                    .into_iter()
                    .for_each(|range| content.extend_from_slice(&piece[range]));
                taken += used;
                if body.is_whole() {
                    break;
                }
            }
            assert_eq!(
                (content.as_slice(), &wire[taken..]),
                (b"Wikipedia".as_slice(), b"next".as_slice()),
                "pieces of {size}"
            );
        }
        assert_eq!(
            Body::Chunked(Chunks::default()).take(b"zz"),
            Err(Unreadable)
        );
        assert_eq!(
            Body::Chunked(Chunks::default()).take(b"11112222333344445"),
            Err(Unreadable)
        );
    }
}
