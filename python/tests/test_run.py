"""Playing tasks with policies of one's own."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

import reel


def test_a_function_decides_and_sees_what_an_agent_sees(tasks: reel.Tasks, tmp_path: Path) -> None:
    seen: list[reel.Observation] = []

    def tour(observation: reel.Observation) -> reel.Action:
        seen.append(observation)
        if observation.step < 2:
            return "nav_to", {"receptacle_name": observation.receptacles[observation.step][0]}
        return '{"name": "finish", "arguments": {}}'

    episodes = reel.run(tasks, tour, out=tmp_path, progress=False, jobs=1)
    assert len(episodes) == len(tasks) and not episodes.errors
    assert all(episode.header["policy"]["name"] == "tour" and len(episode) == 3 for episode in episodes)
    assert all(reel.replay(tmp_path, progress=False))
    assert seen[0].instruction == tasks[0]["instruction"] and seen[0].text == ""
    assert seen[0].image is not None and seen[0].image.shape == (480, 640, 3)
    privileged = {"goal", "target", "objects", "instance"}
    assert not privileged & set(dir(seen[0]))
    assert episodes[0].steps[2].record["input"]["policy"]["raw"] == '{"name": "finish", "arguments": {}}'


def test_each_episode_gets_an_object_of_a_class(tasks: reel.Tasks) -> None:
    class Counting:
        def __init__(self) -> None:
            self.calls = 0

        def __call__(self, observation: reel.Observation) -> reel.Action:
            assert self.calls == observation.step
            self.calls += 1
            return ("finish", {}) if self.calls == 4 else ("walk_around", {})

    episodes = reel.run(tasks, Counting, out=None, progress=False)
    assert [report["length"] for report in episodes.reports] == [4] * len(tasks)
    with pytest.raises(reel.ReelError, match="was not recorded"):
        episodes[0]


def test_gibberish_is_answered_and_an_exception_is_raised(tasks: reel.Tasks, tmp_path: Path) -> None:
    episodes = reel.run(tasks[:1], lambda _: "I would rather not", out=tmp_path, name="talks", progress=False)
    assert episodes[0].steps[0].error == "UNKNOWN_TOOL" or episodes[0].steps[0].error is not None
    assert episodes[0].replay()

    def breaks(observation: reel.Observation) -> reel.Action:
        if observation.step == 1:
            raise ValueError("no more ideas")
        return "walk_around", {}

    message = f"task {tasks.ids[0]}, step 1: the policy raised ValueError: no more ideas"
    with pytest.raises(reel.PolicyError, match=message) as raised:
        reel.run(tasks[:1], breaks, out=tmp_path, progress=False)
    assert isinstance(raised.value.__cause__, ValueError)
    assert (raised.value.task_id, raised.value.step) == (tasks.ids[0], 1)
    assert not list(tmp_path.glob("*.part"))
    left = reel.open(next(tmp_path.glob("*breaks*.mcap")))
    assert left.end and left.end["reason"] == "aborted" and len(left) == 1
    with pytest.raises(reel.PolicyError, match=message) as raised, tasks.start(0, record=tmp_path / "f.mcap") as simulation:
        simulation.follow(breaks)
    assert isinstance(raised.value.__cause__, ValueError) and raised.value.step == 1
    assert len(reel.open(tmp_path / "f.mcap")) == 1
    with pytest.raises(reel.PolicyError, match="step 1: the policy raised ValueError: no more ideas"):
        reel.open(tmp_path / "f.mcap").branch(0, policy=breaks)

    class Unprepared:
        def __init__(self) -> None:
            raise OSError("no model")

        def __call__(self, _: reel.Observation) -> reel.Action:
            return "finish", {}

    with pytest.raises(reel.PolicyError, match="step 0: the policy raised OSError: no model"):
        reel.run(tasks[:1], Unprepared, out=None, progress=False)

    def leaves(_: reel.Observation) -> reel.Action:
        raise SystemExit(3)

    with pytest.raises(SystemExit):
        reel.run(tasks[:1], leaves, out=None, progress=False)


def test_what_a_killed_run_left_is_played_anew(tasks: reel.Tasks, tmp_path: Path) -> None:
    def play(**options: bool) -> reel.Episodes:
        return reel.run(tasks[:1], "oracle", out=tmp_path, images=False, progress=False, **options)

    (path,) = [episode.path for episode in play()]
    part = Path(f"{path}.part")
    part.write_bytes(path.read_bytes()[:1000])
    assert not play().errors and not part.exists()
    # one that is still recorded stays
    path.unlink()
    with tasks.start(0, record=path, images=False) as simulation:
        simulation.step(("walk_around", {}))
        with pytest.raises(reel.ReelError, match="unfinished recording is in the way"):
            play()
        assert part.exists()


def test_traces_are_replaced_unless_they_shall_stay(tasks: reel.Tasks, tmp_path: Path) -> None:
    options = {"out": tmp_path / "out", "name": "mine", "images": False, "progress": False}
    finish = lambda _: ("finish", {})  # noqa: E731
    (first,) = reel.run(tasks[:1], finish, replace=False, **options)
    with pytest.raises(reel.ReelError, match=r"1 of 4 traces are there already, and replace=False keeps them.*--mine--0"):
        reel.run(tasks, finish, replace=False, **options)
    assert [path.name for path in (tmp_path / "out").iterdir()] == [first.path.name]
    (second,) = reel.run(tasks[:1], lambda seen: ("finish" if seen.step else "walk_around", {}), **options)
    assert second.path == first.path and second.digest != first.digest


def test_built_in_policies_give_the_command_lines_traces(tasks: reel.Tasks, played: Path, tmp_path: Path) -> None:
    folder = next(iter({Path(report["trace"]).parent for report in reel.run(tasks, out=tmp_path / "a", progress=False).reports}))
    names = sorted(path.name for path in folder.glob("*.mcap"))
    assert names == sorted(path.name for path in played.glob("*oracle*"))
    for name in names:
        assert reel.open(folder / name).digest == reel.open(played / name).digest


def test_simulations_step_by_step(tasks: reel.Tasks, tmp_path: Path) -> None:
    with tasks.start(0, record=tmp_path / "one.mcap", group=("g", 1)) as simulation:
        result = simulation.step(("nav_to", {"receptacle_name": "no such place"}))
        assert result.observation.error and not result.terminated
        seen = simulation.render()
        assert seen.rgb.any() and simulation.calls == 1
        with tasks.start(0, images=False) as blind:
            # it renders no images by itself, and is asked for one
            blind.step(("nav_to", {"receptacle_name": "no such place"}))
            before = blind.state_digest
            assert np.array_equal(blind.render().rgb, seen.rgb) and blind.state_digest == before
            assert np.array_equal(blind.render().instance_ids, seen.instance_ids)
        result = simulation.step({"tool_name": "finish", "arguments": {}}, {"reasoning": "done", "tokens": [10, 2]})
        assert result.terminated and not result.truncated and result.end_reason == "finished"
        with pytest.raises(reel.ReelError, match="has ended"):
            simulation.step(("walk_around", {}))
    episode = reel.open(tmp_path / "one.mcap")
    assert episode.header["group_id"] == "g" and episode.header["rollout_index"] == 1
    assert episode.steps[1].reasoning == "done" and episode.replay()
    assert sum(episode.steps[0].reward_terms.values()) == pytest.approx(episode.steps[0].reward)


def test_wrong_arguments_say_what_there_is(tasks: reel.Tasks, tmp_path: Path) -> None:
    for message, call in [
        ("no profile is called 'x'", lambda: tasks.start(0, profile="x")),
        ("no reward preset is called 'x'", lambda: tasks.start(0, preset="x")),
        ("no skills are called 'x'", lambda: tasks.start(0, skills="x")),
        ("no task 9: there are 4", lambda: tasks.start(9)),
        ("no task could be loaded", lambda: reel.Tasks.load(tmp_path)),
        ("no policy is called 'x'", lambda: reel.run(tasks, "x", out=None, progress=False).errors and (_ for _ in ()).throw(
            reel.ReelError(reel.run(tasks, "x", out=None, progress=False).errors[0]))),
    ]:
        with pytest.raises(reel.ReelError, match=message):
            call()


def test_numbers_out_of_range_are_named(tasks: reel.Tasks, played: Path, planner: reel.Episode) -> None:
    seeds = "give an integer from 0 to 18446744073709551615"
    for message, call in [
        (r"jobs=-1: give an integer from 1 on, or None", lambda: reel.run(tasks, out=None, jobs=-1)),
        (r"jobs=0: give", lambda: reel.replay(played, jobs=0)),
        (rf"seed=-1: {seeds}", lambda: reel.run(tasks, out=None, seed=-1)),
        (rf"seed=18446744073709551616: {seeds}", lambda: tasks.start(0, seed=2**64)),
        (rf"seed=-1: {seeds}", lambda: planner.branch(1, policy="oracle", seed=-1)),
        (rf"seed=-1: {seeds}", lambda: reel.Tasks.generate(1, "nowhere", seed=-1)),
        (r"index in group=-1: give an integer from 0 to 4294967295", lambda: tasks.start(0, group=("g", -1))),
        (r"unknown call -99: the episode has 13 calls, from 0; .* down to -13", lambda: planner.at(-99)),
        (r"unknown call -99", lambda: planner.branch(-99, [("finish", {})])),
        (r"unknown call 36893488147419103232", lambda: planner.branch(2**65, [("finish", {})])),
        (r"unknown call -14", lambda: planner.frame(-14)),
    ]:
        with pytest.raises(ValueError, match=message) as raised:
            call()
        assert isinstance(raised.value, reel.ReelError)
    for index in (10**30, -(10**30)):
        with pytest.raises(reel.ReelError, match="there are 4, from 0"):
            tasks.start(index)


def test_tasks_travel_to_workers(tasks: reel.Tasks, tmp_path: Path) -> None:
    some = pickle.loads(pickle.dumps(tasks[1:3]))
    assert some.ids == tasks.ids[1:3] and list(some) == list(tasks[1:3]) and some.scene(0) == tasks.scene(1)
    before, after = (
        reel.run(set_, out=tmp_path / name, images=False, progress=False)
        for name, set_ in (("before", tasks[1:3]), ("after", some))
    )
    assert [episode.digest for episode in before] == [episode.digest for episode in after]


def test_meshes_that_changed_are_not_unpickled(tasks: reel.Tasks, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    asset = tasks[0]["objects"][0]["asset"]
    mesh = tmp_path / "meshes" / f"{asset}.obj"
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    mesh.write_text(triangle)
    loaded = reel.Tasks.load(tasks_folder(tasks, tmp_path), assets=tmp_path / "meshes")
    kept = pickle.dumps(loaded)
    assert pickle.loads(kept).ids == loaded.ids
    mesh.write_text(triangle.replace("v 0 0 1", "v 0 0 2"))
    with pytest.raises(reel.ReelError, match="the meshes are no longer those.*meshes"):
        pickle.loads(kept)


KERNEL = """
import sys, reel
tasks = reel.Tasks.load(sys.argv[1])
simulation = tasks.start(0, record=sys.argv[2], images=False)
for n in range(25):
    simulation.step(("walk_around", {}) if n % 2 else ("nav_to", {"receptacle_name": simulation.observe().receptacles[n % 5][0]}))
    print(n, flush=True)
