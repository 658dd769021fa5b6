"""The short form of the proof (under a minute): the pieces, and that a model learns from a few synthetic rows.

    "$(tests/python.sh)" tests/training/test.py
"""

import dataclasses
import json
import math
import pathlib
import sys
import tempfile
import unittest
import unittest.mock

import jax
import numpy

import agree
import augment
import classes
import data
import evaluate
import model
import play
import prove
import train
from tokenizer import ANSWER, BEGIN, END, PAD, Tokenizer

TASK = "Take a mug from the table in the hall and put it on the bed."
FURNITURE = ["table_3 (table, hall/0)", "table_11 (table, kitchen/0)", "bed_2 (bed, hall/0)", "bed_7 (bed, bedroom/1)"]


def row(scene, name, calls, task=TASK):
    """An episode as `reel export sft --format trl --style multi-turn` writes it; calls are (tool, arguments, outcome)."""
    part = lambda text: [{"type": "text", "text": text}]
    receptacles = "".join(f"- {one}\n" for one in FURNITURE)
    messages = [{"role": "system", "content": part("Behave.")}]
    messages.append({"role": "user", "content": [*part(f"Task: {task}\n\nReceptacles:\n{receptacles}"), {"type": "image"}]})
    for number, (tool, arguments, outcome) in enumerate(calls):
        function = {"name": tool, "arguments": json.dumps(arguments)}
        called = [{"id": f"call_{number}", "type": "function", "function": function}]
        messages.append({"role": "assistant", "content": part(f"<think>Now {tool}.</think>\n"), "tool_calls": called})
        messages.append({"role": "tool", "tool_call_id": f"call_{number}", "name": tool, "content": [*part(outcome), {"type": "image"}]})
    return {"messages": messages[:-1], "images": [], "tools": [], "provenance": {"episode": name, "scene": scene, "family": "FDP"}}


def episode(scene, name, place):
    """Go to a place, look for mugs, gaze at one of two, finish."""
    return row(scene, name, [
        ("nav_to", {"receptacle_name": place}, f"Arrived at {place}."),
        ("show_object_by_category", {"target_category": "mug"}, "Found 2 object(s) matching 'mug': marker 1, marker 2."),
        ("gaze_at", {"marker_id": 2}, "Looking at marker 2."),
        ("finish", {}, ""),
    ])


def examples():
    rows = [episode(scene, f"{scene}{n}", FURNITURE[n % 2].split()[0]) for scene in ("a", "b") for n in range(6)]
    return [step for one in rows for step in data.steps(one)]


def trained_on(some, width):
    """A tokenizer, the sequences and a configuration for some steps."""
    tokenizer = Tokenizer([f"{one.given}\n{one.answer}" for one in some])
    return tokenizer, list(train.sequences(tokenizer, some)), model.Config(len(tokenizer), width=width, layers=2)


