//! Endpoints of models that say what a test wants.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    thread,
};

use serde_json::{Value, json};

/// Answers every chat completion with the same text.
pub fn endpoint(answer: &str) -> String {
    let answer = answer.to_owned();
    answering(move |_| completion(&answer))
}

/// A chat completion that says this.
pub fn completion(text: &str) -> Value {
    json!({
        "choices": [{"message": {"role": "assistant", "content": text}}],
        "usage": {"prompt_tokens": 5, "completion_tokens": 7},
    })
}

/// An endpoint that answers one request after another with what it is told to; its address.
pub fn answering(mut answer: impl FnMut(Value) -> Value + Send + 'static) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = BufReader::new(stream.unwrap());
            // Who goes away in the middle gets no answer.
            let Some(request) = body(&mut stream) else {
                continue;
            };
            let answer = answer(request).to_string();
            let head = "HTTP/1.1 200 OK\r\nconnection: close\r\ncontent-type: application/json";
            let length = answer.len();
            let _ = write!(
                stream.get_mut(),
                "{head}\r\ncontent-length: {length}\r\n\r\n{answer}"
            );
        }
    });
    url
}

fn body(stream: &mut BufReader<TcpStream>) -> Option<Value> {
    let (mut line, mut length) = (String::new(), 0);
    while stream.read_line(&mut line).ok()? > 2 {
        if let Some(value) = line.to_lowercase().strip_prefix("content-length:") {
            length = value.trim().parse().ok()?;
        }
        line.clear();
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body).ok()?;
    serde_json::from_slice(&body).ok()
}
