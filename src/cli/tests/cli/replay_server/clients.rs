//! MCP clients over the three transports, as plain bytes: what a server sends is compared as text.

use std::{
    io::{BufRead as _, BufReader, Read, Write as _},
    net::TcpStream,
    path::Path,
    process::{Child, Command, Stdio},
};

use serde_json::{Value, json};

use crate::stdio_client::StdioClient;

/// A client of some transport, which counts its requests from 1.
pub trait Client {
    /// The text of the answer to a request, byte for byte.
    fn request(&mut self, method: &str, params: &Value) -> String;

    /// The text of the answer to a call of a tool.
    fn call(&mut self, name: &str, arguments: &Value) -> String {
        self.request("tools/call", &json!({"name": name, "arguments": arguments}))
    }
}

impl Client for StdioClient {
    fn request(&mut self, method: &str, params: &Value) -> String {
        self.request_text(method, params)
    }
}

/// `reel serve --replay`, until it is dropped.
pub struct ReplayServer {
    child: Child,
    pub address: String,
}

impl ReplayServer {
    pub fn start(folder: &Path, arguments: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_reel"))
            .current_dir(folder)
            .args(["serve", "--listen", "127.0.0.1:0"])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut line = String::new();
        let said = child.stdout.take().unwrap();
        BufReader::new(said).read_line(&mut line).unwrap();
        let rest = line
            .split_once("http://")
            .unwrap_or_else(|| panic!("{line}"));
        let address = rest.1.split_once(": ").unwrap().0.to_owned();
        Self { child, address }
    }
}

impl Drop for ReplayServer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn hello() -> Value {
    json!({
        "protocolVersion": "2025-06-18", "capabilities": {},
        "clientInfo": {"name": "test", "version": "1"},
    })
}

/// Status line with headers, and the body, of a request of its own connection.
fn post(address: &str, path: &str, headers: &str, body: &str) -> (String, String) {
    let mut stream = TcpStream::connect(address).unwrap();
    let request = format!(
        "POST {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\nContent-Type: application/json\r\n\
         Accept: application/json, text/event-stream\r\n{headers}Content-Length: {}\r\n\r\n{body}",
        body.len()
    );
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    let end = answer
        .windows(4)
        .position(|four| four == b"\r\n\r\n")
        .unwrap();
    let head = String::from_utf8(answer[..end].to_vec()).unwrap();
    let mut body = Vec::new();
    if head.to_lowercase().contains("transfer-encoding: chunked") {
        Chunks::new(&answer[end + 4..])
            .read_to_end(&mut body)
            .unwrap();
    } else {
        body = answer[end + 4..].to_vec();
    }
    (head, String::from_utf8(body).unwrap())
}

/// The content of a body that comes in chunks.
struct Chunks<R: Read> {
    from: BufReader<R>,
    left: usize,
}

impl<R: Read> Chunks<R> {
    fn new(from: R) -> Self {
        Self {
            from: BufReader::new(from),
            left: 0,
        }
    }
}

impl<R: Read> Read for Chunks<R> {
    fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
        if self.left == 0 {
            let mut size = String::new();
            while size.trim().is_empty() {
                size.clear();
                if self.from.read_line(&mut size)? == 0 {
                    return Ok(0);
                }
            }
            self.left = usize::from_str_radix(size.trim(), 16).unwrap();
        }
        let most = into.len().min(self.left);
        let read = self.from.read(&mut into[..most])?;
        self.left -= read;
        Ok(read)
    }
}

/// A client of Streamable HTTP.
pub struct StreamableClient {
    address: String,
    session: String,
    sent: u64,
}

impl StreamableClient {
    pub fn start(address: &str) -> Self {
        let message = json!({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": hello()});
        let (head, _) = post(address, "/mcp", "", &message.to_string());
        let session = head
            .lines()
            .find(|line| line.to_lowercase().starts_with("mcp-session-id:"))
            .unwrap_or_else(|| panic!("{head}"));
        let session = session.split_once(':').unwrap().1.trim().to_owned();
        let client = Self {
            address: address.to_owned(),
            session,
            sent: 1,
        };
        let note = json!({"jsonrpc": "2.0", "method": "notifications/initialized"});
        client.post(&note);
        client
    }

    fn post(&self, message: &Value) -> String {
        let session = &self.session;
        let headers = format!("Mcp-Session-Id: {session}\r\nMCP-Protocol-Version: 2025-06-18\r\n");
        post(&self.address, "/mcp", &headers, &message.to_string()).1
    }
}

impl Client for StreamableClient {
    fn request(&mut self, method: &str, params: &Value) -> String {
        self.sent += 1;
        let id = self.sent;
        let message = json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params});
        let body = self.post(&message);
        let data = body.lines().filter_map(|line| line.strip_prefix("data:"));
        let mut data = data.map(str::trim).filter(|data| data.starts_with('{'));
        data.next().unwrap_or_else(|| panic!("{body}")).to_owned()
    }
}

/// A client of HTTP+SSE, the transport of 2024.
pub struct SseClient {
    address: String,
    events: BufReader<Chunks<TcpStream>>,
    path: String,
    sent: u64,
}

impl SseClient {
    pub fn start(address: &str) -> Self {
        let mut stream = TcpStream::connect(address).unwrap();
        let request =
            format!("GET /sse HTTP/1.1\r\nHost: {address}\r\nAccept: text/event-stream\r\n\r\n");
        stream.write_all(request.as_bytes()).unwrap();
        let mut byte = [0];
        let mut head = Vec::new();
        while !head.ends_with(b"\r\n\r\n") {
            stream.read_exact(&mut byte).unwrap();
            head.push(byte[0]);
        }
        let mut client = Self {
            address: address.to_owned(),
            events: BufReader::new(Chunks::new(stream)),
            path: String::new(),
            sent: 0,
        };
        client.path = client.data();
        client.request("initialize", &hello());
        let note = json!({"jsonrpc": "2.0", "method": "notifications/initialized"});
        post(&client.address, &client.path, "", &note.to_string());
        client
    }

    /// The data of the next event that has some.
    fn data(&mut self) -> String {
        loop {
            let mut line = String::new();
            assert!(
                self.events.read_line(&mut line).unwrap() > 0,
                "the stream ended"
            );
            if let Some(data) = line.strip_prefix("data:") {
                return data.trim().to_owned();
            }
        }
    }
}

impl Client for SseClient {
    fn request(&mut self, method: &str, params: &Value) -> String {
        self.sent += 1;
        let id = self.sent;
        let message = json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params});
        let (head, body) = post(&self.address, &self.path, "", &message.to_string());
        assert!(head.starts_with("HTTP/1.1 202"), "{head}\n{body}");
        self.data()
    }
}
