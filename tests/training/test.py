"""The short form of the proof (under a minute): the pieces, and that a model learns from a few made-up rows.

    $REEL_TRAIN_PYTHON tests/training/test.py
"""

import importlib.util
import json
import math
import sys
import unittest

if importlib.util.find_spec("jax") is None:
    print("skipped: jax is not installed (tests/training/requirements.txt)", file=sys.stderr)
    sys.exit(0)

import jax
import numpy

import classes
import data
import evaluate
import model
import prove
import train
from tokenizer import ANSWER, BEGIN, END, Tokenizer

TASK = "Take a mug from the table in the hall and put it on the bed."
FURNITURE = ["table_3 (table, hall/0)", "table_11 (table, kitchen/0)", "bed_2 (bed, hall/0)", "bed_7 (bed, bedroom/1)"]


def row(scene, episode, call, last, outcome, action, task=TASK, progress="Nothing done yet."):
    """A row as `reel export sft --format trl` writes it."""
    receptacles = "".join(f"- {one}\n" for one in FURNITURE)
    user = f"Task: {task}\n\nTools:\n[]\n\nReceptacles:\n{receptacles}\nProgress:\n{progress}\n\nLast action: {last}\nLast outcome: {outcome}\n\nCurrent view: "
    answer = f'<think>It says "next_action": {{}}.</think>\n{json.dumps({"History": "", "next_action": action})}'
    part = lambda text: [{"type": "text", "text": text}]
    return {
        "prompt": [{"role": "system", "content": part("Behave.")}, {"role": "user", "content": [*part(user), {"type": "image"}]}],
        "completion": [{"role": "assistant", "content": part(answer)}],
        "images": ["images/0.png"],
        "provenance": {"example": f"{episode}/{call}", "episode": episode, "call": call, "scene": scene, "family": "FDP"},
    }


def episode(scene, name, place):
    """Go to a place, look for mugs, gaze at one of two, finish."""
    calls = [
        ("nav_to", {"receptacle_name": place}, f"Arrived at {place}."),
        ("show_object_by_category", {"target_category": "mug"}, "Found 2 object(s) matching 'mug': marker 1, marker 2."),
        ("gaze_at", {"marker_id": 2}, "Looking at marker 2."),
        ("finish", {}, ""),
    ]
    last, outcome = "none", "The episode begins."
    for call, (tool, arguments, told) in enumerate(calls):
        action = {"tool_name": tool, "args": arguments}
        yield row(scene, name, call, last, outcome, action)
        last, outcome = json.dumps(action), told


def examples():
    rows = [one for scene in ("a", "b") for n in range(6) for one in episode(scene, f"{scene}{n}", FURNITURE[n % 2].split()[0])]
    return [data.example(one) for one in rows]


