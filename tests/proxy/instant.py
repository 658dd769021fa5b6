"""A tool server that answers every call at once with one result, or with what a function makes of the call: over Streamable HTTP and HTTP+SSE in a thread, or over standard
input and output as a program (`instant.py ANSWER.json`). `endpoint` makes the address that HTTP+SSE names absolute."""

import json
import socketserver
import sys
import threading


def answer(message, result):
    if "id" not in message:
        return None
    results = {
        "initialize": {"protocolVersion": "2025-06-18", "capabilities": {"tools": {}}, "serverInfo": {"name": "instant", "version": "1"}},
        "tools/call": result,
    }
    said = results.get(message["method"], {})
    return {"jsonrpc": "2.0", "id": message["id"], "result": said(message) if callable(said) else said}


class Instant:
    def __init__(self, result, absolute=False, on_call=None):
        self.streams, self.calls = {}, []
        outer = self

        class Handler(socketserver.StreamRequestHandler):
            disable_nagle_algorithm = True

            def handle(self):
                while line := self.rfile.readline():
                    method, target, _ = line.decode().split()
                    headers = {}
                    while (line := self.rfile.readline().decode().strip()):
                        name, _, value = line.partition(":")
                        headers[name.lower()] = value.strip()
                    body = self.rfile.read(int(headers.get("content-length", 0)))
                    if method == "GET":
                        return self.stream(headers)
                    if method != "POST":
                        self.respond(200, b"")
                        continue
                    message = json.loads(body)
                    if message.get("method") == "tools/call":
                        outer.calls.append(message["params"]["name"])
                        if on_call:
                            on_call(message)
                    said = answer(message, result)
                    said = json.dumps(said).encode() if said else b""
                    stream = outer.streams.get(target)
                    if stream is None:
                        self.respond(200 if said else 202, said)
                        continue
                    self.respond(202, b"Accepted")
                    if said:
                        event = b"event: message\r\ndata: " + said + b"\r\n\r\n"
                        stream.write(f"{len(event):x}\r\n".encode() + event + b"\r\n")

            def respond(self, status, body):
                head = f"HTTP/1.1 {status} OK\r\nContent-Type: application/json\r\nmcp-session-id: one\r\nContent-Length: {len(body)}\r\n\r\n"
                self.wfile.write(head.encode() + body)

            def stream(self, headers):
                target = f"/messages/?session_id={len(outer.streams)}"
                outer.streams[target] = self.wfile
                address = f"http://{headers['host']}{target}" if absolute else target
                event = f"event: endpoint\r\ndata: {address}\r\n\r\n"
                head = "HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nTransfer-Encoding: chunked\r\n\r\n"
                self.wfile.write(f"{head}{len(event):x}\r\n{event}\r\n".encode())
                self.rfile.read(1)

        class Threads(socketserver.ThreadingTCPServer):
            daemon_threads = allow_reuse_address = True
            request_queue_size = 256

            def handle_error(self, *_):
                """Agents go without a word."""

        self.server = Threads(("127.0.0.1", 0), Handler)
        self.port = self.server.server_address[1]
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.server.shutdown()
        self.server.server_close()


if __name__ == "__main__":
    with open(sys.argv[1]) as file:
        kept = json.load(file)
    for line in sys.stdin.buffer:
        said = answer(json.loads(line), kept)
        if said:
            sys.stdout.write(json.dumps(said) + "\n")
            sys.stdout.flush()