class Pieces(unittest.TestCase):
    def test_text_survives_the_tokenizer(self):
        tokenizer = Tokenizer(["Go to table_1 (a, b/0).\n- x: {\"y\":\"z\"}"] * 2)
        for text in ["Go to table_1 (a, b/0).\n- x: {\"y\":\"z\"}", "ottoman_42 at Ottoman's 7 beds - 3: {\"q\":12}", "a b 1 2, 3 c"]:
            self.assertEqual(tokenizer.text(tokenizer.ids(text)), text)

    def test_steps_of_an_episode(self):
        one, two = examples()[:2]
        self.assertEqual(one.given, f"Task: {TASK}\n\nReceptacles:\n" + "\n".join(f"- {line}" for line in FURNITURE) + "\n")
        self.assertEqual((one.task, one.last, two.task), (TASK, None, TASK))
        self.assertEqual((two.call, two.last, two.given), (1, one.action, "Arrived at table_3."))
        self.assertEqual(data.parse(one.answer), {"tool_name": "nav_to", "args": {"receptacle_name": "table_3"}})

    def test_an_episode_is_one_sequence(self):
        some = examples()
        tokenizer, sequences, _ = trained_on(some, 16)
        self.assertEqual(len(sequences), 12)
        self.assertEqual([(ids.count(ANSWER), ids.count(END)) for ids in sequences], [(4, 4)] * 12)
        begin, end = sequences[0].index(ANSWER), sequences[0].index(END)
        self.assertEqual(tokenizer.text(sequences[0][1:begin]), some[0].given)
        self.assertEqual(tokenizer.text(sequences[0][begin + 1 : end]), some[0].answer)

    def test_the_last_call_is_read(self):
        action = {"tool_name": "pick", "args": {"marker_id": 1}}
        self.assertEqual(data.parse('<think><tool_call>{}</think>\n' + data.written(action)), action)
        self.assertIsNone(data.parse('<tool_call>{"name":3,"arguments":{}}</tool_call>'))
        self.assertIsNone(data.parse("pick 1"))

    def test_wordings_are_found(self):
        self.assertGreater(len(classes.PATTERNS), 5)
        for wording in classes.wordings():
            self.assertTrue(all(gap in wording for gap in ("{src}", "{dest}", "{object}")), wording)
            task = wording.format(src="the red table", dest="the bed", object="a mug", at="on")
            self.assertEqual(classes.ends(task), ("the red table", "the bed"))

    def test_who_decides(self):
        some = [one for one in examples() if one.episode == "a0"]
        learned = classes.Known({"mug"}, set())
        decided = [classes.choice(one, one.action["tool_name"], situation, learned)
                   for one, situation in zip(some[:3], classes.situations(some).values())]
        # The room names one table; the task names the mug; two numbers for one word.
        self.assertEqual([(one.decides, one.candidates) for one in decided],
                         [(classes.TEXT, ["table_3"]), (classes.TEXT, []), (classes.IMAGE, [1, 2])])
        open_ = some[0]
        open_.task = open_.task.replace("table in the hall", "brown table").replace("a mug", "a drink container")
        situation = classes.Situation()
        self.assertEqual(classes.choice(open_, "nav_to", situation, learned).candidates, ["table_3", "table_11"])
        self.assertEqual(classes.choice(open_, "show_object_by_category", situation, learned).decides, classes.NEITHER)
        situation.visited.append("table_11")
        self.assertEqual(classes.choice(open_, "nav_to", situation, learned).decides, classes.TEXT)

    def test_other_names_tell_the_same(self):
        some, draw = examples(), numpy.random.default_rng(3)
        words, learned = augment.kinds(some), classes.Known({"mug"}, set())
        decide = lambda steps: [
            (one.action["tool_name"], choice.decides, len(choice.candidates), *(one.action["args"].get("receptacle_name") == place for place in choice.candidates))
            for one, situation in zip(steps, classes.situations(steps).values())
            for choice in [classes.choice(one, one.action["tool_name"], situation, learned)]
        ]
        tasks = set()
        for _ in range(50):
            told = list(augment.renamed(some[:4], words, draw))
            tasks.add(told[0].task)
            # Which of the candidates is meant may come first or second: the list is in another order.
            self.assertEqual([sorted(map(str, one)) for one in decide(told)], [sorted(map(str, one)) for one in decide(some[:4])])
            self.assertEqual({one.receptacles.count("\n") for one in told}, {3})
            self.assertEqual([one.last for one in told], [None, *(one.action for one in told[:-1])])
        self.assertGreater(len(tasks), 40)
        several = list(augment.retold(some, draw))
        self.assertEqual([(one.episode, one.call) for one in several], [(one.episode, one.call) for one in some])
        self.assertTrue(0 < sum(one == other for one, other in zip(several, some)) < len(some))

    def test_chance_and_intervals(self):
        self.assertAlmostEqual(evaluate.at_least(2, [0.5, 0.5, 0.5]), 0.5)
        self.assertAlmostEqual(evaluate.at_least(1, [0.5, 0.25]), 1 - 0.5 * 0.75)
        low, high = evaluate.wilson(90, 100)
        self.assertTrue(0.82 < low < 0.9 < high < 0.95)

    def test_kappa(self):
        self.assertAlmostEqual(agree.kappa([("a", "a")] * 20 + [("a", "b")] * 5 + [("b", "a")] * 10 + [("b", "b")] * 15), 0.4)
        self.assertIsNone(agree.kappa([("a", "a")] * 3))

    def test_a_conversation_is_read_as_an_exported_one(self):
        calls = [("nav_to", {"receptacle_name": "bed_2"}, "Arrived at bed_2."), ("walk_around", {}, "Found 1 object(s): marker 1."), ("finish", {}, "")]
        one = row("a", "a0", calls)
        steps = list(data.steps(one))
        expected = [(step.given, step.answer) for step in steps[:-1]] + [(steps[-1].given, "")]
        self.assertEqual(play.turns(one["messages"][:-1]), expected)
        gibberish = [*one["messages"][:2], {"role": "assistant", "content": "bed!"}, {"role": "user", "content": "No tool selected."}]
        self.assertEqual(play.turns(gibberish), [(steps[0].given, "bed!"), ("No tool selected.", "")])

    def test_a_baseline_backs_off(self):
        table = evaluate.BackOff(2)
        for history in (["x", "y"], ["z", "y"]):
            table.learn(history, history[0])
        table.learn(["q"], "x")
        self.assertEqual([table.guess(["z", "y"]), table.guess(["?", "y"]), table.guess(["?"])], ["z", "x", "x"])


