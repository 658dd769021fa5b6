"""REAL's trainer as a client of an MCP server: its environment, its rollouts and its allocation of servers.

Written from the contract alone (docs/spec.md#reward-preset-real-trainer) and proven against `trainer_contract.json` and
`trainer_episodes.json`, so that it may judge a server. It shares no code with Reel and none with REAL. Texts in ⟦ ⟧ stand for
fixed wording of the published code; no decision hangs on them.
"""

import ast
import asyncio
import json
import random
import re
from collections import Counter

import answers
import reward as rewards

MAX_STEPS = 50
ATTEMPTS = 5
STEP_TIMEOUT_S = 150
RESET_TIMEOUT_S = 45
CONNECT_TIMEOUT_S = 60
DRIFT_LIMIT = 3
"""Objects by which the count of a graph may change in one call."""
UID_CHARS = 30
"""A longer name of hexadecimal digits, `_` and `-` only is an asset that has no category."""

SEVERE, MODERATE, UNREADABLE, HAND, TIMED_OUT, FAULT, HORIZON = -0.5, -0.3, -0.5, -0.3, -0.3, -1.0, -1.0
FINISH_COMPLETE, FINISH_EARLY = 2.0, -1.0

ERROR_TEXTS = (
    ("severe", SEVERE, ("[[internal error]]", "error executing", "traceback", "no object in the inventory")),
    ("severe", SEVERE, ("cannot place object into a closed",)),
    ("moderate", MODERATE, ("not found in the marker map", "cannot find a non-occluded position", "not found in the scene")),
    ("moderate", MODERATE, ("not implemented yet", "not recognized", "not aligned to bread target", "selected marker_id")),
    ("moderate", MODERATE, ("hand is empty",)),
)
END_TEXTS = ("All benchmark/replay episodes completed", "All episodes completed")
DEBUG_PREFIX = "Debug Info:"


# --- the tool contract -------------------------------------------------------------------------------------------------------


def schema_of(tool):
    """The input schema of a listed tool, in either spelling."""
    return tool.get("inputSchema") or tool.get("input_schema") or {}


def contract_errors(tools):
    """What the ten tools of a server lack: `missing:T`, or `required:T` if other arguments are required."""
    listed = {tool["name"]: set(schema_of(tool).get("required") or ()) for tool in tools}
    missing = [f"missing:{name}" for name in sorted(answers.TOOLS) if name not in listed]
    wrong = [f"required:{name}" for name in sorted(answers.TOOLS) if name in listed and listed[name] != set(answers.TOOLS[name])]
    return missing + wrong


def server_call(tools, name, arguments):
    """The name and the arguments with which a server is called: old names and one wrong argument key are adapted."""
    listed = {tool["name"]: schema_of(tool) for tool in tools}
    name = answers.canonical(name.strip())
    old = next((old for old, new in answers.OLD_NAMES.items() if new == name and old in listed), None)
    server_name = name if name in listed or old is None else old
    arguments = dict(arguments or {})
    required = listed.get(server_name, {}).get("required") or []
    if len(arguments) == 1 and len(required) == 1 and required[0] not in arguments:
        arguments = {required[0]: next(iter(arguments.values()))}
    return server_name, arguments


def task_ids(answer):
    """The ids in what `list_tasks` answered."""
    if isinstance(answer, dict):
        if "tasks" in answer:
            return task_ids(answer["tasks"]) if isinstance(answer["tasks"], list) else []
        return [key for key in answer if key.startswith(("task_", "seed_")) and key.rsplit("_", 1)[1].isdigit()]
    if not isinstance(answer, list):
        return []
    ids = [item.get("task_id") if isinstance(item, dict) else item for item in answer]
    return [name for name in ids if isinstance(name, str)]


# --- graphs ------------------------------------------------------------------------------------------------------------------


def asset_categories(payload):
    """Asset to category, in the order in which prefixes are tried: the target with one `_` more, the others without any."""
    mapping = {}
    target = payload.get("target_object") or {}
    if target.get("id") and target.get("category"):
        mapping[target["id"]] = mapping[f"_{target['id']}"] = target["category"]
    for asset, entry in (payload.get("distractor_metadata") or {}).items():
        if isinstance(entry, dict) and entry.get("category"):
            mapping[asset] = mapping[asset.lstrip("_")] = entry["category"]
    return mapping


