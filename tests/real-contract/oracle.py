"""Decisions that reach every goal, from what a client sees over MCP alone: the task's payload and the marker map."""

import json


class Lost(Exception):
    """What the oracle needs has no marker."""


def plan(task, close_doors=False):
    """The calls that bring the target to its destination. `markers = yield tool, arguments` after each call.

    A closed destination is opened first, while the hand is empty. `close_doors` closes it in the end, as the goal of the
    evaluation agents wants it.
    """
    source, destination = task["source_furniture"], task["destination_furniture"]
    door = task["initial_world_graph"][destination].get("door") is False
    if door:
        yield "navigate_to", {"receptacle_name": destination}
        yield "open", {"marker_id": (yield from marker_of(destination))}
    target = task["target_object"]
    yield "navigate_to", {"receptacle_name": source}
    markers = yield "find_objects", {"target_category": target["category"]}
    if target["name"] not in (markers or {}).values():
        markers = yield "explore_receptacle", {}
    yield "pick", {"marker_id": number(markers, target["name"])}
    yield "navigate_to", {"receptacle_name": destination}
    marker = yield from marker_of(destination)
    yield "place", {"marker_id": marker}
    if door and close_doors:
        yield "close", {"marker_id": marker}


def marker_of(receptacle):
    markers = yield "highlight_receptacles", {}
    return number(markers, receptacle)


def number(markers, name):
    """The marker of an object or a receptacle. Fails if it has none."""
    for marker, marked in (markers or {}).items():
        if marked == name:
            return marker
    raise Lost(f"{name} has no marker; the map is {markers}")


def clumsy(task):
    """Calls that are refused, useless or wrong, and change nothing that the oracle cannot mend after them."""
    source, target = task["source_furniture"], task["target_object"]
    yield "pick", {"marker_id": "1"}
    yield "place", {"marker_id": "1"}
    yield "explore_receptacle", {}
    yield "navigate_to", {"receptacle_name": "attic_9"}
    yield "fly_to", {"x": "1"}
    yield "navigate_to", {}
    yield "list_receptacles", {}
    yield "navigate_to", {"receptacle_name": source}
    yield "find_objects", {"target_category": "no such category"}
    yield "pick", {"marker_id": "77"}
    yield "ask", {"target_category": target["category"], "target_description": "the one on the left"}
    yield "ask", {"question": "Which of them?"}
    marker = yield from marker_of(source)
    yield "focus_on", {"marker_id": marker}
    yield "open", {"marker_id": marker}
    yield "pick", {"marker_id": marker}
    yield "place", {"marker_id": marker}
    markers = yield "explore_receptacle", {}
    marker = number(markers, target["name"])
    yield "focus_on", {"marker_id": marker}
    yield "pick", {"marker_id": marker}
    yield "pick", {"marker_id": marker}
    yield "navigate_to", {"receptacle_name": source}
    marker = yield from marker_of(source)
    yield "place", {"marker_id": marker}


def clumsy_then_right(task, close_doors=False):
    """The clumsy calls, then the plan."""
    yield from clumsy(task)
    yield from plan(task, close_doors)


def answer(tool, arguments):
    """A call in the one form of answer that all four published parsers read."""
    summary = {"History": f"0) I decided on {tool}.", "New Schedule": "1. go on", "Current subtask": tool}
    body = {"summary": summary, "next action": {"tool_name": tool, "args": arguments}}
    return f"<think>{tool} comes next.</think>\n{json.dumps(body, ensure_ascii=False)}"
