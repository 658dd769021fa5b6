"""The foreign examples of docs/trajectories.md, as the libraries of their formats write them: a coding agent's trajectory in ATIF, and a
log of Inspect in one JSON document.

    ~/.cache/reel-python/formats/bin/python tests/formats/foreign.py FOLDER
"""

import pathlib
import sys

# One attempt each: the tools that were called, with what came of them. None of them saw a test after its last change.
ATTEMPTS = [
    ("parser", ["read_file", "write_file", "run_tests", "write_file"], "C"),
    ("lexer", ["read_file", "write_file"], "I"),
    ("printer", ["read_file", "write_file", "run_tests"], "C"),
    ("linker", ["read_file", "read_file"], "I"),
]


def trajectory():
    import atif

    turns = [{"source": "system", "message": "You write code."}, {"source": "user", "message": "Mend the build."}]
    for number, tool in enumerate(["read_file", "write_file", "run_tests", "write_file"]):
        turns.append({
            "source": "agent", "message": f"Now {tool}.",
            "tool_calls": [{"tool_call_id": f"c{number}", "function_name": tool, "arguments": {"path": "Makefile"}}],
            "observation": {"results": [{"source_call_id": f"c{number}", "content": f"result {number}"}]},
        })
    steps = [{"step_id": at, **turn} for at, turn in enumerate(turns, 1)]
    agent = {"name": "coder", "version": "1.2", "model_name": "some-model"}
    made = atif.Trajectory.model_validate({"schema_version": "ATIF-v1.7", "session_id": "mend-the-build", "agent": agent, "steps": steps})
    return made.model_dump_json(exclude_none=True, indent=1)


def log(folder, name, moment="2026-01-01T00:00:00+00:00"):
    """A log of every attempt, written by Inspect's own writer in the form that the name's end says."""
    from inspect_ai.log import EvalConfig, EvalDataset, EvalLog, EvalResults, EvalSample, EvalSpec, write_eval_log
    from inspect_ai.model import ChatCompletionChoice, ChatMessageAssistant, ChatMessageSystem, ChatMessageTool, ChatMessageUser, ModelOutput
    from inspect_ai.scorer import Score
    from inspect_ai.tool import ToolCall, ToolCallError

    samples = []
    for number, (task, tools, grade) in enumerate(ATTEMPTS):
        messages = [ChatMessageSystem(id=f"{task}-s", content="You write code."), ChatMessageUser(id=f"{task}-u", content=f"Mend the {task}.")]
        for at, tool in enumerate(tools):
            call = ToolCall(id=f"{task}-{at}", function=tool, arguments={"path": f"{task}.c"})
            messages.append(ChatMessageAssistant(id=f"{task}-a{at}", content=f"Now {tool}.", tool_calls=[call], model="some/model"))
            failed = ToolCallError(type="unknown", message="no such file") if task == "linker" else None
            content = "" if failed else f"result {at}"
            messages.append(ChatMessageTool(id=f"{task}-t{at}", content=content, tool_call_id=call.id, function=tool, error=failed))
        messages.append(ChatMessageAssistant(id=f"{task}-e", content="Done.", model="some/model"))
        scores = {
            "builds": Score(value=grade, explanation="make returned 0" if grade == "C" else "make returned 2"),
            "tests": Score(value={"passed": 0.25 * number, "skipped": 1}),
        }
        samples.append(EvalSample(
            id=task, epoch=1, input=f"Mend the {task}.", target="make returns 0", messages=messages, scores=scores,
            output=ModelOutput(model="some/model", choices=[ChatCompletionChoice(message=messages[-1], stop_reason="stop")]), uuid=f"sample-{task}", metadata={"repository": task},
        ))
    spec = EvalSpec(
        eval_id="eval-1", run_id="run-1", created=moment, task="builds", task_id="task-1", model="some/model", config=EvalConfig(epochs=1),
        dataset=EvalDataset(name="builds", samples=len(samples), sample_ids=[one.id for one in samples], shuffled=False),
    )
    results = EvalResults(total_samples=len(samples), completed_samples=len(samples))
    made = EvalLog(status="success", eval=spec, results=results, samples=samples)
    write_eval_log(made, str(pathlib.Path(folder) / name))
    return samples


if __name__ == "__main__":
    folder = pathlib.Path(sys.argv[1])
    (folder / "trajectory.json").write_text(trajectory() + "\n")
    log(folder, "log.json")
