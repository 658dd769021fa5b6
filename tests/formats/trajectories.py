"""Trajectories in ATIF and logs of Inspect between Reel and others: Harbor's own models and those of the package `atif` validate what Reel
writes, Inspect and Inspect Scout read it, and what their own writers wrote of another agent becomes traces. Where the packages cannot be
installed, it says so.

    REEL=~/.cache/reel/debug/reel python3 tests/formats/trajectories.py
"""

import json
import os
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).resolve().parent
REEL = os.environ.get("REEL", "reel")


def reel(folder, *arguments, code=0):
    done = subprocess.run([REEL, *map(str, arguments)], cwd=folder, capture_output=True, text=True)
    assert done.returncode == code, f"reel {arguments}: {done.returncode}: {done.stdout}{done.stderr}"
    return done.stdout


def written(folder):
    """Documents of a few episodes, with and without images, with and without a model's words."""
    reel(folder, "task", "generate", "--count", 3, "--seed", 3, "--out", "tasks")
    for policy, images in (("planner", []), ("wrong-object", ["--no-images"])):
        reel(folder, "run", "--tasks", "tasks", "--policy", policy, *images, "--out", "traces")
    told = reel(folder, "export", "atif", "traces", "--out", "documents", "--json").splitlines()
    return [json.loads(line) for line in told[:-1]]


def validated(folder, documents):
    """Every document is one to both libraries, which read all of it: what they write again is the same."""
    import atif
    from harbor.models.trajectories import Trajectory

    for document in documents:
        text = (folder / document["document"]).read_text()
        for model in (Trajectory, atif.Trajectory):
            read = model.model_validate_json(text)
            again = read.model_dump(mode="json", exclude_unset=True)
            assert again == json.loads(text), f"{model.__module__} reads another document"
            assert len(read.steps) == document["steps"]
        images = [part.source.path for step in read.steps for part in parts(step)]
        assert len(images) == document["images"], f"{images}"
        for image in images:
            assert (folder / "documents" / image).read_bytes()[8:12] == b"WEBP"
    print(f"{len(documents)} documents are valid for Harbor and for the package atif")


def parts(step):
    contents = [step.message, *(result.content for result in (step.observation.results if step.observation else []))]
    return [part for content in contents if isinstance(content, list) for part in content if part.type == "image"]


def seen_by_scout(folder, documents):
    """Inspect Scout has every call with its result."""
    import asyncio
    from inspect_scout.sources import atif

    async def read():
        return [transcript async for transcript in atif(folder / "documents")]

    transcripts = asyncio.run(read())
    assert len(transcripts) == len(documents), f"{len(transcripts)} transcripts of {len(documents)} documents"
    calls = sum(len(message.tool_calls or []) for one in transcripts for message in one.messages if message.role == "assistant")
    results = sum(message.role == "tool" for one in transcripts for message in one.messages)
    steps = sum(document["steps"] - 1 for document in documents)
    assert calls == results == steps, f"{calls} calls, {results} results, {steps} steps"
    print(f"Inspect Scout reads {len(transcripts)} transcripts with {calls} calls")


def of_another_agent(folder):
    """A coding agent's trajectory, made with the package, is a trace whose calls SQL counts."""
    import atif

    tools = ["bash", "read_file", "bash", "write_file", "bash"]
    turns = [{"source": "system", "message": "You write code."}, {"source": "user", "message": "Mend the build."}]
    for number, tool in enumerate(tools):
        turns.append({
            "source": "agent", "message": f"Now {tool}.", "reasoning_content": "Because.",
            "tool_calls": [{"tool_call_id": f"c{number}", "function_name": tool, "arguments": {"at": number}}],
            "observation": {"results": [{"source_call_id": f"c{number}", "content": f"result {number}"}]},
            "metrics": {"prompt_tokens": 100 + number, "completion_tokens": 7},
        })
    steps = [{"step_id": at, **turn} for at, turn in enumerate(turns, 1)]
    agent = {"name": "coder", "version": "1.2", "model_name": "some-model"}
    made = atif.Trajectory.model_validate({"schema_version": "ATIF-v1.7", "session_id": "job-1", "agent": agent, "steps": steps})
    (folder / "foreign").mkdir()
    (folder / "foreign" / "trajectory.json").write_text(made.model_dump_json(exclude_none=True))
    reel(folder, "import", "atif", "foreign", "--out", "imported")
    reel(folder, "ingest", "imported", "--store", "store")
    sql = "SELECT tool, count(*) AS calls FROM steps WHERE policy = 'coder' GROUP BY tool ORDER BY tool"
    counted = {row["tool"]: row["calls"] for row in json.loads(reel(folder, "query", "--store", "store", "--json", sql))}
    assert counted == {tool: tools.count(tool) for tool in tools}, f"{counted}"
    # And out again, with the same words.
    reel(folder, "export", "atif", "imported", "--out", "out")
    [again] = (folder / "out").glob("*.json")
    read = atif.Trajectory.model_validate_json(again.read_text())
    kept = ["source", "message", "reasoning_content", "tool_calls", "observation"]
    said, expected = ([[step.model_dump(exclude_unset=True).get(name) for name in kept] for step in one.steps] for one in (read, made))
    for step in (*said, *expected):
        for part in (*(step[3] or []), *((step[4] or {}).get("results") or [])):
            # Numbers of calls are Reel's own.
            part.pop("tool_call_id", None), part.pop("source_call_id", None)
    assert said == expected, f"{said}"
    assert [step.metrics.prompt_tokens for step in read.steps if step.metrics] == [100, 101, 102, 103, 104]
    print(f"a foreign trajectory of {len(tools)} calls is read, counted and written again")


