"""Profile `real-repo` answers each error case with the exact text of the published server, and calls in its form. The whole
contract is compared by `make real-contract`; here are its texts over the transport."""

import json
import pathlib
import re
import tempfile

from harness import Agent, Server, main

HOME = pathlib.Path(__file__).parents[2] / "src/tasks/src/data/home.json"
#: Walls around a receptacle that nobody then gets to.
CELL = [
    {"from": [12.4, 4.6], "to": [12.4, 6.4], "height": 2.5},
    {"from": [12.4, 4.6], "to": [13.6, 4.6], "height": 2.5},
    {"from": [12.4, 6.4], "to": [13.6, 6.4], "height": 2.5},
]


def content(result):
    """(texts before the debug information, number of images, debug information)."""
    assert not result.get("isError"), result
    texts = [item["text"] for item in result["content"] if item["type"] == "text"]
    images = [item for item in result["content"] if item["type"] == "image"]
    debug = None
    if texts and texts[-1].startswith("Debug Info:\n"):
        debug = json.loads(texts.pop().removeprefix("Debug Info:\n"))
        assert result["content"][-1]["type"] == "text", "the debug information comes last"
    return texts, len(images), debug


class Player(Agent):
    def tell(self, tool, **arguments):
        """The text of a call that fails, in the form of the published server: text, image, debug information."""
        texts, images, debug = content(self.call(tool, **arguments))
        assert (len(texts), images) == (1, 1) and debug, (tool, texts, images)
        return texts[0]

    def do(self, tool, **arguments):
        """The debug information after a call that works: an image, no text."""
        texts, images, debug = content(self.call(tool, **arguments))
        assert (texts, images) == ([], 1), (tool, texts)
        return debug

    def number_of(self, thing, tool="highlight_receptacles", **arguments):
        """The marker of a thing."""
        result = content(self.call(tool, **arguments))[2]
        return next(int(number) for number, target in result["CURRENT_MARKER_MAP"].items() if target == thing)


def text_of_every_error():
    """Each error case of the published contract, by its exact text."""
    with tempfile.TemporaryDirectory() as folder:
        scene = json.loads(HOME.read_text())
        scene["walls"] = CELL
        path = pathlib.Path(folder) / "scene.json"
        path.write_text(json.dumps(scene))
        with Server("--profile", "real-repo", "--scene", path) as server:
            errors(Player(server, "texts"))


def errors(agent):
    tell, cases = agent.tell, []

    def expect(text, said):
        cases.append(text)
        assert said == text, f"expected {text!r}, got {said!r}"

    # Before there is an episode.
    said = content(agent.call("pick", marker_id=1))
    assert said[0][0].startswith("Error executing pick: ") and said[1:] == (0, None), said
    # An episode with a door to the destination, and one with what the table needs.
    ids = json.loads(agent.say("list_tasks"))
    task = json.loads(agent.say("finish_with_id", task_id=next(it for it in ids if it.startswith("FDO"))))
    closed = [name for name, state in task["initial_world_graph"].items() if state.get("door") is False]
    source, target = task["source_furniture"], task["target_object"]["name"]
    empty = next(name for name, state in task["initial_world_graph"].items() if not state["content"] and "door" not in state)
    expect("No landmark selected. Use 'navigate_to' first.", tell("explore_receptacle"))
    expect("Receptacle nowhere_9 not found in the scene.", tell("navigate_to", receptacle_name="nowhere_9"))
    expect("Cannot find a non-occluded position to navigate to shelf_2.", tell("navigate_to", receptacle_name="shelf_2"))
    agent.do("navigate_to", receptacle_name=empty)
    expect(f"Seems there is no object on the {empty}'s top shelf to observe.", tell("explore_receptacle"))
    agent.do("navigate_to", receptacle_name=empty)
    no_map = "No marker map available."
    expect(f"{no_map} Use 'find_objects' or 'explore_receptacle' first.", tell("focus_on", marker_id=1))
    expect(f"{no_map} Use 'find_objects', 'explore_receptacle' or 'highlight_receptacles' first.", tell("pick", marker_id=1))
    expect(f"{no_map} Use 'highlight_receptacles' first.", tell("place", marker_id=1))
    expect(no_map, tell("open", marker_id=1))
    expect(no_map, tell("close", marker_id=1))
    number = agent.number_of(empty)
    expect("Marker ID 99 not found in the marker map.", tell("pick", marker_id=99))
    expect(f"Object {empty} has no graspable component.", tell("pick", marker_id=number))
    expect(f"Object {empty} has no graspable component. Cannot focus on it.", tell("focus_on", marker_id=str(number)))
    expect("No object in the inventory to place.", tell("place", marker_id=number))
    agent.do("open", marker_id=number)
    assert agent.do("find_objects", target_category="unicorn")["CURRENT_MARKER_MAP"] == {}
    expect("Action 'grab' not recognized.", tell("grab", marker_id=1))
    missing = content(agent.call("pick"))
    assert missing[0][0].startswith("Error executing pick: ") and missing[1:] == (0, None), missing
    # With something in hand, in a new episode.
    agent.say("finish_with_id", task_id=task["task_id"])
    agent.do("navigate_to", receptacle_name=source)
    debug = agent.do("pick", marker_id=agent.number_of(target, "explore_receptacle"))
    assert debug["CURRENT_INV"] == target and debug["CURRENT_MARKER_MAP"]
    held = f"You are already holding '{target}'. Place it before picking another object."
    expect(held, tell("pick", marker_id=1))
    door = next(name for name in closed if name != source)
    agent.do("navigate_to", receptacle_name=door)
    expect(f"The door of '{door}' is closed. Use 'open' first.", tell("place", marker_id=agent.number_of(door)))
    assert len(cases) == 16, len(cases)
    # The user says what the task's file does, here nothing.
    asked = agent.tell("ask", target_category="clock", target_description="the red one")
    assert json.loads(asked) == {"error": "simulated_user_context_unavailable", "source": "task_metadata"}, asked
    missing = content(agent.call("ask", question="Which one do you mean?"))
    assert missing[0][0].endswith("KeyError: 'target_category'") and missing[1:] == (0, None), missing
    rooms = content(agent.call("list_receptacles"))
    assert re.fullmatch(r"(Room: .+\n(  - .+\n)+)+", rooms[0][0]) and rooms[1] == 1 and rooms[2], rooms


def text_of_the_end():
    """After the last task, and for ever."""
    with Server("--profile", "real-repo") as server:
        agent = Agent(server)
        ids = json.loads(agent.say("list_tasks"))
        begun = agent.call("finish_with_id", task_id=ids[-1])["content"]
        keys = list(json.loads(begun[0]["text"]))
        assert len(begun) == 1 and keys == [
            "task_id", "benchmark_task_id", "family", "episode_idx", "episode_local_idx", "episode_range",
            "task_description", "scene_id", "rooms_and_furniture", "initial_world_graph", "target_world_graph", "target_object",
            "source_furniture", "destination_furniture", "source_distractors", "destination_distractors", "object_distractors",
            "distractor_metadata", "execution_plan",
        ], keys
        for _ in range(2):
            assert agent.say("finish") == "All evaluation episodes completed."


if __name__ == "__main__":
    main("text_", dict(globals()))
