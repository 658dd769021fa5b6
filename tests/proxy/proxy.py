"""`reel record` from outside: the same bytes as without it, on every transport; a hundred sessions; kills; full disks; strange
bytes; and the tables of its traces beside those of the server's own.

    proxy.py [TEST...]        REEL: the binary. REEL_TABLES: one with `ingest` and `query`, where REEL has them not.
"""

import base64
import json
import os
import pathlib
import re
import signal
import socket
import struct
import subprocess
import tempfile
import threading
import zlib

from instant import Instant
from kit import REEL, TLS, Http, Recorder, Server, Skipped, Sse, Stdio, Wire, environment, main, play, reel, tasks, texts, until

TABLES = os.environ.get("REEL_TABLES", REEL)


def same(direct, through, what):
    """What two agents received is equal, byte for byte."""
    assert len(direct.said) == len(through.said), f"{what}: {len(direct.said)} and {len(through.said)} messages"
    for index, (here, there) in enumerate(zip(direct.said, through.said)):
        assert here == there, f"{what}, message {index}:\n{str(here)[:600]}\n{str(there)[:600]}"
    return sum(len(str(message)) for message in direct.said)


def world(folder):
    return tasks(pathlib.Path(folder) / "tasks")


def test_same_bytes_over_http():
    with tempfile.TemporaryDirectory() as folder:
        made = world(folder)
        with Server("--tasks", made, "--profile", "real-repo") as server, Recorder(server.port) as recorder:
            agents = [Http(server.port), Http(recorder.port)]
            for agent in agents:
                agent.rpc("tools/list")
                for _ in range(2):
                    play(agent)
                agent.rpc("no/such/method", {"a": [1, 2.5, None]})
                agent.ask("POST", b"this is no JSON")
                agent.ask("PUT", b"{}")
                agent.ask("OPTIONS")
                agent.close()
            bytes_ = same(*agents, "Streamable HTTP")
            assert until(lambda: len(recorder.traces()) == 2 and not recorder.parts())
            print(f"  {len(agents[0].said)} messages, {bytes_} bytes alike")


def test_same_bytes_from_a_server_over_tls():
    with tempfile.TemporaryDirectory() as folder:
        served = ["--tasks", world(folder), "--profile", "real-repo", "--run", "one"]
        secured = ["--tls-cert", TLS / "server.pem", "--tls-key", TLS / "server.key"]
        with Server(*served) as plain, Server(*served, *secured, cafile=TLS / "ca.pem") as secure:
            for path, kind in (("/mcp", Http), ("/sse", Sse)):
                with Recorder(secure.port, path=path, trusting=TLS / "ca.pem") as recorder:
                    agents = [kind(plain.port), kind(recorder.port)]
                    for agent in agents:
                        agent.rpc("tools/list")
                        play(agent)
                        agent.close()
                    bytes_ = same(*agents, f"{path} over TLS")
                    assert until(lambda: len(recorder.traces()) == 1 and not recorder.parts()), recorder.traces()
                    print(f"  {path}: {len(agents[0].said)} messages, {bytes_} bytes alike")
            # Whoever vouches for another server is not believed.
            with Recorder(secure.port, trusting=TLS.parent.parent / "service" / "tls" / "second.pem") as recorder:
                wire = Wire(recorder.port)
                status, _, text = wire.ask("POST", "/mcp", b"{}", {"Content-Type": "application/json"})
                assert status == 502 and b"certificate" in text and b"SSL_CERT_FILE" in text, (status, text)


