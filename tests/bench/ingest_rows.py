"""Decoded traces into Arrow batches of the documented tables, for `ingest_python.py`.

Columns are made of flat tuples that attrgetter takes out of the messages, nested lists of their items and a count a
parent. It reads no trace and writes no file. Optional text that is set but empty counts as absent.
"""

import functools
import re
from itertools import accumulate, chain
from operator import attrgetter
from pathlib import Path
from typing import NamedTuple

import orjson
import pyarrow as pa

DOCUMENTATION = Path(__file__).parents[2] / "schemas" / "tables.md"
# Arguments of calls that are kept.
ARGUMENTS_KEPT = 65536

HEADER = attrgetter(
    "episode_id", "run_id", "group_id", "rollout_index", "task_id", "family", "scene_id", "policy.name", "policy.checkpoint",
    "seed", "profile", "reward_preset", "sim_version", "build", "backend", "skills",
)  # fmt: skip
METRICS = attrgetter("success", "completion", "total_reward", "discounted_return", "length", "asks")
RESULT = attrgetter("text", "error", "error_class", "object", "receptacle", "held", "tool")
POLICY = attrgetter("reasoning", "history", "plan", "raw")
EVENT = attrgetter("event", "object", "receptacle", "from", "to")
TERM = attrgetter("component", "value", "reason")
MARKER = attrgetter("id", "object", "receptacle")
VISIBLE = attrgetter("object", "pixels", "x_min", "y_min", "x_max", "y_max")
CALL = attrgetter("name", "arguments_json")

EPISODE_COLUMNS = (
    "episode_id", "run_id", "group_id", "rollout_index", "task_id", "family", "scene_id", "policy", "checkpoint",
    "seed", "profile", "preset", "sim_version", "build", "backend", "skills",
    "task_digest", "scene_digest", "task_type", "end_reason",
    "success", "completion", "total_reward", "discounted_return", "length", "asks", "spl",
    "instruction", "fuzzy", "purpose", "target", "target_category", "target_caption", "src", "dest",
    "src_door", "dest_door", "shortest_path_m", "path_length_m", "parent_trace", "parent_call",
    "trace", "trace_digest", "trace_bytes", "trace_modified_ns",
)  # fmt: skip
STEP_COLUMNS = (
    "step", "tool", "call_name", "arguments", "argument",
    "text", "error_code", "error_class", "object", "receptacle", "held",
    "goal_object", "goal_receptacle", "object_match", "receptacle_match", "put_back", "primitive", "fell", "repeated", "goals_met", "goals_missing", "marker_count", "visible_count", "candidate_count", "reward",
    "sim_step", "robot_x_m", "robot_y_m", "robot_yaw_rad", "path_length_m", "latency_ns",
    "reasoning", "history", "plan", "raw", "question", "reply", "reply_source",
    "prompt_tokens", "completion_tokens", "tokens",
    "state_digest", "chain_digest", "trace_offset",
)  # fmt: skip
VISIBLE_COLUMNS = ("object", "pixels", "x_min", "y_min", "x_max", "y_max")
MEASURED_COLUMNS = (
    "kind", "step", "skill", "target", "success", "duration_ns", "control_steps", "error", "odometry_error_m", "yaw_error_rad",
    "image_shift_px", "image_rmse_px",
)  # fmt: skip
NO_POLICY = (None, None, None, None)

ARGUMENT_KEYS = {
    "nav_to": "receptacle_name", "navigate_to": "receptacle_name",
    "show_object_by_category": "target_category", "find_objects": "target_category",
    "gaze_at": "marker_id", "focus_on": "marker_id",
    "pick": "marker_id", "place": "marker_id", "open": "marker_id", "close": "marker_id",
    "ask": "question",
}  # fmt: skip


class Nested(NamedTuple):
    """A column of lists: how many items each row has, and the items of all, as values or as columns by name."""

    counts: list
    items: object