def logs_open(folder):
    """Inspect reads every log as Reel wrote it, one sample an episode, and Scout every call with its result."""
    import asyncio
    from inspect_ai.log import list_eval_logs, read_eval_log, read_eval_log_sample, read_eval_log_sample_summaries
    from inspect_scout import transcripts_from

    told = [json.loads(line) for line in reel(folder, "export", "inspect", "traces", "--out", "logs", "--json").splitlines()[:-1]]
    assert len(list_eval_logs(str(folder / "logs"))) == len(told) == 2, f"{told}"
    calls = images = 0
    for one in told:
        log = read_eval_log(str(folder / one["log"]))
        assert (log.status, log.eval.model, len(log.samples)) == ("success", one["policy"], one["samples"]), f"{log.eval}"
        summaries = read_eval_log_sample_summaries(str(folder / one["log"]))
        assert [one.id for one in summaries] == log.eval.dataset.sample_ids
        won = [sample.scores["success"].value for sample in log.samples]
        assert won == (["C"] if one["policy"] == "planner" else ["I"]) * len(won), f"{won}"
        [mean] = [score.metrics["mean"].value for score in log.results.scores if score.name == "success"]
        assert mean == (one["policy"] == "planner")
        for sample in log.samples:
            again = read_eval_log_sample(str(folder / one["log"]), sample.id, sample.epoch)
            assert again.messages == sample.messages and sample.metadata["reel"]["task"]["task_id"] == sample.id
            calls += sum(len(message.tool_calls or []) for message in sample.messages if message.role == "assistant")
            contents = [message.content for message in sample.messages if isinstance(message.content, list)]
            images += sum(part.type == "image" and part.image.startswith("data:image/webp") for content in contents for part in content)

    async def read():
        async with transcripts_from(str(folder / "logs")).reader() as reader:
            from inspect_scout import TranscriptContent
            return [await reader.read(info, TranscriptContent(messages="all")) async for info in reader.index()]

    transcripts = asyncio.run(read())
    seen = sum(len(message.tool_calls or []) for one in transcripts for message in one.messages if message.role == "assistant")
    assert seen == calls > 0 and images > 0, f"{seen} of {calls} calls, {images} images"
    print(f"Inspect and Scout read {len(transcripts)} samples with {calls} calls and {images} images")


def of_an_evaluation(folder):
    """A log that Inspect's own writer made, in both of its forms, is traces whose scores and failed calls SQL finds."""
    sys.path.insert(0, str(HERE))
    import foreign

    (folder / "evaluated").mkdir()
    samples = foreign.log(folder / "evaluated", "one.eval")
    reel(folder, "import", "inspect", "evaluated", "--out", "samples")
    foreign.log(folder, "one.json")
    reel(folder, "import", "inspect", "one.json", "--out", "samples-of-json")
    assert same_files(folder / "samples", folder / "samples-of-json"), "the two forms of a log give other traces"
    reel(folder, "ingest", "samples", "--store", "evaluated-store")
    sql = ("SELECT task_id, policy, family, target, success, completion, total_reward, scores, length, "
           "sequence_count(steps, '_[failed]') AS failed FROM episodes")
    rows = {row["task_id"]: row for row in json.loads(reel(folder, "query", "--store", "evaluated-store", "--json", sql))}
    for number, (task, tools, grade) in enumerate(foreign.ATTEMPTS):
        row = rows.pop(f"builds/{task}")
        assert row["policy"] == "some/model" and row["family"] == "other" and row["target"] == "", f"{row}"
        assert row["success"] is (grade == "C") and row["completion"] is row["total_reward"] is None, f"{row}"
        # Each call is a step, and so is what was said at the end.
        assert row["length"] == len(tools) + 1 and row["failed"] == (len(tools) if task == "linker" else 0), f"{row}"
        values = {score["name"]: (score["value"], score["label"]) for score in row["scores"]}
        assert values == {"builds": (float(grade == "C"), grade), "tests.passed": (0.25 * number, None), "tests.skipped": (1, None)}, f"{values}"
    assert not rows, f"{rows}"
    reel(folder, "import", "inspect", "evaluated", "--success", "tests.passed>=0.5", "--out", "by-tests")
    shown = [reel(folder, "show", trace) for trace in sorted((folder / "by-tests").glob("*.mcap"))]
    assert sum("SUCCESS" in text for text in shown) == 2 and sum("FAILURE" in text for text in shown) == 2
    # The same conversations and scores come out again.
    from inspect_ai.log import read_eval_log

    reel(folder, "export", "inspect", "samples", "--out", "evaluated-again")
    [log] = (folder / "evaluated-again").glob("*.eval")
    again = {sample.id.removeprefix("builds/"): sample for sample in read_eval_log(str(log)).samples}
    for sample in samples:
        said, expected = ([(one.role, one.text, [call.function for call in getattr(one, "tool_calls", None) or []]) for one in of.messages]
                          for of in (again[sample.id], sample))
        if sample.id != "linker":
            assert said == expected, f"{said}"
        assert again[sample.id].target == sample.target and again[sample.id].scores["builds"].value == sample.scores["builds"].value
    print(f"a log of {len(samples)} samples is read in both of its forms, counted and written again")


