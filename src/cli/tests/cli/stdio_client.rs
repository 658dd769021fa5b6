//! `reel mcp`, and a client that speaks to it over standard input and output.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Child, ChildStdout, Command, Stdio},
};

use reel_trace::Trace;
use serde_json::{Value, json};

/// The server, and its client.
pub struct StdioClient {
    server: Child,
    answers: BufReader<ChildStdout>,
    sent: u64,
}

impl StdioClient {
    pub fn start(folder: &Path, arguments: &[&str]) -> Self {
        Self::start_command(folder, &[&["mcp"], arguments].concat())
    }

    /// A client of a command that is an MCP server over standard input and output.
    pub fn start_command(folder: &Path, arguments: &[&str]) -> Self {
        let mut server = Command::new(env!("CARGO_BIN_EXE_reel"))
            .current_dir(folder)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let answers = BufReader::new(server.stdout.take().unwrap());
        let mut client = Self {
            server,
            answers,
            sent: 0,
        };
        let hello = json!({
            "protocolVersion": "2025-06-18", "capabilities": {},
            "clientInfo": {"name": "test", "version": "1"},
        });
        client.request("initialize", &hello);
        client.write(&json!({"jsonrpc": "2.0", "method": "notifications/initialized"}));
        client
    }

    pub fn write(&mut self, message: &Value) {
        let input = self.server.stdin.as_mut().unwrap();
        writeln!(input, "{message}").unwrap();
    }

    pub fn request(&mut self, method: &str, params: &Value) -> Value {
        self.sent += 1;
        let id = self.sent;
        self.write(&json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params}));
        self.answer(id)["result"].take()
    }

    /// The message that answers a request.
    pub fn answer(&mut self, id: u64) -> Value {
        serde_json::from_str(&self.answer_text(id)).unwrap()
    }

    /// The text of the message that answers a request, byte for byte.
    pub fn answer_text(&mut self, id: u64) -> String {
        loop {
            let mut line = String::new();
            assert!(self.answers.read_line(&mut line).unwrap() > 0, "it ended");
            let answer: Value = serde_json::from_str(&line).unwrap();
            if answer["id"] == id {
                return line.trim_end().to_owned();
            }
        }
    }

    /// The text of the answer to a request.
    pub fn request_text(&mut self, method: &str, params: &Value) -> String {
        self.sent += 1;
        let id = self.sent;
        self.write(&json!({"jsonrpc": "2.0", "id": id, "method": method, "params": params}));
        self.answer_text(id)
    }

    /// The text of a tool's result, and whether it is an error.
    pub fn call(&mut self, name: &str, arguments: &Value) -> (String, bool) {
        let result = self.request("tools/call", &json!({"name": name, "arguments": arguments}));
        let contents = result["content"].as_array().unwrap().iter();
        let text = contents
            .filter_map(|content| content["text"].as_str())
            .collect();
        (text, result["isError"] == true)
    }

    /// Goes away, and waits for the server to end.
    pub fn leave(self) {
        assert_eq!(self.exit_code(), Some(0));
    }

    /// Goes away: the exit code of the server.
    pub fn exit_code(mut self) -> Option<i32> {
        drop(self.server.stdin.take());
        self.server.wait().unwrap().code()
    }
}

/// The traces of a folder, in the order of their names.
pub fn traces(folder: &Path) -> Vec<Trace> {
    let mut paths: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|it| it == "mcap"))
        .collect();
    paths.sort();
    paths
        .iter()
        .map(|path| Trace::read(path).unwrap())
        .collect()
}