def test_same_bytes_over_sse():
    with tempfile.TemporaryDirectory() as folder:
        made = world(folder)
        with Server("--tasks", made, "--profile", "real-repo") as server, Recorder(server.port, path="/sse") as recorder:
            agents = [Sse(server.port), Sse(recorder.port)]
            for agent in agents:
                agent.rpc("tools/list")
                for _ in range(2):
                    play(agent)
                agent.rpc("no/such/method")
                agent.posts.ask("POST", "/messages/?session_id=nobody", b"{}", {"Content-Type": "application/json"})
                agent.close()
            bytes_ = same(*agents, "HTTP+SSE")
            assert until(lambda: len(recorder.traces()) == 2 and not recorder.parts()), recorder.traces()
            print(f"  {len(agents[0].said)} messages, {bytes_} bytes alike")


def test_same_bytes_over_stdio():
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        made = world(folder)
        serve = lambda data: [REEL, "mcp", "--tasks", made, "--profile", "real-repo", "--run", "one", "--data", folder / data]
        agents = [Stdio(serve("a")), Stdio([REEL, "record", "--out", folder / "out", "--stdio", "--", *serve("b")])]
        for agent in agents:
            agent.rpc("tools/list")
            for _ in range(2):
                play(agent)
            agent.process.stdin.write(b"this is no JSON\n")
            agent.process.stdin.flush()
            agent.rpc("ping")
            agent.close()
        bytes_ = same(*agents, "stdio")
        assert len(list((folder / "out").glob("*.mcap"))) == 2 and not list((folder / "out").glob("*.part"))
        print(f"  {len(agents[0].said)} lines, {bytes_} bytes alike")


def test_a_stdio_server_over_http():
    """Agents that connect get a process each, and the same messages as one that starts the process itself."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        made = world(folder)
        serve = [REEL, "mcp", "--tasks", made, "--profile", "real-repo", "--run", "one", "--data", folder / "data"]
        own = Stdio(serve)
        with Recorder(None, "--json", stdio=serve) as recorder:
            agents = [Http(recorder.port), Http(recorder.port)]
            for agent in (own, *agents):
                agent.rpc("tools/list")
                play(agent)
                agent.rpc("no/such/method")
            assert agents[0].headers["Mcp-Session-Id"] != agents[1].headers["Mcp-Session-Id"]
            lines = [line.rstrip(b"\n") for line in own.said]
            for agent in agents:
                assert messages(agent) == lines, "an agent over HTTP hears other words than one that starts the server"
            # A page, or another program, that finds the port behind the recorder gets no further.
            (port,) = listening(recorder.process.pid) - {recorder.port}
            strange = Wire(port)
            hello = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": {}}).encode()
            assert strange.ask("POST", "/mcp", hello, {"Content-Type": "text/plain"})[0] == 415
            strange.port = "of.another.name"
            assert strange.ask("POST", "/mcp", hello, {"Content-Type": "application/json"})[0] == 403
            servers = children(recorder.process.pid)
            assert len(servers) == 2, servers
            assert agents[0].ask("POST", b"[]")[0] == 400
            agents[0].close()
            assert until(lambda: len(children(recorder.process.pid)) == 1), "the server of an ended session goes on"
            agents[0] = Http(recorder.port)
            # A server that dies in the middle of a session.
            (living,) = set(servers) & set(children(recorder.process.pid))
            os.kill(living, signal.SIGKILL)
            answer = agents[1].call("highlight_receptacles")
            assert "error" in answer or answer["status"] in (404, 502), answer
            assert agents[1].ask("POST", hello.replace(b"initialize", b"ping"))[0] == 404
            agents[0].rpc("ping")
            said = json.loads(recorder.stop())
            assert not children(recorder.process.pid) and len(recorder.traces()) == 2 and not recorder.parts(), said
        own.close()
    with Recorder(None, stdio=["/no/such/server"]) as recorder:
        agent = Wire(recorder.port)
        status, _, body = agent.ask("POST", "/mcp", hello, {"Content-Type": "application/json"})
        assert status == 502 and "/no/such/server" in json.loads(body)["error"]["message"], body


def messages(agent):
    """What an agent over Streamable HTTP was told by a server of standard output."""
    bodies = [body for _, _, body in agent.said]
    return [line.removeprefix(b"data: ") for body in bodies for line in body.splitlines() if line.startswith(b"data: ")]


def children(pid):
    tasks_ = pathlib.Path(f"/proc/{pid}/task").glob("*/children")
    try:
        return sorted(int(child) for task in tasks_ for child in task.read_text().split())
    except FileNotFoundError:
        return []


def listening(pid):
    """Ports of this machine on which a process listens."""
    sockets = set()
    for descriptor in pathlib.Path(f"/proc/{pid}/fd").iterdir():
        try:
            sockets.add(os.readlink(descriptor).removeprefix("socket:[").removesuffix("]"))
        except FileNotFoundError:
            pass
    rows = [line.split() for line in pathlib.Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return {int(row[1].split(":")[1], 16) for row in rows if row[3] == "0A" and row[9] in sockets}


def test_an_absolute_endpoint_leads_through_the_recorder():
    result = {"content": [{"type": "text", "text": "done"}]}
    with Instant(result, absolute=True) as server, Recorder(server.port, path="/sse") as recorder:
        agent = Sse(recorder.port)
        assert agent.target.startswith("/messages/"), agent.target
        agent.call("drive", to="there")
        agent.close()
        assert until(lambda: recorder.traces()), "the call went past the recorder"


def test_the_published_client():
    """REAL's client library (mcp 1.9.4) plays through the recorder until the server has no more tasks."""
    python = environment("mcp-1.9.4")
    client = pathlib.Path(__file__).resolve().parent.parent / "service" / "client_sse.py"
    with tempfile.TemporaryDirectory() as folder:
        made = world(folder)
        with Server("--tasks", made, "--profile", "real-repo") as server, Recorder(server.port, path="/sse") as recorder:
            done = subprocess.run([python, client, f"http://127.0.0.1:{recorder.port}/sse"], capture_output=True, text=True)
            assert done.returncode == 0, done.stderr[-1000:]
            episodes = [line for line in map(json.loads, done.stdout.splitlines()) if "success" in line]
            assert until(lambda: len(recorder.traces()) == len(episodes) and not recorder.parts()), recorder.traces()
            told = []
            for trace in recorder.traces():
                code, out, error = reel("show", trace, "--json")
                assert code == 0, error
                whole = json.loads(out)
                assert whole["end"]["reason"] == "finished" and len(whole["steps"]) >= 5
                told.append(whole["end"]["metrics"]["success"])
            assert told == [episode["success"] for episode in episodes], (told, episodes)
            print(f"  {len(told)} episodes, {sum(told)} with success, as the client says")