class Rows:
    """Rows of every table until they are taken; nested lists lie flat, with a count a parent."""

    def __init__(self):
        self.side_keys = set()
        self.clear()

    def clear(self):
        self.episodes, self.steps, self.step_counts, self.quarantine = [], [], [], []
        self.start_objects, self.start_object_counts, self.start_changes, self.start_change_counts = [], [], [], []
        self.listed, self.listed_counts = [], []
        self.new_objects, self.new_object_counts, self.changes, self.change_counts = [], [], [], []
        self.terms, self.term_counts, self.markers, self.marker_counts = [], [], [], []
        self.logprobs, self.logprob_counts = [], []
        self.visible, self.visible_counts = [], []
        self.tasks, self.scenes = [], []

    def add(self, trace):
        start, task, end = trace.start, trace.task, trace.end
        fields, metrics = task.fields, end.metrics
        scene_digest = start.scene_digest.hex()
        if task.digest not in self.side_keys:
            self.side_keys.add(task.digest)
            self.tasks.append(task_row(task))
        if scene_digest not in self.side_keys:
            self.side_keys.add(scene_digest)
            self.scenes.append(scene_row(trace.scene, scene_digest))
        header = list(HEADER(start))
        header[2] = header[2] if start.HasField("group_id") else None
        header[3] = header[3] if start.HasField("rollout_index") else None
        header[8] = header[8] if start.policy.HasField("checkpoint") else None
        header[13] = trace.build
        header[15] = header[15] or "perfect"
        parent = start.parent if start.HasField("parent") else None
        self.episodes.append(
            (
                *header, task.digest, scene_digest, fields.get("task_type"), end.reason,
                *METRICS(metrics), metrics.spl if metrics.HasField("spl") else None,
                fields["instruction"], fields.get("fuzzy", False), fields.get("purpose"), fields["target"],
                task.target.get("category", ""), task.target.get("caption"), fields["src"], fields["dest"],
                task.door(fields["src"]), task.door(fields["dest"]),
                trace.settled.shortest_path_m if trace.settled.HasField("shortest_path_m") else None,
                trace.moments[-1].robot.path_length_m,
                parent and parent.trace.hex(), parent and parent.call,
                trace.path, trace.chain.links[-1].hex(), trace.bytes, trace.modified_ns,
            )
        )  # fmt: skip
        self.start_objects += map(VISIBLE, trace.settled.visible)
        self.start_object_counts.append(len(trace.settled.visible))
        graphs = trace.graphs[0]
        physics = difference(graph_of(graphs.physics), task.initial)
        registry = difference(graph_of(graphs.registry), task.initial)
        self.start_changes += [("physics", *event) for event in physics] + [("registry", *event) for event in registry]
        self.start_change_counts.append(len(physics) + len(registry))
        self.step_counts.append(len(trace.calls))
        self.add_steps(trace)

    def add_steps(self, trace):
        task, policies, logprobs, answers = trace.task, trace.policies, trace.logprobs, trace.answers
        categories, doors = categories_of(trace.scene), doors_of(trace.scene)
        goal_objects, goal_places, is_candidate = task.goal_objects, task.goal_places, task.candidates.__contains__
        seen = {visible.object for visible in trace.settled.visible}
        see, candidates = seen.add, len(seen & task.candidates)
        revisits = Revisits(trace)
        records = zip(trace.calls, trace.results, trace.diffs, trace.rewards, trace.moments[1:], trace.offsets)
        for step, (call, result, diff, reward, moment, offset) in enumerate(records):
            name, arguments_json = CALL(call)
            arguments, argument = arguments_of(name, arguments_json)
            text, error, error_class, object_, receptacle, held, tool = RESULT(result)
            tool = tool or name

            visible = [*map(VISIBLE, result.visible)]
            self.visible += visible
            self.visible_counts.append(len(visible))
            self.listed += result.listed
            self.listed_counts.append(len(result.listed))
            shown = chain([thing[0] for thing in visible], result.listed)
            new = [thing for thing in shown if thing not in seen and not see(thing)]
            if new:
                self.new_objects += new
                candidates += sum(map(is_candidate, new))
            self.new_object_counts.append(len(new))

            markers = [*map(MARKER, result.markers)]
            self.markers += markers
            self.marker_counts.append(len(markers))

            terms = [*map(TERM, reward.terms)]
            self.terms += terms
            self.term_counts.append(len(terms))
            total = -0.0
            for _, value, _ in terms:
                total += value

            physics, registry = diff.physics, diff.registry
            count = len(physics) + len(registry)
            fallen = [event.object for event in physics if event.event == "add" and event.receptacle == "floor"]
            if count:
                self.changes += [("physics", *EVENT(event)) for event in physics]
                self.changes += [("registry", *EVENT(event)) for event in registry]
            self.change_counts.append(count)

            said, latency_ns, prompt_tokens, completion_tokens = NO_POLICY, None, None, None
            policy = policies.get(step)
            if policy:
                said = POLICY(policy)
                latency_ns = trace.latencies[step].latency_ns if step in trace.latencies else None
                if policy.HasField("tokens"):
                    prompt_tokens, completion_tokens = policy.tokens.input, policy.tokens.output
            scored = logprobs.get(step)
            if scored:
                self.logprobs += sorted((of.policy, of.logprobs[:]) for of in scored.policies)
            self.logprob_counts.append(len(scored.policies) if scored else 0)
            answer = answers.get(step)
            target = answer.text if answer and tool == "ask" else object_ or receptacle or arguments
            events = physics if revisits.by_physics else registry
            repeated = revisits.follow(tool, target, error, receptacle, held, answer and answer.text, events)
            robot = moment.robot
            x, y = robot.base
            self.steps.append(
                (
                    step, tool, name, arguments, argument,
                    text, error, error_class, object_, receptacle, held,
                    object_ in goal_objects if object_ else None,
                    (object_, receptacle) in goal_places if object_ and receptacle else None,
                    task.object_match(object_) if object_ else None,
                    task.receptacle_match(receptacle, categories) if receptacle else None,
                    object_ in task.initial.get(receptacle, ("", {}))[1]
                    if tool == "place" and not error and object_ and receptacle
                    else None,
                    primitive_of(tool, receptacle, argument, markers, doors),
                    ("target" if task.fields["target"] in fallen else "other") if fallen else None,
                    repeated, *revisits.goals(),
                    len(markers), len(visible), candidates, total,
                    moment.sim_step, x, y, robot.yaw, robot.path_length_m, latency_ns,
                    *said, (arguments if argument is None else argument) if tool == "ask" else None,
                    answer and answer.text, answer and answer.source,
                    prompt_tokens, completion_tokens, scored and scored.tokens[:],
                    moment.state.hex(), trace.chain.links[step + 1].hex(), offset,
                )
            )  # fmt: skip

    def take(self, schemas):
        """The batches of all tables; none of their rows is left here."""
        change = ("authority", "event", "object", "receptacle", "door_from", "door_to")
        marker_map = columns_of(("marker", "object", "receptacle"), self.markers)
        objects, receptacles = marker_map.pop("object"), marker_map.pop("receptacle")
        marker_map["kind"] = ["object" if object_ else "receptacle" for object_ in objects]
        marker_map["id"] = [object_ or receptacle for object_, receptacle in zip(objects, receptacles)]

        steps = columns_of(STEP_COLUMNS, self.steps)
        for name in ("error_code", "error_class", "object", "receptacle", "held", "reasoning", "history", "plan", "raw"):
            steps[name] = [value or None for value in steps[name]]
        steps["listed_objects"] = Nested(self.listed_counts, self.listed)
        steps["logprobs"] = Nested(self.logprob_counts, columns_of(("policy", "logprobs"), self.logprobs))
        steps["contradictions"] = [0] * len(self.steps)
        # What an answer or a query means is not read again here.
        for name in ("settles", "refused_replies", "match_source", "match_categories", "query_known"):
            steps[name] = [None] * len(self.steps)
        # Clocks of servers and robots: the simulator's traces have none.
        steps["duration_ns"] = [None] * len(self.steps)
        steps["new_objects"] = Nested(self.new_object_counts, self.new_objects)
        steps["changes"] = Nested(self.change_counts, with_assets(columns_of(change, self.changes)))
        steps["terms"] = Nested(self.term_counts, columns_of(("component", "value", "reason"), self.terms))
        steps["marker_map"] = Nested(self.marker_counts, marker_map)
        steps["visible_objects"] = Nested(self.visible_counts, columns_of(VISIBLE_COLUMNS, self.visible))

        episodes = columns_of(EPISODE_COLUMNS, self.episodes)
        episodes["start_changes"] = Nested(self.start_change_counts, with_assets(columns_of(change, self.start_changes)))
        episodes["start_objects"] = Nested(self.start_object_counts, columns_of(VISIBLE_COLUMNS, self.start_objects))
        episodes["measurements"] = Nested([0] * len(self.episodes), dict.fromkeys(MEASURED_COLUMNS, ()))
        episodes["steps"] = Nested(self.step_counts, steps)
        # Nobody scores what the simulator played.
        episodes["reported_success"] = [None] * len(self.episodes)
        episodes["scores"] = Nested([0] * len(self.episodes), dict.fromkeys(("name", "value", "label", "explanation"), ()))
        tables = {"episodes": episodes}
        for table, rows in (("tasks", self.tasks), ("scenes", self.scenes), ("quarantine", self.quarantine)):
            tables[table] = columns_of(schemas[table].names, rows)
        batches = {}
        for table, columns in tables.items():
            arrays = [array_of(columns[field.name], field.type) for field in schemas[table]]
            batches[table] = pa.RecordBatch.from_arrays(arrays, schema=schemas[table])
        self.clear()
        return batches