def faults_and_missing_scores(folder):
    """What ended in a fault, or was not scored, is read from Inspect's own writer, and Inspect reads it from Reel."""
    import foreign
    from inspect_ai.log import EvalError, EvalSampleLimit, read_eval_log, read_eval_log_sample_summaries, write_eval_log
    from inspect_ai.scorer import Score

    (folder / "seldom").mkdir()
    foreign.log(folder / "seldom", "one.eval")
    log = read_eval_log(str(folder / "seldom" / "one.eval"))
    log.samples[0].error = EvalError(message="the sandbox died", traceback="at", traceback_ansi="at")
    log.samples[1].scores = {"builds": Score.unscored(explanation="no grade"), "tests": Score(value={"passed": 0.5, "none": None})}
    limits = {log.samples[2].id: EvalSampleLimit(type="token", limit=1000), log.samples[3].id: None}
    log.samples[2].limit = limits[log.samples[2].id]
    for name in ("one.eval", "two.json"):
        write_eval_log(log, str(folder / "seldom" / name))
    told = reel(folder, "import", "inspect", "seldom", "--out", "seldom-traces")
    assert f"{2 * len(log.samples)} of {2 * len(log.samples)} episodes imported" in told, f"{told}"
    reel(folder, "export", "inspect", "seldom-traces", "--out", "seldom-again")
    [path] = (folder / "seldom-again").glob("*.eval")
    again = {sample.id.removeprefix("builds/"): sample for sample in read_eval_log(str(path)).samples}
    assert again[log.samples[0].id].error.message == "the sandbox died"
    scores = again[log.samples[1].id].scores
    values = {name: None if score.value != score.value else score.value for name, score in scores.items()}
    assert values == {"builds": None, "tests.passed": 0.5, "tests.none": None}, f"{values}"
    assert scores["builds"].explanation == "no grade"
    assert {name: again[name].limit for name in limits} == limits
    summaries = {summary.id.removeprefix("builds/"): summary for summary in read_eval_log_sample_summaries(str(path))}
    assert [summaries[name].limit for name in limits] == ["token", None]
    print("faults, limits, and scores that were not given go both ways")


def same_files(one, other):
    return {path.name: path.read_bytes() for path in one.iterdir()} == {path.name: path.read_bytes() for path in other.iterdir()}


def examples_are_theirs(folder):
    """The examples of docs/trajectories.md are what the libraries write today."""
    import foreign

    kept = HERE / "foreign"
    assert json.loads(foreign.trajectory()) == json.loads((kept / "trajectory.json").read_text()), "tests/formats/foreign/trajectory.json is stale"
    foreign.log(folder, "log.json")
    assert json.loads((folder / "log.json").read_text()) == json.loads((kept / "log.json").read_text()), "tests/formats/foreign/log.json is stale"


def main():
    if "--inside" not in sys.argv:
        made = subprocess.run([HERE.parent / "python.sh", "formats"], capture_output=True, text=True)
        if made.returncode:
            print(f"skipped: python: third-party readers cannot be installed: {made.stderr.strip()[-300:]}")
            return 0
        return subprocess.run([made.stdout.strip(), __file__, "--inside"]).returncode
    with tempfile.TemporaryDirectory(prefix="reel-atif-") as folder:
        folder = pathlib.Path(folder)
        documents = written(folder)
        validated(folder, documents)
        seen_by_scout(folder, documents)
        of_another_agent(folder)
        logs_open(folder)
        of_an_evaluation(folder)
        faults_and_missing_scores(folder)
        examples_are_theirs(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
