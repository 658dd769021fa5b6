//! What the recorder reads of a connection, over bytes in memory: for the fuzz targets. Passes and
//! records nothing.

use std::sync::{Arc, LazyLock};

use reel_redact::{Redactor, Rules};
use serde_json::json;

use crate::{
    sse::{self, Byte, Event, Scanner},
    tap,
    wire::{Body, Head},
};

/// Reads one side of a connection: heads, bodies, their events, and the messages in them.
#[doc(hidden)]
pub fn read_connection(mut wire: &[u8]) {
    while let Some((head, rest)) = head(wire) {
        let _ = head.with_values(&[("host", "robot:8000"), ("accept-encoding", "identity")]);
        let Ok(mut body) = head.body(false) else {
            return;
        };
        let (content, used) = content(&mut body, rest);
        match head.content_type().as_str() {
            "text/event-stream" => events(&content),
            _ => message(&content),
        }
        if used == 0 && head.bytes.is_empty() {
            return;
        }
        wire = &rest[used..];
    }
}

/// The head at the beginning, of a request or a response, and what is behind it.
fn head(wire: &[u8]) -> Option<(Head, &[u8])> {
    let request = Head::request(wire).ok().flatten();
    let head = request.or_else(|| Head::response(wire).ok().flatten())?;
    let rest = &wire[head.bytes.len()..];
    Some((head, rest))
}

/// The content of a body that comes in pieces, and how long it is on the wire.
fn content(body: &mut Body, wire: &[u8]) -> (Vec<u8>, usize) {
    let (mut content, mut used) = (Vec::new(), 0);
    for piece in wire.chunks(7) {
        let Ok((taken, ranges)) = body.take(piece) else {
            break;
        };
        assert!(taken <= piece.len(), "no more than came");
        ranges
            .into_iter()
            .for_each(|range| content.extend_from_slice(&piece[range]));
        used += taken;
        if body.is_whole() {
            break;
        }
        let _ = body.is_between();
    }
    (content, used)
}

fn events(content: &[u8]) {
    let (mut scanner, mut event) = (Scanner::default(), Vec::new());
    for byte in content {
        let what = scanner.take(*byte);
        if what != Byte::Behind {
            event.push(*byte);
        }
        if what == Byte::Ends {
            let whole = std::mem::take(&mut event);
            let Event { name, data, .. } = Event::read(&whole);
            message(&data);
            if let Ok(data) = str::from_utf8(&data) {
                let _ = sse::resolve("/sse?x", data);
                if let Some(other) = sse::fitted(&name, "{}", whole.len()) {
                    assert_eq!(other.len(), whole.len(), "as long as the event");
                }
            }
        }
    }
}

fn message(bytes: &[u8]) {
    let _ = (
        tap::from_agent(bytes),
        tap::is_hello(bytes),
        tap::client_of(bytes),
    );
    static RULES: LazyLock<Arc<Rules>> = LazyLock::new(|| Arc::new(Rules::built_in()));
    let mut redactor = Redactor::new(RULES.clone());
    if let Some(result) = tap::answer_to(&json!(1), bytes) {
        let _ = (result.task(), result.asks_for_input());
        let _ = result.content(&mut redactor).payload();
    }
    if let tap::FromAgent::Calls(mut calls) = tap::from_agent(bytes) {
        calls
            .iter_mut()
            .for_each(|call| drop(call.redact(&mut redactor)));
    }
}
