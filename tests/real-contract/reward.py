"""The difference reward that REAL's trainer computes on category graphs, and its metric (docs/spec.md#reward-preset-real-trainer).

Written from the contract and proven against `reward.json` and `trainer_episodes.json`; it shares no code with Reel.
"""

import math
from collections import Counter, deque

REWARD_WEIGHTS = {
    "diff_match": 1.5,
    "perfect_match": 2.0,
    "step_penalty": -0.03,
    "step_penalty_start": 3,
    "wrong_diff": -0.5,
    "neutral_diff": 0.0,
    "progress_shaping": 2.0,
    "place_wrong_furniture": -2.0,
}
PARTIAL_CREDIT_WEIGHTS = {
    "pick_correct_object": 0.3,
    "partial_move": 0.5,
    "ask_reward": 1.0,
    "replan_recover_pick": 1.0,
    "ask_when_ambiguous": 0.5,
    "used_marker_from_answer": 0.5,
    "blind_pick_penalty": -0.15,
}
ANTI_EXPLOIT_WEIGHTS = {
    "target_first_discovered": 1.0,
    "first_visit_target_furniture": 0.3,
    "repeated_perception": -0.3,
    "nav_revisit_window": -0.2,
    "repeated_gaze": -0.2,
    "premature_finish": -3.0,
}

PAID_ASKS = 3
REVISIT_WINDOW = 6
NAVIGATION = {"navigate_to", "nav_to"}
PERCEPTION = {"find_objects", "show_object_by_category", "explore_receptacle", "walk_around"}
GAZE = {"focus_on", "gaze_at"}


def contents(graph, receptacle):
    """The objects of a receptacle, names cut at `_on_`, as a multiset."""
    entry = graph.get(receptacle)
    names = entry.get("content") or [] if isinstance(entry, dict) else []
    return Counter(name.split("_on_", 1)[0] for name in names if name is not None)


def differences(before, after):
    """What was added and removed between two graphs, as sorted (object, receptacle, add or remove)."""
    found = []
    for receptacle in before.keys() | after.keys():
        old, new = contents(before, receptacle), contents(after, receptacle)
        found += [(name, receptacle, "add") for name in (new - old).elements()]
        found += [(name, receptacle, "remove") for name in (old - new).elements()]
    return sorted(found)


def reverse(diff):
    """The change that undoes `diff`."""
    name, receptacle, kind = diff
    return name, receptacle, "remove" if kind == "add" else "add"


class DiffReward:
    """The plain class: pays changes of the graph that lead to the goal, and progress."""

    def __init__(self, reward_weights=None):
        self.weights = REWARD_WEIGHTS | (reward_weights or {})

    def reset(self, initial, goal):
        self.graph = initial
        self.targets = differences(initial, goal)
        self.remaining = list(self.targets)
        self.steps, self.completion, self.perfect_paid = 0, 0.0, False

    @property
    def completion_rate(self):
        """Share of the target differences that were reached; 1 if there is none."""
        return 1 - len(self.remaining) / len(self.targets) if self.targets else 1.0

    def compute(self, graph, inventory=None, markers=None):
        """The reward of a step that led to `graph`, and the parts that made it."""
        self.steps += 1
        before, self.graph = self.graph, graph
        diffs = differences(before, graph)
        reward, info = self.pay(diffs)
        completion = self.completion_rate
        if completion != self.completion:
            info["progress_reward"] = self.weights["progress_shaping"] * (completion - self.completion)
            reward += info["progress_reward"]
            self.completion = completion
        if not self.remaining and not self.perfect_paid:
            self.perfect_paid = info["perfect_match"] = True
            reward += self.weights["perfect_match"]
        if self.steps > self.weights["step_penalty_start"]:
            reward += self.weights["step_penalty"]
        info |= {"remaining_count": len(self.remaining), "completion_rate": completion}
        extra = self.credit(before, diffs, inventory, markers, info)
        return reward + extra, info

    def pay(self, diffs):
        reward, info = 0.0, {}
        for diff in diffs:
            name, receptacle, kind = diff
            if diff in self.remaining:
                self.remaining.remove(diff)
                info.setdefault("matched_diffs", []).append(list(diff))
                reward += self.weights["diff_match"]
            elif reverse(diff) in self.targets:
                info.setdefault("wrong_diffs", []).append(list(diff))
                reward += self.weights["wrong_diff"]
            else:
                info.setdefault("neutral_diffs", []).append(list(diff))
                reward += self.weights["neutral_diff"]
                goals = [place for target, place, change in self.targets if (target, change) == (name, "add")]
                if kind == "add" and goals:
                    info["place_wrong_furniture"] = [name, receptacle, goals[0]]
                    reward += self.weights["place_wrong_furniture"]
        return reward, info

    def credit(self, before, diffs, inventory, markers, info):
        """What a class pays beside the differences."""
        return 0.0

    def track(self, tool, arguments, markers):
        """What a class pays for the choice of a call."""
        return 0.0

    def tool(self, tool, arguments, state):
        """What a class pays for asking and for using the answer, and why."""
        return 0.0, {}

    premature_finish = ANTI_EXPLOIT_WEIGHTS["premature_finish"]


