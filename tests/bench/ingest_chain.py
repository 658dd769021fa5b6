"""The hash chain of a decoded trace and the digests of its attachments, for `ingest_python.py`.

A link is the BLAKE3 digest of canonical JSON: of header and start record, then of the link before and the record of
each step, with the chain's own digests set to zero and without wall-clock values and the version of Reel. Records are
built from the messages as dicts, in the shape that serde gives ours. orjson writes numbers as serde_json does, and an
f32 as the f64 that protobuf makes of it. Bodies at rest, start graphs and arguments come again and again: their JSON
is kept.
"""

import functools

import orjson
from blake3 import blake3

# Pieces of JSON that are kept of each kind.
PIECES_KEPT = 16384

NO_LINK = "0" * 64
SORTED = orjson.OPT_SORT_KEYS


def verify(trace, task_text, scene_text):
    """Refuses a trace with a broken chain or with attachments of other digests than its header's."""
    start, moments = trace.start, trace.moments
    for name, text, expected in (("task", task_text, start.task_digest), ("scene", scene_text, start.scene_digest)):
        if blake3(text).digest() != expected:
            raise ValueError(f"the attached {name} is not the one of the header")
    link = moments[0].chain
    if link_of((header(start), start_record(trace))) != link:
        raise ValueError("the hash chain is broken at the start")
    policies, outside, answers = trace.policies, trace.outside, trace.answers
    records = zip(trace.calls, trace.results, trace.diffs, trace.rewards, moments[1:])
    for step, (call, result, diff, reward, moment) in enumerate(records):
        given = {"call": {"name": call.name, "arguments": arguments(call.arguments_json)}}
        if step in policies:
            given["policy"] = policy_output(policies[step])
        if step in outside:
            given["user_reply"] = reply(outside[step])
        has, outcome = result.HasField, {"text": result.text}
        if has("error"):
            outcome["error"] = result.error
        record = {
            "step": step,
            "input": given,
            "outcome": outcome,
            "markers": markers(result.markers),
            "visible": visible(result.visible),
            "changes": {"physics": events(diff.physics), "registry": events(diff.registry)},
            "bodies": bodies(moment.bodies),
            "robot": robots((moment.robot,))[0],
            "sim_step": moment.sim_step,
            "reward": terms(reward.terms),
            "digests": digests(moment),
        }
        if has("tool"):
            record["tool"] = result.tool
        if has("object"):
            record["object"] = result.object
        if has("receptacle"):
            record["receptacle"] = result.receptacle
        if has("held"):
            record["held"] = result.held
        if result.listed:
            record["listed"] = result.listed[:]
        if step in answers:
            record["reply"] = reply(answers[step])
        before, link = link, moment.chain
        if link_of((before.hex(), record)) != link:
            raise ValueError(f"the hash chain is broken at step {step}")
    if trace.end.chain != link:
        raise ValueError("the hash chain is broken at the end")


def link_of(value):
    return blake3(orjson.dumps(value, option=SORTED)).digest()


def kept(record_of):
    """Of what makes a record of one message: what gives the JSON of many, made once for those of the same bytes."""
    known = {}
    get = known.get

    def keep(message):
        if len(known) == PIECES_KEPT:
            known.clear()
        json = known[message.SerializeToString()] = orjson.Fragment(orjson.dumps(record_of(message), option=SORTED))
        return json

    def pieces(messages):
        return [get(message.SerializeToString()) or keep(message) for message in messages] if messages else ()

    return pieces


def header(start):
    has, policy = start.HasField, start.policy
    by = {"name": policy.name}
    if policy.HasField("checkpoint"):
        by["checkpoint"] = policy.checkpoint
    if policy.parameters_json:
        by["parameters"] = {key: orjson.loads(text) for key, text in policy.parameters_json.items()}
    record = {
        "episode_id": start.episode_id,
        "run_id": start.run_id,
        "task_id": start.task_id,
        "family": start.family,
        "scene_id": start.scene_id,
        "task_digest": start.task_digest.hex(),
        "scene_digest": start.scene_digest.hex(),
        "seed": start.seed,
        "sim_version": start.sim_version,
        "build": "",
        "profile": start.profile,
        "reward_preset": start.reward_preset,
        "policy": by,
        "backend": start.backend,
    }
    if has("group_id"):
        record["group_id"] = start.group_id
    if has("rollout_index"):
        record["rollout_index"] = start.rollout_index
    if has("parent"):
        record["parent"] = {"trace": start.parent.trace.hex(), "call": start.parent.call}
    return record


def start_record(trace):
    settled, moment = trace.settled, trace.moments[0]
    physics, registry = worlds((trace.graphs[0].physics, trace.graphs[0].registry))
    record = {
        "graphs": {"physics": physics, "registry": registry},
        "bodies": bodies(moment.bodies),
        "robot": robots((moment.robot,))[0],
        "visible": visible(settled.visible),
        "digests": digests(moment),
    }
    if settled.HasField("shortest_path_m"):
        record["shortest_path_m"] = settled.shortest_path_m
    return record


@kept
def worlds(world):
    receptacles = {}
    for place in world.receptacles:
        state = receptacles[place.receptacle] = {"content": {content.object: content.count for content in place.content}}
        if place.HasField("door"):
            state["door"] = place.door
    return receptacles


@kept
def bodies(state):
    return {
        "body": state.body,
        "position": state.position[:],
        "rotation": state.rotation[:],
        "linear_velocity": state.linear_velocity[:],
        "angular_velocity": state.angular_velocity[:],
        "asleep": state.asleep,
    }


@kept
def robots(state):
    return {
        "base": state.base[:],
        "yaw": state.yaw,
        "camera": state.camera[:],
        "pitch": state.pitch,
        "path_length_m": state.path_length_m,
    }


@kept
def visible(seen):
    return {"object": seen.object, "pixels": seen.pixels, "bbox": (seen.x_min, seen.y_min, seen.x_max, seen.y_max)}


def digests(moment):
    record = {"state": moment.state.hex(), "chain": NO_LINK}
    if moment.HasField("frame"):
        frame = moment.frame
        record["frame"] = {"rgb": frame.rgb.hex(), "ids": frame.ids.hex(), "depth": frame.depth.hex()}
    steps = moment.physics_steps[:]
    if steps:
        record["physics_steps"] = steps
    return record


@functools.lru_cache(PIECES_KEPT)
def arguments(text):
    return orjson.Fragment(orjson.dumps(orjson.loads(text), option=SORTED))


def policy_output(policy):
    parts = {"raw": policy.raw, "reasoning": policy.reasoning, "history": policy.history, "plan": policy.plan}
    record = {name: text for name, text in parts.items() if text}
    if policy.HasField("tokens"):
        record["tokens"] = (policy.tokens.input, policy.tokens.output)
    return record


def reply(said):
    return {"text": said.text, "source": said.source}


@kept
def markers(shown):
    kind = shown.WhichOneof("target")
    return {"id": shown.id, "target": {"kind": kind, "id": getattr(shown, kind)}}


@kept
def events(change):
    has, record = change.HasField, {"event": change.event, "receptacle": change.receptacle}
    if has("object"):
        record["object"] = change.object
    if has("from"):
        record["from"] = getattr(change, "from")
    if has("to"):
        record["to"] = change.to
    return record


@kept
def terms(part):
    record = {"component": part.component, "value": part.value}
    if part.reason:
        record["reason"] = part.reason
    return record
