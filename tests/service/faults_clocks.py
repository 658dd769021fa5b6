"""Faults: clocks that jump."""

import glob
import pathlib
import tempfile
import time

from faults_kit import DAY_S, QUICK, serving
from harness import Agent, Skipped, until


def fault_wall_time_is_in_no_trace():
    """Two servers at different times, equal runs, workers and calls: equal bytes."""
    made = []
    for number in range(2):
        with serving("--run", "same") as server:
            time.sleep(1.1 * number)
            agent = Agent(server, worker="a")
            scripted(agent)
            made.append({path.name: path.read_bytes() for path in server.traces()})
    assert made[0].keys() == made[1].keys() and len(made[0]) == 2, [sorted(found) for found in made]
    assert made[0] == made[1], "the bytes differ"


#: Two episodes, the second one broken off.
SCRIPT = [
    ("finish", {}), ("nav_to", {"receptacle_name": "table_1"}), ("show_receptacles", {}), ("ask", {"question": "which?"}),
    ("pick", {"marker_id": 1}), ("finish", {}), ("walk_around", {}), ("finish", {}),
]


def scripted(agent):
    for tool, arguments in SCRIPT:
        agent.call(tool, **arguments)


def faketime():
    """The library by which a process sees another wall clock."""
    places = ["/usr/lib/*", "/usr/lib*", "/usr/local/lib"]
    found = [path for place in places for path in glob.glob(f"{place}/faketime/libfaketimeMT.so.1")]
    if not found:
        raise Skipped("faketime", "libfaketime is not installed (apt-get install faketime)")
    return found[0]


def fault_clock_jumps():
    """The wall clock jumps days ahead, years back, to the day it began: sessions are neither parked nor closed, their idleness
    and their calls go on, jobs and tokens work, and the traces are those of a clock that stands fast, to the byte."""
    library = faketime()
    with tempfile.TemporaryDirectory(prefix="reel-faults-") as folder, serving("--run", "same") as honest:
        scripted(Agent(honest, worker="a"))
        clock = pathlib.Path(folder) / "clock"
        clock.write_text("+0")
        other = {
            "LD_PRELOAD": library, "FAKETIME_TIMESTAMP_FILE": str(clock), "FAKETIME_NO_CACHE": "1",
            "FAKETIME_DONT_FAKE_MONOTONIC": "1", "DONT_FAKE_MONOTONIC": "1",
        }
        config = "[limits]\nsuspend_after_s = 120\nclose_after_s = 240\n"
        with serving("--run", "same", config=config, folder=folder, environment=other) as server:
            #: Where the clock goes, and how far that is from now; none where it is the year that is named.
            jumps = [
                ("+3d", 3 * DAY_S), ("@2099-12-31 23:59:58", None), ("-400d", -400 * DAY_S), ("@1970-01-02 00:00:00", None),
                ("+0", 0),
            ]
            agent, idle = Agent(server, worker="a"), Agent(server, worker="idle")
            idle.call("finish"), idle.call("finish")
            since, script = time.monotonic(), iter(SCRIPT)

            def play():
                tool, arguments = next(script)
                return agent.call(tool, **arguments)

            play()
            for jump, by in jumps[1::2] if QUICK else jumps:
                clock.write_text(jump)
                # The next round in which the server looks after its sessions sees the new time.
                time.sleep(1.3)
                entries = {entry["session"]: entry for entry in server.json("GET", "/api/sessions")[1]}
                entry = entries.get("w-idle")
                assert entry and entry["state"] == "playing", f"after the jump to {jump} the idle session is {entry}"
                idle_s = entry["idle_s"]
                assert idle_s <= time.monotonic() - since + 1, f"after the jump to {jump} it is idle for {idle_s} s"
                assert play()["content"], jump
                job = server.json("POST", "/api/jobs", {"kind": "ingest"})
                assert job[0] == 202, job
                year, ahead = time.gmtime(job[1]["created"]).tm_year, job[1]["created"] - time.time()
                if abs(ahead - by) > 60 if by is not None else str(year) not in (jump[1:5], "2100"):
                    raise Skipped("faketime", f"the clock of a process cannot be changed here: at {jump} it is in {year}")
            for tool, arguments in script:
                agent.call(tool, **arguments)
            jobs = lambda: server.json("GET", "/api/jobs")[1]  # noqa: E731
            assert until(lambda: all(job["state"] not in ("waiting", "running") for job in jobs()), 30), "jobs do not end"
            assert all(job["state"] == "done" for job in jobs()), jobs()
            made = {path.name: path.read_bytes() for path in server.traces() if "--w-a--" in path.name}
            same = {path.name: path.read_bytes() for path in honest.traces()}
            assert made.keys() == same.keys(), (made.keys(), same.keys())
            differ = [name for name in made if made[name] != same[name]]
            assert not differ, f"the clock is in {differ}"