class PartialCreditReward(DiffReward):
    """The class that the trainer uses by default: also pays picks, moves, asks and recoveries."""

    def __init__(self, reward_weights=None, partial_credit_weights=None):
        super().__init__(reward_weights)
        self.partial = PARTIAL_CREDIT_WEIGHTS | (partial_credit_weights or {})

    def reset(self, initial, goal):
        super().reset(initial, goal)
        self.picked, self.moved, self.asks, self.ambiguous_asks = set(), set(), 0, 0
        self.wrong_object, self.wrong_origin, self.recovered = None, None, False

    def credit(self, before, diffs, inventory, markers, info):
        if not inventory:
            return 0.0
        info["partial_reward"] = self.pick_and_move(inventory)
        info["replan_reward"] = self.recovery(before, diffs, inventory)
        return info["partial_reward"] + info["replan_reward"]

    def pick_and_move(self, held):
        paid = 0.0
        sources = {name: place for name, place, kind in self.targets if kind == "remove"}
        goals = {name: place for name, place, kind in self.targets if kind == "add"}
        if held in sources and held not in self.picked:
            self.picked.add(held)
            paid += self.partial["pick_correct_object"]
        for name in sources.keys() & goals.keys() - self.moved:
            if location(self.graph, name) not in (sources[name], goals[name]):
                self.moved.add(name)
                paid += self.partial["partial_move"]
        return paid

    def recovery(self, before, diffs, held):
        if held not in {name for name, _, kind in self.targets if kind == "remove"}:
            if held != self.wrong_object:
                self.wrong_object, self.wrong_origin = held, location(before, held)
            return 0.0
        returned = any(
            name == self.wrong_object and kind == "add" and self.wrong_origin in (None, place) for name, place, kind in diffs
        )
        if self.wrong_object is None or not returned or self.recovered:
            return 0.0
        self.wrong_object, self.recovered = None, True
        return self.partial["replan_recover_pick"]

    def tool(self, tool, arguments, state):
        if tool == "ask":
            return self.ask(state)
        if tool != "pick":
            return 0.0, {}
        marker = arguments.get("marker_id")
        if state.get("last_ask_marker") and marker == state["last_ask_marker"]:
            key = paid = "used_marker_from_answer"
        elif state.get("last_ask_target"):
            marked = (state.get("current_marker_map") or {}).get(str(marker))
            if not isinstance(marked, dict) or marked.get("mock_target") != state["last_ask_target"]:
                return 0.0, {}
            key, paid = "used_target_from_answer", "used_marker_from_answer"
        elif state.get("distractor_visible") and not state.get("asked_since_ambiguity"):
            key = paid = "blind_pick_penalty"
        else:
            return 0.0, {}
        return self.partial[paid], {key: self.partial[paid]}

    def ask(self, state):
        info, reward = {"tool": "ask"}, 0.0
        if self.asks < PAID_ASKS:
            self.asks += 1
            reward += self.partial["ask_reward"]
            info |= {"ask_count": self.asks, "rewarded": True, "reward": self.partial["ask_reward"]}
        else:
            info |= {"ask_count": self.asks, "rewarded": False, "reason": "max_ask_reached"}
        if state.get("distractor_visible") and self.ambiguous_asks < PAID_ASKS:
            self.ambiguous_asks += 1
            reward += self.partial["ask_when_ambiguous"]
            info["ask_when_ambiguous"] = self.partial["ask_when_ambiguous"]
        return reward, info


