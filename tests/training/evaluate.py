"""What is right on held-out examples, and what baselines get that see the calls of the episode and nothing else."""

import collections
import json
import math

from classes import IMAGE, NEITHER, TEXT, choice, goes_to, situations

LONGEST = 10


class BackOff:
    """The commonest continuation of the longest context that training has; context zero is the majority."""

    def __init__(self, longest):
        self.longest = longest
        self.counts = collections.defaultdict(collections.Counter)

    def learn(self, history, continuation):
        for length in range(min(self.longest, len(history)) + 1):
            self.counts[tuple(history[len(history) - length :])][continuation] += 1

    def guess(self, history):
        for length in range(min(self.longest, len(history)), -1, -1):
            counts = self.counts.get(tuple(history[len(history) - length :]))
            if counts:
                return min(counts, key=lambda continuation: (-counts[continuation], continuation))
        return None


def histories(examples):
    """(example, calls before it): each call is its tool and the first word of its outcome."""
    now = {}
    for example in sorted(examples, key=lambda one: (one.episode, one.call)):
        history = now.setdefault(example.episode, ["begin"])
        if example.last:
            history.append(f"{example.last['tool_name']} {example.outcome.split(' ')[0]}")
        yield example, list(history)


def baseline(train, held, longest):
    """Actions guessed from the calls before: the tool by itself, then the commonest arguments of the tool that was called."""
    tools, arguments = BackOff(longest), BackOff(longest)
    for example, history in histories(train):
        tool = example.action["tool_name"]
        tools.learn(history, tool)
        arguments.learn([*history, tool], json.dumps(example.action["args"], sort_keys=True))
    guesses = {}
    for example, history in histories(held):
        # The last word of an argument's context is its tool; at context zero that would be lost.
        arguments.longest = max(1, longest)
        guess = json.loads(arguments.guess([*history, example.action["tool_name"]]))
        guesses[example.episode, example.call] = {"tool_name": tools.guess(history), "args": guess}
    return guesses


def wilson(right, count):
    """The 95% interval of a share."""
    if count == 0:
        return [0.0, 1.0]
    z, share = 1.96, right / count
    middle, half = share + z * z / (2 * count), z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return [(middle - half) / (1 + z * z / count), (middle + half) / (1 + z * z / count)]


def at_least(right, chances):
    """How probable it is that so many or more come out right by chance."""
    ways = [1.0]
    for chance in chances:
        ways = [
            (ways[hits] if hits < len(ways) else 0) * (1 - chance) + (ways[hits - 1] * chance if hits else 0)
            for hits in range(len(ways) + 1)
        ]
    return min(1.0, sum(ways[right:]))


def share(rights):
    right, count = sum(rights), len(rights)
    return {"right": right, "count": count, "share": right / count if count else None, "interval": wilson(right, count)}


def arrived_at_one_of_several(example, situation, learned):
    """Whether the robot has just come to a place that looks by its name like others: the image says if it is the one."""
    if not example.last or example.last["tool_name"] != "nav_to":
        return False
    before = list(situation.visited)
    situation.visited = before[:-1]
    candidates = goes_to(example, situation, learned)
    situation.visited = before
    return len(candidates) > 1 and situation.at in candidates


def score(held, answers, learned):
    """All figures of one set of answers: {(episode, call): action or None}.

    Arguments are those written after the tool that was called: which tool it is, is asked of the text by itself.
    """
    before = situations(held)
    tools, by_tool = {"all": [], TEXT: [], IMAGE: []}, collections.defaultdict(list)
    arguments = {TEXT: [], NEITHER: []}
    details, exact, both, chances, guessed, outside = collections.defaultdict(list), [], [], [], [], 0
    for example in held:
        key = example.episode, example.call
        answer, tool = answers.get(key), example.action["tool_name"]
        same_tool, same = bool(answer) and answer["tool_name"] == tool, bool(answer) and answer["args"] == example.action["args"]
        tools["all"].append(same_tool)
        tools[IMAGE if arrived_at_one_of_several(example, before[key], learned) else TEXT].append(same_tool)
        by_tool[tool].append(same_tool)
        exact.append(same_tool and same)
        if not example.action["args"]:
            continue
        open_ = choice(example, tool, before[key], learned)
        details[f"{open_.decides} {tool}"].append(same)
        (label,) = example.action["args"].values()
        outside += bool(open_.candidates) and label not in open_.candidates
        if open_.decides != IMAGE:
            arguments[open_.decides].append(same)
            both += [same_tool and same] if open_.decides == TEXT else []
        else:
            guessed.append(same)
            chances.append((label in open_.candidates) / len(open_.candidates))
    return {
        "tool": {name: share(rights) for name, rights in tools.items()},
        "tool_by_label": {name: share(rights) for name, rights in sorted(by_tool.items())},
        "arguments": {name: share(rights) for name, rights in arguments.items()},
        "arguments_and_tool": share(both),
        "arguments_by_tool": {name: share(rights) for name, rights in sorted(details.items())},
        "image_arguments": {
            **share(guessed),
            "chance": sum(chances) / len(chances) if chances else None,
            "probability_by_chance": at_least(sum(guessed), chances),
        },
        "exact_actions": share(exact),
        "labels_outside_what_the_text_allows": outside,
        "unreadable": sum(answers.get((example.episode, example.call)) is None for example in held),
    }