def columns_of(names, rows):
    return dict(zip(names, zip(*rows))) if rows else dict.fromkeys(names, ())


def with_assets(changes):
    objects = changes["object"]
    changes["asset"] = [object_.partition("_on_")[0] if object_ else None for object_ in objects]
    for name in ("object", "door_from", "door_to"):
        changes[name] = [value or None for value in changes[name]]
    return changes


def array_of(values, kind):
    if not isinstance(values, Nested):
        return pa.array(values, kind)
    counts, items = values
    if pa.types.is_struct(kind.value_type):
        fields = list(kind.value_type)
        items = pa.StructArray.from_arrays([array_of(items[field.name], field.type) for field in fields], fields=fields)
    else:
        items = pa.array(items, kind.value_type)
    return pa.ListArray.from_arrays(pa.array(accumulate(counts, initial=0), pa.int32()), items, type=kind)


@functools.lru_cache(ARGUMENTS_KEPT)
def arguments_of(name, text):
    """A call's arguments as canonical JSON, and the tool's one argument as plain text."""
    arguments = orjson.loads(text)
    key = ARGUMENT_KEYS.get(name)
    value = None
    if key and isinstance(arguments, dict) and key in arguments:
        value = arguments[key]
        value = value if isinstance(value, str) else orjson.dumps(value).decode()
    return orjson.dumps(arguments, option=orjson.OPT_SORT_KEYS).decode(), value