class AntiExploitReward(PartialCreditReward):
    """The variant against loops: pays discoveries and first visits, charges repetitions."""

    def __init__(self, reward_weights=None, partial_credit_weights=None, anti_exploit_weights=None):
        super().__init__(reward_weights, partial_credit_weights)
        self.anti = ANTI_EXPLOIT_WEIGHTS | (anti_exploit_weights or {})
        self.premature_finish = self.anti["premature_finish"]

    def reset(self, initial, goal):
        super().reset(initial, goal)
        self.discovered, self.visited, self.visits = set(), set(), deque(maxlen=REVISIT_WINDOW)
        self.perceived, self.gazed = None, None

    def credit(self, before, diffs, inventory, markers, info):
        paid = super().credit(before, diffs, inventory, markers, info)
        info["anti_exploit_reward"] = 0.0
        for name in sorted({name for name, _, _ in self.targets} - self.discovered):
            if any(isinstance(marked, str) and name in marked for marked in (markers or {}).values()):
                self.discovered.add(name)
                info["anti_exploit_reward"] += self.anti["target_first_discovered"]
        return paid + info["anti_exploit_reward"]

    def track(self, tool, arguments, markers):
        if tool in NAVIGATION:
            return self.visit(arguments.get("receptacle_name"))
        if tool in PERCEPTION and markers:
            marked = frozenset(markers.values())
            again, self.perceived = marked == self.perceived, marked
            return self.anti["repeated_perception"] if again else 0.0
        if tool in GAZE:
            again, self.gazed = arguments.get("marker_id") == self.gazed, arguments.get("marker_id")
            return self.anti["repeated_gaze"] if again else 0.0
        return 0.0

    def visit(self, receptacle):
        if not receptacle:
            return 0.0
        times = self.visits.count(receptacle)
        first = receptacle not in self.visited and receptacle in {place for _, place, _ in self.targets}
        self.visits.append(receptacle)
        self.visited.add(receptacle)
        return self.anti["first_visit_target_furniture"] if first else self.anti["nav_revisit_window"] * times


def location(graph, name):
    """The first receptacle in the order of the graph whose content lists `name`, or `None`."""
    for receptacle, entry in graph.items():
        if isinstance(entry, dict) and name in (entry.get("content") or []):
            return receptacle
    return None


def reward_class(config):
    """The class that a `reward_config` of the trainer asks for."""
    config = config or {}
    weights, partial = config.get("reward_weights"), config.get("partial_credit_weights")
    if config.get("use_anti_exploit"):
        return AntiExploitReward(weights, partial, config.get("anti_exploit_weights"))
    if config.get("use_partial_credit", True):
        return PartialCreditReward(weights, partial)
    return DiffReward(weights)


class Metric:
    """The trainer's running metric over finished episodes."""

    def __init__(self, success_threshold=1.0, window_size=100, max_history=10_000):
        self.success_threshold, self.window = success_threshold, window_size
        self.episodes = deque(maxlen=max_history)
        self.total = self.successes = self.timeouts = self.invalid = 0

    def start(self, targets):
        self.current = {"targets": targets, "steps": 0, "reward": 0.0, "completed": 0, "completion": 0.0}

    def step(self, reward, info):
        now = self.current
        now["steps"] += 1
        now["reward"] += reward
        now["completed"] += len(info.get("matched_diffs", ()))
        if "completion_rate" in info:
            now["completion"] = info["completion_rate"]
        elif now["targets"]:
            now["completion"] = now["completed"] / now["targets"]

    def end(self, success=None, timeout=False, invalid_action=False, completion_rate=None):
        now = self.current
        completion = now["completion"] if completion_rate is None else completion_rate
        success = completion >= self.success_threshold if success is None else success
        episode = {
            "episode_id": self.total,
            "total_steps": now["steps"],
            "total_reward": now["reward"],
            "target_diff_count": now["targets"],
            "completed_diff_count": now["completed"],
            "completion_rate": completion,
            "is_success": bool(success),
            "is_timeout": bool(timeout),
            "is_invalid": bool(invalid_action),
        }
        self.episodes.append(episode)
        self.total += 1
        self.successes += episode["is_success"]
        self.timeouts += episode["is_timeout"]
        self.invalid += episode["is_invalid"]
        return episode

    def metrics(self):
        """Rates over all episodes; means and population deviations over the last 10,000."""
        total = max(self.total, 1)
        values = {
            "success_rate": self.successes / total,
            "timeout_rate": self.timeouts / total,
            "invalid_action_rate": self.invalid / total,
            "total_episodes": self.total,
        }
        for name, key in (("completion_rate", "completion_rate"), ("reward", "total_reward"), ("steps", "total_steps")):
            series = [episode[key] for episode in self.episodes]
            values[f"avg_{name}"] = mean(series)
            if series:
                values[f"std_{name}"] = math.sqrt(mean([(value - mean(series)) ** 2 for value in series]))
        return values

    def recent(self, window=None):
        """The same rates and means over the last episodes only."""
        last = list(self.episodes)[-(window or self.window) :]
        return {
            "recent_success_rate": mean([episode["is_success"] for episode in last]),
            "recent_avg_completion_rate": mean([episode["completion_rate"] for episode in last]),
            "recent_avg_reward": mean([episode["total_reward"] for episode in last]),
            "recent_avg_steps": mean([episode["total_steps"] for episode in last]),
            "recent_timeout_rate": mean([episode["is_timeout"] for episode in last]),
            "recent_invalid_action_rate": mean([episode["is_invalid"] for episode in last]),
            "recent_episodes": len(last),
        }


def mean(values):
    return sum(values) / len(values) if values else 0.0