class Model(unittest.TestCase):
    def test_what_comes_later_decides_nothing(self):
        config = model.Config(40, width=16, layers=2, heads=2)
        parameters = model.initialise(config, 1)
        tokens = numpy.random.default_rng(0).integers(4, 40, (1, train.STEP))
        tokens[0, [20, 50]], tokens[0, 30] = ANSWER, END
        whole = numpy.asarray(model.likeliest(parameters, tokens, config))[0]
        for at in (20, 31, 60):
            cut = numpy.where(numpy.arange(train.STEP) > at, PAD, tokens)
            self.assertEqual(numpy.asarray(model.likeliest(parameters, cut, config))[0, : at + 1][20:].tolist(), whole[20 : at + 1].tolist())

    def test_only_answers_have_a_loss(self):
        config = model.Config(40, width=16, layers=2, heads=2)
        parameters = model.initialise(config, 1)
        tokens = train.padded([[BEGIN, 9, 8, ANSWER, 7, END, 6, ANSWER, 5, END]], 1)
        given = jax.jit(model.probabilities, static_argnames="config")(parameters, tokens, config)[0]
        expected = -numpy.mean([math.log(given[at, tokens[0, at + 1]]) for at in (3, 4, 7, 8)])
        found = jax.jit(model.loss, static_argnames="config")(parameters, tokens, config)
        self.assertTrue(math.isclose(float(found), expected, rel_tol=1e-4))

    def test_only_the_opening_is_read_both_ways(self):
        seen = numpy.asarray(model.seen(numpy.array([[BEGIN, 9, ANSWER, 7, END, 8, PAD]])))[0]
        self.assertTrue(seen[0, 1] and seen[3, 0] and seen[5, 4])
        self.assertFalse(seen[0, 2] or seen[2, 3] or seen[3, 5] or seen[0, 6])

    def test_writing_token_by_token_gives_the_same_chances(self):
        config = model.Config(40, width=16, layers=2, heads=2)
        parameters = model.initialise(config, 1)
        tokens = numpy.random.default_rng(0).integers(4, 40, (1, train.STEP))
        tokens[0, [20, 50]], tokens[0, 30] = ANSWER, END
        whole = numpy.asarray(model.probabilities(parameters, tokens, config))[0]
        with unittest.mock.patch.object(play, "CONTEXT", 256):
            memory, start = play.empty(config), 0
            # The opening, padded; then two pieces, one of them padded; then, as after another answer, the last again.
            for start, end, width in ((0, 25, 64), (25, 26, 1), (26, 60, 64), (40, 70, 64)):
                piece = numpy.zeros((1, width), numpy.int32)
                piece[0, : end - start] = tokens[0, start:end]
                chances, memory = play.extend(parameters, memory, piece, start, end - start, 20, config)
                self.assertTrue(numpy.allclose(chances, whole[end - 1], rtol=1e-3, atol=1e-6), (start, end))

    def test_the_coldest_sample_is_the_likeliest(self):
        draw, chances = numpy.random.default_rng(0), numpy.array([0.2, 0.5, 0.3])
        self.assertEqual([play.sample(chances, heat, draw) for heat in (0, 0.01)], [1, 1])
        self.assertEqual({play.sample(chances, 1, draw) for _ in range(100)}, {0, 1, 2})

    def test_what_is_no_call_is_drawn_again(self):
        pick = {"tool_name": "pick", "args": {"marker_id": 1}}
        writer = play.Writer(None, None, Tokenizer([data.written(pick), "pick"] * 2), {play.form(pick)})
        for said, drawn in ((["pick", data.written(pick)], 2), (["pick"] * 20, play.ATTEMPTS)):
            with unittest.mock.patch.object(writer, "write", side_effect=map(writer.tokenizer.ids, said)) as write:
                self.assertEqual(writer.answer([("pick", "")], 0.7)[0], said[drawn - 1])
                self.assertEqual(write.call_count, drawn)

    def test_it_learns(self):
        some = examples()
        tokenizer, sequences, config = trained_on(some, 32)
        parameters, losses = train.train(config, lambda _: sequences, 100, 0, say=lambda _: None)
        self.assertLess(losses[-1], 0.5 * losses[0])
        answers = prove.answer_all(parameters, config, tokenizer, some)
        scores = evaluate.score(some, answers, classes.known(some))
        self.assertGreater(scores["tool"]["all"]["share"], 0.9)

    def test_a_training_that_was_broken_off_goes_on(self):
        _, sequences, config = trained_on(examples(), 32)

        def stop(said):
            raise KeyboardInterrupt(said)

        with tempfile.TemporaryDirectory() as folder, unittest.mock.patch.object(train, "REPORT", 4):
            path = pathlib.Path(folder) / "training.pickle"
            with self.assertRaises(KeyboardInterrupt):
                train.train(config, lambda _: sequences, 8, 7, checkpoint=path, say=stop)
            self.assertIsNone(train.kept(path, dataclasses.replace(config, width=16)))
            broken = train.train(config, lambda _: sequences, 8, 7, checkpoint=path, say=lambda _: None)
            whole = train.train(config, lambda _: sequences, 8, 7, say=lambda _: None)
        self.assertEqual(broken[1], whole[1])
        self.assertTrue(numpy.array_equal(broken[0]["embedding"], whole[0]["embedding"]))


if __name__ == "__main__":
    unittest.main()
