"""The foreign examples of docs/trajectories.md and docs/opentelemetry.md, as the libraries of their formats write them: a coding agent's
trajectory in ATIF, a log of Inspect in one JSON document, and spans of OpenTelemetry's SDK by three conventions.

    ~/.cache/reel-python/formats/bin/python tests/formats/foreign.py FOLDER
"""

import datetime
import json
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
    from inspect_ai.event import ModelEvent
    from inspect_ai.log import EvalConfig, EvalDataset, EvalLog, EvalResults, EvalSample, EvalSpec, write_eval_log
    from inspect_ai.model import ChatCompletionChoice, ChatMessageAssistant, ChatMessageSystem, ChatMessageTool, ChatMessageUser, GenerateConfig, ModelOutput
    from inspect_ai.scorer import Score
    from inspect_ai.tool import ToolCall, ToolCallError, ToolInfo, ToolParam, ToolParams

    path = ToolParams(properties={"path": ToolParam(type="string", description="A file of the repository.")}, required=["path"])
    declared = [ToolInfo(name=name, description=f"Does {name}.", parameters=path) for name in ["read_file", "write_file", "run_tests"]]
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
        first = ModelOutput(model="some/model", choices=[ChatCompletionChoice(message=messages[2], stop_reason="tool_calls")])
        inferred = ModelEvent(
            uuid=f"{task}-m", timestamp=datetime.datetime.fromisoformat(moment), working_start=0.0, model="some/model", input=messages[:2], tools=declared,
            tool_choice="auto", config=GenerateConfig(), output=first,
        )
        samples.append(EvalSample(
            id=task, epoch=1, input=f"Mend the {task}.", target="make returns 0", messages=messages, scores=scores,
            output=ModelOutput(model="some/model", choices=[ChatCompletionChoice(message=messages[-1], stop_reason="stop")]), uuid=f"sample-{task}", metadata={"repository": task}, events=[inferred],
        ))
    spec = EvalSpec(
        eval_id="eval-1", run_id="run-1", created=moment, task="builds", task_id="task-1", model="some/model", config=EvalConfig(epochs=1),
        dataset=EvalDataset(name="builds", samples=len(samples), sample_ids=[one.id for one in samples], shuffled=False),
    )
    results = EvalResults(total_samples=len(samples), completed_samples=len(samples))
    made = EvalLog(status="success", eval=spec, results=results, samples=samples)
    write_eval_log(made, str(pathlib.Path(folder) / name))
    return samples


# Beginning of the spans, in nanoseconds since 1970.
BEGINNING = 1_767_225_600_000_000_000


class Spans:
    """Spans of the official SDK with ids and times that are the same each time. `finished` are those that ended."""

    def __init__(self, exporter=None):
        from opentelemetry.sdk.resources import Resource
        from opentelemetry.sdk.trace import TracerProvider
        from opentelemetry.sdk.trace.export import BatchSpanProcessor, SimpleSpanProcessor
        from opentelemetry.sdk.trace.export.in_memory_span_exporter import InMemorySpanExporter
        from opentelemetry.sdk.trace.id_generator import IdGenerator

        class Counted(IdGenerator):
            traces = spans = 0

            def generate_trace_id(self):
                self.traces += 1
                return 0xC0DE << 64 | self.traces

            def generate_span_id(self):
                self.spans += 1
                return 0xC0DE << 32 | self.spans

        self.memory = InMemorySpanExporter()
        self.provider = TracerProvider(id_generator=Counted(), resource=Resource({"service.name": "builds"}), shutdown_on_exit=False)
        self.provider.add_span_processor(SimpleSpanProcessor(self.memory))
        if exporter:
            self.provider.add_span_processor(BatchSpanProcessor(exporter))
        self.tracer = self.provider.get_tracer("coder")
        self.now = BEGINNING

    def span(self, name, attributes, parent=None, error=None):
        """A span that begins now; `end` ends it."""
        from opentelemetry import trace

        self.now += 1_000_000
        context = trace.set_span_in_context(parent) if parent else trace.set_span_in_context(trace.INVALID_SPAN)
        span = self.tracer.start_span(name, context=context, attributes=attributes, start_time=self.now)
        if error:
            span.set_status(trace.Status(trace.StatusCode.ERROR, error))
        return span

    def end(self, span):
        self.now += 1_000_000
        span.end(end_time=self.now)

    def finished(self):
        return self.memory.get_finished_spans()


def current(spans, task, tools, grade, number):
    """An episode by the semantic conventions for generative AI."""
    root = spans.span("invoke_agent coder", {
        "gen_ai.operation.name": "invoke_agent", "gen_ai.provider.name": "openai", "gen_ai.agent.name": "coder", "test.case.name": f"builds/{task}",
        "gen_ai.conversation.id": f"conversation-{task}"})
    history = [{"role": "user", "parts": [{"type": "text", "content": f"Mend the {task}."}]}]
    for at, tool in enumerate([*tools, None]):
        call = {"type": "tool_call", "id": f"{task}-{at}", "name": tool, "arguments": {"path": f"{task}.c"}}
        said = {"role": "assistant", "parts": [{"type": "text", "content": f"Now {tool}." if tool else "Done."}, *([call] if tool else [])]}
        chat = spans.span("chat some-model", {
            "gen_ai.operation.name": "chat", "gen_ai.provider.name": "openai", "gen_ai.request.model": "some-model",
            "gen_ai.conversation.id": f"conversation-{task}", "gen_ai.usage.input_tokens": 100 + at, "gen_ai.usage.output_tokens": 7,
            "gen_ai.system_instructions": json.dumps([{"type": "text", "content": "You write code."}]),
            "gen_ai.input.messages": json.dumps(history), "gen_ai.output.messages": json.dumps([said])}, root)
        spans.end(chat)
        if tool:
            execution = spans.span(f"execute_tool {tool}", {
                "gen_ai.operation.name": "execute_tool", "gen_ai.tool.name": tool, "gen_ai.tool.call.id": f"{task}-{at}",
                "gen_ai.tool.type": "function", "gen_ai.tool.call.arguments": json.dumps({"path": f"{task}.c"}),
                "gen_ai.tool.call.result": f"result {at}"}, root)
            spans.end(execution)
            history += [said, {"role": "tool", "parts": [{"type": "tool_call_response", "id": f"{task}-{at}", "response": f"result {at}"}]}]
    for name, value, label in (("builds", float(grade == "C"), grade), ("tests.passed", 0.25 * number, None)):
        attributes = {"gen_ai.evaluation.name": name, "gen_ai.evaluation.score.value": value}
        root.add_event("gen_ai.evaluation.result", {**attributes, **({"gen_ai.evaluation.score.label": label} if label else {})}, timestamp=spans.now)
    spans.end(root)


