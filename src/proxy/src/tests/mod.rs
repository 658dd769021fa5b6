//! The recorder between an agent and a server that are scripts, over real connections.

mod redaction;
mod resume;
mod tasks;

use std::{
    fs,
    io::{Read, Write},
    net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    thread,
    time::Duration,
};

use reel_redact::Rules;
use reel_reward::Preset;
use reel_trace::{RecordOptions, Trace};
use reel_world::{Profile, Scenes, record::Backend};
use serde_json::{Value, json};

use crate::{
    OnFull, PendingTraces, Proxy, Report, Setup, Upstream,
    http::Shared,
    wire::{Body, Head, Start},
};

const HERE: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 0);
/// The session of every scripted server.
const SESSION: &str = "the-session-of-the-script";

/// How the tests record.
pub(crate) fn setup(out: &Path, rules: Rules) -> Setup {
    Setup {
        out: out.to_owned(),
        run: "test".to_owned(),
        backend: Backend::Proxy,
        profile: Profile::RealRepo,
        preset: Preset::default(),
        tasks: Vec::new(),
        scenes: Scenes::default(),
        policy: None,
        mapping: None,
        rules: Arc::new(rules),
        options: RecordOptions::default(),
        on_full: OnFull::Stop,
        message_max: 1 << 20,
        idle: Duration::from_secs(60),
        hosts: Vec::new(),
        watch: Box::new(|_| {}),
        report: Report::default(),
        endings: PendingTraces::default(),
    }
}

/// A request as the server got it.
pub(super) struct Request {
    pub method: String,
    /// Lines of the head, in lower case.
    pub head: String,
    pub body: String,
}

impl Request {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_default()
    }

    pub fn header(&self, name: &str) -> Option<&str> {
        let line = self.head.lines().find_map(|line| line.strip_prefix(name));
        line?.strip_prefix(": ")
    }
}

/// What the server writes to a connection.
pub(super) struct Response<'a>(&'a TcpStream);

impl Response<'_> {
    pub fn json(&self, status: u16, body: &str) {
        self.write(&format!(
            "HTTP/1.1 {status} X\r\ncontent-type: application/json\r\nmcp-session-id: {SESSION}\r\ncontent-length: {}\r\n\r\n{body}",
            body.len()
        ));
    }

    /// Begins a stream of events.
    pub fn stream(&self) {
        self.write(&format!(
            "HTTP/1.1 200 OK\r\ncontent-type: text/event-stream\r\nmcp-session-id: {SESSION}\r\ntransfer-encoding: chunked\r\n\r\n"
        ));
    }

    /// Writes to the stream, in chunks of so many bytes.
    pub fn chunks(&self, text: &str, size: usize) {
        for chunk in text.as_bytes().chunks(size.max(1)) {
            let mut bytes = format!("{:x}\r\n", chunk.len()).into_bytes();
            bytes.extend_from_slice(chunk);
            bytes.extend_from_slice(b"\r\n");
            drop((&mut &*self.0).write_all(&bytes));
        }
    }

    pub fn end(&self) {
        self.write("0\r\n\r\n");
    }

    fn write(&self, text: &str) {
        // The agent may be gone: scripts break connections.
        drop((&mut &*self.0).write_all(text.as_bytes()));
    }
}

/// Reads one message of HTTP: its head and its content.
fn read(mut stream: &TcpStream, is_request: bool) -> Option<(Head, Vec<u8>)> {
    let (mut buffer, mut piece) = (Vec::new(), [0; 4096]);
    let mut more = |buffer: &mut Vec<u8>| {
        let count = stream.read(&mut piece).ok().filter(|count| *count > 0)?;
        buffer.extend_from_slice(&piece[..count]);
        Some(())
    };
    let head = loop {
        let head = match is_request {
            true => Head::request(&buffer),
            false => Head::response(&buffer),
        };
        match head.ok()? {
            Some(head) => break head,
            None => more(&mut buffer)?,
        }
    };
    buffer.drain(..head.bytes.len());
    let (mut body, mut content) = (head.body(false).ok()?, Vec::new());
    loop {
        let (used, ranges) = body.take(&buffer).ok()?;
        ranges
            .into_iter()
            .for_each(|range| content.extend_from_slice(&buffer[range]));
        buffer.drain(..used);
        if body.is_whole() {
            return Some((head, content));
        }
        if more(&mut buffer).is_none() {
            // Whatever came, of a stream that broke off.
            return matches!(body, Body::UntilClose | Body::Chunked(_)).then_some((head, content));
        }
    }
}