def test_a_hundred_sessions():
    with tempfile.TemporaryDirectory() as folder:
        made = world(folder)
        with Server("--tasks", made, "--profile", "real-repo") as server, Recorder(server.port) as recorder:
            wrong, counts = [], []

            def one(index):
                try:
                    agent = (Http if index % 2 else Sse)(recorder.port)
                    counts.append(play(agent, decisions=4))
                    agent.close()
                except Exception as error:  # noqa: BLE001
                    wrong.append(f"{index}: {type(error).__name__}: {error}")

            threads = [threading.Thread(target=one, args=(index,)) for index in range(100)]
            [thread.start() for thread in threads]
            [thread.join() for thread in threads]
            assert not wrong, wrong[:3]
            assert until(lambda: len(recorder.traces()) == 100 and not recorder.parts(), 60), len(recorder.traces())
            for trace in recorder.traces():
                code, out, error = reel("show", trace, "--json")
                assert code == 0 and len(json.loads(out)["steps"]) == 4, error
            said = recorder.stop()
            print(f"  {said.strip()}")


def test_kill_loses_no_forwarded_call():
    """The server counts the calls that reached it; each is in a recovered trace, those without a result too."""
    arrived, slow = {}, threading.Event()

    def on_call(message):
        session = message["params"]["arguments"]["session"]
        arrived[session] = arrived.get(session, 0) + 1
        if message["params"]["arguments"]["number"] >= 40:
            slow.wait(20)

    result = {"content": [{"type": "text", "text": "done"}]}
    with Instant(result, on_call=on_call) as server, Recorder(server.port, path="/sse") as recorder:
        got = [0] * 20

        def one(index):
            try:
                agent = Sse(recorder.port)
                for number in range(10_000):
                    agent.call("move", session=index, number=number)
                    got[index] = number + 1
            except (ConnectionError, OSError):
                pass

        threads = [threading.Thread(target=one, args=(index,), daemon=True) for index in range(20)]
        [thread.start() for thread in threads]
        assert until(lambda: sum(count >= 40 for count in got) >= 10, 60), got
        recorder.stop(signal.SIGKILL)
        slow.set()
        [thread.join(30) for thread in threads]
        code, out, error = reel("trace", "recover", recorder.out)
        assert code == 0, out + error
        recorded = {}
        for trace in recorder.traces():
            code, out, error = reel("show", trace, "--json")
            assert code == 0, error
            steps = json.loads(out)["steps"]
            recorded[steps[0]["input"]["call"]["arguments"]["session"]] = steps
        for session, count in arrived.items():
            steps = recorded[session]
            # The last one may have been written and not passed on.
            assert count <= len(steps) <= count + 1, (session, count, len(steps))
            assert [step["input"]["call"]["arguments"]["number"] for step in steps] == list(range(len(steps)))
            assert sum("error" not in step["outcome"] for step in steps) >= got[session]
        open_ = sum(len(recorded[session]) - got[session] for session in recorded)
        print(f"  {sum(arrived.values())} calls reached the server, {sum(map(len, recorded.values()))} are recorded, {open_} of them without a result for the agent")