def base_name(name):
    """A runtime name without its place: cut at the first `_on_` if it says a task too."""
    return name.split("_on_", 1)[0] if "_on_" in name and "_at_" in name else name


def category_of(mapping, name):
    """The category of an object's name, or the name if the mapping has nothing for it."""
    base = base_name(name)
    if base in mapping:
        return mapping[base]
    for asset, category in mapping.items():
        if asset.startswith(base) or base.startswith(asset):
            return category
    return name


def category_graph(mapping, graph):
    """A graph whose objects are categories."""
    converted = {}
    for receptacle, entry in graph.items():
        if isinstance(entry, dict):
            entry = {**entry, "content": [category_of(mapping, name) for name in entry.get("content") or []]}
        converted[receptacle] = entry
    return converted


def names_of(graph):
    return [name for entry in graph.values() if isinstance(entry, dict) for name in entry.get("content") or []]


def refusal(old, new, tool):
    """Why a category graph is refused after a call, or the empty text."""
    if not old or not new:
        return ""
    for name in names_of(new):
        if ("_on_" in name and "_at_" in name) or (len(name) > UID_CHARS and re.fullmatch(r"[0-9a-f_-]+", name)):
            return "unknown_objects"
    if tool and tool != "finish" and abs(len(names_of(new)) - len(names_of(old))) > DRIFT_LIMIT:
        return "drift"
    return ""


def graph_of_text(text):
    """The graph that `WORLD_GRAPH` tells, a line a receptacle; empty receptacles are not in it."""
    graph = {}
    for line in text.splitlines():
        receptacle, found, names = line.partition(": ")
        if found:
            try:
                graph[receptacle.strip()] = {"content": list(ast.literal_eval(names.strip()))}
            except (ValueError, SyntaxError):
                continue
    return graph


# --- observations ------------------------------------------------------------------------------------------------------------


def tool_error(observation):
    """Penalty, kind and pattern of the first known error text in an observation; 0 and `None`s if there is none."""
    text = observation.lower()
    for kind, penalty, patterns in ERROR_TEXTS:
        for pattern in patterns:
            if pattern in text:
                return penalty, kind, pattern
    return 0.0, None, None


def hand_violation(tool, occupied):
    """The hand rule that a call breaks, or `None`."""
    if occupied and tool in ("pick", "open", "close"):
        return f"{tool}_while_hand_occupied"
    return "place_while_hand_empty" if tool == "place" and not occupied else None


def is_ambiguous(tool, markers, target):
    """Whether a search shows more than one marker whose value tells the target's category."""
    if answers.canonical(tool) not in ("explore_receptacle", "find_objects"):
        return False
    target = target[0] if isinstance(target, list) and target else target
    category = str((target.get("category") if isinstance(target, dict) else target) or "").lower()
    values = []
    for value in (markers or {}).values():
        if isinstance(value, dict):
            value = value.get("category") or value.get("name") or ""
        values.append(str(value).lower())
    return bool(category) and sum(category in value for value in values) > 1


def answered_marker(answer, markers):
    """The marker that a reply to a question names, or `None`."""
    if markers:
        known = sorted(markers, key=lambda marker: -len(marker))
        return next((marker for marker in known if marker in answer), None)
    match = re.search(r"marker[_ ](\w+)", answer)
    return match.group(1) if match else None


def observation_of(items):
    """The text of a result, an image counting as a line, and the images. The last of several items is no part of it."""
    lines, images = [], []
    for item in items[:-1] if len(items) > 1 else items:
        if item["type"] == "image":
            lines.append("[Image received]")
            images.append(item)
        elif item["type"] == "text" and not item["text"].lstrip().startswith(("{", DEBUG_PREFIX)):
            lines.append(item["text"].strip())
    return "".join(f"{line}\n" for line in lines), images


def debug_of(items):
    """The object in the last item of a result, or an empty one."""
    last = items[-1] if items else {}
    if last.get("type") != "text":
        return {}
    text = last["text"].strip()
    try:
        debug = json.loads(text.removeprefix(DEBUG_PREFIX))
    except ValueError:
        return {}
    return debug if isinstance(debug, dict) else {}


def is_task_not_found(observation, instruction):
    """Whether a failed reset means that the server has another scene."""
    return any("not found" in (text or "").lower() for text in (observation, instruction))


