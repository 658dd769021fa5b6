"""REAL's evaluation agents as a client of an MCP server: the run over all tasks, scored on the client, and its files.

Written from the contract alone (docs/spec.md#evaluation-agents) and proven against `eval_client.json`, so that it may judge a server. It
shares no code with Reel and none with REAL.
"""

import ast
import base64
import json
import re
import struct
import time
import traceback
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

END_TEXT = "All evaluation episodes completed."
DEBUG_PREFIX = "Debug Info:\n"
DEFAULT_URL = "http://127.0.0.1:8080/sse"
LAST_INDEX = 999_999
IDENTITY = ("benchmark_task_id", "family", "global_index", "task_id", "episode_idx")
DESCRIPTION = ("task_description", "scene_id", "source_furniture", "destination_furniture", "target_object")
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"


@dataclass
class Settings:
    """What an agent is started with."""

    model: str
    max_steps: int
    prefix: str
    output: str = "eval_output"
    url: str = DEFAULT_URL
    start: int = 0
    end: int = LAST_INDEX
    metadata: dict = field(default_factory=dict)
    max_tokens: int = 0
    base_url: str | None = None
    api_key: str | None = None

    def __post_init__(self):
        if self.max_steps < 1:
            raise ValueError(f"MAX_STEP is {self.max_steps}: give 1 or more")
        if self.end < self.start:
            raise ValueError(f"END_IDX {self.end} is below START_IDX {self.start}")


def common_settings(env, max_steps):
    return {
        "max_steps": int(env.get("MAX_STEP") or max_steps),
        "output": env.get("EVAL_OUTPUT_PATH") or env.get("TRAJ_PATH") or "eval_output",
        "start": int(env.get("START_IDX") or 0),
        "end": int(env.get("END_IDX") or LAST_INDEX),
    }


def vlm_settings(env):
    """The settings of the agent behind a chat endpoint. Fails if one is missing or out of range."""
    if not env.get("MODEL_NAME"):
        raise ValueError("MODEL_NAME is not set")
    return Settings(
        model=env["MODEL_NAME"],
        prefix="vlm_api_agent",
        max_tokens=int(env.get("MAX_NEW_TOKENS") or 1024),
        base_url=env.get("OPENAI_API_BASE_URL") or env.get("OPENAI_BASE_URL"),
        api_key=env.get("OPENAI_API_KEY") or None,
        **common_settings(env, 20),
    )


def qwen_settings(env):
    """The settings of the agent with a local model. Fails if one is missing or out of range."""
    if not env.get("MODEL_PATH"):
        raise ValueError("MODEL_PATH is not set")
    return Settings(
        model=Path(env["MODEL_PATH"]).name,
        prefix="qwen_agent",
        max_tokens=int(env.get("MAX_NEW_TOKENS") or 4096),
        metadata={"lora_enabled": bool(env.get("LORA_PATH"))},
        **common_settings(env, 30),
    )


def safe_path(value):
    """A value as the name of a folder."""
    return re.sub(r"[^A-Za-z0-9._-]+", "_", str(value)).strip("._") or "unknown"


def slug(model):
    """A model's name as the name of a folder."""
    return safe_path(model.replace("-", "_").replace("/", "_"))


def task_folder(task):
    """The folder of a task: its benchmark id, otherwise family and id, otherwise its id."""
    name = task.get("benchmark_task_id")
    if not name:
        name = f"{task['family']}/{task['task_id']}" if task.get("family") else task["task_id"]
    return Path(safe_path(task.get("scene_id"))) / safe_path(name)


def succeeds(actual, target):
    """Whether a graph fulfils a goal: every goal receptacle has the same objects, and the same door where the goal tells one."""
    if not actual or not target:
        return False
    for receptacle, goal in target.items():
        found = actual.get(receptacle)
        if not isinstance(found, dict) or in_order(found.get("content")) != in_order(goal.get("content")):
            return False
        if "door" in goal and found.get("door") != goal["door"]:
            return False
    return True


def in_order(content):
    return sorted(content) if isinstance(content, list) else content


def parse_result(items):
    """Kind, data, debug object and images (base64) of a tool's result."""
    texts, images, debug = [], [], {}
    for item in items:
        if item["type"] == "image":
            images.append(item["data"])
        elif item["type"] == "text":
            if item["text"].startswith(DEBUG_PREFIX):
                debug = debug_of(item["text"].removeprefix(DEBUG_PREFIX))
            else:
                texts.append(item["text"])
    if not texts and images:
        return "image", images[0], debug, images
    return "text", "\n".join(texts).strip(), debug, images


def debug_of(text):
    try:
        debug = json.loads(text)
    except ValueError:
        return {"raw": text}
    return debug if isinstance(debug, dict) else {"raw": text}


def graph_of(debug):
    """The world graph that a debug object tells, as an object or as text, or `None`."""
    for key in ("world_graph", "WORLD_GRAPH"):
        if isinstance(debug.get(key), dict):
            return debug[key]
    text = debug.get("WORLD_GRAPH")
    if not isinstance(text, str):
        return None
    graph = {}
    for line in text.splitlines():
        receptacle, found, names = line.partition(":")
        if found:
            try:
                content = ast.literal_eval(names.strip())
            except (ValueError, SyntaxError):
                content = []
            graph[receptacle.strip()] = {"content": content if isinstance(content, list) else []}
    return graph or None


def png_size(data):
    """Width and height of a PNG. Fails if the bytes are none."""
    if not data.startswith(PNG_SIGNATURE) or data[12:16] != b"IHDR":
        raise ValueError("the image is no PNG")
    return struct.unpack(">II", data[16:24])


class RunFailed(RuntimeError):
    """The server cannot be evaluated."""


