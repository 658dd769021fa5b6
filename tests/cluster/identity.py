"""A cluster with identities on the loopback, and strangers at each of its ports: `identity.py`; the command is $REEL.

Whoever shows no certificate of the cluster's authority gets no word of the protocol, from the scheduler and from an executor;
whoever shows one gets answers, and the same ones as without a cluster."""

import os
import pathlib
import signal
import socket
import ssl
import subprocess
import sys
import tempfile
import time

REEL = os.environ.get("REEL", "reel")
#: How a client of HTTP/2 begins, with empty settings. A server answers with its own.
HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
SETTINGS = 4
PATIENCE_S = 30
TRACES = pathlib.Path(__file__).resolve().parents[2] / "traces" / "golden"


def run(*arguments):
    done = subprocess.run([REEL, *map(str, arguments)], capture_output=True, text=True, timeout=120)
    return done.returncode, done.stdout, done.stderr


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def listens(port):
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        try:
            socket.create_connection(("127.0.0.1", port), 1).close()
            return True
        except OSError:
            time.sleep(0.1)
    return False


def tls(authority, identity=None):
    context = ssl.create_default_context(cafile=authority)
    context.set_alpn_protocols(["h2"])
    if identity:
        context.load_cert_chain(identity)
    return context


def speaks(port, context=None):
    """Whether a port talks HTTP/2 to a client of this kind."""
    try:
        wire = socket.create_connection(("127.0.0.1", port), 5)
        if context:
            wire = context.wrap_socket(wire, server_hostname="reel-cluster")
        wire.sendall(HELLO)
        wire.settimeout(5)
        heard = wire.recv(9)
        wire.close()
        return len(heard) == 9 and heard[3] == SETTINGS
    except (OSError, ssl.SSLError):
        return False


def main():
    with tempfile.TemporaryDirectory(prefix="reel-identity-") as folder:
        folder = pathlib.Path(folder)
        ours, theirs = folder / "ours", folder / "theirs"
        assert run("cluster", "cert", "--out", ours, "scheduler", "one", "ann")[0] == 0
        assert run("cluster", "cert", "--out", theirs, "one", "eve")[0] == 0
        assert (ours / "ann.pem").stat().st_mode & 0o77 == 0, "others may read a key"
        code, _, err = run("cluster", "cert", "--out", ours, "ann")
        assert code == 2 and "ann.pem" in err, f"a file of identity was replaced: {code} {err}"
        store = folder / "store"
        code, out, err = run("ingest", "--store", store, TRACES)
        assert code == 0, out + err
        scheduler, executor = free_port(), free_port()
        services = []

        def start(*arguments):
            log = open(folder / f"{len(services)}.log", "wb")
            services.append(subprocess.Popen([REEL, "cluster", *map(str, arguments)], stdout=log, stderr=log))

        try:
            at = f"127.0.0.1:{scheduler}"
            start("scheduler", "--listen", at, "--identity", ours / "scheduler.pem")
            assert listens(scheduler), "no scheduler"
            start("executor", "--scheduler", at, "--listen", f"127.0.0.1:{executor}", "--jobs", 1, "--identity", ours / "one.pem", "--stores", store)
            assert listens(executor), (folder / "1.log").read_text()
            for port in (scheduler, executor):
                authority = ours / "authority.pem"
                assert speaks(port, tls(authority, ours / "ann.pem")), "a member is not answered"
                assert not speaks(port), "in the clear"
                assert not speaks(port, tls(authority)), "without a certificate"
                stranger = tls(theirs / "authority.pem", theirs / "eve.pem")
                stranger.check_hostname, stranger.verify_mode = False, ssl.CERT_NONE
                assert not speaks(port, stranger), "with the certificate of another authority"
            sql = "SELECT family, count(*) AS n, sum(total_reward) AS r FROM episodes GROUP BY 1 ORDER BY 1"
            alone = run("query", "--store", store, "--json", sql)
            assert alone[0] == 0, alone
            asked = run("query", "--store", store, "--json", "--cluster", at, "--identity", ours / "ann.pem", sql)
            assert asked == alone, (asked, alone)
            strangers = [[], ["--identity", theirs / "eve.pem"]]
            for identity in strangers:
                code, out, err = run("query", "--store", store, "--cluster", at, *identity, sql)
                assert code == 2 and not out and "identit" in err and "panicked" not in err, (identity, code, out, err)
            # The other way round, nobody with an identity is talked into speaking in the clear.
            plain = free_port()
            start("scheduler", "--listen", f"127.0.0.1:{plain}")
            assert listens(plain)
            code, out, err = run("query", "--store", store, "--cluster", f"127.0.0.1:{plain}", "--identity", ours / "ann.pem", sql)
            assert code == 2 and "panicked" not in err, (code, out, err)
            for service in services:
                assert service.poll() is None, "an attack ended a process"
        finally:
            for service in services:
                service.send_signal(signal.SIGKILL)
                service.wait()
    print("a cluster with identities answers its members, and nobody else")


if __name__ == "__main__":
    main()
    sys.exit(0)
