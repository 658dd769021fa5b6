"""Recorded episodes: reading, replaying, other futures."""

from __future__ import annotations

import pickle
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import reel


def test_an_episode_says_what_happened(planner: reel.Episode) -> None:
    assert planner.success is True
    assert len(planner) == len(planner.steps) == len(planner.rewards)
    assert planner.rewards.dtype == np.float64
    assert planner.total_reward == pytest.approx(planner.rewards.sum())
    step = planner.steps[-1]
    assert step.tool == "finish" and step.call == "finish()"
    assert planner.steps[-1].index == len(planner) - 1
    assert [step.index for step in planner.steps[2:4]] == [2, 3]
    assert planner.events and all("step" in event for event in planner.events)
    assert planner.graphs(None) != planner.graphs(-1)
    assert "FDO" in planner.header["task_id"] and planner.instruction in planner.transcript()


def test_replay_is_exact_and_a_tampered_trace_is_refused(planner: reel.Episode, tmp_path: Path) -> None:
    verdict = planner.replay()
    assert verdict and verdict.exact and str(verdict).startswith("exact: ")
    assert verdict.details["calls"] == len(planner)
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(planner.path.read_bytes()[:-2000])
    with pytest.raises(reel.ReelError, match="13 steps are readable, recover them"):
        reel.open(torn)
    with pytest.raises(reel.ReelError, match="no-such.mcap"):
        reel.open(tmp_path / "no-such.mcap")
    with pytest.raises(reel.ReelError, match="unknown call 99"):
        planner.frame(99)
    with pytest.raises(reel.ReelError, match=r"is a folder.*reel.trace_paths.*reel.scan_traces"):
        reel.open(tmp_path)
    for nothing in ([], ()):
        with pytest.raises(reel.ReelError, match="no paths are given: the list is empty"):
            reel.replay(nothing)


def test_frames_are_the_agents(planner: reel.Episode, played: Path) -> None:
    frames = list(planner.frames)
    assert frames and all(image.shape == (480, 640, 3) and image.dtype == np.uint8 for _, image in frames)
    recorded = reel.open(next(played.glob("*oracle*")))
    call, image = list(recorded.frames)[-1]
    drawn = recorded.render(call=call)
    assert np.array_equal(image, drawn.rgb)
    assert drawn.depth_mm.dtype == np.uint16 and drawn.depth_mm.max() > 1000
    names = {item["id"] for item in recorded.instances} if "id" in recorded.instances[0] else None
    assert names is None or set(np.unique(drawn.instance_ids)) - {0} <= names
    # the array owns its pixels: nothing of the trace is shared or copied again
    assert image.flags.writeable
    top = recorded.render("top-down", call=0)
    free = recorded.render("free", call=0, eye=(0, 0, 2), look_at=(1, 1, 0.5))
    assert not np.array_equal(top.rgb, free.rgb)


def test_a_branch_is_a_trace_like_any_other(planner: reel.Episode, tmp_path: Path) -> None:
    at = 2
    branch = planner.branch(at, [("walk_around", {})], then="parent", out=tmp_path / "branch.mcap")
    assert branch.path == tmp_path / "branch.mcap"
    assert branch.header["parent"]["call"] == at and branch.header["parent"]["trace"] == planner.digest
    assert branch.steps[at].tool == "walk_around" and branch.replay()
    assert planner.diff(branch).first_difference == at
    oracle = planner.branch(1, policy="oracle")
    assert oracle.success and oracle.replay()

    def gives_up(observation: reel.Observation) -> reel.Action:
        assert observation.step >= 3
        return {"name": "finish", "arguments": {}, "reasoning": "enough"}

    mine = planner.branch(3, policy=gives_up)
    assert len(mine) == 4 and mine.success is False and mine.replay()
    assert mine.steps[3].reasoning == "enough"
    with pytest.raises(reel.ReelError, match="say what happens at call 1"):
        planner.branch(1)
    with pytest.raises(reel.ReelError, match="no policy is called 'nobody'"):
        planner.branch(1, policy="nobody")