# --- the environment ---------------------------------------------------------------------------------------------------------


class CallFault(Exception):
    """A call that came back with `isError`, or whose result could not be used: it is repeated."""


class Environment:
    """One episode at a time on one session. A session has `tools()`, a list, and `call(name, arguments)`, which answers
    `{"content": [items], "isError": bool}` or raises."""

    def __init__(self, session, config=None, sleep=asyncio.sleep, strict=True):
        config = config or {}
        self.session, self.sleep, self.strict = session, sleep, strict
        self.max_steps = config.get("max_steps", MAX_STEPS)
        self.scorer = rewards.reward_class(config.get("reward_config"))
        self.metric = rewards.Metric()
        self.tools = []

    async def reset(self, task_id):
        """Starts a task. Returns error, invalid_task, stale, done, attempts and, if it started, what the trainer knows of it."""
        for attempt in range(1, ATTEMPTS + 1):
            outcome = {"error": False, "invalid_task": False, "stale": False, "done": False, "attempts": attempt}
            outcome |= await self.try_reset(task_id)
            if not outcome.pop("again", False):
                return outcome
            if attempt < ATTEMPTS:
                await self.sleep(2 ** (attempt - 1) + random.random())
        return outcome

    async def try_reset(self, task_id):
        try:
            self.tools = await self.session.tools()
        except Exception as error:
            return {"error": True, "again": True, "observation": str(error)}
        if self.strict and (errors := contract_errors(self.tools)):
            return {"error": True, "observation": " ".join(errors)}
        try:
            result = await asyncio.wait_for(self.session.call("finish_with_id", {"task_id": task_id}), RESET_TIMEOUT_S)
        except Exception as error:
            return {"error": True, "again": True, "observation": str(error)}
        text = next((item["text"] for item in result["content"] if item["type"] == "text"), None)
        if text is None:
            return {"error": True, "observation": "⟦no text: reset⟧"}
        if any(end in text for end in END_TEXTS):
            return {"done": True, "observation": text}
        if "error spawning episode" in text.lower():
            return {"error": True, "again": True, "observation": text}
        try:
            payload = json.loads(text)
        except ValueError:
            return {"error": True, "invalid_task": True, "observation": text}
        if str(payload.get("task_id")) != str(task_id):
            return {"error": True, "invalid_task": True, "stale": True, "again": True, "observation": "⟦stale⟧"}
        return self.begin(payload)

    def begin(self, payload):
        self.payload = payload
        mapping = asset_categories(payload)
        initial = category_graph(mapping, payload.get("initial_world_graph") or {})
        goal = category_graph(mapping, payload.get("goal_world_graph") or payload.get("target_world_graph") or {})
        self.scorer.reset(initial, goal)
        if not initial or not self.scorer.targets:
            return {"error": True, "invalid_task": True, "observation": "⟦no target⟧"}
        self.mapping, self.target, self.graph = mapping, payload.get("target_object"), initial
        self.inventory, self.markers, self.hand_occupied = None, None, False
        self.distractor_visible, self.asked_since, self.last_ask_marker = False, False, None
        self.steps, self.done = 0, False
        self.metric.start(len(self.scorer.targets))
        rooms = payload.get("rooms_and_furniture")
        furniture = [name for room in rooms.values() for name in room] if rooms else payload.get("all_furnitures") or []
        return {
            "instruction": payload.get("task_description"),
            "target_diffs": len(self.scorer.targets),
            "targets": [list(diff) for diff in self.scorer.targets],
            "all_furnitures": furniture,
        }

    async def step(self, text):
        """Plays a model's answer. Returns reward, done, observation, images and info."""
        if self.done:
            return self.outcome(0.0, "⟦already done⟧", {})
        self.steps += 1
        try:
            action = answers.parse_trainer(text)
        except answers.Unreadable:
            info = {"invalid_action": True, "error": True}
            self.metric.step(UNREADABLE, info)
            return self.outcome(UNREADABLE, "⟦invalid⟧", info)
        if action["tool_name"] == "finish":
            return self.finish()
        return await self.act(action)

    def finish(self):
        completion = self.scorer.completion_rate
        complete = not self.scorer.remaining
        paid = FINISH_COMPLETE if complete else FINISH_EARLY + completion + self.scorer.premature_finish
        info = {"completion_rate": completion, "reward_breakdown": {"completion_rate": completion, "terminal_reward": paid}}
        self.end(paid, info, timeout=False)
        return self.outcome(paid, f"⟦finish: {'complete' if complete else 'incomplete'}⟧", info)

    async def act(self, action):
        name, arguments = server_call(self.tools, action["requested_tool_name"], action["arguments"])
        violation = hand_violation(action["tool_name"], self.hand_occupied)
        if violation:
            violation = {"violation_type": violation, "hand_state": "occupied" if self.hand_occupied else "empty"}
            if self.hand_occupied:
                violation["current_inv"] = str(self.inventory)
        for attempt in range(1, ATTEMPTS + 1):
            try:
                result = await asyncio.wait_for(self.session.call(name, arguments), STEP_TIMEOUT_S)
            except TimeoutError:
                self.scorer.compute(self.graph, self.held(), self.markers)
                info = {"timeout": True}
                self.metric.step(TIMED_OUT, info)
                return self.outcome(TIMED_OUT, "⟦timeout⟧", info)
            except Exception as error:
                return self.give_up(f"⟦call raised⟧ {error}")
            try:
                return self.take(action, name, arguments, result, violation)
            except Exception as error:
                fault = error
            if attempt < ATTEMPTS:
                await self.sleep(2 ** (attempt - 1) + random.random())
                await self.session.reconnect()
        return self.give_up(f"⟦gave up⟧ {fault}")

    def give_up(self, observation):
        self.done = True
        return self.outcome(FAULT, observation, {"error": True})

    def take(self, action, server_name, arguments, result, violation):
        """Reads the result of a call and pays for it. Fails if the result cannot be used."""
        items = result["content"]
        if result.get("isError"):
            raise CallFault(next((item["text"] for item in items if item["type"] == "text"), ""))
        tool = action["tool_name"]
        said, images = observation_of(items)
        observation = said.strip() or f"⟦no text: {tool}⟧"
        refused = self.see(debug_of(items), tool)
        error_penalty, kind, pattern = tool_error(observation)
        info = {"tool_name": tool, "server_tool_name": server_name, "tool_args": arguments, "mcp_num_content": len(items)}
        if violation:
            info["hand_violation"] = violation
        if kind:
            info["tool_error"] = {"error_type": kind, "error_pattern": pattern}
        elif tool in ("pick", "place"):
            self.hand_occupied = tool == "pick"
        info["hand_occupied"] = self.hand_occupied
        if refused:
            info["world_graph_rejected"] = refused
        self.follow_ambiguity(tool, said, kind, info)
        paid, breakdown = self.pay(tool, arguments, said)
        paid += (HAND if violation else 0.0) + error_penalty
        complete = not self.scorer.remaining
        horizon = not complete and self.steps >= self.max_steps
        if horizon:
            breakdown["max_steps_penalty"] = HORIZON
            paid += HORIZON
            observation += "\n⟦+horizon⟧"
        if complete:
            observation += "\n⟦+complete⟧"
        info |= {"completion_rate": breakdown["completion_rate"], "reward_breakdown": breakdown}
        if complete or horizon:
            self.end(paid, info, timeout=horizon)
        else:
            self.metric.step(paid, {**info, **breakdown})
        return self.outcome(paid, observation, info, images)

    def see(self, debug, tool):
        """Takes over what the debug text tells. Returns why its graph was refused, or the empty text."""
        graph = debug.get("world_graph")
        if not isinstance(graph, dict) and isinstance(debug.get("WORLD_GRAPH"), str):
            graph = {**self.graph, **graph_of_text(debug["WORLD_GRAPH"])}
        elif not isinstance(graph, dict) and "robot_inv" in debug:
            graph = {name: entry for name, entry in debug.items() if isinstance(entry, dict) and "content" in entry}
        for key in ("CURRENT_INV", "robot_inv"):
            if key in debug:
                self.inventory = debug[key]
        if "CURRENT_MARKER_MAP" in debug:
            self.markers = debug["CURRENT_MARKER_MAP"]
        if not isinstance(graph, dict):
            return ""
        graph = category_graph(self.mapping, graph)
        refused = refusal(self.graph, graph, tool)
        if not refused:
            self.graph = graph
        return refused

    def follow_ambiguity(self, tool, said, error, info):
        if is_ambiguous(tool, self.markers, self.target):
            self.distractor_visible, self.asked_since = True, False
        if tool == "ask":
            info["ask_response"] = said
            if marker := answered_marker(said, self.markers):
                self.asked_since, self.last_ask_marker = True, marker
        if tool == "pick" and not error:
            self.distractor_visible, self.asked_since, self.last_ask_marker = False, False, None

    def held(self):
        """What is held as a category, if its asset is known exactly, otherwise its name."""
        return self.inventory and self.mapping.get(base_name(self.inventory), self.inventory)

    def pay(self, tool, arguments, said):
        track = self.scorer.track(tool, arguments, self.markers)
        paid, breakdown = self.scorer.compute(self.graph, self.held(), self.markers)
        state = {
            "distractor_visible": self.distractor_visible,
            "asked_since_ambiguity": self.asked_since,
            "last_ask_marker": self.last_ask_marker,
            "current_marker_map": self.markers,
        }
        tool_paid, tool_info = self.scorer.tool(tool, arguments, state)
        if tool_paid:
            breakdown["tool_reward"] = tool_info
        return track + paid + tool_paid, breakdown

    def end(self, paid, info, timeout):
        self.done = True
        self.metric.step(paid, {**info, **info["reward_breakdown"]})
        complete = not self.scorer.remaining
        self.last_episode = self.metric.end(success=complete, timeout=timeout, completion_rate=self.scorer.completion_rate)

    def outcome(self, paid, observation, info, images=()):
        return {"reward": paid, "done": self.done, "observation": observation, "images": list(images), "info": info}

    last_episode = None
    """The metric's entry of the last episode that came to an end."""