/// A server that answers one request a connection, as a script says.
pub(super) fn serve(script: impl Fn(&Request, &Response<'_>) + Send + Sync + 'static) -> u16 {
    let listener = TcpListener::bind(HERE).unwrap();
    let port = listener.local_addr().unwrap().port();
    let script = Arc::new(script);
    thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let script = script.clone();
            thread::spawn(move || {
                if let Some((head, body)) = read(&stream, true)
                    && let Start::Request { method, .. } = &head.start
                {
                    let request = Request {
                        method: method.clone(),
                        head: String::from_utf8_lossy(&head.bytes).to_ascii_lowercase(),
                        body: String::from_utf8_lossy(&body).into_owned(),
                    };
                    script(&request, &Response(&stream));
                }
                drop(stream.shutdown(Shutdown::Both));
            });
        }
    });
    port
}

/// A recorder before a server.
pub(super) struct Recording {
    pub setup: Arc<Setup>,
    shared: Arc<Shared>,
    address: SocketAddr,
    /// What was told while it happened.
    pub events: Arc<Mutex<String>>,
    folder: tempfile::TempDir,
}

impl Recording {
    pub fn of(server: u16, rules: Rules) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let events = Arc::new(Mutex::new(String::new()));
        let events_of_the_run = events.clone();
        let setup = Arc::new(Setup {
            watch: Box::new(move |event| {
                events_of_the_run
                    .lock()
                    .unwrap()
                    .push_str(&format!("{event:?}\n"))
            }),
            ..setup(folder.path(), rules)
        });
        let upstream = Upstream::parse(&format!("http://127.0.0.1:{server}/mcp")).unwrap();
        let proxy = Proxy::bind(setup.clone(), upstream, HERE).unwrap();
        let address = proxy.address().unwrap();
        let shared = proxy.start();
        Self {
            setup,
            shared,
            address,
            events,
            folder,
        }
    }

    /// Opens a connection and sends a request on it.
    pub fn send(&self, method: &str, headers: &[(&str, &str)], body: &str) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).unwrap();
        let headers: String = headers
            .iter()
            .map(|(name, value)| format!("{name}: {value}\r\n"))
            .collect();
        let head = format!(
            "{method} /mcp HTTP/1.1\r\nhost: 127.0.0.1\r\ncontent-type: application/json\r\n{headers}content-length: {}\r\n\r\n",
            body.len()
        );
        stream
            .write_all(format!("{head}{body}").as_bytes())
            .unwrap();
        stream
    }

    /// A request of the session and the content of its response.
    pub fn ask(&self, method: &str, headers: &[(&str, &str)], body: &str) -> String {
        let headers = [&[("mcp-session-id", SESSION)][..], headers].concat();
        let stream = self.send(method, &headers, body);
        stream
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        let content = read(&stream, false).map(|(_, content)| content);
        String::from_utf8_lossy(&content.unwrap_or_default()).into_owned()
    }

    pub fn post(&self, message: &Value) -> String {
        self.ask("POST", &[], &message.to_string())
    }

    pub fn call(&self, id: u32, name: &str, params: Value) -> String {
        self.post(&call(id, name, params))
    }

    /// Ends everything; the traces that there are.
    pub fn end(&self) -> Vec<Trace> {
        self.shared.sessions.end_all("the test is over");
        self.setup.endings.wait();
        self.files()
            .iter()
            .map(|path| Trace::read(path).unwrap())
            .collect()
    }

    /// The files that there are, in their order.
    pub fn files(&self) -> Vec<PathBuf> {
        let entries = fs::read_dir(self.folder.path()).unwrap();
        let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        files.sort();
        files
    }
}

/// A message that calls a tool; `more` are members of its parameters besides name and arguments.
pub(super) fn call(id: u32, name: &str, more: Value) -> Value {
    let mut params = json!({"name": name, "arguments": {}});
    for (key, value) in more.as_object().cloned().unwrap_or_default() {
        params[key] = value;
    }
    json!({"jsonrpc": "2.0", "id": id, "method": "tools/call", "params": params})
}

/// A message with the result of a call.
pub(super) fn result(id: &Value, text: &str) -> String {
    let result = json!({"content": [{"type": "text", "text": text}]});
    json!({"jsonrpc": "2.0", "id": id, "result": result}).to_string()
}

/// Tools and texts of the steps of a trace.
pub(super) fn steps(trace: &Trace) -> Vec<(String, String)> {
    trace
        .steps
        .iter()
        .map(|step| (step.tool_name().to_owned(), step.outcome.text.clone()))
        .collect()
}
