"""Tests of the learning loop that need no binary: `python -m unittest discover python/loop/tests`."""

import argparse
import base64
import collections
import dataclasses
import io
import json
import pathlib
import random
import sys
import tempfile
import threading
import types
import unittest
import unittest.mock
import urllib.error
import urllib.request

import numpy
import torch
from PIL import Image

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))
import ablate
import checkpoint
import data
import evaluate
import generate
import gspo
import images
import model
import notes
import play
import pretrain
import rollouts
import score
import server
import sft
import takeover
from tokenizer import ANSWER, END, IMAGE, Tokenizer, join, split

PROMPT = """You are a robot.
Call one tool at a time.

Rooms and their receptacles:
1) In kitchen/0: table_1, sink_2.
2) In living room/0: couch_1, table_3.
Answer with JSON.

Task: Take the red mug from the table with a glass top and put it on the couch.
Hand: empty
Progress: {'History': '0) started'}
Last action: {"tool_name": "navigate_to", "args": {"receptacle_name": "table_1"}}
Last observation: View: <image>
Result: Arrived at table_1."""
ANSWERED = '<think>want a red mug</think>\n{"summary":{"History":"1) at table_1"},"next action":{"tool_name":"navigate_to","args":{"receptacle_name":"table_3"}}}'
torch.set_num_threads(1)  # on a busy machine threads wait for each other
SMALL = {"width": 32, "layers": 2, "heads": 2, "channels": (8, 8, 8)}


def examples(folder: pathlib.Path, count: int = 6) -> list[data.Example]:
    """Decisions with images of one colour each."""
    found = []
    for index in range(count):
        path = folder / f"{index}.png"
        Image.new("RGB", (images.WIDTH, images.HEIGHT), (40 * index, 0, 255 - 40 * index)).save(path)
        found.append(data.Example(f"e{index}", 0, "home", PROMPT.replace("mug", f"mug {'x' * index}"), path, ANSWERED))
    return found


class Words(unittest.TestCase):
    def test_text_comes_back(self) -> None:
        tokenizer = Tokenizer.of([PROMPT] * 5, [ANSWERED] * 5)
        for text in [PROMPT, ANSWERED, "unseen_77, 3rd  a b\n\n c_d4 x1y (a)(b)", " a ", "a  b", "1 2 3/4 _5", "<image>a<image> b"]:
            self.assertEqual(join(split(text)), text)
            self.assertEqual(tokenizer.text(tokenizer.ids(text)), text)
            self.assertEqual("".join(tokenizer.deltas(tokenizer.ids(text))), text)

    def test_random_text_comes_back(self) -> None:
        tokenizer, rng = Tokenizer.of([PROMPT] * 5, [ANSWERED] * 5), random.Random(0)
        for _ in range(500):
            text = "".join(rng.choice("ab1_/ \n{}\":,.<>") for _ in range(rng.randrange(12)))
            self.assertEqual(tokenizer.text(tokenizer.ids(text)), text, repr(text))

    def test_shared_lines_are_one_token(self) -> None:
        other = PROMPT.replace("mug", "cup").replace("table_1", "desk_1")
        tokenizer = Tokenizer.of([PROMPT, other] * 5, [ANSWERED] * 10)
        self.assertEqual(len(tokenizer.ids("You are a robot.\nCall one tool at a time.\n\nRooms and their receptacles:\n")), 1)

    def test_renaming_is_consistent(self) -> None:
        one = data.renamed(data.Example("e", 0, "home", PROMPT, None, ANSWERED), random.Random(3))
        mapped = one.prompt.split("Arrived at ")[1].rstrip(".")
        self.assertIn(f"1) at {mapped}\"", one.answer)
        self.assertEqual(len(one.prompt.split()), len(PROMPT.split()))