def full_disk(mode):
    """A recorder whose files may not grow beyond 300 kB, before a server whose results hold 100 kB."""
    image = base64.b64encode(os.urandom(75_000)).decode()
    result = {"content": [{"type": "text", "text": "x" * 60_000}, {"type": "image", "mimeType": "image/png", "data": image}]}
    limited = ["sh", "-c", 'trap "" XFSZ; ulimit -f 600; exec "$@"', "sh"]
    with Instant(result) as server, Recorder(server.port, "--on-full", mode, before=limited) as recorder:
        agents = [Http(recorder.port), Sse(recorder.port)]
        answers = [[agent.call("move", number=number) for number in range(12)] for agent in agents]
        for agent in agents:
            agent.rpc("tools/list")
        said = recorder.log.read_text()
        return answers, len(server.calls), said, recorder.stop(), [part.stat().st_size for part in recorder.parts()]


def test_full_disk_stops():
    answers, arrived, said, report, parts = full_disk("stop")
    for session in answers:
        refused = [answer for answer in session if "error" in answer]
        assert refused and "error" in session[-1], session[-1]
        assert "reel record cannot record this" in refused[0]["error"]["message"], refused[0]
        assert "result" in session[0]
    # At most the one call of each session whose result could not be written reached the server without a result for the agent.
    got = sum("result" in answer for session in answers for answer in session)
    assert got <= arrived <= got + 2, (got, arrived)
    assert "is refused" in said and parts
    print(f"  {arrived} calls reached the server, {got} results the agents; {report.strip()}")


def test_full_disk_continues():
    answers, arrived, said, report, _ = full_disk("continue")
    assert all("result" in answer for session in answers for answer in session)
    assert arrived == 24 and "UNRECORDED" in said and "UNRECORDED" in report
    print(f"  {report.strip()}")