class Pieces(unittest.TestCase):
    def test_text_survives_the_tokenizer(self):
        tokenizer = Tokenizer(["Go to table_1 (a, b/0).\n- x: {\"y\":\"z\"}"] * 2)
        for text in ["Go to table_1 (a, b/0).\n- x: {\"y\":\"z\"}", "ottoman_42 at Ottoman's 7 beds - 3: {\"q\":12}", "a b 1 2, 3 c"]:
            self.assertEqual(tokenizer.text(tokenizer.ids(text)), text)

    def test_prompts_keep_what_changes(self):
        one = examples()[1]
        self.assertNotIn("Tools:", one.prompt)
        self.assertNotIn("Current view", one.prompt)
        self.assertEqual(data.section(one.prompt, "Task"), TASK)
        self.assertEqual(data.section(one.prompt, "Last outcome"), "Arrived at table_3.")

    def test_actions_are_read_after_the_reasoning(self):
        self.assertEqual(data.parse('<think>"next_action": {}</think>```json\n{"next_action": {"name": "pick", "arguments": {"marker_id": 1}}}'),
                         {"tool_name": "pick", "args": {"marker_id": 1}})
        self.assertIsNone(data.parse('{"next_action": {"tool_name": 3}}'))
        self.assertIsNone(data.parse("pick 1"))

    def test_who_decides(self):
        some = [one for one in examples() if one.episode == "a0"]
        learned = classes.Known({"mug"}, set())
        decided = [classes.choice(one, one.action["tool_name"], situation, learned)
                   for one, situation in zip(some[:3], classes.situations(some).values())]
        # The room names one table; the task names the mug; two numbers for one word.
        self.assertEqual([(one.decides, one.candidates) for one in decided],
                         [(classes.TEXT, ["table_3"]), (classes.TEXT, []), (classes.IMAGE, [1, 2])])
        open_ = some[0]
        open_.prompt = open_.prompt.replace("table in the hall", "brown table").replace("a mug", "a drink container")
        situation = classes.Situation()
        self.assertEqual(classes.choice(open_, "nav_to", situation, learned).candidates, ["table_3", "table_11"])
        self.assertEqual(classes.choice(open_, "show_object_by_category", situation, learned).decides, classes.NEITHER)
        situation.visited.append("table_11")
        self.assertEqual(classes.choice(open_, "nav_to", situation, learned).decides, classes.TEXT)

    def test_chance_and_intervals(self):
        self.assertAlmostEqual(evaluate.at_least(2, [0.5, 0.5, 0.5]), 0.5)
        self.assertAlmostEqual(evaluate.at_least(1, [0.5, 0.25]), 1 - 0.5 * 0.75)
        low, high = evaluate.wilson(90, 100)
        self.assertTrue(0.82 < low < 0.9 < high < 0.95)

    def test_a_baseline_backs_off(self):
        table = evaluate.BackOff(2)
        for history in (["x", "y"], ["z", "y"]):
            table.learn(history, history[0])
        table.learn(["q"], "x")
        self.assertEqual([table.guess(["z", "y"]), table.guess(["?", "y"]), table.guess(["?"])], ["z", "x", "x"])


class Model(unittest.TestCase):
    def test_generation_with_a_cache_is_that_without(self):
        config = model.Config(40, width=16, layers=3, heads=2)
        parameters = model.initialise(config, 1)
        given = [[BEGIN, 9, 8, 7, ANSWER], [BEGIN, 20, 21, 22, 23, 24, 9, ANSWER]]
        most = 6
        forward = jax.jit(model.forward, static_argnames=("tail", "config"))
        cached = numpy.asarray(model.generate(parameters, train.padded(given, 2), config, most))
        for ids, found in zip(given, cached):
            written = list(ids)
            for _ in range(most):
                logarithms, *_ = forward(parameters, train.padded([written], 1), 1, config)
                written.append(int(numpy.argmax(numpy.asarray(logarithms[0, -1]))))
                if written[-1] == END:
                    break
            answer = written[len(ids) :]
            self.assertEqual(found.tolist()[: len(answer)], answer)

    def test_only_the_answer_has_a_loss(self):
        config = model.Config(40, width=16, layers=2, heads=2)
        parameters = model.initialise(config, 1)
        tokens = train.padded([[BEGIN, 9, 8, ANSWER, 7, 6, END]], 1)
        logits = numpy.asarray(model.forward(parameters, tokens[:, :-1], 3, config)[0][0])
        expected = -numpy.mean([logits[0, 7], logits[1, 6], logits[2, END]])
        for tail in (3, 10, 40):
            self.assertTrue(math.isclose(float(model.loss(parameters, tokens, tail, config)), expected, rel_tol=1e-4))

    def test_it_learns(self):
        some = examples()
        tokenizer = Tokenizer([f"{one.prompt}\n{prove.target(one)}" for one in some])
        sequences = [train.sequence(tokenizer, one.prompt, prove.target(one)) for one in some]
        config = model.Config(len(tokenizer), width=32)
        parameters, losses = train.train(config, sequences, 25, 0, say=lambda _: None)
        self.assertLess(losses[-1], 0.2 * losses[0])
        answers = prove.answer_all(parameters, config, tokenizer, some, 64)
        scores = evaluate.score(some, answers, classes.known(some))
        self.assertGreater(scores["tool"]["all"]["share"], 0.9)

    def test_equal_seeds_learn_alike(self):
        some = examples()
        tokenizer = Tokenizer([one.prompt for one in some])
        sequences = [train.sequence(tokenizer, one.prompt, prove.target(one)) for one in some]
        config = model.Config(len(tokenizer), width=16)
        losses = [train.train(config, sequences, 2, 7, say=lambda _: None)[1] for _ in range(2)]
        self.assertEqual(losses[0], losses[1])


if __name__ == "__main__":
    unittest.main()