# --- the scheduler -----------------------------------------------------------------------------------------------------------


async def rollout(environment, task_id, policy, max_turns=MAX_STEPS):
    """Plays a task. `policy(reset, steps)` gives the next answer, an empty one breaks the trajectory.

    Returns reset, steps, and the rollout: num_turns, total_reward, step_rewards, done, success; `None` if it broke.
    """
    reset = await environment.reset(task_id)
    steps = []
    if reset["error"] or reset["done"]:
        return reset, steps, None
    for _ in range(max_turns):
        text = policy(reset, steps)
        if not text.strip():
            return reset, steps, None
        steps.append(await environment.step(text))
        if steps[-1]["done"]:
            break
    paid = [step["reward"] for step in steps] + ([] if environment.done else [HORIZON])
    success = environment.done and not environment.scorer.remaining
    return (
        reset,
        steps,
        {
            "num_turns": len(paid),
            "total_reward": sum(paid),
            "step_rewards": paid,
            "done": environment.done,
            "success": success,
        },
    )


def outcome_of(rollout):
    """The word under which the trainer logs a rollout."""
    if rollout["success"]:
        return "success"
    if not rollout["done"]:
        return "timeout"
    return "failed" if rollout["total_reward"] <= 0 else "partial"


class NoServer(Exception):
    """No pool has a port that answers with tasks."""