def graph_of(graph):
    return {
        place.receptacle: (place.door, {content.object: content.count for content in place.content})
        for place in graph.receptacles
    }


def task_row(task):
    fields = task.fields
    texts = {"add": "+{1}@{2}", "remove": "-{1}@{2}", "door": "{2}.door: {3} -> {4}"}
    objects = [
        {
            "instance": thing["instance"],
            "asset": thing["asset"],
            "category": thing["category"],
            "caption": thing.get("caption"),
            "attributes": [
                {"kind": kind, "word": word} for kind, words in sorted(thing.get("attributes", {}).items()) for word in words
            ],
            **dict(zip(("width_m", "depth_m", "height_m"), thing["size"])),
            "receptacle": thing["receptacle"],
            "role": task.role(thing["instance"]),
        }
        for thing in fields["objects"]
    ]

    return (
        fields["task_id"], task.digest, fields["family"], fields.get("task_type"), fields["scene_id"],
        fields["instruction"], fields["precise_instruction"], fields.get("fuzzy", False), fields.get("purpose"),
        fields["target"], task.target.get("category", ""), fields["src"], fields["dest"],
        task.door(fields["src"]), task.door(fields["dest"]),
        fields.get("src_distractors", []), fields.get("dest_distractors", []), fields.get("object_distractors", []),
        [texts[event[0]].format(*event) for event in task.goal], len(objects), objects, task.text,
    )  # fmt: skip


