"""Trains a small language model from scratch on the text of an exported set and measures it on scenes it never saw.

    python3 prove.py --held-out home_201 home_202 --json result.json --sets set.jsonl ...

Exits 1 when fewer than 90% of the next tools or 80% of the arguments that the text determines are right.
"""

import argparse
import json
import os
import pathlib
import sys
import time

import numpy

import augment
import classes
import data
import evaluate
import model
import train
from tokenizer import ANSWER, END, Tokenizer

TOOLS_LEAST, ARGUMENTS_LEAST = 0.90, 0.80
ROWS = 4


def answer_all(parameters, config, tokenizer, examples):
    """Greedy answers, parsed: {(episode, call): action or None}. What came before each step is as it was recorded.

    Each token is the likeliest after the recorded ones, so arguments are those of the tool that was called. An action as a whole is the
    recorded one exactly where writing token by token gives it; all steps of an episode take one pass.
    """
    answers, ids = {}, list(train.sequences(tokenizer, examples))
    keys = iter([(one.episode, one.call) for one in examples])
    for start in range(0, len(ids), ROWS):
        some = ids[start : start + ROWS]
        tokens = train.padded(some, ROWS)
        likeliest = numpy.asarray(model.likeliest(parameters, tokens, config))
        for given, next_ in zip(tokens, likeliest):
            for begin, end in zip(numpy.flatnonzero(given == ANSWER), numpy.flatnonzero(given == END)):
                answer = next_[begin:end].tolist()
                answers[next(keys)] = data.parse(tokenizer.text(answer[: answer.index(END)] if END in answer else answer))
    return answers


def percent(share):
    return "    -" if share["share"] is None else f"{100 * share['share']:5.1f}%"


def tell(scores):
    """The table: baselines and the model side by side."""
    names = list(scores)
    print(f"\n{'':34}" + "".join(f"{name:>10}" for name in names) + "     of")
    line = lambda what, pick: print(
        f"{what:34}" + "".join(f"{percent(pick(scores[name])):>10}" for name in names) + f"{pick(scores['model'])['count']:7}"
    )
    line("next tool", lambda one: one["tool"]["all"])
    line("  where the text decides", lambda one: one["tool"][classes.TEXT])
    line("  at one of several look-alikes", lambda one: one["tool"][classes.IMAGE])
    line("arguments that the text determines", lambda one: one["arguments"][classes.TEXT])
    for name in scores["model"]["arguments_by_tool"]:
        if name.startswith(classes.TEXT):
            line(f"  {name.split()[1]}", lambda one, name=name: one["arguments_by_tool"][name])
    line("  and the tool before them, too", lambda one: one["arguments_and_tool"])
    line("arguments that neither tells", lambda one: one["arguments"][classes.NEITHER])
    line("whole actions", lambda one: one["exact_actions"])
    image = scores["model"]["image_arguments"]
    if image["count"]:
        low, high = image["interval"]
        print(
            f"\narguments that the image decides: {image['right']} of {image['count']} right, {100 * image['share']:.1f}% "
            f"(95% interval {100 * low:.1f} to {100 * high:.1f}%), by chance {100 * image['chance']:.1f}%; "
            f"that many or more by chance: p = {image['probability_by_chance']:.3f}"
        )
        for name, share in scores["model"]["arguments_by_tool"].items():
            if name.startswith(classes.IMAGE):
                print(f"  {name.split()[1]}: {share['right']} of {share['count']}")
    print(f"labels that the text rules out (detours of the expert): {scores['model']['labels_outside_what_the_text_allows']}")
    print(f"answers without a readable action: {scores['model']['unreadable']}")


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--sets", nargs="+", required=True, type=pathlib.Path, help="JSONL files of `reel export sft --format trl --style multi-turn`")
    options.add_argument("--held-out", nargs="+", required=True, help="the scenes to measure on; training never sees them")
    options.add_argument("--updates", type=int, default=2000)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument("--checkpoint", type=pathlib.Path, help="where to keep the training, and to go on from")
    options.add_argument("--json", type=pathlib.Path, help="where to write all figures")
    options.add_argument("--smoke", action="store_true", help="only check that all runs and that the loss falls")
    options = options.parse_args()
    began = time.perf_counter()

    examples = data.read(options.sets)
    held = [example for example in examples if example.scene in options.held_out]
    learnt = [example for example in examples if example.scene not in options.held_out]
    if not held or not learnt:
        sys.exit(f"{' '.join(options.held_out)}: {len(held)} examples held out, {len(learnt)} to train on; both are needed")
    tokenizer = Tokenizer([f"{example.given}\n{example.answer}" for example in learnt])
    sequences = list(train.sequences(tokenizer, learnt))
    told = lambda draw: list(train.sequences(tokenizer, augment.retold(learnt, draw)))
    config = model.Config(len(tokenizer))
    count = lambda some, what: len({what(example) for example in some})
    for name, some in (("train", learnt), ("held out", held)):
        print(f"{name}: {len(some)} steps, {count(some, lambda one: one.episode)} episodes, {count(some, lambda one: one.scene)} scenes")
    print(f"{len(tokenizer)} pieces, {sum(map(len, sequences)) / len(sequences):.0f} tokens an episode, seed {options.seed}", flush=True)
    parameters, losses = train.train(config, told, options.updates, options.seed, checkpoint=options.checkpoint)
    answers = answer_all(parameters, config, tokenizer, held)

    learned = classes.known(learnt)
    guesses = {"majority": evaluate.baseline(learnt, held, 0), "n-gram": evaluate.baseline(learnt, held, evaluate.LONGEST), "model": answers}
    scores = {name: evaluate.score(held, guess, learned) for name, guess in guesses.items()}
    tell(scores)
    wall_s, cpu_s = time.perf_counter() - began, sum(os.times()[:2])
    print(f"{model.count(parameters)} parameters; {wall_s:.0f} s, {cpu_s:.0f} s of CPU")
    if options.json:
        figures = {"train": len(learnt), "held_out": len(held), "losses": losses, "wall_s": wall_s, "cpu_s": cpu_s, "scores": scores}
        options.json.write_text(json.dumps(figures, indent=1))

    if options.smoke:
        sys.exit(0 if losses[-1] < losses[0] else f"the loss did not fall: {losses}")
    tool, text = scores["model"]["tool"]["all"]["share"], scores["model"]["arguments"][classes.TEXT]["share"]
    enough = tool >= TOOLS_LEAST and text >= ARGUMENTS_LEAST
    print(f"{'held' if enough else 'NOT HELD'}: tools {tool:.3f} (at least {TOOLS_LEAST}), arguments {text:.3f} (at least {ARGUMENTS_LEAST})")
    sys.exit(0 if enough else 1)


if __name__ == "__main__":
    main()
