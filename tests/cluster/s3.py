"""An S3-compatible store in memory (PyPI moto) with an empty bucket `reel`, and a door before it that misbehaves on request.

  s3.py HOST PORT            the store
  s3.py HOST PORT BACKEND    the door: passes requests on to http://BACKEND, late, and some of them not at all
"""

import http.client
import http.server
import random
import socketserver
import sys
import time


def store(host, port):
    import boto3
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address=host, port=port, verbose=False)
    server.start()
    keys = {"aws_access_key_id": "test", "aws_secret_access_key": "test", "region_name": "us-east-1"}
    boto3.client("s3", endpoint_url=f"http://{host}:{port}", **keys).create_bucket(Bucket="reel")
    print("ready", flush=True)
    while True:
        time.sleep(3600)


class Door(http.server.BaseHTTPRequestHandler):
    """Of 100 requests, 15 get 503, 3 an answer that breaks off, or none although they were obeyed; all wait up to a fifth of a second."""

    protocol_version = "HTTP/1.1"
    chance = random.Random(7)

    def _pass(self):
        body = self.rfile.read(int(self.headers.get("content-length") or 0))
        time.sleep(self.chance.random() * 0.2)
        luck = self.chance.random()
        if luck < 0.15:
            self.send_response(503)
            self.send_header("content-length", "0")
            self.end_headers()
            return
        lost = self.command == "PUT" and luck < 0.18
        backend = http.client.HTTPConnection(self.server.backend, timeout=60)
        backend.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
        for name, value in self.headers.items():
            backend.putheader(name, value)
        backend.endheaders(body)
        answer = backend.getresponse()
        content = answer.read()
        if lost:
            # it was done, but nobody hears of it
            self.connection.close()
            self.close_connection = True
            return
        self.send_response_only(answer.status)
        for name, value in answer.getheaders():
            if name.lower() not in ("transfer-encoding", "connection"):
                self.send_header(name, value)
        if not any(name.lower() == "content-length" for name, _ in answer.getheaders()):
            self.send_header("content-length", str(len(content)))
        self.end_headers()
        if luck < 0.18 and len(content) > 100:
            self.wfile.write(content[: len(content) // 2])
            self.wfile.flush()
            self.connection.close()
            self.close_connection = True
            return
        if self.command != "HEAD":
            self.wfile.write(content)

    do_GET = do_PUT = do_POST = do_HEAD = do_DELETE = _pass

    def log_message(self, *_):
        pass

    def handle_one_request(self):
        try:
            super().handle_one_request()
        except (ConnectionError, OSError, ValueError):
            self.close_connection = True


class Server(socketserver.ThreadingMixIn, http.server.HTTPServer):
    daemon_threads = True
    request_queue_size = 128


def door(host, port, backend):
    server = Server((host, port), Door)
    server.backend = backend
    print("ready", flush=True)
    server.serve_forever()


if __name__ == "__main__":
    host, port = sys.argv[1], int(sys.argv[2])
    door(host, port, sys.argv[3]) if len(sys.argv) > 3 else store(host, port)