class Seeing(unittest.TestCase):
    def test_masks_are_read(self) -> None:
        # A column of 4, height 2: runs of 1, 2, 1 go down the columns of a 2 x 2 image.
        covered = pretrain.mask({"size": [2, 2], "counts": "121"})
        self.assertEqual(covered.tolist(), [[False, True], [True, False]])
        # From the fourth on a run is the difference from the one before the last: 4 - 1.
        self.assertEqual(pretrain.run_lengths("342O"), [3, 4, 2, 3])

    def test_cells_have_the_words_of_what_fills_them(self) -> None:
        runs = lambda first, inside: "".join(map(encoded, (first, inside, images.HEIGHT * images.WIDTH - first - inside)))
        about = pretrain.Described({"mug_1": {"category: mug", "red"}}, {"table_1": {"category: table", "top: glass"}}, [{"mug_1": "marker: 3"}])
        # The table fills the left half; the mug fills the first column of cells.
        annotations = [
            {"instance": "mug_1", "segmentation": {"size": [images.HEIGHT, images.WIDTH], "counts": runs(0, images.HEIGHT * pretrain.CELL)}},
            {"instance": "table_1", "segmentation": {"size": [images.HEIGHT, images.WIDTH], "counts": runs(0, images.HEIGHT * images.WIDTH // 2)}},
            {"instance": "wall", "segmentation": {"size": [images.HEIGHT, images.WIDTH], "counts": runs(0, images.HEIGHT * images.WIDTH)}},
        ]
        cells = pretrain.label(annotations, about, 0)
        columns = images.WIDTH // pretrain.CELL
        self.assertEqual(cells[0], {"category: mug", "red", "marker: 3"})
        self.assertEqual(cells[columns + 1], {"category: table", "top: glass"})
        self.assertNotIn(columns - 1, cells)
        self.assertEqual(pretrain.label(annotations, about, None)[0], {"category: mug", "red"})

    def test_an_encoder_learns_what_stands_where(self) -> None:
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        frames = []
        columns = images.WIDTH // pretrain.CELL
        for index, (left, right) in enumerate([("red", "blue"), ("blue", "red")] * 2):
            path = folder / f"{index}.png"
            image = Image.new("RGB", (images.WIDTH, images.HEIGHT), left)
            image.paste(right, (images.WIDTH // 2, 0, images.WIDTH, images.HEIGHT))
            image.save(path)
            cells = {cell: frozenset({left if cell % columns < columns // 2 else right}) for cell in range(columns * (images.HEIGHT // pretrain.CELL))}
            frames.append(pretrain.Frame(path, cells))
        config = model.Config(1, **{**SMALL, "channels": (16, 16, 16)})
        torch.manual_seed(0)
        batches = pretrain.Batches(frames, ["blue", "red"], 1)
        encoder, heads = pretrain.train(config, batches, 120, 1e-2, 4, 0)
        self.assertGreater(pretrain.examine(encoder, heads, batches)["plain"], 0.9)


def encoded(value: int) -> str:
    """One of the first three runs of a mask in COCO's compressed form."""
    text = ""
    while True:
        part, value = value & 31, value >> 5
        more = value != 0 or bool(part & 16)
        text += chr(48 + part + (32 if more else 0))
        if not more:
            return text


class Comparing(unittest.TestCase):
    """What an image shows, compared with what instructions of the same home want."""

    def decision(self, home: str, answer: str) -> data.Example:
        return data.Example("e", 0, home, PROMPT, pathlib.Path("image.png"), answer)

    def arrival(self, wanted: str, seen: str, verdict: str, home: str = "home") -> data.Example:
        return self.decision(home, f'<think>want {wanted}; {seen}; {verdict}</think>\n{{"summary":{{"History":"1) at {seen}"}}}}')

    def test_the_first_word_that_lacks_is_named(self) -> None:
        for wanted, seen, word in [
            ("gray cabinet", "cabinet_2 in toilet: oak, silver handles", " gray"),
            ("cabinet with brass handles in the study", "cabinet_2 in study: oak, brass handle", ""),
            ("cabinet in the study", "cabinet_2 in toilet: oak", " study"),
            ("table with a glass top", "table_1 in hall: walnut top", " glass"),
        ]:
            self.assertEqual(notes.lacking(wanted, seen), word)

    def test_what_no_look_has_is_left_out(self) -> None:
        looks = [{"colour": ["pink", "dark red"], "material": ["leather"], "shape": ["round"]}]
        for phrase, words in [
            ("pink leather round diary with a locked clasp", "pink leather diary"), ("dark red diary", "dark red diary"), ("something to write in", "something to write in"),
        ]:
            self.assertEqual(notes.comparable(phrase, "diary", looks), words)

    def test_receptacles_are_compared_with_what_others_want(self) -> None:
        gray, oak = "cabinet_1 in toilet: gray", "cabinet_2 in study: oak"
        known = [self.arrival("gray cabinet", gray, "yes"), self.arrival("oak cabinet", oak, "yes"), self.arrival("gray cabinet", oak, "no gray")]
        known.append(self.arrival("red cabinet", "cabinet_1 in hall: red", "yes", "other home"))
        drawn = collections.Counter(data.Comparisons(known).draw(known[2], random.Random(seed)).answer for seed in range(400))
        said = {f"want oak cabinet; {oak}; yes", f"want gray cabinet; {oak}; no gray", f"want red cabinet; {oak}; no red"}
        self.assertEqual(set(drawn), said)
        self.assertTrue(160 < drawn[f"want oak cabinet; {oak}; yes"] < 240, drawn)
        self.assertTrue(20 < drawn[f"want red cabinet; {oak}; no red"] < 80, drawn)  # of another home: an eighth

    def test_objects_are_compared_by_their_look(self) -> None:
        def shown(seen: str) -> data.Example:
            return self.decision("home", f'<think>want x</think>\n{{"summary":{{"History":"3) saw mug {seen}"}}}}')

        known = [shown("1: red; 2: white glass"), shown("1: blue"), shown("4: red; 5: red")]
        comparisons = data.Comparisons(known)
        drawn = {comparisons.draw(known[0], random.Random(seed)).answer for seed in range(100)}
        self.assertEqual(drawn, {f"want {wanted} mug; 1: red; 2: white glass; {verdict}" for wanted, verdict in [("red", "1 fits"), ("white glass", "2 fits"), ("blue", "no")]})
        for seed in range(20):  # two alike: neither is asked for
            self.assertTrue(comparisons.draw(known[2], random.Random(seed)).answer.endswith("; no"))
        one = comparisons.draw(known[0], random.Random(0))
        self.assertTrue(one.prompt.startswith("want ") and one.prompt.endswith("Last observation: View: <image>\nResult: Arrived at table_1."))


class TakingOver(unittest.TestCase):
    """The oracle goes on where a policy went wrong."""

    def test_after_and_instead_of_what_failed(self) -> None:
        ok = lambda tool: {"tool": tool, "outcome": {}}
        failed = lambda tool: {"tool": tool, "outcome": {"error": "nothing_found"}}
        steps = [ok("nav_to"), failed("show_object_by_category"), ok("nav_to"), ok("gaze_at"), failed("pick"), {"tool": None, "outcome": {}}, ok("finish")]
        # Not at 4: whoever takes over after a search that found something searches again.
        self.assertEqual(takeover.failures(steps), [1, 2, 5, 6])
        self.assertEqual(takeover.failures([failed("nav_to")]), [])

    def test_at_wrong_verdicts(self) -> None:
        task = {"src": "table_1", "dest": "couch_1"}
        ok = lambda tool, held=None, **arguments: {"tool": tool, "outcome": {}, "held": held, "input": {"call": {"arguments": arguments}}}
        go = lambda name, held=None: ok("nav_to", held, receptacle_name=name)
        search = ok("show_object_by_category")
        self.assertEqual(takeover.misjudged(task, [go("table_1"), search, go("table_2"), search]), [3])
        self.assertEqual(takeover.misjudged(task, [go("table_1"), go("table_2"), go("table_1"), search]), [1])
        self.assertEqual(takeover.misjudged(task, [go("couch_1", "mug"), go("table_1", "mug"), ok("place")]), [1, 2])
        self.assertEqual(takeover.misjudged(task, [go("couch_1", "mug"), ok("place")]), [])

    def test_only_the_decisions_of_the_expert_have_words(self) -> None:
        thing = {"instance": "mug", "category": "mug", "attributes": {"colour": ["red"]}}
        place = lambda name: {"id": name, "category": "table", "room": "kitchen/0", "captions": {}, "attributes": {}}
        step = lambda index, tool, call: {
            "step": index, "tool": tool, "input": {"call": call}, "outcome": {"text": ""} | ({} if tool else {"error": "unparsable_output"}), "markers": [], "held": None,
        }
        go = lambda name: {"name": "nav_to", "arguments": {"receptacle_name": name}}
        trace = {
            "header": {"parent": {"call": 2}}, "scene": {"receptacles": [place("table_1"), place("table_2")]},
            "task": {"instruction": "Take the red mug.", "objects": [thing], "target": "mug", "src": "table_1", "dest": "table_2"},
            "steps": [step(0, "nav_to", go("table_2")), step(1, None, {"name": "", "arguments": None}), step(2, "nav_to", go("table_1")), step(3, "finish", {"name": "finish", "arguments": {}})],
        }
        found = notes.Episode(trace).notes()
        self.assertEqual([one["reasoning"] for one in found], ["", "", "want red mug", "want table; table_1 in kitchen: plain; yes"])
        self.assertEqual(found[2]["history"], "2) gave no call")
        self.assertFalse(data.is_noted(data.Example("e", 0, "home", PROMPT, None, '{"summary":{}}')))
        self.assertTrue(data.is_noted(data.Example("e", 0, "home", PROMPT, None, ANSWERED)))


class Learning(unittest.TestCase):
    def setUp(self) -> None:
        self.folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        self.examples = examples(self.folder)
        self.tokenizer = Tokenizer.of([one.prompt for one in self.examples], [one.answer for one in self.examples])
        self.config = model.Config(len(self.tokenizer), **SMALL)

    def batch(self, config: model.Config) -> data.Batch:
        return data.batch([data.row(self.tokenizer, config, one) for one in self.examples], data.Pictures(model.build(config, 0)))

    def test_a_seed_is_a_model(self) -> None:
        one, same, other = (checkpoint.digest(model.build(self.config, seed)) for seed in (0, 0, 1))
        self.assertEqual(one, same)
        self.assertNotEqual(one, other)

    def test_the_blind_twin_sees_nothing_and_is_equal_otherwise(self) -> None:
        batch = self.batch(self.config)
        black = dataclasses.replace(batch, features=torch.zeros_like(batch.features))
        score = lambda policy, what: policy.logprobs(what.tokens, what.features, what.sequences)
        seeing, blind = model.build(self.config, 0), model.build(dataclasses.replace(self.config, blind=True), 0)
        self.assertEqual(checkpoint.digest(seeing), checkpoint.digest(blind))
        self.assertFalse(torch.equal(score(seeing, batch), score(seeing, black)))
        self.assertTrue(torch.equal(score(blind, batch), score(blind, black)))

    def test_sampled_logprobs_are_those_of_training(self) -> None:
        policy = model.build(self.config, 0)
        rows = [data.row(self.tokenizer, self.config, one) for one in self.examples[:3]]
        pictures = data.Pictures(policy)
        questions = [generate.Question(one.prompt, pictures.get(one.image), 1.0, (2, 9, 3)[index], index) for index, one in enumerate(rows)]
        found = generate.answers(policy, questions)
        batch = data.batch([dataclasses.replace(one, answer=answer.tokens) for one, answer in zip(rows, found)], pictures)
        scored = policy.logprobs(batch.tokens, batch.features, batch.sequences)
        for values, answer in zip(scored.split([len(answer.tokens) for answer in found]), found, strict=True):
            numpy.testing.assert_allclose(values.detach(), answer.logprobs, atol=1e-5)
        alone = generate.answers(policy, questions[1:2])
        self.assertEqual(alone[0].tokens, found[1].tokens)

    def test_a_training_goes_on_where_it_stopped(self) -> None:
        options = sft.Options(8, tokens=2000, bf16=False)
        train = lambda out, minutes: sft.train(self.examples, self.config, self.tokenizer, options, self.folder / out, minutes)
        whole = train("whole", None)
        parts = [train("parts", 0) for _ in range(8)][-1]
        self.assertEqual(checkpoint.digest(whole), checkpoint.digest(parts))
        again, _ = checkpoint.load(self.folder / "parts")
        self.assertEqual(checkpoint.digest(whole), checkpoint.digest(again))

    def test_the_loss_falls(self) -> None:
        sft.train(self.examples, self.config, self.tokenizer, sft.Options(60, rate=3e-3, bf16=False), self.folder / "out", None)
        losses = [json.loads(line)["loss"] for line in (self.folder / "out" / "log.jsonl").read_text().splitlines()]
        self.assertLess(losses[-1], losses[0] / 2)


class Reinforcing(unittest.TestCase):
    """GSPO on made rollouts: three groups of two, two decisions each."""

    def setUp(self) -> None:
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        some = examples(folder)
        self.tokenizer = Tokenizer.of([one.prompt for one in some], [one.answer for one in some])
        self.config = model.Config(len(self.tokenizer), **SMALL)
        self.policy, rng = model.build(self.config, 0), random.Random(1)
        self.pictures = data.Pictures(self.policy)
        rows = [data.row(self.tokenizer, self.config, one) for one in some]
        self.decisions = []
        for rollout in range(6):
            for call in range(2):
                row = rows[(rollout + call) % len(rows)]
                row = dataclasses.replace(row, answer=row.answer[: rng.randrange(5, len(row.answer))])
                names = [f"token_id:{token}" for token in row.answer]
                self.decisions.append(rollouts.Decision(f"e{rollout}", call, f"g{rollout // 2}", row, names, [], (-1.0, 1.0)[rollout % 2], 0.0, False))
        old = score.score(self.policy, self.decisions, self.pictures, 2000)
        self.decisions = [dataclasses.replace(one, old=values) for one, values in zip(self.decisions, old)]

    def test_weights_are_the_derivative_of_the_loss(self) -> None:
        options = gspo.Options(epsilon=0.02, epsilon_high=0.03, beta=0.5, bf16=False)
        draw = lambda values, by: [[min(0.0, value + by * random.Random(index).gauss(0, 1)) for index, value in enumerate(row)] for row in values]
        old = [one.old for one in self.decisions]
        new, ref = draw(old, 0.2), draw(old, 0.3)
        weights, metrics = gspo.objective(self.decisions, new, ref, options)
        # The same by autograd, from the formula of the paper.
        leaves = [torch.tensor(row, dtype=torch.float64, requires_grad=True) for row in new]
        terms = []
        for episode in range(6):
            members = [index for index, one in enumerate(self.decisions) if one.episode == f"e{episode}"]
            stack = lambda rows: torch.cat([torch.as_tensor(rows[index], dtype=torch.float64) for index in members])
            ratio, advantage = (stack(leaves) - stack(old)).mean().exp(), self.decisions[members[0]].advantage
            gap = stack(ref) - stack(leaves)
            terms.append(-torch.minimum(ratio * advantage, ratio.clamp(0.98, 1.03) * advantage) + 0.5 * (gap.exp() - 1 - gap).mean())
        loss = torch.stack(terms).mean()
        loss.backward()
        self.assertAlmostEqual(loss.item(), metrics.loss, places=9)
        for leaf, row in zip(leaves, weights):
            numpy.testing.assert_allclose(leaf.grad, row, atol=1e-12)
        self.assertGreater(metrics.low + metrics.high, 0, "something is clipped")
        self.assertLess(metrics.low + metrics.high, 1, "and something is not")

    def test_better_rollouts_become_likelier(self) -> None:
        learner = gspo.Learner(self.policy, gspo.Options(rate=1e-3, updates=1, epsilon=0.5, epsilon_high=0.5, bf16=False))
        ref = model.build(self.config, 0)
        for _ in range(4):
            learner.learn(self.decisions, ref, self.pictures)
        after = score.score(self.policy, self.decisions, self.pictures, 2000)
        gains = [(sum(row) - sum(one.old)) * one.advantage for one, row in zip(self.decisions, after)]
        self.assertGreater(sum(gains), 0)

    def test_each_update_has_groups_of_its_own(self) -> None:
        lines, scores = gspo.Learner(self.policy, gspo.Options(rate=1e-3, bf16=False)).learn(self.decisions, model.build(self.config, 0), self.pictures)
        self.assertEqual([line["episodes"] for line in lines], [2, 2, 2])
        self.assertEqual(sorted(group for line in lines for group in line["groups"]), ["g0", "g1", "g2"])
        self.assertAlmostEqual(lines[0]["ratio"], 1, places=6)
        self.assertNotAlmostEqual(lines[2]["ratio"], 1, places=6)
        self.assertTrue(all(len(one.row.answer) == len(row) for one, row in zip(self.decisions, scores["new"])))

    def test_a_step_again_gives_the_same_weights_with_any_number_of_threads(self) -> None:
        def learned(threads: int) -> str:
            learner = gspo.Learner(model.build(self.config, 0), gspo.Options(updates=1, tokens=600), threads)
            learner.learn(self.decisions, model.build(self.config, 0), self.pictures)
            return checkpoint.digest(learner.policy)

        self.assertGreater(len(data.batches([one.row for one in self.decisions], 600)), 2, "there is something to share")
        self.assertEqual(learned(1), learned(1))
        self.assertEqual(learned(1), learned(3))

    def test_a_step_that_the_traces_do_not_bear_out_is_not_kept(self) -> None:
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        checkpoint.save(folder / "first", self.policy, self.tokenizer)
        (folder / "home/tasks").mkdir(parents=True)
        (folder / "home/tasks/t.yaml").touch()
        chosen = argparse.Namespace(out=folder / "out", checkpoint=folder / "first", tasks=folder, steps=1, minutes=None, threads=1)
        line = {
            "step": 1, "success": 0.0, "return": 0.0, "updates": [{"kl": 0.0, "low": 0.0}], "episodes": 1, "seconds": {}, "log_to_traces": 0.0, "sampled_to_scored": 0.0,
        }
        for wrong, kept in (({"log_to_traces": 1e-3}, 0), ({"sampled_to_scored": 1e-3}, 0), ({}, 1)):
            with unittest.mock.patch.object(gspo, "step", return_value=line | wrong):
                if wrong:
                    self.assertRaisesRegex(SystemExit, "step 1 is not kept", gspo.train, chosen, gspo.Options())
                else:
                    gspo.train(chosen, gspo.Options())
            log = folder / "out/steps.jsonl"
            self.assertEqual(len(log.read_text().splitlines()) if log.exists() else 0, kept)
            self.assertEqual((folder / "out/step_001").exists(), bool(kept))

    def test_tasks_of_steps_come_around(self) -> None:
        tasks = [pathlib.Path(f"t{index}") for index in range(10)]
        drawn = [rollouts.tasks_of_step(tasks, step, 5, 0) for step in (1, 2, 3)]
        self.assertEqual(sorted(drawn[0] + drawn[1]), sorted(tasks))
        self.assertNotEqual(drawn[0], drawn[2])


class Forecasting(unittest.TestCase):
    """What another reward would have led to."""

    def test_ranks_share_and_correlate(self) -> None:
        self.assertEqual(ablate.ranks([3.0, 1.0, 3.0, 2.0]), [3.5, 1.0, 3.5, 2.0])
        self.assertAlmostEqual(ablate.correlation([1.0, 2.0, 3.0], [2.0, 4.0, 6.0]), 1)
        self.assertIsNone(ablate.correlation([1.0, 1.0], [1.0, 2.0]))

    def test_the_reward_that_pays_for_a_behaviour_leads_to_more_of_it(self) -> None:
        names = ["a", "b", "c", "d"]
        values = lambda **known: {**dict.fromkeys(ablate.BEHAVIOURS, 0.0), **known}
        did = {name: ablate.Did("t", values(questions=float(index), success=float(index % 2))) for index, name in enumerate(names)}
        pays_success = {"g": {name: did[name].values["success"] - 0.5 for name in names}}
        pays_questions = {"g": {name: did[name].values["questions"] - 1.5 for name in names}}
        told = ablate.forecast([(pays_success, pays_questions, did)])
        self.assertEqual((told["groups"], told["groups_ranked"], told["rollouts"]), (1, 1, 4))
        self.assertGreater(told["behaviours"]["questions"]["other"], told["behaviours"]["questions"]["recorded"])
        self.assertAlmostEqual(told["signs_flipped"], 0.5)
        step = lambda *asked: {str(index): ablate.Did(f"t{index % 2}", values(questions=count)) for index, count in enumerate(asked)}
        few, more, mixed = [[step(*asked)] * 4 for asked in ((1.0, 1.0, 1.0, 1.0), (1.0, 3.0, 3.0, 3.0), (2.0, 0.0, 2.0, 0.0))]
        for base, other, held in ((few, more, True), (more, few, False), (few, mixed, None)):
            ablate.came_true(told["behaviours"], base, other)
            self.assertIs(told["behaviours"]["questions"]["held"], held)
        ablate.came_true(told["behaviours"], few, more)
        self.assertEqual(told["behaviours"]["questions"]["difference"], 1.5)
        told["behaviours"]["questions"]["other"] = told["behaviours"]["questions"]["recorded"]
        ablate.came_true(told["behaviours"], few, more)
        self.assertIsNone(told["behaviours"]["questions"]["held"], "nothing was forecast")

    def test_advantages_that_are_rounding_have_no_sign(self) -> None:
        did = {name: ablate.Did("t", dict.fromkeys(ablate.BEHAVIOURS, 0.0)) for name in "ab"}
        told = ablate.forecast([({"g": {"a": 1.0, "b": -1.0}}, {"g": {"a": -1e-11, "b": 1e-11}}, did)])
        self.assertEqual(told["signs_flipped"], 0)


class Playing(unittest.TestCase):
    def test_an_episode_that_broke_off_is_no_failure_of_the_policy(self) -> None:
        folder = pathlib.Path(self.enterContext(tempfile.TemporaryDirectory()))
        reel, served = folder / "reel", types.SimpleNamespace(endpoint="http://127.0.0.1:1/v1")
        for status in (0, 1, 3):
            reel.write_text(f"#!/bin/sh\nexit {status}\n")
            reel.chmod(0o755)
            what = play.Play(str(reel), folder, folder / "out")
            if status:
                with self.assertRaisesRegex(SystemExit, f"ended with {status}"):
                    play.bench(served, what)
            else:
                self.assertGreater(play.bench(served, what).wall, 0)


class Serving(unittest.TestCase):
    @classmethod
    def setUpClass(cls) -> None:
        folder = pathlib.Path(cls.enterClassContext(tempfile.TemporaryDirectory()))
        tokenizer = Tokenizer.of([PROMPT] * 3, [ANSWERED] * 3)
        checkpoint.save(folder, model.build(model.Config(len(tokenizer), **SMALL), 0), tokenizer)
        cls.server = cls.enterClassContext(server.Server(*checkpoint.load(folder), "small", 0, 4))
        cls.server.begin()
        cls.addClassCleanup(cls.server.shutdown)

    def post(self, **fields: object) -> tuple[int, dict]:
        url = f"http://127.0.0.1:{self.server.server_port}/v1/chat/completions"
        request = {"model": "small", "max_tokens": 12, "messages": [{"role": "user", "content": "Where?"}], **fields}
        try:
            with urllib.request.urlopen(urllib.request.Request(url, json.dumps(request).encode())) as reply:
                return reply.status, json.load(reply)
        except urllib.error.HTTPError as error:
            return error.code, json.load(error)

    def image(self, width: int = images.WIDTH) -> dict:
        file = io.BytesIO()
        Image.new("RGB", (width, images.HEIGHT)).save(file, "PNG")
        return {"type": "image_url", "image_url": {"url": "data:image/png;base64," + base64.b64encode(file.getvalue()).decode()}}

    def test_answers(self) -> None:
        parts = [{"type": "text", "text": PROMPT}, self.image()]
        status, body = self.post(messages=[{"role": "user", "content": parts}], logprobs=True, seed=3, return_tokens_as_token_ids=True)
        self.assertEqual(status, 200)
        named = body["choices"][0]["logprobs"]["content"]
        self.assertEqual(len(named), body["usage"]["completion_tokens"])
        self.assertEqual("".join(bytes(token["bytes"]).decode() for token in named), body["choices"][0]["message"]["content"])
        self.assertTrue(all(token["token"].startswith("token_id:") and token["logprob"] <= 0 for token in named))
        _, again = self.post(messages=[{"role": "user", "content": parts}], logprobs=True, seed=3, return_tokens_as_token_ids=True)
        self.assertEqual(again["choices"], body["choices"])

    def test_many_at_once(self) -> None:
        found: list[int] = []
        threads = [threading.Thread(target=lambda: found.append(self.post()[0])) for _ in range(12)]
        [thread.start() for thread in threads]
        [thread.join() for thread in threads]
        self.assertEqual(found, [200] * 12)

    def test_refusals(self) -> None:
        user = lambda content: [{"role": "user", "content": content}]
        cases = [
            ({"model": "other"}, 404, "no model"),
            ({"stream": True}, 400, "`stream`"),
            ({"tools": []}, 400, "`tools` is not supported"),
            ({"top_p": 0.5}, 400, "`top_p` is not supported"),
            ({"n": 2}, 400, "`n`"),
            ({"temperature": "hot"}, 400, "`temperature`"),
            ({"max_tokens": 0}, 400, "`max_tokens`"),
            ({"messages": []}, 400, "one message"),
            ({"messages": [{"role": "system", "content": "x"}]}, 400, "one message"),
            ({"messages": user(3)}, 400, "`content`"),
            ({"messages": user([{"type": "audio"}])}, 400, "neither"),
            ({"messages": user("<image>")}, 400, "0 images"),
            ({"messages": user([{"type": "text", "text": "<image>"}, self.image(320)])}, 400, "320 x 480"),
            ({"messages": user([{"type": "image_url", "image_url": {"url": "http://x/a.png"}}])}, 400, "data URL"),
            ({"messages": user([{"type": "image_url", "image_url": {"url": "data:image/png;base64,AAAA"}}])}, 400, "cannot be read"),
            ({"messages": user("a b " * 5000)}, 400, "context"),
        ]
        for fields, status, words in cases:
            with self.subTest(words):
                got, body = self.post(**fields)
                self.assertEqual((got, words in body["error"]["message"]), (status, True), body)


class Statistics(unittest.TestCase):
    def test_probabilities(self) -> None:
        self.assertEqual(evaluate.mcnemar(0, 0), 1.0)
        self.assertAlmostEqual(evaluate.mcnemar(10, 0), 2 / 1024)
        self.assertAlmostEqual(evaluate.mcnemar(3, 2), 1.0)
        self.assertLess(evaluate.sign_flip([1.0] * 10), 0.01)
        self.assertGreater(evaluate.sign_flip([1.0, -1.0] * 5), 0.5)
        alone, homes = [str(index) for index in range(100)], [str(index // 10) for index in range(100)]
        low, high = evaluate.interval([0.0, 1.0] * 50, alone)
        self.assertTrue(0.3 < low < 0.5 < high < 0.7)
        self.assertEqual(evaluate.interval([0.0, 1.0] * 50, homes), (0.5, 0.5))  # all homes are alike
        wide = evaluate.interval([float(index // 10 % 2) for index in range(100)], homes)
        self.assertGreater(wide[1] - wide[0], 2 * (high - low))


if __name__ == "__main__":
    unittest.main()
