"""Asks a checkpoint for each decision of an exported set, and compares its calls with the oracle's, by what decides them.

    python examine.py checkpoint --set held-out-set

Each prompt is that of the oracle's episode, so mistakes do not add up as in play. After an arrival at one of several look-alikes only the tool
is judged: which of the others is next is free.
"""

import argparse
import collections
import concurrent.futures
import itertools
import json
import pathlib
import random
import typing

import checkpoint
import data
import decisions
import generate


def call(answer: str) -> tuple[str, dict[str, typing.Any]] | None:
    """The call of an answer; `None` if it cannot be read."""
    try:
        action = json.loads(answer.split("</think>", 1)[1])["next action"]
        return action["tool_name"], action["args"]
    except (ValueError, KeyError, IndexError, TypeError):
        return None


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("--set", required=True, type=pathlib.Path)
    parser.add_argument("--out", type=pathlib.Path, help="write the shares into this file too")
    parser.add_argument("--limit", type=int, default=10**9, help="most decisions, drawn by seed 0")
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--threads", type=int, default=1, help="batches at a time")
    chosen = parser.parse_args()
    policy, tokenizer = checkpoint.load(chosen.checkpoint)
    examples, pictures = data.read(chosen.set), data.Pictures(policy)
    examples = random.Random(0).sample(examples, min(chosen.limit, len(examples)))
    examples.sort(key=lambda one: len(one.prompt))
    rights: dict[str, dict[str, list[bool]]] = collections.defaultdict(lambda: collections.defaultdict(list))

    def answered(some: list[data.Example]) -> list[generate.Answer]:
        prompts = [data.prompt_tokens(tokenizer, policy.config, one.prompt) for one in some]
        return generate.answers(policy, [generate.Question(prompt, pictures.get(one.image), 0.0, 120, 0) for prompt, one in zip(prompts, some)])

    batches = [examples[start : start + chosen.batch] for start in range(0, len(examples), chosen.batch)]
    with concurrent.futures.ThreadPoolExecutor(chosen.threads) as pool:
        answers = list(itertools.chain.from_iterable(pool.map(answered, batches)))
    for one, answer in zip(examples, answers):
        text = tokenizer.text(answer.tokens)
        said, wanted, kind = call(text), call(one.answer), decisions.kind(one)
        judged = data.JUDGED.search(text), data.JUDGED.search(one.answer)
        for name in (kind, kind.split(":")[0], "all"):
            rights[name]["readable"].append(said is not None)
            rights[name]["tool"].append(said is not None and said[0] == wanted[0])
            rights[name]["call"].append(said == wanted)
            if judged[1]:
                rights[name]["verdict"].append(judged[0] is not None and judged[0][4][:2] == judged[1][4][:2])
            if one.image:
                lines = data.HISTORY.search(text), data.HISTORY.search(one.answer)
                rights[name]["history"].append(lines[0] is not None and lines[0][1] == lines[1][1])
    share = lambda values: round(sum(values) / len(values), 3)
    told = json.dumps({kind: {"decisions": len(found["tool"]), **{name: share(values) for name, values in found.items()}} for kind, found in sorted(rights.items())}, indent=1)
    print(told)
    if chosen.out:
        chosen.out.write_text(told + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