def primitive_of(tool, receptacle, argument, markers, doors):
    """The skill of the arm; of a `place` that failed, where its marker aimed."""
    if tool != "place":
        return tool if tool in ("open", "close", "pick") else None
    aimed = next((place for marker, _, place in markers if place and str(marker) == argument), None)
    door = doors.get(receptacle or aimed)
    return None if door is None else "place_inside" if door else "place_open"


@functools.lru_cache(1024)
def categories_of(text):
    return {receptacle["id"]: receptacle["category"] for receptacle in orjson.loads(text)["receptacles"]}


@functools.lru_cache(1024)
def doors_of(text):
    return {receptacle["id"]: bool(receptacle.get("door")) for receptacle in orjson.loads(text)["receptacles"]}


def scene_row(text, digest):
    scene = orjson.loads(text)
    receptacles = [
        {
            "receptacle": receptacle["id"],
            "category": receptacle["category"],
            "room": receptacle["room"],
            "has_door": bool(receptacle.get("door")),
            "placeable": receptacle.get("placeable", True),
            "captions": sorted(receptacle.get("captions", {})),
        }
        for receptacle in scene["receptacles"]
    ]
    return digest, scene["scene_id"], [room["name"] for room in scene["rooms"]], receptacles, text.decode()


class Revisits:
    """Which calls repeat another in the same state of the world, and how far the goal is met."""

    def __init__(self, trace):
        self.by_physics = trace.start.profile in ("", "paper")
        graphs = trace.graphs[0]
        graph = graph_of(graphs.physics if self.by_physics else graphs.registry)
        self.graph = {receptacle: (door, dict(content)) for receptacle, (door, content) in graph.items()}
        self.at, self.held, self.replies, self.calls = None, None, set(), set()
        self.goal = {object_: receptacle for event, object_, receptacle, _, _ in trace.task.goal if event == "add"}

    def follow(self, tool, target, error, receptacle, held, reply, events):
        things = frozenset(
            (place, door, frozenset(item for item in content.items() if item[1])) for place, (door, content) in self.graph.items()
        )
        at = None if tool in ("nav_to", "ask") else self.at
        call = (things, self.held, len(self.replies), tool, at, target, error or None)
        repeated = call in self.calls or reply in self.replies
        self.calls.add(call)
        for event in events:
            kind, object_, place, _, to = EVENT(event)
            door, content = self.graph.setdefault(place, ("", {}))
            if kind == "door":
                self.graph[place] = (to, content)
            else:
                content[object_] = content.get(object_, 0) + (1 if kind == "add" else -1)
        self.held = held or None
        if reply is not None:
            self.replies.add(reply)
        if tool == "nav_to" and not error:
            self.at = receptacle or self.at
        return repeated

    def goals(self):
        met = sum(
            self.held != object_ and self.graph.get(place, ("", {}))[1].get(object_, 0) > 0 for object_, place in self.goal.items()
        )
        return met, len(self.goal) - met