def allocate(pools, messages, dead=(), rng=random):
    """Gives each group of equal messages a pool, the ports that share its most common task list, and one task of it.

    `pools` holds for each pool the task list of each of its ports, `None` for a port that is down; ports count through all pools.
    Returns the group of each message, and the groups. Fails with `NoServer` if no port answers.
    """
    usable, first = {}, 0
    for pool, ports in enumerate(pools):
        listed = {first + at: tuple(sorted(tasks)) for at, tasks in enumerate(ports) if tasks}
        first += len(ports)
        if listed and pool not in dead:
            tasks = Counter(listed.values()).most_common(1)[0][0]
            usable[pool] = [port for port, own in listed.items() if own == tasks], tasks
    if not usable:
        raise NoServer("no pool has a port that answers with tasks")
    order = list(usable)
    rng.shuffle(order)
    groups, chosen = {}, {}
    for message in dict.fromkeys(messages):
        pool = order[len(groups) % len(order)]
        ports, tasks = usable[pool]
        chosen.setdefault(pool, rng.choice(tasks))
        groups[message] = {"id": f"group_{len(groups)}", "pool": pool, "ports": ports, "tasks": list(tasks), "task": chosen[pool]}
    return [groups[message]["id"] for message in messages], {group["id"]: group for group in groups.values()}