"""


def test_a_killed_kernel_loses_no_acknowledged_call(tasks: reel.Tasks, tmp_path: Path) -> None:
    folder = Path(tasks_folder(tasks, tmp_path))
    for wanted in (1, 5, 11):
        path = tmp_path / f"killed-{wanted}.mcap"
        kernel = subprocess.Popen([sys.executable, "-c", KERNEL, str(folder), str(path)], stdout=subprocess.PIPE, text=True)
        assert kernel.stdout is not None
        acknowledged = -1
        for line in kernel.stdout:
            acknowledged = int(line)
            if acknowledged == wanted:
                kernel.kill()
        kernel.wait()
        reel.command("trace", "recover", f"{path}.part")
        assert len(reel.open(path)) > acknowledged >= wanted


def tasks_folder(tasks: reel.Tasks, tmp_path: Path) -> str:
    """A folder with the same tasks, for another process."""
    out = tmp_path / "tasks-again"
    reel.Tasks.generate(len(tasks), out, seed=5)
    return str(out)


def test_ctrl_c_ends_long_work(tasks: reel.Tasks, tmp_path: Path) -> None:
    script = textwrap.dedent("""
        import sys, time, reel
        paths = reel.trace_paths(sys.argv[1]) * 500
        print("begins", flush=True)
        try:
            reel.replay(paths, jobs=1, progress=False)
        except KeyboardInterrupt:
            print("stopped", flush=True)
    """)
    golden = Path(__file__).parents[2] / "traces" / "golden"
    process = subprocess.Popen([sys.executable, "-c", script, str(golden)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "begins\n"
    time.sleep(1.0)
    before = time.monotonic()
    os.kill(process.pid, signal.SIGINT)
    assert process.stdout.readline() == "stopped\n"
    assert time.monotonic() - before < 10
    assert process.wait() == 0


def test_observations_hold_arrays_of_their_own(tasks: reel.Tasks) -> None:
    with tasks.start(0) as simulation:
        image = simulation.observe().image
        assert image is not None
        image[:] = 0
        again = simulation.observe().image
        assert again is not None and again.any() and not np.shares_memory(image, again)


def test_tools_are_json_schema() -> None:
    by_name = {tool["name"]: tool for tool in reel.tools()}
    assert by_name["pick"]["parameters"]["properties"] == {"marker_id": {"type": "integer"}}
    assert "show_object_by_category" in by_name and "finish" in by_name
    assert {tool["name"] for tool in reel.tools("real-repo")} != set(by_name)


def test_tasks_are_a_sequence(tasks: reel.Tasks) -> None:
    assert [task["task_id"] for task in tasks] == tasks.ids
    with pytest.raises(IndexError, match="no task 4: there are 4"):
        tasks[4]


def test_a_policy_that_is_not_there_is_one_error(tasks: reel.Tasks, tmp_path: Path) -> None:
    with pytest.raises(reel.ReelError, match="plannr"):
        reel.run(tasks, "plannr", out=tmp_path)


def test_what_a_policy_returns_is_checked(tasks: reel.Tasks) -> None:
    with pytest.raises(reel.ReelError, match="no call: None; give"):
        reel.run(tasks[:1], lambda _: None, out=None)
    endless: list[object] = []
    endless.append(endless)
    deep: object = []
    for _ in range(20_000):
        deep = [deep]
    for value in (endless, deep):
        with pytest.raises(reel.ReelError, match="nested deeper"), tasks.start(0, images=False) as simulation:
            simulation.step(("ask", {"question": value}))
    with tasks.start(0, images=False) as simulation:
        simulation.step(("gaze_at", {"marker_id": np.int64(1)}))
        assert simulation.record(0)["input"]["call"]["arguments"] == {"marker_id": 1}


def test_ctrl_c_stops_after_the_call(tasks: reel.Tasks) -> None:
    calls = 0

    def slow(_: reel.Observation) -> reel.Action:
        nonlocal calls
        calls += 1
        if calls == 2:
            signal.raise_signal(signal.SIGINT)
        time.sleep(0.2)
        return ("walk_around", {})

    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        reel.run(tasks, slow, out=None, images=False, jobs=1, progress=False)
    assert calls < 10 and time.monotonic() - began < 20