async def next_task(session):
    """The next task, or `None` after the last. Fails if the answer is neither."""
    result = await session.call("finish", {})
    text = next((item["text"] for item in result["content"] if item["type"] == "text"), None)
    if text is None:
        raise RunFailed("finish answered no text")
    if text.strip() == END_TEXT:
        return None
    try:
        task = json.loads(text)
    except ValueError as error:
        raise RunFailed(f"finish answered no task: {text[:200]}") from error
    if not isinstance(task, dict):
        raise RunFailed(f"finish answered no task: {text[:200]}")
    return task


def write_json(path, value):
    path.write_text(json.dumps(value, indent=2, ensure_ascii=False), encoding="utf-8")


class Episode:
    """One task, played and written to a folder."""

    def __init__(self, session, settings, policy, task, folder):
        self.session, self.settings, self.policy, self.task, self.folder = session, settings, policy, task, folder
        self.graph, self.inference_time = task.get("initial_world_graph"), 0.0

    async def play(self):
        """Plays to the end. Returns the summary."""
        self.folder.mkdir(parents=True, exist_ok=True)
        meta = {key: self.task.get(key) for key in IDENTITY + DESCRIPTION}
        write_json(self.folder / "task_meta.json", meta | {"model": self.settings.model} | self.settings.metadata)
        status, steps, final, success = "max_steps_reached", 0, None, False
        for steps in range(1, self.settings.max_steps + 1):
            status, final, success = await self.step(self.folder / f"step_{steps - 1:03}")
            if status != "max_steps_reached":
                break
        summary = {key: self.task.get(key) for key in IDENTITY}
        summary |= {"total_steps": steps, "total_inference_time": self.inference_time}
        summary |= {"final_action": final, "success": success, "status": status}
        write_json(self.folder / "episode_summary.json", summary)
        return summary

    async def step(self, folder):
        """Plays a step. Returns the status, the final action and the success so far."""
        folder.mkdir()
        started = time.monotonic()
        try:
            decision = self.policy.decide()
        except Exception:
            (folder / "inference_error.txt").write_text(traceback.format_exc())
            return "inference_error", None, False
        taken = time.monotonic() - started
        self.inference_time += taken
        tool, arguments, _ = decision
        if tool == "finish":
            success = succeeds(self.graph, self.task.get("target_world_graph"))
            said = f"Episode finished. Success: {success}"
            self.save(folder, decision, taken, "text", said, {"world_graph": self.graph}, [])
            return "finished", "finish", success
        try:
            if tool is None:
                self.save(folder, decision, taken, "text", "No tool selected.", {}, [])
            else:
                result = await self.session.call(tool, arguments)
                kind, data, debug, images = parse_result(result["content"])
                self.graph = graph_of(debug) or self.graph
                self.save(folder, decision, taken, kind, data, debug, images)
                self.policy.observe(kind, data, debug, images)
        except Exception:
            (folder / "action_error.txt").write_text(traceback.format_exc())
            return "action_error", None, False
        return "max_steps_reached", None, False

    def save(self, folder, decision, taken, kind, data, debug, images):
        """Writes a step. Fails if an image is none."""
        tool, arguments, raw = decision
        write_json(folder / "tool_call.json", {"tool_name": tool, "args": arguments})
        write_json(folder / "inference_time.json", {"inference_time": taken, "total_inference_time": self.inference_time})
        if isinstance(raw, str):
            (folder / "raw_response.txt").write_text(raw, encoding="utf-8")
        else:
            write_json(folder / "raw_response.json", raw)
        for at, image in enumerate(images):
            png = base64.b64decode(image)
            png_size(png)
            (folder / f"image_observation_{at}.png").write_bytes(png)
        if kind == "text":
            (folder / "textual_observation.txt").write_text(data, encoding="utf-8")
        write_json(folder / "debug_info.json", debug)


async def evaluate(session, settings, policy):
    """Plays every task that the server hands out. Returns the results, which it writes too. Fails with `RunFailed`."""
    if "finish" not in [tool["name"] for tool in await session.tools()]:
        raise RunFailed("the server lists no tool 'finish'")
    output, episodes = Path(settings.output), []
    task = await next_task(session)
    while task is not None:
        index = task.get("episode_idx", -1)
        if index >= settings.end:
            break
        if index >= settings.start:
            episodes.append(await play(session, settings, policy, task, output))
        task = await next_task(session)
    tag = datetime.now().strftime("%Y%m%d_%H%M%S_%f")
    finished = [episode for episode in episodes if episode["status"] == "finished"]
    successes = sum(episode["success"] for episode in finished)
    results = {
        "mode": settings.prefix,
        "run_tag": tag,
        "model": settings.model,
        "start_idx": settings.start,
        "end_idx": settings.end,
        "total": len(episodes),
        "finished": len(finished),
        "successes": successes,
        "skipped": sum(episode["status"] == "skipped" for episode in episodes),
        "errors": sum(episode["status"] in ("inference_error", "action_error") for episode in episodes),
        "success_rate": successes / len(finished) if finished else 0.0,
        "episodes": episodes,
    }
    output.mkdir(parents=True, exist_ok=True)
    write_json(output / f"{settings.prefix}_results_{slug(settings.model)}_{tag}.json", results)
    return results


async def play(session, settings, policy, task, output):
    """Plays a task, unless its folder holds a file already. Fails if the task has no id."""
    if "task_id" not in task:
        raise RunFailed("the task has no task_id")
    folder = output / task_folder(task) / slug(settings.model)
    policy.start(task)
    if any(path.is_file() for path in folder.rglob("*")):
        return {key: task.get(key) for key in IDENTITY} | {"status": "skipped"}
    return await Episode(session, settings, policy, task, folder).play()
