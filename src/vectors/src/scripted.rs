//! An endpoint that does what a test says, and a clock that nobody waits for.

#![expect(missing_docs, reason = "fields of fixtures")]

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    thread,
    time::Duration,
};

use reel_llm::client::Clock;
use serde_json::{Value, json};

/// What the endpoint does with a request.
pub enum Act {
    /// Answers with this text.
    Reply(String),
    /// Answers with status, further header lines and body.
    Status(u16, &'static str, String),
    /// Sends these bytes and closes the connection.
    Raw(String),
    /// Keeps the connection open and never answers.
    Hang,
}

/// A request as it came.
#[derive(Clone)]
pub struct Received {
    /// Request line and headers.
    pub head: String,
    pub body: Value,
}

pub struct Scripted {
    pub base_url: String,
    received: Arc<Mutex<Vec<Received>>>,
}

impl Scripted {
    /// Does one act after the other, then answers 501.
    pub fn start(acts: Vec<Act>) -> Self {
        let mut acts = acts.into_iter();
        Self::answering(move |_| {
            acts.next()
                .unwrap_or_else(|| Act::Status(501, "", "the script is over".to_owned()))
        })
    }

    /// Does what a function of the request says.
    pub fn answering(mut act: impl FnMut(&Received) -> Act + Send + 'static) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let base_url = format!("http://{}/v1", listener.local_addr().unwrap());
        let received = Arc::new(Mutex::new(Vec::new()));
        let seen = Arc::clone(&received);
        thread::spawn(move || {
            let mut hanging = Vec::new();
            for stream in listener.incoming() {
                let mut stream = stream.unwrap();
                let Some(request) = receive(&stream) else {
                    continue;
                };
                seen.lock().unwrap().push(request.clone());
                match act(&request) {
                    Act::Reply(text) => answer(&mut stream, 200, "", &completion(&text)),
                    Act::Status(status, headers, body) => {
                        answer(&mut stream, status, headers, &body)
                    }
                    Act::Raw(bytes) => drop(stream.write_all(bytes.as_bytes())),
                    Act::Hang => hanging.push(stream),
                }
            }
        });
        Self { base_url, received }
    }

    /// What came so far.
    pub fn received(&self) -> Vec<Received> {
        self.received.lock().unwrap().clone()
    }
}

/// The address of an endpoint that is not there. No port of this machine's choice: another
/// test could get it.
pub fn no_endpoint() -> String {
    "http://127.0.0.1:1/v1".to_owned()
}

/// The body of a chat completion.
pub fn completion(text: &str) -> String {
    json!({
        "id": "chatcmpl-1",
        "object": "chat.completion",
        "choices": [{"index": 0, "message": {"role": "assistant", "content": text}, "finish_reason": "stop"}],
        "usage": {"prompt_tokens": 11, "completion_tokens": 3, "total_tokens": 14},
    })
    .to_string()
}

fn receive(stream: &TcpStream) -> Option<Received> {
    let mut reader = BufReader::new(stream);
    let mut head = String::new();
    while !head.ends_with("\r\n\r\n") {
        if reader.read_line(&mut head).ok()? == 0 {
            return None;
        }
    }
    let length = head.lines().find_map(|line| {
        line.to_lowercase()
            .strip_prefix("content-length:")
            .map(|n| n.trim().to_owned())
    });
    let mut body = vec![0; length?.parse().ok()?];
    reader.read_exact(&mut body).ok()?;
    Some(Received {
        head,
        body: serde_json::from_slice(&body).ok()?,
    })
}

fn answer(stream: &mut TcpStream, status: u16, headers: &str, body: &str) {
    let length = body.len();
    let head = format!(
        "HTTP/1.1 {status} x\r\nContent-Type: application/json\r\nContent-Length: {length}\r\nConnection: close\r\n"
    );
    drop(stream.write_all(format!("{head}{headers}\r\n{body}").as_bytes()));
}

/// A clock that goes on by a millisecond when it is read, and by a pause at once.
#[derive(Default)]
pub struct TestClock {
    now_ns: AtomicU64,
    pauses: Mutex<Vec<Duration>>,
}

impl TestClock {
    /// The pauses so far, in seconds.
    pub fn pauses_s(&self) -> Vec<u64> {
        self.pauses
            .lock()
            .unwrap()
            .iter()
            .map(Duration::as_secs)
            .collect()
    }
}

impl Clock for TestClock {
    fn now_ns(&self) -> u64 {
        self.now_ns.fetch_add(1_000_000, Ordering::SeqCst)
    }

    fn sleep(&self, pause: Duration) {
        self.now_ns
            .fetch_add(u64::try_from(pause.as_nanos()).unwrap(), Ordering::SeqCst);
        self.pauses.lock().unwrap().push(pause);
    }
}
