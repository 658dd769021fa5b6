"""Scores the tokens of recorded rollouts with a checkpoint, for `reel trace logprobs add`.

    reel ingest rollouts --store store
    reel export rl --store store --format ms-swift --style single-turn --max-pixels 0 --out rl
    python score.py checkpoint --rows rl --policy new > new.jsonl
    reel trace logprobs add rollouts --from new.jsonl

The rollouts were recorded with `reel bench --logprobs --extra-body '{"return_tokens_as_token_ids": true}'`, so that the tokens are those that
were drawn. Products of matrices are in 32 bits, as in the server: the checkpoint that sampled gives the same numbers within 1e-5.
"""

import argparse
import collections.abc
import json
import pathlib
import sys
import typing

import torch

import checkpoint
import data

PREFIX = "token_id:"


def token_ids(tokens: list[str]) -> list[int]:
    """The ids that a trace names. Fails if it names texts instead."""
    if not all(token.startswith(PREFIX) for token in tokens):
        raise SystemExit(f"the trace names tokens by their text; record with --extra-body '{{\"return_tokens_as_token_ids\": true}}'")
    return [int(token.removeprefix(PREFIX)) for token in tokens]


def rollout_rows(folder: pathlib.Path) -> collections.abc.Iterator[dict[str, typing.Any]]:
    """The rows of an exported set of rollouts that hold tokens."""
    for path in sorted((folder / "train").glob("*.jsonl")):
        with path.open(encoding="utf-8") as lines:
            for line in lines:
                if (row := json.loads(line)).get("tokens"):
                    yield row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("--rows", required=True, type=pathlib.Path, help="folder of `reel export rl`")
    parser.add_argument("--policy", required=True, help="name of the policy in the traces, e.g. new or ref")
    parser.add_argument("--threads", type=int, default=1)
    chosen = parser.parse_args()
    torch.set_num_threads(chosen.threads)
    policy, tokenizer = checkpoint.load(chosen.checkpoint)
    pictures, difference = data.Pictures(policy.config), 0.0
    for row in rollout_rows(chosen.rows):
        shown = row.get("images") or []
        prompt = next(message["content"] for message in row["messages"] if message["role"] == "user")
        drawn = token_ids(row["tokens"])
        image = chosen.rows / shown[0] if shown else None
        batch = data.batch([data.Row(data.prompt_tokens(tokenizer, policy.config, prompt), drawn, image)], pictures)
        with torch.inference_mode():
            found, _ = policy.logprobs(batch.tokens, batch.images, batch.prompts, batch.ends)
        scored = found[0].tolist()
        old = row["logprobs"].get("old") if isinstance(row["logprobs"], dict) else None
        if old:
            difference = max(difference, *(abs(one - other) for one, other in zip(old, scored)))
        about = row["provenance"]
        line = {"episode_id": about["episode"], "step": about["call"], "policy": chosen.policy, "tokens": row["tokens"], "logprobs": scored}
        print(json.dumps(line))
    print(f"largest difference from the policy that sampled: {difference:.2e}", file=sys.stderr)


if __name__ == "__main__":
    main()
