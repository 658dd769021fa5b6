"""A WebSocket client (RFC 6455) that can be rude. Standard library only."""

import base64
import json
import os
import socket
import struct


class WebSocket:
    """A connection to a server of `harness`; `WebSocket.status` is what the handshake was answered with."""

    TEXT, BINARY, CLOSE, PING, PONG = 1, 2, 8, 9, 10

    def __init__(self, server, path="/ws", headers=None, timeout=60):
        self.socket = socket.create_connection(("127.0.0.1", server.port), timeout)
        lines = [
            f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{server.port}", "Upgrade: websocket", "Connection: Upgrade",
            f"Sec-WebSocket-Key: {base64.b64encode(os.urandom(16)).decode()}", "Sec-WebSocket-Version: 13",
            *(f"{name}: {value}" for name, value in (headers or {}).items()),
        ]
        self.socket.sendall("\r\n".join([*lines, "", ""]).encode())
        self.buffer = b""
        while b"\r\n\r\n" not in self.buffer:
            got = self.socket.recv(4096)
            if not got:
                raise ConnectionError("the handshake has no answer")
            self.buffer += got
        head, self.buffer = self.buffer.split(b"\r\n\r\n", 1)
        self.status = int(head.split()[1])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def frame(self, payload, opcode=TEXT, final=True, length=None, masked=True):
        """Sends one frame; `length` is what its head says, if that is not so."""
        payload = payload.encode() if isinstance(payload, str) else payload
        length = len(payload) if length is None else length
        head = bytes([(128 if final else 0) | opcode])
        mask = 128 if masked else 0
        if length < 126:
            head += bytes([mask | length])
        elif length < 1 << 16:
            head += bytes([mask | 126]) + struct.pack(">H", length)
        else:
            head += bytes([mask | 127]) + struct.pack(">Q", length)
        key = os.urandom(4)
        body = bytes(byte ^ key[index % 4] for index, byte in enumerate(payload)) if masked else payload
        self.socket.sendall(head + (key if masked else b"") + body)

    def take(self, count):
        while len(self.buffer) < count:
            got = self.socket.recv(1 << 16)
            if not got:
                raise ConnectionError("the server closed the connection")
            self.buffer += got
        taken, self.buffer = self.buffer[:count], self.buffer[count:]
        return taken

    def receive(self):
        """(opcode, payload) of the next frame."""
        first, second = self.take(2)
        length = second & 127
        if length == 126:
            (length,) = struct.unpack(">H", self.take(2))
        elif length == 127:
            (length,) = struct.unpack(">Q", self.take(8))
        return first & 15, self.take(length)

    def ask(self, message):
        """What a message is answered with; a text is sent as it is."""
        self.frame(message if isinstance(message, str) else json.dumps(message))
        return self.answer()

    def answer(self):
        while True:
            opcode, payload = self.receive()
            if opcode == self.TEXT:
                return json.loads(payload)
            if opcode == self.CLOSE:
                raise ConnectionError(f"closed with {struct.unpack('>H', payload[:2])[0] if payload else None}")

    def closed(self):
        """The code that the server closes with; None if it just goes."""
        try:
            while True:
                opcode, payload = self.receive()
                if opcode == self.CLOSE:
                    return struct.unpack(">H", payload[:2])[0] if payload else None
        except (ConnectionError, OSError):
            return None