class Task:
    """A task, and what all of its episodes share."""

    def __init__(self, text, digest):
        task = self.fields = orjson.loads(text)
        self.text, self.digest = text.decode(), digest.hex()
        self.objects = {thing["instance"]: thing for thing in reversed(task["objects"])}
        self.target = self.objects.get(task["target"], {})
        self.initial = {receptacle: (state.get("door", ""), state["content"]) for receptacle, state in task["initial"].items()}
        goal = {receptacle: (state.get("door", ""), state["content"]) for receptacle, state in task["goal"].items()}
        self.goal = difference(goal, self.initial)
        self.goal_objects = {object_ for _, object_, _, _, _ in self.goal if object_}
        self.goal_places = {(object_, receptacle) for event, object_, receptacle, _, _ in self.goal if event == "add"}
        self.candidates = {instance for instance in self.objects if self.role(instance) != "other"}

    def door(self, receptacle):
        return self.initial.get(receptacle, ("", {}))[0] or None

    def object_match(self, instance):
        if instance == self.fields["target"]:
            return "target"
        thing = self.objects.get(instance)
        if not thing:
            return "other"
        if thing["asset"] == self.target.get("asset"):
            return "instance"
        if thing["category"] == self.target.get("category"):
            return "category"
        return "distractor" if thing["asset"] in self.fields.get("object_distractors", ()) else "other"

    def receptacle_match(self, receptacle, categories):
        dest = self.fields["dest"]
        if receptacle in (dest, self.fields["src"]):
            return "dest" if receptacle == dest else "src"
        category = categories.get(receptacle)
        like = receptacle in self.fields.get("dest_distractors", ()) or category and category == categories.get(dest)
        return "similar" if like else "other"

    def role(self, instance):
        thing = self.objects[instance]
        if instance == self.fields["target"]:
            return "target"
        like = thing["category"] == self.target.get("category") or thing["asset"] in self.fields.get("object_distractors", ())
        return "distractor" if like else "other"


def difference(now, before):
    """The events, sorted, that lead from one graph to the other: event, object, receptacle, doors."""
    if now == before:
        return []
    none, moves, doors = ("", {}), [], []
    for receptacle in now.keys() | before.keys():
        (door, content), (old_door, old_content) = now.get(receptacle, none), before.get(receptacle, none)
        if door and old_door and door != old_door:
            doors.append(("door", None, receptacle, old_door, door))
        for object_ in content.keys() | old_content.keys():
            more = content.get(object_, 0) - old_content.get(object_, 0)
            moves += [("add" if more > 0 else "remove", object_, receptacle, None, None)] * abs(more)
    moves.sort(key=lambda move: (move[0] == "add", move[1:3]))
    doors.sort()
    return moves + doors


# The documented schemas.

SCALARS = {
    "text": pa.string(), "boolean": pa.bool_(), "int32": pa.int32(), "int64": pa.int64(), "float64": pa.float64(),
    "decimal(20, 0)": pa.decimal128(20, 0),
}  # fmt: skip


def documented_schemas():
    """The Arrow schemas of the tables that ingest writes, from their documentation."""
    columns = {}
    for section in DOCUMENTATION.read_text().split("\n## ")[1:]:
        heading, _, text = section.partition("\n")
        cells = re.findall(r"^\| `(\w+)` \| (.+?) \| ", text, re.MULTILINE)
        columns |= dict.fromkeys(re.findall(r"`([\w.]+)`", heading), cells)

    def field(table, name, text):
        text, nullable, _ = text.partition(", may be null")
        if text == "list, see below":
            kind = pa.struct([field(name, *cell) for cell in columns[f"{table}.{name}"]])
        elif text.startswith("list of struct("):
            kind = pa.struct([pa.field(*words.split()[:1], pa.string(), nullable=False) for words in text[15:-1].split(", ")])
        else:
            kind = SCALARS[text.removeprefix("list of ")]
        if text.startswith("list"):
            kind = pa.list_(pa.field("element", kind, nullable=False))
        return pa.field(name, kind, nullable=bool(nullable))

    tables = ("episodes", "tasks", "scenes", "quarantine")
    return {table: pa.schema([field(table, *cell) for cell in columns[table]]) for table in tables}
