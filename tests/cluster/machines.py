"""Machines that are network namespaces of this one: each has an address of its own and reaches the others by the network alone.

Where namespaces are not allowed, processes at several loopback addresses stand in, and that is said.
"""

import itertools
import os
import signal
import subprocess
import sys

BRIDGE = "reelbr0"
BRIDGE_ADDRESS = "10.77.0.1"


def run(*command):
    subprocess.run(command, check=True, capture_output=True)


class Machines:
    """Named machines; `start` runs a process on one. Everything is taken down at the end."""

    def __init__(self, names):
        self.processes, self.apart = {}, self._namespaces(names)
        if not self.apart:
            print("skipped: network namespaces are not allowed here; processes at 127.0.0.x stand in for machines", file=sys.stderr)
        # of this machine, where the others reach it
        self.here = BRIDGE_ADDRESS if self.apart else "127.0.0.1"
        self.address = {name: f"10.77.0.{number}" if self.apart else f"127.0.0.{number}" for number, name in enumerate(names, 10)}

    def _namespaces(self, names):
        self.names = list(names)
        self._remove(names)
        try:
            run("ip", "link", "add", BRIDGE, "type", "bridge")
            run("ip", "addr", "add", f"{BRIDGE_ADDRESS}/24", "dev", BRIDGE)
            run("ip", "link", "set", BRIDGE, "up")
            for number, name in enumerate(names, 10):
                space, inside, outside = f"reel-{name}", f"rv{number}i", f"rv{number}o"
                run("ip", "netns", "add", space)
                run("ip", "link", "add", outside, "type", "veth", "peer", "name", inside)
                run("ip", "link", "set", outside, "master", BRIDGE, "up")
                run("ip", "link", "set", inside, "netns", space)
                within = lambda *command: run("ip", "netns", "exec", space, *command)
                within("ip", "addr", "add", f"10.77.0.{number}/24", "dev", inside)
                within("ip", "link", "set", inside, "up")
                within("ip", "link", "set", "lo", "up")
            return True
        except (subprocess.CalledProcessError, FileNotFoundError):
            self._remove(names)
            return False

    @staticmethod
    def _remove(names):
        for name in names:
            subprocess.run(["ip", "netns", "del", f"reel-{name}"], capture_output=True)
        subprocess.run(["ip", "link", "del", BRIDGE], capture_output=True)

    def command(self, machine, command):
        return ["ip", "netns", "exec", f"reel-{machine}", *command] if self.apart else list(command)

    def start(self, machine, command, log, **options):
        """A process of its own group, its output in a file."""
        with open(log, "ab") as out:
            process = subprocess.Popen(self.command(machine, command), stdout=out, stderr=out, start_new_session=True, **options)
        self.processes.setdefault(machine, []).append(process)
        return process

    def kill(self, machine):
        """As a power cut would."""
        for process in self.processes.pop(machine, []):
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()

    def close(self):
        for machine in list(self.processes):
            self.kill(machine)
        if self.apart:
            self._remove(self.names)