def openinference(spans, task, tools):
    """An episode by OpenInference."""
    root = spans.span("agent", {"openinference.span.kind": "AGENT", "agent.name": "coder", "input.value": f"Mend the {task}.", "test.case.name": f"builds/{task}"})
    for at, tool in enumerate(tools):
        message = "llm.output_messages.0.message"
        spans.end(spans.span("ChatCompletion", {
            "openinference.span.kind": "LLM", "llm.model_name": "some-model", "llm.token_count.prompt": 100 + at, "llm.token_count.completion": 7,
            "llm.input_messages.0.message.role": "system", "llm.input_messages.0.message.content": "You write code.",
            "llm.input_messages.1.message.role": "user", "llm.input_messages.1.message.content": f"Mend the {task}.",
            f"{message}.role": "assistant", f"{message}.content": f"Now {tool}.",
            f"{message}.tool_calls.0.tool_call.id": f"{task}-{at}", f"{message}.tool_calls.0.tool_call.function.name": tool,
            f"{message}.tool_calls.0.tool_call.function.arguments": json.dumps({"path": f"{task}.c"})}, root))
        spans.end(spans.span(tool, {
            "openinference.span.kind": "TOOL", "tool.name": tool, "input.value": json.dumps({"path": f"{task}.c"}), "input.mime_type": "application/json",
            "output.value": f"result {at}"}, root))
    spans.end(root)


def openllmetry(spans, task, tools):
    """An episode by the conventions of OpenLLMetry, whose tools fail, and one request beside it."""
    root = spans.span("coder.workflow", {"traceloop.span.kind": "workflow", "traceloop.entity.name": "coder", "test.case.name": f"builds/{task}"})
    for at, tool in enumerate(tools):
        spans.end(spans.span("openai.chat", {
            "gen_ai.system": "openai", "llm.request.type": "chat", "gen_ai.request.model": "some-model",
            "gen_ai.usage.prompt_tokens": 100 + at, "gen_ai.usage.completion_tokens": 7,
            "gen_ai.prompt.0.role": "user", "gen_ai.prompt.0.content": f"Mend the {task}.",
            "gen_ai.completion.0.role": "assistant", "gen_ai.completion.0.content": f"Now {tool}.",
            "gen_ai.completion.0.tool_calls.0.id": f"{task}-{at}", "gen_ai.completion.0.tool_calls.0.name": tool,
            "gen_ai.completion.0.tool_calls.0.arguments": json.dumps({"path": f"{task}.c"})}, root))
        spans.end(spans.span(f"{tool}.tool", {
            "traceloop.span.kind": "tool", "traceloop.entity.name": tool,
            "traceloop.entity.input": json.dumps({"inputs": {"path": f"{task}.c"}, "tags": []})}, root, error="no such file"))
    spans.end(root)
    spans.end(spans.span("GET /health", {"http.request.method": "GET"}))


def spans(exporter=None):
    """Spans of all attempts."""
    made = Spans(exporter)
    for number, (task, tools, grade) in enumerate(ATTEMPTS):
        match task:
            case "printer":
                openinference(made, task, tools)
            case "linker":
                openllmetry(made, task, tools)
            case _:
                current(made, task, tools, grade, number)
    made.provider.force_flush()
    return made.finished()


def otlp_json(request):
    """A request in OTLP/JSON, which is that of protobuf but for ids, which are hexadecimal."""
    import base64

    from google.protobuf.json_format import MessageToDict

    told = MessageToDict(request, use_integers_for_enums=True)
    for of_resource in told["resourceSpans"]:
        for of_scope in of_resource["scopeSpans"]:
            for span in of_scope["spans"]:
                for name in ("traceId", "spanId", "parentSpanId"):
                    if name in span:
                        span[name] = base64.b64decode(span[name]).hex()
    return told


def spans_file():
    """The spans of each trace on a line, as the collector's file exporter writes them."""
    from opentelemetry.exporter.otlp.proto.common.trace_encoder import encode_spans

    by_trace = {}
    for span in spans():
        by_trace.setdefault(span.context.trace_id, []).append(span)
    requests = (otlp_json(encode_spans(of_trace)) for of_trace in by_trace.values())
    return "".join(json.dumps(request, separators=(",", ":")) + "\n" for request in requests)


if __name__ == "__main__":
    folder = pathlib.Path(sys.argv[1])
    (folder / "trajectory.json").write_text(trajectory() + "\n")
    log(folder, "log.json")
    (folder / "spans.jsonl").write_text(spans_file())