def test_strange_bytes_pass():
    """Bytes that are no HTTP, no JSON, too large, too many: everything arrives, nothing panics."""
    received = []

    def echo(listener):
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            threading.Thread(target=turn, args=(connection,), daemon=True).start()

    def turn(connection):
        data = b""
        while piece := connection.recv(1 << 16):
            data += piece
            connection.sendall(piece)
        received.append(data)
        connection.close()

    with socket.create_server(("127.0.0.1", 0)) as listener:
        threading.Thread(target=echo, args=(listener,), daemon=True).start()
        with Recorder(listener.getsockname()[1]) as recorder:
            noise = [b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + os.urandom(100), os.urandom(200_000), b"\x16\x03\x01" + os.urandom(300)]
            for bytes_ in noise:
                with socket.create_connection(("127.0.0.1", recorder.port)) as agent:
                    agent.settimeout(20)
                    agent.sendall(bytes_)
                    back = b""
                    while len(back) < len(bytes_):
                        back += agent.recv(1 << 16)
                assert back == bytes_
            assert until(lambda: sorted(received) == sorted(noise))
            assert "panicked" not in recorder.log.read_text()
            print(f"  {recorder.stop().strip()}")


def test_large_messages_pass():
    result = {"content": [{"type": "text", "text": "y" * 3_000_000}]}
    with Instant(result) as server, Recorder(server.port, "--message-limit", "1") as recorder:
        for agent in (Http(recorder.port), Sse(recorder.port)):
            answer = agent.call("move")
            assert len(texts(answer)[0]) == 3_000_000
            assert "result" in agent.call("move", text="z" * 2_000_000)
        said = recorder.log.read_text()
        assert "larger than 1048576 bytes" in said and "panicked" not in said, said
        print(f"  {recorder.stop().strip()}")


def test_a_mapping_file():
    mapping = """
[tools.drive_to]
is = "nav_to"
arguments = { receptacle_name = "place" }
[tools.grasp]
is = "pick"
arguments = { marker_id = "number" }
[state]
graph = "/world"
held = "/robot/holds"
"""
    world_ = {"world": {"table_1": ["cup"], "shelf_2": []}, "robot": {"holds": "cup"}}
    result = {"content": [{"type": "text", "text": "done"}], "structuredContent": world_}
    with tempfile.TemporaryDirectory() as folder, Instant(result) as server:
        file = pathlib.Path(folder) / "robot.toml"
        file.write_text(mapping)
        with Recorder(server.port, "--mapping", file, "--backend", "robot") as recorder:
            agent = Http(recorder.port)
            agent.call("drive_to", place="table_1")
            agent.call("grasp", number=3)
            agent.close()
            assert until(lambda: recorder.traces())
            code, out, error = reel("show", recorder.traces()[0], "--json")
            trace = json.loads(out)
            assert trace["header"]["backend"] == "robot"
            assert [step["tool"] for step in trace["steps"]] == ["nav_to", "pick"], error
            assert trace["steps"][1]["held"] == "cup" and "grasp" in trace["steps"][1]["input"]["policy"]["raw"]
            code, out, error = reel("replay", recorder.traces()[0])
            assert "nothing to re-execute" in out + error, out + error
        file.write_text(mapping.replace("pick", "fly"))
        code, _, error = reel("record", "--upstream", "http://127.0.0.1:1", "--out", folder, "--mapping", file)
        assert code == 2 and "line 6" in error, error


# Columns that the recorder cannot know, or that name the recording itself; docs/proxy.md explains each.
OWN = {
    "episodes": """episode_id run_id policy seed sim_version build backend trace trace_digest trace_bytes trace_modified_ns start_objects
        shortest_path_m path_length_m spl steps""",
    "steps": """text reply listed_objects sim_step robot_yaw_rad path_length_m visible_count visible_objects new_objects candidate_count latency_ns duration_ns state_digest
        chain_digest trace_offset refused_replies match_source match_categories query_known""",
    "tasks": "", "scenes": "",
}


