"""TRL's GRPOTrainer plays household tasks: a tiny random model, two steps, on the CPU."""

from __future__ import annotations

import inspect
import json
import sys
from pathlib import Path
from typing import Any

import pytest

trl = pytest.importorskip("trl", reason="TRL is not installed: pip install 'reel[trl]'")
torch = pytest.importorskip("torch", reason="torch is not installed")
transformers = pytest.importorskip("transformers")

sys.path.insert(0, str(Path(__file__).parents[1]))

import reel  # noqa: E402
from env_fixtures import tasks, traces  # noqa: E402
from reel.envs import HouseholdTools, household_dataset, household_factory, success_reward  # noqa: E402
from reel.envs.trl import PublishedTools  # noqa: E402
from transformers.utils import get_json_schema  # noqa: E402

SPECIAL = ["<|endoftext|>", "<|im_start|>", "<|im_end|>"]


def tokenizer() -> Any:
    """A tokenizer of bytes with the chat template of Qwen3, whose tool calls TRL reads."""
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers

    letters = {letter: index for index, letter in enumerate(sorted(pre_tokenizers.ByteLevel.alphabet()))}
    made = Tokenizer(models.BPE(vocab=letters, merges=[]))
    made.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    made.decoder = decoders.ByteLevel()
    made.add_special_tokens(SPECIAL)
    fast = transformers.PreTrainedTokenizerFast(
        tokenizer_object=made, eos_token="<|im_end|>", pad_token="<|endoftext|>", padding_side="left"
    )
    template = Path(inspect.getfile(trl)).parent / "chat_templates" / "qwen3.jinja"
    fast.chat_template = template.read_text(encoding="utf-8")
    return fast


def model(vocabulary: int) -> Any:
    """A Qwen3 of random weights."""
    torch.manual_seed(0)
    config = transformers.Qwen3Config(
        vocab_size=vocabulary, hidden_size=16, intermediate_size=32, num_hidden_layers=1, num_attention_heads=2,
        num_key_value_heads=1, head_dim=8, max_position_embeddings=16384, eos_token_id=None,
    )  # fmt: skip
    return transformers.Qwen3ForCausalLM(config)


class ScriptedTrainer(trl.GRPOTrainer):
    """A trainer whose model says what is scripted: random weights write no tool call."""

    script: list[str]

    def _generate_single_turn(self, prompt_ids: list[list[int]], *_: Any, **__: Any) -> tuple[Any, None]:
        text = self.script.pop(0) if self.script else "done"
        ids = self.processing_class.encode(text + "<|im_end|>", add_special_tokens=False)
        return [list(ids) for _ in prompt_ids], None


def call(name: str, **arguments: Any) -> str:
    return f"<tool_call>\n{json.dumps({'name': name, 'arguments': arguments})}\n</tool_call>"


def train(kind: type, tmp_path: Path, **options: Any) -> Any:
    tokens = tokenizer()
    arguments = trl.GRPOConfig(
        output_dir=str(tmp_path / "out"), max_steps=options.pop("steps"), per_device_train_batch_size=2,
        num_generations=2, max_completion_length=options.pop("length"), learning_rate=1e-3, report_to=[],
        use_cpu=True, save_strategy="no", logging_steps=1, max_tool_calling_iterations=4, bf16=False,
    )  # fmt: skip
    return kind(
        model=model(len(tokens)), args=arguments, processing_class=tokens, reward_funcs=success_reward, **options
    )


def test_the_trainer_plays_and_records(tmp_path: Path) -> None:
    trace = traces()[0]
    factory = household_factory(tasks(), group_size=2, record_dir=tmp_path / "rollouts", run="t")
    rows = household_dataset(tasks(), seeds=[3], starts=[(trace, 2)])
    trainer = train(
        ScriptedTrainer, tmp_path, steps=2, length=6000, train_dataset=rows, environment_factory=factory
    )
    trainer.script = [call("show_receptacles"), call("pick", marker_id=99), call("finish"), call("finish")] * 2
    trainer.train()
    episodes = [reel.open(path) for path in reel.trace_paths(tmp_path / "rollouts")]
    assert len(episodes) == 4, "two groups of two"
    assert len({episode.header["group_id"] for episode in episodes}) == 2
    assert sorted(episode.header["rollout_index"] for episode in episodes) == [0, 0, 1, 1]
    for episode in episodes:
        assert [step.tool for step in episode.steps][-3:] == ["show_receptacles", "pick", "finish"]
        assert episode.end and episode.end["reason"] == "finished"
    assert all(reel.replay(tmp_path / "rollouts", progress=False))
    logged = [entry for entry in trainer.state.log_history if "reward" in entry]
    # of the calls made here: a fork's parent earned what went before
    paid = [round(sum(step.reward for step in episode.steps[-3:]), 4) for episode in episodes]
    assert sorted(round(entry["reward"], 4) for entry in logged) == sorted(paid)[::2]
    assert logged[0]["tools/call_frequency"] == 4.0
    assert logged[0]["tools/failure_frequency"] == 0.0


def test_a_random_model_trains(tmp_path: Path) -> None:
    factory = household_factory(tasks(), group_size=2, record_dir=tmp_path / "rollouts", reward="success")
    trainer = train(
        trl.GRPOTrainer, tmp_path, steps=1, length=16, train_dataset=household_dataset(tasks()),
        environment_factory=factory,
    )  # fmt: skip
    trainer.train()
    episodes = [reel.open(path) for path in reel.trace_paths(tmp_path / "rollouts")]
    assert len(episodes) == 2
    # no call was made; the episodes are complete all the same
    assert [len(episode) for episode in episodes] == [0, 0]


@pytest.mark.parametrize(("kind", "profile"), [(HouseholdTools, "paper"), (PublishedTools, "real-gspo")])
def test_the_methods_are_the_tools_of_the_profile(kind: type, profile: str) -> None:
    methods = {
        name: get_json_schema(method)["function"]
        for name, method in inspect.getmembers(kind, inspect.isfunction)
        if not name.startswith("_") and name not in ("reset", "get_reward")
    }
    specs = {spec["name"]: spec for spec in reel.tools(profile)}
    assert set(methods) == set(specs)
    for name, schema in methods.items():
        assert schema["description"] == specs[name]["description"]
        given = {key: value["type"] for key, value in schema["parameters"]["properties"].items()}
        assert given == {key: value["type"] for key, value in specs[name]["parameters"]["properties"].items()}


def test_tools_return_images_for_models_that_see() -> None:
    environment = household_factory(tasks(), images=True)()
    content = environment.reset(task=0, seed=1)
    assert isinstance(content, list) and content[1]["image"].size == (640, 480)
    answer = environment.show_receptacles()
    assert isinstance(answer, list) and answer[0]["type"] == "text"
    environment.finish()
    assert environment.walk_around() == "The episode has ended."
    assert environment.get_reward() <= 0.0 and not environment.success


def test_groups_that_are_spread_over_processes(monkeypatch: pytest.MonkeyPatch) -> None:
    places: list[tuple[str, int]] = []
    for rank in range(4):
        monkeypatch.setenv("RANK", str(rank))
        factory = household_factory(tasks(), group_size=4, group_part=2, run=f"spread-{rank // 2}-{rank}")
        for _ in range(2):
            environment = factory()
            environment.reset(task=0, seed=1)
            places.append(environment._episode.opened.group)  # noqa: SLF001
            environment.get_reward()
    assert [index for _, index in places] == [0, 1, 2, 3, 0, 1, 2, 3]