@pytest.mark.parametrize(
    "call",
    ["finish", '{"name": "finish"}', {"name": "finish", "arguments": {}}, ("finish", {}), ["pick", {"marker_id": 1}]],
)
def test_one_call_alone_is_no_list_of_calls(planner: reel.Episode, call: Any) -> None:
    with pytest.raises(reel.ReelError, match=r"one call alone, not a list of calls; put it in a list: \["):
        planner.branch(2, call)
    assert planner.branch(2, [call]).steps[2].tool in ("finish", "pick")


def test_a_tuple_of_calls_is_a_list_of_calls(planner: reel.Episode) -> None:
    for calls in (("walk_around", "finish"), ("walk_around", {"name": "finish"}), (("walk_around", {}), ("finish", {}))):
        branch = planner.branch(1, calls)
        assert [step.tool for step in branch.steps[1:]] == ["walk_around", "finish"]


def test_forks_are_bit_identical(planner: reel.Episode) -> None:
    fork = planner.at(3)
    calls = [(step.tool, step.arguments) for step in planner.steps[3:]]
    digests = [step.record["digests"]["state"] for step in planner.steps]
    for _ in range(3):
        with fork.play(images=False) as simulation:
            assert simulation.state_digest == digests[2]
            for index, call in enumerate(calls, start=3):
                simulation.step(call)
                assert simulation.state_digest == digests[index]
            assert simulation.ended == "finished"
        assert simulation.report and simulation.report["success"]
    with pytest.raises(reel.ReelError, match="the episode ended with call"):
        planner.at(len(planner))


def test_blame_names_the_decisive_step(played: Path) -> None:
    failed = [episode for path in sorted(played.glob("*wrong-receptacle*")) if not (episode := reel.open(path)).success]
    assert failed
    explanation = failed[0].blame()
    assert explanation.decisive is not None and explanation.why and explanation.cause
    assert explanation.better is not None and explanation.better.success and explanation.better.replay()
    assert explanation.advised_call is not None
    tool, arguments = explanation.advised_call
    assert tool in {spec["name"] for spec in reel.tools()} and isinstance(arguments, dict)
    at = explanation.decisive.index
    assert (tool, arguments) != (explanation.decisive.tool, explanation.decisive.arguments)
    step = failed[0].branch(at, [explanation.advised_call]).steps[at]
    assert (step.tool, step.arguments) == explanation.advised_call
    better = explanation.better.steps[at]
    assert (better.tool, better.arguments) == explanation.advised_call


def test_blame_of_a_success_advises_nothing(planner: reel.Episode) -> None:
    explanation = planner.blame()
    assert planner.success and explanation.decisive is None and explanation.advised_call is None


def test_rerun_gets_a_recording(planner: reel.Episode, tmp_path: Path) -> None:
    recording = planner.save_rerun(tmp_path / "episode.rrd")
    assert recording.read_bytes()[:3] == b"RRF"
    with pytest.raises(reel.ReelError, match="smell"):
        planner.save_rerun(tmp_path / "x.rrd", layers="smell")


def test_episodes_travel_to_workers(planner: reel.Episode) -> None:
    again = pickle.loads(pickle.dumps(planner))
    assert again == planner and len({again, planner}) == 1 and again.steps[0].call == planner.steps[0].call


def test_work_runs_outside_the_interpreters_lock(golden: Path) -> None:
    ticks = 0
    done = threading.Event()

    def tick() -> None:
        nonlocal ticks
        while not done.is_set():
            ticks += 1
            time.sleep(0.001)

    thread = threading.Thread(target=tick)
    thread.start()
    before = ticks
    verdicts = reel.replay(sorted(golden.glob("*.mcap"))[:6], jobs=2, progress=False)
    during = ticks - before
    done.set()
    thread.join()
    assert all(verdicts) and during > 20


def test_many_replays_come_in_order(golden: Path) -> None:
    paths = reel.trace_paths(golden / "*planner*.mcap")
    assert paths == sorted(paths)
    assert [verdict.name for verdict in reel.replay(paths, progress=False)] == ["exact"] * len(paths)