# 32 x 18 pixels, the left half blue and the right half red.
JPEG = (
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDABQODxIPDRQSEBIXFRQYHjIhHhwcHj0sLiQySUBMS0dARkVQWnNiUFVtVkVGZIhlbXd7gYKBTmCNl4x9lnN+gXz/"
    "2wBDARUXFx4aHjshITt8U0ZTfHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHx8fHz/wAARCAASACADASIAAhEBAxEB/8QA"
    "HwAAAQUBAQEBAQEAAAAAAAAAAAECAwQFBgcICQoL/8QAtRAAAgEDAwIEAwUFBAQAAAF9AQIDAAQRBRIhMUEGE1FhByJxFDKBkaEII0KxwRVS0fAkM2JyggkK"
    "FhcYGRolJicoKSo0NTY3ODk6Q0RFRkdISUpTVFVWV1hZWmNkZWZnaGlqc3R1dnd4eXqDhIWGh4iJipKTlJWWl5iZmqKjpKWmp6ipqrKztLW2t7i5usLDxMXG"
    "x8jJytLT1NXW19jZ2uHi4+Tl5ufo6erx8vP09fb3+Pn6/8QAHwEAAwEBAQEBAQEBAQAAAAAAAAECAwQFBgcICQoL/8QAtREAAgECBAQDBAcFBAQAAQJ3AAEC"
    "AxEEBSExBhJBUQdhcRMiMoEIFEKRobHBCSMzUvAVYnLRChYkNOEl8RcYGRomJygpKjU2Nzg5OkNERUZHSElKU1RVVldYWVpjZGVmZ2hpanN0dXZ3eHl6goOE"
    "hYaHiImKkpOUlZaXmJmaoqOkpaanqKmqsrO0tba3uLm6wsPExcbHyMnK0tPU1dbX2Nna4uPk5ebn6Onq8vP09fb3+Pn6/9oADAMBAAIRAxEAPwDCooor6M5S"
    "1RRRXyJ9UVaKKK+uPlS1RRRXyJ9Uf//Z"
)


