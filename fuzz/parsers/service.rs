//! What comes over connections: requests and bodies to the server, both sides of the recording
//! proxy.

use std::fs;

use reel_server::{Config, InMemoryServer};
use serde_json::Value;

use super::{SCENE, TASK, folder, text};

/// Requests as they are on the wire.
pub fn http(bytes: &[u8]) {
    exchange(bytes);
}

/// A message to the tool server of a worker, with the headers that its protocol wants.
pub fn mcp(bytes: &[u8]) {
    let message: Value = serde_json::from_slice(bytes).unwrap_or_default();
    let of = |pointer| {
        let value = message.pointer(pointer).and_then(Value::as_str);
        value.filter(|value| value.bytes().all(|byte| (b' '..=b'~').contains(&byte)))
    };
    let mut head = format!(
        "POST /w/fuzz/mcp HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n\
         Accept: application/json, text/event-stream\r\nConnection: close\r\nContent-Length: {}\r\n",
        bytes.len()
    );
    let meta = "/params/_meta/io.modelcontextprotocol~1protocolVersion";
    let headers = [
        ("MCP-Protocol-Version", of(meta)),
        ("Mcp-Method", of("/method")),
        ("Mcp-Name", of("/params/name")),
    ];
    for (name, value) in headers {
        if let Some(value) = value {
            head += &format!("{name}: {value}\r\n");
        }
    }
    exchange(&[head.as_bytes(), b"\r\n", bytes].concat());
}

/// Sends bytes to a server of its own, so that what an input does depends on it alone.
fn exchange(bytes: &[u8]) {
    let folder = folder();
    let (tasks, scene) = (
        folder.path().join("task.yaml"),
        folder.path().join("scene.json"),
    );
    fs::write(&tasks, TASK).expect("a temporary file");
    fs::write(&scene, SCENE).expect("a temporary file");
    let mut config = Config {
        listen: ([127, 0, 0, 1], 0).into(),
        data: folder.path().join("data"),
        ..Config::default()
    };
    config.play.tasks = Some(tasks);
    config.play.scene = Some(scene);
    config.play.images = false;
    config.limits.workers = 1;
    let server = InMemoryServer::start(config).expect("a server of a temporary folder");
    let answer = server.exchange(bytes);
    // How the server says that a handler panicked.
    text(&answer, |answer| {
        assert!(!answer.contains("the request panicked"), "{answer}")
    });
}

/// Both sides of a connection that is recorded.
pub fn proxy(bytes: &[u8]) {
    reel_proxy::read_connection(bytes);
    text(bytes, |text| {
        let _ = reel_proxy::Upstream::parse(text);
    });
}