def png(width, height, pixel):
    """A PNG file of pixels by function of column and row."""
    rows = b"".join(b"\0" + b"".join(bytes(pixel(x, y)) for x in range(width)) for y in range(height))
    chunk = lambda kind, data: struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def pixels(file):
    """Width, height and rows of a PNG file in RGB."""
    width, height = struct.unpack(">II", file[16:24])
    data, at = b"", 8
    while at < len(file):
        (length,) = struct.unpack(">I", file[at : at + 4])
        data += file[at + 8 : at + 8 + length] if file[at + 4 : at + 8] == b"IDAT" else b""
        at += length + 12
    data, rows, above = zlib.decompress(data), [], bytes(width * 3)
    for row in range(height):
        kind, *line = data[row * (width * 3 + 1) : (row + 1) * (width * 3 + 1)]
        for i in range(width * 3):
            a, b, c = line[i - 3] if i > 2 else 0, above[i], above[i - 3] if i > 2 else 0
            near = min((abs(b - c), 0, a), (abs(a - c), 1, b), (abs(a + b - 2 * c), 2, c))[2]
            line[i] = (line[i] + (0, a, b, (a + b) // 2, near)[kind]) & 255
        above = line
        rows.append(line)
    return width, height, rows


def test_images_of_any_size():
    """JPEG files and PNG files of other sizes are drawn into 640 x 480, and kept as they came; what is no image is left out."""
    wide = png(1280, 720, lambda x, y: (20, 40, 220) if x < 640 else (200, 30, 30))
    tall = png(60, 120, lambda x, y: (0, 200, 0))
    kinds = [(JPEG, "image/jpeg"), (base64.b64encode(wide).decode(), "image/png"), (base64.b64encode(tall).decode(), "image/png")]
    kinds.append((base64.b64encode(b"GIF89a, or so").decode(), "image/gif"))
    for data, kind in kinds:
        with Instant({"content": [{"type": "image", "mimeType": kind, "data": data}]}) as server, Recorder(server.port) as recorder:
            agent = Http(recorder.port)
            agent.call("look")
            agent.close()
            assert until(lambda: recorder.traces())
            (trace,), left_out = recorder.traces(), kind == "image/gif"
            out = recorder.out / "images"
            code, said, error = reel("trace", "frames", trace, "--out", out)
            assert ("1 images left out" in recorder.stop()) == left_out and ("image/gif" in recorder.log.read_text()) == left_out
            if left_out:
                continue
            assert code == 0, said + error
            shown = json.loads(reel("show", trace, "--json")[1])["steps"][0]
            assert shown["digests"]["frame"], "the digest of an image that was drawn again is known"
            width, height, rows = pixels(next(path for path in sorted(out.glob("*.png")) if "sheet" not in path.name).read_bytes())
            at = lambda x, y: rows[y][3 * x : 3 * x + 3]
            assert (width, height) == (640, 480)
            if data == kinds[2][0]:
                assert at(100, 240) == [0, 0, 0] == at(540, 240) and at(320, 2)[1] > 150, (at(100, 240), at(320, 2))
            else:
                assert at(320, 20) == [0, 0, 0] == at(320, 460), at(320, 20)
                assert at(100, 240)[2] > 150 > at(100, 240)[0] and at(540, 240)[0] > 150 > at(540, 240)[2], (at(100, 240), at(540, 240))


def test_tables_beside_the_servers_own():
    """The tables of an episode, recorded by the server itself and through the recorder, value by value."""
    if subprocess.run([TABLES, "ingest", "--help"], capture_output=True).returncode:
        raise Skipped("tables", "this binary makes no tables; name one in REEL_TABLES")

    def tables(*arguments):
        done = subprocess.run([TABLES, *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        made = world(folder)
        with Server("--tasks", made, "--profile", "real-repo") as server, Recorder(server.port, "--tasks", made) as recorder:
            agent = Http(recorder.port)
            # Some are given up before the object is where it belongs.
            for decisions in (None, 7, None, 9, 3):
                play(agent, decisions)
            agent.call("finish")
            agent.close()
            assert until(lambda: len(recorder.traces()) >= 5 and not recorder.parts())
            assert until(lambda: len(server.traces()) >= 5)
            own, recorded = [], []
            # The sixth was begun by the last `finish`, and holds nothing.
            for traces, kept in ((server.traces(), own), (recorder.traces(), recorded)):
                kept.extend(sorted(traces)[:5])
            found = {}
            for name, traces in (("own", own), ("recorded", recorded)):
                store = folder / name
                tables("ingest", *traces, "--store", store)
                print(f"  {name}:", tables("store", "reward", "--store", store, "--check").strip())
                for preset in ("paper", "real-repo"):
                    tables("store", "reward", "--store", store, "--preset", preset)
                print(f"  {name}:", tables("taxonomy", "--store", store).strip().splitlines()[-1])
                asked = lambda sql: json.loads(tables("query", "--store", store, "--json", sql))
                terms = """select e.task_id, r.preset, r.version, r.step, r.component, r.value, r.reason from rewards r
                    join episodes e using (episode_id) order by 1, 2, 3, 4, 5, 6, 7"""
                found[name] = {table: asked(f"select * from {table} order by task_id") for table in ("episodes", "tasks")}
                found[name]["scenes"] = asked("select * from scenes")
                found[name]["classes"] = asked("select e.task_id, c.class, c.sub_class, c.step from classes c join episodes e using (episode_id) order by 1")
                found[name]["rewards"] = asked(terms)
            verdict(compare(found["own"], found["recorded"]))


def test_questions_among_what_only_the_camera_saw():
    """A question pays by what the camera saw. Where nothing told it, the recorder says between which totals the reward lies, and the
    server's own lies there; all other episodes have the terms of the server's own."""
    episodes = 8
    with tempfile.TemporaryDirectory() as folder:
        made = pathlib.Path(folder) / "tasks"
        code, out, error = reel("task", "generate", "--families", "SUL", "--count", episodes, "--seed", 3, "--out", made)
        assert code == 0, out + error
        with Server("--tasks", made, "--profile", "real-repo") as server, Recorder(server.port, "--tasks", made, "--json") as recorder:
            agent = Http(recorder.port)
            for number in range(episodes):
                task = json.loads(texts(agent.call("finish"))[0])
                category = task["target_object"]["category"]
                agent.call("navigate_to", receptacle_name=task["source_furniture"])
                if number % 2:
                    # Lists everything that stands there.
                    agent.call("explore_receptacle")
                agent.call("find_objects", target_category=category)
                agent.call("ask", target_category=category, target_description="which one?")
            agent.call("finish")
            agent.close()
            assert until(lambda: len(recorder.traces()) >= episodes and not recorder.parts())
            assert until(lambda: len(server.traces()) >= episodes)
            counts, log = json.loads(recorder.stop()), recorder.log.read_text()
            bounded = lost = 0
            for own, recorded in zip(server.traces(), recorder.traces()):
                terms = []
                for trace in (own, recorded):
                    code, out, error = reel("show", trace, "--json")
                    assert code == 0, error
                    steps = json.loads(out)["steps"]
                    terms.append([(step["step"], term["component"], term["value"]) for step in steps for term in step["reward"]])
                total, told = (sum(value for *_, value in each) for each in terms)
                found = re.search(re.escape(recorded.name) + r": .* between (-?[\d.]+) and (-?[\d.]+)$", log, re.MULTILINE)
                if not found:
                    assert terms[0] == terms[1], (recorded.name, terms)
                    continue
                lower, upper = map(float, found.groups())
                assert abs(told - lower) < 1e-3 and lower - 1e-3 < total < upper + 1e-3, (recorded.name, lower, told, total, upper)
                said = reel("show", recorded)[1]
                assert f"between {found.group(1)} and {found.group(2)}" in said, said[-500:]
                bounded, lost = bounded + 1, lost + (total != told)
            assert counts["open_rewards"] == bounded, (counts, bounded)
            assert 0 < lost and bounded < episodes, (lost, bounded)
            print(f"  of {episodes} episodes {bounded} have an open reward, {lost} another one than the server's own trace")


def compare(own, recorded):
    """Which columns differ besides the documented ones, and how: (table, column, one's value, the other's)."""
    differ = []

    def rows(table, here, there):
        assert len(here) == len(there) and here, (table, len(here), len(there))
        for one, other in zip(here, there):
            for column in one:
                if column not in OWN[table].split() and one[column] != other[column]:
                    differ.append((table, column, one.get("step", one.get("task_id")), one[column], other[column]))

    for table in ("episodes", "tasks", "scenes"):
        rows(table, own[table], recorded[table])
    for one, other in zip(own["episodes"], recorded["episodes"]):
        assert len(one["steps"]) == len(other["steps"]), one["task_id"]
        rows("steps", one["steps"], other["steps"])
    assert own["classes"] and own["classes"] == recorded["classes"], (own["classes"], recorded["classes"])
    assert {term["preset"] for term in own["rewards"]} == {"paper", "real-repo"}
    assert own["rewards"] == recorded["rewards"], [pair for pair in zip(own["rewards"], recorded["rewards"]) if pair[0] != pair[1]][:3]
    print(f"  {len(own['rewards'])} reward terms and {len(own['classes'])} classes are equal")
    return differ


def verdict(differ):
    columns = sorted({f"{table}.{column}" for table, column, *_ in differ})
    examples = [next(row for row in differ if f"{row[0]}.{row[1]}" == column) for column in columns]
    assert not columns, f"{len(differ)} values differ, in {columns}; e.g. {str(examples)[:3000]}"


main("test_", globals())
